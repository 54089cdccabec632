"""Which cables slide through their clasps where an action's own legs break a limit on the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.hitch.leg_lengths import measured, share
from hitchopt.planners.path.leg_law import CLEAR, PROBES, RAMP, legs_clear, sharing_task
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, legs_along
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

SLIDES = 1e-6
"""[m] A cable whose legs would change by less keeps them exactly."""

ROUNDS = ((9, 1.005), (17, 1.005), (17, 1.02), (33, 1.005), (65, 1.005))
"""Points of the path at which the sharing is chosen, and how many times their limits distances are
kept there, for what is between them; towards the ends less, which have been chosen already."""

LEG_MARGIN = 1.02
"""Legs are kept at this many times their limit at the knots."""


@dataclass(frozen=True, eq=False)
class Clearance:
    """A path whose legs keep clear, and where the law that it was given did not.

    Attributes
    ----------
    path: with as few cables sliding as possible.
    worst: s where the given law comes closest to its limits or breaks them; None where it is kept.
    """

    path: ShapePath
    worst: float | None


def cleared(path: ShapePath, requirements: Requirements, at_rest: bool) -> Clearance:
    """Return the path with legs shared so that distances hold on the way.

    As with_legs_clear, but for few cables only, and with legs a little longer than their limit at
    the knots: where they reach it, a spline would else dip below in between.

    Parameters
    ----------
    path: with the law that is wanted; returned as it is where none is found, for the certificate to
        tell what it breaks.
    kept: the distances.
    at_rest: whether s is time, so that the sharing has to start and end at rest.
    """
    if legs_clear(path, requirements):
        return Clearance(path, None)
    for count, margin in ROUNDS:
        s = np.linspace(0.0, 1.0, count)
        inward = np.minimum(np.arange(count), np.arange(count)[::-1]) / RAMP
        margins = CLEAR + (margin - CLEAR) * np.minimum(inward, 1.0)
        task = replace(
            sharing_task(path, requirements, s, margins),
            shortest_leg=LEG_MARGIN * requirements.limits.leg,
        )
        found = share(task)
        if found.margin < 1.0:
            break
        law = LegLaw.of_fractions(_spline(s, found.q_legs / task.slack, at_rest))
        changed = ShapePath(path.team, path.vertices, law, path.tensions)
        for candidate in (_few_sliding(path, changed), changed):
            if legs_clear(candidate, requirements):
                return Clearance(candidate, _worst_place(path, requirements))
    return Clearance(path, None)


def _spline(s: Array, fractions: Array, at_rest: bool) -> PiecewisePolynomial:
    """Return the quintic spline through the fractions (J, n), at rest at both ends if so wanted."""
    still = np.zeros(fractions.shape[1])
    rest = [(1, still), (2, still)]  # the stubs know of one condition an end, scipy of any
    ends = (rest, rest) if at_rest else None
    spline = make_interp_spline(s, fractions, k=5, bc_type=ends)  # type: ignore[arg-type]
    return PiecewisePolynomial.from_spline(spline)


def _few_sliding(path: ShapePath, changed: ShapePath) -> ShapePath:
    """Return the changed path with the given path's law for all cables that hardly slide."""
    s = np.linspace(0.0, 1.0, PROBES)
    away = np.abs(legs_along(changed, s) - legs_along(path, s))
    slides = np.max(away, axis=(0, 2)) > SLIDES
    breaks = changed.legs.share.breaks
    law = LegLaw(
        _chosen(slides, changed.legs.length, path.legs.length, breaks),
        _chosen(slides, changed.legs.share, path.legs.share, breaks),
    )
    return ShapePath(path.team, path.vertices, law, path.tensions)


def _chosen(
    first: NDArray[np.bool_], a: PiecewisePolynomial, b: PiecewisePolynomial, breaks: Array
) -> PiecewisePolynomial:
    """Return ``a`` for the cables where ``first`` (n,), else ``b``, on common breaks."""
    parts = [_split(part, breaks) for part in (a, b)]
    order = max(bernstein.degree(part) for part in parts)
    one, other = (bernstein.elevate(part, order) for part in parts)
    return PiecewisePolynomial(breaks, np.where(first[:, None], one, other))


def _split(part: PiecewisePolynomial, breaks: Array) -> Array:
    """Return the coefficients on ``breaks``, which refine the part's own."""
    middle = 0.5 * (breaks[:-1] + breaks[1:])
    piece = np.searchsorted(part.breaks, middle, side="right") - 1
    begin, h = part.breaks[piece], part.durations[piece]
    lower, upper = ((breaks[i : len(breaks) - 1 + i] - begin) / h for i in (0, 1))
    return bernstein.restrict(
        part.coefficients[piece],
        np.clip(lower, 0.0, 1.0)[:, None],
        np.clip(upper, 0.0, 1.0)[:, None],
    )


def _worst_place(path: ShapePath, requirements: Requirements) -> float:
    """Return s where the path's own law leaves the least of its limits, ends left out."""
    s = np.linspace(0.0, 1.0, PROBES)[1:-1]
    legs = legs_along(path, s)[:, path.team.layout.has_leg]
    shortest = np.min(legs, axis=1) / requirements.limits.leg
    apart = [measured(sharing_task(path, requirements, s[j : j + 1], CLEAR)) for j in range(len(s))]
    return float(s[int(np.argmin(np.minimum(shortest, apart)))])
