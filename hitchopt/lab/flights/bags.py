"""Reader of ROS bags: positions, commands, attitudes and on-board logs, on one clock.

Topics are sorted by what they hold; see ``topics``. Logs of a drone may be stamped by a clock that
starts at its boot: it is set by the positions in the log, else by the smallest delay of arrival.

Messages of one type with equal texts and counts have each number at the same bytes. So messages are
grouped by these, and each field of a group is read at once, by the type's definition.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from hitchopt.values import Array, Indices

STATIC = "/tf_static"  # Topic of frames that do not move
MAX_FIXED = 0.05  # Largest motion of a frame that does not move [m]
MAX_DELAY = 10.0  # Largest delay between stamp and arrival on one clock [s]
ARRIVALS = (-8.0, 1.0)  # Shifts that are tried about the smallest delay of arrival [s]
MIN_TURN = 1e-6  # Smallest change of an attitude that is measured

NUMBERS = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1",
    **{f"int{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)},
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip
BASE, NAME, ARRAY = 1, 2, 3  # Nodes of definitions in rosbags; others are sequences

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

Samples = list[tuple[str, Any, dict[str, Array]]]
"""Frame, header and quantities (messages, k) of each body in messages."""


def _xyz(v: Any) -> Array:
    return np.stack([v.x, v.y, v.z], axis=1)


def _pose(pose: Any) -> dict[str, Array]:
    q = pose.orientation
    return {"position": _xyz(pose.position), "attitude": np.column_stack([_xyz(q), q.w])}


def _transform(transform: Any) -> dict[str, Array]:
    q = transform.rotation
    return {"position": _xyz(transform.translation), "attitude": np.column_stack([_xyz(q), q.w])}


def _full_state(m: Any) -> Samples:
    values = {"velocity": _xyz(m.twist.linear), "acceleration": _xyz(m.acc)}
    return [("", m.header, {**_pose(m.pose), **values})]


def _position(m: Any) -> Samples:
    return [("", m.header, {"position": _xyz(m), "yaw": m.yaw[:, None]})]


def _imu(m: Any) -> Samples:
    values = {"rates": _xyz(m.angular_velocity), "specific_force": _xyz(m.linear_acceleration)}
    return [("", m.header, values)]


# Message types that are read, those with positions by preference: whether messages name the
# bodies, and functions that return the samples of decoded messages
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
        arrivals, messages = defaultdict[str, list[int]](list), defaultdict[str, list[bytes]](list)
        for connection, received, data in bag.messages(used) if used else ():
            arrivals[connection.topic].append(received)
            messages[connection.topic].append(data)
        streams, markers = _Streams(), list[Array]()
        for name, data in messages.items():
            groups = decoded(bag.typestore.fielddefs, kinds[name], data, ros1=not bag.is2)
            received = 1e-9 * np.array(arrivals[name])
            if kinds[name] == CLOUD:
                markers = [_points(message, received[rows]) for rows, message in groups]
            else:
                streams[name] = _streams(name, kinds[name], groups, received)
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


def _times(header: Any, received: Array) -> Array:
    """Return times of stamps [s], or of arrival if no message has a stamp."""
    t = header.stamp.sec + 1e-9 * header.stamp.nanosec
    return t if np.any(t) else received


def _streams(
    topic: str, kind: str, groups: Sequence[tuple[Indices, Any]], received: Array
) -> dict[str, _Stream]:
    """Return the streams of a topic by frame, in the order in which they were recorded."""
    pieces = defaultdict[str, list[tuple[Indices, str, Array, dict[str, Array]]]](list)
    for rows, message in groups:
        for frame, header, fields in MESSAGE_TYPES[kind][1](message):
            parts = fields
            if "values" in fields:
                last = topic.rpartition("/")[2].casefold()
                quantity, count, scale = LOGGED.get(last, ("", 0, 1.0))
                is_known = quantity and fields["values"].shape[1] == count
                parts = {quantity: scale * fields["values"]} if is_known else {}
            t = _times(header, received[rows])
            if "timestamp" in vars(message):  # Of crazyswarm2's logs [ms], from the drone's boot
                t = 1e-3 * message.timestamp
            if parts:
                parent = header.frame_id.strip("/")
                pieces[frame.strip("/")].append((rows, parent, t, parts))
    streams = dict[str, _Stream]()
    for frame, each in pieces.items():
        rows = np.concatenate([one[0] for one in each])
        order = np.argsort(rows, kind="stable")
        names = set.intersection(*(set(one[3]) for one in each))
        streams[frame] = _Stream(
            each[-1][1],
            np.concatenate([one[2] for one in each])[order],
            received[rows[order]],
            {name: np.concatenate([one[3][name] for one in each])[order] for name in names},
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


class _MixedError(Exception):
    """Messages of a group differ in a text or a count; ``labels`` (messages,) tell them apart."""

    def __init__(self, labels: NDArray[np.integer[Any]]) -> None:
        super().__init__("messages of different layouts")
        self.labels = labels


def decoded(
    definitions: Mapping[str, Any], kind: str, messages: Sequence[bytes], *, ros1: bool
) -> list[tuple[Indices, Any]]:
    """Return groups of messages of a type: their indices, and their fields.

    Fields are named as in ``definitions``, those of rosbags' type stores; numbers are arrays
    (messages,) or (messages, count), texts are the same in all messages of a group. Raises
    ValueError for a message that is shorter than its type.
    """
    lengths = np.array([len(message) for message in messages])
    pending, groups = list[tuple[Indices, NDArray[np.uint8]]](), list[tuple[Indices, Any]]()
    for size in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == size)
        data = np.frombuffer(b"".join(messages[i] for i in rows.tolist()), np.uint8)
        pending.append((rows, data.reshape(len(rows), size)))
    while pending:
        rows, data = pending.pop()
        try:
            groups.append((rows, _Reader(definitions, data, ros1).message(kind)))
        except _MixedError as mixed:
            chosen = [mixed.labels == label for label in range(int(mixed.labels.max()) + 1)]
            pending += [(rows[each], data[each]) for each in chosen]
    return sorted(groups, key=lambda group: int(group[0][0]))


class _Reader:
    """Reads fields of messages of one layout (messages, bytes) in their order."""

    def __init__(self, definitions: Mapping[str, Any], data: NDArray[np.uint8], ros1: bool) -> None:
        self._definitions, self._data, self._ros1 = definitions, data, ros1
        self._start = self._at = 0 if ros1 else 4

    def message(self, kind: str) -> Any:
        fields = self._definitions[kind][1]
        return SimpleNamespace(**{name: self._value(int(node), of) for name, (node, of) in fields})

    def _value(self, node: int, of: Any) -> Any:
        if node == NAME:
            return self.message(of)
        if node == BASE:
            return self._text() if of[0].endswith("string") else self._numbers(of[0], 1)[:, 0]
        (item, item_of), count = of[0], of[1] if node == ARRAY else self._count()
        if int(item) == BASE and item_of[0] in NUMBERS:
            return self._numbers(item_of[0], count)
        return [self._value(int(item), item_of) for _ in range(count)]

    def _numbers(self, kind: str, count: int) -> Array:
        dtype = np.dtype(NUMBERS[kind])
        return self._block(dtype.itemsize, count).view(dtype)

    def _count(self) -> int:
        count = int.from_bytes(self._common(self._block(4, 1)), "little")
        if count > self._data.shape[1]:
            raise ValueError(f"a message of {self._data.shape[1]} bytes has {count} items")
        return count

    def _text(self) -> str:
        return self._common(self._block(1, self._count())).rstrip(b"\0").decode()

    def _block(self, size: int, count: int) -> NDArray[np.uint8]:
        """Return the next bytes (messages, size * count); ROS 2 aligns numbers to their size."""
        if count and not self._ros1:
            self._at += (self._start - self._at) % size
        block = self._data[:, self._at : self._at + size * count]
        if block.shape[1] < size * count:
            raise ValueError(f"a message of {self._data.shape[1]} bytes is shorter than its type")
        self._at += size * count
        return np.ascontiguousarray(block)

    def _common(self, block: NDArray[np.uint8]) -> bytes:
        """Return bytes that all messages share."""
        if np.any(block != block[0]):
            _, labels = np.unique(block, axis=0, return_inverse=True)
            raise _MixedError(labels.reshape(-1))
        return bytes(block[0].tobytes())


def _points(message: Any, received: Array) -> Array:
    """Return rows (m, 4) of time [s] and position of the points of clouds of float32."""
    float32 = 7
    offsets = {x.name: int(x.offset[0]) for x in message.fields if x.datatype[0] == float32}
    step, count = int(message.point_step[0]), int(message.width[0]) * int(message.height[0])
    data = message.data.reshape(len(message.data), count, step)
    axes = [np.ascontiguousarray(data[..., offsets[x] : offsets[x] + 4]) for x in "xyz"]
    t = np.broadcast_to(_times(message.header, received)[:, None], data.shape[:2])
    columns = [t, *(each.view("<f4")[..., 0] for each in axes)]
    return np.stack(columns, axis=-1).astype(np.float64).reshape(-1, 4)
