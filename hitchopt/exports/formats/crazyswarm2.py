"""Format crazyswarm2: polynomials of degree 7 to upload, settings of the fleet, and how to start.

Feed-forward: the drone's own controller (Mellinger's) takes acceleration from the polynomial and
adds gravity; the polynomial's acceleration is that of its curve, so the cable's pull ``F`` (a
static tilt of ``atan(T / (m g))``) cannot be in it. The controller's integral does not find it: it
brings the drone to its place, where any tension may be. Stream full-state setpoints (ros2bag, csv)
with ``a_ff = a - F / m``, or turn the integral off and export with ``--hold-tension``.

A trajectory is a CSV file, a header, then 33 numbers per piece:
``duration,x^0..x^7,y^0..y^7,z^0..z^7,yaw^0..yaw^7``: ascending powers of the piece's own time in
seconds; m and rad. The drone holds them in single precision, so the numbers are rounded to that
before they are written, and what is read back is what is flown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import comb

from hitchopt.errors import FileError
from hitchopt.exports.formats.crazyflie_memory import BYTES, CrazyflieFormat
from hitchopt.exports.formats.crazyswarm2_start import fly_script, note_text, settings_text
from hitchopt.exports.formats.file_reading import read_text
from hitchopt.exports.formats.format import Candidate, Task, writer_of
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.exports.refit.piece_fitting import Kind, Scale, best_breaks, fitted
from hitchopt.storage.atomic import Writer
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

DEGREE = 7
"""Degree of every piece."""

COLUMNS = 33
"""Numbers of a row."""

PIECE_BYTES = 4 * COLUMNS
"""Size of a piece in the drone's memory [B]."""

HEADER = ",".join(
    ["duration", *(f"{axis}^{i}" for axis in ("x", "y", "z", "yaw") for i in range(DEGREE + 1))]
)

MAX_ROWS = 100_000
"""Rows of a file that is read."""

NOTHING = 1e-10
"""Powers that never add more than this are left out [m]."""


LEAST = 2
"""Rows of a file at least: the usual reader fails on one."""

KIND = Kind(degree=DEGREE, match=3, quantum=1.0 / 1024.0, longest=60.0, shortest=8.0 / 1024.0)
"""Durations are exact in single precision; position, velocity and acceleration are continuous. A
piece of a millisecond would have coefficients of 1e12, and their rounding jolts."""

MOST = BYTES // PIECE_BYTES
"""Pieces that a drone's memory holds: 31."""

COARSEST = 1.0
"""Largest error of a refit over Scale: a millimetre."""

SMOOTH = 2
"""Acceleration is continuous."""

STACKED = 1.0 - 1e-4
"""Share of an ellipsoid's width: drones closer than it, seen from above, block each other."""


@dataclass(frozen=True, eq=False)
class PolyTable:
    """Pieces of one drone as they stand in a file.

    Attributes
    ----------
    durations: (rows,) [s]
    powers: (rows, 4, 8) of x, y, z [m] and yaw [rad], ascending.
    frame: frame that the header names; empty where it names none.
    """

    durations: Array
    powers: Array
    frame: str = ""

    @property
    def curve(self) -> PiecewisePolynomial:
        """Positions (3,) [m] over time."""
        breaks = np.concatenate([[0.0], np.cumsum(self.durations)])
        return PiecewisePolynomial(breaks, from_powers(self.powers[:, :3], self.durations))


def to_powers(coefficients: Array, durations: Array) -> Array:
    """Return ascending powers of seconds (pieces, …, N + 1) of Bernstein coefficients."""
    inverse: Array = np.rint(np.linalg.inv(_powers(bernstein.degree(coefficients))))
    local = coefficients @ inverse.T
    local[np.abs(local) < NOTHING] = 0.0  # differences that are rounding alone
    return local / _scales(durations, local)


def from_powers(powers: Array, durations: Array) -> Array:
    """Return Bernstein coefficients (pieces, …, N + 1) of ascending powers of seconds."""
    local = powers * _scales(durations, powers)
    return local @ _powers(bernstein.degree(powers)).T


@lru_cache
def _powers(degree: int) -> Array:
    """Return the Bernstein coefficients of the local parameter's powers, one column each."""
    i = np.arange(degree + 1)
    return np.asarray(comb(i[:, None], i) / comb(degree, i), dtype=np.float64)


def _scales(durations: Array, powers: Array) -> Array:
    return durations.reshape(-1, *(1,) * (powers.ndim - 1)) ** np.arange(powers.shape[-1])


def write_poly_csv(path: Path, durations: Array, powers: Array, frame: str) -> None:
    """Write one drone's pieces, (rows,) and (rows, 4, 8); the header's last label names the frame.

    Raises
    ------
    OSError: the file cannot be written.
    """
    rows = np.column_stack([durations, powers.reshape(len(durations), -1)])
    single = rows.astype(np.float32).astype(np.float64) + 0.0  # no negative zeros
    header = f"{HEADER}  # frame: {frame}"
    np.savetxt(path, single, "%.9g", ",", header=header, comments="", encoding="ascii")


def read_poly_csv(path: Path) -> PolyTable:
    """Return the pieces of one drone, in single precision as it holds them.

    Raises
    ------
    FileError: no such file, a row without 33 finite numbers, a duration that is not positive.
    """
    lines = read_text(path).splitlines() or [""]
    header, _, note = lines[0].partition("#")
    texts = [line.partition("#")[0].strip().rstrip(",") for line in lines]
    rows = [_row(path, i + 1, text) for i, text in enumerate(texts) if i > 0 and text]
    if not rows:
        raise FileError(
            f"{path}: has no row of numbers after its first line ({header[:40]!r}); it is truncated"
        )
    if len(rows) > MAX_ROWS:
        raise FileError(f"{path}: has more than {MAX_ROWS} rows")
    with np.errstate(over="ignore"):  # reported below
        table = np.array(rows, dtype=np.float64).astype(np.float32).astype(np.float64)
    if not np.all(np.isfinite(table)):
        raise FileError(f"{path}: a number is beyond single precision, which is what drones hold")
    if np.any(wrong := table[:, 0] <= 0.0):
        row = int(np.argmax(wrong))
        raise FileError(f"{path}: row {row + 1}: its duration is {table[row, 0]:g} s")
    frame = note.partition("frame:")[2].strip()
    return PolyTable(table[:, 0], table[:, 1:].reshape(-1, 4, DEGREE + 1), frame)


def _row(path: Path, number: int, text: str) -> list[float]:
    parts = text.split(",")
    if len(parts) != COLUMNS:
        raise FileError(
            f"{path}: line {number} has {len(parts)} numbers, not {COLUMNS} "
            "(duration, then 8 each of x, y, z, yaw); it is truncated or another format"
        )
    try:
        return [float(part) for part in parts]
    except ValueError as error:
        raise FileError(f"{path}: line {number}: {error}") from error


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
        curves = task.frame.placed(fitted(task.motion.drones, breaks, KIND))
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
