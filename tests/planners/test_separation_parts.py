"""The separation planner's parts, each against another route to compute the same."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import BSpline
from scipy.optimize import LinearConstraint, minimize

from hitchopt.errors import InfeasibleError
from hitchopt.hitch.convex_qp import QuadraticProgram
from hitchopt.planners.separation import SeparationTask, Tether
from hitchopt.planners.separation.guess import PriorityRule, pushed_apart
from hitchopt.planners.separation.planes import (
    ClosePieces,
    close_pieces,
    hull_points,
    planes_between,
)
from hitchopt.planners.separation.qp import Solver
from hitchopt.planners.separation.roundabout import roundabout
from hitchopt.planners.separation.routes import routes_around
from hitchopt.planners.separation.separation_program import Around, Built, build_program
from hitchopt.planners.separation.setting import (
    DEGREE,
    HELD,
    Grid,
    Setting,
    departures,
    progress_along,
    setting_of,
)
from hitchopt.planners.separation.walls import walls_before
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.trajectory import bernstein

PILLAR = Prism([[-0.3, -0.4], [-0.3, 0.4], [0.5, 0.4], [0.5, -0.4]], 0.0, 9.0)


def some_grid(seed: int) -> Grid:
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.3, 1.0, rng.integers(2, 9))
    return Grid(np.concatenate([[0.0], np.cumsum(steps)]) / np.sum(steps))


@pytest.mark.parametrize("seed", range(4))
def test_pieces_are_those_of_the_spline_and_smooth(seed: int) -> None:
    grid, rng = some_grid(seed), np.random.default_rng(seed)
    coefficients = rng.normal(size=(3, grid.count, 3))
    curves = grid.curves(coefficients, 2.5)
    spline = BSpline(grid.knots, np.swapaxes(coefficients, 0, 1), DEGREE)
    s = np.linspace(0.0, 1.0, 41)
    for order in range(4):
        expected = spline.derivative(order)(s) if order else spline(s)
        found = curves.at(2.5 * s, order) * 2.5**order
        np.testing.assert_allclose(found, expected, atol=1e-11 * np.max(np.abs(expected)))
        first, last = curves.ends(order)
        np.testing.assert_allclose(
            last[:-1], first[1:], atol=1e-11 * np.max(np.abs(expected)), rtol=0.0
        )
    rest = np.zeros_like(coefficients)
    rest[:, :HELD], rest[:, -HELD:] = coefficients[:, :1], coefficients[:, -1:]
    ends = grid.curves(rest, 1.0)
    np.testing.assert_allclose(ends.at([0.0, 1.0], 1), 0.0, atol=1e-12)
    np.testing.assert_allclose(ends.at([0.0, 1.0], 2), 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_rates_are_the_derivatives_coefficients(seed: int) -> None:
    grid, rng = some_grid(seed), np.random.default_rng(seed)
    coefficients = rng.normal(size=grid.count)
    s = np.linspace(0.0, 1.0, 31)
    for order, rate in enumerate(grid.rates, start=1):
        inner = BSpline(grid.knots[order:-order], rate @ coefficients, DEGREE - order)
        expected = BSpline(grid.knots, coefficients, DEGREE).derivative(order)(s)
        np.testing.assert_allclose(inner(s), expected, atol=1e-10 * np.max(np.abs(expected)))


def test_quadrature_is_exact_for_squares() -> None:
    grid = some_grid(5)
    c = np.random.default_rng(5).normal(size=grid.count)
    s, weights = grid.quadrature
    power = BSpline(grid.knots, c, DEGREE)
    fine = np.linspace(0.0, 1.0, 200_001)
    expected = np.trapezoid(power(fine) ** 2, fine)
    assert float(weights @ (grid.sampled(s) @ c) ** 2) == pytest.approx(expected, rel=1e-7)


@given(st.floats(1e-3, 50.0), st.floats(0.1, 5.0), st.floats(0.2, 9.0), st.floats(0.5, 90.0))
@settings(max_examples=60)
def test_fastest_ramps_are_those_of_another_library(d: float, v: float, a: float, j: float) -> None:
    asked = InputParameter(1)
    asked.target_position = [d]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [v], [a], [j]
    found = Trajectory(1)
    assert Ruckig(1).calculate(asked, found) == Result.Working
    ramps = fastest_ramps(np.array([d]), v, a, j)
    assert ramps.duration[0] == pytest.approx(found.duration, rel=1e-6)
    assert ramps.peak[0] <= v
    assert 2.0 * ramps.rise[0] <= ramps.duration[0] * (1.0 + 1e-12)


def nearest_by_brute_force(cloud: np.ndarray) -> np.ndarray:
    """The point of the hull of (3, k) points nearest to the origin, by all of its simplices.

    Lagrange's conditions of every subset of up to four points are one linear system each.
    """
    best = cloud[:, np.argmin(np.sum(cloud**2, axis=0))]
    for size in (2, 3, 4):
        for chosen in itertools.combinations(range(cloud.shape[1]), size):
            corners = cloud[:, chosen]
            system = np.ones((size + 1, size + 1))
            system[:-1, :-1], system[-1, -1] = corners.T @ corners, 0.0
            weights = np.linalg.lstsq(system, np.eye(size + 1)[-1], rcond=1e-13)[0][:-1]
            if np.all(weights >= 0.0) and abs(np.sum(weights) - 1.0) < 1e-9:
                point = corners @ weights
                if point @ point < best @ best:
                    best = point
    return np.asarray(best)


def clouds(kind: str) -> np.ndarray:
    """(m, 3, 6) points: in general position, or with ties of all kinds."""
    rng = np.random.default_rng(5)
    if kind == "general":
        return rng.normal(size=(60, 3, 6)) + rng.normal(scale=2.0, size=(60, 3, 1))
    if kind == "grid":  # points that coincide, parallel edges and faces, the origin on a face
        return rng.integers(-2, 3, size=(120, 3, 6)).astype(np.float64)
    if kind == "line":
        along = rng.normal(size=(60, 3, 1)) * rng.normal(size=(60, 1, 6))
        return along + rng.normal(size=(60, 3, 1))
    if kind == "level":
        level = rng.normal(size=(60, 3, 6)) + rng.normal(scale=2.0, size=(60, 3, 1))
        level[:, 2] = 0.25
        return level
    return np.repeat(rng.normal(size=(60, 3, 1)), 6, axis=2)  # one point


KINDS = ("general", "grid", "line", "level", "one point")


@pytest.mark.parametrize("kind", KINDS)
def test_hull_points_are_the_nearest(kind: str) -> None:
    found = hull_points(clouds(kind))
    for cloud, point in zip(clouds(kind), found, strict=True):
        np.testing.assert_allclose(point, nearest_by_brute_force(cloud), atol=1e-7)
        # Its plane bounds the hull: no point of it is nearer, whatever the method.
        assert np.min(point @ cloud) >= point @ point - 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_hull_points_follow_their_points(kind: str) -> None:
    points, rng = clouds(kind), np.random.default_rng(6)
    for noise in (1e-14, 1e-10):
        moved = points + noise * rng.uniform(-1.0, 1.0, points.shape)
        np.testing.assert_allclose(hull_points(moved), hull_points(points), atol=2e4 * noise)
    order = rng.permutation(6)
    np.testing.assert_allclose(hull_points(points[..., order]), hull_points(points), atol=1e-10)


def test_hull_points_of_many_hulls_are_those_of_each() -> None:
    many = np.tile(clouds("grid"), (40, 1, 1))
    np.testing.assert_array_equal(hull_points(many)[-120:], hull_points(clouds("grid")))


def test_planes_of_symmetric_meetings_follow_their_curves() -> None:
    """Head on, side by side and through each other: rounding must not choose the normals."""
    s = bernstein.nodes(5)
    forth = np.stack([2.0 * s - 1.0, 0.0 * s, 0.0 * s])
    beside = forth + np.array([[0.0], [0.4], [0.0]])
    scaled = np.stack([forth, -forth, beside, beside[:, ::-1]])[None] * 3.0
    pairs = close_pieces(scaled, 9.0)
    assert len(pairs) == 6
    normals, rng = planes_between(scaled, pairs).normals, np.random.default_rng(7)
    for _ in range(5):
        moved = scaled + 1e-14 * rng.uniform(-1.0, 1.0, scaled.shape)
        np.testing.assert_allclose(planes_between(moved, pairs).normals, normals, atol=1e-8)


def test_level_pairs_lean_by_a_rule() -> None:
    apart = np.array([0.0, 0.3, 1.0, 1.9, 2.5])
    scaled = np.zeros((5, 2, 3, 6))
    scaled[:, 0, 0] = apart[:, None]
    every = ClosePieces(np.arange(5), np.zeros(5, np.intp), np.ones(5, np.intp))
    upward = planes_between(scaled, every).normals[:, 2]
    assert np.all(np.diff(upward[:-1]) < 0.0)
    np.testing.assert_allclose(upward, 0.01 * np.maximum(2.0 - apart, 0.0), rtol=1e-3)
    scaled[:, 0, 2] = 0.01  # no longer level: the widest plane it is
    nearest = np.stack([apart, 0.0 * apart, 0.01 + 0.0 * apart], axis=1)
    expected = nearest / np.linalg.norm(nearest, axis=1, keepdims=True)
    np.testing.assert_allclose(planes_between(scaled, every).normals, expected, atol=1e-12)


def crossing_task(*tethers: Tether, arena: Arena | None = None) -> SeparationTask:
    """Three drones that meet about the middle, off the origin."""
    start = np.array([[-1.0, 0.5, 1.2], [1.4, 0.6, 1.1], [0.2, 2.0, 1.3]])
    goal = np.array([[1.3, 0.4, 1.0], [-1.1, 0.5, 1.3], [0.3, -1.0, 1.1]])
    return SeparationTask(start, goal, Requirements(arena=arena, keep_out=(PILLAR,)), tethers)


def around_of(task: SeparationTask, seed: int) -> Around:
    setting = setting_of(task)
    rng = np.random.default_rng(seed)
    coefficients = setting.nominal.copy()
    coefficients[:, setting.grid.free] += rng.normal(
        scale=0.05, size=coefficients[:, setting.grid.free].shape
    )
    pieces = setting.grid.pieces_of(coefficients)
    scaled = pieces * setting.scale[:, None]
    planes = planes_between(scaled, close_pieces(scaled, 2.0))
    walls = walls_before(
        pieces, task.requirements.keep_out, task.requirements.separation.radius, 0.8
    )
    return Around(coefficients, 4.2, 0.3, planes, walls, np.ones(len(coefficients)))


@pytest.mark.parametrize("longest", [0.1, 9.0])
def test_a_program_can_always_be_met_by_staying(longest: float) -> None:
    task = crossing_task(Tether(1, 2, longest), arena=Arena([-3, -3, 0], [3, 3, 2]))
    setting, around = setting_of(task), around_of(task, 1)
    program = build_program(setting, around).program
    unknowns = around.coefficients[:, setting.grid.free].size
    x = np.zeros(len(program.q))
    x[unknowns:] = 1e3  # slacks as large as wanted
    values = np.asarray(program.A @ x)
    assert np.all(values >= program.lower - 1e-9)
    assert np.all(values <= program.upper + 1e-9)


def test_rows_are_what_the_moved_curves_do() -> None:
    task = crossing_task(Tether(0, 2, 3.0))
    setting, around = setting_of(task), around_of(task, 2)
    built = build_program(setting, around)
    unknowns = around.coefficients[:, setting.grid.free].size
    x = np.zeros(len(built.program.q))
    x[:unknowns] = np.random.default_rng(3).uniform(-1.0, 1.0, unknowns)
    pieces = setting.grid.pieces_of(built.moved(x))
    between, normals = around.planes.between, around.planes.normals
    offset = (pieces[between.piece, between.first] - pieces[between.piece, between.second]) * (
        setting.scale[:, None]
    )
    walls = around.walls
    reach = np.max(walls.normals @ PILLAR.corners.T, axis=1)[:, None]
    before = np.einsum("md,mdk->mk", walls.normals, pieces[walls.piece, walls.drone]) - reach
    expected = np.concatenate(
        [
            np.einsum("md,mdk->mk", normals, offset).ravel(),
            before.ravel() / task.requirements.separation.radius,
        ]
    )
    first = built.common_rows
    rows = slice(first, first + len(expected))
    assert len(walls) > 0
    live = np.isfinite(built.program.lower[rows])
    assert np.any(live)
    wanted = built.program.lower[rows] - np.asarray(built.program.A @ x)[rows]
    np.testing.assert_allclose((1.01 - expected)[live], wanted[live], atol=1e-9)


def changes(built: Built, unknowns: int, seed: int) -> np.ndarray:
    """Random changes of the free coefficients, in trust radii; every slack zero."""
    x = np.zeros(len(built.program.q))
    x[:unknowns] = np.random.default_rng(seed).uniform(-1.0, 1.0, unknowns)
    return x


def rows_of_limits(setting: Setting) -> list[list[slice]]:
    """For every order of derivative the rows along it and the two across it, (drones * rates)."""
    n = setting.task.drones
    first = 3 * n * (setting.grid.count - 2 * HELD)
    found = []
    for rate in setting.grid.rates:
        size = n * len(rate)
        found.append([slice(first + k * size, first + (k + 1) * size) for k in range(3)])
        first += 3 * size
    return found


def test_rows_of_limits_are_the_slopes_of_the_derivatives() -> None:
    """Along a derivative by finite differences of its norm, and all three by its whole change."""
    task = replace(crossing_task(), acceleration=[1.0, 2.0, 1.5])
    setting, around = setting_of(task), around_of(task, 5)
    built = build_program(setting, around)
    unknowns = around.coefficients[:, setting.grid.free].size
    x = changes(built, unknowns, 8)
    h = 1e-5
    for order, rows in enumerate(rows_of_limits(setting), start=1):

        def shares(step: float, order: int = order) -> np.ndarray:
            matrix = setting.grid.rates[order - 1] / around.duration**order
            derivative = np.einsum("rc,ncd->nrd", matrix, built.moved(step * x))
            return np.asarray(derivative / setting.caps[order - 1][:, None, None])

        here = np.linalg.norm(shares(0.0), axis=-1)
        moving = here > 1e-3  # ends are at rest, where a norm has no slope
        assert np.mean(moving) > 0.6
        slope = np.linalg.norm(shares(h), axis=-1) - np.linalg.norm(shares(-h), axis=-1)
        slope /= 2.0 * h
        values = np.asarray(built.program.A @ x)
        along, *across = (values[part].reshape(here.shape) for part in rows)
        atol = 1e-6 * float(np.max(np.abs(slope)))
        np.testing.assert_allclose(along[moving], slope[moving], atol=atol)
        whole = np.linalg.norm(shares(1.0) - shares(0.0), axis=-1)
        np.testing.assert_allclose(np.sqrt(along**2 + sum(a**2 for a in across)), whole, atol=1e-9)
        np.testing.assert_allclose(built.program.upper[rows[0]], (1.0 - here).ravel(), atol=1e-9)
        assert np.all(np.isneginf(built.program.lower[rows[0]]))
        bound = (0.3 + 0.4 * np.clip(1.0 - here, 0.0, 1.0)).ravel()
        for part in rows[1:]:  # the derivative has no component across itself
            np.testing.assert_allclose(built.program.upper[part], bound, atol=1e-9)
            np.testing.assert_allclose(built.program.lower[part], -bound, atol=1e-9)
        for drone in range(task.drones):  # its slack slows this drone down, and no other
            x_slack = np.zeros_like(x)
            x_slack[unknowns + drone] = 1.0
            relief = np.asarray(built.program.A @ x_slack)[rows[0]].reshape(here.shape)
            expected = np.zeros_like(relief)
            expected[drone] = -order
            np.testing.assert_array_equal(relief, expected)


def test_tether_rows_are_the_slopes_of_the_distances() -> None:
    """The distance of every pair of coefficients over the cable's length, by finite differences."""
    tethers = (Tether(0, 2, 3.0), Tether(2, 1, 0.4))  # the second one is broken as it is
    task = crossing_task(*tethers)
    setting, around = setting_of(task), around_of(task, 6)
    built = build_program(setting, around)
    program = built.program
    unknowns = around.coefficients[:, setting.grid.free].size
    x, h = changes(built, unknowns, 9), 1e-5
    free = setting.grid.count - 2 * HELD
    first = rows_of_limits(setting)[-1][-1].stop
    rows = slice(first, first + len(tethers) * free)

    def shares(step: float) -> np.ndarray:
        inner = built.moved(step * x)[:, setting.grid.free]
        ratios = [
            np.linalg.norm(inner[t.first] - inner[t.second], axis=-1) / t.longest for t in tethers
        ]
        return np.concatenate(ratios)

    slope = (shares(h) - shares(-h)) / (2.0 * h)
    np.testing.assert_allclose(np.asarray(program.A @ x)[rows], slope, atol=1e-7)
    np.testing.assert_allclose(program.upper[rows], 0.995 - shares(0.0), atol=1e-12)
    assert np.all(np.isneginf(program.lower[rows]))
    assert np.min(program.upper[rows]) < 0.0 < np.max(program.upper[rows])
    for k in range(len(tethers)):  # its slack lengthens this cable, and no other
        x_slack = np.zeros_like(x)
        x_slack[unknowns + task.drones + k] = 1.0
        expected = np.repeat(-np.eye(len(tethers))[k], free)
        np.testing.assert_array_equal(np.asarray(program.A @ x_slack)[rows], expected)


def test_changes_and_slacks_have_their_bounds() -> None:
    arena = Arena([-1.5, -1.5, 1.15], [1.5, 2.5, 2.0])
    task = crossing_task(Tether(0, 2, 3.0), arena=arena)
    setting, around = setting_of(task), around_of(task, 7)
    built = build_program(setting, around)
    program = built.program
    inner = around.coefficients[:, setting.grid.free]
    A = sp.csr_array(program.A)
    boxes = slice(0, inner.size)
    np.testing.assert_array_equal(A[boxes].toarray(), np.eye(inner.size, len(program.q)))
    lowest = inner + around.trust * program.lower[boxes].reshape(inner.shape)
    highest = inner + around.trust * program.upper[boxes].reshape(inner.shape)
    within = (inner >= arena.lower) & (inner <= arena.upper)
    assert not np.all(within)
    expected = np.maximum(inner - around.trust, arena.lower), inner + around.trust
    np.testing.assert_allclose(lowest[within], expected[0][within], atol=1e-12)
    expected = expected[0], np.minimum(expected[1], arena.upper)
    np.testing.assert_allclose(highest[within], expected[1][within], atol=1e-12)
    assert np.all(program.lower[boxes] <= 0.0)
    assert np.all(program.upper[boxes] >= 0.0)
    for slack in range(inner.size, len(program.q)):
        rows = [row for row in A[:, [slack]].nonzero()[0].tolist() if A[[row]].nnz == 1]
        least = [program.lower[row] for row in rows if np.isposinf(program.upper[row])]
        assert [value for value in least if np.isfinite(value)] == [0.0]


def test_slacks_of_planes_and_prisms_add_to_their_gaps() -> None:
    task = crossing_task()
    setting, around = setting_of(task), around_of(task, 2)
    built = build_program(setting, around)
    sides = len(around.planes.between) + len(around.walls)
    x = np.zeros(len(built.program.q))
    slacks = np.arange(1.0, sides + 1.0)
    x[-sides:] = slacks
    rows = slice(built.common_rows, built.common_rows + sides * (DEGREE + 1))
    relief = np.asarray(built.program.A @ x)[rows]
    np.testing.assert_array_equal(relief, np.repeat(slacks, DEGREE + 1))


def test_the_objective_is_the_integral_and_its_slope_the_gradient() -> None:
    task = crossing_task()
    setting, around = setting_of(task), around_of(task, 4)
    built = build_program(setting, around)
    program = built.program
    unknowns = around.coefficients[:, setting.grid.free].size
    full = program.P

    def value(x: np.ndarray) -> float:
        return float(0.5 * x @ (full @ x) + program.q @ x)

    s = np.linspace(0.0, 1.0, 60_001)
    basis, bends = setting.grid.sampled(s), setting.grid.sampled(s, 3)

    def integral(x: np.ndarray) -> float:
        moved = built.moved(x)
        offset = np.einsum("sc,ncd->snd", basis, moved - setting.nominal)
        bend = np.einsum("sc,ncd->snd", bends, moved)
        density = np.sum(offset**2, axis=(1, 2)) + 3e-7 * np.sum(bend**2, axis=(1, 2))
        return float(np.trapezoid(density, s)) / (setting.size**2 * task.drones)

    x = np.zeros(len(program.q))
    x[:unknowns] = np.random.default_rng(6).uniform(-1.0, 1.0, unknowns)
    change = integral(x) - integral(np.zeros_like(x))
    assert value(x) == pytest.approx(change, rel=1e-5)


def by_slsqp(P: np.ndarray, q: np.ndarray, A: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """The least of x·Px/2 + q·x where lower <= Ax <= -lower."""

    def value(x: np.ndarray) -> float:
        return float(0.5 * x @ P @ x + q @ x)

    kept = LinearConstraint(A, lower, -lower)
    return np.asarray(minimize(value, np.zeros(len(q)), constraints=kept, method="SLSQP").x)


@pytest.mark.parametrize("seed", range(3))
def test_osqp_agrees_with_another_solver_also_after_an_update(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = sp.csc_array(rng.normal(size=(7, 4)))
    solver = Solver()
    for _ in range(3):
        P = np.diag(rng.uniform(0.5, 2.0, 4))
        q, lower = rng.normal(size=4), rng.uniform(-2.0, -0.5, 7)
        A = sp.csc_array((rng.normal(size=A.nnz), A.indices, A.indptr), shape=A.shape)
        program = QuadraticProgram(sp.csc_array(P), q, A, lower, -lower)
        found = solver.solve(program, np.zeros(4), 0)
        np.testing.assert_allclose(found, by_slsqp(P, q, A.toarray(), lower), atol=3e-3)
        assert program.residual(found) < 3e-3
        values = A.toarray() @ found
        broken = max(0.0, float(np.max(lower - values)), float(np.max(values + lower)))
        assert program.residual(found) == pytest.approx(broken, abs=1e-12)


def test_no_coefficient_moves_farther_than_its_drone_may() -> None:
    """Neither in the program's rows nor in what a solution beyond them is taken for."""
    task, moves = crossing_task(), np.array([0.2, 0.5, 1.0])
    setting, around = setting_of(task), replace(around_of(task, 1), moves=moves)
    built = build_program(setting, around)
    most = np.repeat(moves, 3 * (setting.grid.count - 6))
    np.testing.assert_array_equal(built.program.upper[: len(most)], most)
    np.testing.assert_array_equal(built.program.lower[: len(most)], -most)
    moved = built.moved(np.full(len(built.program.q), 7.0)) - around.coefficients
    largest = np.max(np.abs(moved), axis=(1, 2))
    np.testing.assert_allclose(largest, moves * around.trust, rtol=1e-12)


def test_the_solver_ends_after_its_iterations() -> None:
    rng = np.random.default_rng(3)
    A, lower = sp.csc_array(rng.normal(size=(40, 20))), -rng.uniform(0.01, 2.0, 40)
    program = QuadraticProgram(sp.csc_array(np.eye(20)), rng.normal(size=20), A, lower, -lower)
    few, many = (Solver(count).solve(program, np.zeros(20), 0) for count in (2, 500))
    assert program.residual(many) < 1e-3 < program.residual(few)


def test_mistakes_that_osqp_keeps_silent_about_are_refused() -> None:
    P, A = sp.csc_array(np.eye(2)), sp.csc_array(np.ones((1, 2)))
    one, two = np.ones(1), np.ones(2)
    for arguments, words in (
        ((P, np.ones(3), A, -one, one), "objective"),
        ((P, two, A, -two, one), "bounds"),
        ((P, two, A, one, -one), "crossed"),
        ((P, two * np.nan, A, -one, one), "nan"),
    ):
        with pytest.raises(ValueError, match=words):
            QuadraticProgram(*arguments)
    with pytest.raises(ValueError, match="start"):
        Solver().solve(QuadraticProgram(P, two, A, -one, one), np.zeros(5), 0)


def test_the_way_around_a_pillar_is_the_shortest_and_stays_out() -> None:
    start, goal = np.array([[-2.0, 0.1, 1.0]]), np.array([[2.0, 0.0, 1.0]])
    task = SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(PILLAR,)))
    routes = routes_around(task)
    off = 1.25 * task.requirements.separation.radius
    corners = [[-0.3 - off, 0.4 + off], [0.5 + off, 0.4 + off]]
    by_hand = np.vstack([start[0, :2], corners, goal[0, :2]])
    length = float(np.sum(np.linalg.norm(np.diff(by_hand, axis=0), axis=1)))
    assert routes.lengths[0] == pytest.approx(length, rel=1e-6)
    points = routes.of(0, np.linspace(0.0, 1.0, 500))
    assert np.min(PILLAR.clearance(points).distance) > task.requirements.separation.radius
    np.testing.assert_allclose(points[[0, -1]], [start[0], goal[0]], atol=1e-12)


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_near_a_prism_does_not_narrow_the_rest_of_the_route(end: str) -> None:
    """Edges to either end keep the radius alone; corners in between still stand off further."""
    radius = Separation().radius
    near, far = np.array([[0.0, 0.4 + 1.1 * radius, 1.0]]), np.array([[-1.0, -1.5, 1.0]])
    ends = (near, far) if end == "start" else (far, near)
    task = SeparationTask(*ends, Requirements(keep_out=(PILLAR,)))
    route = routes_around(task).corners[0]
    assert len(route) > 2
    inner = PILLAR.clearance(route[1:-1]).distance
    np.testing.assert_allclose(inner, 1.25 * np.sqrt(2.0) * radius, rtol=1e-5)  # mitred corners
    points = routes_around(task).of(0, np.linspace(0.0, 1.0, 500))
    assert np.min(PILLAR.clearance(points).distance) >= radius


def test_a_low_prism_is_flown_over_where_that_is_shorter() -> None:
    low = Prism(PILLAR.polygon, 0.0, 0.9)
    start, goal = np.array([[-2.0, 0.1, 0.8]]), np.array([[2.0, 0.0, 0.8]])
    routes = routes_around(
        SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(low,)))
    )
    assert np.max(routes.of(0, np.linspace(0.0, 1.0, 99))[:, 2]) > 1.0
    assert routes.lengths[0] < 4.2


def test_a_slit_is_told_with_its_width() -> None:
    walls = tuple(
        Prism([[-0.1, low], [-0.1, high], [0.1, high], [0.1, low]], 0.0, 3.0)
        for low, high in ((0.08, 5.0), (-5.0, -0.08))
    )
    start, goal = np.array([[-1.0, 0.3, 1.0]]), np.array([[1.0, 0.2, 1.0]])
    room = Arena([-2, -4, 0], [2, 4, 3])
    task = SeparationTask(
        start, goal, Requirements(Limits(), Separation(), arena=room, keep_out=walls)
    )
    with pytest.raises(InfeasibleError, match="keep_out") as caught:
        routes_around(task)
    assert caught.value.violations[0].value == pytest.approx(0.08, rel=2e-3)
    assert caught.value.violations[0].where == ("d0",)


def test_departures_leave_nobody_to_meet() -> None:
    n = 5
    line = np.linspace(-1.0, 1.0, n)
    start = np.column_stack([np.full(n, -3.0), line, np.full(n, 1.0)])
    goal = start * [-1.0, -1.0, 1.0]
    task = SeparationTask(start, goal, Requirements(Limits(), Separation()))
    routes = routes_around(task)
    shares, ramps = np.full(n, 0.4), np.full(n, 0.2)
    leaving = departures(routes, shares, ramps, task.requirements.separation.scale)
    assert np.all(leaving + shares <= 1.0 + 1e-12)
    time = np.linspace(0.0, 1.0, 400)
    points = np.stack(
        [routes.of(i, progress_along((time - leaving[i]) / 0.4, 0.2)) for i in range(n)]
    )
    scaled = points * task.requirements.separation.scale
    i, j = np.triu_indices(n, 1)
    assert np.min(np.linalg.norm(scaled[i] - scaled[j], axis=-1)) > 1.0


def test_guesses_push_samples_apart_and_keep_the_ends() -> None:
    setting = setting_of(crossing_task())
    guess = pushed_apart(setting, PriorityRule(0.5))
    np.testing.assert_array_equal(guess[:, :HELD], setting.nominal[:, :HELD])
    np.testing.assert_array_equal(guess[:, -HELD:], setting.nominal[:, -HELD:])

    def smallest(coefficients: np.ndarray) -> float:
        s = np.linspace(0.0, 1.0, 300)
        points = setting.grid.curves(coefficients, 1.0).at(s) * setting.scale
        i, j = np.triu_indices(3, 1)
        return float(np.min(np.linalg.norm(points[:, i] - points[:, j], axis=-1)))

    assert smallest(setting.nominal) < 0.5
    assert smallest(guess) > 1.0


def crowd_task(n: int, turned: float = 0.0) -> SeparationTask:
    """Antipodal drones on a circle about a point off the origin."""
    angle = turned + 2.0 * np.pi * np.arange(n) / n
    arm = 0.06 * n * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
    centre = np.array([0.7, -1.2, 2.0])
    return SeparationTask(centre + arm, centre - arm, Requirements())


def test_a_crowd_goes_around_its_centre() -> None:
    n, turned = 40, 0.3
    setting = setting_of(crowd_task(n))
    guess = roundabout(setting)
    assert guess is not None
    np.testing.assert_array_equal(guess[:, :HELD], setting.nominal[:, :HELD])
    np.testing.assert_array_equal(guess[:, -HELD:], setting.nominal[:, -HELD:])
    points = setting.grid.curves(guess, 1.0).at(np.linspace(0.0, 1.0, 200))
    i, j = np.triu_indices(n, 1)
    assert np.min(np.linalg.norm((points[:, i] - points[:, j]) * setting.scale, axis=-1)) > 1.0
    # To the right: clockwise about the centre.
    arm = points[100] - setting.task.start
    ahead = setting.task.goal - setting.task.start
    assert np.all(arm[:, 0] * ahead[:, 1] - arm[:, 1] * ahead[:, 0] > 0.0)
    other = roundabout(setting_of(crowd_task(n, turned)))
    assert other is not None
    c, s = np.cos(turned), np.sin(turned)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    centre = 0.5 * (setting.task.start + setting.task.goal)[0]
    np.testing.assert_allclose(other - centre, (guess - centre) @ turn.T, atol=1e-9)


def test_few_drones_need_no_roundabout() -> None:
    assert roundabout(setting_of(crowd_task(24))) is None
    assert roundabout(setting_of(crossing_task())) is None
    alone = SeparationTask(np.zeros((1, 3)), np.ones((1, 3)), Requirements())
    assert roundabout(setting_of(alone)) is None


@pytest.mark.parametrize("seed", range(2))
def test_planes_bound_the_distance_of_whole_pieces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scaled = rng.normal(size=(2, 6, 3, 6)) * 0.4 + rng.normal(scale=1.5, size=(2, 6, 3, 1))
    pairs = close_pieces(scaled, 3.0)
    planes = planes_between(scaled, pairs)
    np.testing.assert_allclose(np.linalg.norm(planes.normals, axis=1), 1.0)
    offset = scaled[pairs.piece, pairs.first] - scaled[pairs.piece, pairs.second]
    x = np.linspace(0.0, 1.0, 200)
    curves = offset @ bernstein.basis(x, 5).T
    sampled = np.min(np.linalg.norm(curves, axis=1), axis=1)
    assert np.all(np.min(planes.gaps, axis=1) <= sampled + 1e-12)
    # and no pair nearer than asked for is left out
    i, j = np.triu_indices(6, 1)
    every = (scaled[:, i] - scaled[:, j]) @ bernstein.basis(x, 5).T
    near = np.min(np.linalg.norm(every, axis=2), axis=2) < 3.0
    listed = set(
        zip(pairs.piece.tolist(), pairs.first.tolist(), pairs.second.tolist(), strict=True)
    )
    for m, k in np.argwhere(near):
        assert (m, i[k], j[k]) in listed
