"""Check ``cable_length``: legs and edge use up the cable, and the stored legs are the true ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import edge_vectors, leg_vectors
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.certificate import Check
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, largest

Array = NDArray[np.float64]

LIMIT = 1e-4
"""Relative: 0.2 mm of a cable of 2 m, well below what a knot or a strain of 0.5 N takes up."""


def check(motion: Motion) -> Check:
    """Return the largest relative error of a cable's length; ``where`` names the cable.

    The largest of ``|leg + edge + leg - L| / L`` and of how far the plan's own ``d_k`` and ``e_k``
    are from the distances that they stand for, over L as well.
    """
    n = motion.team.robots
    length = motion.team.cable_length
    legs = leg_vectors(motion)
    per_cable = legs.reshape(len(legs), n, 2, *legs.shape[2:])
    vectors = np.concatenate([per_cable, edge_vectors(motion)[:, :, None]], axis=2)
    rows = vectors.reshape(len(legs), n, 9, -1) / length[:, None, None]
    stored = motion.legs.coefficients / length[:, None, None]
    margin = 4.0 * position_margin(motion) / length  # of three lengths, and of their sum
    found = largest(Cells.over(motion.drones.breaks, [rows, stored], margin), _bound)
    where = (f"cable {found.item}",)
    return Check.of("cable_length", found.worst, LIMIT, "max", "1", found.time, where)


def _bound(blocks: tuple[Array, ...]) -> Estimate:
    vectors, stored = blocks
    vectors = vectors.reshape(len(vectors), 3, 3, -1)
    lengths = enclosure.norm(vectors)
    order = max(bernstein.degree(lengths.coefficients), bernstein.degree(stored))
    parts = bernstein.elevate(lengths.coefficients, order)
    sums = np.sum(parts, axis=1, keepdims=True) - 1.0
    errors = np.concatenate([sums, bernstein.elevate(stored, order) - parts[:, :2]], axis=1)
    radius = np.stack(
        [np.sum(lengths.radius, axis=1), lengths.radius[:, 0], lengths.radius[:, 1]], axis=1
    )
    reach = np.abs(errors) + radius[..., None]
    bound = np.max(reach, axis=(1, 2))
    x = np.argmax(np.max(reach, axis=1), axis=-1) / max(1, order)
    there = np.linalg.norm(bernstein.evaluate(vectors, x[:, None, None]), axis=-1)
    given = bernstein.evaluate(stored, x[:, None])
    value = np.maximum(
        np.abs(np.sum(there, axis=-1) - 1.0), np.max(np.abs(given - there[:, :2]), axis=-1)
    )
    return Estimate(bound, value, x)
