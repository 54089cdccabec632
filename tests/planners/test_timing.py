"""Timing: jets, what limits allow, optima known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import Hitch, Limits, Separation, Team
from hitchopt.planners.morph import jets
from hitchopt.planners.morph.path import ShapePath, drones_along
from hitchopt.planners.timing.flight import GRID, Flight, fly
from hitchopt.planners.timing.profile import (
    Demands,
    SpeedProfile,
    TimingError,
    fastest_profile,
    flight_estimate,
    path_grid,
)
from problems.random_morph import random_convex_polygon

FREE = {"vertex_speed": 100.0, "tilt": 1.5}


def polynomial_jet(coefficients: np.ndarray, t: float) -> np.ndarray:
    return np.array([np.polyval(np.polyder(coefficients, k), t) for k in range(4)])


@given(st.integers(0, 2**32 - 1), st.floats(-0.5, 0.5))
@settings(max_examples=40)
def test_jet_arithmetic_is_that_of_polynomials(seed: int, t: float) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 4))
    ja, jb = polynomial_jet(a, t), polynomial_jet(b, t)
    np.testing.assert_allclose(jets.product(ja, jb), polynomial_jet(np.polymul(a, b), t), atol=1e-9)
    composed = np.poly1d(a)(np.poly1d(b))
    outer = polynomial_jet(a, jb[0])
    np.testing.assert_allclose(
        jets.chained(outer, jb), polynomial_jet(np.atleast_1d(composed.c), t), rtol=1e-7, atol=1e-7
    )
    square = polynomial_jet(np.polyadd(np.polymul(b, b), [1.0]), t)
    root = jets.square_root(square)
    np.testing.assert_allclose(jets.product(root, root), square, atol=1e-9)


def straight(
    n: int, seed: int, limits: Limits, offset: tuple[float, float] | None = None
) -> ShapePath:
    """A random morph, or a rigid shift by ``offset``."""
    rng = np.random.default_rng(seed)
    first = random_convex_polygon(n, 1.0, rng)
    second = (
        first.translated(offset)
        if offset is not None
        else first.scaled(1.08).rotated(0.1).translated(rng.normal(scale=0.4, size=2))
    )
    team = Team(n, 2.2, tension=rng.uniform(0.38, 0.42, n))
    start = Hitch.balanced(team, first)
    end = Hitch.nearest(team, second, 1.0, start.fractions, limits=limits, separation=Separation())
    return ShapePath.straight(start, end)


def demands(path: ShapePath, limits: Limits, count: int = 201) -> Demands:
    s = np.linspace(0.0, 1.0, count)
    return Demands.along(path, limits, s)


def profile_of(path: ShapePath, limits: Limits) -> SpeedProfile:
    grid = path_grid(GRID)
    return fastest_profile(grid, Demands.along(path, limits, grid))


@pytest.mark.parametrize("distance", [0.1, 0.6, 3.0])
def test_a_rigid_shift_takes_the_known_time(distance: float) -> None:
    """Trapezoids: without a jerk limit D/v + v/a, with one a/j more (in the long case)."""
    v, a, j = 0.8, 2.0, 20.0
    limits = Limits(speed=v, acceleration=a, jerk=j, **FREE)
    path = straight(4, 3, limits, (0.6 * distance, 0.8 * distance))
    bang = distance / v + v / a if distance > v * v / a else 2.0 * math.sqrt(distance / a)
    flight = fly(path, limits)
    assert profile_of(path, limits).duration == pytest.approx(bang, rel=2e-3)
    # The jerk-limited optimum in closed form.
    ramp = a / j
    if distance >= v * (v / a + ramp):
        optimum = distance / v + v / a + ramp
    else:
        optimum = ramp + math.sqrt(ramp**2 + 4.0 * distance / a)
        if 2.0 * ramp > optimum / 2.0:  # the acceleration's limit is not reached
            optimum = 4.0 * (distance / (2.0 * j)) ** (1.0 / 3.0)
    assert optimum <= flight.duration <= 1.02 * optimum


def worst_ratio(path: ShapePath, limits: Limits, flight: Flight) -> dict[str, float]:
    """Largest share of each limit in use, sampled, forces through the model."""
    t = np.linspace(0.0, flight.duration, 4001)
    v, a, j = (np.linalg.norm(flight.drones.at(t, k), axis=-1).max() for k in (1, 2, 3))
    vertex = np.linalg.norm(flight.vertices.at(t, 1), axis=-1).max()
    first, last = path.vertices.at([0.0, 1.0])
    along = last - first
    k = int(np.argmax(np.linalg.norm(along, axis=1)))
    s = (flight.vertices.at(t)[:, k] - first[k]) @ along[k] / (along[k] @ along[k])
    force = (
        path.team.mass[:, None] * (flight.drones.at(t, 2) + [0.0, 0.0, 9.81])
        - drones_along(path, np.clip(s, 0.0, 1.0)).cable_forces
    )
    tilt = np.arctan2(np.hypot(force[..., 0], force[..., 1]), force[..., 2]).max()
    thrust = (np.linalg.norm(force, axis=-1) / path.team.max_thrust).max()
    return {
        "speed": v / limits.speed,
        "acceleration": a / limits.acceleration,
        "jerk": j / limits.jerk,
        "vertex_speed": vertex / limits.vertex_speed,
        "thrust": thrust,
        "tilt": tilt / limits.tilt,
    }


@pytest.mark.parametrize(
    ("limits", "binding"),
    [
        (Limits(), "vertex_speed"),
        (Limits(vertex_speed=9.0, speed=0.4), "speed"),
        (Limits(vertex_speed=9.0, speed=9.0, jerk=200.0), "acceleration"),
        (Limits(vertex_speed=9.0, speed=9.0), "jerk"),
        (Limits(vertex_speed=9.0, speed=9.0, tilt=math.radians(21.0)), "tilt"),
    ],
)
@pytest.mark.parametrize("n", [3, 5])
def test_limits_hold_one_binds_and_the_duration_is_near_the_optimum(
    limits: Limits, binding: str, n: int
) -> None:
    path = straight(n, 10 + n, limits)
    flight = fly(path, limits)
    ratios = worst_ratio(path, limits, flight)
    assert max(ratios.values()) <= 1.0
    assert ratios[binding] >= 0.985
    fine = np.linspace(0.0, 1.0, 1001)
    exact = Demands.along(path, limits, fine)
    optimum = fastest_profile(fine, exact).duration
    assert flight.duration <= 1.03 * optimum + limits.acceleration / limits.jerk


@pytest.mark.parametrize(
    "limits", [Limits(), Limits(speed=0.5, vertex_speed=5.0, acceleration=1.0)]
)
@pytest.mark.parametrize("seed", range(2))
def test_flights_take_a_little_longer_than_their_estimates(seed: int, limits: Limits) -> None:
    path = straight(3 + seed, seed, limits)
    least, flight = flight_estimate(path, limits), fly(path, limits)
    assert 0.995 * flight.duration - 0.05 < least < flight.duration


def test_a_path_that_cannot_be_held_at_rest_takes_forever() -> None:
    limits = Limits(tilt=math.radians(10.0))
    path = straight(4, 3, limits)
    assert flight_estimate(path, limits) == math.inf
    with pytest.raises(TimingError):
        fly(path, limits)
