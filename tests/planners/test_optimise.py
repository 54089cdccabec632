"""The optimiser: its guesses, the routes that it must find, and what its programs keep."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import planned

import hitchopt as ho
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.path import ShapePath
from hitchopt.planners.optimise.knots import KnotPath, Search, SolverStep
from hitchopt.planners.optimise.program import build_program, iterates, solve_program
from hitchopt.planners.optimise.search import Candidate, OptimisedMorph, guesses
from hitchopt.planners.timing.flight import Flight, fly
from problems.random_morph import random_convex_polygon

FREE, FOUR = Requirements(), Team(4, 2.4)
SQUARE = regular_polygon(4, 1.2, np.pi / 4)
PENTAGON = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])


def ends(team: Team, first: ConvexPolygon, last: ConvexPolygon) -> tuple[Hitch, Hitch]:
    kept: dict[str, Any] = {"limits": FREE.limits, "separation": FREE.separation}
    start = Hitch.spread(team, first)
    return start, Hitch.nearest(team, last, 1.0, start.fractions, **kept)


@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
@settings(max_examples=25)
def test_guesses_join_the_ends_and_those_by_edges_stay_convex(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    first = random_convex_polygon(n, 1.2, rng)
    last = random_convex_polygon(n, 1.2, rng).translated(rng.normal(size=2))
    found = guesses(first, last, 13)
    assert next(iter(found)) == "straight"
    kinds = {name.split(" ")[0] for name in found}
    assert {"straight", "turned"} <= kinds <= {"straight", "turned", "edges"}
    for name, polygons in found.items():
        np.testing.assert_allclose(polygons[0], first.vertices, atol=1e-6)
        np.testing.assert_allclose(polygons[-1], last.vertices, atol=1e-6)
        if name.startswith("edges"):
            for polygon in polygons:
                ConvexPolygon(polygon)  # refuses what is not convex


WEAK = Team(4, 2.4, tension=0.8, quadrotor=ho.Quadrotor(0.132, 1.6))


@pytest.mark.parametrize(
    "name", ["narrow_arena", "octagon_turned", "pentagon_turned", "square_half_turn"]
)
def test_hard_morphs_are_found_and_certified(name: str) -> None:
    plan = planned(name)
    assert "on an optimised route" in plan.phases[0].remark
    assert plan.certificate.certified


def test_renumbering_gives_the_same_duration() -> None:
    seconds = [
        ho.morph(Hitch.spread(Team(5, 2.6), first), first.renumbered(2), optimize=True).duration
        for first in (PENTAGON, PENTAGON.renumbered(3))
    ]
    assert seconds[1] == pytest.approx(seconds[0], rel=0.01)


def found(start: Hitch, end: Hitch, tension: tuple[float, float] | None = None) -> list[Candidate]:
    """What the optimiser finds where every flight will do, the fastest first."""
    given = OptimisedMorph(start, end, FREE, lambda path: fly(path, FREE.limits), tension).solve()
    durations = [candidate.flight.duration for candidate in given]
    assert durations == sorted(durations) != []
    return given


def test_what_the_judge_turns_down_is_refined_and_never_returned() -> None:
    start, end = ends(FOUR, SQUARE, SQUARE.renumbered(1))
    seen: list[int] = []
    passed: list[Flight] = []

    def strict(path: ShapePath) -> Flight | None:
        seen.append(path.vertices.pieces)
        if len(set(seen)) > 1:
            passed.append(fly(path, FREE.limits))
        return passed[-1] if passed else None

    given = OptimisedMorph(start, end, FREE, strict).solve()
    assert [candidate.flight for candidate in given] == sorted(passed, key=lambda f: f.duration)
    assert max(seen) > seen[0]
    assert OptimisedMorph(start, end, FREE, lambda _: None).solve() == []


def test_free_tensions_are_eased_on_the_way_and_restored() -> None:
    start, end = ends(WEAK, SQUARE, SQUARE.rotated(0.9).translated([0.5, 0.2]))
    fixed, eased = (found(start, end, tension)[0].flight for tension in (None, (0.3, 0.8)))
    tensions = eased.tensions.at(np.linspace(0.0, eased.duration, 201))
    np.testing.assert_allclose(tensions[[0, -1]], 0.8, atol=1e-9)
    assert np.min(tensions) < 0.6
    assert eased.duration < fixed.duration


@pytest.mark.parametrize("tension", [(0.25, 0.7), (0.3, 0.4)])
def test_tensions_stay_within_their_range_at_all_times(tension: tuple[float, float]) -> None:
    team = Team(4, 2.4, tension=0.4, quadrotor=ho.Quadrotor(max_thrust=1.6))
    for candidate in found(*ends(team, SQUARE, SQUARE.renumbered(1)), tension):
        flight = candidate.flight
        pulls = flight.tensions.at(np.linspace(0.0, flight.duration, 20001))
        assert tension[0] <= np.min(pulls) <= np.max(pulls) <= tension[1] + 1e-9


def test_a_solved_program_keeps_its_rows_and_lowers_its_cost() -> None:
    rng = np.random.default_rng(4)
    first = random_convex_polygon(4, 1.1, rng)
    last = first.rotated(1.0).translated([0.4, 0.1])
    start, end = ends(Team(4, 2.2, tension=rng.uniform(0.38, 0.42, 4)), first, last)
    bounds = Search(FREE, lambda _: None, None, (1.5, 1.5), 1.02)
    through = KnotPath.through("turned", start, end, list(guesses(first, last, 6).values())[1])
    around = build_program(through, bounds, SolverStep(0.17))
    way = solve_program(around)
    assert way is not None
    x, f, g = around.expressions.values()
    value = ca.Function("value", [x], [f, g])
    cost, rows = value(way.table[1:-1].ravel())
    assert np.all(np.asarray(rows).ravel() >= around.numbers["lbg"] - 1e-4)
    assert np.all(np.asarray(rows).ravel() <= around.numbers["ubg"] + 1e-4)
    assert float(cost) <= float(value(around.numbers["x0"])[0]) + 1e-6


def smallest_distance(path: KnotPath, parts: int) -> float:
    """Smallest distance of two drones at ends of all parts of steps [m]."""
    drones = path.at(np.linspace(0.0, 1.0, parts * path.steps + 1)).table[:, path.columns.drones]
    first, second = np.triu_indices(drones.shape[1], 1)
    return float(np.min(np.linalg.norm(drones[:, first] - drones[:, second], axis=-1)))


def test_parts_of_steps_keep_drones_apart_between_the_knots() -> None:
    last = PENTAGON.renumbered(2)
    polygons = list(guesses(PENTAGON, last, 9).values())[1]
    first = KnotPath.through("turned", *ends(Team(5, 2.6), PENTAGON, last), polygons)
    bounds, limit = Search(FREE, lambda _: None, None, (1.5, 1.5), 1.03), 0.24
    for parts, kept in ((1, False), (8, True)):
        *_, path = iterates(first, bounds, SolverStep(0.17, parts), 12)
        assert smallest_distance(path, 1) > limit
        assert (smallest_distance(path, 8) > limit) == kept
