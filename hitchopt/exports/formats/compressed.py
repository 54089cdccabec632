"""Format compressed: the bytes that a Crazyflie takes, one file per drone.

Control points are whole millimetres, rounded together so that velocity suffers little, and yaw is
constant: firmware up to 2026.04 flies changing yaw wrongly.

Feed-forward: as with crazyswarm2, the on-board controller adds gravity and differentiates the curve
itself; the cable's pull is not in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.compressed_bytes import KIND, MILLI, decoded, encoded, most_segments
from hitchopt.exports.formats.crazyflie_memory import BYTES, CrazyflieFormat
from hitchopt.exports.formats.format import Candidate, Task, writer_of
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.exports.refit.piece_fitting import Scale, breaks_within, fitted
from hitchopt.exports.refit.point_rounding import Keeping, rounded, settled, settling_times
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import states_at
from hitchopt.storage.atomic import Writer
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SMOOTH = 1
"""Acceleration jumps after rounding; so does velocity, by a few mm/s: see the velocity error."""

UNLIMITED = 1e6
"""[m/s], [N] Speed and thrust beyond all that is flown."""

BOUNDS = (1.0, 1.4, 0.8, 2.0, 0.6, 1.2, 0.9, 1.6, 0.4, 0.2)
"""Errors of the refit over Scale, the best first: long pieces fit worse and suffer less from
rounding."""

SCALE = Scale(position=5e-4, velocity=1e-2, acceleration=0.2)
"""Errors of rounding that weigh alike."""

SUFFIX = ".bin"


class CompressedBytes(CrazyflieFormat):
    """One file of bytes per drone."""

    name = "compressed"
    kind = KIND
    bound = BOUNDS[0]
    unit = "segments"
    nearness = "near"
    remedy = "let the plan rest now and then"
    accuracy = 2e-3
    feed_forward = (
        "not in these files: the on-board controller differentiates the curve and adds gravity, "
        "but not the cable's pull; its integral brings drones to their places and leaves the "
        "tension to the cables' lengths: stream full states (ros2bag), or turn it off and export "
        "with --hold-tension"
    )
    carries_pull = False
    receiver_integral = True

    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many segments memory holds: they are longer the more axes move."""
        moving = np.ptp(curves.coefficients, axis=(0, 3)) > 0.0
        return most_segments(BYTES, int(np.max(np.sum(moving, axis=-1))))

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give refits of different lengths of pieces, those that memory holds."""
        for bound in BOUNDS:
            files = compressed(task, bound, self.accuracy)
            most = max(len(data) for data in files.values())
            if most > BYTES:
                continue
            writers: dict[str, Writer] = {
                file_name(name, task.frame.name): writer_of(data) for name, data in files.items()
            }
            note = (
                f"up to {most} of {BYTES} bytes of each drone's memory; velocity jumps "
                "where segments join by no more than twice the velocity error above"
            )
            yield Candidate(writers, (note,))

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves of the drones' bytes."""
        frame = task.frame.name
        curves = [read_compressed(folder / file_name(name, frame)) for name in task.names]
        return recording_of_curves(task.names, curves, frame, SMOOTH)


def file_name(drone: str, frame: str) -> str:
    """Return the name of a drone's file, which names the frame as the bytes cannot."""
    return f"{drone}_{frame}{SUFFIX}"


def compressed(task: Task, bound: float, accuracy: float) -> dict[str, bytes]:
    """Return the bytes of every drone, by name.

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
    whole = settled(rounding, placed, MILLI, keeping_of(task, breaks, accuracy))
    durations = np.rint(np.diff(breaks) / MILLI).astype(np.int64)
    points = np.rint(whole.coefficients / MILLI).astype(np.int64)
    heading = task.frame.heading
    return {n: encoded(durations, points[:, i], heading) for i, n in enumerate(task.names)}


def keeping_of(task: Task, breaks: Array, accuracy: float) -> Keeping:
    """Return the limits that rounding may break: speed and thrust, in the file's axes.

    Set points that hold the tension have none: they are not where the drones are.
    """
    motion = task.motion
    t = np.minimum(settling_times(breaks), float(motion.drones.breaks[-1]))
    mass = motion.team.mass
    weight = mass[:, None] * np.array([0.0, 0.0, GRAVITY])
    load = task.frame.vectors(weight - states_at(motion, t).cable_forces)
    speed, thrust = motion.requirements.limits.speed, motion.team.max_thrust
    if task.options.hold_tension:
        speed, thrust = UNLIMITED, np.full(len(mass), UNLIMITED)
    return Keeping(speed, mass, thrust, load, accuracy)


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
        if path.stat().st_size > 16 * BYTES:
            raise FileError(f"{path}: is far larger than a drone's memory of {BYTES} bytes")
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from error
