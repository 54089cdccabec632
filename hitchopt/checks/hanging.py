"""Hanging cables in continuous time: how close they come to drones and the ground.

On a span of time a cable is stood in for by the points of the catenary at fixed μ, its steepness
taken from mid time and its height difference from the polynomials themselves. The catenary is never
farther from that chain than a bound on how it bends between the points, plus ¼ (L + |h|) of how far
its steepness is from that of mid time (see ``hitchopt.hitch.catenary``): the shorter the span, the
closer the chain. Of a point in time only the bends remain, a few millimetres at most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchopt.checks.certificate import within
from hitchopt.checks.distances import (
    GROUND,
    Flags,
    Ground,
    Moving,
    PairSpans,
    cable_ends,
    cable_names,
    smallest,
)
from hitchopt.checks.drones import steepness_of
from hitchopt.checks.spans import magnitude, position_margin
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import SERIES, Catenary, depth_terms, level_length, steepness
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, Indices

TOLERANCE = 1e-3
"""[m] How far ``worst`` may lie below a distance that is attained, besides what a cable's links are
off it: catenaries are no polynomials, and are closed in on only with the length of a span."""

BY_LENGTH, BY_PLACE = 20, 16
"""A chain's points: so many links of equal length, which follow a cable down its steep ends, and
so many more points evenly across, which follow it around where it is lowest. It is off them by
about 0.2 % of its length at most, where it bends the most, and much less elsewhere."""

FARTHEST = 0.25
"""[m] Pieces on which a drone may go farther are cut before anything else."""

SHIFT = 1.12
"""How far a point of a cable moves with its ends, over how far they move: at most √(1 + ¼), since
its shares in their level and upward parts differ by up to a half."""


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of segments that stand in for hanging cables on spans of time.

    Attributes
    ----------
    points: (spans, links + 1, 3, degree + 1) [m]
    off: (spans, links) [m]: the cable is nowhere farther from that segment, at no time of the span.
    """

    points: Array
    off: Array


def chains(q: Array, r: Array, length: Array) -> Chains:
    """Return the chains of cables between ends (spans, 3, degree + 1) [m], ``length`` (spans,)."""
    offset = Enclosed(r - q)
    cable = Catenary.between(Enclosed(q).middle, Enclosed(r).middle, length)
    by_length = cable.place(np.linspace(0.0, 1.0, BY_LENGTH + 1)[:, None])
    by_place = (np.arange(BY_PLACE) + 0.5)[:, None] * (2.0 / BY_PLACE) - 1.0
    evenly = np.broadcast_to(by_place, (BY_PLACE, len(length)))
    mu = np.sort(np.concatenate([by_length, evenly]), axis=0)  # (links + 1, spans)
    level, skew = depth_terms(cable.sigma, mu)
    share = (0.5 * (1.0 + mu)).T[..., None, None]
    points = q[:, None] + share * offset.c[:, None]
    points[:, :, 2] -= (length * level).T[..., None] + skew.T[..., None] * offset.c[:, None, 2]
    sigma = steepness_of(offset, length)
    drift = np.maximum(sigma.high - cable.sigma, cable.sigma - sigma.low)
    height = np.max(np.abs(offset.c[:, 2]), axis=-1)
    return Chains(points, _bends(cable, mu) + (0.25 * (length + height) * drift)[:, None])


def _bends(cable: Catenary, mu: Array) -> Array:
    """Return (spans, links) [m] how far each cable sags below its links, between points μ, midway.

    Measured in Λ / 2 sinh σ the cable is a hyperbolic cosine, farthest below its chord where it is
    parallel to it.
    """
    sigma = np.maximum(cable.sigma, SERIES)
    y = mu * sigma + np.arcsinh(cable.tilt)
    first, last = y[:-1], y[1:]
    width = np.maximum(last - first, 1e-12)
    slope = (np.cosh(last) - np.cosh(first)) / width
    touching = np.clip(np.arcsinh(slope), first, last)
    gap = np.cosh(first) + slope * (touching - first) - np.cosh(touching)
    unit = 0.5 * level_length(cable.rise, cable.length) / np.sinh(sigma)
    rounding = 2.0**-40 * cable.length
    bends: Array = (unit * np.maximum(gap, 0.0) + rounding).T
    return bends


def cut(drones: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the same curves on pieces so short that no drone goes FARTHEST on any of them."""
    reach = np.max(np.linalg.norm(np.ptp(drones.coefficients, axis=-1), axis=-1), axis=1)
    counts = np.maximum(1, np.ceil(reach / FARTHEST)).astype(np.intp)
    if np.all(counts == 1):
        return drones
    piece = np.repeat(np.arange(drones.pieces), counts)
    first = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts = drones.breaks[piece] + first / counts[piece] * drones.durations[piece]
    return on_breaks(drones, np.append(starts, drones.breaks[-1]))


def cables_and_drones(motion: Motion) -> Moving:
    """Return cables as they hang and the drones that do not carry them."""

    def foreign(cables: Indices, drones: Indices) -> Flags:
        apart: Flags = drones // 2 != cables
        return apart

    points = cut(motion.drones).coefficients[:, :, None]
    names = (cable_names(motion), motion.team.drone_names)
    return _hung(motion, names, second=points, allowed=foreign, formula=_distance)


def cables_and_ground(motion: Motion) -> Moving:
    """Return cables as they hang above the ground."""
    floor, names = motion.requirements.floor, (cable_names(motion), (GROUND,))
    second = np.zeros((cut(motion.drones).pieces, 1, 1, 3, 1))
    return _hung(motion, names, second=second, shape=Ground(floor), formula=above(floor))


def _hung(motion: Motion, names: tuple[Sequence[str], Sequence[str]], **further: Any) -> Moving:
    """Return hanging cables and what they keep off; ``further`` as in Moving."""
    drones, margin = cut(motion.drones), position_margin(motion)
    given: dict[str, Any] = {"lengths": motion.team.cable_length, "tolerance": TOLERANCE} | further
    ends = cable_ends(drones.coefficients)
    return Moving(drones.breaks, ends, margin=margin, names=names, swapped=True, **given)


def _distance(spans: PairSpans) -> Bound:
    """Return the distances of cables to points [m]."""
    ends, point = spans.ends
    hung = chains(ends[:, 0], ends[:, 1], spans.lengths)
    apart = point - hung.points  # (spans, links + 1, 3, degree + 1)
    here = Enclosed(apart).middle
    along = unit(shortest_offset(np.stack([here[:, :-1], here[:, 1:]], axis=2)))
    first, last = (np.einsum("sld,sldi->sli", along, c) for c in (apart[:, :-1], apart[:, 1:]))
    least = np.min(np.minimum(first, last) - hung.off[..., None], axis=1, keepdims=True)
    found = Enclosed(least, spans.source.margin).below
    return Bound(np.maximum(found.value, 0.0), found.x)


def above(top: float) -> Callable[[PairSpans], Bound]:
    """Return the formula of how far hanging cables are above a height [m]."""

    def formula(spans: PairSpans) -> Bound:
        ends, _ = spans.ends
        hung = chains(ends[:, 0], ends[:, 1], spans.lengths)
        z = hung.points[:, :, 2]
        lower = np.minimum(z[:, 1:], z[:, :-1]) - hung.off[..., None]
        height = Enclosed(np.min(lower, axis=1, keepdims=True)) - top
        return height.widened(spans.source.margin).below

    return formula


def above_ground(motion: Motion) -> bool:
    """Return whether cables, if all hung free, would keep ``separation.cable`` off the ground."""
    limit = motion.requirements.separation.cable
    least = smallest(cables_and_ground(motion), relative=TOLERANCE, absolute=TOLERANCE)
    return least.worst >= within(limit, "min", magnitude(motion))


def moved_by(motion: Motion) -> Callable[[float], float]:
    """Return how much nearer [m] drones and hanging cables come if every drone is off by r [m].

    A point of a cable (at μ, see ``hitchopt.hitch.catenary``) moves with its two ends, across by
    shares ``(1 ± μ)/2`` of them, upward by ``(1 ± sinh μσ / sinh σ)/2``, and by ¼ (L + |h|) per
    change of σ at most. That follows from ``(coth σ - 1/σ) dσ = d ln(Λ/s)``, where s and h change
    by 2r at most.
    """
    ends, L = cable_ends(cut(motion.drones).coefficients), motion.team.cable_length
    offset = Enclosed(ends[:, :, 1] - ends[:, :, 0])
    across, height = offset.level.norm_range, offset[2].norm_above.value

    def moved(radius: float) -> float:
        closer, higher = across.low - 2.0 * radius, height + 2.0 * radius
        if np.any(closer <= 0.0) or np.any(higher >= L):
            return np.inf
        flattest = steepness(level_length(higher, L) / (across.high + 2.0 * radius))
        if np.any(flattest < SERIES):  # nearly taut: how deep it hangs changes without a bound
            return np.inf
        ratio = np.log(across.low / closer)
        ratio = ratio + np.log(level_length(height, L) / level_length(higher, L))
        steeper = ratio / (1.0 / np.tanh(flattest) - 1.0 / flattest)
        return radius + SHIFT * radius + float(np.max(0.25 * (L + higher) * steeper))

    return moved
