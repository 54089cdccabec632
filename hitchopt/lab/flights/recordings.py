"""Recorded flights: contents of files, and drones and vertices on the plan's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.errors import InputError, OneLine
from hitchopt.lab.simulation.task import Task
from hitchopt.values import Array, as_array

MAX_GAP = 0.1  # Largest time to the nearest sample at which a body counts as visible [s]
TAUT_RATIO = 0.9  # Smallest planned tension, over the team's, of a hitch that is evaluated

# Standard error of a vertex that is interpolated across a window, added to its standard deviation
# [m], and time between samples with independent errors [s]
INTERPOLATION_ERROR, CORRELATION_TIME = 1e-2, 0.1


@dataclass(frozen=True, eq=False)
class Track(OneLine):
    """Positions of a body, or of all markers, while they are visible.

    Attributes
    ----------
    t: (m,) [s], ascending; times of markers repeat.
    positions: (m, 3) [m], finite.
    """

    t: Array
    positions: Array

    def __post_init__(self) -> None:
        t, x = as_array(self.t), as_array(self.positions)
        if t.ndim != 1 or t.size == 0 < np.size(self.t):
            raise InputError("t", self.t, "times (m,) [s]", "give one per sample")
        if x.shape != (len(t), 3) or not np.isfinite(np.column_stack([t, x])).all():
            bound = f"of shape (m, 3) and finite, as are its times, of shape {t.shape}"
            raise InputError("positions", self.positions, bound, "give a row per sample")
        if np.any(np.diff(t) < 0.0):
            raise InputError("t", t, "ascending", "sort the samples")
        for name, values in (("t", t), ("positions", x)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def at(self, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return interpolated positions (times, 3) [m], and whether the body is visible then."""
        x = np.column_stack([np.interp(t, self.t, axis) for axis in self.positions.T])
        i = np.searchsorted(self.t, t)
        gaps = np.abs(self.t[np.clip([i - 1, i], 0, len(self.t) - 1)] - t).min(axis=0)
        step = np.median(np.diff(self.t)) if len(self.t) > 1 else 0.0
        return x, gaps < max(MAX_GAP, step)


NO_MARKERS = Track(np.zeros(0), np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class RecordedFlight(OneLine):
    """Content of a recording, with the names, the frame and the clock of its file.

    Attributes
    ----------
    source: the file's format, such as ``Motive CSV 1.23``.
    tracks: bodies by their names in the file: drones, and vertices if the file has them.
    markers: unlabeled points, on the clock of ``tracks``.
    setpoints: commanded positions by name, on the clock of the track of that name.
    epoch: time of the recording's clock at which ``t`` is 0 [s]; 0 if times are as recorded.
    one_clock: whether all tracks share one clock; otherwise each track has its own origin.
    notes: corrections and omissions, a sentence each.
    simulated: of a simulated flight, the cables' ``density`` [kg/m] and whether the controllers
        had ``feed_forward`` and ``integral`` (2n,); empty for a real flight.
    """

    source: str
    tracks: Mapping[str, Track]
    markers: Track = NO_MARKERS
    setpoints: Mapping[str, Track] = field(default_factory=dict)
    epoch: float = 0.0
    one_clock: bool = True
    notes: tuple[str, ...] = ()
    simulated: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Recording(OneLine):
    """Measured positions over time.

    Attributes
    ----------
    t: (samples,) [s], ascending, from the plan's start.
    drones: (samples, 2n, 3) [m], in the order q0, r0, q1, …; nan if not visible.
    vertices: (samples, points, 3) [m]; nan if not visible. A chain's ends are its drones.
    density: of the cables [kg/m], if the flight is simulated.
    feed_forward, integral: whether the drones' controllers had these (2n,), if it is simulated.
    standard_errors: of the vertices (samples, points) [m]; None if unknown.
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


def plan_at(task: Task, t: ArrayLike, values: Array) -> Array:
    """Return a plan's values (samples, …) at times [s] from its start, constant beyond its ends."""
    times = task.states.t[0] + np.clip(t, 0.0, task.duration)
    curve: Array = make_interp_spline(task.states.t, values, k=1)(times)
    return curve


def taut_at(task: Task, t: Array, ratio: float = TAUT_RATIO) -> NDArray[np.bool_]:
    """Return whether the plan's hitch has at least a ratio of the team's tension at times."""
    taut = np.all(task.states.tensions >= ratio * task.team.tension, axis=-1) & task.states.formed
    return plan_at(task, t, taut.astype(np.float64)) > 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows (W,) in which the plan's hitch is taut and all drones are visible."""

    t: Array  # (W,) [s], mean time of the samples
    drones: Array  # (W, 2n, 3) [m]
    # (W, points, 3) [m]; displacements of vertices that are not visible are interpolated over time
    vertices: Array
    visible: NDArray[np.bool_]  # (W, points), vertices that are visible in half of a window
    errors: Array  # (W, points) [m], standard errors of the vertices
    positions: Array  # (W, 2n, 3) [m], planned setpoints
    planned: Array  # (W, points, 3) [m], planned vertices
    cable_forces: Array  # planned forces on drones (W, 2n, 3) [N]
    tensions: Array  # planned (W, n) [N]


def windows_of(recording: Recording, task: Task, size: float) -> Windows:
    """Return means over windows of a size [s].

    A window counts if every drone, and half of the vertices, are visible in half of it. Deviations
    from the plan are averaged and added to the plan's means, so that gaps do not bias a movement.
    """
    t, standard_errors = recording.t, recording.standard_errors
    window = np.floor(t / size)
    windows, sizes = np.unique(window, return_counts=True)
    needed = max(0.5 * float(np.median(sizes)), 1.0) if len(t) else 1.0
    usable = taut_at(task, t) & (t >= 0.0)
    member = ((windows[:, None] == window) & usable).astype(np.float64)  # (windows, samples)
    count = np.sum(member, axis=1)

    def mean(values: Array) -> Array:
        return np.tensordot(member / np.maximum(count, 1.0)[:, None], values, 1)

    def deviations(positions: Array, plan: Array) -> tuple[Array, Array]:
        """Return mean deviations (windows, items, 3), and numbers of samples (windows, items)."""
        finite = np.all(np.isfinite(positions), axis=2)
        off = np.where(finite[..., None], positions - plan_at(task, t, plan), 0.0)
        counts = member @ finite
        return np.tensordot(member, off, 1) / np.maximum(counts, 1.0)[..., None], counts

    drones, drone_counts = deviations(recording.drones, task.states.positions)
    off, counts = deviations(recording.vertices, task.states.vertices)
    visible = counts >= needed
    chosen = np.all(drone_counts >= needed, axis=1) & (count >= needed)
    chosen &= 2 * np.sum(visible, axis=1) >= visible.shape[1]
    middle, squares = mean(t), np.zeros(recording.vertices.shape[:2])
    if standard_errors is not None:
        squares = np.nan_to_num(standard_errors) ** 2
    independent = np.maximum(counts / (2.0 * needed) * size / CORRELATION_TIME, 1.0)
    errors = np.sqrt(member @ squares / np.maximum(counts, 1.0) / independent)
    for k in range(visible.shape[1]):
        known, missing = visible[:, k] & chosen, ~visible[:, k]
        spread, interpolated = 0.0, np.zeros(3)
        if np.any(known):
            interpolated = Track(middle[known], off[known, k]).at(middle[missing])[0]
            spread = float(np.linalg.norm(np.std(off[known, k], axis=0)))
        off[missing, k], errors[missing, k] = interpolated, np.hypot(INTERPOLATION_ERROR, spread)
    names = ("positions", "vertices", "cable_forces", "tensions")
    plan = [mean(plan_at(task, t, getattr(task.states, name))) for name in names]
    values: Any = (middle, plan[0] + drones, plan[1] + off, visible, errors, *plan)
    return Windows(*(each[chosen] for each in values))
