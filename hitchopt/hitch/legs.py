"""Leg lengths: the split of every cable's slack between its two legs that keeps distances.

On a given polygon every drone slides along a fixed line, so positions are affine in ``d``. For a
pair of bodies and any unit vector ν, ``ν·(a - b)`` taken at its smallest over their ends is a
lower bound of their distance and linear in ``d``. With ν from the present leg lengths the
bounds are tight there: they make a convex QP whose every solution keeps the true distances at least
as well as the QP says. Repeated, the penalised deviation never grows (a convex inner approximation,
Marks and Wright 1978).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from hitchopt.errors import InfeasibleError, check_time
from hitchopt.geometry.vectors import dot, first_smallest, length, unit
from hitchopt.hitch.forces import leg_directions
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

ROUNDS = 60
"""Maximum number of convex programs from one start."""

GAIN = 1e-6
"""Smallest relative gain of merit that counts: a mirror image gains less."""

SETTLED, QUICKLY_SETTLED = 1e-9, 1e-5
"""[m] Largest change of a leg in the last round; and where the first split that keeps the margin is
taken: a round that changes so little does not raise the margin either."""


def split_slack(task: LegTask) -> LegLengths:
    """Return the leg lengths nearest to the reference that keep the margin, else the best found.

    The search is local: it starts from the reference and, where that fails on a single polygon,
    from a few uneven splits as well (along a path the fixed ends leave little freedom). Its cost
    is linear in J·n.
    """
    slack, bodies = task.slack, LegBodies(task, *task.bounds)
    kept = reference_kept(task, bodies)
    if kept is not None:
        return kept
    start = np.clip(task.reference, *task.bounds)
    best = _refined(task, bodies, start)
    single = len(task.reference) == 1
    if not single or (best.margin >= task.wanted * (1.0 - 1e-9) and best.deviation <= 1e-12):
        return best
    for pattern in _uneven_fractions(task):
        start = np.clip(pattern * slack, *task.bounds)
        found = _refined(task, bodies, start)
        if _merit(task, found) < (1.0 - GAIN) * _merit(task, best):
            best = found
    return best


def reference_kept(task: LegTask, bodies: LegBodies) -> LegLengths | None:
    """Return the reference if it keeps the margin and all bounds, else None.

    To the last bit, where a solver would come within its tolerance.
    """
    start = np.clip(task.reference, *task.bounds)
    if task.roughness == 0.0 and np.array_equal(start, task.reference):
        margin = bodies.margin(task, start)
        if margin >= task.wanted and bodies.inside(task.requirements.arena, start):
            return LegLengths(start, margin, 0.0)
    return None


def quick_split(task: LegTask) -> LegLengths:
    """Return leg lengths on one polygon that keep the margin, else the best found.

    The first ones that keep it, near the reference or else near uneven splits: ``split_slack``
    takes many times as long to come nearest.
    """
    bodies, tried = LegBodies(task, *task.bounds), []
    for start in _starts(task):
        tried.append(_refined(task, bodies, np.clip(start, *task.bounds), first=True))
        if tried[-1].margin >= task.wanted * (1.0 - 1e-9):
            return tried[-1]
    return max(tried, key=lambda found: found.margin)


def _starts(task: LegTask) -> Iterator[Array]:
    """Yield leg lengths (1, n) to begin from on one polygon: the reference, then uneven splits."""
    yield task.reference
    for pattern in _uneven_fractions(task):
        yield pattern * task.slack


def _uneven_fractions(task: LegTask) -> Array:
    """Return fractions (4 or 6, n): equal ones, or alternating from the sharpest clasp on.

    Counted from there, they are the same for a hitch that is renumbered or mirrored.
    """
    layout = task.team.layout
    edges = layout.edges(task.polygons[0])
    ahead, behind = edges[layout.ahead], edges[layout.behind]
    lengths = np.linalg.norm(ahead, axis=1) * np.linalg.norm(behind, axis=1)
    cosines = np.sum(ahead * behind, axis=1) / lengths
    sharpest = layout.clasps[int(first_smallest(cosines, 1.0))]
    k = np.arange(layout.robots)
    onward = (k - sharpest) % layout.robots % 2 == 0
    back = (sharpest - 1 - k) % layout.robots % 2 == 1
    alike = np.ones_like(onward)
    return np.unique(np.where([alike, ~alike, onward, ~onward, back, ~back], 0.3, 0.7), axis=0)


def reference_margin(task: LegTask) -> float:
    """Return the margin of the reference itself: the smallest distance over its limit.

    Pairs beyond the wanted margin may be left out.
    """
    return float(np.min(reference_margins(task)))


def reference_margins(task: LegTask) -> Array:
    """Return the same (J,) of every polygon by itself."""
    return LegBodies(task, task.reference, task.reference).margins(task, task.reference)


def _merit(task: LegTask, found: LegLengths) -> float:
    short = max(0.0, task.wanted - found.margin)
    return PENALTY * task.team.robots * (short if short > 1e-7 else 0.0) + 0.5 * found.deviation


def _refined(task: LegTask, bodies: LegBodies, start: Array, *, first: bool = False) -> LegLengths:
    """Return the leg lengths that repeated convex approximation reaches from ``start``.

    Or the ``first`` ones on the way that keep the margin.
    """
    d, settled, margin = start, QUICKLY_SETTLED if first else SETTLED, None
    for _ in range(ROUNDS):
        check_time()
        x = solve_qp(leg_program(task, bodies, d))
        if x is None:
            break
        moved = x[: d.size].reshape(d.shape)
        step = float(np.max(np.abs(moved - d)))
        d, margin = moved, float(np.min(bodies.margins(task, moved))) if first else None
        if step < settled or (margin is not None and margin >= task.wanted * (1.0 - 1e-9)):
            break
    margin = bodies.margin(task, d) if margin is None else margin
    return LegLengths(d, margin, float(np.sum((d - task.reference) ** 2)))


LADDER = tuple(math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0))
"""[rad] Rolls that are tried until one suffices: up to 60° clasps hold in simulated ropes."""

COARSE = tuple(math.radians(angle) for angle in (20.0, 40.0))
"""[rad] Rolls at which other lengths of legs are looked for, which takes longer."""

HALVINGS = 7
"""Number of halvings of the step of the ladder in which the smallest roll lies: 0.1° are left."""

LESS = 0.9
"""Share of the roll that the reference needs at which other leg lengths have to suffice, for a
search with all of them to be worth its time."""


def split_with_least_roll(task: LegTask) -> tuple[LegLengths, Array]:
    """Return leg lengths on one polygon and the roll (clasps,) [rad] that goes with them.

    There is no roll where legs keep all limits without. Else it is the smallest one found with
    which they keep the margin that is wanted, else the limits; none where no roll helps. Its
    sense is that of the task's own roll, upward of q-legs without one. Where legs carry weight the
    other sense is tried as well if that one does not help.

    Parameters
    ----------
    task: of one polygon; its own roll is what legs have without need.
    """
    own = np.zeros(len(task.team.layout.clasps)) if task.roll is None else task.roll[0]
    without = reference_kept(task, LegBodies(task, *task.bounds))
    if without is None and level_margin_bound(task) >= 1.0:
        without = split_slack(task)
    if without is not None and without.margin >= 1.0:
        return without, own
    margins: dict[float, float] = {}  # of chosen lengths, at the rolls that were tried
    for sense, margin in product(_senses(task, own), dict.fromkeys((task.wanted, LIMIT_MARGIN))):
        aim = replace(task, margin=margin)
        roll = _least(aim, margins, sense)
        if roll is not None:
            return split_slack(_rolled(aim, roll)), np.full(len(own), roll)
    return without or split_slack(task), own


def level_margin_bound(task: LegTask) -> float:
    """Return a bound of the margin that any leg lengths have without roll, infinite if unknown.

    A leg of length d at an angle to its own edge ends at most ``d sin`` from it, and d is at most
    the slack of its cable. Legs that may end beyond the edge do not count.
    """
    team, cable = task.team, task.requirements.separation.cable
    if not task.level or cable == 0.0:
        return math.inf
    edges = team.layout.edges(task.polygons)
    lengths, u = length(edges), unit(edges)
    q, r = leg_directions(u, team.tension, team.topology)
    reach = task.slack
    bound = math.inf
    for out, along in ((q, u), (r, -u)):
        ahead = dot(out, along)
        beside = (ahead > 0.0) & (reach * ahead <= lengths) & (reach > 0.0)
        away = reach * np.sqrt(np.maximum(1.0 - ahead**2, 0.0))
        bound = min(bound, float(np.min(away, where=beside, initial=math.inf)) / cable)
    return bound


def least_roll_of_reference(task: LegTask) -> Array:
    """Return the smallest roll (clasps,) [rad] with which the reference itself keeps all limits.

    None, which is zero, where it keeps them without, or where no roll is found to help.
    """
    none = np.zeros(len(task.team.layout.clasps))
    if reference_margin(task) >= 1.0:
        return none
    rolls = (_least_as_they_are(task, sense) for sense in _senses(task, none))
    return none + next((roll for roll in rolls if roll is not None), 0.0)


def _senses(task: LegTask, own: Array) -> tuple[float, ...]:
    """Return the signs of the rolls that are tried, that of the task's own roll first.

    Without weight one is the other one seen from below. A plan whose roll changes its sense passes
    through none: the smaller one of the two is not looked for.
    """
    first = -1.0 if np.sum(own) < 0.0 else 1.0
    return (first, -first) if task.team.loaded else (first,)


def _least(task: LegTask, margins: dict[float, float], sense: float) -> float | None:
    """Return the smallest roll [rad] with which leg lengths keep the task's margin, or None.

    Lengths as they are come first, which takes no program to be solved.

    Parameters
    ----------
    margins: those of chosen lengths at the rolls of COARSE, once they are known.
    sense: sign of the rolls.
    """

    def chosen(angle: float) -> bool:
        roll = sense * angle
        if angle not in COARSE:
            return split_slack(_rolled(task, roll)).margin >= task.wanted * (1.0 - 1e-6)
        if roll not in margins:
            margins[roll] = split_slack(_rolled(task, roll)).margin
        return margins[roll] >= task.wanted * (1.0 - 1e-6)

    given = _least_as_they_are(task, sense)
    if given is None:
        found = _first(chosen, COARSE, 3)
    elif _possible(chosen, LESS * abs(given)):
        found = _first(chosen, (LESS * abs(given),), 3)
    else:
        return given
    return None if found is None else sense * found


def _least_as_they_are(task: LegTask, sense: float) -> float | None:
    """Return the same of the reference's own leg lengths."""

    def suffices(angle: float) -> bool:
        return reference_margin(_rolled(task, sense * angle)) >= task.wanted

    found = _first(suffices, LADDER)
    return None if found is None else sense * found


def _first(
    suffices: Callable[[float], bool], ladder: tuple[float, ...], halvings: int = HALVINGS
) -> float | None:
    """Return the smallest roll that is found to suffice, between two rungs of a ladder; or None."""
    lower = 0.0
    for rung in ladder:
        if _possible(suffices, rung):
            upper = rung
            for _ in range(halvings):
                middle = 0.5 * (lower + upper)
                lower, upper = (lower, middle) if _possible(suffices, middle) else (middle, upper)
            return upper
        lower = rung
    return None


def _possible(suffices: Callable[[float], bool], roll: float) -> bool:
    """Return whether a roll suffices; one that leaves loads no balance does not."""
    try:
        return suffices(roll)
    except InfeasibleError:
        return False


def _rolled(task: LegTask, roll: float) -> LegTask:
    return replace(task, roll=np.full((1, len(task.team.layout.clasps)), roll))
