"""Leg lengths: the split of every cable's slack between its two legs that keeps distances.

On a given polygon every drone slides along a fixed line, so positions are affine in ``d`` and lower
bounds of distances make a convex QP (``leg_program``) whose every solution keeps the true distances
at least as well as it says. Repeated, the penalised deviation never grows (a convex inner
approximation, Marks and Wright 1978).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError, check_time
from hitchopt.geometry.vectors import dot, first_smallest, unit
from hitchopt.hitch.leg_program import (
    LIMIT_MARGIN,
    PENALTY,
    LegBodies,
    LegLengths,
    LegTask,
    leg_program,
    solve_qp,
)
from hitchopt.values import Array

START_ROUNDS, PATH_ROUNDS = 60, 20
"""Maximum numbers of convex programs from one start: on one polygon, and along a path, where ten
are enough or none are."""

GAIN = 1e-6
"""Smallest relative gain of merit that counts: a mirror image gains less."""

SETTLED, QUICKLY_SETTLED = 1e-9, 1e-5
"""[m] Largest change of a leg in the last round; and where the first split that keeps the margin is
taken: a round that changes so little does not raise the margin either."""


def split_slack(task: LegTask, *, first: bool = False) -> LegLengths:
    """Return the leg lengths nearest to the reference that keep the margin, else the best found.

    The search is local: it starts from the reference and, where that fails on a single polygon,
    from a few uneven splits as well (along a path the fixed ends leave little freedom). Its cost
    is linear in J·n. The ``first`` ones that keep the margin are found many times as fast.
    """
    bodies = LegBodies(task, *task.bounds)
    best = _reference_kept(bodies) or _refined(bodies, task.reference, first)
    if len(task.reference) > 1 or (_keeps(task, best) and (first or best.deviation <= 1e-12)):
        return best
    for fractions in _uneven_fractions(task):
        found = _refined(bodies, fractions * task.slack, first)
        if _merit(task, found) < (1.0 - GAIN) * _merit(task, best):
            best = found
        if first and _keeps(task, best):
            break
    return best


def reference_margin(task: LegTask) -> float:
    """Return the smallest distance over its limit of the reference itself.

    Pairs beyond the wanted margin may be left out.
    """
    return float(np.min(reference_margins(task)))


def reference_margins(task: LegTask) -> Array:
    """Return the same (J,) of every polygon by itself."""
    return LegBodies(task, task.reference, task.reference).margins(task.reference)


def _reference_kept(bodies: LegBodies) -> LegLengths | None:
    """Return the reference if it keeps the margin and all bounds to the last bit, else None."""
    task, arena = bodies.task, bodies.task.requirements.arena
    start = np.clip(task.reference, *task.bounds)
    if task.roughness > 0.0 or not np.array_equal(start, task.reference):
        return None
    margin, drones = float(np.min(bodies.margins(start))), bodies.nodes(start)[bodies.drones, :2]
    if margin < task.wanted or (
        arena and np.any((drones < arena.lower[:2]) | (drones > arena.upper[:2]))
    ):
        return None
    return LegLengths(start, margin, 0.0)


def _uneven_fractions(task: LegTask) -> Array:
    """Return fractions (4 or 6, n): equal ones, or alternating from the sharpest clasp on.

    Counted from there, they are the same for a hitch that is renumbered or mirrored.
    """
    layout = task.team.layout
    along = unit(layout.edges(task.polygons[0]))
    cosines = dot(along[layout.ahead], along[layout.behind])
    sharpest = layout.clasps[int(first_smallest(cosines, 1.0))]
    k = np.arange(layout.robots)
    onward = (k - sharpest) % layout.robots % 2 == 0
    back = (sharpest - 1 - k) % layout.robots % 2 == 1
    alike = np.ones_like(onward)
    return np.unique(np.where([alike, ~alike, onward, ~onward, back, ~back], 0.3, 0.7), axis=0)


def _keeps(task: LegTask, found: LegLengths) -> bool:
    return found.margin >= task.wanted * (1.0 - 1e-9)


def _merit(task: LegTask, found: LegLengths) -> float:
    short = max(0.0, task.wanted - found.margin)
    return PENALTY * task.team.robots * (short if short > 1e-7 else 0.0) + 0.5 * found.deviation


def _refined(bodies: LegBodies, start: Array, first: bool) -> LegLengths:
    """Return the leg lengths that repeated convex approximation reaches from ``start``.

    Or the ``first`` iterate that keeps the margin.
    """
    task = bodies.task
    d, settled = np.clip(start, *task.bounds), QUICKLY_SETTLED if first else SETTLED
    for _ in range(START_ROUNDS if len(d) == 1 else PATH_ROUNDS):
        check_time()
        x = solve_qp(leg_program(bodies, d))
        if x is None:
            break
        before, d = d, x[: d.size].reshape(d.shape)
        if float(np.max(np.abs(d - before))) < settled:
            break
        if first and np.min(bodies.margins(d)) >= task.wanted * (1.0 - 1e-9):
            break
    margin = float(np.min(bodies.margins(d)))
    return LegLengths(d, margin, float(np.sum((d - task.reference) ** 2)))


ROLL_CANDIDATES = tuple(
    math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0)
)
"""[rad] Rolls in ascending order; the first that suffices is used. Simulated clasps hold to 60°."""

COARSE, LESS = (ROLL_CANDIDATES[3], ROLL_CANDIDATES[5]), 0.9
"""[rad] Rolls at which other lengths of legs are looked for, which takes longer; and the share of
the roll that the reference needs at which they have to suffice for that to be worth its time."""


def split_with_least_roll(task: LegTask) -> tuple[LegLengths, Array | float]:
    """Return leg lengths on one polygon and the roll [rad] that goes with them.

    The task's own, or none, where legs keep all limits with it. Else the smallest one found with
    which they keep the margin that is wanted, else the limits, as they are or with other lengths;
    the task's own where no roll helps. Its sense is that of the task's own, upward of q-legs
    without one.
    """
    own = 0.0 if task.roll is None else task.roll
    without = split_slack(task)
    if without.margin >= 1.0:
        return without, own
    sense = -1.0 if np.sum(own) < 0.0 else 1.0
    for margin in dict.fromkeys((task.wanted, LIMIT_MARGIN)):
        aim = replace(task, margin=margin)
        given = least_roll(aim, sense)
        ladder = COARSE if given is None else (LESS * abs(given),)
        chosen = least_roll(aim, sense, lambda rolled: split_slack(rolled).margin, ladder, 3)
        roll = given if chosen is None else chosen
        if roll is not None:
            return split_slack(replace(aim, roll=roll)), roll
    return without, own


def least_roll(
    task: LegTask,
    sense: float = 1.0,
    margin_of: Callable[[LegTask], float] = reference_margin,
    ladder: tuple[float, ...] = ROLL_CANDIDATES,
    halvings: int = 7,
) -> float | None:
    """Return the smallest roll [rad] that is found to give the margin wanted, or None.

    To a hundredth of the step between two rungs of a ladder; a roll that leaves loads no balance
    gives none.
    """

    def suffices(angle: float) -> bool:
        try:
            rolled = replace(task, roll=sense * angle)
            return margin_of(rolled) >= task.wanted * (1.0 - 5e-7)
        except InfeasibleError:
            return False

    upper = next((rung for rung in ladder if suffices(rung)), None)
    if upper is None:
        return None
    lower = max((rung for rung in ladder if rung < upper), default=0.0)
    for _ in range(halvings):
        middle = 0.5 * (lower + upper)
        lower, upper = (lower, middle) if suffices(middle) else (middle, upper)
    return sense * upper
