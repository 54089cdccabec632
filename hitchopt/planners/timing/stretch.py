"""Slowing of a flight until it satisfies its limits between all samples too."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from hitchopt.geometry.vectors import column_lengths, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.statics import taut_forces
from hitchopt.planners.timing.demands import FINAL_SHARE, Demands
from hitchopt.planners.timing.turning_stretch import turning_stretch
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array, Indices

SPANS = 8
"""Number of spans of a piece on which its rates are enclosed: within about 0.1 %."""

ENCLOSING = 8
"""Number of coefficients on a span: those of the drones' septic pieces."""

CHUNK = 20_000
"""Number of coefficients of drones that are processed in one go."""

FIRST = 32
"""Number of pieces of drones that are looked at first, those of the largest bounds."""

LEAST = 1e-12
"""Smallest factor: nothing moves."""

ROUNDING = 2.0**-40
"""Relative rounding of bounds, with room to spare."""


def needed_stretch(
    team: Team,
    limits: Limits,
    drones: PiecewisePolynomial,
    vertices: PiecewisePolynomial,
    pulls: PiecewisePolynomial,
) -> float:
    """Return how many times slower a flight must be to satisfy its limits.

    Rates are not sampled but enclosed: a vector polynomial stays within the hull of its
    coefficients, which lie close to it on a short span of time. Only those drones are looked at so
    closely, on those pieces, for which the hull on the whole piece does not rule out that they
    decide.

    Parameters
    ----------
    drones, vertices: of shapes (2n, 3) and (n, 3) [m], on common breaks.
    pulls: of shape (2n,) [N], of the cables on the drones.
    """
    fastest = FINAL_SHARE * limits.vertex_speed

    def of_vertices(piece: Indices, vertex: Indices) -> float:
        """Return the factor that some vertices need on some pieces."""
        return float(np.max(length(_rates(vertices, piece, vertex, 1)))) / fastest

    def of_drones(piece: Indices, drone: Indices) -> float:
        """Return the factor that some drones need on some pieces, which count as drones here."""
        inner = np.linspace(0.0, 1.0, SPANS * ENCLOSING)
        pulled_to = team.layout.pulled_to[drone]
        x, p, pull = (
            np.moveaxis(
                bernstein.combined(
                    part.coefficients[piece, item], bernstein.basis(inner, part.degree)
                ),
                -1,
                0,
            )
            for part, item in ((drones, drone), (vertices, pulled_to), (pulls, drone))
        )
        mass = team.mass[drone]
        loads = mass[:, None] * np.array([0.0, 0.0, GRAVITY])
        if team.has_cables:
            loads = loads - taut_forces(x - p, pull, 0.5 * GRAVITY * team.cable_density)
        else:
            loads = np.broadcast_to(loads, x.shape)
        jets = [x, *(_rates(drones, piece, drone, order) for order in (1, 2, 3))]
        still = np.zeros(len(inner))
        most = team.max_thrust[drone]
        return Demands(np.stack(jets, -1), still, loads, mass, most, limits, FINAL_SHARE).stretch()

    (speeds,) = _hulls(vertices, 1)
    factor = _largest(speeds / fastest, LEAST, of_vertices)
    bounds = _bounds(team, limits, drones, vertices, pulls)
    factor = _largest(bounds, factor, of_drones)
    taut = PiecewisePolynomial.constant(drones.breaks, np.ones(team.robots))
    return turning_stretch(team, limits.body_rate, (drones, vertices, pulls, taut), factor)


def _largest(bounds: Array, known: float, exact: Callable[[Indices, Indices], float]) -> float:
    """Return the largest factor, or ``known`` if that is larger.

    Parameters
    ----------
    bounds: (pieces, items), not passed by the factors of each.
    exact: returns the largest factor of pieces (k,) of items (k,).
    """
    every = bounds.ravel()

    def looked_at(some: Indices) -> float:
        return exact(*np.divmod(some, bounds.shape[1]))

    if every.size > FIRST:
        first = np.argpartition(every, every.size - FIRST)[-FIRST:]
        known = max(known, looked_at(first))
    left = np.flatnonzero(~(every <= known))
    size = max(1, CHUNK // (SPANS * ENCLOSING))
    for start in range(0, len(left), size):
        known = max(known, looked_at(left[start : start + size]))
    return known


def _bounds(
    team: Team,
    limits: Limits,
    drones: PiecewisePolynomial,
    vertices: PiecewisePolynomial,
    pulls: PiecewisePolynomial,
) -> Array:
    """Return bounds (pieces, 2n) of the factors by which drones have to be slower.

    Infinite where a drone might not even be able to rest.
    """
    speed, acceleration, jerk = _hulls(drones, 3)
    # A force of the cable changes the thrust at rest, and its distance from limits, by no more.
    force = np.max(np.abs(pulls.coefficients), axis=-1) if team.has_cables else 0.0 * speed
    if team.cable_density > 0.0:
        order = max(drones.degree, vertices.degree)
        ends = vertices.elevated(order).coefficients[:, team.layout.pulled_to]
        spans = drones.elevated(order).coefficients - ends
        force = force + GRAVITY * team.cable_density * np.max(column_lengths(spans), axis=-1)
    weight = team.mass * GRAVITY
    upright = np.sin(FINAL_SHARE * limits.tilt) * weight - force
    spare = np.minimum(FINAL_SHARE * team.max_thrust - weight - force, upright)
    by_forces = np.full(speed.shape, math.inf)
    np.divide(team.mass * acceleration, spare, out=by_forces, where=spare > 0.0)
    by_acceleration = acceleration / (FINAL_SHARE * limits.acceleration)
    by_jerk = np.cbrt(jerk / (FINAL_SHARE * limits.jerk))
    by_others = np.maximum(speed / (FINAL_SHARE * limits.speed), by_jerk)
    slower: Array = np.maximum(by_others, np.sqrt(np.maximum(by_forces, by_acceleration)))
    return slower


def _hulls(part: PiecewisePolynomial, orders: int) -> list[Array]:
    """Return bounds (pieces, items) of the norms of derivatives by time, from the first one on."""
    c, h = part.coefficients, part.durations[:, None]
    size = max(1, CHUNK // math.prod(c.shape[1:]))
    hulls = [np.empty(c.shape[:2]) for _ in range(orders)]
    for first in range(0, len(c), size):  # a thousand robots fill the memory
        some = c[first : first + size]
        for hull in hulls:
            some = bernstein.differentiate(some)
            hull[first : first + size] = np.max(column_lengths(some), axis=-1)
    return [(1.0 + ROUNDING) * hull / h ** (k + 1) for k, hull in enumerate(hulls)]


def _rates(part: PiecewisePolynomial, piece: Indices, item: Indices, order: int) -> Array:
    """Return the coefficients (SPANS · ENCLOSING, k, 3) of a derivative by time of some items.

    On each of the SPANS spans of their pieces in turn.
    """
    c = part.coefficients[piece, item]
    for _ in range(order):
        c = bernstein.differentiate(c)
    c = c / part.durations[piece, None, None] ** order
    return np.moveaxis(bernstein.combined(c, _spans(bernstein.degree(c))), -1, 0)


@lru_cache
def _spans(order: int) -> Array:
    """(SPANS · ENCLOSING, order + 1): maps coefficients on a piece to those on its spans."""
    same = bernstein.elevate(np.eye(order + 1), ENCLOSING - 1)[:, None]
    starts = np.arange(SPANS) / SPANS
    spans: Array = bernstein.restrict(same, starts, starts + 1.0 / SPANS)
    spans = spans.reshape(order + 1, -1).T
    spans.setflags(write=False)
    return spans
