"""The controller, the motors and disturbances by their laws; position loops by their statics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scripted import hanging_task

from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Quadrotor, Team
from hitchopt.simulation.control import (
    ATTITUDE_GAIN,
    RATE_GAIN,
    Disturbances,
    Drift,
    Motors,
    PositionGains,
    attitude_command,
    desired_attitudes,
    desired_thrusts,
)
from hitchopt.simulation.judgement import simulate
from hitchopt.simulation.ropes import Ropes, hanging
from hitchopt.simulation.settings import (
    CALM,
    FAST,
    MOTOR_LAG,
    USUAL,
    Perturbations,
    Preset,
    Settings,
)
from hitchopt.simulation.task import Setpoints
from hitchopt.simulation.world import World
from hitchopt.values import Array

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


@pytest.mark.parametrize("seed", range(5))
def test_a_world_that_is_turned_about_the_vertical_changes_no_command(seed: int) -> None:
    random = np.random.default_rng(seed)
    commanded = commands(random)
    where, flying, rates = (random.normal(size=(2, 3)) for _ in range(3))
    attitudes = Rotation.random(2, random_state=seed).as_matrix()
    angle = 1.1
    turn = Rotation.from_rotvec([0.0, 0.0, angle])
    parts = {name: turn.apply(each) for name, each in vars(commanded).items() if name != "yaw"}
    turned = Setpoints(**parts, yaw=commanded.yaw + angle)
    desired = desired_thrusts(commanded, MASSES, GAINS, where, flying)
    again = desired_thrusts(turned, MASSES, GAINS, turn.apply(where), turn.apply(flying))
    np.testing.assert_allclose(again, turn.apply(desired), atol=1e-12)
    first = attitude_command(commanded, desired, attitudes, rates, MASSES, INERTIA)
    second = attitude_command(turned, again, turn.as_matrix() @ attitudes, rates, MASSES, INERTIA)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


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


COARSE = Preset("coarse", 0.1, 0.012, 0.001)
"""Ropes that meet nothing may have long segments."""

SPAN, LENGTH, DENSITY = 0.8, 1.1, 0.02
"""Distance of a cable's drones and its length [m], and its density [kg/m]."""


def rest(settings: Settings, seconds: float = 2.0, **of_drones: float | bool) -> Array:
    """Return the mean offsets (4, 3) [m] of drones from setpoints that know no cable weight."""
    kind = Quadrotor(mass=0.15, **of_drones)  # type: ignore[arg-type]
    team = Team(2, LENGTH, topology="open", quadrotor=kind)
    place = np.array([[0.0, 0.0, 2.0], [SPAN, 0.0, 2.0], [0.0, 3.0, 2.0], [SPAN, 3.0, 2.0]])
    still = np.repeat(place[None], round(100 * seconds) + 1, axis=0)
    task = hanging_task(team, still, np.zeros_like(still))
    settings = replace(settings, preset=COARSE, density=DENSITY, pull_test=False)
    flight = simulate(task, settings).flight
    assert flight.error is None
    chosen = flight.record.t > flight.task.duration + 0.5
    offsets: Array = np.mean(flight.record.drones[chosen], axis=0) - place
    return offsets


@pytest.mark.slow
@pytest.mark.parametrize(("body", "stiffness"), [("rigid", 4.0), ("point", 12.0)])
def test_ropes_whose_weight_setpoints_do_not_hold_pull_drones_down(
    body: str, stiffness: float
) -> None:
    """Nothing but setpoints.csv is fed forward: each drone sinks by half a rope's weight over k."""
    sunk = rest(Settings(body=body, stiffness=stiffness))
    expected = -0.5 * GRAVITY * DENSITY * LENGTH / stiffness
    np.testing.assert_allclose(sunk[:, 2], expected, rtol=0.02)
    np.testing.assert_allclose(rest(Settings(body=body), stiffness=stiffness), sunk, atol=1e-12)


def test_a_steady_wind_moves_every_drone_by_its_force_over_the_stiffness() -> None:
    windy = Settings(perturbations=Perturbations(steady_wind=0.06), stiffness=6.0, seed=3)
    shift = rest(windy) - rest(replace(windy, perturbations=CALM))
    force = Disturbances(windy.perturbations, 2, 3).steady_wind
    np.testing.assert_allclose(shift, np.tile(force / 6.0, (4, 1)), atol=2e-4)


@pytest.mark.slow
def test_integral_action_brings_drones_back_whatever_pulls_at_them() -> None:
    before, after = (rest(Settings(body="point", integral=True), seconds) for seconds in (0.1, 8.0))
    assert np.all(before[:, 2] < -0.01)
    assert np.max(np.abs(after)) < 0.1 * np.min(np.abs(before[:, 2]))
    np.testing.assert_allclose(rest(Settings(body="point"), 8.0, integral=True), after, atol=1e-12)


@pytest.mark.parametrize("integral", [False, True])
@pytest.mark.parametrize("body", ["rigid", "point"])
def test_a_loop_that_oscillates_more_and_more_is_refused(body: str, integral: bool) -> None:
    """The limit is that of the linear system's matrix: position, velocity, wound, then the lag."""
    mass = 0.132

    def growth(stiffness: float) -> float:
        states = 4 if body == "point" else 6
        a = np.diag(np.ones(states - 1), 1)
        a[1, 2], a[1, 3], a[2] = 0.0, 1.0 / mass, 0.0
        a[2, 0] = -stiffness / 2.0 if integral else 0.0
        if body == "point":
            last = a[3, 3] = 1.0 / Settings(body=body).lag
            a[3, 3] = -last
        else:
            last = ATTITUDE_GAIN / MOTOR_LAG
            a[5, 3:] = [-last, -RATE_GAIN / MOTOR_LAG, -1.0 / MOTOR_LAG]
        damping = 2.0 * (5.0 / 6.0) * np.sqrt(stiffness * mass)
        a[-1, :3] += last * np.array([-stiffness, -damping, 1.0])
        kept = np.arange(states) if integral else np.delete(np.arange(states), 2)
        return float(np.max(np.linalg.eigvals(a[np.ix_(kept, kept)]).real))

    limit = brentq(growth, 1.0, 1000.0)
    team = Team(3, 2.4, quadrotor=Quadrotor(mass=mass))
    stable = Settings(body=body, stiffness=0.999 * limit, integral=integral)
    np.testing.assert_allclose(PositionGains.of(team, stable).stiffness, 0.999 * limit)
    with pytest.raises(InputError, match="oscillates more and more"):
        PositionGains.of(team, replace(stable, stiffness=1.001 * limit))


def test_the_teams_stiffness_is_used_and_an_option_replaces_it() -> None:
    kinds = [Quadrotor(), Quadrotor(stiffness=2.5, integral=True), Quadrotor(feed_forward=False)]
    team = Team(3, 2.4, quadrotor=kinds)
    gains = PositionGains.of(team, Settings())
    own = 36.0 * 0.132
    np.testing.assert_allclose(gains.stiffness, [own, own, 2.5, 2.5, own, own])
    np.testing.assert_array_equal(gains.integral > 0.0, [False, False, True, True, False, False])
    np.testing.assert_array_equal(gains.feed_forward, [True] * 4 + [False] * 2)
    other = PositionGains.of(team, Settings(stiffness=7.0, integral=False, feed_forward=True))
    np.testing.assert_allclose(other.stiffness, 7.0)
    np.testing.assert_array_equal(other.integral, 0.0)
    assert other.feed_forward.all()
