"""Check ``keep_out``: drones stay off prisms and objects, by the radius of their ellipsoids."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.checks.bounds.bodies import drone_points
from hitchopt.checks.bounds.object_frames import seen_from
from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.bounds.slab_distance import smallest_gap
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.requirements import Prism
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.extremum import Extremum


def _find(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of any drone to a prism or an object, zero within.

    ``where`` names the drone, and the object where it is one.
    """
    found = smallest_clearance(motion.drones, motion.requirements.keep_out, limit)
    where: tuple[str, ...] = (motion.team.drone_names[found.item],)
    points, poses = drone_points(motion).corners, motion.object_poses.coefficients
    aim = within(limit, "min", magnitude(motion), 0.5)
    for index, (name, each) in enumerate(motion.requirements.objects.items()):
        seen = seen_from(poses[:, index], points)
        for slab in each.slabs:
            margin = seen.error + ROUNDING * (magnitude(motion) + slab.size)
            apart = smallest_gap(motion.drones.breaks, seen.points, slab, margin, aim)
            if apart.worst < found.worst:
                found, where = apart, (motion.team.drone_names[apart.item], name)
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
        points = part.coefficients[:, :, None]
        found = smallest_gap(part.breaks, points, prism.slab, margin, aim)
        if found.worst < best.worst:
            best = found
    return best


def _limit(motion: Motion) -> float | None:
    requirements = motion.requirements
    kept = requirements.keep_out or requirements.objects
    return requirements.separation.radius if kept else None


RULE = CheckRule(
    "keep_out",
    "m",
    "min",
    _limit,
    (Finder(_find, exported=True),),
    "move the keep-out volumes or objects, fly farther from them, or lower separation.radius",
)
