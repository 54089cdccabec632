"""What a plan was asked, robot by robot, and where a plan differs from that.

Plan files store it beside the polynomials, so that whoever reads one can tell that its team, its
requirements and the roles of its robots are those that were asked for.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
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
        return asked(team, motion.requirements, {"drones": first.tolist()})
    given = motion.assignment or Assignment.fixed(team.robots)
    role_of = np.argsort(given.robots)
    flipped = np.array(given.flipped, dtype=np.bool_)[:, None, None]
    pairs = first.reshape(-1, 2, 3)
    pairs = np.where(flipped, pairs[:, ::-1], pairs)[role_of]
    start: dict[str, Any] = {"drones": {"q": pairs[:, 0].tolist(), "r": pairs[:, 1].tolist()}}
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

    Robots are in the order of the start, of which ``hitch``, ``drones`` or both are known. Objects
    are those of the requirements but where they are given, by name.
    """
    own = vars(team) if team.has_cables else {"drones": team.drones, "quadrotor": team.quadrotor}
    limits = dict(vars(requirements.limits))
    for name in ("tilt", "body_rate"):
        angle = limits.pop(name)
        limits[f"{name}_deg"] = None if angle is None else math.degrees(angle)
    values = {
        "start": start,  # compared first: roles tell the order of all else
        "team": own,
        "limits": limits,
        "separation": requirements.separation,
        "arena": requirements.arena,
        "keep_out": requirements.keep_out,
        "objects": requirements.objects if objects is None else objects,
    }
    plain: dict[str, Any] = json.loads(json.dumps(values, default=values_of))
    return plain


def values_of(record: Any) -> Any:
    """Return a record's fields, an outline's points, or an array's entries, as json takes them."""
    if isinstance(record, ConvexPolygon):
        return record.vertices.tolist()
    return record.tolist() if isinstance(record, np.ndarray) else vars(record)


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
    plan = asked_of(motion)
    there, here = (dict(_leaves("asked", each)) for each in (wanted, plan))
    missing = [key for key in here if whole or key.startswith("asked.objects.")]
    for key in [*there, *missing]:
        slack = AT_START if key.startswith("asked.start") else 0.0
        if key in there and key in here and _same(there[key], here[key], slack):
            continue
        role = _exchanged(wanted, plan) if key.startswith("asked.start.drones") else None
        if role is not None:
            given = None if motion.assignment is None else motion.assignment.to_dict()
            raise InputError(role, given, "the robots that start where these roles do", REMEDY)
        bound = f"{there[key]!r} as asked" if key in there else "left out as asked"
        raise InputError(key, here.get(key, "left out"), bound, REMEDY)


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield single values, and what is empty, by their keys in the file."""
    if isinstance(value, dict) and value:
        for name, each in value.items():
            yield from _leaves(f"{key}.{name}", each)
    elif isinstance(value, list) and value:
        for i, each in enumerate(value):
            yield from _leaves(f"{key}[{i}]", each)
    else:
        yield key, value


def _same(wanted: Any, found: Any, slack: float) -> bool:
    """Return whether single values are the same; numbers within TOLERANCE and ``slack``."""
    if any(isinstance(each, bool) or not isinstance(each, int | float) for each in (wanted, found)):
        return type(wanted) is type(found) and bool(wanted == found)
    return bool(abs(wanted - found) <= slack + TOLERANCE * max(abs(wanted), abs(found)))


def _exchanged(wanted: Any, found: Any) -> str | None:
    """Return the key of the roles by which drones start in each other's places, if they do."""
    drones = [each["start"]["drones"] for each in (wanted, found)]
    try:
        if not isinstance(drones[1], dict):
            one, two = (np.round(np.array(each, dtype=np.float64), 5) for each in drones)
            return "assignment" if sorted(one.tolist()) == sorted(two.tolist()) else None
        pairs = [np.round(np.stack([each["q"], each["r"]], axis=1), 5).tolist() for each in drones]
    except (TypeError, ValueError):
        return None
    if sorted(chain(*pairs[0])) != sorted(chain(*pairs[1])):
        return None
    own = all(sorted(one) == sorted(two) for one, two in zip(*pairs, strict=True))
    return "assignment.flipped" if own else "assignment.robots"
