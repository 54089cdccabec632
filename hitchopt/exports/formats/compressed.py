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
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.format import (
    Candidate,
    DroneFacts,
    Finding,
    Format,
    Loaded,
    Task,
    error,
    warning,
    writer_of,
)
from hitchopt.exports.placing import AXES
from hitchopt.exports.recording import recording_of_curves
from hitchopt.exports.refit import (
    Keeping,
    Kind,
    Scale,
    breaks_within,
    fitted,
    rounded,
    settled,
)
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

BOUNDS = (1.0, 1.4, 0.8, 2.0, 0.6, 1.2, 0.9, 1.6, 0.4, 0.2)
"""Errors of the refit over Scale, the best first: long pieces fit worse and suffer less from
rounding."""

SCALE = Scale(position=5e-4, velocity=1e-2, acceleration=0.2)  # Errors of rounding that weigh alike

STEADY = 2e-3
"""[rad] Yaw that changes less is constant: a tenth of a degree is the format's last digit."""


def beyond_memory(fact: DroneFacts) -> Iterator[Finding]:
    """Yield an error if a drone's trajectory takes more than its memory."""
    if fact.size > BYTES:
        yield error(
            "memory",
            fact.name,
            f"{fact.pieces} pieces take {fact.size} bytes, and a drone has {BYTES} for all its "
            "trajectories; refit it with fewer pieces, or cut it into parts",
        )


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
    bound: float  # largest error of a refit, over its scale
    unit: str  # name of the pieces
    nearness: str  # description of the bound
    remedy: str  # what to do about a plan that needs more memory

    @abstractmethod
    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many pieces of some curves memory holds."""

    def arrangements(self, task: Task) -> Iterator[Sequence[Task]]:
        """Give the task as a whole if it fits, then cut at rests into as few parts as fit.

        Parts that are refitted too coarsely to keep the plan's limits are followed by closer ones.

        Raises
        ------
        InfeasibleError: between two rests there is more than fits.
        """
        motion, before = task.motion, 1
        at = rests(motion).tolist()
        if whole := self._held(motion):
            yield (task,)
            if len(at) == 2:
                return
        for share in (1.0, CLOSER):
            parts = self._parts(motion, at, share)
            if len(parts) <= before:
                continue
            before = len(parts)
            lost = "loses a limit in so few pieces" if whole else "does not fit"
            why = (
                f"the plan is cut into {before} parts at rests, since as a whole it {lost} "
                f"(a drone's memory holds {BYTES} bytes): fly one and let the drones hover, "
                f"{UPLOAD_LAST}, go on"
            )
            part = replace(task, count=before, why=why)
            begins = [float(motion.drones.breaks[start]) for start, _ in parts]
            yield [
                replace(part, motion=each, begins=begins[i], number=i + 1)
                for i, (_, each) in enumerate(parts)
            ]

    def _held(self, motion: Motion, share: float = 1.0) -> bool:
        """Return whether memory holds a motion within a share of the bound."""
        most = self.most_pieces(motion.drones)
        return breaks_within(motion.drones, self.kind, share * self.bound, most) is not None

    def _parts(self, motion: Motion, at: Sequence[int], share: float) -> list[tuple[int, Motion]]:
        """Return as few parts between rests as memory holds, and the rest each begins at."""
        parts: list[tuple[int, Motion]] = []
        first = 0
        while first < len(at) - 1:
            # All of the plan in one part has been tried before.
            ends = range(first + 1, len(at) - (first == 0 and len(at) > 2))
            tried = (cut(motion, at[first], at[end]) for end in ends)
            held = list(takewhile(lambda part: self._held(part, share), tried))
            if not held:
                raise self._refusal(cut(motion, at[first], at[first + 1]))
            parts.append((at[first], held[-1]))
            first += len(held)
        return parts

    def _refusal(self, motion: Motion) -> InfeasibleError:
        """Return the error that memory does not hold a motion without a rest."""
        breaks = breaks_within(motion.drones, self.kind, self.bound)
        pieces = math.inf if breaks is None else len(breaks) - 1.0
        most = float(self.most_pieces(motion.drones))
        when = f"to stay {self.nearness} a plan of {motion.duration:.4g} s without a rest"
        return InfeasibleError(
            [Violation("memory", pieces, most, "max", self.unit, (), when, self.remedy)],
            "it cannot be cut either, as nothing rests in between; stream it: "
            "--format ros2bag (full-state setpoints), csv or mavsdk_drone_show",
        )


class CompressedBytes(CrazyflieFormat):
    """One file of bytes per drone, whose name tells the frame as the bytes cannot."""

    name = "compressed"
    file = "{name}_{frame}.bin"
    endings = several = (".bin",)
    kind = KIND
    bound = BOUNDS[0]
    unit = "segments"
    nearness = "near"
    remedy = "let the plan rest now and then"
    accuracy = 2e-3

    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many segments memory holds: they are longer the more axes move."""
        moving = np.ptp(curves.coefficients, axis=(0, 3)) > 0.0
        axes = max(1, int(np.max(np.sum(moving, axis=-1))))
        return (BYTES - START_BYTES - len(END)) // (HEADER_BYTES + 2 * DEGREE * axes)

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give refits of different lengths of pieces, those that memory holds."""
        for bound in BOUNDS:
            data = compressed(task, bound, self.accuracy)
            most = max(map(len, data))
            if most > BYTES:
                continue
            each = zip(self.files(task), data, strict=True)
            note = (
                f"up to {most} of {BYTES} bytes of each drone's memory; velocity jumps "
                "where segments join by no more than twice the velocity error above"
            )
            yield Candidate({file: writer_of(content) for file, content in each}, (note,))

    def load(self, files: Sequence[Path]) -> Loaded:
        """Return what files of bytes hold, one drone each."""
        found = [decoded(read_bytes(path), str(path)) for path in files]
        stems = [path.stem.rpartition("_") for path in files]
        framed = all(stem[2] in AXES and stem[0] for stem in stems)
        names = [stem[0] if framed else path.stem for stem, path in zip(stems, files, strict=True)]
        frames = {stem[2] for stem in stems} if framed else set()
        facts, findings = [], []
        for name, drone in zip(names, found, strict=True):
            facts.append(DroneFacts(name, drone.curve.pieces, drone.size, drone.curve.duration))
            findings += [*beyond_memory(facts[-1]), *_faults(name, drone)]
        frame = frames.pop() if len(frames) == 1 else ""
        recording = recording_of_curves(names, [drone.curve for drone in found], frame, SMOOTH)
        return Loaded(self.name, recording, tuple(facts), tuple(findings))


def compressed(task: Task, bound: float, accuracy: float) -> list[bytes]:
    """Return the bytes of every drone.

    Parameters
    ----------
    task: the plan.
    bound: largest error of the refit before rounding, over Scale.
    accuracy: largest error of positions after rounding [m].

    Raises
    ------
    InfeasibleError: the plan is beyond ±32.767 m.
    """
    curves = task.motion.drones
    breaks = breaks_within(curves, KIND, bound)
    if breaks is None:  # only a limited number of pieces can be too small
        raise FileError("compressed: the plan has no pieces")
    placed = task.frame.placed(fitted(curves, breaks, KIND))
    rounding = rounded(placed, MILLI, SCALE)
    keeping = Keeping.of(task.motion, task.frame, breaks, accuracy, task.options.hold_tension)
    whole = settled(rounding, placed, MILLI, keeping)
    durations = np.rint(np.diff(breaks) / MILLI).astype(np.int64)
    points = np.rint(whole.coefficients / MILLI).astype(np.int64)
    return [encoded(durations, points[:, i], task.frame.heading) for i in range(len(task.names))]


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
