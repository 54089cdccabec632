"""A Crazyflie's compressed trajectory: its bytes, made and read.

8 bytes of the start (int16 x, y, z in mm, yaw in 0.1°), then per segment 3 bytes of header (two
bits per axis for its type, x lowest, yaw highest; uint16 duration in ms) and int16 Bézier control
points of each axis in turn, the first one left out as the segment before ends there: none
(constant), 1 (linear), 3 (cubic) or 7. A segment of no duration ends it: without one the drone
flies on into what an earlier upload left in its memory. Everything is little-endian.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.refit.piece_fitting import Kind
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

Integers = NDArray[np.int64]

DEGREE = 7
"""Degree of the segments that are written."""

POINTS = (0, 1, 3, DEGREE)
"""Control points that a segment of each type gives for an axis."""

LARGEST = 32.767
"""Largest distance of a control point from zero along an axis [m]."""

LONGEST = 65.535
"""Longest duration of a segment [s]."""

MILLI = 1e-3
"""Unit of durations [s] and control points [m]."""

KIND = Kind(degree=DEGREE, match=3, quantum=MILLI, longest=LONGEST)
"""Segments that are written; their durations are whole milliseconds."""

HEADER_BYTES, START_BYTES = 3, 8

END = b"\x00\x00\x00"
"""The segment of no duration."""


@dataclass(frozen=True, eq=False)
class Compressed:
    """One drone's trajectory as it stands in memory.

    Attributes
    ----------
    curve: positions (3,) [m].
    yaws: control points of the yaw [rad], one after the other.
    ended: whether a segment of no duration ends it.
    size: [bytes], up to and with that one.
    """

    curve: PiecewisePolynomial
    yaws: Array
    ended: bool
    size: int


def most_segments(size: int, axes: int) -> int:
    """Return how many segments fit into so many bytes, if so many axes move."""
    return (size - START_BYTES - len(END)) // (HEADER_BYTES + 2 * DEGREE * max(1, axes))


def encoded(durations: Integers, points: Integers, heading: float) -> bytes:
    """Return the bytes of one drone.

    Parameters
    ----------
    durations: (segments,) [ms]
    points: (segments, 3, 8) Bézier control points [mm], each segment from where the last ended.
    heading: the constant yaw [rad].

    Raises
    ------
    InfeasibleError: a control point beyond ±32.767 m, or a duration beyond 65.535 s.
    """
    farthest, longest = (float(np.max(np.abs(v))) * MILLI for v in (points, durations))
    for name, value, limit, unit, remedy in (
        ("range", farthest, LARGEST, "m", "move the plan with --origin"),
        ("segment", longest, LONGEST, "s", "use another format"),
    ):
        if value > limit:
            raise InfeasibleError([Violation(name, value, limit, "max", unit, (), "", remedy)])
    yaw = round(math.degrees(heading) * 10.0)
    parts = [struct.pack("<hhhh", *points[0, :, 0].tolist(), yaw)]
    for duration, segment in zip(durations.tolist(), points, strict=True):
        moving = np.ptp(segment, axis=-1) > 0  # what stays needs no points, all else has 7
        kind = sum(POINTS.index(DEGREE) << (2 * i) for i in np.flatnonzero(moving).tolist())
        values = segment[moving, 1:].astype("<i2").tobytes()
        parts.append(struct.pack("<BH", kind, duration) + values)
    return b"".join([*parts, END])


def decoded(data: bytes, source: str = "trajectory") -> Compressed:
    """Return the trajectory that the bytes stand for, up to its end or theirs.

    Raises
    ------
    FileError: bytes that stop within a segment, or none that lasts.
    """
    if len(data) < START_BYTES:
        raise FileError(f"{source}: has {len(data)} bytes, and the start alone takes {START_BYTES}")
    *last, yaw = struct.unpack_from("<hhhh", data)
    at, ended = START_BYTES, False
    durations: list[int] = []
    segments: list[list[list[int]]] = []
    yaws = [yaw]
    while at < len(data):
        if at + HEADER_BYTES > len(data):
            raise FileError(f"{source}: stops within a segment's header, at byte {at}")
        kind, duration = struct.unpack_from("<BH", data, at)
        counts = [POINTS[(kind >> (2 * i)) & 3] for i in range(4)]
        at += HEADER_BYTES
        if duration == 0:
            ended = True
            break
        if at + 2 * sum(counts) > len(data):
            raise FileError(f"{source}: stops within segment {len(durations)}, at byte {len(data)}")
        axes = []
        for i, count in enumerate(counts):
            values = struct.unpack_from(f"<{count}h", data, at)
            at += 2 * count
            if i == 3:
                yaws += values
                continue
            axes.append([last[i], *values])
            last[i] = axes[-1][-1]
        durations.append(duration)
        segments.append(axes)
    if not durations:
        raise FileError(f"{source}: has no segment that lasts")
    rows = [[bernstein.elevate(np.array(a, dtype=np.float64), DEGREE) for a in s] for s in segments]
    breaks = np.concatenate([[0], np.cumsum(durations)]) * MILLI
    curve = PiecewisePolynomial(breaks, np.array(rows) * MILLI)
    return Compressed(curve, np.radians(np.array(yaws, dtype=np.float64) / 10.0), ended, at)
