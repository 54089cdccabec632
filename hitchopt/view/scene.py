"""Scenes of plans over time: drones, cables, forces and objects, for pictures, films and pages.

A ghost is the scene of another plan, or of a simulated or evaluated flight. Faces of surfaces are
arrays (m, 4, 3) [m] of corners, counter-clockwise seen from outside; a triangle repeats its last
corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import FileError
from hitchopt.geometry.vectors import unit
from hitchopt.motion.flight import Flight
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import states_at
from hitchopt.objects import Slab, SolidObject
from hitchopt.storage.archive import PLAN, READ_ERRORS, RECORDING, read_arrays
from hitchopt.values import Array
from hitchopt.view.cables import MIN_RADIUS, POINTS, THICKNESS, cable_curves
from hitchopt.view.style import (
    FRAME_COLOUR,
    HOLLOW_COLOUR,
    KEEP_OUT_COLOUR,
    OBJECT_COLOUR,
    TABLE_COLOUR,
    team_colours,
)

MAX_SAMPLES = 1_000_000  # Maximum number of coordinates in a scene
MIN_TIMES = 48  # Minimum number of times besides the ends of phases
MAX_RATE = 30.0  # Maximum rate of times [Hz]
PER_DRONE = 11  # Number of a drone's coordinates at a time
# Prefixes of names of cables in ``where`` of a check
CABLE_PREFIXES = ("cable ", "c", "q-leg ", "r-leg ")


@dataclass(frozen=True, eq=False)
class Moment:
    """Places and forces at a time, or at several times if arrays have a leading axis of times."""

    drones: Array  # positions (N, 3) [m]
    quaternions: Array  # attitudes (N, 4), w, x, y, z
    thrusts: Array  # (N,) [N]
    cable_forces: Array  # (N, 3) [N], on the drones
    cables: Array  # (n, POINTS, 3) [m]
    objects: Array  # (objects, 7) positions of their bases [m], and quaternions


@dataclass(frozen=True, eq=False)
class Scene(Moment):
    """Samples of a plan over time: the arrays of ``Moment`` (times, …)."""

    flight: Flight  # the plan, with limits, arena, keep-outs and objects
    t: Array  # (times,) [s] from its start, including the ends of all phases
    radius: float  # radius of drawn cables [m]

    @cached_property
    def appearance(self) -> Appearance:
        """Names, colours and shapes."""
        return Appearance.of(self.flight)

    @property
    def ground(self) -> float:
        """Height of the ground [m]; without one, that of the lowest drone."""
        return self.flight.requirements.ground_or(float(np.min(self.drones[..., 2])))

    def at(self, time: float) -> Moment:
        """Return the scene at a time [s], interpolated between its samples."""
        i = int(np.clip(np.searchsorted(self.t, time, side="right"), 1, len(self.t) - 1))
        share = float(np.clip((time - self.t[i - 1]) / (self.t[i] - self.t[i - 1]), 0.0, 1.0))
        arrays = [getattr(self, field.name) for field in fields(Moment)]
        return Moment(*((1.0 - share) * array[i - 1] + share * array[i] for array in arrays))


def scene_of(flight: Flight, samples: int = MAX_SAMPLES) -> Scene:
    """Return the scene of a plan at even times and at the ends of its phases.

    ``samples`` is the maximum number of coordinates, which determines the number of times.
    """
    teams = [each.motion.team for each in flight.all_teams]
    size = sum(PER_DRONE * team.drones + 3 * POINTS * team.robots for team in teams)
    count = int(np.clip(samples // size, MIN_TIMES, MAX_RATE * flight.duration + 2))
    ends = [phase.end for phase in flight.phases]
    times = np.concatenate([np.linspace(0.0, flight.duration, count), ends])
    return scene_at(flight, np.unique(np.clip(np.round(times, 6), 0.0, flight.duration)))


def scene_at(flight: Flight, t: Array, thickness: float = THICKNESS) -> Scene:
    """Return the scene of a plan, with other plans, at ascending times (times,) [s].

    ``thickness`` is the radius of a drawn cable as a fraction of the scene's extent.
    """
    begin = flight.drones.breaks[0]
    rows = list[Any]()
    radii = list[float]()
    poses = [flight.poses.at(begin + np.minimum(t, flight.duration))]
    for each in flight.all_teams:
        own = each.motion
        is_other = each in flight.others
        states = states_at(own, np.clip(begin + t - own.drones.breaks[0], 0.0, own.duration))
        cables, radius = cable_curves(own, states, thickness)
        thrusts = np.linalg.norm(states.thrusts(own.team), axis=-1)
        rows.append((states.positions, states.quaternions, thrusts, states.cable_forces, cables))
        radii += [radius] * (own.team.has_cables or len(flight.all_teams) == 1)
        poses += [states.object_poses] * is_other
    pose = np.concatenate(poses, axis=1)
    half = 0.5 * np.unwrap(np.arctan2(pose[..., 4], pose[..., 3]), axis=0)[..., None]
    turns = [np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)]
    drones, attitudes, thrusts, forces, curves = (
        np.concatenate(each, axis=1) for each in zip(*rows, strict=True)
    )
    objects = np.concatenate([pose[..., :3], *turns], axis=-1)
    radius = min(radii, default=MIN_RADIUS)
    return Scene(drones, attitudes, thrusts, forces, curves, objects, flight, t, radius)


def ghost_scene(path: Path, flight: Flight) -> Scene:
    """Return the scene of another plan, or of a simulated or evaluated flight of a plan ``flight``.

    ``path`` is a recording or a plan, or the directory of either. Raises FileError if the file is
    missing or damaged, or if the flight is another team's.
    """
    if path.is_dir():
        names = [name for name in (RECORDING, PLAN) if (path / name).exists()]
        if not names:
            raise FileError(
                f"{path}: contains neither {RECORDING} nor {PLAN}; name another directory"
            )
        path = path / names[0]
    if path.name != RECORDING:
        return scene_of(read_plan(path))
    try:
        arrays = read_arrays(path, ("t", "nodes", "cables", "poses"))
    except READ_ERRORS as error:
        raise FileError(f"{path}: not the recording of a flight: {error}") from error
    first, t = arrays["cables"], arrays["t"]
    if (
        len(first) != sum(each.motion.team.robots for each in flight.teams) + 1
        or np.sum(t >= 0.0) < 2
    ):
        raise FileError(f"{path}: a flight of {len(first) - 1} cables; name one of this plan")
    return recorded_scene(flight, t, arrays["nodes"], first, arrays["poses"])


def recorded_scene(
    flight: Flight, t: Array, nodes: NDArray[Any], first: NDArray[Any], poses: NDArray[Any]
) -> Scene:
    """Return the scene of a simulated flight; attitudes of drones are not recorded.

    Groups without cables, and other plans, are at their planned positions.

    Parameters
    ----------
    flight: the plan that was flown.
    t: (frames,) [s], negative while cables settle.
    nodes: (frames, nodes, 3) [m], in the order of cables, with drones at their ends.
    first: (n + 1,), first node of each cable, and the number of nodes.
    poses: (frames, objects, 7) positions of the objects' bases [m], and quaternions.
    """
    in_flight = t >= 0.0
    indices = [np.linspace(a, b - 1, POINTS).round().astype(int) for a, b in pairwise(first)]
    curves = np.stack([nodes[in_flight][:, x] for x in indices], axis=1).astype(np.float64)
    plan = scene_at(flight, t[in_flight])
    recorded = [x.motion.team.has_cables and x not in flight.others for x in flight.all_teams]
    pairs = zip(flight.all_teams, recorded, strict=True)
    teams = [(each.motion.team, is_recorded) for each, is_recorded in pairs]
    drones = np.concatenate([np.full(team.drones, x) for team, x in teams])
    cables = np.concatenate([np.full(team.robots, x) for team, x in teams])
    plan.drones[:, drones] = curves[:, :, [0, -1]].reshape(len(curves), -1, 3)
    plan.quaternions[:, drones] = [1.0, 0.0, 0.0, 0.0]
    plan.thrusts[:, drones], plan.cable_forces[:, drones] = 0.0, 0.0
    plan.cables[:, cables] = curves
    plan.objects[:, : poses.shape[1]] = poses[in_flight]
    return replace(plan, radius=scene_of(flight, 0).radius)


class Highlight(NamedTuple):
    """Indices of drones, cables and vertices that a check names."""

    drones: tuple[int, ...] = ()
    cables: tuple[int, ...] = ()
    vertices: tuple[int, ...] = ()


def highlight_of(flight: Flight, where: Sequence[str]) -> Highlight:
    """Return the indices for the names in ``where`` of a check; unknown names are ignored."""
    drones = []
    cables = []
    vertices = []
    names = set(where)
    for each in flight.all_teams:
        team = each.motion.team
        pairs = zip(team.drone_names, team.leg_names, strict=True)
        drones += [set(map(each.label, pair)) for pair in pairs]
        for k, robot in enumerate(team.labels):
            own = (f"edge {k}", *(f"{prefix}{robot}" for prefix in CABLE_PREFIXES))
            cables.append(set(map(each.label, own)))
        vertices += [{each.label(x)} for x in team.point_names]
    aliases = drones, cables, vertices
    indices = ([k for k, x in enumerate(each) if x & names] for each in aliases)
    return Highlight(*map(tuple, indices))


# Surfaces of drones, objects and spheres; names, colours and shapes of a scene.

SPAN = 0.8  # Radius of a drone with rotors as a fraction of its ellipsoid's radius
SEGMENTS = 16  # Number of corners of a rotor (even)
ROUND = 32  # Number of corners of a circle
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
    hub = np.zeros((segments // 2, 3))
    after = (k + 1) % segments
    disc = np.stack([hub, ring[0::2], ring[1::2], ring[after[1::2]]], axis=1)
    rim = np.stack([ring, ring[after], 1.18 * ring[after], 1.18 * ring], axis=1)
    rotors, rims = (np.concatenate([part + at for at in centres]) for part in (disc, rim))
    return np.concatenate(boxes), rotors, rims


class RigidSurface(NamedTuple):
    """A rigid surface at one pose or several."""

    name: str
    faces: Array  # (m, 4, 3) [m] about its own origin
    colours: tuple[str, ...]  # one per pose


class Clasp(NamedTuple):
    """A clasp: its vertex's name and index, and the index of a cable there."""

    name: str
    vertex: int
    cable: int


class TeamLabel(NamedTuple):
    """Name, colour and drones of a team."""

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
    labels: tuple[TeamLabel, ...]  # empty for a single team
    ellipsoid: tuple[float, float, float]  # semi-axes of a drone's ellipsoid [m]
    objects: tuple[RigidSurface, ...]
    keep_outs: tuple[RigidSurface, ...]  # in world coordinates, as the arena
    arena: Array  # edges (12 or 0, 2, 3) [m]

    @classmethod
    def of(cls, flight: Flight) -> Appearance:
        """Return the appearance of a plan's teams, and of other plans."""
        requirements = flight.requirements
        clasps = list[Clasp]()
        vertices = 0
        cables = 0
        names, hollow, labels = list[str](), list[bool](), list[TeamLabel]()
        looks = team_colours(flight)
        bodies = list(requirements.objects.items())
        for each in flight.all_teams:
            team = each.motion.team
            layout = each.motion.team.layout
            first = len(names)
            names += map(each.label, team.drone_names)
            hollow += [name[0] == "r" for name in team.drone_names]
            pairs = zip(layout.clasps.tolist(), layout.ahead.tolist(), strict=True)
            labels.append(TeamLabel(each.name, looks[len(labels)][0][0], slice(first, len(names))))
            clasps += [
                Clasp(each.label(team.point_names[p]), vertices + p, cables + k) for p, k in pairs
            ]
            vertices, cables = vertices + layout.points, cables + team.robots
        for other in flight.others:
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
            tuple(label for label in labels if label.name),
            (radius, radius, height),
            tuple(objects),
            tuple(keep_outs),
            arena,
        )

    def drone_parts(self, size: float = 1.0, segments: int = SEGMENTS) -> tuple[RigidSurface, ...]:
        """Return the parts of drones, scaled by ``size``; rotors of drones r are hollow."""
        rims = self.drone_colours
        pairs = zip(self.hollow, self.drone_colours, strict=True)
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
