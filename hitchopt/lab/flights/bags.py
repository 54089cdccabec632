"""Reader of ROS bags: positions, commands, attitudes and on-board logs, on one clock.

Topics are sorted by what they hold; see ``topics``. Logs of a drone may be stamped by a clock that
starts at its boot: it is set by the positions in the log, else by the smallest delay of arrival.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.lab.flights.recordings import (
    MARKER,
    QUANTITIES,
    Logged,
    RecordedFlight,
    fitted_shift,
    flight_of,
    library,
    positions_of,
)
from hitchopt.lab.flights.topics import (
    LOAD,
    LOGGED,
    Topic,
    bag_topics,
    body_names,
    is_load,
    quantity_name,
    taken_topics,
)
from hitchopt.storage.archive import reading
from hitchopt.values import Array

STATIC = "/tf_static"  # Topic of frames that do not move
MAX_FIXED = 0.05  # Largest motion of a frame that does not move [m]
MAX_DELAY = 10.0  # Largest delay between stamp and arrival on one clock [s]
ARRIVALS = (-8.0, 1.0)  # Shifts that are tried about the smallest delay of arrival [s]
MIN_TURN = 1e-6  # Smallest change of an attitude that is measured

# Packages of crazyswarm, of ROS 1, and of crazyswarm2, and definitions that bags may lack
CRAZYFLIES = ("crazyswarm", "crazyflie_driver", "crazyflie_interfaces")
POSE = "motion_capture_tracking_interfaces/msg/NamedPose"
MESSAGES = {
    POSE: "string name\ngeometry_msgs/Pose pose\n",
    f"{POSE}Array": f"std_msgs/Header header\n{POSE.replace('msg/', '')}[] poses\n",
    "crazyflie_interfaces/msg/Position": "std_msgs/Header header\n"
    "float32 x\nfloat32 y\nfloat32 z\nfloat32 yaw\n",
    "crazyflie_interfaces/msg/FullState": "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Twist twist\ngeometry_msgs/Vector3 acc\n",
    "crazyflie_interfaces/msg/LogDataGeneric": "std_msgs/Header header\nuint32 timestamp\n"
    "float32[] values\n",
}

_Parts = dict[str, Any]
"""Numbers of a sample by quantity."""

Samples = list[tuple[str, Any, _Parts]]
"""Frame, header and quantities of each body in a message."""


def _xyz(v: Any) -> tuple[float, float, float]:
    return v.x, v.y, v.z


def _pose(pose: Any) -> _Parts:
    q = pose.orientation
    return {"position": _xyz(pose.position), "attitude": (*_xyz(q), q.w)}


def _transform(transform: Any) -> _Parts:
    q = transform.rotation
    return {"position": _xyz(transform.translation), "attitude": (*_xyz(q), q.w)}


def _full_state(m: Any) -> Samples:
    values = {"velocity": _xyz(m.twist.linear), "acceleration": _xyz(m.acc)}
    return [("", m.header, {**_pose(m.pose), **values})]


def _position(m: Any) -> Samples:
    return [("", m.header, {"position": _xyz(m), "yaw": (m.yaw,)})]


def _imu(m: Any) -> Samples:
    values = {"rates": _xyz(m.angular_velocity), "specific_force": _xyz(m.linear_acceleration)}
    return [("", m.header, values)]


# Message types that are read, those with positions by preference: whether messages name the
# bodies, and functions that return the samples of a message
MESSAGE_TYPES: dict[str, tuple[bool, Callable[[Any], Samples]]] = {
    f"{POSE}Array": (True, lambda m: [(x.name, m.header, _pose(x.pose)) for x in m.poses]),
    "geometry_msgs/msg/TransformStamped": (
        False, lambda m: [(m.child_frame_id, m.header, _transform(m.transform))],
    ),
    "tf2_msgs/msg/TFMessage": (
        True, lambda m: [(x.child_frame_id, x.header, _transform(x.transform))
                         for x in m.transforms],
    ),
    "geometry_msgs/msg/PoseStamped": (False, lambda m: [("", m.header, _pose(m.pose))]),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        False, lambda m: [("", m.header, _pose(m.pose.pose))],
    ),
    "nav_msgs/msg/Odometry": (
        False, lambda m: [(m.child_frame_id, m.header, _pose(m.pose.pose))],
    ),
    **{f"{x}/msg/FullState": (False, _full_state) for x in CRAZYFLIES},
    **{f"{x}/msg/Position": (False, _position) for x in CRAZYFLIES},
    **{
        f"{x}/msg/{name}": (False, lambda m: [("", m.header, {"values": m.values})])
        for x in CRAZYFLIES
        for name in ("GenericLogData", "LogDataGeneric")
    },
    "sensor_msgs/msg/Imu": (False, _imu),
}  # fmt: skip
CLOUD = "sensor_msgs/msg/PointCloud2"


@dataclass
class _Stream:
    """Samples of a frame in a topic: times of stamps and of arrival (m,) [s], and quantities."""

    parent: str
    t: Array
    received: Array
    parts: dict[str, Array]

    def rows(self, part: str, shift: float = 0.0) -> Array:
        return np.column_stack([self.t + shift, self.parts[part]])

    @property
    def delay(self) -> float:
        return float(np.median(self.received - self.t))


_Streams = dict[str, dict[str, _Stream]]
"""Streams by topic and frame."""

_Bodies = dict[str, tuple[Topic, _Stream]]
"""Topics and streams of positions by body."""


def single_file(paths: Sequence[Path]) -> Path:
    """Return the only file of a recording; FileError if a directory has several."""
    if len(paths) > 1:
        listed = ", ".join(path.name for path in paths[:5])
        raise FileError(f"holds {len(paths)} recordings, {listed}: give one file")
    return paths[0]


def read_bag(paths: Sequence[Path], unit: str | None, topic: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with or without definitions of its types."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for kind, text in MESSAGES.items():
        store.register(typesys.get_types_from_msg(text, kind))
    path = paths[0].parent
    path = path if (path / "metadata.yaml").is_file() else single_file(paths)
    with (  # Exceptions of rosbags have no common base
        reading(path, "bag", Exception),
        highlevel.AnyReader([path], default_typestore=store) as bag,
    ):
        kinds = {c.topic: c.msgtype for c in bag.connections if c.msgcount}
        read = {x: kind for x, kind in kinds.items() if kind in MESSAGE_TYPES and x != STATIC}
        clouds = sorted(name for name, kind in kinds.items() if kind == CLOUD)
        names = {*read, *clouds[:1]}
        used = [c for c in bag.connections if c.topic in names]
        messages = defaultdict[str, list[tuple[float, Any]]](list)
        for connection, received, data in bag.messages(used) if used else ():
            message = bag.deserialize(data, connection.msgtype)
            messages[connection.topic].append((1e-9 * received, message))
        markers = [_points(*each) for name in clouds[:1] for each in messages.pop(name, ())]
        streams = {name: _streams(name, kinds[name], each) for name, each in messages.items()}
        source = f"ROS {'2' if bag.is2 else '1'} bag"
    positions = {
        name: kind
        for name, kind in read.items()
        if any("position" in each.parts for each in streams.get(name, {}).values())
    }
    if not positions:
        held = ", ".join(sorted(set(kinds.values())))
        raise FileError(f"holds none of {', '.join(MESSAGE_TYPES)}, but {held}")
    preferences = {kind: names_bodies for kind, (names_bodies, _) in MESSAGE_TYPES.items()}
    topics = {each.name: each for each in bag_topics(read, preferences)}
    taken, notes = taken_topics([topics[name] for name in positions], topic)
    bodies, frame_notes = _bodies_of_frames(streams, taken)
    notes += frame_notes
    notes += [f"markers are of {clouds[0]}, not of {', '.join(clouds[1:])}"] if clouds[1:] else []
    loads = {name for name in bodies if is_load(name) and topic is None}
    if len(loads) == len(bodies):
        loads = set()
    others = [each for each in topics.values() if each not in taken]
    found = _found(bodies, loads, sorted(others, key=lambda x: x.preference), streams)
    contents = dict[str, dict[str, Logged]]()
    shifts, residuals = dict[str, float](), dict[str, float]()
    for name, own in found.items():
        contents[name], shift, residual = _content(own)
        if shift is not None:
            shifts[name], residuals[name] = shift, residual
    carried = {name: contents.pop(name) for name in found if name in loads}
    cloud = positions_of({MARKER: np.concatenate(markers)} if markers else {})
    return flight_of(
        source,
        {**contents, **cloud},
        unit or "m",
        loads=carried,
        notes=[*notes, *_clock_notes(residuals)],
        clock_shifts=shifts,
        as_sent=True,
    )


def _found(
    bodies: _Bodies, loads: set[str], topics: Sequence[Topic], streams: _Streams
) -> dict[str, list[tuple[Topic, _Stream]]]:
    """Return the topics and streams of all bodies, those of their positions first.

    Loads in ``topics`` are added to ``loads``.
    """
    found = {name: [own] for name, own in bodies.items()}
    drones = set(bodies) - loads
    for topic in topics:
        for frame, stream in streams.get(topic.name, {}).items():
            # A part of the names of topic and frame may be a drone's
            parts = [topic.body, *topic.name.split("/"), *frame.split("/")]
            name = next((part for part in parts if part in drones), "")
            if topic.kind == LOAD and "position" in stream.parts:
                name = topic.body if topic.body and is_load(topic.body) else LOAD
                if name in found:
                    continue
                loads.add(name)
            if name:
                found.setdefault(name, []).append((topic, stream))
    return found


def _clock_notes(residuals: Mapping[str, float]) -> Iterator[str]:
    """Yield sentences on clocks, by the distances [m] that remain; infinite without a fit."""
    words = "their logs' clocks are set by"
    fitted = {name: x for name, x in residuals.items() if np.isfinite(x)}
    if fitted:
        error = f"{1e3 * max(fitted.values()):.0f} mm"
        yield f"{', '.join(fitted)}: {words} positions, which then agree to {error}"
    if others := [name for name in residuals if name not in fitted]:
        delay = "the smallest delay of arrival, which may be seconds"
        yield f"{', '.join(others)}: {words} {delay}"


def _content(
    own: Sequence[tuple[Topic, _Stream]],
) -> tuple[dict[str, Logged], float | None, float]:
    """Return the quantities of a body from its streams, the first of which has its positions.

    Then follow the shift of the clock of its logs [s], None if they have none, and the distance of
    their positions that remains [m], infinite if the shift is not fitted to positions.
    """
    topic, track = own[0]
    content = {"position": Logged(track.rows("position"), topic.family)}
    apart = [stream for _, stream in own if abs(stream.delay - track.delay) >= MAX_DELAY]
    shift, residual = None, np.inf
    if apart:
        shift = float(np.min(apart[0].received - apart[0].t)) - track.delay
    for stream in (stream for stream in apart if "position" in stream.parts):
        guess = float(np.min(stream.received - stream.t)) - track.delay
        span = (guess + ARRIVALS[0], guess + ARRIVALS[1])
        if (fit := fitted_shift(stream.rows("position"), track.rows("position"), span)) is not None:
            shift, residual = fit
            break
    for topic, stream in own:
        moved = 0.0 if shift is None or abs(stream.delay - track.delay) < MAX_DELAY else shift
        for part, values in stream.parts.items():
            quantity = quantity_name(topic.kind, part)
            if quantity in content or quantity not in QUANTITIES:
                continue
            if part == "attitude" and np.nanmax(np.ptp(values, axis=0), initial=0.0) < MIN_TURN:
                continue  # Of one marker
            content[quantity] = Logged(stream.rows(part, moved), topic.family)
    return content, shift, residual


def _time(header: Any) -> float:
    """Return the time of a stamp [s], 0 if there is none."""
    return float(header.stamp.sec + 1e-9 * header.stamp.nanosec)


def _streams(topic: str, kind: str, messages: Sequence[tuple[float, Any]]) -> dict[str, _Stream]:
    """Return the streams of a topic by frame, from times of arrival [s] and messages."""
    samples = defaultdict[str, list[tuple[str, float, float, _Parts]]](list)
    quantity, count, scale = LOGGED.get(topic.rpartition("/")[2].casefold(), ("", 0, 1.0))
    for received, message in messages:
        for frame, header, parts in MESSAGE_TYPES[kind][1](message):
            if len(values := parts.pop("values", ())) == count > 0:
                parts[quantity] = scale * np.asarray(values)
            # Logs of crazyswarm2 are stamped from the drone's boot [ms]
            t = 1e-3 * message.timestamp if hasattr(message, "timestamp") else _time(header)
            if parts:
                parent = header.frame_id.strip("/")
                samples[frame.strip("/")].append((parent, t, received, parts))
    streams = dict[str, _Stream]()
    for frame, each in samples.items():
        parents, times, arrivals, fields = zip(*each, strict=True)
        names = set.intersection(*map(set, fields))
        streams[frame] = _Stream(
            parents[-1],
            np.array(times if any(times) else arrivals),
            np.array(arrivals),
            {name: np.array([x[name] for x in fields], np.float64) for name in names},
        )
    return streams


def _bodies_of_frames(streams: _Streams, topics: Sequence[Topic]) -> tuple[_Bodies, list[str]]:
    """Return topics and streams by body, and notes.

    Frames with a moving parent are omitted. Raises FileError if two topics have the same body.
    """
    bodies, omitted = _Bodies(), list[str]()
    for topic in topics:
        frames = streams[topic.name]
        names = {frame: name or frame for frame, (name, _) in body_names(list(frames)).items()}
        counts = Counter(names.values())
        names = {frame: name if counts[name] == 1 else frame for frame, name in names.items()}
        if len(frames) == 1 and topic.body:
            names = dict.fromkeys(frames, topic.body)
        for frame, name in names.items():
            parent = frames.get(frames[frame].parent)
            if parent is not None and np.max(np.ptp(parent.parts["position"], axis=0)) > MAX_FIXED:
                omitted.append(frame)
                continue
            body = name or topic.name.strip("/")
            if body in bodies:
                both = " and ".join(sorted((bodies[body][0].family, topic.family)))
                raise FileError(f"{body} has positions in {both}: choose one with topic=")
            bodies[body] = topic, frames[frame]
    relative = [f"{', '.join(omitted)} omitted: positions in frames that move"] if omitted else []
    return bodies, relative


def _points(received: float, cloud: Any) -> Array:
    """Return rows (m, 4) of time [s] and position of the points of a cloud of float32."""
    float32 = 7
    offsets = {x.name: x.offset for x in cloud.fields if x.datatype == float32}
    data = cloud.data.reshape(cloud.width * cloud.height, cloud.point_step)
    axes = [np.ascontiguousarray(data[:, offsets[x] : offsets[x] + 4]).view("<f4") for x in "xyz"]
    t = np.full((len(data), 1), _time(cloud.header) or received)
    return np.concatenate([t, *axes], axis=1)
