"""Parameters of the Crazyflie firmware and of PX4 for the drones of a team, and their comparison.

Every export to Crazyflies has parameters of the filter; gains are those of the team's position
loops (``drones/firmware.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import numpy as np

from hitchopt.drones.controllers import HELD, FlightController
from hitchopt.drones.firmware import Parameters, firmware_parameters, px4_parameters, stated_gains
from hitchopt.errors import InputError
from hitchopt.exports.contents import Finding, error, warning
from hitchopt.hitch import Quadrotor, Team
from hitchopt.values import alternatives

SETTINGS = "crazyflies.yaml"  # File of a fleet's robots and their parameters

PARAMETER_TOLERANCE = 1e-5  # Relative tolerance of parameters in single precision


def refuse_controllers(team: Team, supported: Collection[str], receiver: str) -> None:
    """Raise InputError if a team has a named controller that a receiver does not support."""
    for name in {kind.controller for kind in team.quadrotor} - {None, *supported}:
        bound = f"{alternatives([*supported])} for {receiver}"
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
            gains = stated_gains(kind, stiffness, damping)
            loop = None if gains is None else FlightController.of("mellinger", kind.mass, gains)
        return firmware_parameters(kind, loop)

    kinds = (team.kinds[place] for place in team.listed)
    return dict(zip(team.listed_names, map(of_kind, kinds), strict=True))


def px4_team_parameters(
    team: Team, stiffness: float | None = None, damping: float | None = None
) -> dict[str, dict[str, float]]:
    """Return the PX4 parameters of all drones of a team, by name in the plan.

    ``stiffness`` [N/m] and ``damping`` [N s/m] are for drones without a named controller.
    """
    kinds = (team.kinds[place] for place in team.listed)
    parameters = (px4_parameters(kind, stiffness, damping) for kind in kinds)
    return dict(zip(team.listed_names, parameters, strict=True))


def px4_notes(
    team: Team, stiffness: float | None = None, damping: float | None = None
) -> Iterator[str]:
    """Yield a note on every kind whose stated gains PX4's ranges clip."""
    for kind in dict.fromkeys(team.quadrotor):
        if (gains := stated_gains(kind, stiffness, damping)) is None:
            continue
        loop = FlightController.of("px4", kind.mass, gains)
        flown = {key: getattr(loop, key) for key in vars(gains)}
        stated = {key: getattr(gains, key) or flown[key] for key in flown}
        if not np.allclose([*stated.values()], [*flown.values()], rtol=1e-9):
            text = ", ".join(f"{key} [{x:.4g}, {z:.4g}]" for key, (x, z) in flown.items())
            yield f"gains are clipped to the ranges that PX4 declares: {text}"


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
    types = mapping_at(settings, "robot_types")
    roles = mapping_at(manifest or {}, "drones")
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
