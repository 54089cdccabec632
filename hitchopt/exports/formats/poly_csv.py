"""Polynomial trajectories of the Crazyflie as CSV: a header, then 33 numbers per piece.

``duration,x^0..x^7,y^0..y^7,z^0..z^7,yaw^0..yaw^7``: ascending powers of the piece's own time in
seconds; m and rad. The drone holds them in single precision, so the numbers are rounded to that
before they are written, and what is read back is what is flown.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

DEGREE = 7

COLUMNS = 33

PIECE_BYTES = 4 * COLUMNS
"""In the drone's memory."""

HEADER = ",".join(
    ["duration", *(f"{axis}^{i}" for axis in ("x", "y", "z", "yaw") for i in range(DEGREE + 1))]
)

MAX_ROWS = 100_000

NOTHING = 1e-10
"""[m] A power that never adds more than this is left out."""


@dataclass(frozen=True, eq=False)
class PolyTable:
    """One drone's pieces as they stand in a file.

    Attributes
    ----------
    durations: (rows,) [s]
    powers: (rows, 4, 8) of x, y, z [m] and yaw [rad], ascending.
    frame: as the header tells; empty where it does not.
    """

    durations: Array
    powers: Array
    frame: str = ""

    @property
    def curve(self) -> PiecewisePolynomial:
        """The positions (3,) [m] over time."""
        breaks = np.concatenate([[0.0], np.cumsum(self.durations)])
        return PiecewisePolynomial(breaks, from_powers(self.powers[:, :3], self.durations))


def to_powers(coefficients: Array, durations: Array) -> Array:
    """Return ascending powers of seconds (pieces, …, N + 1) of Bernstein coefficients."""
    n = bernstein.degree(coefficients)
    matrix = np.zeros((n + 1, n + 1))
    for i in range(n + 1):
        for j in range(i + 1):
            matrix[i, j] = comb(n, i) * comb(i, j) * (-1) ** (i - j)
    whole = coefficients @ matrix.T
    whole[np.abs(whole) < NOTHING] = 0.0  # differences that are rounding alone
    return whole / _scales(durations, coefficients.ndim, n)


def from_powers(powers: Array, durations: Array) -> Array:
    """Return Bernstein coefficients (pieces, …, N + 1) of ascending powers of seconds."""
    n = bernstein.degree(powers)
    matrix = np.zeros((n + 1, n + 1))
    for j in range(n + 1):
        for i in range(j + 1):
            matrix[j, i] = comb(j, i) / comb(n, i)
    coefficients: Array = (powers * _scales(durations, powers.ndim, n)) @ matrix.T
    return coefficients


def _scales(durations: Array, axes: int, degree: int) -> Array:
    scales: Array = durations.reshape(-1, *(1,) * (axes - 1)) ** np.arange(degree + 1)
    return scales


def write_poly_csv(path: Path, durations: Array, powers: Array, frame: str) -> None:
    """Write one drone's pieces, (rows,) and (rows, 4, 8); the header's last label tells the frame.

    Raises
    ------
    OSError: the file cannot be written.
    """
    rows = np.column_stack([durations, powers.reshape(len(durations), -1)])
    single = rows.astype(np.float32).astype(np.float64) + 0.0  # no negative zeros
    lines = [",".join(f"{value:.9g}" for value in row) for row in single.tolist()]
    text = "\n".join([f"{HEADER}  # frame: {frame}", *lines])
    path.write_text(text + "\n", encoding="ascii", newline="\n")


def read_poly_csv(path: Path) -> PolyTable:
    """Return the pieces of one drone, in single precision as it holds them.

    Raises
    ------
    FileError: no such file, a row without 33 finite numbers, a duration that is not positive.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read: {error}") from error
    header, _, note = (lines[0] if lines else "").partition("#")
    frame = note.partition("frame:")[2].strip()
    rows = []
    for number, line in enumerate(lines[1:], 2):
        text = line.partition("#")[0].strip().rstrip(",")
        if text:
            rows.append(_row(path, number, text))
        if len(rows) > MAX_ROWS:
            raise FileError(f"{path}: has more than {MAX_ROWS} rows")
    if not rows:
        raise FileError(
            f"{path}: has no row of numbers after its first line ({header[:40]!r}); it is truncated"
        )
    with np.errstate(over="ignore"):  # told below
        table = np.array(rows, dtype=np.float64).astype(np.float32).astype(np.float64)
    if not np.all(np.isfinite(table)):
        raise FileError(f"{path}: a number is beyond single precision, which is what drones hold")
    if not np.all(table[:, 0] > 0.0):
        wrong = int(np.flatnonzero(table[:, 0] <= 0.0)[0])
        raise FileError(f"{path}: row {wrong + 1}: its duration is {table[wrong, 0]:g} s")
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
