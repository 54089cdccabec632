"""Requirements of a plan: limits of motion, distances, the arena and keep-out volumes."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.drones.controllers import TRACKING, Tube
from hitchopt.drones.quadrotor import MODELS
from hitchopt.errors import InputError, OneLine, RequestError, UnitWarning, rounded_up
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch.losses import displacements
from hitchopt.hitch.team import Team
from hitchopt.objects import Clearance, Section, Slab, SolidObject
from hitchopt.objects.placing import check_placed
from hitchopt.slices import SLICES
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array, ByValue, check_instance, known, lazy, sequence, units
from hitchopt.values.fields import Key, documented, points, store, store_degrees, with_fields, words

ROUNDING_FACTOR = 1.0 + 2e-9
"""Factor of ``tracking`` in the planners' distances, so that rounding violates no limit."""

STANDING = "an object that stands"
HANGING = "a cable that hangs free"
LANDING = "a landing"
"""What needs the ground, in messages without one."""

OF_SLICES = ("rest_shift", "survive")  # Limits that rules of slices certify

MAX_CORNERS = 1000  # Largest number of corners of one outline in a file


@documented
@dataclass(frozen=True)
class Limits(OneLine):
    """Limits of motion; all norms are Euclidean.

    Angles may be given in degrees instead, as ``tilt_deg`` and ``body_rate_deg``; they are stored
    and read in radians.

    Raises
    ------
    InputError: a number out of its range, or an angle given twice.
    """

    speed: Annotated[float, Key(units.SPEED, "Largest speed of every drone")] = 1.0
    acceleration: Annotated[
        float, Key(units.ACCELERATION, "Largest acceleration of every drone")
    ] = 2.0
    jerk: Annotated[float, Key(units.JERK, "Largest jerk of every drone")] = 20.0
    tilt: Annotated[float, Key(units.TILT, "Largest angle of the thrust from vertical")] = (
        math.radians(45.0)
    )
    vertex_speed: Annotated[
        float, Key(units.SPEED, "Largest speed of every vertex of the hitch")
    ] = 0.5
    leg: Annotated[
        float, Key(units.LEG, "Shortest leg, vertex to drone, while the hitch holds")
    ] = 0.15
    duration: Annotated[
        float | None, Key(units.DURATION, "Largest duration of the whole plan; null: any")
    ] = None
    body_rate: Annotated[
        float | None, Key(units.BODY_RATE, "Largest turning rate of every thrust; null: any")
    ] = None
    reserve: Annotated[
        float,
        Key(
            units.SHARE,
            "Fraction of the acceleration and jerk limits that plans use; below 1, stops can begin "
            "at any time",
        ),
    ] = 1.0
    tracking: Annotated[
        float | Tube | None,
        Key(
            TRACKING,
            "Largest tracking error of all drones at which every distance is kept, a number, or "
            "level and height; null: that of the team's drones or their named flight "
            "controllers",
        ),
    ] = None
    vertex_error: Annotated[
        float | None,
        Key(
            units.VERTEX_ERROR,
            "Largest error of every vertex at rest, for the worst case of team.errors; null: any, "
            "which is reported",
            omitted=True,
        ),
    ] = None
    rest_shift: Annotated[
        float | None,
        Key(
            units.VERTEX_ERROR,
            "Largest distance from the plan at which any friction of team.cable_friction holds a "
            "vertex at rest; null: any, which is reported",
            omitted=True,
        ),
    ] = None
    swing: Annotated[
        float | None,
        Key(
            units.VERTEX_ERROR,
            "Largest distance of every vertex from the plan by the inertia of cables and loads, as "
            "estimated; null: any, which is reported",
            null=True,
            omitted=True,
        ),
    ] = 0.05
    survive: Annotated[
        str | None,
        Key(
            words("cable"),
            "What the plan survives at any time while a hitch is tied: the loss of any cable, with "
            "its two drones; null: nothing",
            omitted=True,
        ),
    ] = None
    floor: Annotated[
        float | None,
        Key(
            units.WALL,
            "Height of the ground, above which drones, loads, objects and taut or hanging cables "
            "stay; the arena's lower face if that is higher; null: none, or the arena's lower face",
            null=True,
            omitted=True,
        ),
    ] = 0.0
    tilt_deg: InitVar[float | None] = field(default=None, kw_only=True)
    body_rate_deg: InitVar[float | None] = field(default=None, kw_only=True)

    def __post_init__(self, tilt_deg: float | None, body_rate_deg: float | None) -> None:
        store(self, **vars(self))
        store_degrees(self, tilt=tilt_deg, body_rate=body_rate_deg)
        for name in OF_SLICES:
            value = getattr(self, name)
            if value is not None and not any(name in each.limits for each in SLICES):
                bound = "null: what certifies it is not installed"
                raise InputError(name, value, bound, "omit it")

    @property
    def tube(self) -> Tube:
        """The tracking error; zero if it is not limited."""
        return Tube.of(self.tracking)

    @property
    def held_at_rest(self) -> float | None:
        """The largest distance [m] at which friction may hold a vertex at rest; None for any."""
        stated = [limit for limit in (self.rest_shift, self.vertex_error) if limit is not None]
        return min(stated, default=None)

    @property
    def with_reserve(self) -> Limits:
        """The limits enforced at full rate: acceleration and jerk times the reserve."""
        if self.reserve == 1.0:
            return self
        return with_fields(
            self,
            reserve=1.0,
            acceleration=self.reserve * self.acceleration,
            jerk=self.reserve * self.jerk,
        )

    def of_clocks(self, thrust_per_mass: float) -> Limits:
        """Return the limits of clocks, which bound jerks in place of turning rates.

        A thrust turns by about the jerk over ``thrust_per_mass``, the smallest one [m/s²].
        """
        if self.body_rate is None:
            return self
        return with_fields(self, jerk=min(self.jerk, self.body_rate * thrust_per_mass))


class UnstatedAxis(float):
    """A default semi-axis [m], also in copies: drones' models with larger ones replace it."""


@documented
@dataclass(frozen=True, eq=False)
class Separation(ByValue):
    """Minimum distances between drones and cables.

    Semi-axes that are not stated are those of the drones' models, where these are larger.
    """

    radius: Annotated[
        float,
        Key(
            units.ELLIPSOID,
            "Horizontal semi-axis of a drone's ellipsoid, and distance to prisms; by default that "
            "of a named model, if it is larger",
        ),
    ] = 0.12
    height: Annotated[
        float, Key(units.ELLIPSOID, "Vertical semi-axis (Preiss et al. 2017); by default likewise")
    ] = 0.30
    cable: Annotated[
        float, Key(units.DISTANCE, "Drone to any cable part but the one that ends at it")
    ] = 0.10
    crossing: Annotated[float, Key(units.DISTANCE, "Taut parts of cables that share no clasp")] = (
        0.05
    )
    object: Annotated[
        float, Key(units.DISTANCE, "Centre lines of cables, and a held object, to objects")
    ] = 0.035

    def __init__(
        self,
        radius: float | None = None,
        height: float | None = None,
        cable: float = 0.10,
        crossing: float = 0.05,
        object: float = 0.035,
    ) -> None:
        axes = {"radius": radius, "height": height}
        stated = {
            name: axis
            for name, axis in axes.items()
            if axis is not None and not isinstance(axis, UnstatedAxis)
        }
        store(self, **stated, cable=cable, crossing=crossing, object=object)
        for name in axes.keys() - stated.keys():
            vars(self)[name] = UnstatedAxis(getattr(Separation, name))

    def for_drones(self, team: Team) -> Separation:
        """Return the distances with the semi-axes of a team's models, unless others are stated."""
        sizes = [MODELS[kind.model].separation for kind in team.quadrotor if kind.model]
        wider = {
            name: max([getattr(self, name), *(size[axis] for size in sizes)])
            for axis, name in enumerate(("radius", "height"))
            if isinstance(getattr(self, name), UnstatedAxis)
        }
        if all(getattr(self, name) == size for name, size in wider.items()):
            return self
        return with_fields(self, **wider)

    @property
    def scale(self) -> Array:
        """Scale factors (3,) [1/m]: ``separation`` is the norm of the scaled offset of drones."""
        across = 0.5 / self.radius
        upward = 0.5 / self.height
        return np.array([across, across, upward])

    def widened(self, off: float, ratio: float = 1.0) -> Separation:
        """Return distances that ensure these if drones and vertices have errors of up to ``off``.

        The ellipsoid contains the Minkowski sum of this one and an ellipsoid with semi-axes ``off``
        and ``ratio`` times as much vertically [m]. Its squared semi-axes are a² (1 + off/radius) +
        b² (1 + radius/off) for semi-axes a and b, so that its radius is radius + off. Other
        distances are between points whose heights are divided by ``ratio``.
        """
        flat_height = self.height / ratio
        squared_height = (flat_height**2 + self.radius * off) * (1.0 + off / self.radius)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnitWarning)  # these values are of the team's errors
            return Separation(
                radius=self.radius + off,
                height=math.sqrt(squared_height) * ratio,
                cable=self.cable + 2.0 * off,
                crossing=self.crossing + 2.0 * off,
                object=self.object + off,
            )


CORNER = points((3,), "x, y, z", largest=units.MAX_WALL)


@documented
@dataclass(frozen=True, eq=False)
class Arena(ByValue):
    """Box that the drones stay in."""

    lower: Annotated[Array, Key(CORNER, "Corner (3,) with the least x, y, z [m]", [-4, -4, 0])]
    upper: Annotated[Array, Key(CORNER, "Corner (3,) with the greatest x, y, z [m]", [4, 4, 3])]

    def __init__(
        self, lower: Sequence[float] | ArrayLike, upper: Sequence[float] | ArrayLike
    ) -> None:
        store(self, lower=lower, upper=upper)
        for name, corner in (("lower", self.lower), ("upper", self.upper)):
            for i, number in enumerate(corner.tolist()):
                units.WALL.check(f"{name}[{i}]", number)
        if not np.all(self.lower < self.upper):
            bound = f"greater than lower {self.lower.tolist()} on every axis"
            remedy = "swap the corners or move them apart"
            raise InputError("upper", self.upper.tolist(), bound, remedy)


@documented
@dataclass(frozen=True, eq=False)
class Prism(ByValue):
    """An upright prism that the drones stay out of, by at least ``Separation.radius``."""

    polygon: Annotated[
        ConvexPolygon,
        Key(
            points((None, 2), "x, y", 3, MAX_CORNERS, ConvexPolygon),
            "Corners [x, y] (m, 2) [m] of a convex outline, clockwise seen from above",
            [[0, 0], [0, 1], [1, 1]],
        ),
    ]
    lower: Annotated[float, Key(units.COORDINATE, "Altitude of its floor", 0.0)]
    upper: Annotated[float, Key(units.COORDINATE, "Altitude of its ceiling", 3.0)]

    def __init__(self, polygon: ConvexPolygon | ArrayLike, lower: float, upper: float) -> None:
        outline = polygon if isinstance(polygon, ConvexPolygon) else ConvexPolygon(polygon)
        store(self, polygon=outline, lower=lower, upper=upper)
        if self.lower >= self.upper:
            bound = f"greater than lower {self.lower:g}"
            remedy = "swap the altitudes or move them apart"
            raise InputError("upper", self.upper, bound, remedy)

    @lazy
    def corners(self) -> Array:
        """Corners of floor and ceiling (2 m, 3) [m]."""
        levels = np.repeat([self.lower, self.upper], len(self.polygon))
        return np.column_stack([np.tile(self.polygon.vertices, (2, 1)), levels])

    @lazy
    def slab(self) -> Slab:
        """Slab of this body, as in objects."""
        return Slab(Section(self.polygon.vertices), self.lower, self.upper)

    def as_object(self) -> SolidObject:
        """Return the prism as a fixed object."""
        base = np.append(np.mean(self.polygon.vertices, axis=0), self.lower)
        section = Section(self.polygon.vertices - base[:2])
        return SolidObject(section, upper=self.upper - self.lower, at=base, fixed=True)

    def clearance(self, points: Array) -> Clearance:
        """Return the distances of points (…, 3) [m] to the prism and the directions out of it."""
        return self.slab.clearance(points)


def check_requirements(record: Any) -> None:
    """Raise InputError unless limits, separation, arena and keep-outs have the right types."""
    check_instance("limits", record.limits, Limits)
    check_instance("separation", record.separation, Separation)
    if record.arena is not None:
        check_instance("arena", record.arena, Arena)
    for k, prism in enumerate(getattr(record, "keep_out", ())):
        check_instance(f"keep_out[{k}]", prism, Prism)


@dataclass(frozen=True, eq=False)
class Requirements(ByValue):
    """All constraints of a plan at every time.

    Parameters
    ----------
    limits: limits of motion.
    separation: distances between drones and cables.
    arena: the box that the drones stay in, or None.
    keep_out: prisms that the drones stay out of.
    objects: by name, at their initial positions; obstacles to everything that does not hold them.
    position_error: of drones [m], which the distances include. Hanging cables can be displaced
        farther and need an additional margin.
    height_ratio: that of ``Tube``, by which heights are divided in distances and legs: errors are
    this many times larger vertically.
    """

    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    keep_out: tuple[Prism, ...] = ()
    objects: Mapping[str, SolidObject] = field(default_factory=dict)
    position_error: float = 0.0
    height_ratio: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "keep_out", sequence("keep_out", self.keep_out))
        check_requirements(self)
        object.__setattr__(self, "objects", dict(self.objects))

    @property
    def floor(self) -> float | None:
        """Height of the ground [m]: the higher of ``limits.floor`` and the arena's lower face.

        None without both.
        """
        lower_face = None if self.arena is None else float(self.arena.lower[2])
        heights = [each for each in (self.limits.floor, lower_face) if each is not None]
        return max(heights, default=None)

    def ground_for(self, purpose: str) -> float:
        """Return the height of the ground [m]; RequestError names a ``purpose`` without one."""
        if self.floor is None:
            bound = f"a height [m]: {purpose} needs the ground"
            raise RequestError("limits.floor", None, bound, "set limits.floor, or add an arena")
        return self.floor

    def check_placed(self) -> None:
        """Raise InputError for an object that floats, overlaps another one or lacks the ground."""
        if any(not body.fixed for body in self.objects.values()):
            check_placed(self.objects, self.ground_for(STANDING))

    def ground_or(self, height: float) -> float:
        """Return the height of the ground, or without one another height [m]."""
        return height if self.floor is None else self.floor

    @property
    def ground_clearance(self) -> float:
        """Smallest height [m] of hanging cables above the ground.

        It is ``separation.cable``, of which only the included errors are ``height_ratio`` larger.
        """
        errors = 2.0 * self.position_error
        return self.separation.cable + (self.height_ratio - 1.0) * errors

    @property
    def height_error(self) -> float:
        """Largest vertical error of drones [m], which the distances include."""
        return self.position_error * self.height_ratio

    @property
    def error_scale(self) -> Array:
        """Factors (3,) of coordinates with which drones err equally far in all directions."""
        return np.array([1.0, 1.0, 1.0 / self.height_ratio])

    @property
    def with_reserve(self) -> Requirements:
        """Requirements enforced by planners: limits with reserve, distances wider by ``tracking``.

        The floor does not move, since drones rest there.
        """
        limits = self.limits.with_reserve
        tube = self.limits.tube
        error = ROUNDING_FACTOR * tube.level
        if not error:
            return self if limits is self.limits else replace(self, limits=limits)
        arena = self.arena
        if arena is not None:
            lower = arena.lower + np.array([error, error, 0.0])
            upper = arena.upper - np.array([error, error, error * tube.ratio])
            if np.all(lower < upper):
                arena = Arena(lower, upper)
        return replace(
            self,
            limits=with_fields(limits, leg=limits.leg + 2.0 * error, tracking=0.0),
            separation=self.separation.widened(error, tube.ratio),
            arena=arena,
            position_error=error,
            height_ratio=tube.ratio,
        )

    def with_larger_errors(self, by: float) -> Requirements:
        """Return the requirements with errors of position that are larger by a distance [m]."""
        return replace(self, position_error=self.position_error + by)

    def flown_by(self, team: Team) -> Requirements:
        """Return the requirements that include a team's tracking errors, tilt limit and sizes.

        A specified ``tracking`` takes precedence over that of the drones, and specified semi-axes
        over those of their models.
        """
        limits, separation = self.limits, self.separation.for_drones(team)
        max_tilt = float(np.min(team.max_tilt))
        tracking = team.tracking if limits.tracking is None else limits.tracking
        if limits.survive is not None:
            check_survivable(team, self)
            if limits.tracking is None:
                jump = rounded_up(float(np.max(displacements(team))), 4)
                tubes = [Tube.of(tracking), Tube.of(jump)]
                tracking = known(Tube.enclosing(tubes)).tracking
        if tracking != limits.tracking or limits.tilt > max_tilt:
            limits = with_fields(limits, tilt=min(limits.tilt, max_tilt), tracking=tracking)
        if limits is self.limits and separation is self.separation:
            return self
        return replace(self, limits=limits, separation=separation)

    def understated_tracking(self, team: Team) -> str:
        """Return a warning of ``limits.tracking`` below a team's own errors; empty without one."""
        stated = self.limits.tube
        expected = Tube.of(team.tracking)
        if stated.level >= expected.level and max(stated.height, stated.level) >= expected.height:
            return ""
        names = sorted({kind.loop.name for kind in team.quadrotor if kind.loop.name})
        source = f"with the gains of {', '.join(names)}" if names else "by their calibration"
        return (
            f"expect drones {expected} off {source}; only {stated} is certified: raise "
            "limits.tracking, unless you measured it"
        )

    @property
    def untimed(self) -> Requirements:
        """The requirements without a limit on the plan's duration."""
        if self.limits.duration is None:
            return self
        return replace(self, limits=with_fields(self.limits, duration=None))

    @property
    def in_haste(self) -> Requirements:
        """The requirements without a limit of swing: of stops, aborts and new goals in flight."""
        if self.limits.swing is None:
            return self
        return replace(self, limits=with_fields(self.limits, swing=None))


def check_survivable(team: Team, requirements: Requirements) -> None:
    """Raise InputError unless the loss of a cable can be survived by such a team."""
    key, value = "limits.survive", requirements.limits.survive
    if not team.release:
        bound = "omitted unless drones can drop the ends of their cables"
        raise InputError(key, value, bound, "set team.release: true if they can")
    if not team.has_cables or team.robots < 3:
        bound = "omitted with fewer than three cables: none holds another without one of them"
        raise InputError(key, value, bound, "omit it")
    if not np.all(np.isfinite(displacements(team))) or not np.all(team.feed_forward):
        bound = "omitted unless drones have gains, and add the pulls of their cables"
        remedy = "name team.quadrotor.controller or model, or set stiffness"
        raise InputError(key, value, bound, remedy)
    if np.any(team.load):
        bound = "omitted with loads at clasps, which would slide along their cables"
        raise InputError(key, value, bound, "omit team.load")
    if requirements.objects:
        raise refused_value(Feature.SURVIVING, Neighbour.OBJECTS, value)
