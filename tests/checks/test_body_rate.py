"""The turning rate of thrusts: never beaten by samples, tight, and the same from everywhere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import convex_polygon, moving, random_motion, still, with_parts
from free_cases import free_motion, random_flight
from numpy.typing import NDArray

from hitchopt.checks import Check, certify
from hitchopt.checks.body_rate import RULE
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.swarm import Swarm
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import states_at
from hitchopt.requirements import Limits, Requirements, Separation
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed_products import crossed, exact, inner, reduced, scaled
from hitchopt.trajectory.enclosure import direction, inverse_norm

Array = NDArray[np.float64]


def limited(motion: Motion, rate: float = 1.0) -> Motion:
    """The motion with a limit of its body rates [rad/s]."""
    limits = replace(motion.requirements.limits, body_rate=rate)
    return replace(motion, requirements=replace(motion.requirements, limits=limits))


def checked(motion: Motion, rate: float = 1.0) -> Check:
    found = RULE.check(limited(motion, rate))
    assert found is not None
    return found


def turning(motion: Motion, count: int) -> float:
    """The largest of sampled turning rates [deg/s], forces differentiated numerically."""
    states = states_at(motion, np.linspace(0.0, motion.duration, count))
    thrusts, rates = states.thrusts(motion.team), states.thrust_rates(motion.team)
    squared = np.sum(thrusts**2, axis=-1)
    return math.degrees(float(np.max(np.linalg.norm(np.cross(thrusts, rates), axis=-1) / squared)))


@pytest.mark.parametrize(("n", "seed"), [(3, 1), (4, 2), (7, 3), (12, 4)])
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


@pytest.mark.parametrize("seed", range(4))
def test_hanging_cables_with_weight_are_enclosed(seed: int) -> None:
    motion = free_motion(*random_flight(seed)).slowed(4.0)
    worst, value = checked(motion).bound, turning(motion, 6001)
    assert value * (1.0 - 1e-7) <= worst <= value * 1.01
    light = replace(motion, team=replace(motion.team, cable_density=0.0))
    assert abs(checked(light).bound - worst) > 1e-3 * worst


def test_polynomials_that_are_no_hitch_at_all() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        n, pieces, order = 3, 2, 1 + seed
        breaks = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 2.0, pieces))])
        vertices = np.column_stack([convex_polygon(n, rng, (1.0, 2.0)), np.ones(n)])
        drones = np.repeat(vertices, 2, axis=0) + 0.5 * rng.normal(size=(2 * n, 3))

        def around(places: Array) -> PiecewisePolynomial:
            noise = 0.05 * rng.normal(size=(pieces, *places.shape, order + 1))  # noqa: B023
            return PiecewisePolynomial(breaks, places[..., None] + noise)  # noqa: B023

        motion = Motion(
            Team(n, rng.uniform(2.0, 3.0, n), cable_density=0.003),
            Requirements(Limits(), Separation()),
            around(drones),
            around(vertices),
            PiecewisePolynomial(breaks, rng.uniform(0.1, 0.6, (pieces, n, 2, 4))),
            PiecewisePolynomial(breaks, rng.uniform(0.2, 0.8, (pieces, n, 3))),
            (Phase("morph", 0, 0.0, float(breaks[-1]), tension=(0.2, 0.8)),),
        )
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


def test_translation_rotation_mirror_and_reverse_change_nothing_slower_is_slower() -> None:
    motion = random_motion(4, 11)
    worst = checked(motion).bound
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def moved(part: PiecewisePolynomial) -> PiecewisePolynomial:
        if part.shape[-1:] != (3,) or len(part.shape) < 2:
            return part
        x = np.einsum("ij,pdjn->pdin", turn, part.coefficients) + [[3.0], [-2.0], [1.0]]
        return PiecewisePolynomial(part.breaks, x)

    assert checked(with_parts(motion, moved)).bound == pytest.approx(worst, rel=1e-3)
    reversed_ = with_parts(motion, PiecewisePolynomial.reversed)
    assert checked(reversed_).bound == pytest.approx(worst, rel=1e-3)
    slower = with_parts(motion, lambda part: part.stretched(2.0))
    assert checked(slower).bound < 0.51 * worst


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_without_a_limit_nothing_is_checked() -> None:
    motion = random_motion(3, 2)
    assert RULE.check(motion) is None
    assert "body_rate" not in [check.name for check in certify(motion).checks]
    assert certify(limited(motion))["body_rate"] == RULE.check(limited(motion))
    assert not checked(motion, 1e-3).holds


def test_enclosed_products_hold_what_they_enclose() -> None:
    """Against samples: products, reduced degrees, directions and inverse norms with errors."""
    rng = np.random.default_rng(7)
    a, b = (rng.normal(size=(50, 3, 8)) + 3.0 * rng.normal(size=(50, 3, 1)) for _ in range(2))
    error = 1e-3 * rng.normal(size=(2, 50, 3))
    x = np.linspace(0.0, 1.0, 41)
    powers = np.array(
        [[math.comb(7, i) * t**i * (1.0 - t) ** (7 - i) for i in range(8)] for t in x]
    )
    u, v = (
        np.moveaxis(c @ powers.T, 1, -1) + e[:, None] for c, e in zip((a, b), error, strict=True)
    )
    A, B = (exact(c, np.linalg.norm(e, axis=-1)) for c, e in zip((a, b), error, strict=True))
    size = np.linalg.norm(u, axis=-1, keepdims=True)
    noise = np.linalg.norm(error[0], axis=-1)
    cases = (
        (crossed(A, B), np.cross(u, v)),
        (inner(A, B), np.sum(u * v, axis=-1, keepdims=True)),
        (reduced(crossed(A, B), 5), np.cross(u, v)),
        (inverse_norm(a, noise), 1.0 / size),
        (direction(a, noise), u / size),
        (scaled(A, inverse_norm(a, noise)), u / size),
    )
    for enclosed, values in cases:
        c = enclosed.coefficients
        degree = c.shape[-1] - 1
        here = np.array(
            [
                [math.comb(degree, i) * t**i * (1.0 - t) ** (degree - i) for i in range(degree + 1)]
                for t in x
            ]
        )
        off = np.linalg.norm(np.moveaxis(c @ here.T, 1, -1) - values, axis=-1)
        assert np.all(off <= enclosed.radius[:, None] * (1.0 + 1e-9) + 1e-12)
    assert np.sum(np.isfinite(inverse_norm(a, noise).radius)) > 5
