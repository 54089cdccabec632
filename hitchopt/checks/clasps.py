"""Checks of the clasps: ``equilibrium`` of the cables' forces, and ``convexity`` of the outline.

At clasp k meet the q-leg and the edge of cable k and the r-leg and the edge of cable k-1. Cable k
is borne by its drones with half of its legs, by clasp k with half of its q-leg and edge, by clasp
k+1 with half of its edge and r-leg. As the parts add up to its length (check ``cable_length``),
``d_k + l_k = L_k - e_k``: norms of legs alone determine the weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import permutations
from typing import NamedTuple

import numpy as np

from hitchopt.checks.cables import beyond_friction, slips
from hitchopt.checks.certificate import within
from hitchopt.checks.objects import chosen, lacking, unbalanced
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import (
    MotionSpans,
    bent_edges,
    cached,
    cached_value,
    derivative_margin,
    edge_vectors,
    leg_vectors,
    same_degree,
    without_shared_zeros,
)
from hitchopt.geometry.vectors import column_lengths, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import chord_pull
from hitchopt.motion.loads import leg_tensions, object_loads, strut_shares, tautness
from hitchopt.motion.motion import HITCHED_STATE, CableState, Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import Extremum, worst
from hitchopt.values import Array, Indices

BALANCE_LIMIT = 5e-3  # Relative to the tension: the vertex is then within millimetres of its place
BACKWARD = -180.0  # [deg] The smallest angle there is; also that of an edge without direction
TURN = 1e-6  # [deg] Rounding of the sum of all angles, which of a polygon are whole turns
ROLLED = 175.0  # [deg] From this roll on a clasp counts as open: at 180° both cables run straight
OPEN_STATES = frozenset({CableState.ROLLING, CableState.LYING})
LYING = frozenset({CableState.LYING})
ROUGH_ORDER = 3  # degree of factors that detect open clasps, which are far from closed ones
OWN = np.array([0, 1])  # Legs that are at the clasp: q of the cable ahead, r of that behind


def both_cables(motion: Motion) -> Indices:
    """Return the cables at clasps (clasps, 2): the one ahead, the one behind."""
    return np.stack([motion.team.layout.ahead, motion.team.layout.behind], axis=1)


@cached
def clasp_sizes(motion: Motion) -> dict[str, Array]:
    """Return the sizes of forces at clasps, (pieces, clasps, 2, degree + 1) of both cables.

    A factor ``x^a (1 - x)^b`` that all of them share, as where tensions rise from zero, is left
    out: it cancels in every ratio.

    - ``legs``, ``edges`` [N]: their tensions; those of edges less the share of a rim;
    - ``leg_halves``, ``edge_halves`` [N/m]: half of their weight per length;
    - ``weights`` [N]: half of the cable's, and its share of the load;
    - ``loads`` (pieces, clasps, 3, degree + 1) [N] of objects.
    """
    team, cables, taut = motion.team, both_cables(motion), tautness(motion)
    half, loads = 0.5 * GRAVITY * team.cable_density, object_loads(motion)
    own = 0.5 * GRAVITY * team.load[:, None] + half * team.cable_length[cables]
    tables = {
        "legs": leg_tensions(motion)[:, 2 * cables + OWN],
        "edges": edge_tensions(motion)[:, cables],
        "leg_halves": half * taut[:, cables],
        "edge_halves": _kept(motion, half * taut)[:, cables],
        "weights": own[..., None] * taut[:, cables],
        "loads": np.zeros((len(taut), len(cables), 3, 1)) if loads is None else loads,
    }
    rows = [row for table in tables.values() for row in np.moveaxis(table, 2, 0)]
    left = iter(without_shared_zeros(rows))
    each = {name: [next(left) for _ in range(tables[name].shape[2])] for name in tables}
    return {name: np.stack(same_degree(*rows), axis=2) for name, rows in each.items()}


def edge_tensions(motion: Motion) -> Array:
    """Return the pulls of edges (pieces, n, degree + 1) [N], less the share of a rim."""
    return _kept(motion, motion.tensions.coefficients)


def _kept(motion: Motion, values: Array) -> Array:
    """Return values of edges (pieces, n, degree + 1) less the share that rims take."""
    taken = strut_shares(motion)
    return values if taken is None else bernstein.multiply(1.0 - taken[:, None], values)


def clasp_names(motion: Motion) -> Sequence[str]:
    """Return the clasps' names."""
    return [motion.team.point_names[k] for k in motion.team.layout.clasps]


class Clasps(MotionSpans):
    """Spans of clasps: the forces that meet there, (spans, 2) of the cables ahead and behind."""

    names = staticmethod(clasp_names)

    @cached_property
    def cables(self) -> Indices:
        """(spans, 2) Both cables."""
        return both_cables(self.source)[self.item]

    def size(self, name: str) -> Enclosed:
        """Return one of ``clasp_sizes``."""
        return Enclosed(self.read(clasp_sizes(self.source)[name])[..., None, :])

    @cached_property
    def chords(self) -> tuple[Enclosed, Enclosed]:
        """Chords of legs and of edges, from the clasp [m]."""
        leaving, arriving = bent_edges(self.source)
        ahead, behind = self.cables.T
        edges = np.stack([self.read(leaving, ahead), -self.read(arriving, behind)], axis=1)
        legs = self.read(leg_vectors(self.source), 2 * self.cables + OWN)
        return Enclosed(legs, self.noise), Enclosed(edges, self.noise)

    @cached_property
    def others(self) -> Enclosed:
        """Lengths of the cables' other legs [m]."""
        # A drone at a chain's end has no leg, wherever a plan has it.
        legs = leg_vectors(self.source) * self.source.team.layout.has_leg.reshape(-1, 1, 1)
        return Enclosed(self.read(legs, 2 * self.cables + 1 - OWN), self.noise).norm

    @cached_property
    def along(self) -> tuple[Enclosed, Enclosed]:
        """Directions of legs, q̂_k and r̂_{k-1}, and of edges, u_k and -u_{k-1}."""
        return self.chords[0].direction, self.chords[1].direction

    @cached_property
    def pulls(self) -> tuple[Enclosed, Enclosed]:
        """Pulls of legs and edges along their chords [N].

        An edge wrapped around an object counts whole: its cable's length less the legs.
        """
        (leg, edge), team = self.chords, self.source.team
        if team.cable_density == 0.0:
            return self.size("legs"), self.size("edges")
        squared = edge.level.dot(edge.level)
        if self.source.contacts is not None:
            whole = Enclosed(team.cable_length[self.cables][..., None, None])
            wrapped = whole - leg.norm - self.others
            squared = wrapped * wrapped
        flat = leg.level.dot(leg.level)
        pulled = chord_pull(self.size("legs"), self.size("leg_halves"), flat, leg[2])
        return pulled, chord_pull(self.size("edges"), self.size("edge_halves"), squared)

    @cached_property
    def forces(self) -> Enclosed:
        """Both cables' forces [N]: ``P_q q̂_k + P_k u_k``, ``P_r r̂_{k-1} - P_{k-1} u_{k-1}``."""
        return self.along[0] * self.pulls[0] + self.along[1] * self.pulls[1]

    @cached_property
    def carried(self) -> Enclosed:
        """[N] Weight of both cables on the clasp."""
        return self.size("weights") - self.size("leg_halves") * self.others

    @staticmethod
    def weighed(motion: Motion) -> bool:
        """Return whether clasps carry weight."""
        return any(np.any(clasp_sizes(motion)[name]) for name in ("weights", "loads"))

    @cached_property
    def pressed(self) -> Enclosed:
        """[N] The force of objects on the clasp."""
        motion, loads = self.source, self.read(clasp_sizes(self.source)["loads"])
        mass = sum(each.mass for each in motion.requirements.objects.values() if not each.fixed)
        clasps = motion.team.layout.clasps[self.item]
        error = mass * derivative_margin(motion.vertices, 2)[self.piece, clasps]
        return Enclosed(loads, np.where(np.any(loads != 0.0, axis=(1, 2)), error, 0.0))

    @cached_property
    def residual(self) -> Enclosed:
        """``P_q q̂_k + P_k u_k + P_r r̂_{k-1} - P_{k-1} u_{k-1} - W_k ẑ`` and loads of objects."""
        force = self.forces.sum()
        if self.weighed(self.source):
            force = force - self.carried.sum().upward() + self.pressed
        return force

    @cached_property
    def contact(self) -> Enclosed:
        """Force of each cable on the other, such as ``W^k ẑ - (P_q q̂_k + P_k u_k)`` [N].

        ``W^k`` is the weight on itself and half of the clasp's load.
        """
        if not self.weighed(self.source):
            return -self.forces
        pressed = Enclosed(self.pressed.c[:, None], np.asarray(self.pressed.r)[..., None])
        return self.carried.upward() - self.forces - pressed * 0.5

    @cached_property
    def turn(self) -> tuple[Enclosed, Enclosed, Enclosed]:
        """Cosine of the roll, sine over the size of V, times a common positive factor; V.

        With V the sum of its legs' pulls, D their difference and ū = u_k + u_{k-1} cosine and sine
        go as ``(D·ū) V² - (D·V) (ū·V)`` and ``D·(ū × V) |V|``.
        """
        pulls = (self.along[0] * self.pulls[0]).reduced(ROUGH_ORDER)
        q, r = chosen(pulls, 0), chosen(pulls, 1)
        ahead = (chosen(self.along[1], 0) - chosen(self.along[1], 1)).reduced(ROUGH_ORDER)
        whole, apart = q + r, q - r
        cosine = apart.dot(ahead) * whole.dot(whole) - apart.dot(whole) * ahead.dot(whole)
        return cosine, apart.dot(ahead.cross(whole)), whole

    def rolls(self) -> Array:
        """Return the rolls (spans,) [deg] at mid span: 0 where ``q̂_k`` leans towards ``u_k``."""
        (q, r), (u, back) = (np.moveaxis(each.middle, 1, 0) for each in self.along)
        pull, other = np.moveaxis(self.pulls[0].middle, 1, 0)
        axis = unit(pull * q + other * r)
        upward = np.cross(u - back, axis)
        level = np.cross(axis, upward)
        rise, run = np.sum(q * upward, axis=-1), np.sum(q * level, axis=-1)
        return np.asarray(np.degrees(np.arctan2(rise, run)))


def _over(force: Enclosed, spans: Clasps) -> Bound:
    """Return the upper bound of a force, or its size, over the smaller tension.

    It is infinite where a tension is not positive.
    """
    c, tensions = same_degree(force.c, spans.size("edges").c)
    sizes = c if c.shape[1] == 1 else column_lengths(c)[:, None]
    sizes, least = sizes + np.asarray(force.r)[..., None, None], np.min(tensions, axis=1)
    ratio = np.divide(sizes, least, out=np.full_like(sizes, np.inf), where=least > 0.0)
    return Enclosed(ratio).above


def _balance(spans: Clasps) -> Bound:
    """Return the size of the residual over the smaller tension, infinite where a clasp is open.

    Where pairs roll, what bears is a matter of the angle alone, which ``turns`` follows: near 180°
    the weights that cables leave to one another are more than their contact. Where they pass weight
    to one another, that of both cables may be borne elsewhere.
    """
    residual, lifted = _over(spans.residual, spans), _lifted(spans)
    if spans.weighed(spans.source):
        lifted = largest_of([lifted, _rolled(spans)])
    shut = lifted.value < 0.0
    shut |= spans.source.in_states(OPEN_STATES)[spans.piece]
    value, lying = residual.value, spans.source.in_states(LYING)[spans.piece]
    if np.any(lying):
        team = spans.source.team
        weight = GRAVITY * team.cable_density * np.sum(team.cable_length[spans.cables], axis=1)
        value = value - np.where(lying, weight / np.min(team.tension[spans.cables], axis=1), 0.0)
    return Bound(np.where(shut, value, np.inf), np.where(shut, residual.x, lifted.x))


def _lifted(spans: Clasps) -> Bound:
    """Return the largest product that is negative where a clasp bears, over the smaller tension.

    The clasp bears where ``C·q̂_k < 0``, ``C·u_k < 0``, ``C·r̂_{k-1} > 0`` and ``C·u_{k-1} < 0``;
    with friction, which tilts C along the cables, where that is so of the means of each cable's
    two. Unloaded, each is ``-2 T cos²(φ/2) cos²(ψ/2)`` of a roll ψ and an exterior angle φ: what it
    is at ROLLED is added, so a clasp counts as open from there on.
    """
    legs, edges = (each.reduced(ROUGH_ORDER) for each in spans.along)
    directions = [legs, edges] if spans.source.leg_tensions is None else [(legs + edges) * 0.5]
    products = [spans.contact.reduced(ROUGH_ORDER).dot(each) for each in directions]
    most = [np.max(each.c + np.asarray(each.r)[..., None, None], axis=1) for each in products]
    share = math.cos(math.radians(0.5 * ROLLED)) ** 2
    margin = 0.5 * share * (chosen(edges, 0) - chosen(edges, 1)).norm_above.value ** 2
    largest = _over(Enclosed(np.maximum(most[0], most[-1])), spans)
    return Bound(largest.value + margin, largest.x)


def _rolled(spans: Clasps) -> Bound:
    """Return a bound that is negative where a clasp has rolled by less than ROLLED, for any load.

    Legs of clasps that carry much could wind around their edges in contact.
    """
    cosine, sine, whole = spans.turn
    aside, least = sine.range, cosine.below
    most = np.maximum(np.maximum(aside.low, -aside.high), 0.0) * whole.norm_below.value
    return Bound(math.tan(math.radians(ROLLED)) * least.value - most, least.x)


def turns(motion: Motion) -> tuple[Array, Array]:
    """Return rolls at the start and their changes (clasps,) [deg], which are followed throughout.

    Changes are nan where a piece is too long to follow a roll on it.
    """
    first, total = np.zeros((2, len(motion.team.layout.clasps)))
    for spans in Clasps.of(motion):
        rolls = [spans.at(np.full(len(spans), x)).rolls() for x in (0.0, 0.5, 1.0)]
        cosine, sine, whole = spans.turn
        here = np.radians(rolls[1])[:, None]
        along = cosine * np.cos(here) + sine * whole.norm * np.sin(here)
        followed = along.below.value > 0.0  # within a right angle of that at mid span
        steps = (rolls[2] - rolls[0] + 180.0) % 360.0 - 180.0
        np.add.at(total, spans.item, np.where(followed, steps, np.nan))
        begin = spans.piece == 0
        first[spans.item[begin]] = rolls[0][begin]
    return first, total


class Corner(NamedTuple):
    """Where the legs of two cables lie across each other beyond the edge of a robot between them.

    On ``pieces`` they may touch: the ``first`` ones, from where the robot has joined until one of
    them has rolled away, or the last ones, before it leaves. ``clasps`` are those of the robot with
    the cables ``behind`` and ``ahead``.
    """

    pieces: slice
    first: bool
    clasps: tuple[int, int]
    behind: int
    ahead: int


def cut_corners(motion: Motion) -> tuple[Corner, ...]:
    """Return the corners that are cut off where a ring begins or ends by passing weight."""
    lying, rolling = motion.in_states(LYING), motion.in_states(OPEN_STATES - LYING)
    if not np.any(lying):
        return ()
    return cached_value(motion, _corners_cut, tuple(lying.tolist()), tuple(rolling.tolist()))


def _corners_cut(
    motion: Motion, lying: Sequence[bool], rolling: Sequence[bool]
) -> tuple[Corner, ...]:
    corners, count, layout = list[Corner](), len(lying), motion.team.layout
    for first in (True, False):
        order = slice(None, None, 1 if first else -1)
        passing, index = np.logical_and.accumulate(lying[order]), motion.phase_of_piece[order]
        if not (number := int(np.sum(passing))):
            continue
        after = np.isin(index, index[number : number + 1]) & np.array(rolling[order])
        touching = int(np.sum(np.logical_and.accumulate(passing | after)))
        span, pieces = (
            slice(0, size) if first else slice(count - size, count) for size in (number, touching)
        )
        rolls = turns(motion.slice_pieces(span, motion.phases))[0]
        open_ = np.flatnonzero(np.abs(rolls) >= ROLLED).tolist()
        pairs = [(j, k) for j, k in permutations(open_, 2) if layout.ahead[j] == layout.behind[k]]
        if len(open_) == 2 and len(pairs) == 1:
            ((j, k),) = pairs
            corners.append(
                Corner(pieces, first, (j, k), int(layout.behind[j]), int(layout.ahead[k]))
            )
    return tuple(corners)


def _find(motion: Motion, limit: float) -> WorstCase:
    """Return the largest force residual at a clasp over the smaller of its cables' tensions.

    Pulls beyond friction count as unbalanced, and so do forces that an object lacks. Cables must
    also press on each other at all times, for any weight: otherwise either may have passed through
    the other, and the residual is infinite.
    """
    names = Clasps.names(motion)
    largest = worst(Clasps.of(motion), _balance, "max", target=within(limit, "max"))
    words = _opened(motion, largest) if math.isinf(largest.value) else ()
    where = (names[largest.item], *words)
    each = [WorstCase(largest.worst, largest.time, where), unbalanced(motion)]
    if motion.leg_tensions is not None:
        each.append(beyond_friction(motion))
    return max(each, key=lambda case: case.worst)


def _opened(motion: Motion, at: Extremum) -> tuple[str, ...]:
    """Return that a clasp is open, with the roll of its pair, if its forces balance otherwise."""
    breaks = motion.drones.breaks
    piece = max(0, int(np.searchsorted(breaks, at.time)) - 1)
    share = (at.time - breaks[piece]) / motion.drones.durations[piece]
    point = Clasps(motion, breaks, np.array([piece]), np.array([at.item])).at(np.array([share]))
    with np.errstate(all="ignore"):
        open_ = math.isfinite(_over(point.residual, point).value[0])
        return (f"open at a roll of {point.rolls()[0]:.0f}°",) if open_ else ()


def spare_forces(motion: Motion) -> Array:
    """Return the loads that may be added at clasps (pieces, clasps) [N] with all forces balanced.

    Half of a load added to a clasp enters the products of ``contact``.
    """
    spare = BALANCE_LIMIT - _find(motion, BALANCE_LIMIT).worst
    spare = min(spare, -2.0 * worst(Clasps.of(motion), _lifted, "max").worst)
    weakest: Array = np.min(edge_tensions(motion)[:, both_cables(motion)], axis=(2, 3))
    return spare * weakest


FORMULAS = (_balance, Clasps.residual, _lifted, _rolled, Clasps.contact, slips, lacking)

EQUILIBRIUM = CheckRule(
    "equilibrium", "1", "max", BALANCE_LIMIT, (Evaluator(_find, HITCHED_STATE, shown=FORMULAS),)
)


@cached
def _corners(motion: Motion) -> Array:
    """Return the edges behind and ahead of corners, seen from above (pieces, corners, 2, 2, …).

    In addition to its clasps a chain has a corner from its last edge to its first one reversed.
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
        return [*clasp_names(motion), *(() if motion.team.layout.closed else ("ends",))]


def _exterior(spans: Corners) -> Bound:
    """Return the angles [deg] by which the outline turns right.

    For a chain's ends it is the rest of a full turn. Relative to the angle at mid span the others
    are small; beyond 180° angles start again at -180°.
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


def _turns(motion: Motion, _: float) -> WorstCase:
    """Return the smallest exterior angle in degrees, seen from above; ``where`` names the vertex.

    If negative, it is 360° less all turning at the start: of a polygon that winds around its inside
    more than once, or of a chain, whose ends ``where`` names.
    """
    smallest, start = worst(Corners.of(motion), _exterior, "min"), motion.vertices.breaks[0]
    layout, points = motion.team.layout, motion.team.point_names
    clasps, ends = np.arange(len(layout.clasps)), () if layout.closed else (points[0], points[-1])
    where = (points[layout.clasps[smallest.item]],) if smallest.item < len(clasps) else ends
    behind, ahead = np.moveaxis(_corners(motion)[0, clasps, :, :, 0], 1, 0)
    right = behind[:, 1] * ahead[:, 0] - behind[:, 0] * ahead[:, 1]
    room = 360.0 - float(np.sum(np.degrees(np.arctan2(right, np.sum(behind * ahead, axis=-1)))))
    lowest = max(smallest.worst, BACKWARD)
    if lowest > BACKWARD and room < min(lowest, -TURN):
        return WorstCase(room, float(start), ends)
    return WorstCase(lowest, smallest.time, where)


CONVEXITY = CheckRule(
    "convexity",
    "deg",
    "min",
    0.0,
    (Evaluator(_turns, HITCHED_STATE, shown=(_exterior,)),),
    "go by a polygon in between, in two morphs",
)
