"""A hitch whose cables are wrapped around an object, and its motions: friction holds the object.

All is computed in the object's frame. Every cable pulls alike along its whole edge; edges slope
from the clasps down to the plane of contact and so carry the weight. While the object is off its
support all clasps are ahead of it by millimetres, so that edges pull it along: level forces come
from where edges bend, and need no friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.cable_spans import clasp_loads, leg_vectors, sag_factors
from hitchopt.hitch.statics import leg_directions
from hitchopt.holding.wraps import Wraps, wraps_around
from hitchopt.motion.phases import HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.planners.carrying.clasp_lean import edge_ratios
from hitchopt.planners.carrying.moves import Move, courses
from hitchopt.values import Array

PASSES = 6
"""Times that heights and places of clasps are computed from each other: to 1e-9 m."""

SCAN = 400
"""Places on the way from around the object to the grip at which edges are looked at."""


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
    apart: how far neighbouring drones have to be apart while legs lean [m].
    """

    by: ClassVar[HoldBy] = HoldBy.GRIP
    largest_acceleration: ClassVar[float] = np.inf
    team: Team
    body: SolidObject
    around: Array
    closed: Array
    height: float
    open_fractions: Array
    apart: float = 0.0

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
        drones = self._statics(np.ones(1), self.team.tension[None], still[:, 0])["drones"]
        return float(np.max(np.linalg.norm(drones[..., :2], axis=-1)))

    @property
    def farthest(self) -> float:
        """Longest way [m] of a clasp from around the object to the grip."""
        return float(np.max(length(self.closed - self.around)))

    def events(self, farthest: float) -> Array:
        """Return the shares in (0, farthest) at which an edge meets the object or another corner.

        There legs begin to turn: drones have to rest.
        """
        shares = np.linspace(0.0, farthest, SCAN + 1)
        kinds = self._kinds(shares)
        found = []
        for i in np.flatnonzero(np.any(kinds[1:] != kinds[:-1], axis=(1, 2))):
            low, high = shares[i], shares[i + 1]
            before = kinds[i]
            for _ in range(60):
                middle = 0.5 * (low + high)
                same = np.array_equal(self._kinds(np.array([middle]))[0], before)
                low, high = (middle, high) if same else (low, middle)
            found.append(high)
        return np.array(found)

    def _kinds(self, shares: Array) -> Array:
        """Return (…, n, 3) whether edges touch the object, and the corners at both contacts."""
        wraps = wraps_around(self.body.section, self._polygon(shares))
        away = wraps.contacts[..., None, :] - self.body.section.core
        corners = np.argmin(length(away), axis=-1)
        touching = (wraps.angles > 0.0)[..., None]
        return np.concatenate([touching, np.where(touching, corners, 0)], axis=-1)

    def _polygon(self, share: Array) -> Array:
        """Return the clasps (…, n, 2) [m] at shares of the way to the grip."""
        polygon: Array = self.around + share[..., None, None] * (self.closed - self.around)
        return polygon

    def curves(self, move: Move, t: Array) -> dict[str, Array]:
        """Return all curves of a move at times t (…) [s].

        Raises
        ------
        InfeasibleError: a weight that the tensions cannot carry.
        """
        course = courses(move, t)
        borne, pulled = course.borne, None
        weight = GRAVITY * borne
        if move.lifted:
            there = course.accelerations(self.body.centre_of_mass[None])[..., 0, :]
            pulled = self.body.mass * there[..., :2]
            weight = GRAVITY + there[..., 2]
        share = course.between(*move.closed)
        lean = course.between(*move.lean)
        found = self._statics(share, course.tension, self.body.mass * weight, pulled, lean)
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
        pulled: Array | None = None,
        lean: Array | None = None,
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
        pulled: (…, 2) [N], level force on the object; None while it stands.
        lean: (…), as of Move; None for none.
        """
        team, section, T = self.team, self.body.section, tension
        polygon = self._polygon(share)
        wraps = wraps_around(section, polygon)
        contacts = _contacts(polygon, wraps, section.core)
        centre = self.body.centre_of_mass[:2]
        z = np.zeros(polygon.shape[:-1])
        for _ in range(PASSES):
            leaving, arriving = _tangents(polygon, contacts, z)
            z = _heights(T, leaving, arriving, contacts - centre, weight)
            if pulled is not None:
                polygon = polygon + _shift(T, leaving, arriving, pulled)[..., None, :]
                wraps = wraps_around(section, polygon)
                contacts = _contacts(polygon, wraps, section.core)
        leaving, arriving = _tangents(polygon, contacts, z)
        free = length(leaving) + length(arriving)
        if lean is not None and np.any(lean):
            legs = 0.5 * (team.cable_length - wraps.arcs - free)
            T = tension * edge_ratios(
                team.cable_friction * lean, wraps.clasp_angles, legs, self.apart
            )
        factors = sag_factors(team, T)
        edges = wraps.arcs + free
        if team.cable_density > 0.0:
            whole = leaving + arriving
            edges = edges + factors * free * (whole[..., 0] ** 2 + whole[..., 1] ** 2)
        slack = team.cable_length - edges
        q_legs = (self.open_fractions + share[..., None] * (0.5 - self.open_fractions)) * slack
        loads = clasp_loads(team, q_legs, slack, None)
        pulls = np.stack([tension, tension], axis=-1)
        leaning = None if lean is None or not np.any(lean) else pulls
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


def _contacts(polygon: Array, wraps: Wraps, core: Array) -> Array:
    """Return where edges meet and leave the section (…, n, 2, 2) [m].

    Of straight edges that is the point which comes to touch the section first.
    """
    chord = np.roll(polygon, -1, axis=-2) - polygon
    along = unit(chord)
    left = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    corner = core[np.argmax(left @ core.T, axis=-1)]
    ahead = np.sum((corner - polygon) * along, axis=-1, keepdims=True)
    nearest = polygon + np.clip(ahead, 0.0, length(chord)[..., None]) * along
    touching = (wraps.angles > 0.0)[..., None, None]
    return np.where(touching, wraps.contacts, nearest[..., None, :])


def _tangents(polygon: Array, contacts: Array, z: Array) -> tuple[Array, Array]:
    """Return the straight parts (…, n, 3) [m] of edges at ``p_k``, and at ``p_{k+1}``."""
    leaving = np.concatenate([contacts[..., 0, :] - polygon, -z[..., None]], axis=-1)
    onward = np.roll(polygon, -1, axis=-2) - contacts[..., 1, :]
    return leaving, np.concatenate([onward, np.roll(z, -1, axis=-1)[..., None]], axis=-1)


def _shift(T: Array, leaving: Array, arriving: Array, pulled: Array) -> Array:
    """Return how far all clasps go (…, 2) [m] for edges to pull with a level force (…, 2) [N].

    Moved across itself a straight part of length t turns, and pulls with ``T / t`` more per metre.
    """
    force: Array = -pulled
    stiffness: Array = np.zeros((*pulled.shape, 2))
    for part, sign in ((leaving, -1.0), (arriving, 1.0)):
        along = unit(part)[..., :2]
        force = force + sign * np.sum(T[..., None] * along, axis=-2)
        across = np.eye(2) - along[..., :, None] * along[..., None, :]
        stiffness = stiffness + np.sum((T / length(part))[..., None, None] * across, axis=-3)
    shift = np.linalg.solve(stiffness, -force[..., None])[..., 0]
    return np.asarray(shift, dtype=np.float64)


def _heights(T: Array, leaving: Array, arriving: Array, arms: Array, weight: Array) -> Array:
    """Return the heights (…, n) [m] of clasps at which edges carry a weight (…) [N].

    Clasp k lifts with ``f_k = z_k (T_k / t + T_{k-1} / t')``, t and t' its edges' straight parts,
    at their contacts. Of all ``f`` with that sum and no moment about level axes the nearest to
    equal ones is taken.

    Parameters
    ----------
    arms: (…, n, 2, 2) [m], contacts seen from the centre of mass.
    """
    ahead = T / length(leaving)
    behind = np.roll(T / length(arriving), 1, axis=-1)
    rate = ahead + behind
    each = ahead[..., None] * arms[..., 0, :]
    each = (each + behind[..., None] * np.roll(arms[..., 1, :], 1, axis=-2)) / rate[..., None]
    rows = np.concatenate([np.ones_like(rate)[..., None, :], np.swapaxes(each, -1, -2)], axis=-2)
    wanted = np.stack([weight, 0.0 * weight, 0.0 * weight], axis=-1)
    equal = np.repeat(weight[..., None] / T.shape[-1], T.shape[-1], axis=-1)
    short = wanted - np.einsum("...ij,...j->...i", rows, equal)
    forces = equal + np.einsum("...ij,...j->...i", np.linalg.pinv(rows), short)
    heights: Array = forces / rate
    return heights
