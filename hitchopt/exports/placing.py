"""Who flies a plan, and where: the fleet's file, and the frame of a file.

A fleet file is YAML, one entry per drone of the plan::

    drones:
      q0: {name: cf231, uri: radio://0/80/2M/E7E7E7E7E7, type: cf21}
      r0: {name: cf232, uri: radio://0/80/2M/E7E7E7E7E8, type: cf21}
    types:                      # optional, copied into crazyflies.yaml
      cf21: {motion_capture: {tracking: librigidbodytracker}}
    settings: {}                # optional, for all drones, likewise

A ``crazyflies.yaml`` is a fleet file too: every enabled robot flies the drone of the plan that its
key ``role`` names, else the one of its own name.

A plan's world is read as east-north-up: x east, y north, z up. In the frame its origin lies at
``origin`` and it is turned by ``yaw``; a file then names its own axes:

    enu: (x, y, z)      east, north, up        heading yaw
    nwu: (y, -x, z)     north, west, up        heading yaw - π/2
    ned: (y, x, -z)     north, east, down      heading π/2 - yaw

where ``(x, y, z) = Rz(yaw) p + origin`` for a point p of the plan.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError

from hitchopt.errors import FileError, InputError
from hitchopt.steps.step import Keys
from hitchopt.storage.yaml_file import key_path, plain, read_yaml
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, finite

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}\Z")
"""Pattern of names that suit files, ROS topics and keys of YAML alike."""

RESERVED = frozenset(("y", "n", "yes", "no", "on", "off", "true", "false", "null"))
"""Names that YAML 1.1, as ROS reads it, takes for something else."""

PER_RADIO = 15  # Drones that one radio serves with trajectories uploaded


Uri = Annotated[str, Field(pattern=r"^(radio|usb|udp|tcp|serial)://\S+$")]
"""Address of a drone's radio."""


class Member(Keys):
    """One drone: what files and topics call it, its radio's address, and its entry in types."""

    name: str
    uri: Uri
    type: str = "default"
    role: str = ""  # its name in the plan, such as q0
    enabled: bool = True
    initial_position: list[float] = Field(default_factory=list)  # the plan's is used


class FleetKeys(Keys):
    """Drones by the plan's names, or robots by their own; types and settings are copied."""

    drones: dict[str, Member]
    types: dict[str, dict[str, Any]] = Field(default_factory=dict)
    settings: dict[str, Any] = Field(default_factory=dict)
    fileversion: int = 3


@dataclass(frozen=True)
class Fleet:
    """All drones of a plan, in its order."""

    members: tuple[Member, ...]
    types: Mapping[str, Any] = field(default_factory=dict)  # settings of the types, as given
    settings: Mapping[str, Any] = field(default_factory=dict)  # for all drones; empty: the usual
    given: bool = False  # whether the user named them; else their addresses are placeholders


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

ROBOTS = {"robots": "drones", "robot_types": "types", "all": "settings"}
"""Keys of a crazyflies.yaml, and those of a fleet file that say the same."""


def placeholder_fleet(roles: Sequence[str]) -> Fleet:
    """Return drones called as in the plan, at addresses counted up from E7E7E7E701."""

    def uri(i: int) -> str:
        return f"radio://{i // PER_RADIO}/80/2M/{0xE7E7E7E701 + i:010X}"

    members = (Member(role=role, name=role, uri=uri(i)) for i, role in enumerate(roles))
    return Fleet(tuple(members))


def read_fleet(path: str | Path, roles: Sequence[str]) -> Fleet:
    """Return the fleet of a file, a fleet file or a crazyflies.yaml, for all drones of a plan.

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
    """Return the fleet that ``data`` describes; errors as those of ``read_fleet``."""
    root = "robots" if "robots" in data else "drones"
    given: dict[str, Any] = {ROBOTS.get(key, key): plain(value) for key, value in data.items()}
    if root == "robots" and isinstance(given["drones"], dict):
        robots = given["drones"].items()
        given["drones"] = {k: {**v, "name": k} if isinstance(v, dict) else v for k, v in robots}
    try:
        keys = FleetKeys.model_validate(given)
    except ValidationError as error:
        entry = error.errors(include_url=False)[0]
        value = "(missing)" if entry["type"] == "missing" else entry["input"]
        bound, remedy = FAULTS.get(entry["type"], (entry["msg"], "see the fleet file's example"))
        where = key_path([root, *entry["loc"][1:]]) if entry["loc"][:1] == ("drones",) else ""
        raise InputError(where or key_path(entry["loc"]), value, bound, remedy) from None
    drones: dict[str, Member] = {}
    seen: set[str] = set()
    for name, drone in keys.drones.items():
        role, where = (drone.role or name) if root == "robots" else name, f"{root}.{name}"
        if not drone.enabled:
            continue
        if role in drones:
            bound = f"of one enabled robot only, and {drones[role].name} has it"
            raise InputError(f"{where}.role", role, bound, "disable one of them")
        if role not in roles:
            raise _misnamed(root, role, "a drone of the plan", roles)
        if not NAME.match(drone.name) or drone.name.lower() in RESERVED:
            bound = "letters, digits and underscores, a letter first, and no word of YAML"
            raise InputError(f"{where}.name", drone.name, bound, "files and topics are called so")
        for key in ("name", "uri"):  # no name is an address
            value = getattr(drone, key)
            if value.lower() in seen:
                raise InputError(f"{where}.{key}", value, "of one drone only", "give each its own")
            seen.add(value.lower())
        drones[role] = Member(role=role, name=drone.name, uri=drone.uri, type=drone.type)
    if missing := [role for role in roles if role not in drones]:
        raise _misnamed(root, missing[0], "named once, and be a drone of the plan", roles)
    members = tuple(drones[role] for role in roles)
    placeholders = [member.uri for member in placeholder_fleet(roles).members]
    return Fleet(members, keys.types, keys.settings, placeholders != [m.uri for m in members])


def _misnamed(root: str, role: str, bound: str, roles: Sequence[str]) -> InputError:
    known = f"the plan's drones are {', '.join(roles[:6])}{', …' if len(roles) > 6 else ''}"
    more = "; a robot's role tells which it flies" if root == "robots" else ""
    return InputError(root, role, bound, known + more)


AXES = {
    "enu": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "nwu": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
}
"""Axes of every frame as rows, in east, north and up."""


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """A file's axes, and where the plan lies in them.

    Parameters
    ----------
    name: enu, nwu or ned.
    origin: (3,) [m] where the plan's origin lies, east, north and up of the frame's.
    yaw: angle by which the plan is turned, counter-clockwise seen from above [rad].

    Raises
    ------
    InputError: an unknown frame, or numbers that are not finite.
    """

    name: str = "enu"
    origin: ArrayLike = (0.0, 0.0, 0.0)
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in AXES:
            known = f"one of {', '.join(AXES)}"
            raise InputError("frame", self.name, known, "enu is the plan's own")
        point = np.array(self.origin, dtype=np.float64)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise InputError("origin", self.origin, "three finite numbers", "give x y z in metres")
        point.setflags(write=False)
        object.__setattr__(self, "origin", point)
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3) from vectors of the plan to vectors of the file."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        if self.yaw == 0.0:  # exact: a file in the plan's own frame repeats its numbers
            return AXES[self.name]
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation: Array = AXES[self.name] @ turn
        return rotation

    @property
    def shift(self) -> Array:
        """Place (3,) [m] of the plan's origin in the file's axes."""
        return AXES[self.name] @ np.asarray(self.origin, dtype=np.float64)

    @property
    def heading(self) -> float:
        """Yaw of the drones in the file's axes [rad], in (-π, π]; in the plan it is 0."""
        x, y, _ = AXES[self.name] @ np.array([math.cos(self.yaw), math.sin(self.yaw), 0.0])
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
        c = np.einsum("ij,pdjn->pdin", self.rotation, part.coefficients) + self.shift[:, None]
        return PiecewisePolynomial(part.breaks, c)

    def in_plan(self, part: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return points (items, 3) of the file in the plan's axes [m]."""
        c = np.einsum("ji,pdjn->pdin", self.rotation, part.coefficients - self.shift[:, None])
        return PiecewisePolynomial(part.breaks, c)

    def to_dict(self) -> dict[str, object]:
        """Return what a file says of its frame."""
        return {
            "frame": self.name,
            "origin_enu": np.asarray(self.origin).tolist(),
            "yaw_deg": math.degrees(self.yaw),
        }
