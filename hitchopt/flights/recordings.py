"""Recordings of a team: its drones and vertices on one clock, and their means over windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.errors import FileError, OneLine
from hitchopt.flights.flight import RecordedFlight, Track, sampled
from hitchopt.hitch import Team
from hitchopt.simulation.task import Task
from hitchopt.values import Array

WINDOW_TIGHT = 0.9  # Least planned tension over the team's at which a hitch counts in a window

TOGETHER = 0.5  # Least step of all times over a body's at which bodies share their times
LONGEST_GAP = 2.5  # Longest gap over which positions are interpolated, over a body's usual step

# Standard error [m] of a vertex that a window lacks, whose displacement is that before and after:
# 1 cm, besides its standard deviation. Time between samples whose errors are independent [s]
UNSEEN, INDEPENDENT = 1e-2, 0.1


@dataclass(frozen=True, eq=False)
class Recording(OneLine):
    """Measured positions over time.

    Attributes
    ----------
    t: (samples,) [s], ascending, from the plan's start.
    drones: (samples, 2n, 3) [m], in the order q0, r0, q1, …; nan if not visible.
    vertices: (samples, points, 3) [m]; nan if not visible. A chain's ends are its drones.
    density, feed_forward, integral: of the cables [kg/m], and whether the drones' controllers had
        these (2n,), if they are known from a simulation.
    standard_errors: of the vertices (samples, points) [m]; None if they are not known.
    notes: corrections of the reader.
    """

    t: Array
    drones: Array
    vertices: Array
    density: float | None = None
    feed_forward: NDArray[np.bool_] | None = None
    integral: NDArray[np.bool_] | None = None
    standard_errors: Array | None = None
    notes: tuple[str, ...] = ()


def recording_of(flight: RecordedFlight, team: Team) -> Recording:
    """Return a flight whose bodies have the team's names, and whose clock is the plan's.

    Bodies that are sampled at different times are interpolated to those of the first drone.

    Raises
    ------
    FileError: a drone that is not recorded.
    """
    names, layout = (*team.drone_names, *team.point_names), team.layout
    for name in team.drone_names:
        if name not in flight.tracks:
            bodies = ", ".join(list(flight.tracks)[:10])
            raise FileError(f"{name} is not recorded, but {bodies}; names are as in the plan")
    own = {name: flight.tracks[name] for name in names if name in flight.tracks}
    t = np.unique(np.concatenate([track.t for track in own.values()]))
    steps = [np.diff(track.t) for track in own.values() if len(track.t) > 1]
    usual = float(np.median(np.concatenate(steps))) if steps else np.inf
    together = len(t) < 2 or float(np.median(np.diff(t))) >= TOGETHER * usual
    t = t if together else own[names[0]].t
    places = np.full((len(t), len(names), 3), np.nan)
    for k, name in enumerate(names):
        track = own.get(name)
        if track is None or (len(track.t) < 2 and not together):
            continue
        if together:
            places[np.searchsorted(t, track.t), k] = track.positions
        else:
            after = np.clip(np.searchsorted(track.t, t), 1, len(track.t) - 1)
            near = (t >= track.t[0]) & (t <= track.t[-1])
            near &= track.t[after] - track.t[after - 1] <= LONGEST_GAP * usual
            places[near, k] = sampled(track, t[near])[0]
    ends = np.flatnonzero(~layout.has_leg.ravel())  # drones that are a chain's points
    places[:, team.drones + layout.anchors[ends]] = places[:, ends]
    drones, vertices = places[:, : team.drones], places[:, team.drones :]
    notes, simulated = flight.notes, vars(flight.simulated) if flight.simulated else {}
    if not together:
        notes += (f"bodies are seen at different times: interpolated to those of {names[0]}",)
    return Recording(t, drones, vertices, **simulated, notes=notes)


def planned(task: Task, t: ArrayLike, values: Array) -> Array:
    """Return a plan's values (samples, …) at times [s] from its start; it stands still outside."""
    times = task.t[0] + np.clip(t, 0.0, task.duration)
    curve: Array = make_interp_spline(task.t, values, k=1)(times)
    return curve


def tight(task: Task, t: Array, share: float) -> NDArray[np.bool_]:
    """Return whether the plan has a hitch with that share of the team's tension, around times."""
    drawn = np.all(task.tensions >= share * task.team.tension, axis=-1) & task.formed
    return planned(task, t, drawn.astype(np.float64)) > 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows (W,) in which the plan's hitch is drawn tight and its drones are visible.

    Attributes
    ----------
    t: (W,) [s], of the samples that count.
    drones, vertices: (W, 2n, 3), (W, points, 3) [m]; vertices that are not visible are as far off
        the plan as before and after.
    seen: (W, points), vertices that are visible in half of a window.
    errors: (W, points) [m], standard errors of the vertices.
    positions, planned, cable_forces, tensions: of the plan: set points, vertices [m], forces on
        drones and tensions [N].
    """

    t: Array
    drones: Array
    vertices: Array
    seen: NDArray[np.bool_]
    errors: Array
    positions: Array
    planned: Array
    cable_forces: Array
    tensions: Array

    def __len__(self) -> int:
        return len(self.t)


def windows_of(recording: Recording, task: Task, size: float) -> Windows:
    """Return means over windows of a size [s].

    A window counts if every drone, and half of the vertices, are visible in half of it. Means are
    those of deviations from the plan, added to the plan's: gaps in a movement do not shift them.
    """
    t, setpoints = recording.t, task.setpoints
    inside = tight(task, t, WINDOW_TIGHT) & (t >= 0.0)
    window = np.unique(np.floor(t / size), return_inverse=True)[1]
    many = int(window.max(initial=-1)) + 1
    half = 0.5 * np.median(np.bincount(window)) if many else 0.0

    def sums(values: Array) -> Array:
        total = np.zeros((many, *values.shape[1:]))
        np.add.at(total, window[inside], values[inside])
        return total

    count = np.maximum(sums(np.ones(len(t))), 1.0)

    def mean(values: Array) -> Array:
        return (sums(planned(task, t, values)).T / count).T

    def measured(places: Array, plan: Array) -> tuple[Array, Array]:
        """Return means (windows, items, 3), and numbers of samples with each item."""
        there = np.all(np.isfinite(places), axis=2)
        off = np.where(there[..., None], places - planned(task, t, plan), 0.0)
        often = sums(there.astype(np.float64))
        means = sums(off) / np.maximum(often, 1.0)[..., None]
        return means + mean(plan), often

    drones, drones_seen = measured(recording.drones, setpoints.positions)
    vertices, often = measured(recording.vertices, task.vertices)
    seen = (often >= half) & (often > 0.0)
    usable = np.all((drones_seen >= half) & (drones_seen > 0.0), axis=1)
    usable &= 2 * np.sum(seen, axis=1) >= seen.shape[1]
    usable &= sums(np.ones(len(t))) >= half
    middle, plan = sums(t) / count, mean(task.vertices)
    squares = np.zeros(recording.vertices.shape[:2])
    if recording.standard_errors is not None:
        squares = np.nan_to_num(recording.standard_errors) ** 2
    errors = np.sqrt(sums(squares) / np.maximum(often, 1.0))
    errors /= np.sqrt(np.maximum(often / (2.0 * max(half, 0.5)) * size / INDEPENDENT, 1.0))
    off = vertices - plan
    for k in range(seen.shape[1]):
        here, lacks = seen[:, k] & usable, ~seen[:, k]
        spread, guess = 0.0, np.zeros(3)
        if np.any(here):
            guess, _ = sampled(Track(middle[here], off[here, k]), middle[lacks])
            spread = float(np.linalg.norm(np.std(off[here, k], axis=0)))
        off[lacks, k], errors[lacks, k] = guess, np.hypot(UNSEEN, spread)
    commands = mean(setpoints.positions), plan, mean(setpoints.cable_forces), mean(task.tensions)
    values: Any = (middle, drones, plan + off, seen, errors, *commands)
    return Windows(*(each[usable] for each in values))
