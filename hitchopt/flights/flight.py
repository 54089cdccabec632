"""The record of a recorded flight, with the names, the frame and the clock of its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.values import Array, Indices

# Units of length [m], by the names that files and users give them
UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
LONG_UNITS = {"meter": "m", "centimeter": "cm", "millimeter": "mm", "inche": "in", "feet": "ft"}

MAX_GAP = 0.1  # Largest distance to a sample at which a body is visible [s]


@dataclass(frozen=True, eq=False)
class Track(OneLine):
    """Positions of one body at the times at which it is visible.

    Attributes
    ----------
    t: (m,) [s], strictly ascending.
    positions: (m, 3) [m], finite.
    """

    t: Array
    positions: Array

    def __post_init__(self) -> None:
        _freeze(self, "t", np.float64, (-1,))
        _freeze(self, "positions", np.float64, (len(self.t), 3))
        if not np.all(np.diff(self.t) > 0.0):
            raise InputError("t", self.t, "strictly ascending", "sort the samples")


@dataclass(frozen=True, eq=False)
class Markers(OneLine):
    """Points without identity: a cloud per frame, in no order.

    Attributes
    ----------
    t: (frames,) [s], strictly ascending, of all frames, those without markers among them.
    frame: (k,) of every point, ascending index into ``t``.
    positions: (k, 3) [m], finite.
    """

    t: Array
    frame: Indices
    positions: Array

    def __post_init__(self) -> None:
        _freeze(self, "t", np.float64, (-1,))
        _freeze(self, "frame", np.intp, (-1,))
        _freeze(self, "positions", np.float64, (len(self.frame), 3))
        if not np.all(np.diff(self.t) > 0.0):
            raise InputError("t", self.t, "strictly ascending", "sort the frames")
        inside = np.all((self.frame >= 0) & (self.frame < len(self.t)))
        if not inside or np.any(np.diff(self.frame) < 0):
            bound = f"ascending indices into {len(self.t)} frames"
            raise InputError("frame", self.frame, bound, "sort the points by their frames")

    def __len__(self) -> int:
        return len(self.positions)


def no_markers() -> Markers:
    """Return the cloud of a recording without markers."""
    return cloud_of(np.zeros((0, 4)))


@dataclass(frozen=True, eq=False)
class SimulatedTeam(OneLine):
    """Facts of a simulated flight that cannot be measured.

    Attributes
    ----------
    density: of the cables [kg/m].
    feed_forward, integral: whether the drones' controllers had these (2n,).
    """

    density: float
    feed_forward: NDArray[np.bool_]
    integral: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RecordedFlight(OneLine):
    """Content of a recording.

    Attributes
    ----------
    source: the file's format, such as ``Motive CSV 1.23``.
    tracks: by the file's own names, the bodies: drones, and vertices if a file names them. Those
        without a sample are left out.
    markers: points without identity, on the clock of ``tracks``.
    setpoints: by name, commanded positions, on the clock of the track of that name.
    epoch: time of its own clock [s] from which its times count; 0 if they are as recorded.
    one_clock: whether all tracks share one clock; else each counts from an origin of its own.
    notes: corrections and omissions, a sentence each.
    simulated: facts of a simulated flight; None of a real one.
    """

    source: str
    tracks: Mapping[str, Track]
    markers: Markers = field(default_factory=no_markers)
    setpoints: Mapping[str, Track] = field(default_factory=dict)
    epoch: float = 0.0
    one_clock: bool = True
    notes: tuple[str, ...] = ()
    simulated: SimulatedTeam | None = None

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.setpoints) - set(self.tracks)):
            bound = f"of recorded bodies: {', '.join(self.tracks)}"
            raise InputError("setpoints", unknown[0], bound, "record this body too")
        if not self.one_clock and len(self.markers):
            bound = "empty where every track has a clock of its own"
            raise InputError("markers", self.markers, bound, "record them with the bodies' clock")
        for name in ("tracks", "setpoints"):
            tracks = {body: each for body, each in getattr(self, name).items() if len(each.t)}
            object.__setattr__(self, name, MappingProxyType(tracks))


def library(module: str) -> Any:
    """Return a module that only some formats need; FileError names the extra to install."""
    try:
        return import_module(module)
    except ImportError as fault:
        words = f"reading it needs {module.partition('.')[0]} ({fault})"
        raise FileError(f"{words}; pip install 'hitchopt[logs]'") from fault


def metres(unit: str) -> float:
    """Return a unit of length [m]; FileError for one that is not known."""
    word = unit.strip().casefold().replace("metre", "meter")
    scale = UNITS.get(LONG_UNITS.get(word.removesuffix("s"), word))
    if scale is None:
        raise FileError(f"its unit of length, {unit!r}, is unknown; state unit='m', 'cm' or 'mm'")
    return scale


def sampled(track: Track, t: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return positions at times (times, 3) [m], linear between samples, and if one is near."""
    positions = np.column_stack([np.interp(t, track.t, axis) for axis in track.positions.T])
    i = np.searchsorted(track.t, t)
    near = track.t[np.clip([i - 1, i], 0, len(track.t) - 1)]
    return positions, np.min(np.abs(near - t), axis=0) < MAX_GAP


def track_of(rows: Array, scale: float = 1.0) -> Track:
    """Return the track of rows (time [s], x, y, z) (m, 4), positions in units of ``scale`` [m].

    Rows that repeat a time or are not finite are left out. FileError if times do not ascend.
    """
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    steps = np.diff(rows[:, 0], prepend=-np.inf)
    if np.any(steps < 0.0):
        i = int(np.argmax(steps < 0.0))
        words = f"times do not ascend: {rows[i - 1, 0]:.9g} s is followed by {rows[i, 0]:.9g} s"
        raise FileError(f"{words}; give one flight, in the order in which it was recorded")
    return Track(rows[steps > 0.0, 0], scale * rows[steps > 0.0, 1:])


def cloud_of(rows: Array, scale: float = 1.0) -> Markers:
    """Return the cloud of rows (time [s], x, y, z) (k, 4); those that are not finite are left out.

    Frames are the times of its points. Positions are in units of ``scale`` [m].
    """
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    t, frame = np.unique(rows[:, 0], return_inverse=True)
    return Markers(t, frame, scale * rows[:, 1:])


def _freeze(record: object, name: str, kind: type, shape: tuple[int, ...]) -> None:
    """Replace a field by a read-only copy; InputError for another shape or numbers not finite."""
    values: NDArray[Any] = np.array(getattr(record, name), kind)
    lengths = tuple(values.shape[i] if n < 0 else n for i, n in enumerate(shape[: values.ndim]))
    if values.ndim != len(shape) or values.shape != lengths:
        raise InputError(name, values, f"of shape {shape}", "give a row per sample")
    if not np.all(np.isfinite(values)):
        raise InputError(name, values, "finite", "leave out samples without a position")
    values.setflags(write=False)
    object.__setattr__(record, name, values)
