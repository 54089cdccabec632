"""Report ``tracking_radius``: the largest tracking error with which all distances are kept.

It is the largest r such that all distances keep their limits at all times, with every drone within
r of its plan and every vertex within γ r, independently of each other, and taut parts of cables
straight between them. For two drones, it is half the shortest shift of their offset with which
their ellipsoids touch; for other bodies, the slack of checks divided by the approach of both. A
hanging cable moves with its ends, and its depth changes. A cable
that is loose after a loss may be pulled taut, as the check ``loss_displacement`` assumes.

If ``limits.tracking`` is larger vertically than horizontally, errors are within an ellipsoid with
radius r and the same ratio of height and radius. Heights are divided by this ratio in all
distances. That makes the ellipsoid a ball and lengthens no distance, so all of the above applies.

``limits.tracking``, if stated, is the limit; then the distances of cables and carried objects from
other objects are included.

It follows from the bounds of the checks, which hold for all t, and the ``bodies`` of each rule.
Only pairs of drones at different heights, spans of free cables, hanging cables, and what is below
drones are bounded separately. Other checks do not enter: constant errors change no rate; forces and
shapes of displaced hitches are not bounded; cables that keep their distances do not pass through
each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hitchopt.checks.arena import ARENA, FLOOR, drone_floor_gap, drone_wall_gap
from hitchopt.checks.bodies import drones_of
from hitchopt.checks.cables import SPAN
from hitchopt.checks.certificate import Check
from hitchopt.checks.clearance import CABLE_CLEARANCE, OBJECT_CLEARANCE
from hitchopt.checks.distances import Moving, PairSpans, Shape, gap, smaller_case, smallest
from hitchopt.checks.downwash import DOWNWASH, drones_above_objects, lead
from hitchopt.checks.drones import Drones
from hitchopt.checks.hanging import cable_displacement
from hitchopt.checks.rule import CheckRule, ReportRule, SpanResult, SpanResults, WorstCase, approach
from hitchopt.checks.separation import SEPARATION
from hitchopt.checks.spans import ROUNDING, cable_names, phase_parts
from hitchopt.geometry.vectors import shortest_offset, unit
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion
from hitchopt.objects import Slab
from hitchopt.trajectory.enclosed import Bound
from hitchopt.trajectory.search import worst
from hitchopt.values import Array

GAMMA = 1.0  # Default ratio of vertex errors to drone errors

HANGING_CHECKS = (CABLE_CLEARANCE, OBJECT_CLEARANCE)  # Distances of cables that hang
HALVINGS = 40  # Bisection steps for the radius of hanging cables

NEWTON_ITERATIONS = 12
"""Iterations for the nearest point of an ellipsoid; an inexact normal only costs tightness."""

PROJECTIONS = 24  # Alternating projections onto an ellipsoid and a body, to the same effect


def flattened(requirements: Requirements) -> Requirements:
    """Return requirements whose heights the stated tracking errors divide."""
    ratio = requirements.limits.tube.ratio
    if ratio == requirements.height_ratio:
        return requirements
    return replace(requirements, height_ratio=ratio)


def _radius(motion: Motion, results: SpanResults, gamma: float) -> WorstCase:
    """Return the radius [m]; infinite if no distance is checked."""
    motion, results = _flattened_results(motion, results)
    terms = [
        WorstCase(math.inf, 0.0),
        *_slack_radii(motion, results, gamma),
        *_downwash_radii(motion, results),
        *_wall_radii(motion),
        *_span_radii(motion),
    ]
    for check, span in _hanging_spans(motion, results):
        radius = _hanging_radius(span, check)
        terms.append(WorstCase(radius, check.time, check.where, binding=check.name))
    smallest_term = min(terms, key=lambda term: term.worst)
    for result in results[SEPARATION]:
        smallest_term = _pair_radius(motion, result.check, smallest_term)
    return replace(smallest_term, worst=smallest_term.worst * (1.0 - ROUNDING))


def _flattened_results(motion: Motion, results: SpanResults) -> tuple[Motion, SpanResults]:
    """Return the flattened motion, and results with its slacks."""
    requirements = flattened(motion.requirements)
    if requirements is motion.requirements:
        return motion, results
    flat = motion.replaced(requirements=requirements)
    return flat, {**results, **{rule: rule.span_results(flat) for rule in slack_rules(results)}}


def slack_rules(rules: Iterable[CheckRule]) -> list[CheckRule]:
    """Return the rules of distances in metres, whose slack bounds the radius.

    Distances in units of ellipsoids bound it for pairs of bodies.
    """
    return [rule for rule in rules if rule.pairs and rule.unit == "m"]


def _slack_radii(motion: Motion, results: SpanResults, gamma: float) -> Iterator[WorstCase]:
    """Yield the radii [m] that follow from slacks of checks, over the approach of two bodies."""
    is_limited = bool(motion.requirements.limits.tube.level)
    for rule in slack_rules(results):
        if rule is OBJECT_CLEARANCE and not is_limited:
            continue
        for result in results[rule]:
            on_floor = rule in (ARENA, FLOOR) and result.applies(CableState.FREE)
            if on_floor or (rule in HANGING_CHECKS and _is_hanging(result)):
                continue
            hitched = result.applies(CableState.HITCHED)
            check = result.check
            radius = _slack(check) / approach(result.bodies, gamma, hitched=hitched)
            yield WorstCase(radius, check.time, check.where, binding=check.name)


def _downwash_radii(motion: Motion, results: SpanResults) -> Iterator[WorstCase]:
    """Yield the radius [m] with which drones keep off objects below them, if that is checked."""
    if results[DOWNWASH]:
        pairs = partial(drones_above_objects, motion)
        yield downwash_radius(pairs, motion.requirements, 1.0)


def _wall_radii(motion: Motion) -> Iterator[WorstCase]:
    """Yield distances [m] to walls and floor, if any, of drones that are not at rest on it."""
    for rule, distance in ((ARENA, drone_wall_gap), (FLOOR, drone_floor_gap)):
        if rule.limit_of(motion) is None:
            continue
        closest = worst(Drones.of(motion), partial(distance, on_floor=False), "min")
        drone = motion.team.drone_names[closest.item]
        radius = max(closest.worst, 0.0)
        yield WorstCase(radius, closest.time, (drone,), binding=rule.name)


def _span_radii(motion: Motion) -> Iterator[WorstCase]:
    """Yield the radii [m] with which free cables are as long as their chords."""
    for span in motion.spans(lambda state: state.slack and not state.loose):
        tightest = worst(Drones.of(span), _excess, "min")
        cable = cable_names(span)[tightest.item // 2]
        radius = max(0.5 * tightest.worst, 0.0)
        yield WorstCase(radius, tightest.time, (cable,), binding=SPAN.name)


def _hanging_spans(motion: Motion, results: SpanResults) -> Iterator[tuple[Check, Motion]]:
    """Yield the clearance of hanging cables by time span, or by phase if limited.

    In some phases they hang close to obstacles, in others they move farther with their ends.
    """
    limited = bool(motion.requirements.limits.tube.level)
    for rule in HANGING_CHECKS if limited else HANGING_CHECKS[:1]:
        hanging = [result for result in results[rule] if _is_hanging(result)]
        spans = motion.spans(hanging[0].applies) if hanging else ()
        for result, span in zip(hanging, spans, strict=True):
            if not limited or rule is not CABLE_CLEARANCE:
                yield result.check, span
                continue
            for part in phase_parts(span):
                results_of_phase = CABLE_CLEARANCE.span_results(part.motion)
                yield next(filter(_is_hanging, results_of_phase)).check, part.motion


def _slack(check: Check) -> float:
    """Return the slack of a distance beyond its limit [m]; infinite if nothing was evaluated."""
    return max(check.worst - check.number, 0.0)


def _is_hanging(result: SpanResult) -> bool:
    """Return whether cables hang in a time span: neither taut nor replaced by their chords."""
    return result.applies(CableState.FREE) and not result.applies(CableState.HITCHED)


def _excess(spans: Drones) -> Bound:
    """Return twice the radius [m] at which chords may be as long as cables: the excess length.

    If errors are larger vertically, chords grow by 2r horizontally and by ``2r ratio`` vertically.
    """
    ratio = spans.source.requirements.height_ratio
    chord = spans.partner.norm_upper
    excess = spans.length - chord.value
    if ratio == 1.0:
        return Bound(excess, chord.x)
    across = spans.partner.xy.norm_upper.value
    height = spans.partner[2].norm_upper.value
    # Chords longer by x across and by ``ratio x`` upright are as long as cables where
    # a x² + 2 b x = c; its positive root is c / (b + √(b² + a c)).
    squares = 1.0 + ratio**2
    growth = across + ratio * height
    missing = np.maximum(spans.length**2 - across**2 - height**2, 0.0)
    by_axes = missing / (growth + np.sqrt(growth * growth + squares * missing))
    return Bound(np.maximum(by_axes, excess / ratio), chord.x)


def _hanging_radius(span: Motion, check: Check) -> float:
    """Return the largest radius at which hanging cables keep their clearance [m].

    Drones approach cables by the radius; objects are at rest.
    """
    if not check.is_evaluated:
        return math.inf
    slack = _slack(check)
    displacement = cable_displacement(span)
    drone_share = 1.0 if check.name == CABLE_CLEARANCE.name else 0.0
    sufficient = 0.0
    insufficient = slack
    for _ in range(HALVINGS):
        radius = 0.5 * (sufficient + insufficient)
        if drone_share * radius + displacement(radius) <= slack:
            sufficient = radius
        else:
            insufficient = radius
    return sufficient


def _pair_radius(motion: Motion, check: Check, term: WorstCase) -> WorstCase:
    """Return the smaller of a term and the radius at which two drones may touch.

    For a ratio s, the smallest semi-axis times s - 1 is a lower bound: if it suffices, no pair is
    evaluated.
    """
    axes = ellipsoid_axes(motion.requirements)
    lower = max(0.5 * float(np.min(axes)) * (check.worst - 1.0), 0.0)
    if term.worst <= lower:
        return term
    pairs = Moving.between(motion, drones_of(motion))
    return touching_radius(pairs, motion.requirements, term, lower)


def touching_radius(
    pairs: Moving, requirements: Requirements, term: WorstCase, lower: float = 0.0
) -> WorstCase:
    """Return the smaller of a term and the radius, at least ``lower``, at which drones may touch.

    It is half of the smallest shift of the offset of a pair with which their ellipsoids touch.
    """
    ellipsoid = Ellipsoid(ellipsoid_axes(requirements))
    shifts = replace(pairs.flattened(requirements.height_ratio), shape=ellipsoid)
    pair = smallest(shifts, incumbent=2.0 * term.worst)
    closest = smaller_case(term, max(0.5 * pair.worst, lower), shifts, pair)
    return term if closest is term else replace(closest, binding=SEPARATION.name)


def ellipsoid_axes(requirements: Requirements) -> Array:
    """Return twice the semi-axes (3,) [m] of drones' ellipsoids, heights divided by their ratio."""
    axes: Array = 1.0 / requirements.separation.scale
    return axes * requirements.error_scale


@dataclass(frozen=True, eq=False)
class Ellipsoid(Shape):
    """Ellipsoid of the offsets at which two drones' ellipsoids touch, with twice their semi-axes.

    Its semi-axes are ``axes`` (3,) [m], the first two equal.
    """

    axes: Array

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m] along directions (…, 3)."""
        return np.asarray(np.linalg.norm(directions * self.axes, axis=-1))

    def normals(self, corners: Array) -> Array:
        """Return the outward normals (…, 3) nearest to points (…, 1, 3); zero for inner points.

        The nearest point is ``(a² x, b² z) / (t + (a², b²))``, with t > 0 such that it is on the
        ellipsoid. Newton's method finds t from the left, on a convex decreasing function.
        """
        offsets = corners[..., 0, :]
        level_axis = float(self.axes[0])
        upright_axis = float(self.axes[2])
        across = np.hypot(offsets[..., 0], offsets[..., 1])
        upward = np.abs(offsets[..., 2])
        is_outside = (across / level_axis) ** 2 + (upward / upright_axis) ** 2 > 1.0
        by_level = level_axis * across - level_axis * level_axis
        by_height = upright_axis * upward - upright_axis * upright_axis
        t = np.maximum(np.maximum(by_level, by_height), 0.0)
        for _ in range(NEWTON_ITERATIONS):
            level_divisor = t + level_axis * level_axis
            upright_divisor = t + upright_axis * upright_axis
            # The nearest point over the semi-axes, on the unit circle at the solution
            level = level_axis * across / level_divisor
            height = upright_axis * upward / upright_divisor
            excess = level * level + height * height - 1.0
            slope = 2.0 * (level * level / level_divisor + height * height / upright_divisor)
            t = t + np.where(is_outside, excess / np.where(is_outside, slope, 1.0), 0.0)
        normals = offsets / (t[..., None] + self.axes**2)
        return unit(np.where(is_outside[..., None], normals, 0.0))


@dataclass(frozen=True, eq=False)
class Wash(Shape):
    """A drone's ellipsoid and a slab, or none: their sum, from which drones keep clear.

    Semi-axes of the ellipsoid are ``axes`` (3,) [m], the first two equal.
    """

    slab: Slab | None
    axes: Array

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m] along directions (…, 3)."""
        reach = Ellipsoid(self.axes).support(directions)
        if self.slab is None:
            return reach
        return np.asarray(reach + self.slab.support(directions))

    def normals(self, corners: Array) -> Array:
        """Return outward normals (…, 3) nearest to hulls (…, corners, 3), by alternate projections.

        With a slab, hulls are points.
        """
        ellipsoid = Ellipsoid(self.axes)
        inner = np.zeros_like(corners[..., 0, :])
        for _ in range(PROJECTIONS):
            offsets = self._offsets(corners - inner[..., None, :]) + inner
            normals = ellipsoid.normals(offsets[..., None, :])
            is_outside = np.any(normals != 0.0, axis=-1)[..., None]
            # The ellipsoid's point with that normal; the offset itself inside
            on_surface = normals * self.axes**2 / _lengths(normals * self.axes)
            inner = np.where(is_outside, on_surface, offsets)
        return normals

    def _offsets(self, corners: Array) -> Array:
        """Return the shortest vectors (…, 3) to hulls from the slab, or from the origin."""
        if self.slab is None:
            return shortest_offset(corners)
        clearance = self.slab.clearance(corners[..., 0, :])
        return clearance.normals * np.maximum(clearance.distance, 0.0)[..., None]


def _lengths(vectors: Array) -> Array:
    """Return lengths (…, 1) of vectors (…, 3), 1 for zero vectors."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(lengths > 0.0, lengths, 1.0)


def _error(spans: PairSpans, floor: float | None = None) -> Bound:
    """Return the sum of errors [m] with which drones meet no body within their ellipsoids.

    A body that is above a drone as planned remains there up to an error by their heights.
    """
    distances = gap(spans)
    return Bound(np.maximum(distances.value, lead(spans, floor)), distances.x)


def downwash_radius(
    pairs: Callable[..., Iterable[Moving]], requirements: Requirements, approach: float
) -> WorstCase:
    """Return the largest error [m] with which drones keep clear of what their downwash would move.

    ``pairs`` yields the pairs of bodies for a scale of coordinates, a formula and a shape. These
    approach each other by ``approach`` times the error.
    """
    scale = requirements.error_scale
    axes = 0.5 * ellipsoid_axes(requirements)
    least = WorstCase(math.inf, 0.0)
    for moving in pairs(scale, formula=_error, shape=partial(Wash, axes=axes)):
        pair = smallest(moving, incumbent=least.worst * approach)
        least = smaller_case(least, max(pair.worst, 0.0) / approach, moving, pair)
    return replace(least, binding=DOWNWASH.name)


TRACKING_RADIUS = ReportRule(
    "tracking_radius",
    "m",
    "min",
    _radius,
    limit=lambda requirements: requirements.limits.tube.level or None,
    remedy="set limits.tracking to a smaller measured error",
    free_remedy="",
    group="distances",
    key="limits.tracking",
    proves="the largest error [m] of all drones at once that violates no distance "
    "({doc}`/explanation/tracking`)",
    unproven="the actual errors of your drones",
)
