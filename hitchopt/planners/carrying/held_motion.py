"""A hitch at rest below an object, and its motions: the object's rim lies on its clasps.

All is computed in the object's frame, in which the clasps rest: directions of legs there follow
from the forces on clasps, for which ``hitchopt.motion.carried`` has the law.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.cable_spans import (
    ClaspLoads,
    cable_slack_of,
    clasp_loads,
    leg_vectors,
    sag_factors,
)
from hitchopt.hitch.statics import leg_directions
from hitchopt.motion.carried import Supports, rim_drop, rim_savings, strut_share
from hitchopt.motion.phases import HoldBy
from hitchopt.objects import SolidObject
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
        onward = np.roll(self.places, -1, axis=0) - self.places
        inward = np.stack([onward[:, 1], -onward[:, 0]], axis=-1)
        inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
        away = self.body.centre_of_mass[:2] - self.places[:, :2]
        return float(np.min(np.sum(inward * away, axis=-1)))

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
        halves = np.zeros((*forces.shape[:-1], 2)) if own is None else own.halves
        total = forces if own is None else forces + own.forces
        loads = ClaspLoads(total, halves, np.broadcast_to(self.roll, forces.shape[:-1]))
        along = np.broadcast_to(edges / np.linalg.norm(edges, axis=-1, keepdims=True), forces.shape)
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
        chords = np.linalg.norm(both, axis=-1)
        return (anchors + both).reshape(*both.shape[:-3], -1, 3), chords

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
        edges = np.linalg.norm(np.roll(self.places, -1, axis=0) - self.places, axis=-1)
        strut = strut_share(self.team, self.body.mass, edges, course.tension)
        saved = rim_savings(self.team, self.body, self.places[:, :2], course.tension)
        squared = course.borne**2
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
