"""Which cables slide through their clasps where an action's own leg lengths break a limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.hitch.leg_lengths import reference_margin
from hitchopt.planners.path.leg_law import (
    CLEAR,
    MARGIN,
    PROBES,
    laws_nearby,
    leg_task_along,
    legs_clear,
)
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, shapes_along
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splitting import on_breaks

SLIDES = 1e-6
"""[m] A cable whose legs would change by less keeps them exactly."""

ROUNDS = ((9, MARGIN), (17, MARGIN), (17, 1.02), (33, MARGIN), (65, MARGIN))
"""Numbers of points of the path at which leg lengths are chosen, and the margins there."""

LEG_MARGIN = 1.02
"""Factor on the limit of legs at the knots: where they reach it, a spline would dip below
it in between."""


@dataclass(frozen=True, eq=False)
class Clearance:
    """A path whose distances hold, and where the law that it was given breaks them.

    Attributes
    ----------
    path: with as few cables sliding as possible.
    worst: s where the given law comes closest to its limits or breaks them; None where it holds.
    """

    path: ShapePath
    worst: float | None


def cleared(path: ShapePath, requirements: Requirements, at_rest: bool) -> Clearance:
    """Return the path with leg lengths such that distances hold, few cables sliding for it.

    Parameters
    ----------
    path: with the law that is wanted; returned as it is where none is found, for the certificate to
        report what it breaks.
    requirements: distances and shortest legs.
    at_rest: whether s is time, so that cables have to start and end at rest.
    """
    if legs_clear(path, requirements):
        return Clearance(path, None)
    shortest = LEG_MARGIN * requirements.limits.leg
    for changed in laws_nearby(path, requirements, ROUNDS, shortest, 1.0, at_rest=at_rest):
        for candidate in (_few_sliding(path, changed), changed):
            if legs_clear(candidate, requirements):
                return Clearance(candidate, _worst_place(path, requirements))
    return Clearance(path, None)


def _few_sliding(path: ShapePath, changed: ShapePath) -> ShapePath:
    """Return the changed path with the given path's law for all cables that hardly slide."""
    s = np.linspace(0.0, 1.0, PROBES)
    away = np.abs(shapes_along(changed, s).legs - shapes_along(path, s).legs)
    slides = np.max(away, axis=(0, 2)) > SLIDES
    breaks = changed.legs.share.breaks

    def chosen(new: PiecewisePolynomial, old: PiecewisePolynomial) -> PiecewisePolynomial:
        order = max(new.degree, old.degree)
        one, other = (on_breaks(p, breaks).elevated(order).coefficients for p in (new, old))
        return PiecewisePolynomial(breaks, np.where(slides[:, None], one, other))

    lengths = chosen(changed.legs.length, path.legs.length)
    return replace(path, legs=LegLaw(lengths, chosen(changed.legs.share, path.legs.share)))


def _worst_place(path: ShapePath, requirements: Requirements) -> float:
    """Return s where the path's own law comes closest to its limits, without the ends."""
    s = np.linspace(0.0, 1.0, PROBES)[1:-1]
    legs = shapes_along(path, s).legs[:, path.team.layout.has_leg]
    shortest = np.min(legs, axis=1) / requirements.limits.leg
    apart = [
        reference_margin(leg_task_along(path, requirements, s[j : j + 1], CLEAR))
        for j in range(len(s))
    ]
    return float(s[int(np.argmin(np.minimum(shortest, apart)))])
