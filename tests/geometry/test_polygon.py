"""Convex polygons: what is refused, and laws of what is derived."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import InputError
from hitchopt.geometry import ConvexPolygon, regular_polygon
from problems.random_morph import random_convex_polygon

seeds = st.integers(0, 2**32 - 1)


def polygon(seed: int, n: int) -> ConvexPolygon:
    rng = np.random.default_rng(seed)
    return random_convex_polygon(n, 1.3, rng).translated(rng.normal(size=2))


@given(seeds, st.integers(3, 12), st.floats(-3.0, 3.0))
@settings(max_examples=40)
def test_moving_and_mirroring_keep_lengths_and_angles(seed: int, n: int, angle: float) -> None:
    shape = polygon(seed, n)
    for moved in (shape.translated([2.0, -1.0]), shape.rotated(angle)):
        np.testing.assert_allclose(moved.edge_lengths, shape.edge_lengths, rtol=1e-12)
        np.testing.assert_allclose(moved.exterior_angles, shape.exterior_angles, atol=1e-9)
    mirrored = shape.mirrored()
    np.testing.assert_allclose(mirrored.exterior_angles, shape.exterior_angles[::-1], atol=1e-9)
    np.testing.assert_allclose(shape.renumbered(1).vertices[0], shape.vertices[1])
    assert shape.scaled(1.5).area == pytest.approx(2.25 * shape.area)
    np.testing.assert_allclose(shape.scaled(1.5).centroid, shape.centroid, atol=1e-9)


@given(seeds, st.integers(3, 12))
@settings(max_examples=20)
def test_area_and_centroid_by_counting_random_points(seed: int, n: int) -> None:
    shape = polygon(seed, n)
    lower, upper = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    points = np.random.default_rng(1).uniform(lower, upper, (40_000, 2))
    offset = points[:, None] - shape.vertices
    u = shape.edge_directions
    inside = np.all(u[:, 0] * offset[..., 1] - u[:, 1] * offset[..., 0] < 0.0, axis=1)
    share = np.mean(inside) * np.prod(upper - lower)
    assert share == pytest.approx(shape.area, rel=0.03)
    size = float(np.max(upper - lower))
    np.testing.assert_allclose(points[inside].mean(axis=0), shape.centroid, atol=0.02 * size)


def test_regular_polygon_has_its_edge_and_starts_where_told() -> None:
    shape = regular_polygon(7, 1.3, 0.4)
    np.testing.assert_allclose(shape.edge_lengths, 1.3)
    assert math.atan2(shape.vertices[0, 1], shape.vertices[0, 0]) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("points", "word"),
    [
        ([[0, 0], [1, 0], [0, 1]], "clockwise"),
        ([[0, 0], [0, 1], [1, 1], [0.4, 0.6]], "convex"),
        ([[0, 0], [0, 1], [0, 2], [1, 1]], "convex"),
        ([[0, 0], [0, 1], [0, 1], [1, 1]], "coincident"),
        ([[0, 0], [0, 1]], "at least 3"),
        ([[0, 0], [0, float("nan")], [1, 1]], "finite"),
        ([[0, 0], [0, 1], [1]], "at least 3"),
        # A pentagram turns right everywhere, twice around.
        (
            [[math.sin(4 * math.pi * k / 5), math.cos(4 * math.pi * k / 5)] for k in range(5)],
            "simple",
        ),
    ],
)
def test_bad_polygons_are_refused_with_the_remedy(points: object, word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        ConvexPolygon(points)  # type: ignore[arg-type]
    assert caught.value.key.startswith("polygon")
    assert caught.value.remedy


def test_vertices_are_a_read_only_copy() -> None:
    given_points = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    shape = ConvexPolygon(given_points)
    given_points[0] = 5.0
    assert shape.vertices[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        shape.vertices[0, 0] = 1.0
