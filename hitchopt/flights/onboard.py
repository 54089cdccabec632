"""Recordings of robots' own software: ROS bags, logs of Crazyflies' uSD cards, and PX4's ulogs.

A bag has one clock. Logs are one a drone, each with a clock of its own that starts as it boots;
Crazyflies' ran slow by 84/85 until August 2026.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.flight import Markers, RecordedFlight, Track, no_markers
from hitchopt.storage.archive import reading
from hitchopt.values import Array

POSES = "motion_capture_tracking_interfaces/msg/NamedPoseArray"  # Message of crazyswarm2
POSES_TEXT = "std_msgs/Header header\nmotion_capture_tracking_interfaces/NamedPose[] poses\n"
POSE = "motion_capture_tracking_interfaces/msg/NamedPose"
POSE_TEXT = "string name\ngeometry_msgs/Pose pose\n"

# Messages with positions of bodies, the first that a bag holds is read; and with markers
POSE_STAMPED, TRANSFORM = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
BODIES = (POSES, POSE_STAMPED, TRANSFORM, TRANSFORMS, "nav_msgs/msg/Odometry")
CLOUDS = ("sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointCloud")

USD_KEY = 0xBC

# Variables of a uSD log with positions and with commands, first choice first; units of them [m]
USD_PLACES = {"stateEstimate": 1.0, "stateEstimateZ": 1e-3, "locSrv": 1.0}
USD_COMMANDS = {"ctrltarget": 1.0, "ctrltargetZ": 1e-3}

ULOG_PLACES = ("vehicle_visual_odometry", "vehicle_local_position")  # First choice first


def library(path: Path, module: str) -> Any:
    """Return a module that only some formats need; FileError says what to install."""
    try:
        return import_module(module)
    except ImportError as fault:
        words = f"reading it needs {module.partition('.')[0]} ({fault})"
        raise FileError(f"{path}: {words}; pip install 'hitchopt[logs]'") from fault


def sorted_track(rows: Sequence[Sequence[float]]) -> tuple[Track | None, int]:
    """Return the track of rows (time, x, y, z), and how many repeat a time or were not seen.

    FileError where a time is before the one above.
    """
    values = np.array(rows, np.float64).reshape(-1, 4)
    seen = values[np.all(np.isfinite(values), axis=1)]
    steps = np.diff(seen[:, 0])
    if np.any(steps < 0.0):
        i = int(np.argmax(steps < 0.0))
        words = f"times do not ascend: {seen[i, 0]:.9g} s is followed by {seen[i + 1, 0]:.9g} s"
        raise FileError(f"{words}; give one flight, in the order in which it was recorded")
    new = np.append(np.ones(len(seen[:1]), np.bool_), steps > 0.0)
    track = Track(seen[new, 0], seen[new, 1:]) if np.any(new) else None
    return track, len(values) - int(np.sum(new))


def read_bag(path: Path) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with its definitions of types or without."""
    highlevel, typesys = library(path, "rosbags.highlevel"), library(path, "rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for text, kind in ((POSE_TEXT, POSE), (POSES_TEXT, POSES)):
        store.register(typesys.get_types_from_msg(text, kind))
    rows: dict[str, list[list[float]]] = defaultdict(list)
    clouds: list[tuple[float, Array]] = []
    with (  # many exceptions, without a common root
        reading(path, "bag", Exception),
        highlevel.AnyReader([path], default_typestore=store) as bag,
    ):
        kinds = {connection.msgtype for connection in bag.connections}
        chosen = next((kind for kind in BODIES if kind in kinds), None)
        if chosen is None:
            raise FileError(f"holds none of {', '.join(BODIES)}, but {', '.join(sorted(kinds))}")
        points = sorted({c.topic for c in bag.connections if c.msgtype in CLOUDS})
        wanted = [c for c in bag.connections if c.msgtype == chosen or c.topic in points[:1]]
        for connection, received, data in bag.messages(wanted):
            message = bag.deserialize(data, connection.msgtype)
            if connection.msgtype == chosen:
                for name, header, at in _bodies_of(connection.topic, message):
                    rows[name].append([_stamp(header, received), at.x, at.y, at.z])
            else:
                clouds.append((_stamp(message.header, received), _points_of(message)))
    notes = [f"markers are of {points[0]}, not of {', '.join(points[1:])}"] if points[1:] else []
    tracks, repeated = {}, 0
    for name, own in rows.items():
        track, lost = sorted_track(own)
        repeated += lost
        if track is not None:
            tracks[name] = track
    if repeated:
        notes.append(f"{repeated} poses repeat the time before, or are nan: left out")
    t, frame = np.unique([each for each, _ in clouds], return_inverse=True)
    order = np.argsort(frame, kind="stable")
    cloud = no_markers()
    if clouds:
        counts = np.array([len(clouds[i][1]) for i in order])
        places = np.concatenate([clouds[i][1] for i in order])
        cloud = Markers(t, np.repeat(frame[order], counts), places)
    version = "2" if bag.is2 else "1"
    return RecordedFlight(f"ROS {version} bag", tracks, cloud, up="z", notes=tuple(notes))


def _bodies_of(topic: str, message: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield names, headers and positions of the bodies of a message."""
    kind = message.__msgtype__
    if kind == POSES:
        yield from ((each.name, message.header, each.pose.position) for each in message.poses)
    elif kind == TRANSFORMS:
        for each in message.transforms:
            yield each.child_frame_id, each.header, each.transform.translation
    else:
        parts = topic.strip("/").split("/")
        name = parts[-2] if len(parts) > 1 else parts[0]
        if kind == TRANSFORM:
            yield message.child_frame_id or name, message.header, message.transform.translation
        else:
            pose = message.pose if kind == POSE_STAMPED else message.pose.pose
            yield name, message.header, pose.position


def _stamp(header: Any, received: int) -> float:
    """Return the time of a message [s]; that of its arrival where its header has none."""
    stamp = 1_000_000_000 * header.stamp.sec + header.stamp.nanosec
    return 1e-9 * (stamp or received)


def _points_of(message: Any) -> Array:
    """Return the finite points (k, 3) of a cloud."""
    if message.__msgtype__ == CLOUDS[1]:
        points = np.array([[p.x, p.y, p.z] for p in message.points], np.float64).reshape(-1, 3)
    else:
        fields = {field.name: field for field in message.fields}
        order = ">" if message.is_bigendian else "<"
        kinds = [order + {7: "f4", 8: "f8"}[fields[axis].datatype] for axis in "xyz"]
        offsets = [fields[axis].offset for axis in "xyz"]
        layout = {"names": list("xyz"), "formats": kinds, "offsets": offsets}
        kind = np.dtype({**layout, "itemsize": message.point_step})  # type: ignore[call-overload]
        cloud: Any = np.frombuffer(bytes(message.data), kind, message.width * message.height)
        points = np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return points[np.all(np.isfinite(points), axis=1)]


def read_usd(paths: Sequence[Path]) -> RecordedFlight:
    """Return the flight in logs of Crazyflies' uSD cards, a file each, named as the drone.

    A log has events of several kinds, each with a time and variables ``group.name(type)``.
    """
    tracks, commands, notes = {}, {}, []
    for path in paths:
        with reading(path, "uSD log"):
            events, note = usd_events(path.read_bytes())
            places, group = _usd_track(events, USD_PLACES)
            if places is None:
                names = sorted({name for _, table in events.values() for name in table})
                wanted = ", ".join(f"{each}.x" for each in USD_PLACES)
                raise FileError(f"logs none of {wanted}, but {', '.join(names)[:200]}")
            tracks[path.stem] = places
            target, _ = _usd_track(events, USD_COMMANDS)
            if target is not None:
                commands[path.stem] = target
            notes += [f"{path.stem}: {each}" for each in (note, group) if each]
    options: dict[str, Any] = {"one_clock": len(paths) == 1, "up": "z", "notes": tuple(notes)}
    return RecordedFlight("Crazyflie uSD log", tracks, setpoints=commands, **options)


Events = dict[str, tuple[Array, dict[str, Array]]]  # Of a kind: times [s], variables by name


def usd_events(data: bytes) -> tuple[Events, str]:
    """Return the events of a log by kinds, and a note if it is cut off.

    Of the header, kinds of events are known by numbers; then come their records, then a checksum.
    """
    version, count = struct.unpack_from("<HH", data, 1)
    if data[0] != USD_KEY or version not in {1, 2}:
        raise FileError(f"is of version {version}; 1 and 2 are known")
    at, kinds = 5, dict[int, tuple[str, list[str], struct.Struct]]()
    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, at)
        name, at = _text(data, at + 2)
        (many,) = struct.unpack_from("<H", data, at)
        at, names, types = at + 2, list[str](), "<HI" if version == 1 else "<HQ"
        for _ in range(many):
            text, at = _text(data, at)
            names.append(text[:-3])
            types += text[-2]
        kinds[number] = name, names, struct.Struct(types)
    whole = len(data) >= at + 4 and zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]
    end, rows = len(data) - 4 * whole, dict[int, list[tuple[float, ...]]]()
    while at + 2 <= end:
        (number,) = struct.unpack_from("<H", data, at)
        if number not in kinds or at + kinds[number][2].size > end:
            break
        rows.setdefault(number, []).append(kinds[number][2].unpack_from(data, at))
        at += kinds[number][2].size
    events: Events = {}
    for number, own in rows.items():
        values = np.array(own, np.float64)
        t = values[:, 1] * (1e-3 if version == 1 else 1e-6)
        events[kinds[number][0]] = t, dict(zip(kinds[number][1], values[:, 2:].T, strict=True))
    last = max((t[-1] for t, _ in events.values()), default=0.0)
    return events, "" if whole else f"is cut off or damaged: read to its record at {last:.3f} s"


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return the text that ends with a zero, and the place after it."""
    end = data.index(0, at)
    return data[at:end].decode("ascii"), end + 1


def _usd_track(events: Events, groups: dict[str, float]) -> tuple[Track | None, str]:
    """Return the track of the first group of variables x, y, z that an event has, and a note."""
    for group, scale in groups.items():
        names = [f"{group}.{axis}" for axis in "xyz"]
        for t, variables in events.values():
            if all(name in variables for name in names):
                columns = [t, *(scale * variables[name] for name in names)]
                track, _ = sorted_track(np.stack(columns, axis=1).tolist())
                words = f"positions are of {group}" + (", in whole mm" if scale != 1.0 else "")
                return track, words
    return None, ""


def read_ulog(paths: Sequence[Path]) -> RecordedFlight:
    """Return the flight in PX4's ulogs, a file each, named as the drone.

    They count from each drone's own origin unless they log what motion capture sends. Axes are
    turned from north, east, down to the plan's.
    """
    tracks, notes = {}, []
    for path in paths:
        ulog = library(path, "pyulog").ULog
        with reading(path, "ulog", Exception), path.open("rb") as file:
            log = ulog(file, list(ULOG_PLACES))
            topics = {topic.name: topic.data for topic in log.data_list[::-1]}
            topic = next((name for name in ULOG_PLACES if name in topics), None)
            if topic is None:
                raise FileError(f"logs none of {', '.join(ULOG_PLACES)}")
            values = topics[topic]
            t = 1e-6 * values.get("timestamp_sample", values["timestamp"]).astype(np.float64)
            axes = "xyz" if "x" in values else [f"position[{i}]" for i in range(3)]
            north, east, down = (np.asarray(values[axis], np.float64) for axis in axes)
            track, _ = sorted_track(np.stack([t, east, north, -down], axis=1).tolist())
            if track is None:
                raise FileError(f"its {topic} has no position")
            tracks[path.stem] = track
            notes.append(f"{path.stem}: positions are of {topic}")
            if topic != ULOG_PLACES[0]:
                notes[-1] += ", from the drone's own origin"
            lost = sum(gap.duration for gap in log.dropouts)
            notes += [f"{path.stem}: {1e-3 * lost:.1f} s were not logged"] if lost else []
    options: dict[str, Any] = {"one_clock": len(paths) == 1, "up": "z", "notes": tuple(notes)}
    return RecordedFlight("PX4 ulog", tracks, **options)
