"""Recorded flights: positions over time, against the plan, in windows."""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
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


@dataclass(frozen=True, eq=False)
class PlanRows:
    """Samples of a plan between which the times of a recording fall.

    Attributes
    ----------
    low, high: indices of samples (times,).
    share: (times,), from 0 at the first to 1 at the second.
    """

    low: NDArray[np.intp]
    high: NDArray[np.intp]
    share: Array

    @classmethod
    def at(cls, task: Task, times: Array) -> PlanRows:
        """Return the samples about some times (times,) [s] from the plan's start.

        Before its start and after its end a plan stands still.
        """
        asked = task.t[0] + np.clip(times, 0.0, task.duration)
        last = len(task.t) - 1
        low = np.clip(np.searchsorted(task.t, asked, side="right") - 1, 0, last)
        high = np.minimum(low + 1, last)
        step = np.where(high > low, task.t[high] - task.t[low], 1.0)
        return cls(low, high, np.clip((asked - task.t[low]) / step, 0.0, 1.0))

    def of(self, values: Array) -> Array:
        """Return the plan's values (samples, …), interpolated linearly: (times, …)."""
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        found: Array = (1.0 - share) * values[self.low] + share * values[self.high]
        return found


@dataclass(frozen=True, eq=False)
class Comparison:
    """Distances from the plan.

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
    """Return how far a recording is from its plan, in three dimensions."""
    rows = PlanRows.at(task, recording.t)
    tight = np.all(task.tensions >= TIGHT * task.team.tension, axis=-1) & task.formed
    hitched = tight[rows.low] & tight[rows.high]
    off = recording.vertices - rows.of(task.vertices)
    vertices = np.where(hitched[:, None], np.linalg.norm(off, axis=-1), np.nan)
    places = task.setpoints.positions
    drones = np.linalg.norm(recording.drones - rows.of(places), axis=-1)
    steps = np.max(np.abs(places[rows.high] - places[rows.low]), axis=(1, 2))
    inside = (recording.t >= 0.0) & (recording.t <= task.duration)
    return Comparison(recording.t, vertices, drones, (steps > STILL) & inside)


WINDOW = 0.5
"""Length of a window [s]: some times the correlation time of a drone's position error."""

SPAN = 6.0
"""Length of a span over which stiffness is fitted [s]: tensions of a span of 0.5 s would follow the
noise of its drones, which makes them seem up to 24 % stiffer, spans of 2 s up to 13 %."""

WINDOW_TIGHT = 0.9
"""Least planned tension over the team's at which a hitch counts as drawn tight in a window."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows in which the plan has a hitch, drawn tight, and all of it was seen.

    Attributes
    ----------
    t: middles (windows,) [s].
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

    def spans(self) -> Windows:
        """Return means over spans of about SPAN, each without a gap."""
        number = np.arange(len(self.t))
        run = np.cumsum(np.diff(self.t, prepend=self.t[:1]) > 1.5 * WINDOW)
        _, first, length = np.unique(run, return_index=True, return_counts=True)
        parts = np.maximum(np.round(length * WINDOW / SPAN), 1.0)
        span = ((number - first[run]) * parts[run] / length[run]).astype(np.intp)
        _, first, count = np.unique([run, span], axis=1, return_index=True, return_counts=True)

        def mean(values: Array) -> Array:
            sums: Array = np.add.reduceat(values, first, axis=0)
            return sums / count.reshape(-1, *[1] * (values.ndim - 1))

        columns: Any = (mean(getattr(self, field.name)) for field in fields(self))
        return Windows(*columns)


def windows_of(recording: Recording, task: Task) -> Windows:
    """Return the windows of a recording, each with the set points that applied.

    After its end a plan stands still at its last set point.
    """
    rows = PlanRows.at(task, recording.t)
    row = rows.low
    tight = task.formed[row] & np.all(
        task.tensions[row] >= WINDOW_TIGHT * task.team.tension, axis=-1
    )
    seen = np.all(np.isfinite(recording.drones), axis=(1, 2))
    seen &= np.all(np.isfinite(recording.vertices), axis=(1, 2))
    window = np.floor(recording.t / WINDOW).astype(np.intp)
    usable = tight & seen & (recording.t >= 0.0)
    number, of_sample = np.unique(window, return_inverse=True)
    total = np.bincount(of_sample, minlength=len(number))
    good = np.bincount(of_sample, usable, minlength=len(number))
    chosen = usable & (good >= 0.5 * np.median(total))[of_sample]
    number, of_sample = np.unique(window[chosen], return_inverse=True)
    count = np.bincount(of_sample, minlength=len(number))

    def mean(values: Array) -> Array:
        sums = np.zeros((len(number), *values.shape[1:]))
        np.add.at(sums, of_sample, values[chosen])
        return sums / count.reshape(-1, *[1] * (values.ndim - 1))

    setpoints = task.setpoints
    return Windows(
        mean(recording.t),
        mean(recording.drones),
        mean(recording.vertices),
        mean(rows.of(setpoints.positions)),
        mean(rows.of(task.vertices)),
        mean(rows.of(setpoints.cable_forces)),
        mean(rows.of(task.tensions)),
    )
