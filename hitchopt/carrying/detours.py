"""Waypoints of carried objects beside obstacles on their straight way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hitchopt.carrying.moves import MAX_STEP_SLOPE
from hitchopt.carrying.planner import CARRY_ACCELERATION, MovePlanner
from hitchopt.geometry.vectors import length
from hitchopt.objects import Section, SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.morph.detours import SAMPLES, DetourSearch, Gaps, obstacles_of
from hitchopt.values import Array

CLEARANCES = (0.05, 0.15)
"""[m] Distances beyond the limits that ways are searched with: legs tilt as it speeds up."""

STOPS = 14  # Number of parts of the straight way, between which a way may stop
OFFSETS = 32  # Number of offsets to either side
CHUNK = 256  # Number of ways that are compared with all obstacles at once
ROUND_CORNERS = 16  # Number of corners of a polygon about a round section


@dataclass(frozen=True, eq=False)
class CarrySearch:
    """The search for ways of a carried object that lead past obstacles on one side.

    The hitch and the object are translated as a rigid body along a straight way, a stretch beside
    it, and a straight way to the goal, with a stop at each corner.
    """

    planner: MovePlanner  # Planner of the object's moves
    to: Array  # (4,) x, y, z [m] and yaw [rad] of the object's base at the goal

    @property
    def start(self) -> Array:
        """(4,) Those at the start."""
        return self.planner.body.place

    def ways(self) -> list[list[Array]]:
        """Return waypoints (4,) of ways, the goal last: on each side the fastest one, by duration.

        There are none if no obstacle is on the straight way.
        """
        sideways = self._search(0.0).direction(0.0)
        if bool(np.all(self._search(0.0).gaps(sideways).free(np.zeros(1))[1:-1])):
            return []
        found = list[list[Array]]()
        for clearance in CLEARANCES:
            gaps = self._search(clearance).gaps(sideways)
            ways = [way for sign in (1.0, -1.0) for way in self._fastest(gaps, sign)]
            ways.sort(key=lambda way: float(self._durations(way[None])[0]))
            found.extend(self._places(way, sideways) for way in ways)
        return found

    def _search(self, clearance: float) -> DetourSearch:
        """Return the search for offsets of the straight way."""
        planner = self.planner
        requirements = planner.requirements
        carried = planner.state.object
        others = {name: x for name, x in requirements.objects.items() if name != carried}
        first = self._nodes.shape[1] - sum(len(corners) for corners in self._slab_corners)
        counts = [len(corners) for corners in self._slab_corners]
        ends = first + np.cumsum([0, *counts])
        slabs = [
            (np.arange(ends[k], ends[k + 1])[None], requirements.separation.object)
            for k in range(len(counts))
        ]
        among = replace(requirements, objects=others)
        layout = planner.hold.team.layout
        obstacles = tuple(obstacles_of(layout, among, slabs))
        return DetourSearch(layout, self._nodes, obstacles, among, clearance)

    @cached_property
    def _slab_corners(self) -> list[Array]:
        """(corners, 3) [m] of the object's slabs, in its frame."""
        return [
            np.concatenate(
                [
                    np.insert(_corners(slab.section), 2, height, axis=1)
                    for height in (slab.lower, slab.upper)
                ]
            )
            for slab in self.planner.body.slabs
        ]

    @cached_property
    def _nodes(self) -> Array:
        """(J, nodes, 3) [m]: vertices, drones and corners of the object on the straight way."""
        carrying = self.planner.from_state(carried=True)
        at_rest = carrying.motion([carrying.rest(0.5)])
        hitch = np.concatenate([at_rest.vertices.at(0.0), at_rest.drones.at(0.0)])
        body: SolidObject = self.planner.body
        x, y, z, cosine, sine = body.pose
        to_object = np.array([0.0, 0.0, 0.0, cosine, -sine])
        local = np.concatenate([in_world(to_object, hitch - [x, y, z]), *self._slab_corners])
        s = np.linspace(0.0, 1.0, SAMPLES)[:, None]
        place = self.start + s * (self.to - self.start)
        yaw = place[:, 3:]
        poses = np.concatenate([place[:, :3], np.cos(yaw), np.sin(yaw)], axis=1)
        return np.asarray(in_world(poses[:, None], local[None]))

    def _fastest(self, gaps: Gaps, sign: float) -> Iterator[Array]:
        """Yield the fastest free way on one side (3,), if there is one: its stops and offset."""
        bounds = np.concatenate([gaps.lower, gaps.upper], axis=1) * sign
        largest = float(np.max(bounds, where=np.isfinite(bounds), initial=0.0))
        stops = np.arange(1, STOPS) / STOPS
        first, last, offset = np.meshgrid(
            stops, stops, largest * (1.01 / OFFSETS) * np.arange(1, OFFSETS + 1), indexing="ij"
        )
        ways = np.stack([first, last, sign * offset], axis=-1)[first <= last]
        ways = ways[np.argsort(self._durations(ways))]
        s = np.linspace(0.0, 1.0, SAMPLES)
        for chunk in np.split(ways, range(CHUNK, len(ways), CHUNK)):
            leave, back, beside = (column[:, None] for column in chunk.T)
            shares = np.minimum(np.minimum(s / leave, (1.0 - s) / (1.0 - back)), 1.0)
            free = np.flatnonzero(gaps.are_free(beside * shares))
            if len(free) > 0:
                yield chunk[free[0]]
                return

    def _durations(self, ways: Array) -> Array:
        """Return estimates of durations [s] of ways (W, 3): shares of both stops, offset [m]."""
        travel = length((self.to - self.start)[:3])
        first, last, offset = ways.T
        lengths = np.stack(
            [
                np.hypot(first * travel, offset),
                (last - first) * travel,
                np.hypot((1.0 - last) * travel, offset),
            ]
        )
        limits = self.planner.requirements.limits
        speed = min(limits.speed, limits.vertex_speed)
        acceleration = min(CARRY_ACCELERATION, limits.acceleration) / MAX_STEP_SLOPE
        slow = 2.0 * np.sqrt(lengths / acceleration)
        cruising = lengths / speed + speed / acceleration
        durations: Array = np.where(lengths < speed**2 / acceleration, slow, cruising).sum(axis=0)
        return durations

    def _places(self, way: Array, sideways: Array) -> list[Array]:
        """Return the waypoints (4,) of a way (3,), the goal last."""
        first, last, offset = way.tolist()
        shift = np.append(offset * sideways, 0.0)
        shares = [first] if first == last else [first, last]
        corners = [self.start + share * (self.to - self.start) + shift for share in shares]
        return [*corners, self.to]


def _corners(section: Section) -> Array:
    """Return corners (k, 2) [m] of a polygon around a section."""
    if section.radius is None:
        return section.core
    angles = 2.0 * math.pi / ROUND_CORNERS * np.arange(ROUND_CORNERS)
    reach = section.radius / math.cos(math.pi / ROUND_CORNERS)
    return reach * np.column_stack([np.cos(angles), np.sin(angles)])
