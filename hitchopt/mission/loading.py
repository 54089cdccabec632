"""Loading of problems from files, or from mappings with the keys of a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hitchopt.errors import FileError, InputError
from hitchopt.mission.objects import with_outlines
from hitchopt.mission.others import NAME
from hitchopt.mission.problem import Problem, SwarmProblem
from hitchopt.mission.teams_problem import AnyProblem, TeamsProblem, check_team_names
from hitchopt.objects import SolidObject
from hitchopt.storage.yaml_file import located, parse_yaml, plain, read_text, value_at
from hitchopt.values import MAPPING, form_error, form_of
from hitchopt.values.fields import Kind, Schema, arguments_from, dict_of, keys_of, record_schema
from hitchopt.values.units import START_TIME

FOREIGN = {
    False: {
        "keep_out": "a hitch keeps off objects: add one with fixed: true to objects",
        "goal": "a hitch has a mission; goals are for single drones, team: {drones: 2}",
    },
    True: {"mission": "single drones have a goal; missions are for hitches, team: {robots: 3}"},
}
"""Remedies for keys of the other kind of problem; True for problems of single drones."""


def problem_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of problem files of all kinds."""
    definitions = dict[str, Schema]()
    forms = [record_schema(kind, definitions) for kind in (Problem, SwarmProblem, TeamsProblem)]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    title = "hitchopt problem file"
    return {"$schema": dialect, "title": title, "anyOf": forms, "$defs": definitions}


def read_problem(path: str | Path) -> AnyProblem:
    """Return the problem in the YAML file at ``path``; ``-`` is standard input.

    Raises
    ------
    FileError: the file cannot be read as YAML.
    InputError: wrong keys, types, counts, ranges or shapes; JointInputError for several errors.
    """
    text, name = read_text(path)
    return parse_problem(text, name, Path(path).parent)


def parse_problem(text: str, name: str = "text", directory: Path = Path()) -> AnyProblem:
    """Return the problem in a YAML text; errors as ``read_problem``.

    ``name`` is the file's name in messages, ``directory`` that of the objects' outlines.
    """
    data = parse_yaml(text, name)
    if not isinstance(data, dict):
        keys = ", ".join(key.name for key in keys_of(Problem).values())
        raise FileError(
            f"{name}: holds {form_of(data)}, but a problem is a mapping with the keys {keys}; "
            "`hitchopt init` writes one"
        )
    with located(text, name):
        return any_problem_from_dict(data, directory)


def request_in(text: str, objects: Mapping[str, SolidObject]) -> dict[str, Any]:
    """Return the request in the text of a problem file, in the format of ``motion.plan_file``.

    The ``objects`` of its plan replace drawings, whose files are not available.
    """
    data: Any = parse_yaml(text, "problem")
    bodies = data.get("objects") if isinstance(data, dict) else None
    others = data.pop("others", None) if isinstance(data, dict) else None  # files may be missing
    for name, body in (bodies or {}).items():
        if isinstance(body, dict) and "file" in body and name in objects:
            del body["file"]
            body["outline"] = objects[name].section.core.tolist()
    start_times = START_TIMES.check("others", others or {})
    return any_problem_from_dict(data).asked | {"others": start_times}


def _start_time(key: str, value: Any) -> dict[str, float]:
    """Return the start time [s] of another plan, from its mapping in a problem."""
    if not isinstance(value, dict):
        raise form_error(key, value, MAPPING)
    return {"at": START_TIME.check(f"{key}.at", value.get("at", 0.0))}


START_TIMES = dict_of(Kind((MAPPING,), _start_time, {}), NAME)


def load_problem(path: str | Path) -> Problem:
    """Return the problem of a hitch in the YAML file at ``path``; errors as ``read_problem``."""
    return _hitch_problem(read_problem(path))


def load_swarm(path: str | Path) -> SwarmProblem:
    """Return the problem of single drones in a YAML file; errors as ``read_problem``."""
    problem = read_problem(path)
    if not isinstance(problem, SwarmProblem):
        remedy = "use load_problem or read_problem"
        raise InputError("team", "robots", "a team of single drones", remedy)
    return problem


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem of a hitch that ``data`` describes; errors as ``load_problem``."""
    return _hitch_problem(any_problem_from_dict(data))


def _hitch_problem(problem: AnyProblem) -> Problem:
    if not isinstance(problem, Problem):
        is_swarm = isinstance(problem, SwarmProblem)
        key, value = ("team", "drones") if is_swarm else ("teams", "several")
        remedy = "use load_swarm" if is_swarm else "use read_problem"
        raise InputError(key, value, "a team of catenary robots", remedy)
    return problem


def any_problem_from_dict(data: Mapping[str, object], folder: Path = Path()) -> AnyProblem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``."""
    values: Any = plain(data)
    team = values.get("team") if isinstance(values, dict) else None
    is_swarm = isinstance(team, dict) and "drones" in team and "robots" not in team
    record: type[Any] = SwarmProblem if is_swarm else Problem
    if isinstance(values, dict):
        if "teams" in values:
            record = TeamsProblem
            check_team_names(*(values.get(key) for key in ("teams", "start", "mission")))
            if "team" in values:
                bound, remedy = "left out beside teams", "keep one of the two"
                raise InputError("team", values["team"], bound, remedy)
        values = with_outlines(values, folder)
        others = values.get("others")
        for other in others.values() if isinstance(others, dict) else ():
            if isinstance(other, dict) and isinstance(other.get("plan"), str) and other["plan"]:
                other["plan"] = str(folder / other["plan"])
    remedies = {} if record is TeamsProblem else FOREIGN[is_swarm]
    if record is Problem and value_at(values, ("mission", 0, "form")) is not None:
        robots = value_at(values, ("team", "robots"))
        places = f"drones: {{q: [[x, y, z], …], r: [[x, y, z], …]}}}}, {robots} points each"
        remedies = remedies | {"start": f"add start: {{{places}"}
    problem: AnyProblem = record(**arguments_from(record, "", values, remedies=remedies))
    return problem
