"""``fit``: the hitch polygons for an object's outline, and what they would hold."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.drawings import outline_of_geometry, read_outline
from hitchopt.hitch.holding import (
    Capacity,
    Grip,
    GripTask,
    best_grip,
    grip_capacity,
    largest_tension,
    rest_capacity,
)
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.hitch.team import Quadrotor
from hitchopt.objects import Section
from hitchopt.planners.carrying.rest import ROOM, STRETCHES, HoldPolygons
from hitchopt.statics.enclosing import enclosing_polygon, inner_polygon, shortest_cable
from hitchopt.values import instance, not_negative, points, positive, whole

SAFETY = 1.5
"""Least slip load over load."""

GRIP, REST = "grip", "rest"

MOST_ROBOTS = 24
"""Largest number of robots: pairs of parts of a grip are laid out at once."""

TABLE_ROBOTS = (3, 4, 5, 6)
"""Numbers of robots that are compared, besides the one asked for."""


@dataclass(frozen=True)
class FitTask:
    """What a hitch is fitted to, as in ``fit``."""

    section: Section
    clearance: float  # [m]
    height: float  # [m]
    friction: float
    tension: float  # [N]
    cable_length: float | None  # [m], None for the shortest that suits each number of robots
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
        found = self._held(enclosing, cable)
        needed = cable if self.cable_length else self._closing_cable(found)
        longer = self._held(enclosing, needed) if needed > cable else found
        return found if isinstance(longer.grip, InfeasibleError) else longer

    def _held(self, enclosing: ConvexPolygon, cable: float) -> Holding:
        """Return what cables of a length [m] hold."""
        n, requirements = len(enclosing), self.requirements
        gripping = GripTask(
            self.section, n, cable, self.tension, self.clasp_friction, requirements, self.kind
        )
        grip: Grip | InfeasibleError = _attempt(lambda: best_grip(gripping))
        rest = _attempt(lambda: inner_polygon(self.section, n, self.clearance))
        gripped: Any = grip
        rested: Any = rest
        if isinstance(grip, Grip):
            gripped = grip_capacity(gripping, grip, self.friction, SAFETY)
        if isinstance(rest, ConvexPolygon):
            load = self.tension, self.kind, requirements, 0.5 * self.height
            rested = _attempt(lambda: rest_capacity(rest, cable, *load))
        return Holding(self, enclosing, cable, grip, rest, _capacity(gripped), _capacity(rested))

    def _closing_cable(self, found: Holding) -> float:
        """Return the shortest cables [m] at the polygon from which they close around the object.

        There ``enclose`` keeps room for where the object really is. They are no other ones where
        nothing is gripped, or drones come too close there whatever the cables.
        """
        if isinstance(found.grip, InfeasibleError):
            return found.cable_length
        closed, gap = found.grip.vertices, self.clearance + ROOM
        about = HoldPolygons.about(closed, self.section.centroid, (self.section,), gap, STRETCHES)
        needed = _attempt(lambda: shortest_cable(ConvexPolygon(about.around), self.requirements))
        return found.cable_length if isinstance(needed, InfeasibleError) else float(needed)


def _attempt(search: Callable[[], Any]) -> Any:
    """Return what is found, or why there is none."""
    try:
        return search()
    except InfeasibleError as error:
        return error


def _capacity(found: Any) -> Capacity:
    """Return a capacity: none where a limit is in the way."""
    nothing = isinstance(found, InfeasibleError)
    return Capacity(0.0, found.violations[0].constraint) if nothing else found


@dataclass(frozen=True, eq=False)
class Holding(OneLine):
    """The polygons of one number of robots around an object.

    Attributes
    ----------
    task: what they are for.
    enclosing: the polygon that is lowered around the object, with the clearance asked.
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
    """The hitch polygons for an object, and what they would hold.

    Attributes
    ----------
    section: the outline's convex hull, or the circle.
    holding: polygons for the number of robots asked for.
    others: by numbers of robots, the polygons for these, or why there are none.
    notes: what was assumed of the outline and the tension.
    """

    section: Section
    holding: Holding
    others: dict[int, Holding | InfeasibleError]
    notes: tuple[str, ...]

    @property
    def enclosing(self) -> ConvexPolygon:
        """The polygon that is lowered around the object."""
        return self.holding.enclosing

    def capacities(self, by: str) -> dict[int, Capacity | InfeasibleError]:
        """Return what each number of robots holds at most, by ``grip`` or ``rest``, or why not."""
        found = self.others.items()
        return {
            n: each if isinstance(each, InfeasibleError) else each.capacity(by) for n, each in found
        }

    def raise_if_too_heavy(self, mass: float, by: str = GRIP) -> None:
        """Raise InfeasibleError if a mass [kg] is not held by ``grip`` or ``rest``."""
        found = self.holding.capacity(by)
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
    kind = Quadrotor() if quadrotor is None else quadrotor
    limits = Limits() if limits is None else limits
    separation = Separation() if separation is None else separation
    instance("quadrotor", kind, Quadrotor)
    instance("limits", limits, Limits)
    instance("separation", separation, Separation)
    section, notes = _section_of(outline)
    requirements = Requirements(limits, separation)
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
    numbers = sorted({robots, *TABLE_ROBOTS})
    holding = task.holding(robots)
    others = {n: holding if n == robots else _attempt(partial(task.holding, n)) for n in numbers}
    return Fit(section, holding, others, tuple(notes))


def _section_of(outline: Any) -> tuple[Section, list[str]]:
    """Return the convex section of an outline, and what is to be said of it."""
    if isinstance(outline, Section):
        return outline, []
    if isinstance(outline, int | float | np.number) and not isinstance(outline, bool):
        return Section(radius=float(outline)), []
    if isinstance(outline, str | Path):
        outline = read_outline(outline)
    elif hasattr(outline, "__geo_interface__"):
        outline = outline_of_geometry(outline)
    remedy = "give points in metres, a radius, or a drawing"
    found = points("outline", outline, (3, 2), "a list of at least 3 points [x, y]", remedy)
    with contextlib.suppress(InputError):
        return Section(found), []
    try:
        hull = found[ConvexHull(found).vertices]
    except QhullError:
        bound, remedy = "an outline around an area", "give three points that are not in line"
        raise InputError("outline", found.tolist(), bound, remedy) from None
    note = f"the outline is concave: its convex hull of {len(hull)} corners is used"
    return Section(hull), [note]
