"""Recordings of robots' own software: ROS bags, logs of Crazyflies' uSD cards, and PX4's ulogs.

A bag has one clock. Logs are one a drone, each with a clock of its own that starts as it boots.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.recordings import MARKER, RecordedFlight, flight_of, library
from hitchopt.storage.archive import reading
from hitchopt.values import Array

POSE = "motion_capture_tracking_interfaces/msg/NamedPose"  # Messages of crazyswarm2
MESSAGES = {
    POSE: "string name\ngeometry_msgs/Pose pose\n",
    f"{POSE}Array": (
        "std_msgs/Header header\nmotion_capture_tracking_interfaces/NamedPose[] poses\n"
    ),
}

# Messages with bodies, of which the first kind in a bag is read: name, header and position of each,
# from topic and message. Names are those before the end of a topic. Message with markers
BODIES: dict[str, Callable[[Sequence[str], Any], list[tuple[str, Any, Any]]]] = {
    f"{POSE}Array": lambda _, m: [(x.name, m.header, x.pose.position) for x in m.poses],
    "geometry_msgs/msg/PoseStamped": lambda topic, m: [(topic[-2:][0], m.header, m.pose.position)],
    "geometry_msgs/msg/TransformStamped": lambda _, m: [
        (m.child_frame_id, m.header, m.transform.translation)
    ],
    "tf2_msgs/msg/TFMessage": lambda _, m: [
        (x.child_frame_id, x.header, x.transform.translation) for x in m.transforms
    ],
    "nav_msgs/msg/Odometry": lambda topic, m: [(topic[-2:][0], m.header, m.pose.pose.position)],
}
CLOUD = "sensor_msgs/msg/PointCloud2"

# Variables of a uSD log with positions and with commands, by preference, and their units [m]
USD_POSITIONS = {"stateEstimate": 1.0, "stateEstimateZ": 1e-3, "locSrv": 1.0}
USD_COMMANDS = {"ctrltarget": 1.0, "ctrltargetZ": 1e-3}

ULOG_POSITIONS = ("vehicle_visual_odometry", "vehicle_local_position")  # By preference


def read_bag(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with definitions of its types or without."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for kind, text in MESSAGES.items():
        store.register(typesys.get_types_from_msg(text, kind))
    names, rows, notes = list[str](), [np.zeros((0, 4))], list[str]()
    path = path.parent if (path.parent / "metadata.yaml").is_file() else path
    with (  # Its exceptions have no common root
        reading(path, "bag", Exception),
        highlevel.AnyReader([path], default_typestore=store) as bag,
    ):
        kinds = {connection.msgtype for connection in bag.connections}
        chosen = next((kind for kind in BODIES if kind in kinds), None)
        if chosen is None:
            raise FileError(f"holds none of {', '.join(BODIES)}, but {', '.join(sorted(kinds))}")
        clouds = sorted({c.topic for c in bag.connections if c.msgtype == CLOUD})
        if clouds[1:]:
            notes.append(f"markers are of {clouds[0]}, not of {', '.join(clouds[1:])}")
        used = [c for c in bag.connections if c.msgtype == chosen or c.topic in clouds[:1]]
        for connection, received, data in bag.messages(used):
            message = bag.deserialize(data, connection.msgtype)
            if connection.msgtype == CLOUD:
                each = [(MARKER, message.header, points_of(message))]
            else:
                bodies = BODIES[chosen](connection.topic.strip("/").split("/"), message)
                each = [(name, header, np.array([[p.x, p.y, p.z]])) for name, header, p in bodies]
            for name, header, positions in each:
                t = 1e-9 * (10**9 * header.stamp.sec + header.stamp.nanosec or received)
                rows.append(np.insert(positions, 0, t, axis=1))
                names += [name] * len(positions)
    source = f"ROS {'2' if bag.is2 else '1'} bag"
    return flight_of(source, names, np.concatenate(rows), unit or "m", notes=notes)


def points_of(message: Any) -> Array:
    """Return the points (k, 3) of a cloud."""
    fields = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    kinds = [order + {7: "f4", 8: "f8"}[fields[axis].datatype] for axis in "xyz"]
    offsets, size = [fields[axis].offset for axis in "xyz"], message.point_step
    layout: Any = {"names": list("xyz"), "formats": kinds, "offsets": offsets, "itemsize": size}
    cloud: Any = np.frombuffer(bytes(message.data), layout, message.width * message.height)
    return np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)


def flight_of_logs(
    source: str, rows: Mapping[str, Array], notes: Sequence[str], commands: Mapping[str, Array]
) -> RecordedFlight:
    """Return the flight of rows (time, x, y, z) (m, 4) of every log, in metres."""
    names = [name for name, own in rows.items() for _ in own]
    more: Any = {"one_clock": len(rows) == 1, "notes": notes, "setpoints": commands}
    return flight_of(source, names, np.concatenate(list(rows.values())), **more)


def read_usd(paths: Sequence[Path]) -> RecordedFlight:
    """Return the flight in logs of Crazyflies' uSD cards, a file each, named as the drone."""
    rows, commands, notes = dict[str, Array](), dict[str, Array](), list[str]()
    for path in paths:
        with reading(path, "uSD log"):
            events, note = usd_events(path.read_bytes())
            notes += [f"{path.stem}: {note}"] if note else []
            for groups, found in ((USD_POSITIONS, rows), (USD_COMMANDS, commands)):
                for group, event in itertools.product(groups, events):
                    axes = [f"{group}.{axis}" for axis in "xyz"]
                    if path.stem not in found and all(axis in event for axis in axes):
                        positions = [groups[group] * event[axis] for axis in axes]
                        found[path.stem] = np.stack([event["t"], *positions], axis=1)
                        notes += [f"{path.stem}: positions are of {group}"] * (found is rows)
            if path.stem not in rows:
                logged = ", ".join(sorted({name for event in events for name in event}))
                expected = ", ".join(f"{each}.x" for each in USD_POSITIONS)
                raise FileError(f"logs none of {expected}, but {logged[:200]}")
    return flight_of_logs("Crazyflie uSD log", rows, notes, commands)


def usd_events(data: bytes) -> tuple[list[dict[str, Array]], str]:
    """Return the variables of every kind of event, ``t`` [s] among them, and a note on damage.

    The header numbers kinds of events, each with a time and variables ``group.name(type)``; their
    records follow, and a checksum.
    """
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in {1, 2}:
        raise FileError(f"is of version {version}; 1 and 2 are known")
    at, kinds = 5, dict[int, tuple[list[str], struct.Struct]]()
    for _ in range(count):
        number, at = struct.unpack_from("<H", data, at)[0], data.index(0, at + 2) + 1
        names, types = ["t"], "<H" + ("I" if version == 1 else "Q")
        many, at = struct.unpack_from("<H", data, at)[0], at + 2
        for _ in range(many):
            end = data.index(0, at)
            text, at = data[at:end].decode("ascii"), end + 1
            names.append(text[:-3])
            types += text[-2]
        kinds[number] = names, struct.Struct(types)
    whole = len(data) >= at + 4 and zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]
    end, rows = len(data) - 4 * whole, defaultdict[int, list[Any]](list)
    while at + 2 <= end:
        (number,) = struct.unpack_from("<H", data, at)
        if number not in kinds or at + kinds[number][1].size > end:
            break
        rows[number].append(kinds[number][1].unpack_from(data, at)[1:])
        at += kinds[number][1].size
    events, tick = list[dict[str, Array]](), 1e-3 if version == 1 else 1e-6
    for number, own in rows.items():
        t, *others = np.array(own, np.float64).T
        events.append(dict(zip(kinds[number][0], [tick * t, *others], strict=True)))
    last = max((event["t"][-1] for event in events), default=0.0)
    return events, "" if whole else f"is cut off or damaged: read to its record at {last:.3f} s"


def read_ulog(paths: Sequence[Path]) -> RecordedFlight:
    """Return the flight in PX4's ulogs, a file each, named as the drone.

    They count from each drone's own origin unless they log the poses of motion capture. Axes are
    turned from north, east, down to the plan's.
    """
    rows, notes = dict[str, Array](), list[str]()
    for path in paths:
        with reading(path, "ulog", Exception), path.open("rb") as file:
            log = library("pyulog").ULog(file, list(ULOG_POSITIONS))
            topics = {topic.name: topic.data for topic in log.data_list[::-1]}
            topic = next((name for name in ULOG_POSITIONS if name in topics), None)
            if topic is None:
                raise FileError(f"logs none of {', '.join(ULOG_POSITIONS)}")
            values = topics[topic]
            axes = "xyz" if "x" in values else [f"position[{i}]" for i in range(3)]
            north, east, down = (values[axis].astype(np.float64) for axis in axes)
            t = 1e-6 * values.get("timestamp_sample", values["timestamp"]).astype(np.float64)
            rows[path.stem] = np.stack([t, east, north, -down], axis=1)
            own = ", from the drone's own origin" if topic != ULOG_POSITIONS[0] else ""
            notes.append(f"{path.stem}: positions are of {topic}{own}")
            if lost := sum(gap.duration for gap in log.dropouts):
                notes.append(f"{path.stem}: {1e-3 * lost:.1f} s were not logged")
    return flight_of_logs("PX4 ulog", rows, notes, {})
