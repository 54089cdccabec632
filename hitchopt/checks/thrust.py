"""Check ``thrust``: no drone needs more than its motors give."""

from __future__ import annotations

from functools import partial

import numpy as np

from hitchopt.checks.bounds.leg_directions import largest_along
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.thrust_enclosure import (
    known_directions,
    thrust_at,
    thrust_cells,
    thrust_enclosure,
)
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.geometry.vectors import column_lengths, length
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosure import Enclosure
from hitchopt.trajectory.extremum import Estimate
from hitchopt.values import Array


def _find(motion: Motion, _: float) -> Finding:
    """Return the largest thrust of the drone that is nearest to its own ``max_thrust``.

    ``worst`` and ``limit`` are that drone's; the check holds if all drones satisfy theirs.
    """
    limits = motion.team.max_thrust
    cells, noise = thrust_cells(motion, limits), position_margin(motion)
    bound, aim = partial(thrust_bound, noise=noise), within(1.0, "max", share=0.5)
    found = largest_along(cells, bound, known_directions(motion), aim)
    limit = float(limits[found.item])
    where = (motion.team.drone_names[found.item],)
    return Finding(found.worst * limit, found.time, where, limit=limit)


def thrust_bound(
    blocks: tuple[Array, ...], noise: float, along: Enclosure | None = None
) -> Estimate:
    """Bound the thrusts of cells from above."""
    thrust = thrust_enclosure(blocks, noise, along)
    norms, order = column_lengths(thrust.coefficients), bernstein.degree(thrust.coefficients)
    index = np.argmax(norms, axis=-1)
    there = thrust_at(blocks, index, order)
    value = length(there.vectors) + there.pull
    return Estimate(np.max(norms, axis=-1) + thrust.radius, value, index / max(1, order))


RULE = CheckRule(
    "thrust",
    "N",
    "max",
    lambda motion: float(np.max(motion.team.max_thrust)),
    (Finder(_find, exported=True),),
    "give the drone more thrust, or lower team.tension",
    "give the drone more thrust, or lower team.cable_density",
    Ease.TENSION,
    derivative=2,
)
