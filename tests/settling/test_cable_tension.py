"""The law of a cable: its lengths, tensions, energies, and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from hitchopt.hitch.catenary import Catenary
from hitchopt.settling.cable_tension import CableLaw, least_tension

CHORDS = np.array([[0.4, 1.3, 0.6], [0.5, 1.1, 0.3], [0.7, 0.9, 0.8]])
MIDDLES = np.array([[1.1, 1.0, 1.2], [0.9, 1.0, 1.05], [1.0, 1.1, 0.8]])


def law(weight: float, spare: float = 0.01, stiffness: float = 1e4) -> CableLaw:
    lengths = np.sum(CHORDS, axis=-1) + spare
    reference = np.array([0.4, 0.5, 0.6])
    least = least_tension(weight, CHORDS)
    return CableLaw(lengths, weight, lengths / stiffness, reference, np.full(3, 1.03), least)


@given(st.floats(0.005, 0.2), st.floats(-0.02, 0.05))
def test_chords_arcs_and_stretch_are_the_length(weight: float, spare: float) -> None:
    cable = law(weight, spare)
    T = cable.tensions(CHORDS)
    taut = ~cable.slack(T)
    arcs = (weight / T[:, None]) ** 2 * CHORDS**3 / 24.0
    real = cable.lengths + cable.compliance * (T - cable.reference)
    np.testing.assert_allclose(np.sum(CHORDS + arcs, axis=-1)[taut], real[taut], rtol=1e-12)
    assert np.all(T[~taut] == cable.least[~taut])


def test_a_slack_cable_without_weight_does_not_pull_and_a_taut_one_as_a_spring() -> None:
    slack, taut = law(0.0, 0.01, 500.0), law(0.0, -0.002, 500.0)
    assert np.all(slack.tensions(CHORDS) == 0.0)
    assert np.all(slack.slack(slack.tensions(CHORDS)))
    expected = taut.reference + 0.002 * 500.0 / taut.lengths
    np.testing.assert_allclose(taut.tensions(CHORDS), expected, rtol=1e-12)


def test_the_arc_is_that_of_a_hanging_cable() -> None:
    """The level pull of a catenary of the length that the law says is the law's tension."""
    w, s, T = 0.1, 1.2, 0.6
    length = s * (1.0 + (w * s / T) ** 2 / 24.0)
    hanging = Catenary.spanning(s, 0.0, length)
    level = w * 0.5 * s / float(hanging.sigma)
    assert level == pytest.approx(T, rel=2e-3)
    shape, _ = quad(lambda x: np.hypot(1.0, np.sinh(w * x / T)), -s / 2, s / 2)
    assert shape == pytest.approx(length, rel=1e-5)


@pytest.mark.parametrize("weight", [0.0, 0.03, 0.1])
def test_derivatives_agree_with_finite_differences(weight: float) -> None:
    cable, h = law(weight, -0.004 if weight == 0.0 else 0.01), 1e-6
    T = cable.tensions(CHORDS)
    assert not np.any(cable.slack(T))

    def energy(chords: np.ndarray) -> np.ndarray:
        return cable.energies(chords, MIDDLES, cable.tensions(chords))

    for p in range(3):
        step = h * np.eye(3)[p]
        up, down = CHORDS + step, CHORDS - step
        slope = (energy(up) - energy(down)) / (2 * h)
        np.testing.assert_allclose(cable.span_tensions(CHORDS, MIDDLES, T)[:, p], slope, rtol=1e-6)
        T_up, T_down = cable.tensions(up), cable.tensions(down)
        np.testing.assert_allclose(
            cable.tension_slopes(CHORDS, T)[:, p], (T_up - T_down) / (2 * h), rtol=1e-5
        )
        slopes = (
            cable.span_tensions(up, MIDDLES, T_up) - cable.span_tensions(down, MIDDLES, T_down)
        ) / (2 * h)
        np.testing.assert_allclose(
            cable.chord_stiffness(CHORDS, T)[:, p], slopes, rtol=1e-5, atol=1e-6
        )
    lengths = [
        CableLaw(
            cable.lengths + sign * h,
            weight,
            cable.compliance,
            cable.reference,
            cable.heights,
            cable.least,
        ).tensions(CHORDS)
        for sign in (1.0, -1.0)
    ]
    np.testing.assert_allclose(
        -cable.length_slopes(CHORDS, T), (lengths[0] - lengths[1]) / (2 * h), rtol=1e-5
    )
