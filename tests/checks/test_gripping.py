"""Arcs of edges that are wrapped around what they hold: enclosed lengths against exact ones."""

import numpy as np
import pytest

from hitchopt.checks.objects import arc_lengths
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

RADIUS = 0.3
X = np.linspace(0.0, 1.0, 41)


def arcs(seed: int, spread: float, least: float = 0.0) -> Array:
    """Rows (200, 5, 6) of ``wrapped_arcs``: chords of a circle, and a polygon's sides."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((200, 5, 6))
    along = rng.normal(size=(200, 3, 1))
    along *= rng.uniform(least, 1.7 * RADIUS, (200, 1, 1)) / np.linalg.norm(along, axis=1)[:, None]
    rows[:, :3] = along + spread * rng.uniform(-1.0, 1.0, (200, 3, 6))
    rows[:100, 3] = RADIUS
    rows[100:, :3], rows[100:, 4] = 0.0, rng.uniform(0.0, 2.0, (100, 1))
    return rows


def exact(rows: Array) -> Array:
    """Lengths (200, times) at times X."""
    there = rows @ bernstein.basis(X, rows.shape[-1] - 1).T
    on_circle = 2.0 * RADIUS * np.arcsin(np.linalg.norm(there[:, :3], axis=1) / (2.0 * RADIUS))
    return np.where(rows[:, 3, :1] > 0.0, on_circle, rows[:, 4, :1])


@pytest.mark.parametrize("spread", [0.0, 1e-5, 1e-3, 0.03])
def test_arcs_are_enclosed_and_at_a_point_known(spread: float) -> None:
    rows = arcs(3, spread)
    found, lengths = arc_lengths(rows), exact(rows)
    there = (found.c @ bernstein.basis(X, found.degree).T)[:, 0]
    assert np.all(np.abs(there - lengths) <= np.asarray(found.r)[:, None] + 1e-14)
    points = arc_lengths((rows @ bernstein.basis(X, 5).T)[..., 7:8])
    np.testing.assert_allclose(points.c[:, 0, 0], lengths[:, 7], rtol=1e-12)
    assert np.max(points.r) < 1e-11


def test_short_arcs_are_narrow_and_longer_chords_than_the_circle_has_tell_nothing() -> None:
    """The error falls with the square of how much a chord varies, as its norm's does."""
    chords = (arcs(5, spread, 0.5 * RADIUS)[:100] for spread in (1e-3, 1e-4))
    wide, narrow = (np.max(arc_lengths(each).r) for each in chords)
    assert narrow < 1.1e-2 * wide
    assert wide < 1e-5
    rows = np.zeros((1, 5, 2))
    rows[0, 0], rows[0, 3] = [0.5, 0.7], RADIUS
    assert np.all(np.isinf(arc_lengths(rows).r))
