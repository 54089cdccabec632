"""A hitch below an object whose rim lies on its clasps: its motions, polygon and largest mass.

All is computed in the object's frame, in which the clasps rest: directions of legs there follow
from the forces on clasps, for which ``hitchopt.motion.loads`` has the law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import (
    ClaspLoads,
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    sag_factors,
)
from hitchopt.motion.loads import Supports, rim_drop, rim_savings, strut_share
from hitchopt.motion.motion import HoldBy
from hitchopt.objects import Section, SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.carrying.moves import SHARE, Move, courses
from hitchopt.values import Array

GENTLE = 0.4
"""[m/s²] Largest acceleration of what rests on clasps. At 1 m/s² simulated clasps without friction
of cables on each other slid on a rim by 3 to 8 cm as the carrying began: drones follow with a lag,
and little force moves such clasps."""


@dataclass(frozen=True, eq=False)
class HeldHitch:
    """A hitch at rest below an object, in the object's frame.

    Attributes
    ----------
    team: who flies.
    body: what is held.
    places: (n, 3) [m], the clasps below the rim.
    fractions: (n,), how slack is split, ``d_k / (d_k + e_k)``.
    roll: (n,) [rad], of the legs, as of ``Hitch``.
    """

    by: ClassVar[HoldBy] = HoldBy.REST
    team: Team
    body: SolidObject
    places: Array
    fractions: Array
    roll: Array

    @property
    def supports(self) -> Supports:
        """How clasps share the object's mass."""
        return Supports.at(self.places[:, :2], self.body.centre_of_mass[:2])

    @property
    def height(self) -> float:
        """Height [m] of the centre of mass above the clasps."""
        return float(self.body.centre_of_mass[2] - self.places[0, 2])

    @property
    def support_width(self) -> float:
        """Distance [m] of the centre of mass to the nearest edge of the supports, from above."""
        _, reach = _sides(self.places[:, :2] - self.body.centre_of_mass[:2])
        return float(np.min(reach))

    def drones(
        self,
        tension: Array,
        forces: Array,
        taken: Array | None = None,
        saved: Array | float = 0.0,
    ) -> tuple[Array, Array]:
        """Return drones (…, 2n, 3) [m] in the object's frame, and legs' chords (…, n, 2) [m].

        Parameters
        ----------
        tension: (…, n) [N]
        forces: (…, n, 3) [N], of the object on clasps, in its frame.
        taken: (…), share of edges' pulls that the rim takes; None where loads hang at clasps.
        saved: (…, n, 2) [m], by how much straight legs are longer than those that the rim bends.

        Raises
        ------
        InfeasibleError: forces that the tensions cannot carry.
        """
        team = self.team
        edges = np.roll(self.places, -1, axis=0) - self.places
        slack = cable_slack_of(team, edges, tension)
        q_legs = self.fractions * slack
        own = clasp_loads(team, q_legs, slack, self.roll)
        none = np.zeros((*forces.shape[:-1], 2))
        halves, edge_halves = (none, none) if own is None else (own.halves, own.edges)
        if taken is not None:
            edge_halves = (1.0 - taken[..., None, None]) * edge_halves
        total = forces if own is None else forces + own.forces
        roll = np.broadcast_to(self.roll, forces.shape[:-1])
        loads = ClaspLoads(total, halves, roll, edge_halves)
        along = np.broadcast_to(unit(edges), forces.shape)
        left, pulls = tension, None
        if taken is not None:
            legs = np.broadcast_to(tension, forces.shape[:-1])
            left, pulls = (1.0 - taken[..., None]) * legs, np.stack([legs, legs], axis=-1)
        q, r = leg_directions(along, left, team.topology, loads, None, pulls)
        factors = sag_factors(team, tension)
        lengths = np.stack([q_legs, slack - q_legs], axis=-1) + saved
        d, e = (leg_vectors(lengths[..., i], (q, r)[i], factors) for i in (0, 1))
        both = np.stack([d, e], axis=-2)
        anchors = self.places[team.layout.anchors].reshape(*both.shape[-3:])
        return (anchors + both).reshape(*both.shape[:-3], -1, 3), length(both)

    def at_rest(self, tension: Array, mass: float) -> Array:
        """Return drones (2n, 3) [m] in the object's frame where a mass [kg] hangs at the clasps.

        Raises
        ------
        InfeasibleError: more than legs carry so; bent over a rim they would, more steeply.
        """
        forces = np.zeros(self.places.shape)
        forces[:, 2] = -GRAVITY * mass * self.supports.shares
        return self.drones(tension, forces)[0]

    def drop(self, tension: Array, borne: Array | float) -> Array:
        """Return how far vertices are below the rim (…) [m], as ``rim_drop``."""
        return rim_drop(self.team, self.body, self.places[:, :2], tension, borne)

    @property
    def reach(self) -> float:
        """Largest level distance [m] of a drone from the object's origin without a load."""
        drones, _ = self.drones(self.team.tension, np.zeros(self.places.shape))
        return float(np.max(np.linalg.norm(drones[:, :2], axis=1)))

    @property
    def largest_acceleration(self) -> float:
        """What friction and supports allow, to a share, and GENTLE at most [m/s²]."""
        leaning = GRAVITY * self.support_width / max(abs(self.height), 1e-9)
        return min(GENTLE, SHARE * min(self.body.friction * GRAVITY, leaning))

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s]."""
        course = courses(move, t)
        forces = np.zeros((*t.shape, *self.places.shape))
        if move.lifted:
            supports = self.supports
            pulled = course.accelerations(self.places) + np.array([0.0, 0.0, GRAVITY])
            forces = -self.body.mass * supports.shares[:, None] * pulled
            centre = self.body.centre_of_mass[None]
            moved = course.accelerations(centre)[..., 0, :2] @ supports.gains.T
            forces[..., 2] += self.body.mass * self.height * moved
        else:
            weight = GRAVITY * self.body.mass * self.supports.shares
            forces[..., 2] = -course.borne[..., None] * weight
        edges = length(np.roll(self.places, -1, axis=0) - self.places)
        squared = course.borne**2
        strut = strut_share(self.team, self.body.mass, edges, course.tension)
        saved = rim_savings(self.team, self.body, self.places[:, :2], course.tension)
        saved = squared[..., None, None] * saved
        drones, legs = self.drones(course.tension, forces, squared * strut, saved)
        below = course.between(*move.below) + self.drop(course.tension, course.borne)
        lower = np.stack([0 * below, 0 * below, below], axis=-1)[..., None, :]
        places = np.broadcast_to(self.places, (*t.shape, *self.places.shape))
        # Clasps that are not at the rim move on their own, as the object does not.
        return {
            "drones": in_world(course.pose[..., None, :], drones - lower),
            "vertices": in_world(course.pose[..., None, :], places - lower),
            "legs": legs,
            "tensions": course.tension,
            "pose": course.pose,
            "borne": course.borne,
        }


ROOM = 0.045
"""[m] Room besides the distance to be kept: 25 mm, the most that edges have been seen to err, and
20 mm for where the object really is."""

INSET = 0.05
"""[m] Clasps are this far inside of a rim, and edges off the body, where there is as much room."""

LEAST_INSET = 0.01
"""[m] The same where there is less."""

ANGLES, ASPECTS = 12, 17
"""Numbers of orientations and of proportions that are tried."""

SHRINKS = np.linspace(0.05, 1.0, 96)
"""Sizes of a polygon below a rim that are tried, over the rim's own."""


def rest_polygons(name: str, body: SolidObject, robots: int, gap: float) -> HoldPolygons:
    """Return the polygons for a number of robots.

    Of regular polygons about the centre of mass, turned and stretched along the rim's axes, the one
    whose clasps are the farthest inside of the rim and edges off the body; of those with INSET to
    both the one with the widest support.

    Parameters
    ----------
    name, body: the object; it has a rim.
    robots: number of vertices.
    gap: how far edges around it keep from it [m].

    Raises
    ------
    InfeasibleError: no polygon fits between body and rim.
    """
    assert body.rim is not None
    rim, centre = body.rim.section, body.centre_of_mass[:2]
    frame, size = _axes(rim)
    angles = 2.0 * math.pi / robots * np.arange(ANGLES) / ANGLES
    corners = angles[:, None] - 2.0 * math.pi * np.arange(robots) / robots
    regular = math.sqrt(2.0) * np.stack([np.cos(corners), np.sin(corners)], axis=-1)
    wide = np.geomspace(0.5, 2.0, ASPECTS)[:, None, None] ** [0.5, -0.5]
    shapes = (regular[:, None] * wide).reshape(-1, robots, 2)
    places = (shapes[:, None] * SHRINKS[:, None, None] * size) @ frame.T + centre
    inside = -np.max(rim.clearance(places)[0], axis=-1)
    outward, offsets = _sides(places)
    width = np.min(offsets - outward @ centre, axis=-1)
    inset = np.minimum(inside, INSET)
    if body.stem is not None:
        inset = np.minimum(inset, np.min(offsets - body.stem.support(outward), axis=-1))
    best = np.unravel_index(int(np.argmax(inset + 1e-3 * width)), inset.shape)
    if inset[best] < LEAST_INSET:
        value, words = float(inset[best]), "below the rim of the object"
        remedy = (
            f"give objects.{name} a wider rim, or use another number of robots: `hitchopt fit` "
            "tells with which its outline is held"
        )
        broken = Violation("support", value, LEAST_INSET, "min", "m", (name,), words, remedy)
        raise InfeasibleError([broken])
    return HoldPolygons.about(places[best], centre, (rim, body.section), gap)


def _axes(section: Section) -> tuple[Array, Array]:
    """Return the axes (2, 2) of a section as columns, and half of its widths along them [m]."""
    core = section.core
    if len(core) < 3:
        return np.eye(2), np.full(2, section.rounding)
    sides = unit(np.roll(core, -1, axis=0) - core)
    turned = np.stack([sides, np.stack([-sides[:, 1], sides[:, 0]], axis=1)], axis=2)
    widths = np.ptp(np.einsum("pd,sdi->spi", core, turned), axis=1)  # (sides, 2)
    best = int(np.argmin(np.prod(widths, axis=1)))
    return turned[best], 0.5 * widths[best]


ALIKE, STRETCHES = np.ones(1), np.geomspace(0.25, 4.0, 81)
"""Proportions of a polygon around an object that rests on it, and those that are tried around one
that is gripped, over those with which it is held."""


@dataclass(frozen=True, eq=False)
class HoldPolygons:
    """Where clasps are around an object, and where they hold it, as seen from it.

    Attributes
    ----------
    around: (n, 2) [m], outside of all of the object.
    closed: (n, 2) [m], below its rim, or where edges grip it; one is the other one stretched.
    """

    around: Array
    closed: Array

    @classmethod
    def about(
        cls,
        closed: Array,
        centre: Array,
        sections: tuple[Section, ...],
        gap: float,
        stretches: Array = ALIKE,
    ) -> HoldPolygons:
        """Return a polygon and the one about a centre, stretched, that keeps off sections.

        Of the stretches along the polygon's axes the one whose longest edge is the shortest leaves
        the most cable to legs, which keeps drones apart.

        Parameters
        ----------
        closed: (n, 2) [m], clockwise, the centre (2,) [m] inside of it.
        gap: between edges and sections [m].
        stretches: proportions that are tried, over the polygon's own.
        """
        away = closed - centre
        axes = np.linalg.eigh(away.T @ away)[1]
        found = []
        for wide in np.sqrt(stretches):
            there = away @ (axes * [wide, 1.0 / wide]) @ axes.T
            outward, reach = _sides(there)
            needed = [each.support(outward) + gap - outward @ centre for each in sections]
            found.append(float(np.max(np.max(needed, axis=0) / reach)) * there)
        around = min(found, key=lambda each: float(np.max(length(np.roll(each, -1, 0) - each))))
        return cls(ConvexPolygon(centre + around).vertices, ConvexPolygon(closed).vertices)


def _sides(polygon: Array) -> tuple[Array, Array]:
    """Return outward normals (…, n, 2) of a clockwise polygon's edges, and their offsets [m]."""
    onward = np.roll(polygon, -1, axis=-2) - polygon
    outward = unit(np.stack([-onward[..., 1], onward[..., 0]], axis=-1))
    return outward, np.sum(outward * polygon, axis=-1)
