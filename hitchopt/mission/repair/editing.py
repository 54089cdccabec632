"""A problem with one thing of it changed, and what to write into its file for that."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.hitch import Quadrotor
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.problem import DronesStart, HitchStart, Problem
from hitchopt.mission.repair.change import Edit, Edited
from hitchopt.requirements import Arena
from hitchopt.steps import Step
from hitchopt.steps.edits import DECIMALS, StepEdit, outline_scaled, points_scaled
from hitchopt.values import Array


def team_values(problem: Problem, name: str) -> Array:
    """Return cable lengths [m], tensions [N], largest thrusts [N] or loads [kg], (n,) or clasps."""
    if name == "max_thrust":
        return np.array([kind.max_thrust for kind in problem.team.quadrotor])
    values: Array = getattr(problem.team, name)
    return values


def with_team_values(problem: Problem, name: str, values: Array) -> Edited:
    """Return the problem with other ``team_values``."""
    rounded: list[Any] = [round(float(value), DECIMALS) for value in values]
    changed: dict[str, Any] = {name: np.array(rounded)}
    if name == "max_thrust":
        pairs = zip(problem.team.quadrotor, rounded, strict=True)
        kinds = tuple(replace(kind, max_thrust=value) for kind, value in pairs)
        name, changed, rounded = "quadrotor", {"quadrotor": kinds}, list(map(_as_written, kinds))
    team = replace(problem.team, **changed)
    same = all(value == rounded[0] for value in rounded)
    edit = Edit(f"team.{name}", rounded[0] if same else rounded)
    return Edited(replace(problem, team=team), (edit,))


def _as_written(kind: Quadrotor) -> dict[str, float | bool | None]:
    """Return what a file says of a kind: mass, thrust, and whatever else is not its default."""
    return {
        name: value
        for name, value in vars(kind).items()
        if name in ("mass", "max_thrust") or value != getattr(Quadrotor, name)
    }


def with_bound(problem: Problem, key: str, value: float) -> Edited:
    """Return the problem with another limit or distance to keep; key and unit are the file's."""
    section, name = key.split(".")
    angle = name.removesuffix("_deg")
    changed = {name: value} if angle == name else {angle: math.radians(value)}
    part: Any = replace(getattr(problem, section), **changed)
    return Edited(replace(problem, **{section: part}), (Edit(key, value),))


def with_mass(problem: Problem, name: str, value: float) -> Edited:
    """Return the problem with an object of another mass [kg]."""
    return _with_object(problem, name, "mass", value)


def with_friction(problem: Problem, name: str, value: float) -> Edited:
    """Return the problem with an object of another friction."""
    return _with_object(problem, name, "friction", value)


def _with_object(problem: Problem, name: str, key: str, value: float) -> Edited:
    changed: dict[str, Any] = {key: value}
    objects = {**problem.objects, name: replace(problem.objects[name], **changed)}
    return Edited(replace(problem, objects=objects), (Edit(f"objects.{name}.{key}", value),))


def with_arena(problem: Problem, arena: Arena) -> Edited:
    """Return the problem in another box."""
    value = {"lower": arena.lower.tolist(), "upper": arena.upper.tolist()}
    return Edited(replace(problem, arena=arena), (Edit("arena", value),))


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
