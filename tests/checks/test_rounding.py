"""Rounding never lets a quantity slip past its bound: exact fractions against ``worst``."""

import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from certificate_cases import still, with_drones, with_parts

from hitchopt.checks import certify
from hitchopt.checks.spans import ROUNDING
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

TRIANGLE = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])
LEGS = [0.35, 0.5, 0.45]
SEEDS = range(6)


def upward(seed: int) -> Motion:
    """A short piece, far up, on which one drone moves in z only, with derivatives that grow."""
    rng = np.random.default_rng(seed)
    breaks = np.array([0.3, 0.3 + rng.uniform(1e-3, 1e-2)])
    steady = still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE, LEGS, altitude=900.0)
    motion = with_parts(steady, lambda p: PiecewisePolynomial.constant(breaks, p.at(0.0), 6))
    c = motion.drones.coefficients.copy()
    c[0, 2, 2] += np.arange(7) ** 5 * rng.uniform(0.9, 1.0) * 1e-3 + rng.uniform(0.0, 1e-9, 7)
    return with_drones(motion, c)


def exact_at_end(motion: Motion, order: int) -> Fraction:
    """The derivative in z of drone 2 at the end of its piece, in exact arithmetic."""
    c = [Fraction(float(x)) for x in motion.drones.coefficients[0, 2, 2]]
    first, last = (Fraction(float(t)) for t in motion.drones.breaks)
    degree = len(c) - 1
    for k in range(order):
        c = [(degree - k) * (b - a) / (last - first) for a, b in pairwise(c)]
    return c[-1]


@pytest.mark.parametrize(("order", "name"), [(1, "speed"), (2, "acceleration"), (3, "jerk")])
def test_derivatives_are_not_rounded_below_their_exact_values(order: int, name: str) -> None:
    for seed in SEEDS:
        motion = upward(seed)
        exact, worst = exact_at_end(motion, order), certify(motion)[name].bound
        assert Fraction(worst) >= exact, seed
        assert worst == pytest.approx(float(exact), rel=1e-6)


def test_thrust_is_not_rounded_below_its_exact_value() -> None:
    for seed in SEEDS:
        motion = upward(seed)
        slack = PiecewisePolynomial.constant(motion.drones.breaks, np.zeros(3))
        force = Fraction(0.132) * (exact_at_end(motion, 2) + Fraction(9.81))
        worst = certify(replace(motion, tensions=slack))["thrust"].bound
        assert Fraction(worst) >= force, seed
        assert worst == pytest.approx(float(force), rel=1e-6)


@pytest.mark.parametrize("far", [10.0, 1e4])
def test_distances_give_way_by_the_stated_share_of_the_coordinates(far: float) -> None:
    motion = still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE + far, LEGS, altitude=far)
    certificate = certify(motion)
    magnitude = float(np.max(np.abs(motion.drones.coefficients)))
    x, p = motion.drones.coefficients[0, :, :, 0], motion.vertices.coefficients[0, :, :, 0]
    leg = min(math.dist(x[0], p[0]), math.dist(x[2], p[1]), math.dist(x[4], p[2]))
    margin = leg - certificate["legs"].bound
    assert margin == pytest.approx(ROUNDING * magnitude, rel=0.05, abs=1e-15)
    ratio = min(
        math.dist(x[i] / [0.24, 0.24, 0.6], x[j] / [0.24, 0.24, 0.6])
        for i in range(6)
        for j in range(i)
    )
    margin = ratio - certificate["separation"].bound
    assert margin == pytest.approx(ROUNDING * magnitude / 0.24, rel=0.05, abs=1e-14)
