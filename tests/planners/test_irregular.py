"""Morphs between irregular polygons: fair ends without roll, and wild ones with rolled legs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.planners.optimise.guesses import MIN_EDGE_SHARE, turning_edges, turns
from problems.random_morph import HEAVY, irregular_pairs, random_morph, wild_morph
from tests.helpers.second_opinions import is_proven

PAIRS = irregular_pairs()

EXAMPLE = {
    "n": 4,
    "cable_length": 2.6,
    "start": [[0.71, -0.18], [0.5, -0.63], [-0.71, -0.17], [-0.72, -0.02]],
    "goal": [[0.97, -0.02], [-0.71, -0.59], [-0.87, -0.38], [-0.86, 0.4]],
    "altitude": 1.5,
}
"""A pair that needs legs that roll between its ends."""

MAX_EXAMPLE = 3.31  # [s] Largest duration of the example's plan; its slowest vertex alone takes 2.4


def planned(pair: dict[str, Any]) -> ho.Plan:
    """Return the plan of a pair from a hitch with spread legs."""
    team = ho.Team(pair["n"], pair["cable_length"])
    start = ho.Hitch.spread(team, pair["start"], pair["altitude"])
    return ho.morph(start, pair["goal"])


@pytest.mark.parametrize("index", [33, 34])
def test_distances_between_rolled_hitches_are_those_in_space(index: int) -> None:
    """Cables pass each other above and below, which touch in plan view."""
    plan = planned(PAIRS[index])
    assert plan.certificate.certified
    assert "optimised route" in plan.phases[0].remark


def test_legs_roll_between_where_no_level_route_was_found(tmp_path: Path) -> None:
    plan = planned(EXAMPLE)
    assert "roll" in plan.phases[0].remark
    assert plan.duration <= MAX_EXAMPLE
    assert is_proven(plan, tmp_path)


def test_a_morph_passes_a_pole_in_its_way() -> None:
    """Neither a straight route nor one of other shapes passes it; the hitch makes a detour."""
    triangle = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])
    section = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]
    pole = {"outline": section, "to": 4.0, "at": [2.5, 0.0, 0.0], "fixed": True}
    problem = {
        "team": {"robots": 3, "cable_length": 2.4},
        "objects": {"pole": pole},
        "start": {"hitch": {"polygon": triangle.tolist(), "altitude": 1.5}},
        "mission": [{"morph": {"polygon": (triangle + [5.0, 0.0]).tolist()}}],
    }
    plan = ho.solve(ho.problem_from_dict(problem))
    assert "on a detour" in plan.phases[0].remark
    assert plan.certificate.certified


def test_a_chain_turns_by_half_a_turn() -> None:
    """Its straight path collapses; its edges turn evenly."""
    arc = np.array([[-1.0, 0.0], [-0.7, 0.8], [0.2, 1.1], [1.0, 0.7]])
    start = ho.Hitch.spread(ho.Team(3, 2.2, topology="open"), arc, 1.5)
    plan = ho.morph(start, -arc)
    assert "edges turned 180°" in plan.phases[0].remark
    assert plan.certificate.certified


@pytest.mark.parametrize("index", [48, 55])
def test_a_straight_route_far_from_its_bound_is_replaced(index: int) -> None:
    """Its drones move 2.5 times as long as its vertices, or edges that turn are shorter midway."""
    plan = planned(PAIRS[index])
    assert "faster than the step's own route" in plan.phases[0].remark


def test_straight_routes_between_nearly_regular_polygons_are_kept() -> None:
    for n in (3, 4, 7):
        plan = ho.solve(ho.problem_from_dict(random_morph(n, 0)))
        assert not plan.phases[0].remark


@pytest.mark.slow
def test_a_refusal_names_limit_and_place_of_the_best_route_tried() -> None:
    """Thrust suffices at the ends, whose legs are level, but not for legs that roll between."""
    weak = ho.Quadrotor(0.132, 1.42)
    team = ho.Team(PAIRS[13]["n"], PAIRS[13]["cable_length"], quadrotor=weak)
    start = ho.Hitch.spread(team, PAIRS[13]["start"], 1.5)
    with pytest.raises(ho.InfeasibleError, match=r"thrust: .* N at q\d at .*\d%") as caught:
        ho.morph(start, PAIRS[13]["goal"])
    assert "along the best route tried (edges turned" in caught.value.violations[0].when
    assert "the step's own route: convexity" in caught.value.note


@pytest.mark.parametrize(
    ("robots", "seed", "longest"), [(6, 4, 7.9), pytest.param(8, 7, 4.9, marks=pytest.mark.slow)]
)
def test_a_faster_path_that_the_certificate_rejects_leaves_the_one_before(
    robots: int, seed: int, longest: float
) -> None:
    """Its drones come closer than allowed between samples, by a thousandth at most."""
    assert planned(pair_of(wild_morph(robots, seed))).duration < longest


BLUNT = {
    "start": [[-0.83, -0.223], [-0.341, 0.04], [-0.214, 0.085], [0.052, 0.151], [1.332, -0.053]],
    "goal": [[0.423, -1.272], [0.104, -1.221], [-1.043, 1.199], [-0.494, 1.53], [1.0, -0.515]],
}
"""A pair whose edges, turned evenly with the nearest lengths that close, would vanish midway."""


def test_edges_that_turn_evenly_keep_a_share_of_their_lengths() -> None:
    first, last = (ho.ConvexPolygon(BLUNT[key]) for key in ("start", "goal"))
    (turn,) = turns(first, last)
    found = turning_edges(first, last, turn, np.linspace(0.0, 1.0, 9))
    assert found is not None
    np.testing.assert_allclose(found[0], first.vertices, atol=1e-9)
    np.testing.assert_allclose(found[-1], last.vertices, atol=1e-9)
    shortest = MIN_EDGE_SHARE * np.minimum(first.edge_lengths, last.edge_lengths)
    for corners in found:
        outline = ho.ConvexPolygon(corners)  # convex, clockwise
        assert np.all(outline.edge_lengths >= shortest - 1e-6)


@pytest.mark.slow
def test_blunt_pairs_with_friction_are_planned() -> None:
    problem = {
        "team": {"robots": 5, "cable_length": 4.09, "cable_friction": 0.1},
        "start": {"hitch": {"polygon": BLUNT["start"], "altitude": 1.5, "legs": "spread"}},
        "mission": [{"morph": {"polygon": BLUNT["goal"]}}],
    }
    assert ho.solve(ho.problem_from_dict(problem)).certificate.certified


@pytest.mark.slow
@pytest.mark.parametrize("index", [6, 17])
def test_heavy_cables_of_many_robots_are_planned(index: int, tmp_path: Path) -> None:
    """Their refinements need clasps in balance to much less than the certificate's bound."""
    pair = PAIRS[index]
    density, tension = HEAVY["cable_density"], HEAVY["tension"]
    team = ho.Team(pair["n"], pair["cable_length"], cable_density=density, tension=tension)
    start = ho.Hitch.spread(team, pair["start"], pair["altitude"])
    plan = ho.morph(start, pair["goal"])
    assert plan.certificate.certified
    assert is_proven(plan, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(PAIRS)))
def test_all_pairs_are_planned_certified_and_proven(index: int, tmp_path: Path) -> None:
    plan = planned(PAIRS[index])
    assert plan.certificate.certified
    assert is_proven(plan, tmp_path)


def changed(pair: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    """Return a pair whose outlines (n, 2) are changed by a function."""
    outlines = {key: change(np.array(pair[key])).tolist() for key in ("start", "goal")}
    return {**pair, **outlines}


def rotation(angle: float) -> Any:
    """Return the matrix by which rows (n, 2) turn counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s], [-s, c]])


CHANGES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "translated": lambda pair: changed(pair, lambda points: points + [3.0, -7.0]),
    "rotated": lambda pair: changed(pair, lambda points: points @ rotation(2.0)),
    "mirrored": lambda pair: changed(pair, lambda points: points[::-1] * [-1.0, 1.0]),
    "renumbered": lambda pair: changed(pair, lambda points: np.roll(points, 1, axis=0)),
    "reversed": lambda pair: {**pair, "start": pair["goal"], "goal": pair["start"]},
}


def pair_of(problem: dict[str, Any]) -> dict[str, Any]:
    """Return the pair of a problem's start and goal."""
    team, hitch = problem["team"], problem["start"]["hitch"]
    goal = problem["mission"][0]["morph"]["polygon"]
    sizes = {"n": team["robots"], "cable_length": team["cable_length"]}
    return {**sizes, "start": hitch["polygon"], "goal": goal, "altitude": hitch["altitude"]}


@pytest.mark.parametrize("change", CHANGES)
def test_wild_pairs_are_planned_however_they_are_placed_and_numbered(change: str) -> None:
    robots, seed = 3 + list(CHANGES).index(change) % 3, 100
    assert planned(CHANGES[change](pair_of(wild_morph(robots, seed)))).certificate.certified


@pytest.mark.parametrize(
    ("robots", "angle"),
    [
        (3, 0.4),
        (4, 1.3),
        pytest.param(5, 3.7, marks=pytest.mark.slow),
        pytest.param(6, 5.5, marks=pytest.mark.slow),
    ],
)
def test_wild_pairs_are_planned_at_any_heading(robots: int, angle: float) -> None:
    pair = pair_of(wild_morph(robots, 103))
    for each in (pair, changed(pair, lambda points: points @ rotation(angle))):
        assert planned(each).certificate.certified


def test_heavy_cables_that_cannot_be_held_on_a_guess_spoil_no_search() -> None:
    """On one of its guesses the clasps have no balance; others lead to a plan."""
    problem = wild_morph(3, 9, heavy=True)
    assert ho.solve(ho.problem_from_dict(problem)).certificate.certified


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("robots", [3, 4, 5, 6, 7, 8])
def test_laws_of_wild_pairs(change: str, robots: int) -> None:
    """A pair and its changed copy are both planned, or neither."""
    pair = pair_of(wild_morph(robots, 101))
    for each in (pair, CHANGES[change](pair)):
        assert planned(each).certificate.certified


@pytest.mark.slow
@pytest.mark.parametrize("robots", [4, 6])
@pytest.mark.parametrize("kind", ["given legs", "cables", "tensions", "loads", "friction"])
def test_wild_pairs_of_other_teams_are_planned(kind: str, robots: int) -> None:
    problem = wild_morph(robots, 102)
    team, morph = problem["team"], problem["mission"][0]["morph"]
    steps = np.arange(robots)
    if kind == "given legs":
        morph["legs"] = "spread"
    elif kind == "cables":
        team["cable_length"] = (team["cable_length"] + 0.05 * steps).tolist()
    elif kind == "tensions":
        team["tension"] = (0.4 + 0.01 * steps).tolist()
    elif kind == "loads":
        team["load"] = 0.002
    else:
        team["cable_friction"] = 0.1
    assert ho.solve(ho.problem_from_dict(problem)).certificate.certified
