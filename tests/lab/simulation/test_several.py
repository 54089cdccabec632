"""Hitches of several groups in one world: each is evaluated by itself and named by its group."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.distance import pdist

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import UnsupportedError
from hitchopt.lab.flights.recordings import plan_at
from hitchopt.lab.simulation.contacts import touching
from hitchopt.lab.simulation.judgement import closest
from hitchopt.lab.simulation.report import Simulation, ending, summary
from hitchopt.lab.simulation.ropes import simulated_density
from hitchopt.lab.simulation.settings import CALM, Loss, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.mission.problem import Problem
from hitchopt.mission.starts import HitchStart
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.steps.moving import Hold
from hitchopt.support import Feature
from hitchopt.values import Array
from hitchopt.view.scene import ghost_scene
from tests.helpers.groups import beside, beside_saved, moved, with_swarm
from tests.helpers.plans import planned
from tests.helpers.scripted import world_of

BRIEF = Settings(pull_test=False, friction=0.1)


def hovering_motion(robots: int, edge: float, **of_team: float) -> Motion:
    """Return a regular hitch with legs of 0.5 m that hovers for 0.2 s."""
    own = ho.Team(robots, edge + 1.0, **of_team)  # type: ignore[arg-type]
    start = HitchStart(ho.regular_polygon(robots, edge), 2.0)
    return ho.solve(Problem(own, start, (Hold(0.2),))).motion


@pytest.mark.slow
def test_groups_do_not_influence_each_other() -> None:
    """The other group is 30 m away, with other cables."""
    ring, square = hovering_motion(3, 1.3), hovering_motion(4, 1.1, cable_density=0.02, tension=0.6)
    far = moved(square, 30.0, 0.0, 0.0)
    both = Simulation.of(Task.of(Flight((TeamMotion("a", ring), TeamMotion("b", far)))), BRIEF)
    record, drones = both.flight.record, slice(0, 0)
    clasps = cables = slice(0, 0)
    for name, motion in (("a", ring), ("b", far)):
        alone = Simulation.of(Task.of(ho.Flight.of(motion)), BRIEF)
        n, own = motion.team.robots, alone.flight.record
        drones = slice(drones.stop, drones.stop + 2 * n)
        clasps = cables = slice(cables.stop, cables.stop + n)
        np.testing.assert_allclose(record.drones[:, drones], own.drones, atol=2e-3)
        np.testing.assert_allclose(record.vertices[-50:, clasps], own.vertices[-50:], atol=5e-3)
        means = [np.mean(x[-50:], axis=0) for x in (record.tensions[:, cables], own.tensions)]
        np.testing.assert_allclose(means[0], means[1], rtol=0.02)
        for one, other in zip(both.outcome.clasps[clasps], alone.outcome.clasps, strict=True):
            assert one.name == f"{name}.{other.name}"
            assert (one.holds, one.linking) == (True, other.linking)
            assert one.least_bearing == pytest.approx(other.least_bearing, rel=1e-9)
    assert both.outcome.succeeded
    assert ending(both) == "every vertex holds"
    (first, second), apart, time = closest(both.flight)
    least = [np.min(pdist(row)) for row in record.drones]
    assert (apart, time) == (min(least), record.t[np.argmin(least)])
    names = both.flight.task.team.drone_names
    row = record.drones[np.argmin(least)]
    assert np.linalg.norm(row[names.index(first)] - row[names.index(second)]) == apart
    content = summary(both)
    assert content["density"] == {
        "simulated": [simulated_density(ring.team, BRIEF)] * 3 + [0.02] * 4,
        "planned": [0] * 3 + [0.02] * 4,
    }
    assert [each["cable"] for each in content["tension"]][2:4] == ["a.cable 2", "b.cable 0"]
    assert {"a.p2", "b.p3"} < content["vertex_error"].keys()


def test_cables_and_drones_of_two_groups_touch() -> None:
    ropes = world_of(1.0, 1.0).ropes
    world = type(world_of(1.0))(ropes, np.full(4, 0.13), 0.0, {}, ("a.q0", "a.r0", "b.q0", "b.r0"))
    line = np.linspace(-0.5, 0.5, int(ropes.segments[0]) + 1)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    for height, pairs in ((0.008, [("a.cable 0", "b.cable 0")]), (0.1, [])):
        world.place([line * [1.0, 0.0, 0.0] + up, line * [0.0, 1.0, 0.0] + up * (1.0 + height)])
        assert touching(world) == pairs
    positions = up + [[0.5, 0.0, 0.02], [0.0, 0.5, 0.9], [0.0, 0.5, 0.9]]
    contacts = touching(world, ("show.d0", "show.d1", "show.d2"), positions)
    # Contacts among drones without cables are not reported.
    assert contacts == [("a.r0", "show.d0"), ("show.d0", "a.cable 0")]


def test_groups_without_cables_follow_their_plans(tmp_path: Path) -> None:
    swarm, tied = with_swarm(), beside_saved(tmp_path)
    for flight, first in ((swarm, "swarm.d0"), (tied, "show.d0")):
        task = Task.of(flight)
        own = [group for group in flight.teams if group.motion.team.has_cables]
        names = [g.label(x) for g in flight.all_teams for x in g.motion.team.drone_names]
        assert (*task.team.drone_names, *task.passing.names) == tuple(names)
        assert task.passing.names[0] == first
        assert len(task.team.drone_names) == sum(g.motion.team.drones for g in own)
    task = Task.of(swarm)
    t = task.states.t[[0, 100, -1]]
    np.testing.assert_allclose(
        np.concatenate([task.states.positions, task.passing.positions], axis=1)[[0, 100, -1]],
        swarm.drones.at(t),
        atol=1e-9,
    )
    show = tied.others[0].motion.drones
    task = Task.of(tied)
    np.testing.assert_allclose(task.passing.positions[0, :6], show.at(show.breaks[0]), atol=1e-9)
    with pytest.raises(UnsupportedError, match="single drones"):
        Task.of(planned("swarms/circle_6").flight)


@pytest.mark.slow
def test_objects_are_held_by_their_own_group() -> None:
    carry, far = planned("carry_box").motion, moved(planned("triangle").motion, 0.0, 9.0, 0.0)
    both = Task.of(Flight((TeamMotion("far", far), TeamMotion("a", carry)))).cargo
    alone = Task.of(ho.Flight.of(carry)).cargo
    assert both.names == alone.names
    assert set(both.holders.values()) == {"a"}
    count = len(alone.held)
    np.testing.assert_array_equal(both.held[:count], alone.held)
    np.testing.assert_allclose(both.load_share[:count], alone.load_share, atol=1e-9)
    np.testing.assert_allclose(both.poses[:count], alone.poses, atol=1e-9)


def test_functions_of_a_single_team_refuse_several(tmp_path: Path) -> None:
    plan = planned("two_teams")
    flight = plan.flight
    folder = plan.save(tmp_path / "plan", rate=10.0)
    recording = tmp_path / "flight.csv"
    rows = "".join(f"{0.01 * i:.2f},q0,0,0,1\n" for i in range(100))
    recording.write_text(f"t,name,x,y,z\n{rows}", encoding="utf-8")
    task = Task.of(flight)
    show = beside(planned("triangle").motion, moved(planned("triangle").motion, 0, 0, 50.0), 0.0)
    for call in (
        lambda: plan.motion,
        lambda: plan.end,
        lambda: ho.Replanner(planned("triangle").motion.team, plan),
        lambda: ho.equilibrium(plan, 0.5),
        lambda: ho.tolerance(plan, cable_error=0.01),
        lambda: ho.evaluate(recording, folder),
        lambda: ho.calibrate(recording, folder),
        lambda: Simulation.of(task, replace(BRIEF, lost=Loss("a.0", 1.0))),
    ):
        with pytest.raises(UnsupportedError, match="supports a single team, not a, b"):
            call()
    with pytest.raises(UnsupportedError, match="show flies on a clock"):
        ho.Player(show)
    with pytest.raises(UnsupportedError, match=r"a replanner supports .*; plan it without others"):
        show.of_one_team(Feature.REPLANNER)
    result = CliRunner().invoke(
        main, ["statics", str(folder), "--at", "8", "--perturb", "stiffness=40"]
    )
    assert result.exit_code == 0, result.output
    for group in flight.teams:
        rest = ho.equilibrium(group.motion, 8.0, stiffness=40.0)
        content = json.loads((folder / group.name / "statics.json").read_text())
        tensions = [cable["tension"][0] for cable in content["cables"]]
        np.testing.assert_allclose(tensions, rest.tensions, rtol=1e-9)
        assert f"Team {group.name}" in result.stdout


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"controller": "mellinger"}])
def test_two_teams_cross_in_one_hall(options: dict[str, str], tmp_path: Path) -> None:
    flight = planned("two_teams").flight
    task = Task.of(flight)
    names = task.team.drone_names

    def places(t: Array) -> Array:
        return plan_at(task.teams[0], t, task.states.positions)

    result = Simulation.of(task, Settings(perturbations=CALM, friction=0.1, **options))  # type: ignore[arg-type]
    assert result.outcome.hitched
    assert result.outcome.failures == ()
    assert {clasp.name[0] for clasp in result.outcome.clasps} == {"a", "b"}
    assert all(0.0 < clasp.moved < 0.1 for clasp in result.outcome.clasps)
    record, found = result.flight.record, closest(result.flight)
    i, j = (names.index(name) for name in found.drones)
    errors = np.linalg.norm(record.drones - places(record.t), axis=-1)
    between = places(np.linspace(0.0, flight.duration, 2001))
    planned_distance = np.min(np.linalg.norm(between[:, i] - between[:, j], axis=-1))
    assert found.distance >= planned_distance - np.max(errors[:, i]) - np.max(errors[:, j])
    assert np.max(errors[:, [i, j]]) < 0.1
    assert result.save(tmp_path) == tmp_path
    lines = (tmp_path / "drones.csv").read_text(encoding="utf-8").splitlines()
    assert {row["drone"] for row in csv.DictReader(lines)} == set(names)
    scene = ghost_scene(tmp_path, flight)
    positions = scene.at(flight.duration).drones
    np.testing.assert_allclose(positions, places(np.array([flight.duration]))[0], atol=0.1)
