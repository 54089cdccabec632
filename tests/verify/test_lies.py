"""Lies that a plan's file can tell are refused, reported, or none."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plans import PROBLEMS, planned
from verify_lies import LIES, REFUSED, Lie

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.mission.loading import parse_problem, problem_from_dict
from hitchopt.motion.plan_file import write_plan
from hitchopt.storage.yaml_file import read_yaml

PLANS = {
    "morph": "triangle",
    "form": "form_triangle",
    "slid": "friction",
    "swarm": "swarms/circle_6",
    "chain": "open_arc",
}

CARRIED = {"carry": "carry_box", "grip": "grip_drum"}
"""Of these problems the transport alone, from beside the object, which is verified sooner."""

UNLIKE = """
team:
  robots: 3
  cable_length: [2.4, 2.4, 2.6]
  tension: 0.5
  quadrotor: [{mass: 0.132}, {mass: 0.14}, {mass: 0.15, max_thrust: 2.8}]
start:
  drones:
    q: [[0.9, 0.2, 1.5], [-1.2, -0.6, 1.5], [-0.4, 1.2, 1.5]]
    r: [[0.2, -1.2, 1.5], [-1.0, 0.6, 1.5], [0.8, 0.9, 1.5]]
mission:
- form: {polygon: [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], altitude: 1.6}
"""


@lru_cache
def plan(name: str) -> ho.Plan:
    if name == "unlike":
        return ho.solve(parse_problem(UNLIKE, "unlike.yaml", PROBLEMS))
    if name not in CARRIED:
        return planned(PLANS[name])
    problem: Any = read_yaml(PROBLEMS / f"{CARRIED[name]}.yaml")
    form, transport, *_ = problem["mission"]
    x, y, _ = problem["objects"][transport["transport_object"]["object"]]["at"]
    around = [[x - 0.8 + a, y + b] for a, b in form["form"]["polygon"]]
    start = {"hitch": {"polygon": around, "altitude": form["form"]["altitude"]}}
    return ho.solve(problem_from_dict({**problem, "start": start, "mission": [transport]}))


def verdicts(lie: Lie, path: Path) -> Iterator[tuple[str, str]]:
    """Yield limits and their verdicts of a plan that tells a lie."""
    write_plan(path, plan(lie.plan).motion)
    with np.load(path) as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    lie.change(settings, arrays)
    np.savez(path, **{**arrays, "settings": np.array(json.dumps(settings))})
    try:
        for row in second.checked(second.Plan(path)):
            yield row.name, row.verdict
    except second.UnreadableError:
        yield REFUSED, "violated"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in CARRIED else ())
        for name in ("unlike", *PLANS, *CARRIED)
    ],
)
def test_plans_that_tell_none_are_proven(name: str, tmp_path: Path) -> None:
    honest = Lie(name, "the truth", lambda *_: None, "")
    assert {verdict for _, verdict in verdicts(honest, tmp_path / "plan.npz")} == {"proven"}


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES, ids=lambda lie: f"{lie.plan}: {lie.words}")
def test_lies_are_found(lie: Lie, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second, "BUDGET", 300_000)
    told = verdicts(lie, tmp_path / "plan.npz")
    if lie.found:
        assert any(name in lie.found.split("|") and verdict == "violated" for name, verdict in told)
    else:
        assert lie.reason
        assert {verdict for _, verdict in told} == {"proven"}


def test_there_are_a_hundred_kinds() -> None:
    assert len({(lie.plan, lie.words) for lie in LIES}) >= 100
