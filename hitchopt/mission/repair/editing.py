"""A problem with one thing of it changed, and what to write into its file for that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Quadrotor
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.problem import DronesStart, HitchStart, Problem
from hitchopt.mission.repair.change import Edit, Edited
from hitchopt.requirements import Arena
from hitchopt.steps import Step
from hitchopt.steps.edits import DECIMALS, StepEdit, outline_scaled, points_scaled

Array = NDArray[np.float64]


def with_team_values(problem: Problem, name: str, values: Array) -> Edited:
    """Return the problem with other cable lengths [m] or tensions [N] of the robots (n,)."""
    rounded = [_rounded(value) for value in values]
    changes: dict[str, Any] = {name: np.array(rounded)}
    team = replace(problem.team, **changes)
    return Edited(replace(problem, team=team), (Edit(f"team.{name}", _one_or_all(rounded)),))


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
    angle = name.removesuffix("_deg")
    changes = {name: value} if angle == name else {angle: math.radians(value)}
    limits = replace(problem.limits, **changes)
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
    """Return the problem whose step i, one that has legs, ends with its legs spread."""
    return with_step_edit(problem, i, StepEdit("legs", "spread", {"legs": "spread"}))


def with_step_edit(problem: Problem, i: int, edit: StepEdit) -> Edited:
    """Return the problem with another value in step i."""
    step, edits = _edited_step(problem, i, edit)
    mission = (*problem.mission[:i], step, *problem.mission[i + 1 :])
    return Edited(replace(problem, mission=mission), edits)


def _edited_step(problem: Problem, i: int, edit: StepEdit | None) -> tuple[Step, tuple[Edit, ...]]:
    """Return step i with an edit, and what to write into the problem's file for it."""
    step = problem.mission[i]
    if edit is None:
        return step, ()
    key = f"mission[{i}].{step.name}.{edit.key}"
    return replace(step, **edit.changes), (Edit(key, edit.value),)


def with_robots_apart(problem: Problem, start: DronesStart, factor: float) -> Edited:
    """Return the problem whose robots start farther from their middle, each as wide as it was."""
    middles = 0.5 * (start.q + start.r)[:, :2]
    moved = points_scaled(middles, factor, np.mean(middles, axis=0)) - middles
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
        start = replace(start, polygon=outline_scaled(outline, factor))
        edits.append(Edit("start.hitch.polygon", start.polygon.vertices.tolist()))
    steps: list[Step] = []
    for i, step in enumerate(problem.mission):
        edit, centre = step.scaled(factor, centre)
        scaled, written = _edited_step(problem, i, edit)
        steps.append(scaled)
        edits += written
    return Edited(replace(problem, start=start, mission=tuple(steps)), tuple(edits))


def _one_or_all(values: Sequence[object]) -> object:
    """Return the value that all have, as files may write it, or the list of them."""
    return values[0] if all(value == values[0] for value in values) else list(values)


def _rounded(value: float) -> float:
    """Return ``value`` as a file is to show it: a product's last digits tell nothing."""
    return round(float(value), DECIMALS)
