"""Drones and their world: controllers, disturbances, invalid runs, contacts, wakes, friction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation import control
from hitchopt.lab.simulation import world as worlds
from hitchopt.lab.simulation.contacts import touching
from hitchopt.lab.simulation.control import (
    ATTITUDE_GAIN,
    RATE_GAIN,
    Disturbances,
    Drift,
    PositionGains,
)
from hitchopt.lab.simulation.report import Simulation
from hitchopt.lab.simulation.ropes import Ropes, clasped, hanging
from hitchopt.lab.simulation.settings import (
    ACCURATE,
    CALM,
    FAST,
    INDOOR,
    Perturbations,
    Preset,
    Settings,
)
from hitchopt.lab.simulation.world import BODY_HALF_HEIGHT, BODY_RADIUS, World, check_valid
from hitchopt.values import Array
from tests.helpers.scripted import hanging_task, states_of, world_of

Text = pytest.CaptureFixture[str]
PLACES = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 2.0, 3.0], [1.0, 2.0, 3.0]])
WEIGHT = 9.81 * 0.1375  # Of a drone and half of its cable [N]
INERTIA = np.array([[1.6e-4, 1.7e-4, 2.7e-4], [2.0e-4, 2.1e-4, 3.0e-4]])
DEAF = ho.Quadrotor(mass=0.21, max_thrust=3.0, stiffness=9.0, feed_forward=False)
WOUND = ho.Quadrotor(mass=0.13, max_thrust=2.0, stiffness=4.0, integral=True)
TEAM = ho.Team(2, 1.5, topology="open", quadrotor=[WOUND, DEAF])


def hanging_cables(drones: Array = PLACES, **given: Any) -> World:
    """Return two cables that hang between four drones."""
    world = world_of(1.5, 1.5, **given)
    world.place(hanging(world.ropes, drones, 0.0))
    return world


def hovering_pilots(lag: float = 0.0) -> tuple[control.Pilots, World]:
    """Return drones that hover upright with two hanging cables."""
    world = hanging_cables(mass=TEAM.mass)
    disturbed = Settings(perturbations=replace(CALM, lag=lag))
    return control.Pilots(world, TEAM, disturbed), world


def test_the_thrust_is_that_of_the_law() -> None:
    """Gravity, acceleration, springs and the integral, less the cable's force where it is known."""
    p, v, a, f = 0.05 * np.random.default_rng(3).normal(size=(4, 4, 3))
    given = states_of(np.zeros(1), PLACES + p, velocities=v, accelerations=a, cable_forces=f)
    flying, world = hovering_pilots()
    place, speed = world.drones + 0.01, 0.02 * np.ones((4, 3))
    errors, added = np.full((4, 3), 0.04), np.full((4, 3), 0.003)
    flying.integrate(errors, 0.5)
    measured = replace(world.bodies, positions=place, velocities=speed)
    flying.command(given, measured, 0.005, added)
    mass, k = np.repeat([0.13, 0.21], 2)[:, None], np.repeat([4.0, 9.0], 2)[:, None]
    damping = 10.0 / 6.0 * np.sqrt(k * mass)
    wanted = mass * (given.accelerations + [0.0, 0.0, GRAVITY]) + added
    wanted += k * (given.positions - place) + damping * (given.velocities - speed)
    wanted[:2] += 0.5 * k[:2] / 2.0 * 0.04 - given.cable_forces[:2]
    np.testing.assert_allclose(flying.thrusts, wanted[:, 2])  # of drones that are upright
    world.push(flying.thrusts, flying.moments, added)
    force = world.data.xfrc_applied[world.drone_bodies, :3] - added
    np.testing.assert_allclose(force, flying.thrusts[:, None] * np.array([[0.0, 0.0, 1.0]]))


def test_thrust_follows_a_command_with_the_lag_and_within_its_limit() -> None:
    flying, world = hovering_pilots(lag=0.03)
    zero, mass = np.zeros((4, 3)), TEAM.mass[:, None]

    def command(thrust: float) -> Array:
        up = (thrust / mass - GRAVITY) * [0.0, 0.0, 1.0]
        given = states_of(np.zeros(1), world.drones, accelerations=up)
        flying.command(given, replace(world.bodies, velocities=zero), 0.03, zero)
        return flying.thrusts

    np.testing.assert_allclose(command(1.0), 1.0)  # the first command applies at once
    decay = np.exp(-1.0)  # after 30 ms
    reached = np.repeat([2.0 - 1.0 * decay, 2.5 - 1.5 * decay], 2)
    np.testing.assert_allclose(command(2.5), reached)


def test_moments_turn_drones_to_thrusts_that_turn() -> None:
    """About the axis that one is off, and as fast as its thrust turns: then only gyroscopic."""
    random = np.random.default_rng(8)
    desired = np.array([[0.3, -0.2, 1.4], [0.0, 0.4, 2.0]])
    zero, goals = np.zeros((2, 3)), control.desired_attitudes(desired)
    np.testing.assert_allclose(goals[:, :, 2] * np.linalg.norm(desired, axis=1)[:, None], desired)
    np.testing.assert_allclose(np.linalg.det(goals), 1.0)
    assert np.all(goals[:, 0, 0] > 0.9)  # toward x
    for turn in 1e-4 * np.eye(3)[:, None] * np.ones((2, 1)):
        off = goals @ Rotation.from_rotvec(turn).as_matrix()
        found = control.turning_moments(desired, zero, off, zero, INERTIA)
        np.testing.assert_allclose(found, -ATTITUDE_GAIN * INERTIA * turn, atol=1e-9)
        found = control.turning_moments(desired, zero, goals, turn, INERTIA)
        np.testing.assert_allclose(found, -RATE_GAIN * INERTIA * turn, atol=1e-9)
    growth, step = random.normal(size=(2, 3)), 1e-6
    spin = (
        goals.transpose(0, 2, 1)
        @ (control.desired_attitudes(desired + step * growth) - goals)
        / step
    )
    rates = np.stack([spin[:, 2, 1], spin[:, 0, 2], 0.0 * spin[:, 1, 0]], axis=-1)  # yaw stays
    moments = control.turning_moments(desired, growth, goals, rates, INERTIA)
    np.testing.assert_allclose(moments, np.cross(rates, INERTIA * rates), atol=1e-6)


def test_spread_and_memory_do_not_depend_on_the_step() -> None:
    for step in (0.005, 0.1, 1.0):
        drift = Drift(0.3, 0.5, (40_000,), np.random.default_rng(1))
        drift.advance(step)
        before, after = drift.value.copy(), drift.advance(step)
        assert np.std(after) == pytest.approx(0.3, rel=0.02)
        correlation = np.mean(before * after) / np.mean(before**2)
        assert correlation == pytest.approx(np.exp(-step / 0.5), abs=0.02)


def test_switching_off_one_perturbation_does_not_change_the_others() -> None:
    both = Disturbances(INDOOR, 4, 11)
    windless = Disturbances(replace(INDOOR, wind=0.0, steady_wind=0.0, velocity_noise=0.0), 4, 11)
    np.testing.assert_array_equal(both.cable_scale, windless.cable_scale)
    np.testing.assert_array_equal(both.start_offset, windless.start_offset)
    np.testing.assert_array_equal(both.noise.advance(0.1), windless.noise.advance(0.1))
    assert np.max(np.abs(both.wind.value)) > 0.0
    assert not np.array_equal(both.start_offset, Disturbances(INDOOR, 4, 12).start_offset)
    gusts = Disturbances(replace(CALM, wind=0.05), 3000, 5).wind.value
    assert np.sqrt(np.mean(np.sum(gusts**2, axis=-1))) == pytest.approx(0.05, rel=0.02)


COARSE = Preset("coarse", 0.1, 0.012, 0.001)  # Ropes that meet nothing may have long segments
LENGTH, DENSITY = 1.1, 0.02  # Length of a cable [m], and its density [kg/m]


def mean_offsets(settings: Settings) -> Array:
    """Return the mean offsets (4, 3) [m] of drones from setpoints that know no cable weight."""
    team = ho.Team(2, LENGTH, topology="open", quadrotor=ho.Quadrotor(mass=0.15))
    place = PLACES * [0.8, 1.0, 1.0] - [0.0, 0.0, 1.0]
    still = np.repeat(place[None], 51, axis=0)
    settings = replace(settings, preset=COARSE, density=DENSITY, pull_test=False)
    record = Simulation.of(hanging_task(team, still, 0.0 * still), settings).flight.record
    return np.asarray(np.mean(record.drones[record.t > 0.5], axis=0) - place)


@pytest.mark.slow
def test_weight_and_wind_move_drones_by_their_forces_over_the_stiffness() -> None:
    """Cable forces are not fed forward: half a rope's weight pulls each drone down."""
    windy = Settings(perturbations=Perturbations(steady_wind=0.06), stiffness=6.0, seed=3)
    calm = mean_offsets(replace(windy, perturbations=CALM))
    np.testing.assert_allclose(calm[:, 2], -0.5 * GRAVITY * DENSITY * LENGTH / 6.0, rtol=0.02)
    force = Disturbances(windy.perturbations, 2, 3).steady_wind
    np.testing.assert_allclose(mean_offsets(windy) - calm, force / 6.0, atol=2e-4)


@pytest.mark.parametrize("integral", [False, True])
def test_unstable_loops_are_refused(integral: bool) -> None:
    """The limit is that of the linear system of position, velocity, integral and lag."""
    mass, lag = 0.132, Settings().lag

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
    with pytest.raises(ho.InputError, match="is unstable"):
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
    per_axis = np.repeat([stiffness, [0.0, 0.5 * stiffness[1], 0.0]], 2, axis=1)[..., None]
    for found, expected in zip((gains.stiffness, gains.integral), per_axis, strict=True):
        np.testing.assert_allclose(found, np.repeat(expected, 3, axis=1))
    np.testing.assert_array_equal(gains.feed_forward, [True] * 4 + [False] * 2)


@pytest.mark.slow
def test_refined_time_steps_do_not_jerk_ropes() -> None:
    """The stretch under tension must not act as a sudden pull when time steps are refined."""
    world, peaks = hanging_cables(preset=ACCURATE), []
    force = np.array([[-0.5, 0.0, WEIGHT], [0.5, 0.0, WEIGHT]] * 2)
    for step in range(720):
        slowed = force - 2.0 * world.data.qvel[world.drone_dofs]
        world.data.xfrc_applied[world.drone_bodies, :3] = slowed
        world.step(10, substeps=1 if step < 620 else 2)
        peaks.append(float(np.max(world.tensions)))
    taut = max(peaks[600:620])
    assert taut == pytest.approx(0.5, abs=0.05)
    assert max(peaks[620:]) < 1.5 * taut


def test_cables_become_shorter_near_their_drones_alone() -> None:
    world = hanging_cables()
    first = world.model.flexedge_length0.copy()
    world.shorten(np.array([0.01, 0.03]))
    shorter = first - world.model.flexedge_length0
    for cable, by in enumerate([0.01, 0.03]):
        of_cable = shorter[world.edge_cables == cable]
        assert np.sum(of_cable) == pytest.approx(by)
        np.testing.assert_allclose(of_cable, of_cable[::-1])
        third = len(of_cable) // 3
        np.testing.assert_array_equal(of_cable[third:-third], 0.0)


@pytest.mark.parametrize(
    ("pull", "shift", "steps", "words", "where"),
    [
        (12.0, 0.0, 2000, "of .* ropes may have passed each other", "cable 1"),  # strain, tension
        (0.0, 0.006, 1, r"penetration of 0\.00", "cable 0 and cable 1"),
        (1e12, 0.0, 1, r"its state is no longer finite, t = 0\.250 s", "all"),
    ],
)
def test_invalid_states_end_the_run_without_output(
    place: Path, capfd: Text, pull: float, shift: float, steps: int, words: str, where: str
) -> None:
    world = hanging_cables()
    if shift:
        world.place([world.cables[0].copy(), world.cables[0] + [0.0, shift, 0.0]])
    world.data.xfrc_applied[world.drone_bodies, 2] = WEIGHT
    world.data.xfrc_applied[world.drone_bodies[2:], 0] = [-pull, pull]
    with pytest.raises(worlds.InvalidRunError, match=words) as caught:  # noqa: PT012
        for _ in range(steps):
            world.step()
            check_valid(world, 0.25)
    assert (caught.value.where, caught.value.time) == (where, 0.25)
    assert list(place.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("preset", [FAST, ACCURATE])
def test_an_invalid_run_names_no_preset_that_it_uses(preset: Preset) -> None:
    world = hanging_cables(preset=preset)
    world.place([world.cables[0].copy(), world.cables[0] + [0.0, 0.5 * preset.diameter, 0.0]])
    world.step()
    with pytest.raises(worlds.InvalidRunError, match="a higher density") as caught:
        check_valid(world, 0.25)
    assert ("preset accurate" in str(caught.value)) == (preset is FAST)


@pytest.mark.slow
def test_a_rope_picked_up_from_the_ground_is_valid() -> None:
    drones, lifted = np.array([[0.0, 0.0, 0.03], [0.6, 0.0, 0.03]]), []
    for loose in (False, True):
        world = world_of(1.2, preset=ACCURATE, friction=0.0)
        world.place(hanging(world.ropes, drones, 0.0))
        step, worst = ACCURATE.time_step, 0.0
        for k in range(int(0.9 / (5 * step))):
            # Drones that are led upward at 1 m/s by a soft position loop.
            away = drones + [0.0, 0.0, 5 * step * k] - world.drones
            rate = [0.0, 0.0, 1.0] - world.data.qvel[world.drone_dofs]
            force = 40.0 * away + 4.0 * rate + [0.0, 0.0, 9.81 * 0.136]
            world.data.xfrc_applied[world.drone_bodies, :3] = force
            world.step(5, loose=loose)
            strains = world.data.flexedge_length / world.model.flexedge_length0 - 1.0
            worst = max(worst, float(np.max(np.abs(strains))))
            assert world.data.time == pytest.approx(5 * step * (k + 1))
        assert np.min(world.nodes[:, 2]) > 0.1  # all of it has left the ground
        lifted.append(worst)
    assert lifted[0] > 1.3 * worlds.MAX_STRAIN
    assert lifted[1] < 0.8 * worlds.MAX_STRAIN


@pytest.mark.parametrize("depth", [1.5, 3.0])
def test_the_jet_carries_the_momentum_of_the_thrust(depth: float) -> None:
    """Small adjacent disks over the whole plane receive all of it."""
    grid, total = np.linspace(-1.5, 1.5, 61), 0.0
    for x in grid:
        below = np.column_stack([np.full_like(grid, x), grid, np.zeros_like(grid)])
        thrusts = np.append(1.3, np.zeros(len(grid)))
        total -= np.sum(control.downwash(np.vstack([[0.0, 0.0, depth], below]), thrusts)[1:, 2])
    caught = total / control.BLOCKED * (grid[1] - grid[0]) ** 2 / (np.pi * BODY_RADIUS**2)
    assert caught == pytest.approx(1.3, rel=0.01)
    width = (
        0.5 * BODY_RADIUS + control.SPREADING * depth
    )  # where its speed is half of that on its axis
    two = np.array([[0.0, 0.0, depth], [0.0, 0.0, 0.0], [width, 0.0, 0.0]])
    on_axis, aside = control.downwash(two, np.array([1.3, 0.0, 0.0]))[1:, 2]
    assert aside / on_axis == pytest.approx(0.25)


def test_drones_and_cables_in_contact_are_reported_by_name() -> None:
    next_to, above, through = PLACES.copy(), PLACES.copy(), PLACES.copy()
    next_to[2:] = [[0.1, 0.0, 3.02], [0.1, 1.0, 3.0]]  # q1 next to q0
    assert ("q0", "q1") in touching(hanging_cables(next_to))
    above[2:] = [[0.0, 0.0, 3.0 + 2.1 * BODY_HALF_HEIGHT], [0.0, 1.0, 3.0]]  # no ball
    assert ("q0", "q1") not in touching(hanging_cables(above))
    middle = hanging_cables().cables[0]
    through[3] = middle[len(middle) // 2] + [0.0, 0.05, 0.0]  # r1 at the lowest point of cable 0
    through[2] = through[3] + [0.0, 1.0, 0.5]
    assert touching(hanging_cables(through)) == [("r1", "cable 0")]


@pytest.mark.parametrize("height", [0.04, 1.0])
def test_landed_drones_may_touch_their_own_cable(height: float) -> None:
    """Its two drones are side by side, and the cable between them is folded up."""
    world = world_of(0.5, 1.5)
    count = world.ropes.segments + 1
    folded = np.linspace([0.0, 0.0, height], [0.16, 0.0, height], count[0])
    world.place([folded, np.linspace([0.0, 2.0, height], [1.5, 2.0, height], count[1])])
    found = [one for one, other in touching(world) if other == "cable 0"]
    assert found == (["q0", "r0"] if height == 1.0 else [])


@pytest.mark.parametrize("preset", [FAST, ACCURATE])
@pytest.mark.parametrize("room", [0.05, 0.002])
def test_no_link_lies_across_a_rim(preset: Preset, room: float) -> None:
    """A node on top of a rim and a neighbour below it are farther apart than a link is long.

    With little room above a rim, objects may stand there: it is thin.
    """
    section, rim = ho.Section(radius=0.08), ho.Rim(ho.Section(radius=0.21), 0.4)
    tray = ho.SolidObject(section, 0.0, 0.4 + room, 0.1, rim=rim)
    world = world_of(1.0, 1.0, preset=preset, objects={"tray": tray})
    sizes = world.model.geom_size
    (thickness,) = 2.0 * sizes[(sizes[:, 0] == rim.section.radius) & (sizes[:, 1] < 0.1), 1]
    lies_across = thickness + preset.diameter < world.ropes.segment_lengths[0]
    assert lies_across == (room < thickness and preset is FAST)


LEG, SIDE, SPEED, FRICTION = 0.4, 0.6, 0.05, 0.3  # Parts of cables [m], and speed [m/s]

# Times at which cables are perpendicular, and tight, when one begins to slide; and times from and
# to which tensions are measured [s]
TURNED, DRAWN, MEASURED, END = 0.9, 1.0, 3.5, 4.0


@pytest.mark.slow
def test_the_accurate_preset_has_a_capstans_friction() -> None:
    """One of two cables that clasp each other at a right angle is drawn through, without gravity.

    Each is in its own plane, the planes perpendicular to each other: the ratio of tensions before
    and after the clasp is ``exp(μ π/2)``. Where both lie in one plane, as in a hitch, each passes
    under the other and over it, and the ratio is larger: 1.21 for 1.17 at μ = 0.1.
    """
    given = {"tension": 0.5, "cable_density": 0.01, "cable_friction": FRICTION}
    team = ho.Team(2, LEG + SIDE, topology="open", **given)  # type: ignore[arg-type]
    hitch = ho.Hitch(team, [[-SIDE, 0.0], [0.0, 0.0], [0.0, -SIDE]], 1.0, [0.0, LEG])
    ropes = Ropes.of(team, Settings(preset=ACCURATE), team.cable_length)
    world = World(ropes, team.mass, 0.0, {})
    world.model.opt.gravity[:] = 0.0
    world.place(clasped(ropes, team.layout, hitch.drones, hitch.vertices))
    loose, clasp = world.drones - hitch.drones, hitch.vertices[1]
    along = np.vstack([0.0 * hitch.drones[:2], hitch.leg_directions[2:]])
    along[3] *= -1.0  # q1 outward, r1 after it
    edges = np.flatnonzero(world.edge_cables == 1)
    pulled, other = edges[2 : len(edges) // 4], edges[int(0.7 * len(edges)) : -2]
    node, sums = 0.01 * ropes.segment_lengths[0], np.zeros(2)
    for time in ACCURATE.time_step * np.arange(round(END / ACCURATE.time_step)):
        slid, drawn = max(time - DRAWN, 0.0), min(1.0, time / DRAWN)
        turn = 0.5 * np.pi * min(time / TURNED, 1.0)  # of cable 0 about the clasp's bisector
        turned = Rotation.from_rotvec(turn * np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0))
        goal, ahead = hitch.drones + SPEED * slid * along, -hitch.cable_forces
        ahead[:, 2] = 0.0  # no gravity here
        goal[:2], ahead[:2] = clasp + turned.apply(goal[:2] - clasp), turned.apply(ahead[:2])
        error = goal + (1.0 - drawn) * loose - world.drones
        rate = SPEED * along * (slid > 0.0) - world.data.qvel[world.drone_dofs]
        force = team.mass[:, None] * (control.POSITION_GAIN * error + control.VELOCITY_GAIN * rate)
        world.data.xfrc_applied[world.drone_bodies, :3] = force + drawn * ahead
        slowing = 40.0 * (1.0 - drawn) * node  # lest cables whip
        world.data.qfrc_applied[world.node_dofs] = -slowing * world.data.qvel[world.node_dofs]
        world.step()
        check_valid(world, time)
        if time >= MEASURED:
            sums += [np.mean(world.tensions[part]) for part in (pulled, other)]
    assert sums[0] / sums[1] == pytest.approx(np.exp(0.5 * np.pi * FRICTION), rel=0.05)
