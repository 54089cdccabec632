"""Single checks against numbers that follow from geometry, and violations that samples miss."""

from __future__ import annotations

import math
from collections.abc import Callable, Set
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import moving, random_motion, still, with_drones, with_parts
from certificate_sampling import sampled

from hitchopt.checks import CertificateError, certify
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Quadrotor, Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

TRIANGLE = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])
LEGS = [0.35, 0.5, 0.45]


def triangle(**given: object) -> Motion:
    return still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE, LEGS, **given)


def displaced(motion: Motion, drone: int, path: Array) -> Motion:
    """Return the motion with ``path`` (pieces, 3, degree + 1) added to one drone."""
    drones = motion.drones.elevated(path.shape[-1] - 1).coefficients.copy()
    drones[:, drone] += path
    return with_drones(motion, drones)


def at_breaks(motion: Motion, breaks: list[float]) -> Motion:
    """Return a motion at rest, cut at other times."""
    return with_parts(motion, lambda p: PiecewisePolynomial.constant(np.array(breaks), p.at(0.0)))


def placed(motion: Motion, drone: int, place: Callable[[Array, Array], Array]) -> Motion:
    """Return the motion with one drone elsewhere, by drones (…, 2n, 3) and vertices (…, n, 3)."""
    c = np.moveaxis(motion.drones.coefficients, -1, 1).copy()
    p = np.moveaxis(motion.vertices.coefficients, -1, 1)
    c[:, :, drone] = place(c, p)
    return with_drones(motion, np.moveaxis(c, 1, -1))


def test_a_pass_of_a_millisecond_is_found_that_samples_at_100_hz_miss() -> None:
    motion = at_breaks(triangle(), [0.0, 1.0011, 1.0021, 2.0])
    drones = motion.drones.coefficients[0, :, :, 0]
    path = np.zeros((3, 3, 7))
    path[1] = (drones[3] + [0.0, 0.05, 0.0] - drones[0])[:, None] * (
        np.array([0.0, 0.0, 0.0, 3.2, 0.0, 0.0, 0.0])  # a bump as high as 1 at mid time
    )
    darting = displaced(motion, 0, path)
    at_100_hz = sampled(darting, np.linspace(0.0, 2.0, 201))["separation"]
    in_between = sampled(darting, np.linspace(1.0011, 1.0021, 4001))["separation"]
    check = certify(darting)["separation"]
    assert certify(motion)["separation"].worst == pytest.approx(at_100_hz, rel=1e-3)
    assert in_between < 0.3 * at_100_hz
    assert in_between >= check.bound >= 0.99 * in_between
    assert check.where == ("q0", "r1")
    assert 1.0011 <= check.time <= 1.0021


def test_two_drones_passing_come_as_close_as_their_lines() -> None:
    """On straight lines at constant speeds, whose closest approach has a formula."""
    motion = at_breaks(triangle(separation=Separation(0.5, 0.5)), [0.0, 3.0])
    a, va = np.array([-4.0, 0.3, 7.0]), np.array([2.3, 0.1, 0.2])
    b, vb = np.array([3.1, -1.0, 7.4]), np.array([-2.2, 0.9, -0.1])
    drones = motion.drones.elevated(1).coefficients.copy()
    drones[0, 1] = np.column_stack([a, a + 3.0 * va])
    drones[0, 4] = np.column_stack([b, b + 3.0 * vb])
    offset, relative = a - b, va - vb
    time = -np.dot(offset, relative) / np.dot(relative, relative)
    closest = np.linalg.norm(np.cross(offset, relative)) / np.linalg.norm(relative)
    check = certify(with_drones(motion, drones))["separation"]
    assert check.bound <= closest
    assert check.worst == pytest.approx(closest, rel=2e-4)
    assert check.time == pytest.approx(time, abs=2e-2)
    assert check.where == ("r0", "q2")


def test_a_polynomial_s_largest_speed_acceleration_and_jerk() -> None:
    """x = t⁴ - 2 t³ on [0, 2]: the extremes of the derivatives by hand, all at its end."""
    motion = at_breaks(triangle(), [0.0, 2.0])
    line = np.polynomial.Polynomial([0.0, 2.0])
    powers = np.polynomial.Polynomial([0.0, 0.0, 0.0, -2.0, 1.0])(line).coef
    path = np.zeros((1, 3, 5))
    for j in range(5):  # from powers to Bernstein coefficients
        path[0, 1, j] = sum(powers[i] * math.comb(j, i) / math.comb(4, i) for i in range(j + 1))
    certificate = certify(displaced(motion, 3, path))
    for name, value in (("speed", 8.0), ("acceleration", 24.0), ("jerk", 36.0)):
        check = certificate[name]
        assert value <= check.bound == pytest.approx(value, rel=1e-9)
        assert check.where == ("r1",)
        assert check.time == pytest.approx(2.0)


def test_a_rigid_turn_moves_points_at_their_distance_times_the_rate() -> None:
    team, omega, centre = Team(4, 2.1), 0.3, np.array([2.0, -1.0])
    base = regular_polygon(4, 1.2, 0.2).vertices

    def polygon_at(t: Array) -> Array:
        c, s = np.cos(omega * t)[:, None], np.sin(omega * t)[:, None]
        x, y = c * base[:, 0] - s * base[:, 1], s * base[:, 0] + c * base[:, 1]
        return centre + np.stack([x, y], axis=-1)

    q_legs = np.array([0.3, 0.4, 0.5, 0.45])
    certificate = certify(moving(team, polygon_at, q_legs, order=9))
    radius = np.max(np.linalg.norm(Hitch(team, base, 1.0, q_legs).drones[:, :2], axis=1))
    vertex = omega * 0.6 * math.sqrt(2.0)
    expected = {"vertex_speed": vertex} | {
        name: omega**k * radius for k, name in enumerate(("speed", "acceleration", "jerk"), 1)
    }
    still_there = certify(still(team, base, q_legs))
    for name in ("separation", "cable_clearance", "crossing", "legs", "convexity"):
        expected[name] = still_there[name].bound
    for name, value in expected.items():
        assert certificate[name].worst == pytest.approx(value, rel=2e-4), name


PSI = 0.02
TURN = np.array(
    [[math.cos(PSI), -math.sin(PSI), 0], [math.sin(PSI), math.cos(PSI), 0], [0.0, 0.0, 1.0]]
)
HEXAGON = regular_polygon(6, 1.0).vertices
STAR = np.column_stack([f(-4.0 * math.pi * np.arange(5) / 5) for f in (np.cos, np.sin)])
WALLS = Arena([-2.0, -3.0, 0.2], [8.0, 7.0, 1.45])
KINDS = [Quadrotor(0.132, 2.6), Quadrotor(0.2, 2.4), Quadrotor(0.3, 9.0)]


def with_kinds(*kinds: Quadrotor) -> Motion:
    return still(Team(3, [2.4, 2.5, 2.6], quadrotor=list(kinds)), TRIANGLE, LEGS)


def uneven() -> Motion:
    """Return legs for equal tensions under T and 1.25 T."""
    tensions = np.broadcast_to(np.array([[0.4], [0.5], [0.5]]), (2, 3, 1))
    motion = triangle()
    return replace(motion, tensions=PiecewisePolynomial(motion.tensions.breaks, tensions))


EXTERIOR = np.min(Hitch(Team(3, [2.4, 2.5, 2.6]), TRIANGLE, 1.0, LEGS).polygon.exterior_angles[:2])

FORMS: dict[str, tuple[Callable[[], Motion], str, float, bool, Set[tuple[str, ...]]]] = {
    "the ellipsoid's height scales an offset": (
        lambda: placed(
            triangle(separation=Separation(0.12, 0.30)), 2, lambda x, _: x[:, :, 1] + [0, 0, 0.45]
        ),
        *("separation", 0.75, False, {("r0", "q1")}),
    ),
    "a drone is off its own edge by its leg times the sine": (
        lambda: still(Team(24, 2.0), regular_polygon(24, 1.3).vertices, np.full(24, 0.35)),
        *("cable_clearance", 0.35 * math.sin(2.0 * math.pi / 24), False),
        {(f"{end}{k}", f"cable {k}") for end in "qr" for k in range(24)},
    ),
    "a drone over a foreign leg, half way along it": (
        lambda: placed(
            triangle(), 5, lambda x, p: 0.5 * (p[:, :, 1] + x[:, :, 2]) + [0.0, 0.0, 0.07]
        ),
        *("cable_clearance", 0.07, False, {("r2", "cable 1")}),
    ),
    # On a regular hexagon the lines of edges k - 1 and k + 1 meet an edge's length away.
    "legs that end before the star tip, at 60°": (
        lambda: still(Team(6, 2.9), HEXAGON, np.full(6, 0.95)),
        *("crossing", 0.05, True, {(f"q-leg {k}", f"r-leg {k}") for k in range(6)}),
    ),
    "legs past the star tip": (
        lambda: still(Team(6, 3.1), HEXAGON, np.full(6, 1.05)),
        *("crossing", 0.0, False, {(f"q-leg {k}", f"r-leg {k}") for k in range(6)}),
    ),
    "82 % of a weak drone's thrust counts more than a strong one's": (
        lambda: with_kinds(*KINDS),
        *("thrust", math.hypot(0.2 * 9.81, 0.4), True, {("q1",), ("r1",)}),
    ),
    "a weaker drone": (
        lambda: with_kinds(*KINDS[:2], Quadrotor(0.3, 2.9)),
        *("thrust", math.hypot(0.3 * 9.81, 0.4), False, {("q2",), ("r2",)}),
    ),
    "the nearest wall": (
        lambda: triangle(arena=WALLS),
        *("arena", 0.45, True, {(f"{end}{k}",) for end in "qr" for k in range(3)}),
    ),
    "outside of the arena": (
        lambda: placed(triangle(arena=WALLS), 4, lambda x, _: x[:, :, 4] + [0.0, 0.0, 0.55]),
        *("arena", -0.1, False, {("q2",)}),
    ),
    "a leg turned by ψ leaves 2 sin(ψ/2) of its tension": (
        lambda: placed(triangle(), 2, lambda x, p: p[:, :, 1] + (x[:, :, 2] - p[:, :, 1]) @ TURN.T),
        *("equilibrium", 2.0 * math.sin(0.5 * PSI), False, {("p1",)}),
    ),
    "|ΔT| |u_k + u_{k-1}| over the smaller tension": (
        *(uneven, "equilibrium", 0.25 * 2.0 * math.cos(0.5 * EXTERIOR), False),
        {("p0",), ("p1",)},
    ),
    "a polygon that goes around twice": (
        lambda: still(Team(5, 4.0), STAR, np.full(5, 0.5)),
        *("convexity", -360.0, False, {()}),
    ),
}
"""How a motion is made, a check, its worst value, whether it holds, and where it may be."""


@pytest.mark.parametrize("name", FORMS)
def test_a_check_is_what_geometry_says(name: str) -> None:
    make, which, worst, holds, where = FORMS[name]
    check = certify(make())[which]
    assert check.worst == pytest.approx(worst, rel=1e-6, abs=1e-9)
    assert check.holds is holds
    assert check.where in where or where == {()}


def test_thrust_is_held_against_the_limit_of_what_is_named() -> None:
    assert certify(with_kinds(*KINDS))["thrust"].limit == 2.4
    assert certify(with_kinds(*KINDS[:2], Quadrotor(0.3, 2.9)))["thrust"].limit == 2.9


def test_parts_that_meet_at_a_clasp_are_not_crossing() -> None:
    check = certify(triangle())["crossing"]
    opposite = sampled(triangle(), np.array([0.0]))["crossing"]
    assert check.worst == pytest.approx(opposite, rel=1e-9)
    assert check.bound > 0.5


def test_half_of_the_cable_s_weight_hangs_on_each_drone() -> None:
    """A regular hitch shares all weight alike: drones carry it, and the rest of the pull leans."""
    hexagon = np.array([1.0, -2.0]) + HEXAGON
    team = Team(6, 2.0, cable_density=0.01, tension=0.5, load=0.004)
    d = 0.5 * (2.0 - 1.0 - (0.0981 / 0.5) ** 2 / 24.0)
    certificate = certify(still(team, hexagon, np.full(6, d)))
    rise = 0.5 * (9.81 * (0.004 + 0.01 * (1.0 + d)))  # of each leg's pull: half of a clasp's load
    upward = 9.81 * (0.132 + 0.5 * 0.01 * d) + rise
    half, sine = 0.5 * 0.0981 * d, rise / 0.5
    pull = half * sine + math.sqrt(0.25 - half**2 * (1.0 - sine**2))
    level = math.sqrt(pull**2 - rise**2)
    assert certificate["thrust"].worst == pytest.approx(math.hypot(upward, level), rel=2e-4)
    lean = math.degrees(math.atan2(level, upward))
    assert certificate["tilt"].worst == pytest.approx(lean, rel=2e-4)
    assert certificate["equilibrium"].bound < 1e-3
    assert certificate["cable_length"].bound < 1e-9


@pytest.mark.parametrize("fall", [5.0, 20.0])
def test_a_falling_drone_leans_beyond_the_horizon(fall: float) -> None:
    path = np.zeros((1, 3, 4))
    path[0, 2] = -0.5 * fall * np.array([0.0, 0.0, 1.0 / 3.0, 1.0])  # of t²
    path[0, :2] += np.array([[0.1], [-0.2]]) * np.array([0.0, 0.3, -0.2, 0.1])
    falling = displaced(at_breaks(triangle(), [0.0, 1.0]), 2, path)
    worst = certify(falling)["tilt"].bound
    value = sampled(falling, np.linspace(0.0, 1.0, 20_001))["tilt"]
    assert value <= worst <= 1.01 * value


@pytest.mark.parametrize(("power", "jump"), [(0, 2e-3), (1, 3e-3), (2, 4e-3)])
def test_jumps_of_position_velocity_and_acceleration(power: int, jump: float) -> None:
    motion = at_breaks(triangle(), [0.0, 0.5, 2.0])
    path = np.zeros((2, 3, 3))
    # On the second piece: jump · (t - 0.5)^power / power!, as Bernstein coefficients.
    path[1, 1] = [[1.0, 1.0, 1.0], [0.0, 0.75, 1.5], [0.0, 0.0, 1.125]][power]
    check = certify(displaced(motion, 1, jump * path))["continuity"]
    assert certify(motion)["continuity"].bound < 1e-10
    assert check.worst == pytest.approx(jump, rel=1e-6)
    assert (check.time, check.where, check.holds) == (0.5, ("r0",), False)
    whole = certify(at_breaks(triangle(), [0.0, 1.0]))["continuity"]  # a single piece: no joint
    assert (whole.worst, whole.holds) == (0.0, True)


def test_a_vertex_that_passes_a_straight_line_is_no_corner() -> None:
    square = np.array([[5.0, 3.0], [5.0, 4.0], [6.0, 4.0], [6.0, 3.0]])
    inward = np.array([[0.6, 0.6], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    motion = moving(
        Team(4, 2.0), lambda t: square + (t / 4.0)[:, None, None] * inward, np.full(4, 0.4)
    )
    check = certify(motion)["convexity"]
    value = sampled(motion, np.linspace(0.0, 4.0, 2001))["convexity"]
    assert check.worst == pytest.approx(value, rel=1e-3)
    assert check.bound < -10.0
    assert check.where == ("p0",)


def test_violations_are_told_in_words() -> None:
    certificate = certify(random_motion(3, 4, limits=Limits(speed=1e-3)))
    assert [check.name for check in certificate.violated] == ["speed"]
    with pytest.raises(CertificateError, match=r"speed: .* m/s is above the limit of 0.001 m/s"):
        certificate.raise_if_violated()
