"""Timing: jets, what limits allow, optima known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import Hitch, InfeasibleError, Limits, Separation, Team
from hitchopt.geometry import regular_polygon
from hitchopt.planners.morph import jets
from hitchopt.planners.morph.path import ShapePath, drones_along
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.flight import GRID, Flight, fly, needed_stretch
from hitchopt.planners.timing.profile import (
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


def test_the_flight_is_smooth_at_rest_at_its_ends_and_follows_the_model() -> None:
    limits = Limits()
    path = straight(5, 2, limits)
    flight = fly(path, limits)
    for part in (flight.drones, flight.vertices, flight.legs):
        for order in range(3):
            left, right = part.ends(order)
            np.testing.assert_allclose(left[1:], right[:-1], atol=1e-9)
        for order in (1, 2):
            np.testing.assert_allclose(part.at([0.0, flight.duration], order), 0.0, atol=1e-9)
    t = np.linspace(0.0, flight.duration, 501)
    p = flight.vertices.at(t)
    first, last = path.vertices.at([0.0, 1.0])
    along = last - first
    s = np.einsum("tkc,kc->tk", p - first, along) / np.sum(along**2, axis=1)
    np.testing.assert_allclose(s, s[:, :1] * np.ones(5), atol=1e-9)  # all at one pace, straight
    np.testing.assert_allclose(p, first + s[..., None] * along, atol=1e-9)
    exact = drones_along(path, np.clip(s[:, 0], 0.0, 1.0))
    np.testing.assert_allclose(flight.drones.at(t), exact.positions[..., 0], atol=2e-6)
    np.testing.assert_allclose(flight.legs.at(t), exact.legs[..., 0], atol=2e-6)


def test_a_duration_is_met_exactly_or_refused() -> None:
    limits = Limits()
    path = straight(3, 4, limits)
    fastest = fly(path, limits)
    slow = fly(path, limits, 7.25)
    assert slow.duration == 7.25
    np.testing.assert_allclose(slow.drones.at(7.25), fastest.drones.at(fastest.duration))
    with pytest.raises(InfeasibleError, match="duration") as caught:
        fly(path, limits, 0.9 * fastest.duration)
    assert caught.value.violations[0].limit == pytest.approx(fastest.duration, rel=1e-6)


@pytest.mark.parametrize("distance", [1e-6, 1e-4])
def test_tiny_paths_are_timed(distance: float) -> None:
    limits = Limits()
    path = straight(3, 6, limits, (distance, 0.0))
    flight = fly(path, limits)
    assert 4.0 * (distance / 40.0) ** (1 / 3) <= flight.duration <= 0.2
    assert max(worst_ratio(path, limits, flight).values()) <= 1.0


def test_timing_does_not_care_where_or_how_turned() -> None:
    limits = Limits()
    team = Team(6, 2.0)
    first, second = regular_polygon(6, 1.3), regular_polygon(6, 1.35, 0.05)
    times = []
    for angle, offset in ((0.0, (0.0, 0.0)), (1.1, (3.0, -2.0))):
        pair = [Hitch.balanced(team, p.rotated(angle).translated(offset)) for p in (first, second)]
        times.append(fly(ShapePath.straight(*pair), limits).duration)
    assert times[1] == pytest.approx(times[0], rel=1e-4)


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
@pytest.mark.parametrize(
    "values",
    [
        {"speed": 1e-3},
        {"vertex_speed": 2e-3},
        {"speed": 1e-4, "jerk": 0.1},
        {"acceleration": 0.01},
        {"jerk": 0.05},
        {"speed": 1.5, "acceleration": 1.3, "jerk": 103.0, "vertex_speed": 0.12},
        {"acceleration": 1e4},
    ],
    ids=str,
)
def test_limits_of_all_sizes_only_scale_the_time(values: dict[str, float]) -> None:
    limits = Limits(**values)
    path = straight(3, 12, limits)
    flight = fly(path, limits)
    assert max(worst_ratio(path, limits, flight).values()) <= 1.0
    fine = path_grid(2000)
    exact = Demands.along(path, limits, fine)
    optimum = fastest_profile(fine, exact).duration
    assert flight.duration <= 1.03 * optimum + limits.acceleration / limits.jerk


def test_a_long_way_costs_no_more_than_its_ramps() -> None:
    """30 m at 0.5 m/s: the pieces of the ramps must not be as long as those of the cruise."""
    limits = Limits()
    flight = fly(straight(3, 4, limits, (30.0, 0.0)), limits)
    v, a, j = 0.5, 2.0, 20.0
    optimum = 30.0 / v + v / a + a / j
    assert optimum <= flight.duration <= 1.01 * optimum


@pytest.mark.parametrize(
    ("tight", "order", "limit"),
    [
        (Limits(speed=0.3), 1, 0.3),
        (Limits(acceleration=0.2), 2, 0.2),
        (Limits(jerk=0.5), 3, 0.5),
    ],
    ids=["speed", "acceleration", "jerk"],
)
def test_the_stretch_leaves_the_certificate_a_share_of_every_limit(
    tight: Limits, order: int, limit: float
) -> None:
    """Flown at what the stretch allows, the largest rate is under 99.96 % of its limit."""
    path = straight(4, 3, tight, (1.0, 0.5))
    flight = fly(path, tight)
    for factor in (1.0, 0.5):
        faster = flight.lasting(factor * flight.duration)
        slower = needed_stretch(path.team, tight, faster.drones, faster.vertices, faster.pulls)
        assert slower == pytest.approx(1.0 / factor, rel=1e-9)
        t = np.linspace(0.0, faster.duration, 40001)
        rate = np.max(np.linalg.norm(faster.drones.at(t, order), axis=-1)) / slower**order
        assert 0.99 * limit < rate < 0.9996 * limit


def test_the_stretch_leaves_the_certificate_a_share_of_the_vertices_speed() -> None:
    tight = Limits(vertex_speed=0.1)
    flight = fly(straight(4, 3, tight, (1.0, 0.5)), tight)
    t = np.linspace(0.0, flight.duration, 40001)
    fastest = np.max(np.linalg.norm(flight.vertices.at(t, 1), axis=-1))
    assert 0.099 < fastest < 0.09996


@pytest.mark.parametrize(
    "limits", [Limits(), Limits(speed=0.5, vertex_speed=5.0, acceleration=1.0)]
)
@pytest.mark.parametrize("seed", range(4))
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
