"""Hitches on circles, which are tied where the goal cannot be tied directly: laws and problems."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.forming.circles import (
    MAX_ARC,
    PHASES,
    SIZES,
    CircularHitches,
    circular_polygon,
)
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.path import Path as HitchPath
from hitchopt.planners.rests import rest_plan
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array
from tests.helpers.plans import PROBLEMS, planned
from tests.helpers.second_opinions import is_proven

WILD = sorted((Path(__file__).parent / "wild").glob("form_*.yaml"))

TRIANGLE = np.array([[0.0, 0.6], [0.5, -0.3], [-0.5, -0.3]]) + [3.0, -2.0]

EDGES = st.lists(st.floats(0.3, 4.0), min_size=3, max_size=12).map(np.array)


@given(edges=EDGES)
@settings(max_examples=100, deadline=None)
def test_vertices_lie_on_a_circle_and_no_edge_is_longer_than_requested(edges: Array) -> None:
    polygon = circular_polygon(edges)
    radii = np.linalg.norm(polygon.vertices, axis=1)
    np.testing.assert_allclose(radii, radii[0], rtol=1e-9)
    assert np.all(polygon.edge_lengths <= edges * (1.0 + 1e-9))
    shortened = polygon.edge_lengths < edges * (1.0 - 1e-6)
    arcs = 2.0 * np.arcsin(0.5 * polygon.edge_lengths / radii)
    assert np.max(arcs) <= MAX_ARC * (1.0 + 1e-6)
    if np.any(shortened):  # all of them alike, and no more than needed
        assert np.ptp(polygon.edge_lengths[shortened]) < 1e-6
        assert np.max(arcs) == pytest.approx(MAX_ARC, abs=1e-5)


@given(edges=EDGES, shift=st.integers(1, 11))
@settings(max_examples=50, deadline=None)
def test_renumbering_edges_turns_the_polygon(edges: Array, shift: int) -> None:
    one, other = circular_polygon(edges), circular_polygon(np.roll(edges, -shift))
    np.testing.assert_allclose(other.edge_lengths, np.roll(one.edge_lengths, -shift), rtol=1e-9)
    angles = np.roll(one.exterior_angles, -shift)
    np.testing.assert_allclose(other.exterior_angles, angles, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@given(edges=EDGES)
@settings(max_examples=20, deadline=None)
def test_hitches_rest_on_circles_near_a_goal(edges: Array) -> None:
    """Those that are yielded are certified at rest, without roll, wherever they are turned."""
    team = Team(len(edges), edges + 0.6, cable_density=0.005)
    goal = Hitch.balanced(team, circular_polygon(0.9 * edges).translated([3.0, -2.0]), 1.7)
    requirements = Requirements()
    circles = CircularHitches(goal, requirements)
    for shape in islice(circles.shapes(SIZES), 2):
        placed = list(circles.placed(shape))
        assert len(placed) == len(PHASES)
        for hitch in placed:
            assert not np.any(hitch.roll)
            assert rest_plan(hitch, requirements).certificate.certified
            offset = hitch.vertices.mean(axis=0) - goal.vertices.mean(axis=0)
            assert np.linalg.norm(offset) < np.max(np.linalg.norm(shape.polygon.vertices, axis=1))


def test_the_first_place_is_the_nearest_turn() -> None:
    """A goal on a circle itself is met."""
    polygon = circular_polygon(np.array([1.0, 1.3, 0.9, 1.2])).rotated(2.0).translated([3.0, -2.0])
    team = Team(4, polygon.edge_lengths + 0.9)
    circles = CircularHitches(Hitch.balanced(team, polygon, 1.7), Requirements())
    shape = Hitch.balanced(team, circular_polygon(polygon.edge_lengths), 1.7)
    nearest = next(circles.placed(shape))
    np.testing.assert_allclose(nearest.polygon.vertices, polygon.vertices, atol=1e-9)


def test_a_path_climbs_evenly() -> None:
    """Bernstein coefficients of a climb, against values at samples."""
    start, end = (Hitch.balanced(Team(3, 2.4), size * TRIANGLE, 1.0) for size in (1.0, 1.2))
    s = np.linspace(0.0, 1.0, 11)
    level = HitchPath.straight(start, end)
    halves = replace(
        level, vertices=on_breaks(level.vertices.elevated(5), np.array([0.0, 0.3, 1.0]))
    )
    change = halves.climbing(0.7).vertices.at(s) - level.vertices.at(s)
    np.testing.assert_allclose(change[..., 2], np.tile(0.7 * s[:, None], 3), atol=1e-12)
    np.testing.assert_allclose(change[..., :2], 0.0, atol=1e-12)


def test_an_irregular_hitch_is_tied_and_untied_from_a_circle(tmp_path: Path) -> None:
    plan = planned("form_irregular")
    names = [phase.name for phase in plan.phases]
    assert names[-6:] == ["morph", "relax", "loosen", "unswap 1", "unswap 2", "land"]
    assert names.count("morph") == 2
    tied = next(phase for phase in plan.phases if phase.name == "morph")
    goal = plan.at(tied.end)
    polygon = ho.load_problem(PROBLEMS / "form_irregular.yaml").mission[0].polygon
    np.testing.assert_allclose(goal.vertices[:, :2], polygon.vertices, atol=1e-6)
    np.testing.assert_allclose(goal.vertices[:, 2], 1.71, atol=1e-6)
    assert is_proven(plan, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("path", WILD, ids=lambda path: path.stem)
def test_wild_hitches_are_tied(path: Path, tmp_path: Path) -> None:
    plan = ho.solve(path)
    assert plan.certificate.certified
    assert is_proven(plan, tmp_path)
