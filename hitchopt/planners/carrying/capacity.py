"""Masses that unrolled legs hold by a rim: what drones bear, and legs that must not cut the rim.

Cables are weightless here, with equal lengths and tensions.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.forces import if_balanced
from hitchopt.hitch.holding import Capacity, rest_capacity
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import SolidObject
from hitchopt.planners.candidates import Candidate, first_feasible
from hitchopt.planners.carrying.holds import RestHold
from hitchopt.planners.carrying.polygons import HoldPolygons, rest_polygons
from hitchopt.planners.fitting import shortest_cable
from hitchopt.values import Array, known
from hitchopt.values.fields import with_fields

COMPARED_ROBOTS = range(3, 9)
"""Numbers of robots that are tried where the legs of a team cut a rim."""

CUT_RESOLUTION = 1e-3
"""[kg] Resolution of the largest mass with which legs do not cut a rim."""

RIM_BINDING = "object_clearance"
"""The check that binds where legs cut a rim."""


class RimHold(NamedTuple):
    """Clasps below a rim, and what they hold."""

    clasps: Array
    """(n, 2) [m], in the object's frame."""

    capacity: Capacity
    """The largest mass on them."""


def best_rim_hold(
    body: SolidObject,
    polygons: HoldPolygons,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
) -> RimHold:
    """Return the clasps below a rim that hold it best, and the largest mass on them.

    They are the preferred ones if drones bear less than makes their legs cut the rim, or else those
    of all candidates that hold most.

    Parameters
    ----------
    body: the object, with a rim.
    polygons: the clasps below its rim.
    cable_length: of all cables [m].
    tension: of all cables [N].
    kind: kind of all quadrotors.
    requirements: limits and distances.
    """
    load = cable_length, tension, kind, requirements
    preferred, *others = polygons.below_rim
    hold = RimHold(preferred, _capacity(body, preferred, *load))
    if hold.capacity.binding != RIM_BINDING:
        return hold
    holds = [hold, *(RimHold(clasps, _capacity(body, clasps, *load)) for clasps in others)]
    return max(holds, key=lambda hold: hold.capacity.mass)


def _capacity(
    body: SolidObject,
    clasps: Array,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
) -> Capacity:
    """Return the largest mass on clasps (n, 2) [m] that drones bear without cutting the rim."""
    borne = _borne(body, clasps, cable_length, tension, kind, requirements)
    team = Team(len(clasps), cable_length, tension=tension, quadrotor=kind)
    if borne.mass == 0.0 or not cuts_rim(team, body, clasps, borne.mass):
        return borne
    return Capacity(_uncut_mass(team, body, clasps, borne.mass), RIM_BINDING)


def _borne(
    body: SolidObject,
    clasps: Array,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
) -> Capacity:
    """Return the largest mass [kg] on clasps (n, 2) [m] that drones bear."""
    mass_height = float(body.centre_of_mass[2]) - known(body.rim).height
    polygon = ConvexPolygon(clasps)
    return rest_capacity(polygon, cable_length, tension, kind, requirements, mass_height)


def cuts_rim(team: Team, body: SolidObject, clasps: Array, mass: float) -> bool:
    """Return whether legs cut an object's rim, with its weight or without.

    Cables that cannot bear the mass count as cutting.

    Parameters
    ----------
    team: with cables of equal lengths.
    body: the object, with a rim.
    clasps: (n, 2) [m], below its rim, in its frame.
    mass: of the object [kg].
    """
    height = known(body.rim).height
    loaded = with_fields(body, mass=max(mass, CUT_RESOLUTION))
    equal_legs = np.full(team.robots, 0.5)
    level = np.zeros(team.robots)
    hold = RestHold(team, loaded, clasps, height, equal_legs, level)
    return if_balanced(lambda: hold.rim_violation(team.tension) is not None, True)


def _uncut_mass(team: Team, body: SolidObject, clasps: Array, cutting: float) -> float:
    """Return the largest mass [kg] with which legs do not cut a rim, less than one that does."""
    low, high = 0.0, cutting
    while high - low > CUT_RESOLUTION:
        middle = 0.5 * (low + high)
        if cuts_rim(team, body, clasps, middle):
            high = middle
        else:
            low = middle
    return low


class RimTeam(NamedTuple):
    """A team that holds an object by its rim."""

    robots: int
    """Number of robots."""

    cable_length: float
    """Length of their cables [m]."""


def team_for_rim(
    robots: int,
    body: SolidObject,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
    gap: float,
) -> RimTeam | None:
    """Return a team of another size that holds an object by its rim at rest; None without one.

    Its size is the nearest to that of the team that does not. Cables are as long as that team's, or
    as long as its drones require around the object.

    Parameters
    ----------
    robots: size of the team that does not hold the object.
    body: the object, with a rim and its mass.
    cable_length: of that team's cables [m].
    tension: of all cables [N].
    kind: kind of all quadrotors.
    requirements: limits and distances.
    gap: distance of edges around the object [m].
    """

    def holding(number: int) -> RimTeam | None:
        """Return the team of a size if it holds the object on one of its polygons."""
        polygons = rest_polygons("object", body, number, gap)[0]
        team = Team(number, cable_length, tension=tension, quadrotor=kind)
        for clasps in polygons.below_rim:
            if cuts_rim(team, body, clasps, body.mass):
                continue
            outlines = [ConvexPolygon(polygons.around), ConvexPolygon(clasps)]
            needed = max(cable_length, shortest_cable(outlines, requirements))
            if _borne(body, clasps, needed, tension, kind, requirements).mass >= body.mass:
                return RimTeam(number, needed)
        return None

    others = [number for number in COMPARED_ROBOTS if number != robots]
    nearest_first = sorted(others, key=lambda number: (abs(number - robots), number))
    sizes = (Candidate("team", partial(holding, number)) for number in nearest_first)
    teams = (first_feasible([size], None) for size in sizes)
    return next(filter(None, teams), None)
