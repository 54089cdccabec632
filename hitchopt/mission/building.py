"""The models of a problem file to the records that planners take, every fault of them named."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexArc, ConvexPolygon, Outline
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.faults import Collector
from hitchopt.mission.form_records import Form, Land, Release
from hitchopt.mission.leg_sharing import LegSharing, leg_sharing
from hitchopt.mission.problem import DronesStart, HitchStart, Problem, Start
from hitchopt.mission.schema import (
    MotionLimitsKeys,
    QuadrotorKeys,
    StartKeys,
    TeamKeys,
)
from hitchopt.mission.step_records import (
    Adjust,
    FollowVertex,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    Step,
    Transport,
)
from hitchopt.mission.steps import (
    AdjustKeys,
    FollowVertexKeys,
    FormKeys,
    HoldKeys,
    MorphKeys,
    MoveEdgeKeys,
    MoveVertexKeys,
    PlainKeys,
    ProblemKeys,
    StepKeys,
    TransportKeys,
)
from hitchopt.planners.forming.swap_settings import SwapSettings
from hitchopt.requirements import Arena, Limits, Separation

StepOfKeys = (
    MorphKeys
    | MoveVertexKeys
    | MoveEdgeKeys
    | AdjustKeys
    | FollowVertexKeys
    | TransportKeys
    | HoldKeys
    | FormKeys
    | PlainKeys
)
"""Their models."""


def built_problem(keys: ProblemKeys) -> Problem:
    """Return the problem that ``keys`` describe.

    Raises
    ------
    InputError: what single values do not tell, such as counts and shapes; a joint error if several.
    """
    faults = Collector()
    attempt = faults.attempt
    title = attempt("", lambda: checked_title(keys.title))
    team = attempt("team", lambda: _team(keys.team))
    limits = attempt("limits", lambda: built_limits(keys.limits))
    separation = attempt("separation", lambda: Separation(**keys.separation.model_dump()))
    box = keys.arena
    arena = attempt("arena", lambda: Arena(box.lower, box.upper)) if box is not None else None
    start = _start(keys.start, keys.team, team, faults)
    steps = [_step(i, step, keys.team, team, faults) for i, step in enumerate(keys.mission)]
    mission = tuple(step for step in steps if step is not None)
    error = faults.error()
    if error is not None:
        raise error
    if title is None or team is None or limits is None or separation is None or start is None:
        raise RuntimeError("a part of the problem is missing although nothing was refused")
    return Problem(team, start, mission, limits, separation, arena, title)


def checked_title(title: str) -> str:
    """Return the title, or raise InputError where a terminal would obey it."""
    if not title.isprintable():  # a terminal would obey its control characters
        raise InputError("title", title, "printable text on one line", "remove such characters")
    return title


def _team(keys: TeamKeys) -> Team:
    return Team(
        keys.robots,
        keys.cable_length,
        topology=keys.topology,
        cable_density=keys.cable_density,
        cable_friction=keys.cable_friction,
        tension=keys.tension,
        quadrotor=built_quadrotors(keys.quadrotor),
    )


def built_quadrotors(
    keys: QuadrotorKeys | list[QuadrotorKeys],
) -> Quadrotor | list[Quadrotor]:
    """Return the one kind, or the list of kinds, that ``keys`` describe."""
    if isinstance(keys, list):
        return [Quadrotor(kind.mass, kind.max_thrust) for kind in keys]
    return Quadrotor(keys.mass, keys.max_thrust)


def built_limits(keys: MotionLimitsKeys) -> Limits:
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
    i: int, keys: StepKeys, team_keys: TeamKeys, team: Team | None, faults: Collector
) -> Step | None:
    ((name, step),) = ((name, step) for name, step in keys if step is not None)
    path = f"mission[{i}].{name}"
    polygon = getattr(step, "polygon", None)
    given = getattr(step, "legs", None)
    outline = _outline(path, polygon, team_keys, team, faults) if polygon is not None else None
    legs = _legs(path, given, team, faults) if given is not None else None
    for key, count in (("vertex", _vertices(team_keys)), ("edge", team_keys.robots)):
        index = getattr(step, key, None)
        if index is not None and index >= count:
            faults.inputs.append(
                InputError(f"{path}.{key}", index, f"from 0 to {count - 1}", "indices start at 0")
            )
    if (given is not None and legs is None) or (polygon is not None and outline is None):
        return None
    return faults.attempt(path, lambda: _record(name, step, outline, legs))


def _record(
    name: str, step: StepOfKeys, outline: Outline | None, legs: LegSharing | None
) -> Step | None:
    """Return the record of a step; None where a part of it has been refused already."""
    if isinstance(step, PlainKeys):
        return Release(step.duration) if name == Release.name else Land(step.duration)
    if isinstance(step, FormKeys | MorphKeys):
        return None if outline is None else _with_polygon(step, outline, legs)
    if isinstance(step, HoldKeys):
        return Hold(step.seconds)
    if isinstance(step, AdjustKeys):
        return Adjust(legs, step.duration, step.blend) if legs is not None else None
    return _move(step, legs)


def _with_polygon(
    step: FormKeys | MorphKeys, outline: Outline, legs: LegSharing | None
) -> Form | Morph:
    if isinstance(step, MorphKeys):
        tension = None if step.tension is None else (step.tension.min, step.tension.max)
        return Morph(outline, legs, step.duration, step.blend, step.optimize, tension)
    swap = step.swap
    tilt = None if swap.tilt_deg is None else math.radians(swap.tilt_deg)
    sense = {"up": 1, "down": -1, "auto": 0}[swap.sense]
    settings = SwapSettings(swap.radius, tilt, swap.seconds, sense)
    return Form(outline, step.altitude, legs, step.assign, settings, step.duration)


def _move(
    step: MoveVertexKeys | MoveEdgeKeys | FollowVertexKeys | TransportKeys, legs: LegSharing | None
) -> Step:
    if isinstance(step, TransportKeys):
        return Transport(np.array(step.to), math.radians(step.yaw_deg), step.duration)
    if isinstance(step, FollowVertexKeys):
        return FollowVertex(step.vertex, np.array(step.path), legs)
    to, by = (None if value is None else np.array(value) for value in (step.to, step.by))
    if isinstance(step, MoveEdgeKeys):
        return MoveEdge(step.edge, to, by, legs, step.duration, step.blend)
    return MoveVertex(step.vertex, to, by, legs, step.duration, step.blend)


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
    path: str, legs: str | list[float], team: Team | None, faults: Collector
) -> LegSharing | None:
    if team is None:
        return None
    if isinstance(legs, list) and len(legs) != team.robots:
        _refuse_count(f"{path}.legs", legs, f"{team.robots} q-legs", faults)
        return None
    return faults.attempt(path, lambda: leg_sharing(legs, team))


def _vertices(keys: TeamKeys) -> int:
    return keys.robots + (keys.topology == "open")


def _check_count(path: str, count: int, expected: int, faults: Collector) -> bool:
    """Return whether a count is the expected one; the fault is kept if not."""
    if count != expected:
        _refuse_count(path, f"{count} points", f"{expected} points", faults)
    return count == expected


def _refuse_count(path: str, value: object, expected: str, faults: Collector) -> None:
    remedy = "add or remove entries, or change team.robots"
    faults.inputs.append(InputError(path, value, f"a list of {expected}", remedy))
