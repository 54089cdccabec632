"""``fit``: the hitch polygons for an object's outline, and what they would hold."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.drawings import object_outline, outline_of_geometry
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.hitch.team import Quadrotor
from hitchopt.holding.capacity import Capacity, rest_capacity
from hitchopt.holding.grip import Grip, GripTask, best_grip, grip_capacity, largest_tension
from hitchopt.objects import Section
from hitchopt.planners.carrying.rest import ROOM, STRETCHES, HoldPolygons
from hitchopt.statics.enclosing import enclosing_polygon, inner_polygon, shortest_cable
from hitchopt.values import Array, instance, not_negative, points, positive, whole


def section_of(outline: Any) -> tuple[Array | None, Section, list[str]]:
    """Return the outline as given, its convex section, and what is to be said of it."""
    if isinstance(outline, Section):
        return outline.outline, outline, []
    if isinstance(outline, int | float | np.number) and not isinstance(outline, bool):
        return None, Section(radius=float(outline)), []
    if isinstance(outline, str | Path):
        found = object_outline(outline)
    elif hasattr(outline, "__geo_interface__"):
        found = outline_of_geometry(outline)
    else:
        remedy = "give points in metres, a radius, or a drawing"
        found = points("outline", outline, (3, 2), "a list of at least 3 points [x, y]", remedy)
    found = points("outline", found, (3, 2), "points [x, y]", "write [[x, y], …] in metres")
    with contextlib.suppress(InputError):
        return found, Section(found), []
    try:
        hull = found[ConvexHull(found).vertices]
    except QhullError:
        bound, remedy = "an outline around an area", "give three points that are not in line"
        raise InputError("outline", found.tolist(), bound, remedy) from None
    note = f"the outline is concave: its convex hull of {len(hull)} corners is used"
    return found, Section(hull), [note]


SAFETY = 1.5
"""Least slip load over load."""

GRIP, REST = "grip", "rest"

MOST_ROBOTS = 24
"""Largest number of robots: pairs of parts of a grip are laid out at once."""

LENGTHENED = 3
"""Most times that cables are made longer, each time with the best grip for them."""

TABLE_ROBOTS = (3, 4, 5, 6)
"""Numbers of robots that are compared, besides the one asked for."""


@dataclass(frozen=True)
class FitTask:
    """What a hitch is fitted to.

    Parameters
    ----------
    section: convex section of the object.
    clearance: distance of cables to it while it is enclosed, and of vertices inside of its rim [m].
    height: of the object [m]; its centre of mass is at half of it.
    friction: coefficient between cables and object.
    tension: of all cables [N].
    cable_length: of all cables [m], or None for the shortest that suits each number of robots.
    clasp_friction: coefficient of cables on each other.
    kind: of all drones.
    requirements: limits and distances.
    """

    section: Section
    clearance: float
    height: float
    friction: float
    tension: float
    cable_length: float | None
    clasp_friction: float
    kind: Quadrotor
    requirements: Requirements

    def holding(self, robots: int) -> Holding:
        """Return the polygons for a number of robots.

        Raises
        ------
        InfeasibleError: nothing encloses the object.
        """
        enclosing = enclosing_polygon(self.section, robots, self.clearance)
        cable = self.cable_length or shortest_cable(enclosing, self.requirements)
        least = cable - 2.0 * self.requirements.limits.leg
        k = int(np.argmax(enclosing.edge_lengths))
        longest = float(enclosing.edge_lengths[k])
        if longest > least:
            remedy = f"use cables of {longest + cable - least:.3g} m or more, or more robots"
            broken = Violation("legs", longest, least, "max", "m", (f"edge {k}",), "", remedy)
            raise InfeasibleError([broken], "the enclosing polygon does not fit the cables")
        found = Holding(self, enclosing, cable)
        for _ in range(0 if self.cable_length else LENGTHENED):
            needed = found.closing_cable
            longer = Holding(self, enclosing, max(needed, found.cable_length))
            if needed <= found.cable_length or isinstance(longer.grip, InfeasibleError):
                break
            found = longer
        return found


@dataclass(frozen=True, eq=False)
class Holding(OneLine):
    """The polygons of one number of robots around an object.

    Attributes
    ----------
    task: what they are for.
    enclosing: the polygon that is lowered around the object, with the clearance asked.
    cable_length: of all cables [m].
    """

    task: FitTask
    enclosing: ConvexPolygon
    cable_length: float

    @property
    def robots(self) -> int:
        """Number of cables."""
        return len(self.enclosing)

    @cached_property
    def grip(self) -> Grip | InfeasibleError:
        """The grip with the largest slip load, or why there is none."""
        try:
            return best_grip(self._grip_task)
        except InfeasibleError as error:
            return error

    @property
    def closing_cable(self) -> float:
        """The shortest cables [m] at the polygon from which they close around the object.

        There ``enclose`` keeps room for where the object really is. They are no other ones where
        nothing is gripped, or drones come too close there whatever the cables.
        """
        if isinstance(self.grip, InfeasibleError):
            return self.cable_length
        section, gap = self.task.section, self.task.clearance + ROOM
        closed, centre = self.grip.vertices, section.centroid
        around = HoldPolygons.about(closed, centre, (section,), gap, STRETCHES).around
        try:
            return shortest_cable(ConvexPolygon(around), self.task.requirements)
        except InfeasibleError:
            return self.cable_length

    @cached_property
    def rest(self) -> ConvexPolygon | InfeasibleError:
        """The polygon on which the outline rests, as of a rim, or why there is none."""
        try:
            return inner_polygon(self.task.section, self.robots, self.task.clearance)
        except InfeasibleError as error:
            return error

    @cached_property
    def grip_capacity(self) -> Capacity:
        """The largest mass that is gripped."""
        if isinstance(self.grip, InfeasibleError):
            return Capacity(0.0, self.grip.violations[0].constraint)
        return grip_capacity(self._grip_task, self.grip, self.task.friction, SAFETY)

    @cached_property
    def rest_capacity(self) -> Capacity:
        """The largest mass that rests on the edges."""
        if isinstance(self.rest, InfeasibleError):
            return Capacity(0.0, self.rest.violations[0].constraint)
        task = self.task
        try:
            return rest_capacity(
                self.rest, self.cable_length, task.tension, task.kind, task.requirements,
                0.5 * task.height,
            )  # fmt: skip
        except InfeasibleError as error:
            return Capacity(0.0, error.violations[0].constraint)

    @property
    def _grip_task(self) -> GripTask:
        task = self.task
        return GripTask(
            task.section, self.robots, self.cable_length, task.tension, task.clasp_friction,
            task.requirements, task.kind,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Fit(OneLine):
    """The hitch polygons for an object, and what they would hold.

    Attributes
    ----------
    outline: (m, 2) [m], as given; None of a circle.
    section: its convex hull, or the circle.
    holding: polygons for the number of robots asked for.
    others: by numbers of robots, the polygons for these, or why there are none.
    notes: what was assumed of the outline and the tension.
    """

    outline: Array | None
    section: Section
    holding: Holding
    others: dict[int, Holding | InfeasibleError]
    notes: tuple[str, ...]

    @property
    def enclosing(self) -> ConvexPolygon:
        """The polygon that is lowered around the object."""
        return self.holding.enclosing

    @property
    def grip(self) -> Grip | InfeasibleError:
        """The grip with the largest slip load, or why there is none."""
        return self.holding.grip

    @property
    def rest(self) -> ConvexPolygon | InfeasibleError:
        """The polygon on which the outline rests, as of a rim, or why there is none."""
        return self.holding.rest

    def capacities(self, by: str) -> dict[int, Capacity | InfeasibleError]:
        """Return what each number of robots holds at most, by ``grip`` or ``rest``, or why not."""
        return {
            n: each
            if isinstance(each, InfeasibleError)
            else (each.grip_capacity if by == GRIP else each.rest_capacity)
            for n, each in self.others.items()
        }

    def raise_if_too_heavy(self, mass: float, by: str = GRIP) -> None:
        """Raise InfeasibleError if a mass [kg] is not held by ``grip`` or ``rest``."""
        found = self.holding.grip_capacity if by == GRIP else self.holding.rest_capacity
        if mass > found.mass:
            remedy = f"at {found.mass:.3g} kg {found.binding} binds: {found.suggested}"
            raise InfeasibleError([Violation(by, mass, found.mass, "max", "kg", (), "", remedy)])


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
    quadrotor: Quadrotor | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
) -> Fit:
    """Return the hitch polygons for an object's outline, and the largest masses that they hold.

    Parameters
    ----------
    outline: points (m, 2) [m], a circle's radius [m], a ``Section``, a geometry of shapely, or the
        path of an SVG, DXF, GeoJSON or CSV file. The convex hull is used where it is concave.
    robots: number n of robots.
    clearance: distance of cables to the object while it is enclosed [m]; vertices inside of a rim
        keep it to the rim's edge.
    height: of the object [m], its centre of mass at half of it.
    friction: coefficient between cables and object.
    tension: of all cables [N]; None for the largest level pull that tilt and thrust allow.
    cable_length: [m]; None for the shortest that keeps drones apart around the object.
    clasp_friction: coefficient of cables on each other: at its worst it lowers what is gripped.
    quadrotor, limits, separation: the default ones if None.

    Raises
    ------
    InputError: a number out of its range, or an outline that is none.
    InfeasibleError: no hitch encloses the object, or the drones cannot hold the tension.
    """
    if whole("robots", robots, 3) > MOST_ROBOTS:
        raise InputError("robots", robots, f"a whole number from 3 to {MOST_ROBOTS}", "use three")
    for key, value, expected in (
        ("quadrotor", quadrotor, Quadrotor),
        ("limits", limits, Limits),
        ("separation", separation, Separation),
    ):
        if value is not None:
            instance(key, value, expected)
    given, section, notes = section_of(outline)
    kind = quadrotor or Quadrotor()
    requirements = Requirements(limits or Limits(), separation or Separation())
    most, binding = largest_tension(requirements, kind)
    if tension is None:
        tension = most
        notes.append(f"tension {most:.4g} N, the largest level pull: {binding} binds")
    if positive("tension", tension) > most:
        name = "limits.tilt_deg" if binding == "tilt" else "quadrotor.max_thrust"
        remedy = f"raise {name}, or lower the tension"
        raise InfeasibleError([Violation(binding, tension, most, "max", "N", (), "", remedy)])
    task = FitTask(
        section,
        not_negative("clearance", clearance),
        positive("height", height),
        not_negative("friction", friction),
        float(tension),
        None if cable_length is None else positive("cable_length", cable_length),
        not_negative("clasp_friction", clasp_friction),
        kind,
        requirements,
    )
    holding = task.holding(robots)
    others: dict[int, Holding | InfeasibleError] = {}
    for n in sorted({robots, *TABLE_ROBOTS}):
        try:
            others[n] = holding if n == robots else task.holding(n)
        except InfeasibleError as error:
            others[n] = error
    return Fit(given, section, holding, others, tuple(notes))
