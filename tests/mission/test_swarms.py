"""Problems of single drones: files, mappings, schema, and what becomes of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from problem_cases import header

import hitchopt as ho
from hitchopt.mission.keys import problem_schema
from hitchopt.mission.loading import any_problem_from_dict, load_problem, load_swarm
from hitchopt.mission.problem import SwarmProblem
from hitchopt.mission.solving import flyable_accelerations
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.values import Array

SWARMS = Path(__file__).parents[2] / "problems" / "swarms"
GOOD = sorted(SWARMS.glob("*.yaml"))
INFEASIBLE = sorted((SWARMS / "infeasible").glob("*.yaml"))
SMALL = [path for path in GOOD if path.stem not in {"circle_64", "circle_200", "door", "grids"}]
VALIDATOR = jsonschema.Draft202012Validator(problem_schema())


def full() -> dict[str, Any]:
    """A problem with every key."""
    return {
        "title": "Every key",
        "team": {"drones": 2, "quadrotor": [{"mass": 0.1}, {"max_thrust": 3.0}]},
        "limits": {"speed": 0.8, "acceleration": 1.5, "jerk": 12.0, "tilt_deg": 30, "duration": 9},
        "separation": {"radius": 0.1, "height": 0.25},
        "arena": {"lower": [-2, -2, 0], "upper": [2, 2.5, 3]},
        "keep_out": [{"polygon": [[0, 1], [0.3, 1.4], [0.4, 0.9]], "lower": 0.0, "upper": 2.0}],
        "objects": {"pole": {"circle": 0.1, "to": 1.5, "at": [1.0, 1.5, 0.0], "fixed": True}},
        "start": [[-1, 0.1, 1.0], [1.0, 0, 1.1]],
        "goal": [[1, 0.2, 1.1], [-1.0, 0.3, 1.2]],
        "duration": 6.5,
    }


def test_every_key_is_read_and_kept() -> None:
    VALIDATOR.validate(full())
    problem = any_problem_from_dict(full())
    assert isinstance(problem, SwarmProblem)
    assert problem.arena is not None
    found = {
        "mass": problem.team.mass.tolist(),
        "max_thrust": problem.team.max_thrust.tolist(),
        "tilt": math.degrees(problem.limits.tilt),
        "limit": problem.limits.duration,
        "ellipsoid": [problem.separation.radius, problem.separation.height],
        "upper": problem.arena.upper.tolist(),
        "corner": problem.keep_out[0].polygon.vertices[1].tolist(),
        "goal": problem.goal[1].tolist(),
        "duration": problem.duration,
    }
    expected = [[0.1, 0.132], [2.6, 3.0], pytest.approx(30.0), 9.0, [0.1, 0.25], [2.0, 2.5, 3.0]]
    assert list(found.values()) == [*expected, [0.3, 1.4], [-1.0, 0.3, 1.2], 6.5]
    plan = ho.separate(problem)
    assert plan.duration == pytest.approx(6.5)
    assert plan.certificate.certified
    assert {"keep_out", "arena", "duration"} <= {check.name for check in plan.certificate.checks}


@pytest.mark.parametrize("path", SMALL, ids=lambda path: path.stem)
def test_problems_are_planned_and_samples_keep_what_is_certified(path: Path) -> None:
    problem = load_swarm(path)
    plan = ho.separate(problem)
    assert plan.certificate.certified
    t = np.linspace(0.0, plan.duration, 3001)
    state = plan.at(t)
    i, j = np.triu_indices(problem.team.drones, 1)
    offset = (state.positions[:, i] - state.positions[:, j]) * problem.separation.scale
    assert np.min(np.linalg.norm(offset, axis=-1)) >= plan.certificate["separation"].worst
    assert np.max(np.linalg.norm(state.velocities, axis=-1)) <= plan.certificate["speed"].worst
    np.testing.assert_allclose(state.positions[0], problem.start, atol=1e-9)
    np.testing.assert_allclose(state.positions[-1], problem.goal, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("path", INFEASIBLE, ids=lambda path: path.stem)
def test_infeasible_problems_say_what_binds(path: Path) -> None:
    VALIDATOR.validate(read_yaml(path))
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(path)
    assert caught.value.violations[0].constraint == header(path, "Binds")


FROM_TO = {"lower": 0, "upper": 1}


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("goals", [[0, 0, 1]], "did you mean goal?"),
        ("team", {"drones": 3}, "3 points"),
        ("team", {"drones": 2, "tension": 0.4}, "team.tension"),
        ("start", [[0, 0], [1, 1, 1]], "start[0]"),
        ("duration", -1.0, "duration"),
        ("limits", {"leg": 0.2}, "limits.leg"),
        ("arena", {"lower": [0, 0, 0], "upper": [0, 1, 1]}, "arena"),
        ("keep_out", [{"polygon": [[0, 0], [1, 0], [1, 1]], **FROM_TO}], "keep_out[0]"),
        ("keep_out", [{"polygon": [[0, 0], [0, 1], [1, 1]], "lower": 2, "upper": 1}], "upper"),
    ],
)
def test_faults_are_named(key: str, value: object, words: str) -> None:
    with pytest.raises(ho.InputError) as caught:
        any_problem_from_dict({**full(), key: value})
    assert words in str(caught.value)


def test_each_kind_has_its_own_loader() -> None:
    with pytest.raises(ho.InputError, match="load_swarm"):
        load_problem(SWARMS / "head_on.yaml")
    with pytest.raises(ho.InputError, match="load_problem"):
        load_swarm(SWARMS.parent / "triangle.yaml")


def test_thrust_and_tilt_limit_what_drones_accelerate() -> None:
    data = full()
    data["team"]["quadrotor"] = [{"mass": 0.1, "max_thrust": 1.1}, {"mass": 0.1, "max_thrust": 9.0}]
    data["limits"] = {"tilt_deg": 5.0, "acceleration": 20.0, "jerk": 200.0}
    del data["duration"]
    problem = any_problem_from_dict(data)
    assert isinstance(problem, SwarmProblem)
    able = flyable_accelerations(problem)
    assert able[0] == pytest.approx(min(11.0 - 9.81, 9.81 * math.sin(math.radians(5.0))), rel=1e-5)
    assert able[1] == pytest.approx(9.81 * math.sin(math.radians(5.0)), rel=1e-5)
    certificate = ho.separate(problem).certificate
    assert certificate.certified
    assert certificate["tilt"].bound > 4.0
    heavy = {**data, "team": {"drones": 2, "quadrotor": {"mass": 0.5}}}
    with pytest.raises(ho.InfeasibleError, match="thrust"):
        ho.solve(any_problem_from_dict(heavy))
    slow = {**full(), "duration": 9.5}
    with pytest.raises(ho.InfeasibleError, match="duration"):
        ho.solve(any_problem_from_dict(slow))


SQUARE = [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]
STANDS = {"at": [2.0, 1.0, 0.0], "yaw_deg": 20.0, "fixed": True}
OBJECTS: dict[str, Any] = {
    "table": {"outline": SQUARE, "to": 0.4, **STANDS},
    "tub": {"circle": 0.2, "to": 1.2, "at": [2.0, 1.0, 0.4], "rim": {"circle": 0.3, "at": 1.0}},
}


def past_objects(goal: tuple[float, ...] = (3.2, 1.0, 0.6)) -> dict[str, Any]:
    return {
        "team": {"drones": 2},
        "start": [[0.8, 1.0, 0.6], [3.2, 1.05, 0.3]],
        "goal": [list(goal), [0.8, 1.05, 0.3]],
        "objects": OBJECTS,
    }


def distance(beside: Array, z: Array, low: float, high: float) -> float:
    """Least distance to what is upright between heights; level distances to it are given [m]."""
    above = np.maximum(np.maximum(low - z, z - high), 0.0)
    return float(np.min(np.hypot(np.maximum(beside, 0.0), above)))


@pytest.mark.slow
def test_drones_stay_off_objects_by_samples() -> None:
    problem = any_problem_from_dict(past_objects())
    plan = ho.solve(problem)
    points = plan.motion.drones.at(np.linspace(0.0, plan.duration, 20001)).reshape(-1, 3)
    seen = points - [2.0, 1.0, 0.0]
    c, s = math.cos(math.radians(20.0)), math.sin(math.radians(20.0))
    turned = np.stack([c * seen[:, 0] + s * seen[:, 1], c * seen[:, 1] - s * seen[:, 0]], axis=-1)
    beyond = np.maximum(np.abs(turned) - [0.3, 0.2], 0.0)
    to_box, to_axis = np.linalg.norm(beyond, axis=1), np.hypot(seen[:, 0], seen[:, 1])
    rows = ((to_box, 0.0, 0.4), (to_axis - 0.2, 0.4, 1.6), (to_axis - 0.3, 1.4, 1.4))
    nearest = min(distance(beside, seen[:, 2], low, high) for beside, low, high in rows)
    found = plan.certificate["keep_out"]
    assert 0.12 <= found.bound <= nearest + 1e-9
    assert found.bound == pytest.approx(nearest, abs=1e-3)
    assert found.where[1] in OBJECTS


def test_a_goal_at_an_object_names_it() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"keep_out: .* d0, tub at the goals"):
        ho.solve(any_problem_from_dict(past_objects((2.25, 1.0, 0.6))))
