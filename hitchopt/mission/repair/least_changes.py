"""Kinds of changes of what is allowed: limits, durations and walls."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.errors import Violation
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair.change import (
    TIMES,
    Edited,
    Kind,
    Quantity,
    beyond,
    lowered,
    needed,
    short,
)
from hitchopt.mission.repair.editing import with_arena, with_bound, with_step_edit
from hitchopt.steps.edits import PLAN_DURATION, Tunable

STEEPEST = 80.0
"""Largest tilt suggested [deg]."""

WALLS = tuple((side, axis) for axis in range(3) for side in ("lower", "upper"))
"""Sides and axes of an arena."""

RAISED_LIMITS = (
    ("speed", "m/s", TIMES | {"speed"}),
    ("acceleration", "m/s²", TIMES | {"acceleration"}),
    ("jerk", "m/s³", TIMES | {"jerk"}),
    ("vertex_speed", "m/s", TIMES | {"vertex_speed"}),
    ("duration", "s", frozenset({PLAN_DURATION})),
)
"""Limits that may be raised, with their units and the constraints that this repairs."""


def bound_quantity(problem: Problem, key: str, unit: str) -> Quantity:
    """Return a limit or a distance to keep, by its key in the file."""
    section, name = key.split(".")
    old = float(getattr(getattr(problem, section), name))
    return Quantity(key, old, unit, partial(with_bound, problem, key))


def limit_kinds(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield limits of motion raised, and the shortest leg lowered."""
    for name, unit, covers in RAISED_LIMITS:
        if getattr(problem.limits, name) is not None:
            least = needed(violations, PLAN_DURATION if name == "duration" else name)
            quantity = bound_quantity(problem, f"limits.{name}", unit)
            yield Kind(quantity, 1, covers, least, relaxes=True)
    degrees = round(math.degrees(problem.limits.tilt), 9)
    if degrees < STEEPEST:
        key, most = "limits.tilt_deg", STEEPEST / degrees - 1.0
        tilt = Quantity(key, degrees, "deg", partial(with_bound, problem, key))
        yield Kind(tilt, 1, TIMES | {"tilt"}, needed(violations, "tilt"), most, relaxes=True)
    if problem.limits.body_rate is not None:
        key, covers = "limits.body_rate_deg", TIMES | {"body_rate"}
        degrees = round(math.degrees(problem.limits.body_rate), 9)
        rate = Quantity(key, degrees, "deg/s", partial(with_bound, problem, key))
        yield Kind(rate, 1, covers, needed(violations, "body_rate"), relaxes=True)
    yield lowered(bound_quantity(problem, "limits.leg", "m"), frozenset({"legs"}), relaxes=True)


def step_kinds(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield the numbers of steps that can be changed."""
    for i, step in enumerate(problem.mission):
        own = short([v for v in violations if f"step {i} " in v.when])
        for tunable in step.tunables():
            key = f"mission[{i}].{step.name}.{tunable.key}"
            put = partial(_tuned, problem, i, tunable)
            quantity = Quantity(key, tunable.old, tunable.unit, put, tunable.words)
            lasts = "duration" in tunable.raises  # a longer step takes nothing away
            if tunable.raises:
                yield Kind(quantity, 1, tunable.raises, own if lasts else 0.0, relaxes=lasts)
            yield lowered(quantity, tunable.lowers)


def _tuned(problem: Problem, i: int, tunable: Tunable, value: float) -> Edited:
    return with_step_edit(problem, i, tunable.put(value))


def wall_kinds(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield the arena's walls moved out, each alone."""
    arena = problem.arena
    if arena is None:
        return
    for side, axis in WALLS:
        corner = getattr(arena, side)

        def put(new: float, side: str = side, axis: int = axis) -> Edited:
            moved = getattr(arena, side).copy()
            moved[axis] = new
            return with_arena(problem, replace(arena, **{side: moved}))

        extent = float(arena.upper[axis] - arena.lower[axis])
        key, sign = f"arena.{side}[{axis}]", -1 if side == "lower" else 1
        wall = Quantity(key, float(corner[axis]), "m", put, "one wall", extent)
        yield Kind(wall, sign, frozenset({"arena"}), beyond(violations) / extent, relaxes=True)


def all_walls(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield all walls moved out by the same distance."""
    arena = problem.arena
    if arena is None:
        return

    def put(by: float) -> Edited:
        lower, upper = np.round(arena.lower - by, 9), np.round(arena.upper + by, 9)
        return with_arena(problem, replace(arena, lower=lower, upper=upper))

    extent = float(np.min(arena.upper - arena.lower))
    walls = Quantity("arena", 0.0, "m", put, "every wall moved out", extent)
    yield Kind(walls, 1, frozenset({"arena"}), beyond(violations) / extent, relaxes=True)
