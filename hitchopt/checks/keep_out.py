"""Check ``keep_out``: drones stay out of prisms, by the radius of their ellipsoids."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.requirements import Prism
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, smallest
from hitchopt.values import Array


def _find(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of any drone to a prism, zero within."""
    found = smallest_clearance(motion.drones, motion.requirements.keep_out, limit)
    where = (motion.team.drone_names[found.item],)
    return Finding(found.worst, found.time, where, magnitude(motion))


def smallest_clearance(
    part: PiecewisePolynomial, prisms: tuple[Prism, ...], limit: float = 0.0
) -> Extremum:
    """Return the smallest distance of points ``part`` (N, 3) to any of the prisms [m], zero within.

    Linear in the number of drones and of prisms: most pairs are bounded once, and as closely as it
    takes to tell whether they keep ``limit`` [m].
    """
    best = Extremum(math.inf, math.inf, -1, 0.0)
    size = float(np.max(np.abs(part.coefficients)))
    aim = within(limit, "min", size, 0.5)
    for prism in prisms:
        margin = ROUNDING * (size + float(np.max(np.abs(prism.corners))))
        cells = Cells.over(part.breaks, [part.coefficients], margin)
        found = smallest(cells, partial(_bound, prism=prism), aim)
        if found.worst < best.worst:
            best = found
    return Extremum(max(best.worst, 0.0), best.value, best.item, best.time)


def _bound(blocks: tuple[Array, ...], prism: Prism) -> Estimate:
    """Return what bounds the distance to a prism from below.

    The distance is the largest, over vectors n no longer than one, of n·p minus the largest n·v of
    the prism's corners v. Along the normals at both ends of a cell, and between them in between.
    """
    (rows,) = blocks
    degree = rows.shape[-1] - 1
    first, last = prism.clearance(rows[..., 0]), prism.clearance(rows[..., -1])
    lengths = np.maximum(np.stack([first.distance, last.distance]), 0.0)
    towards = []
    for clearance in (first, last):
        reach = np.max(clearance.normals @ prism.corners.T, axis=1)
        product = np.einsum("md,mdk->mk", clearance.normals, rows)
        towards.append(product - reach[:, None])
    weight = np.arange(degree + 2) / (degree + 1)
    coefficients = np.zeros((len(rows), degree + 2))
    coefficients[:, :-1] = (1.0 - weight[:-1]) * towards[0]
    coefficients[:, 1:] += weight[1:] * towards[1]
    x = np.argmin(lengths, axis=0)
    lowest = np.maximum(np.min(coefficients, axis=-1), 0.0)
    return Estimate(lowest, np.min(lengths, axis=0), x.astype(np.float64))


RULE = CheckRule(
    "keep_out",
    "m",
    "min",
    lambda motion: motion.requirements.separation.radius if motion.requirements.keep_out else None,
    (Finder(_find, exported=True),),
    "move the keep-out volumes, fly farther from them, or lower separation.radius",
)
