"""Timing: jets, what limits allow, optima known in closed form."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toppra import SplineInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, LinearConstraint
from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

from hitchopt import Hitch, InfeasibleError, Limits, Quadrotor, Separation, Team
from hitchopt.geometry import regular_polygon
from hitchopt.planners.path import jets
from hitchopt.planners.path.shape_path import ShapePath, drones_along
from hitchopt.planners.timing import demands as timing_demands
from hitchopt.planners.timing import stretch
from hitchopt.planners.timing.demands import LIMIT_SHARE, Demands
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.fly_path import GRID, fly, time_mesh
from hitchopt.planners.timing.speed_profile import (
    SpeedProfile,
    acceleration_rows,
    allowed_corners,
    fastest_profile,
    path_grid,
)
from hitchopt.planners.timing.stretch import needed_stretch
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


@given(st.integers(0, 2**32 - 1), st.integers(3, 6))
@settings(max_examples=10)
def test_the_rows_allow_what_the_limits_allow_and_nothing_else(seed: int, n: int) -> None:
    limits = Limits(speed=0.7, acceleration=1.5, tilt=math.radians(25.0))
    found = demands(straight(n, seed, limits), limits, 5)
    rows = acceleration_rows(allowed_corners(found))
    rng = np.random.default_rng(seed)
    q1, q2 = found.drones[..., 1], found.drones[..., 2]
    largest_x, largest_u = found.speed_bound, 1.5 / np.linalg.norm(q1, axis=-1).max(axis=1)
    for _ in range(300):
        j = rng.integers(5)
        u, x = largest_u[j] * rng.uniform(-1.2, 1.2), largest_x[j] * rng.uniform(0.0, 1.2)
        a = q1[j] * u + q2[j] * x
        force = found.mass[:, None] * a + found.loads[j]
        ratio = max(
            np.max(np.linalg.norm(a, axis=-1)) / 1.5,
            np.max(np.linalg.norm(force, axis=-1) / found.max_thrust),
            np.max(np.arctan2(np.hypot(force[:, 0], force[:, 1]), force[:, 2])) / limits.tilt,
            np.max(np.linalg.norm(q1[j], axis=-1)) * math.sqrt(x) / 0.7,
            found.vertex_speed[j] * math.sqrt(x) / 0.5,
        )
        allowed = bool(np.all(rows.normals[j] @ [u, x] <= rows.bounds[j] + 1e-12))
        if allowed:
            assert ratio <= LIMIT_SHARE + 1e-9
        elif ratio < LIMIT_SHARE:
            # Only the chords' narrow margin is lost.
            assert not np.all(rows.normals[j] @ [0.995 * u, 0.995 * x] <= rows.bounds[j]) or (
                ratio > 0.98 * LIMIT_SHARE
            )


def test_rows_are_the_same_however_many_rays_are_cast_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = demands(straight(5, 3, Limits()), Limits(), 40)
    rows = {}
    for chunk in (1, 3000, 10**9):
        monkeypatch.setattr(timing_demands, "CHUNK", chunk)
        rows[chunk] = acceleration_rows(allowed_corners(found))
    for other in (rows[1], rows[3000]):  # products of matrices of another size round otherwise
        np.testing.assert_allclose(other.normals, rows[10**9].normals, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(other.bounds, rows[10**9].bounds, rtol=1e-12)


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


@pytest.mark.parametrize("tilt", [math.radians(45.0), math.radians(22.0)])
@pytest.mark.parametrize("seed", range(3))
def test_profiles_are_those_of_toppras_own_classes(seed: int, tilt: float) -> None:
    limits = Limits(tilt=tilt)
    grid = path_grid(GRID)
    found = Demands.along(straight(3 + seed, seed, limits), limits, grid)
    rows = acceleration_rows(allowed_corners(found))

    class Rule(LinearConstraint):  # type: ignore[misc]
        identical = False
        discretization_type = DiscretizationType.Interpolation

        def compute_constraint_params(
            self, _path: object, grid: np.ndarray, *_: object
        ) -> tuple[object, ...]:
            count = len(grid)
            columns = (np.tile(row, (count, 1)) for row in ([1.0, 0.0], [0.0, 1.0], [0.0, 0.0]))
            both = (*columns, rows.normals, rows.bounds, None, None, grid)
            return tuple(canlinear_colloc_to_interpolate(*both))

    line = SplineInterpolator([0.0, 1.0], [[0.0], [1.0]])
    solver = TOPPRA([Rule()], line, gridpoints=grid, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    np.testing.assert_allclose(fastest_profile(grid, found).speed, speed, atol=1e-6)


def test_a_finer_grid_changes_toppras_optimum_little_and_less() -> None:
    limits = Limits(vertex_speed=9.0, speed=9.0)
    path = straight(4, 8, limits)
    times = [
        fastest_profile(np.linspace(0.0, 1.0, m), demands(path, limits, m)).duration
        for m in (51, 101, 201, 801)
    ]
    errors = np.abs(np.array(times[:3]) - times[3])
    assert errors[2] < errors[0]
    assert errors[2] < 2e-3 * times[3]


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


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_a_higher_limit_hardly_ever_costs_time() -> None:
    path = straight(3, 4, Limits())
    times = [fly(path, Limits(acceleration=a)).duration for a in (1.0, 2.0, 4.0, 40.0, 1e4)]
    assert all(later <= 1.01 * earlier for earlier, later in pairwise(times))


def test_the_profiles_mean_and_acceleration_by_sampling() -> None:
    profile = profile_of(straight(4, 5, Limits()), Limits())
    t = np.linspace(-0.3, profile.duration + 0.3, 4001)
    rate = np.interp(t, profile.times, profile.speed, left=0.0, right=0.0)
    s = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))
    window = t > -0.1
    width = 0.2
    steps = round(width / (t[1] - t[0]))
    mean = np.array([np.mean(s[max(0, i - steps) : i + 1]) for i in range(len(t))])
    np.testing.assert_allclose(profile.mean(t, width)[window], mean[window], atol=2e-3)
    middle = (t[1:] + t[:-1]) / 2.0
    slope = np.diff(rate) / np.diff(t)
    steady = np.abs(profile.acceleration(t[1:]) - profile.acceleration(t[:-1])) < 1e-9
    np.testing.assert_allclose(profile.acceleration(middle)[steady], slope[steady], atol=1e-6)


def test_the_mesh_is_close_where_the_acceleration_changes() -> None:
    limits = Limits()
    profile = profile_of(straight(3, 4, limits, (10.0, 0.0)), limits)
    ramp = 0.2
    knots = time_mesh(profile, ramp)
    widths = np.diff(knots)
    assert knots[0] == 0.0
    assert knots[-1] == pytest.approx(profile.duration + ramp)
    assert np.all(widths > 0.0)
    assert max(widths[0], widths[-1]) <= ramp / 4.0
    assert np.max(widths) >= 5.0 * widths[0]
    assert np.all(widths[1:] / widths[:-1] < 2.5)
    assert np.all(widths[:-1] / widths[1:] < 2.5)
    assert len(time_mesh(profile, ramp, finer=2)) == pytest.approx(2 * len(knots), abs=3)


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


WEAK = Quadrotor(mass=0.132, max_thrust=1.9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tight", "changed"),
    [
        (Limits(jerk=100.0), lambda team: team),
        (Limits(speed=0.3, vertex_speed=100.0), lambda team: team),
        (Limits(acceleration=9.0, jerk=500.0, tilt=0.6), lambda team: team),
        (
            Limits(acceleration=20.0, jerk=500.0, tilt=1.5),
            lambda team: replace(team, quadrotor=WEAK),
        ),
        (
            Limits(acceleration=20.0, jerk=500.0, tilt=1.5),
            lambda team: replace(team, quadrotor=replace(WEAK, max_thrust=1.41)),
        ),
        (Limits(jerk=40.0), lambda team: replace(team, cable_density=0.01)),
        (Limits(vertex_speed=0.1), lambda team: team),
    ],
    ids=["jerk", "speed", "tilt", "thrust", "pull", "weight", "vertices"],
)
def test_the_stretch_is_that_of_all_drones_on_all_pieces(
    tight: Limits, changed: Callable[[Team], Team], monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is ruled out that would have to be slower: each needs no more than its bound."""
    easy = Limits(tilt=1.5)
    path = straight(10, 3, easy, (1.0, 0.5))
    flight = fly(path, easy)
    team = changed(path.team)
    parts = (flight.drones, flight.vertices, flight.pulls)
    alone = []

    def every(bounds: np.ndarray, known: float, exact: Callable[..., float]) -> float:
        for piece, item in np.ndindex(*bounds.shape):
            alone.append(exact(np.array([piece]), np.array([item])))
            assert alone[-1] <= bounds[piece, item]
        return known

    found = needed_stretch(team, tight, *parts)
    monkeypatch.setattr(stretch, "_largest", every)
    needed_stretch(team, tight, *parts)
    assert 1e-3 < found == pytest.approx(max(alone), rel=1e-12)
