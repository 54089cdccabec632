"""Parameters of the Crazyflie firmware and of PX4 for one drone, and its attitude loops.

The Crazyflie's Kalman filter attributes sideways accelerations to tilt only, because it uses the
accelerometer along the thrust only. With the firmware's default noises, a sideways cable force
makes it ignore measurements, so every export has parameters of the filter. Gains are those of the
drone's position loop. Attitude gains are scaled for the same rotational dynamics as a stock
Crazyflie: for its proportions, arms grow with mass to the power 1/3, inertia to the power 5/3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hitchopt.drones.controllers import HELD, FlightController, Gains, px4_gains
from hitchopt.drones.quadrotor import GRAVITY, Quadrotor
from hitchopt.errors import InputError

Parameters = dict[str, dict[str, float]]  # By group and name; integers are int

CONTROLLER_NUMBERS = {"pid": 1, "mellinger": 2, "lee": 5}
"""Values of the firmware's ``stabilizer.controller`` of supported controllers."""

KALMAN = 2  # Value of ``stabilizer.estimator`` for the extended Kalman filter
MAX_COMMAND = 65535.0  # Command of full thrust
STOCK_INERTIA = 16.57e-6, 16.66e-6, 29.26e-6  # Inertia of a Crazyflie 2.1 [kg m²]
STOCK_ARM = 0.046  # Distance of its motors from its centre [m]
STOCK_MASS = 0.0313  # Its mass [kg], for a radius of gyration of half its arms
STOCK_THRUST = MAX_COMMAND / 132_000.0  # Its full thrust [N], by the default of ``massThrust``
YAW_ARM = 0.00734  # Moment of a motor about its axis over its thrust [m]

ATTITUDE_GAINS = {
    "mellinger": {
        **{"kR_xy": 70_000.0, "kw_xy": 20_000.0, "kd_omega_rp": 200.0},
        **{"kR_z": 60_000.0, "kw_z": 12_000.0, "ki_m_z": 500.0},
    },
    "lee": {
        **{"KR_x": 0.007, "KR_y": 0.007, "KR_z": 0.008, "KI_x": 0.03, "KI_y": 0.03, "KI_z": 0.03},
        **{"Kw_x": 0.00115, "Kw_y": 0.00115, "Kw_z": 0.002},
        **dict(zip(("J_x", "J_y", "J_z"), STOCK_INERTIA, strict=True)),
    },
}
"""The firmware's default attitude gains: of commands for Mellinger's law, of moments for Lee's."""


@dataclass(frozen=True)
class AttitudeLoop:
    """Gains of an attitude loop over the moments of inertia; pairs are tilt and yaw."""

    stiffness: tuple[float, float]  # of an angle [1/s²]
    damping: tuple[float, float]  # of a rate [1/s]
    lead: float = 0.0  # of an angular acceleration
    integral: tuple[float, float] = (0.0, 0.0)  # of the integral of an angle [1/s³]


PID_ATTITUDE = AttitudeLoop((636.0, 78.0), (106.0, 13.0), 1.06, (318.0, 13.0))
"""The Crazyflie's cascade of angles and rates, over its moments of inertia."""

PX4_ATTITUDE = AttitudeLoop((130.0, 28.0), (20.0, 10.0))  # A typical tuning of PX4's rate loop


def attitude_loop(controller: str) -> AttitudeLoop:
    """Return the attitude loop of a controller on a stock Crazyflie; px4's on a typical drone.

    Mellinger's law gives commands: a command of 1 about x or y changes the thrust of each motor by
    half a step, and its attitude error is twice the rotation vector of a small angle.
    """
    if controller == "pid":
        return PID_ATTITUDE
    if controller == "px4":
        return PX4_ATTITUDE
    gains = ATTITUDE_GAINS[controller]
    tilt_inertia, _, yaw_inertia = STOCK_INERTIA
    if controller == "lee":
        return AttitudeLoop(
            stiffness=(gains["KR_x"] / tilt_inertia, gains["KR_z"] / yaw_inertia),
            damping=(gains["Kw_x"] / tilt_inertia, gains["Kw_z"] / yaw_inertia),
            integral=(gains["KI_x"] / tilt_inertia, gains["KI_z"] / yaw_inertia),
        )
    step = STOCK_THRUST / MAX_COMMAND / 4.0  # thrust of one motor per step of its command [N]
    tilt = 4.0 * 0.5 * step * STOCK_ARM / math.sqrt(2.0) / tilt_inertia
    yaw = 4.0 * step * YAW_ARM / yaw_inertia
    return AttitudeLoop(
        stiffness=(2.0 * gains["kR_xy"] * tilt, 2.0 * gains["kR_z"] * yaw),
        damping=(gains["kw_xy"] * tilt, gains["kw_z"] * yaw),
        lead=gains["kd_omega_rp"] * tilt,
    )


def stated_gains(kind: Quadrotor, stiffness: float | None, damping: float | None) -> Gains | None:
    """Return the gains that are stated for a drone, of its controller or as a stiffness [N/m]."""
    loop = kind.loop
    if kind.controller is not None:
        return None if kind.gains is None else Gains.of(kind.gains)
    if stiffness is not None:
        loop = FlightController.plain(kind.mass, stiffness, integral=False, feed_forward=True)
    if not math.isfinite(loop.kp[0]):
        return None
    return Gains(loop.kp, loop.kd if damping is None else damping, loop.ki)


def firmware_parameters(kind: Quadrotor, loop: FlightController | None) -> Parameters:
    """Return the Crazyflie's parameters for a drone and its loop; without one, of the filter alone.

    They have the six digits of single precision. The controller is one of CONTROLLER_NUMBERS.
    """
    name = "mellinger" if loop is None else loop.name
    parameters: Parameters = {
        "stabilizer": {"estimator": KALMAN, "controller": CONTROLLER_NUMBERS[name]}
    }
    parameters |= HELD.firmware_params
    if loop is None:
        return parameters
    mass, size, factor = kind.mass, kind.mass / STOCK_MASS, kind.thrust_factor or 1.0
    (kp, kp_z), (kd, kd_z), (ki, ki_z) = loop.kp, loop.kd, loop.ki
    if name == "mellinger":
        ranges = zip(("i_range_xy", "i_range_z"), loop.ki_limit, loop.ki, strict=True)
        scale = size ** (4.0 / 3.0) * STOCK_THRUST / kind.max_thrust
        parameters["ctrlMel"] = {
            **{"mass": mass, "massThrust": factor * MAX_COMMAND / kind.max_thrust},
            **{"kp_xy": kp, "kd_xy": kd, "ki_xy": ki, "kp_z": kp_z, "kd_z": kd_z, "ki_z": ki_z},
            **{key: limit / gain for key, limit, gain in ranges if 0.0 < limit < math.inf},
            **{key: scale * value for key, value in ATTITUDE_GAINS[name].items()},
        }
    elif name == "lee":
        gains = {"P": (kp, kp_z), "D": (kd, kd_z), "I": (ki, ki_z)}
        scale = size ** (5.0 / 3.0)
        parameters["ctrlLee"] = {
            "mass": mass,
            **{
                f"Kpos_{term}{axis}": gain / mass
                for term, (level, upright) in gains.items()
                for axis, gain in zip("xyz", (level, level, upright), strict=True)
            },
            **{key: scale * value for key, value in ATTITUDE_GAINS[name].items()},
        }
    else:
        if kind.gains not in (None, Gains()):
            bound = "omitted for pid: its gains are not those of a firmware's parameters"
            raise InputError("team.quadrotor.gains", kind.gains, bound, "omit them")
        base = round(factor * MAX_COMMAND * mass * GRAVITY / kind.max_thrust)
        parameters["posCtlPid"] = {"thrustBase": base}
    return {key: {k: _rounded(x) for k, x in group.items()} for key, group in parameters.items()}


def px4_parameters(
    kind: Quadrotor, stiffness: float | None = None, damping: float | None = None
) -> dict[str, float]:
    """Return the PX4 parameters of a drone.

    By default PX4 computes the tilt with thrust ``m g``, which is too much tilt if cables pull
    downward, and estimates the cable force as weight. Stated gains are those of PX4's velocity loop
    and of the position loop around it, within the ranges that PX4 declares; ``stiffness`` [N/m] and
    ``damping`` [N s/m] are for drones without a named controller.
    """
    parameters: dict[str, float] = {"MPC_ACC_DECOUPLE": 0, "MPC_USE_HTE": 0}
    if (stated := stated_gains(kind, stiffness, damping)) is not None:
        loop = FlightController.of("px4", kind.mass, stated)
        gains = px4_gains(loop.kp, loop.kd, loop.ki, kind.mass)
        parameters |= {name: _rounded(gain) for name, gain in gains.items()}
    return parameters


def _rounded(value: float) -> float:
    return value if isinstance(value, int) else float(f"{value:.6g}")
