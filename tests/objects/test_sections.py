"""Sections, slabs and placed objects: distances against brute force, and invalid values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import hitchopt as ho
from hitchopt.motion.loads import centre_path
from hitchopt.objects import Slab
from hitchopt.objects.placing import check_placed, surface_below
from hitchopt.values import Array
from tests.helpers.refusals import Refusal, assert_refused

examples = settings(max_examples=30)
SEEDS = st.integers(0, 10_000)
BOX = [[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]]


def random_section(rng: np.random.Generator) -> ho.Section:
    if rng.random() < 0.3:
        return ho.Section(radius=float(rng.uniform(0.1, 0.5)))
    points = rng.normal(size=(12, 2)) * [0.3, 0.2] + rng.normal(size=2) * 0.2
    hull = points[ConvexHull(points).vertices]
    return ho.Section(hull[:: rng.choice([-1, 1])])


@examples
@given(SEEDS, st.floats(0.001, 0.2))
def test_widened_sections_have_their_sides_farther_out(seed: int, distance: float) -> None:
    """A circle everywhere; a polygon along its normals, and in between by no less."""
    section = random_section(np.random.default_rng(seed))
    wider, angles = section.widened(distance), np.linspace(0.0, 2.0 * np.pi, 50)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    more = wider.support(directions) - section.support(directions)
    assert np.all(more >= distance - 1e-9)
    if section.outline is None:
        assert np.allclose(more, distance)
        return
    edges = section.sides[:, 1] - section.sides[:, 0]
    normals = edges[:, ::-1] * [-1.0, 1.0] / np.linalg.norm(edges, axis=1)[:, None]
    assert np.allclose(wider.support(normals) - section.support(normals), distance)


def inner_points(section: ho.Section, rng: np.random.Generator, count: int) -> Array:
    """Return points of the section, including its corners."""
    weights = rng.dirichlet(np.full(len(section.core), 0.5), count)
    angles = rng.uniform(0.0, 2.0 * np.pi, count)
    round_ = section.rounding * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.vstack([weights @ section.core + round_, section.core])


@examples
@given(SEEDS)
def test_distances_match_the_nearest_point(seed: int) -> None:
    """Check points and segments outside, rays from inside, and the support function."""
    rng = np.random.default_rng(seed)
    section = random_section(rng)
    points, places = inner_points(section, rng, 400), rng.normal(size=(20, 2))
    distance, normals = section.clearance(places)
    brute = np.min(np.linalg.norm(places[:, None] - points, axis=-1), axis=1)
    assert np.all(np.maximum(distance, 0.0) <= brute + 1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert np.all(np.abs(section.clearance(places - distance[:, None] * normals)[0]) < 1e-9)
    directions = normals[:5]
    assert np.all(section.support(directions) >= np.max(directions @ points.T, axis=1) - 1e-12)
    ends = points[:20] + section.reach(points[:20], normals)[:, None] * normals
    assert np.all(np.abs(section.clearance(ends)[0]) < 1e-9)
    assert np.all(section.clearance(ends + 1e-3 * normals)[0] > 0.0)
    first, last = rng.normal(size=(2, 10, 2))
    result = section.segment_distance(first, last)
    between = first + np.linspace(0.0, 1.0, 2001)[:, None, None] * (last - first)
    brute = np.min(np.maximum(section.clearance(between)[0], 0.0), axis=0)
    assert np.all((result <= brute + 1e-12) & (result >= brute - 2e-3))


@examples
@given(SEEDS)
def test_slabs_have_signed_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slab = Slab(random_section(rng), 0.1, 0.5)
    places = rng.normal(size=(30, 3))
    result = slab.clearance(places)
    feet = places - result.distance[:, None] * result.normals
    assert np.all(np.abs(slab.clearance(feet).distance) < 1e-9)
    behind = slab.support(result.normals) - np.einsum("md,md->m", result.normals, places)
    outside = result.distance > 0.0
    np.testing.assert_allclose(result.distance[outside], -behind[outside], atol=1e-9)


def test_outlines_are_stored_clockwise_without_collinear_points() -> None:
    corners = [*BOX[:2], [0.4, 0.0], *BOX[2:]]
    for outline in (corners, corners[::-1]):
        result = ho.Section(outline).outline
        assert result is not None
        assert len(result) == 4
        assert ho.ConvexPolygon(result).area == pytest.approx(0.48)


def solid(at: list[float], **values: object) -> ho.SolidObject:
    return ho.SolidObject(ho.Section(BOX), at=at, **values)  # type: ignore[arg-type]


def test_objects_stand_on_the_ground_or_on_each_other() -> None:
    """A shelf above a box is not its support."""
    table, shelf = (solid([1, 2, z], upper=0.5, fixed=True) for z in (0, 2))
    objects = {"table": table, "box": solid([1, 2, 0.5]), "shelf": shelf}
    check_placed(objects, 0.0)
    rimmed(0.3)
    poses = np.stack([each.pose for each in objects.values()])
    assert surface_below(objects, poses, "box", 0.0) == (0.5, "table")
    poses[1, 0] += 2.0
    assert surface_below(objects, poses, "box", 0.0) == (0.0, None)


def test_the_centre_of_mass_turns_with_its_object() -> None:
    body = ho.SolidObject(ho.Section(np.add(BOX, [0.3, 0.2])), at=[1.0, 2.0, 0.5], yaw=0.7)
    c, s = np.cos(0.7), np.sin(0.7)
    expected = [1.0 + 0.3 * c - 0.2 * s, 2.0 + 0.3 * s + 0.2 * c, 0.5 + body.centre_of_mass[2]]
    result = centre_path(body.pose[None, :, None], body)
    np.testing.assert_allclose(result[0, :, 0], expected)


def placed(at: list[float]) -> None:
    table = solid([1, 2, 0], upper=0.5, fixed=True)
    check_placed({"table": table, "box": solid(at)}, 0.0)


def rimmed(height: float) -> None:
    """Place a box whose rim is above a pillar of 0.3 m, or is cut by it."""
    pillar = ho.SolidObject(ho.Section(radius=0.05), at=[0.8, 0.0, 0.0], upper=0.3, fixed=True)
    box = solid([0, 0, 0], upper=0.5, rim=ho.Rim(ho.Section(radius=1.0), height))
    check_placed({"pillar": pillar, "box": box}, 0.0)


EITHER = "specify either an outline or a circle's radius"
CONCAVE: Any = [[0, 0], [1, 0], [0.4, 0.4], [0, 1]]
REFUSED: list[Refusal] = [
    (ho.Section, "outline", EITHER),
    (lambda: ho.Section(BOX, radius=0.1), "outline", EITHER),
    (lambda: ho.Section(radius=-0.1), "radius", "greater than 0"),
    (lambda: ho.Section([[0, 0], [1, 0], [2, 0]]), "outline", "not in line"),
    (lambda: ho.Section(CONCAVE), "outline[2]", "specify the hull: [[0.0, 1.0]"),
    (lambda: placed([1.0, 2.0, 0.6]), "objects.box.at", "[1.0, 2.0, 0.6]: must be such that it"),
    (lambda: placed([3.0, 2.0, 0.1]), "objects.box.at", "write [3.0, 2.0, 0.0]"),
    (lambda: placed([1.7, 2.0, 0.0]), "objects.table.at", "must be apart from objects.box"),
    (lambda: rimmed(0.2), "objects.pillar.at", "must be apart from objects.box"),
    (lambda: solid([0, 0, 0], lower=0.2, upper=0.1), "upper", "must be above its floor, 0.2 m"),
    (lambda: solid([0, 0, 0], rim=ho.Rim(ho.Section(radius=1.0), 0.9)), "rim.height", "the body"),
    (lambda: solid([0, 0]), "at", "must be a point"),
]


@pytest.mark.parametrize("refusal", REFUSED)
def test_invalid_sections_and_objects_are_refused(refusal: Refusal) -> None:
    assert_refused(*refusal)
