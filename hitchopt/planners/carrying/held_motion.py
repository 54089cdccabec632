"""Motions of a hitch with an object on its clasps: legs lean by what these carry, and its inertia.

All is computed in the object's frame, in which the clasps rest: directions of legs there follow
from the forces on clasps, for which ``hitchopt.motion.carried`` has the law.
"""

from __future__ import annotations

from dataclasses import dataclass

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
from hitchopt.motion.carried import Supports
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.carrying.smooth_law import SmoothLaw
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PROBE = 2e-3
"""[s] Step of finite differences of the fourth order: they err by 1e-9 m/s² in such motions."""

STENCIL = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0

LONGEST = 0.5
"""[s] Longest piece while what is held turns or tensions change."""


@dataclass(frozen=True, eq=False)
class HeldHitch:
    """A hitch at rest below an object, in the object's frame.

    Attributes
    ----------
    team: who flies.
    body: what is held.
    places: (n, 3) [m], the clasps below the rim.
    fractions: (n,), how slack is split, ``d_k / (d_k + e_k)``.
    """

    team: Team
    body: SolidObject
    places: Array
    fractions: Array

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

    def drones(self, tension: Array, forces: Array) -> tuple[Array, Array]:
        """Return drones (…, 2n, 3) [m] in the object's frame, and legs' chords (…, n, 2) [m].

        Parameters
        ----------
        tension: (…, n) [N]
        forces: (…, n, 3) [N], of the object on clasps, in its frame.

        Raises
        ------
        InfeasibleError: forces that the tensions cannot carry.
        """
        team = self.team
        edges = np.roll(self.places, -1, axis=0) - self.places
        slack = cable_slack_of(team, edges, tension)
        q_legs = self.fractions * slack
        own = clasp_loads(team, q_legs, slack, np.zeros(team.robots))
        halves = np.zeros((*forces.shape[:-1], 2)) if own is None else own.halves
        total = forces if own is None else forces + own.forces
        loads = ClaspLoads(total, halves, np.zeros(forces.shape[:-1]))
        along = np.broadcast_to(edges / np.linalg.norm(edges, axis=-1, keepdims=True), forces.shape)
        q, r = leg_directions(along, tension, team.topology, loads)
        factors = sag_factors(team, tension)
        d, e = leg_vectors(q_legs, q, factors), leg_vectors(slack - q_legs, r, factors)
        both = np.stack([d, e], axis=-2)
        anchors = self.places[team.layout.anchors].reshape(*both.shape[-3:])
        chords = np.linalg.norm(both, axis=-1)
        return (anchors + both).reshape(*both.shape[:-3], -1, 3), chords


@dataclass(frozen=True, eq=False)
class Move:
    """What changes in a span of time, by one share from 0 to 1.

    Attributes
    ----------
    start, end: (4,) x, y, z [m] of the object's base and its yaw [rad], of what the clasps' frame
        follows.
    tension: (2, n) [N], before and after.
    borne: share of the object's weight on clasps before and after.
    below: how far the clasps are below the rim before and after [m]; 0 where they touch it.
    law: of the share.
    """

    start: Array
    end: Array
    tension: Array
    borne: tuple[float, float]
    below: tuple[float, float]
    law: SmoothLaw


@dataclass(frozen=True, eq=False)
class HeldFlight:
    """Curves of a hitch that holds an object.

    Attributes
    ----------
    flight: of the hitch.
    pose: of the object, (5,).
    borne: the share of its weight on clasps, ().
    """

    flight: Flight
    pose: PiecewisePolynomial
    borne: PiecewisePolynomial


def held_flight(held: HeldHitch, move: Move) -> HeldFlight:
    """Return the curves of a move, from rest to rest.

    Raises
    ------
    InfeasibleError: a weight that the tensions cannot carry.
    """
    moves = bool(np.any(move.start != move.end)) or move.below[0] != move.below[1]
    turns = move.start[3] != move.end[3]
    changes = bool(np.any(move.tension[0] != move.tension[1])) or move.borne[0] != move.borne[1]
    longest = LONGEST if turns or changes or not moves else np.inf
    breaks = move.law.breaks(longest)
    t = np.clip(breaks[:, None] + PROBE * STENCIL, 0.0, move.law.duration)
    values = _curves(held, move, t)
    centre = len(STENCIL) // 2
    parts = {}
    for name, each in values.items():
        jets = [
            each[:, centre],
            np.tensordot(FIRST / PROBE, each, (0, 1)),
            np.tensordot(SECOND / PROBE**2, each, (0, 1)),
        ]
        for jet in jets[1:]:
            jet[[0, -1]] = 0.0
        constant = np.all(each == each[:1, :1])
        whole = np.stack(jets)
        parts[name] = (
            PiecewisePolynomial.constant(breaks, each[0, 0])
            if constant
            else PiecewisePolynomial.hermite(breaks, whole[:, :-1], whole[:, 1:])
        )
    flight = Flight(parts["drones"], parts["vertices"], parts["legs"], parts["tensions"])
    share = np.clip(parts["borne"].coefficients, 0.0, 1.0)  # polynomials overshoot by 1e-6
    return HeldFlight(flight, parts["pose"], PiecewisePolynomial(breaks, share))


def _curves(held: HeldHitch, move: Move, t: Array) -> dict[str, Array]:
    """Return all curves at times t (…) [s]."""
    share, speed, change = np.moveaxis(move.law.jet(t), -1, 0)
    offset = move.end - move.start
    place = move.start + share[..., None] * offset
    lifted = move.borne == (1.0, 1.0)
    yaw, turning = place[..., 3], speed * offset[3]
    pose = np.concatenate([place[..., :3], np.cos(yaw)[..., None], np.sin(yaw)[..., None]], axis=-1)
    borne = move.borne[0] + share * (move.borne[1] - move.borne[0])
    tension = move.tension[0] + share[..., None] * (move.tension[1] - move.tension[0])
    pushed = change[..., None] * offset[:3]
    back = np.stack([0 * yaw, 0 * yaw, 0 * yaw, np.cos(yaw), -np.sin(yaw)], axis=-1)
    level = in_world(back, pushed)

    def accelerated(points: Array) -> Array:
        """Return accelerations (…, k, 3) [m/s²] of points (k, 3) of the object, in its frame."""
        x, y = points[:, 0], points[:, 1]
        inward, sideways = (turning**2)[..., None], (change * offset[3])[..., None]
        spin = [-inward * x - sideways * y, sideways * x - inward * y, 0.0 * inward * x]
        found: Array = level[..., None, :] + np.stack(spin, axis=-1)
        return found

    centre = held.body.centre_of_mass
    forces = np.zeros((*t.shape, *held.places.shape))
    if lifted:
        supports = held.supports
        pulled = accelerated(held.places) + np.array([0.0, 0.0, GRAVITY])
        forces = -held.body.mass * supports.shares[:, None] * pulled
        moved = accelerated(centre[None])[..., 0, :2] @ supports.gains.T
        forces[..., 2] += held.body.mass * held.height * moved
    else:
        weight = GRAVITY * held.body.mass * held.supports.shares
        forces[..., 2] = -borne[..., None] * weight
    drones, legs = held.drones(tension, forces)
    below = move.below[0] + share * (move.below[1] - move.below[0])
    lower = np.stack([0 * below, 0 * below, below], axis=-1)[..., None, :]
    places = np.broadcast_to(held.places, (*t.shape, *held.places.shape))
    # Clasps that are not below the rim yet move on their own, as the object does not.
    curves: dict[str, Array] = {
        "drones": in_world(pose[..., None, :], drones - lower),
        "vertices": in_world(pose[..., None, :], places - lower),
        "legs": legs,
        "tensions": tension,
        "pose": pose,
        "borne": borne,
    }
    return curves
