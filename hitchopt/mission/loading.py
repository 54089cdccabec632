"""Loading of problems from files, or from mappings with the keys of a file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from hitchopt.errors import (
    UNKNOWN_KEY,
    FileError,
    InputError,
    JointInputError,
    joint_error,
)
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.mission.objects import with_outlines
from hitchopt.mission.others import NAME
from hitchopt.mission.problem import (
    HITCH_LIMITS,
    HITCH_SEPARATION,
    ITEMS,
    STARTS,
    SWARM_TEAM,
    TEAMS,
    Problem,
    SwarmTeam,
    check_team_names,
)
from hitchopt.objects import SolidObject
from hitchopt.slices import lacking
from hitchopt.steps import DRONE_STEP_KINDS
from hitchopt.steps.keys import SWARM_PLACES, TRIANGLE
from hitchopt.storage.yaml_file import located, parse_yaml, plain, read_text, split_key, value_at
from hitchopt.values import MAPPING, SYNONYMS, form_error, form_of
from hitchopt.values.fields import (
    Key,
    Kind,
    Schema,
    arguments_from,
    dict_of,
    keys_of,
    keys_schema,
    mapping_of,
    suggest_keywords,
)
from hitchopt.values.units import START_TIME

FOREIGN = {
    False: {
        "goal": "a hitch has a mission; goals are for single drones, team: {drones: 2}",
    },
    True: {"mission": "single drones have a goal; missions are for hitches, team: {robots: 3}"},
}
"""Remedies for keys of the other kind of problem; True for problems of single drones."""


HITCH_FORM = keys_of(Problem)
COMMON = {name: HITCH_FORM[name] for name in ("arena", "title", "objects", "others", "keep_out")}

TEAMS_FORM = {
    "teams": Key(
        TEAMS,
        "The teams by name, of robots or of single drones",
        {name: {"robots": 3, "cable_length": 2.4} for name in "ab"},
        "teams",
    ),
    "start": Key(
        STARTS,
        "The start of every team; for single drones, their positions [x, y, z] [m]",
        {
            name: {"hitch": {"polygon": TRIANGLE, "altitude": altitude}}
            for name, altitude in (("a", 1.0), ("b", 2.5))
        },
        "start",
    ),
    "mission": Key(
        ITEMS,
        "Items, one after the other: a step, or a list of steps, of some teams",
        [{name: {"hold": {"seconds": 1.0}} for name in "ab"}],
        "mission",
    ),
    "limits": replace(HITCH_FORM["limits"], text="Limits of motion of all teams"),
    "separation": replace(HITCH_FORM["separation"], text="Distances to keep, between teams too"),
    **COMMON,
}


@cache
def swarm_form() -> dict[str, Key]:
    """Return the keys of files of single drones, whose only step they state."""
    if not DRONE_STEP_KINDS:
        raise lacking("single drones")
    (step,) = DRONE_STEP_KINDS.values()
    keys = keys_of(step)
    places = "Start positions (N, 3) [m], [x, y, z] per drone, at rest"
    return {
        "team": Key(SWARM_TEAM, "The team", {"drones": 2}, "team"),
        "start": Key(SWARM_PLACES, places, [[-1, 0, 1], [1, 0, 1]], "start"),
        "goal": replace(keys["goal"], text="Goal positions (N, 3) [m], in the same order"),
        "limits": replace(HITCH_FORM["limits"], kind=mapping_of(Limits, exclude=HITCH_LIMITS)),
        "separation": replace(
            HITCH_FORM["separation"], kind=mapping_of(Separation, exclude=HITCH_SEPARATION)
        ),
        "arena": HITCH_FORM["arena"],
        "duration": keys["duration"],
        **COMMON,
        "objects": replace(
            HITCH_FORM["objects"],
            text="Fixed obstacles, by name; drones keep clear of them",
        ),
    }


def forms() -> dict[str, tuple[Mapping[str, Key], str]]:
    """Return the keys of files and what their problems are, by their names in the schema."""
    drones = "Single drones that swap positions out of each other's downwash."
    return {
        "Problem": (HITCH_FORM, "A mission of a team with a hitch."),
        **({"SwarmProblem": (swarm_form(), drones)} if DRONE_STEP_KINDS else {}),
        "TeamsProblem": (
            TEAMS_FORM,
            "A mission of several teams, with hitches or of single drones, in one arena.",
        ),
    }


def problem_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of problem files of all kinds."""
    definitions = dict[str, Schema]()
    schemas = [
        keys_schema(name, text, keys.values(), definitions)
        for name, (keys, text) in forms().items()
    ]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    title = "hitchopt problem file"
    return {"$schema": dialect, "title": title, "anyOf": schemas, "$defs": definitions}


@suggest_keywords
def load_problem(path: str | Path) -> Problem:
    """Return the problem in the YAML file at ``path``; ``-`` is standard input.

    Raises FileError if the file cannot be read as YAML; InputError for wrong keys, types, counts,
    ranges or shapes; JointInputError for several errors.
    """
    text, name = read_text(path)
    return parse_problem(text, name, Path(path).parent)


def parse_problem(text: str, name: str = "text", directory: Path = Path()) -> Problem:
    """Return the problem in a YAML text; errors as ``load_problem``.

    ``name`` is the file's name in messages, ``directory`` that of the objects' outlines.
    """
    data = parse_yaml(text, name)
    if not isinstance(data, dict):
        keys = ", ".join(key.name for key in keys_of(Problem).values())
        raise FileError(
            f"{name}: contains {form_of(data)}, but a problem is a mapping with the keys {keys}; "
            "`hitchopt init` writes one"
        )
    with located(text, name):
        return problem_from_dict(data, directory)


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
    return problem_from_dict(data).request | {"others": start_times}


def _start_time(key: str, value: Any) -> dict[str, float]:
    """Return the start time [s] of another plan, from its mapping in a problem."""
    if not isinstance(value, dict):
        raise form_error(key, value, MAPPING)
    return {"at": START_TIME.check(f"{key}.at", value.get("at", 0.0))}


START_TIMES = dict_of(Kind((MAPPING,), _start_time, {}), NAME)


def _is_swarm(team: Any) -> bool:
    """Return whether the mapping of a team in a file is that of single drones."""
    return isinstance(team, dict) and "drones" in team and "robots" not in team


@contextmanager
def _misplaced_keys(form: Mapping[str, Key], values: Any) -> Iterator[None]:
    """State where unknown keys belong that are keys of another section of a file's values."""
    try:
        yield
    except InputError as error:
        errors = error.errors if isinstance(error, JointInputError) else (error,)
        raise joint_error([_with_home(each, form, values) for each in errors]) from None


def _with_home(error: InputError, form: Mapping[str, Key], values: Any) -> InputError:
    """Return an error of an unknown key with the place of this key in files as its remedy."""
    name = error.key.rpartition(".")[2]
    suggested = re.fullmatch(r"did you mean (\w+)\?", error.remedy)
    is_synonym = suggested and name in SYNONYMS.get(suggested[1], "").split()
    if error.bound != UNKNOWN_KEY or is_synonym:
        return error
    if name in form:
        remedy = f"write {name} at the top level of the file"
    elif home := _home_of(name, error.key, form, values):
        remedy = f"write it as {home}"
        section, _, key = home.rpartition(".")
        if section.endswith(".quadrotor"):
            remedy += f", with a model by name as {{model: NAME, {key}: …}}"
    else:
        return error
    return InputError(error.key, error.value, error.bound, remedy, error.place)


def _home_of(name: str, path: str, form: Mapping[str, Key], values: Any) -> str:
    """Return the key, such as ``limits.tilt_deg``, of another section that a name means.

    ``path`` is where the name stands, of which several teams have one each. Empty without a key.
    """
    own = re.match(r"teams\.[^.]+", path)
    team = own[0] if own else "team"
    of_cables = form is HITCH_FORM or form is TEAMS_FORM
    sections: dict[str, tuple[type[Any], tuple[str, ...]]] = {
        "limits": (Limits, () if of_cables else HITCH_LIMITS),
        "separation": (Separation, () if of_cables else HITCH_SEPARATION),
    }
    if own or team in form:
        is_swarm = _is_swarm(value_at(values, split_key(team)))
        sections[team] = (SwarmTeam if is_swarm else Team, ())
        sections[f"{team}.quadrotor"] = (Quadrotor, ())
    for section, (record, excluded) in sections.items():
        for field, key in keys_of(record).items():
            is_named = name in (field, key.name) and key.name not in excluded
            if is_named and section != path.rpartition(".")[0]:
                return f"{section}.{key.name}"
    return ""


@suggest_keywords
def problem_from_dict(data: Mapping[str, object], folder: Path = Path()) -> Problem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``."""
    values: Any = plain(data)
    team = values.get("team") if isinstance(values, dict) else None
    is_swarm = _is_swarm(team)
    form = swarm_form() if is_swarm else HITCH_FORM
    if isinstance(values, dict):
        if "teams" in values:
            form = TEAMS_FORM
            check_team_names(*(values.get(key) for key in ("teams", "start", "mission")))
            if "team" in values:
                bound, remedy = "omitted next to teams", "keep one of the two"
                raise InputError("team", values["team"], bound, remedy)
        values = with_outlines(values, folder)
        others = values.get("others")
        for other in others.values() if isinstance(others, dict) else ():
            if isinstance(other, dict) and isinstance(other.get("plan"), str) and other["plan"]:
                other["plan"] = str(folder / other["plan"])
    if isinstance(values, dict) and isinstance(mission := values.get("mission"), dict):
        first = f"- {next(iter(mission), 'hold')}: {{…}}"
        bound = "a list of steps"
        raise InputError("mission", mission, bound, f"begin each step with a dash: {first}")
    remedies = {} if form is TEAMS_FORM else FOREIGN[is_swarm]
    if form is HITCH_FORM and value_at(values, ("mission", 0, "form")) is not None:
        robots = value_at(values, ("team", "robots"))
        places = f"drones: {{q: [[x, y, z], …], r: [[x, y, z], …]}}}}, {robots} points each"
        remedies = remedies | {"start": f"add start: {{{places}"}
    with _misplaced_keys(form, values):
        arguments = arguments_from(form, "", values, remedies=remedies)
    if form is TEAMS_FORM:
        arguments["team"] = arguments.pop("teams")
    if form is not TEAMS_FORM and is_swarm:
        fly: Any = next(iter(DRONE_STEP_KINDS.values()))
        arguments["mission"] = (fly(arguments.pop("goal"), arguments.pop("duration", None)),)
    try:
        return Problem(**arguments)
    except InputError as error:
        nested = "mission[0].fly." if is_swarm else ""
        raise error.renamed(lambda key: key.removeprefix(nested)) from None
