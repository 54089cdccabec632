"""Plan files, plan.npz: piecewise polynomials, exact to the last bit.

Polynomials are stored as Bernstein coefficients (pieces, *shape, degree + 1) over common
``breaks``, without cables the drones' alone; everything else as JSON under ``settings``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.hitch.team import Assignment
from hitchopt.motion.asked import asked_of, check_asked, objects_at_first, values_of
from hitchopt.motion.motion import FURTHER, JOINT, POLYNOMIALS, Motion, Phase
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.objects.placing import STILL, check_apart, poses_of
from hitchopt.storage.archive import BROKEN, read_arrays
from hitchopt.trajectory import PiecewisePolynomial

T = TypeVar("T")

Arrays = dict[str, NDArray[Any]]

FORMAT = "hitchopt-plan/1"

PER_KIND = ("mass", "max_thrust")
"""Fields of a quadrotor, stored as arrays: (n,), one value a robot; (N,) of single drones."""

PER_CONTROLLER = ("stiffness", "integral", "feed_forward")
"""Fields of a quadrotor that are stored likewise where one is no default, which a setting
``control`` says. A rigid loop is an infinite stiffness, a flag 0 or 1."""

PER_ROBOT = ("cable_length", "tension")
"""Fields of a team that are stored as arrays (n,); the others are settings."""

DO_NOT = "do not edit plan files"
"""Remedy for what hitchopt does not write."""

LARGEST = 1e6
"""[m], [N] No coefficient of a plan is larger; sums of such numbers stay far from overflow."""


def write_plan(path: Path, motion: Motion, title: str = "", problem: str = "") -> None:
    """Write the plan; the same plan gives the same bytes.

    Parameters
    ----------
    path: file, replaced if there is one.
    motion, title: the plan.
    problem: the text of its problem file, if it is known.

    Raises
    ------
    OSError: the file cannot be written.
    """
    team, requirements = motion.team, motion.requirements
    columns = {
        name: [getattr(kind, name) for kind in team.quadrotor]
        for name in (*PER_KIND, *PER_CONTROLLER)
    }
    control = any(set(columns[name]) != {getattr(Quadrotor, name)} for name in PER_CONTROLLER)
    columns["stiffness"] = [np.inf if x is None else x for x in columns["stiffness"]]
    arrays: Arrays = {
        name: np.array(columns[name], dtype=np.float64)
        for name in (*PER_KIND, *(PER_CONTROLLER if control else ()))
    }
    own = {field.name: getattr(team, field.name) for field in fields(team)}
    if team.has_cables:
        arrays |= {name: own[name] for name in PER_ROBOT}
    names = POLYNOMIALS if team.has_cables else POLYNOMIALS[:1]
    further = [name for name in FURTHER if getattr(motion, name) is not None]
    settings: dict[str, Any] = {
        "title": title,
        "team": {k: v for k, v in own.items() if k not in (*PER_ROBOT, "quadrotor")}
        if team.has_cables
        else {"drones": team.drones},
        "limits": requirements.limits,
        "separation": requirements.separation,
        "arena": requirements.arena,
        "phases": motion.phases,
        "keep_out": requirements.keep_out,
        "asked": asked_of(motion),
        "control": control,
        "objects": objects_at_first(motion),
        **dict.fromkeys(further, True),  # arrays of these names are there
        "problem": problem,
        "assignment": motion.assignment,
    }
    optional = {"control", "objects", "problem", "assignment"}  # left out where there are none
    stored = {name: value for name, value in settings.items() if value or name not in optional}
    arrays["breaks"] = motion.drones.breaks
    arrays |= {name: getattr(motion, name).coefficients for name in (*names, *further)}
    text = np.array(json.dumps(stored, allow_nan=False, default=values_of))
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, format=np.array(FORMAT), settings=text, **arrays)


def read_plan(path: Path) -> Motion:
    """Return the plan of a file that hitchopt wrote.

    Raises
    ------
    FileError: it cannot be read, does not hold a plan, or one that differs from what was asked.
    """
    return _read(path, _motion)


def read_title(path: Path) -> str:
    """Return the title of the plan in a file, or an empty one; errors are ``read_plan``'s."""
    return _read(path, lambda settings, _: str(settings["title"]))


def read_problem_text(path: Path) -> str:
    """Return the text of a plan's problem file, empty if not known; errors as ``read_plan``."""
    return _read(path, lambda settings, _: str(settings.get("problem", "")))


def _read(path: Path, made: Callable[[dict[str, Any], Arrays], T]) -> T:
    """Return what ``made`` makes of the settings and arrays in a file."""
    try:
        head = read_arrays(path, ("format", "settings"))
        if str(head["format"]) != FORMAT:
            raise InputError("format", str(head["format"]), FORMAT, "use hitchopt's own files")
        settings = json.loads(str(head["settings"]))
        if not isinstance(settings, dict):
            raise InputError("settings", settings, "a mapping", "use a plan that hitchopt wrote")
        hitched = (*PER_ROBOT, *POLYNOMIALS[1:]) if "robots" in settings["team"] else ()
        names = ["breaks", POLYNOMIALS[0], *PER_KIND, *hitched]
        names += [name for name in FURTHER if settings.get(name) is True]
        names += PER_CONTROLLER if settings.get("control") is True else ()
        arrays = read_arrays(path, names)
        for name, array in arrays.items():
            if array.dtype != np.float64:
                raise InputError(name, array.dtype, "of double precision", "do not convert it")
        return made(settings, arrays)
    except BROKEN as error:
        raise FileError(f"{path}: {_reason(error)}; solve the problem again") from error


def _motion(settings: dict[str, Any], arrays: Arrays) -> Motion:
    parts = {}
    for name in (name for name in (*POLYNOMIALS, *FURTHER) if name in arrays):
        if arrays[name].size and not np.max(np.abs(arrays[name])) <= LARGEST:
            raise InputError(name, "a coefficient", f"within ±{LARGEST:g}", DO_NOT)
        parts[name] = PiecewisePolynomial(arrays["breaks"], arrays[name])
    requirements = Requirements(
        Limits(**settings["limits"]),
        Separation(**settings["separation"]),
        None if settings["arena"] is None else Arena(**settings["arena"]),
        tuple(Prism(**entry) for entry in settings["keep_out"]),
        {name: _object(**entry) for name, entry in settings.get("objects", {}).items()},
    )
    given, kinds = settings["team"], _kinds(arrays)
    phases = _stored("phases", settings["phases"], tuple[Phase, ...])
    if "robots" in given:
        per_robot: dict[str, Any] = {name: arrays[name] for name in PER_ROBOT}
        team = Team(**given, **per_robot, quadrotor=kinds)
        assignment = _stored("assignment", settings.get("assignment"), Assignment | None)
        motion = Motion(team, requirements, **parts, phases=phases, assignment=assignment)
    else:
        swarm = Swarm(given["drones"], quadrotor=kinds)
        motion = Motion.single(swarm, requirements, parts["drones"], phases)
    _check_phases(motion)
    begin, objects = motion.object_poses.coefficients[0, ..., 0], requirements.objects
    if np.max(np.abs(begin - poses_of(objects)), initial=0.0) > STILL:
        raise InputError("poses", begin.tolist(), "where the objects stand", DO_NOT)
    check_apart(objects)
    check_asked(settings["asked"], motion)
    return motion


def _object(section: dict[str, Any], rim: dict[str, Any] | None, **values: Any) -> SolidObject:
    """Return an object as it is stored."""
    thin = None if rim is None else Rim(Section(**rim["section"]), rim["height"])
    return SolidObject(Section(**section), rim=thin, **values)


def _kinds(arrays: Arrays) -> list[Quadrotor]:
    """Return the kinds of quadrotors, whose controllers are the defaults where none are stored."""
    names = [name for name in (*PER_KIND, *PER_CONTROLLER) if name in arrays]
    columns: dict[str, list[Any]] = {name: arrays[name].tolist() for name in names}
    for name in PER_CONTROLLER[1:]:
        for value in columns.get(name, ()):
            if value not in (0.0, 1.0):
                raise InputError(name, value, "0 or 1", DO_NOT)
        if name in columns:
            columns[name] = [value == 1.0 for value in columns[name]]
    if "stiffness" in columns:
        columns["stiffness"] = [None if x == np.inf else x for x in columns["stiffness"]]
    rows = zip(*columns.values(), strict=True)
    return [Quadrotor(**dict(zip(names, row, strict=True))) for row in rows]


def _stored(key: str, value: Any, kind: Any) -> Any:
    """Return the record of a kind, or the tuple of records, that a setting holds.

    Raises
    ------
    InputError: types that are not those of the record's fields.
    """
    from pydantic import TypeAdapter, ValidationError  # heavy, as of all files

    try:
        return TypeAdapter(kind).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, (key, *first["loc"])))
        raise InputError(place, first["input"], f"stored ({first['msg']})", DO_NOT) from None


def _check_phases(motion: Motion) -> None:
    """Raise InputError for phases of other times, impossible ranges, or holds of what is not there.

    A motion has verified that they follow one another and cover the pieces.
    """
    spans = [[phase.start, phase.end] for phase in motion.phases]
    if not spans or max(abs(spans[0][0]), abs(spans[-1][1] - motion.duration)) > JOINT:
        words = f"one after the other from 0 to {motion.duration:g} s"
        raise InputError("phases", spans, words, DO_NOT)
    objects, robots = motion.requirements.objects, motion.team.robots
    for phase in motion.phases:
        if phase.tension is not None and not 0.0 < phase.tension[0] <= phase.tension[1] < np.inf:
            words = "a smallest and a largest tension, or null"
            raise InputError("phases.tension", phase.tension, words, DO_NOT)
        hold = phase.hold
        if hold and not (hold.object in objects and set(hold.cables) <= set(range(robots))):
            bound = f"an object of {sorted(objects)} and cables from 0 to {robots - 1}"
            raise InputError("phases.hold", vars(hold), bound, DO_NOT)


def _reason(error: BaseException) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, KeyError):
        return f"not a plan that hitchopt wrote: {error} is missing"
    if isinstance(error, OSError) and error.strerror:
        return f"cannot be read: {error.strerror}"
    return f"not a plan that hitchopt wrote, or a damaged one: {error or type(error).__name__}"
