"""The turning rate of thrusts: never beaten by samples, tight, and the same from everywhere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import (
    applied,
    convex_polygon,
    moving,
    random_motion,
    still,
    wild_motion,
)
from free_cases import free_motion, random_flight
from numpy.typing import NDArray

from hitchopt.checks import Check, certify
from hitchopt.checks.drones import BODY_RATE as RULE
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.hitch.team import Swarm
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


def limited(motion: Motion, rate: float = 1.0) -> Motion:
    """The motion with a limit of its body rates [rad/s]."""
    limits = replace(motion.requirements.limits, body_rate=rate)
    return replace(motion, requirements=replace(motion.requirements, limits=limits))


def checked(motion: Motion, rate: float = 1.0) -> Check:
    return applied(RULE, limited(motion, rate))


def turning(motion: Motion, count: int) -> float:
    """The largest of sampled turning rates [deg/s], forces differentiated numerically."""
    states = states_at(motion, np.linspace(0.0, motion.duration, count))
    thrusts, rates = states.thrusts(motion.team), states.thrust_rates(motion.team)
    squared = np.sum(thrusts**2, axis=-1)
    return math.degrees(float(np.max(np.linalg.norm(np.cross(thrusts, rates), axis=-1) / squared)))


@pytest.mark.parametrize(("n", "seed"), [(3, 1), (7, 3)])
def test_no_sample_turns_faster_and_the_bound_is_tight(n: int, seed: int) -> None:
    motion = random_motion(n, seed)
    worst, value = checked(motion).bound, turning(motion, 4001)
    assert value * (1.0 - 1e-7) <= worst <= value * 1.01


def test_tensions_that_change_and_weights_turn_thrusts_as_well() -> None:
    rng = np.random.default_rng(5)
    n = 5
    team = Team(n, 2.6 + 0.05 * np.arange(n), cable_density=0.01)
    start = convex_polygon(n, rng, (3.0, -2.0))

    def tension_at(t: Array) -> Array:
        return 0.6 + 0.15 * np.sin(2.0 * t[:, None] + np.arange(n))

    motion = moving(
        team,
        lambda t: start + 0.05 * np.sin(t[:, None, None] * [0.8, 1.1] + start),
        np.full(n, 0.45),
        order=9,
        tension_at=tension_at,
    )
    phase = replace(motion.phases[0], tension=(0.4, 0.8))
    motion = replace(motion, phases=(phase,))
    worst, value = checked(motion).bound, turning(motion, 6001)
    assert value * (1.0 - 1e-7) <= worst <= value * 1.01


@pytest.mark.parametrize("seed", range(2))
def test_hanging_cables_with_weight_are_enclosed(seed: int) -> None:
    motion = free_motion(*random_flight(seed)).slowed(4.0)
    worst, value = checked(motion).bound, turning(motion, 6001)
    assert value * (1.0 - 1e-7) <= worst <= value * 1.01
    light = replace(motion, team=replace(motion.team, cable_density=0.0))
    assert abs(checked(light).bound - worst) > 1e-3 * worst


def test_polynomials_that_are_no_hitch_at_all() -> None:
    for seed in range(6):
        motion = wild_motion(np.random.default_rng(seed), 3, 2, 1 + seed, 0.05, None)
        assert checked(motion).bound >= turning(motion, 2001) * (1.0 - 1e-7)


def single(coefficients: Array, seconds: float = 1.0) -> Motion:
    """One drone without a cable on one piece, coefficients (3, degree + 1) [m]."""
    part = PiecewisePolynomial(np.array([0.0, seconds]), coefficients[None, None])
    phase = Phase("fly", 0, 0.0, seconds)
    return Motion.single(Swarm(1), Requirements(Limits(), Separation()), part, [phase])


def test_a_constant_level_jerk_turns_as_the_arc_tangent_says() -> None:
    """The tilt is ``atan(j t / g)``: it turns fastest, by j / g, where it is upright."""
    jerk, seconds = 6.0, 1.3
    level = [0.0, 0.0, 0.0, jerk * seconds**3 / 6.0]
    found = checked(single(np.array([level, [2.0] * 4, [1.0] * 4]), seconds))
    exactly = math.degrees(jerk / GRAVITY)
    assert exactly <= found.bound <= exactly * (1.0 + 1e-3)
    assert found.time == pytest.approx(0.0, abs=0.02)
    assert found.where == ("d0",)
    assert (found.unit, found.sense, found.limit) == ("deg/s", "max", math.degrees(1.0))


def test_rest_turns_nothing_and_free_fall_turns_without_bound() -> None:
    resting = still(Team(3, 2.4), np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]), [0.3] * 3)
    assert checked(resting).bound < 1e-6
    fall = -GRAVITY / 2.0
    found = checked(single(np.array([[0.0] * 3, [0.0] * 3, [9.0, 9.0, 9.0 + fall]])))
    assert not found.holds


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_without_a_limit_nothing_is_checked() -> None:
    motion = random_motion(3, 2)
    assert RULE.check(motion) is None
    assert "body_rate" not in [check.name for check in certify(motion).checks]
    assert certify(limited(motion))["body_rate"] == RULE.check(limited(motion))
    assert not checked(motion, 1e-3).holds
