"""Report ``tracking_radius``: how far all drones may be off their plan, every distance kept.

It is the largest r such that, with every drone within r of its plan and every vertex within γ r,
independently of each other, and taut parts of cables straight between them, all distances keep
their limits at all times:

- two drones: half the shortest shift of their offset that makes their ellipsoids touch;
- ``cable_clearance``, ``crossing`` and ``legs``: what they leave beyond the limit over how far both
  bodies move, a part of a cable no farther than its ends (g = max(1, γ));
- ``arena`` and ``keep_out``: what they leave;
- free cables: their drones come no farther apart than they are long, and a hanging cable moves by
  its ends and by how much deeper or shallower it hangs between them.

It follows from the bounds of the checks, which hold for all t. Only pairs of drones one of which is
higher, and hanging cables, need a look of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.bounds.bodies import drone_points
from hitchopt.checks.bounds.ellipsoid_distance import ellipsoid_metric
from hitchopt.checks.bounds.hanging_clearance import moved_by
from hitchopt.checks.bounds.moving_bodies import Bodies, every_pair
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rates import norm_bound
from hitchopt.checks.bounds.rounding_margins import ROUNDING, position_margin
from hitchopt.checks.rule import Finding, Findings, Found, ReportRule
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE
from hitchopt.trajectory.extremum import Cells, Estimate, largest
from hitchopt.values import Array

GAMMA = 1.0
"""How many times farther than drones vertices are taken to be off, where nobody says."""

HALVINGS = 40
"""Halvings of the interval in which the radius of hanging cables lies."""

SAME = 1e-6
"""Relative difference of two bounds that makes no further search worth its time."""


@dataclass(frozen=True)
class _Term:
    """What keeps the radius small.

    Attributes
    ----------
    radius: [m]
    time: [s], when.
    where: names of drones, cables or vertices.
    """

    radius: float
    time: float = 0.0
    where: tuple[str, ...] = ()


def _find(motion: Motion, found: Findings, gamma: float) -> Finding:
    """Return the radius [m]; infinite where nothing keeps a distance."""
    terms = [*_distances_kept(found, gamma), *_spans(motion)]
    least = min(terms, key=lambda term: term.radius, default=_Term(math.inf))
    for each, span in _hanging(motion, found):
        least = _least_hanging(span, each, least)
    for each in found["separation"]:
        least = _least_pair(motion, each, least)
    return Finding(least.radius * (1.0 - ROUNDING), least.time, least.where)


def _distances_kept(found: Findings, gamma: float) -> Iterator[_Term]:
    """Yield what distances leave whose bodies move by a known multiple of the radius."""
    most = max(1.0, gamma)
    hitched = {"cable_clearance": 1.0 + most, "crossing": 2.0 * most, "legs": 1.0 + gamma}
    free = {"cable_clearance": 2.0, "crossing": 2.0}
    for name in ("cable_clearance", "crossing", "legs", "arena", "keep_out"):
        for each in found[name]:
            if each.check.worst is None or (name == "cable_clearance" and _hangs(each)):
                continue
            moved = (hitched if each.states == HITCHED_STATE else free).get(name, 1.0)
            left = each.check.worst - each.check.number
            yield _Term(max(left / moved, 0.0), each.check.time, each.check.where)


def _hangs(found: Found) -> bool:
    return found.states.isdisjoint(HITCHED_STATE | {CableState.GROUND})


def _spans(motion: Motion) -> Iterator[_Term]:
    """Yield half of what cables are longer than their drones are apart."""
    margin = 2.0 * position_margin(motion)
    for span in motion.spans(FREE_STATES):
        c, length = span.drones.coefficients, motion.team.cable_length
        lengths = np.broadcast_to(length[:, None, None], (len(c), len(length), 1, 1))
        cells = Cells.over(span.drones.breaks, [c[:, 1::2] - c[:, 0::2], lengths], margin)
        tightest = largest(cells, _beyond)
        radius = max(-0.5 * tightest.worst, 0.0)
        yield _Term(radius, tightest.time, (f"cable {tightest.item}",))


def _beyond(blocks: tuple[Array, ...]) -> Estimate:
    """Bound from above how much chords are longer than their cables."""
    chords, lengths = blocks
    norm = norm_bound((chords,))
    return Estimate(norm.bound - lengths[:, 0, 0], norm.value - lengths[:, 0, 0], norm.x)


def _hanging(motion: Motion, found: Findings) -> Iterator[tuple[Found, Motion]]:
    """Yield each finding on hanging cables with the span of time that it is of."""
    each = [entry for entry in found["cable_clearance"] if _hangs(entry)]
    if each:
        yield from zip(each, motion.spans(each[0].states), strict=True)


def _least_hanging(span: Motion, found: Found, least: _Term) -> _Term:
    """Return the smaller of a term and what hanging cables leave."""
    if found.check.worst is None:
        return least
    left = max(found.check.worst - found.check.number, 0.0)
    most = min(least.radius, left)
    needed = moved_by(span)
    if needed(most) <= left:
        return least if most == least.radius else _Term(most, found.check.time, found.check.where)
    low, high = 0.0, most
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) <= left else (low, middle)
    return _Term(low, found.check.time, found.check.where)


def _least_pair(motion: Motion, found: Found, least: _Term) -> _Term:
    """Return the smaller of a term and the radius at which two drones may touch.

    A ratio s leaves the thinnest semi-axis times s - 1. That is all that a level pair has, if
    ellipsoids are high; others are searched for.
    """
    check, separation = found.check, motion.requirements.separation
    if check.worst is None:
        return least
    lower = max(min(separation.radius, separation.height) * (check.worst - 1.0), 0.0)
    if least.radius <= lower:
        return least
    names, metric = motion.team.drone_names, ellipsoid_metric(separation)
    i, j = (names.index(name) for name in check.where)
    there = motion.drones.at(check.time)
    upper = 0.5 * float(metric.measured((there[i] - there[j]) * separation.scale))
    pair = _Term(lower, check.time, check.where)
    if upper <= lower * (1.0 + SAME) + SAME * separation.radius:
        return pair
    known = 2.0 * min(upper, least.radius)
    drones = Bodies(drone_points(motion).corners * separation.scale[:, None])
    margin = position_margin(motion)
    nearest = smallest_distance(
        motion.drones.breaks, drones, None, every_pair, margin, metric=metric, known=known
    )
    radius = max(0.5 * nearest.worst, lower)
    if nearest.item >= 0:
        where = tuple(names[k] for k in sorted(divmod(nearest.item, len(names))))
        return _Term(radius, nearest.time, where)
    return least if least.radius <= upper else _Term(radius, pair.time, pair.where)


RULE = ReportRule("tracking_radius", "m", "min", _find)
