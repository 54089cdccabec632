"""Two cables tied around an object: laid past both of its sides, bent around it, and rolled.

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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hitchopt.checks import Check
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import length, rotated, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import sag_factors
from hitchopt.hitch.holding import turn, wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase, PhaseHold, concatenated
from hitchopt.objects.placing import in_world, poses_of
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.moves import Move, SmoothLaw, polynomials
from hitchopt.planners.carrying.planner import MovePlanner, first_violated
from hitchopt.planners.forming.prehitch import MAX_SPAN_RATIO, MIN_SEPARATION
from hitchopt.planners.forming.stages import (
    SMOOTH,
    Keyframe,
    best,
    hover_altitude,
    straight_stages,
)
from hitchopt.planners.timing.flight import needed_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

SENSE = 1.0
"""Sense of both clasps: cables of q-drones lie on those of r-drones."""

OPEN = -math.pi * SENSE
"""[rad] Roll at which cables lie on one another."""

SHORT_SHARES = (0.43, 0.4, 0.37, 0.34, 0.3, 0.26)
"""Candidate shares of q-legs, in the order of trial: drones of a pair pass each other at different
distances from the object."""

SCALES = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
"""Candidate distances of clasps to the object's centre as they are tied, over those of the grip."""

MIN_RADIAL = 0.05
"""[m] Length of legs in addition to ``limits.leg`` where clasps are tied far from the object."""

PITCHES = tuple(np.radians([4.0, 6.0, 8.0, 11.0, 15.0]))
"""[rad] Candidate slopes of cables, q-drones up, in the order of trial."""

STRADDLE_SPEED = 0.3
"""[m/s] Largest speed of drones while cables bend around an object."""

MAX_TURN = math.radians(20.0)
"""[rad] Largest angle by which hanging cables turn about an object on straight lines."""

SLACK = 6.0
"""Slack of hanging cables over the position error of drones, which displaces tauter ones far."""

BESIDE = 0.08
"""[m] Distance of straight cables to the object, in addition to ``separation.object``."""

DISTANCE_FACTOR, EXTRA_DISTANCE = 1.1, 0.01
"""Factor on the distances of cables, and distance added to them [m], in planning."""

MIN_HEIGHT = 0.06
"""[m] Smallest height of drones over the ground while cables are tied."""

TENSION_SECONDS = 0.5
"""[s] Rise of the tension from that of cables drawn taut."""

SAMPLES, FINE_SAMPLES = 21, 121
"""Number of samples of a change of the place, and of one whose first samples keep distances."""

MIN_BEND, PITCHED_SHARE = 1e-3, 0.6
"""Smallest distance of bends at which drones rest, and bend up to which cables are pitched, over
that at which drones pass each other."""

UNFIT = -1e3
"""Margin of candidates that no plan can use."""

ITERATIONS = 8
"""Fixed-point steps of the length of edges, whose sag changes as they bend."""


class Distance(NamedTuple):
    """The smallest of the distances that a check of the certificate limits."""

    check: str
    value: float
    limit: float
    planned: float  # limit with the reserve of planning
    unit: str = "m"

    @property
    def margin(self) -> float:
        """Margin over the planned distance."""
        return self.value / self.planned - 1.0


class Place(NamedTuple):
    """A place of cables on their path around the object, (4,) in sequence."""

    bend: float  # share of the final turns, from 0 (straight) to 1 (crossing at the clasps)
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

    ``hold`` is their hitch before they are drawn, and ``tension`` (n,) [N] that of all cables as
    they are tied.
    """

    hold: GripHold
    tension: Array
    pitch: float
    beside: float

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
        left = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)
        along, across = (np.sum(legs[..., :2] * each, axis=-1) for each in (outward, left))
        return np.stack([along, across, legs[..., 2]], axis=-1)

    def _directions(self, bend: Array) -> Array:
        """Return unit vectors (…, n, 2, 2) from the object to the q- and to the r-drones."""
        angles = np.arctan2(self._axes[:, 1], self._axes[:, 0])[:, None]
        angles = angles + self.turns * [1.0, -1.0] * bend[..., None, None]
        return np.stack([np.cos(angles), np.sin(angles)], axis=-1) * [[-1.0], [1.0]]

    def _corners(self, bend: float) -> Indices:
        """Return the corners (n, 2) of the section about which edges bend, or begin to bend."""
        outward = self._directions(np.array(max(bend, MIN_BEND))) * [[-1.0], [1.0]]
        normals = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)
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
    def _pitched(self) -> float:
        """Bend up to which cables are pitched, before drones pass over the other cables."""
        section, polygon = self.hold.body.section, self.hold.polygon
        left = np.stack([-self._axes[:, 1], self._axes[:, 0]], axis=-1)
        widths = section.support(left) - np.sum(left * polygon, axis=-1)  # (n,)
        reaches = length(self._laid["drones"].reshape(-1, 2, 3)[..., :2] - polygon.mean(axis=0))
        passing = np.arctan2(widths[:, None], reaches) / self.turns
        return float(np.clip(PITCHED_SHARE * np.min(passing), 10.0 * MIN_BEND, 0.5))

    @property
    def _level(self) -> float:
        """Bend of the last event before cables are pitched: those along sides are level."""
        return max(x for x in self.events if x < self._pitched - MIN_BEND)

    @property
    def sides_passed(self) -> list[float]:
        """Bends of events at which cables are pitched, and edges would leave the next side."""
        return [x for x in self.events[1:-1] if x >= self._pitched - MIN_BEND]

    def curves(self, change: PlaceChange, t: Array) -> dict[str, Array]:
        """Return all curves of a change of the place at times t (…) [s], in the world."""
        progress = change.law.jet(t)[..., 0]
        start, end = np.array(change.start), np.array(change.end)
        bend, beside, pitch, above = np.moveaxis(start + progress[..., None] * (end - start), -1, 0)
        seams = np.array([self._seam(place, change) for place in (change.start, change.end)])
        corners = self._corners(0.5 * (change.start.bend + change.end.bend))
        seam = seams[0] + progress[..., None] * (seams[1] - seams[0])
        return self._curves(bend, beside, pitch, above, corners, seam)

    def _seam(self, place: Place, change: PlaceChange) -> Array:
        """Return half of the jump of the sag of edges (n,) [m] at an end of a change of the place.

        The length of the straight parts that sag jumps where an edge meets another corner. The
        changes before and after such an event meet halfway.
        """
        bend, straight = np.array(place.bend), place == self.touching
        if place.beside > 0.0 or place in (self.crossed, self.laid):
            return np.zeros(self.hold.team.robots)
        outward = self._directions(bend) * math.cos(place.pitch)
        own = self._corners(0.5 * (change.start.bend + change.end.bend))
        sides = [self._corners(place.bend + off) for off in (-0.5 * MIN_BEND, 0.5 * MIN_BEND)]
        other = sides[0] if np.array_equal(sides[1], own) else sides[1]
        flat = straight and max(change.start.beside, change.end.beside) > 0.0
        lengths = [self._edges(bend, outward, x, None) for x in (own, other)]
        sags = [self._sag(lengths[0], outward, own, flat=flat)]
        sags.append(self._sag(lengths[1], outward, other, flat=straight and not flat))
        return np.asarray(0.5 * (sags[1] - sags[0]))

    def _curves(
        self,
        bend: Array,
        beside: Array,
        pitch: Array,
        above: Array,
        corners: Indices,
        seam: Array,
    ) -> dict[str, Array]:
        """Return all curves at places (…), with edges that bend about corners (n, 2)."""
        hold, section, team = self.hold, self.hold.body.section, self.hold.team
        outward = self._directions(bend)  # (…, n, 2, 2)
        onward = outward * [[-1.0], [1.0]]
        normals = np.stack([-onward[..., 1], onward[..., 0]], axis=-1)
        left = np.stack([-self._axes[:, 1], self._axes[:, 0]], axis=-1)[:, None]
        contacts = section.core[corners] + section.rounding * normals
        contacts = contacts + beside[..., None, None, None] * left
        level = outward * np.cos(pitch)[..., None, None, None]
        lengths = self._edges(bend, level, corners, seam, flat=bool(np.max(beside) > 0.0))
        slopes = pitch[..., None, None] * [1.0, -1.0]
        c, s = np.cos(slopes), np.sin(slopes)
        along, across, upward = np.moveaxis(self._legs, -1, 0)
        anchors = contacts + (lengths * c)[..., None] * outward
        sideways = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)
        level = (along * c - upward * s)[..., None] * outward + across[..., None] * sideways
        base = hold.height + above[..., None, None]
        heights = base + lengths * s, base + lengths * s + along * s + upward * c
        drones = np.concatenate([anchors + level, heights[1][..., None]], axis=-1)
        anchors = np.concatenate([anchors, heights[0][..., None]], axis=-1)
        if np.max(beside) > 0.0:  # straight: a single point
            middles = np.mean(contacts, axis=-2, keepdims=True)
            contacts = np.broadcast_to(middles, contacts.shape)
        contact_heights = np.broadcast_to(base[..., None], (*contacts.shape[:-1], 1))
        contacts = np.concatenate([contacts, contact_heights], axis=-1)
        shape, pose = bend.shape, hold.body.pose
        rest = {name: self._laid[name] for name in ("vertices", "legs", "tensions")}
        fixed = {x: np.broadcast_to(each, (*shape, *each.shape)) for x, each in rest.items()}
        fixed["vertices"] = in_world(pose, fixed["vertices"])
        drones = drones.reshape(*shape, team.drones, 3)
        moving = {"drones": drones, "contacts": contacts, "anchors": anchors}
        return fixed | {name: in_world(pose, each) for name, each in moving.items()}

    def _edges(
        self,
        bend: Array,
        outward: Array,
        corners: Indices,
        seam: Array | None,
        *,
        flat: bool = False,
    ) -> Array:
        """Return the lengths (…, n, 2) [m] of the straight parts of edges.

        As edges bend, the object takes up cable, and sag is lost. Without a ``seam``, sag is left
        out. Edges that are ``flat`` do not touch the object.
        """
        section, team = self.hold.body.section, self.hold.team
        ring = np.append(0.0, np.cumsum(length(section.sides[:, 1] - section.sides[:, 0])))
        after = (ring[self._corners(1.0)] - ring[corners]) * [-1.0, 1.0]
        sides = after % ring[-1] if ring[-1] > 0.0 else np.zeros(corners.shape)
        taken = section.rounding * self.turns * (1.0 - bend)[..., None, None] + sides
        laid = self._laid["vertices"][team.layout.anchors].reshape(-1, 2, 3)
        final = length((laid - self._laid["contacts"])[..., :2])  # (n, 2)
        edges = final + taken
        if seam is None:
            return np.asarray(edges)
        target = self._sag(final, self._directions(np.ones(1))[0], self._corners(1.0))
        lengths = edges
        for _ in range(ITERATIONS):
            excess = self._sag(lengths, outward, corners, flat=flat) + seam - target
            lengths = edges - 0.5 * excess[..., None]
        return np.asarray(lengths)

    def _sag(
        self, lengths: Array, outward: Array, corners: Indices, *, flat: bool = False
    ) -> Array:
        """Return the excess (…, n) [m] of edges with straight parts (…, n, 2) [m] by their sag."""
        core = self.hold.body.section.core[corners]
        between = (core[:, 1] - core[:, 0]) * float(flat)
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
        bends = sorted({*self.events, self._pitched})
        start, level = self.ready.pitch, self._level
        rises = [float(np.clip((x - level) / (self._pitched - level), 0.0, 1.0)) for x in bends]
        pitches = [start + (self.pitch - start) * rise for rise in rises]
        return [Place(x, 0.0, pitch, 0.0) for x, pitch in zip(bends, pitches, strict=True)]

    @property
    def laid(self) -> Place:
        """The place of cables that lie on one another."""
        return self.crossed._replace(pitch=0.0)

    def samples(self, count: int) -> Iterator[dict[str, Array]]:
        """Yield all curves at samples of the path to the cables that lie on one another."""
        for start, end in pairwise([self.first, self.ready, *self.bent, self.laid]):
            change = PlaceChange(start, end, SmoothLaw(0.5))
            yield self.curves(change, np.linspace(0.0, 1.0, count))

    def closest_rolling(self, requirements: Requirements) -> Distance:
        """Return the distance with the smallest margin at samples while pairs roll."""
        origin, tension = self.hold.body.place, np.stack([self.tension, self.tension])
        roll = Move(origin, origin, tension, (0.0, 0.0), SmoothLaw(0.5), roll=(OPEN, 0.0))
        curves = self.hold.curves(roll, np.linspace(0.0, 1.0, SAMPLES))
        inner = curves["vertices"][:, self.hold.team.layout.anchors]
        return self._closest(curves, inner, requirements)

    def closest_bent(self, requirements: Requirements) -> Distance:
        """Return the distance with the smallest margin, from straight to crossing cables."""
        found = list[Distance]()
        for count in (SAMPLES, FINE_SAMPLES):
            for each in self.samples(count):
                inner = each["anchors"].reshape(each["drones"].shape)
                found.append(self._closest(each, inner, requirements))
            if min(each.margin for each in found) < 0.0:
                break
        return min(found, key=lambda each: each.margin)

    def _closest(
        self, curves: dict[str, Array], inner: Array, requirements: Requirements
    ) -> Distance:
        """Return the smallest distance, with the inner ends of legs (J, 2n, 3) [m]."""
        separation, n, drones = requirements.separation, self.hold.team.robots, curves["drones"]
        points, (i, j) = drones * separation.scale, np.triu_indices(2 * n, 1)
        closest = float(np.min(length(points[:, i] - points[:, j])))
        pairs, ends = (each.reshape(len(drones), n, 2, 3) for each in (drones, inner))
        route = [pairs[:, :, 0], ends[:, :, 0], *np.moveaxis(curves["contacts"], 2, 0)]
        route += [ends[:, :, 1], pairs[:, :, 1]]
        parts = np.stack([np.stack(route[:-1], 2), np.stack(route[1:], 2)], axis=3)
        others = np.flatnonzero((np.arange(2 * n) // 2 != np.arange(n)[:, None]).ravel())
        cable, drone = np.divmod(others, 2 * n)
        offsets = shortest_offset(differences(drones[:, drone, None, None], parts[:, cable]))
        gap = float(np.min(length(offsets)))
        lowest = float(np.min(drones[..., 2])) - requirements.floor
        off = requirements.position_error * requirements.height_ratio
        wide = DISTANCE_FACTOR * separation.cable + EXTRA_DISTANCE
        each = (
            Distance("separation", closest, 1.0, MIN_SEPARATION, "ratio"),
            Distance("cable_clearance", gap, separation.cable, wide),
            Distance("arena", lowest, off, MIN_HEIGHT + off),
        )
        return min(each, key=lambda x: x.margin)

    def unbalanced(self, requirements: Requirements) -> Check | None:
        """Return the check that cables violate that lie on one another, each for itself; or None.

        One cable of a clasp bears the other if their legs are of very different lengths.
        """
        change, phase = PlaceChange(self.laid, self.laid, SmoothLaw(0.5)), Phase("lay", 0, 0.0, 1.0)
        return first_violated(self._whole(change, requirements, phase), ["equilibrium"])

    @property
    def drones_taut(self) -> Array:
        """(2n, 3) [m]: drones of straight cables beside the object."""
        change = PlaceChange(self.first, self.first, SmoothLaw(0.5))
        return np.asarray(self.curves(change, np.zeros(1))["drones"][0])

    def hanging(self, requirements: Requirements) -> tuple[Array, float]:
        """Return drones (2n, 3) [m] with cables that hang beside the object, and their rise [m].

        Cables also keep off the ground as they turn about it there.
        """
        team, pairs = self.hold.team, self.drones_taut.reshape(-1, 2, 3)
        middle, chords = np.mean(pairs, axis=1, keepdims=True), length(pairs[:, 1] - pairs[:, 0])
        rises = (pairs[:, 1] - pairs[:, 0])[:, 2]
        longest = np.minimum(_longest_spans(team, requirements), chords)
        share = np.sqrt((longest**2 - rises**2) / (chords**2 - rises**2))
        scale = share[:, None, None] * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
        drones = (middle + scale * (pairs - middle)).reshape(-1, 3)
        turned = middle + math.cos(0.5 * MAX_TURN) * scale * (pairs - middle)
        both = np.stack([drones, turned.reshape(-1, 3)])
        lowest = hover_altitude(team, both, requirements)
        rise = max(lowest - float(np.min(drones[:, 2])), 0.0)
        return drones + [0.0, 0.0, rise], rise

    def stages(self, planner: MovePlanner) -> list[Motion]:
        """Return the motions from hanging cables to those that are tied, with one tension."""
        requirements, step = planner.requirements, planner.step
        drones, rise = self.hanging(requirements)
        first = self.first._replace(above=rise)
        raised = self.drones_taut + [0.0, 0.0, rise]
        context = self.hold.team, requirements, step
        roll = planner.within_limits(planner.move(SmoothLaw(1.0), roll=(OPEN, 0.0)), "separation")
        rolling = planner.motion([roll], "roll")
        phases = [replace(x, state=CableState.ROLLING, tension=self._range) for x in rolling.phases]
        drawing = [Keyframe("draw taut", raised, CableState.DRAWN)]
        stages = straight_stages(drones, drawing, *context)
        stages.append(self._tension(first, requirements, step))
        if first != self.ready:
            stages.append(self._motion("lower", [first, self.ready], requirements, step))
        hold = PhaseHold(planner.state.object, self.hold.by, tuple(range(self.hold.team.robots)))
        straddling = [self.ready, *self.bent]
        stages.append(self._motion("straddle", straddling, requirements, step, hold))
        laying = [self.crossed, self.laid]
        stages.append(self._motion("lay", laying, requirements, step, hold))
        return [*stages, rolling.replaced(phases=tuple(phases))]

    @property
    def _range(self) -> tuple[float, float]:
        """Range of the tensions [N]."""
        return float(np.min(self.tension)), float(np.max(self.tension))

    def _tension(self, place: Place, requirements: Requirements, step: int) -> Motion:
        """Return the motion at rest in which tensions rise."""
        change = PlaceChange(place, place, SmoothLaw(0.5 * TENSION_SECONDS))
        motion = self._whole(change, requirements, Phase("tension", step, 0.0, 1.0))
        breaks = np.array([0.0, TENSION_SECONDS])

        def at_rest(part: PiecewisePolynomial) -> PiecewisePolynomial:
            return PiecewisePolynomial.constant(breaks, part.coefficients[0, ..., 0])

        resting = motion.map_curves(at_rest, motion.phases)
        rising = PiecewisePolynomial(breaks, (self.tension[:, None] * SMOOTH)[None])
        return resting.replaced(tensions=rising)

    def _motion(
        self,
        name: str,
        places: Sequence[Place],
        requirements: Requirements,
        step: int,
        hold: PhaseHold | None = None,
    ) -> Motion:
        """Return the motion through places, at rest at each, as one phase."""
        phase, parts = Phase(name, step, 0.0, 1.0, hold=hold), list[Motion]()
        for start, end in pairwise(places):
            change = PlaceChange(start, end, SmoothLaw(0.5))
            drones = self.curves(change, np.linspace(0.0, 1.0, SAMPLES))["drones"]
            travel = max(float(np.max(np.sum(length(np.diff(drones, axis=0)), axis=0))), 1e-6)
            limits = requirements.limits
            speed = min(STRADDLE_SPEED, limits.speed, limits.vertex_speed) / travel
            rates = speed, 0.5 * limits.acceleration / travel, 0.5 * limits.jerk / travel
            change = replace(change, law=SmoothLaw.fastest(*rates))
            motion = self._whole(change, requirements, phase)
            factor = needed_stretch(motion)
            if 1.0 < factor < math.inf:
                change = replace(change, law=change.law.slowed(1.01 * factor))
                motion = self._whole(change, requirements, phase)
            parts.append(motion)
        whole = concatenated(parts)
        return whole.replaced(phases=(replace(parts[0].phases[0], end=whole.duration),))

    def _whole(self, change: PlaceChange, requirements: Requirements, phase: Phase) -> Motion:
        """Return the motion of a change of the place as one phase; objects are at rest."""
        parts: dict[str, Any] = polynomials(change, lambda t: self.curves(change, t))
        breaks = parts["drones"].breaks
        objects = requirements.objects
        parts["poses"] = PiecewisePolynomial.constant(breaks, poses_of(objects))
        parts["load_share"] = PiecewisePolynomial.constant(breaks, np.zeros(len(objects)))
        bent = replace(phase, state=CableState.BENT, tension=self._range)
        phases = (bent.retimed(0.0, change.law.duration),)
        return Motion(self.hold.team, requirements, **parts, phases=phases)


def _longest_spans(team: Team, requirements: Requirements) -> Array:
    """Return the distances (n,) [m] of drones whose cables hang beside the object."""
    off = requirements.position_error * requirements.height_ratio
    L = team.cable_length
    return np.asarray(np.minimum(MAX_SPAN_RATIO * L, L - SLACK * off))


def find_straddle(
    hold: GripHold, tension: Array, requirements: Requirements, drones: Array | None = None
) -> Straddle:
    """Return the first straddle that keeps distances at samples, else that with the most margin.

    Clasps are tied so far from the object that drones which turn about each other keep off the
    ground, and are drawn to those of ``hold`` then. ``drones`` (2n, 3) [m] are those before, with
    hanging cables. InfeasibleError: pitched cables would meet sides of the object, wherever clasps
    are tied.
    """
    centre, team, separation = np.mean(hold.polygon, axis=0), hold.team, requirements.separation
    aligned = rotated(hold.polygon - centre, _angle_to_side(hold))
    spans, off = _longest_spans(team, requirements), requirements.position_error
    hanging = [Catenary.spanning(spans, 0.0, team.cable_length)]
    if drones is not None:
        hanging.append(Catenary.between(drones[0::2], drones[1::2], team.cable_length))
    displaced = [x.extra_displacement(off, requirements.height_ratio) for x in hanging]
    farthest = float(np.max(displaced, where=np.isfinite(displaced), initial=0.0))
    # Cables may turn about the object
    section, axes = hold.body.section, unit(hold.polygon[1] - hold.polygon[0])
    radius = max(each.section.circumradius for each in hold.body.slabs)
    sides = section.support(np.array([[-axes[1], axes[0]], [axes[1], -axes[0]]]))
    beside = separation.object + BESIDE + farthest + radius - 0.5 * float(np.sum(sides))

    def candidates() -> Iterator[tuple[float, Straddle]]:
        for scale, share in product(SCALES, SHORT_SHARES):
            around = centre + scale * aligned
            wraps = wraps_around(hold.body.section, around)
            legs = share * (team.cable_length - wraps.lengths)
            if scale > 1.0 and np.min(legs) < requirements.limits.leg + MIN_RADIAL:
                continue
            opened = replace(hold, polygon=around, around=around, fractions=np.full(2, share))
            rolled = Straddle(opened, tension, 0.0, beside)
            try:
                margin = rolled.closest_rolling(requirements).margin
            except InfeasibleError:  # clasps that tensions cannot balance
                margin = -math.inf
            if margin < 0.0:
                yield margin - 1.0, rolled
                continue
            if rolled.sides_passed or rolled.unbalanced(requirements):
                yield UNFIT, rolled
                continue
            for pitch in PITCHES:
                straddle = replace(rolled, pitch=float(pitch))
                yield min(margin, straddle.closest_bent(requirements).margin), straddle

    found = best(candidates(), 0.0)
    if found.sides_passed:
        raise InfeasibleError([_met_sides(found)])
    unbalanced = found.unbalanced(requirements)
    if unbalanced:
        remedy = "raise the tension of tie, or use lighter cables or other lengths of them"
        raise InfeasibleError([unbalanced.violation("as cables lie on one another", remedy)])
    closest = [found.closest_rolling(requirements)]
    if found.pitch > 0.0:  # of pairs that can roll
        closest.append(found.closest_bent(requirements))
    name, value, limit, _, unit_of_both = min(closest, key=lambda each: each.margin)
    if value < limit:
        remedy = "use longer cables, or enclose a narrow outline in a circle"
        if name == "arena":
            remedy = "tie it higher above the ground"
        when = "as cables bend around the object and roll, wherever they are tied"
        raise InfeasibleError(
            [Violation(name, value, limit, "min", unit_of_both, (), when, remedy)]
        )
    return found


def _angle_to_side(hold: GripHold) -> float:
    """Return the angle [rad] of the nearest side to the line through both clasps, if it is tiny.

    Grips are so accurate only. Straight cables must touch a side along all of its length.
    """
    sides = hold.body.section.sides
    angles = turn(hold.polygon[1] - hold.polygon[0], sides[:, 1] - sides[:, 0])
    angles = (angles + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    nearest = float(angles[np.argmin(np.abs(angles))])
    return nearest if len(sides) > 1 and abs(nearest) < MIN_BEND else 0.0


def _met_sides(straddle: Straddle) -> Violation:
    """Return the violation of pitched cables that meet the sides of an object."""
    largest = math.degrees(float(np.max(straddle.turns)))
    pitched = max(straddle.sides_passed) * largest
    remedy = "use longer cables, which are tied farther out, or enclose the outline in a circle"
    when = "where cables cross beyond the object and meet another of its sides as they bend"
    limit = straddle._pitched * largest
    return Violation("continuity", pitched, limit, "max", "deg", (), when, remedy)
