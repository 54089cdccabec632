"""Recordings of robots' own software: ROS bags, logs of Crazyflies' uSD cards, and PX4's ulogs.

A bag has one clock. Logs are one a drone, each with a clock of its own that starts as it boots.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.flight import RecordedFlight, Track, cloud_of, library, metres, track_of
from hitchopt.storage.archive import reading
from hitchopt.values import Array

POSES = "motion_capture_tracking_interfaces/msg/NamedPoseArray"  # Message of crazyswarm2
POSES_TEXT = "std_msgs/Header header\nmotion_capture_tracking_interfaces/NamedPose[] poses\n"
POSE = "motion_capture_tracking_interfaces/msg/NamedPose"
POSE_TEXT = "string name\ngeometry_msgs/Pose pose\n"

# Messages with positions of bodies, of which the first in a bag is read; and with markers
POSE_STAMPED, TRANSFORM = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
BODIES = (POSES, POSE_STAMPED, TRANSFORM, TRANSFORMS, "nav_msgs/msg/Odometry")
CLOUD = "sensor_msgs/msg/PointCloud2"

# Variables of a uSD log with positions and with commands, by preference, and their units [m]
USD_POSITIONS = {"stateEstimate": 1.0, "stateEstimateZ": 1e-3, "locSrv": 1.0}
USD_COMMANDS = {"ctrltarget": 1.0, "ctrltargetZ": 1e-3}

ULOG_POSITIONS = ("vehicle_visual_odometry", "vehicle_local_position")  # By preference


def read_bag(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with definitions of its types or without."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for text, kind in ((POSE_TEXT, POSE), (POSES_TEXT, POSES)):
        store.register(typesys.get_types_from_msg(text, kind))
    rows, points = defaultdict[str, list[list[float]]](list), [np.zeros((0, 4))]
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
        used = [c for c in bag.connections if c.msgtype == chosen or c.topic in clouds[:1]]
        for connection, received, data in bag.messages(used):
            message = bag.deserialize(data, connection.msgtype)
            if connection.msgtype == CLOUD:
                each = points_of(message)
                t = np.full((len(each), 1), _stamp(message.header, received))
                points.append(np.hstack([t, each]))
            else:
                for name, header, p in _bodies_of(connection.topic, message):
                    rows[name].append([_stamp(header, received), p.x, p.y, p.z])
    notes = [f"markers are of {clouds[0]}, not of {', '.join(clouds[1:])}"] if clouds[1:] else []
    scale = metres(unit or "m")
    tracks = {name: track_of(np.array(own), scale) for name, own in rows.items()}
    lost = sum(map(len, rows.values())) - sum(len(each.t) for each in tracks.values())
    if lost:
        notes.append(f"{lost} poses repeat the time before, or are nan: left out")
    source, cloud = f"ROS {'2' if bag.is2 else '1'} bag", cloud_of(np.concatenate(points), scale)
    return RecordedFlight(source, tracks, cloud, notes=tuple(notes))


def _bodies_of(topic: str, message: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield names, headers and positions of the bodies of a message."""
    kind = message.__msgtype__
    if kind == POSES:
        yield from ((each.name, message.header, each.pose.position) for each in message.poses)
    elif kind in (TRANSFORM, TRANSFORMS):
        for each in [message] if kind == TRANSFORM else message.transforms:
            yield each.child_frame_id, each.header, each.transform.translation
    else:
        pose = message.pose if kind == POSE_STAMPED else message.pose.pose
        yield topic.strip("/").split("/")[-2:][0], message.header, pose.position


def _stamp(header: Any, received: int) -> float:
    """Return the time of a message [s], or that of its arrival if its header has none."""
    stamp = 1_000_000_000 * header.stamp.sec + header.stamp.nanosec
    return 1e-9 * (stamp or received)


def points_of(message: Any) -> Array:
    """Return the points (k, 3) of a cloud."""
    fields = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    kinds = [order + {7: "f4", 8: "f8"}[fields[axis].datatype] for axis in "xyz"]
    offsets, size = [fields[axis].offset for axis in "xyz"], message.point_step
    layout: Any = {"names": list("xyz"), "formats": kinds, "offsets": offsets, "itemsize": size}
    cloud: Any = np.frombuffer(bytes(message.data), layout, message.width * message.height)
    return np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)


def read_usd(paths: Sequence[Path]) -> RecordedFlight:
    """Return the flight in logs of Crazyflies' uSD cards, a file each, named as the drone.

    A log has events of several kinds, each with a time and variables ``group.name(type)``.
    """
    tracks, commands, notes = {}, {}, list[str]()
    for path in paths:
        with reading(path, "uSD log"):
            events, note = usd_events(path.read_bytes())
            group, track = _usd_track(events, USD_POSITIONS)
            if track is None:
                names = sorted({name for event in events for name in event})
                expected = ", ".join(f"{each}.x" for each in USD_POSITIONS)
                raise FileError(f"logs none of {expected}, but {', '.join(names)[:200]}")
            tracks[path.stem] = track
            notes += [f"{path.stem}: {note}"] if note else []
            notes.append(f"{path.stem}: positions are of {group}")
            if (target := _usd_track(events, USD_COMMANDS)[1]) is not None:
                commands[path.stem] = target
    options: Any = {"one_clock": len(paths) == 1, "notes": tuple(notes)}
    return RecordedFlight("Crazyflie uSD log", tracks, setpoints=commands, **options)


def usd_events(data: bytes) -> tuple[list[dict[str, Array]], str]:
    """Return the variables of every kind of event, ``t`` [s] among them, and a note on damage.

    The header numbers kinds of events; their records follow, and a checksum.
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
    events = []
    for number, own in rows.items():
        values = np.array(own, np.float64)
        values[:, 0] *= 1e-3 if version == 1 else 1e-6
        events.append(dict(zip(kinds[number][0], values.T, strict=True)))
    last = max((event["t"][-1] for event in events), default=0.0)
    return events, "" if whole else f"is cut off or damaged: read to its record at {last:.3f} s"


def _usd_track(
    events: Sequence[dict[str, Array]], groups: dict[str, float]
) -> tuple[str, Track | None]:
    """Return the first of some groups of variables x, y, z in a log, and its track."""
    for group, scale in groups.items():
        names = ["t", *(f"{group}.{axis}" for axis in "xyz")]
        for event in events:
            if all(name in event for name in names):
                return group, track_of(np.stack([event[name] for name in names], axis=1), scale)
    return "", None


def read_ulog(paths: Sequence[Path]) -> RecordedFlight:
    """Return the flight in PX4's ulogs, a file each, named as the drone.

    They count from each drone's own origin unless they log the poses of motion capture. Axes are
    turned from north, east, down to the plan's.
    """
    tracks, notes = {}, list[str]()
    for path in paths:
        with reading(path, "ulog", Exception), path.open("rb") as file:
            log = library("pyulog").ULog(file, list(ULOG_POSITIONS))
            topics = {topic.name: topic.data for topic in log.data_list[::-1]}
            topic = next((name for name in ULOG_POSITIONS if name in topics), None)
            if topic is None:
                raise FileError(f"logs none of {', '.join(ULOG_POSITIONS)}")
            values = topics[topic]
            t = 1e-6 * values.get("timestamp_sample", values["timestamp"]).astype(np.float64)
            axes = "xyz" if "x" in values else [f"position[{i}]" for i in range(3)]
            north, east, down = (values[axis].astype(np.float64) for axis in axes)
            tracks[path.stem] = track_of(np.stack([t, east, north, -down], axis=1))
            own = ", from the drone's own origin" if topic != ULOG_POSITIONS[0] else ""
            notes.append(f"{path.stem}: positions are of {topic}{own}")
            if lost := sum(gap.duration for gap in log.dropouts):
                notes.append(f"{path.stem}: {1e-3 * lost:.1f} s were not logged")
    return RecordedFlight("PX4 ulog", tracks, one_clock=len(paths) == 1, notes=tuple(notes))
