"""Checks of the clasps: ``equilibrium`` of the cables' forces, and ``convexity`` of the outline.

At clasp k meet the q-leg and the edge of cable k and the r-leg and the edge of cable k-1. Cable k
is borne by its drones with half of its legs, by clasp k with half of its q-leg and edge, by clasp
k+1 with half of its edge and r-leg. With all of its length used up (check ``cable_length``) ``d_k +
l_k = L_k - e_k``, so that norms of legs alone tell the weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from hitchopt.checks.cables import beyond_friction, slips
from hitchopt.checks.certificate import within
from hitchopt.checks.objects import lacking, unbalanced
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.checks.spans import (
    MotionSpans,
    bent_edges,
    derivative_margin,
    edge_vectors,
    leg_vectors,
    same_degree,
    shared,
    without_shared_zeros,
)
from hitchopt.geometry.vectors import column_lengths
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import chord_pull
from hitchopt.motion.loads import leg_tensions, object_loads, strut_shares, tautness
from hitchopt.motion.motion import HITCHED_STATE, Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of, vector
from hitchopt.trajectory.search import worst
from hitchopt.values import Array

LIMIT = 5e-3
"""Relative to the tension: the vertex then stands within millimetres of its place."""

SIGNS = 1.0, 1.0, 1.0, -1.0
"""The last of the parts at a clasp arrives there; the others leave it."""

BACKWARD = -180.0
"""[deg] The smallest angle there is; also that of an edge without direction."""


@shared
def clasp_forces(motion: Motion) -> dict[str, list[Array]]:
    """Return the sizes of forces at clasps, rows of (pieces, clasps, degree + 1).

    A factor ``x^a (1 - x)^b`` that all of them share, as where tensions rise from zero, is left
    out: it cancels in every ratio.

    - ``parts`` [N]: tensions of the leg and the edge ahead and of those behind; those of edges less
      what a rim takes;
    - ``halves`` [N/m], where there is weight: half of the weight per length of the same parts;
    - ``tensions`` [N] of both edges;
    - ``weights`` where there is weight: of the cable ahead and of that behind, its share of the
      load with half of its cable's weight [N], and half of the weight per length [N/m];
    - ``loads`` of objects [N], where there are any.
    """
    team, ahead, behind = motion.team, motion.team.layout.ahead, motion.team.layout.behind
    tension, legs = edge_tensions(motion), leg_tensions(motion)
    taut, half = tautness(motion), 0.5 * GRAVITY * team.cable_density
    loads = object_loads(motion)

    def parts(legs: Array, edges: Array) -> list[Array]:
        return [legs[:, 2 * ahead], edges[:, ahead], legs[:, 2 * behind + 1], edges[:, behind]]

    found = {"parts": parts(legs, tension), "tensions": [tension[:, ahead], tension[:, behind]]}
    if half > 0.0:
        found["halves"] = parts(half * np.repeat(taut, 2, axis=1), half * _kept(motion, taut))
    if team.loaded or loads is not None:
        found["weights"] = []
        for cable in (ahead, behind):
            own = 0.5 * GRAVITY * team.load + half * team.cable_length[cable]
            found["weights"] += [own[:, None] * taut[:, cable], half * taut[:, cable]]
    if loads is not None:
        found["loads"] = list(np.moveaxis(loads, 2, 0))
    rows = iter(without_shared_zeros([row for each in found.values() for row in each]))
    return {name: [next(rows) for _ in each] for name, each in found.items()}


def edge_tensions(motion: Motion) -> Array:
    """Return what edges pull with (pieces, n, degree + 1) [N], less what a rim takes."""
    return _kept(motion, motion.tensions.coefficients)


def _kept(motion: Motion, values: Array) -> Array:
    """Return values of edges (pieces, n, degree + 1) less the share that rims take."""
    taken = strut_shares(motion)
    return values if taken is None else bernstein.multiply(1.0 - taken[:, None], values)


def clasp_names(motion: Motion) -> Sequence[str]:
    """Return the clasps' names."""
    return [motion.team.point_names[k] for k in motion.team.layout.clasps]


class Clasps(MotionSpans):
    """Spans of clasps: the forces that meet there."""

    names = staticmethod(clasp_names)

    @cached_property
    def _sizes(self) -> dict[str, list[Enclosed]]:
        return {name: self.scalars(rows) for name, rows in clasp_forces(self.source).items()}

    @cached_property
    def pulls(self) -> list[Enclosed]:
        """The pulls along q̂_k, u_k, r̂_{k-1} and u_{k-1} [N]."""
        tensions, halves = self._sizes["parts"], self._sizes.get("halves")
        if halves is None:
            return tensions
        found = []
        for i, way in enumerate(self.ways):
            if i % 2 == 0:
                found.append(chord_pull(tensions[i], halves[i], way.level.dot(way.level), way[2]))
            else:
                found.append(chord_pull(tensions[i], halves[i], self.edge_squares[i // 2]))
        return found

    @cached_property
    def tensions(self) -> Enclosed:
        """The tensions of both edges [N], a component each."""
        return vector(*self._sizes["tensions"])

    @staticmethod
    def weighed(motion: Motion) -> bool:
        """Return whether clasps carry anything."""
        return "weights" in clasp_forces(motion)

    @cached_property
    def ways(self) -> tuple[Enclosed, ...]:
        """Chords of the leg and the edge ahead and of those behind [m]; the last one arrives."""
        motion, layout = self.source, self.source.team.layout
        ahead, behind = layout.ahead[self.item], layout.behind[self.item]
        legs, (leaving, arriving) = leg_vectors(motion), bent_edges(motion)
        each = (legs, 2 * ahead), (leaving, ahead), (legs, 2 * behind + 1), (arriving, behind)
        return tuple(Enclosed(self.read(*part), self.noise) for part in each)

    @cached_property
    def others(self) -> list[Enclosed]:
        """Lengths of the other legs of the cables ahead and behind [m]."""
        layout = self.source.team.layout
        # A drone at a chain's end has no leg, wherever a plan has it.
        legs = leg_vectors(self.source) * layout.has_leg.reshape(-1, 1, 1)
        others = 2 * layout.ahead[self.item] + 1, 2 * layout.behind[self.item]
        return [Enclosed(self.read(legs, other), self.noise).norm for other in others]

    @cached_property
    def edge_squares(self) -> list[Enclosed]:
        """Squared lengths of the edges ahead and behind as seen from above [m²].

        One that is wrapped around something counts whole: what legs leave of its cable.
        """
        team = self.source.team
        if self.source.contacts is None:
            return [edge.level.dot(edge.level) for edge in (self.ways[1], self.ways[3])]
        found = []
        for i, cable in enumerate((team.layout.ahead, team.layout.behind)):
            whole = Enclosed(team.cable_length[cable[self.item]][:, None, None])
            edge = whole - self.ways[2 * i].norm - self.others[i]
            found.append(edge * edge)
        return found

    @cached_property
    def along(self) -> tuple[Enclosed, ...]:
        """Directions q̂_k, u_k, r̂_{k-1} and u_{k-1}."""
        return tuple(way.direction for way in self.ways)

    @cached_property
    def forces(self) -> tuple[Enclosed, ...]:
        """Forces [N] of leg and edge ahead and of those behind; the last edge leads backward."""
        each = zip(self.along, self.pulls, SIGNS, strict=True)
        return tuple(along * (sign * pull) for along, pull, sign in each)

    @cached_property
    def carried(self) -> tuple[Enclosed, Enclosed]:
        """[N] What the clasp carries of the cable ahead and of that behind."""
        rows, sizes = self._sizes["weights"], self.others
        return rows[0] - rows[1] * sizes[0], rows[2] - rows[3] * sizes[1]

    @cached_property
    def pressed(self) -> Enclosed | None:
        """[N] The force of objects on the clasp; None without any."""
        if "loads" not in self._sizes:
            return None
        loads = vector(*self._sizes["loads"])
        return loads.widened(_load_errors(self.source)[self.piece, self.item])

    @cached_property
    def residual(self) -> Enclosed:
        """``P_q q̂_k + P_k u_k + P_r r̂_{k-1} - P_{k-1} u_{k-1} - W_k ẑ`` and what objects add."""
        found = self.forces[0] + self.forces[1] + self.forces[2] + self.forces[3]
        if self.weighed(self.source):
            found = found - (self.carried[0] + self.carried[1]).upward()
        return found if self.pressed is None else found + self.pressed

    @cached_property
    def contact(self) -> Enclosed:
        """``C = W^k ẑ - (P_q q̂_k + P_k u_k)``, with which cable k presses on cable k-1 [N].

        ``W^k`` is the weight on itself and half of the clasp's load.
        """
        found = self.carried[0].upward() - (self.forces[0] + self.forces[1])
        return found if self.pressed is None else found - 0.5 * self.pressed


@shared
def _load_errors(motion: Motion) -> Array:
    """Return by how much objects' forces on clasps may be off (pieces, clasps) [N]."""
    mass = sum(each.mass for each in motion.requirements.objects.values() if not each.fixed)
    error = mass * derivative_margin(motion.vertices, 2)[:, motion.team.layout.clasps]
    loads = object_loads(motion)
    return error if loads is None else np.where(np.any(loads != 0.0, axis=(2, 3)), error, 0.0)


def over(force: Enclosed, tensions: Enclosed) -> Bound:
    """Return what a force's size over the smallest of tensions does not rise above.

    Infinite where a tension is not positive.
    """
    c, pulls = same_degree(force.c, tensions.c)
    sizes, least = c[..., 0, :] if c.shape[-2] == 1 else column_lengths(c), np.min(pulls, axis=-2)
    sizes = sizes + np.broadcast_to(force.r, sizes.shape[:-1])[..., None]
    ratio = np.divide(sizes, least, out=np.full_like(sizes, np.inf), where=least > 0.0)
    return Enclosed(ratio[..., None, :]).above


def _balance(spans: Clasps) -> Bound:
    """Return the size of the residual over the smaller tension."""
    return over(spans.residual, spans.tensions)


def _lifted(spans: Clasps) -> Bound:
    """Return the largest product that is negative where a clasp bears, over the smaller tension.

    The clasp bears where ``C·q̂_k < 0``, ``C·u_k < 0``, ``C·r̂_{k-1} > 0`` and ``C·u_{k-1} < 0``.
    """
    pressed = zip(spans.along, (1.0, 1.0, -1.0, 1.0), strict=True)
    return largest_of(
        [over(spans.contact.dot(along) * sign, spans.tensions) for along, sign in pressed]
    )


def _find(motion: Motion, limit: float) -> Finding:
    """Return the largest force residual at a clasp over the smaller of its cables' tensions.

    What friction cannot make of a tension counts as unbalanced, and so does what an object lacks.
    Where there is weight cables have to press on each other as well: a clasp that does not bear is
    infinitely far from balance.
    """
    names = Clasps.names(motion)
    found = worst(Clasps.of(motion), _balance, "max", target=within(limit, "max"))
    best = Finding(found.worst, found.time, (names[found.item],))
    if motion.leg_tensions is not None:
        beyond = beyond_friction(motion)
        best = beyond if beyond.worst > best.worst else best
    if Clasps.weighed(motion):
        lifted = worst(Clasps.of(motion), _lifted, "max", target=within(0.0, "max"))
        if lifted.worst >= 0.0:
            best = Finding(math.inf, lifted.time, (names[lifted.item],))
    gripped = unbalanced(motion)
    return gripped if gripped.worst > best.worst else best


def spare_forces(motion: Motion) -> Array:
    """Return which loads may be added at clasps (pieces, clasps) [N] with all forces balanced.

    Half of what is added to a clasp enters the products of ``contact``.
    """
    spare = LIMIT - _find(motion, LIMIT).worst
    if Clasps.weighed(motion):
        spare = min(spare, -2.0 * worst(Clasps.of(motion), _lifted, "max").worst)
    weakest: Array = np.min(edge_tensions(motion), axis=-1)
    layout = motion.team.layout
    return spare * np.minimum(weakest[:, layout.ahead], weakest[:, layout.behind])


FORMULAS = (_balance, Clasps.residual, _lifted, Clasps.contact, slips, lacking)


EQUILIBRIUM = CheckRule(
    "equilibrium", "1", "max", LIMIT, (Finder(_find, HITCHED_STATE, shown=FORMULAS),)
)


@shared
def _corners(motion: Motion) -> Array:
    """Return the edges behind and ahead of corners, seen from above (pieces, corners, 2, 2, …).

    Besides its clasps a chain has a corner from its last edge to its first one reversed.
    """
    edges, layout = edge_vectors(motion)[:, :, :2], motion.team.layout
    both = np.stack([edges[:, layout.behind], edges[:, layout.ahead]], axis=2)
    ends = np.stack([edges[:, -1:], -edges[:, :1]], axis=2)
    return both if layout.closed else np.concatenate([both, ends], axis=1)


class Corners(MotionSpans):
    """Spans of the outline's corners."""

    @classmethod
    def names(cls, motion: Motion) -> Sequence[str]:
        """Return the corners' names."""
        return [*clasp_names(motion), *([] if motion.team.layout.closed else ["ends"])]


def _exterior(spans: Corners) -> Bound:
    """Return the angles [deg] by which the outline turns right.

    Of a chain's ends it is what they leave of once around. Seen from the angle at mid span the
    others are small; past 180° angles start again at -180°.
    """
    edges = spans.read(_corners(spans.source))
    behind, ahead = (Enclosed(edges[:, i], spans.noise) for i in (0, 1))
    dot, cross = behind.dot(ahead), ahead.cross(behind)
    middle = np.arctan2(cross.middle, dot.middle)
    c, s, middle = np.cos(middle), np.sin(middle), middle[:, 0]
    along, across = (dot * c + cross * s).range, (cross * c - dot * s).range
    least = np.arctan2(across.low, np.where(across.low < 0.0, along.low, along.high))
    most = np.arctan2(across.high, np.where(across.high < 0.0, along.high, along.low))
    known = (along.low > 0.0) & (middle + most <= np.pi)
    added = np.where(spans.item < len(spans.source.team.layout.clasps), 0.0, 180.0)
    return Bound(np.where(known, added + np.degrees(middle + least), BACKWARD), cross.below.x)


def _turns(motion: Motion, _: float) -> Finding:
    """Return the smallest exterior angle in degrees, seen from above; ``where`` names the vertex.

    A polygon that goes w times around its inside has ``360 (1 - w)`` reported if that is less, w
    that of the start; a chain 360° less all of its turning, and ``where`` names both ends.
    """
    found = worst(Corners.of(motion), _exterior, "min")
    layout, points = motion.team.layout, motion.team.point_names
    ends = (points[0], points[-1])
    clasped = found.item < len(layout.clasps)
    where = (Corners.names(motion)[found.item],) if clasped else ends
    behind, ahead = np.moveaxis(_corners(motion)[0, : len(layout.clasps), :, :, 0], 1, 0)
    right = behind[:, 1] * ahead[:, 0] - behind[:, 0] * ahead[:, 1]
    total = float(np.sum(np.degrees(np.arctan2(right, np.sum(behind * ahead, axis=-1)))))
    room = 360.0 * (1 - round(total / 360.0)) if layout.closed else 360.0 - total
    lowest = max(found.worst, BACKWARD)
    if lowest > BACKWARD and room < min(lowest, 0.0):
        return Finding(room, float(motion.vertices.breaks[0]), () if layout.closed else ends)
    return Finding(lowest, found.time, where)


CONVEXITY = CheckRule(
    "convexity",
    "deg",
    "min",
    0.0,
    (Finder(_turns, HITCHED_STATE, shown=(_exterior,)),),
    "go by a polygon in between, in two morphs",
)
