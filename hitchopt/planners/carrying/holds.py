"""Curves of a hitch that holds an object, below its rim or with cables wrapped around it.

Computations are in the object's frame, in which legs follow from the forces on clasps. A rim rests
on clasps by the law of ``hitchopt.motion.loads``. A grip holds by friction, with the same tension
along a cable's whole edge; edges descend from the clasps to the plane of contact and so carry the
weight. While the object is off its support all clasps lead it by millimetres: horizontal forces act
where edges bend, without friction.
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
from hitchopt.hitch.holding import Bends, Wraps, balanced, edge_ratios, straight_parts, wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.loads import RIM_CUT, RIM_REMEDY, Supports, rim_drop, rim_savings, strut_share
from hitchopt.motion.motion import HoldBy, Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world, poses_of
from hitchopt.planners.carrying.moves import Move, MoveState, SmoothLaw, polynomials
from hitchopt.planners.carrying.polygons import sides_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


def polygon_at(body: SolidObject, vertices: Array) -> ConvexPolygon:
    """Return a polygon (n, 2) [m] of an object's frame in the world frame."""
    points = np.column_stack([vertices, np.zeros(len(vertices))])
    return ConvexPolygon(in_world(body.pose, points)[:, :2])


def leg_chords(
    team: Team, lengths: Array, directions: tuple[Array, Array], factors: Array, clasps: Array
) -> tuple[Array, Array]:
    """Return drones (…, 2n, 3) [m] and the lengths of the legs' chords (…, n, 2) [m].

    Parameters
    ----------
    lengths: (…, n, 2) [m], cable lengths of q- and r-legs.
    directions: of q- and r-legs, (…, n, 3) each.
    factors: (…, n) [1/m²], those of ``sag_factors``.
    clasps: (…, n, 3) [m]
    """
    legs = (leg_vectors(lengths[..., i], directions[i], factors) for i in (0, 1))
    both = np.stack([*legs], axis=-2)
    anchors = clasps[..., team.layout.anchors, :].reshape(*clasps.shape[:-2], *both.shape[-3:])
    return (anchors + both).reshape(*both.shape[:-3], -1, 3), length(both)


@dataclass(frozen=True, eq=False)
class HoldingHitch(ABC):
    """A hitch that holds an object, in the object's frame.

    Attributes
    ----------
    team: of the hitch.
    body: the object.
    polygon: (n, 2) [m], the clasps that hold it.
    height: of the plane of contact above the object's base [m].
    fractions: (n,), slack split ``d_k / (d_k + e_k)``.
    roll: (n,) [rad], of the legs, as in ``Hitch``.
    """

    by: ClassVar[HoldBy]
    team: Team
    body: SolidObject
    polygon: Array
    height: float
    fractions: Array
    roll: Array

    @property
    def largest_acceleration(self) -> float:
        """Largest acceleration [m/s²] of the object, in addition to the certificate's limits."""
        return np.inf

    @property
    def reach(self) -> float:
        """Largest horizontal distance [m] of a drone from the object's origin without a load."""
        tensions, origin = np.stack([self.team.tension, self.team.tension]), np.zeros(4)
        rest = Move(origin, origin, tensions, (0.0, 0.0), SmoothLaw(1.0))
        drones = self.curves(rest, np.zeros(1))["drones"]
        return float(np.max(np.linalg.norm(drones[..., :2], axis=-1)))

    def drop(self, tension: Array, load_share: Array | float) -> Array:
        """Return the depth (…) [m] of vertices below the plane of contact."""
        return 0.0 * tension[..., 0] * load_share

    def hitch(self, body: SolidObject, depth: float = 0.0) -> Hitch:
        """Return the unloaded hitch about ``body``, ``depth`` [m] below the plane of contact."""
        polygon, altitude = polygon_at(body, self.polygon), float(body.at[2]) + self.height - depth
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
        """Return the motion of a move as one phase; all other objects are at rest."""
        parts: dict[str, Any] = polynomials(move, lambda t: self.curves(move, t))
        index = list(requirements.objects).index(phase.hold.object if phase.hold else "")
        breaks = parts["pose"].breaks
        pose, share = parts.pop("pose").coefficients, parts["load_share"].coefficients
        poses = np.repeat(poses_of(requirements.objects)[None, :, :, None], len(pose), axis=0)
        poses = np.repeat(poses, pose.shape[-1], axis=-1)
        poses[:, index] = pose
        shares = np.zeros((len(share), len(requirements.objects), share.shape[-1]))
        shares[:, index] = np.clip(share, 0.0, 1.0)  # polynomials overshoot by 1e-6
        parts |= {"poses": PiecewisePolynomial(breaks, poses)}
        parts |= {"load_share": PiecewisePolynomial(breaks, shares)}
        phases = (phase.retimed(0.0, move.law.duration),)
        return Motion(self.team, requirements, **parts, phases=phases)


MAX_REST_ACCELERATION, USED_SHARE = 0.4, 0.8
"""[m/s²] Largest acceleration of an object that rests on clasps, and used share of the acceleration
that friction and supports permit. At 1 m/s² simulated clasps without clasp friction slid on a rim
by 3 to 8 cm at the start of a carry, since drones lag and small forces move such clasps."""


@dataclass(frozen=True, eq=False)
class RestHold(HoldingHitch):
    """A hitch below an object whose rim rests on its clasps."""

    by: ClassVar[HoldBy] = HoldBy.REST

    @property
    def clasps(self) -> Array:
        """(n, 3) [m]: the clasps below the rim."""
        return np.column_stack([self.polygon, np.full(len(self.polygon), self.height)])

    @property
    def supports(self) -> Supports:
        """Distribution of the object's mass over the clasps."""
        return Supports.at(self.polygon, self.body.centre_of_mass[:2])

    @property
    def _mass_height(self) -> float:
        """Height [m] of the centre of mass above the clasps."""
        return float(self.body.centre_of_mass[2]) - self.height

    @property
    def largest_acceleration(self) -> float:
        """Largest acceleration [m/s²] with friction and supports, at most MAX_REST_ACCELERATION."""
        _, offsets = sides_of(self.polygon - self.body.centre_of_mass[:2])
        tipping = GRAVITY * float(np.min(offsets)) / max(abs(self._mass_height), 1e-9)
        sliding = self.body.friction * GRAVITY
        return min(MAX_REST_ACCELERATION, USED_SHARE * min(sliding, tipping))

    def drop(self, tension: Array, load_share: Array | float) -> Array:
        """Return the depth (…) [m] of vertices below the rim that bends their legs."""
        return rim_drop(self.team, self.body, self.polygon, tension, load_share)

    def drones(
        self, tension: Array, forces: Array, strut: Array | None = None, saved: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Return drones (…, 2n, 3) [m] in the object's frame, and legs' chords (…, n, 2) [m].

        Parameters
        ----------
        tension: (…, n) [N]
        forces: (…, n, 3) [N], of the object on clasps, in its frame.
        strut: (…), fraction of edges' pulls that the rim carries; None if loads hang at clasps.
        saved: (…, n, 2) [m], lengths that legs gain because the rim bends them.

        Raises
        ------
        InfeasibleError: forces that the tensions cannot carry.
        """
        team = self.team
        edges = np.roll(self.clasps, -1, axis=0) - self.clasps
        slack = cable_slack_of(team, edges, tension)
        q_legs = self.fractions * slack
        cable_loads = clasp_loads(team, q_legs, slack, self.roll)
        if cable_loads is None:
            clasp_forces = forces
            half_leg_weights = np.zeros((*forces.shape[:-1], 2))
            half_edge_weights = half_leg_weights
        else:
            clasp_forces = forces + cable_loads.forces
            half_leg_weights = cable_loads.half_leg_weights
            half_edge_weights = cable_loads.half_edge_weights
        edge_tension = tension
        leg_pulls = None
        if strut is not None:
            half_edge_weights = (1.0 - strut[..., None, None]) * half_edge_weights
            leg_tension = np.broadcast_to(tension, forces.shape[:-1])
            edge_tension = (1.0 - strut[..., None]) * leg_tension
            leg_pulls = np.stack([leg_tension, leg_tension], axis=-1)
        roll = np.broadcast_to(self.roll, forces.shape[:-1])
        loads = ClaspLoads(clasp_forces, half_leg_weights, roll, half_edge_weights)
        along = np.broadcast_to(unit(edges), forces.shape)
        directions = leg_directions(along, edge_tension, team.topology, loads, None, leg_pulls)
        lengths = np.stack([q_legs, slack - q_legs], axis=-1) + saved
        return leg_chords(team, lengths, directions, sag_factors(team, tension), self.clasps)

    def check_unbent(self, tension: Array) -> None:
        """Raise InfeasibleError if legs that the rim does not bend cannot carry the object."""
        forces = np.zeros(self.clasps.shape)
        forces[:, 2] = -GRAVITY * self.body.mass * self.supports.shares
        self.drones(tension, forces)

    def check_rim(self, tension: Array) -> None:
        """Raise InfeasibleError if straight legs leave the rim more than RIM_CUT above its edge.

        That is at rest without and with the whole weight, for tensions (n,) [N].
        """
        assert self.body.rim is not None
        tensions, origin = np.stack([tension, tension]), np.zeros(4)
        for share in (0.0, 1.0):
            rest = Move(origin, origin, tensions, (share, share), SmoothLaw(1.0))
            at_rest = self.curves(rest, np.zeros(1))
            clasps = at_rest["vertices"][0, self.team.layout.anchors]
            legs = at_rest["drones"][0] - clasps
            level = length(legs[:, :2])
            inside = self.body.rim.section.reach(clasps[:, :2], legs[:, :2] / level[:, None])
            heights = clasps[:, 2] + inside * legs[:, 2] / level - self.height
            worst = int(np.argmax(heights))
            if heights[worst] > RIM_CUT:
                where, remedy = (f"cable {self.team.labels[worst // 2]}", "the rim"), RIM_REMEDY
                cut = "object_clearance", 0.0, RIM_CUT, "min", "m", where, "", remedy
                raise InfeasibleError([Violation(*cut)])

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s]."""
        state, team, body, supports = move.state(t), self.team, self.body, self.supports
        forces = np.zeros((*t.shape, *self.clasps.shape))
        if move.lifted:
            accelerations = state.accelerations(self.clasps) + np.array([0.0, 0.0, GRAVITY])
            forces = -body.mass * supports.shares[:, None] * accelerations
            centre = state.accelerations(body.centre_of_mass[None])[..., 0, :2]
            forces[..., 2] += body.mass * self._mass_height * (centre @ supports.gains.T)
        else:
            forces[..., 2] = -state.load_share[..., None] * (GRAVITY * body.mass * supports.shares)
        tension, share = state.tension, state.load_share
        edges, squared = length(np.roll(self.clasps, -1, axis=0) - self.clasps), share**2
        strut = squared * strut_share(team, body.mass, edges, tension)
        saved = squared[..., None, None] * rim_savings(team, body, self.polygon, tension)
        drones, legs = self.drones(tension, forces, strut, saved)
        depth = state.between(*move.below) + self.drop(tension, share)
        down = np.stack([0 * depth, 0 * depth, depth], axis=-1)[..., None, :]
        clasps = np.broadcast_to(self.clasps, (*t.shape, *self.clasps.shape))
        return {
            "drones": in_world(state.pose[..., None, :], drones - down),
            "vertices": in_world(state.pose[..., None, :], clasps - down),
            "legs": legs,
            "tensions": tension,
            "pose": state.pose,
            "load_share": share,
        }


MAX_NEWTON_STEPS, STEP_TOLERANCE = 20, 1e-12
"""Maximum number of Newton steps for clasps, and size of the last one [m]."""

EVENT_TOLERANCE, PAST_EVENT = 1e-6, 3e-6
"""Fractions of the path: distance of distinct events, and distance beyond an event."""

PATH_SAMPLES, BISECTIONS = 400, 60
"""Samples of the path from around the object to the grip at which edges are compared, and steps
that locate an event between two samples."""


@dataclass(frozen=True, eq=False)
class GripHold(HoldingHitch):
    """A hitch that closes around an object and grips it, without roll."""

    by: ClassVar[HoldBy] = HoldBy.GRIP
    around: Array  # (n, 2) [m], clasps around the object
    open_fractions: Array  # (n,), slack split there

    @classmethod
    def tied(cls, team: Team, body: SolidObject, clasps: Array, height: float) -> GripHold:
        """Return the grip of two cables with clasps (2, 2) [m], and equal legs."""
        halves = np.full(team.robots, 0.5)
        return cls(team, body, clasps, height, halves, np.zeros(2), clasps, halves)

    @property
    def travel(self) -> float:
        """Longest path [m] of a clasp from around the object to the grip."""
        return float(np.max(length(self.polygon - self.around)))

    @cached_property
    def events(self) -> Array:
        """Shares in (0, 1) of the path at which an edge meets the object or another corner.

        There legs start to turn, so that drones rest.
        """
        shares = np.linspace(0.0, 1.0, PATH_SAMPLES + 1)
        bends, events = self._bends(shares), list[float]()
        for i in np.flatnonzero(bends[1:].differ(bends[:-1])):
            share, last = shares[i], bends[i + 1]
            while (before := self._bends(share)).differ(last):
                low, high = share, shares[i + 1]
                for _ in range(BISECTIONS):
                    middle = 0.5 * (low + high)
                    equal = not self._bends(middle).differ(before)
                    low, high = (middle, high) if equal else (low, middle)
                events.append(high)
                share = high
        return np.array(events)[np.diff(events, prepend=-1.0) > EVENT_TOLERANCE]

    def largest_push(self, tension: Array) -> float:
        """Return the largest horizontal force [N] of edges on a standing object.

        With tensions (n,) [N]. It is not zero because edges touch the object one after the other.
        """
        shares = np.linspace(0.0, 1.0, PATH_SAMPLES + 1)
        wraps = wraps_around(self.body.section, self._polygon(shares))
        force = np.sum(tension[:, None] * (wraps.arriving - wraps.leaving), axis=-2)
        return float(np.max(length(force)))

    @property
    def opened(self) -> GripHold:
        """The hitch around the object."""
        return replace(self, polygon=self.around, fractions=self.open_fractions)

    def _polygon(self, share: Array | float) -> Array:
        """Return the clasps (…, n, 2) [m] at shares (…) of the path to the grip."""
        path = self.polygon - self.around
        return np.asarray(self.around + np.asarray(share)[..., None, None] * path)

    def _bends(self, share: Array | float) -> Bends:
        """Return the bends (…, n) of edges at shares (…) of the path."""
        return wraps_around(self.body.section, self._polygon(share)).bends

    def _seam(self, share: float, bends: Bends) -> Array:
        """Return half of the jump of spans (n,) [m³] at an event, from a move with these bends.

        The length of the straight part that sags jumps where an edge meets another corner. The
        moves before and after such an event at ``share`` meet halfway.
        """
        polygon = self._polygon(share)
        nearby = self._bends(np.clip(share + PAST_EVENT * np.array([-1.0, 1.0]), 0.0, None))
        others = [each for each in (nearby[0], nearby[1]) if each.differ(bends)]
        spans = []
        for each in (bends, *others[:1]):
            contacts = wraps_around(self.body.section, polygon, each).contacts
            spans.append(_span(*straight_parts(polygon, contacts, np.zeros(len(polygon)))))
        return 0.5 * (spans[-1] - spans[0])

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        With friction feed-forward, legs have the tension T and edges ``exp(-s μ θ) T``. Here s is
        the share of clasp friction, and θ the angle by which both cables turn at a clasp, the mean
        of the angles between edges and between legs.
        """
        state, team = move.state(t), self.team
        share, T = state.between(*move.closure), state.tension
        pulls, has_feedforward = np.stack([T, T], axis=-1), move.friction_share != (0.0, 0.0)
        bends = self._bends(0.5 * sum(move.closure))
        polygon, z, wraps = self._balanced(move, state, self._polygon(share), bends)
        leaving, arriving = straight_parts(polygon, wraps.contacts, z)
        if has_feedforward:
            friction_share = state.between(*move.friction_share)
            T = T * edge_ratios(team.cable_friction * friction_share, wraps.clasp_angles)
        factors, edges = sag_factors(team, T), wraps.arcs + (length(leaving) + length(arriving))
        if team.cable_density > 0.0:
            spans = _span(leaving, arriving)
            if move.closure[0] != move.closure[1]:
                before, after = (self._seam(end, bends) for end in move.closure)
                spans = spans + state.between(before, after)
            edges = edges + factors * spans
        slack = team.cable_length - edges
        split = self.open_fractions + share[..., None] * (self.fractions - self.open_fractions)
        q_legs = split * slack
        roll = state.between(*move.roll)[..., None] if np.any(move.roll) else None
        loads, onward = clasp_loads(team, q_legs, slack, roll), unit(arriving)
        leg_pulls = pulls if has_feedforward else None
        directions = leg_directions(unit(leaving), T, team.topology, loads, onward, leg_pulls)
        clasps = np.concatenate([polygon, self.height + z[..., None]], axis=-1)
        lengths = np.stack([q_legs, slack - q_legs], axis=-1)
        drones, legs = leg_chords(team, lengths, directions, factors, clasps)
        heights = np.full((*wraps.contacts.shape[:-1], 1), self.height)
        contacts = np.concatenate([wraps.contacts, heights], axis=-1)
        pose = state.pose[..., None, :]
        return {
            "drones": in_world(pose, drones),
            "vertices": in_world(pose, clasps),
            "legs": legs,
            "tensions": T,
            "contacts": in_world(pose[..., None, :], contacts),
            "pose": state.pose,
            "load_share": state.load_share,
        } | ({"leg_tensions": pulls} if has_feedforward else {})

    def _balanced(
        self, move: Move, state: MoveState, planned: Array, bends: Bends
    ) -> tuple[Array, Array, Wraps]:
        """Return clasps (…, n, 2) [m], their heights (…, n) [m], and edges that bear the load.

        While the object stands, edges bear horizontal forces in proportion to their load share.
        """
        section, T, share = self.body.section, state.tension, state.load_share
        polygon, z = planned, np.zeros(planned.shape[:-1])
        wraps = wraps_around(section, polygon, bends)
        if not np.any(share):
            return polygon, z, wraps
        load = np.zeros((*share.shape, 3))
        load[..., 2] = GRAVITY * share
        if move.lifted:
            load += state.accelerations(self.body.centre_of_mass[None])[..., 0, :]
        load, centre = self.body.mass * load, self.body.centre_of_mass[:2]
        for _ in range(MAX_NEWTON_STEPS):
            before = np.concatenate([polygon - centre, z[..., None]], axis=-1)
            arms = wraps.contacts - centre
            after = balanced(before, T, arms, load, (planned - centre, share))
            polygon, z = centre + after[..., :2], after[..., 2]
            wraps = wraps_around(section, polygon, bends)
            if np.max(np.abs(after - before)) < STEP_TOLERANCE:
                break
        else:
            _check_balance(straight_parts(polygon, wraps.contacts, z), T, load, share)
        return polygon, z, wraps


def _check_balance(parts: tuple[Array, Array], T: Array, load: Array, load_share: Array) -> None:
    """Raise InfeasibleError if edges do not bear a load (…, 3) [N].

    Parameters
    ----------
    parts: (…, n, 3) [m], straight parts of edges at ``p_k`` and at ``p_{k+1}``.
    T: (…, n) [N], tensions of edges.
    load_share: (…), of edges; below 1 the object's support bears horizontal forces too.
    """
    leaving, arriving = parts
    residual = np.sum(T[..., None] * (unit(arriving) - unit(leaving)), axis=-2) - load
    residual[..., :2] *= (load_share == 1.0)[..., None]
    worst = float(np.max(length(residual) / np.min(T, axis=-1)))
    if worst > BALANCE_LIMIT:
        remedy = "lower the object's mass, raise the tension, or use more robots"
        when = "where edges bear the object"
        raise InfeasibleError(
            [Violation("equilibrium", worst, BALANCE_LIMIT, "max", "", (), when, remedy)]
        )


def _span(leaving: Array, arriving: Array) -> Array:
    """Return lengths of edges' straight parts times their squared horizontal spans (…, n) [m³]."""
    total, straight = leaving + arriving, length(leaving) + length(arriving)
    return np.asarray(straight * (total[..., 0] ** 2 + total[..., 1] ** 2))
