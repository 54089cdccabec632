"""Masses that rims hold: limits of drones and cables, and legs that must not cut the rim."""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.holding import Capacity, rest_capacity
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.holds import RestHold
from hitchopt.planners.carrying.polygons import HoldPolygons, rest_polygons
from hitchopt.planners.fitting import shortest_cable
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

COMPARED_ROBOTS = range(3, 9)
"""Numbers of robots that are compared where legs of others cut a rim."""

CUT_RESOLUTION = 1e-3
"""[kg] Resolution of the masses with which legs do not cut a rim."""

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
    """Return the clasps on whose unrolled legs a rim rests best.

    Candidates are compared in order of preference: the first ones whose legs do not cut the rim at
    any mass that drones bear are best, or else those that hold most.

    Parameters
    ----------
    body: the object, with a rim.
    polygons: the clasps below its rim.
    cable_length: of all cables [m].
    tension: of all cables [N].
    kind: kind of all quadrotors.
    requirements: limits and distances.
    """
    holds = list[RimHold]()
    for clasps in polygons.below_rim:
        borne = _borne(body, clasps, cable_length, tension, kind, requirements)
        team = Team(len(clasps), cable_length, tension=tension, quadrotor=kind)
        if borne.mass == 0.0 or not cuts_rim(team, body, clasps, borne.mass):
            return RimHold(clasps, borne)
        uncut = _uncut_mass(team, body, clasps, borne.mass)
        holds.append(RimHold(clasps, Capacity(uncut, RIM_BINDING)))
    return max(holds, key=lambda hold: hold.capacity.mass)


def _borne(
    body: SolidObject,
    clasps: Array,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
) -> Capacity:
    """Return the largest mass [kg] on clasps (n, 2) [m] that drones bear."""
    assert body.rim is not None
    mass_height = float(body.centre_of_mass[2]) - body.rim.height
    polygon = ConvexPolygon(clasps)
    return rest_capacity(polygon, cable_length, tension, kind, requirements, mass_height)


def cuts_rim(team: Team, body: SolidObject, clasps: Array, mass: float) -> bool:
    """Return whether unrolled legs cut an object's rim, with or without its weight.

    Parameters
    ----------
    team: with cables of equal lengths.
    body: the object, with a rim.
    clasps: (n, 2) [m], below its rim, in its frame.
    mass: of the object [kg], which the cables bear.
    """
    assert body.rim is not None
    loaded = with_fields(body, mass=max(mass, CUT_RESOLUTION))
    equal_legs = np.full(team.robots, 0.5)
    level = np.zeros(team.robots)
    try:
        RestHold(team, loaded, clasps, body.rim.height, equal_legs, level).check_rim(team.tension)
    except InfeasibleError:
        return True
    return False


def _uncut_mass(team: Team, body: SolidObject, clasps: Array, cutting: float) -> float:
    """Return the largest mass [kg] with which legs do not cut a rim, below one that makes them."""
    low, high = 0.0, cutting
    while high - low > CUT_RESOLUTION:
        middle = 0.5 * (low + high)
        if cuts_rim(team, body, clasps, middle):
            high = middle
        else:
            low = middle
    return low


def robots_that_rest(
    robots: int,
    body: SolidObject,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
    gap: float,
) -> int | None:
    """Return the number of robots, nearest to one, whose unrolled legs hold a rim; None if none do.

    Their cables are as long as given, or longer if drones need it around the object.

    Parameters
    ----------
    robots: the number that does not hold it.
    body: the object, with a rim and its mass.
    cable_length: of all cables, at least [m].
    tension: of all cables [N].
    kind: kind of all quadrotors.
    requirements: limits and distances.
    gap: distance of edges around the object [m].
    """
    others = [number for number in COMPARED_ROBOTS if number != robots]
    for number in sorted(others, key=lambda number: (abs(number - robots), number)):
        with contextlib.suppress(InfeasibleError):
            polygons = rest_polygons("object", body, number, gap)[0]
            team = Team(number, cable_length, tension=tension, quadrotor=kind)
            uncut = [
                clasps
                for clasps in polygons.below_rim
                if not cuts_rim(team, body, clasps, body.mass)
            ]
            if not uncut:
                continue
            outlines = [ConvexPolygon(polygons.around), ConvexPolygon(uncut[0])]
            needed = max(cable_length, shortest_cable(outlines, requirements))
            capacity = _borne(body, uncut[0], needed, tension, kind, requirements)
            if capacity.mass >= body.mass:
                return number
    return None
