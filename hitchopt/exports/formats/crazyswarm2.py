"""Format crazyswarm2: polynomials of degree 7 to upload, settings of the fleet, and how to start.

Feed-forward: the drone's own controller (Mellinger's) takes acceleration from the polynomial and
adds gravity; the polynomial's acceleration is that of its curve, so the cable's pull ``F`` (a
static tilt of ``atan(T / (m g))``) cannot be in it and is left to the controller's integral. Stream
full-state setpoints (ros2bag, csv) where ``a_ff = a - F / m`` is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.errors import Violation
from hitchopt.exports.formats import memory_budget
from hitchopt.exports.formats.crazyswarm2_start import fly_script, note_text, settings_text
from hitchopt.exports.formats.format import Arrangement, Candidate, Task
from hitchopt.exports.formats.poly_csv import PIECE_BYTES, read_poly_csv, to_powers, write_poly_csv
from hitchopt.exports.recording import Recording, lasted, recording_of_curves
from hitchopt.exports.refit.breaks import best_breaks, greedy_breaks, span_error
from hitchopt.exports.refit.pieces import Kind, Scale, fitted
from hitchopt.motion.motion import Motion
from hitchopt.storage.atomic import Writer
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

MOST = memory_budget.BYTES // PIECE_BYTES
"""Pieces that a drone's memory holds: 31."""

LEAST = 2
"""Rows: the usual reader fails on one."""

KIND = Kind(degree=7, match=3, quantum=1.0 / 1024.0, longest=60.0)
"""Durations are exact in single precision; position, velocity and acceleration are continuous."""

SMOOTH = 2

STACKED = 1.0 - 1e-4
"""Of an ellipsoid's width: drones less apart, seen from above, stand in each other's way."""

COARSEST = 1.0
"""Of Scale: a millimetre at most."""


class Crazyswarm2:
    """One CSV per drone, crazyflies.yaml, fly.py and a note."""

    name = "crazyswarm2"
    summary = "polynomials for Crazyflies, to upload with crazyswarm2"
    frames = ("enu", "nwu")
    rate = 0.0
    accuracy = 1e-3
    feed_forward = (
        "not in these files: a polynomial's acceleration is its curve's own, and the on-board "
        "controller adds gravity but not the cable's pull; its integral has to find it, or stream "
        "full states (ros2bag)"
    )

    def arrangements(self, task: Task) -> Iterator[Arrangement]:
        """Give the plan whole if 31 pieces hold it to a millimetre, then cut at rests."""
        yield from memory_budget.arrangements(task, _fits, _needed)

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the best fit of at most 31 pieces."""
        breaks = best_breaks(task.motion.drones, KIND, MOST)
        if breaks is None:
            return
        if len(breaks) <= LEAST:
            breaks = np.array([0.0, KIND.quantum * (breaks[-1] // (2 * KIND.quantum)), breaks[-1]])
        curves = task.room.placed(
            fitted(lasted(task.motion.drones, float(breaks[-1])), breaks, KIND)
        )
        powers = np.zeros((curves.pieces, len(task.names), 4, KIND.degree + 1))
        powers[:, :, :3] = to_powers(curves.coefficients, curves.durations)
        powers[:, :, 3, 0] = task.room.heading
        starts, ends = curves.ends()
        first, last = starts[0], ends[-1]
        writers: dict[str, Writer] = {
            f"{name}.csv": _writer(curves.durations, powers[:, i], task.room.frame)
            for i, name in enumerate(task.names)
        }
        writers["crazyflies.yaml"] = lambda path: _write(path, settings_text(task, first))
        script = fly_script(task, first, last, curves.duration)
        writers["fly.py"] = lambda path: _write(path, script)
        writers["README.txt"] = lambda path: _write(path, note_text(task, curves.duration))
        used = curves.pieces * PIECE_BYTES
        note = (
            f"{curves.pieces} pieces, {used} of {memory_budget.BYTES} bytes of each drone's memory"
        )
        yield Candidate(writers, (note, *_stacked(task, curves)))

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves of the drones' files."""
        tables = [read_poly_csv(folder / f"{name}.csv") for name in task.names]
        curves = [table.curve for table in tables]
        return recording_of_curves(task.names, curves, tables[0].frame, SMOOTH)


def _stacked(task: Task, curves: PiecewisePolynomial) -> tuple[str, ...]:
    """Return a warning where drones start, or land, below one another: fly.py goes straight up."""
    found = []
    for points, what in zip(curves.ends(), ("take off from", "land on"), strict=True):
        across = points[0 if what == "take off from" else -1][:, :2]
        pairs = cKDTree(across).query_pairs(
            STACKED * 2.0 * task.motion.requirements.separation.radius
        )
        if pairs:
            i, j = min(pairs)
            found.append(
                f"{task.names[i]} and {task.names[j]}"
                + (f" and {len(pairs) - 1} pairs more" if len(pairs) > 1 else "")
                + f" would {what} one place, as one is above the other: fly.py and crazyflies.yaml "
                "will not do, bring them there one by one"
            )
    return tuple(found)


def _writer(durations: Array, powers: Array, frame: str) -> Writer:
    return lambda path: write_poly_csv(path, durations, powers, frame)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def _fits(motion: Motion, share: float) -> bool:
    return _coarse_breaks(motion.drones, MOST, share * COARSEST) is not None


def _needed(motion: Motion) -> Violation:
    many = 100 * (MOST + ceil(motion.duration / 0.01))
    breaks = _coarse_breaks(motion.drones, many, COARSEST)
    pieces = float(many if breaks is None else len(breaks) - 1)
    return Violation(
        "memory",
        pieces,
        float(MOST),
        "max",
        "pieces",
        (),
        f"to stay within {1e3 * COARSEST * Scale().position:g} mm of a plan of "
        f"{motion.duration:.4g} s without a rest",
        "--format compressed holds about three times as much; let the plan rest now and then",
    )


def _coarse_breaks(curves: PiecewisePolynomial, most: int, bound: float) -> Array | None:
    return greedy_breaks(span_error(curves, KIND), float(curves.breaks[-1]), KIND, bound, most)
