"""Drones and taut cable parts as moving points and segments, with their names.

Cable k has three parts: the q-leg from ``p_k`` to ``q_k``, edge k, and the r-leg from ``p_{k+1}``
to ``r_k``. Part ``3 k + type`` is cable k's, with types in that order; bodies are those that
``Layout.parts`` lists, as the drones at the ends of a chain have no leg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hitchopt.checks.bounds.moving_bodies import Allowed, Bodies
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.checks.bounds.rounding_margins import magnitude, position_margin
from hitchopt.checks.bounds.shared_values import once
from hitchopt.checks.certificate import within
from hitchopt.geometry.broadphase import Indices
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Extremum
from hitchopt.values import Array

PART_NAMES = ("q-leg", "edge", "r-leg")

LAYOUTS = 64
"""Number of layouts of which indices are stored."""


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
    return once(motion, _leg_vectors)


def _leg_vectors(motion: Motion) -> Array:
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.anchors]


def pull_vectors(motion: Motion) -> Array:
    """Return (pieces, 2n, 3, N+1) [m] to each drone along the straight piece of cable it ends."""
    return leg_vectors(motion) if motion.team.layout.closed else once(motion, _pull_vectors)


def _pull_vectors(motion: Motion) -> Array:
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.pulled_to]


def edge_vectors(motion: Motion) -> Array:
    """Return the edges ``p_{k+1} - p_k`` (pieces, n, 3, N+1) [m]."""
    return once(motion, _edge_vectors)


def _edge_vectors(motion: Motion) -> Array:
    _, vertices = positions(motion)
    return motion.team.layout.edges(vertices, axis=1)


def concatenated(parts: Sequence[Array], axis: int) -> Array:
    """Return arrays of polynomials (…, degree + 1) in a row, in the largest of their degrees."""
    order = max(bernstein.degree(part) for part in parts)
    return np.concatenate([bernstein.elevate(part, order) for part in parts], axis=axis)


def bent_edges(motion: Motion) -> tuple[Array, Array]:
    """Return what edges are at both of their ends, each (pieces, n, 3, N+1) [m].

    Edge k leaves ``p_k`` along the first and arrives at ``p_{k+1}`` along the second: up to where
    it is wrapped around an object, or the whole edge where all are straight.
    """
    if motion.contacts is None:
        edges = edge_vectors(motion)
        return edges, edges
    layout, parts = motion.team.layout, (motion.vertices, motion.contacts)
    order = max(part.degree for part in parts)
    vertices, contacts = (part.elevated(order).coefficients for part in parts)
    leaving = contacts[:, :, 0] - vertices[:, layout.starts]
    return leaving, vertices[:, layout.ends] - contacts[:, :, 1]


def drone_points(motion: Motion) -> Bodies:
    """Return the drones as points, in the degree of the cable parts where there are any."""
    return Bodies(positions(motion)[0][:, :, None])


@dataclass(frozen=True, eq=False)
class CableParts(Bodies):
    """The cable parts as segments.

    Attributes
    ----------
    part: (bodies,), the part that each is of. An edge that is wrapped around an object has three
        segments: what is straight of it, and between the chord of its arc, which is on the object.
    """

    part: Indices


def cable_parts(motion: Motion) -> CableParts:
    """Return the cable parts in the order of ``Layout.parts``, edges' segments in theirs."""
    return once(motion, _cable_parts)


def _cable_parts(motion: Motion) -> CableParts:
    drones, vertices = positions(motion)
    layout = motion.team.layout
    before, following = vertices[:, layout.starts], vertices[:, layout.ends]
    ends = [(before, drones[:, 0::2]), (before, following), (following, drones[:, 1::2])]
    if motion.contacts is not None:  # all hitches that are wrapped around something are closed
        order = max(bernstein.degree(vertices), motion.contacts.degree)
        first, last = np.moveaxis(motion.contacts.elevated(order).coefficients, 2, 0)
        ends[1:2] = [(before, first), (first, last), (last, following)]
        ends = [
            (bernstein.elevate(first, order), bernstein.elevate(last, order))
            for first, last in ends
        ]
    shape = ends[0][0].shape
    parts = np.empty((*shape[:2], len(ends), 2, *shape[2:]))
    for i, pair in enumerate(ends):
        for j, end in enumerate(pair):
            parts[:, :, i, j] = end
    every = parts.reshape(len(parts), -1, *parts.shape[3:])
    if motion.contacts is None and not layout.closed:
        every = every[:, layout.parts]
    return CableParts(every, parts_listed(layout, wrapped=motion.contacts is not None))


@lru_cache(maxsize=LAYOUTS)
def parts_listed(layout: Layout, *, wrapped: bool) -> Indices:
    """Return the parts (bodies,) that ``cable_parts`` lists, read-only."""
    kinds = np.tile([0, 1, 1, 1, 2] if wrapped else [0, 1, 2], layout.robots)
    every = 3 * np.repeat(np.arange(layout.robots), 5 if wrapped else 3) + kinds
    listed: Indices = every if wrapped else every[layout.parts]
    listed.setflags(write=False)
    return listed


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
