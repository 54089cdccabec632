"""The fastest rate of a clock: its rows by other formulas, its optimum by another solver."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline
from scipy.optimize import NonlinearConstraint, minimize

from hitchopt import Limits, Team
from hitchopt.planners.timing.clock import (
    ClockedPath,
    RateProgram,
    RateRows,
    SplineBasis,
    fastest_rate,
)
from hitchopt.planners.timing.profile import Demands

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
    demands = Demands(jets, np.zeros(samples), loads, team, LIMITS)
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
def test_derivatives_of_rows_by_differences(seed: int) -> None:
    path = clocked(seed, 4)
    rows = RateRows.of(path, every_drone(path))
    rng = np.random.default_rng(seed)
    p = np.vstack([rng.uniform(0.3, 2.0, 4), rng.normal(size=(2, 4))])
    weights = rng.uniform(0.0, 1.0, rows.c.shape)
    step = 1e-6
    gradients, curvature = rows.gradients(p), rows.curvature(p, weights)
    for i in range(3):
        shift = step * np.eye(3)[:, i : i + 1]
        difference = (rows.values(p + shift) - rows.values(p - shift)) / (2.0 * step)
        np.testing.assert_allclose(gradients[i], difference, rtol=1e-5, atol=1e-6)
        change = (rows.gradients(p + shift) - rows.gradients(p - shift)) / (2.0 * step)
        bent = np.einsum("rm,irm->im", weights, change)
        np.testing.assert_allclose(curvature[i], bent, rtol=1e-5, atol=1e-5)
    convex = np.linalg.eigvalsh(rows.curvature(p, weights, convex=True).T)
    assert np.min(convex) >= -1e-12 * np.max(convex)
    least = np.linalg.eigvalsh((rows.curvature(p, weights, convex=True) - curvature).T)
    assert np.min(least) >= -1e-9  # what is left out bends the other way


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_rate_is_as_fast_as_another_solver_finds_it(seed: int) -> None:
    task = program(seed)
    start = np.full(task.basis.count, 0.02)

    def seconds(c: np.ndarray) -> float:
        return task.duration(task.basis.at(c))

    assert task.slack(start) is not None
    found = fastest_rate(task, start)
    slack = task.slack(found)
    assert slack is not None
    assert seconds(found) < 0.5 * seconds(start)
    other = minimize(
        seconds,
        0.9 * found,
        method="SLSQP",
        bounds=[(1e-3, 10.0)] * task.basis.count,
        constraints=NonlinearConstraint(
            lambda c: task.rows.values(task.basis.at(c)).ravel(), -np.inf, 0.0
        ),
        options={"maxiter": 200, "ftol": 1e-10},
    )
    assert other.success
    assert seconds(found) <= (1.0 + 1e-4) * other.fun
