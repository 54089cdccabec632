"""The turning rate of thrusts: never beaten by samples, tight, and the same from everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import applied, random_motion, still
from free_cases import single
from numpy.typing import NDArray

from hitchopt.checks import Check, certify
from hitchopt.checks.drones import BODY_RATE as RULE
from hitchopt.hitch import GRAVITY, Team
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


def limited(motion: Motion, rate: float = 1.0) -> Motion:
    """The motion with a limit of its body rates [rad/s]."""
    limits = replace(motion.requirements.limits, body_rate=rate)
    return replace(motion, requirements=replace(motion.requirements, limits=limits))


def checked(motion: Motion, rate: float = 1.0) -> Check:
    return applied(RULE, limited(motion, rate))


def alone(coefficients: Array, seconds: float = 1.0) -> Motion:
    """One drone without a cable on one piece, coefficients (3, degree + 1) [m]."""
    return single(PiecewisePolynomial(np.array([0.0, seconds]), coefficients[None, None]))


def test_rest_turns_nothing_and_free_fall_turns_without_bound() -> None:
    resting = still(Team(3, 2.4), np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]), [0.3] * 3)
    assert checked(resting).bound < 1e-6
    fall = -GRAVITY / 2.0
    found = checked(alone(np.array([[0.0] * 3, [0.0] * 3, [9.0, 9.0, 9.0 + fall]])))
    assert not found.holds


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_without_a_limit_nothing_is_checked() -> None:
    motion = random_motion(3, 2)
    assert RULE.check(motion) is None
    assert "body_rate" not in [check.name for check in certify(motion).checks]
    assert certify(limited(motion))["body_rate"] == RULE.check(limited(motion))
    assert not checked(motion, 1e-3).holds
