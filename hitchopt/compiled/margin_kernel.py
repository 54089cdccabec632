"""Compiled smallest distances of a hitch's bodies over their limits; see ``LegBodies.margins``."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices

ROUNDING = 1e-9
"""Share of their margin by which cables that cross count as far enough apart."""


@kernel
def _to_segment(x: float, y: float, u: float, v: float) -> float:
    """Return the squared distance of (x, y) from the segment from the origin to (u, v)."""
    squared = u * u + v * v
    share = min(max((x * u + y * v) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return float((x - share * u) ** 2 + (y - share * v) ** 2)


@kernel
def _apart(nodes: Array, first: Indices, second: Indices) -> float:
    """Return the squared distance of two bodies in the plane, from node to node each."""
    x, y = nodes[second[0], 0] - nodes[first[0], 0], nodes[second[0], 1] - nodes[first[0], 1]
    ux, uy = nodes[first[1], 0] - nodes[first[0], 0], nodes[first[1], 1] - nodes[first[0], 1]
    vx, vy = nodes[second[1], 0] - nodes[second[0], 0], nodes[second[1], 1] - nodes[second[0], 1]
    least = min(_to_segment(x, y, ux, uy), _to_segment(x + vx, y + vy, ux, uy))
    least = min(least, _to_segment(-x, -y, vx, vy), _to_segment(ux - x, uy - y, vx, vy))
    det = ux * vy - uy * vx
    if det * det > 1e-14 * (ux * ux + uy * uy) * (vx * vx + vy * vy):
        s, t = (x * vy - y * vx) / det, (x * uy - y * ux) / det
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            return 0.0
    return least


@kernel
def smallest_shares(
    nodes: Array,
    bodies: Indices,
    pairs: tuple[Indices, Indices, Indices],
    limits: Array,
    margins: tuple[Array, Array],
    cutoff: float,
) -> Array:
    """Return (J,) the smallest distance over limit and margin in every frame; else infinity.

    Parameters
    ----------
    nodes: (J, count, 2) [m]
    bodies: (parts, 2), nodes at their ends.
    pairs: bodies (m,) and (m,), and kinds (m,), crossings the last kind.
    limits: (3,) [m], by kind; without one pairs are left out.
    margins: (J,) each, of all pairs, and those at which crossings count as far enough apart.
    cutoff: [m], pairs farther apart are left out.
    """
    i, j, kinds = pairs
    found = np.full(len(nodes), np.inf)
    for frame in range(len(nodes)):
        for k in range(len(i)):
            limit = limits[kinds[k]]
            if limit > 0.0:
                squared = _apart(nodes[frame], bodies[i[k]], bodies[j[k]])
                if squared <= cutoff * cutoff:
                    ratio = np.sqrt(squared) / limit
                    if kinds[k] < 2 or ratio < margins[1][frame] * (1.0 - ROUNDING):
                        found[frame] = min(found[frame], ratio / margins[0][frame])
    return found
