"""The record of a recorded flight, as its file states it: own names, own frame, own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError, OneLine
from hitchopt.values import Array, Indices, choice


@dataclass(frozen=True, eq=False)
class Track(OneLine):
    """Positions of one body where it was seen.

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
    """Return the cloud of a recording that holds none."""
    return Markers(np.zeros(0), np.zeros(0, np.intp), np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class SimulatedTeam(OneLine):
    """Facts of a simulated flight that no measurement tells.

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
    tracks: by the file's own names, the bodies (drones; vertices where a file names them).
    markers: points without identity, on the clock of ``tracks``.
    setpoints: by name, commanded positions, on the clock of the track of that name.
    epoch: time of its own clock [s] from which its times count; 0 where they are as recorded.
    one_clock: whether all tracks share one clock; else each counts from an origin of its own.
    up: axis that the format or the file puts upright, ``y`` or ``z``; empty where nothing says so.
    notes: what was mended or left out, a sentence each.
    simulated: facts of a simulated flight; None of a real one.
    """

    source: str
    tracks: Mapping[str, Track]
    markers: Markers = field(default_factory=no_markers)
    setpoints: Mapping[str, Track] = field(default_factory=dict)
    epoch: float = 0.0
    one_clock: bool = True
    up: str = ""
    notes: tuple[str, ...] = ()
    simulated: SimulatedTeam | None = None

    def __post_init__(self) -> None:
        choice("up", self.up, ("z", "y", ""))
        if unknown := sorted(set(self.setpoints) - set(self.tracks)):
            bound = f"of recorded bodies: {', '.join(self.tracks)}"
            raise InputError("setpoints", unknown[0], bound, "record this body too")
        if not self.one_clock and len(self.markers):
            bound = "empty where every track has a clock of its own"
            raise InputError("markers", self.markers, bound, "record them with the bodies' clock")
        for name in ("tracks", "setpoints"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))


def _freeze(record: object, name: str, kind: type, shape: tuple[int, ...]) -> None:
    """Replace a field by a read-only copy; InputError for another shape or what is not finite."""
    values: NDArray[Any] = np.array(getattr(record, name), kind)
    lengths = tuple(values.shape[i] if n < 0 else n for i, n in enumerate(shape[: values.ndim]))
    if values.ndim != len(shape) or values.shape != lengths:
        raise InputError(name, values, f"of shape {shape}", "give a row per sample")
    if not np.all(np.isfinite(values)):
        raise InputError(name, values, "finite", "leave out samples that were not seen")
    values.setflags(write=False)
    object.__setattr__(record, name, values)
