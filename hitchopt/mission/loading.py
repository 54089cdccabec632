"""Loading of problems from files, or from mappings with the keys of one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hitchopt.errors import FileError, InputError
from hitchopt.mission.objects import with_outlines
from hitchopt.mission.others import NAME
from hitchopt.mission.problem import Problem, SwarmProblem
from hitchopt.mission.teams_problem import AnyProblem, TeamsProblem, refuse_unnamed
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
"""Remedies for keys of the other kind of problem, by whether drones are single."""


def problem_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of problem files of all kinds."""
    definitions = dict[str, Schema]()
    forms = [record_schema(kind, definitions) for kind in (Problem, SwarmProblem, TeamsProblem)]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    head = {"$schema": dialect, "title": "hitchopt problem file"}
    return {**head, "anyOf": forms, "$defs": definitions}


def read_problem(path: str | Path) -> AnyProblem:
    """Return the problem in the YAML file at ``path``; ``-`` is standard input.

    Raises
    ------
    FileError: a file that cannot be read as YAML.
    InputError: keys, types, counts, ranges or shapes that are wrong; JointInputError if several.
    """
    text, name = read_text(path)
    return parse_problem(text, name, Path(path).parent)


def parse_problem(text: str, name: str = "text", directory: Path = Path()) -> AnyProblem:
    """Return the problem in a YAML text; errors as ``read_problem``.

    ``name`` is what messages call it, ``directory`` where outlines of objects are.
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


def asked_in(text: str, objects: Mapping[str, SolidObject]) -> dict[str, Any]:
    """Return the request in the text of a problem file, as ``hitchopt.motion.plan_file`` has it.

    The ``objects`` of its plan stand in for drawings, which a text alone does not have.
    """
    data: Any = parse_yaml(text, "problem")
    given = data.get("objects") if isinstance(data, dict) else None
    others = data.pop("others", None) if isinstance(data, dict) else None  # files may be gone
    for name, each in (given or {}).items():
        if isinstance(each, dict) and "file" in each and name in objects:
            del each["file"]
            each["outline"] = objects[name].section.core.tolist()
    begins = BEGINS.check("others", others or {})
    return any_problem_from_dict(data).asked | {"others": begins}


def _begins(key: str, value: Any) -> dict[str, float]:
    """Return when a plan that flies besides begins [s], in a problem's text."""
    if not isinstance(value, dict):
        raise form_error(key, value, MAPPING)
    return {"at": START_TIME.check(f"{key}.at", value.get("at", 0.0))}


BEGINS = dict_of(Kind((MAPPING,), _begins, {}), NAME)


def load_problem(path: str | Path) -> Problem:
    """Return the problem of a hitch in the YAML file at ``path``; errors as ``read_problem``."""
    return _of_a_hitch(read_problem(path))


def load_swarm(path: str | Path) -> SwarmProblem:
    """Return the problem of single drones in a YAML file; errors as ``read_problem``."""
    problem = read_problem(path)
    if not isinstance(problem, SwarmProblem):
        raise InputError(
            "team", "robots", "a team of single drones", "use load_problem or read_problem"
        )
    return problem


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem of a hitch that ``data`` describes; errors as ``load_problem``."""
    return _of_a_hitch(any_problem_from_dict(data))


def _of_a_hitch(problem: AnyProblem) -> Problem:
    if not isinstance(problem, Problem):
        single = isinstance(problem, SwarmProblem)
        given = ("team", "drones") if single else ("teams", "several")
        remedy = "use load_swarm" if single else "use read_problem"
        raise InputError(*given, "a team of catenary robots", remedy)
    return problem


def any_problem_from_dict(data: Mapping[str, object], folder: Path = Path()) -> AnyProblem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``."""
    values: Any = plain(data)
    team = values.get("team") if isinstance(values, dict) else None
    single = isinstance(team, dict) and "drones" in team and "robots" not in team
    record: type[Any] = SwarmProblem if single else Problem
    if isinstance(values, dict):
        if "teams" in values:
            record = TeamsProblem
            refuse_unnamed(*(values.get(key) for key in ("teams", "start", "mission")))
            if "team" in values:
                bound, remedy = "left out beside teams", "keep one of the two"
                raise InputError("team", values["team"], bound, remedy)
        values = with_outlines(values, folder)
        others = values.get("others")
        for other in others.values() if isinstance(others, dict) else ():
            if isinstance(other, dict) and isinstance(other.get("plan"), str) and other["plan"]:
                other["plan"] = str(folder / other["plan"])
    remedies = {} if record is TeamsProblem else FOREIGN[single]
    if record is Problem and value_at(values, ("mission", 0, "form")) is not None:
        robots = value_at(values, ("team", "robots"))
        places = f"drones: {{q: [[x, y, z], …], r: [[x, y, z], …]}}}}, {robots} points each"
        remedies = remedies | {"start": f"add start: {{{places}"}
    problem: AnyProblem = record(**arguments_from(record, "", values, remedies=remedies))
    return problem
