"""Problems of single drones: files, mappings, schema, and what becomes of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plans import PROBLEMS
from problem_cases import VALIDATOR, header

import hitchopt as ho
from hitchopt.mission.loading import any_problem_from_dict, load_problem, load_swarm
from hitchopt.mission.problem import SwarmProblem
from hitchopt.mission.solving import flyable_accelerations
from hitchopt.storage.yaml_file import read_yaml

SWARMS = PROBLEMS / "swarms"
INFEASIBLE = sorted((SWARMS / "infeasible").glob("*.yaml"))
LARGE = {"circle_64", "circle_200", "door", "grids"}
SMALL = [path for path in sorted(SWARMS.glob("*.yaml")) if path.stem not in LARGE]


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


def swarm(data: dict[str, Any]) -> SwarmProblem:
    problem = any_problem_from_dict(data)
    assert isinstance(problem, SwarmProblem)
    return problem


def test_every_key_is_read_and_kept() -> None:
    VALIDATOR.validate(full())
    problem = swarm(full())
    assert problem.arena is not None
    assert problem.team.mass.tolist() == [0.1, 0.132]
    assert problem.team.max_thrust.tolist() == [2.6, 3.0]
    assert math.degrees(problem.limits.tilt) == pytest.approx(30.0)
    assert problem.limits == ho.Limits(0.8, 1.5, 12.0, problem.limits.tilt, duration=9.0)
    assert problem.separation == ho.Separation(0.1, 0.25)
    assert problem.arena.upper.tolist() == [2.0, 2.5, 3.0]
    assert problem.keep_out[0].polygon.vertices[1].tolist() == [0.3, 1.4]
    assert problem.goal[1].tolist() == [-1.0, 0.3, 1.2]
    plan = ho.separate(problem)
    assert plan.duration == pytest.approx(6.5)
    assert plan.certificate.certified
    assert {"keep_out", "arena", "duration"} <= {check.name for check in plan.certificate.checks}


@pytest.mark.parametrize("path", SMALL, ids=lambda path: path.stem)
def test_problems_are_planned_and_samples_keep_what_is_certified(path: Path) -> None:
    problem = load_swarm(path)
    plan = ho.separate(problem)
    assert plan.certificate.certified
    x = plan.at(np.linspace(0.0, plan.duration, 1001)).positions
    i, j = np.triu_indices(problem.team.drones, 1)
    ratios = np.linalg.norm((x[:, i] - x[:, j]) * problem.separation.scale, axis=-1)
    assert np.min(ratios) >= plan.certificate["separation"].worst
    np.testing.assert_allclose(x[[0, -1]], [problem.start, problem.goal], atol=1e-9)


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
        load_swarm(PROBLEMS / "triangle.yaml")


def test_thrust_and_tilt_limit_what_drones_accelerate() -> None:
    data = full()
    data["team"]["quadrotor"] = [{"mass": 0.1, "max_thrust": most} for most in (1.1, 9.0)]
    data["limits"] = {"tilt_deg": 5.0, "acceleration": 20.0, "jerk": 200.0}
    del data["duration"]
    problem, tilted = swarm(data), 9.81 * math.sin(math.radians(5.0))
    able = flyable_accelerations(problem)
    assert able == pytest.approx([min(11.0 - 9.81, tilted), tilted], rel=1e-5)
    certificate = ho.separate(problem).certificate
    assert certificate.certified
    assert certificate["tilt"].bound > 4.0
    heavy = {**data, "team": {"drones": 2, "quadrotor": {"mass": 0.5}}}
    for changed, binds in ((heavy, "thrust"), ({**full(), "duration": 9.5}, "duration")):
        with pytest.raises(ho.InfeasibleError, match=binds):
            ho.solve(any_problem_from_dict(changed))


def test_a_goal_at_an_object_names_it() -> None:
    tub = {"circle": 0.2, "to": 1.2, "at": [2.0, 1.0, 0.4], "rim": {"circle": 0.3, "at": 1.0}}
    square = [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]
    table = {"outline": square, "to": 0.4, "at": [2.0, 1.0, 0.0], "yaw_deg": 20.0, "fixed": True}
    data = {
        "team": {"drones": 2},
        "start": [[0.8, 1.0, 0.6], [3.2, 1.05, 0.3]],
        "goal": [[3.2, 1.0, 0.6], [0.8, 1.05, 0.3]],
        "objects": {"table": table, "tub": tub},
    }
    found = ho.solve(any_problem_from_dict(data)).certificate["keep_out"]
    assert found.bound >= 0.12
    assert found.where[1] in data["objects"]
    data["goal"] = [[2.25, 1.0, 0.6], [0.8, 1.05, 0.3]]
    with pytest.raises(ho.InfeasibleError, match=r"keep_out: .* d0, tub at the goals"):
        ho.solve(any_problem_from_dict(data))
