"""Format crazyswarm2: polynomials of degree 7 to upload, settings of the fleet, and how to start.

Feed-forward: the drone's own controller (Mellinger's) takes acceleration from the polynomial and
adds gravity; the polynomial's acceleration is that of its curve, so the cable's pull ``F`` (a
static tilt of ``atan(T / (m g))``) cannot be in it. The controller's integral does not find it: it
brings the drone to its place, where any tension may be. Stream full-state setpoints (ros2bag, csv)
with ``a_ff = a - F / m``, or turn the integral off and export with ``--hold-tension``.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.exports.formats.crazyflie_memory import BYTES, CrazyflieFormat
from hitchopt.exports.formats.crazyswarm2_start import fly_script, note_text, settings_text
from hitchopt.exports.formats.format import Candidate, Task, writer_of
from hitchopt.exports.formats.poly_csv import PIECE_BYTES, read_poly_csv, to_powers, write_poly_csv
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.exports.refit.breaks import best_breaks, refitted
from hitchopt.exports.refit.pieces import Kind, Scale
from hitchopt.storage.atomic import Writer
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LEAST = 2
"""Rows of a file at least: the usual reader fails on one."""

KIND = Kind(degree=7, match=3, quantum=1.0 / 1024.0, longest=60.0)
"""Durations are exact in single precision; position, velocity and acceleration are continuous."""

MOST = BYTES // PIECE_BYTES
"""Pieces that a drone's memory holds: 31."""

COARSEST = 1.0
"""Largest error of a refit over Scale: a millimetre."""

SMOOTH = 2
"""Acceleration is continuous."""

STACKED = 1.0 - 1e-4
"""Share of an ellipsoid's width: drones closer than it, seen from above, block each other."""


class Crazyswarm2(CrazyflieFormat):
    """One CSV per drone, crazyflies.yaml, fly.py and a note."""

    name = "crazyswarm2"
    kind = KIND
    bound = COARSEST
    unit = "pieces"
    nearness = f"within {1e3 * COARSEST * Scale().position:g} mm of"
    remedy = "--format compressed holds about three times as much; let the plan rest now and then"
    accuracy = 1e-3
    feed_forward = (
        "not in these files: a polynomial's acceleration is its curve's own, and the on-board "
        "controller adds gravity but not the cable's pull; its integral brings drones to their "
        "places and leaves the tension to the cables' lengths: stream full states (ros2bag), or "
        "turn it off and export with --hold-tension"
    )
    carries_pull = False
    receiver_integral = True

    def most_pieces(self, curves: PiecewisePolynomial) -> int:  # noqa: ARG002
        """Return 31."""
        return MOST

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the best fit of at most 31 pieces."""
        breaks = best_breaks(task.motion.drones, KIND, MOST)
        if breaks is None:
            return
        if len(breaks) <= LEAST:
            breaks = np.array([0.0, KIND.quantum * (breaks[-1] // (2 * KIND.quantum)), breaks[-1]])
        curves = task.frame.placed(refitted(task.motion.drones, breaks, KIND))
        durations = curves.durations
        powers = np.zeros((curves.pieces, len(task.names), 4, KIND.degree + 1))
        powers[:, :, :3] = to_powers(curves.coefficients, durations)
        powers[:, :, 3, 0] = task.frame.heading
        starts, ends = curves.ends()
        first, last = starts[0], ends[-1]
        write = partial(write_poly_csv, durations=durations, frame=task.frame.name)
        writers: dict[str, Writer] = {
            f"{name}.csv": partial(write, powers=powers[:, i]) for i, name in enumerate(task.names)
        }
        writers["crazyflies.yaml"] = writer_of(settings_text(task, first))
        writers["fly.py"] = writer_of(fly_script(task, first, last, curves.duration))
        writers["README.txt"] = writer_of(note_text(task, curves.duration))
        used = curves.pieces * PIECE_BYTES
        note = f"{curves.pieces} pieces, {used} of {BYTES} bytes of each drone's memory"
        warnings = (*_stacked(task, first, "take off from"), *_stacked(task, last, "land on"))
        yield Candidate(writers, (note, *warnings))

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves of the drones' files."""
        tables = [read_poly_csv(folder / f"{name}.csv") for name in task.names]
        curves = [table.curve for table in tables]
        return recording_of_curves(task.names, curves, tables[0].frame, SMOOTH)


def _stacked(task: Task, places: Array, what: str) -> Iterator[str]:
    """Give a warning where drones start, or land, below one another: fly.py goes straight up."""
    width = 2.0 * task.motion.requirements.separation.radius
    pairs = cKDTree(places[:, :2]).query_pairs(STACKED * width)
    if pairs:
        i, j = min(pairs)
        more = f" and {len(pairs) - 1} pairs more" if len(pairs) > 1 else ""
        yield (
            f"{task.names[i]} and {task.names[j]}{more} would {what} one place, as one is above "
            "the other: fly.py and crazyflies.yaml will not do, bring them there one by one"
        )
