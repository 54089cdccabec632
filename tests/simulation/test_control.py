"""The controller and the motors by their laws: rest, rotation, finite differences, lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.hitch import GRAVITY
from hitchopt.simulation.cable_shapes import hanging
from hitchopt.simulation.drone_control import (
    ATTITUDE_GAIN,
    PositionGains,
    attitude_command,
    desired_attitudes,
    desired_thrusts,
)
from hitchopt.simulation.drone_motors import Motors
from hitchopt.simulation.flight_task import Setpoints
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.ropes import Ropes
from hitchopt.simulation.simulation_settings import FAST

Array = NDArray[np.float64]

MASSES = np.array([0.13, 0.21])
GAINS = PositionGains(
    np.array([4.0, 9.0]), np.array([1.2, 2.5]), np.zeros(2), np.ones(2, dtype=np.bool_)
)
INERTIA = np.array([[1.6e-4, 1.7e-4, 2.7e-4], [2.0e-4, 2.1e-4, 3.0e-4]])


def commands(random: np.random.Generator) -> Setpoints:
    p, v, a, j, f = (random.normal(size=(2, 3)) for _ in range(5))
    return Setpoints(p, v, a, j, random.uniform(-3.0, 3.0, 2), 0.3 * f)


def test_at_rest_thrust_carries_the_drone_and_holds_its_cable() -> None:
    pull = np.array([[0.3, -0.2, -0.1], [0.0, 0.4, 0.0]])
    zero = np.zeros((2, 3))
    still = Setpoints(zero, zero, zero, zero, np.zeros(2), pull)
    expected = -pull + MASSES[:, None] * np.array([0.0, 0.0, GRAVITY])
    desired = desired_thrusts(still, MASSES, GAINS, zero, zero)
    np.testing.assert_allclose(desired, expected)
    deaf = replace(GAINS, feed_forward=np.array([True, False]))
    found = desired_thrusts(still, MASSES, deaf, zero, zero)
    np.testing.assert_allclose(found - expected, [[0.0] * 3, pull[1]], atol=1e-15)
    attitudes = desired_attitudes(desired, still.yaw)
    thrusts, moments = attitude_command(still, desired, attitudes, zero, MASSES, INERTIA)
    np.testing.assert_allclose(thrusts, np.linalg.norm(expected, axis=-1))
    np.testing.assert_allclose(moments, 0.0, atol=1e-15)


def test_errors_pull_back_softly() -> None:
    random = np.random.default_rng(3)
    commanded = commands(random)
    there, flying = random.normal(size=(2, 3)), random.normal(size=(2, 3))
    base = desired_thrusts(commanded, MASSES, GAINS, commanded.positions, commanded.velocities)
    change = desired_thrusts(commanded, MASSES, GAINS, there, flying, 0.1) - base
    force = GAINS.stiffness[:, None] * (commanded.positions - there)
    force += GAINS.damping[:, None] * (commanded.velocities - flying)
    np.testing.assert_allclose(change, force + 0.1)


def test_desired_attitudes_are_rotations_along_the_thrust_and_toward_the_yaw() -> None:
    random = np.random.default_rng(4)
    desired = random.normal(size=(20, 3)) + [0.0, 0.0, 3.0]
    yaw = random.uniform(-3.0, 3.0, 20)
    found = desired_attitudes(desired, yaw)
    np.testing.assert_allclose(
        found.transpose(0, 2, 1) @ found, np.eye(3) * np.ones((20, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    np.testing.assert_allclose(found[:, :, 2] * np.linalg.norm(desired, axis=1)[:, None], desired)
    heading = np.arctan2(found[:, 1, 0], found[:, 0, 0])
    level = desired_attitudes(np.tile([0.0, 0.0, 1.0], (20, 1)), yaw)
    np.testing.assert_allclose(np.arctan2(level[:, 1, 0], level[:, 0, 0]), yaw)
    assert np.all(np.abs(np.angle(np.exp(1j * (heading - yaw)))) < 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_world_that_is_turned_about_the_vertical_changes_no_command(seed: int) -> None:
    random = np.random.default_rng(seed)
    commanded = commands(random)
    where, flying, rates = (random.normal(size=(2, 3)) for _ in range(3))
    attitudes = Rotation.random(2, random_state=seed).as_matrix()
    angle = 1.1
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    turned = Setpoints(
        turn.apply(commanded.positions),
        turn.apply(commanded.velocities),
        turn.apply(commanded.accelerations),
        turn.apply(commanded.jerks),
        commanded.yaw + angle,
        turn.apply(commanded.cable_forces),
    )
    desired = desired_thrusts(commanded, MASSES, GAINS, where, flying)
    again = desired_thrusts(turned, MASSES, GAINS, turn.apply(where), turn.apply(flying))
    np.testing.assert_allclose(again, turn.apply(desired), atol=1e-12)
    first = attitude_command(commanded, desired, attitudes, rates, MASSES, INERTIA)
    second = attitude_command(turned, again, turn.as_matrix() @ attitudes, rates, MASSES, INERTIA)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_a_small_tilt_is_turned_back_as_a_damped_spring_would() -> None:
    zero = np.zeros((2, 3))
    still = Setpoints(zero, zero, zero, zero, np.zeros(2), zero)
    desired = desired_thrusts(still, MASSES, GAINS, zero, zero)
    for axis in range(3):
        tilt = np.zeros(3)
        tilt[axis] = 1e-4
        attitudes = np.tile(Rotation.from_rotvec(tilt).as_matrix(), (2, 1, 1))
        _, moments = attitude_command(still, desired, attitudes, zero, MASSES, INERTIA)
        expected = np.zeros((2, 3))
        expected[:, axis] = -ATTITUDE_GAIN * 1e-4 * INERTIA[:, axis]
        np.testing.assert_allclose(moments, expected, atol=1e-10)


def test_attitudes_are_commanded_to_turn_as_fast_as_the_thrust_does() -> None:
    """Drones that already turn with their thrust get no moment but the gyroscopic one."""
    random = np.random.default_rng(8)
    commanded = commands(random)
    still = replace(commanded, yaw=np.zeros(2), cable_forces=np.zeros((2, 3)))
    desired = desired_thrusts(still, MASSES, GAINS, commanded.positions, commanded.velocities)
    step = 1e-6
    later = desired + step * MASSES[:, None] * commanded.jerks
    before, after = desired_attitudes(desired, still.yaw), desired_attitudes(later, still.yaw)
    spin = before.transpose(0, 2, 1) @ (after - before) / step  # of the body, about its own axes
    rates = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    rates[:, 2] = 0.0  # yaw's own share is left to the loop
    _, moments = attitude_command(still, desired, before, rates, MASSES, INERTIA)
    np.testing.assert_allclose(moments, np.cross(rates, INERTIA * rates), atol=1e-6)


@pytest.mark.parametrize("rigid", [True, False])
def test_thrust_follows_a_command_with_the_lag_and_within_its_limit(rigid: bool) -> None:
    drones = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0]])
    ropes = Ropes(np.array([1.5]), 0.01, 0.1, FAST)
    world = World(ropes, MASSES, rigid=rigid)
    world.place(hanging(ropes, drones, 0.0))
    motors = Motors(world, np.array([2.0, 3.0]), 0.05)
    still = replace(commands(np.random.default_rng(1)), yaw=np.zeros(2), jerks=np.zeros((2, 3)))
    up = np.array([[0.0, 0.0, 1.0]])
    motors.apply(1.0 * up.repeat(2, axis=0), still, 0.01)
    np.testing.assert_allclose(motors.thrusts, 1.0)  # the first command applies at once
    for _ in range(5):
        motors.apply(2.5 * up.repeat(2, axis=0), still, 0.01)
    decay = np.exp(-1.0)  # after 50 ms
    np.testing.assert_allclose(motors.thrusts, [2.0 - 1.0 * decay, 2.5 - 1.5 * decay])
    np.testing.assert_array_equal(motors.saturated, [True, False])
    applied = world.data.xfrc_applied[world.drone_bodies, :3]
    np.testing.assert_allclose(applied, motors.thrusts[:, None] * up, atol=1e-12)
