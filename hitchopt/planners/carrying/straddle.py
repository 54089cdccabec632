"""Path of two cables that are tied around an object: laid past its sides, bent around it, rolled.

At a roll of -180° both cables of a clasp run straight through and lie on one another. Each cable is
then bent around its side of the object alone, and could be straight as well: so cables are tied
and untied without slack. They are drawn taut beside the object, touch it, and bend around it until
their ends cross beyond it, those of q-drones above those of r-drones. They come to lie on one
another, and both pairs roll by half a turn into their clasps.

Lengths are in the object's frame. Cable k bends by ``turns[k, 0]`` before and ``turns[k, 1]``
behind the direction of the line from its first to its last clasp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from hitchopt.geometry.vectors import dot, left_of, length, turn, unit
from hitchopt.hitch.forces import sag_factors
from hitchopt.hitch.holding import wraps_around
from hitchopt.objects.placing import in_world
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.moves import Move, SmoothLaw
from hitchopt.values import Array, Indices

SENSE = 1.0
"""Sense of both clasps: cables of q-drones lie on those of r-drones."""

OPEN = -math.pi * SENSE
"""[rad] Roll at which cables lie on one another."""

MIN_BEND, PITCHED_SHARE = 1e-3, 0.6
"""Minimum distance of bends at which drones rest, and bend up to which cables are pitched, over
that at which drones pass each other."""

ITERATIONS = 8
"""Fixed-point steps of the length of edges, whose sag changes as they bend."""


class Place(NamedTuple):
    """A place of cables on their path around the object, (4,) in sequence."""

    bend: float  # fraction of the final turns, from 0 (straight) to 1 (crossing at the clasps)
    beside: float  # distance from the object [m]
    pitch: float  # slope of cables, q-drones up [rad]
    above: float  # height above the clasps [m]


@dataclass(frozen=True, eq=False)
class PlaceChange:
    """A change of the place with a smooth progress."""

    start: Place
    end: Place
    law: SmoothLaw
    steady: ClassVar[bool] = False


@dataclass(frozen=True, eq=False)
class Straddle:
    """Two cables that are tied around an object with one tension.

    ``grip`` is their final hitch, tied ``around`` and drawn to the object, and ``tension`` (n,) [N]
    that of all cables as they are tied.
    """

    grip: GripHold
    tension: Array
    pitch: float
    beside: float

    @cached_property
    def hold(self) -> GripHold:
        """The hitch before it is drawn."""
        return self.grip.opened

    @cached_property
    def _laid(self) -> dict[str, Array]:
        """All curves where cables lie on one another, in the frame of the object's base."""
        origin = np.zeros(4)
        tension = np.stack([self.tension, self.tension])
        rest = Move(origin, origin, tension, (0.0, 0.0), SmoothLaw(1.0), roll=(OPEN, OPEN))
        return {name: each[0] for name, each in self.hold.curves(rest, np.zeros(1)).items()}

    @cached_property
    def _axes(self) -> Array:
        """(n, 2): directions of the lines from each cable's first to its last clasp."""
        return unit(np.roll(self.hold.polygon, -1, axis=0) - self.hold.polygon)

    @cached_property
    def turns(self) -> Array:
        """(n, 2) [rad]: turns of each cable before and behind the middle of its edge."""
        wraps = wraps_around(self.hold.body.section, self.hold.polygon)
        first, last = turn(self._axes, wraps.leaving), turn(wraps.arriving, self._axes)
        return np.stack([first, last], axis=-1)

    @cached_property
    def _legs(self) -> Array:
        """(n, 2, 3) [m]: legs outward, to the left and upward of their edges, at the clasps."""
        pairs = self._laid["drones"].reshape(-1, 2, 3)
        legs = pairs - self._laid["vertices"][self.hold.team.layout.anchors].reshape(pairs.shape)
        outward = self._directions(np.ones(1))[0]
        along, across = (dot(legs[..., :2], each) for each in (outward, left_of(outward)))
        return np.stack([along, across, legs[..., 2]], axis=-1)

    def _directions(self, bend: Array) -> Array:
        """Return unit vectors (…, n, 2, 2) from the object to the q- and to the r-drones."""
        angles = np.arctan2(self._axes[:, 1], self._axes[:, 0])[:, None]
        angles = angles + self.turns * [1.0, -1.0] * bend[..., None, None]
        return np.stack([np.cos(angles), np.sin(angles)], axis=-1) * [[-1.0], [1.0]]

    def _corners(self, bend: float) -> Indices:
        """Return the corners (n, 2) of the section about which edges bend, or begin to bend."""
        onward = self._directions(np.array(max(bend, MIN_BEND))) * [[-1.0], [1.0]]
        normals = left_of(onward)
        return np.asarray(np.argmax(normals @ self.hold.body.section.core.T, axis=-1))

    @cached_property
    def events(self) -> list[float]:
        """Bends, from 0 to 1, at which an edge meets another corner, where drones rest."""
        found, sides = list[float](), self.hold.body.section.sides
        if len(sides) == 1:
            return [0.0, 1.0]
        normals = np.arctan2(*(sides[:, 1] - sides[:, 0]).T[::-1])
        for k, end in np.ndindex(self.turns.shape):
            angle = float(np.arctan2(*self._axes[k][::-1]))
            gaps = (normals - angle) * (1.0 if end == 0 else -1.0)
            gaps = (gaps + math.pi) % (2.0 * math.pi) - math.pi
            found += [float(x) for x in gaps / self.turns[k, end] if MIN_BEND < x < 1.0 - MIN_BEND]
        return sorted({0.0, *found, 1.0})

    @cached_property
    def largest_pitched(self) -> float:
        """Bend up to which cables are pitched, before drones pass over the other cables."""
        section, polygon = self.hold.body.section, self.hold.polygon
        left = left_of(self._axes)
        widths = section.support(left) - dot(left, polygon)  # (n,)
        reaches = length(self._laid["drones"].reshape(-1, 2, 3)[..., :2] - polygon.mean(axis=0))
        passing = np.arctan2(widths[:, None], reaches) / self.turns
        return float(np.clip(PITCHED_SHARE * np.min(passing), 10.0 * MIN_BEND, 0.5))

    @property
    def _level(self) -> float:
        """Bend of the last event before cables are pitched: those along sides are level."""
        return max(x for x in self.events if x < self.largest_pitched - MIN_BEND)

    @property
    def sides_passed(self) -> list[float]:
        """Bends of events at which cables are pitched, and edges would leave the next side."""
        return [x for x in self.events[1:-1] if x >= self.largest_pitched - MIN_BEND]

    def _corners_of(self, change: PlaceChange) -> Indices:
        """Return the corners (n, 2) about which edges bend during a change of the place."""
        return self._corners(0.5 * (change.start.bend + change.end.bend))

    def curves(self, change: PlaceChange, t: Array) -> dict[str, Array]:
        """Return all curves of a change of the place at times t (…) [s], in the world."""
        hold, section = self.hold, self.hold.body.section
        progress = change.law.jet(t)[..., :1]
        start, end = np.array(change.start), np.array(change.end)
        bend, beside, pitch, above = np.moveaxis(start + progress * (end - start), -1, 0)
        corners, straight = self._corners_of(change), bool(np.max(beside) > 0.0)
        outward = self._directions(bend)  # (…, n, 2, 2)
        sideways = left_of(outward)
        contacts = section.core[corners] + section.rounding * sideways * [[-1.0], [1.0]]
        contacts = contacts + beside[..., None, None, None] * left_of(self._axes)[:, None]
        seams = [self._seam(place, change) for place in (change.start, change.end)]
        gained = self._sag_when_laid - seams[0] - progress * (seams[1] - seams[0])
        edges, level = self._edges(bend, corners), outward * np.cos(pitch)[..., None, None, None]
        lengths = edges
        for _ in range(ITERATIONS):
            excess = self._sag(lengths, level, corners, straight=straight) - gained
            lengths = edges - 0.5 * excess[..., None]
        slopes, zero = pitch[..., None, None, None] * [[1.0], [-1.0]], 0.0 * contacts[..., :1]
        c, s, height = np.cos(slopes), np.sin(slopes), hold.height + above[..., None, None, None]
        along = np.concatenate([c * outward, s + zero], axis=-1)
        across = np.concatenate([sideways, zero], axis=-1)
        upward = np.concatenate([-s * outward, c + zero], axis=-1)
        contacts = np.concatenate([contacts, height + zero], axis=-1)
        anchors = contacts + lengths[..., None] * along
        drones = anchors + np.sum(self._legs[..., None] * np.stack([along, across, upward], -2), -2)
        if straight:  # a single point
            contacts = np.repeat(np.mean(contacts, axis=-2, keepdims=True), 2, axis=-2)
        fixed = {
            name: np.broadcast_to(self._laid[name], (*bend.shape, *self._laid[name].shape))
            for name in ("vertices", "legs", "tensions")
        }
        moving = {
            "drones": drones.reshape(*bend.shape, -1, 3),
            "vertices": fixed.pop("vertices"),
            "contacts": contacts,
            "anchors": anchors,
        }
        return fixed | {name: in_world(hold.body.pose, each) for name, each in moving.items()}

    def _seam(self, place: Place, change: PlaceChange) -> Array:
        """Return half of the jump of the sag of edges (n,) [m] at an end of a change of the place.

        The length of the straight parts that sag jumps where an edge meets another corner. The
        changes before and after such an event meet halfway.
        """
        if place.beside > 0.0 or place in (self.crossed, self.laid):
            return np.zeros(self.hold.team.robots)
        bend, touches = np.array(place.bend), place == self.touching
        outward = self._directions(bend) * math.cos(place.pitch)
        own = self._corners_of(change)
        sides = [self._corners(place.bend + off) for off in (-0.5 * MIN_BEND, 0.5 * MIN_BEND)]
        other = sides[0] if np.array_equal(sides[1], own) else sides[1]
        straight = touches and max(change.start.beside, change.end.beside) > 0.0
        sags = [
            self._sag(self._edges(bend, corners), outward, corners, straight=flat)
            for corners, flat in ((own, straight), (other, touches and not straight))
        ]
        return np.asarray(0.5 * (sags[1] - sags[0]))

    def _edges(self, bend: Array, corners: Indices) -> Array:
        """Return the lengths (…, n, 2) [m] of the straight parts of edges without their sag.

        As edges bend, the object takes up cable.
        """
        section = self.hold.body.section
        ring = np.append(0.0, np.cumsum(length(section.sides[:, 1] - section.sides[:, 0])))
        after = (ring[self._corners(1.0)] - ring[corners]) * [-1.0, 1.0]
        sides = after % ring[-1] if ring[-1] > 0.0 else np.zeros(corners.shape)
        taken = section.rounding * self.turns * (1.0 - bend)[..., None, None] + sides
        return np.asarray(self._edges_when_laid + taken)

    @cached_property
    def _edges_when_laid(self) -> Array:
        """(n, 2) [m]: straight parts of the edges that cross beyond the object."""
        anchors = self._laid["vertices"][self.hold.team.layout.anchors].reshape(-1, 2, 3)
        return length((anchors - self._laid["contacts"])[..., :2])

    @cached_property
    def _sag_when_laid(self) -> Array:
        """(n,) [m]: excess of these edges by their sag."""
        return self._sag(self._edges_when_laid, self._directions(np.ones(1))[0], self._corners(1.0))

    def _sag(
        self, lengths: Array, outward: Array, corners: Indices, *, straight: bool = False
    ) -> Array:
        """Return the excess (…, n) [m] of edges with straight parts (…, n, 2) [m] by their sag.

        Edges that are ``straight`` do not touch the object.
        """
        core = self.hold.body.section.core[corners]
        between = (core[:, 1] - core[:, 0]) * float(straight)
        span = np.sum(lengths[..., None] * outward * [[-1.0], [1.0]], axis=-2) + between
        total = np.sum(lengths, axis=-1) + length(between)
        factors = sag_factors(self.hold.team, self.tension)
        return np.asarray(factors * total * np.sum(span * span, axis=-1))

    # The path.

    @property
    def first(self) -> Place:
        """The place of straight cables beside the object."""
        return Place(0.0, self.beside, 0.0, 0.0)

    @cached_property
    def ready(self) -> Place:
        """The place of straight cables that are going to touch the object.

        They are pitched already, unless they touch a side then or later.
        """
        corners = self._corners(0.0)
        is_level = bool(np.any(corners[:, 0] != corners[:, 1])) or self._level > 0.0
        return self.first if is_level else self.first._replace(pitch=self.pitch)

    @property
    def touching(self) -> Place:
        """The place of straight cables that touch the object."""
        return self.ready._replace(beside=0.0)

    @property
    def crossed(self) -> Place:
        """The place of cables whose ends cross beyond the object, above each other."""
        return self.bent[-1]

    @property
    def bent(self) -> list[Place]:
        """Places of cables that touch the object, from straight ones on, where drones rest."""
        bends = sorted({*self.events, self.largest_pitched})
        start, level = self.ready.pitch, self._level
        pitches = np.interp(bends, [level, self.largest_pitched], [start, self.pitch]).tolist()
        return [Place(x, 0.0, pitch, 0.0) for x, pitch in zip(bends, pitches, strict=True)]

    @property
    def laid(self) -> Place:
        """The place of cables that lie on one another."""
        return self.crossed._replace(pitch=0.0)

    @property
    def drones_taut(self) -> Array:
        """(2n, 3) [m]: drones of straight cables beside the object."""
        change = PlaceChange(self.first, self.first, SmoothLaw(0.5))
        return np.asarray(self.curves(change, np.zeros(1))["drones"][0])
