"""Report ``tracking_radius``: how far all drones may be off their plan with every distance kept.

It is the largest r such that, with every drone within r of its plan and every vertex within γ r,
independently of each other, and taut parts of cables straight between them, all distances keep
their limits at all times. Two drones have half the shortest shift of their offset that makes their
ellipsoids touch, all others the slack of checks beyond their limits over the motion of both bodies.
A hanging cable moves by its ends and by how much deeper or shallower it hangs between them.

If ``limits.tracking`` states how far they may be off, that is the limit, and the distances of
cables and carried objects to other objects count, too.

It follows from the bounds of the checks, which hold for all t. Only pairs of drones at different
heights, and hanging cables, are bounded separately.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.checks.clearance import CABLE_CLEARANCE, drones_room, moved_by
from hitchopt.checks.distances import Moving, smallest
from hitchopt.checks.drones import Drones
from hitchopt.checks.rule import ReportRule, SpanResult, SpanResults, WorstCase
from hitchopt.checks.spans import ROUNDING, cable_names, phase_parts
from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, Motion
from hitchopt.trajectory.enclosed import Bound
from hitchopt.trajectory.search import worst
from hitchopt.values import Array

GAMMA = 1.0  # default ratio of vertex errors to drone errors
HANGING = ("cable_clearance", "object_clearance")  # distances of cables that hang
HALVINGS = 40  # of the interval in which the radius of hanging cables lies
NEWTON = 12  # iterations for the nearest point; a normal that is off costs tightness only


def _radius(motion: Motion, results: SpanResults, gamma: float) -> WorstCase:
    """Return the radius [m]; infinite if nothing keeps a distance."""
    most, terms = max(1.0, gamma), [WorstCase(math.inf, 0.0)]
    # How far bodies come together per radius, with a hitch and without.
    nearer = {"cable_clearance": (1.0 + most, 2.0), "crossing": (2.0 * most, 2.0)}
    nearer |= {"legs": (1.0 + gamma, 1.0), "arena": (most, 1.0), "keep_out": (1.0, 1.0)}
    if motion.requirements.limits.tracking:
        nearer["object_clearance"] = (most, most)
    for name, factors in nearer.items():
        for each in results[name]:
            landed = name == "arena" and each.states != HITCHED_STATE
            if not (landed or (name in HANGING and _hangs(each))):
                left = _left(each.check) / factors[each.states != HITCHED_STATE]
                terms.append(WorstCase(left, each.check.time, each.check.where))
    if motion.requirements.arena is not None:  # drones that stand on its floor may
        near = worst(Drones.of(motion), partial(drones_room, landed=False), "min")
        where = (motion.team.drone_names[near.item],)
        terms.append(WorstCase(max(near.worst, 0.0), near.time, where))
    for span in motion.spans(FREE_STATES):  # half of the excess of cables over their chords
        tightest = worst(Drones.of(span), _spare, "min")
        cable = cable_names(span)[tightest.item // 2]
        terms.append(WorstCase(max(0.5 * tightest.worst, 0.0), tightest.time, (cable,)))
    for check, span in _while_hanging(motion, results):
        terms.append(WorstCase(_hanging(span, check), check.time, check.where))
    least = min(terms, key=lambda term: term.worst)
    for each in results["separation"]:
        least = _least_pair(motion, each.check, least)
    return replace(least, worst=least.worst * (1.0 - ROUNDING))


def _while_hanging(motion: Motion, results: SpanResults) -> Iterator[tuple[Check, Motion]]:
    """Yield the clearance of hanging cables with its span of time; if limited, of each phase.

    In some phases they hang close to obstacles, in others they move farther with their ends.
    """
    limited = bool(motion.requirements.limits.tracking)
    for name in HANGING if limited else HANGING[:1]:
        hanging = [each for each in results[name] if _hangs(each)]
        spans = motion.spans(hanging[0].states) if hanging else ()
        for each, span in zip(hanging, spans, strict=True):
            if not limited or name != "cable_clearance":
                yield each.check, span
                continue
            for part in phase_parts(span):
                (own,) = CABLE_CLEARANCE.span_results(part.motion)
                yield own.check, part.motion


def _left(check: Check) -> float:
    """Return the slack of a distance beyond its limit [m]; infinite if nothing was evaluated."""
    return max(check.bound - check.number, 0.0)


def _hangs(result: SpanResult) -> bool:
    return result.states.isdisjoint(HITCHED_STATE) and result.states != {CableState.GROUND}


def _spare(spans: Drones) -> Bound:
    """Return by how much cables are longer than their chords [m]."""
    chord = spans.partner.norm_above
    return Bound(spans.length - chord.value, chord.x)


def _hanging(span: Motion, check: Check) -> float:
    """Return the largest radius at which hanging cables keep their clearance [m]."""
    if check.worst is None:
        return math.inf
    left, needed = _left(check), moved_by(span)
    low, high = 0.0, left
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) <= left else (low, middle)
    return low


def _least_pair(motion: Motion, check: Check, least: WorstCase) -> WorstCase:
    """Return the smaller of a term and the radius at which two drones may touch.

    A ratio s leaves the thinnest semi-axis times s - 1: if that suffices, no pair is evaluated.
    """
    separation, names = motion.requirements.separation, motion.team.drone_names
    lower = max(min(separation.radius, separation.height) * (check.bound - 1.0), 0.0)
    if least.worst <= lower:
        return least
    points, shape = motion.drones.coefficients[:, :, None], Ellipsoid(1.0 / separation.scale)
    moving = Moving.of(motion, points, shape=shape, names=(names, names))
    pair = smallest(moving, known=2.0 * least.worst)
    radius = max(0.5 * pair.worst, lower)
    if radius >= least.worst or pair.item < 0:
        return replace(least, worst=min(radius, least.worst))
    return WorstCase(radius, pair.time, moving.named(pair.item))


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Ellipsoid of the offsets at which two drones' ellipsoids touch: twice their semi-axes.

    Its semi-axes are ``axes`` (3,) [m], the first two equal.
    """

    axes: Array

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3)."""
        reach: Array = np.linalg.norm(directions * self.axes, axis=-1)
        return reach

    def towards(self, corners: Array) -> Array:
        """Return the outward normals (…, 3) nearest to points (…, 1, 3); zero for points within.

        The nearest point is ``(a² x, b² z) / (t + (a², b²))`` with t > 0 where that is on the
        ellipsoid. Newton's method on a convex function that falls, from the left.
        """
        offsets, a, b = corners[..., 0, :], float(self.axes[0]), float(self.axes[2])
        across, upward = np.hypot(offsets[..., 0], offsets[..., 1]), np.abs(offsets[..., 2])
        outside = (across / a) ** 2 + (upward / b) ** 2 > 1.0
        t = np.maximum(np.maximum(a * across - a * a, b * upward - b * b), 0.0)
        for _ in range(NEWTON):
            x, z = a * across / (t + a * a), b * upward / (t + b * b)
            slope = 2.0 * (x * x / (t + a * a) + z * z / (t + b * b))
            t = t + np.where(outside, (x * x + z * z - 1.0) / np.where(outside, slope, 1.0), 0.0)
        return unit(np.where(outside[..., None], offsets / (t[..., None] + self.axes**2), 0.0))


TRACKING_RADIUS = ReportRule(
    "tracking_radius",
    "m",
    "min",
    _radius,
    limit=lambda motion: motion.requirements.limits.tracking or None,
    remedy="give cables or polygons more room, stiffer gains, or lower limits.tracking",
    free_remedy="place the robots farther apart, give stiffer gains, or lower limits.tracking",
)
