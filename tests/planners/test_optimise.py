"""The optimiser: its guesses, the routes that it must find, and what its programs keep."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.morph.path import ShapePath
from hitchopt.planners.optimise.knots import (
    KnotPath,
    Search,
    SolverStep,
)
from hitchopt.planners.optimise.program import (
    MorphProgram,
    build_program,
    iterates,
    solve_program,
)
from hitchopt.planners.optimise.search import Candidate, OptimisedMorph, guesses
from hitchopt.planners.timing.flight import Flight, fly
from problems.random_morph import random_convex_polygon

FREE = Requirements(ho.Limits(), ho.Separation(), None)
SQUARE = regular_polygon(4, 1.2, np.pi / 4)
PENTAGON = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])
OCTAGON = regular_polygon(8, 1.3)


def ends(
    team: Team, first: ConvexPolygon, last: ConvexPolygon, requirements: Requirements = FREE
) -> tuple[Hitch, Hitch]:
    start = Hitch.spread(
        team, first, limits=requirements.limits, separation=requirements.separation
    )
    end = Hitch.nearest(
        team,
        last,
        1.0,
        start.fractions,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
    )
    return start, end


def certified(
    flight: Flight,
    team: Team,
    requirements: Requirements,
    tension: tuple[float, float] | None = None,
) -> ho.Certificate:
    motion = Motion(
        team,
        Requirements(requirements.limits, requirements.separation, requirements.arena),
        flight.drones,
        flight.vertices,
        flight.legs,
        flight.tensions,
        (Phase("morph", 0, 0.0, flight.duration, tension=tension),),
    )
    return ho.certify(motion)


@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
@settings(max_examples=25)
def test_guesses_join_the_ends_and_turning_the_edges_keeps_polygons_convex(
    seed: int, n: int
) -> None:
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


NARROW = Requirements(ho.Limits(), ho.Separation(), ho.Arena([-1.55, -1.55, 0], [1.55, 1.55, 3]))
FOUR = Team(4, 2.4)
THRUST_BOUND = Team(4, 2.4, tension=0.8, quadrotor=ho.Quadrotor(0.132, 1.6))
MUST_PLAN = {
    "square, quarter turn": (FOUR, SQUARE, SQUARE.renumbered(1), FREE),
    "square, half turn": (FOUR, SQUARE, SQUARE.renumbered(2), FREE),
    "octagon turned by 45 degrees": (Team(8, 2.0), OCTAGON, OCTAGON.rotated(np.pi / 4), FREE),
    "asymmetric pentagon": (Team(5, 2.6), PENTAGON, PENTAGON.renumbered(2), FREE),
    "thrust-bound": (THRUST_BOUND, SQUARE, SQUARE.rotated(0.9).translated([0.5, 0.2]), FREE),
    "narrow arena": (FOUR, SQUARE, SQUARE.renumbered(1), NARROW),
}


def found_flights(
    start: Hitch, end: Hitch, requirements: Requirements, tension: tuple[float, float] | None = None
) -> list[Candidate]:
    def judge(path: ShapePath) -> Flight | None:
        flight = fly(path, requirements.limits)
        return flight if certified(flight, start.team, requirements, tension).certified else None

    return OptimisedMorph(start, end, requirements, judge, tension).solve()


def best(
    start: Hitch, end: Hitch, requirements: Requirements, tension: tuple[float, float] | None = None
) -> Flight:
    found = found_flights(start, end, requirements, tension)
    assert found
    durations = [candidate.flight.duration for candidate in found]
    assert durations == sorted(durations)
    return found[0].flight


def test_what_the_judge_turns_down_is_refined_and_never_returned() -> None:
    start, end = ends(FOUR, SQUARE, SQUARE.renumbered(1))
    seen: list[int] = []
    passed: list[Flight] = []

    def strict(path: ShapePath) -> Flight | None:
        seen.append(path.vertices.pieces)
        if len(set(seen)) > 1:
            passed.append(fly(path, FREE.limits))
        return passed[-1] if passed else None

    found = OptimisedMorph(start, end, FREE, strict).solve()
    assert [candidate.flight for candidate in found] == sorted(passed, key=lambda f: f.duration)
    assert found
    assert max(seen) > seen[0]
    assert OptimisedMorph(start, end, FREE, lambda _: None).solve() == []


@pytest.mark.parametrize("name", MUST_PLAN)
def test_hard_morphs_are_found_and_certified(name: str) -> None:
    team, first, last, requirements = MUST_PLAN[name]
    start, end = ends(team, first, last, requirements)
    flight = best(start, end, requirements)
    np.testing.assert_allclose(flight.drones.at(0.0), start.drones, atol=1e-9)
    np.testing.assert_allclose(flight.drones.at(flight.duration), end.drones, atol=1e-9)


def test_renumbering_gives_the_same_duration() -> None:
    start, end = ends(Team(5, 2.6), PENTAGON, PENTAGON.renumbered(2))
    other = ends(Team(5, 2.6), PENTAGON.renumbered(3), PENTAGON.renumbered(5))
    durations = [best(a, b, FREE).duration for a, b in ((start, end), other)]
    assert durations[1] == pytest.approx(durations[0], rel=0.01)


@pytest.mark.slow
def test_programs_with_rows_between_many_knots_find_a_half_turn_of_a_heptagon() -> None:
    first = [(0.518, -1.298), (-0.798, -1.154), (-1.414, -0.166), (-0.95, 1.037)]
    first += [(0.361, 1.348), (1.374, 0.364), (1.379, -0.346)]
    last = [(-0.35, 1.105), (0.594, 0.942), (0.992, 0.137), (0.755, -0.751)]
    last += [(-0.058, -1.156), (-0.801, -0.713), (-0.988, 0.284)]
    start, end = (ConvexPolygon(np.array(each)) for each in (first, last))
    team = Team(7, 2.4, tension=0.8)
    hitch = Hitch.spread(team, start.rotated(1.0), altitude=1.8)
    assert ho.morph(hitch, end.rotated(1.0)).certificate.certified


def test_free_tensions_are_eased_on_the_way_and_restored() -> None:
    team, first, last, requirements = MUST_PLAN["thrust-bound"]
    start, end = ends(team, first, last)
    fixed = best(start, end, requirements)
    eased = best(start, end, requirements, (0.3, 0.8))
    t = np.linspace(0.0, eased.duration, 201)
    tensions = eased.tensions.at(t)
    np.testing.assert_allclose(tensions[[0, -1]], 0.8, atol=1e-9)
    assert np.min(tensions) < 0.6
    assert eased.duration < fixed.duration


@pytest.mark.parametrize("tension", [(0.25, 0.7), (0.3, 0.4)])
def test_tensions_stay_within_their_range_at_all_times(tension: tuple[float, float]) -> None:
    team = Team(4, 2.4, tension=0.4, quadrotor=ho.Quadrotor(max_thrust=1.6))
    start, end = ends(team, SQUARE, SQUARE.renumbered(1))
    for candidate in found_flights(start, end, FREE, tension):
        flight = candidate.flight
        found = flight.tensions.at(np.linspace(0.0, flight.duration, 20001))
        assert np.min(found) >= tension[0]
        assert np.max(found) <= tension[1] + 1e-9


def search(
    tension: tuple[float, float] | None,
    margin: float,
    end_margins: tuple[float, float],
    requirements: Requirements | None = None,
) -> Search:
    return Search(requirements or Requirements(), lambda _: None, tension, end_margins, margin)


def program_of(
    n: int, step: SolverStep, tension: tuple[float, float] | None, shift: float = 0.0
) -> MorphProgram:
    rng = np.random.default_rng(n)
    first = random_convex_polygon(n, 1.1, rng)
    pulls = 0.4 if tension else rng.uniform(0.38, 0.42, n)
    last = first.rotated(1.0).translated([0.4, 0.1 + shift])
    start, end = ends(Team(n, 2.2, tension=pulls), first, last)
    polygons = list(guesses(first, last, 6).values())[1]
    bounds = search(tension, 1.02, (1.5, 1.5))
    return build_program(KnotPath.through("turned", start, end, polygons), bounds, step)


def test_a_solved_program_keeps_its_rows_and_lowers_its_cost() -> None:
    around = program_of(4, SolverStep(0.17), None)
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
    start, end = ends(Team(5, 2.6), PENTAGON, last)
    polygons = list(guesses(PENTAGON, last, 9).values())[1]
    first, limit = KnotPath.through("turned", start, end, polygons), 2.0 * FREE.separation.radius
    for parts, kept in ((1, False), (8, True)):
        *_, path = iterates(first, search(None, 1.03, (1.5, 1.5)), SolverStep(0.17, parts), 12)
        assert smallest_distance(path, 1) > limit
        assert (smallest_distance(path, 8) > limit) == kept
