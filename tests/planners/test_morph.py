"""Morphs: leg laws, blocked paths, and the optimizer's guesses, paths and programs."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.distance import pdist

import hitchopt as ho
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.legs import leg_task_along, with_legs_clear
from hitchopt.planners.morph.morph import StraightMorph
from hitchopt.planners.morph.path import ShapePath, shapes_along
from hitchopt.planners.optimise import program, search
from hitchopt.planners.optimise.knots import KnotPath, SearchLimits, SolverStep
from hitchopt.planners.optimise.program import iterates
from hitchopt.planners.optimise.search import OptimisedMorph, guesses
from hitchopt.planners.timing.flight import fly

FREE = Requirements()
SQUARE = regular_polygon(4, 1.2, np.pi / 4)
PENTAGON = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])


def ends(team: Team, first: ConvexPolygon, last: ConvexPolygon) -> tuple[Hitch, Hitch]:
    kept: dict[str, Any] = {"limits": FREE.limits, "separation": FREE.separation}
    start = Hitch.spread(team, first)
    return start, Hitch.nearest(team, last, 1.0, start.fractions, **kept)


WEAK = Team(4, 2.4, tension=0.8, quadrotor=ho.Quadrotor(0.132, 1.6))


def test_renumbering_gives_the_same_duration() -> None:
    seconds = [
        ho.morph(Hitch.spread(Team(5, 2.6), first), first.renumbered(2), optimize=True).duration
        for first in (PENTAGON, PENTAGON.renumbered(3))
    ]
    assert seconds[1] == pytest.approx(seconds[0], rel=0.01)


def found(start: Hitch, end: Hitch, tension: tuple[float, float] | None = None) -> list[Motion]:
    """The optimizer's motions with a judge that accepts every flight, the fastest first."""
    given = OptimisedMorph(start, end, FREE, lambda path: fly(path, FREE), tension).solve()
    flights = [candidate.motion for candidate in given]
    durations = [flight.duration for flight in flights]
    assert durations == sorted(durations) != []
    return flights


@pytest.mark.parametrize("least", [0.3, 0.7])
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
    tried = guesses(PENTAGON, last, 9)
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


def test_the_optimiser_ends_on_ctrl_c_at_the_first_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a solver that keeps signals to itself, as IPOPT does."""
    built: list[str] = []
    build = ca.nlpsol

    def disturbed(name: str, plugin: str, *given: Any) -> Any:
        built.append(plugin)
        solver = build(name, plugin, *given)

        def solve(**numbers: Any) -> Any:
            with suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
            return solver(**numbers)

        solve.stats = solver.stats  # type: ignore[attr-defined]
        return solve

    monkeypatch.setattr(ca, "nlpsol", disturbed)
    monkeypatch.setattr(program, "solver_of", program.solver_of.__wrapped__)
    triangle = ho.regular_polygon(3, 1.0)
    start, before = ho.Hitch.spread(ho.Team(3, 2.4), triangle), signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        ho.morph(start, triangle.rotated(0.5), optimize=True)
    assert built == ["ipopt"]
    assert signal.getsignal(signal.SIGINT) is before


def test_solvers_of_one_structure_are_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second team's cables, positions and altitude are parameters of the same solver."""
    built: list[str] = []
    build = ca.nlpsol

    def counted(name: str, plugin: str, *given: Any) -> Any:
        built.append(plugin)
        return build(name, plugin, *given)

    monkeypatch.setattr(ca, "nlpsol", counted)
    program.solver_of.cache_clear()

    def morphed(cable: float, moved: float) -> tuple[float, int]:
        first, last = SQUARE, SQUARE.rotated(0.9).translated([0.4, 0.0])
        first, last = (polygon.translated([moved, -moved]) for polygon in (first, last))
        ho.forget()
        start = Hitch.spread(Team(4, cable), first, 1.0 + moved)
        return ho.morph(start, last, optimize=True).duration, len(built)

    (first, one), (second, two) = morphed(2.4, 0.0), morphed(2.4001, 3.0)
    program.solver_of.cache_clear()
    again, three = morphed(2.4001, 3.0)
    assert 0 < one == two < three
    assert abs(second - first) > 1e-6
    assert again == pytest.approx(second, rel=1e-12)


TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]


def distances_on_the_way(path: ShapePath) -> float:
    s = np.linspace(0.0, 1.0, 301)
    return leg_task_along(path, FREE, s, 1.0).reference_margin()


def test_leg_laws_keep_distances_that_linear_fractions_do_not() -> None:
    """From a slack split of the sharp triangle to its mirror image; equal splits are too close."""
    team = Team(3, 2.4)
    start = Hitch.spread(team, TRIANGLE)
    end = Hitch(team, TRIANGLE, 1.0, start.slack - start.q_legs)
    linear = ShapePath.straight(start, end)
    assert distances_on_the_way(linear) < 1.0
    clear = with_legs_clear(linear, FREE)
    assert distances_on_the_way(clear) >= 1.0
    legs = shapes_along(clear, np.array([0.0, 1.0])).legs
    np.testing.assert_allclose(legs, [start.legs, end.legs], atol=1e-9)
    flight = StraightMorph(start, end, FREE).solve()
    assert flight is not None
    np.testing.assert_allclose(flight.drones.at(flight.duration), end.drones, atol=1e-9)
    assert StraightMorph(start, start, FREE).solve() is None  # nothing to do


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
            StraightMorph(start, end, FREE).solve()
        assert caught.value.violations[0].value == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("thrust", [1.35, 1.37])
def test_too_little_thrust_at_rest_is_refused_before_timing(thrust: float) -> None:
    needed = np.hypot(0.132 * 9.81, 0.4)  # 1.356 N
    team = Team(3, 2.4, quadrotor=ho.Quadrotor(0.132, thrust))
    start, end = (Hitch.spread(team, [[0.0, y], *TRIANGLE[1:]]) for y in (-1.0, -0.8))
    morph = StraightMorph(start, end, FREE)
    if thrust > needed:
        assert morph.solve() is not None
        return
    with pytest.raises(ho.InfeasibleError, match="thrust") as caught:
        morph.solve()
    assert caught.value.violations[0].value == pytest.approx(needed, rel=1e-9)


def stretched(robots: int) -> tuple[Hitch, ConvexPolygon, ho.Separation]:
    """Return a regular polygon with long legs, whose drones are close, and a stretched goal."""
    polygon = regular_polygon(robots, 1.6 * np.sin(np.pi / robots))
    goal = ConvexPolygon(polygon.vertices * [1.15, 0.9] + [0.2, 0.1])
    separation = ho.Separation(cable=0.15 * np.sin(2.0 * np.pi / robots))
    return Hitch.spread(Team(robots, 2.0), polygon, 1.5, separation=separation), goal, separation


def test_what_cannot_be_faster_is_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """No guess of a stretched 12-gon is nearly as fast as straight lines."""
    start, goal, separation = stretched(12)
    straight = ho.morph(start, goal, separation=separation)
    monkeypatch.setattr(program, "solve_program", None)
    optimised = ho.morph(start, goal, separation=separation, optimize=True)
    assert optimised.duration <= straight.duration


def test_the_optimizer_ends_at_the_limit_of_its_effort(monkeypatch: pytest.MonkeyPatch) -> None:
    """For a morph with legs as long as edges, whose programs never have a feasible path."""
    solve, sizes = program.solve_program, list[tuple[int, float]]()

    def counted(task: program.MorphProgram) -> program.ProgramResult:
        result = solve(task)
        sizes.append((result.iterations, task.size))
        return result

    monkeypatch.setattr(program, "solve_program", counted)
    monkeypatch.setattr(search, "MAX_ITERATIONS", 100)
    start, end = ends(Team(4, 4.0), SQUARE, SQUARE.rotated(0.5))
    assert OptimisedMorph(start, end, FREE, lambda _: None).solve() == []
    spent = [iterations * size for iterations, size in sizes]
    limit = 100.0 * 4 * 7  # robots and inner knots
    assert sum(spent[:-1]) <= limit < 2.0 * sum(spent)
