"""``fit``: the hitch polygons for an object's outline, and their capacities.

Around the outline goes a polygon of short edges, much alike, that keep the clearance. The
grip is ``holding.best_grip``; a rim rests on the polygon that ``grasp`` takes. Cables are
the shortest with which drones keep apart.
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
from hitchopt.geometry.drawings import drawing_of_geometry, read_drawing, size_in_words
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.holding import Capacity, Grip, grip_capacity, rest_capacity
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.hitch.slack_split import (
    LIMIT_MARGIN,
    SPREAD_MARGIN,
    LegTask,
    reference_margin,
    split_slack,
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
SAFETY = 1.5  # Least slip load over load
MOST_ROBOTS = 24  # Pairs of parts of a grip are laid out at once
TABLE_ROBOTS = (3, 4, 5, 6)  # Numbers of robots that are compared with the requested one

# Regular polygons are turned by so many parts of their symmetry, and stretched in so many
# directions in addition to those of the section's sides, by these ratios over the section's own
AXES, TURNS, PROPORTIONS = 24, 16, np.geomspace(0.25, 4.0, 41)

LEAST_TURN, LEAST_EDGE = 0.6, 0.5  # Smallest exterior angle and smallest edge, over their means

# Sizes and margins that differ by less are the same: drones in one place are not 3e-16 apart
ROUNDING = 1e-9

# Step of cable lengths [m]; steps between candidates with legs that are not balanced; and the
# longest candidates beyond the length that legs need [m]
CENTIMETRE, STRIDE, LONGEST = 0.01, 20, 1.0


@dataclass(frozen=True)
class FitTask:
    """Target and requirements of a fit, as arguments of ``fit``."""

    section: Section
    clearance: float  # [m]
    height: float  # [m]
    friction: float
    tension: float  # [N]
    cable_length: float | None  # [m], None for the shortest that suits each number of robots
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
    grip: the grip with the largest slip load, or why there is none.
    rest: the polygon on which the outline rests, as of a rim, or why there is none.
    grip_capacity, rest_capacity: the largest masses that are gripped, and rest on the edges.
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
    others: by numbers of robots, the polygons for these, or why there are none.
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
            n: each.capacity(by) if isinstance(each, Holding) else _none(each)
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
    clasp_friction: coefficient of cables on each other: at its worst it lowers what is gripped.
    quadrotor: kind or name of a model; limits, separation: the default ones if None.

    Raises
    ------
    InputError: a number out of its range, or an outline that is none.
    InfeasibleError: no hitch encloses the object, or the drones cannot hold the tension.
    """
    integer("robots", robots, 3, MOST_ROBOTS)
    (kind,) = kinds_of(quadrotor, 1, "object")
    own = Requirements(limits or Limits(), separation or Separation())
    requirements = own.flown_by(Swarm(1, quadrotor=kind)).with_reserve
    section, notes = _section_of(outline)
    most, binding = kind.level_pull(requirements.limits.tilt)
    if tension is None:
        tension = most
        notes.append(f"tension {most:.4g} N, the largest level pull: {binding} binds")
    if positive("tension", tension) > most:
        remedy = Capacity(most, binding).suggested
        raise InfeasibleError([Violation(binding, tension, most, "max", "N", (), "", remedy)])
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
    notes = [f"outline: {size_in_words(corners)}, {len(corners)} corners{source}", *notes]
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
    least = cable - 2.0 * task.requirements.limits.leg
    k = int(np.argmax(enclosing.edge_lengths))
    longest = float(enclosing.edge_lengths[k])
    if longest > least:
        remedy = f"use cables of {longest + cable - least:.3g} m or more, or more robots"
        broken = Violation("legs", longest, least, "max", "m", (f"edge {k}",), "", remedy)
        raise InfeasibleError([broken], "the enclosing polygon does not fit the cables")
    holding = _held(task, enclosing, cable)
    if task.cable_length is None and isinstance(holding.grip, Grip):
        # ``enclose`` keeps a margin for errors of the object's pose around the closed grip.
        sections, gap = (task.section,), task.clearance + EDGE_MARGIN
        closed, centre = holding.grip.vertices, task.section.centroid
        around = ConvexPolygon(
            HoldPolygons.about(closed, centre, sections, gap, GRIP_STRETCHES).around
        )
        needed = _attempt(lambda: shortest_cable(around, task.requirements))
        if isinstance(needed, float) and needed > cable:
            longer = _held(task, enclosing, needed)
            return longer if isinstance(longer.grip, Grip) else holding
    return holding


def _held(task: FitTask, enclosing: ConvexPolygon, cable: float) -> Holding:
    """Return the polygons for cables of a length [m]."""
    n, section, requirements = len(enclosing), task.section, task.requirements
    gripping = GripTask(
        section, n, cable, task.tension, task.clasp_friction, requirements, task.kind
    )

    def resting() -> ConvexPolygon:
        body = SolidObject(section, 0.0, task.height, rim=Rim(section, 0.0))
        return ConvexPolygon(rest_polygons("outline", body, n, task.clearance).closed)

    grip, rest = _attempt(lambda: best_grip(gripping)), _attempt(resting)
    capacities = [grip, rest]
    if isinstance(grip, Grip):
        capacities[0] = grip_capacity(grip, task.kind, task.friction, SAFETY)
    if isinstance(rest, ConvexPolygon):
        load = task.tension, task.kind, requirements, 0.5 * task.height
        capacities[1] = _attempt(lambda: rest_capacity(rest, cable, *load))
    gripped, rested = (each if isinstance(each, Capacity) else _none(each) for each in capacities)
    return Holding(task, enclosing, cable, grip, rest, gripped, rested)


def _none(error: InfeasibleError) -> Capacity:
    """Return the capacity of a hitch that breaks a limit without a load."""
    return Capacity(0.0, error.violations[0].constraint)


def _attempt(search: Callable[[], Any]) -> Any:
    """Return the result of a search, or the error that refuses it."""
    try:
        return search()
    except InfeasibleError as error:
        return error


def enclosing_polygon(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return an n-gon of short edges, much alike, that keep a distance [m] to a section.

    Edges face as those of regular polygons that are turned, and stretched in proportion to the
    section's widths, and keep just the distance; of these n-gons it has the least sum of squares of
    edges. InfeasibleError: all have flat corners or short edges, as around a narrow section.
    """
    sides = np.roll(section.core, -1, axis=0) - section.core
    angles = np.append(math.pi * np.arange(AXES) / AXES, np.arctan2(sides[:, 1], sides[:, 0]))
    c, s = np.cos(angles), np.sin(angles)
    axes = np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2)
    widths = 0.5 * (section.support(axes) + section.support(-axes)) + clearance
    ratios = np.column_stack([np.sqrt(PROPORTIONS), 1.0 / np.sqrt(PROPORTIONS)])
    turns = 2.0 * math.pi / n * (np.arange(TURNS)[:, None] / TURNS - np.arange(n))
    regular = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    shapes = np.einsum("aj,kj,tnj,aji->aktni", widths, ratios, regular, axes).reshape(-1, n, 2)
    edges = unit(np.roll(shapes, -1, axis=-2) - shapes)
    outward = np.stack([-edges[..., 1], edges[..., 0]], axis=-1)
    far = section.support(outward) + clearance
    pairs = np.stack([np.roll(outward, 1, axis=-2), outward], axis=-2)
    reaches = np.stack([np.roll(far, 1, axis=-1), far], axis=-1)
    corners = np.linalg.solve(pairs, reaches[..., None])[..., 0]
    onward = np.roll(corners, -1, axis=-2) - corners
    before, sizes = np.roll(onward, 1, axis=-2), length(onward)
    right = before[..., 1] * onward[..., 0] - before[..., 0] * onward[..., 1]
    turned = np.arctan2(right, dot(before, onward))
    good = np.isclose(np.sum(turned, axis=-1), 2.0 * math.pi)
    good &= np.all(turned >= LEAST_TURN * 2.0 * math.pi / n, axis=-1)
    good &= np.min(sizes, axis=-1) >= LEAST_EDGE * np.mean(sizes, axis=-1)
    good &= np.all(dot(onward, edges) > 0.0, axis=-1)
    if not np.any(good):
        broken = Violation("convexity", n, n - 1, "max", "edges", (), "", "use fewer robots")
        raise InfeasibleError([broken], "the section is too narrow for so many edges around it")
    squares = np.where(good, np.sum(onward**2, axis=(-2, -1)), np.inf)
    return ConvexPolygon(corners[np.argmax(squares <= (1.0 + ROUNDING) * np.min(squares))])


def shortest_cable(polygon: ConvexPolygon, requirements: Requirements) -> float:
    """Return the shortest cables [m], in whole centimetres, whose balanced legs are ``spread``.

    If none are, the length with the largest margin over all slack splits.
    InfeasibleError: none of up to a metre more than legs need keep drones apart.
    """
    longest, leg = float(np.max(polygon.edge_lengths)), requirements.limits.leg
    first = math.ceil((longest + 2.0 * LIMIT_MARGIN * leg) / CENTIMETRE)
    lengths = np.arange(first, first + round(LONGEST / CENTIMETRE)) / 100.0
    for cables, balanced in ((lengths, True), (lengths[::STRIDE], False)):
        best, shortest = 0.0, 0.0
        for cable in cables.tolist():
            team = Team(len(polygon), cable)
            shape = polygon.vertices[None], balanced_legs(team, polygon)[None]
            task = LegTask(team, requirements, *shape, leg, SPREAD_MARGIN)
            margin = reference_margin(task) if balanced else split_slack(task).margin
            if min(margin, SPREAD_MARGIN) > best + ROUNDING:
                best, shortest = min(margin, SPREAD_MARGIN), cable
            if best >= SPREAD_MARGIN:
                break
        if best >= LIMIT_MARGIN:
            return shortest
    remedy = f"{'use fewer robots, or ' if len(polygon) > 3 else ''}change the clearance"
    broken = Violation("separation", best, LIMIT_MARGIN, "min", "ratio", (), "", remedy)
    raise InfeasibleError([broken], "no cable length keeps drones around the object apart")
