"""The controller, the motors and disturbances by their laws; position loops by their statics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scripted import hanging_task

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.simulation.control import (
    ATTITUDE_GAIN,
    RATE_GAIN,
    Disturbances,
    Drift,
    Pilots,
    PositionGains,
    desired_attitudes,
    turning_moments,
)
from hitchopt.simulation.judgement import simulate
from hitchopt.simulation.ropes import Ropes, hanging
from hitchopt.simulation.settings import CALM, FAST, USUAL, Perturbations, Preset, Settings
from hitchopt.simulation.task import Setpoints
from hitchopt.simulation.world import World
from hitchopt.values import Array

PLACES = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 3.0, 3.0], [1.0, 3.0, 3.0]])
INERTIA = np.array([[1.6e-4, 1.7e-4, 2.7e-4], [2.0e-4, 2.1e-4, 3.0e-4]])
DEAF = ho.Quadrotor(mass=0.21, max_thrust=3.0, stiffness=9.0, feed_forward=False)
WOUND = ho.Quadrotor(mass=0.13, max_thrust=2.0, stiffness=4.0, integral=True)
TEAM = ho.Team(2, 1.5, topology="open", quadrotor=[WOUND, DEAF])


def pilots(lag: float = 0.0) -> tuple[Pilots, World]:
    """Return drones that hover upright with two hanging cables."""
    ropes = Ropes(np.array([1.5, 1.5]), 0.01, 0.1, FAST)
    world = World(ropes, TEAM.mass, 0.0, {})
    world.place(hanging(ropes, PLACES, 0.0))
    return Pilots(world, TEAM, Settings(perturbations=replace(CALM, lag=lag))), world


def test_the_thrust_is_that_of_the_law() -> None:
    """Gravity, acceleration, springs and the integral, less the cable's force where it is known."""
    p, v, a, f = 0.05 * np.random.default_rng(3).normal(size=(4, 4, 3))
    given, (flying, world) = Setpoints(PLACES + p, v, a, 0.0 * a, f), pilots()
    place, speed = world.drones + 0.01, 0.02 * np.ones((4, 3))
    errors, added = np.full((4, 3), 0.04), np.full((4, 3), 0.003)
    flying.wind(errors, 0.5)
    flying.command(given, place, speed, 0.005, added)
    mass, k = np.repeat([0.13, 0.21], 2)[:, None], np.repeat([4.0, 9.0], 2)[:, None]
    damping = 10.0 / 6.0 * np.sqrt(k * mass)
    wanted = mass * (given.accelerations + [0.0, 0.0, GRAVITY]) + added
    wanted += k * (given.positions - place) + damping * (given.velocities - speed)
    wanted[:2] += 0.5 * k[:2] / 2.0 * 0.04 - given.cable_forces[:2]
    np.testing.assert_allclose(flying.thrusts, wanted[:, 2])  # of drones that are upright
    force = world.data.xfrc_applied[world.drone_bodies, :3]
    np.testing.assert_allclose(force, flying.thrusts[:, None] * np.array([[0.0, 0.0, 1.0]]))


def test_thrust_follows_a_command_with_the_lag_and_within_its_limit() -> None:
    flying, world = pilots(lag=0.03)
    zero, mass = np.zeros((4, 3)), TEAM.mass[:, None]

    def command(thrust: float) -> Array:
        up = (thrust / mass - GRAVITY) * [0.0, 0.0, 1.0]
        given = Setpoints(world.drones, zero, up, zero, zero)
        flying.command(given, world.drones, zero, 0.03, zero)
        return flying.thrusts

    np.testing.assert_allclose(command(1.0), 1.0)  # the first command applies at once
    decay = np.exp(-1.0)  # after 30 ms
    reached = np.repeat([2.0 - 1.0 * decay, 2.5 - 1.5 * decay], 2)
    np.testing.assert_allclose(command(2.5), reached)
    flying.stop(3)
    assert command(2.5)[3] == pytest.approx(decay * reached[3])


def test_moments_turn_drones_to_thrusts_that_turn() -> None:
    """About the axis that one is off, and as fast as its thrust turns: then only gyroscopic."""
    random = np.random.default_rng(8)
    desired = np.array([[0.3, -0.2, 1.4], [0.0, 0.4, 2.0]])
    zero, goals = np.zeros((2, 3)), desired_attitudes(desired)
    np.testing.assert_allclose(goals[:, :, 2] * np.linalg.norm(desired, axis=1)[:, None], desired)
    np.testing.assert_allclose(np.linalg.det(goals), 1.0)
    assert np.all(goals[:, 0, 0] > 0.9)  # toward x
    for turn in 1e-4 * np.eye(3)[:, None] * np.ones((2, 1)):
        off = goals @ Rotation.from_rotvec(turn).as_matrix()
        found = turning_moments(desired, zero, off, zero, INERTIA)
        np.testing.assert_allclose(found, -ATTITUDE_GAIN * INERTIA * turn, atol=1e-9)
        found = turning_moments(desired, zero, goals, turn, INERTIA)
        np.testing.assert_allclose(found, -RATE_GAIN * INERTIA * turn, atol=1e-9)
    growth, step = random.normal(size=(2, 3)), 1e-6
    spin = goals.transpose(0, 2, 1) @ (desired_attitudes(desired + step * growth) - goals) / step
    rates = np.stack([spin[:, 2, 1], spin[:, 0, 2], 0.0 * spin[:, 1, 0]], axis=-1)  # yaw stays
    moments = turning_moments(desired, growth, goals, rates, INERTIA)
    np.testing.assert_allclose(moments, np.cross(rates, INERTIA * rates), atol=1e-6)


def test_spread_and_memory_do_not_depend_on_the_step() -> None:
    for step in (0.005, 0.1, 1.0):
        drift = Drift(0.3, 0.5, (40_000,), np.random.default_rng(1))
        drift.advance(step)
        before, after = drift.value.copy(), drift.advance(step)
        assert np.std(after) == pytest.approx(0.3, rel=0.02)
        correlation = np.mean(before * after) / np.mean(before**2)
        assert correlation == pytest.approx(np.exp(-step / 0.5), abs=0.02)


def test_a_quantity_that_is_switched_off_leaves_the_others_as_they_were() -> None:
    both = Disturbances(USUAL, 4, 11)
    windless = Disturbances(replace(USUAL, wind=0.0, steady_wind=0.0, velocity_noise=0.0), 4, 11)
    np.testing.assert_array_equal(both.cable_scale, windless.cable_scale)
    np.testing.assert_array_equal(both.start_offset, windless.start_offset)
    np.testing.assert_array_equal(both.noise.advance(0.1), windless.noise.advance(0.1))
    assert np.max(np.abs(both.wind.value)) > 0.0
    assert not np.array_equal(both.start_offset, Disturbances(USUAL, 4, 12).start_offset)
    gusts = Disturbances(replace(CALM, wind=0.05), 3000, 5).wind.value
    assert np.sqrt(np.mean(np.sum(gusts**2, axis=-1))) == pytest.approx(0.05, rel=0.02)
    vertices = both.measured(np.zeros((4000, 3)))
    assert np.std(vertices) == pytest.approx(USUAL.vertex_noise, rel=0.03)


COARSE = Preset("coarse", 0.1, 0.012, 0.001)  # Ropes that meet nothing may have long segments
LENGTH, DENSITY = 1.1, 0.02  # Length of a cable [m], and its density [kg/m]


def rest(settings: Settings) -> Array:
    """Return the mean offsets (4, 3) [m] of drones from setpoints that know no cable weight."""
    team = ho.Team(2, LENGTH, topology="open", quadrotor=ho.Quadrotor(mass=0.15))
    place = PLACES * [0.8, 1.0, 1.0] - [0.0, 0.0, 1.0]
    still = np.repeat(place[None], 51, axis=0)
    settings = replace(settings, preset=COARSE, density=DENSITY, pull_test=False)
    record = simulate(hanging_task(team, still, 0.0 * still), settings).flight.record
    return np.asarray(np.mean(record.drones[record.t > 0.5], axis=0) - place)


@pytest.mark.slow
def test_weight_and_wind_move_drones_by_their_forces_over_the_stiffness() -> None:
    """Nothing but the setpoints is fed forward: half a rope's weight pulls each drone down."""
    windy = Settings(perturbations=Perturbations(steady_wind=0.06), stiffness=6.0, seed=3)
    calm = rest(replace(windy, perturbations=CALM))
    np.testing.assert_allclose(calm[:, 2], -0.5 * GRAVITY * DENSITY * LENGTH / 6.0, rtol=0.02)
    force = Disturbances(windy.perturbations, 2, 3).steady_wind
    np.testing.assert_allclose(rest(windy) - calm, np.tile(force / 6.0, (4, 1)), atol=2e-4)


@pytest.mark.parametrize("integral", [False, True])
def test_a_loop_that_oscillates_more_and_more_is_refused(integral: bool) -> None:
    """The limit is that of the linear system's matrix: position, velocity, wound, then the lag."""
    mass, lag = 0.132, CALM.lag

    def growth(stiffness: float) -> float:
        a = np.diag(np.ones(5), 1)
        a[1, 2], a[1, 3], a[2] = 0.0, 1.0 / mass, 0.0
        a[2, 0] = -stiffness / 2.0 if integral else -1e-9
        a[5, 3:] = np.array([-ATTITUDE_GAIN, -RATE_GAIN, -1.0]) / lag
        damping = 2.0 * (5.0 / 6.0) * np.sqrt(stiffness * mass)
        a[5, :3] = np.array([-stiffness, -damping, 1.0]) * ATTITUDE_GAIN / lag
        return float(np.max(np.linalg.eigvals(a).real))

    limit = brentq(growth, 1.0, 1000.0)
    team = ho.Team(3, 2.4, quadrotor=ho.Quadrotor(mass=mass, integral=integral))
    stable = Settings(stiffness=0.999 * limit)
    np.testing.assert_allclose(PositionGains.of(team, stable).stiffness, 0.999 * limit)
    with pytest.raises(ho.InputError, match="oscillates more and more"):
        PositionGains.of(team, replace(stable, stiffness=1.001 * limit))


@pytest.mark.parametrize(
    ("given", "stiffness"), [(None, [36.0 * 0.132, 2.5, 36.0 * 0.132]), (7.0, [7.0, 7.0, 7.0])]
)
def test_the_teams_stiffness_is_used_and_an_option_replaces_it(
    given: float | None, stiffness: list[float]
) -> None:
    kinds = [
        ho.Quadrotor(),
        ho.Quadrotor(stiffness=2.5, integral=True),
        ho.Quadrotor(feed_forward=False),
    ]
    gains = PositionGains.of(ho.Team(3, 2.4, quadrotor=kinds), Settings(stiffness=given))
    np.testing.assert_allclose(gains.stiffness, np.repeat(stiffness, 2))
    np.testing.assert_allclose(gains.integral, np.repeat([0.0, 0.5 * stiffness[1], 0.0], 2))
    np.testing.assert_array_equal(gains.feed_forward, [True] * 4 + [False] * 2)
