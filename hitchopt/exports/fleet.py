"""The fleet: names, radio addresses and types of the drones that a plan calls q0, r0, q1, ….

A fleet file is YAML, one entry per drone of the plan::

    drones:
      q0: {name: cf231, uri: radio://0/80/2M/E7E7E7E7E7, type: cf21}
      r0: {name: cf232, uri: radio://0/80/2M/E7E7E7E7E8, type: cf21}
    types:                      # optional, copied into crazyflies.yaml
      cf21: {motion_capture: {tracking: librigidbodytracker}}
    settings: {}                # optional, for all drones, likewise

A ``crazyflies.yaml`` is a fleet file too: every enabled robot flies the drone of the plan that its
key ``role`` names, else the one of its own name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from hitchopt.errors import FileError, InputError
from hitchopt.steps.step_keys import Keys
from hitchopt.storage.yaml_file import key_path, plain, read_yaml

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}\Z")
"""Pattern of names that suit files, ROS topics and keys of YAML alike."""

RESERVED = frozenset(("y", "n", "yes", "no", "on", "off", "true", "false", "null"))
"""Names that YAML 1.1, as ROS reads it, takes for something else."""

PER_RADIO = 15  # Drones that one radio serves with trajectories uploaded


@dataclass(frozen=True)
class Member:
    """One drone of the fleet."""

    role: str  # its name in the plan, such as q0
    name: str  # its name in files
    uri: str  # its radio's address
    type: str = "default"  # its entry in types


@dataclass(frozen=True)
class Fleet:
    """All drones of a plan, in its order."""

    members: tuple[Member, ...]
    types: Mapping[str, Any] = field(default_factory=dict)  # settings of the types, as given
    settings: Mapping[str, Any] = field(default_factory=dict)  # for all drones; empty: the usual
    given: bool = False  # whether the user named them; else their addresses are placeholders


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


def placeholder_fleet(roles: Sequence[str]) -> Fleet:
    """Return drones called as in the plan, at addresses counted up from E7E7E7E701."""
    members = [
        Member(role, role, f"radio://{i // PER_RADIO}/80/2M/{0xE7E7E7E701 + i:010X}")
        for i, role in enumerate(roles)
    ]
    return Fleet(tuple(members))


def read_fleet(path: str | Path, roles: Sequence[str]) -> Fleet:
    """Return the fleet of a file; it names every drone of the plan once.

    Raises
    ------
    FileError: the file cannot be read as YAML.
    InputError: keys, names or addresses that are wrong.
    """
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise FileError(f"{path}: is no mapping; a fleet file has the key drones or robots")
    return fleet_from_dict(data, roles)


def fleet_from_dict(data: Mapping[str, Any], roles: Sequence[str]) -> Fleet:
    """Return the fleet that ``data`` describes with the keys of a fleet file or crazyflies.yaml.

    Raises
    ------
    InputError: keys, names or addresses that are wrong.
    """
    robots = "robots" in data
    try:
        keys = (
            _by_role(RobotsKeys.model_validate(plain(data)))
            if robots
            else FleetKeys.model_validate(plain(data))
        )
    except ValidationError as error:
        entry = error.errors(include_url=False)[0]
        value = "(missing)" if entry["type"] == "missing" else entry["input"]
        bound, remedy = FAULTS.get(entry["type"], (entry["msg"], "see the fleet file's example"))
        raise InputError(key_path(entry["loc"]) or "fleet", value, bound, remedy) from None
    root = "robots" if robots else "drones"
    missing = [role for role in roles if role not in keys.drones]
    if wrong := missing or [role for role in keys.drones if role not in set(roles)]:
        bound = "named once, and be a drone of the plan" if missing else "a drone of the plan"
        known = f"the plan's drones are {', '.join(roles[:6])}{', …' if len(roles) > 6 else ''}"
        more = "; a robot's role tells which it flies" if robots else ""
        raise InputError(root, wrong[0], bound, known + more)
    members = tuple(Member(role=role, **dict(keys.drones[role])) for role in roles)
    seen: set[str] = set()
    for member in members:
        where = f"{root}.{member.name if robots else member.role}"
        if not NAME.match(member.name) or member.name.lower() in RESERVED:
            bound = "letters, digits and underscores, a letter first, and no word of YAML"
            raise InputError(f"{where}.name", member.name, bound, "files and topics are called so")
        for key in ("name", "uri"):  # no name is an address
            value = getattr(member, key)
            if value.lower() in seen:
                raise InputError(f"{where}.{key}", value, "of one drone only", "give each its own")
            seen.add(value.lower())
    given = [member.uri for member in members] != [m.uri for m in placeholder_fleet(roles).members]
    return Fleet(members, keys.types, keys.settings, given)


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
