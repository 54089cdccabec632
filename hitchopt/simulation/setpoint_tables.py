"""A plan's tables, read back: all that a simulated flight knows of its plan but the team."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.export.setpoints import HEADER as SETPOINTS_HEADER
from hitchopt.export.vertices import HEADER as VERTICES_HEADER
from hitchopt.hitch import Team

Array = NDArray[np.float64]

EARLY = 1e-6
"""[s] Rounding of times that are the same."""


@dataclass(frozen=True, eq=False)
class Setpoints:
    """What the drones q0, r0, q1, … are told, sample by sample.

    Attributes
    ----------
    t: (samples,) [s], ascending.
    positions, velocities, accelerations, jerks: (samples, 2n, 3) [m], [m/s], [m/s²], [m/s³]
    yaw: (samples, 2n) [rad]
    cable_forces: (samples, 2n, 3) [N], what the plan expects of the cables.
    """

    t: Array
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    yaw: Array
    cable_forces: Array

    @property
    def duration(self) -> float:
        """[s] From the first setpoint to the last."""
        return float(self.t[-1] - self.t[0])

    def index(self, elapsed: float) -> int:
        """Return the setpoint that holds ``elapsed`` [s] after the first one."""
        found = int(np.searchsorted(self.t, self.t[0] + elapsed + EARLY, side="right")) - 1
        return min(max(found, 0), len(self.t) - 1)


@dataclass(frozen=True, eq=False)
class VertexTable:
    """Where the plan has the hitch's vertices, while there is a hitch.

    Attributes
    ----------
    t: (samples,) [s], those of the setpoints at which the hitch exists.
    positions: (samples, points, 3) [m]
    tensions: (samples, n) [N]
    """

    t: Array
    positions: Array
    tensions: Array

    def index(self, t: float) -> int | None:
        """Return the sample at time t [s], or None where there is no hitch then."""
        if not len(self.t):
            return None
        found = int(np.argmin(np.abs(self.t - t)))
        return found if abs(self.t[found] - t) <= SAME_SAMPLE else None


SAME_SAMPLE = 1e-5
"""[s] Times of the same sample of both tables."""


def read_setpoints(path: Path, team: Team) -> Setpoints:
    """Return the table of a ``setpoints.csv``.

    Raises
    ------
    FileError: it cannot be read, or is not one of this team.
    """
    columns = [0, *range(2, 18)]
    values = _numbers(path, SETPOINTS_HEADER, columns)
    names = team.drone_names
    if len(values) == 0 or len(values) % len(names):
        raise FileError(f"{path}: {len(values)} rows for {len(names)} drones; solve again")
    _check_names(path, 1, names)
    table = values.reshape(-1, len(names), len(columns))
    t = table[:, 0, 0]
    if np.any(table[:, :, 0] != t[:, None]) or np.any(np.diff(t) <= 0.0):
        raise FileError(f"{path}: its rows are not by time, then drone; solve again")
    return Setpoints(
        t,
        table[:, :, 1:4],
        table[:, :, 4:7],
        table[:, :, 7:10],
        table[:, :, 10:13],
        table[:, :, 13],
        table[:, :, 14:17],
    )


def read_vertices(path: Path, team: Team) -> VertexTable:
    """Return the table of a ``vertices.csv``; it may have no rows.

    Raises
    ------
    FileError: it cannot be read, or is not one of this team.
    """
    points, n = team.layout.points, team.robots
    values = _numbers(path, VERTICES_HEADER, [0, 2, 3, 4, 5])
    if len(values):
        _check_names(path, 1, tuple(str(k) for k in range(points)))
    if len(values) % points:
        raise FileError(f"{path}: {len(values)} rows for {points} vertices; solve again")
    table = values.reshape(-1, points, 5)
    return VertexTable(table[:, 0, 0], table[:, :, 1:4], table[:, :n, 4])


def _numbers(path: Path, header: str, columns: list[int]) -> Array:
    """Return (rows, columns) of a table with this header; an empty field is nan."""
    try:
        with path.open(encoding="utf-8") as file:
            found = file.readline().rstrip("\r\n")
            if found != header:
                raise FileError(f"{path}: begins with {found[:60]!r}, not {header!r}; solve again")
            first = file.readline()
            if not first.strip():
                return np.empty((0, len(columns)))
        values: Array = np.loadtxt(
            path,
            delimiter=",",
            skiprows=1,
            usecols=columns,
            ndmin=2,
            converters=_number,
            encoding="utf-8",
        )
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file; solve the problem first") from None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: not a table of numbers: {error}; solve again") from error
    if not np.all(np.isfinite(values[:, :4])):
        raise FileError(f"{path}: holds numbers that are not finite; solve again")
    return values


def _number(text: str) -> float:
    return float(text) if text else np.nan


def _check_names(path: Path, column: int, names: tuple[str, ...]) -> None:
    """Raise FileError unless the column repeats the names over and over."""
    found = np.loadtxt(
        path, delimiter=",", skiprows=1, usecols=column, dtype=str, ndmin=1, encoding="utf-8"
    )
    wanted = np.resize(np.array(names), found.shape)
    wrong = np.flatnonzero(found != wanted)
    if wrong.size:
        raise FileError(
            f"{path}: row {wrong[0] + 1} is of '{found[wrong[0]]}' where '{wanted[wrong[0]]}' is "
            "due; plan and tables are not of one solve: solve again"
        )
