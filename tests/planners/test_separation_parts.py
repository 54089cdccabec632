"""The separation planner's parts, each against another way to compute the same."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import BSpline
from scipy.optimize import LinearConstraint, lsq_linear, minimize

from hitchopt.errors import InfeasibleError
from hitchopt.planners.separation import SeparationTask, Tether
from hitchopt.planners.separation.course import course_of
from hitchopt.planners.separation.delays import departures, progress_along
from hitchopt.planners.separation.fastest import fastest_ramps
from hitchopt.planners.separation.guess import Manners, pushed_apart
from hitchopt.planners.separation.planes import close_pieces, hull_points, planes_between
from hitchopt.planners.separation.program import Around, build_program
from hitchopt.planners.separation.qp import QuadraticProgram, Solver
from hitchopt.planners.separation.spline import DEGREE, HELD, Grid
from hitchopt.planners.separation.walls import walls_before
from hitchopt.planners.separation.ways import ways_around
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
@settings(max_examples=60, deadline=None)
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


@pytest.mark.parametrize("seed", range(3))
def test_hull_points_are_about_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clouds = rng.normal(size=(12, 3, 6)) + rng.normal(scale=2.0, size=(12, 3, 1))
    for cloud, point in zip(clouds, hull_points(clouds), strict=True):
        big = 1e4  # weights that sum to one
        rows = np.vstack([cloud, big * np.ones(6)])
        best = lsq_linear(rows, np.array([0.0, 0.0, 0.0, big]), (0.0, 1.0), tol=1e-12)
        least = float(np.linalg.norm(cloud @ best.x))
        assert least - 1e-3 <= np.linalg.norm(point) <= least * 1.05 + 0.05


def crossing_task(**more: object) -> SeparationTask:
    """Three drones that meet about the middle, off the origin."""
    start = np.array([[-1.0, 0.5, 1.2], [1.4, 0.6, 1.1], [0.2, 2.0, 1.3]])
    goal = np.array([[1.3, 0.4, 1.0], [-1.1, 0.5, 1.3], [0.3, -1.0, 1.1]])
    return SeparationTask(start, goal, Requirements(Limits(), Separation()), **more)  # type: ignore[arg-type]


def around_of(task: SeparationTask, seed: int) -> Around:
    course = course_of(task)
    rng = np.random.default_rng(seed)
    coefficients = course.nominal.copy()
    coefficients[:, course.grid.free] += rng.normal(
        scale=0.05, size=coefficients[:, course.grid.free].shape
    )
    pieces = course.grid.pieces_of(coefficients)
    scaled = pieces * course.scale[:, None]
    planes = planes_between(scaled, close_pieces(scaled, 2.0))
    walls = walls_before(
        pieces, task.requirements.keep_out, task.requirements.separation.radius, 0.8
    )
    return Around(coefficients, 4.2, 0.3, planes, walls)


def test_a_program_can_always_be_met_by_staying() -> None:
    task = crossing_task(keep_out=(PILLAR,), arena=Arena([-3, -3, 0], [3, 3, 2]))
    course, around = course_of(task), around_of(task, 1)
    program = build_program(course, around).program
    unknowns = around.coefficients[:, course.grid.free].size
    x = np.zeros(len(program.q))
    x[unknowns:] = 1e3  # slacks as large as wanted
    values = np.asarray(program.A @ x)
    assert np.all(values >= program.lower - 1e-9)
    assert np.all(values <= program.upper + 1e-9)


def test_rows_are_what_the_moved_curves_do() -> None:
    task = crossing_task(keep_out=(PILLAR,), tethers=(Tether(0, 2, 3.0),))
    course, around = course_of(task), around_of(task, 2)
    built = build_program(course, around)
    unknowns = around.coefficients[:, course.grid.free].size
    x = np.zeros(len(built.program.q))
    x[:unknowns] = np.random.default_rng(3).uniform(-1.0, 1.0, unknowns)
    pieces = course.grid.pieces_of(built.moved(x))
    between, normals = around.planes.between, around.planes.normals
    offset = (pieces[between.piece, between.first] - pieces[between.piece, between.second]) * (
        course.scale[:, None]
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
    first = built.kept_rows
    rows = slice(first, first + len(expected))
    assert len(walls) > 0
    live = np.isfinite(built.program.lower[rows])
    assert np.any(live)
    wanted = built.program.lower[rows] - np.asarray(built.program.A @ x)[rows]
    np.testing.assert_allclose((1.01 - expected)[live], wanted[live], atol=1e-9)


def test_the_objective_is_the_integral_and_its_slope_the_gradient() -> None:
    task = crossing_task()
    course, around = course_of(task), around_of(task, 4)
    built = build_program(course, around)
    program = built.program
    unknowns = around.coefficients[:, course.grid.free].size
    full = program.P + sp.triu(program.P, 1).T

    def value(x: np.ndarray) -> float:
        return float(0.5 * x @ (full @ x) + program.q @ x)

    s = np.linspace(0.0, 1.0, 60_001)
    basis, bends = course.grid.sampled(s), course.grid.sampled(s, 3)

    def integral(x: np.ndarray) -> float:
        moved = built.moved(x)
        offset = np.einsum("sc,ncd->snd", basis, moved - course.nominal)
        bend = np.einsum("sc,ncd->snd", bends, moved)
        density = np.sum(offset**2, axis=(1, 2)) + 3e-7 * np.sum(bend**2, axis=(1, 2))
        return float(np.trapezoid(density, s)) / (course.size**2 * task.drones)

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
        np.testing.assert_allclose(found.x, by_slsqp(P, q, A.toarray(), lower), atol=3e-3)
        assert found.residual < 3e-3
        values = A.toarray() @ found.x
        broken = max(0.0, float(np.max(lower - values)), float(np.max(values + lower)))
        assert found.residual == pytest.approx(broken, abs=1e-12)


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
    ways = ways_around(task)
    off = 1.25 * task.requirements.separation.radius
    corners = [[-0.3 - off, 0.4 + off], [0.5 + off, 0.4 + off]]
    by_hand = np.vstack([start[0, :2], corners, goal[0, :2]])
    length = float(np.sum(np.linalg.norm(np.diff(by_hand, axis=0), axis=1)))
    assert ways.lengths[0] == pytest.approx(length, rel=1e-6)
    points = ways.of(0, np.linspace(0.0, 1.0, 500))
    assert np.min(PILLAR.clearance(points).distance) > task.requirements.separation.radius
    np.testing.assert_allclose(points[[0, -1]], [start[0], goal[0]], atol=1e-12)


def test_a_low_prism_is_flown_over_where_that_is_shorter() -> None:
    low = Prism(PILLAR.polygon, 0.0, 0.9)
    start, goal = np.array([[-2.0, 0.1, 0.8]]), np.array([[2.0, 0.0, 0.8]])
    ways = ways_around(
        SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(low,)))
    )
    assert np.max(ways.of(0, np.linspace(0.0, 1.0, 99))[:, 2]) > 1.0
    assert ways.lengths[0] < 4.2


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
        ways_around(task)
    assert caught.value.violations[0].value == pytest.approx(0.08, rel=2e-3)
    assert caught.value.violations[0].where == ("d0",)


def test_departures_leave_nobody_to_meet() -> None:
    n = 5
    line = np.linspace(-1.0, 1.0, n)
    start = np.column_stack([np.full(n, -3.0), line, np.full(n, 1.0)])
    goal = start * [-1.0, -1.0, 1.0]
    task = SeparationTask(start, goal, Requirements(Limits(), Separation()))
    ways = ways_around(task)
    shares, ramps = np.full(n, 0.4), np.full(n, 0.2)
    leaving = departures(ways, shares, ramps, task.requirements.separation.scale)
    assert np.all(leaving + shares <= 1.0 + 1e-12)
    time = np.linspace(0.0, 1.0, 400)
    points = np.stack(
        [ways.of(i, progress_along((time - leaving[i]) / 0.4, 0.2)) for i in range(n)]
    )
    scaled = points * task.requirements.separation.scale
    i, j = np.triu_indices(n, 1)
    assert np.min(np.linalg.norm(scaled[i] - scaled[j], axis=-1)) > 1.0


def test_guesses_push_samples_apart_and_keep_the_ends() -> None:
    course = course_of(crossing_task())
    guess = pushed_apart(course, Manners(0.5))
    np.testing.assert_array_equal(guess[:, :HELD], course.nominal[:, :HELD])
    np.testing.assert_array_equal(guess[:, -HELD:], course.nominal[:, -HELD:])

    def smallest(coefficients: np.ndarray) -> float:
        s = np.linspace(0.0, 1.0, 300)
        points = course.grid.curves(coefficients, 1.0).at(s) * course.scale
        i, j = np.triu_indices(3, 1)
        return float(np.min(np.linalg.norm(points[:, i] - points[:, j], axis=-1)))

    assert smallest(course.nominal) < 0.5
    assert smallest(guess) > 1.0


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
