"""The fastest rate of a clock: its rows by other formulas, its optimum by another solver."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline
from scipy.optimize import NonlinearConstraint, minimize

from hitchopt import Limits, Team
from hitchopt.planners.timing.demands import LIMIT_SHARE, Demands
from hitchopt.planners.timing.fastest_rate import RateProgram, SplineBasis, fastest_rate
from hitchopt.planners.timing.rate_rows import ClockedPath, RateRows

LIMITS = Limits(speed=1.1, acceleration=1.7, jerk=9.0, tilt=math.radians(24.0))
few = settings(max_examples=20)


def clocked(seed: int, samples: int, robots: int = 3) -> ClockedPath:
    """Drones on smooth curves of τ in [0, 1], no two alike, pulled by cables."""
    rng = np.random.default_rng(seed)
    tau = np.linspace(0.0, 1.0, samples)[:, None, None]
    team = Team(robots, 2.0)
    drones = 2 * robots
    size, phase = rng.uniform(0.1, 0.3, (drones, 3)), rng.uniform(0.0, 6.0, (drones, 3))
    rate = rng.uniform(1.0, 3.0, (drones, 3))
    first, second, third = (
        size * rate**k * np.sin(rate * tau + phase + k * np.pi / 2.0) for k in (1, 2, 3)
    )
    pull = rng.normal(scale=0.1, size=(drones, 3))
    loads = np.broadcast_to(
        team.mass[:, None] * np.array([0.0, 0.0, 9.81]) - pull, (samples, drones, 3)
    )
    jets = np.stack([np.zeros_like(first), first, second, third], axis=-1)
    demands = Demands(jets, np.zeros(samples), loads, team.mass, team.max_thrust, LIMITS)
    return ClockedPath(demands, first, second, third, np.full(samples, 1.5))


def every_drone(path: ClockedPath) -> np.ndarray:
    samples, drones = path.first.shape[:2]
    return np.broadcast_to(np.arange(drones), (4, samples, drones))


def program(seed: int, pieces: int = 6, robots: int = 3) -> RateProgram:
    knots = np.linspace(0.0, 1.0, pieces + 1)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    tau = (knots[:-1, None] + 0.5 / pieces * (1.0 + nodes)).ravel()
    path = clocked(seed, len(tau), robots)
    spline = make_interp_spline(knots, np.ones(len(knots)), k=3)
    return RateProgram(
        SplineBasis.of(spline, tau),
        RateRows.of(path, every_drone(path)),
        np.tile(0.5 / pieces * weights, pieces),
    )


@few
@given(st.integers(0, 10_000))
def test_a_row_is_kept_where_its_limit_is(seed: int) -> None:
    path = clocked(seed, 7)
    rows = RateRows.of(path, every_drone(path))
    rng = np.random.default_rng(seed)
    p = np.column_stack(
        [rng.uniform(0.05, 2.0, 7), rng.normal(scale=2.0, size=7), rng.normal(scale=9.0, size=7)]
    )
    ratios = path.ratios(*p.T)
    values = rows.values(p)
    np.testing.assert_array_equal(values[:, 0] <= 0.0, p[:, 0] <= 1.5)
    kept = np.moveaxis(ratios <= LIMIT_SHARE, 0, 1).reshape(7, -1)
    np.testing.assert_array_equal(values[:, 1:] <= 0.0, kept)


@few
@given(st.integers(0, 10_000))
def test_ratios_are_those_of_a_flight_by_that_clock(seed: int) -> None:
    """Of q(τ(t)) by differences of time, where τ follows dτ/dt = √x for a quadratic x."""
    path = clocked(seed, 3)
    x, x1, x2 = 0.8, 0.5, -0.7
    ratios = path.ratios(*(np.full(3, v) for v in (x, x1, x2)))[:, 1]
    q1, q2, q3 = (d[1] for d in (path.first, path.second, path.third))
    h = 1e-3
    t = h * np.arange(-2, 3)
    # τ(t) from its derivatives √x, x'/2, x'' √x / 2 at t = 0, and q by its Taylor polynomial.
    tau = math.sqrt(x) * t + x1 / 4.0 * t**2 + x2 * math.sqrt(x) / 12.0 * t**3
    tau = tau[:, None, None]
    q = q1 * tau + q2 * tau**2 / 2.0 + q3 * tau**3 / 6.0
    acceleration = (q[3] - 2.0 * q[2] + q[1]) / h**2
    jerk = (q[4] - 2.0 * q[3] + 2.0 * q[1] - q[0]) / (2.0 * h**3)
    expected = np.linalg.norm(acceleration, axis=-1) / LIMITS.acceleration
    np.testing.assert_allclose(ratios[0], expected, rtol=1e-3, atol=1e-5)
    expected = np.linalg.norm(jerk, axis=-1) / LIMITS.jerk
    np.testing.assert_allclose(ratios[1], expected, rtol=2e-3, atol=1e-4)


@few
@given(st.integers(0, 10_000))
def test_derivatives_of_rows_by_differences(seed: int) -> None:
    path = clocked(seed, 4)
    rows = RateRows.of(path, every_drone(path))
    rng = np.random.default_rng(seed)
    p = np.column_stack([rng.uniform(0.3, 2.0, 4), rng.normal(size=(4, 2))])
    weights = rng.uniform(0.0, 1.0, rows.c.shape)
    step = 1e-6
    gradients, curvature = rows.gradients(p), rows.curvature(p, weights)
    for i in range(3):
        shift = step * np.eye(3)[i]
        difference = (rows.values(p + shift) - rows.values(p - shift)) / (2.0 * step)
        np.testing.assert_allclose(gradients[..., i], difference, rtol=1e-5, atol=1e-6)
        change = (rows.gradients(p + shift) - rows.gradients(p - shift)) / (2.0 * step)
        bent = np.einsum("mr,mri->mi", weights, change)
        np.testing.assert_allclose(curvature[:, i], bent, rtol=1e-5, atol=1e-5)
    convex = np.linalg.eigvalsh(rows.curvature(p, weights, convex=True))
    assert np.min(convex) >= -1e-12 * np.max(convex)
    least = np.linalg.eigvalsh(rows.curvature(p, weights, convex=True) - curvature)
    assert np.min(least) >= -1e-9  # what is left out bends the other way


def test_the_basis_is_the_splines_and_its_products_are_those_of_matrices() -> None:
    rng = np.random.default_rng(1)
    knots = np.cumsum(rng.uniform(0.1, 0.4, 9))
    spline = make_interp_spline(knots, rng.normal(size=9), k=3)
    at = rng.uniform(knots[0], knots[-1], 40)
    basis = SplineBasis.of(spline, at)
    for order in range(3):
        np.testing.assert_allclose(basis.at(spline.c)[:, order], spline(at, order), atol=1e-10)
    dense = np.zeros((40, 3, basis.count))
    for i in range(basis.count):
        dense[..., i] = basis.at(np.eye(basis.count)[i])
    forces = rng.normal(size=(40, 3))
    np.testing.assert_allclose(
        basis.transposed(forces), np.einsum("mo,moi->i", forces, dense), atol=1e-9
    )
    forms = rng.normal(size=(40, 3, 3))
    forms = forms + np.swapaxes(forms, 1, 2)
    whole = np.einsum("moi,mop,mpj->ij", dense, forms, dense)
    band = basis.banded(forms)
    for d in range(4):
        diagonal = np.diagonal(whole, -d)
        np.testing.assert_allclose(band[d, : len(diagonal)], diagonal, atol=1e-9)
    assert np.max(np.abs(np.tril(whole, -4))) < 1e-12


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_rate_is_as_fast_as_another_solver_finds_it(seed: int) -> None:
    task = program(seed)
    start = np.full(task.basis.count, 0.02)
    assert task.slack(start) is not None
    found = fastest_rate(task, start)
    slack = task.slack(found)
    assert slack is not None
    assert task.duration(found) < 0.5 * task.duration(start)
    other = minimize(
        task.duration,
        0.9 * found,
        method="SLSQP",
        bounds=[(1e-3, 10.0)] * task.basis.count,
        constraints=NonlinearConstraint(
            lambda c: task.rows.values(task.basis.at(c)).ravel(), -np.inf, 0.0
        ),
        options={"maxiter": 200, "ftol": 1e-10},
    )
    assert other.success
    assert task.duration(found) <= (1.0 + 1e-4) * other.fun


@pytest.mark.parametrize("seed", [3, 4])
def test_no_rate_nearby_is_faster(seed: int) -> None:
    task = program(seed, pieces=12)
    found = fastest_rate(task, np.full(task.basis.count, 0.02))
    rng = np.random.default_rng(seed)
    tried = [
        found * (1.0 + size * rng.normal(size=found.shape))
        for size in np.repeat([1e-3, 1e-2, 0.1], 200)
    ]
    kept = [c for c in tried if task.slack(c) is not None]
    assert all(task.duration(c) > (1.0 - 1e-4) * task.duration(found) for c in kept)
    # All of it a little faster breaks something.
    assert task.slack(1.002 * found) is None


def test_a_start_that_breaks_a_row_is_given_back() -> None:
    task = program(5)
    start = np.full(task.basis.count, 50.0)
    assert task.slack(start) is None
    np.testing.assert_array_equal(fastest_rate(task, start), start)


def test_more_room_costs_no_time() -> None:
    """A row less: the optimum of the others."""
    fewer, more = program(6, robots=3), program(6, robots=3)
    rows = fewer.rows
    loose = RateRows(
        *(part[:, :7] for part in (rows.Q, rows.C, rows.b, rows.c, rows.e))
    )  # speed and acceleration alone
    start = np.full(fewer.basis.count, 0.02)
    quick = fastest_rate(RateProgram(fewer.basis, loose, fewer.weights), start)
    assert fewer.duration(quick) <= (1.0 + 1e-5) * more.duration(fastest_rate(more, start))
