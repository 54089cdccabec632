"""How the legs' sharing changes along a path so that distances are kept all the way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.hitch.leg_lengths import measured, share
from hitchopt.hitch.leg_task import SharingTask
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, Shapes, shapes_along
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

PROBES = 65
"""Points of the path at which a law is tried before the certificate looks at all of it."""

MARGIN = 1.005
"""How many times their limits distances are kept at knots, for what is between them."""

ROUNDS = ((9, MARGIN), (17, MARGIN), (17, 1.02), (33, 1.002), (33, 1.01))
"""Points of the path at which the sharing is chosen, and the margin there."""

CLEAR = 1.0005
"""A law will do that keeps distances at this many times their limits at all probes: half of what
LIMIT_MARGIN gives to a sharing at rest, and more than the certificate's tolerance."""

RAMP = 3.0
"""Knots in which the margin rises from CLEAR, since the ends may have no more than LIMIT_MARGIN."""

ROUGHNESS = 1.0
"""[m²] How much a bend of the fractions between knots weighs against a deviation of the legs."""


def with_legs_clear(path: ShapePath, requirements: Requirements) -> ShapePath:
    """Return the path with the legs shared so that distances hold on the way.

    The path's own law is kept where it will do. Else legs are chosen at knots, all at once, nearest
    to that law's; where none is found the path is returned as it is, for the certificate to tell
    what it breaks.
    """
    if legs_clear(path, requirements):
        return path
    for count, margin in ROUNDS:
        s = np.linspace(0.0, 1.0, count)
        inward = np.minimum(np.arange(count), np.arange(count)[::-1]) / RAMP
        margins = CLEAR + (margin - CLEAR) * np.minimum(inward, 1.0)
        task = sharing_task(path, requirements, s, margins)
        found = share(task)
        if found.margin < CLEAR:
            return path
        law = LegLaw.of_fractions(_spline(s, found.q_legs / task.slack))
        changed = ShapePath(path.team, path.vertices, law, path.tensions)
        if legs_clear(changed, requirements):
            return changed
    return path


def legs_clear(path: ShapePath, requirements: Requirements) -> bool:
    """Return whether legs are long enough and distances kept at the probes."""
    s = np.linspace(0.0, 1.0, PROBES)
    shapes = shapes_along(path, s)
    legs = shapes.legs[:, path.team.layout.has_leg]
    # The ends are what was asked for; whether they hold is told apart from the way.
    long_enough = float(np.min(legs[1:-1])) >= requirements.limits.leg
    return long_enough and measured(_task(path, requirements, shapes, CLEAR)) >= CLEAR


def sharing_task(
    path: ShapePath, requirements: Requirements, s: Array, margin: float | Array
) -> SharingTask:
    """Return the task of sharing the legs at the points s (J,) of a path, the ends fixed."""
    return _task(path, requirements, shapes_along(path, s), margin)


def _task(
    path: ShapePath, requirements: Requirements, shapes: Shapes, margin: float | Array
) -> SharingTask:
    fixed = np.zeros(len(shapes.legs), dtype=np.bool_)
    fixed[[0, -1]] = True
    return SharingTask(
        path.team,
        requirements,
        shapes.polygons,
        shapes.legs[..., 0],
        requirements.limits.leg,
        margin,
        ROUGHNESS,
        fixed,
    )


def _spline(s: Array, fractions: Array) -> PiecewisePolynomial:
    """Return the quintic spline through the fractions (J, n): smooth up to the snap."""
    return PiecewisePolynomial.from_spline(make_interp_spline(s, fractions, k=5))
