"""Checks of the cables: ``cable_length``, ``span``, ``tension``, and friction's range of pulls.

While clasped cables are being tightened, none may be overstretched before the hitch exists. From
the second swap on neighbours hold each other, so a cable is not straight between its drones: their
distance (``span``) does not suffice. Every cable must then reach around the plan's vertices, which
are possible places of the clasps: if all cables do for some places, none is taut.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.drones import Drones, edge_sags
from hitchopt.checks.objects import arc_lengths, wrapped_arcs
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
    cached_value,
    leg_vectors,
    magnitude,
    same_degree,
    without_shared_zeros,
)
from hitchopt.hitch.forces import sag_factors
from hitchopt.motion.loads import ranged_phases, saved_lengths, stated_tensions
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, Motion
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, Indices

Mask = NDArray[np.bool_]

# Relative: 0.2 mm of a cable of 2 m, well below the length of a knot or a strain of 0.5 N
LENGTH_LIMIT = 1e-4
EXPORTED_LIMIT = 1e-3  # Relative: for files that store millimetres, instead of a plan's 1e-4
# [N] A quarter of a thousandth of a usual tension, far below what a drone can measure
TENSION_LIMIT = 1e-4
SAG_SHARE = 0.2  # of the sag of a cable that is taut by itself, by which its chord may be off
RATIO_ORDER = 4  # degree of a weight over a tension: both hardly change on spans that matter
LYING = frozenset({CableState.LYING})
REST_TOLERANCE = 1e-9  # [m] Largest motion at rest


class Cables(MotionSpans):
    """Spans of cables; lengths are over the cable's own."""

    names = staticmethod(cable_names)

    @cached_property
    def scale(self) -> Array:
        """(spans, 1) [1/m] One over the cable's length."""
        return 1.0 / self.source.team.cable_length[self.item, None]

    def scaled(self, table: Array, item: Indices | None = None, noise: float = 0.0) -> Enclosed:
        """Return vectors of a table, or scalars, over the cable's length."""
        c = self.read(table, item)
        return Enclosed(c[:, None] if c.ndim == 2 else c, noise) * self.scale

    @cached_property
    def parts(self) -> list[Enclosed]:
        """The q-leg, the r-leg and the edge, or its straight parts on both sides of an arc."""
        legs, edges = leg_vectors(self.source), bent_edges(self.source)
        straight_parts = [self.scaled(legs, 2 * self.item + end, self.noise) for end in (0, 1)]
        straight = edges[:1] if self.source.contacts is None else edges
        return straight_parts + [self.scaled(edge, noise=self.noise) for edge in straight]

    @cached_property
    def excess(self) -> Enclosed:
        """Excess of the length of legs and edge over the cable's."""
        length = self.parts[0].norm + self.parts[1].norm
        for part in self.parts[2:]:
            length = length + part.norm
        if self.source.contacts is not None:
            arcs = self.read(wrapped_arcs(self.source))
            length = length + arc_lengths(arcs * self.scale[..., None])
        saved = cached_value(self.source, saved_lengths)
        return length - 1.0 if saved is None else length - self.scaled(saved) - 1.0

    @cached_property
    def sag(self) -> Enclosed:
        """Excess of spans over their chords: ``(ρ g / T)² s³ cos²α / 24`` each.

        Both straight parts of an edge sag as one.
        """
        q, r, *edges = self.parts
        edge = edges[0] if len(edges) == 1 else edges[0] + edges[1]
        sagging = q.norm * q.level.dot(q.level) + r.norm * r.level.dot(r.level)
        for part in edges:
            sagging = sagging + part.norm * edge.level.dot(edge.level)
        weight, tension = self.scalars(edge_sags(self.source))
        ratio = (weight * tension.inverse).reduced(RATIO_ORDER) * (2.0 / self.scale)
        return sagging * (ratio * ratio) * (1.0 / 24.0)


def _length_error(spans: Cables) -> Bound:
    """Return the largest of ``|leg + edge + leg - L| / L`` and of errors of the plan's legs.

    Less the sag of the whole cable, ``(ρ g L / T)² / 24``, where cables pass weight to one another.
    """
    heavy = spans.source.team.cable_density > 0.0
    excess = spans.excess + spans.sag if heavy else spans.excess
    stored = spans.scaled(spans.source.legs.coefficients)
    errors = [stored[i] - spans.parts[i].norm for i in (0, 1)]
    largest = largest_of([each.norm_above for each in (excess, *errors)])
    lying = spans.source.in_states(LYING)[spans.piece]
    if not np.any(lying):
        return largest
    team = spans.source.team
    sag = (sag_factors(team, team.tension) * team.cable_length**2)[spans.item]
    return Bound(largest.value - np.where(lying, sag, 0.0), largest.x)


def _shortfall(spans: Cables) -> Bound:
    """Return by how much a clasped cable is too short, over its length."""
    return largest_of([spans.excess.above], 0.0)


def _span_ratio(spans: Cables) -> Bound:
    """Return the distance of a cable's drones over its length."""
    drones = spans.source.drones.coefficients
    return spans.scaled(drones[:, 1::2] - drones[:, 0::2], noise=spans.noise).norm_above


def _taut_error(spans: Cables) -> Bound:
    """Return by how much the chord of a taut cable is off its length less its sag, over that.

    Beyond SAG_SHARE of the sag: its tension is then within an eighth of the team's.
    """
    team, drones = spans.source.team, spans.source.drones.coefficients
    chord = spans.scaled(drones[:, 1::2] - drones[:, 0::2], noise=spans.noise)
    sag = sag_factors(team, team.tension) * team.cable_length**2
    longer = chord.norm * chord.level.dot(chord.level) * sag[spans.item, None]
    error = (chord.norm + longer - 1.0).norm_above
    return Bound(np.maximum(error.value - SAG_SHARE * sag[spans.item], 0.0), error.x)


def _size(motion: Motion) -> float:
    return magnitude(motion) / float(np.min(motion.team.cable_length))


LENGTH_ERROR = Evaluator(
    WorstOverSpans(Cables, _length_error, "max"), HITCHED_STATE, True, (Cables.excess, Cables.sag)
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
"""Relative error of a cable's length; while being tightened, by how much it is too short; of cables
that are laid, that of their chords with the sag at the team's tension, but for a fifth of that."""

SPAN = CheckRule(
    "span",
    "1",
    "max",
    1.0,
    (Evaluator(WorstOverSpans(Cables, _span_ratio, "max", _size), FREE_STATES, exported=True),),
    "use a longer cable, a smaller polygon, or place the drones closer together",
    ease="length",
)
"""The largest distance of a free cable's drones over its length: a longer one hangs."""


@cached
def _leg_and_edge(motion: Motion) -> list[Array]:
    """Return the pull of every drone's leg, and its cable's tension [N], without shared factors."""
    tension = np.repeat(motion.tensions.coefficients, 2, axis=1)
    return without_shared_zeros([motion.pulls.coefficients, tension])


class Slides(Drones):
    """Spans of drones whose cables slide against friction."""

    @cached_property
    def held(self) -> Array:
        """(spans,) ``e^{μ θ}``, θ the least angle by which the cable wraps its clasp."""
        leaving, arriving = bent_edges(self.source)
        edges = np.stack([leaving, -arriving], axis=2).reshape(len(leaving), -1, *leaving.shape[2:])
        cosine = self.along.dot(Enclosed(self.read(edges), self.noise).direction).below.value
        turn = np.pi - np.arccos(np.clip(cosine - ROUNDING, -1.0, 1.0))
        return np.asarray(np.exp(self.source.team.cable_friction * turn))


def slips(spans: Slides) -> Bound:
    """Return the excess of a leg's pull over friction's range, relative to the tension.

    It is between ``e^{-μ θ}`` and ``e^{μ θ}`` times the edge's. A quotient of polynomials, the
    divisor positive, lies between those of their coefficients.
    """
    pull, tension = same_degree(*map(spans.read, _leg_and_edge(spans.source)))
    ratios = np.divide(pull, tension, out=np.full_like(pull, np.inf), where=tension > 0.0)
    high, low = np.max(ratios, -1) * (1.0 + ROUNDING), np.min(ratios, -1) * (1.0 - ROUNDING)
    value = np.maximum(high - spans.held, 1.0 / spans.held - low)
    return Bound(value, np.full(len(spans), 0.5))


def beyond_friction(motion: Motion) -> WorstCase:
    """Return the largest excess of a leg's pull over friction's range, relative to the tension."""
    largest = worst(Slides.of(motion), slips, "max")
    point = motion.team.layout.anchors[largest.item]
    return WorstCase(largest.worst, largest.time, (f"p{point}",))


def _find(motion: Motion, _: float) -> WorstCase:
    """Return the largest jump of a tension or thrust, or distance of a tension to its range [N].

    While the hitch exists every cable pulls with the team's tension, or within the range that its
    phase states, and on a ramp from 0 to the team's; legs within friction's range of it. Without a
    hitch tensions and pulls count as 0, whatever the plan states.
    """
    cases = [_jump_of_pulls(motion), _jump_of_thrusts(motion)]
    if np.any(motion.formed):
        ranges = np.moveaxis(stated_tensions(motion), -1, 0)
        if not np.all(motion.formed):  # ramps are next to spans without a hitch
            ranges[0] = np.where(_ramps(motion), 0.0, ranges[0])
        cases += [_outside(motion, Cables, motion.tensions.coefficients, ranges)]
        cases += [_off_at_ends(motion)]
        if motion.leg_tensions is not None:
            twice = np.repeat(ranges, 2, axis=2)
            cases += [_outside(motion, Slides, motion.pulls.coefficients, twice)]
    return max(cases, key=lambda each: each.worst)


def _jump_of_pulls(motion: Motion) -> WorstCase:
    """Return the largest jump of a cable's tension or of a leg's pull."""
    parts = motion.tensions.coefficients, motion.pulls.coefficients
    each = np.concatenate([part[..., [0, -1]] for part in parts], axis=1)
    names = [*cable_names(motion), *motion.team.drone_names]
    left, right = np.moveaxis(np.where(motion.formed[:, None, None], each, 0.0), -1, 0)
    noise = ROUNDING * (np.abs(left[1:]) + np.abs(right[:-1]))
    return worst_at_joint(np.abs(left[1:] - right[:-1]) + noise, motion.drones.breaks[1:], names)


def _jump_of_thrusts(motion: Motion) -> WorstCase:
    """Return the largest jump of a drone's thrust, by its norm."""
    (left, before), (right, after) = (end_thrusts(motion, x) for x in (0.0, 1.0))
    jumps = np.linalg.norm(left[1:] - right[:-1], axis=-1) + before[1:] + after[:-1]
    return worst_at_joint(jumps, motion.drones.breaks[1:], motion.team.drone_names)


def end_thrusts(motion: Motion, x: float) -> tuple[Array, Array]:
    """Return the thrusts (pieces, 2n, 3) [N] at a share of every piece, and errors (pieces, 2n)."""
    shape = motion.drones.pieces, motion.team.drones
    batches = [spans.at(np.full(len(spans), x)).thrust for spans in Drones.of(motion)]
    f = np.concatenate([each.c[..., 0] for each in batches]).reshape(*shape, 3)
    slop = [np.broadcast_to(each.r, len(each.c)) for each in batches]
    return f, np.concatenate(slop).reshape(shape)


def _outside(
    motion: Motion, over: type[Cables] | type[Slides], pulls: Array, ranges: Array
) -> WorstCase:
    """Return the distance of pulls (pieces, items, …) to ranges (2, pieces, items) [N]."""
    margin = ROUNDING * np.max(np.abs(pulls))

    def beyond(spans: MotionSpans) -> Bound:
        pull = Enclosed(spans.read(pulls)[:, None], margin)
        held = spans.held if isinstance(spans, Slides) else 1.0
        least, most = ranges[:, spans.piece, spans.item]
        high, low = pull.above, pull.below
        over = Bound(high.value - most * held, high.x)  # rough cables hold any number
        return largest_of([over, Bound(least / held - low.value, low.x)], 0.0)

    spans: Iterator[MotionSpans]
    spans = over.all_of(motion, motion.drones.breaks, pulls.shape[1], motion.formed)
    largest = worst(spans, beyond, "max")
    where = (over.names(motion)[largest.item],) if largest.worst > 0.0 else ()
    return WorstCase(largest.worst, largest.time, where)


def _off_at_ends(motion: Motion) -> WorstCase:
    """Return how far tensions are from the team's where phases that state a range begin or end.

    Except where an object is held before and after: the range is that of a grasp, of all its steps.
    """
    index = np.concatenate([[-1], ranged_phases(motion), [-1]])
    held = [phase.hold is not None for phase in motion.phases] or [False]
    holding = np.pad(np.array(held)[motion.phase_of_piece], 1, mode="edge")
    c, team = motion.tensions.coefficients, motion.team.tension
    off = np.zeros((motion.drones.pieces + 1, motion.team.robots))
    for end, other, shift in ((0, slice(0, -2), 0), (-1, slice(2, None), 1)):
        changes = (index[1:-1] != index[other]) & (index[1:-1] >= 0) & motion.formed
        changes &= ~(holding[1:-1] & holding[other])
        joints = np.flatnonzero(changes) + shift
        off[joints] = np.maximum(off[joints], np.abs(c[changes][..., end] - team))
    return worst_at_joint(off, motion.drones.breaks, Cables.names(motion))


def _ramps(motion: Motion) -> Mask:
    """Return (pieces, n) whether tensions rise after, or fall before, a span without a hitch.

    Nothing moves on a ramp, and it ends where the team's tension is reached.
    """
    resting, free = motion.formed, ~motion.formed
    for part in (motion.drones, motion.vertices):
        resting = resting & (
            np.max(np.ptp(part.coefficients, axis=-1), axis=(1, 2)) <= REST_TOLERANCE
        )
    ends = motion.tensions.coefficients[..., [0, -1]]
    low = motion.team.tension[:, None] - ends > TENSION_LIMIT
    ramps = np.zeros(low.shape[:2], dtype=np.bool_)
    for flip in (slice(None), slice(None, None, -1)):  # forward in time, and backward
        rests, lows = resting[flip], low[flip, :, flip]
        for first in (np.flatnonzero(rests[1:] & free[flip][:-1]) + 1).tolist():
            run = slice(first, first + int(np.argmin(np.append(rests[first:], False))))
            rising = np.logical_and.accumulate(lows[run, :, 0], axis=0)
            reached = np.any(rising & ~lows[run, :, 1], axis=0)
            ramps[flip][run] |= rising & reached
    return ramps


JUMPS_AND_RANGES = Evaluator(
    _find, FREE_STATES | HITCHED_STATE, shown=(_jump_of_pulls, _jump_of_thrusts, _outside)
)

TENSION = CheckRule("tension", "N", "max", TENSION_LIMIT, (JUMPS_AND_RANGES,), whole=True)
