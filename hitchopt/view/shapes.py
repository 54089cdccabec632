"""Surfaces of drones, objects and spheres; names, colours and shapes of a plan's scene.

Faces are arrays (m, 4, 3) [m] of corners, counter-clockwise seen from outside; a triangle repeats
its last corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.values import Array
from hitchopt.view.style import (
    FRAME_COLOUR,
    HOLLOW_COLOUR,
    KEEP_OUT_COLOUR,
    OBJECT_COLOUR,
    TABLE_COLOUR,
    group_colours,
)

SPAN = 0.8  # Radius of a drone with rotors as a share of its ellipsoid's radius
SEGMENTS, ROUND = 16, 32  # Numbers of corners of a rotor (even), and of a circle
PLATE = 0.012  # Thickness of a drawn rim [m], below its height


def drone_faces(radius: float, segments: int = SEGMENTS) -> tuple[Array, Array, Array]:
    """Return frame, rotors and rims of a drone about its centre, for its ellipsoid's radius [m]."""
    size = SPAN * radius
    arm, rotor, above = 0.62 * size, 0.38 * size, 0.08 * size
    quarter = np.radians([45.0, 135.0, 225.0, 315.0])
    centres = np.column_stack([arm * np.cos(quarter), arm * np.sin(quarter), np.full(4, above)])
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    boxes = [
        _prism(sides * [arm, 0.05 * size] @ [[c, s], [-s, c]], -0.04 * size, 0.04 * size)
        for c, s in zip(np.cos(quarter[:2]), np.sin(quarter[:2]), strict=True)
    ]
    boxes.append(_prism(sides * (0.22 * size), -0.12 * size, 0.12 * size))
    ring = np.column_stack([rotor * _circle(segments), np.zeros(segments)])
    k = np.arange(segments)
    hub, after = np.zeros((segments // 2, 3)), (k + 1) % segments
    disc = np.stack([hub, ring[0::2], ring[1::2], ring[after[1::2]]], axis=1)
    rim = np.stack([ring, ring[after], 1.18 * ring[after], 1.18 * ring], axis=1)
    rotors, rims = (np.concatenate([part + at for at in centres]) for part in (disc, rim))
    return np.concatenate(boxes), rotors, rims


class RigidSurface(NamedTuple):
    """A rigid surface at one place or several."""

    name: str
    faces: Array  # (m, 4, 3) [m] about its own origin
    colours: tuple[str, ...]  # one per place


class Clasp(NamedTuple):
    """A clasp: its vertex's name and index, and the index of a cable there."""

    name: str
    vertex: int
    cable: int


class GroupName(NamedTuple):
    """Name, colour and drones of a group."""

    name: str
    colour: str
    drones: slice


@dataclass(frozen=True, eq=False)
class Appearance:
    """Names, colours and shapes of a plan's drones, cables and surroundings.

    Pictures, films, the live view, reports and exported scenes share them.
    """

    drones: tuple[str, ...]  # names
    drone_colours: tuple[str, ...]
    hollow: tuple[bool, ...]  # whether a drone's rotors are drawn hollow, as for drones r
    cable_colours: tuple[str, ...]
    clasps: tuple[Clasp, ...]  # empty for a hitch that changes its robots
    groups: tuple[GroupName, ...]  # empty for a single team
    ellipsoid: tuple[float, float, float]  # semi-axes of a drone's ellipsoid [m]
    objects: tuple[RigidSurface, ...]
    keep_outs: tuple[RigidSurface, ...]  # in world coordinates, as the arena
    arena: Array  # edges (12 or 0, 2, 3) [m]

    @classmethod
    def of(cls, motion: Motion) -> Appearance:
        """Return the appearance of a plan's groups, and of other plans."""
        requirements, clasps, vertices, cables = motion.requirements, list[Clasp](), 0, 0
        names, hollow, groups = list[str](), list[bool](), list[GroupName]()
        looks = group_colours(motion)
        bodies = list(requirements.objects.items())
        for group in motion.all_groups:
            team, layout = group.motion.team, group.motion.team.layout
            first = len(names)
            names += map(group.label, team.drone_names)
            hollow += [name[0] == "r" for name in team.drone_names]
            pairs = zip(layout.clasps.tolist(), layout.ahead.tolist(), strict=True)
            groups.append(GroupName(group.name, looks[len(groups)][0][0], slice(first, len(names))))
            clasps += [
                Clasp(group.label(team.point_names[p]), vertices + p, cables + k)
                for p, k in pairs
                if not group.motion.has_ring_changes
            ]
            vertices, cables = vertices + layout.points, cables + team.robots
        for other in motion.others:
            objects_of_other = other.motion.requirements.objects.items()
            bodies += [(other.label(name), body) for name, body in objects_of_other]
        drone_shades, cable_shades = (sum(each, ()) for each in zip(*looks, strict=True))
        radius, height = requirements.separation.radius, requirements.separation.height
        objects = (
            RigidSurface(name, object_faces(body), (TABLE_COLOUR if body.fixed else OBJECT_COLOUR,))
            for name, body in bodies
        )
        keep_outs = (
            RigidSurface(f"keep_out {i}", slab_faces(prism.slab), (KEEP_OUT_COLOUR,))
            for i, prism in enumerate(requirements.keep_out)
        )
        arena = np.zeros((0, 2, 3))
        if requirements.arena is not None:
            corners = [[0, 0, 0], [1, 1, 0], [0, 1, 1], [1, 0, 1]]
            edges = [[a, [*a[:i], 1 - a[i], *a[i + 1 :]]] for a in corners for i in range(3)]
            ends = np.array([requirements.arena.lower, requirements.arena.upper])
            arena = ends[np.array(edges), np.arange(3)]
        return cls(
            tuple(names),
            drone_shades,
            tuple(hollow),
            cable_shades,
            tuple(clasps),
            tuple(each for each in groups if each.name),
            (radius, radius, height),
            tuple(objects),
            tuple(keep_outs),
            arena,
        )

    def drone_parts(self, size: float = 1.0, segments: int = SEGMENTS) -> tuple[RigidSurface, ...]:
        """Return the parts of drones, scaled by ``size``; rotors of drones r are hollow."""
        rims, pairs = self.drone_colours, zip(self.hollow, self.drone_colours, strict=True)
        rotors = tuple(HOLLOW_COLOUR if hollow else colour for hollow, colour in pairs)
        faces = drone_faces(size * self.ellipsoid[0], segments)
        colours = (FRAME_COLOUR,) * len(rims), rotors, rims
        return tuple(map(RigidSurface, ("frame", "rotors", "rims"), faces, colours))


def object_faces(body: SolidObject) -> Array:
    """Return the faces of an object about its base: its body, and its rim as a plate."""
    return np.concatenate(
        [slab_faces(Slab(s.section, min(s.lower, s.upper - PLATE), s.upper)) for s in body.slabs]
    )


def slab_faces(slab: Slab) -> Array:
    """Return the faces of a section between two heights."""
    section = slab.section
    if section.outline is None:
        return _prism(section.rounding * _circle(ROUND), slab.lower, slab.upper)
    return _prism(np.asarray(section.outline[::-1]), slab.lower, slab.upper)


def sphere_faces(size: ArrayLike) -> Array:
    """Return the faces of an ellipsoid about the origin with semi-axes (3,) or a radius [m]."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, 9), np.linspace(0, 2 * np.pi, 17), indexing="ij"
    )
    level = np.sin(polar)
    grid = np.stack([level * np.cos(around), level * np.sin(around), np.cos(polar)], axis=-1) * size
    corners = [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]]
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def subdivide(faces: Array, times: int) -> Array:
    """Return faces divided at the middles of their sides, 4**times for each."""
    for _ in range(times):
        middles = 0.5 * (faces + np.roll(faces, -1, axis=1))
        centre = np.mean(middles[:, ::2], axis=1)
        parts = [
            np.stack([faces[:, i], middles[:, i], centre, middles[:, i - 1]], axis=1)
            for i in range(4)
        ]
        faces = np.concatenate(parts)
    return faces


def normals(faces: Array) -> Array:
    """Return the unit normals (…, 3) of faces (…, 4, 3), from their diagonals."""
    first, second = faces[..., 2, :] - faces[..., 0, :], faces[..., 3, :] - faces[..., 1, :]
    return unit(np.cross(first, second))


def mesh(faces: Array) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return vertices (v, 3) [m] and triangles (f, 3) of faces."""
    corners = np.round(faces.reshape(-1, 3), 9)
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    triangles = index.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    degenerate = np.any(triangles == np.roll(triangles, 1, axis=1), axis=1)
    return vertices.astype(np.float32), triangles[~degenerate].astype(np.uint32)


def _circle(corners: int) -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _prism(corners: Array, lower: float, upper: float) -> Array:
    """Return the faces of a prism: sides, ceiling and floor as fans."""
    floor, ceiling = (np.column_stack([corners, np.full(len(corners), z)]) for z in (lower, upper))
    sides = np.stack([floor, np.roll(floor, -1, 0), np.roll(ceiling, -1, 0), ceiling], axis=1)
    k = np.arange(2, len(corners), 2)  # two triangles a face
    last = np.minimum(k + 1, len(corners) - 1)
    fan = np.column_stack([0 * k, k - 1, k, last])
    return np.concatenate([sides, ceiling[fan], floor[fan[:, ::-1]]])
