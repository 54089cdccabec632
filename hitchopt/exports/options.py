"""Options of an export: format, placement and sampling."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hitchopt.errors import InputError

HOMES = {
    "crazyswarm2": "crazyflie:Crazyswarm2",
    "compressed": "crazyflie:CompressedBytes",
    "skybrush": "skybrush:SkybrushShow",
    "mavsdk_drone_show": "mavsdk:MavsdkDroneShow",
    "ros2bag": "ros2bag:Ros2Bag",
    "csv": "tables:CsvTable",
    "parquet": "tables:ParquetTable",
    "gltf": "gltf:Gltf",
}
"""Module and class of every format; modules are imported on demand."""

ENDINGS = (".bin", ".csv", ".db3", ".glb", ".mcap", ".parquet", ".skyc")
STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}  # Storage formats of bags, and their suffixes
ROS_DISTROS = {"humble": 8, "iron": 8, "jazzy": 9}  # Versions of bags' metadata; all read 8
MAX_RATE = 10_000.0  # Maximum sampling rate [Hz]: no flight controller accepts a higher one


@dataclass(frozen=True)
class ExportOptions:
    """The format of an export, and the placement and sampling of the plan.

    Raises InputError for an unknown storage or release.
    """

    format: str
    frame: str | None = None  # enu, nwu or ned; None for the format's default
    origin: Sequence[float] = (0.0, 0.0, 0.0)  # of the plan in the frame: east, north, up [m]
    yaw: float = 0.0  # rotation of the plan in the frame, counter-clockwise from above [rad]
    fleet: Path | str | None = None  # fleet file; None for the plan's names of drones
    rate: float | None = None  # sampling rate [Hz]; None for the format's default
    stretch: float = 1.0  # factor of all durations, at least 1
    storage: str = "mcap"  # storage format of a bag, mcap or sqlite3
    ros_distro: str = "humble"  # ROS 2 release of a bag: humble, iron or jazzy
    hold_tension: bool = False  # whether set points hold the tension in other formats than uploads
    allow_slack: bool = False  # whether uploads that cannot hold the tension are written
    positions_only: bool = False  # whether receivers follow positions alone, and trail them
    stiffness: float | None = None  # of position loops [N/m]; None for the team's
    damping: float | None = None  # [N s/m]; None for a damping ratio of 5/6
    # whether parts of a plan that fly one by one may rest longer at their ends than the plan
    longer_rests: bool = True

    def __post_init__(self) -> None:
        for name, values in (("storage", STORAGES), ("ros_distro", ROS_DISTROS)):
            if (value := getattr(self, name)) not in values:
                remedy = f"{next(iter(values))} is usual"
                raise InputError(name, value, " or ".join(values), remedy)


def checked_rate(rate: float) -> float:
    """Return the rate [Hz]; raises InputError if it is out of range."""
    if not (math.isfinite(rate) and 0.0 < rate <= MAX_RATE):
        raise InputError("rate", rate, f"above 0 and at most {MAX_RATE:g} Hz", "100 Hz is usual")
    return rate
