"""A hitch whose cables are wrapped around an object: its polygon, and its motions.

Friction holds the object. All is computed in the object's frame. Every cable pulls alike along its
whole edge; edges slope from the clasps down to the plane of contact and so carry the weight. While
the object is off its support all clasps are ahead of it by millimetres, so that edges pull it
along: level forces come from where edges bend, and need no friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from hitchopt.checks.clasps import LIMIT
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import clasp_loads, leg_directions, leg_vectors, sag_factors
from hitchopt.hitch.holding import Bends, GripTask, Wraps, best_grip, largest_tension, wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.carrying.moves import Move, courses
from hitchopt.planners.carrying.rest import STRETCHES, HoldPolygons
from hitchopt.values import Array

PASSES = 20
"""Most steps of Newton's that places and heights of clasps take."""

SETTLED = 1e-12
"""[m] Steps that are smaller end the search for clasps in balance."""

TOGETHER, BEYOND = 1e-6, 3e-6
"""Shares of the path that are nearer to each other are one event; so far from one it is over."""

SCAN = 400
"""Places on the path from around the object to the grip at which edges are looked at."""


@dataclass(frozen=True, eq=False)
class GrippedHitch:
    """A hitch that closes around an object and grips it, in the object's frame.

    Attributes
    ----------
    team: who flies.
    body: what is held.
    around, closed: (n, 2) [m], clasps around the object, and where they grip it.
    height: of the plane of contact above the object's base [m].
    open_fractions: (n,), how slack is split around the object; where it grips legs are equal.
    """

    by: ClassVar[HoldBy] = HoldBy.GRIP
    largest_acceleration: ClassVar[float] = np.inf
    team: Team
    body: SolidObject
    around: Array
    closed: Array
    height: float
    open_fractions: Array

    @property
    def places(self) -> Array:
        """(n, 3) [m], the clasps where they grip, without a weight."""
        return np.column_stack([self.closed, np.full(len(self.closed), self.height)])

    @property
    def fractions(self) -> Array:
        """(n,), how slack is split where it grips."""
        return np.full(len(self.closed), 0.5)

    @property
    def roll(self) -> Array:
        """(n,) [rad]: legs are not rolled."""
        return np.zeros(len(self.closed))

    @property
    def reach(self) -> float:
        """Largest level distance [m] of a drone from the object's origin where it grips."""
        still = np.zeros((1, 4))
        pulls, bends = self.team.tension[None], self._bends(1.0)
        drones = self._statics(np.ones(1), pulls, still[:, 0], bends)["drones"]
        return float(np.max(np.linalg.norm(drones[..., :2], axis=-1)))

    @property
    def farthest(self) -> float:
        """Longest path [m] of a clasp from around the object to the grip."""
        return float(np.max(length(self.closed - self.around)))

    @cached_property
    def events(self) -> Array:
        """Shares in (0, 1) at which an edge meets the object or another corner.

        There legs begin to turn: drones have to rest.
        """
        shares = np.linspace(0.0, 1.0, SCAN + 1)
        bends = self._bends(shares)
        found = []
        for i in np.flatnonzero(bends[1:].differ(bends[:-1])):
            place, last = shares[i], bends[i + 1]
            while (before := self._bends(place)).differ(last):
                low, high = place, shares[i + 1]
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    same = not self._bends(middle).differ(before)
                    low, high = (middle, high) if same else (low, middle)
                found.append(high)
                place = high
        events = np.array(found)
        return events[np.append(True, np.diff(events) > TOGETHER)] if found else events

    def largest_push(self, tension: Array) -> float:
        """Return the largest level force [N] of edges on what stands, with tensions (n,) [N].

        Edges do not come to touch it all at once.
        """
        wraps = wraps_around(self.body.section, self._polygon(np.linspace(0.0, 1.0, SCAN + 1)))
        force = np.sum(tension[:, None] * (wraps.arriving - wraps.leaving), axis=-2)
        return float(np.max(length(force)))

    def _bends(self, shares: Array | float) -> Bends:
        """Return (…, n) about what edges turn at shares (…) of the path to the grip."""
        return wraps_around(self.body.section, self._polygon(np.asarray(shares))).bends

    def _seam(self, share: float, bends: Bends) -> Array:
        """Return half of what spans (n,) [m³] change by where edges come to bend otherwise.

        Where an edge meets another corner, the straight part that sags is longer or shorter at
        once; moves before and after it, which ends at ``share``, meet halfway.
        """
        polygon, section = self._polygon(np.asarray(share)), self.body.section
        beyond = self._bends(np.clip(share + BEYOND * np.array([-1.0, 1.0]), 0.0, None))
        others = [each for each in (beyond[0], beyond[1]) if each.differ(bends)]
        spans = []
        for each in (bends, *others[:1]):
            contacts = contacts_of(polygon, wraps_around(section, polygon, each), section.core)
            spans.append(_span(*straight_parts(polygon, contacts, np.zeros(len(polygon)))))
        return 0.5 * (spans[-1] - spans[0])

    def _polygon(self, share: Array) -> Array:
        """Return the clasps (…, n, 2) [m] at shares of the path to the grip."""
        polygon: Array = self.around + share[..., None, None] * (self.closed - self.around)
        return polygon

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        Raises
        ------
        InfeasibleError: a weight that the tensions cannot carry.
        """
        course = courses(move, t)
        borne, pulled = course.borne, np.zeros((*course.borne.shape, 2))
        weight = GRAVITY * borne
        if move.lifted:
            there = course.accelerations(self.body.centre_of_mass[None])[..., 0, :]
            pulled = self.body.mass * there[..., :2]
            weight = GRAVITY + there[..., 2]
        share = course.between(*move.closed)
        lean = course.between(*move.lean)
        weight, tension = self.body.mass * weight, course.tension
        bends = self._bends(0.5 * sum(move.closed))
        seam = np.zeros(len(self.closed))
        if move.closed[0] != move.closed[1]:
            before, after = (self._seam(end, bends) for end in move.closed)
            seam = before + course.share[..., None] * (after - before)
        found = self._statics(share, tension, weight, bends, (pulled, borne), lean, seam)
        if move.lean == (0.0, 0.0):
            del found["leg_tensions"]
        pose = course.pose[..., None, :]
        for name in ("drones", "vertices"):
            found[name] = in_world(pose, found[name])
        found["contacts"] = in_world(pose[..., None, :], found["contacts"])
        return found | {"pose": course.pose, "borne": borne}

    def _statics(
        self,
        share: Array,
        tension: Array,
        weight: Array,
        bends: Bends,
        pulled: tuple[Array, Array] | None = None,
        lean: Array | float = 0.0,
        seam: Array | float = 0.0,
    ) -> dict[str, Array]:
        """Return drones, vertices, legs, tensions and contacts in the object's frame.

        Legs that lean pull with the tension, and edges with ``exp(-s μ θ)`` of that: s is the share
        of clasp friction, and θ the angle by which both of its cables turn at a clasp, the mean of
        what edges and legs enclose.

        Parameters
        ----------
        share: (…), how far the hitch is closed.
        tension: (…, n) [N]
        weight: (…) [N], what edges carry.
        bends: (n,), about what edges turn.
        pulled: (…, 2) [N], level force on the object, and (…) what share of it edges bear, from 0
            of an object that stands; None for no force.
        lean: (…), as of Move.
        seam: (…, n) [m³], what ``_span`` is taken to be larger.
        """
        team, section, T = self.team, self.body.section, tension
        planned = polygon = self._polygon(share)
        wraps = wraps_around(section, polygon, bends)
        contacts = contacts_of(polygon, wraps, section.core)
        centre, z = self.body.centre_of_mass[:2], np.zeros(polygon.shape[:-1])
        if pulled is not None and np.any(pulled[1]):
            force, borne = pulled
            load = np.concatenate([force, weight[..., None]], axis=-1)
            for _ in range(PASSES):
                before = np.concatenate([polygon - centre, z[..., None]], axis=-1)
                after = balanced(before, T, contacts - centre, load, (planned - centre, borne))
                polygon, z = centre + after[..., :2], after[..., 2]
                wraps = wraps_around(section, polygon, bends)
                contacts = contacts_of(polygon, wraps, section.core)
                if np.max(np.abs(after - before)) < SETTLED:
                    break
            else:
                _check_balance(straight_parts(polygon, contacts, z), T, load, borne)
        leaving, arriving = straight_parts(polygon, contacts, z)
        free = length(leaving) + length(arriving)
        pulls = np.stack([tension, tension], axis=-1)
        leaning = pulls if np.any(lean) else None
        if leaning is not None:
            T = tension * edge_ratios(team.cable_friction * np.asarray(lean), wraps.clasp_angles)
        factors = sag_factors(team, T)
        edges = wraps.arcs + free
        if team.cable_density > 0.0:
            edges = edges + factors * (_span(leaving, arriving) + seam)
        slack = team.cable_length - edges
        q_legs = (self.open_fractions + share[..., None] * (0.5 - self.open_fractions)) * slack
        loads = clasp_loads(team, q_legs, slack, None)
        q, r = leg_directions(unit(leaving), T, team.topology, loads, unit(arriving), leaning)
        d, e = leg_vectors(q_legs, q, factors), leg_vectors(slack - q_legs, r, factors)
        both = np.stack([d, e], axis=-2)
        places = np.concatenate([polygon, self.height + z[..., None]], axis=-1)
        anchors = places[..., team.layout.anchors, :].reshape(both.shape)
        level = np.full((*contacts.shape[:-1], 1), self.height)
        return {
            "drones": (anchors + both).reshape(*both.shape[:-3], -1, 3),
            "vertices": places,
            "legs": length(both),
            "tensions": T,
            "leg_tensions": pulls,
            "contacts": np.concatenate([contacts, level], axis=-1),
        }


def _check_balance(parts: tuple[Array, Array], T: Array, load: Array, borne: Array) -> None:
    """Raise InfeasibleError where edges do not bear a load (…, 3) [N].

    Parameters
    ----------
    parts: (…, n, 3) [m], straight parts of edges at ``p_k`` and at ``p_{k+1}``.
    borne: (…), the share of the object that they bear; below 1 its support bears level forces too.
    """
    leaving, arriving = parts
    lacking = np.sum(T[..., None] * (unit(arriving) - unit(leaving)), axis=-2) - load
    lacking[..., :2] *= (borne == 1.0)[..., None]
    worst = float(np.max(length(lacking) / np.min(T, axis=-1)))
    if worst > LIMIT:
        remedy = "lower the object's mass, raise the tension, or use more robots"
        when = "where edges bear the object"
        raise InfeasibleError([Violation("equilibrium", worst, LIMIT, "max", "", (), when, remedy)])


def _span(leaving: Array, arriving: Array) -> Array:
    """Return the length of edges' straight parts (…, n), times their level span squared [m³]."""
    whole = leaving + arriving
    free = length(leaving) + length(arriving)
    span: Array = free * (whole[..., 0] ** 2 + whole[..., 1] ** 2)
    return span


SOFT = 1e-2
"""Damping over stiffness: clasps do not turn about objects that are nearly round."""

PROBE = 1e-6
"""[m] Step of differences of what edges pull."""

FARTHEST = 0.5
"""Longest step of a clasp over the shorter of its straight parts, at most as far as which edges
pull nearly as their derivatives say."""


def contacts_of(polygon: Array, wraps: Wraps, core: Array) -> Array:
    """Return where edges meet and leave the section (…, n, 2, 2) [m].

    Of straight edges that is the point which comes to touch the section first.
    """
    chord = np.roll(polygon, -1, axis=-2) - polygon
    along = unit(chord)
    corner = core[wraps.bends.corners[..., 0]]
    ahead = np.sum((corner - polygon) * along, axis=-1, keepdims=True)
    nearest = polygon + np.clip(ahead, 0.0, length(chord)[..., None]) * along
    touching = wraps.bends.touching[..., None, None]
    return np.where(touching, wraps.contacts, nearest[..., None, :])


def straight_parts(polygon: Array, contacts: Array, z: Array) -> tuple[Array, Array]:
    """Return the straight parts (…, n, 3) [m] of edges at ``p_k``, and at ``p_{k+1}``."""
    leaving = np.concatenate([contacts[..., 0, :] - polygon, -z[..., None]], axis=-1)
    onward = np.roll(polygon, -1, axis=-2) - contacts[..., 1, :]
    return leaving, np.concatenate([onward, np.roll(z, -1, axis=-1)[..., None]], axis=-1)


def balanced(
    clasps: Array, T: Array, arms: Array, load: Array, back: tuple[Array, Array] | None = None
) -> Array:
    """Return clasps (…, n, 3) [m], moved and turned together and raised, whose edges bear a load.

    One damped step of Newton's, shortened where it is long. No edge turns a disc.

    Parameters
    ----------
    clasps: (…, n, 3) [m], from the centre of mass, and above the plane of contact.
    arms: (…, n, 2, 2) [m], contacts, from the centre of mass.
    load: (…, 3) [N], level force on the object there, and weight.
    back: (…, n, 2) [m], clasps as planned, and (…) the share by which they are moved from there;
        None for all.
    """
    polygon, z = clasps[..., :2], clasps[..., 2]
    size = np.mean(length(arms), axis=(-2, -1))[..., None, None]
    at = np.stack([arms[..., 0, :], np.roll(arms[..., 1, :], 1, axis=-2)], axis=-2)
    pull = np.stack([T, np.roll(T, 1, axis=-1)], axis=-1)
    turn = np.stack([-polygon[..., 1], polygon[..., 0]], axis=-1) / size
    moves = np.stack([0.0 * turn + [1.0, 0.0], 0.0 * turn + [0.0, 1.0], turn])

    def lacking(there: Array) -> Array:
        """Return level force, and moment over size (…, 3) [N], that edges lack."""
        parts = _parts(there, _raised(there, z, pull, at, load[..., 2]), at)
        pulls = pull[..., None] * unit(parts)
        moments = at[..., 0] * pulls[..., 1] - at[..., 1] * pulls[..., 0]
        pulls[..., 2] = moments / size
        lacks: Array = load * [1.0, 1.0, 0.0] - np.sum(pulls, axis=(-3, -2))
        return lacks

    after, before = (lacking(polygon + step * moves) for step in (PROBE, -PROBE))
    stiffness = np.moveaxis(before - after, 0, -1) / (2.0 * PROBE)
    soft = (SOFT * np.linalg.norm(stiffness, axis=(-2, -1)))[..., None, None] ** 2 * np.eye(3)
    transposed = np.swapaxes(stiffness, -2, -1)
    right = transposed @ lacking(polygon)[..., None]
    found = np.linalg.solve(transposed @ stiffness + soft, right)[..., 0]
    there = polygon + np.einsum("j...ni,...j->...ni", moves, found)
    if back is not None:
        planned, share = back
        there = planned + share[..., None, None] * (there - planned)
    raised = _raised(there, z, pull, at, load[..., 2])
    step = np.concatenate([there, raised[..., None]], axis=-1) - clasps
    reach = FARTHEST * np.min(length(_parts(polygon, z, at)), axis=-1)
    part = np.min(reach / np.maximum(length(step), reach), axis=-1)
    stepped: Array = clasps + part[..., None, None] * step
    return stepped


def _parts(polygon: Array, z: Array, at: Array) -> Array:
    """Return the straight parts (…, n, 2, 3) [m] from contacts (…, n, 2, 2) to their clasps."""
    level = polygon[..., None, :] - at
    height = np.broadcast_to(z[..., None, None], (*level.shape[:-1], 1))
    parts: Array = np.concatenate([level, height], axis=-1)
    return parts


def _raised(polygon: Array, z: Array, pull: Array, at: Array, weight: Array) -> Array:
    """Return the clasps' heights (…, n) [m], after a step of Newton's towards bearing a weight.

    Of all lifts that bear it without a moment about level axes they have the nearest to equal ones.
    """
    parts = _parts(polygon, z, at)
    rates = pull / length(parts)
    lifts = np.concatenate([np.ones_like(at[..., :1]), at], axis=-1) * rates[..., None]
    whole = np.sum(rates, axis=-1)
    means = np.sum(lifts, axis=-2) / whole[..., None]  # (…, n, 3), of force and moments
    wanted = weight[..., None] * ([1.0, 0.0, 0.0] - np.mean(means, axis=-2))
    squares = np.swapaxes(means, -1, -2) @ means
    forces = weight[..., None] / z.shape[-1]
    forces = forces + (means @ np.linalg.solve(squares, wanted[..., None]))[..., 0]
    stiff = np.sum(rates * (1.0 - unit(parts)[..., 2] ** 2), axis=-1)
    raised: Array = z + (forces - whole * z) / stiff
    return raised


ROUNDS = 20
"""Times that the angle which cables wrap and the friction over it are computed from each other."""

TINY = 1e-12
"""Keeps quotients of friction finite where there is none."""


def _other_half(friction: Array, angle: Array) -> Array:
    """Return half of the angle (…) [rad] that legs enclose where edges enclose one, or the reverse.

    Where cables slide on each other, ``cos x = e^{-μ θ} cos(β/2)``: x and β are of the side that is
    pulled more and of the other one, μ is the friction and ``θ = β/2 + x`` what cables turn by.
    """
    half = other = 0.5 * angle
    for _ in range(ROUNDS):
        rubbed = np.exp(-friction * (half + other))
        other = np.arccos(np.clip(rubbed * np.cos(half), -1.0, 1.0))
    return other


def edge_ratios(friction: Array, edges: Array) -> Array:
    """Return tensions of edges over those of their legs (…, n) where legs lean.

    Of both clasps of a cable the lesser friction counts.

    Parameters
    ----------
    friction: (…), coefficient of cables on each other that counts; negative where clasps open.
    edges: (…, n) [rad], between edges at clasps.
    """
    friction = friction[..., None]
    one = np.abs(friction) * (0.5 * edges + _other_half(friction, edges)) + TINY
    other = np.roll(one, -1, axis=-1)
    lesser = one * other / (0.5 * (one**8 + other**8)) ** 0.125
    ratios: Array = np.exp(-np.sign(friction) * lesser)
    return ratios


SEARCHED = 0.9
"""Share of the largest level pull with which polygons are looked for: they do not depend on it."""


def grip_polygons(
    name: str, body: SolidObject, team: Team, requirements: Requirements, gap: float
) -> HoldPolygons:
    """Return the polygons of the grip whose slip load is largest.

    Parameters
    ----------
    name, body: the object.
    gap: how far edges around it keep from it [m].

    Raises
    ------
    InputError: cables or drones that differ.
    InfeasibleError: no grip was found.
    """
    for key, values in (("cable_length", team.cable_length), ("quadrotor", team.quadrotor)):
        if len(set(values)) > 1:
            bound = "alike for all robots where they grip an object"
            raise InputError(f"team.{key}", list(values), bound, "use one kind")
    drone, cable = team.quadrotor[0], float(team.cable_length[0])
    pull = SEARCHED * largest_tension(requirements, drone)[0]
    friction, section = team.cable_friction, body.section
    task = GripTask(section, team.robots, cable, pull, friction, requirements, drone)
    try:
        closed = best_grip(task).vertices
    except InfeasibleError as error:
        words = f"around objects.{name}"
        raise InfeasibleError([replace(v, when=words) for v in error.violations]) from None
    return HoldPolygons.about(closed, body.centre_of_mass[:2], (body.section,), gap, STRETCHES)


def check_pull(tension: float, team: Team, requirements: Requirements) -> None:
    """Raise InfeasibleError for level pulls that no drone can hold."""
    most, binding = largest_tension(requirements, team.quadrotor[0])
    if tension <= most:
        return
    tilt = np.degrees(requirements.limits.tilt)
    remedy = f"grasp with a tension of {most:.3g} N or less"
    if binding == "tilt":
        needed = np.degrees(np.arctan(tension / (9.81 * team.mass[0])))
        remedy = (
            f"level pulls of {tension:.3g} N need limits.tilt_deg of {np.ceil(needed) + 5:.0f}, "
            f"above {tilt:.3g}; or {remedy}"
        )
    raise InfeasibleError(
        [Violation(binding, tension, most, "max", "N", (), "to grip at rest", remedy)]
    )


OUTWARD = 0.02
"""[m] Clasps are opened that go outward by more: they are nowhere to a centimetre."""


def check_opens(hitch: Hitch, around: Array, requirements: Requirements, remedy: str) -> None:
    """Raise InfeasibleError where friction keeps legs from opening a hitch.

    A clasp opens where its legs, which enclose β, pull outward by more than its edges do inward:
    ``cos(β/2) > e^{μ θ} cos(β_edges/2)``, μ the cables' friction and θ the mean of both angles, by
    which cables turn. Legs enclose the least angle where their drones are side by side.

    Parameters
    ----------
    hitch: closed, as it is now.
    around: (n, 2) [m], where its vertices are to go, as seen from a common centre or not.
    requirements: the distance of drones.
    remedy: what to change.
    """
    friction, layout = hitch.team.cable_friction, hitch.team.layout
    if friction == 0.0 or np.any(hitch.roll):
        return
    here = hitch.polygon.vertices
    ahead, behind = (unit(np.roll(here, shift, axis=0) - here) for shift in (-1, 1))
    moved = (around - np.mean(around, axis=0)) - (here - np.mean(here, axis=0))
    opened = -np.sum(unit(ahead + behind) * moved, axis=1) > OUTWARD
    edges = np.arccos(np.clip(np.sum(ahead * behind, axis=1), -1.0, 1.0))
    d, e = hitch.legs[layout.ahead, 0], hitch.legs[layout.behind, 1]
    apart = 2.0 * requirements.separation.radius
    legs = np.arccos(np.clip((d**2 + e**2 - apart**2) / (2.0 * d * e), -1.0, 1.0))
    turned, room = 0.5 * (edges + legs), np.log(np.cos(0.5 * legs) / np.cos(0.5 * edges))
    excess = np.where(opened, np.exp(friction * turned - room), 0.0)
    worst = int(np.argmax(excess))
    if excess[worst] <= 1.0:
        return
    where, words = (hitch.team.point_names[layout.clasps[worst]],), "as the hitch opens"
    smoother = room[worst] / turned[worst]
    if smoother > 0.0:
        smoother = math.floor(1000.0 * smoother) / 1000.0
        remedy = f"{remedy}, or use smoother cables, team.cable_friction {smoother:.3g} or less"
    raise InfeasibleError(
        [Violation("equilibrium", float(excess[worst]), 1.0, "max", "ratio", where, words, remedy)]
    )


def grip_left(legs: Array, tension: Array, clasp_friction: float, friction: float) -> float:
    """Return the largest slip load [N] of a hitch that has been opened as far as friction lets it.

    Cables slide on each other until friction holds edges against legs. What the angles between
    edges add up to beyond those of a polygon is wrapped around the object.

    Parameters
    ----------
    legs: (n, 2, 2) [m], the two legs at every clasp as seen from above.
    tension: (n,) [N], of legs.
    clasp_friction: coefficient of cables on each other.
    friction: coefficient of cables on the object.
    """
    one, other = np.moveaxis(unit(legs), 1, 0)
    between = np.arccos(np.clip(np.sum(one * other, axis=-1), -1.0, 1.0))
    half = _other_half(np.asarray(clasp_friction), between)
    harder = float(np.max(np.exp(clasp_friction * (half + 0.5 * between))))
    wrapped = max(2.0 * float(np.sum(half)) - (len(legs) - 2) * math.pi, 0.0)
    return friction * float(np.max(tension)) * harder * wrapped
