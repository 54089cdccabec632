"""Changes other than of one number: units, controllers, rims, legs and single vertices."""

from __future__ import annotations

import contextlib
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.drones.controllers import MIN_TRACKING, Tube
from hitchopt.errors import InputError, Reason, UnitWarning, Violation
from hitchopt.geometry import Outline
from hitchopt.mission.advice import can_be_stiffer, stiffest
from hitchopt.mission.problem import Problem
from hitchopt.mission.starts import HitchStart
from hitchopt.objects import Rim
from hitchopt.planners.ends import RolledLegs
from hitchopt.repairs.changes import Change, in_step, quadrotor_keys, with_edits
from hitchopt.steps.hitch_step import ShapeStep
from hitchopt.steps.knob import DECIMALS, Edit
from hitchopt.values.fields import Key, keys_of, with_fields


def unit_change(problem: Problem) -> Change | None:
    """Return the change of all values that seem to be in another unit; None without any."""
    combined: Change | None = None
    changed = problem
    for place, record in _records(problem):
        for name, declared in keys_of(type(record)).items():
            value = _plain_numbers(declared.to_file(getattr(record, name)))
            key = f"{place}.{declared.name}"
            factor = None if value is None else _unit_factor(declared, key, value)
            if factor is None:
                continue
            converted = np.round(np.multiply(value, factor), DECIMALS).tolist()
            edits = (Edit(key, converted),)
            changed = with_edits(changed, edits)
            is_number = isinstance(value, float)
            old = value if is_number else "as given"
            new = converted if is_number else f"multiplied by {factor:g}"
            unit = declared.file_kind.unit if is_number else ""
            change = Change(key, "", old, new, unit, 0.0, changed, edits)
            combined = change if combined is None else change.after(combined)
    return combined


def _records(problem: Problem) -> Iterator[tuple[str, Any]]:
    """Yield the problem's records with their places in the file."""
    yield "team", problem.team
    if isinstance(problem.start, HitchStart):
        yield "start.hitch", problem.start
    for i, step in enumerate(problem.mission):
        yield f"mission[{i}].{step.name}", step


def _plain_numbers(value: Any) -> Any:
    """Return a number or lists of numbers; None for other values."""
    if isinstance(value, Outline):
        return value.vertices.tolist()
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value if isinstance(value, float) else None


def _unit_factor(declared: Key, key: str, value: Any) -> float | None:
    """Return the factor that converts a value from the unit that was probably meant, if any."""
    with warnings.catch_warnings(record=True) as caught, contextlib.suppress(InputError):
        warnings.simplefilter("always", UnitWarning)
        declared.from_file(key, value)
    factors = [w.message.factor for w in caught if isinstance(w.message, UnitWarning)]
    return factors[0] if factors else None


def retuning_changes(problem: Problem) -> Iterator[Change]:
    """Yield the controllers' error as ``limits.tracking``, and the stiffest gains of a firmware."""
    own = max(MIN_TRACKING, Tube.of(problem.team.tracking).largest)
    if (error := problem.limits.tube.largest) > own:
        edits = (Edit("limits.tracking", own),)
        relative = own / error - 1.0
        changed = with_edits(problem, edits)
        yield Change("limits.tracking", "", error, own, "m", relative, changed, edits)
    kinds = problem.team.quadrotor
    if not can_be_stiffer(kinds):
        return
    values = [quadrotor_keys(stiffest(kind)) for kind in kinds]
    are_equal = all(each == values[0] for each in values)
    edits = (Edit("team.quadrotor", values[0] if are_equal else values),)
    changed = with_edits(problem, edits)
    old = ", ".join(dict.fromkeys(str(kind.controller) for kind in kinds if kind.controller))
    new = f"{values[0].get('controller')} with gains {values[0].get('gains')}".replace("'", "")
    yield Change("team.quadrotor.controller", "", old, new, "", 0.0, changed, edits)


RIM_OVERHANG = 0.03  # [m] Overhang over the body of rims that suggestions try


def rim_changes(problem: Problem, violations: Sequence[Violation]) -> Iterator[Change]:
    """Yield rims at the ceilings of objects for which no grip was found."""
    for name, body in problem.objects.items():
        ungripped = any(v.object == name and v.reason is Reason.NO_GRIP for v in violations)
        if not ungripped:
            continue
        wider = body.section.widened(RIM_OVERHANG)
        radius = math.sqrt(body.section.area / math.pi)
        keys = (
            {"circle": wider.radius}
            if wider.outline is None
            else {"outline": wider.outline.tolist()}
        )
        edits = (Edit(f"objects.{name}.rim", {**keys, "at": body.upper}),)
        with_rim = with_fields(body, rim=Rim(wider, body.upper))
        changed = replace(problem, objects={**problem.objects, name: with_rim})
        new = f"{RIM_OVERHANG:g} m wide at {body.upper:g} m"
        relative = RIM_OVERHANG / radius
        yield Change(edits[0].key, "of the mean radius", "none", new, "", relative, changed, edits)


TRIED_ROLLS = (15, 30)  # [deg] Rolls of legs at an end that suggestions try

VERTEX_SHIFTS = (0.1, 0.25)
"""Shifts of a vertex of a goal outward that suggestions try, over its distance to the centroid."""


def roll_changes(problem: Problem) -> Iterator[Change]:
    """Yield changes to rolled legs at the start, and after steps that change the polygon."""
    records: list[tuple[str, object]] = [
        (f"mission[{i}].{step.name}", step)
        for i, step in enumerate(problem.mission)
        if isinstance(step, ShapeStep)
    ]
    if isinstance(problem.start, HitchStart):
        records.append(("start.hitch", problem.start))
    for roll in TRIED_ROLLS:
        for place, record in records:
            legs: Any = getattr(record, "legs", None)
            if isinstance(legs, RolledLegs) and legs.roll is not None:
                continue
            edits = (Edit(f"{place}.legs", {"sharing": "spread", "roll_deg": roll}),)
            old = legs if isinstance(legs, str) else "as they are"
            new = f"spread with roll_deg: {roll}"
            changed = with_edits(problem, edits)
            yield Change(edits[0].key, "", old, new, "", 0.0, changed, edits)


def vertex_changes(problem: Problem, violations: Sequence[Violation]) -> Iterator[Change]:
    """Yield changes of a vertex of a goal that moves outward, next to the bodies that are close."""
    robots = problem.team.robots
    names = " ".join(name for each in violations for name in each.where)
    cables = dict.fromkeys(int(number) for number in re.findall(r"\d+", names))
    ends = {"p": (0,), "q": (0,), "r": (1,)}
    bodies = re.findall(r"([pqr])(\d+)", names)
    vertices = [(int(k) + offset) % robots for kind, k in bodies for offset in ends[kind]]
    vertices += [(k + offset) % robots for k in cables for offset in (0, 1)]
    for i, step in enumerate(problem.mission):
        outline = step.goal_outline
        if outline is None or not isinstance(step, ShapeStep):
            continue
        for shift in VERTEX_SHIFTS:
            for vertex in dict.fromkeys(k for k in vertices if k < len(outline)):
                points = outline.vertices.copy()
                points[vertex] += shift * (points[vertex] - outline.centroid)
                points[vertex] = np.round(points[vertex], 3)
                edits = in_step(problem, i, (Edit("polygon", points.tolist()),))
                try:
                    changed = with_edits(problem, edits)
                except InputError:  # not convex
                    continue
                key = f"{edits[0].key}[{vertex}]"
                old, new = (str(each[vertex].tolist()) for each in (outline.vertices, points))
                yield Change(key, "", old, new, "", 0.0, changed, edits)


def spread_changes(problem: Problem) -> Iterator[Change]:
    """Yield the changes from other legs to spread ones, at the start or after steps."""
    records: list[tuple[str, object]] = [("start.hitch", problem.start)]
    records += [(f"mission[{i}].{step.name}", step) for i, step in enumerate(problem.mission)]
    for place, record in records:
        legs: Any = getattr(record, "legs", None)
        sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
        if sharing is None or (isinstance(sharing, str) and sharing == "spread"):
            continue
        edits = (Edit(f"{place}.legs", "spread"),)
        old = legs if isinstance(legs, str) else "as given"
        changed = with_edits(problem, edits)
        yield Change(edits[0].key, "", old, "spread", "", 0.0, changed, edits)
