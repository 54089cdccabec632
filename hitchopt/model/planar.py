"""The casadi model of one catenary robot at rest in a level hitch, seen from above.

As in ``robot``, robot k depends on ``p_{k-1} … p_{k+2}``, ``d_k`` and ``T_{k-1} … T_{k+1}`` only.
"""

from __future__ import annotations

import casadi as ca

from hitchopt.model.cache import kept


@kept
def planar_function(equal_tensions: bool) -> ca.Function:
    """Return robot k's drones, its other leg, and how sharply the outline turns at ``p_k``.

    Parameters
    ----------
    equal_tensions: as for ``robot_function``.

    Returns
    -------
    Function with inputs ``vertices`` (8, 1): ``p_{k-1}, p_k, p_{k+1}, p_{k+2}`` [m], ``q_leg``:
    ``d_k`` [m], ``tensions`` (3, 1) [N], ``cable_length`` [m], and outputs ``place`` (5, 1):
    ``q_k``, ``r_k``, ``e_k`` [m], and ``turn``: the sine of the exterior angle at ``p_k``.
    """
    vertices, q_leg = ca.SX.sym("p", 8), ca.SX.sym("d")
    tensions, length = ca.SX.sym("T", 3), ca.SX.sym("L")
    before, here, there, after = ca.vertsplit(vertices, 2)
    T_before, T, T_after = ca.vertsplit(tensions)
    u_before, u, u_after = (
        _unit(here - before),
        _unit(there - here),
        _unit(after - there),
    )
    if equal_tensions:
        q_direction, r_direction = u_before, -u_after
    else:
        q_direction = _reflected(u, T_before * u_before - T * u)
        r_direction = -_reflected(u, T * u - T_after * u_after)
    r_leg = length - ca.norm_2(there - here) - q_leg
    place = ca.vertcat(here + q_leg * q_direction, there + r_leg * r_direction, r_leg)
    turn = u_before[1] * u[0] - u_before[0] * u[1]
    return ca.Function(
        "planar",
        [vertices, q_leg, tensions, length],
        [place, turn],
        ["vertices", "q_leg", "tensions", "cable_length"],
        ["place", "turn"],
        {"cse": True},
    )


def _unit(vector: ca.SX) -> ca.SX:
    return vector / ca.norm_2(vector)


def _reflected(u: ca.SX, V: ca.SX) -> ca.SX:
    """Return u mirrored in the line normal to V: ``u - 2 (u·v̂) v̂``."""
    return u - 2.0 * ca.dot(u, V) / ca.dot(V, V) * V
