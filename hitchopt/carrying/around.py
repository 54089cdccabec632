"""Hitches around an object: their orientations, and how high and how fast they get there."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hitchopt.carrying.holds import polygon_at
from hitchopt.carrying.planner import CLOSING_SPEED
from hitchopt.carrying.polygons import (
    EDGE_MARGIN,
    HoldPolygons,
    grip_polygons,
    rest_polygons,
)
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.geometry.vectors import length, rotated
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import SolidObject
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

OBJECT_MARGIN = 0.10
"""[m] Clearance of the lowest drone over objects, in addition to ``separation.radius``."""

PLACE_TOLERANCE = 1e-6  # [m] Positions that differ by less are the same
GRIP_TURNS = 6  # Number of turns about a disc, within its grip's symmetry


class Orientation(NamedTuple):
    """A hitch around an object in one orientation."""

    polygons: HoldPolygons  # Polygons around the object and of its hold, in the object's frame
    # The polygon around it in world coordinates, with the vertices as numbered in the hitch
    around: ConvexPolygon


def orientations_around(
    name: str, team: Team, requirements: Requirements, polygon: Outline
) -> list[Orientation]:
    """Return the hitches around an object, in order of decreasing capacity.

    They are numbered for the shortest paths from a polygon. There are several if obstacles may be
    in the way of some.
    """
    body = requirements.objects[name]
    gap = requirements.separation.object + EDGE_MARGIN
    if body.rim is None:
        of_grip = grip_polygons(name, body, team, requirements, gap)
        of_object = _turned(of_grip, body, polygon)
    else:
        rests = rest_polygons(name, body, team.robots, gap)
        of_object = [_renumbered(rest, body, polygon) for rest in rests]
    obstacles = len(requirements.objects) > 1 or requirements.keep_out or requirements.arena
    return of_object if obstacles else of_object[:1]


def _turned(polygons: HoldPolygons, body: SolidObject, polygon: Outline) -> list[Orientation]:
    """Return the polygons of a grip and the one around, the nearest first.

    They are turned about a disc, and by half a turn about a section that is symmetric to it.
    """
    nearest, around = _renumbered(polygons, body, polygon)
    centre = body.section.centroid
    turned = [Orientation(nearest, around)]
    for turn in _symmetric_turns(body, len(polygon)):
        both = HoldPolygons(
            around=centre + rotated(nearest.around - centre, turn),
            clasps=centre + rotated(nearest.clasps - centre, turn),
        )
        turned.append(_renumbered(both, body, polygon, turn=False))
    return turned


def _symmetric_turns(body: SolidObject, vertices: int) -> list[float]:
    """Return other turns [rad] about an object after which its section is the same."""
    if body.section.radius is not None:
        symmetry = 2.0 * math.pi / vertices
        return [symmetry * k / GRIP_TURNS for k in (1, -1, 2, -2, 3)]
    core = body.section.core
    opposite = 2.0 * body.section.centroid - core
    distances = length(opposite[:, None] - core)
    is_symmetric = np.max(np.min(distances, axis=1)) < PLACE_TOLERANCE
    return [math.pi] if is_symmetric else []


def _renumbered(
    polygons: HoldPolygons, body: SolidObject, polygon: Outline, *, turn: bool = True
) -> Orientation:
    """Return the polygons numbered for the shortest paths of vertices, and the one around.

    With ``turn`` polygons about a disc are also turned.
    """
    start = polygon.vertices - polygon.centroid
    if turn and body.rim is None and body.section.radius is not None:
        angle = _nearest_turn(polygons.around, start) - body.yaw
        polygons = HoldPolygons(rotated(polygons.around, angle), rotated(polygons.clasps, angle))
    around = polygon_at(body, polygons.around)
    end = around.vertices - around.centroid
    squares = [np.sum((np.roll(end, -k, axis=0) - start) ** 2) for k in range(len(end))]
    shift = int(np.argmin(squares))
    numbered = HoldPolygons(
        around=np.roll(polygons.around, -shift, axis=0),
        clasps=np.roll(polygons.clasps, -shift, axis=0),
        outer=tuple(np.roll(clasps, -shift, axis=0) for clasps in polygons.outer),
    )
    return Orientation(numbered, around.renumbered(shift))


def _nearest_turn(polygon: Array, goal: Array) -> float:
    """Return the angle [rad] that turns a polygon (n, 2) [m] nearest to a goal in any numbering."""
    to_complex = np.array([1.0, 1.0j])
    vertices = polygon @ to_complex
    goals = goal @ to_complex
    products = [np.vdot(np.roll(vertices, -k), goals) for k in range(len(vertices))]
    return float(np.angle(max(products, key=abs)))


def altitude_over(hitch: Hitch, to: Outline, requirements: Requirements) -> float:
    """Return the lowest altitude [m] of a hitch that clears all objects below its way.

    That is the straight one from its polygon to another, ``to``. Its drones pass within the reach
    of both hitches.
    """
    team = hitch.team
    start = hitch.polygon.centroid
    onward = to.centroid - start
    slack = float(np.max(team.cable_length)) - float(np.min(to.edge_lengths))
    reach = max(
        float(np.max(length(hitch.drones[:, :2] - start))),
        float(np.max(length(to.vertices - to.centroid))) + slack,
    )
    sink = max(hitch.altitude - float(np.min(hitch.drones[:, 2])), 0.0)
    clearance = requirements.separation.radius + OBJECT_MARGIN + sink
    lowest = -math.inf
    for body in requirements.objects.values():
        radius = max(slab.section.circumradius for slab in body.slabs)
        ahead = (body.at[:2] - start) @ onward / max(float(onward @ onward), PLACE_TOLERANCE)
        nearest = start + np.clip(ahead, 0.0, 1.0) * onward
        if length(body.at[:2] - nearest) < reach + radius + clearance:
            lowest = max(lowest, float(body.at[2]) + body.upper + clearance)
    return lowest


def slowed_to(requirements: Requirements, speed: float) -> Requirements:
    """Return requirements with a limit of the speed [m/s] of drones and vertices."""
    limits = requirements.limits
    slow = with_fields(
        limits,
        speed=min(limits.speed, speed),
        vertex_speed=min(limits.vertex_speed, speed),
    )
    return replace(requirements, limits=slow)


def requirements_closing(requirements: Requirements, name: str) -> Requirements:
    """Return requirements at low speed without the object that cables may touch."""
    others = {other: body for other, body in requirements.objects.items() if other != name}
    return slowed_to(replace(requirements, objects=others), CLOSING_SPEED)
