"""What a user asks of an export, and the export of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hitchopt.checks import certify
from hitchopt.errors import FileError, InputError
from hitchopt.exports.exporting import Export, export_plan
from hitchopt.exports.fleet import placeholder_fleet, read_fleet
from hitchopt.exports.formats.format import ROS_DISTROS, Format, Task
from hitchopt.exports.formats.registry import format_of
from hitchopt.exports.frame import Room
from hitchopt.exports.single_file import ENDINGS, export_file
from hitchopt.motion.cutting import stretched
from hitchopt.motion.motion import Motion

MAX_RATE = 10_000.0
"""[Hz] Nothing takes setpoints faster."""

STORAGES = ("mcap", "sqlite3")
"""Of a bag."""


@dataclass(frozen=True)
class Wish:
    """How a plan is to be told to a fleet.

    Attributes
    ----------
    format: name of the format.
    frame: enu, nwu or ned; None for the format's usual one.
    origin: where the plan's origin lies in the room, east, north and up (3,) [m].
    yaw: how far the plan is turned there, counter-clockwise from above [rad].
    fleet: a fleet file; None calls the drones as the plan does.
    rate: samples a second [Hz], where the format samples; None for its usual rate.
    stretch: how many times as slowly to fly, from 1 on.
    storage: of a bag, mcap or sqlite3.
    ros_distro: the ROS 2 release that a bag is for: humble, iron or jazzy. Every later one reads
        bags for the earlier ones.
    """

    format: str
    frame: str | None = None
    origin: Sequence[float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    fleet: Path | str | None = None
    rate: float | None = None
    stretch: float = 1.0
    storage: str = "mcap"
    ros_distro: str = "humble"


def export_motion(
    motion: Motion,
    title: str,
    wish: Wish,
    folder: Path | str,
    progress: Callable[[str], None] | None = None,
) -> tuple[Export, ...]:
    """Write the plan as asked; return what was written, one entry per part.

    Parameters
    ----------
    motion: the plan; it is certified first, stretched as asked.
    title: what it is called.
    wish: how it is to be told.
    folder: where to; a name that ends as the format's only file does is that file, its manifest
        beside it.
    progress: called with what is being done now.

    Raises
    ------
    InputError, FileError: what was asked is wrong in itself, or cannot be written.
    CertificateError: the plan's certificate does not hold.
    InfeasibleError: the format cannot hold the plan, or loses a limit; nothing is written.
    UnsupportedError: a library that the format needs is not installed.
    """
    kind = format_of(wish.format)
    rate = _rate(kind, wish.rate)
    if wish.storage not in STORAGES:
        raise InputError("--storage", wish.storage, " or ".join(STORAGES), "mcap is usual")
    if wish.ros_distro not in ROS_DISTROS:
        raise InputError("--ros-distro", wish.ros_distro, ", ".join(ROS_DISTROS), "humble is usual")
    roles = motion.team.drone_names
    fleet = placeholder_fleet(roles) if wish.fleet is None else read_fleet(wish.fleet, roles)
    room = Room(wish.frame or kind.frames[0], wish.origin, wish.yaw)
    task = Task(
        stretched(motion, wish.stretch),
        title,
        room,
        fleet,
        rate,
        wish.storage,
        wish.rate is not None,
        ros_distro=wish.ros_distro,
    )
    place = Path(folder)
    if place.suffix.lower() in ENDINGS and not place.is_dir():
        return export_file(kind, task, certify(task.motion, progress), place, progress)
    if place.exists() and not place.is_dir():
        raise FileError(f"{place}: is a file; an export is a folder, choose another one")
    return export_plan(kind, task, certify(task.motion, progress), place, progress)


def _rate(kind: Format, rate: float | None) -> float:
    if rate is None:
        return kind.rate
    if kind.rate == 0.0:
        raise InputError("--rate", rate, f"left out for {kind.name}", "it does not sample")
    if not (math.isfinite(rate) and 0.0 < rate <= MAX_RATE):
        raise InputError("--rate", rate, f"above 0 and at most {MAX_RATE:g} Hz", "100 is usual")
    return rate
