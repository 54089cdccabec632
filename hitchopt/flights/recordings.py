"""Records of flights: as a file has them, and with drones and vertices on the plan's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from hitchopt.errors import InputError, OneLine
from hitchopt.simulation.task import Task
from hitchopt.values import Array

MAX_GAP = 0.1  # Least distance to a sample beyond which a body is not visible [s]
WINDOW_TIGHT = 0.9  # Least planned tension over the team's at which a hitch counts in a window

# Standard error [m] of a vertex that a window lacks, whose displacement is that before and after:
# 1 cm, besides its standard deviation. Time between samples whose errors are independent [s]
UNSEEN, INDEPENDENT = 1e-2, 0.1


@dataclass(frozen=True, eq=False)
class Track(OneLine):
    """Positions of a body, or of all markers, at the times at which they are visible.

    Attributes
    ----------
    t: (m,) [s], ascending; times of markers repeat.
    positions: (m, 3) [m], finite.
    """

    t: Array
    positions: Array

    def __post_init__(self) -> None:
        t, x = np.array(self.t, np.float64), np.array(self.positions, np.float64)
        if t.ndim != 1 or x.shape != (len(t), 3) or not np.isfinite(np.column_stack([t, x])).all():
            bound = f"of shape (m, 3) and finite, as are its times, of shape {t.shape}"
            raise InputError("positions", x, bound, "give a row per sample")
        if np.any(np.diff(t) < 0.0):
            raise InputError("t", t, "ascending", "sort the samples")
        for name, values in (("t", t), ("positions", x)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def at(self, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return positions at times (times, 3) [m], linear between samples, and if one is near."""
        x = np.column_stack([np.interp(t, self.t, axis) for axis in self.positions.T])
        i = np.searchsorted(self.t, t)
        near = np.abs(self.t[np.clip([i - 1, i], 0, len(self.t) - 1)] - t).min(axis=0)
        step = np.median(np.diff(self.t)) if len(self.t) > 1 else 0.0
        return x, near < max(MAX_GAP, step)


NOTHING = Track(np.zeros(0), np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class RecordedFlight(OneLine):
    """Content of a recording, with the names, the frame and the clock of its file.

    Attributes
    ----------
    source: the file's format, such as ``Motive CSV 1.23``.
    tracks: by the file's own names, the bodies: drones, and vertices if a file names them.
    markers: points without identity, on the clock of ``tracks``.
    setpoints: by name, commanded positions, on the clock of the track of that name.
    epoch: time of its own clock [s] from which its times count; 0 if they are as recorded.
    one_clock: whether all tracks share one clock; else each counts from an origin of its own.
    notes: corrections and omissions, a sentence each.
    simulated: of a simulated flight the cables' ``density`` [kg/m], and whether the drones'
        controllers had ``feed_forward`` and ``integral`` (2n,); empty of a real one.
    """

    source: str
    tracks: Mapping[str, Track]
    markers: Track = NOTHING
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
    t, setpoints, stated = recording.t, task.setpoints, recording.standard_errors
    window = np.floor(t / size)
    sizes, here = (
        np.unique(window, return_counts=True)[1],
        tight(task, t, WINDOW_TIGHT) & (t >= 0.0),
    )
    least = max(0.5 * float(np.median(sizes)), 1.0) if len(t) else 1.0
    member = ((np.unique(window)[:, None] == window) & here).astype(
        np.float64
    )  # (windows, samples)
    count = np.sum(member, axis=1)

    def mean(values: Array) -> Array:
        return np.tensordot(member / np.maximum(count, 1.0)[:, None], values, 1)

    def measured(places: Array, plan: Array) -> tuple[Array, Array]:
        """Return means off the plan (windows, items, 3), and numbers of samples with each item."""
        there = np.all(np.isfinite(places), axis=2)
        off = np.where(there[..., None], places - planned(task, t, plan), 0.0)
        often = member @ there
        return np.tensordot(member, off, 1) / np.maximum(often, 1.0)[..., None], often

    drones, drones_often = measured(recording.drones, setpoints.positions)
    off, often = measured(recording.vertices, task.vertices)
    seen, usable = often >= least, np.all(drones_often >= least, axis=1) & (count >= least)
    usable &= 2 * np.sum(seen, axis=1) >= seen.shape[1]
    middle, squares = mean(t), np.zeros(recording.vertices.shape[:2])
    if stated is not None:
        squares = np.nan_to_num(stated) ** 2
    free = np.maximum(often / (2.0 * least) * size / INDEPENDENT, 1.0)
    errors = np.sqrt(member @ squares / np.maximum(often, 1.0) / free)
    for k in range(seen.shape[1]):
        use, lacks = seen[:, k] & usable, ~seen[:, k]
        spread, guess = 0.0, np.zeros(3)
        if np.any(use):
            guess = Track(middle[use], off[use, k]).at(middle[lacks])[0]
            spread = float(np.linalg.norm(np.std(off[use, k], axis=0)))
        off[lacks, k], errors[lacks, k] = guess, np.hypot(UNSEEN, spread)
    commands = (setpoints.positions, task.vertices, setpoints.cable_forces, task.tensions)
    plan = [mean(planned(task, t, values)) for values in commands]
    values: Any = (middle, plan[0] + drones, plan[1] + off, seen, errors, *plan)
    return Windows(*(each[usable] for each in values))
