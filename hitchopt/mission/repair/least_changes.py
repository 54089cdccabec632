"""Kinds of changes of what is allowed: limits, durations and walls."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from hitchopt.errors import Violation
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair.change import Edited, Kind, Quantity, lowered, raised
from hitchopt.mission.repair.constraints import TIMES, beyond, needed, short
from hitchopt.mission.repair.editing import with_arena, with_limit, with_step_edit, with_thrust
from hitchopt.steps.edits import PLAN_DURATION, Tunable

STEEPEST = 80.0
"""Largest tilt suggested [deg]."""

WALLS = tuple((side, axis) for axis in range(3) for side in ("lower", "upper"))


def limit_kinds(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield limits of motion and thrust raised, and the shortest leg lowered."""
    limits = problem.limits
    for name, unit in (
        ("speed", "m/s"),
        ("acceleration", "m/s²"),
        ("jerk", "m/s³"),
        ("vertex_speed", "m/s"),
    ):
        quantity = Quantity(
            f"limits.{name}", getattr(limits, name), unit, partial(with_limit, problem, name)
        )
        yield raised(quantity, TIMES | {name}, needed(violations, name), relaxes=True)
    degrees = round(math.degrees(limits.tilt), 9)
    tilt = Quantity("limits.tilt_deg", degrees, "deg", partial(with_limit, problem, "tilt_deg"))
    if degrees < STEEPEST:
        steepest = STEEPEST / degrees - 1.0
        yield raised(tilt, TIMES | {"tilt"}, needed(violations, "tilt"), steepest, relaxes=True)
    if limits.body_rate is not None:
        rate = Quantity(
            "limits.body_rate_deg",
            round(math.degrees(limits.body_rate), 9),
            "deg/s",
            partial(with_limit, problem, "body_rate_deg"),
        )
        yield raised(rate, TIMES | {"body_rate"}, needed(violations, "body_rate"), relaxes=True)
    thrusts = np.array([kind.max_thrust for kind in problem.team.quadrotor])
    same = bool(np.all(thrusts == thrusts[0]))
    old = float(thrusts[0]) if same else 1.0
    thrust = Quantity(
        "team.quadrotor.max_thrust" if same else "team.quadrotor",
        old,
        "N" if same else "times",
        lambda new: with_thrust(problem, new / old),
        "" if same else "every max_thrust",
    )
    yield raised(thrust, TIMES | {"thrust"}, relaxes=True)
    leg = Quantity("limits.leg", limits.leg, "m", partial(with_limit, problem, "leg"))
    yield lowered(leg, frozenset({"legs"}), relaxes=True)


def step_kinds(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield the plan's longest duration raised, and the numbers of steps that can be changed."""
    longest = problem.limits.duration
    if longest is not None:
        quantity = Quantity(
            "limits.duration", longest, "s", partial(with_limit, problem, "duration")
        )
        least = needed(violations, PLAN_DURATION)
        yield raised(quantity, frozenset({PLAN_DURATION}), least, relaxes=True)
    for i, step in enumerate(problem.mission):
        own = short([v for v in violations if f"step {i} " in v.when])
        for tunable in step.tunables():
            key = f"mission[{i}].{step.name}.{tunable.key}"
            put = partial(_tuned, problem, i, tunable)
            quantity = Quantity(key, tunable.old, tunable.unit, put, tunable.words)
            lasts = "duration" in tunable.raises  # a longer step takes nothing away
            if tunable.raises:
                yield raised(quantity, tunable.raises, own if lasts else 0.0, relaxes=lasts)
            yield lowered(quantity, tunable.lowers)


def _tuned(problem: Problem, i: int, tunable: Tunable, value: float) -> Edited:
    return with_step_edit(problem, i, tunable.put(value))


def wall_kinds(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield the arena's walls moved out, each alone."""
    arena = problem.arena
    if arena is None:
        return
    covers = frozenset({"arena"})
    short = beyond(violations)
    extents = arena.upper - arena.lower
    for side, axis in WALLS:
        sign = -1 if side == "lower" else 1
        old, extent = float(getattr(arena, side)[axis]), float(extents[axis])

        def put(new: float, side: str = side, axis: int = axis) -> Edited:
            corners = {"lower": arena.lower.copy(), "upper": arena.upper.copy()}
            corners[side][axis] = new
            return with_arena(problem, **corners)

        wall = Quantity(f"arena.{side}[{axis}]", old, "m", put, "one wall", extent)
        yield Kind(covers, partial(wall.moved, sign=sign), short / extent, relaxes=True)


def all_walls(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield all walls moved out by the same distance."""
    arena = problem.arena
    if arena is None:
        return

    def put(by: float) -> Edited:
        return with_arena(problem, np.round(arena.lower - by, 9), np.round(arena.upper + by, 9))

    extent = float(np.min(arena.upper - arena.lower))
    walls = Quantity("arena", 0.0, "m", put, "every wall moved out", extent)
    least = beyond(violations) / extent
    yield Kind(frozenset({"arena"}), partial(walls.moved, sign=1), least, relaxes=True)
