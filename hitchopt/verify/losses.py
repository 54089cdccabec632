"""Losses of a robot with its cable: what remains is a chain in balance, reached clear of all.

Without cable k, its neighbours are straight from their other clasps f, where they pull as before:
with a pull P of their edge along ê, and weights w of the edge and w' of edge and leg, along
``P ê + (w' - w)/2 ẑ``. Ways to their ends there are segments, loose cables are in prisms below way
and f, and drones of the lost robot rise above all others.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .arithmetic import (
    DEGREES,
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
)
from .reading import Plan
from .shapes import distance, prism_gap
from .spans import Row, Spans, fault_row, prove, worst_row

TAUT_SHARE = 0.9  # least tension of a taut hitch, over the team's
RISE = 2.1  # height of the rise of a lost robot's drones, over the semi-axis of ellipsoids
STATED_TOL = 2e-3  # [m] tolerance of ways in the table ``after_loss``
DAMPING_RATIO = 5.0 / 6.0  # of loops of which only the stiffness is stated
STOCK = {  # gains kp, kd of controllers, horizontal and vertical, and whether they are per mass
    "mellinger": ((0.40, 1.25), (0.2, 0.4), False),
    "lee": ((7.0, 7.0), (4.0, 4.0), True),
    "px4": ((1.71, 4.0), (1.8, 4.0), True),
}


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


def losses(p: Plan, stated: Any = None) -> Iterator[Row]:
    """Prove that every loss is survived while a hitch is taut, if the plan says so.

    ``stated`` is the content of ``certificate.json``, or None.
    """
    if p.limits.get("survive") is None:
        return
    jumps, names = displacements(p), p.names
    yield fault_row("losses", [(0.0, applies, text) for applies, text in contradictions(p, jumps)])
    hitched = p.state == "hitched"
    T = np.max(p.tensions.c[0][:, :, 0], axis=-1) * hitched[:, None]
    jump = np.repeat(T, 2, axis=1) * jumps
    values = [(float(x), float(p.breaks[q]), names[i]) for (q, i), x in np.ndenumerate(jump)]
    yield worst_row("loss_displacement", "m", p.tube[0], values)
    rows, on = moves(p), taut_pieces(p)
    if not np.any(on) or not len(rows.drone):
        return
    yield from cases(p, rows, on)
    if stated is not None:
        yield fault_row("after_loss", table_faults(p, rows, on, stated, float(np.max(jump))))


def taut_pieces(p: Plan) -> Mask:
    """Return the pieces on which a hitch is taut and holds no object."""
    taut = np.min(p.tensions.c[0][:, :, 0], axis=-1) >= TAUT_SHARE * p.team[:, 0]
    return np.asarray((p.state == "hitched") & np.all(taut, axis=1) & ~np.any(p.held, axis=0))


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


def place_after(s: Spans, rows: Moves, j: Index) -> Line:
    """Return places of drones after losses."""
    p, drone = s.plan, rows.drone[j]
    k = drone // 2
    far, clasp = s.point(rows.far[j]), s.point(rows.clasp[j])
    edge, leg, T = clasp - far, s.point(drone) - clasp, p.tensions.on(s, k)
    factor = T.inverse() * T.inverse() * (p.weight**2 / 24.0)
    edge_cable, leg_cable = (x.norm() + x.norm() * x[:2].dot(x[:2]) * factor for x in (edge, leg))
    pull = s.chord_force(T, k, edge[:2].dot(edge[:2]))
    direction = (edge.unit() * pull + leg_cable * UP * (0.5 * p.weight)).unit()
    cable = edge_cable + leg_cable
    e = factor * cable * cable * direction[:2].dot(direction[:2])
    share = -(e * (-(e * (-(e * (-(e * 55.0) + 12.0)) + 3.0)) + 1.0)) + 1.0
    return far + direction * cable * share


def depth_of(s: Spans, rows: Moves, j: Index, ends: list[Line]) -> Array:
    """Return how far loose cables hang at most below their ends (m, 1) [m]."""
    p, far, drone = s.plan, s.point(rows.far[j]), rows.drone[j]
    edge, leg = s.point(rows.clasp[j]) - far, s.point(drone) - s.point(rows.clasp[j])
    sag = (p.weight / p.min_tension[s.piece, drone // 2, 0]) ** 2 / 24.0
    longest = sum(x.norm().high * (1.0 + 1.3 * sag * x.norm().high ** 2) for x in (edge, leg))
    nearest = distance(ends, [far]).low
    squares = longest**2 - np.maximum(nearest, 0.0) ** 2
    return np.asarray(0.5 * np.sqrt(np.maximum(squares, 0.0))[:, None])


def pairs(allowed: Callable[[Any, Any], Any], first: Items, second: Items) -> Items:
    """Return the pairs (m, 2) of two groups that are allowed."""
    i, j = (x.ravel() for x in np.meshgrid(first, second, indexing="ij"))
    keep = np.broadcast_to(allowed(i, j), i.shape)
    return np.column_stack([i[keep], j[keep]])


def share(line: Line, limit: float) -> Line:
    """Return a distance over its limit, at most 1."""
    return minimum(line * (1.0 / limit), 1.0)


def cases(p: Plan, rows: Moves, on: Mask) -> Iterator[Row]:
    """Prove that all distances after losses are kept, as shares of their limits, at most 1."""
    count, names = len(rows.drone), [p.names[i] for i in rows.drone]
    each, drones = np.arange(count), np.arange(p.N)
    cable, points = rows.drone // 2, p.points.c[0]
    may_leave = np.flatnonzero(np.isin(drones // 2, rows.lost))
    heights = points[on][:, : p.N, 2]
    spread = np.max(heights, axis=(1, 2)) - np.min(heights, axis=(1, 2))
    lift = largest_lift(p, rows, on)
    # The semi-axis of the ellipsoid that contains a drone's errors is 0.5 over the scale
    rise = (RISE * 0.5 / float(p.scale[2]) + float(np.max(spread)) + lift) * UP
    segments = p.segments
    of_cable = segments[:, 2]

    def way(s: Spans, j: Index) -> list[Line]:
        return [s.point(rows.drone[j]), place_after(s, rows, j)]

    def loose(s: Spans, j: Index, *, at_first: bool = False) -> list[Line]:
        start, place = way(s, j)
        other = s.point(rows.clasp[j]) if at_first else place
        ends = [start, start if at_first else place]
        low = depth_of(s, rows, j, ends)
        corners = [start, other, s.point(rows.far[j])]
        lowest = minimum(*(x[2] for x in corners)) - low
        below = concatenate(s.zero, s.zero, lowest)
        return [*corners, start, below + start * (1.0 - UP)]

    def taut(s: Spans, j: Index) -> list[Line]:
        return [place_after(s, rows, j), s.point(rows.far[j])]

    def rising(s: Spans, i: Index) -> list[Line]:
        return [s.point(i), s.point(i) + rise]

    def ratio(a: list[Line], b: list[Line]) -> Line:
        return share(distance([x * p.scale for x in a], [x * p.scale for x in b]), 1.0)

    near = partial(distance, ratio=p.ratio)
    apart_by = partial(prism_gap, ratio=p.ratio)
    cable_limit, crossing_limit = p.cable_limit[1], p.crossing_limit[1]
    others = pairs(lambda j, i: (i != rows.drone[j]) & (i // 2 != rows.lost[j]), each, drones)
    of_others = others[others[:, 1] // 2 != cable[others[:, 0]]]
    both = pairs(lambda j, i: (rows.lost[j] == rows.lost[i]) & (i != j), each, each)
    leaving = pairs(lambda j, i: rows.lost[j] == i // 2, each, drones)
    staying = pairs(lambda i, j: i // 2 != j // 2, may_leave, drones)
    parts = np.arange(len(segments))
    foreign = pairs(
        lambda j, x: (of_cable[x] != cable[j]) & (of_cable[x] != rows.lost[j]), each, parts
    )
    not_own = pairs(lambda i, x: of_cable[x] != i // 2, may_leave, parts)
    meets = np.array([[f in (p.begin[k], p.end[k]) for k in of_cable] for f in rows.far])
    unclasped = foreign[~meets[foreign[:, 0], foreign[:, 1]]]
    apart = both[rows.far[both[:, 0]] != rows.far[both[:, 1]]]
    at, part_names, all_names = partial(Spans.of, p, on), p.segment_names, p.names

    def proven(items: Items, formula: Callable[..., Line], *columns: Any) -> Iterator[Row]:
        if len(items):
            yield prove("survivable 1 min", 1.0, at(items, *columns), formula)

    yield from proven(others, lambda s, j, i: ratio(way(s, j), [s.point(i)]), names, all_names)
    yield from proven(both, lambda s, j, i: ratio(way(s, j), way(s, i)), names, names)
    yield from proven(
        leaving, lambda s, j, i: ratio(way(s, j), [s.point(i) + rise]), names, all_names
    )
    yield from proven(
        staying, lambda s, i, j: ratio(rising(s, i), [s.point(j)]), all_names, all_names
    )
    for items, formula, columns in (
        (foreign, lambda s, j, x: near(way(s, j), s.segment(x)), (names, part_names)),
        (not_own, lambda s, i, x: near(rising(s, i), s.segment(x)), (all_names, part_names)),
        (both, lambda s, j, i: apart_by(loose(s, j), way(s, i)), (names, names)),
        (of_others, lambda s, j, i: apart_by(loose(s, j), [s.point(i)] * 2), (names, all_names)),
        (others, lambda s, j, i: near(taut(s, j), [s.point(i)]), (names, all_names)),
        (
            leaving,
            lambda s, j, i: apart_by(loose(s, j, at_first=True), rising(s, i)),
            (names, all_names),
        ),
    ):
        yield from proven(items, lambda s, *k, f=formula: share(f(s, *k), cable_limit), *columns)
    for items, formula, columns in (
        (unclasped, lambda s, j, x: apart_by(loose(s, j), s.segment(x)), (names, part_names)),
        (apart, lambda s, j, i: apart_by(loose(s, j), loose(s, i)), (names, names)),
    ):
        yield from proven(items, lambda s, *k, f=formula: share(f(s, *k), crossing_limit), *columns)
    yield from rest_rows(p, rows, on, float(rise[2]))


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

    def over_ground(s: Spans, j: Index) -> Line:
        """Return 1 where loose cables are clear of the ground, else less."""
        ends = [s.point(rows.drone[j]), place_after(s, rows, j)]
        low = minimum(*(x[2] for x in [*ends, s.point(rows.far[j])]))
        least = p.floor + p.sep["cable"] + (p.ratio - 1.0) * 2.0 * p.tracking
        return minimum(low - depth_of(s, rows, j, ends) - least, 0.0) + 1.0

    yield prove("survivable 1 min", 1.0, s, over_ground)


def table_faults(
    p: Plan, rows: Moves, on: Mask, stated: dict[str, Any], jump: float
) -> Iterator[tuple[float, bool, str]]:
    """Yield what a certificate states otherwise than follows from the plan."""
    checks = {each["name"]: each for each in stated["checks"]}
    bound = checks.get("loss_displacement", {}).get("worst")
    yield 0.0, bound is None or bound < jump * (1.0 - 1e-6), "loss_displacement is understated"
    shares = checks.get("survivable", {}).get("worst")
    yield 0.0, shares is None, "survivable is missing"
    table = {row["robot"]: row for row in stated.get("after_loss", {}).get("robots", [])}
    s = Spans.of(p, on, np.arange(len(rows.drone)))
    j = s.item[:, 0]
    with np.errstate(all="ignore"):
        ways = norm((place_after(s, rows, j) - s.point(rows.drone[j])).v)
    for lost in range(p.n):
        row = table.get(f"{p.label}{p.robot[lost]}")
        name = f"robot {p.label}{p.robot[lost]}"
        yield 0.0, row is None, f"{name} is missing"
        own = np.flatnonzero(rows.lost == lost)
        if row is None or not len(own):
            continue
        told = row.get("ways", {})
        moved = {p.names[rows.drone[x]]: float(np.max(ways[j == x])) for x in own}
        yield 0.0, told.keys() != moved.keys(), f"{name}: other drones move"
        short = [x for x in moved if told.get(x, 0.0) < moved[x] - STATED_TOL]
        yield 0.0, bool(short), f"{name}: ways are longer"


def read_stated(folder: Path) -> dict[str, Any] | None:
    """Return the certificate beside a plan, or None."""
    path = folder / "certificate.json"
    if not path.is_file():
        return None
    content = json.loads(path.read_text("utf-8"))
    if not isinstance(content, dict) or not isinstance(content.get("checks"), list):
        raise ValueError("certificate.json is not a certificate")
    return content
