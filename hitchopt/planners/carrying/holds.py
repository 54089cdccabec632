"""A hitch that holds an object: below its rim, or with cables wrapped around it; its curves.

All is computed in the object's frame, in which legs follow from the forces on clasps. A rim rests
on clasps by the law of ``hitchopt.motion.loads``. A grip holds by friction: every cable pulls
equally along its whole edge; edges slope from the clasps down to the plane of contact and so carry
the weight. While the object is off its support all clasps are ahead of it by millimetres, so that
edges pull it along: level forces come from where edges bend, and need no friction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from hitchopt.checks.clasps import BALANCE_LIMIT
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import (
    ClaspLoads,
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    sag_factors,
)
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.holding import (
    Bends,
    Wraps,
    balanced,
    edge_ratios,
    straight_parts,
    wraps_around,
)
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.loads import Supports, rim_drop, rim_savings, strut_share
from hitchopt.motion.motion import HoldBy, Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world, poses_of
from hitchopt.planners.carrying.moves import Course, Move, SmoothLaw, polynomials
from hitchopt.planners.carrying.polygons import sides_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


def polygon_at(body: SolidObject, vertices: Array) -> ConvexPolygon:
    """Return a polygon (n, 2) [m] in an object's frame as seen from the world."""
    flat = np.column_stack([vertices, np.zeros(len(vertices))])
    return ConvexPolygon(in_world(body.pose, flat)[:, :2])


def leg_chords(
    team: Team, lengths: Array, directions: tuple[Array, Array], factors: Array, places: Array
) -> tuple[Array, Array]:
    """Return drones (…, 2n, 3) [m] and the legs' chords (…, n, 2) [m].

    Parameters
    ----------
    lengths: (…, n, 2) [m], cable in the legs q and r.
    directions: of these, (…, n, 3) each.
    factors: (…, n) [1/m²], as of ``sag_factors``.
    places: (…, n, 3) [m], clasps.
    """
    legs = (leg_vectors(lengths[..., i], directions[i], factors) for i in (0, 1))
    both = np.stack([*legs], axis=-2)
    anchors = places[..., team.layout.anchors, :].reshape(*places.shape[:-2], *both.shape[-3:])
    return (anchors + both).reshape(*both.shape[:-3], -1, 3), length(both)


@dataclass(frozen=True, eq=False)
class Hold(ABC):
    """A hitch that holds an object, in the object's frame.

    Attributes
    ----------
    team: who flies.
    body: the object.
    closed: (n, 2) [m], the clasps.
    height: of their contact with it above its base [m].
    fractions: (n,), how slack is split, ``d_k / (d_k + e_k)``.
    roll: (n,) [rad], of the legs, as of ``Hitch``.
    """

    by: ClassVar[HoldBy]
    team: Team
    body: SolidObject
    closed: Array
    height: float
    fractions: Array
    roll: Array

    @property
    def largest_acceleration(self) -> float:
        """Largest acceleration [m/s²] of the object, besides what the certificate bounds."""
        return np.inf

    @property
    def reach(self) -> float:
        """Largest level distance [m] of a drone from the object's origin without a load."""
        pulls, origin = np.stack([self.team.tension, self.team.tension]), np.zeros(4)
        rest = Move(origin, origin, pulls, (0.0, 0.0), SmoothLaw(1.0))
        drones = self.curves(rest, np.zeros(1))["drones"]
        return float(np.max(np.linalg.norm(drones[..., :2], axis=-1)))

    def drop(self, tension: Array, borne: Array | float) -> Array:
        """Return the depth (…) [m] of vertices below the clasps' contact with the object."""
        return 0.0 * tension[..., 0] * borne

    def hitch(self, body: SolidObject, depth: float = 0.0) -> Hitch:
        """Return the hitch as if it carried nothing, with the object at ``body``.

        Its vertices are ``depth`` [m] below their height in the hold.
        """
        polygon, altitude = polygon_at(body, self.closed), float(body.at[2]) + self.height - depth
        q_legs = self.fractions * cable_slack(self.team, polygon)
        return Hitch(self.team, polygon, altitude, q_legs, self.roll)

    @abstractmethod
    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        Raises
        ------
        InfeasibleError: a weight that the tensions cannot carry.
        """

    def motion(self, move: Move, requirements: Requirements, phase: Phase) -> Motion:
        """Return the motion of a move as one phase; all other objects stay where they stand."""
        parts: dict[str, Any] = polynomials(move, lambda t: self.curves(move, t))
        assert phase.hold is not None
        index = list(requirements.objects).index(phase.hold.object)
        breaks = parts["pose"].breaks
        pose, borne = parts.pop("pose").coefficients, parts["borne"].coefficients
        poses = np.repeat(poses_of(requirements.objects)[None, :, :, None], len(pose), axis=0)
        poses = np.repeat(poses, pose.shape[-1], axis=-1)
        poses[:, index] = pose
        shares = np.zeros((len(borne), len(requirements.objects), borne.shape[-1]))
        shares[:, index] = np.clip(borne, 0.0, 1.0)  # polynomials overshoot by 1e-6
        parts["poses"], parts["borne"] = (PiecewisePolynomial(breaks, c) for c in (poses, shares))
        phases = (phase.retimed(0.0, move.law.duration),)
        return Motion(self.team, requirements, **parts, phases=phases)


MAX_REST_ACCELERATION, USED_SHARE = 0.4, 0.8
"""[m/s²] Largest acceleration of an object at rest on clasps, and used share of the acceleration
that friction and supports allow. At 1 m/s² simulated clasps without friction of cables on each
other slid on a rim by 3 to 8 cm as the carrying began: drones follow with a lag, and little force
moves such clasps."""


@dataclass(frozen=True, eq=False)
class RestHold(Hold):
    """A hitch below an object whose rim rests on its clasps."""

    by: ClassVar[HoldBy] = HoldBy.REST

    @property
    def places(self) -> Array:
        """(n, 3) [m], the clasps below the rim."""
        return np.column_stack([self.closed, np.full(len(self.closed), self.height)])

    @property
    def supports(self) -> Supports:
        """How clasps share the object's mass."""
        return Supports.at(self.closed, self.body.centre_of_mass[:2])

    @property
    def _mass_height(self) -> float:
        """Height [m] of the centre of mass above the clasps."""
        return float(self.body.centre_of_mass[2]) - self.height

    @property
    def largest_acceleration(self) -> float:
        """Largest acceleration [m/s²] by friction and supports, MAX_REST_ACCELERATION at most."""
        _, offsets = sides_of(self.closed - self.body.centre_of_mass[:2])
        tipping = GRAVITY * float(np.min(offsets)) / max(abs(self._mass_height), 1e-9)
        sliding = self.body.friction * GRAVITY
        return min(MAX_REST_ACCELERATION, USED_SHARE * min(sliding, tipping))

    def drop(self, tension: Array, borne: Array | float) -> Array:
        """Return the depth (…) [m] of vertices below the rim that bends their legs."""
        return rim_drop(self.team, self.body, self.closed, tension, borne)

    def drones(
        self,
        tension: Array,
        forces: Array,
        strut: Array | None = None,
        saved: Array | float = 0.0,
    ) -> tuple[Array, Array]:
        """Return drones (…, 2n, 3) [m] in the object's frame, and legs' chords (…, n, 2) [m].

        Parameters
        ----------
        tension: (…, n) [N]
        forces: (…, n, 3) [N], of the object on clasps, in its frame.
        strut: (…), share of edges' pulls that the rim takes; None if loads hang at clasps.
        saved: (…, n, 2) [m], lengths of straight legs over those that the rim bends.

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
        total = forces if own is None else forces + own.forces
        left, pulls = tension, None
        if strut is not None:
            edge_halves = (1.0 - strut[..., None, None]) * edge_halves
            legs = np.broadcast_to(tension, forces.shape[:-1])
            left, pulls = (1.0 - strut[..., None]) * legs, np.stack([legs, legs], axis=-1)
        roll = np.broadcast_to(self.roll, forces.shape[:-1])
        loads = ClaspLoads(total, halves, roll, edge_halves)
        along = np.broadcast_to(unit(edges), forces.shape)
        directions = leg_directions(along, left, team.topology, loads, None, pulls)
        lengths = np.stack([q_legs, slack - q_legs], axis=-1) + saved
        return leg_chords(team, lengths, directions, sag_factors(team, tension), self.places)

    def check_unbent(self, tension: Array) -> None:
        """Raise InfeasibleError if legs that no rim bends do not carry the object's mass.

        Bent over a rim they would, more steeply.
        """
        forces = np.zeros(self.places.shape)
        forces[:, 2] = -GRAVITY * self.body.mass * self.supports.shares
        self.drones(tension, forces)

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s]."""
        course, team, body, supports = move.course(t), self.team, self.body, self.supports
        forces = np.zeros((*t.shape, *self.places.shape))
        if move.lifted:
            pulled = course.accelerations(self.places) + np.array([0.0, 0.0, GRAVITY])
            forces = -body.mass * supports.shares[:, None] * pulled
            centre = course.accelerations(body.centre_of_mass[None])[..., 0, :2]
            forces[..., 2] += body.mass * self._mass_height * (centre @ supports.gains.T)
        else:
            forces[..., 2] = -course.borne[..., None] * (GRAVITY * body.mass * supports.shares)
        tension, borne = course.tension, course.borne
        edges, squared = length(np.roll(self.places, -1, axis=0) - self.places), borne**2
        strut = squared * strut_share(team, body.mass, edges, tension)
        saved = squared[..., None, None] * rim_savings(team, body, self.closed, tension)
        drones, legs = self.drones(tension, forces, strut, saved)
        below = course.between(*move.below) + self.drop(tension, borne)
        lower = np.stack([0 * below, 0 * below, below], axis=-1)[..., None, :]
        places = np.broadcast_to(self.places, (*t.shape, *self.places.shape))
        # Clasps that are not at the rim move on their own, as the object does not.
        return {
            "drones": in_world(course.pose[..., None, :], drones - lower),
            "vertices": in_world(course.pose[..., None, :], places - lower),
            "legs": legs,
            "tensions": tension,
            "pose": course.pose,
            "borne": borne,
        }


MAX_PASSES, CONVERGED = 20, 1e-12
"""Maximum Newton steps for places and heights of clasps; steps [m] that are smaller end them."""

SAME_EVENT, PAST_EVENT = 1e-6, 3e-6
"""Shares of the path that are nearer to each other are one event; so far from one it is over."""

SCAN, BISECTIONS = 400, 60
"""Samples of the path from around the object to the grip at which edges are compared, and steps by
which an event between two samples is located."""


@dataclass(frozen=True, eq=False)
class GripHold(Hold):
    """A hitch that closes around an object and grips it; its legs are not rolled.

    Attributes
    ----------
    around: (n, 2) [m], clasps around the object.
    open_fractions: (n,), how slack is split there.
    """

    by: ClassVar[HoldBy] = HoldBy.GRIP
    around: Array
    open_fractions: Array

    @property
    def travel(self) -> float:
        """Longest path [m] of a clasp from around the object to the grip."""
        return float(np.max(length(self.closed - self.around)))

    @cached_property
    def events(self) -> Array:
        """Shares in (0, 1) of the path at which an edge meets the object or another corner.

        There legs begin to turn: drones have to rest.
        """
        shares = np.linspace(0.0, 1.0, SCAN + 1)
        bends, events = self._bends(shares), list[float]()
        for i in np.flatnonzero(bends[1:].differ(bends[:-1])):
            share, last = shares[i], bends[i + 1]
            while (before := self._bends(share)).differ(last):
                low, high = share, shares[i + 1]
                for _ in range(BISECTIONS):
                    middle = 0.5 * (low + high)
                    same = not self._bends(middle).differ(before)
                    low, high = (middle, high) if same else (low, middle)
                events.append(high)
                share = high
        return np.array(events)[np.diff(events, prepend=-1.0) > SAME_EVENT]

    def largest_push(self, tension: Array) -> float:
        """Return the largest level force [N] of edges on an object that stands.

        With tensions (n,) [N]; edges do not come to touch it all at once.
        """
        wraps = wraps_around(self.body.section, self._polygon(np.linspace(0.0, 1.0, SCAN + 1)))
        force = np.sum(tension[:, None] * (wraps.arriving - wraps.leaving), axis=-2)
        return float(np.max(length(force)))

    @property
    def opened(self) -> GripHold:
        """The hitch around the object."""
        return replace(self, closed=self.around, fractions=self.open_fractions)

    def _polygon(self, share: Array | float) -> Array:
        """Return the clasps (…, n, 2) [m] at shares (…) of the path to the grip."""
        path = self.closed - self.around
        return np.asarray(self.around + np.asarray(share)[..., None, None] * path)

    def _bends(self, share: Array | float) -> Bends:
        """Return the corners (…, n) about which edges bend at shares (…) of the path."""
        return wraps_around(self.body.section, self._polygon(share)).bends

    def _seam(self, share: float, bends: Bends) -> Array:
        """Return half of the change of spans (n,) [m³] if edges bend about other corners.

        Where an edge meets another corner, the straight part that sags is longer or shorter at
        once; moves before and after it, which ends at ``share``, meet halfway.
        """
        polygon = self._polygon(share)
        beyond = self._bends(np.clip(share + PAST_EVENT * np.array([-1.0, 1.0]), 0.0, None))
        others = [each for each in (beyond[0], beyond[1]) if each.differ(bends)]
        spans = []
        for each in (bends, *others[:1]):
            contacts = wraps_around(self.body.section, polygon, each).contacts
            spans.append(_span(*straight_parts(polygon, contacts, np.zeros(len(polygon)))))
        return 0.5 * (spans[-1] - spans[0])

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        Legs that lead pull with the tension, and edges with ``exp(-s μ θ)`` of that: s is the share
        of clasp friction, and θ the angle by which both of its cables turn at a clasp, the mean of
        the angles that edges and legs enclose.
        """
        course, team = move.course(t), self.team
        share, T = course.between(*move.closed), course.tension
        pulls, leading = np.stack([T, T], axis=-1), move.lead != (0.0, 0.0)
        bends = self._bends(0.5 * sum(move.closed))
        polygon, z, wraps = self._balanced(move, course, self._polygon(share), bends)
        leaving, arriving = straight_parts(polygon, wraps.contacts, z)
        if leading:
            lead = course.between(*move.lead)
            T = T * edge_ratios(team.cable_friction * lead, wraps.clasp_angles)
        factors, edges = sag_factors(team, T), wraps.arcs + (length(leaving) + length(arriving))
        if team.cable_density > 0.0:
            spans = _span(leaving, arriving)
            if move.closed[0] != move.closed[1]:
                before, after = (self._seam(end, bends) for end in move.closed)
                spans = spans + course.between(before, after)
            edges = edges + factors * spans
        slack = team.cable_length - edges
        split = self.open_fractions + share[..., None] * (self.fractions - self.open_fractions)
        q_legs = split * slack
        loads, onward = clasp_loads(team, q_legs, slack, None), unit(arriving)
        own = pulls if leading else None
        directions = leg_directions(unit(leaving), T, team.topology, loads, onward, own)
        places = np.concatenate([polygon, self.height + z[..., None]], axis=-1)
        lengths = np.stack([q_legs, slack - q_legs], axis=-1)
        drones, legs = leg_chords(team, lengths, directions, factors, places)
        level = np.full((*wraps.contacts.shape[:-1], 1), self.height)
        contacts = np.concatenate([wraps.contacts, level], axis=-1)
        pose = course.pose[..., None, :]
        return {
            "drones": in_world(pose, drones),
            "vertices": in_world(pose, places),
            "legs": legs,
            "tensions": T,
            "contacts": in_world(pose[..., None, :], contacts),
            "pose": course.pose,
            "borne": course.borne,
        } | ({"leg_tensions": pulls} if leading else {})

    def _balanced(
        self, move: Move, course: Course, planned: Array, bends: Bends
    ) -> tuple[Array, Array, Wraps]:
        """Return clasps (…, n, 2) [m], their heights (…, n) [m], and edges that bear the load.

        Edges of an object that stands bear level forces in proportion to its weight on them.
        """
        section, T, borne = self.body.section, course.tension, course.borne
        polygon, z = planned, np.zeros(planned.shape[:-1])
        wraps = wraps_around(section, polygon, bends)
        if not np.any(borne):
            return polygon, z, wraps
        load = np.zeros((*borne.shape, 3))
        load[..., 2] = GRAVITY * borne
        if move.lifted:
            load += course.accelerations(self.body.centre_of_mass[None])[..., 0, :]
        load, centre = self.body.mass * load, self.body.centre_of_mass[:2]
        for _ in range(MAX_PASSES):
            before = np.concatenate([polygon - centre, z[..., None]], axis=-1)
            arms = wraps.contacts - centre
            after = balanced(before, T, arms, load, (planned - centre, borne))
            polygon, z = centre + after[..., :2], after[..., 2]
            wraps = wraps_around(section, polygon, bends)
            if np.max(np.abs(after - before)) < CONVERGED:
                break
        else:
            _check_balance(straight_parts(polygon, wraps.contacts, z), T, load, borne)
        return polygon, z, wraps


def _check_balance(parts: tuple[Array, Array], T: Array, load: Array, borne: Array) -> None:
    """Raise InfeasibleError if edges do not bear a load (…, 3) [N].

    Parameters
    ----------
    parts: (…, n, 3) [m], straight parts of edges at ``p_k`` and at ``p_{k+1}``.
    borne: (…), the share of the object that they bear; below 1 its support bears level forces too.
    """
    leaving, arriving = parts
    lacking = np.sum(T[..., None] * (unit(arriving) - unit(leaving)), axis=-2) - load
    lacking[..., :2] *= (borne == 1.0)[..., None]
    worst = float(np.max(length(lacking) / np.min(T, axis=-1)))
    if worst > BALANCE_LIMIT:
        remedy = "lower the object's mass, raise the tension, or use more robots"
        when = "where edges bear the object"
        raise InfeasibleError(
            [Violation("equilibrium", worst, BALANCE_LIMIT, "max", "", (), when, remedy)]
        )


def _span(leaving: Array, arriving: Array) -> Array:
    """Return the length of edges' straight parts (…, n), times their level span squared [m³]."""
    whole, free = leaving + arriving, length(leaving) + length(arriving)
    return np.asarray(free * (whole[..., 0] ** 2 + whole[..., 1] ** 2))
