"""Single checks against numbers that follow from geometry, and violations that samples miss."""

import math
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

TRIANGLE = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])
LEGS = [0.35, 0.5, 0.45]


def triangle(**given: object) -> Motion:
    return still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE, LEGS, **given)


def displaced(motion: Motion, drone: int, path: np.ndarray) -> Motion:
    """Return the motion with ``path`` (pieces, 3, degree + 1) added to one drone."""
    drones = motion.drones.elevated(path.shape[-1] - 1).coefficients.copy()
    drones[:, drone] += path
    return with_drones(motion, drones)


def at_breaks(motion: Motion, breaks: np.ndarray) -> Motion:
    """Return a motion at rest, cut at other times."""

    def cut(part: PiecewisePolynomial) -> PiecewisePolynomial:
        return PiecewisePolynomial.constant(breaks, part.at(0.0))

    return with_parts(motion, cut)


def test_a_pass_of_a_millisecond_is_found_that_samples_at_100_hz_miss() -> None:
    motion = at_breaks(triangle(), np.array([0.0, 1.0011, 1.0021, 2.0]))
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
    motion = at_breaks(triangle(separation=Separation(0.5, 0.5)), np.array([0.0, 3.0]))
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


def test_the_ellipsoids_heights_and_radii_scale_the_offset() -> None:
    motion = triangle(separation=Separation(0.12, 0.30))
    drones = motion.drones.coefficients.copy()
    drones[:, 2] = drones[:, 1] + np.array([0.0, 0.0, 0.45])[:, None]
    check = certify(with_drones(motion, drones))["separation"]
    assert check.worst == pytest.approx(0.75, rel=1e-9)
    assert check.where == ("r0", "q1")
    assert not check.holds


def test_a_polynomial_s_largest_speed_acceleration_and_jerk() -> None:
    """x = t⁴ - 2 t³ on [0, 2]: the extremes of the derivatives by hand."""
    motion = at_breaks(triangle(), np.array([0.0, 2.0]))
    powers = np.polynomial.Polynomial([0.0, 0.0, 0.0, -2.0, 1.0])(
        np.polynomial.Polynomial([0.0, 2.0])
    ).coef
    path = np.zeros((1, 3, 5))
    for j in range(5):  # from powers to Bernstein coefficients
        path[0, 1, j] = sum(powers[i] * math.comb(j, i) / math.comb(4, i) for i in range(j + 1))
    certificate = certify(displaced(motion, 3, path))
    speed = max(abs(4 * t**3 - 6 * t**2) for t in (1.0, 2.0))
    acceleration = max(abs(12 * t**2 - 12 * t) for t in (0.5, 2.0))
    jerk = max(abs(24 * t - 12) for t in (0.0, 2.0))
    for name, value in (("speed", speed), ("acceleration", acceleration), ("jerk", jerk)):
        assert certificate[name].bound >= value
        assert certificate[name].worst == pytest.approx(value, rel=1e-9)
        assert certificate[name].where == ("r1",)
        assert certificate[name].time == pytest.approx(2.0)


def test_a_rigid_turn_moves_points_at_their_distance_times_the_rate() -> None:
    team, omega, centre = Team(4, 2.1), 0.3, np.array([2.0, -1.0])
    base = regular_polygon(4, 1.2, 0.2).vertices

    def polygon_at(t: np.ndarray) -> np.ndarray:
        c, s = np.cos(omega * t)[:, None], np.sin(omega * t)[:, None]
        x, y = c * base[:, 0] - s * base[:, 1], s * base[:, 0] + c * base[:, 1]
        return centre + np.stack([x, y], axis=-1)

    q_legs = np.array([0.3, 0.4, 0.5, 0.45])
    motion = moving(team, polygon_at, q_legs, order=9)
    radius = np.max(np.linalg.norm(Hitch(team, base, 1.0, q_legs).drones[:, :2], axis=1))
    certificate = certify(motion)
    assert certificate["speed"].worst == pytest.approx(omega * radius, rel=2e-4)
    assert certificate["acceleration"].worst == pytest.approx(omega**2 * radius, rel=2e-4)
    assert certificate["jerk"].worst == pytest.approx(omega**3 * radius, rel=2e-4)
    vertex = omega * 0.6 * math.sqrt(2.0)
    assert certificate["vertex_speed"].worst == pytest.approx(vertex, rel=2e-4)
    still_there = certify(still(team, base, q_legs))
    for name in ("separation", "cable_clearance", "crossing", "legs", "convexity"):
        assert certificate[name].worst == pytest.approx(still_there[name].worst, rel=2e-4), name


def test_a_drone_stands_off_its_own_edge_by_its_leg_times_the_sine() -> None:
    """Drone q_k continues edge k - 1: with an exterior angle φ it stands d sin φ off edge k."""
    n, leg = 24, 0.35
    motion = still(Team(n, 2.0), regular_polygon(n, 1.3).vertices, np.full(n, leg))
    check = certify(motion)["cable_clearance"]
    assert check.worst == pytest.approx(leg * math.sin(2.0 * math.pi / n), rel=1e-6)
    drone, cable = check.where
    assert drone[1:] == cable.removeprefix("cable ")
    assert not check.holds


def test_a_drone_held_over_a_foreign_leg() -> None:
    motion = triangle()
    drones = motion.drones.coefficients.copy()
    foot = 0.5 * (motion.vertices.coefficients[:, 1] + drones[:, 2])[..., :1]  # half way along q1's
    drones[:, 5] = foot + np.array([[0.0], [0.0], [0.07]])
    check = certify(with_drones(motion, drones))["cable_clearance"]
    assert check.worst == pytest.approx(0.07, rel=1e-6)
    assert check.where == ("r2", "cable 1")


def test_legs_past_the_star_tip_cross() -> None:
    """On a regular hexagon the lines of edges k - 1 and k + 1 meet an edge's length away."""
    hexagon = regular_polygon(6, 1.0).vertices
    apart = certify(still(Team(6, 2.9), hexagon, np.full(6, 0.95)))["crossing"]
    crossed = certify(still(Team(6, 3.1), hexagon, np.full(6, 1.05)))["crossing"]
    assert apart.worst == pytest.approx(0.05, rel=1e-6)  # both end 0.05 short of the tip, at 60°
    assert crossed.worst == 0.0
    for check in (apart, crossed):
        q, r = check.where
        assert q.removeprefix("q-leg ") == r.removeprefix("r-leg ")


def test_parts_that_meet_at_a_clasp_are_not_crossing() -> None:
    motion = triangle()
    check = certify(motion)["crossing"]
    opposite = min(sampled(motion, np.array([0.0]))["crossing"], np.inf)
    assert check.worst == pytest.approx(opposite, rel=1e-9)
    assert check.bound > 0.5


def test_thrust_counts_what_each_drone_can_give() -> None:
    kinds = [Quadrotor(0.132, 2.6), Quadrotor(0.2, 2.4), Quadrotor(0.3, 9.0)]
    team = Team(3, [2.4, 2.5, 2.6], quadrotor=kinds)
    check = certify(still(team, TRIANGLE, LEGS))["thrust"]
    assert check.where[0] in {"q1", "r1"}  # 82 % of its limit; robot 2 needs more force
    assert check.limit == 2.4
    assert check.worst == pytest.approx(math.hypot(0.2 * 9.81, 0.4), rel=1e-9)
    kinds[2] = Quadrotor(0.3, 2.9)
    weak = Team(3, [2.4, 2.5, 2.6], quadrotor=kinds)
    check = certify(still(weak, TRIANGLE, LEGS))["thrust"]
    assert check.where[0] in {"q2", "r2"}
    assert check.limit == 2.9
    assert not check.holds


def test_half_of_the_cable_s_weight_hangs_on_each_drone() -> None:
    """A regular hitch shares all weight alike: drones carry it, and the rest of the pull leans."""
    angles = 2.0 * math.pi * np.arange(6) / 6
    hexagon = np.array([1.0, -2.0]) + np.column_stack([np.cos(angles), -np.sin(angles)])
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
    motion = at_breaks(triangle(), np.array([0.0, 1.0]))
    path = np.zeros((1, 3, 4))
    path[0, 2] = -0.5 * fall * np.array([0.0, 0.0, 1.0 / 3.0, 1.0])  # of t²
    path[0, :2] += np.array([[0.1], [-0.2]]) * np.array([0.0, 0.3, -0.2, 0.1])
    falling = displaced(motion, 2, path)
    worst = certify(falling)["tilt"].bound
    value = sampled(falling, np.linspace(0.0, 1.0, 20_001))["tilt"]
    assert value <= worst <= 1.01 * value


def test_arena_counts_the_nearest_wall_and_is_negative_outside() -> None:
    motion = triangle(arena=Arena([-2.0, -3.0, 0.2], [8.0, 7.0, 1.45]))
    assert certify(motion)["arena"].worst == pytest.approx(0.45, rel=1e-9)
    lifted = displaced(motion, 4, np.broadcast_to([[0.0], [0.0], [0.55]], (2, 3, 4)))
    check = certify(lifted)["arena"]
    assert check.worst == pytest.approx(-0.1, rel=1e-9)
    assert check.where == ("q2",)
    assert not check.holds


@pytest.mark.parametrize(("power", "jump"), [(0, 2e-3), (1, 3e-3), (2, 4e-3)])
def test_jumps_of_position_velocity_and_acceleration(power: int, jump: float) -> None:
    motion = at_breaks(triangle(), np.array([0.0, 0.5, 2.0]))
    steady = certify(motion)["continuity"]
    path = np.zeros((2, 3, 3))
    # On the second piece: jump · (t - 0.5)^power / power!, as Bernstein coefficients.
    path[1, 1] = [[1.0, 1.0, 1.0], [0.0, 0.75, 1.5], [0.0, 0.0, 1.125]][power]
    check = certify(displaced(motion, 1, jump * path))["continuity"]
    assert steady.bound < 1e-10
    assert check.worst == pytest.approx(jump, rel=1e-6)
    assert check.time == 0.5
    assert check.where == ("r0",)
    assert not check.holds


def test_a_single_piece_has_no_joint() -> None:
    check = certify(at_breaks(triangle(), np.array([0.0, 1.0])))["continuity"]
    assert check.worst == 0.0
    assert check.holds


def test_equilibrium_of_a_leg_that_points_the_wrong_way() -> None:
    """One leg turned by ψ leaves 2 sin(ψ/2) of its tension."""
    motion = triangle()
    psi = 0.02
    c, s = math.cos(psi), math.sin(psi)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    drones = motion.drones.coefficients.copy()
    anchor = motion.vertices.coefficients[:, 1, :, :1]
    drones[:, 2] = anchor + np.einsum("ij,pjk->pik", turn, drones[:, 2] - anchor)
    check = certify(with_drones(motion, drones))["equilibrium"]
    assert check.worst == pytest.approx(2.0 * math.sin(0.5 * psi), rel=1e-6)
    assert check.where == ("p1",)
    assert not check.holds


def test_equilibrium_of_unequal_tensions_uses_the_smaller() -> None:
    """Legs for equal tensions under T and 1.25 T: |ΔT| |u_k + u_{k-1}| over the smaller."""
    motion = triangle()
    tensions = np.broadcast_to(np.array([[0.4], [0.5], [0.5]]), (2, 3, 1))
    uneven = replace(motion, tensions=PiecewisePolynomial(motion.tensions.breaks, tensions))
    value = sampled(uneven, np.array([0.0, 1.0]))["equilibrium"]
    check = certify(uneven)["equilibrium"]
    assert check.worst == pytest.approx(value, rel=1e-6)
    exterior = Hitch(motion.team, TRIANGLE, 1.0, LEGS).polygon.exterior_angles[:2]
    assert check.worst == pytest.approx(0.25 * 2.0 * math.cos(0.5 * np.min(exterior)), rel=1e-6)


def test_a_polygon_that_goes_around_twice_is_no_hitch() -> None:
    angles = -4.0 * math.pi * np.arange(5) / 5
    star = np.column_stack([np.cos(angles), np.sin(angles)])
    check = certify(still(Team(5, 4.0), star, np.full(5, 0.5)))["convexity"]
    assert check.worst == pytest.approx(-360.0)
    assert not check.holds


def test_a_vertex_that_passes_a_straight_line_is_no_corner() -> None:
    square = np.array([[5.0, 3.0], [5.0, 4.0], [6.0, 4.0], [6.0, 3.0]])

    def polygon_at(t: np.ndarray) -> np.ndarray:
        inward = np.zeros((4, 2))
        inward[0] = [0.6, 0.6]
        return square + (t / 4.0)[:, None, None] * inward

    motion = moving(Team(4, 2.0), polygon_at, np.full(4, 0.4))
    check = certify(motion)["convexity"]
    value = sampled(motion, np.linspace(0.0, 4.0, 2001))["convexity"]
    assert check.worst == pytest.approx(value, rel=1e-3)
    assert check.bound < -10.0
    assert check.where == ("p0",)


def test_violations_are_told_in_words() -> None:
    motion = random_motion(3, 4, limits=Limits(speed=1e-3))
    certificate = certify(motion)
    assert [check.name for check in certificate.violated] == ["speed"]
    with pytest.raises(CertificateError, match=r"speed: .* m/s is above the limit of 0.001 m/s"):
        certificate.raise_if_violated()
