"""Path of two cables that are tied around an object: laid past its sides, bent around it, rolled.

At a roll of -180° both cables of a clasp run straight through and lie on one another. Each cable is
then bent around its side of the object alone, and could be straight as well: so cables are tied
and untied without slack. They are drawn taut next to the object, touch it, and bend around it until
their ends cross beyond it, those of q-drones above those of r-drones. They come to lie on one
another, and both pairs roll by half a turn into their clasps.

Lengths are in the object's frame. The object splits the edge of a cable into two straight parts, at
its q-end and at its r-end; arrays (…, n, 2, …) hold both. Cable k bends by ``turns[k, 0]`` before
and ``turns[k, 1]`` behind the direction of the line from its first to its last clasp.
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

SENSE = 1.0  # Sense of both clasps: cables of q-drones lie on those of r-drones
OPEN = -math.pi * SENSE  # [rad] Roll at which cables lie on one another
MIN_BEND = 1e-3  # Smallest difference of two bends at which drones rest

PITCHED_SHARE = 0.6
"""Bend up to which cables are pitched, over that at which drones pass each other."""

MAX_PITCHED = 0.5  # Largest bend up to which cables are pitched

SHORT_SIDE = 3e-3
"""[m] Longest side of a rounded corner. Where a pitched cable passes one, its straight part moves
across by the side's length times the pitch, within what checks of lengths and forces permit."""

BEND_DECIMALS = 9  # Decimal places of bends at events: those of symmetric cables are the same
ITERATIONS = 8  # Fixed-point steps of the length of edges, whose sag changes as they bend

OUTWARD = np.array([[-1.0], [1.0]])
"""(2, 1): sign of the direction away from the object, at the q- and the r-end of a cable, along the
direction from its q- to its r-drone."""

TURN_SENSES = np.array([1.0, -1.0])
"""(2,): senses in which the straight parts of a cable turn as it bends, counter-clockwise."""


class Place(NamedTuple):
    """A place of cables on their path around the object."""

    bend: float  # Fraction of the final turns, from 0 (straight) to 1 (crossing at the clasps)
    beside: float  # [m] Distance from the object
    pitch: float  # [rad] Slope of cables, q-drones up
    above: float  # [m] Height above the clasps


@dataclass(frozen=True, eq=False)
class PlaceChange:
    """A change of the place with a smooth progress."""

    start: Place  # The place at the start
    end: Place  # The place at the end
    law: SmoothLaw  # Law of the progress
    # True if all points move straight, with constant loads and shapes
    steady: ClassVar[bool] = False


@dataclass(frozen=True, eq=False)
class Straddle:
    """Two cables that are tied around an object with one tension."""

    grip: GripHold  # Their final hitch, tied ``around`` and drawn to the object
    tension: Array  # (n,) [N], of all cables as they are tied
    pitch: float  # [rad] Slope of cables whose ends cross beyond the object, q-drones up
    beside: float  # [m] Distance of straight cables to the object, before they touch it

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
        curves = self.hold.curves(rest, np.zeros(1))
        return {name: values[0] for name, values in curves.items()}

    @cached_property
    def _axes(self) -> Array:
        """(n, 2): directions of the lines from each cable's first to its last clasp."""
        return unit(np.roll(self.hold.polygon, -1, axis=0) - self.hold.polygon)

    @cached_property
    def turns(self) -> Array:
        """(n, 2) [rad]: turns of each cable before and behind the middle of its edge."""
        wraps = wraps_around(self.hold.body.section, self.hold.polygon)
        before = turn(self._axes, wraps.leaving)
        behind = turn(wraps.arriving, self._axes)
        return np.stack([before, behind], axis=-1)

    @cached_property
    def _legs(self) -> Array:
        """(n, 2, 3) [m]: legs outward, to the left and upward of their edges, at the clasps."""
        pairs = self._laid["drones"].reshape(-1, 2, 3)
        clasps = self._laid["vertices"][self.hold.team.layout.anchors].reshape(pairs.shape)
        legs = pairs - clasps
        outward = OUTWARD * self._directions(np.array(1.0))
        along = dot(legs[..., :2], outward)
        across = dot(legs[..., :2], left_of(outward))
        return np.stack([along, across, legs[..., 2]], axis=-1)

    def _directions(self, bend: Array) -> Array:
        """Return the directions (…, n, 2, 2) of the straight parts, from q- to r-drones."""
        axis_angles = np.arctan2(self._axes[:, 1], self._axes[:, 0])[:, None]
        angles = axis_angles + self.turns * TURN_SENSES * bend[..., None, None]
        return np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    def _corners(self, bend: float) -> Indices:
        """Return the corners (n, 2) of the section about which edges bend, or begin to bend."""
        normals = left_of(self._directions(np.array(max(bend, MIN_BEND))))
        return np.asarray(np.argmax(normals @ self.hold.body.section.core.T, axis=-1))

    @cached_property
    def _met_sides(self) -> dict[float, float]:
        """Lengths [m] of the longest sides that edges lie along, by bends between 0 and 1."""
        met = dict[float, float]()
        sides = self.hold.body.section.sides
        along_sides = sides[:, 1] - sides[:, 0]
        side_lengths = length(along_sides)
        side_angles = np.arctan2(along_sides[:, 1], along_sides[:, 0])
        axis_angles = np.arctan2(self._axes[:, 1], self._axes[:, 0])
        for cable, end in np.ndindex(self.turns.shape):
            turns_to_sides = (side_angles - axis_angles[cable]) * TURN_SENSES[end]
            turns_to_sides = (turns_to_sides + math.pi) % (2.0 * math.pi) - math.pi
            bends = np.round(turns_to_sides / self.turns[cable, end], BEND_DECIMALS)
            between = (bends > MIN_BEND) & (bends < 1.0 - MIN_BEND) & (side_lengths > 0.0)
            for bend, side in zip(bends[between].tolist(), side_lengths[between], strict=True):
                met[bend] = max(met.get(bend, 0.0), float(side))
        return met

    @cached_property
    def events(self) -> list[float]:
        """Bends, from 0 to 1, at which an edge meets another corner, where drones rest."""
        return sorted({0.0, 1.0, *self._met_sides})

    @property
    def _long_sides(self) -> list[float]:
        """Bends at which edges lie along sides that are no parts of rounded corners."""
        return [bend for bend, side in self._met_sides.items() if side > SHORT_SIDE]

    @cached_property
    def largest_pitched(self) -> float:
        """Bend up to which cables are pitched, before drones pass over the other cables."""
        polygon = self.hold.polygon
        left = left_of(self._axes)
        widths = self.hold.body.section.support(left) - dot(left, polygon)  # (n,)
        pairs = self._laid["drones"].reshape(-1, 2, 3)
        reaches = length(pairs[..., :2] - polygon.mean(axis=0))
        passing = np.arctan2(widths[:, None], reaches) / self.turns
        return float(np.clip(PITCHED_SHARE * np.min(passing), 10.0 * MIN_BEND, MAX_PITCHED))

    @property
    def _level(self) -> float:
        """Bend of the last side before cables are pitched: those along sides are horizontal."""
        before = (bend for bend in self._long_sides if bend < self.largest_pitched - MIN_BEND)
        return max(before, default=0.0)

    @property
    def sides_passed(self) -> list[float]:
        """Bends at which cables are pitched, and edges would leave the next side."""
        return [bend for bend in self._long_sides if bend >= self.largest_pitched - MIN_BEND]

    def _corners_of(self, change: PlaceChange) -> Indices:
        """Return the corners (n, 2) about which edges bend during a change of the place."""
        return self._corners(0.5 * (change.start.bend + change.end.bend))

    def _corners_beyond(self, place: Place, change: PlaceChange) -> Indices:
        """Return the corners (n, 2) about which edges bend before or after a change, at its end."""
        bends = [each.bend for each in self.bent]
        index = bends.index(place.bend) + (1 if place == change.end else 0)
        return self._corners(0.5 * (bends[max(index - 1, 0)] + bends[index]))

    def curves(self, change: PlaceChange, t: Array) -> dict[str, Array]:
        """Return all curves of a change of the place at times t (…) [s], in the world."""
        progress = change.law.jet(t)[..., :1]
        start = np.array(change.start)
        end = np.array(change.end)
        bend, beside, pitch, above = np.moveaxis(start + progress * (end - start), -1, 0)
        is_straight = bool(np.max(beside) > 0.0)
        corners = self._corners_of(change)
        directions = self._directions(bend)
        edges = self._edges(bend, corners)

        seam_at_start = self._seam(change.start, change)
        seam_at_end = self._seam(change.end, change)
        seam_change = seam_at_end - seam_at_start
        reference_sag = self._sag_when_laid - seam_at_start - progress * seam_change
        level_directions = directions * np.cos(pitch)[..., None, None, None]
        lengths = edges
        for _ in range(ITERATIONS):
            sag = self._sag(lengths, level_directions, corners, straight=is_straight)
            lengths = edges - 0.5 * (sag - reference_sag)[..., None]

        contacts = self._contacts(directions, corners, beside, above)
        along, across, upward = self._leg_axes(directions, pitch)
        anchors = contacts + lengths[..., None] * along
        shift_at_start = self._shift(change.start, change)
        shift_change = self._shift(change.end, change) - shift_at_start
        anchors += shift_at_start + progress[..., None, None] * shift_change
        axes = np.stack([along, across, upward], axis=-2)
        drones = anchors + np.sum(self._legs[..., None] * axes, axis=-2)
        if is_straight:  # a single point
            contacts = np.repeat(np.mean(contacts, axis=-2, keepdims=True), 2, axis=-2)
        points = {
            "drones": drones.reshape(*bend.shape, -1, 3),
            "vertices": _repeated(self._laid["vertices"], bend.shape),
            "contacts": contacts,
            "anchors": anchors,
        }
        pose = self.hold.body.pose
        curves = {name: in_world(pose, values) for name, values in points.items()}
        curves["legs"] = _repeated(self._laid["legs"], bend.shape)
        curves["tensions"] = _repeated(self._laid["tensions"], bend.shape)
        return curves

    def _contacts(self, directions: Array, corners: Indices, beside: Array, above: Array) -> Array:
        """Return the points (…, n, 2, 3) [m] at which straight parts touch the object.

        Cables at a distance ``beside`` (…) [m] would touch it there if they came nearer; all are
        ``above`` (…) [m] the clasps.
        """
        section = self.hold.body.section
        on_section = section.core[corners] + section.rounding * left_of(directions)
        level = on_section + beside[..., None, None, None] * left_of(self._axes)[:, None]
        heights = self.hold.height + above[..., None, None, None]
        return np.concatenate([level, heights + np.zeros_like(level[..., :1])], axis=-1)

    def _leg_axes(self, directions: Array, pitch: Array) -> tuple[Array, Array, Array]:
        """Return unit vectors (…, n, 2, 3) along, across and upward of pitched straight parts.

        The first ones lead from the object to the drones.
        """
        outward = OUTWARD * directions
        slopes = -OUTWARD * pitch[..., None, None, None]
        cosines = np.cos(slopes)
        sines = np.sin(slopes)
        zero = np.zeros_like(outward[..., :1])
        along = np.concatenate([cosines * outward, sines + zero], axis=-1)
        across = np.concatenate([left_of(outward), zero], axis=-1)
        upward = np.concatenate([-sines * outward, cosines + zero], axis=-1)
        return along, across, upward

    def _seam(self, place: Place, change: PlaceChange) -> Array:
        """Return half of the jump of the sag of edges (n,) [m] at an end of a change of the place.

        The length of the straight parts that sag jumps where an edge meets another corner. The
        changes before and after such an event meet halfway.
        """
        if place.beside > 0.0 or place in (self.crossed, self.laid):
            return np.zeros(self.hold.team.robots)
        corners = self._corners_of(change)
        touches = place == self.touching
        is_straight = touches and max(change.start.beside, change.end.beside) > 0.0
        is_straight_beyond = touches and not is_straight
        corners_beyond = self._corners_beyond(place, change)

        bend = np.array(place.bend)
        directions = self._directions(bend) * math.cos(place.pitch)
        edges = self._edges(bend, corners)
        edges_beyond = self._edges(bend, corners_beyond)
        sag = self._sag(edges, directions, corners, straight=is_straight)
        sag_beyond = self._sag(
            edges_beyond, directions, corners_beyond, straight=is_straight_beyond
        )
        return np.asarray(0.5 * (sag_beyond - sag))

    def _shift(self, place: Place, change: PlaceChange) -> Array:
        """Return half of the jump of anchors (n, 2, 3) [m] at an end of a change of the place.

        Pitched straight parts leave the contacts' height at the next corner instead. As for sag,
        the changes before and after meet halfway.
        """
        if place.pitch == 0.0 or place.beside > 0.0 or place == self.crossed:
            return np.zeros((*self.turns.shape, 3))
        own = self._corners_of(change)
        beyond = self._corners_beyond(place, change)
        level = np.array(0.0)
        bend = np.array(place.bend)
        directions = self._directions(bend)
        along, _, _ = self._leg_axes(directions, np.array(place.pitch))
        anchors = [
            self._contacts(directions, corners, level, level)
            + self._edges(bend, corners)[..., None] * along
            for corners in (own, beyond)
        ]
        return np.asarray(0.5 * (anchors[1] - anchors[0]))

    def _edges(self, bend: Array, corners: Indices) -> Array:
        """Return the lengths (…, n, 2) [m] of the straight parts of edges without their sag.

        As edges bend, the object takes up cable: along its rounding, and along sides between
        ``corners`` (n, 2) and those of cables that cross.
        """
        section = self.hold.body.section
        side_lengths = length(section.sides[:, 1] - section.sides[:, 0])
        around = np.append(0.0, np.cumsum(side_lengths))  # lengths along sides, from corner 0
        perimeter = around[-1]
        ahead = (around[self._corners(1.0)] - around[corners]) * [-1.0, 1.0]
        along_sides = ahead % perimeter if perimeter > 0.0 else np.zeros(corners.shape)
        along_rounding = section.rounding * self.turns * (1.0 - bend)[..., None, None]
        return np.asarray(self._edges_when_laid + (along_rounding + along_sides))

    @cached_property
    def _edges_when_laid(self) -> Array:
        """(n, 2) [m]: straight parts of the edges that cross beyond the object."""
        anchors = self._laid["vertices"][self.hold.team.layout.anchors].reshape(-1, 2, 3)
        return length((anchors - self._laid["contacts"])[..., :2])

    @cached_property
    def _sag_when_laid(self) -> Array:
        """(n,) [m]: excess of these edges by their sag."""
        directions = self._directions(np.array(1.0))
        return self._sag(self._edges_when_laid, directions, self._corners(1.0))

    def _sag(
        self, lengths: Array, directions: Array, corners: Indices, *, straight: bool = False
    ) -> Array:
        """Return the excess (…, n) [m] of edges by their sag.

        Parameters
        ----------
        lengths: (…, n, 2) [m], of straight parts.
        directions: (…, n, 2, 2), of straight parts in plan view.
        corners: (n, 2), about which edges bend.
        straight: whether edges do not touch the object, so that they sag between corners too.
        """
        core = self.hold.body.section.core[corners]
        between_corners = (core[:, 1] - core[:, 0]) * float(straight)
        spans = np.sum(lengths[..., None] * directions, axis=-2) + between_corners
        total = np.sum(lengths, axis=-1) + length(between_corners)
        factors = sag_factors(self.hold.team, self.tension)
        return np.asarray(factors * total * np.sum(spans * spans, axis=-1))

    # The path.

    @property
    def first(self) -> Place:
        """The place of straight cables next to the object."""
        return Place(bend=0.0, beside=self.beside, pitch=0.0, above=0.0)

    @cached_property
    def ready(self) -> Place:
        """The place of straight cables that are going to touch the object.

        They are pitched already, unless they touch a side then or later.
        """
        corners = self._corners(0.0)
        touches_side = bool(np.any(corners[:, 0] != corners[:, 1]))
        stays_level = touches_side or self._level > 0.0
        return self.first if stays_level else self.first._replace(pitch=self.pitch)

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
        """Configurations with cables touching the object, first straight, at which drones rest."""
        bends = sorted({*self.events, self.largest_pitched})
        pitched_from = [self._level, self.largest_pitched]
        pitches = np.interp(bends, pitched_from, [self.ready.pitch, self.pitch]).tolist()
        return [
            Place(bend=bend, beside=0.0, pitch=pitch, above=0.0)
            for bend, pitch in zip(bends, pitches, strict=True)
        ]

    @property
    def laid(self) -> Place:
        """The place of cables that lie on one another."""
        return self.crossed._replace(pitch=0.0)

    @property
    def drones_taut(self) -> Array:
        """(2n, 3) [m]: drones of straight cables next to the object."""
        change = PlaceChange(self.first, self.first, SmoothLaw(0.5))
        return np.asarray(self.curves(change, np.zeros(1))["drones"][0])


def _repeated(values: Array, times: tuple[int, ...]) -> Array:
    """Return constant values for an array of times (…), as a view."""
    return np.broadcast_to(values, (*times, *values.shape))
