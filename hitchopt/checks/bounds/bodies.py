"""Drones and taut cable parts as moving points and segments, with their names.

Cable k has three parts: the q-leg from ``p_k`` to ``q_k``, edge k, and the r-leg from ``p_{k+1}``
to ``r_k``. Part ``3 k + type`` is cable k's, with types in that order; bodies are those that
``Layout.parts`` lists, as the drones at the ends of a chain have no leg.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.proximity import Allowed, Bodies, smallest_distance
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.certificate import within
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Extremum
from hitchopt.values import Array

PART_NAMES = ("q-leg", "edge", "r-leg")


def positions(motion: Motion) -> tuple[Array, Array]:
    """Return the polynomials of the drones (pieces, 2n, 3, N+1) and points (pieces, P, 3, N+1) [m].

    Both have the larger of their degrees.
    """
    order = max(motion.drones.degree, motion.vertices.degree)
    return (
        bernstein.elevate(motion.drones.coefficients, order),
        bernstein.elevate(motion.vertices.coefficients, order),
    )


def leg_vectors(motion: Motion) -> Array:
    """Return (pieces, 2n, 3, N+1) [m] from its vertex to each drone q0, r0, q1, …."""
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.anchors]


def pull_vectors(motion: Motion) -> Array:
    """Return (pieces, 2n, 3, N+1) [m] to each drone along the straight piece of cable it ends."""
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.pulled_to]


def edge_vectors(motion: Motion) -> Array:
    """Return the edges ``p_{k+1} - p_k`` (pieces, n, 3, N+1) [m]."""
    _, vertices = positions(motion)
    return motion.team.layout.edges(vertices, axis=1)


def drone_points(motion: Motion) -> Bodies:
    """Return the drones as points, in the degree of the cable parts where there are any."""
    return Bodies(positions(motion)[0][:, :, None])


def cable_parts(motion: Motion) -> Bodies:
    """Return the cable parts as segments, in the order of ``Layout.parts``."""
    drones, vertices = positions(motion)
    layout = motion.team.layout
    before, following = vertices[:, layout.starts], vertices[:, layout.ends]
    ends = [(before, drones[:, 0::2]), (before, following), (following, drones[:, 1::2])]
    parts = np.stack([np.stack(pair, axis=2) for pair in ends], axis=2)  # (pieces, n, 3, 2, 3, N+1)
    return Bodies(parts.reshape(len(parts), -1, *parts.shape[3:])[:, layout.parts])


def part_points(parts: Indices, layout: Layout) -> tuple[Indices, Indices]:
    """Return the first and last point that each part touches; the same one for a leg."""
    k, kind = np.divmod(parts, 3)
    before, following = layout.starts[k], layout.ends[k]
    return np.where(kind == 2, following, before), np.where(kind == 0, before, following)


def clasped_pairs(layout: Layout) -> Indices:
    """Return the pairs of cables (clasps,) that hold each other: ``i * n + j`` with i < j."""
    return pair_of(layout, layout.ahead, layout.behind)


def pair_of(layout: Layout, first: Indices, second: Indices) -> Indices:
    """Return pairs of cables as ``i * n + j`` with i <= j."""
    return np.minimum(first, second) * layout.robots + np.maximum(first, second)


def closest(
    motion: Motion, first: Bodies, second: Bodies | None, allowed: Allowed, limit: float
) -> Extremum:
    """Return the smallest distance of allowed pairs, close enough to compare it with a limit."""
    aim = within(limit, "min", magnitude(motion), 0.5)
    margin = position_margin(motion)
    return smallest_distance(motion.drones.breaks, first, second, allowed, margin, aim)


def part_name(part: int) -> str:
    """Return such as ``q-leg 2`` or ``edge 0``."""
    return f"{PART_NAMES[part % 3]} {part // 3}"
