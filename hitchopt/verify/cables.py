"""Taut cables: lengths, balance at clasps, contact, friction and convexity."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise

import numpy as np

from .arithmetic import BIG, DEGREES, UP, G, Index, Line, Mask, angle, maximum, minimum, norm
from .drones import FLOOR_ROW, wall_gap
from .parts import depth_below
from .plan import HITCHED, REST_TOL, WRAP_TOL, Plan
from .shapes import distance
from .spans import MIN_TENSION, Row, Spans, nothing_row, prove

TANGENTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # places of tangents of sagging segments
OPEN_ROLL = 175.0  # [deg] smallest roll of an open clasp: at 180° cables run straight


def taut_cables(p: Plan) -> Iterator[Row]:
    """Prove distances, lengths and shapes of hitches, tensions, and force residuals of clasps."""
    limits = p.limits
    names = p.segment_names
    clasps = Spans.of(p, p.formed, range(len(p.clasps)), [p.labels[p.V][c] for c in p.clasps])
    legs = Spans.of(p, p.formed, np.flatnonzero(p.leg), p.names)
    cables = Spans.of(p, p.formed, range(p.n), p.cables)
    vertices = Spans.of(p, p.formed, range(p.V.start, p.V.stop), p.labels)
    own = np.where(p.leg, np.arange(p.N), p.anchor)  # other end of the segment at each drone
    foreign = np.argwhere(np.all(p.segments[:, :2] != own[:, None, None], axis=2))
    ties = p.segments[:, 3:]
    shared = np.any(ties[:, None, :, None] == ties[None, :, None, :], axis=(2, 3))
    pairs = Spans.of(p, p.formed, np.argwhere(np.triu(~shared, 1)), names, names)
    for j in np.split(np.arange(len(p.segments)), [int(np.sum(p.leg))]):
        s = Spans.of(p, p.formed, j, names)
        if p.arena is not None:
            yield prove("arena m min", 0.0, s, partial(arena_gap, leg=not j[0]))
        if limits["floor"] is not None:
            yield prove(FLOOR_ROW, limits["floor"], s, partial(lowest_part, leg=not j[0]))
    s = Spans.of(p, p.formed, foreign, p.names, names)
    near = partial(distance, ratio=p.ratio)
    yield prove(*p.cable_limit, s, lambda s, i, j: near([s.point(i)], s.segment(j)))
    if not len(pairs.x) and np.any(p.formed):
        yield nothing_row(*p.crossing_limit)  # two cables
    yield prove(*p.crossing_limit, pairs, lambda s, i, j: near(s.segment(i), s.segment(j)))
    speed = "vertex_speed m/s max", limits["vertex_speed"]
    yield prove(*speed, vertices, lambda s, i: s.point(i, 1).norm())
    least = limits["leg"] + 2.0 * p.tracking  # vertices may be off as far as drones
    yield prove("legs m min", least, legs, lambda s, i: s.leg(i).flat(p.ratio).norm())
    yield prove("cable_length ratio max", 1e-4, cables, length_error)
    yield prove("equilibrium ratio max", 5e-3, clasps, force_residual)
    closed = clasps.select(p.state[clasps.piece] == HITCHED)
    yield prove("contact deg max", OPEN_ROLL, closed, roll_angle)
    if p.weight or np.any(p.load) or np.any(p.active):
        yield prove("contact 1 max", 0.0, closed, contact)
    yield prove("convexity deg min", 0.0, clasps, exterior_angle)
    yield prove("outline_turn deg min", 0.0, Spans.of(p, p.formed, [0], ["outline"]), turn_margin)
    yield prove("tension N max", 1e-4, cables, range_excess)
    if p.frictional:
        yield prove("equilibrium ratio max", 5e-3, legs, friction_excess)
    if p.has_contacts:
        straight = Spans.of(p, p.formed & ~np.any(p.grip, axis=0), range(p.n), p.cables)
        yield prove("bend 1 max", 2 * WRAP_TOL, straight, bend)


def largest_sag(s: Spans, j: Index, *, leg: bool) -> Line | float:
    """Return how far segments sag below their chords at most."""
    p = s.plan
    a, b = s.segment(j)
    k = p.segments[j, 2]
    chord = b - a
    T = p.pulls.on(s, p.segments[j, 1]) if leg else p.tensions.on(s, k)
    ratio = s.weight_ratio(T, k)
    return 0.0 if ratio is None else depth_below(chord, ratio)


def arena_gap(s: Spans, j: Index, *, leg: bool) -> Line:
    """Return distances of segments to walls."""
    a, b = s.segment(j)
    chord = b - a
    sag = largest_sag(s, j, leg=leg)
    inner = wall_gap(s, [a + chord * x for x in (0.25, 0.5, 0.75)], sag)
    return minimum(wall_gap(s, [a, b]), inner)


def lowest_part(s: Spans, j: Index, *, leg: bool) -> Line:
    """Return heights below which no point of segments is.

    The parabola ``z + h u - 4 S u (1 - u)`` of a segment with a sag S that rises by h is above its
    tangents. Those at u and v meet halfway, ``4 S (½ (u + v) - u v)`` below the chord.
    """
    a, b = (x[2] for x in s.segment(j))
    sag = largest_sag(s, j, leg=leg)
    meeting = [(0.5 * (u + v), 4.0 * (0.5 * (u + v) - u * v)) for u, v in pairwise(TANGENTS)]
    return minimum(a, b, *(a + (b - a) * x - sag * depth for x, depth in meeting))


def turn_margin(s: Spans, _: Index) -> Line:
    """Return the margin of the total turn to more than one turn, or to one for a chain."""
    return -total_turn(s) + (361.0 if s.plan.closed else 360.0)


def range_excess(s: Spans, k: Index) -> Line:
    """Return ``T - T_max``, or ``T_min - T``; on ramps from 0 to T_min, their excesses."""
    p = s.plan
    T = p.tensions.on(s, k)
    low, high = p.tension_range[s.piece, k, :, None].swapaxes(0, 1)
    ramp = p.ramp[s.piece, k, None]
    return maximum(T - np.where(ramp, low, high), -T + np.where(ramp, 0.0, low))


def bend(s: Spans, k: Index) -> Line:
    """Return the turn of edges without an object, or the distance of their contacts [m]."""
    leaving, arriving = s.edge(k)
    first, last = (s.point(i) for i in s.plan.edges[1:3, k])
    return maximum(leaving.unit().cross(arriving.unit()).norm(), (last - first).norm())


def friction_excess(s: Spans, i: Index) -> Line:
    """Return excesses of legs' tensions beyond ``e^{-μβ} T`` and ``e^{μβ} T``, over T."""
    p = s.plan
    ratio = capstan(s, i)
    x = p.pulls.on(s, i)
    T = p.tensions.on(s, i // 2)
    beyond = maximum(x - T * ratio, T * ratio.inverse() - x)
    return beyond * maximum(T, MIN_TENSION).inverse()


def capstan(s: Spans, i: Index) -> Line:
    """Return ``e^{μβ}`` for the bends ``β = π sin(θ/2)`` of cables that turn by θ, at drones i.

    They twist half a turn of a helix about each other. ``2 sin(θ/2)`` is the distance of both
    directions.
    """
    leaving, arriving = s.edge(i // 2)
    q = np.broadcast_to(i % 2 == 0, len(s.x))
    along = leaving.where(q) - arriving.where(~q)
    turn = (along.unit() + s.leg_chord(i).unit()).norm()
    return (turn * (0.5 * np.pi * s.plan.mu)).map(np.exp, np.exp)


def length_error(s: Spans, k: Index) -> Line:
    """Return ``|d + l + e - L| / L``, or errors of stored legs."""
    p = s.plan
    errors = [(p.legs.on(s, i) - s.leg(i).norm()).norm() for i in (2 * k, 2 * k + 1)]
    legs = s.leg_length(2 * k) + s.leg_length(2 * k + 1)
    excess = legs + s.edge_length(k) - p.length[k]
    if p.has_contacts:
        excess = excess + wrapped_length(s, k)
    for b in range(len(p.bodies)):
        share = p.load_share.on(s, b)
        excess = excess - share * share * p.rim.length_loss[b, s.piece, k, None]
    return maximum(excess.norm(), *errors) * (1.0 / p.length[k])


def wrapped_length(s: Spans, k: Index) -> Line:
    """Return lengths of edges along gripped objects: ``2 R arcsin(c / 2 R)``, or sides."""
    p = s.plan
    ends = [s.point(i) for i in s.plan.edges[1:3, k]]
    total = chord = (ends[1] - ends[0]).norm()
    for b in map(int, np.flatnonzero(np.any(p.grip, axis=1))):
        stem = p.bodies[b].stem
        on = p.grip[b, s.piece]
        if stem.round:
            half = chord * (0.5 / stem.radius)
            half = half.map(np.arcsin, lambda x: 1.0 / np.sqrt(1.0 - x**2))
            wrapped = half * (2.0 * stem.radius)
        else:
            ring = np.append(0.0, np.cumsum(norm(stem.sides)))
            gaps = [norm(s.local(b, x).v[:, None, :2] - stem.core) for x in ends]
            first, last = (ring[np.argmin(x, axis=1), None] for x in gaps)
            wrapped = s.zero + np.where(chord.v < REST_TOL, 0.0, (last - first) % ring[-1])
        total = total.where(~on) + wrapped.where(on)
    return total


def clasp_forces(s: Spans, c: Index) -> tuple[list[Line], list[Line], Line]:
    """Return tensions at a clasp, weights of loads for both cables, and body forces.

    ``Q + E + R + E' - W - W' + w = 0``, the tensions of q-leg and edge ahead, and of r-leg and edge
    behind, all from the clasp. Loads W are ``½ τ g load``; ``w = -m μ (a_k + g b ẑ) + m h (G·a) ẑ``
    with the load share b, the clasp's shares μ and G of mass and moments, and the height h above
    clasps. A rim takes its share of the pull of edges, but not of their weight.
    """
    p = s.plan
    k = s.plan.clasps[c]
    j = s.plan.behind[c]
    factor = s.zero + 1.0
    body_force = s.zero * UP
    for b, body in enumerate(p.bodies):
        share = p.load_share.on(s, b)
        mass, x, y = p.rim.shares[b, s.piece, c, :, None].swapaxes(0, 1)
        factor = factor - share * share * p.rim.pull_loss[b, s.piece, None]
        a = s.rotated(b, s.world(b, body.centre, 2))
        moment = (a[0] * x + a[1] * y) * UP * (body.centre[2] - body.height)
        inertia = (moment - s.point(p.begin[k], 2) * mass).where(p.moving[b, s.piece])
        body_force = body_force + (inertia - share * mass * G * UP) * body.mass
    weights = [s.zero * UP] * 2
    if np.any(p.load):
        weights = [s.tautness(cable) * (0.5 * G * p.load[c]) * UP for cable in (k, j)]
    edges = [s.edge_part(k), s.edge_part(j, from_end=True)]
    if p.bodies:
        edges = [x._replace(mean=x.mean * factor) for x in edges]
    legs = [s.leg_part(2 * k), s.leg_part(2 * j + 1)]
    return (
        [part.first for pair in zip(legs, edges, strict=True) for part in pair],
        weights,
        body_force,
    )


def weaker_tension(s: Spans, c: Index) -> Line:
    """Return the smaller tension of a clasp's cables, at least MIN_TENSION."""
    ahead, behind = (s.plan.tensions.on(s, k[c]) for k in (s.plan.clasps, s.plan.behind))
    return maximum(minimum(ahead, behind), MIN_TENSION)


def force_residual(s: Spans, c: Index) -> Line:
    """Return the force residual of a clasp, over the smaller tension of its cables."""
    tensions, (a, b), body_force = clasp_forces(s, c)
    total = sum(tensions, body_force - a - b)
    return total.norm() * weaker_tension(s, c).inverse()


def roll_angle(s: Spans, c: Index) -> Line:
    """Return the roll of pairs about the sum of their legs' tensions [deg]; open ones have 180°.

    It is the angle from ``u_k + u_{k-1}``, of the edges' chords, to the difference of the tensions
    at the clasp, both normal to their sum; zero where tensions vanish at the ends of ramps.
    """
    k, j = s.plan.clasps[c], s.plan.behind[c]
    q, r = (s.leg_part(i).first for i in (2 * k, 2 * j + 1))
    axis = (q + r).unit()
    bisector = s.edge(k)[0].unit() + s.edge(j)[1].unit()
    components = [x - axis * axis.dot(x) for x in (bisector, q - r)]
    return (angle(*components) * DEGREES).where(has_tension(s, k, j))


def has_tension(s: Spans, *cables: Index) -> Mask:
    """Return a mask (m,) of cables under tension, which excludes the ends of ramps."""
    weakest = minimum(*(s.plan.tensions.on(s, k) for k in cables))
    on_ramp = np.any([s.plan.ramp[s.piece, k] for k in cables], axis=0)
    return np.asarray((weakest.high > MIN_TENSION) | ~on_ramp)


def contact(s: Spans, c: Index) -> Line:
    """Return contact products over the weaker pull: negative while the cables press together.

    The cable ahead presses by ``C = W - Q - E - ½ w``; products are those of C with its directions
    at the clasp, and of -C with those of the cable behind. With different tensions due to friction
    they are the means of both products of a cable.
    """
    p = s.plan
    tensions, weights, body_force = clasp_forces(s, c)
    C = weights[0] - tensions[0] - tensions[1] - body_force * 0.5
    tensioned = has_tension(s, p.clasps[c], p.behind[c])
    directions = [x.unit() for x in tensions]
    products = [C.dot(directions[0]), C.dot(directions[1])]
    products += [-C.dot(directions[2]), -C.dot(directions[3])]
    if p.frictional:
        products = [(products[i] + products[i + 1]) * 0.5 for i in (0, 2)]
    largest = maximum(*products) * weaker_tension(s, c).inverse()
    return largest.where(tensioned) - np.where(tensioned, 0.0, 1.0)[:, None]


def wrap_angle(s: Spans, k: Index) -> Line:
    """Return angles by which edges turn along an object in the horizontal plane [rad]."""
    return angle(*(x[:2] for x in s.edge(k)))


def total_turn(s: Spans) -> Line:
    """Return sums of exterior angles [deg]."""
    turns = [exterior_angle(s, c) for c in range(len(s.plan.clasps))]
    return sum(turns, s.zero)


def exterior_angle(s: Spans, c: Index) -> Line:
    """Return exterior angles at clasps in the horizontal plane [deg]; clockwise is positive."""
    p = s.plan
    k = s.plan.clasps[c]
    x = s.point(s.plan.begin[s.plan.clasps[c]])
    a = (x - s.point(p.begin[p.behind[c]]))[:2]
    b = (s.point(p.end[k]) - x)[:2]
    right = a[1] * b[0] - a[0] * b[1]
    turn = angle(a, b) * DEGREES * np.where(right.v < 0.0, -1.0, 1.0)
    return Line(turn.v, turn.g, np.where(right.low * right.high > 0.0, turn.q, BIG), s.t)
