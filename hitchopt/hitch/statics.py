"""Force balance at the clasps (eq. (2) of the paper, in its general form).

At ``p_k`` cables k-1 and k bend around each other without friction:
``T_k q̂_k + T_k u_k + T_{k-1} r̂_{k-1} - T_{k-1} u_{k-1} + w_k = 0``. Arrays carry any leading
axes (times, for instance); the cable index is the last axis but the coordinates. Results at clasps
are in the order of ``Layout.clasps``: all n points of a closed hitch, the n - 1 inner ones of a
chain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.hitch.layout import CLOSED, layout_of

Array = NDArray[np.float64]


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
    """Return how hard the two cables of each clasp press on each other.

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
