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
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hitchopt.carrying.holding import (
    Bends,
    Grip,
    PlannedClasps,
    Wraps,
    edge_ratios,
    step_toward_balance,
    straight_parts,
    wraps_around,
)
from hitchopt.carrying.moves import Move, MoveState, SmoothLaw, polynomials
from hitchopt.carrying.polygons import sides_of
from hitchopt.checks.clasps import BALANCE_LIMIT
from hitchopt.errors import Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import cross, length, unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import (
    BalanceError,
    ClaspLoads,
    cable_of,
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    weight_ratios,
)
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.loads import RIM_CUT, RIM_REMEDY, Supports, rim_drop, rim_savings, strut_share
from hitchopt.motion.motion import HoldBy, Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world, poses_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, known

RIM_EDGE = "the rim"  # Name of the part that legs cut, in messages


def polygon_at(body: SolidObject, vertices: Array) -> ConvexPolygon:
    """Return a polygon (n, 2) [m] of an object's frame in the world frame."""
    points = np.column_stack([vertices, np.zeros(len(vertices))])
    return ConvexPolygon(in_world(body.pose, points)[:, :2])


def leg_chords(
    team: Team, lengths: Array, directions: tuple[Array, Array], ratios: Array, clasps: Array
) -> tuple[Array, Array]:
    """Return drones (…, 2n, 3) [m] and the lengths of the legs' chords (…, n, 2) [m].

    Parameters
    ----------
    lengths: (…, n, 2) [m], cable lengths of q- and r-legs.
    directions: of q- and r-legs at their clasps, (…, n, 3) each.
    ratios: (…, n) [1/m], those of ``weight_ratios``.
    clasps: (…, n, 3) [m]
    """
    q_directions, r_directions = directions
    q_legs = leg_vectors(lengths[..., 0], q_directions, ratios)
    r_legs = leg_vectors(lengths[..., 1], r_directions, ratios)
    legs = np.stack([q_legs, r_legs], axis=-2)  # (…, n, 2, 3)
    anchors = clasps[..., team.layout.anchors, :].reshape(*clasps.shape[:-2], *legs.shape[-3:])
    drones = (anchors + legs).reshape(*legs.shape[:-3], -1, 3)
    return drones, length(legs)


@dataclass(frozen=True, eq=False)
class HoldingHitch(ABC):
    """A hitch that holds an object, in the object's frame.

    The slack split is ``d_k / (d_k + e_k)``, and the plane of contact is that of the rim, or of the
    edges around the object.
    """

    by: ClassVar[HoldBy]  # Method of holding
    team: Team  # Team of the hitch
    body: SolidObject  # The object
    polygon: Array  # (n, 2) [m], the clasps that hold it
    height: float  # Height of the plane of contact above the object's base [m]
    fractions: Array  # (n,), slack split
    roll: Array  # (n,) [rad], of the legs, as in ``Hitch``

    @property
    def largest_acceleration(self) -> float:
        """Largest acceleration [m/s²] of the object, in addition to the certificate's limits."""
        return np.inf

    @property
    def reach(self) -> float:
        """Largest horizontal distance [m] of a drone from the object's origin without a load."""
        drones = self.at_rest(self.team.tension, load_share=0.0)["drones"]
        return float(np.max(np.linalg.norm(drones[..., :2], axis=-1)))

    def drop(self, tension: Array, load_share: Array | float) -> Array:
        """Return the depth (…) [m] of vertices below the plane of contact."""
        return 0.0 * tension[..., 0] * load_share

    def hitch(self, body: SolidObject, depth: float = 0.0) -> Hitch:
        """Return the unloaded hitch about ``body``, ``depth`` [m] below the plane of contact."""
        polygon = polygon_at(body, self.polygon)
        altitude = float(body.at[2]) + self.height - depth
        q_legs = self.fractions * cable_slack(self.team, polygon)
        return Hitch(self.team, polygon, altitude, q_legs, self.roll)

    @abstractmethod
    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        Raises
        ------
        InfeasibleError: a weight that the tensions cannot carry.
        """

    def at_rest(self, tension: Array, load_share: float) -> dict[str, Array]:
        """Return all curves at rest at the origin, for tensions (n,) [N].

        They have one time, or, of holds with leading axes, these axes instead.
        """
        origin = np.zeros(4)
        tensions = np.stack([tension, tension])
        rest = Move(origin, origin, tensions, (load_share, load_share), SmoothLaw(1.0))
        return self.curves(rest, np.zeros(self.polygon.shape[:-2] or 1))

    def motion(self, move: Move, requirements: Requirements, phase: Phase) -> Motion:
        """Return the motion of a move as one phase; all other objects are at rest."""
        curves: dict[str, Any] = polynomials(move, lambda t: self.curves(move, t))
        objects = requirements.objects
        held = list(objects).index(phase.hold.object if phase.hold else "")

        pose = curves.pop("pose")
        pieces, _, order = pose.coefficients.shape
        at_rest = poses_of(objects)[:, :, None]  # (objects, 5, 1)
        poses = np.empty((pieces, *at_rest.shape[:2], order))
        poses[:] = at_rest
        poses[:, held] = pose.coefficients
        curves["poses"] = PiecewisePolynomial(pose.breaks, poses)

        load_share = curves["load_share"].coefficients
        load_shares = np.zeros((pieces, len(objects), load_share.shape[-1]))
        load_shares[:, held] = np.clip(load_share, 0.0, 1.0)  # polynomials overshoot by 1e-6
        curves["load_share"] = PiecewisePolynomial(pose.breaks, load_shares)

        phases = (phase.retimed(0.0, move.law.duration),)
        return Motion(self.team, requirements, **curves, phases=phases)


MAX_REST_ACCELERATION = 0.4
"""[m/s²] Largest acceleration of an object that rests on clasps. At 1 m/s² simulated clasps without
clasp friction slid on a rim by 3 to 8 cm at the start of a carry, since drones lag and small forces
move such clasps."""

USED_SHARE = 0.8  # Used share of the acceleration that friction and supports permit


@dataclass(frozen=True, eq=False)
class RestHold(HoldingHitch):
    """A hitch below an object whose rim rests on its clasps."""

    by: ClassVar[HoldBy] = HoldBy.REST

    @property
    def clasps(self) -> Array:
        """(…, n, 3) [m]: the clasps below the rim."""
        heights = np.full((*self.polygon.shape[:-1], 1), self.height)
        return np.concatenate([self.polygon, heights], axis=-1)

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
        lever = max(abs(self._mass_height), 1e-9)  # not zero: it divides
        tipping = GRAVITY * float(np.min(offsets)) / lever
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
        edges = np.roll(self.clasps, -1, axis=-2) - self.clasps
        slack = cable_slack_of(team, edges, tension)
        q_legs = self.fractions * slack
        cable_loads = clasp_loads(team, slack, self.roll)
        if cable_loads is None:
            clasp_forces = forces
            half_edge_weights = np.zeros((*forces.shape[:-1], 2))
        else:
            clasp_forces = forces + cable_loads.forces
            half_edge_weights = cable_loads.half_edge_weights
        edge_tension = tension
        leg_pulls = None
        if strut is not None:
            half_edge_weights = (1.0 - strut[..., None, None]) * half_edge_weights
            leg_tension = np.broadcast_to(tension, forces.shape[:-1])
            edge_tension = (1.0 - strut[..., None]) * leg_tension
            leg_pulls = np.stack([leg_tension, leg_tension], axis=-1)
        roll = np.broadcast_to(self.roll, forces.shape[:-1])
        loads = ClaspLoads(clasp_forces, roll, half_edge_weights)
        along = np.broadcast_to(unit(edges), forces.shape)
        directions = leg_directions(along, edge_tension, team.topology, loads, None, leg_pulls)
        lengths = np.stack([q_legs, slack - q_legs], axis=-1) + saved
        return leg_chords(team, lengths, directions, weight_ratios(team, tension), self.clasps)

    def check_unbent(self, tension: Array) -> None:
        """Raise InfeasibleError if legs that the rim does not bend cannot carry the object."""
        forces = np.zeros(self.clasps.shape)
        forces[:, 2] = -GRAVITY * self.body.mass * self.supports.shares
        self.drones(tension, forces)

    def rim_violation(self, tension: Array) -> Violation | None:
        """Return the violation of straight legs that leave the rim too far above its edge, or None.

        That is by more than RIM_CUT at rest, without and with the whole weight, for tensions (n,)
        [N].
        """
        for load_share in (0.0, 1.0):
            heights = self.rim_heights(self.at_rest(tension, load_share))[0]
            worst = int(np.argmax(heights))
            if heights[worst] > RIM_CUT:
                where = (f"cable {self.team.labels[worst // 2]}", RIM_EDGE)
                return Violation(
                    "object_clearance", 0.0, RIM_CUT, "min", "m", where, "", RIM_REMEDY
                )
        return None

    def rim_heights(self, curves: dict[str, Array]) -> Array:
        """Return the heights (…, 2n) [m] above the rim at which straight legs leave its outline."""
        clasps = curves["vertices"][..., self.team.layout.anchors, :]
        legs = curves["drones"] - clasps
        level_lengths = length(legs[..., :2])
        level_directions = legs[..., :2] / level_lengths[..., None]
        within_rim = known(self.body.rim).section.reach(clasps[..., :2], level_directions)
        rises = within_rim * legs[..., 2] / level_lengths
        return np.asarray(clasps[..., 2] + rises - self.height)

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s]."""
        state = move.state(t)
        tension = state.tension
        load_share = state.load_share
        edges = length(np.roll(self.clasps, -1, axis=-2) - self.clasps)
        bent_share = load_share**2  # the rim's effects on legs grow with the load's square
        strut = bent_share * strut_share(self.team, self.body.mass, edges, tension)
        savings = rim_savings(self.team, self.body, self.polygon, tension)
        saved = bent_share[..., None, None] * savings
        drones, legs = self.drones(tension, self._forces(move, state), strut, saved)

        depth = state.between(*move.below) + self.drop(tension, load_share)
        down = depth[..., None, None] * [0.0, 0.0, 1.0]
        clasps = np.broadcast_to(self.clasps, (*t.shape, *self.clasps.shape[-2:]))
        pose = state.pose
        pose_of_points = pose[..., None, :]
        return {
            "drones": in_world(pose_of_points, drones - down),
            "vertices": in_world(pose_of_points, clasps - down),
            "legs": legs,
            "tensions": tension,
            "pose": pose,
            "load_share": load_share,
        }

    def _forces(self, move: Move, state: MoveState) -> Array:
        """Return the forces (…, n, 3) [N] of the object on clasps, in its frame."""
        mass = self.body.mass
        supports = self.supports
        if not move.lifted:
            forces = np.zeros((*state.load_share.shape, *self.clasps.shape[-2:]))
            forces[..., 2] = -state.load_share[..., None] * (GRAVITY * mass * supports.shares)
            return forces
        accelerations = state.accelerations(self.clasps) + np.array([0.0, 0.0, GRAVITY])
        forces = np.asarray(-mass * supports.shares[..., None] * accelerations)
        centre_of_mass = self.body.centre_of_mass[None]
        level_acceleration = state.accelerations(centre_of_mass)[..., 0, :2]
        shifts = supports.gains @ level_acceleration[..., None]
        forces[..., 2] += mass * self._mass_height * shifts[..., 0]
        return forces


MAX_NEWTON_STEPS = 20  # Maximum number of Newton steps for clasps
STEP_TOLERANCE = 1e-12  # [m] Size of the last Newton step

PATH_SAMPLES = 400
"""Samples of the path from around the object to the grip at which edges are compared."""

BISECTIONS = 60  # Steps that locate an event between two samples of the path
EVENT_TOLERANCE = 1e-6  # Distance of distinct events, as a fraction of the path

PAST_EVENT = 3e-6
"""Distance beyond an event, as a fraction of the path, at which edges bend about other corners."""


class BearingEdges(NamedTuple):
    """Edges around an object that they bear, and their clasps."""

    polygon: Array  # (…, n, 2) [m], clasps
    heights: Array  # (…, n) [m], of clasps above the plane of contact
    wraps: Wraps  # The edges, seen from above

    @property
    def straight_parts(self) -> tuple[Array, Array]:
        """(…, n, 3) [m] each: straight parts of edges at ``p_k``, and at ``p_{k+1}``."""
        return straight_parts(self.polygon, self.wraps.contacts, self.heights)


@dataclass(frozen=True, eq=False)
class GripHold(HoldingHitch):
    """A hitch that closes around an object and grips it, without roll."""

    by: ClassVar[HoldBy] = HoldBy.GRIP

    around: Array  # (n, 2) [m], clasps around the object
    open_fractions: Array  # (n,), slack split there

    def _slack(self, polygon: Array) -> Array:
        """Return the lengths (n,) [m] of both legs of cables around the object, without sag."""
        return self.team.cable_length - wraps_around(self.body.section, polygon).lengths

    @property
    def leg_differences(self) -> Array:
        """(n,) [m]: lengths of q-legs over those of r-legs."""
        return (2.0 * self.fractions - 1.0) * self._slack(self.polygon)

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
        bends = self._bends(shares)
        events = list[float]()
        for i in np.flatnonzero(bends[1:].differ(bends[:-1])):
            share = shares[i]
            while self._bends(share).differ(bends[i + 1]):
                share = self._next_event(share, shares[i + 1])
                events.append(share)
        is_distinct = np.diff(events, prepend=-1.0) > EVENT_TOLERANCE
        return np.array(events)[is_distinct]

    def _next_event(self, start: float, end: float) -> float:
        """Return the share beyond which bends differ from those at ``start``, up to ``end``."""
        bends = self._bends(start)
        for _ in range(BISECTIONS):
            middle = 0.5 * (start + end)
            if self._bends(middle).differ(bends):
                end = middle
            else:
                start = middle
        return end

    def largest_push(self, tension: Array) -> float:
        """Return the largest force [N] with which edges slide or turn a standing object.

        With tensions (n,) [N], as friction with the support must resist them. It is not zero
        because edges touch the object one after the other.
        """
        section = self.body.section
        shares = np.linspace(0.0, 1.0, PATH_SAMPLES + 1)
        wraps = wraps_around(section, self._polygon(shares))
        forces = np.sum(tension[:, None] * (wraps.arriving - wraps.leaving), axis=-2)
        arms = wraps.contacts - self.body.centre_of_mass[:2]
        moments = cross(arms[..., 1, :], wraps.arriving) - cross(arms[..., 0, :], wraps.leaving)
        turning = np.sum(tension * moments, axis=-1) / section.friction_radius
        return float(np.max(np.hypot(length(forces), turning)))

    def grip(self, tension: Array) -> Grip:
        """Return the grip with tensions (n,) [N] of cables of one length, without a load."""
        team = self.team
        cable_length = float(np.min(team.cable_length))
        weakest = float(np.min(tension))
        return Grip.of(self.body.section, self.polygon, cable_length, weakest, team.friction)

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
        shares_nearby = np.clip([share - PAST_EVENT, share + PAST_EVENT], 0.0, None)
        bends_nearby = self._bends(shares_nearby)
        neighbours = (bends_nearby[0], bends_nearby[1])
        others = [neighbour for neighbour in neighbours if neighbour.differ(bends)]
        if not others:
            return np.zeros(len(polygon))
        return 0.5 * (self._level_spans(polygon, others[0]) - self._level_spans(polygon, bends))

    def _level_spans(self, polygon: Array, bends: Bends) -> Array:
        """Return the spans (n,) [m³] of edges in the plane of contact, for clasps (n, 2) [m]."""
        wraps = wraps_around(self.body.section, polygon, bends)
        return _spans(*straight_parts(polygon, wraps.contacts, np.zeros(len(polygon))))

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        With friction feed-forward, legs have the tension T and edges ``exp(-s μ γ) T``. Here s is
        the share of clasp friction, and γ the ``bend_together`` of cables that turn by the mean of
        the angles between edges and between legs.
        """
        team = self.team
        state = move.state(t)
        closure = state.between(*move.closure)
        bends = self._bends(0.5 * sum(move.closure))
        edges = self._bearing_edges(move, state, self._polygon(closure), bends)
        leaving, arriving = edges.straight_parts

        leg_tension = state.tension
        edge_tension = leg_tension
        leg_pulls = None
        if move.friction_share != (0.0, 0.0):
            friction = team.friction * state.between(*move.friction_share)
            edge_tension = leg_tension * edge_ratios(friction, edges.wraps.clasp_angles)
            leg_pulls = np.stack([leg_tension, leg_tension], axis=-1)

        ratios = weight_ratios(team, edge_tension)
        edge_lengths = edges.wraps.arcs + (length(leaving) + length(arriving))
        if team.cable_density > 0.0:
            spans = _spans(leaving, arriving)
            if move.closure[0] != move.closure[1]:
                seams = [self._seam(end, bends) for end in move.closure]
                spans = spans + state.between(*seams)
            lengths = length(leaving) + length(arriving)
            span = np.sqrt(spans / lengths)
            level = np.stack([span, np.zeros_like(span)], axis=-1)
            edge_lengths = edge_lengths + lengths * (cable_of(level, ratios) / span - 1.0)

        slack = team.cable_length - edge_lengths
        opened = self.opened.leg_differences
        differences = opened + closure[..., None] * (self.leg_differences - opened)
        level_slack = team.cable_length - edges.wraps.lengths
        q_legs = (0.5 + 0.5 * differences / level_slack) * slack
        roll = state.between(*move.roll)[..., None] if np.any(move.roll) else None
        loads = clasp_loads(team, slack, roll)
        directions = leg_directions(
            unit(leaving), edge_tension, team.topology, loads, unit(arriving), leg_pulls
        )
        leg_lengths = np.stack([q_legs, slack - q_legs], axis=-1)
        clasp_heights = self.height + edges.heights
        clasps = np.concatenate([edges.polygon, clasp_heights[..., None]], axis=-1)
        of_legs = weight_ratios(team, leg_tension)
        drones, legs = leg_chords(team, leg_lengths, directions, of_legs, clasps)

        level_contacts = edges.wraps.contacts
        contact_heights = np.full((*level_contacts.shape[:-1], 1), self.height)
        contacts = np.concatenate([level_contacts, contact_heights], axis=-1)
        pose = state.pose
        curves = {
            "drones": in_world(pose[..., None, :], drones),
            "vertices": in_world(pose[..., None, :], clasps),
            "legs": legs,
            "tensions": edge_tension,
            "contacts": in_world(pose[..., None, None, :], contacts),
            "pose": pose,
            "load_share": state.load_share,
        }
        if leg_pulls is not None:
            curves["leg_tensions"] = leg_pulls
        return curves

    def _bearing_edges(
        self, move: Move, state: MoveState, planned: Array, bends: Bends
    ) -> BearingEdges:
        """Return edges that bear the object, in its frame, for planned clasps (…, n, 2) [m].

        While the object stands, edges bear horizontal forces in proportion to their load share.
        """
        section = self.body.section
        load_share = state.load_share
        polygon = planned
        heights = np.zeros(planned.shape[:-1])
        wraps = wraps_around(section, polygon, bends)
        if not np.any(load_share):
            return BearingEdges(polygon, heights, wraps)
        centre = self.body.centre_of_mass[:2]
        acceleration = np.zeros((*load_share.shape, 3))
        acceleration[..., 2] = GRAVITY * load_share
        if move.lifted:
            centre_of_mass = self.body.centre_of_mass[None]
            acceleration += state.accelerations(centre_of_mass)[..., 0, :]
        load = self.body.mass * acceleration
        for _ in range(MAX_NEWTON_STEPS):
            before = np.concatenate([polygon - centre, heights[..., None]], axis=-1)
            arms = wraps.contacts - centre
            displaced_from = PlannedClasps(planned - centre, load_share)
            after = step_toward_balance(before, state.tension, arms, load, displaced_from)
            polygon = centre + after[..., :2]
            heights = after[..., 2]
            wraps = wraps_around(section, polygon, bends)
            if np.max(np.abs(after - before)) < STEP_TOLERANCE:
                return BearingEdges(polygon, heights, wraps)
        edges = BearingEdges(polygon, heights, wraps)
        _check_balance(edges, state.tension, load, load_share)
        return edges


def _check_balance(edges: BearingEdges, tension: Array, load: Array, load_share: Array) -> None:
    """Raise BalanceError if edges do not bear a load (…, 3) [N].

    Parameters
    ----------
    edges: around the object.
    tension: (…, n) [N], of edges.
    load: (…, 3) [N]
    load_share: (…), of edges; below 1 the object's support bears horizontal forces too.
    """
    leaving, arriving = edges.straight_parts
    pulls = tension[..., None] * (unit(arriving) - unit(leaving))
    residual = np.sum(pulls, axis=-2) - load
    is_lifted = load_share == 1.0
    residual[..., :2] *= is_lifted[..., None]
    worst = float(np.max(length(residual) / np.min(tension, axis=-1)))
    if worst > BALANCE_LIMIT:
        when = "where edges touch the object"
        remedy = "lower the object's mass, raise the tension, or use more robots"
        violation = Violation("equilibrium", worst, BALANCE_LIMIT, "max", "", (), when, remedy)
        raise BalanceError([violation])


def _spans(leaving: Array, arriving: Array) -> Array:
    """Return lengths of edges' straight parts times their squared horizontal spans (…, n) [m³]."""
    lengths = length(leaving) + length(arriving)
    chord = leaving + arriving
    return np.asarray(lengths * (chord[..., 0] ** 2 + chord[..., 1] ** 2))
