"""Motions that no planner should make: the certificate fails them, and always returns."""

import math
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import random_motion, with_drones, with_parts

from hitchopt.checks import Certificate, Check, certify
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial


@pytest.fixture
def motion() -> Motion:
    return random_motion(4, 3)


def certified(motion: Motion) -> Certificate:
    """Return the certificate, all of whose numbers a file can hold."""
    certificate = certify(motion)
    for check in certificate.checks:
        assert check.worst is None or math.isfinite(check.worst), check
        assert math.isfinite(check.time), check
    return certificate


def own_vertex(motion: Motion) -> np.ndarray:
    return motion.vertices.coefficients[:, 2]


def test_a_drone_on_its_vertex_for_all_of_the_time(motion: Motion) -> None:
    c = motion.drones.coefficients.copy()
    c[:, 4] = own_vertex(motion)
    certificate = certified(with_drones(motion, c))
    assert certificate["legs"].worst == 0.0
    assert certificate["legs"].where == ("q-leg 2",)
    for name in ("legs", "cable_length", "equilibrium", "cable_clearance"):
        assert not certificate[name].holds, name
    assert certificate["thrust"].bound >= 0.132 * 9.81 + 0.4  # the pull may point anywhere


def test_a_drone_through_its_vertex_at_one_instant(motion: Motion) -> None:
    leg = motion.drones.coefficients[:, 4] - own_vertex(motion)
    piece = 5
    c = motion.drones.coefficients.copy()
    share = np.linspace(1.0, -2.0, c.shape[-1])
    c[piece, 4] = own_vertex(motion)[piece] + leg[piece, :, :1] * share
    certificate = certified(with_drones(motion, c))
    assert 0.0 <= certificate["legs"].bound < 1e-6
    third = motion.drones.breaks[piece] + motion.drones.durations[piece] / 3.0
    assert certificate["legs"].time == pytest.approx(third, abs=1e-4)
    assert not certificate["equilibrium"].holds
    assert not certificate["cable_length"].holds


def test_two_drones_at_one_place(motion: Motion) -> None:
    c = motion.drones.coefficients.copy()
    c[:, 1] = c[:, 6]
    check = certified(with_drones(motion, c))["separation"]
    assert check.worst == 0.0
    assert check.where == ("r0", "q3")
    assert not check.holds


@pytest.mark.parametrize("n", [5, 60])
def test_all_drones_at_one_place(n: int) -> None:
    motion = random_motion(n, 3)
    c = np.broadcast_to(motion.drones.coefficients[:, :1], motion.drones.coefficients.shape)
    certificate = certified(with_drones(motion, c.copy()))
    assert certificate["separation"].worst == 0.0
    assert certificate["cable_clearance"].worst == 0.0
    assert not certificate["cable_length"].holds


def test_an_edge_of_no_length(motion: Motion) -> None:
    c = motion.vertices.coefficients.copy()
    c[:, 1] = c[:, 2]
    certificate = certified(
        replace(motion, vertices=PiecewisePolynomial(motion.vertices.breaks, c))
    )
    for name in ("convexity", "equilibrium", "cable_length"):
        assert not certificate[name].holds, name
    assert certificate["convexity"].worst == -180.0


def test_all_vertices_at_one_place(motion: Motion) -> None:
    c = np.broadcast_to(motion.vertices.coefficients[:, :1], motion.vertices.coefficients.shape)
    certificate = certified(
        replace(motion, vertices=PiecewisePolynomial(motion.vertices.breaks, c.copy()))
    )
    assert not certificate["convexity"].holds
    assert certificate["crossing"].worst == 0.0


@pytest.mark.parametrize("tension", [0.0, -0.1])
def test_a_cable_without_tension_holds_nothing(motion: Motion, tension: float) -> None:
    c = motion.tensions.elevated(1).coefficients.copy()
    c[3, 1, 1] = tension
    certificate = certified(
        replace(motion, tensions=PiecewisePolynomial(motion.tensions.breaks, c))
    )
    assert not certificate["equilibrium"].holds
    assert certificate["equilibrium"].where[0] in {"p1", "p2"}


def test_slack_everywhere(motion: Motion) -> None:
    c = np.zeros_like(motion.tensions.coefficients)
    certificate = certified(
        replace(motion, tensions=PiecewisePolynomial(motion.tensions.breaks, c))
    )
    assert not certificate["equilibrium"].holds
    assert certificate["thrust"].worst == pytest.approx(0.132 * 9.81, rel=1e-2)


def test_a_thrust_of_nothing_points_anywhere(motion: Motion) -> None:
    """In free fall without a pull there is no thrust, and so no angle that could be kept."""
    one = with_parts(motion, lambda p: PiecewisePolynomial(p.breaks[:2], p.coefficients[:1]))
    place = one.drones.coefficients[..., :1] * np.ones(3)
    place[0, 3, 2] += -0.5 * 9.81 * one.duration**2 * np.array([0.0, 0.0, 1.0])  # of t²
    slack = PiecewisePolynomial.constant(one.drones.breaks, np.zeros(4))
    falling = with_drones(replace(one, tensions=slack), place)
    check = certified(falling)["tilt"]
    assert check.worst == pytest.approx(180.0)
    assert check.where == ("r1",)


@pytest.mark.parametrize("size", [1e9, 1e300])
def test_coefficients_beyond_all_measure(motion: Motion, size: float) -> None:
    c = motion.drones.coefficients.copy()
    c[2, 3, 1, 4] = size
    certificate = certified(with_drones(motion, c))
    for name in ("speed", "acceleration", "thrust", "cable_length"):
        assert not certificate[name].holds, name


@pytest.mark.parametrize("worst", [math.nan, math.inf])
def test_numbers_that_are_none_never_hold(worst: float) -> None:
    check = Check.of("speed", worst, 1.0, "max", "m/s", 0.0, ())
    assert not check.holds
    assert check.bound > 1e300
    low = Check.of("legs", -worst, 0.1, "min", "m", 0.0, ())
    assert not low.holds
    assert low.bound < -1e300
