"""The schema of a fleet file, and that of Crazyswarm2's crazyflies.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, ValidationError

from hitchopt.errors import InputError
from hitchopt.mission.schema import Keys
from hitchopt.storage.plain import key_path, plain

URI = r"^(radio|usb|udp|tcp|serial)://\S+$"


class DroneKeys(Keys):
    """One drone of the fleet."""

    name: str = Field(description="What files and topics call it", examples=["cf231"])
    uri: str = Field(
        description="Address of its radio",
        pattern=URI,
        examples=["radio://0/80/2M/E7E7E7E7E7"],
    )
    type: str = Field(default="default", description="Its entry in types")


class FleetKeys(Keys):
    """Who flies the plan's drones."""

    drones: dict[str, DroneKeys] = Field(description="By the plan's names: q0, r0, q1, …")
    types: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="Settings of the types, copied into crazyflies.yaml"
    )
    settings: dict[str, Any] = Field(
        default_factory=dict, description="Settings for all drones, copied into crazyflies.yaml"
    )


class RobotKeys(Keys):
    """One robot of a crazyflies.yaml."""

    enabled: bool = True
    uri: str = Field(pattern=URI)
    initial_position: list[float] = Field(default_factory=list, description="The plan's is used")
    type: str = "default"
    role: str = Field(default="", description="The plan's drone that it flies; else its own name")


class RobotsKeys(Keys):
    """A crazyflies.yaml: who flies, by the robots' names."""

    fileversion: int = 3
    robots: dict[str, RobotKeys] = Field(description="By their names")
    robot_types: dict[str, dict[str, Any]] = Field(default_factory=dict)
    all: dict[str, Any] = Field(default_factory=dict)


WORDS = {
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
        bound, remedy = WORDS.get(entry["type"], (entry["msg"], "see the fleet file's example"))
        raise InputError(key_path(entry["loc"]) or "fleet", value, bound, remedy) from None


def _by_role(file: RobotsKeys) -> FleetKeys:
    """Return the enabled robots by the drones of the plan that they fly."""
    drones: dict[str, DroneKeys] = {}
    for name, robot in file.robots.items():
        if not robot.enabled:
            continue
        role = robot.role or name
        if role in drones:
            raise InputError(
                f"{key_path(['robots', name])}.role",
                role,
                f"of one enabled robot only, and {drones[role].name} has it",
                "disable one of them",
            )
        drones[role] = DroneKeys(name=name, uri=robot.uri, type=robot.type)
    return FleetKeys(drones=drones, types=file.robot_types, settings=file.all)
