"""Loading of problems from files, or from mappings with the keys of one."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from hitchopt.errors import FileError, InputError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.mission.faults import Collector
from hitchopt.mission.file_models import STEP_KINDS, ProblemKeys
from hitchopt.mission.object_keys import objects_of
from hitchopt.mission.problem import DronesStart, HitchStart, Problem, Start, fitting_start
from hitchopt.mission.schema import Keys, StartKeys, TeamKeys
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.mission.swarm_schema import SwarmKeys, SwarmTeamKeys
from hitchopt.objects import SolidObject
from hitchopt.requirements import Arena, Limits, Prism, Separation
from hitchopt.steps import Step
from hitchopt.storage.plain import Plain, plain
from hitchopt.storage.yaml_file import key_places, parse_yaml, place_of, read_text
from hitchopt.units import seen_from

_KINDS = {list: "a list", str: "only text", bool: "true or false"}


AnyProblem = Problem | SwarmProblem
"""A problem of a hitch, or of single drones."""


def read_problem(path: str | Path) -> AnyProblem:
    """Return the problem in the YAML file at ``path``, of a hitch or of single drones.

    Parameters
    ----------
    path: of the file; ``-`` is standard input.

    Raises
    ------
    FileError: a file that cannot be read as YAML.
    InputError: keys, types, counts, ranges or shapes that are wrong; JointInputError if several.
    """
    text, name = read_text(path)
    return parse_problem(text, name, Path(path).parent)


def parse_problem(text: str, name: str = "text", directory: Path = Path()) -> AnyProblem:
    """Return the problem in YAML, of a hitch or of single drones.

    Parameters
    ----------
    text: what a problem file holds.
    name: what messages call it.
    directory: where outlines of objects are.

    Raises
    ------
    FileError, InputError: as ``read_problem``.
    """
    try:
        return _problem_of(parse_yaml(text, name), name, directory)
    except InputError as error:
        places = key_places(text, name)
        raise error.located(partial(place_of, places)) from None


def asked_in(text: str, objects: Mapping[str, SolidObject]) -> dict[str, Any]:
    """Return what the text of a problem file asks, as ``hitchopt.motion.asked`` has it.

    Where a hitch starts, its drones are not known before it is planned: the polygon is.

    Parameters
    ----------
    text: what a problem file holds.
    objects: those of its plan; they stand in for drawings, which a text alone does not have.

    Raises
    ------
    FileError, InputError: as ``read_problem``.
    """
    data: Any = parse_yaml(text, "problem")
    given = data.get("objects") if isinstance(data, dict) else None
    for name, each in (given or {}).items():
        if isinstance(each, dict) and "file" in each and name in objects:
            del each["file"]
            each["outline"] = objects[name].section.core.tolist()
    return _problem_of(data, "problem", Path()).asked


def _problem_of(data: Plain, name: str, directory: Path) -> AnyProblem:
    if not isinstance(data, dict):
        raise FileError(
            f"{name}: holds {_KINDS.get(type(data), 'a number')}, but a problem is a mapping with "
            f"the keys {', '.join(ProblemKeys.model_fields)}; `hitchopt init` writes one"
        )
    return any_problem_from_dict(data, directory)


def load_problem(path: str | Path) -> Problem:
    """Return the problem of a hitch in the YAML file at ``path``.

    Raises
    ------
    InputError: a problem of single drones; as ``read_problem``.
    FileError, UnsupportedError: as ``read_problem``.
    """
    return _of_a_hitch(read_problem(path))


def load_swarm(path: str | Path) -> SwarmProblem:
    """Return the problem of single drones in the YAML file at ``path``.

    Raises
    ------
    InputError: a problem of a hitch; as ``read_problem``.
    FileError: as ``read_problem``.
    """
    problem = read_problem(path)
    if not isinstance(problem, SwarmProblem):
        raise InputError("team", "robots", "a team of single drones", "use load_problem")
    return problem


def any_problem_from_dict(data: Mapping[str, object], folder: Path | None = None) -> AnyProblem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``.

    Raises
    ------
    InputError: as ``read_problem``.
    """
    values = plain(data)
    single = isinstance(values, dict) and _of_single_drones(values)
    try:
        if single:
            return built_swarm(SwarmKeys.model_validate(values), folder)
        return built_problem(ProblemKeys.model_validate(values), folder)
    except ValidationError as error:
        from hitchopt.mission.wording import translated

        raise translated(error, SwarmKeys if single else ProblemKeys) from None


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem of a hitch that ``data`` describes; errors as ``load_problem``."""
    return _of_a_hitch(any_problem_from_dict(data))


def _of_a_hitch(problem: AnyProblem) -> Problem:
    if not isinstance(problem, Problem):
        raise InputError("team", "drones", "a team of catenary robots", "use load_swarm")
    return problem


def _of_single_drones(values: dict[str, Plain]) -> bool:
    """Return whether a problem file is one of single drones: its team counts those."""
    team = values.get("team")
    return isinstance(team, dict) and "drones" in team and "robots" not in team


def built_problem(keys: ProblemKeys, folder: Path | None = None) -> Problem:
    """Return the problem of a hitch that ``keys`` describe; drawings are looked for in ``folder``.

    Raises
    ------
    InputError: what single values do not tell, such as counts and shapes; a joint error if several.
    """
    faults = Collector()
    common = _common_parts(keys, faults)
    common["objects"] = objects_of(keys.objects, folder, faults)
    team = faults.attempt("team", lambda: Team(**_team_values(keys.team)))
    if team is None:  # nothing else can be judged without it
        return faults.made(None)
    start = _start(keys.start, team, faults)
    steps = [_step(i, step, team, faults) for i, step in enumerate(keys.mission)]
    faults.check()
    mission = tuple(step for step in steps if step is not None)
    return faults.made(Problem(team, start, mission, **common) if start else None)


def built_swarm(keys: SwarmKeys, folder: Path | None = None) -> SwarmProblem:
    """Return the problem of single drones that ``keys`` describe; as ``built_problem``."""
    faults = Collector()
    common = _common_parts(keys, faults)
    common["objects"] = objects_of(keys.objects, folder, faults)
    team = faults.attempt("team", lambda: Swarm(**_team_values(keys.team)))
    keep_out = [
        faults.attempt(f"keep_out[{k}]", partial(Prism, **prism.model_dump()))
        for k, prism in enumerate(keys.keep_out)
    ]
    places: dict[str, Any] = {"start": np.array(keys.start), "goal": np.array(keys.goal)}
    prisms = tuple(prism for prism in keep_out if prism is not None)
    rest: dict[str, Any] = {"keep_out": prisms, "duration": keys.duration}
    if team is None:
        return faults.made(None)
    return faults.made(faults.attempt("", lambda: SwarmProblem(team, **places, **common, **rest)))


def _common_parts(keys: ProblemKeys | SwarmKeys, faults: Collector) -> dict[str, Any]:
    """Return the parts that problems of both kinds have, by name, those refused left out."""
    box = keys.arena
    parts = {
        "title": faults.attempt("", partial(_title, keys.title)),
        "limits": faults.attempt("limits", lambda: Limits(**keys.limits.model_dump())),
        "separation": faults.attempt(
            "separation", lambda: Separation(**keys.separation.model_dump())
        ),
        "arena": box and faults.attempt("arena", lambda: Arena(box.lower, box.upper)),
    }
    return {name: part for name, part in parts.items() if part is not None}


def _title(title: str) -> str:
    """Return the title, or raise InputError where a terminal would obey it."""
    if not title.isprintable():  # a terminal would obey its control characters
        raise InputError("title", title, "printable text on one line", "remove such characters")
    return title


def _team_values(keys: TeamKeys | SwarmTeamKeys) -> dict[str, Any]:
    """Return the arguments of the team that ``keys`` describe."""
    values = keys.model_dump()
    kinds = values["quadrotor"]
    one = isinstance(kinds, dict)
    found = []
    for k, kind in enumerate([kinds] if one else kinds):
        with seen_from("quadrotor" if one else f"quadrotor[{k}]"):
            found.append(Quadrotor(**kind))
    values["quadrotor"] = found[0] if one else found
    return values


def _start(keys: StartKeys, team: Team, faults: Collector) -> Start | None:
    """Return where the plan starts; None where it has been refused."""
    start: Start | None = None
    if keys.hitch is not None:
        values: dict[str, Any] = keys.hitch.model_dump()
        start = faults.attempt("start.hitch", lambda: HitchStart(**values))
    elif keys.drones is not None:
        q, r = np.array(keys.drones.q), np.array(keys.drones.r)
        start = faults.attempt("start.drones", lambda: DronesStart(q, r))
    return start and faults.attempt("", partial(fitting_start, team, start))


def _step(i: int, keys: Keys, team: Team, faults: Collector) -> Step | None:
    """Return the record of a step; None where it has been refused."""
    ((name, given),) = ((name, step) for name, step in keys if step is not None)
    kind, values = STEP_KINDS[name], given.model_dump()
    return faults.attempt(f"mission[{i}].{name}", lambda: kind.from_file(values).fitting(team))
