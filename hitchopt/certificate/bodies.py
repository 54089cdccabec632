"""Drones and taut cable parts as moving points and segments, with their names.

Cable k has three parts: the q-leg from ``p_k`` to ``q_k``, edge k, and the r-leg from ``p_{k+1}``
to ``r_k``. Part ``3 k + type`` is cable k's, with types in that order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate.broadphase import Indices
from hitchopt.certificate.proximity import Bodies
from hitchopt.model.motion import Motion
from hitchopt.trajectory import bernstein

Array = NDArray[np.float64]

PART_NAMES = ("q-leg", "edge", "r-leg")


def positions(motion: Motion) -> tuple[Array, Array]:
    """Return the drones' (pieces, 2n, 3, N+1) and vertices' (pieces, n, 3, N+1) polynomials [m].

    Both in the larger of their degrees.
    """
    order = max(motion.drones.degree, motion.vertices.degree)
    return (
        bernstein.elevate(motion.drones.coefficients, order),
        bernstein.elevate(motion.vertices.coefficients, order),
    )


def leg_vectors(motion: Motion) -> Array:
    """(pieces, 2n, 3, N+1) [m]: from its vertex to each drone, in the order q0, r0, q1, …."""
    drones, vertices = positions(motion)
    return drones - anchors(vertices)


def edge_vectors(motion: Motion) -> Array:
    """(pieces, n, 3, N+1) [m]: ``p_{k+1} - p_k``."""
    _, vertices = positions(motion)
    return np.roll(vertices, -1, axis=1) - vertices


def anchors(vertices: Array) -> Array:
    """(pieces, 2n, …): each drone's own vertex, ``p_k`` for q_k and ``p_{k+1}`` for r_k."""
    both = np.stack([vertices, np.roll(vertices, -1, axis=1)], axis=2)
    return both.reshape(len(vertices), -1, *vertices.shape[2:])


def drone_points(motion: Motion) -> Bodies:
    """Return the drones as points."""
    drones, _ = positions(motion)
    return Bodies(drones[:, :, None])


def cable_parts(motion: Motion) -> Bodies:
    """Return the 3n cable parts as segments."""
    drones, vertices = positions(motion)
    following = np.roll(vertices, -1, axis=1)
    ends = [(vertices, drones[:, 0::2]), (vertices, following), (following, drones[:, 1::2])]
    parts = np.stack([np.stack(pair, axis=2) for pair in ends], axis=2)  # (pieces, n, 3, 2, 3, N+1)
    return Bodies(parts.reshape(len(parts), -1, *parts.shape[3:]))


def part_clasps(parts: Indices, robots: int) -> tuple[Indices, Indices]:
    """Return the first and last clasp that each part touches; the same one for a leg."""
    k, kind = np.divmod(parts, 3)
    following = (k + 1) % robots
    return np.where(kind == 2, following, k), np.where(kind == 0, k, following)


def part_name(part: int) -> str:
    """Return such as ``q-leg 2`` or ``edge 0``."""
    return f"{PART_NAMES[part % 3]} {part // 3}"
