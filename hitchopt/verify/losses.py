"""Losses of a robot with its cable: what remains is a chain in balance, reached clear of all.

Without cable k, its neighbours lead from their other clasps f to their drones, with the tension of
their edge at f, which pulls there as before. Ways to their ends there are segments, loose cables
are in prisms below way and f, and drones of the lost robot rise above all others.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from hashlib import sha256
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .arithmetic import (
    DEGREES,
    POS_TOL,
    UP,
    Array,
    G,
    Index,
    Items,
    Line,
    Mask,
    angle,
    concatenate,
    minimum,
    norm,
    normalize,
)
from .parts import chord_of, taut_length, taut_part
from .plan import HITCHED, Plan
from .shapes import closest, distance, hull_distance, prism_gap
from .spans import Fault, Row, Spans, fault_row, nothing_row, prove, worst_row

TAUT_SHARE = 0.9  # least tension of a taut hitch, over the team's
RISE = 2.1  # height of the rise of a lost robot's drones, over the semi-axis of ellipsoids
SWEEPS = 4  # number of triangles that a chord sweeps on the way of its end
STATED_TOL = 2e-3  # [m] by how much stated paths may be longer than bounds
REST_RATE = 1e-6  # [m/s], [m/s²] largest rate at rest
REACTION = 0.1  # [s] from a loss until the others react
TIGHTENING = 1.0, 3.0  # shortest rise of tensions: [s], and in periods of cables as strings
DAMPING_RATIO = 5.0 / 6.0  # of loops of which only the stiffness is stated
STOCK = {  # gains kp, kd of controllers, horizontal and vertical, and whether they are per mass
    "mellinger": ((0.40, 1.25), (0.2, 0.4), False),
    "lee": ((7.0, 7.0), (4.0, 4.0), True),
    "px4": ((1.71, 4.0), (1.8, 4.0), True),
}

Region = Callable[[Spans, Index], list[Line]]  # corners of bodies, for items of spans
Chords = Callable[[Spans, Index], list[list[Line]]]  # ends of what chords of cables sweep


class Moves(NamedTuple):
    """Drones that move after losses (m,): the lost cable, the clasp that vanishes, the other."""

    drone: Items
    lost: Items
    clasp: Items
    far: Items


def moves(p: Plan) -> Moves:
    """Return the moves after losses of any cable of a ring, or of those at a chain's ends."""
    rows = []
    for ahead, behind in zip(p.clasps.tolist(), p.behind.tolist(), strict=True):
        vertex = p.begin[ahead]
        rows.append((2 * ahead, behind, vertex, p.end[ahead]))
        rows.append((2 * behind + 1, ahead, vertex, p.begin[behind]))
    at_end = (0, p.n - 1)
    rows = [row for row in rows if p.n > 2 and (p.closed or row[1] in at_end)]
    return Moves(*np.array(rows, dtype=int).reshape(-1, 4).T)


def losses(p: Plan, stated: Stated | None = None) -> Iterator[Row]:
    """Prove that every loss is survived while a hitch is taut, if the plan says so.

    ``stated`` is what ``certificate.json`` states, or None.
    """
    if p.limits.get("survive") is None:
        return
    jumps, names = displacements(p), p.names
    yield fault_row("losses", [(0.0, applies, text) for applies, text in contradictions(p, jumps)])
    hitched = p.state == HITCHED
    T = np.max(p.tensions.c[0][:, :, 0], axis=-1) * hitched[:, None]
    jump = np.repeat(T, 2, axis=1) * jumps
    places = [(float(x), float(p.breaks[q]), names[i]) for (q, i), x in np.ndenumerate(jump)]
    values = places if np.any(hitched) else []
    yield worst_row("loss_displacement", "m", p.tube[0], values)
    rows, on = moves(p), taut_pieces(p)
    if stated is not None:
        yield fault_row("after_loss", table_faults(p, rows, on, stated, float(np.max(jump))))
    if np.any(on) and len(rows.drone):
        yield from AfterLosses(p, rows, on).proofs()
    else:
        yield nothing_row("survivable 1 min", 1.0)


def taut_pieces(p: Plan) -> Mask:
    """Return the pieces on which a hitch is taut and holds no object."""
    taut = np.min(p.tensions.c[0][:, :, 0], axis=-1) >= TAUT_SHARE * p.stated_tension[:, 0]
    return np.asarray((p.state == HITCHED) & np.all(taut, axis=1) & ~np.any(p.held, axis=0))


def contradictions(p: Plan, jumps: Array) -> Iterator[tuple[bool, str]]:
    """Yield what excludes that losses are survived."""
    yield not p.settings["team"].get("release"), "drones cannot drop their cables"
    yield not np.all(np.isfinite(jumps)), "drones have no known gains"
    yield bool(np.any(p.load)), "loads slide along loose cables"
    yield bool(p.bodies), "objects are not bounded"


def displacements(p: Plan) -> Array:
    """Return deviations of drones (N,) after a loss per tension [m/N], from their gains."""
    kinds = p.settings["team"]["quadrotor"]
    each = [kinds[i * len(kinds) // p.N] for i in p.drone.tolist()]
    return np.array([displacement(kind, float(kind["mass"])) for kind in each])


def displacement(kind: dict[str, Any], mass: float) -> float:
    """Return ``coth(π ζ / 2 √(1 - ζ²)) / kp`` of the worse axis; infinite without known gains."""
    gains, stiffness = kind["gains"] or {}, kind["stiffness"]
    kp, kd = gains.get("kp"), gains.get("kd")
    if kind["feed_forward"] is False or kind["controller"] == "pid":
        return math.inf
    if kind["controller"] is None:
        kp = [stiffness] * 2 if stiffness else None
        kd = [2.0 * DAMPING_RATIO * math.sqrt(x * mass) for x in kp or ()]
    elif kind["controller"] in STOCK and kind["latency"] is None:
        *usual, per_mass = STOCK[kind["controller"]]
        scale = mass if per_mass else 1.0
        kp, kd = (x or [scale * y for y in z] for x, z in zip((kp, kd), usual, strict=True))
    if not kp or not kd:
        return math.inf
    worst = 0.0
    for k, c in zip(kp, kd, strict=True):
        ratio = c / (2.0 * math.sqrt(k * mass))
        swing = math.pi * ratio / (2.0 * math.sqrt(1.0 - ratio**2)) if ratio < 1.0 else math.inf
        worst = max(worst, 1.0 / (k * math.tanh(swing)))
    return worst


def cable_after(s: Spans, rows: Moves, j: Index) -> tuple[Line, Line]:
    """Return tensions of edges at their far clasps, and lengths of edges and legs, which remain."""
    p, drone = s.plan, rows.drone[j]
    k = drone // 2
    far, clasp = s.point(rows.far[j]), s.point(rows.clasp[j])
    T = p.tensions.on(s, k)
    ratio = T.inverse() * p.weight if p.weight else None
    edge = taut_part(clasp - far, T, ratio)
    return edge.first, edge.length + taut_length(s.point(drone) - clasp, ratio)


def place_after(s: Spans, rows: Moves, j: Index) -> Line:
    """Return places of drones after losses."""
    return s.point(rows.far[j]) + chord_of(*cable_after(s, rows, j), s.plan.weight)


def end_region(s: Spans, rows: Moves, j: Index, clasp: Line) -> list[Line]:
    """Return corners of vertical regions of cables from drones, by way of a clasp, to others.

    They are below the drone, the place of the clasp, the far clasp and the other drone.
    """
    p, drone = s.plan, rows.drone[j]
    start, other = s.point(drone), s.point(drone ^ 1)
    level = distance([start[:2], place_after(s, rows, j)[:2]], [other[:2]]).low
    squares = p.length[drone // 2, 0] ** 2 - np.maximum(level, 0.0) ** 2
    depth = 0.5 * np.sqrt(np.maximum(squares, 0.0))[:, None]
    corners = [start, clasp, s.point(rows.far[j]), other]
    lowest = minimum(*(x[2] for x in corners)) - depth
    return [*corners, concatenate(s.zero, s.zero, lowest) + start * (1.0 - UP)]


def whole_region(s: Spans, k: Index) -> list[Line]:
    """Return corners of vertical regions of cables between their drones and over both clasps."""
    (q, r), p = s.ends(k), s.plan
    corners = [q, s.point(p.begin[k]), s.point(p.end[k]), r]
    lowest = minimum(*(x[2] for x in corners)) - s.hanging_depth(k)
    return [*corners, concatenate(s.zero, s.zero, lowest) + q * (1.0 - UP)]


def swept_gap(a: Sequence[Line], b: Sequence[Line]) -> Line:
    """Return distances of triangles that chords sweep, with their ends at rest last."""
    mean = [np.mean([x.v for x in ends[:-1]], axis=0) for ends in (a, b)]
    w = normalize(closest(mean[0], a[-1].v, mean[1], b[-1].v))
    return minimum(*((x - y).dot(w) for x in a for y in b))


def pairs(allowed: Callable[[Any, Any], Any], first: Items, second: Items) -> Items:
    """Return the pairs (m, 2) of two groups that are allowed."""
    i, j = (x.ravel() for x in np.meshgrid(first, second, indexing="ij"))
    keep = np.broadcast_to(allowed(i, j), i.shape)
    return np.column_stack([i[keep], j[keep]])


def share(line: Line, limit: float) -> Line:
    """Return a distance over its limit, at most 1."""
    return minimum(line * (1.0 / limit), 1.0)


class Pairs(NamedTuple):
    """Pairs of bodies that may meet after the same loss (m, 2).

    Bodies are rows of moves (the drone, or its cable), drones i, and whole cables k, which keep
    their clasps.
    """

    others: Items  # rows and drones that remain
    both: Items  # both rows of a loss
    leaving: Items  # rows and drones of the lost robot
    staying: Items  # drones that may leave, and all others
    beside: Items  # rows and whole cables
    leave_beside: Items  # drones that may leave, and whole cables
    stay_beside: Items  # drones that remain, and whole cables other than theirs
    whole: Items  # two whole cables

    @classmethod
    def of(cls, p: Plan, rows: Moves) -> Pairs:
        """Return all pairs of a plan."""
        moves, drones, cables = np.arange(len(rows.drone)), np.arange(p.N), np.arange(p.n)
        whole = whole_cables(p, rows)
        may_leave = np.flatnonzero(np.isin(drones // 2, rows.lost))
        is_other = drones[:, None] // 2 != cables
        remain = np.any(is_other.T[:, :, None] & whole[:, None], axis=0) & is_other
        return cls(
            others=pairs(
                lambda j, i: (i != rows.drone[j]) & (i // 2 != rows.lost[j]), moves, drones
            ),
            both=pairs(lambda j, i: (rows.lost[j] == rows.lost[i]) & (i != j), moves, moves),
            leaving=pairs(lambda j, i: rows.lost[j] == i // 2, moves, drones),
            staying=pairs(lambda i, j: i // 2 != j // 2, may_leave, drones),
            beside=pairs(lambda j, k: whole[rows.lost[j], k], moves, cables),
            leave_beside=pairs(lambda i, k: whole[i // 2, k], drones, cables),
            stay_beside=pairs(lambda i, k: remain[i, k], drones, cables),
            whole=pairs(
                lambda i, k: (i < k) & np.any(whole[:, i] & whole[:, k], axis=0), cables, cables
            ),
        )


def whole_cables(p: Plan, rows: Moves) -> Mask:
    """Return whether cables keep their clasps after the loss of one that may be lost (n, n)."""
    whole = ~np.eye(p.n, dtype=bool)
    whole[rows.lost, rows.drone // 2] = False
    whole[~np.isin(np.arange(p.n), rows.lost)] = False
    return whole


def clasped_first(p: Plan, items: Items, cables: Items) -> tuple[Items, Items]:
    """Return the pairs whose cables (m, 2) share a clasp, and the others."""
    shares = p.clasped[cables[:, 0], cables[:, 1]]
    return items[shares], items[~shares]


class CablePlaces(NamedTuple):
    """Where cables are after losses."""

    region: Region
    chords: Chords


class AfterLosses:
    """Bodies of a plan after losses, and proofs that they stay apart.

    Methods with spans and an index return corners of where a body is: drones i, rows j of moves
    with their drone or its cable, and whole cables k.
    """

    def __init__(self, p: Plan, rows: Moves, on: Mask) -> None:
        self.p, self.rows, self.on, self.pairs = p, rows, on, Pairs.of(p, rows)
        self.moved = [p.names[i] for i in rows.drone]  # names of the rows
        heights = p.points.c[0][on][:, : p.N, 2]
        spread = np.max(heights, axis=(1, 2)) - np.min(heights, axis=(1, 2))
        # The semi-axis of the ellipsoid that contains a drone's errors is 0.5 over the scale
        semi_axis = 0.5 / float(p.scale[2])
        self.rise = RISE * semi_axis + float(np.max(spread)) + largest_lift(p, rows, on)

    def proofs(self) -> Iterator[Row]:
        """Prove that all distances after losses are kept, as shares of their limits, at most 1."""
        yield from self.separations()
        yield from self.clearances()
        yield from self.heights()
        yield from self.crossings()
        yield from rest_rows(self.p, self.rows, self.on, self.rise)

    def proven(self, items: Items, formula: Callable[..., Line], *names: Any) -> Iterator[Row]:
        """Prove shares of limits, for all items with names of their columns."""
        if len(items):
            yield prove("survivable 1 min", 1.0, Spans.of(self.p, self.on, items, *names), formula)

    def resting(self, s: Spans, i: Index) -> list[Line]:
        """Return where drones are that do not move."""
        return [s.point(i)]

    def risen(self, s: Spans, i: Index) -> list[Line]:
        """Return where drones of the lost robot end."""
        return [s.point(i) + self.rise * UP]

    def rising(self, s: Spans, i: Index) -> list[Line]:
        """Return both ends of where drones of the lost robot rise."""
        return [*self.resting(s, i), *self.risen(s, i)]

    def moving(self, s: Spans, j: Index) -> list[Line]:
        """Return both ends of ways."""
        return [s.point(self.rows.drone[j]), place_after(s, self.rows, j)]

    def straight_edge(self, s: Spans, j: Index) -> list[Line]:
        """Return both ends of cables after losses, from the drone's place to the far clasp."""
        return [place_after(s, self.rows, j), s.point(self.rows.far[j])]

    def loose_cable(self, s: Spans, j: Index) -> list[Line]:
        """Return regions of cables whose ends are anywhere on their ways."""
        return end_region(s, self.rows, j, place_after(s, self.rows, j))

    def cable_at_first(self, s: Spans, j: Index) -> list[Line]:
        """Return regions of cables while their clasp vanishes."""
        return end_region(s, self.rows, j, s.point(self.rows.clasp[j]))

    def swept(self, s: Spans, j: Index) -> list[list[Line]]:
        """Return triangles that chords of cables sweep in turn."""
        start, place = self.moving(s, j)
        steps = [start + (place - start) * (x / SWEEPS) for x in range(SWEEPS + 1)]
        return [[*ends, s.point(self.rows.drone[j] ^ 1)] for ends in pairwise(steps)]

    def separations(self) -> Iterator[Row]:
        """Prove the distances of drones."""
        p, pairs, moved = self.p, self.pairs, self.moved

        def ratio(s: Spans, i: Index, j: Index, first: Region, second: Region) -> Line:
            scaled = [[x * p.scale for x in corners] for corners in (first(s, i), second(s, j))]
            return share(distance(scaled[0], scaled[1]), 1.0)

        for items, first, second, names in (
            (pairs.others, self.moving, self.resting, (moved, p.names)),
            (pairs.both, self.moving, self.moving, (moved, moved)),
            (pairs.leaving, self.moving, self.risen, (moved, p.names)),
            (pairs.staying, self.rising, self.resting, (p.names, p.names)),
        ):
            yield from self.proven(items, partial(ratio, first=first, second=second), *names)

    def clearances(self) -> Iterator[Row]:
        """Prove the distances of cables to drones."""
        p, pairs, moved = self.p, self.pairs, self.moved
        limit = p.cable_limit[1]
        others = pairs.others
        of_others = others[others[:, 1] // 2 != self.rows.drone[others[:, 0]] // 2]

        def taut(s: Spans, j: Index, i: Index) -> Line:
            return share(distance(self.straight_edge(s, j), self.resting(s, i), p.ratio), limit)

        def gap(s: Spans, i: Index, j: Index, first: Region, second: Region) -> Line:
            return share(prism_gap(first(s, i), second(s, j), p.ratio), limit)

        def still(s: Spans, i: Index) -> list[Line]:
            """Return where drones are as a segment, which distances of regions take."""
            return self.resting(s, i) * 2

        yield from self.proven(others, taut, moved, p.names)
        for items, first, second, names in (
            (pairs.beside, self.moving, whole_region, (moved, p.cables)),
            (pairs.both, self.loose_cable, self.moving, (moved, moved)),
            (of_others, self.loose_cable, still, (moved, p.names)),
            (pairs.stay_beside, still, whole_region, (p.names, p.cables)),
            (pairs.leave_beside, self.rising, whole_region, (p.names, p.cables)),
            (pairs.leaving, self.cable_at_first, self.rising, (moved, p.names)),
        ):
            yield from self.proven(items, partial(gap, first=first, second=second), *names)

    def heights(self) -> Iterator[Row]:
        """Prove that cables are clear of the ground."""
        p = self.p
        least = p.floor + p.sep["cable"] + (p.ratio - 1.0) * 2.0 * p.tracking
        rows = np.arange(len(self.rows.drone))[:, None]
        whole = np.flatnonzero(np.any(whole_cables(p, self.rows), axis=0))[:, None]

        def height(s: Spans, j: Index, region: Region) -> Line:
            """Return 1 where cables are clear of the ground, else less."""
            return minimum(region(s, j)[-1][2] - least, 0.0) + 1.0

        yield from self.proven(rows, partial(height, region=self.loose_cable), self.moved)
        yield from self.proven(whole, partial(height, region=whole_region), p.cables)

    def crossings(self) -> Iterator[Row]:
        """Prove the distances of cables that share no clasp, and of chords of those that do."""
        p, pairs, moved = self.p, self.pairs, self.moved
        cable = self.rows.drone // 2
        beside = np.column_stack([cable[pairs.beside[:, 0]], pairs.beside[:, 1]])
        loose = CablePlaces(self.loose_cable, self.swept)
        whole = CablePlaces(whole_region, chord)

        def gap(s: Spans, i: Index, j: Index, first: Region, second: Region) -> Line:
            outlines = ([x[:2] for x in corners[:-1]] for corners in (first(s, i), second(s, j)))
            return share(hull_distance(*outlines), p.crossing_limit[1])

        def past(s: Spans, i: Index, j: Index, first: Chords, second: Chords) -> Line:
            gaps = [swept_gap(x, y) for x, y in product(first(s, i), second(s, j))]
            return share(minimum(*gaps), POS_TOL)

        for items, cables, one, other, names in (
            (pairs.beside, beside, loose, whole, (moved, p.cables)),
            (pairs.both, cable[pairs.both], loose, loose, (moved, moved)),
            (pairs.whole, pairs.whole, whole, whole, (p.cables, p.cables)),
        ):
            clasped, apart = clasped_first(p, items, cables)
            outlines_apart = partial(gap, first=one.region, second=other.region)
            chords_apart = partial(past, first=one.chords, second=other.chords)
            yield from self.proven(apart, outlines_apart, *names)
            yield from self.proven(clasped, chords_apart, *names)


def chord(s: Spans, k: Index) -> list[list[Line]]:
    """Return the chord of cables that keep their clasps, as the only one that it sweeps."""
    return [s.ends(k)]


def largest_lift(p: Plan, rows: Moves, on: Mask) -> float:
    """Return a bound of how far places after losses are above the drones [m]."""
    if p.weight == 0.0:
        return 0.0
    s = Spans.of(p, on, np.arange(len(rows.drone)))
    j = s.item[:, 0]
    up = place_after(s, rows, j)[2] - s.point(rows.drone[j])[2]
    return max(0.0, float(np.max(up.high)))


def rest_rows(p: Plan, rows: Moves, on: Mask, rise: float) -> Iterator[Row]:
    """Prove thrust, tilt and room at the places after losses."""
    each, names = np.arange(len(rows.drone)), [p.names[i] for i in rows.drone]
    s = Spans.of(p, on, each, names)

    def thrust_after(s: Spans, j: Index) -> Line:
        """Return the thrust at rest: weight, half of the cable's weight, and its pull."""
        drone = rows.drone[j]
        k = drone // 2
        chord = place_after(s, rows, j) - s.point(rows.far[j])
        pull = p.tensions.on(s, k)
        return (chord.unit() * pull) + UP * (p.mass[drone] * G)

    def thrust_share(s: Spans, j: Index) -> Line:
        drone = rows.drone[j]
        heaviest = 2.0 * p.weight * p.length[drone // 2]
        used = thrust_after(s, j).norm() + heaviest
        return minimum((used * (1.0 / p.max_thrust[drone])).inverse(), 1.0)

    def tilt_share(s: Spans, j: Index) -> Line:
        used = angle(thrust_after(s, j), s.zero + UP) * DEGREES
        return minimum(-used * (1.0 / (p.limits["tilt"] * DEGREES)) + 2.0, 1.0)

    yield prove("survivable 1 min", 1.0, s, thrust_share)
    yield prove("survivable 1 min", 1.0, s, tilt_share)
    if p.arena is not None:
        lower, upper = (np.array(p.arena[key]) for key in ("lower", "upper"))
        walls = np.array([p.tracking, p.tracking, 0.0])
        top = upper - np.array([1.0, 1.0, p.ratio]) * p.tracking

        def room(s: Spans, j: Index) -> Line:
            """Return 1 where places after losses are inside the arena, else less."""
            place = place_after(s, rows, j)
            inside = [(place - (lower + walls))[i] for i in range(3)]
            inside += [(-place + top)[i] for i in range(3)]
            return minimum(*inside, 0.0) + 1.0

        def headroom(s: Spans, i: Index) -> Line:
            return minimum(-s.point(i)[2] + (top[2] - rise), 0.0) + 1.0

        yield prove("survivable 1 min", 1.0, s, room)
        drones = Spans.of(p, on, np.arange(p.N), p.names)
        yield prove("survivable 1 min", 1.0, drones, headroom)


class Stated(NamedTuple):
    """What ``certificate.json`` states of losses."""

    worst: dict[str, float]  # worst values of checks
    ways: dict[str, dict[str, float]]  # [m] longest paths of drones, by robot
    seconds: dict[str, float]  # [s] time until tension is back, by robot


def table_faults(p: Plan, rows: Moves, on: Mask, stated: Stated, jump: float) -> Iterator[Fault]:
    """Yield what a certificate states otherwise than follows from the plan."""
    bound = stated.worst.get("loss_displacement", -math.inf)
    yield 0.0, bound < jump * (1.0 - 1e-6), "loss_displacement is understated"
    lost: list[int] = np.unique(rows.lost).tolist() if np.any(on) else []
    names = {k: f"{p.label}{p.robot[k]}" for k in range(p.n)}
    for k, name in names.items():
        yield 0.0, (k in lost) != (name in stated.ways), f"robot {name} is missing, or too many"
    lost = [k for k in lost if names[k] in stated.ways]
    if not lost:
        return
    yield 0.0, "survivable" not in stated.worst, "survivable is missing"
    s = Spans.of(p, on, np.arange(len(rows.drone)))
    j = s.item[:, 0]
    with np.errstate(all="ignore"):
        way = (place_after(s, rows, j) - s.point(rows.drone[j])).norm()
    for k in lost:
        name, of_drones = names[k], stated.ways[names[k]]
        moved = {p.names[rows.drone[x]]: j == x for x in np.flatnonzero(rows.lost == k)}
        if of_drones.keys() != moved.keys():
            yield 0.0, True, f"robot {name}: other drones move"
            continue
        for drone, own in moved.items():
            too_short = of_drones[drone] < float(np.max(way.v[own])) - POS_TOL
            yield 0.0, too_short, f"robot {name}: paths are longer"
            too_long = of_drones[drone] > float(np.max(way.high[own])) * 1.01 + STATED_TOL
            yield 0.0, too_long, f"robot {name}: paths are shorter"
        least = least_seconds(p, rows, on, k)
        unstated = math.inf if never_answered(p, on) else 0.0
        seconds = stated.seconds.get(name, unstated)
        yield 0.0, seconds < least, f"robot {name}: tension takes at least {least:.2f} s"


def never_answered(p: Plan, on: Mask) -> bool:
    """Return whether a plan moves at the end of each of its parts with a taut hitch.

    Otherwise it stops there at the latest, and a loss is answered.
    """
    ends = np.flatnonzero(on & ~np.append(on[1:], False))
    rates = [norm(p.points.c[k][ends, : p.N, :, -1]) for k in (1, 2)]
    return bool(np.all(np.max(rates, axis=(0, 2)) > REST_RATE))


def least_seconds(p: Plan, rows: Moves, on: Mask, lost: int) -> float:
    """Return a lower bound of the time [s] until tension is back after the loss of a cable.

    At the worst time the fastest drone stops, then both ends move as far as they must at any time,
    by the limits of the plan, and then tensions rise.
    """
    limits, others = p.limits, np.arange(p.n) != lost
    s = Spans.of(p, on, np.arange(p.N))
    stop = float(np.max(norm(s.point(s.item[:, 0], 1).v))) / limits["acceleration"]
    s = Spans.of(p, on, np.flatnonzero(rows.lost == lost))
    j = s.item[:, 0]
    ways = (place_after(s, rows, j) - s.point(rows.drone[j])).norm().low
    way = max(float(np.min(ways[j == x])) for x in np.unique(j))
    ramp = fastest_ramp(max(way, 0.0), *(limits[x] for x in ("speed", "acceleration", "jerk")))
    periods = 2.0 * p.length[others, 0] * np.sqrt(p.weight / G / p.stated_tension[others, 0])
    shortest, count = TIGHTENING
    tightening = max(shortest, count * float(np.max(periods)))
    return float(REACTION + stop + ramp + tightening)


def fastest_ramp(distance: float, speed: float, acceleration: float, jerk: float) -> float:
    """Return the time [s] of the fastest straight motion from rest to rest."""

    def rise(peak: float) -> float:
        """Return the time in which the speed rises to its peak."""
        if peak * jerk >= acceleration**2:
            return peak / acceleration + acceleration / jerk
        return 2.0 * math.sqrt(peak / jerk)

    if speed * rise(speed) <= distance:
        return distance / speed + rise(speed)
    low, high = 0.0, speed
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle * rise(middle) <= distance else (low, middle)
    return 2.0 * rise(low)


def read_stated(plan: Path, teams: Sequence[Plan]) -> Stated | None:
    """Return what the certificate beside a ``plan.npz`` states, or None without one.

    Raises an error of any kind unless it is a certificate of this plan, for robots of its teams.
    """
    path = plan.with_name("certificate.json")
    if plan.name != "plan.npz" or not path.exists():
        return None
    content = json.loads(path.read_text("utf-8"), object_pairs_hook=without_repeats)
    if content["plan"] != sha256(plan.read_bytes()).hexdigest():
        raise ValueError("it is that of another plan.npz")
    checks = without_repeats([(each["name"], each["worst"]) for each in content["checks"]])
    (table,) = [content["after_loss"]]
    if table.keys() != {"robots"} or content["certified"] is not True:
        raise ValueError("after_loss has other keys than robots, or it is not certified")
    robots = without_repeats([(row["robot"], row) for row in table["robots"]])
    if not robots.keys() <= {f"{p.label}{k}" for p in teams for k in p.robot}:
        raise ValueError("after_loss names robots that are none")
    if any(not row.keys() <= {"robot", "ways", "seconds"} for row in robots.values()):
        raise ValueError("after_loss has other keys than robot, ways and seconds")
    ways = {name: row["ways"] for name, row in robots.items()}
    return Stated(
        {name: number(worst) for name, worst in checks.items() if worst is not None},
        {name: {x: number(way) for x, way in each.items()} for name, each in ways.items()},
        {name: number(row["seconds"]) for name, row in robots.items() if "seconds" in row},
    )


def without_repeats(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return the dictionary of some pairs; raises ValueError if a key is repeated."""
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a key is repeated")
    return content


def number(value: Any) -> float:
    """Return a finite number; raises ValueError for anything else."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError(f"{value!r:.60} is not a number")
    return float(value)
