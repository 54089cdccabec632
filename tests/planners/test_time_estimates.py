"""Estimates of flights' durations, against toppra and against the flights themselves."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hitchopt import Hitch, Limits, Team
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.fly_path import fly
from hitchopt.planners.timing.speed_profile import TimingError, fastest_profile, path_grid
from hitchopt.planners.timing.time_estimates import flight_estimate, quick_profile
from problems.random_morph import random_convex_polygon

LIMITS = (
    Limits(),
    Limits(speed=0.5, vertex_speed=5.0, acceleration=1.0),
    Limits(speed=3.0, vertex_speed=3.0, tilt=math.radians(20.0), jerk=60.0),
)


def morph(seed: int) -> ShapePath:
    """A random turn and shift, off the origin."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    first = random_convex_polygon(n, 1.2, rng, 0.18)
    last = first.rotated(rng.uniform(-0.4, 0.4)).translated(0.3 * rng.normal(size=2))
    team = Team(n, 2.4, tension=rng.uniform(0.38, 0.42, n))
    return ShapePath.straight(Hitch.balanced(team, first), Hitch.balanced(team, last))


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", range(4))
def test_the_quick_profile_takes_as_long_as_toppras(seed: int, limits: Limits) -> None:
    path, s = morph(seed), path_grid(160)
    demands = Demands.along(path, limits, s)
    quick, exact = quick_profile(s, demands), fastest_profile(s, demands)
    assert quick.duration == pytest.approx(exact.duration, rel=2e-3)
    assert quick.speed[0] == quick.speed[-1] == 0.0
    assert (
        flight_estimate(path, limits) < 1.003 * exact.duration + limits.acceleration / limits.jerk
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_quick_profile_keeps_all_limits_at_its_points(seed: int) -> None:
    path, limits, s = morph(seed), LIMITS[0], path_grid(100)
    demands = Demands.along(path, limits, s)
    profile = quick_profile(s, demands)
    x = profile.speed**2
    u = 0.5 * np.diff(x) / np.diff(s)
    # A motion keeps its limits where the ray towards it reaches it.
    assert np.min(demands.reach(np.append(u, 0.0)[:, None], x[:, None])[:-1]) > 1.0 - 1e-9
    assert np.all(x <= demands.speed_bound * (1.0 + 1e-9))


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", range(4))
def test_rounding_does_not_change_a_profile(seed: int, limits: Limits) -> None:
    """At a limit of speed corners tie."""
    rng, s = np.random.default_rng(seed), path_grid(80)
    demands = Demands.along(morph(seed), limits, s)
    duration = quick_profile(s, demands).duration
    for _ in range(5):
        noise = 1.0 + 1e-14 * rng.normal(size=demands.drones.shape)
        other = replace(demands, drones=demands.drones * noise)
        assert quick_profile(s, other).duration == pytest.approx(duration, rel=1e-9)


@pytest.mark.parametrize("limits", LIMITS[:2])
@pytest.mark.parametrize("seed", range(4))
def test_flights_take_a_little_longer_than_their_estimates(seed: int, limits: Limits) -> None:
    path = morph(seed)
    least, flight = flight_estimate(path, limits), fly(path, limits)
    assert 0.995 * flight.duration - 0.05 < least < flight.duration


def test_a_path_that_cannot_be_held_at_rest_takes_forever() -> None:
    path, limits = morph(0), Limits(tilt=math.radians(5.0))
    assert flight_estimate(path, limits) == math.inf
    with pytest.raises(TimingError, match="no speed profile"):
        quick_profile(path_grid(8), Demands.along(path, limits, path_grid(8)))
