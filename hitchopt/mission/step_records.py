"""The steps of a mission as records, checked in themselves but not yet against a team."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.mission.form_records import Form, Land, Release
from hitchopt.mission.leg_sharing import LegSharing
from hitchopt.values import finite, positive

Array = NDArray[np.float64]

MIN_GAP = 1e-3
"""[s] Timed points closer than this are typing errors: no drone could tell them apart."""

MAX_TURNS = 5
"""Of one transport; its polynomials, of a bounded number, would not follow more closely enough."""


@dataclass(frozen=True, eq=False)
class Morph:
    """Step: every vertex goes to its place in ``polygon``.

    Parameters
    ----------
    polygon: the outline at the end, or its points (n, 2) [m] until a Problem knows the topology.
    legs: at the end, ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for those nearest to the
        current fractions.
    duration: exactly that long [s]; None for as fast as the limits allow.
    blend: go on into the next step without a stop.
    optimize: look for a faster way even where the straight one will do.
    tension: smallest and largest [N] where tensions may change on the way, or None.
    """

    name: ClassVar[str] = "morph"
    polygon: Outline
    legs: LegSharing | None = None
    duration: float | None = None
    blend: bool = False
    optimize: bool = False
    tension: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _check_duration(self)
        if self.tension is not None:
            least, most = (
                positive(f"tension.{name}", value)
                for name, value in zip(("min", "max"), self.tension, strict=True)
            )
            if least > most:
                raise InputError(
                    "tension.max", most, f"at least tension.min, {least:g} N", "exchange the two"
                )
            object.__setattr__(self, "tension", (least, most))


@dataclass(frozen=True, eq=False)
class MoveVertex:
    """Step: one vertex goes elsewhere; only the four drones move that the paper names.

    Where a limit binds, further drones slide along their cables as well.

    Parameters
    ----------
    vertex: which, from 0.
    to, by: its new place, or by how much it goes (2,) [m]; exactly one of them.
    legs, duration, blend: as of Morph; without legs those of the paper are kept.
    """

    name: ClassVar[str] = "move_vertex"
    vertex: int
    to: Array | None = None
    by: Array | None = None
    legs: LegSharing | None = None
    duration: float | None = None
    blend: bool = False

    def __post_init__(self) -> None:
        _check_index("vertex", self.vertex)
        _check_to_or_by(self, (2,))
        _check_duration(self)


@dataclass(frozen=True, eq=False)
class MoveEdge:
    """Step: both ends of an edge go elsewhere; four drones move, or six where edges turn.

    Parameters
    ----------
    edge: which, from 0; edge k runs from vertex k to vertex k + 1.
    to, by: the new places of its ends (2, 2), or by how much both go (2,) [m]; exactly one of them.
    legs, duration, blend: as of MoveVertex.
    """

    name: ClassVar[str] = "move_edge"
    edge: int
    to: Array | None = None
    by: Array | None = None
    legs: LegSharing | None = None
    duration: float | None = None
    blend: bool = False

    def __post_init__(self) -> None:
        _check_index("edge", self.edge)
        _check_to_or_by(self, (2, 2))
        _check_duration(self)


@dataclass(frozen=True, eq=False)
class Adjust:
    """Step: cables slide through their clasps, the outline stays.

    Parameters
    ----------
    legs: the sharing at the end.
    duration, blend: as of Morph.
    """

    name: ClassVar[str] = "adjust"
    legs: LegSharing
    duration: float | None = None
    blend: bool = False

    def __post_init__(self) -> None:
        _check_duration(self)


@dataclass(frozen=True, eq=False)
class FollowVertex:
    """Step: one vertex meets timed points at their times, at rest before and after.

    Parameters
    ----------
    vertex: which, from 0.
    path: (J, 3), rows ``t, x, y`` [s, m, m], t from the step's start and increasing. Equal points
        in a row mean standing still in between.
    legs: the sharing at the end; without it as of MoveVertex.
    """

    name: ClassVar[str] = "follow_vertex"
    vertex: int
    path: Array
    legs: LegSharing | None = None

    def __post_init__(self) -> None:
        _check_index("vertex", self.vertex)
        path = _numbers("path", self.path, (None, 3), "points [t, x, y]")
        times = path[:, 0]
        gaps = np.diff(times, prepend=0.0)
        if times[0] == 0.0:
            gaps = gaps[1:]
        if len(gaps) == 0 or np.min(gaps) < MIN_GAP:
            raise InputError(
                "path",
                path.tolist(),
                f"a path whose times increase from 0 or later, by {MIN_GAP:g} s or more, and end "
                "after it",
                "sort its points by time",
            )
        object.__setattr__(self, "path", path)

    @property
    def duration(self) -> float:
        """When the last point is met [s]."""
        return float(self.path[-1, 0])


@dataclass(frozen=True, eq=False)
class Transport:
    """Step: the whole hitch is carried and turned, its shape and legs unchanged.

    Parameters
    ----------
    to: (3,) [m], where the centroid of the outline goes.
    yaw: by how much it turns about that, counter-clockwise [rad]; more than a turn is one.
    duration: as of Morph.
    """

    name: ClassVar[str] = "transport"
    to: Array
    yaw: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", _numbers("to", self.to, (3,), "a point [x, y, z]"))
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))
        if abs(self.yaw) > MAX_TURNS * 2.0 * math.pi:
            raise InputError(
                "yaw",
                self.yaw,
                f"at most {MAX_TURNS} turns either way",
                "turn in several steps",
            )
        _check_duration(self)


@dataclass(frozen=True)
class Hold:
    """Step: nothing moves.

    Parameters
    ----------
    seconds: how long [s].
    """

    name: ClassVar[str] = "hold"
    seconds: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", positive("seconds", self.seconds))


ShapeStep = Morph | MoveVertex | MoveEdge | Adjust
"""What changes the shape by untimed vertices and legs: these can be blended."""

HitchStep = ShapeStep | FollowVertex | Transport | Hold
"""What a hitch does, and is one afterwards."""

Step = HitchStep | Form | Release | Land


def _check_duration(step: Morph | MoveVertex | MoveEdge | Adjust | Transport) -> None:
    if step.duration is not None:
        object.__setattr__(step, "duration", positive("duration", step.duration))


def _check_index(key: str, index: object) -> None:
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or index < 0:
        raise InputError(key, index, "a whole number from 0 on", "indices start at 0")


def _check_to_or_by(step: MoveVertex | MoveEdge, to_shape: tuple[int, ...]) -> None:
    if (step.to is None) == (step.by is None):
        value = None if step.to is None else np.asarray(step.to).tolist()
        raise InputError(
            "to", value, "given where by is not, and only there", "give either to or by"
        )
    if step.to is not None:
        words = "a point [x, y]" if to_shape == (2,) else "two points [[x, y], [x, y]]"
        object.__setattr__(step, "to", _numbers("to", step.to, to_shape, words))
    if step.by is not None:
        object.__setattr__(step, "by", _numbers("by", step.by, (2,), "an offset [dx, dy]"))


def _numbers(key: str, value: object, shape: tuple[int | None, ...], words: str) -> Array:
    """Return ``value`` as a read-only array of that shape; None stands for one or more."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    fits = array.ndim == len(shape) and all(
        size == wanted if wanted is not None else size > 0
        for size, wanted in zip(array.shape, shape, strict=True)
    )
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if not fits:
        raise InputError(key, value, words, "give plain numbers in SI units")
    if not np.all(np.isfinite(array)):
        raise InputError(key, value, "finite", "nan and inf are no quantities")
    array.setflags(write=False)
    return array
