"""Paths as few segments: near the curves, connected, with their ends, and few."""

import numpy as np
import pytest

from hitchopt.values import Array
from hitchopt.view.path_segments import path_segments


def wound(n: int, count: int, seed: int = 3) -> Array:
    """Return n smooth curves (n, count, 3) [m] off the origin."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, count)[:, None, None]
    sizes, shifts = rng.normal(size=(2, 2, n, 3))
    waves = np.array([sizes[k] * np.sin((2.0 + 4.0 * k) * t + shifts[k]) for k in range(2)])
    return np.moveaxis(5.0 + np.sum(waves, axis=0), 1, 0)


def distances(points: Array, segments: Array) -> Array:
    """Return the distances of points (p, 3) to the nearest of segments (m, 2, 3), sampled."""
    shares = np.linspace(0.0, 1.0, 400)[:, None, None]
    places = (1.0 - shares) * segments[:, 0] + shares * segments[:, 1]
    apart = np.linalg.norm(points[:, None] - places.reshape(-1, 3), axis=-1)
    found: Array = np.min(apart, axis=1)
    return found


@pytest.mark.parametrize("tolerance", [0.001, 0.02, 0.3])
def test_every_sample_stays_near_the_segments_of_its_curve(tolerance: float) -> None:
    curves = wound(4, 120)
    segments, owners = path_segments(curves, tolerance)
    for k, curve in enumerate(curves):
        own = segments[owners == k]
        assert np.max(distances(curve, own)) <= tolerance + 0.005  # the sampling's own
        np.testing.assert_array_equal(own[0, 0], curve[0])
        np.testing.assert_array_equal(own[-1, 1], curve[-1])
        np.testing.assert_array_equal(own[1:, 0], own[:-1, 1])


def test_a_larger_tolerance_needs_fewer_segments() -> None:
    curves = wound(3, 200)
    counts = [len(path_segments(curves, tolerance)[0]) for tolerance in (0.0, 0.001, 0.01, 0.1)]
    assert counts[0] == 3 * 199
    assert counts[1] < 0.5 * counts[0]
    assert counts == sorted(counts, reverse=True)


def test_straight_and_standing_curves_are_one_segment_each() -> None:
    straight = np.linspace([1.0, 2.0, 3.0], [4.0, 2.5, 1.0], 65)
    still = np.tile([1.0, -2.0, 0.5], (65, 1))
    segments, owners = path_segments(np.stack([straight, still]), 1e-9)
    np.testing.assert_array_equal(owners, [0, 1])
    np.testing.assert_allclose(segments[0], straight[[0, -1]])
    np.testing.assert_allclose(segments[1], still[[0, -1]])


def test_a_turn_back_is_kept() -> None:
    """The line through both ends is near the turn, the segment between them is not."""
    x = np.concatenate([np.linspace(0.0, 1.0, 20), np.linspace(1.0, 0.5, 11)[1:]])
    curve = np.column_stack([x, 0.0 * x, 0.0 * x])[None]
    segments, _ = path_segments(curve, 1e-6)
    assert np.max(segments[..., 0]) == 1.0
