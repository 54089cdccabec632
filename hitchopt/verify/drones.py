"""Drones: distances, rates, forces and walls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from .arithmetic import DEGREES, TOLERANCE, UP, G, Index, Line, angle, minimum, norm
from .catenary import catenary_force
from .plan import Body, Plan
from .shapes import Slab
from .spans import Row, Spans, prove

FLOOR_ROW = "floor m min"  # header of the row of heights


def drones(p: Plan) -> Iterator[Row]:
    """Prove distances, rates and forces of drones."""
    s = Spans.of(p, p.all_pieces, range(p.N), p.names)
    lim = p.limits
    sep = p.sep
    pairs = Spans.of(p, p.all_pieces, np.column_stack(np.triu_indices(p.N, 1)), p.names, p.names)

    def turning(s: Spans, i: Index) -> Line:
        """Return ``|f × f'| / |f|²``: the rotation rate of the thrust."""
        u = thrust(s, i).unit()
        return Line(norm(u.g)[:, None], s.zero.g, u.q / s.t, s.t) * DEGREES

    def to_slab(s: Spans, i: Index, b: int, slab: Slab) -> Line:
        return slab.gap(s.local(b, s.point(i)), ratio=p.ratio)

    def over_slab(s: Spans, i: Index, b: int, slab: Slab) -> Line:
        return slab.below(s.local(b, s.point(i)) * p.wash, p.wash_lead)

    ratio = "separation ratio min", 1.0
    yield prove(*ratio, pairs, lambda s, i, j: ((s.point(i) - s.point(j)) * p.scale).norm())
    for k, header in enumerate(("speed m/s max", "acceleration m/s² max", "jerk m/s³ max"), 1):
        limit = lim[header.split()[0]] * (lim["reserve"] if k > 1 else 1.0)  # reserved for stops
        yield prove(header, limit, s, lambda s, i, k=k: s.point(i, k).norm())
    for most in np.unique(p.max_thrust).tolist():  # drones of one kind have one limit
        kind = Spans.of(p, p.all_pieces, np.flatnonzero(p.max_thrust == most), p.names)
        yield prove("thrust N max", most, kind, lambda s, i: thrust(s, i).norm())
    tilt = lim["tilt"] * DEGREES
    yield prove("tilt deg max", tilt, s, lambda s, i: angle(thrust(s, i), s.zero + UP) * DEGREES)
    if lim["body_rate"] is not None:
        yield prove("body_rate deg/s max", lim["body_rate"] * DEGREES, s, turning)
    if p.arena is not None:
        yield prove("arena m min", 0.0, s, lambda s, i: wall_gap(s, [s.point(i)]))
    if lim["floor"] is not None:
        yield prove(FLOOR_ROW, lim["floor"], s, lambda s, i: s.point(i)[2])
    for b, slab in [*p.slabs, *p.walls]:
        gap = partial(to_slab, b=b, slab=slab)
        can_be_held = p.n > 0 and b >= 0 and not p.bodies[b].fixed
        error = p.tracking if can_be_held else 0.0  # objects err with what holds them
        yield prove("keep_out m min", sep["radius"] + error, s, gap)
    for b, slab in [] if p.n else p.slabs:
        if moves(p, p.bodies[b]):
            over = partial(over_slab, b=b, slab=slab.scaled(p.wash))
            yield prove("downwash ratio min", 1.0, s, over)


def thrust(s: Spans, i: Index) -> Line:
    """Return ``m (a + g ẑ) + F - (1 - τ) w`` for the tension F of a leg at its drone.

    w is a hanging cable's force.
    """
    p = s.plan
    force = (s.point(i, 2) + G * UP) * s.plan.mass[i]
    if p.n:
        force = force + s.leg_part(i).second.where(p.pulling[s.piece])
    if p.weight > 0.0:
        slack = -s.tautness(i // 2) + 1.0
        if np.any(slack.high > TOLERANCE):
            hanging = catenary_force(s, i) * slack * p.weight
            force = force - hanging.where(slack.high > TOLERANCE)
    return force


def moves(p: Plan, body: Body) -> bool:
    """Return whether the largest thrust of a drone exceeds the friction of a standing body."""
    grip = body.friction * body.mass * G
    return not body.fixed and grip < float(np.max(p.max_thrust))


def wall_gap(s: Spans, x: Sequence[Line], depth: Line | float = 0.0, radius: float = 0.0) -> Line:
    """Return the distance to walls from points with a horizontal radius and a depth."""
    arena = s.plan.arena
    assert arena is not None
    lower, upper = np.array(arena["lower"]), np.array(arena["upper"])
    error = s.plan.tracking  # except for the floor, on which drones stand
    gaps = [(each - lower)[k] - radius - error for each in x for k in range(2)]
    gaps += [(-each + upper)[k] - radius - error for each in x for k in range(2)]
    gaps += [(-each + upper)[2] - error * s.plan.ratio for each in x]
    return minimum(*gaps, *(each[2] - lower[2] - depth for each in x))
