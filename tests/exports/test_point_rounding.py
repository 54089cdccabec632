from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exported_plans import hitch_plan

from hitchopt.exports.refit import point_rounding
from hitchopt.exports.refit.piece_fitting import Kind, Scale, fitted
from hitchopt.exports.refit.point_rounding import Keeping, rounded, settled, settling_times
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial

MM = 1e-3

KIND = Kind(degree=7, match=3, quantum=MM, longest=60.0)


def fit() -> PiecewisePolynomial:
    return fitted(hitch_plan().drones, np.array([0.0, 0.35, 0.71, 1.05, 1.3]), KIND)


def speeds(curves: PiecewisePolynomial) -> float:
    t = np.linspace(0.0, curves.duration, 5000)
    return float(np.max(np.linalg.norm(curves.at(t, 1), axis=-1)))


def thrusts(curves: PiecewisePolynomial) -> float:
    """The largest over its limit."""
    motion = hitch_plan()
    t = np.linspace(0.0, curves.duration, 5000)
    states = replace(states_at(motion, t), accelerations=curves.at(t, 2))
    sizes = np.linalg.norm(states.thrusts(motion.team), axis=-1)
    return float(np.max(sizes / motion.team.max_thrust))


def keeping(speed: float, thrust: float = 10.0) -> Keeping:
    motion = hitch_plan()
    mass = motion.team.mass
    forces = states_at(motion, settling_times(fit().breaks)).cable_forces
    load = mass[:, None] * np.array([0.0, 0.0, GRAVITY]) - forces
    return Keeping(speed, mass, thrust * motion.team.max_thrust, load, 2e-3)


def test_a_speed_limit_that_rounding_breaks_is_kept_again() -> None:
    wanted = fit()
    curves = rounded(wanted, MM, Scale(5e-4, 1e-2, 0.2))
    limit = speeds(wanted) * 1.001
    assert speeds(curves) > limit
    found = settled(curves, wanted, MM, keeping(limit))
    assert speeds(found) <= limit
    units = found.coefficients / MM
    np.testing.assert_allclose(units, np.rint(units), atol=1e-9)
    assert np.array_equal(found.ends()[0], curves.ends()[0])
    assert np.array_equal(found.ends()[1], curves.ends()[1])
    t = np.linspace(0.0, wanted.duration, 3000)
    assert np.max(np.linalg.norm(found.at(t) - wanted.at(t), axis=-1)) <= 2e-3


def test_a_thrust_limit_too() -> None:
    wanted = fit()
    curves = rounded(wanted, MM, Scale(1e-3, 1.0, 1e3))  # as good as each alone
    limit = thrusts(wanted) * 1.005
    assert thrusts(curves) > limit
    found = settled(curves, wanted, MM, keeping(10.0, limit))
    assert thrusts(found) <= limit


def test_what_keeps_its_limits_is_left_alone() -> None:
    wanted = fit()
    curves = rounded(wanted, MM, Scale())
    found = settled(curves, wanted, MM, keeping(10.0))
    np.testing.assert_allclose(found.coefficients, curves.coefficients, atol=1e-12)


def test_with_too_much_beyond_nothing_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_rounding, "MOST", 2)
    wanted = fit()
    curves = rounded(wanted, MM, Scale())
    assert settled(curves, wanted, MM, keeping(0.01)) is curves
