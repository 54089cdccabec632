"""The records that planners take, built from the models of a problem file; names every fault."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexArc, ConvexPolygon, Outline
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.faults import Collector
from hitchopt.mission.file_models import STEP_KINDS, ProblemKeys
from hitchopt.mission.problem import DronesStart, HitchStart, Problem, Start
from hitchopt.mission.schema import (
    Keys,
    MotionLimitsKeys,
    RolledLegsKeys,
    StartKeys,
    TeamKeys,
)
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.mission.swarm_schema import SwarmKeys, SwarmTeamKeys
from hitchopt.requirements import Arena, Limits, Prism, Separation
from hitchopt.steps import Step
from hitchopt.steps.slack_split import SlackSplit, slack_split
from hitchopt.steps.step import check_within


def built_problem(keys: ProblemKeys) -> Problem:
    """Return the problem of a hitch that ``keys`` describe.

    Raises
    ------
    InputError: what single values do not tell, such as counts and shapes; a joint error if several.
    """
    faults = Collector()
    common = _common_parts(keys, faults)
    team = faults.attempt("team", lambda: Team(**_team_values(keys.team)))
    start = _start(keys.start, keys.team, team, faults)
    steps = [_step(i, step, keys.team, team, faults) for i, step in enumerate(keys.mission)]
    mission = tuple(step for step in steps if step is not None)
    faults.check()
    if team is None or start is None:
        raise RuntimeError("a part of the problem is missing although nothing was refused")
    return Problem(team, start, mission, **common)


def built_swarm(keys: SwarmKeys) -> SwarmProblem:
    """Return the problem of single drones that ``keys`` describe; errors as ``built_problem``."""
    faults = Collector()
    common = _common_parts(keys, faults)
    team = faults.attempt("team", lambda: Swarm(**_team_values(keys.team)))
    prisms = [
        faults.attempt(f"keep_out[{k}]", partial(Prism, **prism.model_dump()))
        for k, prism in enumerate(keys.keep_out)
    ]
    if team is None or not common.keys() >= {"limits", "separation"}:
        faults.check()
        raise RuntimeError("a part of the problem is missing although nothing was refused")
    common |= {"keep_out": [p for p in prisms if p is not None], "duration": keys.duration}
    start, goal = np.array(keys.start), np.array(keys.goal)
    problem = faults.attempt("", lambda: SwarmProblem(team, start, goal, **common))
    faults.check()
    if problem is None:
        raise RuntimeError("no problem although nothing was refused")
    return problem


def _common_parts(keys: ProblemKeys | SwarmKeys, faults: Collector) -> dict[str, Any]:
    """Return the parts that problems of both kinds have, by name, those refused left out."""
    box = keys.arena
    parts = {
        "title": faults.attempt("", lambda: _title(keys.title)),
        "limits": faults.attempt("limits", lambda: _limits(keys.limits)),
        "separation": faults.attempt(
            "separation", lambda: Separation(**keys.separation.model_dump())
        ),
        "arena": box and faults.attempt("arena", lambda: Arena(box.lower, box.upper)),
    }
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
    values["quadrotor"] = Quadrotor(**kinds) if one else [Quadrotor(**kind) for kind in kinds]
    return values


def _limits(keys: MotionLimitsKeys) -> Limits:
    """Return the limits that ``keys`` describe, angles in rad."""
    values = keys.model_dump()
    return Limits(tilt=math.radians(values.pop("tilt_deg")), **values)


def _start(
    keys: StartKeys, team_keys: TeamKeys, team: Team | None, faults: Collector
) -> Start | None:
    if keys.hitch is not None:
        hitch = keys.hitch
        outline = _outline("start.hitch", hitch.polygon, team_keys, team, faults)
        legs = _legs("start.hitch", hitch.legs, team, faults)
        if outline is None or legs is None:
            return None
        return faults.attempt("start.hitch", lambda: HitchStart(outline, hitch.altitude, legs))
    places = keys.drones
    if places is None:
        raise RuntimeError("a start that is neither a hitch nor drones")
    fits = [
        _check_count(f"start.drones.{end}", len(points), team_keys.robots, faults)
        for end, points in (("q", places.q), ("r", places.r))
    ]
    if not all(fits):
        return None
    return faults.attempt(
        "start.drones", lambda: DronesStart(np.array(places.q), np.array(places.r))
    )


def _step(
    i: int, keys: Keys, team_keys: TeamKeys, team: Team | None, faults: Collector
) -> Step | None:
    """Return the record of a step; None where a part of it has been refused."""
    ((name, given),) = ((name, step) for name, step in keys if step is not None)
    path, values = f"mission[{i}].{name}", given.model_dump()
    parts: dict[str, object] = {}
    if values.get("polygon") is not None:
        parts["polygon"] = _outline(path, values["polygon"], team_keys, team, faults)
    if values.get("legs") is not None:
        parts["legs"] = _legs(path, values["legs"], team, faults)
    for key, count in (("vertex", _vertices(team_keys)), ("edge", team_keys.robots)):
        if values.get(key, 0) >= count:
            faults.attempt(path, partial(check_within, key, values[key], count))
    if any(part is None for part in parts.values()):
        return None
    return faults.attempt(path, lambda: STEP_KINDS[name].from_file(values | parts))


def _outline(
    path: str,
    points: list[list[float]],
    team_keys: TeamKeys,
    team: Team | None,
    faults: Collector,
) -> Outline | None:
    kind: type[Outline] = ConvexArc if team_keys.topology == "open" else ConvexPolygon
    outline = faults.attempt(path, lambda: kind(points))
    if outline is None or team is None:
        return outline
    return faults.attempt(path, lambda: fitting_polygon(team, outline))


def _legs(
    path: str, legs: str | list[float] | RolledLegsKeys, team: Team | None, faults: Collector
) -> SlackSplit | None:
    if team is None:
        return None
    if isinstance(legs, list) and len(legs) != team.robots:
        _refuse_count(f"{path}.legs", legs, f"{team.robots} q-legs", faults)
        return None
    given = legs.model_dump() if isinstance(legs, RolledLegsKeys) else legs
    return faults.attempt(path, lambda: slack_split(given, team))


def _vertices(keys: TeamKeys) -> int:
    return keys.robots + (keys.topology == "open")


def _check_count(path: str, count: int, expected: int, faults: Collector) -> bool:
    """Return whether a count is the expected one; a fault is gathered if not."""
    if count != expected:
        _refuse_count(path, f"{count} points", f"{expected} points", faults)
    return count == expected


def _refuse_count(path: str, value: object, expected: str, faults: Collector) -> None:
    remedy = "add or remove entries, or change team.robots"
    faults.inputs.append(InputError(path, value, f"a list of {expected}", remedy))
