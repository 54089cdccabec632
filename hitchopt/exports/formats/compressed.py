"""Format compressed: the bytes that a Crazyflie takes, one file per drone.

Control points are whole millimetres, rounded together so that velocity suffers little, and yaw is
constant: firmware up to 2026.04 flies changing yaw wrongly.

Feed-forward: as with crazyswarm2, the on-board controller adds gravity and differentiates the curve
itself; the cable's pull is not in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, Violation
from hitchopt.exports.formats import memory_budget
from hitchopt.exports.formats.compressed_bytes import (
    DEGREE,
    END,
    HEADER_BYTES,
    LONGEST,
    MILLI,
    START_BYTES,
    decoded,
    encoded,
)
from hitchopt.exports.formats.format import Arrangement, Candidate, Task
from hitchopt.exports.recording import Recording, lasted, recording_of_curves
from hitchopt.exports.refit.breaks import greedy_breaks, span_error
from hitchopt.exports.refit.joint_rounding import rounded
from hitchopt.exports.refit.lattice_rounding import Keeping, settled, settling_times
from hitchopt.exports.refit.pieces import Kind, Scale, fitted
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.storage.atomic import Writer
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

KIND = Kind(degree=DEGREE, match=3, quantum=MILLI, longest=LONGEST)

SMOOTH = 1
"""After rounding, acceleration jumps; so does velocity, by a few mm/s, which the errors tell."""

BOUNDS = (1.0, 1.4, 0.8, 2.0, 0.6, 1.2, 0.9, 1.6, 0.4, 0.2)
"""Of the refit over Scale, the best first: long pieces fit worse and suffer less from rounding."""

ACCURACY = 2e-3
"""[m]"""

SCALE = Scale(position=5e-4, velocity=1e-2, acceleration=0.2)
"""Of rounding."""

SUFFIX = ".bin"


class CompressedBytes:
    """One file of bytes per drone."""

    name = "compressed"
    summary = "compressed trajectories for Crazyflies, as bytes"
    frames = ("enu", "nwu")
    rate = 0.0
    accuracy = ACCURACY
    feed_forward = (
        "not in these files: the on-board controller differentiates the curve and adds gravity, "
        "but not the cable's pull; its integral has to find it, or stream full states (ros2bag)"
    )

    def arrangements(self, task: Task) -> Iterator[Arrangement]:
        """Give the plan whole if memory holds it, then cut at rests."""
        yield from memory_budget.arrangements(task, _fits, _needed)

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give refits of different lengths of pieces, those that memory holds."""
        for bound in BOUNDS:
            files = compressed(task, bound)
            most = max(len(data) for data in files.values())
            if most > memory_budget.BYTES:
                continue
            writers: dict[str, Writer] = {
                file_name(name, task.room.frame): _writer(data) for name, data in files.items()
            }
            note = (
                f"up to {most} of {memory_budget.BYTES} bytes of each drone's memory; velocity "
                "jumps where segments join by no more than twice the velocity error above"
            )
            yield Candidate(writers, (note,))

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves of the drones' bytes."""
        frame = task.room.frame
        curves = [read_compressed(folder / file_name(name, frame)) for name in task.names]
        return recording_of_curves(task.names, curves, frame, SMOOTH)


def file_name(drone: str, frame: str) -> str:
    """Return the name of a drone's file, which tells the frame as the bytes cannot."""
    return f"{drone}_{frame}{SUFFIX}"


def compressed(task: Task, bound: float = BOUNDS[0]) -> dict[str, bytes]:
    """Return the bytes of every drone, by name.

    Parameters
    ----------
    task: the plan.
    bound: of the refit's error before rounding, over Scale.

    Raises
    ------
    InfeasibleError: the plan is beyond ±32.767 m.
    """
    curves = task.motion.drones
    many = ceil(curves.duration / KIND.quantum) + 1
    error = span_error(curves, KIND)
    breaks = greedy_breaks(error, float(curves.breaks[-1]), KIND, bound, many)
    if breaks is None:  # every piece may be one quantum
        raise FileError("compressed: a plan of no duration has no pieces")
    fit = fitted(lasted(curves, float(breaks[-1])), breaks, KIND)
    placed = task.room.placed(fit)
    whole = settled(
        rounded(placed, MILLI, SCALE), placed, MILLI, keeping_of(task, breaks, ACCURACY)
    )
    durations = np.rint(np.diff(breaks) / MILLI).astype(np.int64)
    points = np.rint(whole.coefficients / MILLI).astype(np.int64)
    heading = task.room.heading
    return {n: encoded(durations, points[:, i], heading) for i, n in enumerate(task.names)}


def keeping_of(task: Task, breaks: Array, accuracy: float) -> Keeping:
    """Return the limits that rounding may break: speed and thrust, in the file's axes."""
    motion = task.motion
    t = np.minimum(settling_times(breaks), float(motion.drones.breaks[-1]))
    mass = motion.team.mass
    weight = mass[:, None] * np.array([0.0, 0.0, GRAVITY])
    load = task.room.vectors(weight - states_at(motion, t).cable_forces)
    return Keeping(motion.requirements.limits.speed, mass, motion.team.max_thrust, load, accuracy)


def read_compressed(path: Path) -> PiecewisePolynomial:
    """Return the positions (3,) [m] of a file of bytes.

    Raises
    ------
    FileError: it cannot be read, is damaged, or does not end.
    """
    found = decoded(read_bytes(path), str(path))
    if not found.ended:
        raise FileError(f"{path}: no segment of no duration ends it; it is truncated")
    return found.curve


def read_bytes(path: Path) -> bytes:
    """Return what is in a file of no more than sixteen memories.

    Raises
    ------
    FileError: it cannot be read, or is larger.
    """
    try:
        if path.stat().st_size > 16 * memory_budget.BYTES:
            raise FileError(
                f"{path}: is far larger than a drone's memory of {memory_budget.BYTES} bytes"
            )
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from error


def _writer(data: bytes) -> Writer:
    return lambda path: _write(path, data)


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _most(curves: PiecewisePolynomial) -> int:
    """Return how many segments memory holds, given how many axes move at all."""
    moving = np.ptp(curves.coefficients, axis=(0, 3)) > 0.0
    axes = int(np.max(np.sum(moving, axis=-1)))
    room = memory_budget.BYTES - START_BYTES - len(END)
    return room // (HEADER_BYTES + 2 * DEGREE * max(1, axes))


def _fits(motion: Motion, share: float) -> bool:
    return _segments(motion, _most(motion.drones), share * BOUNDS[0]) is not None


def _needed(motion: Motion) -> Violation:
    many = ceil(motion.duration / KIND.quantum) + 1
    breaks = _segments(motion, many, BOUNDS[0])
    return Violation(
        "memory",
        float(many if breaks is None else len(breaks) - 1),
        float(_most(motion.drones)),
        "max",
        "segments",
        (),
        f"to stay near a plan of {motion.duration:.4g} s without a rest",
        "let the plan rest now and then",
    )


def _segments(motion: Motion, most: int, bound: float) -> Array | None:
    error = span_error(motion.drones, KIND)
    return greedy_breaks(error, float(motion.drones.breaks[-1]), KIND, bound, most)
