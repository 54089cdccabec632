"""Reader of ROS bags: positions, commands, attitudes and on-board logs, on one clock.

Topics are sorted by their contents; see ``topics``. Logs of a drone may be stamped by a clock that
starts at its boot: it is set by the positions in the log, or without these by the smallest delay of
arrival.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchopt.errors import FileError
from hitchopt.lab.flights.bag_files import METADATA, opened_bag
from hitchopt.lab.flights.logs import px4_values
from hitchopt.lab.flights.recordings import (
    MARKER,
    QUANTITIES,
    Logged,
    RecordedFlight,
    fitted_shift,
    flight_of,
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
CAPTURE = "motion_capture_tracking_interfaces"
POSE = f"{CAPTURE}/msg/NamedPose"
OPTITRACK = "mocap4r2_msgs"
VICON = ("vicon_receiver", "vicon_msgs")  # Packages with the same message
VICON_UNIT = 1e-3  # Unit of its positions [m]
MESSAGES = {
    POSE: "string name\ngeometry_msgs/Pose pose\n",
    f"{POSE}Array": f"std_msgs/Header header\n{CAPTURE}/NamedPose[] poses\n",
    f"{CAPTURE}/msg/LatencyInfo": "string source\nuint32 latency\n",
    f"{POSE}ArrayV2": "std_msgs/Header header\nuint64 timestamp\n"
    f"{CAPTURE}/LatencyInfo[] latencies\n{CAPTURE}/NamedPose[] poses\n",
    f"{OPTITRACK}/msg/Marker": "int8 id_type\nint32 marker_index\nstring marker_name\n"
    "geometry_msgs/Point translation\n",
    f"{OPTITRACK}/msg/RigidBody": "string rigid_body_name\n"
    f"{OPTITRACK}/Marker[] markers\ngeometry_msgs/Pose pose\n",
    f"{OPTITRACK}/msg/RigidBodies": "std_msgs/Header header\nuint32 frame_number\n"
    f"{OPTITRACK}/RigidBody[] rigidbodies\n",
    **{
        f"{package}/msg/Position": "float32 x_trans\nfloat32 y_trans\nfloat32 z_trans\n"
        "float32 x_rot\nfloat32 y_rot\nfloat32 z_rot\nfloat32 w\nstring segment_name\n"
        "string subject_name\nint32 frame_number\nstring translation_type\n"
        for package in VICON
    },
    "crazyflie_interfaces/msg/Position": "std_msgs/Header header\n"
    "float32 x\nfloat32 y\nfloat32 z\nfloat32 yaw\n",
    "crazyflie_interfaces/msg/FullState": "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Twist twist\ngeometry_msgs/Vector3 acc\n",
    "crazyflie_interfaces/msg/LogDataGeneric": "std_msgs/Header header\nuint32 timestamp\n"
    "float32[] values\n",
}

_Parts = dict[str, Any]  # Numbers of a sample by quantity


class _Stamp(NamedTuple):
    """The parent frame of a sample, and its time [s], 0 if it is not stated."""

    parent: str
    t: float


Samples = list[tuple[str, _Stamp, _Parts]]  # Frame, stamp and quantities of each body in a message


def _stamp(header: Any) -> _Stamp:
    """Return the stamp of a message's header."""
    return _Stamp(header.frame_id.strip("/"), float(header.stamp.sec + 1e-9 * header.stamp.nanosec))


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _pose(pose: Any) -> _Parts:
    q = pose.orientation
    return {"position": _xyz(pose.position), "attitude": (*_xyz(q), q.w)}


def _transform(transform: Any) -> _Parts:
    q = transform.rotation
    return {"position": _xyz(transform.translation), "attitude": (*_xyz(q), q.w)}


def _full_state(m: Any) -> Samples:
    values = {"velocity": _xyz(m.twist.linear), "acceleration": _xyz(m.acc)}
    return [("", _stamp(m.header), {**_pose(m.pose), **values})]


def _position(m: Any) -> Samples:
    return [("", _stamp(m.header), {"position": _xyz(m), "yaw": (m.yaw,)})]


def _imu(m: Any) -> Samples:
    values = {"rates": _xyz(m.angular_velocity), "specific_force": _xyz(m.linear_acceleration)}
    return [("", _stamp(m.header), values)]


def _log(m: Any) -> Samples:
    """Return the values of a log; those of crazyswarm2 are stamped from the drone's boot [ms]."""
    stamp = _stamp(m.header)
    boot_time = getattr(m, "timestamp", None)
    return [
        (
            "",
            stamp if boot_time is None else stamp._replace(t=1e-3 * boot_time),
            {"values": m.values},
        )
    ]


def _vicon(m: Any) -> Samples:
    """Return the pose of a segment; newer versions of the message have a header."""
    values = [VICON_UNIT * getattr(m, f"{axis}_trans") for axis in "xyz"]
    attitude = (m.x_rot, m.y_rot, m.z_rot, m.w)
    stamp = _stamp(m.header) if hasattr(m, "header") else _Stamp("", 0.0)
    return [(m.subject_name, stamp, {"position": values, "attitude": attitude})]


def _px4_stamp(m: Any) -> _Stamp:
    """Return the stamp of a message of PX4, of the sample if it is stated [µs]."""
    return _Stamp("", 1e-6 * (getattr(m, "timestamp_sample", 0) or m.timestamp))


def _px4_odometry(m: Any) -> Samples:
    """Return pose and rates of a drone in PX4's axes, and its velocity in those of the world."""
    position = px4_values("world", m.position)
    attitude, rates = px4_values("attitude", m.q), px4_values("body", m.angular_velocity)
    parts = {"position": position, "attitude": attitude, "rates": rates}
    if m.velocity_frame == m.pose_frame:
        parts["velocity"] = px4_values("world", m.velocity)
    return [("", _px4_stamp(m), parts)]


def _px4_position(m: Any) -> Samples:
    """Return the estimated position and velocity of a drone while they are valid."""
    position = px4_values("world", (m.x, m.y, m.z))
    velocity = px4_values("world", (m.vx, m.vy, m.vz))
    parts = {
        "position": position if m.xy_valid and m.z_valid else np.full(3, np.nan),
        "velocity": velocity if m.v_xy_valid and m.v_z_valid else np.full(3, np.nan),
    }
    return [("", _px4_stamp(m), parts)]


# Message types that are read, those with positions by preference: whether messages name the
# bodies, and functions that return the samples of a message
MESSAGE_TYPES: dict[str, tuple[bool, Callable[[Any], Samples]]] = {
    **{
        f"{POSE}Array{version}": (
            True, lambda m: [(x.name, _stamp(m.header), _pose(x.pose)) for x in m.poses],
        )
        for version in ("", "V2")
    },
    f"{OPTITRACK}/msg/RigidBodies": (
        True, lambda m: [(x.rigid_body_name, _stamp(m.header), _pose(x.pose))
                         for x in m.rigidbodies],
    ),
    **{f"{x}/msg/Position": (False, _vicon) for x in VICON},
    "geometry_msgs/msg/TransformStamped": (
        False, lambda m: [(m.child_frame_id, _stamp(m.header), _transform(m.transform))],
    ),
    "tf2_msgs/msg/TFMessage": (
        True, lambda m: [(x.child_frame_id, _stamp(x.header), _transform(x.transform))
                         for x in m.transforms],
    ),
    "geometry_msgs/msg/PoseStamped": (False, lambda m: [("", _stamp(m.header), _pose(m.pose))]),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        False, lambda m: [("", _stamp(m.header), _pose(m.pose.pose))],
    ),
    "nav_msgs/msg/Odometry": (
        False, lambda m: [(m.child_frame_id, _stamp(m.header), _pose(m.pose.pose))],
    ),
    "px4_msgs/msg/VehicleOdometry": (False, _px4_odometry),
    "px4_msgs/msg/VehicleLocalPosition": (False, _px4_position),
    **{f"{x}/msg/FullState": (False, _full_state) for x in CRAZYFLIES},
    **{f"{x}/msg/Position": (False, _position) for x in CRAZYFLIES},
    **{
        f"{x}/msg/{name}": (False, _log)
        for x in CRAZYFLIES
        for name in ("GenericLogData", "LogDataGeneric")
    },
    "sensor_msgs/msg/Imu": (False, _imu),
}  # fmt: skip
CLOUD = "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True, eq=False)
class _Stream:
    """Samples of a frame in a topic.

    Attributes
    ----------
    topic: the topic that has the frame.
    parent: frame of the positions.
    t, received: times of stamps and of arrival (m,) [s].
    parts: quantities (m, k) by name.
    """

    topic: Topic
    parent: str
    t: Array
    received: Array
    parts: dict[str, Array]

    def rows(self, part: str, shift: float = 0.0) -> Array:
        """Return rows of time [s] and a quantity, on a clock that is shifted [s]."""
        return np.column_stack([self.t + shift, self.parts[part]])

    @property
    def delay(self) -> float:
        """Median delay between stamp and arrival [s]."""
        return float(np.median(self.received - self.t))

    @property
    def smallest_delay(self) -> float:
        """Smallest delay between stamp and arrival [s]."""
        return float(np.min(self.received - self.t))

    @property
    def has_positions(self) -> bool:
        return "position" in self.parts

    @property
    def turns(self) -> bool:
        """Return whether the attitude is measured: that of one marker does not change."""
        ranges = np.ptp(self.parts["attitude"], axis=0)
        return bool(np.nanmax(ranges, initial=0.0) >= MIN_TURN)


_Frames = dict[str, _Stream]  # Streams of a topic by frame


@dataclass(frozen=True)
class _Clock:
    """The clock of a drone's logs.

    Attributes
    ----------
    shift: time of the positions' clock minus that of the logs [s].
    residual: remaining distance of the logged positions [m]; infinite if ``shift`` is not fitted
        to positions.
    """

    shift: float
    residual: float = np.inf

    @property
    def is_fitted(self) -> bool:
        return bool(np.isfinite(self.residual))


@dataclass(frozen=True, eq=False)
class _Body:
    """Streams of a drone or a load.

    Attributes
    ----------
    track: stream of its positions.
    is_load: whether it is a load.
    others: streams of other quantities.
    """

    track: _Stream
    is_load: bool = False
    others: list[_Stream] = field(default_factory=list)

    def clock(self) -> _Clock | None:
        """Return the clock of its logs; None if all streams are on the clock of the positions."""
        logs = [each for each in self.others if self._is_log(each)]
        if not logs:
            return None
        for log in logs:
            if log.has_positions:
                guess = log.smallest_delay - self.track.delay
                span = (guess + ARRIVALS[0], guess + ARRIVALS[1])
                fit = fitted_shift(log.rows("position"), self.track.rows("position"), span)
                if fit is not None:
                    return _Clock(*fit)
        return _Clock(logs[0].smallest_delay - self.track.delay)

    def quantities(self, clock: _Clock | None) -> dict[str, Logged]:
        """Return its quantities, each from the first stream that has it."""
        quantities = {"position": Logged(self.track.rows("position"), self.track.topic.family)}
        for stream in (self.track, *self.others):
            shift = clock.shift if clock is not None and self._is_log(stream) else 0.0
            for part in stream.parts:
                quantity = quantity_name(stream.topic.kind, part)
                if quantity in quantities or quantity not in QUANTITIES:
                    continue
                if part == "attitude" and not stream.turns:
                    continue
                quantities[quantity] = Logged(stream.rows(part, shift), stream.topic.family)
        return quantities

    def _is_log(self, stream: _Stream) -> bool:
        """Return whether a stream is on another clock than the positions."""
        return abs(stream.delay - self.track.delay) >= MAX_DELAY


def read_bag(paths: Sequence[Path], unit: str | None, topic: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with or without definitions of its types."""
    directory = paths[0].parent
    place = directory if len(paths) > 1 or (directory / METADATA).is_file() else paths[0]
    # Exceptions of rosbags have no common base
    with reading(place, "bag", Exception), opened_bag(paths, MESSAGES) as bag:
        topics = _topics_of(bag.types)
        clouds = sorted(name for name, kind in bag.types.items() if kind == CLOUD)
        messages = bag.messages([*(each.name for each in topics), *clouds[:1]])
        frames = {
            each.name: _streams(each, bag.types[each.name], messages[each.name]) for each in topics
        }
        markers = [_points(*arrived) for name in clouds[:1] for arrived in messages[name]]
    with_positions = [
        each
        for each in topics
        if any(stream.has_positions for stream in frames[each.name].values())
    ]
    if not with_positions:
        held = ", ".join(sorted(set(bag.types.values())))
        raise FileError(f"contains none of {', '.join(MESSAGE_TYPES)}, but {held}")
    taken, topic_notes = taken_topics(with_positions, topic)
    tracks, frame_notes = _tracks_by_body(frames, taken)
    bodies = _bodies(tracks, loads=_loads_among(tracks) if topic is None else set())
    others = sorted((each for each in topics if each not in taken), key=lambda x: x.preference)
    _add_streams(bodies, [stream for each in others for stream in frames[each.name].items()])
    clocks = {name: clock for name, body in bodies.items() if (clock := body.clock()) is not None}
    contents = {name: body.quantities(clocks.get(name)) for name, body in bodies.items()}
    cloud = positions_of({MARKER: np.concatenate(markers)} if markers else {})
    drones = {name: own for name, own in contents.items() if not bodies[name].is_load}
    cloud_notes = list[str]()
    if clouds[1:]:
        cloud_notes.append(f"markers come from {clouds[0]}, not from {', '.join(clouds[1:])}")
    return flight_of(
        bag.source,
        {**drones, **cloud},
        unit or "m",
        loads={name: own for name, own in contents.items() if bodies[name].is_load},
        notes=[*bag.notes, *topic_notes, *frame_notes, *cloud_notes, *_clock_notes(clocks)],
        clock_shifts={name: clock.shift for name, clock in clocks.items()},
        as_sent=True,
    )


def _topics_of(types: Mapping[str, str]) -> list[Topic]:
    """Return the topics that are read, from message types by topic."""
    read = {name: kind for name, kind in types.items() if kind in MESSAGE_TYPES and name != STATIC}
    return bag_topics(read, {kind: named for kind, (named, _) in MESSAGE_TYPES.items()})


def _streams(topic: Topic, kind: str, messages: Sequence[tuple[float, Any]]) -> _Frames:
    """Return the streams of a topic by frame, from times of arrival [s] and messages."""
    samples = defaultdict[str, list[tuple[str, float, float, _Parts]]](list)
    last_part = topic.name.rpartition("/")[2].casefold()
    logged_quantity, logged_count, logged_unit = LOGGED.get(last_part, ("", 0, 1.0))
    samples_of = MESSAGE_TYPES[kind][1]
    for received, message in messages:
        for frame, stamp, parts in samples_of(message):
            values = parts.pop("values", ())
            if len(values) == logged_count > 0:
                parts[logged_quantity] = logged_unit * np.asarray(values)
            if parts:
                samples[frame.strip("/")].append((*stamp, received, parts))
    return {frame: _stream(topic, own) for frame, own in samples.items()}


def _stream(topic: Topic, samples: Sequence[tuple[str, float, float, _Parts]]) -> _Stream:
    """Return a stream of the parent, stamp [s], arrival [s] and quantities of each sample.

    Messages without any stamp have the times of their arrival.
    """
    parents, stamps, arrivals, parts = zip(*samples, strict=True)
    common = set.intersection(*map(set, parts))
    return _Stream(
        topic,
        parents[-1],
        np.array(stamps if any(stamps) else arrivals),
        np.array(arrivals),
        {name: np.array([own[name] for own in parts], np.float64) for name in common},
    )


def _points(received: float, cloud: Any) -> Array:
    """Return rows (m, 4) of time [s] and position of the points of a cloud of float32."""
    float32 = 7
    offsets = {each.name: each.offset for each in cloud.fields if each.datatype == float32}
    data = cloud.data.reshape(cloud.width * cloud.height, cloud.point_step)
    axes = [
        np.ascontiguousarray(data[:, offsets[axis] : offsets[axis] + 4]).view("<f4")
        for axis in "xyz"
    ]
    t = np.full((len(data), 1), _stamp(cloud.header).t or received)
    return np.concatenate([t, *axes], axis=1)


def _tracks_by_body(
    frames_of: Mapping[str, _Frames], topics: Sequence[Topic]
) -> tuple[dict[str, _Stream], list[str]]:
    """Return the streams of positions by body, and notes.

    Frames with a moving parent are omitted. Raises FileError if two topics have the same body.
    """
    tracks = dict[str, _Stream]()
    omitted = list[str]()
    for topic in topics:
        frames = frames_of[topic.name]
        for frame, name in _names_by_frame(topic, list(frames)).items():
            parent = frames.get(frames[frame].parent) if frames[frame].parent else None
            if parent is not None and _moves(parent):
                omitted.append(frame)
                continue
            body = name or topic.name.strip("/")
            if body in tracks:
                both = " and ".join(sorted((tracks[body].topic.family, topic.family)))
                raise FileError(f"{body} has positions in {both}: choose one with topic=")
            tracks[body] = frames[frame]
    notes = [f"{', '.join(omitted)} omitted: positions in moving frames"] if omitted else []
    return tracks, notes


def _names_by_frame(topic: Topic, frames: Sequence[str]) -> dict[str, str]:
    """Return names of bodies by frame: the part of frames that differs, if it is unique."""
    if len(frames) == 1 and topic.body:
        return dict.fromkeys(frames, topic.body)
    names = {frame: name or frame for frame, (name, _) in body_names(frames).items()}
    counts = Counter(names.values())
    return {frame: name if counts[name] == 1 else frame for frame, name in names.items()}


def _moves(stream: _Stream) -> bool:
    return bool(np.max(np.ptp(stream.parts["position"], axis=0)) > MAX_FIXED)


def _loads_among(bodies: Collection[str]) -> set[str]:
    """Return the bodies that are named as loads, unless all are."""
    loads = set(filter(is_load, bodies))
    return loads if len(loads) < len(bodies) else set()


def _bodies(tracks: Mapping[str, _Stream], loads: Collection[str]) -> dict[str, _Body]:
    return {name: _Body(track, name in loads) for name, track in tracks.items()}


def _add_streams(bodies: dict[str, _Body], streams: Sequence[tuple[str, _Stream]]) -> None:
    """Add other streams, each with its frame, to their bodies; loads among them are new bodies."""
    drones = {name for name, body in bodies.items() if not body.is_load}
    for frame, stream in streams:
        topic = stream.topic
        if topic.kind == LOAD and stream.has_positions:
            name = topic.body if is_load(topic.body) else LOAD
            bodies.setdefault(name, _Body(stream, is_load=True))
            continue
        # A part of the names of topic and frame may be a drone's
        parts = [topic.body, *topic.name.split("/"), *frame.split("/")]
        name = next((part for part in parts if part in drones), "")
        if name:
            bodies[name].others.append(stream)


def _clock_notes(clocks: Mapping[str, _Clock]) -> Iterator[str]:
    """Yield sentences on the clocks of logs by body."""
    words = "their logs' clocks are set by"
    residuals = {name: clock.residual for name, clock in clocks.items() if clock.is_fitted}
    if residuals:
        error = f"{1e3 * max(residuals.values()):.0f} mm"
        yield f"{', '.join(residuals)}: {words} positions, which then agree to {error}"
    if by_arrival := [name for name, clock in clocks.items() if not clock.is_fitted]:
        delay = "the smallest delay of arrival, which may be seconds"
        yield f"{', '.join(by_arrival)}: {words} {delay}"
