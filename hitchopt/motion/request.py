"""Requests: team, requirements, start and results of steps, as records and JSON values.

Problems state the request, motions imply it, and both are compared with the keys of problem files.
Plan files store records in the same form: fields by their names, arrays as lists.
Robots are in the order of the problem.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache
from itertools import groupby
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY, Swarm, Team
from hitchopt.hitch.quadrotor import MEASURED, Quadrotor
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT, SETTLE, WAIT, Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

REMEDY = "do not edit plan files"

PLANNER_ONLY = ("position_error", "height_ratio")
"""Fields of requirements that planners set, which plan files do not have."""

TOLERANCE = 1e-9
"""Largest relative difference of equal numbers: conversion of angles to degrees rounds them."""

POSITION_TOLERANCE = 1e-6
"""[m] Largest difference of a plan's start, and of the ends of its steps, from the request."""

OMITTED: dict[type, tuple[str, ...]] = {
    Quadrotor: MEASURED,
    Team: ("errors",),
    Limits: ("vertex_error",),
}
"""Fields of records that plan files omit where they are None."""

SLACK = {"request.start": POSITION_TOLERANCE, "request.mission": POSITION_TOLERANCE}

TENSION_SLACK = 1e-4  # [N] Largest excess over a range of tensions, as in the check ``tension``


def encoded(value: Any) -> Any:
    """Return a record as JSON values: fields by name, arrays as lists."""
    if isinstance(value, ConvexPolygon):
        value = value.vertices
    if isinstance(value, Swarm):
        value = {"drones": value.drones, "quadrotor": value.quadrotor}
    elif is_dataclass(value):
        values = {each.name: getattr(value, each.name) for each in fields(value)}
        if isinstance(value, Team):
            del values["assignment"]  # records of plans have it beside the team
        omitted = OMITTED.get(type(value), ())
        absent = [name for name in omitted if values[name] is None]
        value = {name: each for name, each in values.items() if name not in absent}
    elif isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: encoded(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [encoded(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.value if isinstance(value, Enum) else value


_hints = cache(get_type_hints)


def decoded(kind: Any, value: Any) -> Any:
    """Return the value of a type from JSON values; constructors check records.

    Raises TypeError, ValueError, KeyError or InputError for values of another form.
    """
    origin, args = get_origin(kind), get_args(kind)
    known = {float: (float, int), int: (int,), str: (str,), bool: (bool,)}.get(kind)
    if known is not None and type(value) not in known:
        raise InputError("", value, f"of the type {kind.__name__}", REMEDY)
    if origin in (Union, UnionType):
        if value is None and NoneType in args:
            return None
        form: Any = tuple if isinstance(value, list) else type(value)
        arms = [each for each in args if each is not NoneType and get_origin(each) is not Mapping]
        fitting = [
            each
            for each in arms
            if get_origin(each) is form or (form is dict and is_dataclass(each))
        ]
        value = decoded((fitting or arms)[0], value)
    elif origin is tuple:
        kinds = args[:1] * len(value) if args[1:] == (...,) else args
        value = tuple(decoded(*each) for each in zip(kinds, value, strict=True))
    elif isinstance(origin, type) and issubclass(origin, Mapping):
        value = {name: decoded(args[1], each) for name, each in value.items()}
    elif kind is Team and "drones" in value:
        kinds = decoded(tuple[Quadrotor, ...], value["quadrotor"])
        value = Swarm(value["drones"], quadrotor=kinds)
    elif (is_dataclass(kind) and kind is not ConvexPolygon) or hasattr(kind, "_fields"):
        hints, values = _hints(kind), dict[str, Any]()
        for name, each in value.items():
            if name not in hints:
                raise InputError(name, each, "a known key", REMEDY)
            try:
                values[name] = decoded(hints[name], each)
            except InputError as error:
                raise error.within(name) from error
        value = kind(**values)
    elif isinstance(kind, type) and issubclass(kind, Enum):
        value = kind(value)
    return value


def check_same(
    prefix: str, request: Any, value: Any, suffix: str, slack: Mapping[str, float] | None = None
) -> None:
    """Raise InputError with the key if JSON values or records differ from the requested ones.

    Numbers are equal within TOLERANCE, and within ``slack`` where keys begin so.
    """
    if isinstance(request, dict) and isinstance(value, dict):  # most records are exactly equal
        same = {k for k, x in request.items() if is_dataclass(x) and x == value.get(k)}
        request, value = ({k: x[k] for k in x if k not in same} for x in (request, value))
    requested, actual = (dict(_leaves(prefix, encoded(each))) for each in (request, value))
    for key in requested | actual:
        allowed = max([by for name, by in (slack or {}).items() if key.startswith(name)] or [0.0])
        in_both = key in requested and key in actual
        if not (in_both and _equal(requested[key], actual[key], allowed)):
            bound = f"{requested[key]!r} {suffix}" if key in requested else f"omitted {suffix}"
            raise InputError(key, actual.get(key, "omitted"), bound, REMEDY)


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


def request_of(motion: Motion) -> dict[str, Any]:
    """Return the request that a motion satisfies, with robots in the order of the problem."""
    team, first = motion.team, motion.drones.coefficients[0, ..., 0]
    requirements = replace(motion.requirements, objects=objects_at(motion))
    start: dict[str, Any] = {"drones": first}
    if team.has_cables:
        first, team = first[team.listed], team.of_problem
        assignment = motion.assignment or Assignment.fixed(team.robots)
        start = {"drones": {"q": first[0::2], "r": first[1::2]}}
        start["assignment"] = assignment.to_dict()
        if motion.formed[0]:
            x, y, z = motion.vertices.coefficients[0, ..., 0].T
            legs = motion.legs.coefficients[0, :, 0, 0]
            outline = np.column_stack([x, y])
            start["hitch"] = {"polygon": outline, "altitude": float(np.mean(z)), "legs": legs}
    return request_fields(team, requirements, start, mission_of(motion))


def request_fields(
    team: Team,
    requirements: Requirements,
    start: Mapping[str, Any],
    mission: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return a team and requirements as records, a start and a mission as JSON values.

    The start has ``hitch``, ``drones`` or both; steps of the mission have some of the keys of
    ``mission_of``.
    """
    names = (each.name for each in fields(requirements) if each.name not in PLANNER_ONLY)
    return {
        "start": encoded(start),  # compared first: other drones differ in much else
        "team": team,
        **{name: getattr(requirements, name) for name in names},
        "mission": encoded(mission),
    }


def objects_at(motion: Motion, end: Literal[0, -1] = 0) -> dict[str, SolidObject]:
    """Return objects with their poses at the motion's start, or at its end (-1)."""
    poses = motion.poses.coefficients[end, ..., end]
    return {
        name: each
        if np.max(np.abs(pose - each.pose)) <= REST_DRIFT
        else with_fields(each, at=pose[:3], yaw=math.atan2(pose[4], pose[3]))
        for pose, (name, each) in zip(poses, motion.requirements.objects.items(), strict=True)
    }


def _steps(motion: Motion) -> list[list[Phase]]:
    """Return the phases of every step, in order."""
    return [list(phases) for _, phases in groupby(motion.phases, lambda phase: phase.step)]


def mission_of(motion: Motion) -> list[dict[str, Any]]:
    """Return the result of every step."""
    breaks, names, results = motion.drones.breaks, motion.requirements.objects, []
    for phases in _steps(motion):
        last = max(int(np.argmin(np.abs(breaks - phases[-1].end))) - 1, 0)
        ranges = [phase.tension for phase in phases if phase.tension is not None]
        holds = [(phase.hold.object, phase.hold.by) for phase in phases if phase.hold is not None]
        places = motion.vertices.coefficients[last, ..., -1]
        poses = motion.poses.coefficients[last, ..., -1]
        step: dict[str, Any] = {
            "tension": [np.min(ranges), np.max(ranges)] if ranges else None,
            "holds": [*dict.fromkeys(holds)],
            "polygon": places[:, :2] if motion.formed[last] else None,
            "altitude": float(np.mean(places[:, 2])) if motion.formed[last] else None,
            "legs": motion.legs.coefficients[last, :, 0, -1] if motion.formed[last] else None,
            "heights": motion.drones.coefficients[last, :, 2, -1],
            "objects": dict(zip(names, poses, strict=True)),
        }
        if not motion.team.has_cables:
            step = {"drones": motion.drones.coefficients[last, ..., -1], "objects": step["objects"]}
        results.append(step)
    return results


def check_request(request: Mapping[str, Any], flight: Flight) -> None:
    """Raise InputError with the key if a flight differs from a problem's request.

    Keys that the problem does not specify are not compared. A step may use less than the requested
    range of tensions. For several teams, the request maps their names to their requests. ``others``
    maps the names of external plans to their start times ``at`` [s] and, if specified, their paths
    ``plan``.
    """
    teams = {key: value for key, value in request.items() if key != "others"}
    if "others" in request:
        others = dict[str, dict[str, Any]]()
        for each in flight.others:
            name = each.name.partition(".")[0]
            facts = {"plan": each.plan, "at": float(each.motion.drones.breaks[0])}
            keys = request["others"].get(name, facts)
            others[name] = {key: fact for key, fact in facts.items() if key in keys}
        check_same("request.others", request["others"], others, "as requested")
    if len(flight.teams) == 1:
        _check_team(teams, flight.teams[0].motion)
        return
    names = [each.name for each in flight.teams]
    if teams.keys() != set(names):
        raise InputError("request", names, f"the teams {sorted(teams)}", REMEDY)
    for each in flight.teams:
        try:
            _check_team(teams[each.name], each.motion)
        except InputError as error:
            raise error.within(each.name) from error


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
    wanted, chords = (np.asarray(each["legs"], dtype=np.float64) for each in (given, actual))
    if wanted.shape != chords.shape:
        return {}
    share = GRAVITY * motion.team.cable_density / motion.team.tension
    allowed = 2.0 * share**2 * wanted**3 / 24.0 + POSITION_TOLERANCE
    return {"legs": given["legs"]} if np.all(np.abs(wanted - chords) <= allowed) else {}


def _visited(places: Array, wanted: Sequence[Sequence[float]]) -> list[Array]:
    """Return those of places (k, 3) that are nearest to the wanted ones (m, 3), in their order."""
    visited, first = list[Array](), 0
    for place in wanted:
        distances = np.linalg.norm(places[first:] - np.asarray(place), axis=1)
        near = distances <= POSITION_TOLERANCE
        first += int(np.argmax(near)) if np.any(near) else int(np.argmin(distances))
        visited.append(places[first])
    return visited


def _check_team(request: Mapping[str, Any], motion: Motion) -> None:
    """Raise InputError with the key if one team's motion differs from its request."""
    actual = request_of(motion)
    results, steps = actual.pop("mission"), request["mission"]
    start = {
        key: _with_keys_of(given, actual["start"].get(key), motion)
        for key, given in request["start"].items()
    }
    team_request = {key: value for key, value in request.items() if key != "mission"}
    check_same("request", team_request, actual | {"start": start}, "as requested", SLACK)
    if len(steps) != len(results):
        bound = f"{len(steps)} as requested"
        raise InputError("request.mission", f"{len(results)} steps", bound, REMEDY)
    breaks, vertices = motion.vertices.breaks, motion.vertices.coefficients
    middles = 0.5 * (breaks[:-1] + breaks[1:])

    def is_settling(phase: Phase) -> bool:
        """Return whether a phase is a step's end, or a step, in which no vertex moves."""
        points = vertices[(middles > phase.start) & (middles < phase.end)]
        return phase.name == SETTLE and not np.any(np.ptp(points, axis=(0, -1)) > JOINT)

    def rests(phases: Sequence[Phase]) -> Array:
        """Return the poses (k, o, 5) at the ends of a step's pieces."""
        on = (middles > phases[0].start) & (middles < phases[-1].end)
        ends: Array = motion.poses.coefficients[on][..., -1]
        return ends

    names = [*motion.requirements.objects]
    pairs = zip(_steps(motion), steps, results, strict=True)
    for i, (phases, requested, result) in enumerate(pairs):
        flown = [phase for phase in phases if phase.name != WAIT]
        before_settling = [phase for phase in flown if not is_settling(phase)] or flown
        result["seconds"] = sum(phase.end - phase.start for phase in before_settling)
        low, high = requested.get("tension") or (0.0, 0.0)
        used = result.get("tension")
        if used is None or (low - TENSION_SLACK <= used[0] and used[1] <= high + TENSION_SLACK):
            result["tension"] = requested.get("tension")
        if (route := requested.get("route")) is not None:
            places = rests(phases)[:, names.index(route["object"]), :3]
            highest = float(np.max(places[:, 2]))
            result["route"] = {**route, "highest": highest, "via": _visited(places, route["via"])}
        compared = {key: result.get(key) for key in requested}
        compared |= _unsagged(requested, compared, motion)
        check_same(f"request.mission[{i}]", requested, compared, "as requested", SLACK)
