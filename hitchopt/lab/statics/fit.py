"""``fit``: the hitch polygons for an object's outline, and their capacities.

The enclosing polygon has short edges of similar lengths at the clearance from the outline. The grip
is that of ``best_grip``, the polygon of a rim that of ``grasp``. Cables are the shortest that keep
the separation of the drones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.drawings import drawing_of_geometry, format_size, read_drawing
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.holding import Capacity, Grip, grip_capacity, rest_capacity
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.hitch.slack_split import (
    LIMIT_MARGIN,
    SPREAD_MARGIN,
    LegTask,
)
from hitchopt.hitch.team import Quadrotor, Swarm, Team, kinds_of
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.planners.carrying.polygons import (
    EDGE_MARGIN,
    GRIP_STRETCHES,
    GripTask,
    HoldPolygons,
    best_grip,
    rest_polygons,
)
from hitchopt.values import integer, nonnegative, points, positive

GRIP, REST = "grip", "rest"
SAFETY = 1.5  # Smallest ratio of slip load to load
MAX_ROBOTS = 24  # Limited by memory for pairs of parts of a grip
TABLE_ROBOTS = (3, 4, 5, 6)  # Numbers of robots that are compared with the requested one

# Candidate polygons: directions of stretch besides those of the section's sides, rotations within a
# period of symmetry, and aspect ratios over the section's own
AXES, ROTATIONS, ASPECT_RATIOS = 24, 16, np.geomspace(0.25, 4.0, 41)

MIN_TURN, MIN_EDGE = 0.6, 0.5  # Smallest exterior angle and smallest edge, over their means
ROUNDING = 1e-9  # Tolerance within which lengths or margins are equal

# Step of cable lengths [m], stride of candidates with unbalanced legs, and largest length beyond
# the one that legs need [m]
CENTIMETRE, STRIDE, MAX_EXTRA_LENGTH = 0.01, 20, 1.0


@dataclass(frozen=True)
class FitTask:
    """Target and requirements of a fit, as arguments of ``fit``."""

    section: Section
    clearance: float  # [m]
    height: float  # [m]
    friction: float
    tension: float  # [N]
    cable_length: float | None  # [m], None for the shortest feasible one of each number of robots
    clasp_friction: float
    kind: Quadrotor
    requirements: Requirements


@dataclass(frozen=True, eq=False)
class Holding(OneLine):
    """The polygons of one number of robots around an object.

    Attributes
    ----------
    task: the request.
    enclosing: the polygon that is lowered around the object, with the clearance.
    cable_length: of all cables [m].
    grip: the grip with the largest slip load, or the error without one.
    rest: the polygon on which the outline rests as a rim, or the error without one.
    grip_capacity, rest_capacity: the largest masses that are held by grip, and by rest.
    """

    task: FitTask
    enclosing: ConvexPolygon
    cable_length: float
    grip: Grip | InfeasibleError
    rest: ConvexPolygon | InfeasibleError
    grip_capacity: Capacity
    rest_capacity: Capacity

    @property
    def robots(self) -> int:
        """Number of cables."""
        return len(self.enclosing)

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
    others: polygons by number of robots, or the error without any.
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


def fit(
    outline: Any,
    robots: int,
    *,
    clearance: float = 0.035,
    height: float = 0.3,
    friction: float = 0.5,
    tension: float | None = None,
    cable_length: float | None = None,
    clasp_friction: float = 0.15,
    quadrotor: Quadrotor | str | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
) -> Fit:
    """Return the hitch polygons for an object's outline, and the largest masses that they hold.

    Parameters
    ----------
    outline: points (m, 2) [m], a circle's radius [m], a ``Section``, a geometry of shapely, or the
        path of an SVG, DXF, GeoJSON or CSV file. The convex hull is used where it is concave.
    robots: number n of robots.
    clearance: distance of cables to the object while it is enclosed [m].
    height: of the object [m], its centre of mass at half of it.
    friction: coefficient between cables and object.
    tension: of all cables [N]; None for the largest level pull that tilt and thrust allow.
    cable_length: [m]; None for the shortest that keeps drones apart around the object.
    clasp_friction: coefficient between cables, which reduces the mass that is gripped.
    quadrotor: kind or name of a model; limits, separation: the default ones if None.

    Raises
    ------
    InputError: a number out of its range, or an invalid outline.
    InfeasibleError: no hitch encloses the object, or the drones cannot hold the tension.
    """
    integer("robots", robots, 3, MAX_ROBOTS)
    (kind,) = kinds_of(quadrotor, 1, "object")
    stated = Requirements(limits or Limits(), separation or Separation())
    requirements = stated.flown_by(Swarm(1, quadrotor=kind)).with_reserve
    section, notes = _section_of(outline)
    limit, binding = kind.level_pull(requirements.limits.tilt)
    if tension is None:
        tension = limit
        notes.append(f"tension {limit:.4g} N, the largest level pull: {binding} binds")
    if positive("tension", tension) > limit:
        remedy = Capacity(limit, binding).suggested
        raise InfeasibleError([Violation(binding, tension, limit, "max", "N", (), "", remedy)])
    task = FitTask(
        section,
        nonnegative("clearance", clearance),
        positive("height", height),
        nonnegative("friction", friction),
        float(tension),
        None if cable_length is None else positive("cable_length", cable_length),
        nonnegative("clasp_friction", clasp_friction),
        kind,
        requirements,
    )
    numbers = sorted({robots, *TABLE_ROBOTS})
    holding = _holding(task, robots)
    others = {n: holding if n == robots else _attempt(partial(_holding, task, n)) for n in numbers}
    return Fit(section, holding, others, tuple(notes))


def _section_of(outline: Any) -> tuple[Section, list[str]]:
    """Return the convex section of an outline, and notes on it."""
    notes, source = list[str](), ""
    if isinstance(outline, int | float | np.number) and not isinstance(outline, bool):
        outline = Section(radius=float(outline))
    if isinstance(outline, Section) and outline.radius is not None:
        return outline, [f"outline: circle of radius {outline.radius:.4g} m"]
    if isinstance(outline, str | Path):
        drawing, source = read_drawing(outline), f", of {Path(outline).name}"
        outline, notes = drawing.outline, list(drawing.notes)
    elif hasattr(outline, "__geo_interface__"):
        drawing = drawing_of_geometry(outline)
        outline, notes = drawing.outline, list(drawing.notes)
    remedy = "give points in metres, a radius, or a drawing"
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


def _holding(task: FitTask, robots: int) -> Holding:
    """Return the polygons for a number of robots; InfeasibleError if none encloses the object."""
    enclosing = enclosing_polygon(task.section, robots, task.clearance)
    cable = task.cable_length or shortest_cable(enclosing, task.requirements)
    max_edge = cable - 2.0 * task.requirements.limits.leg
    k = int(np.argmax(enclosing.edge_lengths))
    longest = float(enclosing.edge_lengths[k])
    if longest > max_edge:
        remedy = f"use cables of {longest + cable - max_edge:.3g} m or more, or more robots"
        violation = Violation("legs", longest, max_edge, "max", "m", (f"edge {k}",), "", remedy)
        raise InfeasibleError([violation], "the enclosing polygon does not fit the cables")
    holding = _polygons_for_cable(task, enclosing, cable)
    if task.cable_length is None and isinstance(holding.grip, Grip):
        # ``enclose`` adds a margin for errors of the object's pose around the closed grip
        sections, gap = (task.section,), task.clearance + EDGE_MARGIN
        closed, centre = holding.grip.vertices, task.section.centroid
        enclosure = HoldPolygons.about(closed, centre, sections, gap, GRIP_STRETCHES).around
        needed = _attempt(lambda: shortest_cable(ConvexPolygon(enclosure), task.requirements))
        if isinstance(needed, float) and needed > cable:
            longer = _polygons_for_cable(task, enclosing, needed)
            return longer if isinstance(longer.grip, Grip) else holding
    return holding


def _polygons_for_cable(task: FitTask, enclosing: ConvexPolygon, cable: float) -> Holding:
    """Return the polygons for a cable length [m]."""
    n, section, requirements = len(enclosing), task.section, task.requirements
    gripping = GripTask(
        section, n, cable, task.tension, task.clasp_friction, requirements, task.kind
    )

    def resting() -> ConvexPolygon:
        body = SolidObject(section, 0.0, task.height, rim=Rim(section, 0.0))
        return ConvexPolygon(rest_polygons("outline", body, n, task.clearance).clasps)

    grip, rest = _attempt(lambda: best_grip(gripping)), _attempt(resting)
    capacities = [grip, rest]
    if isinstance(grip, Grip):
        capacities[0] = grip_capacity(grip, task.kind, task.friction, SAFETY)
    if isinstance(rest, ConvexPolygon):
        load = task.tension, task.kind, requirements, 0.5 * task.height
        capacities[1] = _attempt(lambda: rest_capacity(rest, cable, *load))
    gripped, rested = (x if isinstance(x, Capacity) else _zero_capacity(x) for x in capacities)
    return Holding(task, enclosing, cable, grip, rest, gripped, rested)


def _zero_capacity(error: InfeasibleError) -> Capacity:
    """Return the zero capacity of a hitch that violates a limit without a load."""
    return Capacity(0.0, error.violations[0].constraint)


def _attempt(search: Callable[[], Any]) -> Any:
    """Return the result of a search, or its error."""
    try:
        return search()
    except InfeasibleError as error:
        return error


def enclosing_polygon(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return an n-gon of short edges of similar lengths at a distance [m] from a section.

    Candidates have the edge directions of regular polygons, rotated and stretched in proportion to
    the section's widths. The one with the least sum of squared edge lengths is taken.
    InfeasibleError: all have flat corners or short edges, as around a narrow section.
    """
    sides = np.roll(section.core, -1, axis=0) - section.core
    angles = np.append(math.pi * np.arange(AXES) / AXES, np.arctan2(sides[:, 1], sides[:, 0]))
    c, s = np.cos(angles), np.sin(angles)
    axes = np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2)
    widths = 0.5 * (section.support(axes) + section.support(-axes)) + clearance
    ratios = np.column_stack([np.sqrt(ASPECT_RATIOS), 1.0 / np.sqrt(ASPECT_RATIOS)])
    turns = 2.0 * math.pi / n * (np.arange(ROTATIONS)[:, None] / ROTATIONS - np.arange(n))
    regular = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    shapes = np.einsum("aj,kj,tnj,aji->aktni", widths, ratios, regular, axes).reshape(-1, n, 2)
    edges = unit(np.roll(shapes, -1, axis=-2) - shapes)
    outward = np.stack([-edges[..., 1], edges[..., 0]], axis=-1)
    distances = section.support(outward) + clearance
    pairs = np.stack([np.roll(outward, 1, axis=-2), outward], axis=-2)
    reaches = np.stack([np.roll(distances, 1, axis=-1), distances], axis=-1)
    corners = np.linalg.solve(pairs, reaches[..., None])[..., 0]
    onward = np.roll(corners, -1, axis=-2) - corners
    previous, sizes = np.roll(onward, 1, axis=-2), length(onward)
    right = previous[..., 1] * onward[..., 0] - previous[..., 0] * onward[..., 1]
    turned = np.arctan2(right, dot(previous, onward))
    feasible = np.isclose(np.sum(turned, axis=-1), 2.0 * math.pi)
    feasible &= np.all(turned >= MIN_TURN * 2.0 * math.pi / n, axis=-1)
    feasible &= np.min(sizes, axis=-1) >= MIN_EDGE * np.mean(sizes, axis=-1)
    feasible &= np.all(dot(onward, edges) > 0.0, axis=-1)
    if not np.any(feasible):
        violation = Violation("convexity", n, n - 1, "max", "edges", (), "", "use fewer robots")
        raise InfeasibleError([violation], "the section is too narrow for so many edges around it")
    squares = np.where(feasible, np.sum(onward**2, axis=(-2, -1)), np.inf)
    return ConvexPolygon(corners[np.argmax(squares <= (1.0 + ROUNDING) * np.min(squares))])


def shortest_cable(polygon: ConvexPolygon, requirements: Requirements) -> float:
    """Return the shortest cable length [m], in centimetres, with well separated balanced legs.

    If there is none, return the length with the largest margin over all slack splits.
    InfeasibleError: no length up to MAX_EXTRA_LENGTH keeps the separation of the drones.
    """
    longest, leg = float(np.max(polygon.edge_lengths)), requirements.limits.leg
    first = math.ceil((longest + 2.0 * LIMIT_MARGIN * leg) / CENTIMETRE)
    lengths = np.arange(first, first + round(MAX_EXTRA_LENGTH / CENTIMETRE)) / 100.0
    for cables, balanced in ((lengths, True), (lengths[::STRIDE], False)):
        best, shortest = 0.0, 0.0
        for cable in cables.tolist():
            team = Team(len(polygon), cable)
            shape = polygon.vertices[None], balanced_legs(team, polygon)[None]
            task = LegTask(team, requirements, *shape, leg, SPREAD_MARGIN)
            margin = task.reference_margin() if balanced else task.split().margin
            if min(margin, SPREAD_MARGIN) > best + ROUNDING:
                best, shortest = min(margin, SPREAD_MARGIN), cable
            if best >= SPREAD_MARGIN:
                break
        if best >= LIMIT_MARGIN:
            return shortest
    remedy = f"{'use fewer robots, or ' if len(polygon) > 3 else ''}change the clearance"
    violation = Violation("separation", best, LIMIT_MARGIN, "min", "ratio", (), "", remedy)
    raise InfeasibleError([violation], "no cable length separates the drones around the object")
