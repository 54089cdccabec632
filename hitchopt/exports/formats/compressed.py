"""Format compressed: the bytes that a Crazyflie takes, one file per drone.

8 bytes of the start (int16 x, y, z in mm, yaw in 0.1°), then per segment 3 bytes of header (two
bits per axis for its type, x lowest, yaw highest; uint16 duration in ms) and int16 Bézier control
points of each axis in turn, the first one left out as the segment before ends there: none
(constant), 1 (linear), 3 (cubic) or 7. A segment of no duration ends it: without one the drone
flies on into what an earlier upload left in its memory. Everything is little-endian.

Control points are whole millimetres, rounded together so that velocity suffers little, and yaw is
constant: firmware up to 2026.04 flies changing yaw wrongly. Feed-forward: as with crazyswarm2, the
on-board controller adds gravity and differentiates the curve itself; the cable's pull is not in it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.placing import AXES
from hitchopt.exports.recording import Finding, Recording, error, recording_of_curves, warning
from hitchopt.exports.refit import Kind, Scale, breaks_within, fitted, rounded
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import cut, rests
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

Integers = NDArray[np.int64]

BYTES = 4096  # Size of the memory for all trajectories of one drone [B]

UPLOAD_LAST = "goTo the point where each hovers and wait, only then upload the next"
"""A finished trajectory is evaluated from the memory that an upload overwrites; goTo is not."""

CLOSER = 0.3  # Share of the error within which parts are refitted where coarser ones lose a limit

DEGREE = 7  # Degree of the segments that are written
POINTS = (0, 1, 3, DEGREE)  # Control points that a segment of each type gives for an axis
LARGEST = 32.767  # Largest distance of a control point from zero along an axis [m]
LONGEST = 65.535  # Longest duration of a segment [s]
MILLI = 1e-3  # Unit of durations [s] and control points [m]

KIND = Kind(degree=DEGREE, match=3, quantum=MILLI, longest=LONGEST)
"""Segments that are written; their durations are whole milliseconds."""

HEADER_BYTES, START_BYTES = 3, 8

END = b"\x00\x00\x00"  # The segment of no duration

SMOOTH = 1
"""Acceleration jumps after rounding; so does velocity, by a few mm/s: see the velocity error."""

SCALE = Scale(position=2e-4, velocity=1e-2, acceleration=0.2)  # Errors of rounding that weigh alike

STEADY = 2e-3
"""[rad] Yaw that changes less is constant: a tenth of a degree is the format's last digit."""


class CrazyflieFormat(Format):
    """A format of trajectories that are uploaded into a Crazyflie's memory."""

    frames = ("enu", "nwu")
    receiver_integral = True
    feed_forward = (
        "not in these files: the on-board controller takes acceleration from the curve and adds "
        "gravity, but not the cable's pull; its integral brings drones to their places and leaves "
        "the tension to the cables' lengths: stream full states (ros2bag), or turn it off and "
        "export with --hold-tension"
    )
    kind: Kind  # of its pieces

    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many pieces of some curves memory holds."""
        raise NotImplementedError

    def parts(self, task: Task) -> Iterator[Sequence[Task]]:
        """Give the task cut at rests into as few parts as fit, then into closer refitted ones."""
        breaks, counts = task.motion.drones.breaks, [1]
        for share in (1.0, CLOSER):
            parts = self._parts(task.motion, share)
            if len(parts) in counts:
                continue
            counts.append(len(parts))
            why = (
                f"the plan is cut into {len(parts)} parts at rests, since as a whole it does not "
                f"fit (a drone's memory holds {BYTES} bytes) or loses a limit: fly one and let the "
                f"drones hover, {UPLOAD_LAST}, go on"
            )
            begins = [float(breaks[first]) for first, _ in parts]
            tasks = [
                replace(task, motion=part, begins=begins[i], number=i + 1, count=len(parts))
                for i, (_, part) in enumerate(parts)
            ]
            yield [replace(t, notes=(*t.notes, f"{t.part}: {why}")) for t in tasks]

    def _parts(self, motion: Motion, share: float) -> list[tuple[int, Motion]]:
        """Return the fewest parts between rests that memory holds, and the break of each start."""
        parts, at, most = [], rests(motion).tolist(), self.most_pieces(motion.drones)

        def held(part: Motion) -> bool:
            return len(breaks_within(part.drones, self.kind, share, most)) - 1 <= most

        while len(at) > 1:
            tried = (cut(motion, at[0], end) for end in at[1:])
            fitting = list(takewhile(held, tried))
            if not fitting:
                raise self.refusal(cut(motion, at[0], at[1]))
            parts.append((at[0], fitting[-1]))
            at = at[len(fitting) :]
        return parts

    def refusal(self, motion: Motion) -> InfeasibleError:
        """Return the error that memory does not hold a motion."""
        pieces = len(breaks_within(motion.drones, self.kind, 1.0)) - 1.0
        when = f"for {motion.duration:.4g} s without a rest"
        most, remedy = float(self.most_pieces(motion.drones)), "let the plan rest now and then"
        return InfeasibleError(
            [Violation("memory", pieces, most, "max", "pieces", (), when, remedy)],
            "it can be cut at rests only; --format compressed holds three times as much as "
            "crazyswarm2; or stream it: --format ros2bag (full-state setpoints), csv or "
            "mavsdk_drone_show",
        )

    def recording(
        self,
        names: Sequence[str],
        curves: Sequence[PiecewisePolynomial],
        frame: str,
        smooth: int,
        sizes: Sequence[int],
        findings: Sequence[Finding],
    ) -> Recording:
        """Return a recording of trajectories of some sizes [bytes], with what is too large."""
        beyond = tuple(
            error(
                "memory",
                name,
                f"{curve.pieces} pieces take {size} bytes, and a drone has {BYTES} for all its "
                "trajectories; refit it with fewer pieces, or cut it into parts",
            )
            for name, curve, size in zip(names, curves, sizes, strict=True)
            if size > BYTES
        )
        found = (*beyond, *findings)
        return recording_of_curves(names, curves, frame, smooth, sizes, findings=found)


class CompressedBytes(CrazyflieFormat):
    """One file of bytes per drone, whose name tells the frame as the bytes cannot."""

    name = "compressed"
    file = "{name}_{frame}.bin"
    endings = several = (".bin",)
    kind = KIND
    accuracy = 2e-3
    bounds = (1.0, 0.6, 1.4, 0.4, 0.2)  # long pieces fit worse and suffer less from rounding

    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many segments memory holds: they are longer the more axes move."""
        moving = np.ptp(curves.coefficients, axis=(0, 3)) > 0.0
        axes = max(1, int(np.max(np.sum(moving, axis=-1))))
        return (BYTES - START_BYTES - len(END)) // (HEADER_BYTES + 2 * DEGREE * axes)

    def write(self, folder: Path, task: Task) -> Written:
        """Write the bytes of every drone, refitted within the task's bound and rounded."""
        breaks = breaks_within(task.motion.drones, KIND, task.bound)
        whole = rounded(task.frame.placed(fitted(task.motion.drones, breaks, KIND)), MILLI, SCALE)
        durations = np.rint(np.diff(breaks) / MILLI).astype(np.int64)
        points = np.rint(whole.coefficients / MILLI).astype(np.int64)
        most = 0
        for i, file in enumerate(files := self.files(task)):
            data = encoded(durations, points[:, i], task.frame.heading)
            (folder / file).write_bytes(data)
            most = max(most, len(data))
        if most > BYTES:
            raise self.refusal(task.motion)
        note = (
            f"up to {most} of {BYTES} bytes of each drone's memory; velocity jumps "
            "where segments join by no more than twice the velocity error above"
        )
        return Written(files, (note,))

    def load(self, files: Sequence[Path]) -> Recording:
        """Return what files of bytes hold, one drone each."""
        found = [decoded(read_bytes(path), str(path)) for path in files]
        stems = [path.stem.rpartition("_") for path in files]
        framed = all(stem[2] in AXES and stem[0] for stem in stems)
        names = [stem[0] if framed else path.stem for stem, path in zip(stems, files, strict=True)]
        frames = {stem[2] for stem in stems} if framed else set()
        frame = frames.pop() if len(frames) == 1 else ""
        faults = [f for name, drone in zip(names, found, strict=True) for f in _faults(name, drone)]
        curves, sizes = [drone.curve for drone in found], [drone.size for drone in found]
        return self.recording(names, curves, frame, SMOOTH, sizes, faults)


def encoded(durations: Integers, points: Integers, heading: float) -> bytes:
    """Return the bytes of one drone.

    Parameters
    ----------
    durations: (segments,) [ms]
    points: (segments, 3, 8) Bézier control points [mm], each segment from where the last ended.
    heading: the constant yaw [rad].

    Raises
    ------
    InfeasibleError: a control point beyond ±32.767 m.
    """
    if (farthest := float(np.max(np.abs(points))) * MILLI) > LARGEST:
        remedy = "move the plan with --origin"
        raise InfeasibleError([Violation("range", farthest, LARGEST, "max", "m", (), "", remedy)])
    yaw = round(math.degrees(heading) * 10.0)
    parts = [struct.pack("<hhhh", *points[0, :, 0].tolist(), yaw)]
    for duration, segment in zip(durations.tolist(), points, strict=True):
        moving = np.ptp(segment, axis=-1) > 0  # what stays needs no points, all else has 7
        kind = sum(POINTS.index(DEGREE) << (2 * i) for i in np.flatnonzero(moving).tolist())
        values = segment[moving, 1:].astype("<i2").tobytes()
        parts.append(struct.pack("<BH", kind, duration) + values)
    return b"".join([*parts, END])


@dataclass(frozen=True, eq=False)
class Compressed:
    """One drone's trajectory as it stands in memory."""

    curve: PiecewisePolynomial  # positions (3,) [m]
    yaws: Array  # control points of the yaw [rad], one after the other
    ended: bool  # whether a segment of no duration ends it
    size: int  # [bytes], up to and with that one


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
    segments: list[list[Array]] = []
    yaws = [yaw]
    while at < len(data) and not ended:
        if at + HEADER_BYTES > len(data):
            raise FileError(f"{source}: stops within a segment's header, at byte {at}")
        kind, duration = struct.unpack_from("<BH", data, at)
        at += HEADER_BYTES
        if ended := duration == 0:
            break
        counts = [POINTS[(kind >> (2 * i)) & 3] for i in range(4)]
        if at + 2 * sum(counts) > len(data):
            raise FileError(f"{source}: stops within segment {len(durations)}, at byte {len(data)}")
        values = struct.unpack_from(f"<{sum(counts)}h", data, at)
        at += 2 * sum(counts)
        *axes, turns = np.split(np.array(values, dtype=np.float64), np.cumsum(counts)[:-1])
        axes = [np.append(start, axis) for start, axis in zip(last, axes, strict=True)]
        last = [axis[-1] for axis in axes]
        yaws += turns.tolist()
        durations.append(duration)
        segments.append([bernstein.elevate(axis, DEGREE) for axis in axes])
    if not durations:
        raise FileError(f"{source}: has no segment that lasts")
    breaks = np.concatenate([[0], np.cumsum(durations)]) * MILLI
    curve = PiecewisePolynomial(breaks, np.array(segments) * MILLI)
    return Compressed(curve, np.radians(np.array(yaws, dtype=np.float64) / 10.0), ended, at)


def read_bytes(path: Path) -> bytes:
    """Return what is in a file of no more than sixteen memories; raise FileError of others."""
    try:
        if path.stat().st_size > 16 * BYTES:
            raise FileError(f"{path}: is far larger than a drone's memory of {BYTES} bytes")
        return path.read_bytes()
    except OSError as fault:
        raise FileError(f"{path}: cannot be read: {fault.strerror or fault}") from fault


def _faults(name: str, drone: Compressed) -> Iterator[Finding]:
    """Yield what is wrong with one drone's bytes."""
    if not drone.ended:
        yield error(
            "end marker",
            name,
            "no segment of no duration ends it: the drone flies on into earlier contents of its "
            "memory; append three zero bytes",
        )
    if float(np.ptp(drone.yaws)) > STEADY:
        yield warning(
            "yaw",
            name,
            f"turns by {math.degrees(np.ptp(drone.yaws)):.3g}°; firmware up to 2026.04 flies "
            "changing yaw wrongly; keep it constant",
        )
    if np.max(np.abs(drone.curve.coefficients)) > LARGEST - 0.5 * MILLI:
        yield error(
            "range",
            name,
            f"a control point is at the end of ±{LARGEST} m: it may have been cut off there; move "
            "the origin",
        )
