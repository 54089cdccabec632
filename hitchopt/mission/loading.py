"""Loading of problems from files, or from mappings with the keys of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from hitchopt.errors import FileError, InputError, one_or_all
from hitchopt.geometry.drawings import object_outline
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
from hitchopt.steps.step_keys import Keys
from hitchopt.storage.yaml_file import key_places, parse_yaml, place_of, plain, read_text
from hitchopt.values.units import seen_from

T = TypeVar("T")

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
        data = parse_yaml(text, name)
        if not isinstance(data, dict):
            kind = _KINDS.get(type(data), "a number")
            raise FileError(
                f"{name}: holds {kind}, but a problem is a mapping with the keys "
                f"{', '.join(ProblemKeys.model_fields)}; `hitchopt init` writes one"
            )
        return any_problem_from_dict(data, directory)
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
    return any_problem_from_dict(data).asked


def load_problem(path: str | Path) -> Problem:
    """Return the problem of a hitch in the YAML file at ``path``.

    Raises
    ------
    InputError: a problem of single drones; as ``read_problem``.
    FileError: as ``read_problem``.
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


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem of a hitch that ``data`` describes; errors as ``load_problem``."""
    return _of_a_hitch(any_problem_from_dict(data))


def _of_a_hitch(problem: AnyProblem) -> Problem:
    if not isinstance(problem, Problem):
        raise InputError("team", "drones", "a team of catenary robots", "use load_swarm")
    return problem


def any_problem_from_dict(data: Mapping[str, object], folder: Path | None = None) -> AnyProblem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``.

    Raises
    ------
    InputError: as ``read_problem``.
    """
    values = plain(data)
    team = values.get("team") if isinstance(values, dict) else None
    single = isinstance(team, dict) and "drones" in team and "robots" not in team
    model = SwarmKeys if single else ProblemKeys
    try:
        return _built(model.model_validate(values), folder)
    except ValidationError as error:
        from hitchopt.mission.wording import translated

        raise translated(error, model) from None


def _built(keys: ProblemKeys | SwarmKeys, folder: Path | None) -> AnyProblem:
    """Return the problem that ``keys`` describe; drawings are looked for in ``folder``.

    Raises
    ------
    InputError: what single values do not tell, such as counts and shapes; a joint error if several.
    """
    faults = Collector()
    parts = _common_parts(keys, folder, faults)
    kind: Any = Swarm if isinstance(keys, SwarmKeys) else Team
    team = faults.attempt("team", lambda: kind(**_team_values(keys.team)))
    if team is None:  # nothing else can be judged without it
        return faults.made(None)
    if isinstance(keys, SwarmKeys):
        prisms = [
            faults.attempt(f"keep_out[{k}]", partial(Prism, **prism.model_dump()))
            for k, prism in enumerate(keys.keep_out)
        ]
        parts["keep_out"] = tuple(prism for prism in prisms if prism is not None)
        places = np.array(keys.start), np.array(keys.goal)
        swarm = partial(SwarmProblem, team, *places, duration=keys.duration, **parts)
        return faults.made(faults.attempt("", swarm))
    start = _start(keys.start, team, faults)
    steps = [_step(i, step, team, faults) for i, step in enumerate(keys.mission)]
    faults.check()
    mission = tuple(step for step in steps if step is not None)
    return faults.made(Problem(team, start, mission, **parts) if start else None)


def _common_parts(
    keys: ProblemKeys | SwarmKeys, folder: Path | None, faults: Collector
) -> dict[str, Any]:
    """Return the parts that problems of both kinds have, by name, those refused left out."""
    box, separation = keys.arena, keys.separation
    parts: dict[str, Any] = {
        "title": faults.attempt("", partial(_title, keys.title)),
        "limits": faults.attempt("limits", lambda: Limits(**keys.limits.model_dump())),
        "separation": faults.attempt("separation", lambda: Separation(**separation.model_dump())),
        "arena": box and faults.attempt("arena", lambda: Arena(box.lower, box.upper)),
    }
    objects = {
        name: faults.attempt(f"objects.{name}", partial(_object, given, folder))
        for name, given in keys.objects.items()
    }
    parts["objects"] = {name: each for name, each in objects.items() if each is not None}
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


KEYS = {"lower": "from", "upper": "to", "rim.height": "rim.at", "rim.section": "rim"}
"""Keys of files for the arguments of ``SolidObject`` that have other names."""


def _object(keys: ObjectKeys, folder: Path | None) -> SolidObject:
    """Return the object that ``keys`` describe."""
    values: dict[str, Any] = keys.model_dump()
    rim, file = values.pop("rim"), values.pop("file")
    outline, circle = values.pop("outline"), values.pop("circle")
    if file is not None:
        try:
            outline = object_outline(Path(file) if folder is None else folder / file)
        except InputError as error:
            raise InputError("file", file, error.bound, error.remedy) from None
    if rim is not None:
        rim = Rim(Section(rim["outline"], rim["circle"]), rim["at"])
    yaw = math.radians(values.pop("yaw_deg"))
    lower, upper = values.pop("from_"), values.pop("to")
    try:
        return SolidObject(Section(outline, circle), lower, upper, yaw=yaw, rim=rim, **values)
    except InputError as error:
        key = KEYS.get(error.key, error.key)
        if file is not None and key.partition("[")[0] == "outline":
            bound = f"an outline that is {error.bound.removeprefix('an outline that is ')}"
            raise InputError("file", file, bound, error.remedy) from None
        raise InputError(key, error.value, error.bound, error.remedy) from None


class Collector:
    """Gathers faults, so that one run names them all."""

    def __init__(self) -> None:
        self.inputs: list[InputError] = []

    def attempt(self, parent: str, make: Callable[[], T]) -> T | None:
        """Return ``make()``, or None where it raises, gathering the error under ``parent``."""
        try:
            with seen_from(parent):
                return make()
        except InputError as error:
            self.inputs.append(error)
        return None

    def check(self) -> None:
        """Raise what was gathered, as one error."""
        if self.inputs:
            raise one_or_all(self.inputs)

    def made(self, whole: T | None) -> T:
        """Return what was made of all parts, or raise what was gathered."""
        self.check()
        if whole is None:
            raise RuntimeError("a part is missing although nothing was refused")
        return whole
