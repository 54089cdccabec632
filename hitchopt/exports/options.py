"""Options of an export: format, placement and sampling.

``ExportOptions`` declares their keys, from which the options of the command line follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated

from hitchopt.motion.states import checked_rate
from hitchopt.values import SCALAR
from hitchopt.values.fields import FLAGS, Key, Kind, Record, documented, points, words
from hitchopt.values.units import ANGLE, DAMPING, NUMBER, STIFFNESS

GROUP = "hitchopt.formats"  # Group of the entry points by which packages register formats

HOMES = {
    "crazyswarm2": "hitchopt.exports.formats.crazyflie:Crazyswarm2",
    "compressed": "hitchopt.exports.formats.crazyflie:CompressedBytes",
    "skybrush": "hitchopt.exports.formats.skybrush:SkybrushShow",
    "mavsdk_drone_show": "hitchopt.exports.formats.mavsdk:MavsdkDroneShow",
    "ros2bag": "hitchopt.exports.formats.ros2bag:Ros2Bag",
    "csv": "hitchopt.exports.formats.tables:CsvTable",
    "parquet": "hitchopt.exports.formats.tables:ParquetTable",
    "gltf": "hitchopt.exports.formats.gltf:Gltf",
    "mjcf": "hitchopt.lab.simulation.mjcf:Mjcf",
}
"""Module and class of every format of hitchopt; the class has all other facts."""

STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}  # Storage formats of bags, and their suffixes
ROS_DISTROS = {"humble": 8, "iron": 8, "jazzy": 9}  # Versions of bags' metadata; all read 8


def registered_formats() -> dict[str, EntryPoint]:
    """Return the entry points of all formats by name: those of hitchopt, then of other packages.

    Nothing is imported. Names of hitchopt's formats stay its own: another package cannot replace
    the format that a name stands for.
    """
    formats = {name: EntryPoint(name, home, GROUP) for name, home in HOMES.items()}
    for entry in entry_points(group=GROUP):
        formats.setdefault(entry.name, entry)
    return formats


RATE = Kind((SCALAR,), lambda key, rate: checked_rate(rate, key), {"type": "number"}, "Hz")


@documented
@dataclass(frozen=True, eq=False)
class ExportOptions(Record):
    """The format of an export, and the placement and sampling of the plan.

    Attributes without a key are ``format``, its name, and ``fleet``, the path of a fleet file; None
    for the plan's names of drones.

    Raises
    ------
    InputError: an unknown word, or a number out of its range.
    """

    format: str
    frame: Annotated[
        str | None,
        Key(words("enu", "nwu", "ned"), "Frame of the files; null: the format's default"),
    ] = None
    origin: Annotated[
        Sequence[float],
        Key(points((3,), "x, y, z"), "Origin of the plan in that frame: east, north, up [m]"),
    ] = (0.0, 0.0, 0.0)
    yaw: Annotated[
        float, Key(ANGLE, "Rotation of the plan in that frame, counter-clockwise seen from above")
    ] = 0.0
    fleet: Path | str | None = None
    rate: Annotated[
        float | None, Key(RATE, "Samples per second of sampled formats; null: the format's default")
    ] = None
    stretch: Annotated[float, Key(NUMBER, "Factor on all durations, at least 1")] = 1.0
    storage: Annotated[str, Key(words(*STORAGES), "Storage of a ros2bag")] = "mcap"
    ros_distro: Annotated[
        str, Key(words(*ROS_DISTROS), "ROS 2 release of a ros2bag; later releases read it too")
    ] = "humble"
    hold_tension: Annotated[
        bool,
        Key(
            FLAGS, "Move setpoints outward to hold the tension, even in formats other than uploads"
        ),
    ] = False
    allow_slack: Annotated[
        bool, Key(FLAGS, "Write uploads even if they cannot hold the tension")
    ] = False
    positions_only: Annotated[
        bool, Key(FLAGS, "Certify for drones that follow positions alone and trail them by v kd/kp")
    ] = False
    stiffness: Annotated[
        float | None, Key(STIFFNESS, "Stiffness of the drones' position loops; null: the team's")
    ] = None
    damping: Annotated[
        float | None,
        Key(DAMPING, "Damping of these loops; null: that of a damping ratio of 5/6"),
    ] = None
    longer_rests: Annotated[
        bool,
        Key(
            FLAGS,
            "Extend rests at which a plan is cut until setpoints are at rest",
        ),
    ] = True
