"""A problem with one thing of it changed, and what to write into its file for that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry import Outline
from hitchopt.hitch import Quadrotor
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.form_records import Form, Land, Release
from hitchopt.mission.problem import DronesStart, HitchStart, Problem
from hitchopt.mission.repair.change import Edit, Edited
from hitchopt.mission.step_records import (
    FollowVertex,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    Step,
    Transport,
)
from hitchopt.requirements import Arena

Array = NDArray[np.float64]

DECIMALS = 9
"""Of numbers in edits: far below any tolerance, and short enough to read."""


def with_cables(problem: Problem, lengths: Array) -> Edited:
    """Return the problem with cables (n,) [m]."""
    values = [_rounded(length) for length in lengths]
    team = replace(problem.team, cable_length=np.array(values))
    return Edited(replace(problem, team=team), (Edit("team.cable_length", _one_or_all(values)),))


def with_tensions(problem: Problem, tensions: Array) -> Edited:
    """Return the problem with tensions (n,) [N]."""
    values = [_rounded(tension) for tension in tensions]
    team = replace(problem.team, tension=np.array(values))
    return Edited(replace(problem, team=team), (Edit("team.tension", _one_or_all(values)),))


def with_thrust(problem: Problem, factor: float) -> Edited:
    """Return the problem with every largest thrust times ``factor``."""
    kinds = [
        Quadrotor(kind.mass, _rounded(kind.max_thrust * factor)) for kind in problem.team.quadrotor
    ]
    team = replace(problem.team, quadrotor=tuple(kinds))
    values = [{"mass": kind.mass, "max_thrust": kind.max_thrust} for kind in kinds]
    return Edited(replace(problem, team=team), (Edit("team.quadrotor", _one_or_all(values)),))


def with_limit(problem: Problem, name: str, value: float) -> Edited:
    """Return the problem with another of its limits, named as in the file, in its unit."""
    if name == "tilt_deg":
        limits = replace(problem.limits, tilt=math.radians(value))
    else:
        limits = replace(problem.limits, **{name: value})
    return Edited(replace(problem, limits=limits), (Edit(f"limits.{name}", value),))


def with_separation(problem: Problem, name: str, value: float) -> Edited:
    """Return the problem with another distance to keep [m]."""
    separation = replace(problem.separation, **{name: value})
    return Edited(replace(problem, separation=separation), (Edit(f"separation.{name}", value),))


def with_arena(problem: Problem, lower: Array, upper: Array) -> Edited:
    """Return the problem in another box, its corners (3,) [m]."""
    arena = Arena(lower, upper)
    value = {"lower": arena.lower.tolist(), "upper": arena.upper.tolist()}
    return Edited(replace(problem, arena=arena), (Edit("arena", value),))


def with_spread_start(problem: Problem, start: HitchStart) -> Edited:
    """Return the problem whose start, a hitch, has its legs spread."""
    return Edited(
        replace(problem, start=replace(start, legs="spread")), (Edit("start.hitch.legs", "spread"),)
    )


def with_spread_legs(problem: Problem, i: int) -> Edited:
    """Return the problem whose step i ends with its legs spread."""
    step = problem.mission[i]
    if isinstance(step, Hold | Transport | Release | Land):
        return Edited(problem, ())  # they keep their legs
    return _with_step(problem, i, replace(step, legs="spread"), "legs", "spread")


def with_radius(problem: Problem, i: int, step: Form, radius: float) -> Edited:
    """Return the problem whose step i forms with a smaller swap [m]."""
    changed = replace(step, swap=replace(step.swap, radius=radius))
    return _with_step(problem, i, changed, "swap.radius", radius)


def with_robots_apart(problem: Problem, start: DronesStart, factor: float) -> Edited:
    """Return the problem whose robots start farther from their middle, each as wide as it was."""
    middles = 0.5 * (start.q + start.r)[:, :2]
    moved = _about(middles, factor, np.mean(middles, axis=0)) - middles
    return _starting(problem, start, moved, moved)


def with_robots_drawn(problem: Problem, start: DronesStart, factor: float) -> Edited:
    """Return the problem whose robots' two drones start closer together, about their middles."""
    arms = 0.5 * (factor - 1.0) * (start.r - start.q)[:, :2]
    return _starting(problem, start, -arms, arms)


def _starting(problem: Problem, start: DronesStart, q: Array, r: Array) -> Edited:
    """Return the problem with the start's drones moved by q and r (n, 2) [m]."""
    places = {}
    for name, offset in (("q", q), ("r", r)):
        places[name] = getattr(start, name).copy()
        places[name][:, :2] = np.round(places[name][:, :2] + offset, DECIMALS)
    edits = tuple(Edit(f"start.drones.{name}", places[name].tolist()) for name in places)
    return Edited(replace(problem, start=DronesStart(**places)), edits)


def with_seconds(problem: Problem, i: int, seconds: float) -> Edited:
    """Return the problem whose step i, one that has a duration, takes ``seconds`` [s]."""
    step = problem.mission[i]
    if isinstance(step, FollowVertex):
        return Edited(problem, ())  # its points have times of their own
    if isinstance(step, Hold):
        return _with_step(problem, i, Hold(seconds), "seconds", seconds)
    return _with_step(problem, i, replace(step, duration=seconds), "duration", seconds)


def with_times(problem: Problem, i: int, step: FollowVertex, factor: float) -> Edited:
    """Return the problem whose step i has its points' times multiplied."""
    path = step.path.copy()
    path[:, 0] = [_rounded(t) for t in path[:, 0] * factor]
    return _with_step(problem, i, replace(step, path=path), "path", path.tolist())


def with_outlines_scaled(problem: Problem, factor: float) -> Edited:
    """Return the problem with the start's outline and those of all steps scaled.

    Each about its own centroid; points that vertices are moved to go with the outline they are of.
    """
    team, start = problem.team, problem.start
    centre = np.zeros(2)
    edits: list[Edit] = []
    if isinstance(start, HitchStart):
        outline = fitting_polygon(team, start.polygon)
        centre = outline.centroid
        start = replace(start, polygon=_scaled(outline, factor, centre))
        edits.append(Edit("start.hitch.polygon", start.polygon.vertices.tolist()))
    steps: list[Step] = []
    for i, step in enumerate(problem.mission):
        key, value = "", np.empty(0)
        scaled: Step = step
        if isinstance(step, Morph | Form):
            goal = fitting_polygon(team, step.polygon)
            centre = goal.centroid
            polygon = _scaled(goal, factor, centre)
            key, value, scaled = "polygon", polygon.vertices, replace(step, polygon=polygon)
        elif isinstance(step, MoveVertex | MoveEdge):
            if step.to is not None:
                key, value = "to", _about(step.to, factor, centre)
                scaled = replace(step, to=value)
            else:
                key, value = "by", _about(np.asarray(step.by), factor, np.zeros(2))
                scaled = replace(step, by=value)
        elif isinstance(step, FollowVertex):
            points = _about(step.path[:, 1:], factor, centre)
            key, value = "path", np.column_stack([step.path[:, 0], points])
            scaled = replace(step, path=value)
        elif isinstance(step, Transport):
            centre = step.to[:2]
        if key:
            edits.append(Edit(f"mission[{i}].{step.name}.{key}", value.tolist()))
        steps.append(scaled)
    changed = replace(problem, start=start, mission=tuple(steps))
    return Edited(changed, tuple(edits))


def seconds_of(step: Step) -> tuple[str, float] | None:
    """Return key and value [s] of the duration that a step was given; None where it was not."""
    if isinstance(step, Hold):
        return "seconds", step.seconds
    if isinstance(step, FollowVertex) or step.duration is None:
        return None
    return "duration", step.duration


def _with_step(problem: Problem, i: int, step: Step, key: str, value: object) -> Edited:
    mission = (*problem.mission[:i], step, *problem.mission[i + 1 :])
    edit = Edit(f"mission[{i}].{step.name}.{key}", value)
    return Edited(replace(problem, mission=mission), (edit,))


def _scaled(outline: Outline, factor: float, centre: Array) -> Outline:
    return type(outline)(_about(outline.vertices, factor, centre))


def _about(points: Array, factor: float, centre: Array) -> Array:
    """Return the points (…, 2) [m] moved away from ``centre`` by a factor."""
    scaled: Array = np.round(centre + factor * (points - centre), DECIMALS)
    return scaled


def _one_or_all(values: Sequence[object]) -> object:
    """Return the value that all have, as files may write it, or the list of them."""
    return values[0] if all(value == values[0] for value in values) else list(values)


def _rounded(value: float) -> float:
    """Return ``value`` as a file is to show it: a product's last digits tell nothing."""
    return round(float(value), DECIMALS)
