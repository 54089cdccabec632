"""The model's drones where all tensions are equal, in closed form for all robots at once.

Legs then go on along the neighbouring edges (the paper's class, its eq. (3)): ``q_k = p_k + d_k
u_{k-1}``, ``r_k = p_{k+1} - e_k u_{k+1}``. Jets of these are a hundred operations on arrays of all
robots, where ``robot_function`` takes eight hundred on their single coordinates.
"""

from __future__ import annotations

import numpy as np

from hitchopt.hitch import Team
from hitchopt.values import Array


def straight_legs(team: Team, vertices: Array, q_legs: Array) -> tuple[Array, Array, Array]:
    """Return the drones of cables that all pull alike, the directions of the pulls, and the r-legs.

    Parameters
    ----------
    team: whose cables have no weight and no loads.
    vertices: (J, points, 3, 4) [m], jets.
    q_legs: (J, n, 4) [m]

    Returns
    -------
    (J, n, 2, 3, 4) [m], jets of ``q_k`` and ``r_k``; (J, n, 2, 3), unit vectors from them along
    their cables; (J, n, 4) [m], jets of ``e_k``.
    """
    layout = team.layout
    points = np.ascontiguousarray(vertices.transpose(3, 2, 0, 1))  # samples and robots come last
    d = np.ascontiguousarray(q_legs.transpose(2, 0, 1))
    starts, ends = points[..., layout.starts], points[..., layout.ends]
    edges = ends - starts
    count, n = q_legs.shape[:2]
    drones, along = np.empty((count, n, 2, 3, len(points))), np.empty((count, n, 2, 3))
    with np.errstate(all="ignore"):  # edges of no length have no direction
        lengths = _lengths(edges)
        u = _directions(edges, lengths)
        before, after = u[..., layout.neighbours[:, 0]], u[..., layout.neighbours[:, 2]]
        if not layout.closed:  # beyond its ends a chain is mirrored
            before[..., 0] *= -1.0
            after[..., -1] *= -1.0
        e = -lengths - d
        e[0] += team.cable_length
        drones[:, :, 0] = (starts + _product(d, before)).transpose(2, 3, 1, 0)
        drones[:, :, 1] = (ends - _product(e, after)).transpose(2, 3, 1, 0)
    along[:, :, 0], along[:, :, 1] = -before[0].transpose(1, 2, 0), after[0].transpose(1, 2, 0)
    return drones, along, e.transpose(1, 2, 0)


def _lengths(edges: Array) -> Array:
    """Return the jets (4, J, n) of the lengths of edges (4, 3, J, n)."""
    value, first, second, third = edges
    found = np.empty((len(edges), *edges.shape[2:]))
    found[0] = np.sqrt(_dot(value, value))
    # From length² = edge · edge, solved for the newest derivative.
    inverse = 1.0 / found[0]
    found[1] = _dot(value, first) * inverse
    found[2] = (_dot(value, second) + _dot(first, first) - found[1] ** 2) * inverse
    known = _dot(value, third) + 3.0 * (_dot(first, second) - found[1] * found[2])
    found[3] = known * inverse
    return found


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar products (J, n) of vectors (3, J, n)."""
    products: Array = np.add.reduce(a * b, axis=0)
    return products


def _directions(edges: Array, lengths: Array) -> Array:
    """Return the jets (4, 3, J, n) of unit vectors along edges (4, 3, J, n)."""
    # From length · u = edge, solved for the newest derivative.
    ratios = lengths[1:] / lengths[0]
    u: Array = np.divide(edges, lengths[0])
    u[1] -= ratios[0] * u[0]
    u[2] -= 2.0 * ratios[0] * u[1] + ratios[1] * u[0]
    u[3] -= 3.0 * (ratios[0] * u[2] + ratios[1] * u[1]) + ratios[2] * u[0]
    return u


def _product(lengths: Array, u: Array) -> Array:
    """Return the jets (4, 3, J, n) of lengths (4, J, n) along u (4, 3, J, n), by Leibniz' rule."""
    value, first, second, third = lengths
    found: Array = np.multiply(value, u)
    found[1] += first * u[0]
    found[2] += 2.0 * first * u[1] + second * u[0]
    found[3] += 3.0 * (first * u[2] + second * u[1]) + third * u[0]
    return found
