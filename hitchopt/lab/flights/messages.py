"""Messages of ROS bags, decoded as arrays over all messages of a topic.

Messages of one type with equal texts and counts have each number at the same bytes. So messages are
grouped by these, and each field of a group is read at once, by the type's definition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array, Indices

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


def points_of(message: Any) -> Array:
    """Return the points (messages, k, 3) of clouds of float32."""
    float32 = 7
    offsets = {x.name: int(x.offset[0]) for x in message.fields if x.datatype[0] == float32}
    step, count = int(message.point_step[0]), int(message.width[0]) * int(message.height[0])
    data = message.data.reshape(len(message.data), count, step)
    axes = [np.ascontiguousarray(data[..., offsets[x] : offsets[x] + 4]) for x in "xyz"]
    return np.stack([each.view("<f4")[..., 0] for each in axes], axis=-1).astype(np.float64)
