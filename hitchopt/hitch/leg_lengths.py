"""Leg lengths: the split of every cable's slack between its two legs that keeps distances.

On a given polygon every drone slides along a fixed line, so positions are affine in ``d``. For a
pair of bodies and any unit vector ν, ``ν·(a - b)`` taken at its smallest over their ends is a
lower bound of their distance and linear in ``d``. With ν from the present leg lengths the
bounds are tight there: they make a convex QP whose every solution keeps the true distances at least
as well as the QP says. Repeated, the penalised deviation never grows (a convex inner approximation,
Marks and Wright 1978).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hitchopt.geometry.vectors import first_smallest
from hitchopt.hitch.convex_qp import solve_qp
from hitchopt.hitch.leg_program import PENALTY, LegBodies, leg_program
from hitchopt.hitch.leg_task import LegLengths, LegTask
from hitchopt.time_limit import check_time
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


def split_slack_from(task: LegTask, start: Array) -> LegLengths:
    """Return the leg lengths that the search reaches from given ones (J, n) [m]."""
    bounds = task.bounds
    return _refined(task, LegBodies(task, *bounds), np.clip(start, *bounds))


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
