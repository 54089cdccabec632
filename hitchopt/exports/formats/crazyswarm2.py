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

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import comb

from hitchopt.errors import FileError
from hitchopt.exports.format import Task, Written
from hitchopt.exports.formats.compressed import BYTES, STEADY, CrazyflieFormat
from hitchopt.exports.placing import AXES
from hitchopt.exports.recording import Finding, Recording, error, read_columns, read_text, warning
from hitchopt.exports.refit import Kind, best_breaks, fitted
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

DEGREE = 7  # Degree of every piece
COLUMNS = 33  # Numbers of a row
PIECE_BYTES = 4 * COLUMNS  # Size of a piece in the drone's memory [B]

HEADER = ",".join(
    ["duration", *(f"{axis}^{i}" for axis in ("x", "y", "z", "yaw") for i in range(DEGREE + 1))]
)

MAX_ROWS = 100_000  # Rows of a file that is read
NOTHING = 1e-10  # Powers that never add more than this are left out [m]
LEAST = 2  # Rows of a file at least: the usual reader fails on one

KIND = Kind(degree=DEGREE, match=3, quantum=1.0 / 1024.0, longest=60.0, shortest=8.0 / 1024.0)
"""Durations are exact in single precision; position, velocity and acceleration are continuous. A
piece of a millisecond would have coefficients of 1e12, and their rounding jolts."""

MOST = BYTES // PIECE_BYTES  # Pieces that a drone's memory holds: 31
SMOOTH = 2  # Acceleration is continuous

CLOSE = 1.0 - 1e-4
"""Share of an ellipsoid's width: drones closer than it, seen from above, block each other; below 1
by the rounding of file digits."""

SETTINGS = "crazyflies.yaml"  # Name of Crazyswarm2's settings

LANDED = 0.04  # Height at which landing cuts the motors [m], unless drones hover below it


@dataclass(frozen=True, eq=False)
class PolyTable:
    """Pieces of one drone as they stand in a file."""

    durations: Array  # (rows,) [s]
    powers: Array  # (rows, 4, 8) of x, y, z [m] and yaw [rad], ascending powers of seconds
    frame: str = ""  # that the header names; empty where it names none
    headed: bool = True  # whether the first line is words

    @property
    def curve(self) -> PiecewisePolynomial:
        """Positions (3,) [m] over time."""
        breaks = np.concatenate([[0.0], np.cumsum(self.durations)])
        local = self.powers[:, :3] * _scales(self.durations)
        return PiecewisePolynomial(breaks, local @ _bernstein_of_powers().T)


@lru_cache
def _bernstein_of_powers() -> Array:
    """Return the Bernstein coefficients of the local parameter's powers, one column each."""
    i = np.arange(DEGREE + 1)
    return np.asarray(comb(i[:, None], i) / comb(DEGREE, i), dtype=np.float64)


def _scales(durations: Array) -> Array:
    """Return the powers of the durations (pieces, 1, 8)."""
    return durations[:, None, None] ** np.arange(DEGREE + 1)


def to_powers(curves: PiecewisePolynomial) -> Array:
    """Return ascending powers of seconds (pieces, D, 3, 8) of curves (D, 3) of degree 7."""
    inverse: Array = np.rint(np.linalg.inv(_bernstein_of_powers()))
    local = curves.coefficients @ inverse.T
    local[np.abs(local) < NOTHING] = 0.0  # differences that are rounding alone
    return local / _scales(curves.durations)[:, None]


def write_poly_csv(path: Path, durations: Array, powers: Array, frame: str) -> None:
    """Write one drone's pieces, (rows,) and (rows, 4, 8); the header names the frame."""
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
    first, *lines = [*read_text(path).splitlines(), ""]
    header, _, comment = first.partition("#")
    if len(lines) > MAX_ROWS:
        raise FileError(f"{path}: has more than {MAX_ROWS} rows")
    rows = [line.partition("#")[0].strip().rstrip(",") for line in lines]
    table = read_columns(rows, HEADER, HEADER.split(","), str(path), least=1)
    with np.errstate(over="ignore"):  # reported below
        table = table.astype(np.float32).astype(np.float64)
    if not np.all(np.isfinite(table)):
        raise FileError(f"{path}: a number is beyond single precision, which is what drones hold")
    if np.any(wrong := table[:, 0] <= 0.0):
        row = int(np.argmax(wrong))
        raise FileError(f"{path}: row {row + 1}: its duration is {table[row, 0]:g} s")
    try:
        float(header.partition(",")[0])
        headed = False  # the first line is a piece, which readers skip
    except ValueError:
        headed = True
    frame = comment.partition("frame:")[2].strip()
    return PolyTable(table[:, 0], table[:, 1:].reshape(-1, 4, DEGREE + 1), frame, headed)


class Crazyswarm2(CrazyflieFormat):
    """One CSV per drone, crazyflies.yaml, fly.py and a note."""

    name = "crazyswarm2"
    file = "{name}.csv"
    endings = several = (".csv",)
    kind = KIND
    accuracy = 1e-3

    def most_pieces(self, curves: PiecewisePolynomial) -> int:  # noqa: ARG002
        """Return 31."""
        return MOST

    def write(self, folder: Path, task: Task) -> Written:
        """Write the best fit of at most 31 pieces, within a millimetre."""
        breaks = best_breaks(task.motion.drones, KIND, MOST)
        if len(breaks) - 1 > MOST:
            raise self.refusal(task.motion)
        if len(breaks) <= LEAST:
            breaks = np.array([0.0, KIND.quantum * (breaks[-1] // (2 * KIND.quantum)), breaks[-1]])
        curves = task.frame.placed(fitted(task.motion.drones, breaks, KIND))
        powers = np.zeros((curves.pieces, len(task.names), 4, KIND.degree + 1))
        powers[:, :, :3] = to_powers(curves)
        powers[:, :, 3, 0] = task.frame.heading
        first, last = curves.coefficients[0, ..., 0], curves.coefficients[-1, ..., -1]
        for i, file in enumerate(files := self.files(task)):
            write_poly_csv(folder / file, curves.durations, powers[:, i], task.frame.name)
        texts = start_files(task, first, last, curves.duration)
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        used = curves.pieces * PIECE_BYTES
        words = f"{curves.pieces} pieces, {used} of {BYTES} bytes of each drone's memory"
        warnings = (*_stacked(task, first, "take off from"), *_stacked(task, last, "land on"))
        return Written((*files, *texts), (words, *warnings))

    def recognises(self, labels: Sequence[str]) -> bool:
        """Return whether it begins with ``duration``, or has 33 columns of whatever."""
        return labels[0] == "duration" or len(labels) == COLUMNS

    def load(self, files: Sequence[Path]) -> Recording:
        """Return what CSV files of polynomial pieces hold, one drone each."""
        names, tables = [path.stem for path in files], [read_poly_csv(path) for path in files]
        faults = [f for name, each in zip(names, tables, strict=True) for f in _faults(name, each)]
        frames = {table.frame for table in tables} - {""}
        if len(frames) > 1:
            faults.append(error("frame", "", f"files are in {' and '.join(sorted(frames))}"))
        frame = next(iter(frames)) if len(frames) == 1 and frames <= set(AXES) else ""
        curves = [table.curve for table in tables]
        sizes = [curve.pieces * PIECE_BYTES for curve in curves]
        return self.recording(names, curves, frame, SMOOTH, sizes, faults)


def start_files(task: Task, first: Array, last: Array, duration: float) -> dict[str, str]:
    """Return crazyflies.yaml (fileversion 3), fly.py and README.txt by their names.

    Parameters
    ----------
    task: the plan, or a part of it.
    first, last: (D, 3) [m], where the trajectories begin, with drones on the floor below, and end.
    duration: of the trajectories [s].
    """
    fleet, frame, texts = task.fleet, task.frame.name, json.loads(_template("crazyswarm2.json"))
    robots = [
        # ROS refuses lists that mix integers and floats, so every number has a point.
        f"  {member.name}: {{enabled: true, uri: {json.dumps(member.uri)}, "
        f"initial_position: [{x:.6f}, {y:.6f}, 0.0], type: {json.dumps(member.type)}, "
        f"role: {member.role}}}"
        for member, (x, y, _) in zip(fleet.members, first.tolist(), strict=True)
    ]
    types = [
        f"  {json.dumps(name)}: {json.dumps(fleet.types.get(name, texts['type']))}"
        for name in dict.fromkeys(member.type for member in fleet.members)
    ]
    places = {n: [round(x, 6) for x in p] for n, p in zip(task.names, first.tolist(), strict=True)}
    place = f"This is {task.part}.\n" if task.part else ""
    hint = " (its radio addresses are placeholders: name yours with --fleet when exporting)"
    common = {"frame": frame, "duration": duration}
    return {
        SETTINGS: _template("crazyflies.txt").format(
            robots="\n".join(robots),
            types="\n".join(types),
            all=json.dumps(fleet.settings or texts["all"]),
            **common,
        ),
        "fly.py": _template("fly_script.txt").format(
            title=task.title.replace("\\", " ").replace('"', "'") or "a plan of hitchopt",
            place=place,
            heading=task.frame.heading,
            first=json.dumps(places, indent=4),
            height=round(float(np.min(first[:, 2])), 3),
            land=min(LANDED, round(float(np.min(last[:, 2])), 3) + 0.0),
            **common,
        ),
        "README.txt": _template("start_note.txt").format(
            title=task.title or "A plan of hitchopt",
            place=f"\n{place}{texts['parts']}\n" if place else "",
            placeholders="" if fleet.given else hint,
            pull=texts["held_pull" if task.options.hold_tension else "pull"],
            **common,
        ),
    }


def _template(name: str) -> str:
    """Return the text of a file beside this module, with fields in braces."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _stacked(task: Task, places: Array, what: str) -> Iterator[str]:
    """Give a warning where drones start, or land, below one another: fly.py goes straight up."""
    width = 2.0 * task.motion.requirements.separation.radius
    pairs = cKDTree(places[:, :2]).query_pairs(CLOSE * width)
    if pairs:
        i, j = min(pairs)
        more = f" and {len(pairs) - 1} pairs more" if len(pairs) > 1 else ""
        yield (
            f"{task.names[i]} and {task.names[j]}{more} would {what} one place, as one is above "
            "the other: fly.py and crazyflies.yaml will not do, bring them there one by one"
        )


def _faults(name: str, table: PolyTable) -> Iterator[Finding]:
    """Yield what is wrong with one drone's table of pieces."""
    if len(table.durations) < LEAST:
        yield error("one row", name, "the usual reader fails on it; split the piece")
    if not table.headed:
        words = "has none: readers skip the first line, and with it the first piece; put a line of"
        yield error("header", name, f"{words} names before it")
    powers = table.powers[:, 3]
    ends = np.sum(powers * table.durations[:, None] ** np.arange(powers.shape[1]), axis=1)
    jumps = np.abs(np.angle(np.exp(1j * (powers[1:, 0] - ends[:-1]))))  # whole turns are none
    if np.max(jumps, initial=0.0) > STEADY:
        joint = int(np.argmax(jumps))
        yield warning(
            "jump",
            name,
            f"yaw jumps by {math.degrees(jumps[joint]):.3g}° at "
            f"t = {np.sum(table.durations[: joint + 1]):.4g} s; "
            "let every piece begin with the yaw at which the one before ends",
        )
