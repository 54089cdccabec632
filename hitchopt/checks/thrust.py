"""Check ``thrust``: no drone is asked for more than its motors give."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.thrust_enclosure import thrust_at, thrust_cells, thrust_enclosure
from hitchopt.checks.certificate import Check, within
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Estimate, largest

Array = NDArray[np.float64]


def check(motion: Motion) -> Check:
    """Return the largest thrust of the drone that is nearest to its own ``max_thrust``.

    ``worst`` and ``limit`` are that drone's; the check holds if all drones keep theirs.
    """
    limits = motion.team.max_thrust
    cells, bound = thrust_cells(motion, limits), partial(_bound, noise=position_margin(motion))
    found = largest(cells, bound, within(1.0, "max", share=0.5))
    limit = float(limits[found.item])
    where = (motion.team.drone_names[found.item],)
    return Check.of("thrust", found.worst * limit, limit, "max", "N", found.time, where)


def _bound(blocks: tuple[Array, ...], noise: float) -> Estimate:
    thrust = thrust_enclosure(blocks, noise)
    norms = np.linalg.norm(thrust.coefficients, axis=-2)
    x = np.argmax(norms, axis=-1) / max(1, bernstein.degree(norms))
    there = thrust_at(blocks, x)
    value = np.linalg.norm(there.vectors, axis=-1) + there.pull
    return Estimate(np.max(norms, axis=-1) + thrust.radius, value, x)
