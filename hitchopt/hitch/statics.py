"""Static forces: the balance at the clasps, and what cables do to drones.

At ``p_k`` cables k-1 and k bend around each other without friction (eq. (2)
of the paper, in its general form):
``T_k q̂_k + T_k u_k + T_{k-1} r̂_{k-1} - T_{k-1} u_{k-1} + w_k = 0``. Arrays carry any leading
axes (times, for instance); the cable index is the last axis but the coordinates. Results at clasps
are in the order of ``Layout.clasps``: all n points of a closed hitch, the n - 1 inner ones of a
chain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.layout import CLOSED, layout_of
from hitchopt.hitch.team import GRAVITY, Team

Array = NDArray[np.float64]

STEP = 1e-5
"""[s] Step of central differences of cable forces: at 1 m/s a leg of 0.1 m turns by 1e-4 in it, so
that they err by 1e-9 of themselves."""


def leg_directions(
    edge_directions: Array, tensions: ArrayLike, topology: str = CLOSED
) -> tuple[Array, Array]:
    """Return the directions of the legs that hold a planar hitch in balance.

    The two unknown unit vectors at a vertex close a triangle with sides ``T_k``, ``T_{k-1}`` and
    the known ``V = T_{k-1} u_{k-1} - T_k u_k``; of its two solutions this is the clasp. For equal
    tensions it is the paper's class ``q̂_k = u_{k-1}``, ``r̂_{k-1} = -u_k`` (its eq. (3)).

    Parameters
    ----------
    edge_directions: (…, n, 2 or 3) unit vectors ``u_k``.
    tensions: (…, n) or scalar [N], positive.

    Returns
    -------
    q: (…, n, 2 or 3) unit vectors from ``p_k`` to ``q_k``.
    r: (…, n, 2 or 3) unit vectors from ``p_{k+1}`` to ``r_k``.
    Where a chain's end has no leg: away from its edge, the cable's direction there.
    """
    edges = np.asarray(edge_directions, dtype=np.float64)
    pulls = np.broadcast_to(np.asarray(tensions, dtype=np.float64), edges.shape[:-1])[..., None]
    layout = layout_of(edges.shape[-2], topology)
    u, T = edges[..., layout.ahead, :], pulls[..., layout.ahead, :]
    behind, T_behind = edges[..., layout.behind, :], pulls[..., layout.behind, :]
    V = T_behind * behind - T * u
    squared = np.sum(V * V, axis=-1, keepdims=True)
    q_at_clasp = u - 2.0 * np.sum(u * V, axis=-1, keepdims=True) / squared * V
    r_at_clasp = 2.0 * np.sum(behind * V, axis=-1, keepdims=True) / squared * V - behind
    equal = np.equal(T, T_behind)  # exact there, and free of the cancellation in V
    q, r = -edges, edges.copy()
    q[..., layout.ahead, :] = np.where(equal, behind, q_at_clasp)
    r[..., layout.behind, :] = np.where(equal, -u, r_at_clasp)
    return q, r


def contact_forces(edge_directions: Array, tensions: ArrayLike, topology: str = CLOSED) -> Array:
    """Return the forces with which the two cables of each clasp press on each other.

    ``2 T_k T_{k-1} sin φ_k / |V|``, φ the exterior angle; positive where the clasp bears.

    Parameters
    ----------
    edge_directions: (…, n, 2 or 3) unit vectors ``u_k``.
    tensions: (…, n) or scalar [N].

    Returns
    -------
    (…, clasps) [N]
    """
    u = np.asarray(edge_directions, dtype=np.float64)
    T = np.broadcast_to(np.asarray(tensions, dtype=np.float64), u.shape[:-1])
    q, _ = leg_directions(u, T, topology)
    bend: Array = T * np.linalg.norm(u + q, axis=-1)  # what a cable bent by a clasp presses with
    return bend[..., layout_of(u.shape[-2], topology).ahead]


def hanging_forces(team: Team, drones: Array) -> Array:
    """Return the force of hanging cables on drones that are at (…, 2n, 3) [m], in [N] likewise.

    Zero where cables weigh nothing.
    """
    if team.cable_density == 0.0:
        return np.zeros(drones.shape)
    q, r = drones[..., 0::2, :], drones[..., 1::2, :]
    pull = Catenary.between(q, r, team.cable_length).pull(q, r)
    forces: Array = GRAVITY * team.cable_density * pull.reshape(drones.shape)
    return forces


def cable_forces(team: Team, drones: Array, vertices: Array, pulls: Array, taut: Array) -> Array:
    """Return the force of cables on drones (…, 2n, 3) [N], between hanging free and taut.

    A leg pulls toward its vertex (at a chain's end along the edge), and a taut cable puts half of
    its weight on each of its drones. To the share that a cable is not yet taut, what a hanging one
    pulls with takes the place of that weight.

    Parameters
    ----------
    drones: (…, 2n, 3) [m]
    vertices: (…, points, 3) [m]
    pulls: (…, 2n) [N], of the legs; 0 while there is no hitch.
    taut: (…, n), from 0 to 1.
    """
    if not team.has_cables:
        return np.zeros(drones.shape)
    # A leg without length has no direction: no force rather than nan (certified plans have none).
    directions = unit(drones - vertices[..., team.layout.pulled_to, :])
    forces: Array = 0.0 - pulls[..., None] * directions  # no negative zeros
    if team.cable_density > 0.0:
        share = np.repeat(taut, 2, axis=-1)
        forces[..., 2] -= share * team.cable_weight
        if np.any(share < 1.0):
            forces += (1.0 - share)[..., None] * hanging_forces(team, drones)
    return forces


def cable_force_rates(team: Team, values: tuple[Array, ...], rates: tuple[Array, ...]) -> Array:
    """Return the derivative by time of ``cable_forces``, (…, 2n, 3) [N/s], by central differences.

    Parameters
    ----------
    values: drones, vertices, pulls and tautness, as ``cable_forces`` takes them.
    rates: their derivatives by time.
    """
    later, earlier = (
        cable_forces(team, *(v + step * r for v, r in zip(values, rates, strict=True)))
        for step in (STEP, -STEP)
    )
    change: Array = (later - earlier) / (2.0 * STEP)
    return change
