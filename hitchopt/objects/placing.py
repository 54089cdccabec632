"""Placed objects: frames, supports, footings and overlaps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations, product

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.objects.bodies import Section, SolidObject
from hitchopt.values import Array

TOUCH = 1e-6
"""[m] Surfaces that are no farther apart touch."""

STILL = 1e-9
"""[m] Objects that move by no more, or whose headings change by no more, stand still."""

GRID, DIRECTIONS = 121, 72
"""Points on a side, and directions, in which footings are sampled."""


def in_frame(pose: Array, points: Array) -> Array:
    """Return points (…, 3) [m] as seen from objects with poses (…, 5): x, y, z, cos and sin yaw."""
    away = points - pose[..., :3]
    return _turned(away, pose[..., 3], -pose[..., 4])


def in_world(pose: Array, points: Array) -> Array:
    """Return points (…, 3) [m] in objects' frames as seen from the world; poses as above."""
    return _turned(points, pose[..., 3], pose[..., 4]) + pose[..., :3]


def _turned(vectors: Array, c: Array, s: Array) -> Array:
    """Return vectors (…, 3) turned about the vertical by angles of cosine and sine (…)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z + 0.0 * c], axis=-1)


def surface_below(
    objects: Mapping[str, SolidObject], poses: Array, name: str, floor: float
) -> tuple[float, str | None]:
    """Return the height [m] of the surface below an object's centre of mass, and its object.

    Objects are at poses (objects, 5), the ground is at ``floor`` [m] and has no name.
    """
    places = dict(zip(objects, poses, strict=True))
    centre, height, under = in_world(places[name], objects[name].centre_of_mass), floor, None
    for other, each in objects.items():
        seen, top = in_frame(places[other], centre), float(places[other][2]) + each.upper
        above = height < top <= centre[2] + TOUCH and each.section.clearance(seen[:2])[0] <= 0.0
        if other != name and above:
            height, under = top, other
    return height, under


def footing(objects: Mapping[str, SolidObject], name: str) -> float:
    """Return the distance [m] of an object's centre of mass within the edges of its supports.

    It is the least distance, from above, to the edge of the hull of all that its base meets,
    sampled on a grid and low by up to a step of it; infinite on the ground.
    """
    body = objects[name]
    bottom = float(body.at[2]) + body.lower
    others = [each for other, each in objects.items() if other != name]
    below = [each for each in others if abs(float(each.at[2]) + each.upper - bottom) <= TOUCH]
    if not below:
        return math.inf
    section, centre = body.section, body.section.centroid
    reach = float(np.max(length(section.core - centre))) + section.rounding
    steps = np.linspace(-reach, reach, GRID)
    grid = centre + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid = grid[section.clearance(grid)[0] <= 0.0]
    places = in_world(body.pose, _level(grid))
    met = [each.section.clearance(in_frame(each.pose, places)[:, :2])[0] <= 0.0 for each in below]
    if not np.any(met):
        return 0.0
    angles = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    along = np.stack([np.cos(angles), np.sin(angles)]).T @ (grid - centre)[np.any(met, axis=0)].T
    return float(np.min(np.max(along, axis=1)))


def _gap_below(
    objects: Mapping[str, SolidObject], name: str, floor: float
) -> tuple[float, float, str | None]:
    """Return the gap [m] below an object, the height [m] of the surface there, and its object."""
    surface, under = surface_below(objects, poses_of(objects), name, floor)
    return float(objects[name].at[2]) + objects[name].lower - surface, surface, under


def stacked_on(objects: Mapping[str, SolidObject], name: str, floor: float) -> list[str]:
    """Return the names of loose objects that stand on one."""
    loose = [other for other, each in objects.items() if not each.fixed and other != name]
    gaps = [(other, _gap_below(objects, other, floor)) for other in loose]
    return [other for other, (gap, _, under) in gaps if under == name and abs(gap) <= TOUCH]


def poses_of(objects: Mapping[str, SolidObject]) -> Array:
    """Return the poses of all objects (objects, 5)."""
    return np.array([each.pose for each in objects.values()], dtype=np.float64).reshape(-1, 5)


def check_placed(objects: Mapping[str, SolidObject], floor: float) -> None:
    """Raise InputError for an object that floats or stands in another one."""
    for name, each in objects.items():
        if each.fixed:
            continue
        gap, surface, under = _gap_below(objects, name, floor)
        if abs(gap) > TOUCH:
            support = "the ground" if under is None else f"objects.{under}"
            heights = f"its floor at {surface:.6g} m not {surface + gap:.6g} m"
            bound = f"such that it stands on {support}, {heights}"
            remedy = f"write {[*each.at[:2].tolist(), round(surface - each.lower, 9)]}"
            raise InputError(f"objects.{name}.at", each.at.tolist(), bound, remedy)
    check_apart(objects)


def check_apart(objects: Mapping[str, SolidObject]) -> None:
    """Raise InputError for an object that stands in another one."""
    for (name, one), (other, two) in combinations(objects.items(), 2):
        for a, b in () if one.fixed and two.fixed else product(one.slabs, two.slabs):
            rise = two.at[2] - one.at[2]
            overlap = min(a.upper - rise - b.lower, rise + b.upper - a.lower)  # of flat rims too
            apart = sections_apart(a.section, one.pose, b.section, two.pose)
            if overlap > TOUCH and apart < -TOUCH:  # they share more than surfaces
                bound = f"apart from objects.{other}"
                raise InputError(f"objects.{name}.at", one.at.tolist(), bound, "move one of them")


def sections_apart(first: Section, here: Array, second: Section, there: Array) -> float:
    """Return the distance [m] of two placed sections, seen from above; negative where they meet.

    If their cores meet, it is some depth, not the least.
    """
    both = (first, here), (second, there)
    a, b = (in_world(pose, _level(section.sides))[..., :2] for section, pose in both)
    each = differences(a[:, None], b[None])
    apart = float(np.min(length(shortest_offset(each))))
    ends = (first, here, b[0, 0]), (second, there, a[0, 0])
    within = min(
        float(section.clearance(in_frame(pose, _level(end))[:2])[0]) for section, pose, end in ends
    )
    if within < 0.0 or apart == 0.0:
        return min(within, -first.rounding - second.rounding, -2.0 * TOUCH)
    return apart - first.rounding - second.rounding


def _level(places: Array) -> Array:
    """Return points (…, 2) as points (…, 3) at height 0."""
    return np.concatenate([places, np.zeros_like(places[..., :1])], axis=-1)
