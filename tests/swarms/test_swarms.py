"""Problems of single drones: files, mappings, schema, and what becomes of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.mission.loading import load_problem, problem_from_dict
from hitchopt.steps.moving import Hold
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.swarms.flights import flyable_accelerations
from tests.helpers.plans import PROBLEMS, header
from tests.helpers.problem_cases import VALIDATOR

SWARMS = PROBLEMS / "swarms"
INFEASIBLE = sorted((SWARMS / "infeasible").glob("*.yaml"))


def full() -> dict[str, Any]:
    """A problem with every key."""
    wall = [[0, 1], [0.3, 1.4], [0.4, 0.9]]
    return {
        "title": "Every key",
        "team": {"drones": 2, "quadrotor": [{"mass": 0.1}, {"max_thrust": 3.0}]},
        "limits": {"speed": 0.8, "acceleration": 1.5, "jerk": 12.0, "tilt_deg": 30, "duration": 9},
        "separation": {"radius": 0.1, "height": 0.25},
        "arena": {"lower": [-2, -2, 0], "upper": [2, 2.5, 3]},
        "keep_out": [{"polygon": wall, "lower": 0.0, "upper": 2.0}],
        "objects": {"pole": {"circle": 0.1, "to": 1.5, "at": [1.0, 1.5, 0.0], "fixed": True}},
        "start": [[-1, 0.1, 1.0], [1.0, 0, 1.1]],
        "goal": [[1, 0.2, 1.1], [-1.0, 0.3, 1.2]],
        "duration": 6.5,
    }


def swarm(data: dict[str, Any]) -> ho.Problem:
    problem = problem_from_dict(data)
    assert problem.kind == "swarm"
    return problem


def test_every_key_is_read_and_kept() -> None:
    VALIDATOR.validate(full())
    problem = swarm(full())
    assert problem.arena is not None
    assert problem.team.mass.tolist() == [0.1, 0.132]
    assert problem.team.max_thrust.tolist() == [2.6, 3.0]
    assert problem.limits == ho.Limits(0.8, 1.5, 12.0, math.radians(30.0), duration=9.0)
    assert problem.separation == ho.Separation(0.1, 0.25)
    assert problem.arena.upper.tolist() == [2.0, 2.5, 3.0]
    assert problem.keep_out[0].polygon.vertices[1].tolist() == [0.3, 1.4]
    plan = ho.separate(problem)
    ends = plan.at([0.0, 6.5]).positions
    np.testing.assert_allclose(ends, [full()["start"], full()["goal"]], atol=1e-9)
    assert plan.duration == pytest.approx(6.5)
    assert plan.certificate.certified
    assert {"keep_out", "arena", "duration"} <= {check.name for check in plan.certificate.checks}


@pytest.mark.slow
@pytest.mark.parametrize("path", INFEASIBLE, ids=lambda path: path.stem)
def test_infeasible_problems_say_what_binds(path: Path) -> None:
    VALIDATOR.validate(read_yaml(path))
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(path)
    assert caught.value.violations[0].constraint == header(path, "Binds")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("goals", [[0, 0, 1]], "did you mean goal?"),
        ("team", {"drones": 3}, "3 points"),
        ("team", {"drones": 2, "tension": 0.4}, "team.tension"),
        ("start", [[0, 0], [1, 1, 1]], "start[0]"),
        ("limits", {"leg": 0.2}, "limits.leg"),
        ("keep_out", [{"polygon": [[0, 0], [1, 0], [1, 1]]}], "keep_out[0]"),
    ],
)
def test_faults_are_named(key: str, value: object, words: str) -> None:
    with pytest.raises(ho.InputError) as caught:
        problem_from_dict({**full(), key: value})
    assert words in str(caught.value)


def test_swarms_are_loaded_as_hitches_are_and_get_no_suggestions() -> None:
    assert load_problem(SWARMS / "head_on.yaml").kind == "swarm"
    assert load_problem(PROBLEMS / "triangle.yaml").kind == "hitch"
    with pytest.raises(ho.InputError, match=r"team = .swarm.: .* catenary robots"):
        ho.suggestions(SWARMS / "head_on.yaml")
    with pytest.raises(ho.InputError, match=r"team = .hitch.: .* single drones"):
        ho.separate(PROBLEMS / "triangle.yaml")


PLACES = np.array([[-1.0, 0.0, 1.0], [1.0, 0.1, 1.0]])
TEAM, SWARM = ho.Team(3, 2.4), ho.Swarm(2)
HITCH = ho.HitchStart(ho.regular_polygon(3, 1.0), 1.0)
FLY, HOLD = ho.Fly(PLACES[::-1]), Hold(1.0)


def test_single_drones_fly_one_flight_after_the_other() -> None:
    plan = ho.solve(ho.Problem(SWARM, PLACES, [FLY, ho.Fly(PLACES, duration=4.0)]))
    assert plan.certificate.certified
    assert [(phase.name, phase.step) for phase in plan.phases] == [("fly", 0), ("fly", 1)]
    ends = plan.at([0.0, plan.duration - 4.0, plan.duration]).positions
    np.testing.assert_allclose(ends, [PLACES, PLACES[::-1], PLACES], atol=1e-9)


@pytest.mark.parametrize(
    ("team", "start", "mission", "key"),
    [
        (TEAM, HITCH, [FLY], "mission[0].fly"),
        (SWARM, PLACES, [FLY, HOLD], "mission[1].hold"),
        (SWARM, HITCH, [FLY], "start"),
        (TEAM, PLACES, [HOLD], "start"),
        (ho.Swarm(3), PLACES, [FLY], "start"),
        (SWARM, PLACES, [FLY, ho.Fly(PLACES[:1])], "mission[1].fly.goal"),
        (SWARM, PLACES, [], "mission"),
    ],
)
def test_starts_and_steps_fit_the_kind_of_team(
    team: Any, start: Any, mission: Any, key: str
) -> None:
    with pytest.raises(ho.InputError) as caught:
        ho.Problem(team, start, mission)
    assert caught.value.key == key


def test_thrust_and_tilt_limit_what_drones_accelerate() -> None:
    data = full()
    data["team"]["quadrotor"] = [{"mass": 0.1, "max_thrust": thrust} for thrust in (1.1, 9.0)]
    data["limits"] = {"tilt_deg": 5.0, "acceleration": 20.0, "jerk": 200.0}
    del data["duration"]
    problem, tilted = swarm(data), 9.81 * math.sin(math.radians(5.0))
    able = flyable_accelerations(problem.team, problem.teams[""].requirements.limits)
    assert able == pytest.approx([min(11.0 - 9.81, tilted), tilted], rel=1e-5)
    certificate = ho.separate(problem).certificate
    assert certificate.certified
    assert certificate["tilt"].worst > 4.0
    with pytest.raises(ho.InfeasibleError, match="duration"):
        ho.solve(problem_from_dict({**full(), "duration": 9.5}))


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
    check = ho.solve(problem_from_dict(data)).certificate["keep_out"]
    assert check.worst >= 0.12
    assert check.where[1] in data["objects"]
    data["goal"] = [[2.25, 1.0, 0.6], [0.8, 1.05, 0.3]]
    with pytest.raises(ho.InfeasibleError, match=r"keep_out: .* d0, tub at the goals"):
        ho.solve(problem_from_dict(data))
