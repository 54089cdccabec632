"""Checks ``loss_displacement`` and ``survivable``: the loss of a robot in flight, for all t.

While a hitch is taut, each of its robots may be lost with its cable (``hitchopt.hitch.losses``).
Then its drones drop their ends of the cable and rise, and the two neighbouring drones at its clasps
move to where the remaining cables are an open chain in balance. Until then these two cables hang
between their drones and their other clasps. For every instant, as if the plan had stopped there:

- every drone may be off its plan by ``loss_displacement``, for which the tracking error allows;
- places after the loss are polynomials of t, which the chain's balance and cable lengths bound;
- a way is the segment from the drone's place to that after the loss. It keeps ``separation`` and
  ``cable_clearance``, with the tracking error, whatever happens when on all ways;
- a loose cable is in the prism below the triangle of way and far clasp, as deep as a cable that
  leads straight down and up again; as while cables are tightened, its own drones may be closer;
- the lost robot's drones rise straight up, above all others.

Not covered: cables that swing sideways, friction, which may keep vertices off their places, and
what falls. While cables of a hitch roll, or its tension rises or falls, drones let go and land.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchopt.checks.bodies import Bodies, drones_of, taut_cables
from hitchopt.checks.cables import LENGTH_LIMIT
from hitchopt.checks.certificate import TOLERANCE
from hitchopt.checks.clasps import BALANCE_LIMIT
from hitchopt.checks.distances import Flags, Moving, smallest
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import ROUNDING, cached, joined_arrays, magnitude
from hitchopt.geometry.vectors import shortest_offset, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.losses import Losses, displacements, places_after_loss
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.retiming import on_breaks_of
from hitchopt.motion.states import TAUT_RATIO
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.search import TimeSpans, rough_bounds, worst
from hitchopt.values import Array, Indices, lazy, true_runs

MAX_PIECE = 0.25
"""[s] Longest piece on which places after a loss are interpolated while the hitch moves."""

ORDER = 7
"""Degree of these polynomials."""

RISE = 2.1
"""Height between a lost robot's drones and all others, over the semi-axis of ellipsoids."""

REST = 1e-9
"""[m] Largest motion at rest."""


class Case(NamedTuple):
    """Bodies that keep a distance after a loss."""

    check: str
    """Name of the check of such distances."""

    limit: float
    """The distance [m], or ratio, which includes the tracking error."""

    moving: Moving
    """The pairs."""


@dataclass(frozen=True, eq=False)
class AfterLoss:
    """What happens after the loss of any robot at every time of a taut hitch.

    Rows are those of ``Losses``; polynomials are (pieces, m, 3, degree + 1) [m], in one degree.
    """

    motion: Motion
    """The hitch."""

    robots: Indices
    """The cables that may be lost."""

    drone: Indices
    """(m,), the drones that move."""

    lost: Indices
    """(m,), the cables that are lost then."""

    start: Array
    """Places of the drones that move."""

    clasp: Array
    """Clasps that vanish."""

    far: Array
    """Other vertices of the cables of these drones."""

    place: Array
    """Places of these drones after the loss."""

    shared: Indices
    """(m,), the far vertices."""

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
    def lengths(self) -> Array:
        """Largest lengths (pieces, m) [m] of the loose parts of cables."""
        chords = [self.clasp - self.far, self.start - self.clasp]
        sizes = [np.asarray(Enclosed(chord).norm_upper.value) for chord in chords]
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = (2.0 * self.half_density / np.min(self.tensions, axis=-1)) ** 2 / 24.0
        edge, leg = (size * (1.0 + factors * size**2) for size in sizes)
        return np.asarray(edge + leg)

    @lazy
    def depths(self) -> Array:
        """How far loose cables hang at most below their ends (pieces, m) [m]."""
        ends = np.stack([self.start, self.place], axis=2) - self.far[:, :, None]
        middle = ends @ bernstein.at_nodes(0, bernstein.degree(ends))[0]
        nearest = unit(shortest_offset(middle))
        along = np.min(np.einsum("pmc,pmkcd->pmkd", nearest, ends), axis=(2, 3))
        squares = self.lengths**2 - np.maximum(along, 0.0) ** 2
        return np.asarray(0.5 * np.sqrt(np.maximum(squares, 0.0)))

    def loose(self, *corners: Array) -> Bodies:
        """Return the prisms below some corners, in which the cables of the rows hang."""
        top = np.stack(corners, axis=2)
        bottom = top.copy()
        bottom[..., 2, :] -= self.depths[:, :, None, None]
        names = [self.motion.team.cable_names[cable] for cable in self.cable]
        return Bodies(np.concatenate([top, bottom], axis=2), names, outline=len(corners))

    def cases(self) -> Iterator[Case]:
        """Yield all distances that are kept."""
        motion = self.motion
        need = self.requirements
        limits = {name: rule.limit(need.separation) for name, rule in DISTANCES.items()}
        names = motion.team.drone_names
        drones = drones_of(motion)
        parts = taut_cables(motion)
        cable_of_part = parts.part // 3
        ways = Bodies(
            np.stack([self.start, self.place], axis=2), [names[drone] for drone in self.drone]
        )
        tops = drones.corners.copy()
        tops[..., 2, :] += self.rise
        rising = Bodies(np.concatenate([drones.corners, tops], axis=2), names)
        waiting = Bodies(tops, names)
        loose = self.loose(self.start, self.place, self.far)
        at_first = self.loose(self.start, self.clasp, self.far)
        taut = Bodies(np.stack([self.place, self.far], axis=2), loose.names)
        may_leave = np.isin(np.arange(len(names)) // 2, self.robots)

        def others(row: Indices, drone: Indices) -> Flags:
            return np.asarray((drone != self.drone[row]) & (drone // 2 != self.lost[row]))

        def of_others(row: Indices, drone: Indices) -> Flags:
            return np.asarray(others(row, drone) & (drone // 2 != self.cable[row]))

        def together(row: Indices, other: Indices) -> Flags:
            return np.asarray((self.lost[row] == self.lost[other]) & (row != other))

        def leaves(row: Indices, drone: Indices) -> Flags:
            return np.asarray(self.lost[row] == drone // 2)

        def foreign(row: Indices, part: Indices) -> Flags:
            cable = cable_of_part[part]
            return np.asarray((cable != self.cable[row]) & (cable != self.lost[row]))

        at_vertex = np.zeros((motion.team.robots, motion.team.layout.points), dtype=np.bool_)
        for ends in (motion.team.layout.starts, motion.team.layout.ends):
            at_vertex[np.arange(motion.team.robots), ends] = True

        def unclasped(row: Indices, part: Indices) -> Flags:
            is_clasped = at_vertex[cable_of_part[part], self.shared[row]]
            return np.asarray(foreign(row, part) & ~is_clasped)

        def apart(row: Indices, other: Indices) -> Flags:
            return np.asarray(together(row, other) & (self.shared[row] != self.shared[other]))

        def stay(drone: Indices, other: Indices) -> Flags:
            return np.asarray(may_leave[drone] & (drone // 2 != other // 2))

        def not_own(drone: Indices, part: Indices) -> Flags:
            return np.asarray(may_leave[drone] & (cable_of_part[part] != drone // 2))

        scale = need.separation.scale
        margin = ROUNDING * magnitude(motion) * float(np.max(scale))

        def ratio(first: Bodies, second: Bodies, allowed: object) -> Case:
            pair = first.scaled(scale), second.scaled(scale)
            return Case("separation", 1.0, between(*pair, allowed, margin=margin))

        def metres(check: str, first: Bodies, second: Bodies, allowed: object) -> Case:
            moving = between(first, second, allowed).flattened(need.height_ratio)
            return Case(check, limits[check], moving)

        def between(first: Bodies, second: Bodies, allowed: object, **options: float) -> Moving:
            return Moving.between(motion, first, second, allowed=allowed, **options)

        yield ratio(ways, drones, others)
        yield ratio(ways, ways, together)
        yield ratio(ways, waiting, leaves)
        yield ratio(rising, drones, stay)
        yield metres("cable_clearance", ways, parts, foreign)
        yield metres("cable_clearance", loose, ways, together)
        yield metres("cable_clearance", loose, drones, of_others)
        yield metres("cable_clearance", taut, drones, others)
        yield metres("cable_clearance", rising, parts, not_own)
        yield metres("cable_clearance", at_first, rising, leaves)
        yield metres("crossing", loose, parts, unclasped)
        yield metres("crossing", loose, loose, apart)

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
            pair = smallest(moving, target=limit)
            if pair.item >= 0 and pair.worst / limit < best.worst:
                where = moving.pair_names(pair.item)
                best = WorstCase(pair.worst / limit, pair.time, where, binding=check)
        return best


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
    steepness = tension.inverse * (2.0 * after.half_density)
    factor = steepness * steepness * (1.0 / 24.0)

    def cable(part: Enclosed) -> Enclosed:
        """Return the cable length of a part."""
        return part.norm + part.norm * part.xy.dot(part.xy) * factor

    leg_cable = cable(start - clasp)
    excess = cable(chord) - cable(edge) - leg_cable
    longest = after.motion.team.cable_length[after.cable[rows.item], None]
    length_error = (excess * (1.0 / (LENGTH_LIMIT * longest))).norm_upper
    level_weight = edge.xy * after.half_density
    pull = (tension * tension - level_weight.dot(level_weight)).root
    needed = edge.direction * pull + (leg_cable * after.half_density).along_z()
    residual = needed - chord.direction * needed.norm
    imbalance = (residual * tension.inverse * (1.0 / BALANCE_LIMIT)).norm_upper
    return largest_of([length_error, imbalance])


def _need(rows: Rows) -> Bound:
    """Return thrust and tilt at rest after the loss, over their limits."""
    after = rows.source
    team = after.motion.team
    drone = after.drone[rows.item]
    tension = np.max(rows.read(after.tensions), axis=-1)
    weight = 2.0 * after.half_density * after.lengths[rows.piece, rows.item]
    own = GRAVITY * team.mass[drone]
    thrust = np.hypot(own + weight, tension) / team.max_thrust[drone]
    tilt = np.arctan2(tension, own) / after.motion.requirements.limits.tilt
    return Bound(np.maximum(thrust, tilt), np.zeros(len(rows)))


def _room(rows: Rows) -> Bound:
    """Return 1 above the clearance that loose cables and drones lack to ground and walls [m]."""
    after = rows.source
    need = after.requirements
    place = rows.read(after.place)
    start = rows.read(after.start)
    far = rows.read(after.far)
    lowest = np.min([np.min(each[:, 2], axis=-1) for each in (place, start, far)], axis=0)
    depth = after.depths[rows.piece, rows.item]
    lacking = need.floor + need.ground_clearance - (lowest - depth)
    if need.arena is not None:
        lower, upper = need.arena.lower[:, None], need.arena.upper[:, None]
        outside = np.max(np.concatenate([lower - place, place - upper], axis=1), axis=(1, 2))
        highest = np.max(after.motion.drones.coefficients[rows.piece, :, 2], axis=(1, 2))
        lacking = np.max([lacking, outside, highest + after.rise - need.arena.upper[2]], axis=0)
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
    pieces = motion.in_states(frozenset({CableState.HITCHED})) & ~motion.holding
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
    taut = motion.in_states(frozenset({CableState.HITCHED}))[:, None]
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
    (Evaluator(_displacement, frozenset({CableState.HITCHED})),),
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
    (Evaluator(_survived, frozenset({CableState.HITCHED})),),
    "use shorter legs, a larger polygon or more altitude, or omit limits.survive",
    ease="length",
    group="timing",
    proves="with ``limits.survive``, the fraction of (robot, time) after whose loss the others "
    "remain in balance; otherwise that of (drone, time) whose loss has a certified reaction, only "
    "by `check --survivable`",
    unproven="what falls; loose cables that swing sideways; phases without a taut hitch",
)
"""The remaining cables are an open chain in balance, which its drones reach clear of all others."""
