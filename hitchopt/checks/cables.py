"""Checks of the cables: ``cable_length``, ``span`` and ``tension``.

While clasped cables are being tightened, none may be overstretched before the hitch exists. From
the second swap on, neighbours hold each other, so a cable is not straight between its drones, and
their distance (``span``) does not suffice. Every cable must then reach around the plan's vertices:
if all cables do for some positions of the clasps, none is taut.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.drone_forces import SagTerms, edge_sags, leg_sags
from hitchopt.checks.drones import Drones
from hitchopt.checks.friction import FrictionLegs
from hitchopt.checks.grips import arc_lengths, wrapped_arcs
from hitchopt.checks.objects import select
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, WorstOverSpans, worst_at_joint
from hitchopt.checks.sagging import sagging_part
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    bent_edges,
    cable_names,
    cached,
    joined_arrays,
    leg_vectors,
    magnitude,
)
from hitchopt.geometry.vectors import length
from hitchopt.motion.loads import ranged_phases, saved_lengths, stated_tensions
from hitchopt.motion.motion import Motion
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, lazy

Mask = NDArray[np.bool_]

LENGTH_LIMIT = 1e-4
"""Largest relative error of a cable's length: 0.2 mm of a cable of 2 m, well below the length of a
knot or a strain of 0.5 N."""

EXPORTED_SHARE = 10.0  # The same limit for files, which store millimetres, over that for plans

TENSION_LIMIT = 1e-4
"""[N] Largest error of a tension: a quarter of a thousandth of a usual one, far below what a drone
can measure."""


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
        values = self.read(table)
        if values.ndim == 2:
            values = values[:, None]
        return Enclosed(values, noise) * self.scale

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
        if savings is not None:
            length = length - self.scaled(savings)
        return length - 1.0

    @lazy
    def sag(self) -> Enclosed:
        """Excess of the cable over its chords; both straight parts of an edge sag as one."""
        terms = [Enclosed(self.read(table)[:, :, None]) for table in _sag_terms(self.source)]
        half_density, tension = terms
        of_parts = half_density * tension.inverse * (1.0 / self.scale[:, None])
        if not self.source.has_wraps:
            cables: Enclosed = sagging_part(self.parts, of_parts).length
            exists = self.source.team.layout.exists[self.item][:, [0, 2, 1], None]
            return ((cables - self.parts.norm) * exists.astype(np.float64)).sum()
        whole = Enclosed(self.read(_parts(self.source, True)), 2.0 * self.noise)
        chords = whole * self.scale[:, None]
        cables = sagging_part(chords, of_parts).length
        return (self.parts.norm * (cables * chords.norm.inverse - 1.0)).sum()


@cached
def _sag_terms(motion: Motion) -> SagTerms:
    """Return the terms of the parts of cables (pieces, n, 3 or 4, N+1) as in ``Cables.parts``."""
    tables = list[Array]()
    for legs, edges in zip(leg_sags(motion), edge_sags(motion), strict=True):
        of_legs = legs.reshape(len(legs), -1, 2, legs.shape[-1])
        of_edges = edges[:, :, None]
        tables.append(joined_arrays([of_legs, *[of_edges] * (1 + motion.has_wraps)], axis=2))
    return SagTerms(*tables)


@cached
def _parts(motion: Motion, whole: bool = False) -> Array:
    """Return the parts of cables (pieces, n, 3 or 4, 3, N+1) [m] as in ``Cables.parts``.

    With ``whole``, both straight parts of an edge are their sum.
    """
    legs = leg_vectors(motion)
    leaving, arriving = bent_edges(motion)
    if not motion.has_wraps:
        edges = [leaving]
        if not motion.team.layout.closed:  # from its clasp, where the tension is known
            edges = [np.concatenate([-leaving[:, :1], leaving[:, 1:]], axis=1)]
    elif whole:
        edges = [leaving + arriving, leaving + arriving]
    else:
        edges = [leaving, arriving]
    parts = [legs[:, 0::2], legs[:, 1::2], *edges]
    return joined_arrays([part[:, :, None] for part in parts], axis=2)


def _length_error(spans: Cables) -> Bound:
    """Return the largest of ``|leg + edge + leg - L| / L`` and of errors of the plan's legs.

    While tensions rise or fall, cables have the shape of the smallest stated tension: longer than
    their straight parts, and as long as their drones will pull them.
    """
    excess = spans.excess
    if spans.source.team.cable_density > 0.0:
        excess = excess + spans.sag
    plan_legs = spans.read(spans.source.legs.coefficients)[:, :, None]
    relative_legs = Enclosed(plan_legs) * spans.scale[:, None]
    chords_of_q_and_r = select(spans.parts.norm, [0, 1])
    errors = (relative_legs - chords_of_q_and_r).norm_upper
    q_error = Bound(errors.value[:, 0], errors.x[:, 0])
    r_error = Bound(errors.value[:, 1], errors.x[:, 1])
    return largest_of([excess.norm_upper, q_error, r_error])


def _shortfall(spans: Cables) -> Bound:
    """Return the relative length that a clasped cable lacks."""
    return largest_of([spans.excess.upper], 0.0)


def _span_ratio(spans: Cables) -> Bound:
    """Return the distance of a cable's drones over its length."""
    drones = spans.source.drones.coefficients
    return spans.scaled(drones[:, 1::2] - drones[:, 0::2], noise=spans.noise).norm_upper


def _size(motion: Motion) -> float:
    """Return the largest coordinate of a motion over its shortest cable."""
    return magnitude(motion) / float(np.min(motion.team.cable_length))


LENGTH_ERROR = Evaluator(
    WorstOverSpans(Cables, _length_error, "max"),
    lambda state: state.hitched,
    True,
    (Cables.excess, Cables.sag),
)

CABLE_LENGTH = CheckRule(
    "cable_length",
    "ratio",
    "max",
    LENGTH_LIMIT,
    (
        LENGTH_ERROR,
        Evaluator(WorstOverSpans(Cables, _shortfall, "max"), lambda state: state.tightening),
    ),
    free_remedy="use a longer cable",
    ease="length",
    group="cables",
    bodies=(("cables",),),
    is_error=True,
    proves="the largest relative error of a cable's length: 1e-4 is 0.2 mm of 2 m",
    unproven="how far it stretches",
    exported_share=EXPORTED_SHARE,
)
"""Relative error of a cable's length; during tightening, the missing length."""

SPAN = CheckRule(
    "span",
    "ratio",
    "max",
    1.0,
    (
        Evaluator(
            WorstOverSpans(Cables, _span_ratio, "max", _size),
            lambda state: state.slack,
            exported=True,
        ),
    ),
    "use a longer cable",
    ease="length",
    group="cables",
    bodies=(("cables",),),
    proves="the largest distance between the drones of a free cable, over its length",
    unproven="what lies between them",
)
"""Largest distance of a free cable's drones over its length: below 1, it hangs."""


def _worst_tension(motion: Motion, _: float) -> WorstCase:
    """Return the largest jump of a tension or thrust, or distance of a tension to its range [N].

    While the hitch exists, every cable has the team's tension, or one in the range of its phase, or
    on a ramp one from 0 to the smallest of that range, as while it is tightened. Pulls of legs are
    within the range of friction. In other states, tensions and pulls count as 0.
    """
    cases = [_pull_jump(motion), _thrust_jump(motion)]
    if np.any(motion.pulling):
        ranges = _tension_ranges(motion)
        cases.append(_out_of_range(motion, Cables, motion.tensions.coefficients, ranges))
        cases.append(_end_deviation(motion))
        if motion.leg_tensions_differ:
            of_legs = np.repeat(ranges, 2, axis=2)
            cases.append(_out_of_range(motion, FrictionLegs, motion.pulls.coefficients, of_legs))
    return max(cases, key=lambda case: case.worst)


def _tension_ranges(motion: Motion) -> Array:
    """Return the smallest and the largest admissible tensions (2, pieces, n) [N]."""
    smallest, largest = np.moveaxis(stated_tensions(motion), -1, 0)
    if not np.all(motion.formed):  # ramps are next to spans without a hitch
        ramps = _ramps(motion)
        largest = np.where(ramps, smallest, largest)
        smallest = np.where(ramps, 0.0, smallest)
    return np.stack([smallest, largest])


def _pull_jump(motion: Motion) -> WorstCase:
    """Return the largest jump of a cable's tension or of a leg's pull."""
    curves = motion.tensions.coefficients, motion.pulls.coefficients
    end_values = np.concatenate([curve[..., [0, -1]] for curve in curves], axis=1)
    end_values = np.where(motion.pulling[:, None, None], end_values, 0.0)
    at_start = end_values[..., 0]
    at_end = end_values[..., 1]
    noise = ROUNDING * (np.abs(at_start[1:]) + np.abs(at_end[:-1]))
    jumps = np.abs(at_start[1:] - at_end[:-1]) + noise
    names = [*cable_names(motion), *motion.team.drone_names]
    return worst_at_joint(jumps, motion.drones.breaks[1:], names)


def _thrust_jump(motion: Motion) -> WorstCase:
    """Return the largest jump of a drone's thrust, by its norm."""
    (at_start, at_end), (start_error, end_error) = end_thrusts(motion)
    jumps = length(at_start[1:] - at_end[:-1]) + start_error[1:] + end_error[:-1]
    return worst_at_joint(jumps, motion.drones.breaks[1:], motion.team.drone_names)


def end_thrusts(motion: Motion) -> tuple[Array, Array]:
    """Return thrusts (2, pieces, 2n, 3) [N] at starts and ends of all pieces, and their errors."""
    thrusts = list[Array]()
    errors = list[Array]()
    for spans in Drones.of(motion):
        count = len(spans)
        both_ends = np.repeat([0.0, 1.0], count)
        thrust = spans.at(both_ends, np.tile(np.arange(count), 2)).thrust
        thrusts.append(thrust.c[..., 0].reshape(2, count, 3))
        errors.append(np.broadcast_to(thrust.r, 2 * count).reshape(2, count))
    shape = (2, motion.drones.pieces, motion.team.drones)
    return (
        np.concatenate(thrusts, axis=1).reshape(*shape, 3),
        np.concatenate(errors, axis=1).reshape(shape),
    )


def _out_of_range(
    motion: Motion, spans_type: type[Cables] | type[FrictionLegs], pulls: Array, ranges: Array
) -> WorstCase:
    """Return the distance of pulls (pieces, items, …) to ranges (2, pieces, items) [N]."""
    margin = ROUNDING * np.max(np.abs(pulls))

    def excess(spans: MotionSpans) -> Bound:
        pull = Enclosed(spans.read(pulls)[:, None], margin)
        friction = spans.friction_ratio if isinstance(spans, FrictionLegs) else 1.0
        smallest, largest = ranges[:, spans.piece, spans.item]
        high = pull.upper
        low = pull.lower
        above = Bound(high.value - largest * friction, high.x)
        below = Bound(smallest / friction - low.value, low.x)
        return largest_of([above, below], 0.0)

    spans: Iterator[MotionSpans]
    spans = spans_type.all_of(motion, motion.drones.breaks, pulls.shape[1], motion.pulling)
    largest = worst(spans, excess, "max")
    where = (spans_type.names(motion)[largest.item],) if largest.worst > 0.0 else ()
    return WorstCase(largest.worst, largest.time, where)


def _end_deviation(motion: Motion) -> WorstCase:
    """Return the distance of tensions from the team's at ends of phases that state a range.

    Ends at which an object is held before and after are excluded: all steps of a grasp share its
    range.
    """
    ranged = np.concatenate([[-1], ranged_phases(motion), [-1]])  # with none before and after
    holding = np.pad(motion.holding, 1, mode="edge")
    states_range = (ranged[1:-1] >= 0) & motion.formed
    errors = np.abs(motion.tensions.coefficients[..., [0, -1]] - motion.team.tension[:, None])
    deviations = np.zeros((motion.drones.pieces + 1, motion.team.robots))
    for end, neighbour in ((0, slice(0, -2)), (1, slice(2, None))):
        changes = (ranged[1:-1] != ranged[neighbour]) & states_range
        changes &= ~(holding[1:-1] & holding[neighbour])
        pieces = np.flatnonzero(changes)
        joints = pieces + end
        deviations[joints] = np.maximum(deviations[joints], errors[pieces, :, end])
    return worst_at_joint(deviations, motion.drones.breaks, Cables.names(motion))


def _ramps(motion: Motion) -> Mask:
    """Return on which pieces tensions ramp up after, or down before, a span without a hitch.

    The mask is (pieces, n). Cables are on a ramp, too, while they are tightened.
    """
    resting = motion.formed
    for curve in (motion.drones, motion.vertices):
        travel = np.max(np.ptp(curve.coefficients, axis=-1), axis=(1, 2))
        resting = resting & (travel <= REST_DRIFT)
    unhitched = ~motion.formed
    smallest = stated_tensions(motion)[..., 0]
    tensions = motion.tensions.coefficients
    low_at_start = smallest - tensions[..., 0] > TENSION_LIMIT
    low_at_end = smallest - tensions[..., -1] > TENSION_LIMIT
    rising = _rising(resting, unhitched, low_at_start, low_at_end)
    # A tension that falls rises backward in time.
    falling = _rising(resting[::-1], unhitched[::-1], low_at_end[::-1], low_at_start[::-1])[::-1]
    tightened = motion.in_states(lambda state: state.tightening)
    return rising | falling | tightened[:, None]


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
    _worst_tension,
    lambda state: state.has_cables,
    formulas=(_pull_jump, _thrust_jump, _out_of_range),
)

TENSION = CheckRule(
    "tension",
    "N",
    "max",
    TENSION_LIMIT,
    (JUMPS_AND_RANGES,),
    whole=True,
    group="forces",
    bodies=(("cables",),),
    is_error=True,
    proves="the largest jump [N] of a tension, pull or thrust, or distance of a tension from its "
    "range, for legs widened by friction",
    unproven="the real pull, which depends on stiffness: `hitchopt statics`",
)
