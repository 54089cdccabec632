"""Parameters of flight controllers for a team's drones: of the Crazyflie's firmware and PX4.

The Crazyflie's filter explains every sideways acceleration by tilt alone: its accelerometer counts
along the thrust only. A cable that pulls sideways makes it blind at the firmware's noises, so the
filter's parameters belong to every plan. Gains are those of the team's position loops. Attitude
gains are scaled so that a drone turns as the Crazyflie does for which the firmware has them: for
its proportions, arms grow with the cube root of the mass, inertia with the power 5/3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from hitchopt.errors import InputError
from hitchopt.exports.recording import Finding, error, warning
from hitchopt.hitch import GRAVITY, Quadrotor, Team
from hitchopt.hitch.estimator import HELD
from hitchopt.hitch.flight_controller import FlightController, Gains

SETTINGS = "crazyflies.yaml"  # File of a fleet's robots and their parameters

Parameters = dict[str, dict[str, float]]  # by group, then name; whole numbers are integers

CONTROLLERS = {"pid": 1, "mellinger": 2, "lee": 5}
"""Values of the firmware's ``stabilizer.controller``; 3 and 4 are others."""

KALMAN = 2  # Value of ``stabilizer.estimator`` for the extended Kalman filter
FULL = 65535.0  # Command of full thrust

STOCK_INERTIA = 16.57e-6, 16.66e-6, 29.26e-6  # Inertia of a Crazyflie 2.1 [kg m²]
STOCK_MASS = 0.0313  # Its mass [kg], with which the radius of gyration is half its arms of 46 mm
STOCK_THRUST = FULL / 132_000.0  # Its full thrust [N], by the firmware's default of ``massThrust``

ATTITUDE = {
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

SINGLE = 1e-5  # Relative error by which parameters in single precision may differ


def refuse_controllers(team: Team, known: Collection[str], receiver: str) -> None:
    """Raise InputError if a controller is named that is not among those of a receiver."""
    for name in {kind.controller for kind in team.quadrotor} - {None, *known}:
        bound, remedy = f"one of {', '.join(known)} for {receiver}", "plan for one of them"
        raise InputError("team.quadrotor.controller", name, bound, remedy)


def team_parameters(
    team: Team, stiffness: float | None = None, damping: float | None = None
) -> dict[str, Parameters]:
    """Return the Crazyflie's parameters of every drone of a team, by its name in the plan.

    Gains [N/m], [N s/m] are for drones whose controller nobody names. InputError tells of gains
    with which they are lost, or for which the firmware has no names.
    """
    found = []
    for kind in team.quadrotor:
        loop = kind.loop if kind.controller else _mellinger(kind, stiffness, damping)
        found.append(firmware_parameters(kind, loop))
    each = team.drones // len(found)
    return {name: found[i // each] for i, name in enumerate(team.drone_names)}


def _mellinger(
    kind: Quadrotor, stiffness: float | None, damping: float | None
) -> FlightController | None:
    """Return Mellinger's loop of a stiffness [N/m] that is known, or None."""
    loop = kind.loop
    if stiffness is not None:
        loop = FlightController.plain(kind.mass, stiffness, integral=False, feed_forward=True)
    if not math.isfinite(loop.kp[0]):
        return None
    gains = Gains(loop.kp, loop.kd if damping is None else damping, loop.ki)
    return FlightController.of("mellinger", kind.mass, gains)


def firmware_parameters(kind: Quadrotor, loop: FlightController | None) -> Parameters:
    """Return the Crazyflie's parameters for a drone and its loop; without one, of the filter alone.

    They have six digits, as single precision holds. The controller is one of CONTROLLERS.
    """
    name = "mellinger" if loop is None else loop.name
    parameters: Parameters = {"stabilizer": {"estimator": KALMAN, "controller": CONTROLLERS[name]}}
    parameters |= HELD.firmware_params
    if loop is None:
        return parameters
    mass, size = kind.mass, kind.mass / STOCK_MASS
    (kp, kp_z), (kd, kd_z), (ki, ki_z) = loop.kp, loop.kd, loop.ki
    if name == "mellinger":
        ranges = zip(("i_range_xy", "i_range_z"), loop.ki_limit, loop.ki, strict=True)
        turning = size ** (4.0 / 3.0) * STOCK_THRUST / kind.max_thrust
        parameters["ctrlMel"] = {
            **{"mass": mass, "massThrust": FULL / kind.max_thrust},
            **{"kp_xy": kp, "kd_xy": kd, "ki_xy": ki, "kp_z": kp_z, "kd_z": kd_z, "ki_z": ki_z},
            **{key: limit / gain for key, limit, gain in ranges if 0.0 < limit < math.inf},
            **{key: turning * value for key, value in ATTITUDE[name].items()},
        }
    elif name == "lee":
        each = {"P": (kp, kp_z), "D": (kd, kd_z), "I": (ki, ki_z)}
        turning = size ** (5.0 / 3.0)
        parameters["ctrlLee"] = {
            "mass": mass,
            **{
                f"Kpos_{term}{axis}": gain / mass
                for term, (level, upright) in each.items()
                for axis, gain in zip("xyz", (level, level, upright), strict=True)
            },
            **{key: turning * value for key, value in ATTITUDE[name].items()},
        }
    else:
        if kind.gains not in (None, Gains()):
            bound = "left out for pid: its gains are not those of a firmware's parameters"
            raise InputError("team.quadrotor.gains", kind.gains, bound, "leave them out")
        parameters["posCtlPid"] = {"thrustBase": round(FULL * mass * GRAVITY / kind.max_thrust)}
    return {group: {k: _digits(x) for k, x in named.items()} for group, named in parameters.items()}


def px4_parameters(team: Team) -> dict[str, dict[str, float]]:
    """Return PX4's parameters of every drone of a team, by its name in the plan.

    By default PX4 tilts as if thrust were ``m g``, too far where cables pull downward, and takes
    their pull for weight. Gains are those that are stated: of velocity, then of position by it.
    """
    found = []
    for kind in team.quadrotor:
        own: dict[str, float] = {"MPC_ACC_DECOUPLE": 0, "MPC_USE_HTE": 0}
        if kind.gains is not None:
            loop = kind.loop
            for axes, kp, kd, ki in zip(("XY", "Z"), loop.kp, loop.kd, loop.ki, strict=True):
                own[f"MPC_{axes}_P"] = _digits(kp / kd)
                own[f"MPC_{axes}_VEL_P_ACC"] = _digits(kd / kind.mass)
                own[f"MPC_{axes}_VEL_I_ACC"] = _digits(ki * kd / (kp * kind.mass))
        found.append(own)
    each = team.drones // len(found)
    return {name: found[i // each] for i, name in enumerate(team.drone_names)}


def _digits(value: float) -> float:
    return value if isinstance(value, int) else float(f"{value:.6g}")


def describe_differences(
    wanted: Mapping[str, Mapping[str, float]], held: Callable[[str, str], object]
) -> str:
    """Return in words which parameters are not as wanted; nothing if all are held."""
    words = []
    for group in wanted:
        for name, value in _mapping(wanted, group).items():
            value_held = held(group, name)
            if not (
                isinstance(value_held, int | float)
                and isinstance(value, int | float)
                and math.isclose(value_held, value, rel_tol=SINGLE)
            ):
                shown = "missing" if value_held is None else value_held
                words.append(f"{group}.{name} is {shown}, not {value}")
    return ", ".join(words)


def settings_findings(
    settings: Mapping[str, Any], manifest: Mapping[str, Any] | None
) -> Iterator[Finding]:
    """Yield faults of a crazyflies.yaml for drones that cables pull.

    Its robots have to have the parameters that their manifest says, else those of the filter.
    """
    types, roles = _mapping(settings, "robot_types"), _mapping(manifest or {}, "drones")
    exported = _mapping(_mapping(manifest or {}, "receiver"), "parameters")
    of_robots = {str(name): _mapping(exported, role) for role, name in roles.items()}
    for name, robot in _mapping(settings, "robots").items():
        if not isinstance(robot, Mapping) or robot.get("enabled") is False:
            continue
        kind = _mapping(types, str(robot.get("type")))
        levels = [_mapping(x, "firmware_params") for x in (robot, kind, _mapping(settings, "all"))]

        def held(group: str, key: str, levels: list[Any] = levels) -> object:
            found = (_mapping(level, group).get(key) for level in levels)
            return next((value for value in found if value is not None), None)

        wanted = of_robots.get(str(name)) or HELD.firmware_params
        if words := describe_differences(wanted, held):
            level, effect = warning, "a cable's pull makes the filter blind"
            if exported:
                level, effect = error, "fly.py refuses to arm"
            yield level("parameters", str(name), f"{words}: {effect}")
        marker = str(_mapping(kind, "motion_capture").get("marker"))
        if "single" in marker:
            effect = "has no attitude, and the filter's parameters count on one; mount four"
            yield warning("markers", str(name), f"one marker ({marker}) {effect}")


def _mapping(values: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return the mapping at a key, an empty one if there is none."""
    value = values.get(key)
    return value if isinstance(value, Mapping) else {}
