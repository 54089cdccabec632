"""Check ``cable_length`` while clasped cables are drawn out: none is torn before the hitch exists.

From the second swap on neighbours hold each other, so that a cable no longer runs straight between
its drones: their distance (``span``) says too little. In the phases that lead to a hitch, or away
from it, every cable has to reach around the plan's vertices, which stand for where the clasps may
lie: where it does for some places of the clasps, no cable is taut.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import edge_vectors, leg_vectors
from hitchopt.checks.bounds.free_phases import PhasePart, free_phases
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.cable_length import LIMIT
from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, largest

Array = NDArray[np.float64]


def check(motion: Motion) -> Check | None:
    """Return by how much a clasped cable is too short, over its length; ``where`` names it.

    Parameters
    ----------
    motion: a span of time without a hitch.
    """
    found = [_of_phase(part) for part in free_phases(motion) if part.tightening]
    return most_pressing(found) if found else None


def _of_phase(part: PhasePart) -> Check:
    motion, n = part.motion, part.motion.team.robots
    length = motion.team.cable_length
    legs = leg_vectors(motion)
    per_cable = legs.reshape(len(legs), n, 2, *legs.shape[2:])
    vectors = np.concatenate([per_cable, edge_vectors(motion)[:, :, None]], axis=2)
    rows = vectors.reshape(len(legs), n, 9, -1) / length[:, None, None]
    margin = 3.0 * position_margin(motion) / float(np.min(length))
    found = largest(Cells.over(motion.drones.breaks, [rows], margin), _bound)
    where = (f"cable {found.item}",)
    return Check.of("cable_length", found.worst, LIMIT, "max", "1", found.time, where)


def _bound(blocks: tuple[Array, ...]) -> Estimate:
    """Bound by how much three lengths, over that of the cable, sum to more than 1."""
    (rows,) = blocks
    vectors = rows.reshape(len(rows), 3, 3, -1)
    lengths = enclosure.norm(vectors)
    sums = np.sum(lengths.coefficients, axis=1) + np.sum(lengths.radius, axis=1)[:, None] - 1.0
    x = np.argmax(sums, axis=-1) / max(1, bernstein.degree(sums))
    there = np.linalg.norm(bernstein.evaluate(vectors, x[:, None, None]), axis=-1)
    value = np.sum(there, axis=-1) - 1.0
    return Estimate(np.maximum(np.max(sums, axis=-1), 0.0), np.maximum(value, 0.0), x)
