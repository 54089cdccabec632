"""Every problem file of this repository, once: what is read, valid by the schema, or refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from plans import BAD, GOOD, INFEASIBLE, PROBLEMS, header
from problem_cases import TEMPLATE, VALIDATOR, triangle
from ruamel.yaml import YAML

from hitchopt.errors import FileError, HitchoptError, InputError
from hitchopt.mission.keys import SCHEMA_FILE, problem_schema, schema_text
from hitchopt.mission.loading import read_problem
from hitchopt.mission.problem import SwarmProblem
from hitchopt.storage.yaml_file import read_yaml

SWARMS = PROBLEMS / "swarms"
READ = [*GOOD, *INFEASIBLE, TEMPLATE, *sorted(SWARMS.glob("*.yaml"))]
REFUSED = [*BAD, *sorted((SWARMS / "bad").glob("*.yaml"))]


@pytest.mark.parametrize("path", READ, ids=lambda path: path.stem)
def test_what_can_be_planned_is_read_and_valid(path: Path) -> None:
    data: Any = read_yaml(path)
    assert data == YAML(typ="safe", pure=True).load(path)
    VALIDATOR.validate(data)
    problem = read_problem(path)
    assert problem.title
    drones = problem.team.drones if isinstance(problem, SwarmProblem) else problem.team.robots
    assert drones == data["team"].get("robots", data["team"].get("drones"))


@pytest.mark.parametrize("path", REFUSED, ids=lambda path: path.stem)
def test_what_is_wrong_in_itself_is_told_with_its_place(path: Path) -> None:
    with pytest.raises((InputError, FileError)) as caught:
        read_problem(path)
    assert path not in BAD or header(path, "Names") in str(caught.value)
    if isinstance(caught.value, InputError):
        assert all("must be" in line and "; " in line for line in str(caught.value).splitlines())
    expected = header(path, "Schema") if path in BAD else "unjudged"
    try:
        data = read_yaml(path)
    except HitchoptError:
        assert expected == "unreadable"
        return
    if expected != "unjudged":  # JSON has no nan
        assert VALIDATOR.is_valid(data) is (expected == "accepts")


def test_every_fault_has_one_file_and_every_section_is_valid() -> None:
    assert len({header(path, "Fault") for path in BAD}) == len(BAD) >= 25
    VALIDATOR.validate(triangle())


def test_the_shipped_schema_is_current_and_describes_every_key() -> None:
    assert SCHEMA_FILE.read_text(encoding="utf-8") == schema_text()
    shown: dict[str, Any] = {}
    for model in problem_schema()["$defs"].values():
        assert model["additionalProperties"] is False
        assert model["description"]
        for name, entry in model["properties"].items():
            assert "description" in entry or "$ref" in entry, name
            shown |= {name: entry["default"]} if "default" in entry else {}
    for name, value in {"speed": 1.0, "assign": "auto", "height": 0.3, "jerk": 20.0}.items():
        assert shown[name] == value


def test_files_are_read_without_solvers() -> None:
    """What is wrong with a file is told before anything that plans is imported."""
    script = (
        "import sys, hitchopt as ho\n"
        f"ho.read_problem({str(PROBLEMS / 'grip_drum.yaml')!r})\n"
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    told = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"scipy", "casadi", "toppra", "ruckig", "mujoco", "numba"} & set(told.stdout.split())
