"""What a plan was asked, robot by robot, and where a plan differs from that.

Plan files store it beside the polynomials, so that whoever reads one can tell that its team, its
requirements and the roles of its robots are those that were asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.values import Array

TOLERANCE = 1e-9
"""Relative difference of numbers that are the same, but for turning angles into degrees."""

AT_START = 1e-6
"""[m] A plan begins this close to where it was asked to."""

REMEDY = "do not edit plan files"


def asked_of(motion: Motion) -> dict[str, Any]:
    """Return what a motion was asked, in the keys of problem files, with all defaults filled in.

    Values of robots are in the order of the start's robots, which ``assignment`` gives roles.
    """
    team, first = motion.team, motion.drones.coefficients[0, ..., 0]
    if not team.has_cables:
        start: dict[str, Any] = {"drones": first.tolist()}
        return asked(team, motion.requirements, start)
    given = motion.assignment or Assignment.fixed(team.robots)
    role_of = np.argsort(given.robots)
    flipped = np.array(given.flipped, dtype=np.bool_)[:, None, None]
    pairs = first.reshape(-1, 2, 3)
    pairs = np.where(flipped, pairs[:, ::-1], pairs)[role_of]
    start = {"drones": {"q": pairs[:, 0].tolist(), "r": pairs[:, 1].tolist()}}
    if motion.formed[0]:
        vertices = motion.vertices.coefficients[0, ..., 0]
        start["hitch"] = hitch_start(vertices[:, :2], float(np.mean(vertices[:, 2])))
    back = Assignment(tuple(role_of.tolist()), (False,) * team.robots)
    return asked(back.team(team), motion.requirements, start, objects_at_first(motion))


def asked(
    team: Team,
    requirements: Requirements,
    start: Mapping[str, Any],
    objects: Mapping[str, SolidObject] | None = None,
) -> dict[str, Any]:
    """Return a team, requirements and a start as plan files store them.

    Parameters
    ----------
    team: its robots in the order of the start.
    start: of the keys ``hitch`` and ``drones``, or the one that is known.
    objects: by name; None for those of the requirements.
    """
    kinds = [dict(vars(kind)) for kind in team.quadrotor]
    values: dict[str, Any] = {"drones": team.drones, "quadrotor": kinds}
    if team.has_cables:
        values = {**vars(team), "quadrotor": kinds}
    limits = dict(vars(requirements.limits))
    for name in ("tilt", "body_rate"):
        angle = limits.pop(name)
        limits[f"{name}_deg"] = None if angle is None else math.degrees(angle)
    arena = requirements.arena
    return {
        "start": dict(start),  # compared first: roles tell the order of all else
        "team": {name: _plain(value) for name, value in values.items()},
        "limits": limits,
        "separation": dict(vars(requirements.separation)),
        "arena": None if arena is None else {k: _plain(v) for k, v in vars(arena).items()},
        "keep_out": [_plain(prism) for prism in requirements.keep_out],
        "objects": {
            name: _plain(each)
            for name, each in (requirements.objects if objects is None else objects).items()
        },
    }


def hitch_start(polygon: Array, altitude: float) -> dict[str, Any]:
    """Return the start of a hitch with a polygon (points, 2) [m] at an altitude [m]."""
    return {"polygon": polygon.tolist(), "altitude": altitude}


def objects_at_first(motion: Motion) -> dict[str, SolidObject]:
    """Return objects where they are as the motion begins."""
    poses = motion.object_poses.coefficients[0, ..., 0]
    return {
        name: each
        if np.max(np.abs(pose - each.pose)) <= STILL
        else replace(each, at=pose[:3], yaw=math.atan2(pose[4], pose[3]))
        for pose, (name, each) in zip(poses, motion.requirements.objects.items(), strict=True)
    }


def check_asked(wanted: Any, motion: Motion, *, whole: bool = True) -> None:
    """Raise InputError, by its key, where a motion differs from what it was asked.

    Parameters
    ----------
    wanted: as ``asked_of`` returns it.
    whole: whether all of that has to be there; else what is missing is not compared.
    """
    found = asked_of(motion)
    try:
        _compare("asked", wanted, found, whole)
    except InputError as error:
        if error.key.startswith("asked.start.drones") and _same_places(wanted, found):
            drones, others = wanted["start"]["drones"], found["start"]["drones"]
            key, bound = "assignment", "the robots that start where these roles do"
            if isinstance(drones, dict):
                pairs = zip(drones["q"], drones["r"], others["q"], others["r"], strict=True)
                own = all(_near(q, x) or _near(q, y) for q, _, x, y in pairs)
                key = "assignment.flipped" if own else "assignment.robots"
            given = None if motion.assignment is None else motion.assignment.to_dict()
            raise InputError(key, given, bound, REMEDY) from None
        raise


def _compare(key: str, wanted: Any, found: Any, whole: bool) -> None:
    """Raise InputError where ``found`` is not ``wanted``, by the key in the file."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        other = wanted.keys() - found.keys()
        if whole or key == "asked.objects":
            other |= found.keys() - wanted.keys()
        if other:
            raise InputError(f"{key}.{min(other)}", "present", "what the plan has", REMEDY)
        for name, value in wanted.items():
            _compare(f"{key}.{name}", value, found[name], whole)
    elif isinstance(found, list) and isinstance(wanted, list) and len(found) == len(wanted):
        for i, (one, each) in enumerate(zip(wanted, found, strict=True)):
            _compare(f"{key}[{i}]", one, each, whole)
    elif not _same(wanted, found, AT_START if key.startswith("asked.start") else 0.0):
        raise InputError(key, found, f"{wanted!r} as asked", REMEDY)


def _same_places(wanted: Any, found: Any) -> bool:
    """Return whether drones start at the same places, though other ones at each."""
    places = []
    for each in (wanted, found):
        drones = each["start"]["drones"]
        rows = [*drones["q"], *drones["r"]] if isinstance(drones, dict) else drones or []
        if not all(isinstance(x, float | int) for row in rows for x in row):
            return False
        places.append(sorted([round(x, 5) for x in row] for row in rows))
    return bool(places[0] == places[1])


def _near(one: list[float], other: list[float]) -> bool:
    """Return whether two places are the same."""
    return bool(np.max(np.abs(np.subtract(one, other))) <= AT_START)


def _same(wanted: Any, found: Any, slack: float) -> bool:
    """Return whether single values are the same; numbers within TOLERANCE and ``slack``."""
    numbers = (int, float)
    if isinstance(wanted, bool) or isinstance(found, bool):
        return wanted is found
    if isinstance(wanted, numbers) and isinstance(found, numbers):
        return abs(wanted - found) <= slack + TOLERANCE * max(abs(wanted), abs(found))
    return bool(wanted == found)


def _plain(value: Any) -> Any:
    """Return a value as JSON takes it: records as mappings, arrays as lists."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if hasattr(value, "vertices"):  # an outline
        return value.vertices.tolist()
    if hasattr(value, "__dict__"):
        return {name: _plain(each) for name, each in vars(value).items()}
    return value
