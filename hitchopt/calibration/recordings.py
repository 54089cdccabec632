"""Recorded flights: positions of drones and vertices over time, from a table or a simulation."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.hitch import Team
from hitchopt.one_line import OneLine
from hitchopt.simulation.flight_records import Flight
from hitchopt.storage.strict_json import parsed_json
from hitchopt.values import Array

HEADER = "t,name,x,y,z"
"""Columns of a recording, in any order and among others: time from the plan's start [s], a drone
(q0, r0, …) or a vertex (p0, …), and its position [m]."""

MAX_BYTES = 400_000_000
"""Larger tables are refused before they are read."""

DRONES, VERTICES, SUMMARY = "drones.csv", "vertices.csv", "simulation.json"
"""Files of a simulated flight; for ``name`` its tables have ``drone`` and ``vertex``."""


@dataclass(frozen=True, eq=False)
class Recording(OneLine):
    """Measured positions over time.

    Attributes
    ----------
    t: (samples,) [s], ascending, from the plan's start.
    drones: (samples, 2n, 3) [m], in the order q0, r0, q1, …; nan where not seen.
    vertices: (samples, points, 3) [m]; nan where not seen. A chain's ends are its drones.
    density: of the cables [kg/m], where it is known from a simulation.
    feed_forward, integral: whether drones' controllers had these (2n,), where it is known likewise.
    """

    t: Array
    drones: Array
    vertices: Array
    density: float | None = None
    feed_forward: NDArray[np.bool_] | None = None
    integral: NDArray[np.bool_] | None = None

    @classmethod
    def of_flight(cls, flight: Flight) -> Recording:
        """Return what a simulated flight recorded until it had rested."""
        record, layout = flight.record, flight.task.team.layout
        rows = record.t <= np.fmax(flight.task.duration, flight.rested) + 1e-9
        drones = record.drones[rows]
        vertices = np.full((len(drones), layout.points, 3), np.nan)
        vertices[:, layout.clasps] = record.vertices[rows]
        return cls(
            record.t[rows],
            drones,
            _with_ends(vertices, drones, flight.task.team),
            flight.density,
            flight.gains.feed_forward,
            flight.gains.integral > 0.0,
        )


def read_recording(path: Path, team: Team) -> Recording:
    """Return the recording in a table, or in the directory of a simulated flight.

    Parameters
    ----------
    path: CSV file with the columns of ``HEADER``, or the results of ``hitchopt simulate``.
    team: names the drones and vertices.

    Raises
    ------
    FileError: a file that is missing, no such table, or without a drone or vertex of the team.
    """
    names = (*team.drone_names, *team.point_names)
    known: tuple[Any, ...] = ()
    if path.is_dir():
        drones = _rows(path / DRONES, "drone", dict(zip(names, range(len(names)), strict=True)))
        points = {str(p): team.drones + p for p in range(team.layout.points)}
        vertices = _rows(path / VERTICES, "vertex", points)
        last = np.max(vertices[:, 0], initial=-np.inf)  # drones alone are recorded longer
        if np.isfinite(last):
            drones = drones[drones[:, 0] <= last]
        rows = np.vstack([drones, vertices])
        known = _simulated(path / SUMMARY, team)
    else:
        rows = _rows(path, "name", dict(zip(names, range(len(names)), strict=True)))
    item = rows[:, 1].astype(np.intp)
    seen = np.bincount(item, minlength=len(names)) > 0
    for k, name in enumerate(team.drone_names):
        if not seen[k]:
            raise FileError(
                f"{path}: {name} is not recorded; the columns are {HEADER}, names as in the plan"
            )
    t, sample = np.unique(rows[:, 0], return_inverse=True)
    places = np.full((len(t), len(names), 3), np.nan)
    if len(np.unique(sample * len(names) + item)) < len(rows):
        raise FileError(f"{path}: holds a name twice at the same time; record it once")
    places[sample, item] = rows[:, 2:]
    drones, vertices = places[:, : team.drones], places[:, team.drones :]
    return Recording(t, drones, _with_ends(vertices, drones, team), *known)


def _simulated(path: Path, team: Team) -> tuple[Any, ...]:
    """Return density, feed-forward and integral action of a simulated flight from its summary.

    Raises
    ------
    FileError: the file is missing, or not such a summary of this team.
    """
    try:
        content = parsed_json(path.read_text(encoding="utf-8"))
        loops = content["position_loops"]
        density = float(content["density"]["simulated"])
        feeds = np.array(loops["feed_forward"], dtype=np.bool_)
        winds = np.array(loops["integral"], dtype=np.float64) > 0.0
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(f"{path}: not a summary of a flight; simulate again ({error})") from error
    if feeds.shape != (team.drones,) or winds.shape != (team.drones,):
        raise FileError(f"{path}: is not of this plan's {team.drones} drones; simulate again")
    return density, feeds, winds


def _with_ends(vertices: Array, drones: Array, team: Team) -> Array:
    """Return the points, a chain's ends replaced by the drones that hold them."""
    without = np.flatnonzero(~team.layout.has_leg.ravel())
    vertices = vertices.copy()
    vertices[:, team.layout.anchors[without]] = drones[:, without]
    return vertices


def _rows(path: Path, kind: str, items: dict[str, int]) -> Array:
    """Return (rows, 5): time, number of the item, and position, of a table's known names.

    Parameters
    ----------
    path: CSV file.
    kind: title of the column with names.
    items: number of each name; others are left out.

    Raises
    ------
    FileError: the file is missing, too large, or no such table.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FileError(f"{path}: is larger than {MAX_BYTES:.0e} bytes; record at a lower rate")
        with path.open(encoding="utf-8-sig", newline="") as file:
            table = csv.reader(file)
            titles = [title.strip() for title in next(table, [])]
            lines = [line for line in table if line]
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file; give a recording") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{path}: cannot be read as a table: {error}") from error
    missing = [title for title in ("t", kind, "x", "y", "z") if title not in titles]
    if missing:
        raise FileError(f"{path}: has no column {missing[0]!r}; a recording has {HEADER}")
    wanted = [titles.index(title) for title in ("t", "x", "y", "z")]
    name = titles.index(kind)
    try:
        item = np.array([items.get(line[name].strip(), -1) for line in lines], dtype=np.intp)
        cells = [[float(line[c] or "nan") for c in wanted] for line in lines]
    except (ValueError, IndexError) as error:
        raise FileError(f"{path}: holds a row that is not of numbers: {error}") from error
    values = np.array(cells, dtype=np.float64).reshape(len(lines), len(wanted))
    if not np.all(np.isfinite(values[:, 0])):
        raise FileError(f"{path}: holds a time that is not finite; give every row its time")
    known = item >= 0
    return np.column_stack([values[known, 0], item[known], values[known, 1:4]])
