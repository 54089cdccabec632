"""Recorded flights: positions over time, against the plan, and their means over windows."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.errors import FileError, OneLine
from hitchopt.hitch import Team
from hitchopt.simulation.task import Task
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array

# Columns of a recording, in any order and among others: time from the plan's start [s], a drone
# (q0, r0, …) or a vertex (p0, …), and its position [m]
HEADER = "t,name,x,y,z"

MAX_BYTES = 400_000_000  # Larger tables are refused before they are read

# Files of a simulated flight; for "name" its tables have "drone" and "vertex"
DRONES, VERTICES, SUMMARY = "drones.csv", "vertices.csv", "simulation.json"

WINDOW_TIGHT = 0.9  # Least planned tension over the team's at which a hitch counts in a window


@dataclass(frozen=True, eq=False)
class Recording(OneLine):
    """Measured positions over time.

    Attributes
    ----------
    t: (samples,) [s], ascending, from the plan's start.
    drones: (samples, 2n, 3) [m], in the order q0, r0, q1, …; nan where not seen.
    vertices: (samples, points, 3) [m]; nan where not seen. A chain's ends are its drones.
    density, feed_forward, integral: of the cables [kg/m], and whether the drones' controllers had
        these (2n,), where they are known from a simulation.
    """

    t: Array
    drones: Array
    vertices: Array
    density: float | None = None
    feed_forward: NDArray[np.bool_] | None = None
    integral: NDArray[np.bool_] | None = None


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
    names, layout = (*team.drone_names, *team.point_names), team.layout
    known: tuple[Any, ...] = ()
    if path.is_dir():
        drones = _rows(path / DRONES, "drone", team.drone_names)
        vertices = _rows(path / VERTICES, "vertex", [str(p) for p in range(layout.points)])
        vertices[:, 1] += team.drones
        last = np.max(vertices[:, 0], initial=-np.inf)  # drones alone are recorded longer
        rows = np.vstack([drones[~(drones[:, 0] > last) | np.isinf(last)], vertices])
        known = _simulated(path / SUMMARY, team)
    else:
        rows = _rows(path, "name", names)
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
    ends = np.flatnonzero(~layout.has_leg.ravel())  # drones that are a chain's points
    places[:, team.drones + layout.anchors[ends]] = places[:, ends]
    return Recording(t, places[:, : team.drones], places[:, team.drones :], *known)


def _simulated(path: Path, team: Team) -> tuple[Any, ...]:
    """Return density, feed-forward and integral action of a simulated flight from its summary."""
    try:
        content = parsed_json(path.read_text(encoding="utf-8"))
        loops = [content["position_loops"][name] for name in ("feed_forward", "integral")]
        on = np.array(loops, np.float64).reshape(2, team.drones) > 0.0
        return float(content["density"]["simulated"]), *on
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(
            f"{path}: not a summary of this plan's flight; simulate again ({error})"
        ) from error


def _rows(path: Path, kind: str, names: Any) -> Array:
    """Return (rows, 5): time, index of the name in column ``kind``, and position; else a FileError.

    Rows of other names are left out.
    """
    index = {name: float(i) for i, name in enumerate(names)}
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it is larger than {MAX_BYTES:.0e} bytes; record at a lower rate")
        with path.open(encoding="utf-8-sig", newline="") as file:
            titles, *lines = [[x.strip() for x in line] for line in csv.reader(file) if line] or [
                []
            ]
        time, name, *place = map(titles.index, ("t", kind, "x", "y", "z"))
        cells = [
            [float(line[time]), index[line[name]], *(float(line[c] or "nan") for c in place)]
            for line in lines
            if line[name] in index
        ]
        rows = np.array(cells, np.float64).reshape(-1, 5)
        if not np.all(np.isfinite(rows[:, 0])):
            raise ValueError("a time is not finite")
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file; give a recording") from None
    except (OSError, ValueError, IndexError, csv.Error) as error:
        raise FileError(f"{path}: is no table of {HEADER} in numbers: {error}") from error
    return rows


def planned(task: Task, t: ArrayLike, values: Array) -> Array:
    """Return a plan's values (samples, …) at times [s] from its start; it stands still outside."""
    times = task.t[0] + np.clip(t, 0.0, task.duration)
    found: Array = make_interp_spline(task.t, values, k=1)(times)
    return found


def tight(task: Task, t: Array, share: float) -> NDArray[np.bool_]:
    """Return whether the plan has a hitch with that share of the team's tension, around times."""
    drawn = np.all(task.tensions >= share * task.team.tension, axis=-1) & task.formed
    return planned(task, t, drawn.astype(np.float64)) > 1.0 - 1e-9


def windows_of(recording: Recording, task: Task, size: float) -> dict[str, Array]:
    """Return means over windows of a size [s] in which the plan has a hitch, drawn tight.

    They are, by name, of the times ``t``, of what was measured, ``drones`` and ``vertices``, and of
    the plan: set points ``positions``, ``planned`` vertices, ``cable_forces`` and ``tensions``.
    Samples count in which all was seen; windows are left out less than half of which count.
    """
    t, setpoints = recording.t, task.setpoints
    usable = tight(task, t, WINDOW_TIGHT) & (t >= 0.0)
    for places in (recording.drones, recording.vertices):
        usable &= np.all(np.isfinite(places), axis=(1, 2))
    window = np.unique(np.floor(t / size), return_inverse=True)[1]
    share = np.bincount(window, usable) / np.median(np.bincount(window))
    usable &= (share >= 0.5)[window]
    firsts, counts = np.unique(window[usable], return_index=True, return_counts=True)[1:]
    values = {"t": t, "drones": recording.drones, "vertices": recording.vertices}
    for name, each in (
        ("positions", setpoints.positions),
        ("planned", task.vertices),
        ("cable_forces", setpoints.cable_forces),
        ("tensions", task.tensions),
    ):
        values[name] = planned(task, t, each)
    if not len(firsts):
        return {name: each[:0] for name, each in values.items()}
    sums = {name: np.add.reduceat(each[usable], firsts) for name, each in values.items()}
    return {name: (each.T / counts).T for name, each in sums.items()}
