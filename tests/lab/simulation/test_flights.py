"""Simulated flights: hitches at rest, under load, while formed, and with objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation.contacts import ObjectContacts
from hitchopt.lab.simulation.control import Disturbances
from hitchopt.lab.simulation.judgement import judge
from hitchopt.lab.simulation.record import ground_of
from hitchopt.lab.simulation.report import Simulation, summary
from hitchopt.lab.simulation.settings import ACCURATE, CALM, FAST, INDOOR, Preset, Settings
from hitchopt.lab.simulation.task import RATE, Cargo, Task, read_task
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.values import Array
from tests.helpers.scripted import (
    changed,
    hanging_task,
    regular_hitch,
    resting_task,
    smooth_step,
    world_of,
)

BRIEF = Settings(pull_test=False)


def test_a_hitch_holds_at_its_planned_position() -> None:
    """With level legs vertices would sag by 9 cm."""
    result = Simulation.of(resting_task(regular_hitch(3), 0.6), Settings())
    team, record, errors = result.flight.task.team, result.flight.record, result.errors
    assert result.outcome.hitched
    assert (result.outcome.failures, result.flight.touches) == ((), {})
    for clasp in result.outcome.clasps:
        assert 0.0 < clasp.moved < 0.1
        # The exterior angle is 120°: two pulls of 0.5 N close the force triangle.
        assert clasp.least_bearing == pytest.approx(0.3 * 2.0 * 0.5 * np.cos(np.pi / 3.0))
        assert clasp.bearing > 3.0 * clasp.least_bearing
    edge, leg = 1.3, 0.5 * (team.cable_length[0] - 1.3)
    sag = GRAVITY * team.cable_density * leg * (leg + edge) / (2.0 * team.tension[0])
    assert abs(np.mean(errors.offsets[30:, :, 2])) < 0.1 * sag
    assert np.max(errors.without_sag[30:]) < 0.05
    assert not errors.moving.any()
    assert np.all(np.isfinite(errors.errors))
    # Each thrust holds its share of the weight upward and the cable's pull across.
    at_rest = (record.t > 0.6) & (record.t < result.flight.rested)
    lift = np.sum(np.mean(record.thrusts[at_rest], axis=0))
    weight = GRAVITY * (np.sum(team.mass) + team.cable_density * np.sum(team.cable_length))
    pull = 2 * team.robots * np.mean(record.tensions[at_rest])
    assert pull == pytest.approx(2 * team.robots * team.tension[0], rel=0.05)
    assert lift == pytest.approx(np.hypot(weight, pull), rel=0.02)
    in_pull_test = record.t > result.flight.pulled - 0.3
    assert 1.3 < np.mean(record.tensions[in_pull_test]) / np.mean(record.tensions[at_rest]) < 1.6
    assert np.all(record.peak_tensions[1:] >= record.tensions[1:] - 1e-12)


@pytest.mark.slow
def test_a_chain_holds_at_its_clasps() -> None:
    team = ho.Team(3, 2.4, topology="open", tension=0.5, cable_density=0.01)
    points = [[1.0, 0.0], [1.8, 1.2], [3.2, 1.3], [4.0, 0.0]]
    result = Simulation.of(resting_task(ho.Hitch.balanced(team, points, altitude=1.6), 0.1), BRIEF)
    assert result.outcome.failures == ()
    assert [clasp.name for clasp in result.outcome.clasps] == ["p1", "p2"]


def test_drones_that_touch_are_reported() -> None:
    hitch = regular_hitch(3)
    positions = np.repeat(hitch.drones[None], 6, axis=0)
    positions[:, 0] = positions[:, 5] + [0.05, 0.0, 0.0]  # q0 next to r2
    weight = -np.multiply.outer(np.ones((6, 1)) * hitch.team.cable_weight, [0.0, 0.0, 1.0])
    result = Simulation.of(hanging_task(hitch.team, positions, weight), BRIEF)
    assert result.flight.touches["q0", "r2"] == 0.0
    assert {failure.kind for failure in result.outcome.failures} >= {"touch"}


@pytest.mark.slow
def test_drones_carry_loads_and_vertices_keep_their_heights() -> None:
    loads, loads_held, heights = np.array([0.01, 0.0, 0.02]), list[float](), list[Array]()
    task = resting_task(regular_hitch(3, load=loads, tension=0.8), 0.5)
    for share in (1.0, 0.5):  # share of the load at the vertices
        result = Simulation.of(
            changed(task, taut=np.full(task.states.tensions.shape, share)), BRIEF
        )
        assert result.outcome.failures == ()
        record, gains = result.flight.record, result.flight.gains
        rows = (record.t > 0.5) & (record.t < result.flight.rested)
        sink = np.mean(record.commanded[rows] - record.drones[rows], axis=0)[:, 2]
        pulls = -task.states.cable_forces[0, :, 2] + gains.stiffness[:, 2] * sink
        loads_held.append(float(np.sum(pulls)))
        heights.append(np.nanmean(result.errors.offsets[30:, :, 2], axis=0))
    assert loads_held[0] == pytest.approx(GRAVITY * (np.sum(loads) + 3 * 0.01 * 2.3), rel=0.02)
    assert np.max(np.abs(heights[0])) < 0.015  # legs planned without load would be 4 cm off
    assert loads_held[0] - loads_held[1] == pytest.approx(0.5 * GRAVITY * np.sum(loads), rel=0.03)
    assert heights[1][2] > 0.02  # the plan expects twice the load


def test_the_task_of_a_plan_is_its_states_at_100_hz(tmp_path: Path) -> None:
    plan = ho.solve(regular_hitch(3, load=0.01), ho.Transport(to=[0.1, 0.0, 2.1]))
    task = read_task(plan.save(tmp_path / "plan"))
    count = int(100 * plan.duration) + 1
    np.testing.assert_allclose(task.states.t, np.append(np.arange(count) / 100, plan.duration))
    states = plan.at(task.states.t)
    for name, values in vars(task.states).items():
        np.testing.assert_allclose(values, getattr(states, name))
    np.testing.assert_array_equal(task.load_shares(0), np.ones(3))
    assert [task.index(t) for t in (-1.0, 0.0, 0.0099, 0.01, 99.0)] == [0, 0, 0, 1, count]


@pytest.mark.slow
def test_a_planned_triangle_is_tied_and_holds_under_disturbances() -> None:
    team = ho.Team(3, 2.3, tension=0.5, cable_density=0.01, cable_friction=0.1)
    q = np.array([[-1.5, 0.9, 1.0], [0.9, 0.9, 1.0], [-0.3, -1.2, 1.0]])
    plan = ho.form(team, q, q + [0.6, 0.0, 0.0], ho.regular_polygon(3, 1.3), altitude=2.0)
    result = ho.simulate(plan, perturbed=True, seed=5, pull_test=False)
    assert result.outcome.failures == ()
    assert {abs(clasp.linking) for clasp in result.outcome.clasps} == {1}
    assert np.nanmax(result.errors.without_sag[-50:]) < 0.05
    tensions = result.flight.record.tensions
    assert np.mean(tensions[:300]) < 0.4 * np.min(tensions[-50:])


TABLE = Section([[-0.4, -0.4], [0.4, -0.4], [0.4, 0.4], [-0.4, 0.4]])
BOX = Section([[-0.2, -0.15], [0.2, -0.15], [0.2, 0.15], [-0.2, 0.15]])
KITE = Section([[0.0, -0.2], [0.15, 0.0], [0.0, 0.1], [-0.15, 0.0]])
ROUND = Section(radius=0.2)
MASS = 0.2


def test_objects_stand_still_on_the_ground_and_on_tables_of_any_shape() -> None:
    objects = {}
    for i, top in enumerate((TABLE, Section(radius=0.4), KITE)):
        for j, section in enumerate((BOX, KITE, ROUND)):
            at = [2.0 * i, 3.0 + 2.0 * j, 0.0]
            objects[f"table {i} {j}"] = SolidObject(top, 0.0, 0.5, at=at, fixed=True)
            on_it = [*at[:2], 0.5]
            objects[f"thing {i} {j}"] = SolidObject(section, mass=0.08, at=on_it, yaw=0.3 * j)
    objects["alone"] = SolidObject(BOX, at=[0.0, -3.0, 0.0], yaw=1.0)
    world = world_of(1.0, objects=objects)
    world.step()
    before = world.poses
    world.step(1000)
    assert np.max(np.abs(world.poses - before)) < 1e-4
    places = [each.at for each in objects.values()]
    np.testing.assert_allclose(world.poses[:, :3], places, atol=1e-4)


@pytest.mark.parametrize("section", [BOX, KITE, ROUND])
def test_moments_of_inertia_are_those_of_points_of_the_body(section: Section) -> None:
    body = SolidObject(section, 0.1, 0.4, MASS, at=[1.0, 2.0, 0.0])
    world = world_of(1.0, objects={"body": body})
    x, step = np.linspace(-0.25, 0.25, 250, retstep=True)
    plane = np.stack(np.meshgrid(x, x + 0.3 * step), axis=-1).reshape(-1, 2)
    plane = plane[section.clearance(plane)[0] < 0.0]
    z = 0.1 + 0.3 * (np.arange(100) + 0.5) / 100
    offsets = np.append(plane - np.mean(plane, axis=0), np.zeros((len(plane), 1)), axis=1)
    spread = offsets.T @ offsets / len(offsets) + np.diag([0.0, 0.0, np.var(z)])
    expected = MASS * np.linalg.eigvalsh(np.trace(spread) * np.eye(3) - spread)
    inertia = world.model.body_inertia[world.object_bodies[0]]
    np.testing.assert_allclose(np.sort(inertia), expected, rtol=0.02)


def test_perturbed_objects_are_within_their_bounds_and_tables_are_fixed() -> None:
    objects = {f"o{i}": SolidObject(BOX, mass=0.1, at=[i, 0, 0]) for i in range(40)}
    objects["table"] = SolidObject(TABLE, at=[0, 5, 0], fixed=True)
    perturbed = Disturbances(INDOOR, 3, 7).disturbed(objects)
    distances = np.array(
        [np.linalg.norm(perturbed[name].at - each.at) for name, each in objects.items()]
    )
    assert distances[-1] == 0.0
    assert 0.015 < np.max(distances) <= 0.02
    for name, nominal, bound in (("mass", 0.1, 0.01), ("friction", 0.5, 0.1)):
        errors = [abs(getattr(each, name) - nominal) for each in perturbed.values()]
        assert 0.8 * bound < np.max(errors) <= bound
    calm = Disturbances(CALM, 3, 7).disturbed(objects)
    assert all(calm[name].mass == each.mass for name, each in objects.items())


FLOOR = -0.5  # Height of the ground [m]


def lifting_task(mass: float = MASS, height: float = 0.2) -> Task:
    """Return the task of a triangle that lifts a tray by its rim from a post."""
    team = {"tension": 1.0, "cable_friction": 0.0, "edge": 0.45}
    empty, full = regular_hitch(3, **team), regular_hitch(3, load=MASS / 3.0, **team)
    t = np.arange(round(3.5 * RATE) + 1) / RATE
    share = smooth_step((t - 1.0) / 1.0)
    rise = 0.05 * (smooth_step(t) - 1.0) + height * smooth_step((t - 2.0) / 1.5)
    share_by_drone, offset = share[:, None, None], (FLOOR + rise)[:, None, None] * [0.0, 0.0, 1.0]
    positions = empty.drones + share_by_drone * (full.drones - empty.drones) + offset
    forces = empty.cable_forces + share_by_drone * (full.cable_forces - empty.cable_forces)
    task, vertices = hanging_task(empty.team, positions, forces), empty.vertices + offset
    x, y, z = np.mean(empty.vertices, axis=0)
    base = FLOOR + z + 0.006 - 0.2
    rim = Rim(Section(radius=0.3), 0.2)
    objects = {
        "post": SolidObject(Section(radius=0.05), 0.0, base - FLOOR, at=[x, y, FLOOR], fixed=True),
        "tray": SolidObject(Section(radius=0.06), 0.0, 0.22, mass, at=[x, y, base], rim=rim),
    }
    poses = np.zeros((len(t), 2, 5))
    poses[..., :2], poses[:, 1, 2], poses[..., 3] = [x, y], base + np.maximum(rise, 0.0), 1.0
    load_share = np.multiply.outer(share, [0.0, 1.0])
    held = np.tile([False, True], (len(t), 1))
    formed, tensions = np.ones(len(t), dtype=np.bool_), np.ones((len(t), 3))
    cargo = Cargo(objects, poses, held, load_share, FLOOR)
    states = replace(task.states, formed=formed, vertices=vertices, tensions=tensions)
    return changed(task, states=states, cargo=cargo)


@pytest.mark.slow
def test_a_tray_is_lifted_by_its_rim_and_not_by_the_pull_test() -> None:
    result = Simulation.of(lifting_task(), Settings())
    flight, (tray,) = result.flight, result.outcome.objects
    assert result.outcome.failures == ()
    assert tray.well_placed
    assert ground_of(flight.task) == FLOOR
    content, body = summary(result)["objects"][0], flight.task.cargo.objects["tray"]
    assert (content["mass"], content["stood_at"]) == (MASS, body.at.tolist())
    assert tray.slipped < 0.02
    assert not tray.free  # the tray ends on the clasps, as planned
    record = flight.record
    assert not record.touched[:20].any()
    assert record.touched[-1].tolist() == [False, True]
    assert result.figures["placed"] == tray.placed
    first, last = np.searchsorted(record.t, [flight.rested, flight.pulled - 1e-6])
    assert abs(record.poses[first, 1, 2] - record.poses[last, 1, 2]) < 0.05
    assert tray.round  # its heading is not checked
    assert replace(tray, turned=40.0).well_placed
    assert not replace(tray, turned=40.0, round=False).well_placed
    assert not replace(tray, tilted=6.0).well_placed
    cargo = flight.task.cargo
    shifted_task = changed(flight.task, cargo=replace(cargo, poses=cargo.poses + 0.01))
    (shifted,) = judge(replace(flight, task=shifted_task)).objects
    # Slip is relative to the pose at lift-off, and swinging about the hitch is none.
    assert shifted.slipped == pytest.approx(tray.slipped)
    swings = Rotation.from_rotvec(0.2 * np.sin(record.t)[:, None] * [1.0, 0.0, 0.0])
    middles, swung = np.mean(record.vertices, axis=1), record.poses.copy()
    swung[:, 1, :3] = middles + swings.apply(swung[:, 1, :3] - middles)
    attitudes = Rotation.from_quat(swung[:, 1, 3:], scalar_first=True)
    swung[:, 1, 3:] = (swings * attitudes).as_quat(scalar_first=True)
    (swinging,) = judge(replace(flight, record=replace(record, poses=swung))).objects
    assert swinging.slipped == pytest.approx(tray.slipped)
    # The plan leaves the tray at rest:
    unheld = {name: np.zeros_like(getattr(cargo, name)) for name in ("held", "load_share")}
    poses = np.repeat(cargo.poses[:1], len(cargo.poses), axis=0)
    cargo_at_rest = replace(cargo, **unheld, poses=poses)
    outcome = judge(replace(flight, task=changed(flight.task, cargo=cargo_at_rest)))
    assert {failure.kind for failure in outcome.failures} == {"misplaced", "caught"}
    assert outcome.objects[0].placed == pytest.approx(0.2, abs=0.02)
    assert np.isnan(outcome.objects[0].slipped)


@pytest.mark.slow
def test_a_tray_that_is_too_heavy_is_dropped() -> None:
    result = Simulation.of(lifting_task(mass=0.6), Settings(pull_test=False))
    failures = {failure.kind: failure for failure in result.outcome.failures}
    assert failures["dropped"].where == ("tray",)
    assert set(failures["touch"].where) == {"post", "tray"}  # the tray should have left the post
    assert 1.5 < failures["dropped"].time < 4.5


def test_objects_are_aloft_between_their_supports() -> None:
    heights = np.array([0.5, 0.5, 0.52, 0.6, 0.6, 0.42, 0.4, 0.4])
    poses = np.zeros((8, 1, 5))
    poses[:, 0, 2] = heights
    load_share = np.array([0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0])[:, None]
    cargo = Cargo({"box": SolidObject(BOX)}, poses, load_share > 0.0, load_share)
    np.testing.assert_array_equal(np.flatnonzero(cargo.lifted[:, 0]), [3, 4])
    ends_aloft = replace(
        cargo, poses=poses[:5], load_share=load_share[:5], held=load_share[:5] > 0.0
    )
    np.testing.assert_array_equal(np.flatnonzero(ends_aloft.lifted[:, 0]), [3, 4])


def test_objects_may_touch_what_is_below_their_places_as_they_are_set_down() -> None:
    """Those that hang tilted touch it before; on other ways nothing may be touched."""
    drum = SolidObject(Section(radius=0.15), 0.0, 0.3, 0.1)
    poses = np.zeros((6, 1, 5))
    poses[:, 0, 0] = [0.0, 0.0, 0.3, 0.6, 0.6, 0.6]
    poses[:, 0, 2] = [0.0, 0.2, 0.2, 0.2, 0.1, 0.0]
    load_share = np.array([0.0, 1.0, 1.0, 1.0, 1.0, 0.0])[:, None]
    cargo = Cargo({"drum": drum}, poses, load_share > 0.0, load_share)
    below = np.array([0.0, -np.inf, -np.inf, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(cargo.places_below[:, 0], below)
    world = world_of(1.0, objects={"drum": drum})  # it stands on the ground
    for _ in range(3):  # it sinks in by micrometres
        world.step()
    touching = ("the ground", "drum")
    found = [ObjectContacts(world, cargo).wrong(index) for index in range(6)]
    assert found == [[], [touching], [touching], [], [], []]


@pytest.mark.parametrize(
    ("section", "preset"),
    [
        (ROUND, FAST),
        (ROUND, ACCURATE),
        (Section(radius=0.1), FAST),
        pytest.param(Section(radius=0.1), ACCURATE, marks=pytest.mark.slow),
    ],
)
def test_a_tilted_cylinder_comes_to_rest(section: Section, preset: Preset) -> None:
    """It neither wobbles nor rolls along its edge."""
    drum = SolidObject(section, 0.0, 0.3, 0.1, 0.5)
    world = world_of(1.0, preset=preset, objects={"drum": drum})
    cable = np.zeros((world.ropes.segments[0] + 1, 3))
    cable[:, 0], cable[:, 2] = np.linspace(2.0, 3.0, len(cable)), 0.1
    world.place([cable])
    joint = world.model.body_dofadr[world.object_bodies[0]]
    world.data.qvel[joint + 3 : joint + 6] = [0.6, 0.2, 1.0]
    world.step(round(1.0 / preset.time_step))
    before = world.poses[0].copy()
    world.step(round(0.5 / preset.time_step))
    np.testing.assert_allclose(world.poses[0], before, atol=1e-5)
    assert np.hypot(*before[4:6]) < 1e-4


@pytest.mark.slow
def test_a_crate_that_two_cables_carry_and_leave_does_not_turn() -> None:
    """Its cables are drawn around it, and loosened, by equal lengths at both of their ends."""
    crate = SolidObject(
        Section([[-0.16, -0.13], [-0.16, 0.13], [0.16, 0.13], [0.16, -0.13]]), 0.0, 0.32, 0.06
    )
    team = ho.Team(2, 2.4, cable_density=0.005, tension=0.5)
    start = ho.DronesStart(
        q=[[-1.4, -1.0, 1.2], [-1.4, 1.0, 1.2]], r=[[0.8, -1.0, 1.2], [0.8, 1.0, 1.2]]
    )
    mission = ho.TransportObject("crate", to=[0.0, 0.3, 0.0], tension=1.0)
    limits = ho.Limits(tracking=0.05)
    plan = ho.solve(start, mission, team=team, limits=limits, objects={"crate": crate})
    result = ho.simulate(plan, pull_test=False)
    assert result.outcome.failures == ()
    poses = result.flight.record.poses[:, 0]
    axes = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
    assert np.max(np.abs(np.degrees(np.arctan2(axes[:, 1, 0], axes[:, 0, 0])))) < 3.0
    (state,) = result.outcome.objects
    assert state.placed < 0.01
