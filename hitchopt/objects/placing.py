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

CONTACT_GAP = 1e-6  # [m] Largest gap between surfaces that touch
REST_DRIFT = 1e-9  # [m] Largest change of position, or of heading, of objects at rest
GRID = 121  # Number of grid points on a side of the area in which footings are sampled
DIRECTIONS = 72  # Number of directions in which footings are sampled


def in_frame(pose: Array, points: Array) -> Array:
    """Return points (…, 3) [m] in objects' frames; poses (…, 5) are x, y, z, cos and sin of yaw."""
    return _rotate(points - pose[..., :3], pose[..., 3], -pose[..., 4])


def in_world(pose: Array, points: Array) -> Array:
    """Return points (…, 3) [m] of objects' frames in the world frame; poses as in ``in_frame``."""
    return _rotate(points, pose[..., 3], pose[..., 4]) + pose[..., :3]


def _rotate(vectors: Array, c: Array, s: Array) -> Array:
    """Return vectors (…, 3) rotated about the vertical by angles with cosine and sine (…)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z + 0.0 * c], axis=-1)


def surface_below(
    objects: Mapping[str, SolidObject], poses: Array, name: str, floor: float
) -> tuple[float, str | None]:
    """Return the height [m] of the surface below an object's centre of mass, and its object.

    Objects are at poses (objects, 5). The ground is at ``floor`` [m]; its object is None.
    """
    pose_of = dict(zip(objects, poses, strict=True))
    centre, height, support = in_world(pose_of[name], objects[name].centre_of_mass), floor, None
    for other, body in objects.items():
        local, top = in_frame(pose_of[other], centre), float(pose_of[other][2]) + body.upper
        inside = body.section.clearance(local[:2])[0] <= 0.0
        if other != name and height < top <= centre[2] + CONTACT_GAP and inside:
            height, support = top, other
    return height, support


def footing(objects: Mapping[str, SolidObject], name: str) -> float:
    """Return the distance [m] of an object's centre of mass from the edge of its supports.

    Supports are the convex hull of all points of other objects that its base touches, sampled on a
    grid: the distance is too small by up to a grid step. It is infinite on the ground.
    """
    body = objects[name]
    bottom = float(body.at[2]) + body.lower
    others = (each for other, each in objects.items() if other != name)
    supports = [x for x in others if abs(float(x.at[2]) + x.upper - bottom) <= CONTACT_GAP]
    if not supports:
        return math.inf
    section, centre = body.section, body.section.centroid
    radius = float(np.max(length(section.core - centre))) + section.rounding
    steps = np.linspace(-radius, radius, GRID)
    grid = centre + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid = grid[section.clearance(grid)[0] <= 0.0]
    points = in_world(body.pose, _at_zero_height(grid))
    touching = [x.section.clearance(in_frame(x.pose, points)[:, :2])[0] <= 0.0 for x in supports]
    if not np.any(touching):
        return 0.0
    angles = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    contacts = grid[np.any(touching, axis=0)] - centre
    extents = np.stack([np.cos(angles), np.sin(angles)]).T @ contacts.T
    return float(np.min(np.max(extents, axis=1)))


def _gap_below(
    objects: Mapping[str, SolidObject], name: str, floor: float
) -> tuple[float, float, str | None]:
    """Return the gap [m] below an object, and height [m] and object as ``surface_below``."""
    surface, support = surface_below(objects, poses_of(objects), name, floor)
    return float(objects[name].at[2]) + objects[name].lower - surface, surface, support


def stacked_on(objects: Mapping[str, SolidObject], name: str, floor: float) -> list[str]:
    """Return the names of movable objects that stand on an object."""
    loose = [other for other, each in objects.items() if not each.fixed and other != name]
    below = {other: _gap_below(objects, other, floor) for other in loose}
    return [k for k, (gap, _, base) in below.items() if base == name and abs(gap) <= CONTACT_GAP]


def poses_of(objects: Mapping[str, SolidObject]) -> Array:
    """Return the poses of all objects (objects, 5)."""
    return np.array([each.pose for each in objects.values()], dtype=np.float64).reshape(-1, 5)


def check_placed(objects: Mapping[str, SolidObject], floor: float) -> None:
    """Raise InputError for an object that floats or overlaps another one."""
    for name, each in objects.items():
        if each.fixed:
            continue
        gap, surface, support = _gap_below(objects, name, floor)
        if abs(gap) > CONTACT_GAP:
            words = "the ground" if support is None else f"objects.{support}"
            heights = f"its floor at {surface:.6g} m, not {surface + gap:.6g} m"
            bound = f"such that it stands on {words}, {heights}"
            remedy = f"write {[*each.at[:2].tolist(), round(surface - each.lower, 9)]}"
            raise InputError(f"objects.{name}.at", each.at.tolist(), bound, remedy)
    check_overlaps(objects)


def check_overlaps(objects: Mapping[str, SolidObject]) -> None:
    """Raise InputError for an object that overlaps another one."""
    for (name, first), (other, second) in combinations(objects.items(), 2):
        for a, b in () if first.fixed and second.fixed else product(first.slabs, second.slabs):
            rise = second.at[2] - first.at[2]
            overlap = min(a.upper - rise - b.lower, rise + b.upper - a.lower)  # of flat rims too
            gap = section_gap(a.section, first.pose, b.section, second.pose)
            if overlap > CONTACT_GAP and gap < -CONTACT_GAP:
                bound = f"apart from objects.{other}"
                raise InputError(f"objects.{name}.at", first.at.tolist(), bound, "move one of them")


def section_gap(first: Section, first_pose: Array, second: Section, second_pose: Array) -> float:
    """Return the horizontal distance [m] of two placed sections; negative where they overlap.

    If their cores overlap, it is some depth, not the smallest one.
    """
    bodies = (first, first_pose), (second, second_pose)
    a, b = (in_world(pose, _at_zero_height(section.sides))[..., :2] for section, pose in bodies)
    gap = float(np.min(length(shortest_offset(differences(a[:, None], b[None])))))
    corners = zip(bodies, (b[0, 0], a[0, 0]), strict=True)
    local = [(x, in_frame(pose, _at_zero_height(corner))) for (x, pose), corner in corners]
    depth = min(float(section.clearance(corner[:2])[0]) for section, corner in local)
    if depth < 0.0 or gap == 0.0:
        return min(depth, -first.rounding - second.rounding, -2.0 * CONTACT_GAP)
    return gap - first.rounding - second.rounding


def _at_zero_height(points: Array) -> Array:
    """Return points (…, 2) as points (…, 3) at height 0."""
    return np.concatenate([points, np.zeros_like(points[..., :1])], axis=-1)
