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
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hitchopt.errors import FileError, InputError

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}\Z")
"""Pattern of names that suit files, ROS topics and keys of YAML alike."""

RESERVED = frozenset(("y", "n", "yes", "no", "on", "off", "true", "false", "null"))
"""Names that YAML 1.1, as ROS reads it, takes for something else."""

PER_RADIO = 15
"""Drones that one radio serves with trajectories uploaded."""


@dataclass(frozen=True)
class Member:
    """One drone of the fleet.

    Attributes
    ----------
    role: its name in the plan, such as ``q0``.
    name: its name in files.
    uri: its radio's address.
    type: its entry in ``types``.
    """

    role: str
    name: str
    uri: str
    type: str = "default"


@dataclass(frozen=True)
class Fleet:
    """All drones of a plan, in its order.

    Attributes
    ----------
    members: one per drone.
    types: settings of the types, as given.
    settings: settings for all drones, as given; empty for the usual ones.
    given: whether the user named them; else their addresses are placeholders.
    """

    members: tuple[Member, ...]
    types: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    given: bool = False


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
    from hitchopt.storage.yaml_file import read_yaml

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
    from hitchopt.exports.fleet_keys import checked_keys

    keys = checked_keys(data)
    root = "robots" if "robots" in data else "drones"
    missing = [role for role in roles if role not in keys.drones]
    unknown = [role for role in keys.drones if role not in set(roles)]
    if missing or unknown:
        bound = "named once, and be a drone of the plan" if missing else "a drone of the plan"
        known = f"the plan's drones are {', '.join(roles[:6])}{', …' if len(roles) > 6 else ''}"
        more = "; a robot's role tells which it flies" if root == "robots" else ""
        raise InputError(root, (missing or unknown)[0], bound, known + more)
    members = tuple(Member(role=role, **dict(keys.drones[role])) for role in roles)
    counts = {
        key: Counter(getattr(member, key).lower() for member in members) for key in ("name", "uri")
    }
    for member in members:
        where = f"{root}.{member.name if root == 'robots' else member.role}"
        if not NAME.match(member.name) or member.name.lower() in RESERVED:
            bound = "letters, digits and underscores, a letter first, and no word of YAML"
            raise InputError(f"{where}.name", member.name, bound, "files and topics are called so")
        for key, count in counts.items():
            value = getattr(member, key)
            if count[value.lower()] > 1:
                raise InputError(f"{where}.{key}", value, "of one drone only", "give each its own")
    placeholders = [member.uri for member in placeholder_fleet(roles).members]
    given = [member.uri for member in members] != placeholders
    return Fleet(members, keys.types, keys.settings, given)
