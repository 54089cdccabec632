"""Random convex polygons, for tests, benchmarks and problems."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.geometry.polygon import ConvexPolygon

STRETCH = 0.12
"""By how much the polygon may be longer one way than the other."""


def random_convex_polygon(
    n: int, edge: float, rng: np.random.Generator, jitter: float = 0.3
) -> ConvexPolygon:
    """Return a random convex n-gon about the origin.

    Points of a circle at jittered angles, then stretched: both keep it convex.

    Parameters
    ----------
    n: number of vertices.
    edge: length of an edge, about [m].
    rng: source of randomness.
    jitter: by how much a vertex may be off a regular polygon's, as a share of the angle between
        two vertices, below 0.5.
    """
    step = 2.0 * math.pi / n
    angles = -step * (np.arange(n) + jitter * rng.uniform(-1.0, 1.0, n))
    angles += rng.uniform(0.0, 2.0 * math.pi)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    points *= 1.0 + STRETCH * rng.uniform(-1.0, 1.0, 2)
    polygon = ConvexPolygon(0.5 * edge / math.sin(0.5 * step) * points)
    return polygon.rotated(rng.uniform(0.0, 2.0 * math.pi))
