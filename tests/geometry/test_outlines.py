"""Outlines: invalid points and laws of derived values; close pairs and points by brute force."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import InputError
from hitchopt.geometry import (
    ConvexArc,
    ConvexPolygon,
    differences,
    regular_polygon,
    shortest_offset,
)
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.geometry.vectors import cross, left_of, rotated, turn
from tests.helpers.clasp_balance import random_outline
from tests.helpers.refusals import assert_refused

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(3, 12), st.floats(-3.0, 3.0), st.sampled_from(["closed", "open"]))
@settings(max_examples=60)
def test_moves_keep_lengths_and_angles(seed: int, n: int, angle: float, topology: str) -> None:
    shape = random_outline(seed, n, topology)
    assert list(shape.corners) == (list(range(n)) if shape.closed else list(range(1, n)))
    assert shape.exterior_angles.shape == (len(shape.corners),)
    for moved in (shape.translated([2.0, -1.0]), shape.rotated(angle)):
        assert type(moved) is type(shape)
        np.testing.assert_allclose(moved.edge_lengths, shape.edge_lengths, rtol=1e-12)
        np.testing.assert_allclose(moved.exterior_angles, shape.exterior_angles, atol=1e-9)
    mirrored = shape.mirrored()
    np.testing.assert_allclose(mirrored.exterior_angles, shape.exterior_angles[::-1], atol=1e-9)
    shift = 1 if shape.closed else 0  # edge k of the image is edge n-2-k, of an arc n-1-k
    lengths = np.roll(shape.edge_lengths[::-1], -shift)
    np.testing.assert_allclose(mirrored.edge_lengths, lengths, rtol=1e-12)
    larger = shape.scaled(1.5)
    np.testing.assert_allclose(larger.edge_lengths, 1.5 * shape.edge_lengths)
    np.testing.assert_allclose(larger.centroid, shape.centroid, atol=1e-9)
    if isinstance(shape, ConvexPolygon) and isinstance(larger, ConvexPolygon):
        assert larger.area == pytest.approx(2.25 * shape.area)
        np.testing.assert_allclose(shape.renumbered(1).vertices[0], shape.vertices[1])


@given(seeds, st.integers(3, 12))
@settings(max_examples=20)
def test_area_and_centroid_match_random_points(seed: int, n: int) -> None:
    shape = ConvexPolygon(random_outline(seed, n))
    lower, upper = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    points = np.random.default_rng(1).uniform(lower, upper, (40_000, 2))
    offset = points[:, None] - shape.vertices
    u = shape.edge_directions
    inside = np.all(u[:, 0] * offset[..., 1] - u[:, 1] * offset[..., 0] < 0.0, axis=1)
    share = np.mean(inside) * np.prod(upper - lower)
    assert share == pytest.approx(shape.area, rel=0.03)
    size = float(np.max(upper - lower))
    np.testing.assert_allclose(points[inside].mean(axis=0), shape.centroid, atol=0.02 * size)


@given(seeds, st.integers(2, 12))
@settings(max_examples=20)
def test_arc_centroids_match_evenly_spaced_points(seed: int, n: int) -> None:
    shape = random_outline(seed, n, "open")
    ends = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(shape.vertices, axis=0), axis=1)))
    along = (np.arange(20_000) + 0.5) / 20_000 * ends[-1]
    mean = [float(np.mean(np.interp(along, ends, shape.vertices[:, i]))) for i in (0, 1)]
    np.testing.assert_allclose(shape.centroid, mean, atol=1e-6)


def test_regular_polygons_have_their_edge_length_and_start_angle() -> None:
    shape = regular_polygon(7, 1.3, 0.4)
    np.testing.assert_allclose(shape.edge_lengths, 1.3)
    assert math.atan2(shape.vertices[0, 1], shape.vertices[0, 0]) == pytest.approx(0.4)


@pytest.mark.parametrize("n", [3, 9])
def test_arcs_turn_by_less_than_a_full_turn(n: int) -> None:
    """Turn n edges by equal angles at n - 1 corners."""

    def turning(turn: float) -> np.ndarray:
        headings = 0.3 - turn * np.arange(n)
        steps = np.column_stack([np.cos(headings), np.sin(headings)])
        return np.vstack([[2.0, -1.0], [2.0, -1.0] + np.cumsum(steps, axis=0)])

    limit = 2.0 * math.pi / (n - 1)
    if limit < math.pi:
        with pytest.raises(InputError, match=r"less than 360° in all \(it turns by 36"):
            ConvexArc(turning(limit * 1.001))
    shape = ConvexArc(turning(min(limit, 3.1) * 0.999))
    np.testing.assert_allclose(shape.exterior_angles, min(limit, 3.1) * 0.999)


STAR = [[math.sin(4 * math.pi * k / 5), math.cos(4 * math.pi * k / 5)] for k in range(5)]
"""A pentagram turns right everywhere, twice around."""

REFUSED: list[tuple[type[Any], object, str, str]] = [
    (ConvexPolygon, [[0, 0], [1, 0], [0, 1]], "polygon", "clockwise"),
    (ConvexPolygon, [[0, 0], [0, 1], [1, 1], [0.4, 0.6]], "polygon[3]", "turns left by"),
    (ConvexPolygon, [[0, 0], [1, 2], [2, 4]], "polygon", "on one line; move one off the line"),
    (ConvexPolygon, [[0, 0], [2, 0], [1, 0], [3, 0]], "polygon", "its points are on one line"),
    (ConvexArc, [[0, 0], [1, 1], [2, 2]], "polygon", "its points are on one line"),
    (ConvexPolygon, [[0, 0], [0, 1], [0, 1], [1, 1]], "polygon[1]", "coincident"),
    (ConvexPolygon, [[0, 0], [0, 1], [1]], "polygon", "at least 3"),
    (ConvexPolygon, STAR, "polygon", "simple"),
    (ConvexArc, [[0, 0], [1, 0], [0, 1]], "polygon", "clockwise"),
    (ConvexArc, [[0, 0], [0, 1], [1, 1], [2, 2]], "polygon[2]", "convex"),
    (ConvexArc, [[0, 0], [0, 1], [math.nan, 1]], "polygon[2]", "finite"),
]


@pytest.mark.parametrize(("kind", "points", "key", "words"), REFUSED)
def test_bad_outlines_are_refused(kind: type[Any], points: object, key: str, words: str) -> None:
    assert_refused(lambda: kind(points), key, words)


def test_vertices_are_a_read_only_copy() -> None:
    source = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    shape = ConvexPolygon(source)
    source[0] = 5.0
    assert shape.vertices[0, 0] == 0.0
    assert not shape.vertices.flags.writeable


def gap(a: Boxes, i: int, b: Boxes, j: int) -> float:
    """Return the distance of two boxes, axis by axis."""
    gaps = np.maximum(a.lower[i] - b.upper[j], b.lower[j] - a.upper[i])
    return float(np.linalg.norm(np.maximum(gaps, 0.0)))


def boxes(rng: np.random.Generator, count: int, scale: float) -> Boxes:
    """Return boxes of sizes from 1e-4 to 10, some of them points."""
    centres = rng.uniform(-scale, scale, (count, 3))
    sizes = 10.0 ** rng.uniform(-4.0, 1.0, (count, 3)) * (rng.random((count, 1)) > 0.3)
    return Boxes(centres - sizes, centres + sizes)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), cutoff=st.floats(0.0, 3.0), single=st.booleans())
def test_close_pairs_match_brute_force(seed: int, cutoff: float, single: bool) -> None:
    rng = np.random.default_rng(seed)
    a = boxes(rng, 30, 20.0)
    b = a if single else boxes(rng, 20, 20.0)
    pairs = close_pairs(a, None if single else b, cutoff)
    indices = list(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    every = itertools.product(range(len(a)), range(len(b)))
    expected = {(i, j) for i, j in every if (i < j or not single) and gap(a, i, b, j) <= cutoff}
    assert len(indices) == len(set(indices))
    assert set(indices) == expected


@given(seeds, st.sampled_from([2, 3]))
@settings(max_examples=60)
def test_shortest_offsets_match_sampled_segments(seed: int, d: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 8, 2, d))
    a[0, 1] = a[0, 0]  # a point
    b[1, 1], a[1, 1] = b[1, 0], a[1, 0]  # two points
    b[2, 1] = b[2, 0] + 2.0 * (a[2, 1] - a[2, 0])  # parallel
    b[3, 0] = a[3, 0]  # touching
    shares = np.linspace(0.0, 1.0, 201)[:, None]
    on_a, on_b = (x[:, :1] + shares * (x[:, 1:] - x[:, :1]) for x in (a, b))
    sampled = np.linalg.norm(on_a[:, :, None] - on_b[:, None, :], axis=-1).min(axis=(1, 2))
    distances = np.linalg.norm(shortest_offset(differences(a, b)), axis=1)
    lengths = np.linalg.norm(a[:, 1] - a[:, 0], axis=1) + np.linalg.norm(b[:, 1] - b[:, 0], axis=1)
    assert np.all(distances <= sampled + 1e-12)
    assert np.all(sampled - distances <= lengths * 0.0026)
    reverse = shortest_offset(differences(b, a))
    np.testing.assert_allclose(np.linalg.norm(reverse, axis=1), distances, atol=1e-12)


@given(seeds, st.floats(-3.1, 3.1))
def test_left_is_counter_clockwise(seed: int, angle: float) -> None:
    a = np.random.default_rng(seed).normal(size=(6, 2)) + 3.0
    np.testing.assert_allclose(turn(a, rotated(a, angle)), angle, atol=1e-12)
    np.testing.assert_allclose(left_of(a), rotated(a, 0.5 * math.pi), atol=1e-12)
    np.testing.assert_allclose(cross(a, left_of(a)), np.sum(a * a, axis=1), rtol=1e-12)
    level = left_of(np.column_stack([a, np.ones(6)]))
    np.testing.assert_array_equal(level, np.column_stack([left_of(a), np.zeros(6)]))


def test_moves_take_numbers_only() -> None:
    triangle = regular_polygon(3, 1.0)
    for move, key, remedy in (
        (lambda: triangle.rotated("90"), "angle", "remove the quotes"),  # type: ignore[arg-type]
        (lambda: triangle.translated([1.0, np.nan]), "offset[0]", "within"),
        (lambda: triangle.translated([1.0, 2.0, 3.0]), "offset", "two numbers"),
        (lambda: triangle.scaled(-1.0), "factor", "positive"),
    ):
        assert_refused(move, key, remedy)
