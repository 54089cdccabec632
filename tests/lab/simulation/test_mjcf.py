"""The scene for MuJoCo, stepped with its controls, is the simulated flight."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import UnsupportedError
from hitchopt.lab.simulation.ropes import leg_end_offsets
from hitchopt.lab.simulation.settings import FAST
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.mission.loading import problem_from_dict
from hitchopt.values import Array

TEAM = ho.Team(robots=3, cable_length=2.4, cable_density=0.002)
START = ho.Hitch.spread(TEAM, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.2)
MISSION = [ho.Morph([[0, -0.8], [-0.4, 0.5], [0.4, 0.5]]), ho.Hold(1.5)]


def stepped(path: Path) -> tuple[mujoco.MjModel, mujoco.MjData, dict[float, Array]]:
    """Step a scene with its controls; return the ropes' nodes at the times of its keyframes."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data, nodes = mujoco.MjData(model), dict[float, Array]()
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for k in range(1, model.nkey):
        while data.time < model.key_time[k]:
            mujoco.mj_step(model, data)
        data.ctrl = model.key_ctrl[k]
        nodes[float(model.key_time[k])] = data.flexvert_xpos.copy()
    assert not data.warning.number.any()
    return model, data, nodes


@pytest.mark.slow
def test_the_scene_rests_where_the_simulated_flight_rests(tmp_path: Path) -> None:
    plan = ho.solve(START, MISSION)
    plan.export("mjcf", tmp_path)
    model, data, nodes = stepped(tmp_path / "scene.xml")
    names = plan.flight.team.drone_names
    bodies = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names]
    ends = leg_end_offsets(TeamTask.of(plan.motion), FAST.diameter)[-1]  # of thick ropes
    off = data.xpos[bodies] - plan.at(plan.duration).positions
    assert np.sum(off * ends) / np.sum(ends * ends) == pytest.approx(1.0, abs=0.3)
    np.testing.assert_allclose(off, ends, atol=0.01)
    film = ho.simulate(plan, pull_test=False).flight.film
    for t in (plan.duration - 1.0, plan.duration):
        key = min(nodes, key=lambda time: abs(time - t))
        frame = int(np.argmin(np.abs(film.t - key)))
        apart = np.linalg.norm(nodes[key] - film.nodes[frame], axis=-1)
        assert np.max(apart) < 0.03


@pytest.mark.slow
def test_a_turned_scene_is_the_turned_one(tmp_path: Path) -> None:
    plan = ho.solve(START, ho.Hold(0.3))
    scenes = list[tuple[Array, Array]]()
    for yaw, origin in ((0.0, [0.0, 0.0, 0.0]), (np.pi / 2.0, [1.0, -2.0, 0.5])):
        folder = tmp_path / f"{yaw:g}"
        plan.export("mjcf", folder, yaw=yaw, origin=origin)
        root = ElementTree.parse(folder / "scene.xml").getroot()
        (first, *_) = root.findall("keyframe/key")
        plane = float(root.find("worldbody/geom").get("pos", "").split()[2])  # type: ignore[union-attr]
        state = np.array([float(x) for x in first.attrib["qpos"].split()]).reshape(-1, 3)
        control = np.array([float(x) for x in first.attrib["ctrl"].split()]).reshape(-1, 3)
        assert plane == pytest.approx(origin[2])
        back = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) if yaw else np.eye(3)
        control[::2] -= origin  # positions; forces follow
        scenes.append(((state - origin) @ back.T, control @ back.T))
    for one, other in zip(*scenes, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-7)


def test_single_drones_are_bodies_of_the_scene(tmp_path: Path) -> None:
    problem = problem_from_dict(
        {
            "team": {"drones": 2},
            "start": [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]],
            "goal": [[0.0, 0.5, 1.0], [1.0, 0.5, 1.0]],
        }
    )
    ho.solve(problem).export("mjcf", tmp_path)
    model, data, _ = stepped(tmp_path / "scene.xml")
    np.testing.assert_allclose(data.xpos[1:], [[0.0, 0.5, 1.0], [1.0, 0.5, 1.0]], atol=0.02)
    assert (model.nbody, model.nu) == (3, 12)


def test_loads_are_refused(tmp_path: Path) -> None:
    team = ho.Team(robots=3, cable_length=2.4, load=0.01)
    start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.2)
    with pytest.raises(UnsupportedError, match="does not support loads"):
        ho.solve(start, ho.Hold(0.3)).export("mjcf", tmp_path)
