"""Fleet files and coordinate frames: assign and place the drones of a plan.

A fleet file is YAML, one entry per drone of the plan::

    drones:
      q0: {name: cf231, uri: radio://0/80/2M/E7E7E7E7E7, type: cf21}
      r0: {name: cf232, uri: radio://0/80/2M/E7E7E7E7E8, type: cf21}
    types:                      # optional, copied into crazyflies.yaml
      cf21: {motion_capture: {tracking: librigidbodytracker}}
    settings: {}                # optional, for all drones, likewise

A ``crazyflies.yaml`` is a fleet file too: every enabled robot flies the drone of the plan in its
key ``role``, by default the drone of its own name.

A plan's frame is read as east-north-up: x east, y north, z up. Its origin is at ``origin``, and it
is rotated by ``yaw``. Files have different axes:

    enu: (x, y, z)      east, north, up        heading yaw
    nwu: (y, -x, z)     north, west, up        heading yaw - π/2
    ned: (y, x, -z)     north, east, down      heading π/2 - yaw

where ``(x, y, z) = Rz(yaw) p + origin`` for a point p of the plan.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.motion.flight import Flight, drone_places
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, finite
from hitchopt.values.fields import (
    ANYTHING,
    FLAGS,
    Key,
    dict_of,
    integers,
    list_of,
    mapping_of,
    strings,
)
from hitchopt.values.units import NUMBER

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}\Z")  # Valid in files, ROS topics and YAML
RESERVED = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}  # Literals of YAML 1.1
URI = re.compile(r"(radio|usb|udp|tcp|serial)://\S+\Z")  # Radio addresses of drones
PER_RADIO = 15  # Drones per radio with uploaded trajectories


def places_text(flight: Flight, fleet: Fleet) -> str:
    """Return the table of drones on cables: names in files and problem, and ends of edges.

    Empty without cables.
    """
    robots = {member.role: member.name for member in fleet.members}
    rows = [{"name": robots[row["drone"]], **row} for row in drone_places(flight)]
    if not rows:
        return ""
    lines = [[*rows[0]], *([*row.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
    return "\nDrones by name in these files and in the problem:\n" + "\n".join(text) + "\n"


_WORD = strings(1000)


def _number(key: str, value: object) -> int | float:
    """Return a number, int or float, unchanged; raises InputError for other values."""
    NUMBER.check(key, value)
    return value  # type: ignore[return-value]


_NUMBER = replace(NUMBER, check=_number)


@dataclass(frozen=True)
class Member:
    """A drone in a fleet file, or a robot in a crazyflies.yaml."""

    uri: Annotated[str, Key(_WORD, "Address of its radio")]
    name: Annotated[str, Key(_WORD, "Name in files and topics; the key in a crazyflies.yaml")] = ""
    type: Annotated[str, Key(_WORD, "Entry in the types")] = "default"
    role: Annotated[str, Key(_WORD, "Name in the plan; the key in a fleet file")] = ""
    enabled: Annotated[bool, Key(FLAGS, "Whether it flies")] = True
    initial_position: Annotated[
        list[float], Key(list_of(NUMBER), "Initial position; that of the plan is used")
    ] = field(default_factory=list)
    firmware_params: Annotated[
        dict[str, dict[str, int | float]],
        Key(dict_of(dict_of(_NUMBER, _WORD), _WORD), "Parameters by group and name"),
    ] = field(default_factory=dict)


@dataclass(frozen=True)
class Fleet:
    """All drones of a plan, in its order."""

    members: tuple[Member, ...]
    types: Mapping[str, Any] = field(default_factory=dict)  # settings of the types
    settings: Mapping[str, Any] = field(default_factory=dict)  # for all drones; empty for defaults
    is_placeholder: bool = True  # whether names and addresses are placeholders


_DRONES = Key(dict_of(mapping_of(Member), _WORD), "Drones, by their keys")
_TYPES = Key(dict_of(dict_of(ANYTHING, _WORD), _WORD), "Settings of the types")
_SETTINGS = Key(dict_of(ANYTHING, _WORD), "Settings of all drones")


@dataclass(frozen=True)
class FleetKeys:
    """Keys of a fleet file, and of a crazyflies.yaml: robots, robot_types, all, fileversion."""

    drones: Annotated[dict[str, Member], _DRONES] = field(default_factory=dict)
    robots: Annotated[dict[str, Member], _DRONES] = field(default_factory=dict)
    types: Annotated[dict[str, Any], _TYPES] = field(default_factory=dict)
    robot_types: Annotated[dict[str, Any], _TYPES] = field(default_factory=dict)
    settings: Annotated[dict[str, Any], _SETTINGS] = field(default_factory=dict)
    all: Annotated[dict[str, Any], _SETTINGS] = field(default_factory=dict)
    fileversion: Annotated[int, Key(integers(0, 1000), "Version of the format")] = 3


def placeholder_fleet(roles: Sequence[str], *, dotted: bool = False) -> Fleet:
    """Return drones with their names of the plan, and addresses from E7E7E7E701.

    Unless names may be ``dotted``, a drone ``a.q0`` of several teams is named ``a_q0``.
    """

    def uri(i: int) -> str:
        return f"radio://{i // PER_RADIO}/80/2M/{0xE7E7E7E701 + i:010X}"

    names = roles if dotted else [role.replace(".", "_") for role in roles]
    each = enumerate(zip(roles, names, strict=True))
    return Fleet(tuple(Member(role=role, name=name, uri=uri(i)) for i, (role, name) in each))


def read_fleet(path: str | Path, roles: Sequence[str]) -> Fleet:
    """Return the fleet of a fleet file or a crazyflies.yaml, with all drones of a plan."""
    data = read_yaml(path)
    _check_roles(data, roles)
    keys: FleetKeys = mapping_of(FleetKeys).check("", data)
    root = "robots" if keys.robots else "drones"
    drones: dict[str, Member] = {}
    unique: set[str] = set()
    for default, entry in (keys.robots or keys.drones).items():
        if not entry.enabled:
            continue
        role, name = entry.role or default, entry.name or default
        # The plan places its drones. Positions in a crazyflies.yaml are those of an earlier export:
        # without them, its fleet equals that of the fleet file from which it was written
        member = replace(entry, role=role, name=name, initial_position=[])
        where = f"{root}.{member.name if root == 'robots' else member.role}"
        if member.role in drones:
            bound = f"the role of one enabled robot only, and {drones[member.role].name} has it"
            raise InputError(f"{where}.role", member.role, bound, "disable one of them")
        if not NAME.match(member.name) or member.name.lower() in RESERVED:
            bound = "letters, digits and underscores, a letter first, and no word of YAML"
            raise InputError(
                f"{where}.name", member.name, bound, "it is used in file names and topics"
            )
        if not URI.match(member.uri):
            remedy = "such as radio://0/80/2M/E7E7E7E707"
            raise InputError(f"{where}.uri", member.uri, "an address", remedy)
        for key, value in (("name", member.name), ("uri", member.uri)):
            if value.lower() in unique:
                raise InputError(
                    f"{where}.{key}", value, "unique among drones", "use a unique one per drone"
                )
            unique.add(value.lower())
        drones[member.role] = member
    for role in roles:
        if role not in drones:
            raise InputError(root, role, "named once, in the fleet", _role_remedy(roles))
    members = tuple(drones[role] for role in roles)
    types = keys.types or keys.robot_types
    return Fleet(members, types, keys.settings or keys.all, is_placeholder=False)


def _check_roles(data: object, roles: Sequence[str]) -> None:
    """Raise InputError for the first enabled robot that flies no drone of the plan.

    Its other keys do not matter then.
    """
    sections = data if isinstance(data, Mapping) else {}
    root = "robots" if sections.get("robots") else "drones"
    robots = sections.get(root)
    for name, entry in robots.items() if isinstance(robots, Mapping) else ():
        own = entry if isinstance(entry, Mapping) else {}
        role = own.get("role") or name
        if own.get("enabled") is not False and isinstance(role, str) and role not in roles:
            raise InputError(root, role, "a drone of the plan", _role_remedy(roles))


def _role_remedy(roles: Sequence[str]) -> str:
    names = f"the plan's drones are {', '.join(roles[:6])}{', …' if len(roles) > 6 else ''}"
    return f"{names}; a robot's role states which one it flies"


AXES = {
    "enu": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "nwu": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Axes of frames as rows, in east-north-up."""


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """The frame of a file, enu, nwu or ned, and the placement of the plan.

    ``origin`` (3,) [m] is the position of the plan's origin, east-north-up; ``yaw`` [rad] is the
    rotation of the plan, counter-clockwise from above.
    """

    name: str = "enu"
    origin: ArrayLike = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in AXES:
            bound = f"one of {', '.join(AXES)}"
            raise InputError("frame", self.name, bound, "enu is the plan's own")
        point = np.array(self.origin, dtype=np.float64)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise InputError(
                "origin", self.origin, "three finite numbers", "specify x y z in metres"
            )
        point.setflags(write=False)
        object.__setattr__(self, "origin", point)
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) from the plan's axes to the file's axes."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation: Array = AXES[self.name] @ turn + 0.0  # no negative zeros
        return rotation

    @property
    def shift(self) -> Array:
        """Position (3,) [m] of the plan's origin in the file's axes."""
        return AXES[self.name] @ np.asarray(self.origin, dtype=np.float64)

    @property
    def heading(self) -> float:
        """Yaw of the drones in the file's axes [rad], in (-π, π]; in the plan it is 0."""
        x, y, _ = self.rotation[:, 0]
        heading = math.atan2(y, x)
        return math.pi if heading == -math.pi else heading

    def vectors(self, values: Array) -> Array:
        """Return vectors (…, 3) of the plan in the file's axes."""
        return values @ self.rotation.T

    def points(self, values: Array) -> Array:
        """Return points (…, 3) of the plan in the file's axes [m]."""
        return values @ self.rotation.T + self.shift

    def planned(self, points: Array) -> Array:
        """Return points (…, 3) of the file in the plan's axes [m]."""
        return (points - self.shift) @ self.rotation

    def placed(self, part: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return points (items, 3) of the plan in the file's axes [m]."""
        return part.replaced(self.rotation @ part.coefficients + self.shift[:, None])

    def in_plan(self, part: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return points (items, 3) of the file in the plan's axes [m]."""
        return part.replaced(self.rotation.T @ (part.coefficients - self.shift[:, None]))

    def to_dict(self) -> dict[str, object]:
        """Return the frame as plain data for files."""
        origin = np.asarray(self.origin).tolist()
        return {"frame": self.name, "origin_enu": origin, "yaw_deg": math.degrees(self.yaw)}
