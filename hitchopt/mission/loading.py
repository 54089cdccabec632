"""Loading of problems from files, or from mappings with the keys of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import ValidationError

from hitchopt.errors import FileError, InputError, one_or_all
from hitchopt.geometry.drawings import read_drawing
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.requirements import Arena, Limits, Prism, Separation
from hitchopt.mission.keys import (
    STEP_KINDS,
    ObjectKeys,
    ProblemKeys,
    StartKeys,
    SwarmKeys,
    SwarmTeamKeys,
    TeamKeys,
    translated,
)
from hitchopt.mission.problem import (
    DronesStart,
    HitchStart,
    Problem,
    Start,
    SwarmProblem,
    fitting_start,
)
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.steps import Step
from hitchopt.steps.step import Keys
from hitchopt.storage.yaml_file import parse_yaml, plain, read_node, read_text
from hitchopt.values.units import keys_within

T = TypeVar("T")

_KINDS = {list: "a list", str: "only text", bool: "true or false"}


AnyProblem = Problem | SwarmProblem
"""A problem of a hitch, or of single drones."""


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
    root = read_node(text, name)
    data = root.value
    if not isinstance(data, dict):
        kind = _KINDS.get(type(data), "a number")
        raise FileError(
            f"{name}: holds {kind}, but a problem is a mapping with the keys "
            f"{', '.join(ProblemKeys.model_fields)}; `hitchopt init` writes one"
        )
    try:
        return any_problem_from_dict(data, directory)
    except InputError as error:
        raise error.located(root.finder()) from None


def asked_in(text: str, objects: Mapping[str, SolidObject]) -> dict[str, Any]:
    """Return the request in the text of a problem file, as ``hitchopt.motion.plan_file`` has it.

    The ``objects`` of its plan stand in for drawings, which a text alone does not have.
    """
    data: Any = parse_yaml(text, "problem")
    given = data.get("objects") if isinstance(data, dict) else None
    for name, each in (given or {}).items():
        if isinstance(each, dict) and "file" in each and name in objects:
            del each["file"]
            each["outline"] = objects[name].section.core.tolist()
    return any_problem_from_dict(data).asked


def load_problem(path: str | Path) -> Problem:
    """Return the problem of a hitch in the YAML file at ``path``; errors as ``read_problem``."""
    return _of_a_hitch(read_problem(path))


def load_swarm(path: str | Path) -> SwarmProblem:
    """Return the problem of single drones in a YAML file; errors as ``read_problem``."""
    problem = read_problem(path)
    if not isinstance(problem, SwarmProblem):
        raise InputError("team", "robots", "a team of single drones", "use load_problem")
    return problem


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem of a hitch that ``data`` describes; errors as ``load_problem``."""
    return _of_a_hitch(any_problem_from_dict(data))


def _of_a_hitch(problem: AnyProblem) -> Problem:
    if not isinstance(problem, Problem):
        raise InputError("team", "drones", "a team of catenary robots", "use load_swarm")
    return problem


def any_problem_from_dict(data: Mapping[str, object], folder: Path | None = None) -> AnyProblem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``."""
    values = plain(data)
    team = values.get("team") if isinstance(values, dict) else None
    single = isinstance(team, dict) and "drones" in team and "robots" not in team
    model = SwarmKeys if single else ProblemKeys
    try:
        return _built(model.model_validate(values), folder)
    except ValidationError as error:
        raise translated(error, model) from None


def _built(keys: ProblemKeys | SwarmKeys, folder: Path | None) -> AnyProblem:
    """Return the problem that ``keys`` describe, or raise what single values do not tell."""
    faults = list[InputError]()  # gathered, so that one run names them all

    def attempt(parent: str, make: Callable[..., T], *args: Any, **kwargs: Any) -> Any:
        """Return the built value, or None if it is refused."""
        try:
            with keys_within(parent):
                return make(*args, **kwargs)
        except InputError as error:
            faults.append(error)
        return None

    parts: dict[str, Any] = {
        "title": attempt("", _title, keys.title),
        "limits": attempt("limits", Limits, **keys.limits.model_dump()),
        "separation": attempt("separation", Separation, **keys.separation.model_dump()),
        "objects": {
            name: attempt(f"objects.{name}", _object, given, folder)
            for name, given in keys.objects.items()
        },
    }
    if keys.arena is not None:
        parts["arena"] = attempt("arena", Arena, keys.arena.lower, keys.arena.upper)
    if isinstance(keys, SwarmKeys):
        swarm = attempt("team", _team, Swarm, keys.team)
        parts["keep_out"] = [
            attempt(f"keep_out[{k}]", Prism, **prism.model_dump())
            for k, prism in enumerate(keys.keep_out)
        ]
        if faults:
            raise one_or_all(faults)
        places = np.array(keys.start), np.array(keys.goal)
        return SwarmProblem(swarm, *places, duration=keys.duration, **parts)
    team = attempt("team", _team, Team, keys.team)
    if team is not None:  # nothing else can be judged without it
        start = attempt("", _start, keys.start, team)
        mission = [
            attempt(f"mission[{i}].{name}", _step, name, step, team)
            for i, given in enumerate(keys.mission)
            for name, step in cast("Keys", given)
            if step is not None
        ]
    if faults:
        raise one_or_all(faults)
    return Problem(team, start, tuple(mission), **parts)


def _title(title: str) -> str:
    """Return the title, or raise InputError where a terminal would obey it."""
    if not title.isprintable():
        raise InputError("title", title, "printable text on one line", "remove such characters")
    return title


def _team(kind: type[T], keys: TeamKeys | SwarmTeamKeys) -> T:
    """Return the team that ``keys`` describe."""
    values = keys.model_dump()
    kinds, quadrotors = values["quadrotor"], []
    one = isinstance(kinds, dict)
    for k, each in enumerate([kinds] if one else kinds):
        with keys_within("quadrotor" if one else f"quadrotor[{k}]"):
            quadrotors.append(Quadrotor(**each))
    return kind(**values | {"quadrotor": quadrotors[0] if one else quadrotors})


def _start(keys: StartKeys, team: Team) -> Start:
    """Return where the plan starts."""
    kinds: dict[str, type[HitchStart | DronesStart]] = {"hitch": HitchStart, "drones": DronesStart}
    ((name, given),) = keys.model_dump(exclude_none=True).items()
    with keys_within(f"start.{name}"):
        start = kinds[name](**given)
    return fitting_start(team, start)


def _step(name: str, keys: Keys, team: Team) -> Step:
    """Return the record of a step."""
    return STEP_KINDS[name].from_file(keys.model_dump()).resolved_for(team)


KEYS = {"lower": "from", "upper": "to", "rim.height": "rim.at", "rim.section": "rim"}
"""Keys of files for the arguments of ``SolidObject`` that have other names."""


def _object(keys: ObjectKeys, folder: Path | None) -> SolidObject:
    """Return the object that ``keys`` describe."""
    values: dict[str, Any] = keys.model_dump()
    rim, file, outline, circle = (values.pop(key) for key in ("rim", "file", "outline", "circle"))
    yaw = math.radians(values.pop("yaw_deg"))
    lower, upper = values.pop("from_"), values.pop("to")
    try:
        if file is not None:
            outline = read_drawing(Path(file) if folder is None else folder / file).outline
        if rim is not None:
            rim = Rim(Section(rim["outline"], rim["circle"]), rim["at"])
        return SolidObject(Section(outline, circle), lower, upper, yaw=yaw, rim=rim, **values)
    except InputError as error:
        key, bound = KEYS.get(error.key, error.key), error.bound
        if file is not None and key.partition("[")[0] in ("outline", "file"):
            raise InputError("file", file, f"an outline: {bound}", error.remedy) from None
        raise InputError(key, error.value, bound, error.remedy) from None
