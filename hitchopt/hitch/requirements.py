"""Requirements of a plan: limits of motion, distances, the arena and keep-out volumes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError, OneLine
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch.team import Team
from hitchopt.objects import Clearance, Section, Slab, SolidObject
from hitchopt.values import Array, finite, instance, positive, sequence, units
from hitchopt.values.units import check_unit, radians_of, store

WIDER = 1.0 + 2e-9
"""Factor of ``tracking`` in the planners' distances, so that rounding breaks no limit."""


@dataclass(frozen=True)
class Limits(OneLine):
    """Limits of motion; all norms are Euclidean.

    Parameters
    ----------
    speed: largest speed of every drone [m/s]
    acceleration: largest acceleration of every drone [m/s²]
    jerk: largest jerk of every drone [m/s³]
    tilt: largest angle of the thrust from vertical [rad], below π/2; None for 45°
    vertex_speed: largest speed of every vertex of the hitch [m/s]
    leg: shortest leg, vertex to drone, while the hitch holds [m]
    duration: largest duration of the whole plan [s], or None
    body_rate: largest turning rate of every drone's thrust vector [rad/s], or None
    reserve: share of acceleration and jerk that plans use, above 0 and up to 1; below 1 a stop on
        the common clock can begin at every time
    tracking: distance [m] by which all drones may be off their plan at once, every distance kept;
        None for what the team's flight controllers need, which is none unless they are named
    tilt_deg, body_rate_deg: the same in [°] and [°/s]; give one of the two

    Raises
    ------
    InputError: a number out of its range, or an angle given twice.
    """

    speed: float = 1.0
    acceleration: float = 2.0
    jerk: float = 20.0
    tilt: float = math.radians(45.0)
    vertex_speed: float = 0.5
    leg: float = 0.15
    duration: float | None = None
    body_rate: float | None = None
    reserve: float = 1.0
    tracking: float | None = None

    def __init__(
        self,
        speed: float = 1.0,
        acceleration: float = 2.0,
        jerk: float = 20.0,
        tilt: float | None = None,
        vertex_speed: float = 0.5,
        leg: float = 0.15,
        duration: float | None = None,
        body_rate: float | None = None,
        reserve: float = 1.0,
        tracking: float | None = None,
        *,
        tilt_deg: float | None = None,
        body_rate_deg: float | None = None,
    ) -> None:
        angle = radians_of("tilt", tilt, tilt_deg, units.TILT_DEG)
        values = {
            "speed": speed,
            "acceleration": acceleration,
            "jerk": jerk,
            "tilt": Limits.tilt if angle is None else angle,
            "vertex_speed": vertex_speed,
            "leg": leg,
            "duration": duration,
            "body_rate": radians_of("body_rate", body_rate, body_rate_deg, units.BODY_RATE_DEG),
            "reserve": float(reserve),
            "tracking": tracking,
        }
        if positive("reserve", reserve) > 1.0:
            raise InputError("reserve", reserve, "at most 1", "0.8 leaves a fifth for stops")
        in_degrees = {"tilt": tilt_deg, "body_rate": body_rate_deg}
        store(self, values, [name for name, given in in_degrees.items() if given is not None])

    @property
    def tilt_deg(self) -> float:
        """Largest angle of the thrust from vertical [°]."""
        return math.degrees(self.tilt)

    @property
    def with_reserve(self) -> Limits:
        """The limits enforced at full rate: acceleration and jerk times the reserve."""
        if self.reserve == 1.0:
            return self
        less = self.reserve * self.acceleration, self.reserve * self.jerk
        return replace(self, reserve=1.0, acceleration=less[0], jerk=less[1])


@dataclass(frozen=True)
class Separation(OneLine):
    """Smallest distances between drones and cables.

    Parameters
    ----------
    radius, height: semi-axes of a drone's ellipsoid [m] (Preiss et al. 2017)
    cable: distance of a drone to any cable but its own, and to its own edge [m]
    crossing: distance of taut cable parts that share no clasp [m]
    object: distance of a cable's centre line, and of a held object, to objects [m]
    """

    radius: float = 0.12
    height: float = 0.30
    cable: float = 0.10
    crossing: float = 0.05
    object: float = 0.035

    def __post_init__(self) -> None:
        store(self, vars(self).copy())

    @property
    def scale(self) -> Array:
        """Factors (3,) [1/m]: ``separation`` is the norm of two drones' offset times these."""
        across, upward = 0.5 / self.radius, 0.5 / self.height
        return np.array([across, across, upward])

    def widened(self, off: float) -> Separation:
        """Return distances that keep these where all drones and vertices may be off by some [m].

        The ellipsoid is the smallest around its own sum with a ball that is no wider than needed:
        squares of semi-axes grow by 1 + off/radius, and those of the ball by 1 + radius/off.
        """
        height = math.sqrt((self.height**2 + self.radius * off) * (1.0 + off / self.radius))
        cable, crossing = self.cable + 2.0 * off, self.crossing + 2.0 * off
        return Separation(self.radius + off, height, cable, crossing, self.object + off)


@dataclass(frozen=True, eq=False)
class Arena(OneLine):
    """A box that the drones stay in.

    Parameters
    ----------
    lower, upper: opposite corners (3,) [m]
    """

    lower: Array
    upper: Array

    def __init__(
        self, lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike
    ) -> None:
        for name, corner in (("lower", lower), ("upper", upper)):
            given = [*corner] if np.iterable(corner) else []
            if len(given) != 3:
                raise InputError(name, corner, "a point [x, y, z]", "give three numbers in metres")
            point = np.array([finite(f"{name}[{i}]", x) for i, x in enumerate(given)])
            check_unit(name, point, units.HEIGHT)
            point.setflags(write=False)
            object.__setattr__(self, name, point)
        if not np.all(self.lower < self.upper):
            bound = f"greater than lower {self.lower.tolist()} on every axis"
            remedy = "exchange the corners or move them apart"
            raise InputError("upper", self.upper.tolist(), bound, remedy)


@dataclass(frozen=True, eq=False)
class Prism(OneLine):
    """An upright prism to which drones keep a distance of at least ``Separation.radius``.

    Parameters
    ----------
    polygon: its outline, (m, 2) [m], convex, clockwise seen from above.
    lower, upper: altitudes of its floor and its ceiling [m]; floor below ceiling.
    """

    polygon: ConvexPolygon
    lower: float
    upper: float

    def __init__(self, polygon: ConvexPolygon | ArrayLike, lower: float, upper: float) -> None:
        outline = polygon if isinstance(polygon, ConvexPolygon) else ConvexPolygon(polygon)
        heights = {"lower": finite("lower", lower), "upper": finite("upper", upper)}
        store(self, {"polygon": outline, **heights})
        if self.lower >= self.upper:
            bound = f"greater than lower {self.lower:g}"
            remedy = "exchange the altitudes or move them apart"
            raise InputError("upper", self.upper, bound, remedy)

    @property
    def corners(self) -> Array:
        """Corners of floor and ceiling (2 m, 3) [m]."""
        levels = np.repeat([self.lower, self.upper], len(self.polygon))
        return np.column_stack([np.tile(self.polygon.vertices, (2, 1)), levels])

    @property
    def slab(self) -> Slab:
        """Slab of this body, as in objects."""
        return Slab(Section(self.polygon.vertices), self.lower, self.upper)

    def clearance(self, points: Array) -> Clearance:
        """Return the distances of points (…, 3) [m] to the prism and the directions out of it."""
        return self.slab.clearance(points)


def check_requirements(record: Any) -> None:
    """Raise InputError unless a record's limits, separation, arena and keep-outs are such."""
    instance("limits", record.limits, Limits)
    instance("separation", record.separation, Separation)
    if record.arena is not None:
        instance("arena", record.arena, Arena)
    for k, prism in enumerate(getattr(record, "keep_out", ())):
        instance(f"keep_out[{k}]", prism, Prism)


@dataclass(frozen=True, eq=False)
class Requirements(OneLine):
    """All that a plan must satisfy at every time.

    Parameters
    ----------
    limits: limits of motion.
    separation: distances between drones and cables.
    arena: the box that the drones stay in, or None.
    keep_out: prisms that the drones stay out of.
    objects: by name, where they stand at first; obstacles to all that does not hold them.
    off: how far drones may be off [m], for which distances are wide enough but those of cables
        that hang, as these sag more.
    """

    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    keep_out: tuple[Prism, ...] = ()
    objects: Mapping[str, SolidObject] = field(default_factory=dict)
    off: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "keep_out", sequence("keep_out", self.keep_out))
        check_requirements(self)
        object.__setattr__(self, "objects", dict(self.objects))

    @property
    def floor(self) -> float:
        """Height of the ground [m]: the arena's floor, or 0 where there is no arena."""
        return 0.0 if self.arena is None else float(self.arena.lower[2])

    @property
    def with_reserve(self) -> Requirements:
        """Requirements enforced by planners: limits with reserve, distances wider by ``tracking``.

        The arena's floor stays where it is: drones stand there.
        """
        limits, off = self.limits.with_reserve, WIDER * (self.limits.tracking or 0.0)
        if not off:
            return self if limits is self.limits else replace(self, limits=limits)
        arena = self.arena
        if arena is not None:
            inward = np.array([off, off, 0.0])
            lower, upper = arena.lower + inward, arena.upper - off
            arena = Arena(lower, upper) if np.all(lower < upper) else arena
        limits = replace(limits, leg=limits.leg + 2.0 * off, tracking=0.0)
        wider = self.separation.widened(off)
        return replace(self, limits=limits, separation=wider, arena=arena, off=off)

    def flown_by(self, team: Team) -> Requirements:
        """Return the same requirements with what a team's flight controllers add to them.

        They fly up to their ``tracking`` off, unless that is stated, and tilt no farther than they
        command.
        """
        limits, tilt = self.limits, float(np.min(team.max_tilt))
        off = team.tracking if limits.tracking is None else limits.tracking
        if off == limits.tracking and limits.tilt <= tilt:
            return self
        return replace(self, limits=replace(limits, tilt=min(limits.tilt, tilt), tracking=off))

    @property
    def untimed(self) -> Requirements:
        """These requirements without a limit on the plan's duration."""
        if self.limits.duration is None:
            return self
        return replace(self, limits=replace(self.limits, duration=None))
