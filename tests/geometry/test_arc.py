"""Convex arcs: what is refused, and laws of what is derived."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import InputError
from hitchopt.geometry import ConvexArc
from problems.random_morph import random_convex_polygon

seeds = st.integers(0, 2**32 - 1)


def arc(seed: int, n: int) -> ConvexArc:
    """n + 1 points in a row of a larger polygon, off the origin."""
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n + 3, 1.3, rng).translated(rng.normal(size=2))
    return ConvexArc(polygon.vertices[: n + 1])


def turning(turn: float, n: int) -> np.ndarray:
    """n edges of one metre, each turned right from the one before."""
    headings = 0.3 - turn * np.arange(n)
    steps = np.column_stack([np.cos(headings), np.sin(headings)])
    points: np.ndarray = np.vstack([[2.0, -1.0], [2.0, -1.0] + np.cumsum(steps, axis=0)])
    return points


@given(seeds, st.integers(2, 12), st.floats(-3.0, 3.0))
@settings(max_examples=40)
def test_moving_and_mirroring_keep_lengths_and_angles(seed: int, n: int, angle: float) -> None:
    shape = arc(seed, n)
    assert shape.exterior_angles.shape == (n - 1,)
    assert list(shape.corners) == list(range(1, n))
    for moved in (shape.translated([2.0, -1.0]), shape.rotated(angle)):
        assert isinstance(moved, ConvexArc)
        np.testing.assert_allclose(moved.edge_lengths, shape.edge_lengths, rtol=1e-12)
        np.testing.assert_allclose(moved.exterior_angles, shape.exterior_angles, atol=1e-9)
    mirrored = shape.mirrored()
    np.testing.assert_allclose(mirrored.exterior_angles, shape.exterior_angles[::-1], atol=1e-9)
    np.testing.assert_allclose(mirrored.edge_lengths, shape.edge_lengths[::-1], rtol=1e-12)
    np.testing.assert_allclose(shape.scaled(1.5).edge_lengths, 1.5 * shape.edge_lengths)
    np.testing.assert_allclose(shape.scaled(1.5).centroid, shape.centroid, atol=1e-9)


@given(seeds, st.integers(2, 12))
@settings(max_examples=20)
def test_the_centroid_is_the_mean_of_points_spread_evenly_along_the_arc(seed: int, n: int) -> None:
    shape = arc(seed, n)
    ends = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(shape.vertices, axis=0), axis=1)))
    along = (np.arange(20_000) + 0.5) / 20_000 * ends[-1]
    mean = [float(np.mean(np.interp(along, ends, shape.vertices[:, i]))) for i in (0, 1)]
    np.testing.assert_allclose(shape.centroid, mean, atol=1e-6)


@pytest.mark.parametrize("n", [3, 9])
def test_arcs_turn_by_less_than_once_around(n: int) -> None:
    """All n edges at equal turns: n - 1 of them."""
    most = 2.0 * math.pi / (n - 1)
    if most < math.pi:
        with pytest.raises(InputError, match=r"less than 360° in all \(it turns by 36"):
            ConvexArc(turning(most * 1.001, n))
    shape = ConvexArc(turning(min(most, 3.1) * 0.999, n))
    np.testing.assert_allclose(shape.exterior_angles, min(most, 3.1) * 0.999)


@pytest.mark.parametrize(
    ("points", "key", "word"),
    [
        ([[0, 0], [1, 0], [0, 1]], "polygon", "clockwise"),
        ([[0, 0], [0, 1], [1, 1], [2, 2]], "polygon[2]", "convex"),
        ([[0, 0], [0, 1]], "polygon", "at least 3"),
        ([[0, 0], [0, 1], [math.nan, 1]], "polygon[2]", "finite"),
    ],
)
def test_bad_arcs_are_refused_with_the_remedy(points: object, key: str, word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        ConvexArc(points)  # type: ignore[arg-type]
    assert caught.value.key == key
    assert caught.value.remedy
