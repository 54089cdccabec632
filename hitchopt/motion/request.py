"""Requests: team, requirements and start, as records and JSON values.

Problems state the request, motions imply it, and both are compared with the keys of problem files.
Steps are compared by the table of ``hitchopt.verify.steps``.
Plan files store records in the same form: fields by their names, arrays as lists.
Robots are in the order of the problem.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache, partial
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from hitchopt.drones.quadrotor import Quadrotor
from hitchopt.errors import UNKNOWN_KEY, InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY, Swarm, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.values import Array, line
from hitchopt.values.fields import keys_of, with_fields

REMEDY = "do not edit plan files"

PLANNER_ONLY = ("position_error", "height_ratio")
"""Fields of requirements that planners set, which plan files do not have."""

TOLERANCE = 1e-9
"""Largest relative difference of equal numbers: conversion of angles to degrees rounds them."""

POSITION_TOLERANCE = 1e-6  # [m] Largest difference of a plan's start from the request

SLACK = {"request.start": POSITION_TOLERANCE}
"""Largest differences of numbers by the beginning of their keys."""


def encoded(value: Any) -> Any:
    """Return a record as JSON values: fields by name, arrays as lists."""
    if isinstance(value, ConvexPolygon):
        value = value.vertices
    if isinstance(value, Swarm):
        value = {"drones": value.drones, "quadrotor": value.quadrotor}
    elif isinstance(value, CableState):
        value = value.word
    elif is_dataclass(value):
        values = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
        if isinstance(value, Team):
            del values["assignment"]  # records of plans have it beside the team
        keys = keys_of(type(value))
        absent = [name for name, key in keys.items() if key.omitted and values[name] is None]
        value = {name: item for name, item in values.items() if name not in absent}
    elif isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: encoded(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [encoded(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.value if isinstance(value, Enum) else value


_hints = cache(get_type_hints)


PLAIN_TYPES = {float: (float, int), int: (int,), str: (str,), bool: (bool,)}
"""Types of JSON values of plain types."""

READERS: dict[Any, Callable[[Any], Any]] = {str: partial(line, ""), CableState: CableState.of}
"""Functions that read values of types that are written as a line."""


def decoded(kind: Any, value: Any) -> Any:
    """Return the value of a type from JSON values; constructors check records.

    Raises TypeError, ValueError, KeyError or InputError for values of another form.
    """
    origin = get_origin(kind)
    arguments = get_args(kind)
    if kind in PLAIN_TYPES and type(value) not in PLAIN_TYPES[kind]:
        raise InputError("", value, f"of the type {kind.__name__}", REMEDY)
    if kind in READERS:
        return READERS[kind](value)
    if origin in (Union, UnionType):
        return _decoded_union(arguments, value)
    if origin is tuple:
        is_of_any_length = arguments[1:] == (...,)
        kinds = arguments[:1] * len(value) if is_of_any_length else arguments
        return tuple(decoded(*pair) for pair in zip(kinds, value, strict=True))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {line("", name): decoded(arguments[1], item) for name, item in value.items()}
    if (is_dataclass(kind) and kind is not ConvexPolygon) or hasattr(kind, "_fields"):
        return _decoded_record(kind, value)
    is_enumerated = isinstance(kind, type) and issubclass(kind, Enum)
    return kind(value) if is_enumerated else value


def _decoded_union(kinds: Sequence[Any], value: Any) -> Any:
    """Return the value of one of several types: the first one of its form, else the first one."""
    if value is None and NoneType in kinds:
        return None
    form: Any = tuple if isinstance(value, list) else type(value)
    candidates = [
        kind for kind in kinds if kind is not NoneType and get_origin(kind) is not Mapping
    ]
    fitting = [
        kind
        for kind in candidates
        if get_origin(kind) is form or (form is dict and is_dataclass(kind))
    ]
    return decoded((fitting or candidates)[0], value)


def _decoded_record(kind: Any, value: Mapping[str, Any]) -> Any:
    """Return a record from a mapping of its fields; a team of single drones is a swarm."""
    if kind is Team and "drones" in value:
        kinds = decoded(tuple[Quadrotor, ...], value["quadrotor"])
        return Swarm(value["drones"], quadrotor=kinds)
    hints = _hints(kind)
    keys = keys_of(kind) if isinstance(kind, type) and is_dataclass(kind) else {}
    values: dict[str, Any] = {name: None for name, key in keys.items() if key.omitted}
    for name, item in value.items():
        if name not in hints:
            raise InputError(name, item, UNKNOWN_KEY, REMEDY)
        try:
            values[name] = decoded(hints[name], item)
        except InputError as error:
            raise error.within(name) from error
    return kind(**values)


def check_same(
    prefix: str, request: Any, value: Any, suffix: str, slack: Mapping[str, float] | None = None
) -> None:
    """Raise InputError with the key if JSON values or records differ from the requested ones.

    Numbers are equal within TOLERANCE, and within ``slack`` where keys begin so.
    """
    if isinstance(request, dict) and isinstance(value, dict):  # most records are exactly equal
        equal = {
            key
            for key, record in request.items()
            if is_dataclass(record) and record == value.get(key)
        }
        request = {key: record for key, record in request.items() if key not in equal}
        value = {key: record for key, record in value.items() if key not in equal}
    requested = dict(_leaves(prefix, encoded(request)))
    actual = dict(_leaves(prefix, encoded(value)))
    for key in requested | actual:
        slacks = [by for beginning, by in (slack or {}).items() if key.startswith(beginning)]
        allowed = max(slacks, default=0.0)
        in_both = key in requested and key in actual
        if not (in_both and _equal(requested[key], actual[key], allowed)):
            bound = f"{requested[key]!r} {suffix}" if key in requested else f"omitted {suffix}"
            raise InputError(key, actual.get(key, "omitted"), bound, REMEDY)


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield single values and empty containers by their keys in the file."""
    if isinstance(value, dict) and value:
        for name, item in value.items():
            yield from _leaves(f"{key}.{name}".lstrip("."), item)
    elif isinstance(value, list) and value:
        for index, item in enumerate(value):
            yield from _leaves(f"{key}[{index}]", item)
    else:
        yield key, value


def _equal(request: Any, value: Any, slack: float) -> bool:
    """Return whether single values are equal, numbers within TOLERANCE and ``slack``."""
    if _is_number(request) and _is_number(value):
        return math.isclose(request, value, rel_tol=TOLERANCE, abs_tol=slack)
    return type(request) is type(value) and bool(request == value)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, which true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def request_of(motion: Motion) -> dict[str, Any]:
    """Return the request that a motion satisfies, with robots in the order of the problem."""
    team = motion.team
    requirements = replace(motion.requirements, objects=objects_at(motion))
    drones = motion.drones.coefficients[0, ..., 0]
    if not team.has_cables:
        return request_fields(team, requirements, {"drones": drones})
    in_order = drones[team.listed]
    assignment = motion.assignment or Assignment.fixed(team.robots)
    start: dict[str, Any] = {
        "drones": {"q": in_order[0::2], "r": in_order[1::2]},
        "assignment": assignment.to_dict(),
    }
    if motion.formed[0]:
        vertices = motion.vertices.coefficients[0, ..., 0]
        start["hitch"] = {
            "polygon": vertices[:, :2],
            "altitude": float(np.mean(vertices[:, 2])),
            "legs": motion.legs.coefficients[0, :, 0, 0],
        }
    return request_fields(team.of_problem, requirements, start)


def request_fields(
    team: Team, requirements: Requirements, start: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a team and requirements as records, and a start as JSON values.

    The start has ``hitch``, ``drones`` or both.
    """
    names = [field.name for field in fields(requirements) if field.name not in PLANNER_ONLY]
    return {
        "start": encoded(start),  # compared first: other drones differ in much else
        "team": team,
        **{name: getattr(requirements, name) for name in names},
    }


def objects_at(motion: Motion, end: Literal[0, -1] = 0) -> dict[str, SolidObject]:
    """Return objects with their poses at the motion's start, or at its end (-1)."""
    objects = motion.requirements.objects
    poses = motion.poses.coefficients[end, ..., end]
    return {
        name: _placed(body, pose) for (name, body), pose in zip(objects.items(), poses, strict=True)
    }


def _placed(body: SolidObject, pose: Array) -> SolidObject:
    """Return an object at a pose (5,), or itself if it is there."""
    if np.max(np.abs(pose - body.pose)) <= REST_DRIFT:
        return body
    return with_fields(body, at=pose[:3], yaw=math.atan2(pose[4], pose[3]))


def check_request(request: Mapping[str, Any], flight: Flight) -> None:
    """Raise InputError with the key if teams, limits or starts of a flight differ from a request.

    Keys that the problem does not specify are not compared. For several teams, the request maps
    their names to their requests. ``others`` maps the names of external plans to their start times
    ``at`` [s] and, if specified, their paths ``plan``.
    """
    teams = {key: value for key, value in request.items() if key != "others"}
    if "others" in request:
        others = dict[str, dict[str, Any]]()
        for flown in flight.others:
            name = flown.name.partition(".")[0]
            facts = {"plan": flown.plan, "at": float(flown.motion.drones.breaks[0])}
            keys = request["others"].get(name, facts)
            others[name] = {key: fact for key, fact in facts.items() if key in keys}
        check_same("request.others", request["others"], others, "as requested")
    if len(flight.teams) == 1:
        _check_team(teams, flight.teams[0].motion)
        return
    names = [flown.name for flown in flight.teams]
    if teams.keys() != set(names):
        raise InputError("request", names, f"the teams {sorted(teams)}", REMEDY)
    for flown in flight.teams:
        try:
            _check_team(teams[flown.name], flown.motion)
        except InputError as error:
            raise error.within(flown.name) from error


def _with_keys_of(given: Any, actual: Any, motion: Motion) -> Any:
    """Return the entries of a mapping that another one has as well; other values as they are."""
    if not (isinstance(given, Mapping) and isinstance(actual, Mapping)):
        return actual
    common = {key: actual[key] for key in given if key in actual}
    return common | _unsagged(given, common, motion)


def _unsagged(given: Mapping[str, Any], actual: Mapping[str, Any], motion: Motion) -> Any:
    """Return the legs that are given, if actual ones are shorter by no more than sags.

    Legs of a motion are chords; lengths exceed them by ``(ρ g / T)² d³ / 24``.
    """
    if given.get("legs") is None or actual.get("legs") is None:
        return {}
    lengths = np.asarray(given["legs"], dtype=np.float64)
    chords = np.asarray(actual["legs"], dtype=np.float64)
    if lengths.shape != chords.shape:
        return {}
    weight_ratio = GRAVITY * motion.team.cable_density / motion.team.tension  # [1/m]
    allowed = 2.0 * weight_ratio**2 * lengths**3 / 24.0 + POSITION_TOLERANCE
    is_sag = np.all(np.abs(lengths - chords) <= allowed)
    return {"legs": given["legs"]} if is_sag else {}


def _check_team(request: Mapping[str, Any], motion: Motion) -> None:
    """Raise InputError with the key if one team's motion differs from its request."""
    actual = request_of(motion)
    start = {
        key: _with_keys_of(given, actual["start"].get(key), motion)
        for key, given in request["start"].items()
    }
    check_same("request", request, actual | {"start": start}, "as requested", SLACK)
