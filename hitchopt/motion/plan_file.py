"""Plan files, plan.npz: piecewise polynomials, exact to the last bit, and the request they satisfy.

Polynomials are stored as Bernstein coefficients (pieces, *shape, degree + 1) over common
``breaks``; without cables, only those of the drones. Everything else is JSON in ``settings``. Its
key ``asked`` is the request, robot by robot: readers can verify that team, requirements and roles
are the requested ones.

Format 1 holds the motion of one team. Format 2 holds several teams and external plans, each with
the arrays and settings of format 1 under its name.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.hitch.team import Assignment
from hitchopt.motion.chapters import check_rings
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import (
    JOINT,
    OPTIONAL_CURVES,
    POLYNOMIALS,
    WAIT,
    Group,
    Motion,
    Phase,
)
from hitchopt.motion.retiming import shifted
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.objects.placing import REST_DRIFT, check_overlaps, poses_of
from hitchopt.storage.archive import PLAN, READ_ERRORS, read_arrays
from hitchopt.storage.files import digest
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import text

Arrays = dict[str, NDArray[Any]]

FORMAT_1, FORMAT_2 = "hitchopt-plan/1", "hitchopt-plan/2"
"""Formats of a single team, and of several groups or external plans."""

QUADROTOR_ARRAYS = ("mass", "max_thrust")
"""Fields of a quadrotor that are stored as arrays: (n,), one value per robot, or per drone (N,)."""

LOOP_ARRAYS: Mapping[str, float] = {"stiffness": math.inf, "integral": 0.0, "feed_forward": 1.0}
"""Numbers of a quadrotor's position loop with defaults, stored as arrays if any differs (setting
``control``). Rigid loops have infinite stiffness; flags are 0 or 1. Named controllers are stored in
the setting ``controllers``: a single one, or one per kind."""

ROBOT_ARRAYS = ("cable_length", "tension")
"""Fields of a team that are stored as arrays (n,); the others are settings."""

OTHERS = "others"
"""Key of external plans, and folder of their arrays."""

REMEDY = "do not edit plan files"

MAX_COEFFICIENT, MAX_DEGREE = 1e5, 60
"""[m], [N] Largest coefficient of a plan: sums of such numbers stay far from overflow."""

MAX_STEPS = 2**31
"""Upper bound of a step's index, exclusive."""

TOLERANCE = 1e-9
"""Largest relative difference of equal numbers: conversion of angles to degrees rounds them."""

POSITION_TOLERANCE = 1e-6
"""[m] Largest difference of a plan's start, and of the ends of its steps, from the request."""

TENSION_SLACK = 1e-4
"""[N] Largest excess over a range of tensions, as in the check ``tension``."""

OPTIONAL = frozenset(
    {"control", "controllers", "objects", "problem", "assignment", *OPTIONAL_CURVES}
)
"""Settings that are left out if empty."""

OPTIONAL_KEYS = frozenset({"mission", "problem"})
"""Keys of ``asked`` that files of earlier releases lack."""


def write_plan(path: Path, motion: Motion, title: str = "", problem: str = "") -> None:
    """Write a plan; the same plan gives the same bytes.

    Parameters
    ----------
    path: file, replaced if it exists.
    motion, title: the plan.
    problem: text of its problem file, if known.

    Raises
    ------
    OSError: the file cannot be written.
    """
    single = len(motion.all_groups) == 1
    settings = (_settings if single else _group_settings)(motion, title, problem)
    arrays: Arrays = {"format": np.array(FORMAT_1 if single else FORMAT_2)}
    arrays["settings"] = np.array(json.dumps(settings, allow_nan=False))
    for folder, groups in (("", motion.groups), (OTHERS, motion.others)):
        for each in groups:
            group_arrays = _arrays(each.motion).items()
            arrays |= {_path(folder, each.name, name): array for name, array in group_arrays}
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _path(*names: str) -> str:
    """Return the path of an array in an archive."""
    return "/".join(filter(None, names))


def _arrays(motion: Motion) -> Arrays:
    """Return the arrays of one team's motion."""
    team = motion.team
    columns = _columns(team)
    names = (*QUADROTOR_ARRAYS, *(LOOP_ARRAYS if _has_loop_arrays(team) else ()))
    arrays: Arrays = {name: np.array(columns[name], dtype=np.float64) for name in names}
    if team.has_cables:
        arrays |= {name: getattr(team, name) for name in ROBOT_ARRAYS}
    arrays["breaks"] = motion.drones.breaks
    optional = [name for name in OPTIONAL_CURVES if getattr(motion, name) is not None]
    for name in (*(POLYNOMIALS if team.has_cables else POLYNOMIALS[:1]), *optional):
        arrays[name] = getattr(motion, name).coefficients
    return arrays


def _columns(team: Team) -> dict[str, list[float]]:
    """Return the numbers of all kinds of quadrotors by name, as files store them."""
    columns = {name: [getattr(kind, name) for kind in team.quadrotor] for name in QUADROTOR_ARRAYS}
    for name, plain in LOOP_ARRAYS.items():
        values = [getattr(kind, name) for kind in team.quadrotor]
        columns[name] = [plain if each is None else float(each) for each in values]
    return columns


def _has_loop_arrays(team: Team) -> bool:
    """Return whether any number of a position loop differs from its default."""
    columns = _columns(team)
    return any(set(columns[name]) != {plain} for name, plain in LOOP_ARRAYS.items())


def _settings(motion: Motion, title: str, problem: str) -> dict[str, Any]:
    """Return the settings of a plan file, as JSON values."""
    team, requirements = motion.team, motion.requirements
    team_values = {"drones": team.drones}
    if team.has_cables:
        arrays = (*ROBOT_ARRAYS, "quadrotor")
        names = (field.name for field in fields(team) if field.name not in arrays)
        team_values = {name: getattr(team, name) for name in names}
    limits, per_kind = _limits(requirements), [_controller(kind) for kind in team.quadrotor]
    controllers = per_kind[:1] if all(each == per_kind[0] for each in per_kind) else per_kind
    settings: dict[str, Any] = {
        "title": title,
        "team": team_values,
        "limits": limits,
        "separation": requirements.separation,
        "arena": requirements.arena,
        "phases": motion.phases,
        "keep_out": requirements.keep_out,
        "asked": request_of(motion, problem),
        "control": _has_loop_arrays(team),
        "controllers": controllers if any(controllers) else [],
        "objects": _objects_at_first(motion),
        **{name: getattr(motion, name) is not None for name in OPTIONAL_CURVES},
        "problem": problem,
        "assignment": motion.assignment,
    }
    return {key: x for key, x in _as_json(settings).items() if x or key not in OPTIONAL}


def _group_settings(motion: Motion, title: str, problem: str) -> dict[str, Any]:
    """Return the settings of format 2: those of every group, and the requested groups."""
    head = {"title": title} | ({"problem": problem} if problem else {})

    def by_name(groups: Sequence[Group]) -> dict[str, Any]:
        settings = {each.name: _settings(each.motion, title, problem) for each in groups}
        return {
            name: {key: x for key, x in each.items() if key not in head}
            for name, each in settings.items()
        }

    asked = {
        each.name: {
            "plan": each.plan,
            "at": float(each.motion.drones.breaks[0]),
            "digest": each.digest,
        }
        for each in motion.others
    }
    teams, others = by_name(motion.groups), by_name(motion.others)
    return head | {"teams": teams, OTHERS: others, "asked": {"teams": [*teams], OTHERS: asked}}


def _limits(requirements: Requirements) -> dict[str, Any]:
    """Return the limits; of unset ones, only those that files of all releases store as null."""
    limits = vars(requirements.limits).items()
    return {name: limit for name, limit in limits if limit or name in ("duration", "body_rate")}


def _as_json(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values as JSON stores them."""
    result: dict[str, Any] = json.loads(json.dumps(values, allow_nan=False, default=_encode))
    return result


class SavedPlan(NamedTuple):
    """Contents of a plan file: the plan, its title, and the text of its problem file if known."""

    motion: Motion
    title: str
    problem: str


def read_plan(path: Path) -> Motion:
    """Return the plan of a file that hitchopt wrote; errors are those of ``read_saved_plan``."""
    return read_saved_plan(path).motion


def saved_others(name: str, path: Path, plan: str, at: float) -> tuple[Group, ...]:
    """Return the groups of a plan file as external plans that start at a time ``at`` [s].

    They are named ``name``, or ``name.a``, ``name.b`` for several teams; ``plan`` is the path as
    written. External plans of that plan are left out. Errors are those of ``read_saved_plan``.
    """
    return tuple(
        Group(
            ".".join(filter(None, (name, each.name))),
            shifted(each.motion.replaced(others=()), at),
            digest(path),
            plan,
        )
        for each in read_plan(path).groups
    )


def is_of(other: Group, path: Path) -> bool:
    """Return whether a plan file contains an external plan, as ``saved_others`` reads it."""
    try:
        at = float(other.motion.drones.breaks[0])
        groups = saved_others(other.name.partition(".")[0], path, other.plan, at)
        saved = next(each for each in groups if each.name == other.name)
        arrays, saved_arrays = _arrays(other.motion), _arrays(saved.motion)
        settings, saved_settings = (_settings(each.motion, "", "") for each in (other, saved))
        _check_same("", saved_settings, settings, "as in its plan")
    except (FileError, InputError, StopIteration):
        return False
    return saved.digest == other.digest and all(
        arrays[name].shape == array.shape
        and np.allclose(arrays[name], array, rtol=0.0, atol=TOLERANCE, equal_nan=True)
        for name, array in saved_arrays.items()
    )


def read_saved_plan(path: Path) -> SavedPlan:
    """Return the contents of a plan file.

    Raises
    ------
    FileError: it cannot be read, is not a plan, or differs from its request.
    """
    try:
        head = read_arrays(path, ("format", "settings"))
        version, settings = str(head["format"]), json.loads(str(head["settings"]))
        if version not in (FORMAT_1, FORMAT_2):
            bound = f"{FORMAT_1} or {FORMAT_2}"
            raise InputError("format", version, bound, "use hitchopt's own files")
        if not isinstance(settings, dict):
            raise InputError("settings", settings, "a mapping", "use a plan that hitchopt wrote")
        return _saved_plan(path, settings) if version == FORMAT_1 else _saved_groups(path, settings)
    except READ_ERRORS as error:
        reason = f"not a plan that hitchopt wrote, or a damaged one: {error or repr(error)}"
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            hint = f", {path.parent} holds no plan" if path.name == PLAN else ""
            words = f"there is no such file{hint}; name the directory of a plan"
            raise FileError(f"{path}: {words}") from None
        if isinstance(error, KeyError):
            reason = f"not a plan that hitchopt wrote: {error} is missing"
        elif isinstance(error, OSError) and error.strerror:
            reason = f"cannot be read: {error.strerror}"
        reason = " ".join(reason.split())  # arrays are printed over several lines
        raise FileError(f"{path}: {reason}; solve the problem again") from error


def _saved_plan(path: Path, settings: dict[str, Any]) -> SavedPlan:
    """Return the contents of a file of format 1."""
    motion = _read_motion(path, settings)
    title, problem = text("title", settings["title"]), text("problem", settings.get("problem", ""))
    actual = _settings(motion, title, problem)
    requested, request = dict(settings["asked"]), actual.pop("asked")
    request = {key: x for key, x in request.items() if key in requested or key not in OPTIONAL_KEYS}
    _check_same("asked", requested, request, "as requested")
    stored = {key: x for key, x in settings.items() if key != "asked"}
    _check_same("", actual, stored, "as plans are written")
    return SavedPlan(motion, title, problem)


def _saved_groups(path: Path, settings: dict[str, Any]) -> SavedPlan:
    """Return the contents of a file of format 2."""
    groups, others = list[Group](), list[Group]()
    for name, each in settings["teams"].items():
        with _error_context(f"teams.{name}"):
            motion = _read_motion(path, each, name)
            groups.append(Group(name, motion))
            end, duration = motion.duration, groups[0].motion.duration
            if abs(end - duration) > JOINT:
                raise InputError("breaks", end, f"up to {duration:g} s, as for all teams", REMEDY)
            _check_waits(motion)
    for name, each in settings[OTHERS].items():
        asked = settings["asked"][OTHERS][name]
        with _error_context(f"{OTHERS}.{name}"):
            motion = _read_motion(path, each, OTHERS, name, begin=asked["at"])
            texts = (text(key, asked[key]) for key in ("digest", "plan"))
            others.append(Group(name, motion, *texts))
    motion = combined(groups, others)
    title, problem = text("title", settings["title"]), text("problem", settings.get("problem", ""))
    actual = _group_settings(motion, title, problem)
    if len(motion.all_groups) == 1:
        raise InputError("teams", [*settings["teams"]], "several, or one with others", REMEDY)
    _check_same("", actual, settings, "as plans are written")
    return SavedPlan(motion, title, problem)


@contextmanager
def _error_context(name: str) -> Iterator[None]:
    """Prefix the keys of invalid values with that of a group."""
    try:
        yield
    except InputError as error:
        raise error.within(name) from error


def _check_waits(motion: Motion) -> None:
    """Raise InputError if anything moves in a phase named WAIT."""
    curves = [getattr(motion, name) for name in (*POLYNOMIALS, *OPTIONAL_CURVES)]
    for index, phase in enumerate(motion.phases):
        pieces = motion.phase_of_piece == index
        for curve in filter(None, curves if phase.name == WAIT and np.any(pieces) else ()):
            if np.max(np.ptp(curve.coefficients[pieces], axis=(0, -1)), initial=0.0) > REST_DRIFT:
                bound = "of a phase in which nothing moves"
                raise InputError(f"phases[{index}].name", WAIT, bound, REMEDY)


def _read_motion(path: Path, settings: dict[str, Any], *folders: str, begin: float = 0.0) -> Motion:
    """Return the motion of one team, with its arrays in nested folders, from ``begin`` [s] on."""
    names = ["breaks", POLYNOMIALS[0], *QUADROTOR_ARRAYS]
    names += (*ROBOT_ARRAYS, *POLYNOMIALS[1:]) if "robots" in settings["team"] else ()
    names += [name for name in OPTIONAL_CURVES if settings.get(name) is True]
    names += LOOP_ARRAYS if settings.get("control") is True else ()
    stored = read_arrays(path, [_path(*folders, name) for name in names])
    arrays = dict(zip(names, stored.values(), strict=True))
    for name, array in arrays.items():
        if array.dtype != np.float64:
            raise InputError(name, array.dtype, "of double precision", "do not convert it")
    parts = dict[str, Any]()
    for name in (name for name in (*POLYNOMIALS, *OPTIONAL_CURVES) if name in arrays):
        if arrays[name].size and not np.max(np.abs(arrays[name])) <= MAX_COEFFICIENT:
            raise InputError(name, "a coefficient", f"within ±{MAX_COEFFICIENT:g}", REMEDY)
        if (degree := arrays[name].shape[-1] - 1) > MAX_DEGREE:
            raise InputError(name, f"of degree {degree}", f"at most {MAX_DEGREE}", REMEDY)
        parts[name] = PiecewisePolynomial(arrays["breaks"], arrays[name])
    requirements = Requirements(
        Limits(**settings["limits"]),
        Separation(**settings["separation"]),
        None if settings["arena"] is None else Arena(**settings["arena"]),
        tuple(Prism(**entry) for entry in settings["keep_out"]),
        {name: _object(**entry) for name, entry in settings.get("objects", {}).items()},
    )
    own, kinds = settings["team"], _kinds(arrays, settings.get("controllers", []))
    phases = _stored("phases", settings["phases"], tuple[Phase, ...])
    if "robots" in own:
        per_robot: dict[str, Any] = {name: arrays[name] for name in ROBOT_ARRAYS}
        team = Team(**own, **per_robot, quadrotor=kinds)
        assignment = _stored("assignment", settings.get("assignment"), Assignment | None)
        motion = Motion(team, requirements, **parts, phases=phases, assignment=assignment)
    else:
        swarm = Swarm(own["drones"], quadrotor=kinds)
        motion = Motion.single(swarm, requirements, parts["drones"], phases)
    _check_phases(motion, begin)
    poses, objects = motion.object_poses.coefficients[0, ..., 0], requirements.objects
    if np.max(np.abs(poses - poses_of(objects)), initial=0.0) > REST_DRIFT:
        raise InputError("poses", poses.tolist(), "where the objects stand", REMEDY)
    check_overlaps(objects)
    return motion


def _object(section: dict[str, Any], rim: dict[str, Any] | None, **values: Any) -> SolidObject:
    """Return an object from its stored values."""
    thin = None if rim is None else Rim(Section(**rim["section"]), rim["height"])
    return SolidObject(Section(**section), rim=thin, **values)


def _controller(kind: Quadrotor) -> dict[str, Any] | None:
    """Return a kind's controller, gains and latency as files store them; None if it has none."""
    if kind.controller is None:
        return None
    named = {"controller": kind.controller, "gains": kind.gains and vars(kind.gains)}
    return named if kind.latency is None else named | {"latency": kind.latency}


def _kinds(arrays: Arrays, controllers: Sequence[Any]) -> list[Quadrotor]:
    """Return the kinds of quadrotors from their stored values."""
    names = [name for name in (*QUADROTOR_ARRAYS, *LOOP_ARRAYS) if name in arrays]
    columns: dict[str, list[Any]] = {name: arrays[name].tolist() for name in names}
    for name in LOOP_ARRAYS.keys() & columns:
        columns[name] = [None if x == LOOP_ARRAYS[name] else x for x in columns[name]]
        if name != "stiffness":
            columns[name] = [bool(x) if x in (0.0, 1.0) else x for x in columns[name]]
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    listed = list(controllers) if len(controllers) > 1 else [*controllers, None][:1] * len(rows)
    for row, each in zip(rows, listed, strict=True):
        if each:
            row.update({name: None for name in LOOP_ARRAYS if name in row}, **each)
    return [Quadrotor(**row) for row in rows]


def _stored(key: str, value: Any, kind: Any) -> Any:
    """Return a setting as a record, or a tuple of records; raise InputError if it is invalid."""
    from pydantic import TypeAdapter, ValidationError  # heavy, as of all files

    try:
        return TypeAdapter(kind).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, (key, *first["loc"])))
        raise InputError(place, first["input"], f"stored ({first['msg']})", REMEDY) from None


def _check_phases(motion: Motion, begin: float) -> None:
    """Raise InputError for phases with invalid times, ranges, rings, or holds of missing objects.

    The motion has verified that they are contiguous and cover the pieces.
    """
    spans = [[phase.start, phase.end] for phase in motion.phases]
    first, last = motion.drones.breaks[[0, -1]].tolist()
    if first != begin:
        raise InputError("breaks", first, f"rising from {begin:g}", REMEDY)
    if not spans or max(abs(spans[0][0] - first), abs(spans[-1][1] - last)) > JOINT:
        words = f"one after the other from {first:g} to {last:g} s"
        raise InputError("phases", spans, words, REMEDY)
    if motion.has_ring_changes:
        check_rings(motion)
    objects, cables = motion.requirements.objects, range(motion.team.robots)
    for phase in motion.phases:
        if not 0 <= phase.step < MAX_STEPS:
            raise InputError("phases.step", phase.step, "an index of a step", REMEDY)
        low, high = phase.tension or (1.0, 1.0)
        if not 0.0 < low <= high < np.inf:
            words = "a smallest and a largest tension, or null"
            raise InputError("phases.tension", phase.tension, words, REMEDY)
        hold = phase.hold
        if hold and not (hold.object in objects and set(hold.cables) <= set(cables)):
            bound = f"an object of {sorted(objects)} and cables from 0 to {len(cables) - 1}"
            raise InputError("phases.hold", vars(hold), bound, REMEDY)


def request_of(motion: Motion, problem: str = "") -> dict[str, Any]:
    """Return the request of a motion, with the keys of problem files and all defaults.

    Robots are in the order of the start; ``assignment`` maps them to roles. The text of the
    ``problem`` is stored as its digest.
    """
    team, first = motion.team, motion.drones.coefficients[0, ..., 0]
    requirements = replace(motion.requirements, objects=_objects_at_first(motion))
    start: dict[str, Any] = {"drones": first}
    if team.has_cables:
        assignment = motion.assignment or Assignment.fixed(team.robots)
        roles = np.argsort(assignment.robots).tolist()
        inverse = Assignment(tuple(roles), tuple(assignment.flipped[role] for role in roles))
        drones, team = inverse.drones(first), inverse.team(team)
        start = {"drones": {"q": drones[0::2], "r": drones[1::2]}}
        if motion.formed[0]:
            points = len(motion.phases[0].ring or motion.team.point_names)
            x, y, z = motion.vertices.coefficients[0, :points, ..., 0].T
            start["hitch"] = {"polygon": np.column_stack([x, y]), "altitude": float(np.mean(z))}
    request = request_fields(team, requirements, start, mission_of(motion))
    return request | {"problem": hashlib.sha256(problem.encode()).hexdigest()}


def request_fields(
    team: Team,
    requirements: Requirements,
    start: Mapping[str, Any],
    mission: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return a team, requirements, a start and a mission as plan files store them.

    Robots are in the order of the start, which has ``hitch``, ``drones`` or both. Steps of the
    mission have some of the keys of ``mission_of``.
    """
    team_fields: dict[str, Any] = dict(vars(team)) if team.has_cables else {"drones": team.drones}
    team_fields["quadrotor"] = [_quadrotor_fields(kind) for kind in team.quadrotor]
    limits = _limits(requirements)
    for name in ("tilt", "body_rate"):
        angle = limits.pop(name)
        limits[f"{name}_deg"] = None if angle is None else math.degrees(angle)
    return _as_json(
        {
            "start": start,  # compared first: roles determine the order of everything else
            "team": team_fields,
            "limits": limits,
            "separation": requirements.separation,
            "arena": requirements.arena,
            "keep_out": requirements.keep_out,
            "objects": requirements.objects,
            "mission": mission,
        }
    )


def _quadrotor_fields(kind: Quadrotor) -> dict[str, Any]:
    """Return a kind of quadrotor as plan files store it: with a controller, or with numbers."""
    own: dict[str, Any] = {name: getattr(kind, name) for name in QUADROTOR_ARRAYS}
    if named := _controller(kind):
        return own | named
    own |= {"stiffness": kind.stiffness, "integral": bool(kind.integral)}
    return own | {"feed_forward": kind.loop.feed_forward}


def _encode(record: Any) -> Any:
    """Return a record's fields, an outline's points, or an array's entries, for ``json``."""
    if isinstance(record, ConvexPolygon):
        return record.vertices.tolist()
    if isinstance(record, Phase) and record.ring is None:
        return {key: x for key, x in vars(record).items() if key not in ("ring", "waiting")}
    return record.tolist() if isinstance(record, np.ndarray) else vars(record)


def _objects_at_first(motion: Motion) -> dict[str, SolidObject]:
    """Return objects with their poses at the motion's start."""
    poses = motion.object_poses.coefficients[0, ..., 0]
    return {
        name: each
        if np.max(np.abs(pose - each.pose)) <= REST_DRIFT
        else replace(each, at=pose[:3], yaw=math.atan2(pose[4], pose[3]))
        for pose, (name, each) in zip(poses, motion.requirements.objects.items(), strict=True)
    }


def _steps(motion: Motion) -> list[list[Phase]]:
    """Return the phases of every step, in order."""
    return [list(phases) for _, phases in groupby(motion.phases, lambda phase: phase.step)]


def mission_of(motion: Motion) -> list[dict[str, Any]]:
    """Return the result of every step, as in ``asked.mission`` of a plan file."""
    breaks, names, results = motion.drones.breaks, motion.requirements.objects, []
    for phases in _steps(motion):
        last = max(int(np.argmin(np.abs(breaks - phases[-1].end))) - 1, 0)
        ranges = [phase.tension for phase in phases if phase.tension is not None]
        holds = [(phase.hold.object, phase.hold.by) for phase in phases if phase.hold is not None]
        ring = phases[-1].ring
        places = motion.vertices.coefficients[last, : None if ring is None else len(ring), ..., -1]
        poses = motion.object_poses.coefficients[last, ..., -1]
        step: dict[str, Any] = {
            "tension": [np.min(ranges), np.max(ranges)] if ranges else None,
            "holds": [*dict.fromkeys(holds)],
            "polygon": places[:, :2] if motion.formed[last] else None,
            "altitude": float(np.mean(places[:, 2])) if motion.formed[last] else None,
            "objects": dict(zip(names, poses, strict=True)),
        }
        if ring is not None:
            step["ring"] = ring
        if not motion.team.has_cables:
            step = {"drones": motion.drones.coefficients[last, ..., -1], "objects": step["objects"]}
        results.append(step)
    return results


def check_request(request: Mapping[str, Any], motion: Motion) -> None:
    """Raise InputError with the key if a motion differs from a problem's request.

    Keys that the problem does not specify are not compared. A step may use less than the requested
    range of tensions. For several teams, the request maps their names to their requests. ``others``
    maps the names of external plans to their start times ``at`` [s] and, if specified, their paths
    ``plan``.
    """
    teams = {key: value for key, value in request.items() if key != OTHERS}
    if OTHERS in request:
        others = dict[str, dict[str, Any]]()
        for each in motion.others:
            name = each.name.partition(".")[0]
            facts = {"plan": each.plan, "at": float(each.motion.drones.breaks[0])}
            keys = request[OTHERS].get(name, facts)
            others[name] = {key: fact for key, fact in facts.items() if key in keys}
        _check_same(f"asked.{OTHERS}", request[OTHERS], others, "as requested")
    if len(motion.groups) == 1:
        _check_team(teams, motion)
        return
    names = [each.name for each in motion.groups]
    if teams.keys() != set(names):
        raise InputError("asked", names, f"the teams {sorted(teams)}", REMEDY)
    for each in motion.groups:
        with _error_context(each.name):
            _check_team(teams[each.name], each.motion)


def _check_team(request: Mapping[str, Any], motion: Motion) -> None:
    """Raise InputError with the key if one team's motion differs from its request."""
    actual = request_of(motion)
    results, steps = actual.pop("mission"), request["mission"]
    del actual["problem"]
    start = {key: actual["start"].get(key) for key in request["start"]}
    team_request = {key: value for key, value in request.items() if key != "mission"}
    _check_same("asked", team_request, actual | {"start": start}, "as requested")
    if len(steps) != len(results):
        bound = f"{len(steps)} as requested"
        raise InputError("asked.mission", f"{len(results)} steps", bound, REMEDY)
    pairs = zip(_steps(motion), steps, results, strict=True)
    for i, (phases, requested, result) in enumerate(pairs):
        result["seconds"] = sum(each.end - each.start for each in phases if each.name != WAIT)
        (low, high), used = requested.get("tension") or (0.0, 0.0), result.get("tension")
        if used is None or (low - TENSION_SLACK <= used[0] and used[1] <= high + TENSION_SLACK):
            result["tension"] = requested.get("tension")
        compared = {key: result.get(key) for key in requested}
        _check_same(f"asked.mission[{i}]", requested, compared, "as requested")


def _check_same(prefix: str, request: Any, value: Any, suffix: str) -> None:
    """Raise InputError with the key if a value differs from the request."""
    requested, actual = (dict(_leaves(prefix, each)) for each in (request, value))
    for key in requested | actual:
        slack = POSITION_TOLERANCE if key.startswith(("asked.start", "asked.mission")) else 0.0
        in_both = key in requested and key in actual
        if not (in_both and _equal(requested[key], actual[key], slack)):
            bound = f"{requested[key]!r} {suffix}" if key in requested else f"left out {suffix}"
            raise InputError(key, actual.get(key, "left out"), bound, REMEDY)


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield single values and empty containers by their keys in the file."""
    if isinstance(value, dict) and value:
        for name, each in value.items():
            yield from _leaves(f"{key}.{name}".lstrip("."), each)
    elif isinstance(value, list) and value:
        for i, each in enumerate(value):
            yield from _leaves(f"{key}[{i}]", each)
    else:
        yield key, value


def _equal(request: Any, value: Any, slack: float) -> bool:
    """Return whether single values are equal, numbers within TOLERANCE and ``slack``."""
    if any(
        isinstance(each, bool) or not isinstance(each, int | float) for each in (request, value)
    ):
        return type(request) is type(value) and bool(request == value)
    return math.isclose(request, value, rel_tol=TOLERANCE, abs_tol=slack)
