"""Plan files, plan.npz: piecewise polynomials, exact to the last bit.

Polynomials are stored as Bernstein coefficients (pieces, *shape, degree + 1) over common
``breaks``, without cables the drones' alone; everything else as JSON under ``settings``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.motion.asked import asked_of, check_asked, objects_at_first, values_of
from hitchopt.motion.motion import (
    FURTHER,
    JOINT,
    POLYNOMIALS,
    Motion,
    Phase,
)
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.objects.placing import STILL, check_apart, poses_of
from hitchopt.storage.archive import BROKEN, read_arrays
from hitchopt.trajectory import PiecewisePolynomial

T = TypeVar("T")

Arrays = dict[str, NDArray[Any]]

FORMAT = "hitchopt-plan/1"

OBJECTS = "objects"
"""Setting with the objects by name, stored where there are any."""

PER_KIND = ("mass", "max_thrust")
"""Fields of a quadrotor, stored as arrays: (n,), one value a robot; (N,) of single drones."""

CONTROL = "control"
"""Setting that is true where the fields of a quadrotor's controller are stored as well."""

PER_CONTROLLER = tuple(field.name for field in fields(Quadrotor) if field.name not in PER_KIND)
"""Fields of a quadrotor that are stored like PER_KIND, unless all of them are defaults.

A rigid loop is stored as an infinite stiffness, and a flag as 0 or 1.
"""

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
    arrays: Arrays = {
        name: np.array([getattr(kind, name) for kind in team.quadrotor]) for name in PER_KIND
    }
    settings: dict[str, Any] = {
        "title": title,
        "team": {"drones": team.drones},
        "limits": requirements.limits,
        "separation": requirements.separation,
        "arena": requirements.arena,
        "phases": motion.phases,
        "keep_out": requirements.keep_out,
        "asked": asked_of(motion),
    }
    control = {name: [getattr(kind, name) for kind in team.quadrotor] for name in PER_CONTROLLER}
    if any(set(column) != {getattr(Quadrotor, name)} for name, column in control.items()):
        settings[CONTROL] = True
        for name, column in control.items():
            stored = [np.inf if value is None else float(value) for value in column]
            arrays[name] = np.array(stored)
    polynomials: tuple[str, ...] = POLYNOMIALS[:1]
    if team.has_cables:
        polynomials = POLYNOMIALS
        values = {field.name: getattr(team, field.name) for field in fields(team)}
        arrays |= {name: values.pop(name) for name in PER_ROBOT}
        settings["team"] = {name: value for name, value in values.items() if name != "quadrotor"}
    if requirements.objects:
        settings[OBJECTS] = objects_at_first(motion)
    for name in FURTHER:  # a setting of the same name says that they are there
        if getattr(motion, name) is not None:
            polynomials += (name,)
            settings[name] = True
    if problem:
        settings["problem"] = problem
    if motion.assignment is not None:
        settings["assignment"] = motion.assignment
    arrays["breaks"] = motion.drones.breaks
    arrays |= {name: getattr(motion, name).coefficients for name in polynomials}
    text = json.dumps(settings, allow_nan=False, default=values_of)
    with path.open("wb") as file:
        np.savez(
            file, allow_pickle=False, format=np.array(FORMAT), settings=np.array(text), **arrays
        )


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
        if settings.get(CONTROL) is True:
            names += PER_CONTROLLER
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
        {name: _object(**entry) for name, entry in settings.get(OBJECTS, {}).items()},
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
    _check_phases(phases, motion.team.robots, requirements.objects)
    spans = [[phase.start, phase.end] for phase in phases]
    # A motion has verified that they follow one another and cover the pieces.
    if not spans or max(abs(spans[0][0]), abs(spans[-1][1] - motion.duration)) > JOINT:
        words = f"one after the other from 0 to {motion.duration:g} s"
        raise InputError("phases", spans, words, DO_NOT)
    begin = motion.object_poses.coefficients[0, ..., 0]
    if np.max(np.abs(begin - poses_of(requirements.objects)), initial=0.0) > STILL:
        raise InputError("poses", begin.tolist(), "where the objects stand", DO_NOT)
    check_apart(requirements.objects)
    check_asked(settings["asked"], motion)
    return motion


def _object(section: dict[str, Any], rim: dict[str, Any] | None, **values: Any) -> SolidObject:
    """Return an object as it is stored."""
    thin = None if rim is None else Rim(Section(**rim["section"]), rim["height"])
    return SolidObject(Section(**section), rim=thin, **values)


def _kinds(arrays: Arrays) -> list[Quadrotor]:
    """Return the kinds of quadrotors, whose controllers are the defaults where none are stored."""
    columns: dict[str, list[Any]] = {
        name: arrays[name].tolist() for name in (*PER_KIND, *PER_CONTROLLER) if name in arrays
    }
    for name in ("integral", "feed_forward"):
        for value in columns.get(name, ()):
            if value not in (0.0, 1.0):
                raise InputError(name, value, "0 or 1", "do not edit it")
        if name in columns:
            columns[name] = [value == 1.0 for value in columns[name]]
    if "stiffness" in columns:
        columns["stiffness"] = [None if x == np.inf else x for x in columns["stiffness"]]
    rows = zip(*columns.values(), strict=True)
    return [Quadrotor(**dict(zip(columns, row, strict=True))) for row in rows]


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


def _check_phases(phases: Sequence[Phase], robots: int, objects: Collection[str]) -> None:
    """Raise InputError for phases with an impossible range, or that name what is not there."""
    for phase in phases:
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
