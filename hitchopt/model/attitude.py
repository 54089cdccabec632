"""The casadi model of a quadrotor's attitude: a thrust and its derivative to angles and rates.

A quadrotor thrusts along its body's z axis only, so the thrust vector and the yaw determine the
attitude, and their derivatives the body rates (differential flatness: D. Mellinger and V. Kumar,
"Minimum snap trajectory generation and control for quadrotors", ICRA 2011). Yaw is the first of the
angles yaw, pitch, roll about the axes z, y, x, as receivers of quaternions read it.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca


@lru_cache
def attitude_function() -> ca.Function:
    """Return attitude and body rates as a function of the thrust's and the yaw's jets.

    The result is nan where there is no thrust, and where it points along the body's y axis at rest:
    a roll of 90°.

    Returns
    -------
    Function with inputs
        ``thrust`` (3, 2): thrust vector [N] and its derivative by time [N/s],
        ``yaw`` (1, 2): yaw [rad] and its derivative [rad/s],
    and outputs
        ``quaternion`` (4, 1): w, x, y, z, from the body's axes to the world's,
        ``body_rates`` (3, 1): angular velocity about the body's axes [rad/s].
    """
    thrust, yaw = ca.SX.sym("f", 3, 2), ca.SX.sym("psi", 1, 2)
    f, psi = thrust[:, 0], yaw[0]
    # As seen from axes that are turned by the yaw.
    ahead = ca.cos(psi) * f[0] + ca.sin(psi) * f[1]
    left = ca.cos(psi) * f[1] - ca.sin(psi) * f[0]
    pitch = ca.atan2(ahead, f[2])
    roll = ca.atan2(-left, ca.sqrt(ahead**2 + f[2] ** 2))
    flat = ca.vertcat(f, psi)
    rates = ca.jtimes(ca.vertcat(roll, pitch), flat, ca.vertcat(thrust[:, 1], yaw[1]))
    roll_rate, pitch_rate, yaw_rate = rates[0], rates[1], yaw[1]
    body_rates = ca.vertcat(
        roll_rate - yaw_rate * ca.sin(pitch),
        pitch_rate * ca.cos(roll) + yaw_rate * ca.sin(roll) * ca.cos(pitch),
        yaw_rate * ca.cos(roll) * ca.cos(pitch) - pitch_rate * ca.sin(roll),
    )
    (cr, sr), (cp, sp), (cy, sy) = (
        (ca.cos(0.5 * angle), ca.sin(0.5 * angle)) for angle in (roll, pitch, psi)
    )
    quaternion = ca.vertcat(
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    )
    return ca.Function(
        "attitude",
        [thrust, yaw],
        [quaternion, body_rates],
        ["thrust", "yaw"],
        ["quaternion", "body_rates"],
        {"cse": True},
    )
