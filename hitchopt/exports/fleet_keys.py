"""The schema of a fleet file, and that of Crazyswarm2's crazyflies.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError

from hitchopt.errors import InputError
from hitchopt.mission.schema import Keys
from hitchopt.storage.plain import key_path, plain

Uri = Annotated[str, Field(pattern=r"^(radio|usb|udp|tcp|serial)://\S+$")]
"""Address of a drone's radio."""


class DroneKeys(Keys):
    """One drone: what files and topics call it, its radio's address, and its entry in types."""

    name: str
    uri: Uri
    type: str = "default"


class FleetKeys(Keys):
    """Drones by the plan's names; types and settings are copied into crazyflies.yaml."""

    drones: dict[str, DroneKeys]
    types: dict[str, dict[str, Any]] = Field(default_factory=dict)
    settings: dict[str, Any] = Field(default_factory=dict)


class RobotKeys(Keys):
    """One robot of a crazyflies.yaml; without a role it flies the drone of its own name."""

    enabled: bool = True
    uri: Uri
    initial_position: list[float] = Field(default_factory=list)  # the plan's is used
    type: str = "default"
    role: str = ""


class RobotsKeys(Keys):
    """A crazyflies.yaml, robots by their names."""

    fileversion: int = 3
    robots: dict[str, RobotKeys]
    robot_types: dict[str, dict[str, Any]] = Field(default_factory=dict)
    all: dict[str, Any] = Field(default_factory=dict)


FAULTS = {
    "missing": ("given", "add it"),
    "extra_forbidden": (
        "a known key",
        "drones have name, uri and type; robots of a crazyflies.yaml enabled, uri, "
        "initial_position, type and role, and other settings go into their type",
    ),
    "string_pattern_mismatch": ("an address", "such as radio://0/80/2M/E7E7E7E7E7"),
    "string_type": ("text", "put it in quotes"),
}
"""Bound and remedy for the kinds of faults that fleet files have."""


def checked_keys(data: Mapping[str, Any]) -> FleetKeys:
    """Return the fleet of plain data, either a fleet file's or that of a crazyflies.yaml.

    Raises
    ------
    InputError: keys or values that are wrong, the first of them; two robots of one role.
    """
    try:
        if "robots" not in data:
            return FleetKeys.model_validate(plain(data))
        return _by_role(RobotsKeys.model_validate(plain(data)))
    except ValidationError as error:
        entry = error.errors(include_url=False)[0]
        value = "(missing)" if entry["type"] == "missing" else entry["input"]
        bound, remedy = FAULTS.get(entry["type"], (entry["msg"], "see the fleet file's example"))
        raise InputError(key_path(entry["loc"]) or "fleet", value, bound, remedy) from None


def _by_role(file: RobotsKeys) -> FleetKeys:
    """Return the enabled robots by the drones of the plan that they fly."""
    drones: dict[str, DroneKeys] = {}
    for name, robot in file.robots.items():
        role = robot.role or name
        if robot.enabled and role in drones:
            bound = f"of one enabled robot only, and {drones[role].name} has it"
            key = f"{key_path(['robots', name])}.role"
            raise InputError(key, role, bound, "disable one of them")
        if robot.enabled:
            drones[role] = DroneKeys(name=name, uri=robot.uri, type=robot.type)
    return FleetKeys(drones=drones, types=file.robot_types, settings=file.all)
