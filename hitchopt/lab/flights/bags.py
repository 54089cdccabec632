"""Reader of ROS bags: positions, commands, attitudes and on-board logs, on one clock.

Topics are sorted by what they hold; see ``topics``. Logs of a drone may be stamped by a clock that
starts at its boot: it is set by the positions in the log, else by the smallest delay of arrival.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.lab.flights.clocks import fitted_shift
from hitchopt.lab.flights.messages import (
    CLOUD,
    MESSAGE_TYPES,
    MESSAGES,
    decoded,
    points_of,
)
from hitchopt.lab.flights.recordings import (
    MARKER,
    QUANTITIES,
    RecordedFlight,
    flight_of,
    library,
)
from hitchopt.lab.flights.topics import (
    LOAD,
    Topic,
    bag_topics,
    distinct_names,
    is_load,
    logged_quantity,
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
                markers = [_cloud(message, received[rows]) for rows, message in groups]
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
    loads = {name: own for name, own in bodies.items() if is_load(name) and topic is None}
    if len(loads) == len(bodies):
        loads = {}
    tracks = {name: own for name, own in bodies.items() if name not in loads}
    contents = _Contents(tracks, loads)
    for each in sorted(topics.values(), key=lambda x: x.preference):
        contents.add(each, streams.get(each.name, {}), is_taken=each in taken)
    rows = {name: stream.rows("position") for name, (_, stream) in tracks.items()}
    cloud = {MARKER: np.concatenate(markers)} if markers else {}
    return flight_of(
        source,
        rows | cloud,
        unit or "m",
        notes=[*notes, *contents.notes],
        setpoints=contents.setpoints,
        signals=contents.signals,
        loads=contents.loads,
        sources=contents.sources,
        clock_shifts=contents.shifts,
        as_sent=True,
    )


def _times(header: Any, received: Array) -> Array:
    """Return times of stamps [s], or of arrival if no message has a stamp."""
    t = header.stamp.sec + 1e-9 * header.stamp.nanosec
    return t if np.any(t) else received


def _cloud(message: Any, received: Array) -> Array:
    """Return rows (m, 4) of the points of a group of clouds."""
    points = points_of(message)
    t = np.broadcast_to(_times(message.header, received)[:, None, None], (*points.shape[:2], 1))
    return np.concatenate([t, points], axis=2).reshape(-1, 4)


def _streams(
    topic: str, kind: str, groups: Sequence[tuple[Indices, Any]], received: Array
) -> dict[str, _Stream]:
    """Return the streams of a topic by frame, in the order in which they were recorded."""
    pieces = defaultdict[str, list[tuple[Indices, str, Array, dict[str, Array]]]](list)
    for rows, message in groups:
        for frame, header, fields in MESSAGE_TYPES[kind][1](message):
            parts = fields
            if "values" in fields:
                quantity, scale = logged_quantity(topic, fields["values"].shape[1])
                parts = {quantity: scale * fields["values"]} if quantity else {}
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


def _bodies_of_frames(
    streams: _Streams, topics: Sequence[Topic]
) -> tuple[dict[str, tuple[Topic, _Stream]], list[str]]:
    """Return topics and streams by body, and notes.

    Frames with a moving parent are omitted. Raises FileError if two topics have the same body.
    """
    bodies, omitted = dict[str, tuple[Topic, _Stream]](), list[str]()
    for topic in topics:
        frames = streams[topic.name]
        names = dict.fromkeys(frames, topic.body) if len(frames) == 1 and topic.body else {}
        for frame, name in (names or distinct_names(list(frames))).items():
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


class _Contents:
    """Quantities of bodies whose positions are known, from all topics of a bag."""

    def __init__(
        self,
        tracks: Mapping[str, tuple[Topic, _Stream]],
        loads: Mapping[str, tuple[Topic, _Stream]],
    ) -> None:
        self._tracks = tracks
        self.signals, self.setpoints = dict[str, dict[str, Array]](), dict[str, Array]()
        self.loads, self.sources = dict[str, Array](), dict[str, dict[str, str]]()
        self.shifts, self._unfitted = dict[str, float](), list[str]()
        self._residuals = list[float]()
        for name, (topic, stream) in {**tracks, **loads}.items():
            self.sources[name] = {"position": topic.family}
            self._add_parts(name, topic, stream, 0.0)
        for name, (_, stream) in loads.items():
            self.loads[name] = stream.rows("position")

    @property
    def notes(self) -> list[str]:
        """Sentences on clocks of bodies."""
        notes, names = list[str](), [name for name in self.shifts if name not in self._unfitted]
        if names:
            error = f"{1e3 * max(self._residuals):.0f} mm"
            words = "their logs' clocks are set by positions, which then agree to"
            notes.append(f"{', '.join(names)}: {words} {error}")
        if self._unfitted:
            words = "their logs' clocks are set by the smallest delay of arrival"
            notes.append(f"{', '.join(self._unfitted)}: {words}, which may be seconds")
        return notes

    def add(self, topic: Topic, frames: Mapping[str, _Stream], *, is_taken: bool) -> None:
        """Add the quantities of a topic, except positions of the topics that are taken."""
        if is_taken:
            return
        for frame, stream in frames.items():
            if topic.kind == LOAD and "position" in stream.parts:
                name = topic.body if topic.body and is_load(topic.body) else LOAD
                if name not in self.loads and name not in self._tracks:
                    self.loads[name] = stream.rows("position")
                    self.sources[name] = {"position": topic.family}
                    self._add_parts(name, topic, stream, 0.0)
                continue
            body = self._body(topic, frame)
            if body is not None:
                self._add_parts(body, topic, stream, self._shift(body, stream))

    def _body(self, topic: Topic, frame: str) -> str | None:
        """Return the body of a frame of a topic; None if it is no known body."""
        parts = [topic.body, *topic.name.split("/"), *frame.split("/")]
        return next((part for part in parts if part in self._tracks), None)

    def _shift(self, body: str, stream: _Stream) -> float:
        """Return the time of the recording minus that of a stream's clock [s]."""
        delay = self._tracks[body][1].delay
        if abs(stream.delay - delay) < MAX_DELAY:
            return 0.0
        if body not in self.shifts or (body in self._unfitted and "position" in stream.parts):
            guess = float(np.min(stream.received - stream.t)) - delay
            residual = np.inf
            if "position" in stream.parts:
                reference = self._tracks[body][1].rows("position")
                own = stream.rows("position")
                span = (guess + ARRIVALS[0], guess + ARRIVALS[1])
                guess, residual = fitted_shift(own, reference, span) or (guess, np.inf)
            if np.isfinite(residual):
                self._residuals.append(residual)
                self._unfitted = [name for name in self._unfitted if name != body]
            elif body not in self._unfitted:
                self._unfitted.append(body)
            self.shifts[body] = guess
        return self.shifts[body]

    def _add_parts(self, body: str, topic: Topic, stream: _Stream, shift: float) -> None:
        sources = self.sources.setdefault(body, {})
        for part, values in stream.parts.items():
            quantity = quantity_name(topic.kind, part)
            if quantity in sources or quantity not in QUANTITIES:
                continue
            if part == "attitude" and np.nanmax(np.ptp(values, axis=0), initial=0.0) < MIN_TURN:
                continue  # Of one marker
            rows = stream.rows(part, shift)
            if quantity == "commanded_position":
                self.setpoints[body] = rows
            else:
                self.signals.setdefault(body, {})[quantity] = rows
            sources[quantity] = topic.family
