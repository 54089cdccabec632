"""Eq. (2) of the paper in its general form: the unbalanced force at the clasps of a hitch."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.hitch.team import CLOSED, layout_of

Array = NDArray[np.float64]


def clasp_residuals(
    vertices: Array,
    q: Array,
    r: Array,
    tensions: ArrayLike,
    loads: ArrayLike = 0.0,
    topology: str = CLOSED,
) -> Array:
    """Return the unbalanced force at every clasp of a hitch.

    Parameters
    ----------
    vertices: (…, points, 3) [m]
    q, r: (…, n, 3) [m], positions of the drones.
    tensions: (…, n) or scalar [N].
    loads: (…, clasps, 3) or scalar [N], outside forces ``w_k`` on the clasps.

    Returns
    -------
    (…, clasps, 3) [N]; zero in equilibrium.
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
