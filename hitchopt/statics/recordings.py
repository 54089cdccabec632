"""Recorded flights: positions over time, against the plan, and their means over windows."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, OneLine
from hitchopt.hitch import Team
from hitchopt.simulation.flight import Flight
from hitchopt.simulation.judgement import STILL, TIGHT, Spread
from hitchopt.simulation.task import Task
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array

HEADER = "t,name,x,y,z"
"""Columns of a recording, in any order and among others: time from the plan's start [s], a drone
(q0, r0, …) or a vertex (p0, …), and its position [m]."""

MAX_BYTES = 400_000_000
"""Larger tables are refused before they are read."""

DRONES, VERTICES, SUMMARY = "drones.csv", "vertices.csv", "simulation.json"
"""Files of a simulated flight; for ``name`` its tables have ``drone`` and ``vertex``."""

WINDOW_TIGHT = 0.9
"""Least planned tension over the team's at which a hitch counts as drawn tight in a window."""


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
        record, team = flight.record, flight.task.team
        rows = record.t <= np.fmax(flight.task.duration, flight.rested) + 1e-9
        drones = record.drones[rows]
        vertices = np.full((len(drones), team.layout.points, 3), np.nan)
        vertices[:, team.layout.clasps] = record.vertices[rows]
        known = flight.density, flight.gains.feed_forward, flight.gains.integral > 0.0
        return cls(record.t[rows], drones, _with_ends(vertices, drones, team), *known)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(samples,): whether all drones and points are, after the plan's start."""
        seen = np.all(np.isfinite(self.drones), axis=(1, 2)) & (self.t >= 0.0)
        return np.asarray(seen & np.all(np.isfinite(self.vertices), axis=(1, 2)))


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
        drones = _rows(path / DRONES, "drone", {name: i for i, name in enumerate(names)})
        points = {str(p): team.drones + p for p in range(team.layout.points)}
        vertices = _rows(path / VERTICES, "vertex", points)
        last = np.max(vertices[:, 0], initial=-np.inf)  # drones alone are recorded longer
        rows = np.vstack([drones[~(drones[:, 0] > last) | np.isinf(last)], vertices])
        known = _simulated(path / SUMMARY, team)
    else:
        rows = _rows(path, "name", {name: i for i, name in enumerate(names)})
    item = rows[:, 1].astype(np.intp)
    for k in np.setdiff1d(np.arange(team.drones), item)[:1]:
        raise FileError(
            f"{path}: {names[k]} is not recorded; the columns are {HEADER}, names as in the plan"
        )
    t, sample = np.unique(rows[:, 0], return_inverse=True)
    if len(np.unique(sample * len(names) + item)) < len(rows):
        raise FileError(f"{path}: holds a name twice at the same time; record it once")
    places = np.full((len(t), len(names), 3), np.nan)
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
    for title in ("t", kind, "x", "y", "z"):
        if title not in titles:
            raise FileError(f"{path}: has no column {title!r}; a recording has {HEADER}")
    wanted, name = [titles.index(title) for title in ("t", "x", "y", "z")], titles.index(kind)
    try:
        item = np.array([items.get(line[name].strip(), -1) for line in lines], dtype=np.intp)
        cells = [[float(line[c] or "nan") for c in wanted] for line in lines]
    except (ValueError, IndexError) as error:
        raise FileError(f"{path}: holds a row that is not of numbers: {error}") from error
    values = np.array(cells, dtype=np.float64).reshape(len(lines), len(wanted))
    if not np.all(np.isfinite(values[:, 0])):
        raise FileError(f"{path}: holds a time that is not finite; give every row its time")
    return np.column_stack([values[:, 0], item, values[:, 1:]])[item >= 0]


class PlanRows:
    """A plan's samples at times (times,) [s] from its start, which stands still outside of it.

    Attributes
    ----------
    low, high: indices of the samples (times,) between which the times fall.
    """

    def __init__(self, task: Task, times: Array) -> None:
        asked, last = task.t[0] + np.clip(times, 0.0, task.duration), len(task.t) - 1
        self.low = np.clip(np.searchsorted(task.t, asked, side="right") - 1, 0, last)
        self.high = np.minimum(self.low + 1, last)
        step = np.where(self.high > self.low, task.t[self.high] - task.t[self.low], 1.0)
        self._share = np.clip((asked - task.t[self.low]) / step, 0.0, 1.0)

    def of(self, values: Array) -> Array:
        """Return the plan's values (samples, …), interpolated linearly: (times, …)."""
        share = self._share.reshape(-1, *[1] * (values.ndim - 1))
        found: Array = (1.0 - share) * values[self.low] + share * values[self.high]
        return found


@dataclass(frozen=True, eq=False)
class Comparison:
    """Distances from the plan, in three dimensions.

    Attributes
    ----------
    t: (samples,) [s]
    vertices: (samples, points) [m], nan where there is no hitch, drawn tight, or none was seen.
    drones: (samples, 2n) [m]
    moving: whether the plan moves a drone (samples,).
    """

    t: Array
    vertices: Array
    drones: Array
    moving: NDArray[np.bool_]

    def spreads(self, errors: Array) -> list[tuple[Spread, Spread, Spread]]:
        """Return the spreads of each column: over all samples, at rest, and moving."""
        return [
            (Spread.of(e), Spread.of(e[~self.moving]), Spread.of(e[self.moving])) for e in errors.T
        ]


def compare(recording: Recording, task: Task) -> Comparison:
    """Return how far a recording is from its plan."""
    rows, places = PlanRows(task, recording.t), task.setpoints.positions
    tight = np.all(task.tensions >= TIGHT * task.team.tension, axis=-1) & task.formed
    hitched = tight[rows.low] & tight[rows.high]
    off = np.linalg.norm(recording.vertices - rows.of(task.vertices), axis=-1)
    drones = np.linalg.norm(recording.drones - rows.of(places), axis=-1)
    steps = np.max(np.abs(places[rows.high] - places[rows.low]), axis=(1, 2))
    inside = (recording.t >= 0.0) & (recording.t <= task.duration)
    vertices = np.where(hitched[:, None], off, np.nan)
    return Comparison(recording.t, vertices, drones, (steps > STILL) & inside)


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows in which the plan has a hitch, drawn tight, and all of it was seen.

    Attributes
    ----------
    t: means of the times (windows,) [s].
    drones, vertices: measured (windows, 2n, 3), (windows, points, 3) [m].
    commanded: set points (windows, 2n, 3) [m].
    planned: planned vertices (windows, points, 3) [m].
    cable_forces: of the set points (windows, 2n, 3) [N].
    tensions: planned (windows, n) [N].
    """

    t: Array
    drones: Array
    vertices: Array
    commanded: Array
    planned: Array
    cable_forces: Array
    tensions: Array

    @classmethod
    def of(cls, recording: Recording, task: Task, size: float) -> Windows:
        """Return the windows of a size [s], those left out of which less than half is usable."""
        rows, least = PlanRows(task, recording.t), WINDOW_TIGHT * task.team.tension
        tight = task.formed & np.all(task.tensions >= least, axis=-1)
        usable = recording.seen & tight[rows.low]
        _, window, total = np.unique(
            np.floor(recording.t / size), return_inverse=True, return_counts=True
        )
        usable &= (np.bincount(window, usable) >= 0.5 * np.median(total))[window]
        _, window, count = np.unique(window[usable], return_inverse=True, return_counts=True)

        def mean(values: Array) -> Array:
            sums = np.zeros((len(count), *values.shape[1:]))
            np.add.at(sums, window, values[usable])
            return sums / count.reshape(-1, *[1] * (values.ndim - 1))

        setpoints = task.setpoints
        plan = setpoints.positions, task.vertices, setpoints.cable_forces, task.tensions
        measured = map(mean, (recording.t, recording.drones, recording.vertices))
        return cls(*measured, *(mean(rows.of(values)) for values in plan))
