"""Checks ``loss_displacement`` and ``survivable``: the loss of a robot in flight, for all t.

While a hitch is taut, each of its robots may be lost with its cable (``hitchopt.hitch.losses``).
Then its drones drop their ends of the cable and rise, and the two neighbouring drones at its clasps
move to where the remaining cables are an open chain in balance. Without these clasps no cable is
held: until then all are loose (``CableState.loose``), as in the plan of the reaction. For every
instant, as if the plan had stopped there:

- every drone may be off its plan by ``loss_displacement``, for which the tracking error allows;
- places after the loss are polynomials of t, which the chain's balance and cable lengths bound;
- a way is the segment from the drone's place to that after the loss. It keeps ``separation`` and
  ``cable_clearance``, with the tracking error, whatever happens when on all ways;
- a loose cable is in the prism below its drones, the way of one if it moves, and its clasps, as
  deep as its length allows; its own drones may be closer;
- chords of cables that hold each other do not pass through each other;
- the lost robot's drones rise straight up, above all others.

Not covered: cables that swing sideways, friction, which may keep vertices off their places, and
what falls. While cables of a hitch roll, or its tension rises or falls, drones let go and land.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hitchopt.checks.bodies import PLAN_AXES, Bodies, cable_ends, drones_of, hanging_depth
from hitchopt.checks.cables import LENGTH_LIMIT
from hitchopt.checks.certificate import TOLERANCE
from hitchopt.checks.chords import MIN_DISTANCE
from hitchopt.checks.clasps import BALANCE_LIMIT
from hitchopt.checks.distances import GROUND, Flags, Ground, Hulls, Moving, PairSpans, smallest
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.sagging import sagging_part
from hitchopt.checks.solids import pairs_with_shape
from hitchopt.checks.spans import ROUNDING, cached, joined_arrays, magnitude
from hitchopt.geometry.vectors import differences, shortest_offset, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.losses import Losses, displacements, places_after_loss
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import on_breaks_of
from hitchopt.motion.states import TAUT_RATIO
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import TimeSpans, rough_bounds, worst
from hitchopt.values import Array, Indices, lazy, true_runs

MAX_PIECE = 0.25
"""[s] Longest piece on which places after a loss are interpolated while the hitch moves."""

ORDER = 7  # Degree of these polynomials
RISE = 2.1  # Height between a lost robot's drones and all others, over the semi-axis of ellipsoids
SWEEPS = 4  # Number of triangles that a chord sweeps on the way of its end

MARGIN = 3e-4
"""Relative margin of distances: bounds of those in the plan that follows may be less tight."""

REST = 1e-9  # [m] Largest motion at rest


class Case(NamedTuple):
    """Bodies that keep a distance after a loss."""

    check: str  # Name of the check of such distances
    limit: float  # The distance [m], or ratio, which includes the tracking error
    moving: Moving  # The pairs


@dataclass(frozen=True, eq=False)
class AfterLoss:
    """What happens after the loss of any robot at every time of a taut hitch.

    Rows are those of ``Losses``; polynomials are (pieces, m, 3, degree + 1) [m], in one degree.
    """

    motion: Motion  # The hitch
    robots: Indices  # The cables that may be lost
    drone: Indices  # (m,), the drones that move
    lost: Indices  # (m,), the cables that are lost then
    start: Array  # Places of the drones that move
    clasp: Array  # Clasps that vanish
    far: Array  # Other vertices of the cables of these drones
    place: Array  # Places of these drones after the loss
    shared: Indices  # (m,), the far vertices

    @classmethod
    def of(cls, motion: Motion) -> AfterLoss:
        """Return the places after losses of a hitch at each time of its motion."""
        motion = on_short_pieces(motion)
        losses = Losses.of(motion.team.layout)
        nodes = bernstein.nodes(ORDER)

        def at_nodes(curve: Array) -> Array:
            """Return values (pieces, nodes, …) of polynomials (pieces, …, degree + 1)."""
            degree = bernstein.degree(curve)
            return np.moveaxis(curve @ bernstein.basis(nodes, degree).T, -1, 1)

        drones = motion.drones.coefficients
        vertices = motion.vertices.coefficients
        tensions = motion.tensions.coefficients
        places, _ = places_after_loss(motion.team, *map(at_nodes, (drones, vertices, tensions)))
        place = bernstein.interpolate(np.moveaxis(places, 1, -1))
        rows = (drones[:, losses.drone], vertices[:, losses.clasp], vertices[:, losses.far], place)
        start, clasp, far, place = same_degree(*rows)
        of_rows = losses.robots, losses.drone, losses.lost
        return cls(motion, *of_rows, start, clasp, far, place, losses.far)

    def only(self, robot: int) -> AfterLoss:
        """Return what happens after the loss of one cable."""
        rows = self.lost == robot
        curves = {name: getattr(self, name)[:, rows] for name in ("start", "clasp", "far", "place")}
        items = {name: getattr(self, name)[rows] for name in ("drone", "lost", "shared")}
        return replace(self, robots=np.array([robot]), **items, **curves)

    @property
    def cable(self) -> Indices:
        """(m,), the cables of the drones that move."""
        return self.drone // 2

    @lazy
    def tensions(self) -> Array:
        """Tensions of these cables (pieces, m, degree + 1) [N]."""
        return self.motion.tensions.coefficients[:, self.cable]

    @property
    def half_density(self) -> float:
        """[N/m] Half of the weight per length of cables."""
        return 0.5 * GRAVITY * self.motion.team.cable_density

    @property
    def ways(self) -> Array:
        """Lengths (pieces, m) [m] that the longest way of each piece has at most."""
        return np.asarray(Enclosed(self.place - self.start).norm_upper.value)

    @lazy
    def rise(self) -> float:
        """[m] Height by which the drones of a lost robot rise above all others."""
        heights = joined_arrays([self.motion.drones.coefficients, self.place], axis=1)[:, :, 2]
        differences = np.max(heights, axis=(1, 2)) - np.min(heights, axis=(1, 2))
        height = RISE * self.requirements.separation.height
        return height + float(np.max(differences))

    @lazy
    def requirements(self) -> Requirements:
        """Requirements that include the tracking error."""
        return self.motion.requirements.with_reserve

    @lazy
    def other(self) -> Array:
        """Places of the other drones of these cables, which stay."""
        drones = self.motion.drones.coefficients[:, self.drone ^ 1]
        return bernstein.elevate(drones, bernstein.degree(self.start))

    @lazy
    def depths(self) -> Array:
        """How far loose cables hang at most below their ends (pieces, m) [m]."""
        ends = np.stack([self.start, self.place], axis=2) - self.other[:, :, None]
        ends = ends * PLAN_AXES
        middle = ends @ bernstein.at_nodes(0, bernstein.degree(ends))[0]
        nearest = unit(shortest_offset(middle))
        along = np.min(np.einsum("pmc,pmkcd->pmkd", nearest, ends), axis=(2, 3))
        length = self.motion.team.cable_length[self.cable]
        return hanging_depth(length, np.maximum(along, 0.0))

    def end_regions(self, *corners: Array) -> Bodies:
        """Return the vertical regions below some corners and the other drones of the rows' cables.

        These cables are in there.
        """
        outline = np.stack([*corners, self.other], axis=2)
        names = [self.motion.team.cable_names[cable] for cable in self.cable]
        return _hanging_below(outline, self.depths, names)

    @lazy
    def inner_regions(self) -> Bodies:
        """The vertical regions (n,) of cables between their drones and over their clasps."""
        motion = self.motion
        layout = motion.team.layout
        drones, vertices = same_degree(motion.drones.coefficients, motion.vertices.coefficients)
        q = drones[:, 0::2]
        r = drones[:, 1::2]
        outline = [q, vertices[:, layout.starts], vertices[:, layout.ends], r]
        level = Enclosed(r - q).xy.norm_lower.value
        depths = hanging_depth(motion.team.cable_length, level)
        return _hanging_below(np.stack(outline, axis=2), depths, motion.team.cable_names)

    def chords(self) -> Bodies:
        """Return triangles that the chords of the rows' cables sweep in turn, SWEEPS per row."""
        shares = np.linspace(0.0, 1.0, SWEEPS + 1)
        steps = [self.start + share * (self.place - self.start) for share in shares]
        parts = [np.stack([*each, self.other], axis=2) for each in pairwise(steps)]
        names = [self.motion.team.cable_names[cable] for cable in self.cable]
        return Bodies(np.concatenate(parts, axis=1), names * SWEEPS)

    @lazy
    def swept_ways(self) -> Bodies:
        """The ways (m,) of the drones that move."""
        names = [self.motion.team.drone_names[drone] for drone in self.drone]
        return Bodies(np.stack([self.start, self.place], axis=2), names)

    @lazy
    def rising(self) -> Bodies:
        """The ways of all drones up, as after the loss of their robots."""
        drones = drones_of(self.motion)
        corners = np.concatenate([drones.corners, self.waiting.corners], axis=2)
        return replace(drones, corners=corners)

    @lazy
    def waiting(self) -> Bodies:
        """All drones after they have risen."""
        drones = drones_of(self.motion)
        corners = drones.corners.copy()
        corners[..., 2, :] += self.rise
        return replace(drones, corners=corners)

    @lazy
    def loose(self) -> Bodies:
        """The regions (m,) of cables whose ends move, at any place on their ways."""
        return self.end_regions(self.start, self.place, self.far)

    @lazy
    def compared(self) -> Compared:
        """The pairs of bodies that are compared."""
        return Compared.of(self)

    def cases(self) -> Iterator[Case]:
        """Yield all distances that are kept.

        Where whole cables are compared, they are those that lose no clasp.
        """
        yield from self._separations()
        yield from self._clearances()
        yield from self._crossings()

    def _between(self, first: Bodies, second: Bodies, pairs: Flags, **options: Any) -> Moving:
        """Return pairs of bodies of two kinds, by a table."""
        allowed = {"allowed": lambda i, j: pairs[i, j]}
        return Moving.between(self.motion, first, second, **(allowed | options))

    def _separations(self) -> Iterator[Case]:
        """Yield the distances of drones."""
        pairs = self.compared
        scale = self.requirements.separation.scale
        margin = ROUNDING * magnitude(self.motion) * float(np.max(scale))
        ways, rising, waiting, drones = (
            bodies.scaled(scale)
            for bodies in (self.swept_ways, self.rising, self.waiting, drones_of(self.motion))
        )
        for first, second, table in (
            (ways, drones, pairs.others),
            (ways, ways, pairs.together),
            (ways, waiting, pairs.leaves),
            (rising, drones, pairs.stay),
        ):
            moving = self._between(first, second, table, margin=margin)
            yield Case("separation", 1.0, moving)

    def _clearances(self) -> Iterator[Case]:
        """Yield the distances of cables to drones and the ground."""
        need = self.requirements
        check = "cable_clearance"
        limit = DISTANCES[check].limit(need.separation)
        pairs = self.compared
        drones = drones_of(self.motion)
        whole = self.inner_regions
        at_first = self.end_regions(self.start, self.clasp, self.far)
        taut = Bodies(np.stack([self.place, self.far], axis=2), self.loose.names)
        for first, second, table in (
            (self.swept_ways, whole, pairs.beside),
            (self.loose, self.swept_ways, pairs.together),
            (self.loose, drones, pairs.of_others),
            (taut, drones, pairs.others),
            (drones, whole, pairs.stay_beside),
            (self.rising, whole, pairs.leave_beside),
            (at_first, self.rising, pairs.leaves),
        ):
            moving = self._between(first, second, table).flattened(need.height_ratio)
            yield Case(check, limit, moving)
        every = np.ones(len(self.drone), dtype=np.bool_)
        if need.floor is None:
            return
        for regions, on in ((self.loose, every), (whole, np.any(self.is_whole, axis=0))):
            bottom = Enclosed(regions.corners[:, :, regions.outline :])
            moving = pairs_with_shape(
                *(self.motion, bottom, regions.names, GROUND, Ground(need.floor)),
                allowed=lambda body, _, on=on: on[body],
            )
            yield Case(check, need.ground_clearance, moving)

    def _crossings(self) -> Iterator[Case]:
        """Yield the distances of cables that share no clasp, and of chords of those that do."""
        pairs = self.compared
        limit = DISTANCES["crossing"].limit(self.requirements.separation)
        loose, whole = (_seen_from_above(each) for each in (self.loose, self.inner_regions))
        for first, second, table in (
            (loose, whole, pairs.beside & ~pairs.linked_beside),
            (loose, loose, pairs.together & ~pairs.linked_ends),
            (whole, whole, pairs.both_whole & ~self.linked),
        ):
            shape = Hulls((first.outline, second.outline))
            yield Case("crossing", limit, self._between(first, second, table, shape=shape))
        swept = self.chords()
        chords = Bodies(cable_ends(self.motion.drones.coefficients), whole.names)
        for first, second, table in (
            (swept, chords, np.tile(pairs.beside & pairs.linked_beside, (SWEEPS, 1))),
            (swept, swept, np.tile(pairs.together & pairs.linked_ends, (SWEEPS, SWEEPS))),
            (chords, chords, pairs.both_whole & self.linked),
        ):
            moving = self._between(first, second, table, formula=_swept_gap)
            yield Case("interlacing", 2.0 * MIN_DISTANCE, moving)

    @lazy
    def is_whole(self) -> Flags:
        """(n, n), whether a cable keeps its clasps after the loss of one that may be lost."""
        count = self.motion.team.robots
        whole = ~np.eye(count, dtype=np.bool_)
        whole[self.lost, self.cable] = False
        whole[~np.isin(np.arange(count), self.robots)] = False
        return whole

    @lazy
    def linked(self) -> Flags:
        """(n, n), whether two cables share a clasp."""
        layout = self.motion.team.layout
        pairs = np.zeros((layout.robots, layout.robots), dtype=np.bool_)
        pairs[layout.ahead, layout.behind] = True
        return pairs | pairs.T

    def spans(self) -> Iterator[Rows]:
        """Yield all rows on all pieces."""
        yield from Rows.all_of(self, self.motion.drones.breaks, len(self.drone))

    def worst(self) -> WorstCase:
        """Return the smallest distance, or the like, over its limit; a bound if it is kept."""
        with rough_bounds():
            return self._worst()

    def _worst(self) -> WorstCase:
        """Return the smallest distance, or the like, over its limit."""
        best = WorstCase(math.inf, 0.0)
        for formula, name in ((_chain_error, "equilibrium"), (_need, "thrust"), (_room, "arena")):
            extremum = worst(self.spans(), formula, "max", target=1.0)
            if extremum.item >= 0:
                drone = self.motion.team.drone_names[self.drone[extremum.item]]
                share = 1.0 / max(extremum.worst, TOLERANCE)
                case = WorstCase(share, extremum.time, (drone,), binding=name)
                best = min(best, case, key=lambda each: each.worst)
        for check, limit, moving in self.cases():
            kept = (1.0 + MARGIN) * limit
            pair = smallest(moving, target=kept)
            if pair.item >= 0 and pair.worst / kept < best.worst:
                where = moving.pair_names(pair.item)
                best = WorstCase(pair.worst / kept, pair.time, where, binding=check)
        return best


@dataclass(frozen=True, eq=False)
class Compared:
    """Pairs of bodies that may meet after the same loss: tables of rows, drones and cables.

    Rows are those of ``AfterLoss``: drones that move, or their cables. Whole cables keep their
    clasps.
    """

    others: Flags  # (m, 2n), rows and drones that remain
    of_others: Flags  # (m, 2n), rows and drones of other cables that remain
    together: Flags  # (m, m), both rows of one loss
    leaves: Flags  # (m, 2n), rows and the drones of the lost robot
    stay: Flags  # (2n, 2n), drones that may leave, and all others
    beside: Flags  # (m, n), rows and whole cables
    stay_beside: Flags  # (2n, n), drones that remain, and whole cables other than theirs
    leave_beside: Flags  # (2n, n), drones of a lost robot, and whole cables
    both_whole: Flags  # (n, n), pairs of whole cables
    linked_beside: Flags  # (m, n), whether a row's cable and another one share a clasp
    linked_ends: Flags  # (m, m), whether cables of rows share a clasp

    @classmethod
    def of(cls, after: AfterLoss) -> Compared:
        """Return the pairs of what remains after losses."""
        own = after.drone[:, None]
        lost = after.lost[:, None]
        drones = np.arange(after.motion.team.drones)
        robot = drones // 2
        whole = after.is_whole
        others = (drones != own) & (robot != lost)
        is_other = robot[:, None] != np.arange(len(whole))
        remain = np.any(is_other.T[:, :, None] & whole[:, None], axis=0)
        return cls(
            others=others,
            of_others=others & (robot != after.cable[:, None]),
            together=(after.lost == lost) & (after.drone != own),
            leaves=robot == lost,
            stay=np.isin(robot, after.robots)[:, None] & (robot[:, None] != robot),
            beside=whole[after.lost],
            stay_beside=remain & is_other,
            leave_beside=whole[robot],
            both_whole=np.triu(np.any(whole[:, :, None] & whole[:, None], axis=0), 1),
            linked_beside=after.linked[after.cable],
            linked_ends=after.linked[np.ix_(after.cable, after.cable)],
        )


def _hanging_below(outline: Array, depths: Array, names: Sequence[str]) -> Bodies:
    """Return the vertical regions from some corners (pieces, bodies, k, 3, degree + 1) [m] down.

    They are ``depths`` (pieces, bodies) [m] deep below the lowest corner.
    """
    bottom = outline.copy()
    bottom[..., 2, :] -= depths[:, :, None, None]
    return Bodies(np.concatenate([outline, bottom], axis=2), names, outline=outline.shape[2])


def _seen_from_above(regions: Bodies) -> Bodies:
    """Return the outlines of vertical regions, at height 0."""
    return replace(regions, corners=regions.corners[:, :, : regions.outline] * PLAN_AXES)


def _swept_gap(spans: PairSpans) -> Bound:
    """Return the distances [m] of triangles that chords sweep, or of chords, at least 0.

    All but the last corner of a triangle are ends of the chord at the start and at the end.
    """
    chords, others = ((ends[:, :-1], ends[:, -1:]) for ends in spans.ends)
    middles = [
        np.concatenate(
            [Enclosed(moving).middle.mean(axis=1, keepdims=True), Enclosed(still).middle], 1
        )
        for moving, still in (chords, others)
    ]
    along = unit(shortest_offset(differences(*middles)))
    first, second = spans.ends
    offsets = Enclosed(
        (first[:, :, None] - second[:, None]).reshape(len(first), -1, *first.shape[2:])
    )
    distances = offsets.dot(along[:, None]).lower
    return Bound(np.maximum(np.min(distances.value, axis=1), 0.0), np.zeros(len(first)))


class Rows(TimeSpans):
    """Spans of rows of ``AfterLoss``."""

    source: AfterLoss


def _chain_error(rows: Rows) -> Bound:
    """Return the error of the remaining chain: in balance and cable length, over their limits."""
    after = rows.source
    start, clasp, far, place = (
        Enclosed(rows.read(curve)) for curve in (after.start, after.clasp, after.far, after.place)
    )
    tension = Enclosed(rows.read(after.tensions)[:, None])
    edge = clasp - far
    chord = place - far
    ratio = tension.inverse * after.half_density
    before = sagging_part(edge, ratio)
    leg = sagging_part(start - clasp, ratio)
    straight = sagging_part(chord, ratio)
    excess = straight.length - before.length - leg.length
    longest = after.motion.team.cable_length[after.cable[rows.item], None]
    length_error = (excess * (1.0 / (LENGTH_LIMIT * longest))).norm_upper
    residual = straight.force() - before.force()  # at the far vertex, over the tension
    imbalance = (residual * (1.0 / BALANCE_LIMIT)).norm_upper
    return largest_of([length_error, imbalance])


def _need(rows: Rows) -> Bound:
    """Return thrust and tilt at rest after the loss, over their limits."""
    after = rows.source
    team = after.motion.team
    drone = after.drone[rows.item]
    tension = np.max(rows.read(after.tensions), axis=-1)
    weight = 2.0 * after.half_density * team.cable_length[drone // 2]
    own = GRAVITY * team.mass[drone]
    thrust = np.hypot(own + weight, tension) / team.max_thrust[drone]
    tilt = np.arctan2(tension, own) / after.motion.requirements.limits.tilt
    return Bound(np.maximum(thrust, tilt), np.zeros(len(rows)))


def _room(rows: Rows) -> Bound:
    """Return 1 above the clearance that drones lack to walls and the ceiling [m]."""
    after = rows.source
    arena = after.requirements.arena
    if arena is None:
        return Bound(np.zeros(len(rows)), np.zeros(len(rows)))
    place = rows.read(after.place)
    lower, upper = arena.lower[:, None], arena.upper[:, None]
    outside = np.max(np.concatenate([lower - place, place - upper], axis=1), axis=(1, 2))
    highest = np.max(after.motion.drones.coefficients[rows.piece, :, 2], axis=(1, 2))
    lacking = np.maximum(outside, highest + after.rise - arena.upper[2])
    return Bound(1.0 + lacking, np.zeros(len(rows)))


def on_short_pieces(motion: Motion) -> Motion:
    """Return a motion on pieces of at most MAX_PIECE [s] where it moves."""
    breaks = [motion.drones.breaks[:1]]
    curves = motion.drones.coefficients, motion.vertices.coefficients, motion.tensions.coefficients
    moves = np.max([np.max(np.ptp(c, -1).reshape(len(c), -1), axis=1) for c in curves], axis=0)
    for (start, end), change in zip(pairwise(motion.drones.breaks.tolist()), moves, strict=True):
        count = max(1, math.ceil((end - start) / MAX_PIECE)) if change > REST else 1
        breaks.append(np.linspace(start, end, count + 1)[1:])
    return on_breaks_of(motion, np.concatenate(breaks))


def taut_runs(motion: Motion) -> list[Motion]:
    """Return the parts of a motion in which a hitch is tied and taut, and holds no object."""
    pieces = motion.formed & ~motion.holding
    tensions = np.min(motion.tensions.coefficients, axis=-1)
    pieces &= np.all(tensions >= TAUT_RATIO * motion.team.tension, axis=1)
    return [motion.on_pieces(*run) for run in true_runs(pieces)]


@cached
def after_losses(motion: Motion) -> tuple[AfterLoss, ...]:
    """Return what happens after losses in each part of a motion in which a hitch is taut."""
    return tuple(map(AfterLoss.of, taut_runs(motion)))


def _survived(motion: Motion, _: float) -> WorstCase:
    """Return the fraction of losses (robot, time) that the plan survives."""
    if not Losses.of(motion.team.layout).robots.size:
        return WorstCase(math.inf, 0.0)
    survived, total = 0.0, 0.0
    worst_case: WorstCase | None = None
    for after in after_losses(motion):
        seconds = float(np.ptp(after.motion.drones.breaks))
        total += seconds * len(after.robots)
        if after.worst().worst >= 1.0 - TOLERANCE:
            survived += seconds * len(after.robots)
            continue
        for robot in after.robots.tolist():
            case = after.only(robot).worst()
            if case.worst >= 1.0 - TOLERANCE:
                survived += seconds
            elif worst_case is None or case.worst < worst_case.worst:
                lost = motion.team.cable_names[robot]
                worst_case = replace(case, where=(lost, *case.where))
    if not total:
        return WorstCase(math.inf, 0.0)
    if worst_case is None:
        return WorstCase(1.0, 0.0)
    return replace(worst_case, worst=survived / total)


def _displacement(motion: Motion, _: float) -> WorstCase:
    """Return the largest deviation of a drone after a loss [m]."""
    tensions = np.max(motion.tensions.coefficients, axis=-1)
    taut = motion.formed[:, None]
    ratios = np.where(taut, tensions / motion.team.tension, 0.0)
    jumps = np.repeat(ratios, 2, axis=1) * displacements(motion.team)
    piece, drone = np.unravel_index(int(np.argmax(jumps)), jumps.shape)
    where = (motion.team.drone_names[drone],)
    return WorstCase(float(jumps[piece, drone]), float(motion.drones.breaks[piece]), where)


def _if_survived(limit: Callable[[Motion], float]) -> Callable[[Motion], float | None]:
    """Return a limit that applies where losses are to be survived."""
    return lambda motion: None if motion.requirements.limits.survive is None else limit(motion)


LOSS_DISPLACEMENT = CheckRule(
    "loss_displacement",
    "m",
    "max",
    _if_survived(lambda motion: motion.requirements.with_reserve.position_error),
    (Evaluator(_displacement, lambda state: state.hitched),),
    "lower team.tension, choose stiffer gains, or raise limits.tracking",
    ease="tension",
    group="distances",
    proves="with ``limits.survive``, the largest deviation [m] of a drone after the loss of a "
    "cable, if no other cable pulls with more than twice its tension, along the planned direction",
    unproven="snaps that pull more, or sideways",
)
"""How far drones jump after a loss: not beyond the tracking error that all distances include."""

SURVIVABLE = CheckRule(
    "survivable",
    "1",
    "min",
    _if_survived(lambda _: 1.0),
    (Evaluator(_survived, lambda state: state.hitched),),
    "use shorter legs, a larger polygon or more altitude, or omit limits.survive",
    ease="length",
    group="timing",
    proves="with ``limits.survive``, the fraction of (robot, time) after whose loss the others "
    "remain in balance",
    unproven="what falls; loose cables that swing sideways; phases without a taut hitch, and times "
    "at which a plan does not stop before one: `react` refuses these",
)
"""The remaining cables are an open chain in balance, which its drones reach clear of all others."""

RULES = (LOSS_DISPLACEMENT, SURVIVABLE)  # Rules of the loss of a robot
