"""Random hitches, and the unbalanced force at their clasps: eq. (2) of the paper in general."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import hitchopt as ho
from hitchopt.geometry import Outline
from hitchopt.hitch.team import CLOSED, layout_of
from hitchopt.values import Array
from problems.random_morph import random_convex_polygon

# Equal and other tensions of clasps that carry nothing; rolled legs with loads, with weight
KINDS = ("equal", "unequal", "loaded", "heavy")


def random_outline(seed: int, n: int, topology: str = CLOSED) -> Outline:
    """Return a polygon of n edges, or n edges in a row of a larger one, off the origin."""
    rng = np.random.default_rng(seed)
    closed = topology == CLOSED
    polygon = random_convex_polygon(n if closed else n + 3, 1.2, rng).translated(rng.normal(size=2))
    return polygon if closed else ho.ConvexArc(polygon.vertices[: n + 1])


def random_hitch(seed: int, n: int, topology: str = CLOSED, kind: str = "unequal") -> ho.Hitch:
    """Return a hitch of unequal cables and legs at 0.8 m, of one of KINDS."""
    rng = np.random.default_rng([seed, 1])
    outline, plain = random_outline(seed, n, topology), kind in KINDS[:2]
    clasps = n if topology == CLOSED else n - 1
    team = ho.Team(
        n,
        outline.edge_lengths + rng.uniform(0.7, 1.0, n),
        topology=topology,
        tension=0.8 if kind == "equal" else rng.uniform(0.75, 0.85, n) + 0.15 * (not plain),
        cable_density=0.01 if kind == "heavy" else 0.0,
        load=0.0 if plain else rng.uniform(0.0, 0.008, clasps),
    )
    roll = 0.0 if plain else rng.uniform(-0.8, 0.8, clasps)
    slack = ho.Hitch.balanced(team, outline).slack
    legs = team.layout.q_legs_of(slack * rng.uniform(0.3, 0.7, n), slack)
    return ho.Hitch(team, outline, 0.8, legs, roll)


def clasp_residuals(
    vertices: Array,
    q: Array,
    r: Array,
    tensions: ArrayLike,
    loads: ArrayLike = 0.0,
    topology: str = CLOSED,
) -> Array:
    """Return the unbalanced force (…, clasps, 3) [N] at every clasp of a hitch.

    Of vertices (…, points, 3) and drones q, r (…, n, 3) [m], tensions (…, n) or one [N], and
    outside forces on the clasps, one or (…, clasps, 3) [N].
    """
    T = np.broadcast_to(np.asarray(tensions, dtype=np.float64), q.shape[:-1])[..., None]
    layout = layout_of(q.shape[-2], topology)
    here, cable, before = vertices[..., layout.clasps, :], layout.ahead, layout.behind
    u = unit(layout.edges(vertices))
    ahead = T[..., cable, :] * (unit(q[..., cable, :] - here) + u[..., cable, :])
    behind = T[..., before, :] * (unit(r[..., before, :] - here) - u[..., before, :])
    residuals: Array = ahead + behind + np.asarray(loads, dtype=np.float64)
    return residuals


def unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit
