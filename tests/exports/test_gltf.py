"""Scenes for Blender, three.js and model viewers, loaded by trimesh."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from exported_plans import Array, exported, hitch_plan
from format_readers import glb_animation
from scipy.spatial.transform import Rotation

from hitchopt.hitch import Swarm
from hitchopt.mission.loading import load_problem
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at

TRAY = Path(__file__).parents[2] / "problems" / "carry_tray.yaml"


@lru_cache
def tray() -> Motion:
    return solve_problem(load_problem(TRAY)).motion


def y_up(points: Array) -> Array:
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


@pytest.mark.parametrize(
    "make", [hitch_plan, pytest.param(tray, marks=pytest.mark.slow)], ids=["hitch", "tray"]
)
def test_nodes_are_where_the_plan_has_them(make: object, tmp_path: Path) -> None:
    motion: Motion = make()  # type: ignore[operator]
    assert not isinstance(motion.team, Swarm)
    exported(motion, "gltf", tmp_path)
    graph = trimesh.load_scene(tmp_path / "plan.glb").graph
    objects = list(motion.requirements.objects)
    cables = [f"cable {k}" for k in range(motion.team.robots)]
    assert {*motion.team.drone_names, *objects, *cables} <= set(graph.nodes)
    moved = glb_animation(tmp_path / "plan.glb")
    t, _ = moved["q0"]["translation"]
    states = states_at(motion, np.minimum(t, motion.duration))
    for i, name in enumerate(motion.team.drone_names):
        np.testing.assert_allclose(
            moved[name]["translation"][1], y_up(states.positions[:, i]), atol=1e-5
        )
        np.testing.assert_allclose(graph[name][0][:3, 3], y_up(states.positions[0, i]), atol=1e-5)
        upward = Rotation.from_quat(moved[name]["rotation"][1]).apply([0.0, 1.0, 0.0])
        thrust = y_up(states.thrusts(motion.team)[:, i])
        across = np.cross(upward, thrust / np.linalg.norm(thrust, axis=-1, keepdims=True))
        assert np.max(np.abs(across)) < 1e-5  # single precision
    for i, name in enumerate(objects):
        places = y_up(states.object_poses[:, i, :3])
        np.testing.assert_allclose(moved[name]["translation"][1], places, atol=1e-5)


def test_spans_of_a_cable_lead_from_drone_to_drone_and_turn_smoothly(tmp_path: Path) -> None:
    motion = hitch_plan()
    exported(motion, "gltf", tmp_path)
    moved = glb_animation(tmp_path / "plan.glb")
    for k in range(3):
        names = [name for name in moved if name.startswith(f"cable {k} span")]
        ends = []
        for name in names:
            middle, turned, scale = (
                moved[name][p][1] for p in ("translation", "rotation", "scale")
            )
            half = Rotation.from_quat(turned).apply([0.0, 0.5, 0.0]) * scale[:, 1:2]
            ends.append((middle - half, middle + half))
            turns = np.sum(turned[1:] * turned[:-1], axis=1)
            assert np.min(turns) > 0.9
        for (_, before), (after, _) in pairwise(ends):
            np.testing.assert_allclose(before, after, atol=1e-5)
        np.testing.assert_allclose(ends[0][0], moved[f"q{k}"]["translation"][1], atol=1e-5)
        np.testing.assert_allclose(ends[-1][1], moved[f"r{k}"]["translation"][1], atol=1e-5)
        lengths = sum(np.linalg.norm(b - a, axis=-1) for a, b in ends)
        # Drawn hooks are larger than real ones, so that drawn cables are a little longer.
        np.testing.assert_allclose(lengths, motion.team.cable_length[k], rtol=0.04)
