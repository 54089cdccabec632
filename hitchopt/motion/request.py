"""Compare a motion with what was requested: team, requirements, start and results of steps.

Problems state the request, motions imply it, and both are compared with the keys of problem files.
Robots are in the order of the start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import groupby
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import JOINT, SETTLE, WAIT, Motion, Phase
from hitchopt.motion.records import PLANNER_ONLY, REMEDY, check_same, encoded
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT

POSITION_TOLERANCE = 1e-6
"""[m] Largest difference of a plan's start, and of the ends of its steps, from the request."""

SLACK = {"request.start": POSITION_TOLERANCE, "request.mission": POSITION_TOLERANCE}

TENSION_SLACK = 1e-4
"""[N] Largest excess over a range of tensions, as in the check ``tension``."""


def request_of(motion: Motion) -> dict[str, Any]:
    """Return the request that a motion satisfies; ``assignment`` maps its robots to roles."""
    team, first = motion.team, motion.drones.coefficients[0, ..., 0]
    requirements = replace(motion.requirements, objects=objects_at_first(motion))
    start: dict[str, Any] = {"drones": first}
    if team.has_cables:
        assignment = motion.assignment
        if assignment is not None:
            roles = np.argsort(assignment.robots).tolist()
            inverse = Assignment(tuple(roles), tuple(assignment.flipped[role] for role in roles))
            first, team = inverse.drones(first), inverse.team(team)
        start = {"drones": {"q": first[0::2], "r": first[1::2]}}
        if motion.formed[0]:
            points = len(motion.phases[0].ring or motion.team.point_names)
            x, y, z = motion.vertices.coefficients[0, :points, ..., 0].T
            start["hitch"] = {"polygon": np.column_stack([x, y]), "altitude": float(np.mean(z))}
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
        "start": encoded(start),  # compared first: roles determine the order of everything else
        "team": team,
        **{name: getattr(requirements, name) for name in names},
        "mission": encoded(mission),
    }


def objects_at_first(motion: Motion) -> dict[str, SolidObject]:
    """Return objects with their poses at the motion's start."""
    poses = motion.poses.coefficients[0, ..., 0]
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
    """Return the result of every step."""
    breaks, names, results = motion.drones.breaks, motion.requirements.objects, []
    for phases in _steps(motion):
        last = max(int(np.argmin(np.abs(breaks - phases[-1].end))) - 1, 0)
        ranges = [phase.tension for phase in phases if phase.tension is not None]
        holds = [(phase.hold.object, phase.hold.by) for phase in phases if phase.hold is not None]
        ring = phases[-1].ring
        places = motion.vertices.coefficients[last, : None if ring is None else len(ring), ..., -1]
        poses = motion.poses.coefficients[last, ..., -1]
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
    teams = {key: value for key, value in request.items() if key != "others"}
    if "others" in request:
        others = dict[str, dict[str, Any]]()
        for each in motion.others:
            name = each.name.partition(".")[0]
            facts = {"plan": each.plan, "at": float(each.motion.drones.breaks[0])}
            keys = request["others"].get(name, facts)
            others[name] = {key: fact for key, fact in facts.items() if key in keys}
        check_same("request.others", request["others"], others, "as requested")
    if len(motion.groups) == 1:
        _check_team(teams, motion)
        return
    names = [each.name for each in motion.groups]
    if teams.keys() != set(names):
        raise InputError("request", names, f"the teams {sorted(teams)}", REMEDY)
    for each in motion.groups:
        try:
            _check_team(teams[each.name], each.motion)
        except InputError as error:
            raise error.within(each.name) from error


def _moves_vertices(motion: Motion, phase: Phase) -> bool:
    breaks = motion.vertices.breaks
    middles = 0.5 * (breaks[:-1] + breaks[1:])
    points = motion.vertices.coefficients[(middles > phase.start) & (middles < phase.end)]
    return bool(np.any(np.ptp(points, axis=(0, -1)) > JOINT))


def _check_team(request: Mapping[str, Any], motion: Motion) -> None:
    """Raise InputError with the key if one team's motion differs from its request."""
    actual = request_of(motion)
    results, steps = actual.pop("mission"), request["mission"]
    start = {key: actual["start"].get(key) for key in request["start"]}
    team_request = {key: value for key, value in request.items() if key != "mission"}
    check_same("request", team_request, actual | {"start": start}, "as requested", SLACK)
    if len(steps) != len(results):
        bound = f"{len(steps)} as requested"
        raise InputError("request.mission", f"{len(results)} steps", bound, REMEDY)
    pairs = zip(_steps(motion), steps, results, strict=True)
    for i, (phases, requested, result) in enumerate(pairs):
        flown = [each for each in phases if each.name != WAIT]
        # A step's end, or a step; swings move no vertex
        own = [x for x in flown if x.name != SETTLE or _moves_vertices(motion, x)] or flown
        result["seconds"] = sum(each.end - each.start for each in own)
        (low, high), used = requested.get("tension") or (0.0, 0.0), result.get("tension")
        if used is None or (low - TENSION_SLACK <= used[0] and used[1] <= high + TENSION_SLACK):
            result["tension"] = requested.get("tension")
        compared = {key: result.get(key) for key in requested}
        check_same(f"request.mission[{i}]", requested, compared, "as requested", SLACK)
