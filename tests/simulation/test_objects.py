"""Objects in the simulation: they stand, are carried, dropped, touched, and judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scripted import RATE, hanging_task, regular_hitch, smooth

from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.simulation.control import Disturbances
from hitchopt.simulation.flight import ground_of
from hitchopt.simulation.judgement import judge, simulate
from hitchopt.simulation.report import summary
from hitchopt.simulation.ropes import Ropes
from hitchopt.simulation.settings import ACCURATE, CALM, FAST, USUAL, Preset, Settings
from hitchopt.simulation.task import Cargo, Task
from hitchopt.simulation.world import World

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
    world = World(Ropes(np.array([1.0]), 0.01, 0.1, FAST), np.full(2, 0.13), 0.0, objects)
    world.step()
    before = world.poses
    world.step(1000)
    assert np.max(np.abs(world.poses - before)) < 1e-4
    places = [each.at for each in objects.values()]
    np.testing.assert_allclose(world.poses[:, :3], places, atol=1e-4)


@pytest.mark.parametrize("section", [BOX, KITE, ROUND])
def test_moments_of_inertia_are_those_of_points_of_the_body(section: Section) -> None:
    body = SolidObject(section, 0.1, 0.4, MASS, at=[1.0, 2.0, 0.0])
    ropes = Ropes(np.array([1.0]), 0.01, 0.1, FAST)
    world = World(ropes, np.full(2, 0.13), 0.0, {"body": body})
    x, step = np.linspace(-0.25, 0.25, 250, retstep=True)
    plane = np.stack(np.meshgrid(x, x + 0.3 * step), axis=-1).reshape(-1, 2)
    plane = plane[section.clearance(plane)[0] < 0.0]
    z = 0.1 + 0.3 * (np.arange(100) + 0.5) / 100
    off = np.append(plane - np.mean(plane, axis=0), np.zeros((len(plane), 1)), axis=1)
    spread = off.T @ off / len(off) + np.diag([0.0, 0.0, np.var(z)])
    expected = MASS * np.linalg.eigvalsh(np.trace(spread) * np.eye(3) - spread)
    found = world.model.body_inertia[world.object_bodies[0]]
    np.testing.assert_allclose(np.sort(found), expected, rtol=0.02)


def test_perturbed_objects_stay_within_their_bounds_and_tables_stand() -> None:
    objects = {f"o{i}": SolidObject(BOX, mass=0.1, at=[i, 0, 0]) for i in range(40)}
    objects["table"] = SolidObject(TABLE, at=[0, 5, 0], fixed=True)
    found = Disturbances(USUAL, 3, 7).disturbed(objects)
    away = np.array([np.linalg.norm(found[name].at - each.at) for name, each in objects.items()])
    assert away[-1] == 0.0
    assert 0.015 < np.max(away) <= 0.02
    for name, told, most in (("mass", 0.1, 0.01), ("friction", 0.5, 0.1)):
        off = [abs(getattr(each, name) - told) for each in found.values()]
        assert 0.8 * most < np.max(off) <= most
    calm = Disturbances(CALM, 3, 7).disturbed(objects)
    assert all(calm[name].mass == each.mass for name, each in objects.items())


FLOOR = -0.5  # Height of the ground [m]


def lifting(*, mass: float = MASS, planned: float = MASS, by: float = 0.2) -> Task:
    """Return the task of a triangle that takes a tray by its rim off a post and lifts it."""
    team = {"tension": 1.0, "cable_friction": 0.0, "edge": 0.45}
    empty, full = regular_hitch(3, **team), regular_hitch(3, load=planned / 3.0, **team)
    t = np.arange(round(3.5 * RATE) + 1) / RATE
    share = smooth((t - 1.0) / 1.0)
    rise = 0.05 * (smooth(t) - 1.0) + by * smooth((t - 2.0) / 1.5)
    positions = empty.drones + share[:, None, None] * (full.drones - empty.drones)
    positions[..., 2] += FLOOR + rise[:, None]
    forces = empty.cable_forces + share[:, None, None] * (full.cable_forces - empty.cable_forces)
    task = hanging_task(empty.team, positions, forces)
    vertices = np.repeat(empty.vertices[None], len(t), axis=0)
    vertices[..., 2] += FLOOR + rise[:, None]
    x, y, z = np.mean(empty.vertices, axis=0)
    base = FLOOR + z + 0.006 - 0.2
    rim = Rim(Section(radius=0.3), 0.2)
    objects = {
        "post": SolidObject(Section(radius=0.05), 0.0, base - FLOOR, at=[x, y, FLOOR], fixed=True),
        "tray": SolidObject(Section(radius=0.06), 0.0, 0.22, mass, at=[x, y, base], rim=rim),
    }
    poses = np.zeros((len(t), 2, 5))
    poses[..., :2], poses[:, 1, 2], poses[..., 3] = [x, y], base + np.maximum(rise, 0.0), 1.0
    borne = np.multiply.outer(share, [0.0, 1.0])
    held = np.tile([False, True], (len(t), 1))
    formed, tensions = np.ones(len(t), dtype=np.bool_), np.ones((len(t), 3))
    cargo = Cargo(objects, poses, held, borne, FLOOR)
    return replace(task, formed=formed, vertices=vertices, tensions=tensions, cargo=cargo)


@pytest.mark.slow
def test_a_tray_is_lifted_by_its_rim_and_not_by_the_pull_test() -> None:
    lifted = simulate(lifting(), Settings())
    flight, (tray,) = lifted.flight, lifted.outcome.objects
    assert lifted.outcome.failures == ()
    assert tray.well_placed
    assert ground_of(flight.task) == FLOOR
    drawn, stood = summary(lifted)["objects"][0], flight.task.cargo.objects["tray"]
    assert (drawn["mass"], drawn["stood_at"]) == (MASS, stood.at.tolist())
    assert tray.slipped < 0.02
    assert not tray.free  # it ends on the clasps, as planned
    record = flight.record
    assert not record.touched[:20].any()
    assert record.touched[-1].tolist() == [False, True]
    assert lifted.figures["placed"] == tray.placed
    times = np.searchsorted(record.t, [flight.rested, flight.pulled - 1e-6])
    assert abs(np.diff(record.poses[times, 1, 2])[0]) < 0.05
    assert tray.round  # so that its heading is not judged
    assert replace(tray, turned=40.0).well_placed
    assert not replace(tray, turned=40.0, round=False).well_placed
    assert not replace(tray, tilted=6.0).well_placed
    cargo = flight.task.cargo
    aside = replace(flight.task, cargo=replace(cargo, poses=cargo.poses + 0.01))
    (slid,) = judge(replace(flight, task=aside)).objects  # from where it was as it was lifted
    assert slid.slipped == pytest.approx(tray.slipped)
    # And if it was not to be moved:
    none = {name: np.zeros_like(getattr(cargo, name)) for name in ("held", "borne")}
    standing = replace(cargo, **none, poses=np.repeat(cargo.poses[:1], len(cargo.poses), axis=0))
    outcome = judge(replace(flight, task=replace(flight.task, cargo=standing)))
    assert {failure.kind for failure in outcome.failures} == {"misplaced", "caught"}
    assert outcome.objects[0].placed == pytest.approx(0.2, abs=0.02)
    assert np.isnan(outcome.objects[0].slipped)


@pytest.mark.slow
def test_a_tray_that_is_too_heavy_is_dropped() -> None:
    done = simulate(lifting(mass=0.6), Settings(pull_test=False))
    found = {failure.kind: failure for failure in done.outcome.failures}
    assert "dropped" in found
    assert found["dropped"].where == ("tray",)
    assert set(found["touch"].where) == {"post", "tray"}  # which it should have left
    assert 1.5 < found["dropped"].time < 4.5


def test_objects_are_aloft_between_the_places_where_they_stand() -> None:
    heights = np.array([0.5, 0.5, 0.52, 0.6, 0.6, 0.42, 0.4, 0.4])
    poses = np.zeros((8, 1, 5))
    poses[:, 0, 2] = heights
    borne = np.array([0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0])[:, None]
    cargo = Cargo({"box": SolidObject(BOX)}, poses, borne > 0.0, borne)
    np.testing.assert_array_equal(np.flatnonzero(cargo.aloft[:, 0]), [3, 4])
    ends_aloft = replace(cargo, poses=poses[:5], borne=borne[:5], held=borne[:5] > 0.0)
    np.testing.assert_array_equal(np.flatnonzero(ends_aloft.aloft[:, 0]), [3, 4])


@pytest.mark.parametrize("section", [Section(radius=0.2), Section(radius=0.1)])
@pytest.mark.parametrize("preset", [FAST, ACCURATE])
def test_a_cylinder_that_was_tilted_comes_to_rest(section: Section, preset: Preset) -> None:
    """It neither wobbles nor rolls along its edge: what turns it afterwards is friction alone."""
    drum = SolidObject(section, 0.0, 0.3, 0.1, 0.5)
    ropes = Ropes(np.array([1.0]), 0.01, 0.1, preset)
    world = World(ropes, np.array([0.1, 0.1]), 0.0, {"drum": drum})
    away = np.zeros((ropes.segments[0] + 1, 3))
    away[:, 0], away[:, 2] = np.linspace(2.0, 3.0, len(away)), 0.1
    world.place([away])
    joint = world.model.body_dofadr[world.object_bodies[0]]
    world.data.qvel[joint + 3 : joint + 6] = [0.6, 0.2, 1.0]
    world.step(round(1.0 / preset.time_step))
    before = world.poses[0].copy()
    world.step(round(0.5 / preset.time_step))
    np.testing.assert_allclose(world.poses[0], before, atol=1e-5)
    assert np.hypot(*before[4:6]) < 1e-4
