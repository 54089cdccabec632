"""Attitude loops of simulated drones follow from the gains that exports write."""

from __future__ import annotations

import math

import pytest

from hitchopt.drones.firmware import attitude_loop


def test_mellingers_commands_turn_a_crazyflie_as_its_motors_do() -> None:
    """A motor has 1.89 µN per step; roll lifts two motors and lowers two, by half a command."""
    step = 1.0 / (4.0 * 132_000.0)
    arm = 0.046 / math.sqrt(2.0)
    error = 2.0  # of a small angle: the vee map of R_d^T R − R^T R_d, not halved
    torque = 70_000.0 * error * (4.0 * 0.5 * step) * arm
    loop = attitude_loop("mellinger")
    assert loop.stiffness[0] == pytest.approx(torque / 16.57e-6, rel=1e-12)
    assert loop.damping[0] == pytest.approx(20_000.0 / 140_000.0 * loop.stiffness[0], rel=1e-12)
    assert loop.lead == pytest.approx(200.0 / 140_000.0 * loop.stiffness[0], rel=1e-12)
    assert loop.damping[1] == pytest.approx(0.1 * loop.stiffness[1], rel=1e-12)  # 12 of 2 · 60


def test_lees_moments_are_divided_by_the_inertia() -> None:
    loop = attitude_loop("lee")
    assert loop.stiffness == pytest.approx((0.007 / 16.57e-6, 0.008 / 29.26e-6), rel=1e-12)
    assert loop.damping == pytest.approx((0.00115 / 16.57e-6, 0.002 / 29.26e-6), rel=1e-12)
    assert loop.integral == pytest.approx((0.03 / 16.57e-6, 0.03 / 29.26e-6), rel=1e-12)
