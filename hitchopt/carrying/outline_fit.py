"""``fit``: the hitch polygons for an object's outline, and their capacities.

The enclosing polygon has short edges of similar lengths at the clearance from the outline. The grip
is the first of ``grips``, the polygon of a rim that of ``grasp``. Cables are the shortest that keep
the separation of the drones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.spatial import ConvexHull

from hitchopt.carrying.grasps import (
    Heaviest,
    HoldJudge,
    hold_polygons,
    on_pillar,
    shortest_judge,
)
from hitchopt.carrying.holding import Capacity, Grip
from hitchopt.carrying.polygons import EDGE_MARGIN, HoldPolygons
from hitchopt.drones.quadrotor import Quadrotor, kinds_of
from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation, rounded_up
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.drawings import drawing_of_geometry, format_size, read_drawing
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.hitch.team import Swarm, Team
from hitchopt.motion.motion import HoldBy
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.planners.candidates import outcome
from hitchopt.values import MAX_COORDINATE, integer, points, positive, sequence
from hitchopt.values.fields import Key, Record, suggest_keywords
from hitchopt.values.units import (
    CABLE_LENGTH,
    DENSITY,
    DISTANCE,
    FRICTION,
    LENGTH,
    OBJECT_MASS,
    TENSION,
)

GRIP = "grip"  # Method of holding an object by cables that are wrapped around it
REST = "rest"  # Method of holding an object whose rim lies on the clasps
OBJECT = "object"  # Name of the object
MAX_ROBOTS = 24  # Limited by memory for pairs of parts of a grip
MAX_REACH = 0.25 * MAX_COORDINATE  # [m] Largest reach of a fit; triangles reach twice as far
TABLE_ROBOTS = (3, 4, 5, 6)  # Numbers of robots that are compared with the requested one
CENTRED = 1e-9  # Distance of a centroid from the origin that is rounding [m]
CIRCLE_ANGLES = np.pi * np.arange(24) / 12.0
CIRCLE = np.column_stack([np.cos(CIRCLE_ANGLES), -np.sin(CIRCLE_ANGLES)]) / np.cos(np.pi / 24.0)
"""Polygon around the unit circle (24, 2), clockwise, at most 0.9 % larger."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FitTask(Record):
    """Target and requirements of a fit, as arguments of ``fit``.

    Attributes without a key are ``section``, the object's outline; ``kind``, the quadrotors'; and
    ``requirements``.
    """

    section: Section
    kind: Quadrotor
    requirements: Requirements
    clearance: Annotated[
        float,
        Key(
            DISTANCE,
            "Distance of cables to the object while it is enclosed, in addition to 4.5 cm for its "
            "position error",
        ),
    ] = 0.035
    stem: Annotated[
        float | None,
        Key(LENGTH, "Radius of a round body below the outline as a rim; null: a flat tray"),
    ] = None
    height: Annotated[
        float, Key(LENGTH, "Height of the object; its centre of mass is at half of it")
    ] = 0.3
    friction: Annotated[float, Key(FRICTION, "Friction between cables and object")] = 0.5
    tension: Annotated[
        float,
        Key(
            TENSION,
            "Tension of all cables; null: the largest horizontal pull that tilt and thrust allow",
        ),
    ]
    cable_length: Annotated[
        float | None,
        Key(
            CABLE_LENGTH,
            "Length of all cables; null: for each number of robots the shortest that keep drones "
            "apart around the object and carry it",
        ),
    ] = None
    clasp_friction: Annotated[
        float,
        Key(FRICTION, "Friction between cables, which reduces the mass that is gripped"),
    ] = 0.15
    cable_density: Annotated[float, Key(DENSITY, "Mass of cables per length")] = 0.005
    mass: Annotated[
        float | None,
        Key(
            OBJECT_MASS,
            "Mass for which cables are chosen; null: half of what the tension of a regular polygon "
            "bears",
        ),
    ] = None


@dataclass(frozen=True, eq=False)
class Holding(OneLine):
    """The polygons of one number of robots around an object.

    Attributes
    ----------
    task: the request.
    robots: number of cables.
    enclosing: the polygon that ``enclose`` lowers around the object, by grip, or with a stem by
        rest, if that holds it.
    cable_length: of all cables [m].
    grip: the grip with the largest slip load, or the error if there is none.
    rest: the polygon on which the outline rests as a rim, or the error if there is none.
    grip_capacity, rest_capacity: the largest masses that are held by grip, and by rest.
    """

    task: FitTask
    robots: int
    enclosing: ConvexPolygon
    cable_length: float
    grip: Grip | InfeasibleError
    rest: ConvexPolygon | InfeasibleError
    grip_capacity: Capacity
    rest_capacity: Capacity

    def capacity(self, by: str) -> Capacity:
        """Return the largest mass that is held by ``grip`` or ``rest``."""
        return self.grip_capacity if by == GRIP else self.rest_capacity


@dataclass(frozen=True, eq=False)
class Fit(OneLine):
    """The hitch polygons for an object, and their capacities.

    Attributes
    ----------
    section: the outline's convex hull, or the circle.
    holding: polygons for the requested number of robots.
    others: polygons by number of robots, or the error if there are none.
    notes: assumptions on the outline and the tension.
    """

    section: Section
    holding: Holding
    others: dict[int, Holding | InfeasibleError]
    notes: tuple[str, ...]

    @property
    def enclosing(self) -> ConvexPolygon:
        """The polygon that is lowered around the object."""
        return self.holding.enclosing

    def capacities(self, by: str) -> dict[int, Capacity]:
        """Return the capacity of each number of robots, by ``grip`` or ``rest``."""
        return {
            n: each.capacity(by) if isinstance(each, Holding) else _zero_capacity(each)
            for n, each in self.others.items()
        }

    def raise_if_too_heavy(self, mass: float, by: str = GRIP) -> None:
        """Raise InfeasibleError if a mass [kg] is not held by ``grip`` or ``rest``."""
        capacity = self.holding.capacity(by)
        if mass > capacity.mass:
            remedy = f"at {capacity.mass:.3g} kg {capacity.binding} binds: {capacity.suggested}"
            raise InfeasibleError([Violation(by, mass, capacity.mass, "max", "kg", (), "", remedy)])


@suggest_keywords
def fit(
    outline: Any,
    robots: int,
    *,
    clearance: float = FitTask.clearance,
    stem: float | None = None,
    height: float = FitTask.height,
    friction: float = FitTask.friction,
    tension: float | None = None,
    cable_length: float | None = None,
    clasp_friction: float = FitTask.clasp_friction,
    cable_density: float = FitTask.cable_density,
    mass: float | None = None,
    quadrotor: Quadrotor | str | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
    compared: Sequence[int] = TABLE_ROBOTS,
) -> Fit:
    """Return the hitch polygons for an object's outline, and the largest masses that they hold.

    Parameters
    ----------
    outline: points (m, 2) [m], a circle's radius [m], a ``Section``, a geometry of shapely, or the
        path of a GeoJSON or CSV file. The convex hull is used where it is concave.
    robots: number n of robots.
    clearance: distance of cables to the object while it is enclosed [m], in addition to 4.5 cm for
        its position error.
    stem: radius of a round body below the outline as a rim [m]; None for a flat tray.
    height: of the object [m], its centre of mass at half of it.
    friction: coefficient between cables and object.
    tension: of all cables [N]; None for the largest horizontal pull that tilt and thrust allow.
    cable_length: [m]; None for the shortest that keep drones apart around the object and carry it.
    clasp_friction: coefficient between cables, which reduces the mass that is gripped.
    cable_density: of the cables [kg/m].
    mass: for which cables are chosen [kg]; None for half of what the tension of a regular polygon
        bears.
    quadrotor: kind or name of a model; limits, separation: the default ones if None.
    compared: other numbers of robots whose largest masses are reported.

    Raises
    ------
    InputError: a number out of its range, or an invalid outline.
    InfeasibleError: no hitch encloses the object, or the drones cannot hold the tension.
    """
    integer("robots", robots, 3, MAX_ROBOTS)
    for number in sequence("compared", compared):
        integer("compared", number, 3, MAX_ROBOTS)
    (kind,) = kinds_of(quadrotor, 1, "object")
    stated = Requirements(limits or Limits(), separation or Separation())
    requirements = stated.flown_by(Swarm(1, quadrotor=kind)).with_reserve
    section, notes = _section_of(outline)
    limit, binding = kind.level_pull(requirements.limits.tilt)
    if tension is None:
        tension = limit
        notes.append(f"tension {limit:.4g} N, the largest horizontal pull: {binding} binds")
    if positive("tension", tension) > limit:
        remedy = Capacity(limit, binding).suggested
        raise InfeasibleError([Violation(binding, tension, limit, "max", "N", (), "", remedy)])
    task = FitTask(
        section=section,
        kind=kind,
        requirements=requirements,
        clearance=clearance,
        stem=stem,
        height=height,
        friction=friction,
        tension=tension,
        cable_length=cable_length,
        clasp_friction=clasp_friction,
        cable_density=cable_density,
        mass=mass,
    )
    reach = float(np.max(np.abs(section.core))) + section.rounding + clearance
    if reach > MAX_REACH:
        bound = f"such that cables stay within {MAX_REACH:g} m of the origin"
        raise InputError("clearance", clearance, bound, "use metres, and points near the origin")
    numbers = sorted({robots, *compared})
    holding = _holding(task, robots)
    others = {n: holding if n == robots else outcome(partial(_holding, task, n)) for n in numbers}
    return Fit(section, holding, others, tuple(notes))


def _section_of(outline: Any) -> tuple[Section, list[str]]:
    """Return the convex section of an outline, and notes on it."""
    notes = list[str]()
    source = ""
    if isinstance(outline, int | float | np.number) and not isinstance(outline, bool):
        outline = Section(radius=float(outline))
    if isinstance(outline, Section) and outline.radius is not None:
        return outline, [f"outline: circle of radius {outline.radius:.4g} m"]
    if isinstance(outline, str | Path):
        drawing = read_drawing(outline)
        source = f", of {Path(outline).name}"
        outline = drawing.outline
        notes = list(drawing.notes)
    elif hasattr(outline, "__geo_interface__"):
        drawing = drawing_of_geometry(outline)
        outline = drawing.outline
        notes = list(drawing.notes)
    remedy = "specify points in metres, a radius, or a drawing"
    corners = outline.core if isinstance(outline, Section) else outline
    corners = points("outline", corners, (3, 2), "a list of at least 3 points [x, y]", remedy)
    notes = [f"outline: {format_size(corners)}, {len(corners)} corners{source}", *notes]
    try:
        return Section(corners), notes
    except InputError:
        if np.linalg.matrix_rank(corners - corners[0]) < 2:  # around no area
            raise
    hull = corners[ConvexHull(corners).vertices]
    note = f"the outline is concave: its convex hull of {len(hull)} corners is used"
    return Section(hull), [*notes, note]


@dataclass(frozen=True, eq=False)
class _JudgedHold:
    """A method of holding an object, and the heaviest one that it holds."""

    judge: HoldJudge  # Judge of the method, with its team and polygons
    heaviest: Heaviest  # The largest mass that it holds

    @property
    def cable_length(self) -> float:
        """Length of all cables [m]."""
        return float(self.judge.team.cable_length[0])

    @property
    def polygons(self) -> HoldPolygons:
        """The polygons around the object, and of the clasps."""
        return self.judge.planner.state.polygons


def _holding(task: FitTask, robots: int) -> Holding:
    """Return the polygons for a number of robots; InfeasibleError if none encloses the object.

    Cables without a stated length are those of the grip, or of the rest of an object with a stem.
    """
    preferred, other = (HoldBy.GRIP, HoldBy.REST)[:: 1 if task.stem is None else -1]
    first = outcome(partial(_judged_hold, task, robots, preferred, task.cable_length))
    cable = task.cable_length if isinstance(first, InfeasibleError) else first.cable_length
    second = outcome(partial(_judged_hold, task, robots, other, cable))
    held = [each for each in (first, second) if isinstance(each, _JudgedHold)]
    if isinstance(first, InfeasibleError) and not held:
        raise first
    grip, rest = (first, second) if preferred is HoldBy.GRIP else (second, first)
    return Holding(
        task,
        robots,
        ConvexPolygon(held[0].polygons.around),
        held[0].cable_length,
        _grip_of(task, grip),
        _rest_of(rest),
        _capacity_of(grip),
        _capacity_of(rest),
    )


def _judged_hold(task: FitTask, robots: int, by: HoldBy, cable_length: float | None) -> _JudgedHold:
    """Return how a method holds the object; cables are the shortest that carry the mass, or stated.

    InfeasibleError: no polygon encloses and holds the object, or cables do not fit around it.
    """
    requirements = replace(task.requirements, objects=_objects(task, by))
    placeholder = 1.0  # A team states a length; ``shortest_judge`` does not use it
    team = Team(
        robots,
        placeholder if cable_length is None else cable_length,
        cable_density=task.cable_density,
        cable_friction=task.clasp_friction,
        tension=task.tension,
        quadrotor=task.kind,
    )
    gap = task.clearance + EDGE_MARGIN
    if cable_length is None:
        judge = shortest_judge(OBJECT, team, requirements, by, gap, task.mass)
    else:
        polygons = hold_polygons(OBJECT, team, requirements, by, gap)
        _require_length(ConvexPolygon(polygons.around), cable_length, requirements)
        judge = HoldJudge.of(OBJECT, team, requirements, polygons)
    return _JudgedHold(judge, judge.heaviest)


def _require_length(around: ConvexPolygon, cable: float, requirements: Requirements) -> None:
    """Raise InfeasibleError if cables of a length [m] are too short for the polygon around."""
    max_edge = cable - 2.0 * requirements.limits.leg
    k = int(np.argmax(around.edge_lengths))
    longest = float(around.edge_lengths[k])
    if longest > max_edge:
        needed = rounded_up(longest + cable - max_edge, 3)
        remedy = f"use cables of {needed:.3g} m or more, or more robots"
        violation = Violation("legs", longest, max_edge, "max", "m", (f"edge {k}",), "", remedy)
        raise InfeasibleError([violation], "the enclosing polygon does not fit the cables")


def _grip_of(task: FitTask, held: _JudgedHold | InfeasibleError) -> Grip | InfeasibleError:
    """Return the grip that is held, or the error that there is none."""
    if isinstance(held, InfeasibleError):
        return held
    clasps = held.polygons.clasps
    cable = held.cable_length
    return Grip.of(task.section, clasps, cable, task.tension, task.clasp_friction)


def _rest_of(held: _JudgedHold | InfeasibleError) -> ConvexPolygon | InfeasibleError:
    """Return the clasps below the rim that hold most, or the error that there are none."""
    if isinstance(held, InfeasibleError):
        return held
    hold = held.heaviest.hold
    return ConvexPolygon(held.polygons.clasps if hold is None else hold.polygon)


def _capacity_of(held: _JudgedHold | InfeasibleError) -> Capacity:
    """Return the largest mass that is held; an error means none."""
    return _zero_capacity(held) if isinstance(held, InfeasibleError) else held.heaviest.capacity


def _objects(task: FitTask, by: HoldBy) -> dict[str, SolidObject]:
    """Return the object to be held: to rest with its outline as a rim, above a stem or as a tray.

    A flat tray stands on a slim pillar.
    """
    friction = task.friction
    if by is HoldBy.GRIP:
        return {OBJECT: SolidObject(task.section, 0.0, task.height, friction=friction)}
    if task.stem is None:
        rim = Rim(task.section, 0.0)
        tray = SolidObject(task.section, 0.0, task.height, friction=friction, rim=rim)
        return on_pillar(OBJECT, tray)
    centre = task.section.centroid
    is_centred = bool(np.all(np.abs(centre) < CENTRED))
    stem = Section(radius=task.stem) if is_centred else Section(centre + task.stem * CIRCLE)
    rim = Rim(task.section, task.height)
    return {OBJECT: SolidObject(stem, 0.0, task.height, friction=friction, rim=rim)}


def _zero_capacity(error: InfeasibleError) -> Capacity:
    """Return the zero capacity of a hitch that violates a limit without a load."""
    return Capacity(0.0, error.violations[0].constraint)
