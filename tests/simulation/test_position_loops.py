"""Position loops by their statics: under a known force F a drone of stiffness k is F/k off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scripted import hanging_task, regular_hitch, standing

from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Quadrotor, Team
from hitchopt.simulation.disturbances import Disturbances
from hitchopt.simulation.drone_control import ATTITUDE_GAIN, RATE_GAIN, PositionGains
from hitchopt.simulation.rope_thickness import thickness_allowance
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import (
    CALM,
    MOTOR_LAG,
    USUAL,
    Perturbations,
    Preset,
    Settings,
)

Array = NDArray[np.float64]

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


@pytest.mark.parametrize(("body", "stiffness"), [("rigid", 4.0), ("point", 12.0)])
def test_ropes_whose_weight_setpoints_do_not_hold_pull_drones_down(
    body: str, stiffness: float
) -> None:
    """Nothing but setpoints.csv is fed forward: each drone sinks by half a rope's weight over k."""
    sunk = rest(Settings(body=body, stiffness=stiffness))
    expected = -0.5 * GRAVITY * DENSITY * LENGTH / stiffness
    np.testing.assert_allclose(sunk[:, 2], expected, rtol=0.02)
    np.testing.assert_allclose(rest(Settings(body=body), stiffness=stiffness), sunk, atol=1e-12)


def test_without_feed_forward_the_cable_forces_of_setpoints_change_nothing() -> None:
    team = Team(2, LENGTH, topology="open")
    place = np.array([[0.0, 0.0, 2.0], [SPAN, 0.0, 2.0], [0.0, 3.0, 2.0], [SPAN, 3.0, 2.0]])
    still = np.repeat(place[None], 21, axis=0)
    settings = Settings(preset=COARSE, body="point", pull_test=False, feed_forward=False)
    forces = np.full_like(still, 0.2)
    told, untold = (
        simulate(hanging_task(team, still, f), settings).flight.record for f in (forces, 0 * forces)
    )
    np.testing.assert_array_equal(told.drones, untold.drones)
    fed = simulate(hanging_task(team, still, forces), replace(settings, feed_forward=None))
    assert np.max(np.abs(fed.flight.record.drones - told.drones)) > 0.03


def test_a_steady_wind_moves_every_drone_by_its_force_over_the_stiffness() -> None:
    windy = Settings(perturbations=Perturbations(steady_wind=0.06), stiffness=6.0, seed=3)
    shift = rest(windy) - rest(replace(windy, perturbations=CALM))
    force = Disturbances(windy.perturbations, 2, 3).steady_wind
    np.testing.assert_allclose(shift, np.tile(force / 6.0, (4, 1)), atol=2e-4)


def test_integral_action_brings_drones_back_whatever_pulls_at_them() -> None:
    before, after = (rest(Settings(body="point", integral=True), seconds) for seconds in (0.1, 8.0))
    assert np.all(before[:, 2] < -0.01)
    assert np.max(np.abs(after)) < 0.1 * np.min(np.abs(before[:, 2]))
    np.testing.assert_allclose(rest(Settings(body="point"), 8.0, integral=True), after, atol=1e-12)


def test_velocity_noise_shakes_drones_and_nothing_else_does() -> None:
    shaken = Settings(perturbations=Perturbations(velocity_noise=0.1), body="point", seed=1)
    team = Team(2, LENGTH, topology="open")
    place = np.array([[0.0, 0.0, 2.0], [SPAN, 0.0, 2.0], [0.0, 3.0, 2.0], [SPAN, 3.0, 2.0]])
    task = hanging_task(team, np.repeat(place[None], 201, axis=0), np.zeros((201, 4, 3)))
    spread = []
    for settings in (shaken, replace(shaken, perturbations=CALM)):
        flown = simulate(task, replace(settings, preset=COARSE, pull_test=False)).flight
        spread.append(float(np.max(np.std(flown.record.drones, axis=0))))
    assert spread[0] > 20.0 * spread[1]


def test_usual_perturbations_hold_all_kinds() -> None:
    assert USUAL.downwash
    for name in ("noise", "velocity_noise", "wind", "steady_wind", "cable_error", "start_error"):
        assert getattr(USUAL, name) > 0.0


@pytest.mark.parametrize("integral", [False, True])
@pytest.mark.parametrize("body", ["rigid", "point"])
def test_a_loop_that_oscillates_more_and_more_is_refused(body: str, integral: bool) -> None:
    """The limit is that of the linear system's matrix: position, velocity, tilt, rate, moment."""
    mass = 0.132

    def growth(stiffness: float) -> float:
        settings = Settings(body=body)
        damping = 2.0 * (5.0 / 6.0) * np.sqrt(stiffness * mass)
        winding = stiffness / 2.0 if integral else 0.0
        # x, v, wound force, then the force's own states.
        if body == "point":
            a = np.zeros((4, 4))
            a[1, 3] = 1.0 / mass
            command, last = 3, 1.0 / settings.lag
            a[3, 3] = -last
        else:
            a = np.zeros((6, 6))
            a[1, 3], a[3, 4], a[4, 5] = 1.0 / mass, 1.0, 1.0
            last = ATTITUDE_GAIN / MOTOR_LAG
            a[5, 3:] = [-last, -RATE_GAIN / MOTOR_LAG, -1.0 / MOTOR_LAG]
            command = 5
        a[0, 1] = 1.0
        a[2, 0] = -winding
        a[command, :3] += last * np.array([-stiffness, -damping, 1.0])
        if not integral:
            a = np.delete(np.delete(a, 2, 0), 2, 1)
        return float(np.max(np.linalg.eigvals(a).real))

    low, high = 1.0, 1000.0
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if growth(middle) < 0.0 else (low, middle)
    team = Team(3, 2.4, quadrotor=Quadrotor(mass=mass))
    stable = Settings(body=body, stiffness=0.999 * low, integral=integral)
    np.testing.assert_allclose(PositionGains.of(team, stable).stiffness, 0.999 * low)
    with pytest.raises(InputError, match="oscillates more and more"):
        PositionGains.of(team, replace(stable, stiffness=1.001 * low))


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


def test_the_flight_states_the_size_of_its_correction_and_commands_the_setpoints() -> None:
    task = standing(regular_hitch(3), 0.02)
    flight = simulate(task, Settings(body="point", pull_test=False)).flight
    longer = np.max(thickness_allowance(task, 0.012, 0.03))
    assert flight.longer == pytest.approx(longer)
    commanded = np.broadcast_to(task.setpoints.positions[:1], flight.record.commanded.shape)
    np.testing.assert_array_equal(flight.record.commanded, commanded)
