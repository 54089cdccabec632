"""Morphs: leg laws, blocked paths, and the optimiser's guesses, paths and programs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import pdist

import hitchopt as ho
from hitchopt.checks.registry import RULE_OF
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.quadratic_program import solve_qp
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Effort, error_of
from hitchopt.planners.morph.legs import leg_task_along, with_legs_clear
from hitchopt.planners.morph.morph import (
    CHECKED_AT_SAMPLES,
    DISTANCE_TOLERANCE,
    check_distances,
    moves,
    straight_path,
)
from hitchopt.planners.optimise import program
from hitchopt.planners.optimise.guesses import polygon_guesses
from hitchopt.planners.optimise.knots import KnotPath, SearchLimits, SolverStep
from hitchopt.planners.optimise.program import build_program, iterates
from hitchopt.planners.optimise.search import OptimisedMorph
from hitchopt.planners.optimise.times import acceleration_rows, speed_rows, step_times
from hitchopt.planners.path import Path, shapes_along
from hitchopt.planners.timing.timed_motion import motion_along
from hitchopt.values import Array
from problems.random_morph import irregular_pairs

FREE = Requirements()
SQUARE = regular_polygon(4, 1.2, np.pi / 4)
PENTAGON = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])


def ends(team: Team, first: ConvexPolygon, last: ConvexPolygon) -> tuple[Hitch, Hitch]:
    kept: dict[str, Any] = {"limits": FREE.limits, "separation": FREE.separation}
    start = Hitch.spread(team, first)
    return start, Hitch.nearest(team, last, 1.0, start.fractions, **kept)


WEAK = Team(4, 2.4, tension=0.8, quadrotor=ho.Quadrotor(0.132, 1.6))


@pytest.mark.slow
def test_renumbering_gives_the_same_duration() -> None:
    seconds = [
        ho.morph(Hitch.spread(Team(5, 2.6), first), first.renumbered(2), optimize=True).duration
        for first in (PENTAGON, PENTAGON.renumbered(3))
    ]
    assert seconds[1] == pytest.approx(seconds[0], rel=0.01)


def found(start: Hitch, end: Hitch, tension: tuple[float, float] | None = None) -> list[Motion]:
    """The optimiser's motions with a judge that accepts every flight, the fastest first."""
    given = OptimisedMorph(start, end, FREE, lambda path: motion_along(path, FREE), tension).solve()
    flights = [route.motion for route in given.accepted]
    durations = [flight.duration for flight in flights]
    assert durations == sorted(durations) != []
    return flights


@pytest.mark.parametrize("least", [0.3, pytest.param(0.7, marks=pytest.mark.slow)])
def test_variable_tensions_stay_within_their_range_and_return(least: float) -> None:
    start, end = ends(WEAK, SQUARE, SQUARE.rotated(0.9).translated([0.5, 0.2]))
    eased = found(start, end, (least, 0.8))
    for flight in eased:
        tensions = flight.tensions.at(np.linspace(0.0, flight.duration, 20001))
        np.testing.assert_allclose(tensions[[0, -1]], 0.8, atol=1e-9)
        assert least <= np.min(tensions) < least + 0.3
        assert np.max(tensions) <= 0.8 + 1e-9
    assert eased[0].duration < found(start, end)[0].duration


def test_parts_of_steps_keep_drones_apart_between_the_knots() -> None:
    last = PENTAGON.renumbered(2)
    tried = polygon_guesses(PENTAGON, last, 9)
    polygons = next(tried[name] for name in tried if name.startswith("turned"))
    first = KnotPath.through("turned", *ends(Team(5, 2.6), PENTAGON, last), polygons)
    bounds = SearchLimits(FREE, lambda _: None, None, (1.5, 1.5), 1.03)

    def apart(path: KnotPath, parts: int) -> bool:
        """Whether drones are at the ends of all parts of steps."""
        table = path.at(np.linspace(0.0, 1.0, parts * path.steps + 1)).table
        return min(float(np.min(pdist(x))) for x in table[:, path.columns.drones]) > 0.24

    for parts, kept in ((1, False), (8, True)):
        *_, path = iterates(first, bounds, SolverStep(0.17, parts), 12)
        assert apart(path, 1)
        assert apart(path, 8) is kept


def tangent_errors(path: KnotPath, search: SearchLimits) -> float:
    """Return the largest error of a program's tangent against central differences of tables."""
    task = program.build_program(path, search, SolverStep(0.1))
    columns, step, table = path.columns, 1e-6, path.table
    free = [columns.vertices.ravel(), columns.q_legs]
    free += [] if search.tension is None else [columns.tensions]
    every, size = np.concatenate(free), task.tangent.shape[1]
    direction = np.random.default_rng(3).uniform(-1.0, 1.0, size)

    def moved(sign: float) -> Array:
        changed = table.copy()
        changed[1:-1, every] += sign * step * direction.reshape(path.steps - 1, -1)
        return path.with_table(changed).table[1:-1].ravel()

    slopes = (moved(1.0) - moved(-1.0)) / (2.0 * step)
    return float(np.max(np.abs(task.tangent @ direction - slopes)))


@pytest.mark.parametrize("kind", ["equal", "unequal", "loaded", "sagging", "rolled"])
def test_drones_and_legs_follow_the_programs_tangent(kind: str) -> None:
    team = {
        "equal": Team(5, 2.6),
        "unequal": Team(5, [2.6, 2.5, 2.7, 2.6, 2.8], tension=[0.6, 0.5, 0.55, 0.62, 0.58]),
        "loaded": Team(5, 2.6, load=0.01),
        "sagging": Team(5, 2.6, cable_density=0.002),
        "rolled": Team(5, 2.6),
    }[kind]
    start, end = (Hitch.spread(team, polygon) for polygon in (PENTAGON, PENTAGON.rotated(0.2)))
    polygons = np.linspace(PENTAGON.vertices, PENTAGON.rotated(0.2).vertices, 5)
    path = KnotPath.through("", start, end, polygons)
    if kind == "rolled":
        path = replace(path, roll=np.full((5, 5), 0.3))
    tension = None if kind == "equal" else (0.4, 0.7)
    search = SearchLimits(FREE, lambda _: None, tension, (1.5, 1.5))
    assert tangent_errors(path, search) < 1e-6


def test_rows_of_corners_are_derivatives() -> None:
    """Without near pairs they precede those of speeds and accelerations; corners are convex."""
    start, end = (Hitch.spread(Team(5, 2.6), p) for p in (PENTAGON, PENTAGON.rotated(0.2)))
    polygons = np.linspace(PENTAGON.vertices, PENTAGON.rotated(0.2).vertices, 7)
    path = KnotPath.through("", start, end, polygons)
    near = ho.Separation(radius=0.01, cable=0.01, crossing=0.01)
    bounds = SearchLimits(replace(FREE, separation=near), lambda _: None, None, (1.0, 1.0))
    task = program.build_program(path, bounds, SolverStep(0.01, fastest=True))
    times = step_times(path, FREE.limits)
    timed = [rows(path, FREE.limits, times) for rows in (speed_rows, acceleration_rows)]
    count = sum(len(rows.spare) for rows in timed)

    def sines_of(table: Array) -> Array:
        """Return sines of exterior angles."""
        vertices = table[1:-1, path.columns.vertices]
        edges = np.roll(vertices, -1, axis=1) - vertices
        edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
        before = np.roll(edges, 1, axis=1)
        sines = before[..., 1] * edges[..., 0] - before[..., 0] * edges[..., 1]
        return np.asarray(sines.ravel())

    changes = task.tangent.shape[1]
    direction = np.random.default_rng(4).uniform(-1.0, 1.0, changes)
    given = np.append(direction, np.zeros(task.program.A.shape[1] - changes))
    change = np.zeros_like(path.table)
    change[1:-1] = np.asarray(task.tangent @ direction).reshape(path.steps - 1, -1)
    here, after, before = (sines_of(path.table + h * change) for h in (0.0, 1e-6, -1e-6))
    found = np.asarray(task.program.A @ given)
    corners = slice(-count - len(here), -count)
    assert found[corners] == pytest.approx((after - before) / 2e-6, abs=1e-7)
    spare = np.concatenate([rows.spare for rows in timed])
    assert task.stride * task.program.upper[-count:] == pytest.approx(spare)
    lowest = task.stride * task.program.lower[corners] + here
    assert np.ptp(lowest) < 1e-12
    assert lowest[0] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robots", "edge", "bound"),
    [(10, 0.34, 4.7), (12, 1.3, 12.2)],
)
def test_half_turns_of_regular_polygons(robots: int, edge: float, bound: float) -> None:
    """Guesses are perturbed, without which the 12-gon takes 13 s, or tight ones not: the 10-gon."""
    polygon = regular_polygon(robots, edge)
    separation = ho.Separation(cable=min(0.1, 0.15 * np.sin(2.0 * np.pi / robots)))
    start = Hitch.spread(Team(robots, 2.0), polygon, separation=separation)
    plan = ho.morph(start, polygon.rotated(np.pi), separation=separation)
    assert plan.certificate.certified
    assert plan.duration < bound


def turned_pentagon(effort: Effort) -> tuple[KnotPath, SearchLimits]:
    """Return a guess that turns a pentagon, and the constraints of its search."""
    polygons = polygon_guesses(PENTAGON, PENTAGON.renumbered(2), 9)
    guess = next(polygons[name] for name in polygons if name.startswith("turned"))
    path = KnotPath.through("", *ends(Team(5, 2.6), PENTAGON, PENTAGON.renumbered(2)), guess)
    return path, SearchLimits(FREE, lambda _: None, None, (1.5, 1.5), 1.03, effort)


def test_steps_keep_rows_that_were_far_at_first() -> None:
    """The result is that of all rows at once, enforced in several programs."""
    path, bounds = turned_pentagon(Effort())
    for _ in range(3):
        build = build_program(path, bounds, SolverStep(0.17))
        whole, effort = build.program, Effort()
        moved, x = build.solve(effort), solve_qp(whole)
        assert moved is not None
        assert x is not None
        table = path.table.copy()
        changes = np.asarray(0.17 * (build.tangent @ x[: build.tangent.shape[1]]))
        table[1:-1] += changes.reshape(table[1:-1].shape)
        np.testing.assert_allclose(moved.table, path.with_table(table).table, atol=1e-5)
        path = moved
    assert effort.spent > program.ENTRY_COST * (whole.P.nnz + whole.A.nnz)  # of several programs


def test_optimised_plans_are_repeated_bit_by_bit() -> None:
    start = Hitch.spread(Team(4, 2.4), SQUARE)
    durations = list[float]()
    for _ in range(2):
        plan = ho.morph(start, SQUARE.rotated(0.9).translated([0.4, 0.0]), optimize=True)
        durations.append(plan.duration)
    assert durations[0] == durations[1]


TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]


def distances_on_the_way(path: Path) -> float:
    s = np.linspace(0.0, 1.0, 301)
    return leg_task_along(path, FREE, s, 1.0).reference_margin()


def test_leg_laws_keep_distances_that_linear_fractions_do_not() -> None:
    """From a slack split of the sharp triangle to its mirror image; equal splits are too close."""
    team = Team(3, 2.4)
    start = Hitch.spread(team, TRIANGLE)
    end = Hitch(team, TRIANGLE, 1.0, start.slack - start.q_legs)
    linear = Path.straight(start, end)
    assert distances_on_the_way(linear) < 1.0
    clear = with_legs_clear(linear, FREE)
    assert distances_on_the_way(clear) >= 1.0
    legs = shapes_along(clear, np.array([0.0, 1.0])).legs
    np.testing.assert_allclose(legs, [start.legs, end.legs], atol=1e-9)
    flight = motion_along(straight_path(start, end, FREE), FREE)
    np.testing.assert_allclose(flight.drones.at(flight.duration), end.drones, atol=1e-9)
    assert moves(start, end)
    assert not moves(start, start)  # nothing to do


def test_a_straight_path_that_loses_convexity_names_the_vertex() -> None:
    """PAPER.md's pair of quadrilaterals; half turns, which collapse to a point."""
    first = [[1.0, 1.0], [1.0, 2.0], [2.0, 0.0], [2.0, -1.0]]
    second = [[1.0, 0.0], [-1.0, 1.0], [1.0, 1.0], [2.0, 0.0]]
    square = np.array([[0.0, 0.0], [0.0, 1.3], [1.3, 1.3], [1.3, 0.0]])
    turned, arc = np.roll(square, 2, axis=0), Team(3, 2.2, topology="open")
    for team, one, other in (
        (Team(4, 6.0), first, second),
        (Team(4, 2.2), square, turned),
        (arc, square, turned),
    ):
        start, end = (Hitch.balanced(team, p) for p in (one, other))
        with pytest.raises(
            ho.InfeasibleError, match=r"convexity: .* at p\d .*of the path"
        ) as caught:
            straight_path(start, end, FREE)
        assert caught.value.violations[0].value == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("thrust", [1.35, 1.37])
def test_too_little_thrust_at_rest_is_refused_before_timing(thrust: float) -> None:
    needed = np.hypot(0.132 * 9.81, 0.4)  # 1.356 N
    team = Team(3, 2.4, quadrotor=ho.Quadrotor(0.132, thrust))
    start, end = (Hitch.spread(team, [[0.0, y], *TRIANGLE[1:]]) for y in (-1.0, -0.8))
    if thrust > needed:
        assert motion_along(straight_path(start, end, FREE), FREE).duration > 0.0
        return
    with pytest.raises(ho.InfeasibleError, match="thrust") as caught:
        straight_path(start, end, FREE)
    assert caught.value.violations[0].value == pytest.approx(needed, rel=1e-9)


def stretched(robots: int) -> tuple[Hitch, ConvexPolygon, ho.Separation]:
    """Return a regular polygon with long legs, whose drones are close, and a stretched goal."""
    polygon = regular_polygon(robots, 1.6 * np.sin(np.pi / robots))
    goal = ConvexPolygon(polygon.vertices * [1.15, 0.9] + [0.2, 0.1])
    separation = ho.Separation(cable=0.15 * np.sin(2.0 * np.pi / robots))
    return Hitch.spread(Team(robots, 2.0), polygon, 1.5, separation=separation), goal, separation


def test_what_cannot_be_faster_is_not_searched() -> None:
    """No guess of a stretched 12-gon is nearly as fast as straight lines."""
    start, goal, separation = stretched(12)
    requirements = Requirements(ho.Limits(), separation)
    end = Hitch.nearest(
        start.team, goal, 1.5, start.fractions, limits=ho.Limits(), separation=separation
    )
    effort = Effort()
    straight = straight_path(start, end, requirements)
    planner = OptimisedMorph(
        start,
        end,
        requirements,
        lambda path: motion_along(path, requirements),
        straight=straight,
        effort=effort,
    )
    assert [route.name for route in planner.solve().accepted] == [""]
    assert effort.spent == 0.0


def test_the_optimizer_ends_at_the_limit_of_its_effort() -> None:
    path, bounds = turned_pentagon(Effort())
    steps = [*iterates(path, bounds, SolverStep(0.17), 8, progress=0.0)]
    assert len(steps) == 8
    path, bounds = turned_pentagon(Effort(0.5 * bounds.effort.spent))
    fewer = [*iterates(path, bounds, SolverStep(0.17), 8, progress=0.0)]
    assert 2 <= len(fewer) < 8
    for one, other in zip(fewer, steps, strict=False):
        np.testing.assert_array_equal(one.table, other.table)


def test_a_morph_without_a_route_names_the_best_one_tried() -> None:
    """Legs are as long as edges; no path of the search is feasible."""
    start, end = ends(Team(4, 4.0), SQUARE, SQUARE.rotated(0.5))
    routes = OptimisedMorph(start, end, FREE, lambda _: None).solve()
    assert routes.accepted == []
    assert routes.rejected is not None
    assert routes.rejected.name.startswith("edges turned")


@pytest.mark.parametrize("wide", [1.0, 1.6])
def test_distances_at_samples_are_those_of_the_timed_motion(wide: float) -> None:
    """What samples of a path refuse, the certificate of its motion refuses for the same reason."""
    requirements = Requirements(
        separation=ho.Separation(radius=0.12 * wide), arena=ho.Arena([-2, -2, 0], [2, 1.9, 3])
    )
    refused = list[str]()
    for pair in irregular_pairs()[:12]:
        team = Team(pair["n"], pair["cable_length"])
        start, end = (Hitch.spread(team, pair[key]) for key in ("start", "goal"))
        path = Path.straight(start, end)
        motion = motion_along(path, requirements)
        checks = [rule.check(motion) for rule in CHECKED_AT_SAMPLES]
        shortfalls = {
            check.name: check.limit - check.worst
            for check in checks
            if check is not None and check.limit is not None
        }
        found = error_of(partial(check_distances, path, requirements))
        broken = () if found is None else tuple(each.constraint for each in found.violations)
        for violation in () if found is None else found.violations:
            shortfall = violation.limit - violation.value
            assert shortfall > DISTANCE_TOLERANCE
            assert shortfalls[violation.constraint] > shortfall - DISTANCE_TOLERANCE
            assert "of the path" in violation.when
        refused += broken
    assert len(set(refused)) > 1


@pytest.mark.parametrize("index", range(4))
def test_samples_see_small_violations_of_distances(index: int) -> None:
    """A radius is chosen that the certificate of the motion misses by half a thousandth."""
    pair = irregular_pairs()[index]
    team = Team(pair["n"], pair["cable_length"])
    path = Path.straight(*(Hitch.spread(team, pair[key]) for key in ("start", "goal")))
    check = RULE_OF["separation"].check(motion_along(path, Requirements()))
    assert check is not None
    radius = Requirements().separation.radius * check.worst * 1.0005
    found = error_of(
        partial(check_distances, path, Requirements(separation=ho.Separation(radius=radius)))
    )
    assert found is not None
    assert "separation" in {violation.constraint for violation in found.violations}
