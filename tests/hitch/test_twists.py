"""Laws of the friction of two cables that twist about each other."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.hitch.energy import bends_of
from hitchopt.hitch.twists import bend, bend_together, cosine_of, half_axes, sliding_parts
from tests.helpers.clasp_balance import unit

TURNS = np.radians([1.0, 20.0, 60.0, 90.0, 135.0, 179.0])


@pytest.mark.parametrize("turn", TURNS)
def test_bends_are_arcs_of_half_a_turn_of_a_helix(turn: float) -> None:
    """Its tangents are at half of the turn to the bisector; their directions draw the bend."""
    phase = np.linspace(0.0, np.pi, 20_001)
    level, along = np.sin(0.5 * turn), np.cos(0.5 * turn)
    tangents = np.stack([level * np.cos(phase), level * np.sin(phase), 0.0 * phase + along], -1)
    ends = np.arccos(tangents[0] @ tangents[-1])
    assert ends == pytest.approx(turn)
    arc = np.sum(np.linalg.norm(np.diff(tangents, axis=0), axis=-1))
    assert bend(np.cos(turn)) == pytest.approx(arc, rel=1e-6)
    assert arc > turn
    assert cosine_of(bend(np.cos(turn))) == pytest.approx(np.cos(turn))


def test_bends_have_the_derivatives_of_complex_steps() -> None:
    random = np.random.default_rng(1)
    spans, ways = random.normal(size=(2, 5, 3, 3))
    steps = [bends_of(unit(spans + h * ways)) for h in (1e-6, -1e-6)]
    change = spans + 1e-30j * ways
    size = np.sqrt(np.sum(change * change, axis=-1, keepdims=True))
    slopes = bends_of(change / size).imag / 1e-30
    np.testing.assert_allclose(slopes, (steps[0] - steps[1]) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("turn", TURNS)
def test_shares_of_sliding_cables_are_on_the_ellipse_where_rates_are_normal(turn: float) -> None:
    """No other shares of a contact dissipate more."""
    c, random = np.cos(turn), np.random.default_rng(2)
    rates = random.normal(size=(50, 2))
    along, size = sliding_parts(np.full(50, c), rates)
    shares = along / size[:, None]
    matrix = np.array([[1.0, c], [c, 1.0]])
    np.testing.assert_allclose(
        np.einsum("ki,ij,kj->k", shares, matrix, shares), np.sin(turn) ** 2, rtol=1e-9
    )
    np.testing.assert_allclose(unit(shares @ matrix), unit(rates), atol=1e-7)
    alike, opposite = half_axes(np.array(c))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    u, v = alike * np.cos(angle), opposite * np.sin(angle)
    others = np.stack([u + v, u - v], axis=-1)
    np.testing.assert_allclose(np.sum((others @ matrix) * others, axis=-1), np.sin(turn) ** 2)
    assert np.all(np.max(rates @ others.T, axis=-1) <= np.sum(rates * shares, axis=-1) + 1e-9)


@pytest.mark.parametrize("turn", TURNS)
def test_cables_that_slide_alone_or_alike_have_shares_of_their_own(turn: float) -> None:
    c = np.array(np.cos(turn))
    along, size = sliding_parts(c, np.array([0.3, 0.0]))
    np.testing.assert_allclose(along / size, [1.0, -np.cos(turn)])
    along, size = sliding_parts(c, np.array([-0.2, -0.2]))
    np.testing.assert_allclose(along / size, [-np.sin(0.5 * turn)] * 2)
    assert bend_together(np.array(turn)) == pytest.approx(bend(c) * np.sin(0.5 * turn))
