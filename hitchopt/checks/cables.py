"""Checks of the cables: ``cable_length``, ``span``, ``tension``, and the range of friction.

While clasped cables are being tightened, none may be overstretched before the hitch exists. From
the second swap on, neighbours hold each other, so a cable is not straight between its drones, and
their distance (``span``) does not suffice. Every cable must then reach around the plan's vertices:
if all cables do for some positions of the clasps, none is taut.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.drones import Drones, edge_sags
from hitchopt.checks.objects import arc_lengths, select, wrapped_arcs
from hitchopt.checks.rule import (
    CheckRule,
    Evaluator,
    WorstCase,
    WorstOverSpans,
    worst_at_joint,
)
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    bent_edges,
    cable_names,
    cached,
    joined_arrays,
    leg_vectors,
    magnitude,
    without_shared_zeros,
)
from hitchopt.geometry.vectors import length
from hitchopt.hitch.forces import sag_factors
from hitchopt.motion.loads import ranged_phases, saved_lengths, stated_tensions
from hitchopt.motion.motion import FREE_STATES, TAUT_STATES, CableState, Motion
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, lazy

Mask = NDArray[np.bool_]

# Relative: 0.2 mm of a cable of 2 m, well below the length of a knot or a strain of 0.5 N
LENGTH_LIMIT = 1e-4
EXPORTED_LIMIT = 1e-3  # Relative: for files that store millimetres
# [N] A quarter of a thousandth of a usual tension, far below what a drone can measure
TENSION_LIMIT = 1e-4
SAG_SHARE = 0.2  # largest error of the chord of a laid cable, relative to its sag
RATIO_ORDER = 4  # degree of a weight over a tension: both hardly change on spans that matter


_saved_lengths = cached(saved_lengths)


class Cables(MotionSpans):
    """Spans of cables; lengths are relative to the cable's length."""

    names = staticmethod(cable_names)

    @lazy
    def scale(self) -> Array:
        """(spans, 1) [1/m] Inverse of the cable's length."""
        return 1.0 / self.source.team.cable_length[self.item, None]

    def scaled(self, table: Array, noise: float = 0.0) -> Enclosed:
        """Return vectors or scalars of a table, relative to the cable's length."""
        c = self.read(table)
        return Enclosed(c[:, None] if c.ndim == 2 else c, noise) * self.scale

    @lazy
    def parts(self) -> Enclosed:
        """The q-leg, the r-leg, and the edge or its straight parts at an arc (spans, 3 or 4)."""
        return Enclosed(self.read(_parts(self.source)), self.noise) * self.scale[:, None]

    @lazy
    def excess(self) -> Enclosed:
        """Excess of the length of legs and edge over the cable's length."""
        length = self.parts.norm.sum()
        if self.source.has_wraps:
            arcs = self.read(wrapped_arcs(self.source))
            length = length + arc_lengths(arcs * self.scale[..., None])
        savings = _saved_lengths(self.source)
        return length - 1.0 if savings is None else length - self.scaled(savings) - 1.0

    @lazy
    def sag(self) -> Enclosed:
        """Excess of the cable over its chords: ``(ρ g / T)² s³ cos²α / 24`` for each.

        Both straight parts of an edge sag as one.
        """
        chords = self.parts
        if self.source.has_wraps:
            whole = Enclosed(self.read(_parts(self.source, True)), 2.0 * self.noise)
            chords = whole * self.scale[:, None]
        sag_sum = (self.parts.norm * chords.xy.dot(chords.xy)).sum()
        weight, tension = self.scalars(edge_sags(self.source))
        ratio = (weight * tension.inverse).reduced(RATIO_ORDER) * (2.0 / self.scale)
        return sag_sum * (ratio * ratio) * (1.0 / 24.0)


@cached
def _parts(motion: Motion, whole: bool = False) -> Array:
    """Return the parts of cables (pieces, n, 3 or 4, 3, N+1) [m] as in ``Cables.parts``.

    With ``whole``, both straight parts of an edge are their sum.
    """
    legs, edges = leg_vectors(motion), bent_edges(motion)
    edges = (edges[0] + edges[1],) * 2 if whole else edges
    rows = legs[:, 0::2], legs[:, 1::2], *(edges if motion.has_wraps else edges[:1])
    return joined_arrays([row[:, :, None] for row in rows], axis=2)


def _length_error(spans: Cables) -> Bound:
    """Return the largest of ``|leg + edge + leg - L| / L`` and of errors of the plan's legs."""
    has_weight = spans.source.team.cable_density > 0.0
    excess = spans.excess + spans.sag if has_weight else spans.excess
    stored = Enclosed(spans.read(spans.source.legs.coefficients)[:, :, None]) * spans.scale[:, None]
    errors = (stored - select(spans.parts.norm, [0, 1])).norm_upper
    each = [Bound(errors.value[:, i], errors.x[:, i]) for i in (0, 1)]
    return largest_of([excess.norm_upper, *each])


def _shortfall(spans: Cables) -> Bound:
    """Return the relative length that a clasped cable lacks."""
    return largest_of([spans.excess.upper], 0.0)


def _span_ratio(spans: Cables) -> Bound:
    """Return the distance of a cable's drones over its length."""
    drones = spans.source.drones.coefficients
    return spans.scaled(drones[:, 1::2] - drones[:, 0::2], noise=spans.noise).norm_upper


def _taut_error(spans: Cables) -> Bound:
    """Return the relative error of the chord of a laid cable, beyond SAG_SHARE of its sag.

    The error is relative to the length with the sag at the team's tension. Within SAG_SHARE, the
    tension is within an eighth of the team's.
    """
    team, drones = spans.source.team, spans.source.drones.coefficients
    chord = spans.scaled(drones[:, 1::2] - drones[:, 0::2], noise=spans.noise)
    sag = sag_factors(team, team.tension) * team.cable_length**2
    sag_excess = chord.norm * chord.xy.dot(chord.xy) * sag[spans.item, None]
    error = (chord.norm + sag_excess - 1.0).norm_upper
    return Bound(np.maximum(error.value - SAG_SHARE * sag[spans.item], 0.0), error.x)


def _size(motion: Motion) -> float:
    return magnitude(motion) / float(np.min(motion.team.cable_length))


LENGTH_ERROR = Evaluator(
    WorstOverSpans(Cables, _length_error, "max"), TAUT_STATES, True, (Cables.excess, Cables.sag)
)

CABLE_LENGTH = CheckRule(
    "cable_length",
    "1",
    "max",
    LENGTH_LIMIT,
    (
        LENGTH_ERROR,
        Evaluator(WorstOverSpans(Cables, _shortfall, "max"), frozenset({CableState.TIGHTENING})),
        Evaluator(WorstOverSpans(Cables, _taut_error, "max"), frozenset({CableState.LAYING})),
    ),
    free_remedy="use a longer cable, or a smaller polygon",
    ease="length",
    exported_limit=EXPORTED_LIMIT,
)
"""Relative error of a cable's length; during tightening, the missing length; of laid cables, the
error of their chords beyond a fifth of their sag."""

SPAN = CheckRule(
    "span",
    "1",
    "max",
    1.0,
    (Evaluator(WorstOverSpans(Cables, _span_ratio, "max", _size), FREE_STATES, exported=True),),
    "use a longer cable, a smaller polygon, or place the drones closer together",
    ease="length",
)
"""Largest distance of a free cable's drones over its length: below 1, it hangs."""


@cached
def _leg_and_edge(motion: Motion) -> list[Array]:
    """Return the pull of every drone's leg, and its cable's tension [N], without common zeros."""
    tension = np.repeat(motion.tensions.coefficients, 2, axis=1)
    pairs = without_shared_zeros([motion.pulls.coefficients[:, :, None], tension[:, :, None]])
    return [each[:, :, 0] for each in pairs]


class FrictionLegs(Drones):
    """Spans of all legs, each by its drone, with the friction of their cables at the clasps."""

    @lazy
    def friction_ratio(self) -> Array:
        """(spans,) ``e^{μ θ}``, θ the smallest wrap angle of the cable at its clasp."""
        leaving, arriving = bent_edges(self.source)
        edges = np.stack([leaving, -arriving], axis=2).reshape(len(leaving), -1, *leaving.shape[2:])
        cosine = self.along.dot(Enclosed(self.read(edges), self.noise).direction).lower.value
        turn = np.pi - np.arccos(np.clip(cosine - ROUNDING, -1.0, 1.0))
        return np.asarray(np.exp(self.source.team.cable_friction * turn))


def leg_excess(spans: FrictionLegs) -> Bound:
    """Return the excess of a leg's pull over the range of friction, relative to the tension.

    The range is from ``e^{-μ θ}`` to ``e^{μ θ}`` times the edge's pull. A quotient of polynomials
    with a positive divisor lies between the quotients of their coefficients.
    """
    pull, tension = same_degree(*map(spans.read, _leg_and_edge(spans.source)))
    ratios = np.divide(pull, tension, out=np.full_like(pull, np.inf), where=tension > 0.0)
    highest, lowest = np.max(ratios, -1) * (1.0 + ROUNDING), np.min(ratios, -1) * (1.0 - ROUNDING)
    value = np.maximum(highest - spans.friction_ratio, 1.0 / spans.friction_ratio - lowest)
    return Bound(value, np.full(len(spans), 0.5))


def friction_excess(motion: Motion) -> WorstCase:
    """Return the largest excess of a leg's pull over the range of friction (``leg_excess``)."""
    largest = worst(FrictionLegs.of(motion), leg_excess, "max")
    point = motion.team.layout.anchors[largest.item]
    return WorstCase(largest.worst, largest.time, (f"p{point}",))


def _worst_tension(motion: Motion, _: float) -> WorstCase:
    """Return the largest jump of a tension or thrust, or distance of a tension to its range [N].

    While the hitch exists, every cable has the team's tension, or one in the range of its phase, or
    on a ramp one from 0 to the smallest of that range. Pulls of legs are within the range of
    friction. Without a hitch, tensions and pulls count as 0.
    """
    cases = [_pull_jump(motion), _thrust_jump(motion)]
    if np.any(motion.taut):
        ranges = np.moveaxis(stated_tensions(motion), -1, 0)
        if not np.all(motion.taut):  # ramps are next to spans without a hitch
            ramps = _ramps(motion)
            ranges = np.where(ramps, [np.zeros_like(ranges[0]), ranges[0]], ranges)
        cases += [_out_of_range(motion, Cables, motion.tensions.coefficients, ranges)]
        cases += [_end_deviation(motion)]
        if motion.has_friction:
            twice = np.repeat(ranges, 2, axis=2)
            cases += [_out_of_range(motion, FrictionLegs, motion.pulls.coefficients, twice)]
    return max(cases, key=lambda each: each.worst)


def _pull_jump(motion: Motion) -> WorstCase:
    """Return the largest jump of a cable's tension or of a leg's pull."""
    parts = motion.tensions.coefficients, motion.pulls.coefficients
    each = np.concatenate([part[..., [0, -1]] for part in parts], axis=1)
    names = [*cable_names(motion), *motion.team.drone_names]
    left, right = np.moveaxis(np.where(motion.taut[:, None, None], each, 0.0), -1, 0)
    noise = ROUNDING * (np.abs(left[1:]) + np.abs(right[:-1]))
    return worst_at_joint(np.abs(left[1:] - right[:-1]) + noise, motion.drones.breaks[1:], names)


def _thrust_jump(motion: Motion) -> WorstCase:
    """Return the largest jump of a drone's thrust, by its norm."""
    (left, right), (before, after) = end_thrusts(motion)
    jumps = length(left[1:] - right[:-1]) + before[1:] + after[:-1]
    return worst_at_joint(jumps, motion.drones.breaks[1:], motion.team.drone_names)


def end_thrusts(motion: Motion) -> tuple[Array, Array]:
    """Return thrusts (2, pieces, 2n, 3) [N] at starts and ends of all pieces, and their errors."""
    shape, parts = (2, motion.drones.pieces, motion.team.drones), list[Array]()
    for spans in Drones.of(motion):
        count = len(spans)
        x, index = np.repeat([0.0, 1.0], count), np.tile(np.arange(count), 2)
        thrust = spans.at(x, index).thrust
        errors = np.broadcast_to(thrust.r, 2 * count)
        parts.append(np.column_stack([thrust.c[..., 0], errors]).reshape(2, count, 4))
    each = np.concatenate(parts, axis=1).reshape(*shape, 4)
    return each[..., :3], each[..., 3]


def _out_of_range(
    motion: Motion, spans_type: type[Cables] | type[FrictionLegs], pulls: Array, ranges: Array
) -> WorstCase:
    """Return the distance of pulls (pieces, items, …) to ranges (2, pieces, items) [N]."""
    margin = ROUNDING * np.max(np.abs(pulls))

    def excess(spans: MotionSpans) -> Bound:
        pull = Enclosed(spans.read(pulls)[:, None], margin)
        friction = spans.friction_ratio if isinstance(spans, FrictionLegs) else 1.0
        smallest, largest = ranges[:, spans.piece, spans.item]
        high, low = pull.upper, pull.lower
        over = Bound(high.value - largest * friction, high.x)
        return largest_of([over, Bound(smallest / friction - low.value, low.x)], 0.0)

    spans: Iterator[MotionSpans]
    spans = spans_type.all_of(motion, motion.drones.breaks, pulls.shape[1], motion.taut)
    largest = worst(spans, excess, "max")
    where = (spans_type.names(motion)[largest.item],) if largest.worst > 0.0 else ()
    return WorstCase(largest.worst, largest.time, where)


def _end_deviation(motion: Motion) -> WorstCase:
    """Return the distance of tensions from the team's at ends of phases that state a range.

    Ends at which an object is held before and after are excluded: all steps of a grasp share its
    range. So are bent cables, which are held by the tension at which they are tied.
    """
    index = np.concatenate([[-1], ranged_phases(motion), [-1]])
    holds = [phase.hold is not None for phase in motion.phases] or [False]
    holding = np.pad(np.array(holds)[motion.phase_of_piece], 1, mode="edge")
    c, team = motion.tensions.coefficients, motion.team.tension
    bent = motion.in_states(frozenset({CableState.BENT}))
    deviation = np.zeros((motion.drones.pieces + 1, motion.team.robots))
    for end, other, shift in ((0, slice(0, -2), 0), (-1, slice(2, None), 1)):
        changes = (index[1:-1] != index[other]) & (index[1:-1] >= 0) & motion.taut
        changes &= ~(holding[1:-1] & holding[other]) & ~bent
        joints = np.flatnonzero(changes) + shift
        deviation[joints] = np.maximum(deviation[joints], np.abs(c[changes][..., end] - team))
    return worst_at_joint(deviation, motion.drones.breaks, Cables.names(motion))


def _ramps(motion: Motion) -> Mask:
    """Return on which pieces tensions ramp up after, or down before, a span without a hitch.

    The mask is (pieces, n).
    """
    resting, unhitched = motion.taut, ~motion.taut
    for part in (motion.drones, motion.vertices):
        resting = resting & (np.max(np.ptp(part.coefficients, axis=-1), axis=(1, 2)) <= REST_DRIFT)
    ends = motion.tensions.coefficients[..., [0, -1]]
    lowest = stated_tensions(motion)[..., 0]
    is_low = lowest[..., None] - ends > TENSION_LIMIT
    low_at_start, low_at_end = is_low[..., 0], is_low[..., 1]
    rising = _rising(resting, unhitched, low_at_start, low_at_end)
    # A tension that falls rises backward in time.
    falling = _rising(resting[::-1], unhitched[::-1], low_at_end[::-1], low_at_start[::-1])[::-1]
    return rising | falling


def _rising(resting: Mask, unhitched: Mask, low_at_start: Mask, low_at_end: Mask) -> Mask:
    """Return on which pieces tensions ramp up after a span without a hitch (pieces, n).

    Nothing moves on a ramp, and it ends at the smallest tension that its phase states, from which
    on cables are taut.

    Parameters
    ----------
    resting, unhitched: (pieces,), whether nothing moves, and whether there is no hitch.
    low_at_start, low_at_end: (pieces, n), whether the tension is below the smallest one there.
    """
    ramps = np.zeros_like(low_at_start)
    for first in (np.flatnonzero(resting[1:] & unhitched[:-1]) + 1).tolist():
        moving = np.flatnonzero(~resting[first:])
        stop = first + int(moving[0]) if len(moving) else len(resting)
        always_low = np.logical_and.accumulate(low_at_start[first:stop], axis=0)
        reaches_smallest = np.any(always_low & ~low_at_end[first:stop], axis=0)
        ramps[first:stop] = always_low & reaches_smallest
    return ramps


JUMPS_AND_RANGES = Evaluator(
    _worst_tension, FREE_STATES | TAUT_STATES, formulas=(_pull_jump, _thrust_jump, _out_of_range)
)

TENSION = CheckRule("tension", "N", "max", TENSION_LIMIT, (JUMPS_AND_RANGES,), whole=True)
