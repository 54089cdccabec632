"""Parameters of the Crazyflie firmware and of PX4 for a team's drones.

The Crazyflie's Kalman filter attributes sideways accelerations to tilt only, because it uses the
accelerometer along the thrust only. With the firmware's default noises, a sideways cable force
makes it ignore measurements, so every export has parameters of the filter. Gains are those of the
team's position loops. Attitude gains are scaled for the same rotational dynamics as a stock
Crazyflie: for its proportions, arms grow with mass to the power 1/3, inertia to the power 5/3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.exports.contents import Finding, error, warning
from hitchopt.hitch import GRAVITY, Quadrotor, Team
from hitchopt.hitch.flight_controller import HELD, FlightController, Gains, px4_gains

SETTINGS = "crazyflies.yaml"  # File of a fleet's robots and their parameters
Parameters = dict[str, dict[str, float]]  # By group and name; integers are int

CONTROLLERS = {"pid": 1, "mellinger": 2, "lee": 5}
"""Values of the firmware's ``stabilizer.controller`` of supported controllers."""

KALMAN = 2  # Value of ``stabilizer.estimator`` for the extended Kalman filter
MAX_COMMAND = 65535.0  # Command of full thrust
STOCK_INERTIA = 16.57e-6, 16.66e-6, 29.26e-6  # Inertia of a Crazyflie 2.1 [kg m²]
STOCK_MASS = 0.0313  # Its mass [kg], for a radius of gyration of half its arms of 46 mm
STOCK_THRUST = MAX_COMMAND / 132_000.0  # Its full thrust [N], by the default of ``massThrust``

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

PARAMETER_TOLERANCE = 1e-5  # Relative tolerance of parameters in single precision


def refuse_controllers(team: Team, supported: Collection[str], receiver: str) -> None:
    """Raise InputError if a team has a named controller that a receiver does not support."""
    for name in {kind.controller for kind in team.quadrotor} - {None, *supported}:
        bound = f"one of {', '.join(supported)} for {receiver}"
        remedy = "plan for one of them, or without a controller, by mass and max_thrust"
        raise InputError("team.quadrotor.controller", name, bound, remedy)


def team_parameters(
    team: Team, stiffness: float | None = None, damping: float | None = None
) -> dict[str, Parameters]:
    """Return the Crazyflie parameters of all drones of a team, by name in the plan.

    Gains [N/m], [N s/m] are for drones without a named controller, which get Mellinger's. Raises
    InputError for unstable gains, and for gains that the firmware does not have.
    """

    def of_kind(kind: Quadrotor) -> Parameters:
        loop: FlightController | None = kind.loop
        if kind.controller is None:
            gains = _stated_gains(kind, stiffness, damping)
            loop = None if gains is None else FlightController.of("mellinger", kind.mass, gains)
        return firmware_parameters(kind, loop)

    kinds = (team.kinds[place] for place in team.listed)
    return dict(zip(team.listed_names, map(of_kind, kinds), strict=True))


def _stated_gains(kind: Quadrotor, stiffness: float | None, damping: float | None) -> Gains | None:
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

    They have the six digits of single precision. The controller is one of CONTROLLERS.
    """
    name = "mellinger" if loop is None else loop.name
    parameters: Parameters = {"stabilizer": {"estimator": KALMAN, "controller": CONTROLLERS[name]}}
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
    team: Team, stiffness: float | None = None, damping: float | None = None
) -> dict[str, dict[str, float]]:
    """Return the PX4 parameters of all drones of a team, by name in the plan.

    By default PX4 computes the tilt with thrust ``m g``, which is too much tilt if cables pull
    downward, and estimates the cable force as weight. Stated gains are those of PX4's velocity loop
    and of the position loop around it, within the ranges that PX4 declares; ``stiffness`` [N/m] and
    ``damping`` [N s/m] are for drones without a named controller.
    """

    def of_kind(kind: Quadrotor) -> dict[str, float]:
        parameters: dict[str, float] = {"MPC_ACC_DECOUPLE": 0, "MPC_USE_HTE": 0}
        if (stated := _stated_gains(kind, stiffness, damping)) is not None:
            loop = FlightController.of("px4", kind.mass, stated)
            gains = px4_gains(loop.kp, loop.kd, loop.ki, kind.mass)
            parameters |= {name: _rounded(gain) for name, gain in gains.items()}
        return parameters

    kinds = (team.kinds[place] for place in team.listed)
    return dict(zip(team.listed_names, map(of_kind, kinds), strict=True))


def px4_notes(
    team: Team, stiffness: float | None = None, damping: float | None = None
) -> Iterator[str]:
    """Yield a note on every kind whose stated gains PX4's ranges clip."""
    for kind in dict.fromkeys(team.quadrotor):
        if (gains := _stated_gains(kind, stiffness, damping)) is None:
            continue
        loop = FlightController.of("px4", kind.mass, gains)
        flown = {key: getattr(loop, key) for key in vars(gains)}
        stated = {key: getattr(gains, key) or flown[key] for key in flown}
        if not np.allclose([*stated.values()], [*flown.values()], rtol=1e-9):
            text = ", ".join(f"{key} [{x:.4g}, {z:.4g}]" for key, (x, z) in flown.items())
            yield f"gains are clipped to the ranges that PX4 declares: {text}"


def _rounded(value: float) -> float:
    return value if isinstance(value, int) else float(f"{value:.6g}")


def describe_differences(
    expected: Mapping[str, Mapping[str, float]], value_of: Callable[[str, str], object]
) -> str:
    """Describe the parameters whose values differ from the expected ones; empty if none do."""
    differences = []
    for group in expected:
        for name, value in mapping_at(expected, group).items():
            actual = value_of(group, name)
            if not (
                isinstance(actual, int | float)
                and isinstance(value, int | float)
                and math.isclose(actual, value, rel_tol=PARAMETER_TOLERANCE)
            ):
                text = "missing" if actual is None else actual
                differences.append(f"{group}.{name} is {text}, not {value}")
    return ", ".join(differences)


def settings_findings(
    settings: Mapping[str, Any], manifest: Mapping[str, Any] | None
) -> Iterator[Finding]:
    """Yield findings on a crazyflies.yaml for drones with cables.

    Its robots must have the parameters of the manifest, or else those of the filter.
    """
    types, roles = mapping_at(settings, "robot_types"), mapping_at(manifest or {}, "drones")
    exported = mapping_at(mapping_at(manifest or {}, "receiver"), "parameters")
    by_robot = {str(name): mapping_at(exported, role) for role, name in roles.items()}
    for name, robot in mapping_at(settings, "robots").items():
        if not isinstance(robot, Mapping) or robot.get("enabled") is False:
            continue
        kind = mapping_at(types, str(robot.get("type")))
        sections = (robot, kind, mapping_at(settings, "all"))
        levels = [mapping_at(section, "firmware_params") for section in sections]

        def value_of(group: str, key: str, levels: list[Any] = levels) -> object:
            values = (mapping_at(level, group).get(key) for level in levels)
            return next((value for value in values if value is not None), None)

        expected = by_robot.get(str(name)) or HELD.firmware_params
        if differences := describe_differences(expected, value_of):
            level, effect = warning, "a cable's pull misleads the filter"
            if exported:
                level, effect = error, "fly.py refuses to arm"
            yield level("parameters", str(name), f"{differences}: {effect}")
        marker = str(mapping_at(kind, "motion_capture").get("marker"))
        if "single" in marker:
            effect = "gives no attitude, which the filter's parameters require; mount four"
            yield warning("markers", str(name), f"one marker ({marker}) {effect}")


def mapping_at(values: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return the mapping at a key, or an empty one."""
    value = values.get(key)
    return value if isinstance(value, Mapping) else {}
