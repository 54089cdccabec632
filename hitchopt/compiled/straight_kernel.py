"""Compiled legs and drones of a hitch whose cables all pull alike; see ``straight_legs``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.series_kernels import FACTORIALS, JET, edge, jet, minus, over, plus, times
from hitchopt.values import Array, Indices


@kernel
def shared_legs(
    vertices: Array,
    law: tuple[Array, Array],
    cable_length: Array,
    stencil: Indices,
    has_leg: NDArray[np.bool_],
) -> Array:
    """Return the jets of q-legs (J, n, 4) [m] whose law is ``length + share · slack``.

    Parameters
    ----------
    vertices: (J, points, 3, 4) [m], jets.
    law: jets (J, n, 4) of length [m] and share.
    cable_length: (n,) [m]
    stencil, has_leg: of the layout, (n, 4) and (n, 2).
    """
    legs = np.empty((len(vertices), len(stencil), JET))
    for step in range(len(vertices)):
        points = vertices[step] / FACTORIALS
        for k in range(len(stencil)):
            chord = edge(points, stencil[k, 1], stencil[k, 2])[3]
            slack = minus((cable_length[k], 0.0, 0.0, 0.0), chord)
            leg = (0.0, 0.0, 0.0, 0.0)
            if not has_leg[k, 1]:
                leg = slack
            elif has_leg[k, 0]:
                share = times(jet(law[1][step, k] / FACTORIALS), slack)
                leg = plus(jet(law[0][step, k] / FACTORIALS), share)
            for order in range(JET):
                legs[step, k, order] = leg[order] * FACTORIALS[order]
    return legs


@kernel
def straight_drones(
    vertices: Array, q_legs: Array, cable_length: Array, stencil: Indices
) -> tuple[Array, Array, Array]:
    """Return drones, the directions in which cables pull, and r-legs, as ``straight_legs`` does.

    Parameters
    ----------
    vertices: (J, points, 3, 4) [m], jets.
    q_legs: (J, n, 4) [m], jets.
    cable_length: (n,) [m]
    stencil: of the layout, (n, 4).
    """
    count, n = len(vertices), len(stencil)
    drones, along = np.empty((count, n, 2, 3, JET)), np.empty((count, n, 2, 3))
    r_legs = np.empty((count, n, JET))
    for step in range(count):
        points = vertices[step] / FACTORIALS
        for k in range(n):
            before, here, there, after = stencil[k]
            chord, q_leg = edge(points, here, there)[3], jet(q_legs[step, k] / FACTORIALS)
            r_leg = minus(minus((cable_length[k], 0.0, 0.0, 0.0), chord), q_leg)
            for order in range(JET):
                r_legs[step, k, order] = r_leg[order] * FACTORIALS[order]
            for end in range(2):
                place, leg = (here, q_leg) if end == 0 else (there, r_leg)
                x, y, z, size = edge(points, before if end == 0 else after, place)
                for axis in range(3):
                    outward = over(x if axis == 0 else (y if axis == 1 else z), size)
                    curve = plus(jet(points[place, axis]), times(leg, outward))
                    along[step, k, end, axis] = -outward[0]
                    for order in range(JET):
                        drones[step, k, end, axis, order] = curve[order] * FACTORIALS[order]
    return drones, along, r_legs
