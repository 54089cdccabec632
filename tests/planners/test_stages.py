"""The stages of a plan one by one, and custom paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.drones.controllers import FlightController
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.loads import tracking_warnings
from hitchopt.planners.timing.following import distances_from
from hitchopt.planners.timing.timed_motion import fastest_motion, motion_by
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SQUARE = ho.regular_polygon(4, 1.2)
TEAM = ho.Team(robots=4, cable_length=2.4)
START = ho.Hitch.spread(TEAM, SQUARE)
TURNED = SQUARE.rotated(1.0)  # the straight path is slow
TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])
SMALLER = ho.regular_polygon(4, 1.1)  # the straight path is fast


@pytest.mark.parametrize(
    ("goal", "tension"), [(SMALLER, None), (TURNED, None), (TURNED, (0.3, 0.6))]
)
def test_route_and_time_are_the_stages_of_a_morph(
    goal: ho.ConvexPolygon, tension: tuple[float, float] | None
) -> None:
    plan = ho.morph(START, goal, tension=tension)
    motion = ho.time(ho.route(START, goal, tension=tension))
    for part, planned in (
        (motion.drones, plan.motion.drones),
        (motion.legs, plan.motion.legs),
        (motion.tensions, plan.motion.tensions),
    ):
        np.testing.assert_array_equal(part.breaks, planned.breaks)
        np.testing.assert_array_equal(part.coefficients, planned.coefficients)
    assert ho.certify(motion).certified


def test_a_route_has_the_shapes_of_its_ends_and_plots_itself() -> None:
    path = ho.route(START, TURNED)
    shapes = path.shapes([0.0, 1.0])
    np.testing.assert_allclose(shapes.polygons[0], SQUARE.vertices, atol=1e-9)
    np.testing.assert_allclose(shapes.polygons[1], TURNED.vertices, atol=1e-9)
    np.testing.assert_allclose(shapes.legs[0], START.legs, atol=1e-9)
    np.testing.assert_allclose(path.drones([0.0])[0], START.drones, atol=1e-9)
    assert len(path.plot().lines) > TEAM.drones


def test_limits_and_durations_are_those_of_the_timing() -> None:
    path = ho.route(START, SMALLER)
    slow = ho.time(path, limits=ho.Limits(speed=0.1))
    assert ho.certify(slow)["speed"].worst <= 0.1
    assert ho.time(path, 5.0).duration == 5.0
    with pytest.raises(ho.InfeasibleError, match="duration"):
        ho.time(path, 0.1)
    assert not ho.certify(ho.time(path, arena=ho.Arena([-1, -1, 0], [1, 1, 2]))).certified


def on_circle(s: float) -> Array:
    """Return the square, its first vertex on a circle of 0.1 m."""
    vertices = SQUARE.vertices.copy()
    angle = 2.0 * np.pi * s
    vertices[0] += [0.1 * np.cos(angle) - 0.1, 0.1 * np.sin(angle)]
    return vertices


def test_a_path_by_hand_is_timed_and_certified() -> None:
    path = ho.Path.of(TEAM, on_circle, altitude=1.5)
    s = np.linspace(0.0, 1.0, 501)
    exact = np.stack([on_circle(each) for each in s])
    np.testing.assert_allclose(path.shapes(s).polygons, exact, atol=1e-8)
    motion = ho.time(path)
    assert ho.certify(motion).certified
    distances = np.linalg.norm(
        motion.vertices.at(np.linspace(0.0, motion.duration, 300))[:, 0]
        - [*(SQUARE.vertices[0] - [0.1, 0.0]), 1.5],
        axis=1,
    )
    np.testing.assert_allclose(distances, 0.1, atol=1e-5)


def quintic(s: float) -> float:
    """Return a clock from 0 to 1 at rest at both ends."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


@pytest.mark.parametrize(
    ("stated", "tracking"),
    [(None, None), (ho.Limits(speed=0.5), None), (ho.Limits(tracking=0.0), 0.0)],
)
@pytest.mark.parametrize("duration", [None, 4.0])
def test_paths_of_named_drones_have_their_tracking_errors(
    stated: ho.Limits | None, tracking: float | None, duration: float | None
) -> None:
    """None: what follows from the gains of the drones."""
    drone = ho.Quadrotor(model="crazyflie_2.1")
    team = ho.Team(3, 2.4, quadrotor=drone)
    if tracking is None:
        tracking = FlightController.of("mellinger", drone.mass, drone.gains).tracking

    def moved(s: float) -> Array:
        """Return the triangle, moved smoothly and at rest at both ends."""
        return TRIANGLE + [0.3 * s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 0.0]

    motion = ho.time(ho.Path.of(team, moved, duration=duration), limits=stated)
    assert motion.requirements.limits.tracking == tracking
    notes = ho.Plan(ho.Flight.of(motion), ho.certify(motion)).notes
    is_understated = any("only 0 m is certified" in note for note in notes)
    assert is_understated == (tracking == 0.0), notes


@pytest.mark.parametrize(("trim", "is_told"), [(0.04, False), (0.08, True)])
def test_trims_with_which_drones_swing_are_told(trim: float, is_told: bool) -> None:
    one, others = ho.Quadrotor(trim=(0.0, -trim)), ho.Quadrotor()
    team = ho.Team(3, 2.4, quadrotor=[others, one, others])
    path = ho.Path.of(team, lambda s: TRIANGLE + [0.3 * quintic(s), 0.0])
    motion = ho.time(path)
    notes = list(tracking_warnings(ho.Flight.of(motion)))
    assert any("swings by itself" in note for note in notes) == is_told, notes


@pytest.mark.parametrize("clock", [quintic, lambda s: quintic(s * s)])
def test_a_path_with_a_duration_keeps_its_timing(clock: Callable[[float], float]) -> None:
    """Functions and knots, with limits that hold and limits that the timing breaks."""
    seconds = 6.0
    s = np.linspace(0.0, 1.0, 41)
    exact = np.stack([on_circle(clock(each)) for each in s])
    for vertices in (lambda s: on_circle(clock(s)), exact):
        path = ho.Path.of(TEAM, vertices, altitude=1.5, duration=seconds)
        motion = ho.time(path)
        assert motion.duration == seconds
        found = motion.vertices.at(seconds * s)
        np.testing.assert_allclose(found[..., :2], exact, atol=2e-4)
        for order in (1, 2):
            ends = motion.drones.at(np.array([0.0, seconds]), order)
            np.testing.assert_allclose(ends, 0.0, atol=1e-9)
        hurried = replace(path, duration=0.2)
        certificate = ho.certify(ho.time(hurried))
        assert {"speed", "acceleration"} <= {c.name for c in certificate.limited if not c.holds}
        ratio = certificate["speed"].worst / ho.certify(motion)["speed"].worst
        assert ratio == pytest.approx(30.0, rel=1e-3)
    assert ho.certify(motion).certified
    with pytest.raises(ho.InputError, match=r"duration = 4.* omitted: the path takes 6 s"):
        ho.time(path, 4.0)
    with pytest.raises(ho.InputError, match="zero velocity and acceleration at both ends"):
        ho.Path.of(TEAM, on_circle, duration=seconds)


def test_a_path_by_knots_passes_them_with_legs_and_roll() -> None:
    knots = np.stack([START.vertices, 0.98 * START.vertices + [0, 0, 0.1], START.vertices])
    path = ho.Path.of(TEAM, knots, legs=lambda s: START.q_legs - 0.05 * s, roll=[[0.0] * 4] * 3)
    np.testing.assert_allclose(path.vertices.at(np.array([0.0, 0.5, 1.0])), knots, atol=1e-12)
    q_legs = path.shapes([0.0, 1.0]).legs[..., 0]
    np.testing.assert_allclose(q_legs, [START.q_legs, START.q_legs - 0.05], atol=1e-12)
    assert ho.certify(ho.time(path)).certified


def test_rolled_legs_leave_the_plane() -> None:
    level, rolled = (
        ho.Path.of(TEAM, on_circle, roll=lambda s, angle=angle: [angle * s] * 4)  # type: ignore[misc]
        for angle in (0.0, 0.3)
    )
    heights = [np.ptp(path.drones([1.0])[0, :, 2]) for path in (level, rolled)]
    assert heights[0] < 1e-9
    assert heights[1] > 0.1


def test_impossible_shapes_are_refused_where_they_are() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"convexity: .* of the path"):
        ho.time(ho.Path.of(TEAM, lambda s: SQUARE.vertices * (1.0, 1.0 - 1.5 * s)))
    with pytest.raises(
        ho.InfeasibleError, match=r"from 0% .*; list the points in the reverse order"
    ):
        ho.time(ho.Path.of(TEAM, lambda s: (1.0 + 0.1 * s) * SQUARE.vertices[::-1]))
    with pytest.raises(ho.InfeasibleError, match=r"legs: .* of the path"):
        ho.time(ho.Path.of(TEAM, lambda s: SQUARE.vertices * (1.0 + s)))
    with pytest.raises(ho.InputError, match=r"polygon .* nothing moves"):
        ho.route(START, SQUARE)
    with pytest.raises(ho.InputError, match=r"shape \(3, 2\)"):
        ho.Path.of(TEAM, lambda _: SQUARE.vertices[:3])
    with pytest.raises(ho.InputError, match="3 or more knots"):
        ho.Path.of(TEAM, [SQUARE.vertices, TURNED.vertices])
    with pytest.raises(ho.InputError, match="vertices"):
        ho.Path.of(TEAM, lambda s: SQUARE.vertices / s if s else SQUARE.vertices * np.nan)
    with pytest.raises(ho.InputError, match=r"^s = "):
        ho.Path.of(TEAM, on_circle).shapes([1.5])


def circling(turns: int) -> Callable[[float], np.ndarray]:
    """Return a function of s by which one vertex of a triangle circles."""

    def vertices(s: float) -> np.ndarray:
        angle = 2.0 * np.pi * turns * s
        moved = TRIANGLE.copy()
        moved[0] += [0.1 * (np.cos(angle) - 1.0), 0.1 * np.sin(angle)]
        return moved

    return vertices


@pytest.mark.parametrize("turns", [1, 10, 50])
def test_splines_fit_their_functions_between_samples(turns: int) -> None:
    path = ho.Path.of(ho.Team(3, 2.4), circling(turns))
    s = np.linspace(0.0, 1.0, 7001)
    expected = np.stack([circling(turns)(each) for each in s.tolist()])
    assert np.max(np.abs(path.vertices.at(s)[..., :2] - expected)) < 1e-4


@pytest.mark.parametrize(
    "vertices",
    [*map(circling, (128, 256, 300, 512)), lambda s: TRIANGLE + (0.05 if s > 0.3 else 0.0)],
)
def test_functions_that_samples_miss_are_refused(vertices: Callable[[float], np.ndarray]) -> None:
    with pytest.raises(
        ho.InputError, match=r"vertices = 'off by .* near s = 0\.\d+': must be smooth"
    ):
        ho.Path.of(ho.Team(3, 2.4), vertices)


def test_paths_that_rest_are_not_timed() -> None:
    def waiting(s: float) -> np.ndarray:
        return TRIANGLE * (1.0 + 4.0 * max(s - 0.5, 0.0) ** 6)

    for vertices, end in ((waiting, "0.5"), (lambda _: TRIANGLE, "1")):
        path = ho.Path.of(ho.Team(3, 2.4), vertices)
        with pytest.raises(ho.InputError, match=rf"path: rests from s = 0 to {end}"):
            ho.time(path)


@pytest.mark.parametrize("power", [4, 6, 8])
def test_paths_that_begin_slowly_are_timed(power: int) -> None:
    def slow(s: float) -> np.ndarray:
        moved = TRIANGLE.copy()
        moved[0, 1] += 0.1 * s**power
        return moved

    motion = ho.time(ho.Path.of(ho.Team(3, 2.4), slow))
    assert np.ptp(motion.vertices.at([0.0, motion.duration])[:, 0, 1]) == pytest.approx(0.1)


def turning_triangle(amplitude: float, waves: int) -> Callable[[float], Array]:
    """Return a function of s by which a triangle turns, and sways along a line in waves."""

    def vertices(s: float) -> Array:
        cosine, sine = np.cos(0.4 * s), np.sin(0.4 * s)
        turned = ho.regular_polygon(3, 1.126).vertices @ [[cosine, sine], [-sine, cosine]]
        sway = amplitude * np.sin(2.0 * np.pi * waves * s)
        return np.asarray(turned + sway * np.array([1.0, 0.3]))

    return vertices


def distance_from(path: ho.Path, motion: ho.Motion) -> float:
    """Return the largest distance [m] of vertices from the path, all at one s, at samples."""
    shapes = path.vertices.at(np.linspace(0.0, 1.0, 20_001)).reshape(20_001, -1, 3)
    t = np.random.default_rng(3).uniform(0.0, motion.duration, 300)
    to_shapes = (np.max(np.linalg.norm(shapes - x, axis=-1), axis=1) for x in motion.vertices.at(t))
    return max(float(np.min(distances)) for distances in to_shapes)


@pytest.mark.parametrize(
    ("amplitude", "waves"),
    [(0.05, 2), (0.004, 60), pytest.param(0.001, 128, marks=pytest.mark.slow)],
)
def test_motions_follow_paths_that_sway(amplitude: float, waves: int) -> None:
    path = ho.Path.of(ho.Team(3, 2.4), turning_triangle(amplitude, waves))
    motion = ho.time(path)
    assert ho.certify(motion).certified
    assert distance_from(path, motion) < 1.1e-4


def test_distances_from_a_path_are_upper_bounds_and_close() -> None:
    """Of motions on fewer pieces than they need, which leave the path between breakpoints."""
    path = ho.Path.of(ho.Team(3, 2.4), turning_triangle(0.02, 8))
    _, clock = fastest_motion(path, Requirements())
    for pieces in (6, 12, 24):
        coarse = replace(clock, knots=np.linspace(0.0, clock.knots[-1], pieces + 1))
        motion = motion_by(path, Requirements(), coarse)
        progress = PiecewisePolynomial.through_jets(coarse.breaks, coarse.jets())
        bounds = distances_from(path, motion, progress)
        t = np.random.default_rng(pieces).uniform(0.0, motion.duration, 5000)
        offsets = motion.vertices.at(t) - path.vertices.at(progress.at(t).clip(0.0, 1.0))
        sampled = np.max(np.linalg.norm(offsets, axis=-1), axis=1)
        piece = np.searchsorted(coarse.breaks, t) - 1
        assert np.all(sampled <= bounds[piece])
        assert np.max(bounds) < 1.5 * np.max(sampled) + 1e-3
        assert np.max(bounds) > 1e-4


def test_paths_that_turn_too_often_are_refused_where_they_do() -> None:
    rng = np.random.default_rng(5)
    knots = ho.regular_polygon(3, 1.126).vertices + rng.uniform(-0.01, 0.01, (12_000, 3, 2))
    with pytest.raises(ho.InputError, match=r"path = 'left by .* m near s = 0\.\d+'.* or split it"):
        ho.time(ho.Path.of(ho.Team(3, 2.4), knots))


@pytest.mark.parametrize(
    "vertices",
    [
        lambda s: TRIANGLE * (1.0 + 0.1 * s) + 0.05 * np.exp(-(((s - 0.5013) * 3000.0) ** 2)),
        lambda s: TRIANGLE + 0.05 * np.sin(32_000.0 * np.pi * s),
        lambda s: TRIANGLE * (np.nan if 0.7001 < s < 0.7012 else 1.0),
        lambda s: TRIANGLE * (1.0 + 0.1 * s) + 0.3j,
        lambda _: np.ma.masked_array(TRIANGLE, mask=[[True, False]] + [[False] * 2] * 2),
        np.ma.masked_array(np.stack([TRIANGLE] * 3), mask=True),
        np.stack([TRIANGLE] * 3) * (1.0 + 0.3j),
    ],
)
def test_what_is_no_smooth_curve_of_real_numbers_is_refused(vertices: Any) -> None:
    with pytest.raises(ho.InputError, match="vertices"):
        ho.Path.of(ho.Team(3, 2.4), vertices)
