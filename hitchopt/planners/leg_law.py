"""How the legs' sharing changes along a path so that distances are kept all the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.hitch import Arena, Limits, Separation
from hitchopt.hitch.sharing import SharingTask, measured, share
from hitchopt.planners.path import StraightPath
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

PROBES = 65
"""Points of the path at which a law is tried before the certificate looks at all of it."""

KNOTS = (9, 17, 33)
"""Points of the path at which the sharing is chosen, more where fewer do not do."""

MARGIN = 1.005
"""Distances are kept at this many times their limits at the knots, for what is between them."""

CLEAR = 1.0005
"""A law will do that keeps distances at this many times their limits at all probes."""

ROUGHNESS = 1.0
"""[m²] How much a bend of the fractions between knots weighs against a deviation of the legs."""


@dataclass(frozen=True, eq=False)
class KeptDistances:
    """What a leg law has to keep."""

    limits: Limits
    separation: Separation
    arena: Arena | None


def with_legs_clear(path: StraightPath, kept: KeptDistances) -> StraightPath:
    """Return the path with the legs shared so that distances hold on the way.

    The fractions change linearly where that will do. Else they are chosen at knots, all at once,
    nearest to linear; where none is found the linear law is returned, for the certificate to tell
    what it breaks.
    """
    if _clear(path, kept):
        return path
    ends = path.fractions.at(np.array([0.0, 1.0]))
    for count in KNOTS:
        s = np.linspace(0.0, 1.0, count)
        linear = ends[0] + s[:, None] * (ends[1] - ends[0])
        task = _task(path, kept, s, linear, MARGIN)
        found = share(task)
        if found.margin < MARGIN * (1.0 - 1e-6):
            if found.margin < 1.0:
                return path
            continue
        fractions = found.q_legs / task.slack
        law = StraightPath(path.team, path.start, path.end, _spline(s, fractions))
        if _clear(law, kept):
            return law
    return path


def _clear(path: StraightPath, kept: KeptDistances) -> bool:
    s = np.linspace(0.0, 1.0, PROBES)
    task = _task(path, kept, s, path.fractions.at(s), CLEAR)
    legs = np.stack([task.reference, task.slack - task.reference])
    # The ends are what was asked for; whether they hold is told apart from the way.
    return float(np.min(legs[:, 1:-1])) >= kept.limits.leg and measured(task) >= CLEAR


def _task(
    path: StraightPath, kept: KeptDistances, s: Array, fractions: Array, margin: float
) -> SharingTask:
    polygons = path.polygons(s)
    edges = np.roll(polygons, -1, axis=1) - polygons
    slack = path.team.cable_length - np.linalg.norm(edges, axis=-1)
    fixed = np.zeros(len(s), dtype=np.bool_)
    fixed[[0, -1]] = True
    return SharingTask(
        path.team,
        kept.separation,
        kept.arena,
        polygons,
        fractions * slack,
        kept.limits.leg,
        margin,
        ROUGHNESS,
        fixed,
    )


def _spline(s: Array, fractions: Array) -> PiecewisePolynomial:
    """Return the quintic spline through the fractions (J, n): smooth up to the snap."""
    spline = make_interp_spline(s, fractions, k=5)
    breaks = np.unique(spline.t)
    x = breaks[:-1, None] + np.diff(breaks)[:, None] * bernstein.nodes(5)
    return PiecewisePolynomial(breaks, bernstein.interpolate(np.moveaxis(spline(x), 1, -1)))
