"""Slowing of a flight until it satisfies its limits between all samples too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.hitch import Team
from hitchopt.hitch.statics import cable_forces
from hitchopt.planners.timing.demands import FINAL_SHARE, Demands, loads_at_rest
from hitchopt.planners.timing.turning_stretch import turning_stretch
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

SPANS = 8
"""Number of spans of a piece on which its rates are enclosed: within about 0.1 %."""

ENCLOSING = 8
"""Number of coefficients on a span: those of the drones' septic pieces."""

CHUNK = 20_000
"""Number of coefficients of drones that are processed in one go."""


def needed_stretch(
    team: Team,
    limits: Limits,
    drones: PiecewisePolynomial,
    vertices: PiecewisePolynomial,
    pulls: PiecewisePolynomial,
) -> float:
    """Return how many times slower a flight must be to satisfy its limits.

    Rates are not sampled but enclosed: a vector polynomial stays within the hull of its
    coefficients, which lie close to it on a short span of time.

    Parameters
    ----------
    drones, vertices: of shapes (2n, 3) and (n, 3) [m], on common breaks.
    pulls: of shape (2n,) [N], of the cables on the drones.
    """
    breaks, h = drones.breaks, drones.durations
    inner = np.linspace(0.0, 1.0, SPANS * ENCLOSING)
    size = max(1, CHUNK // (len(inner) * len(team.mass)))
    factors = []
    for first in range(0, len(h), size):  # a thousand robots fill the memory
        span = slice(first, first + size)
        x, p, pull = (
            _combined(part.coefficients[span], bernstein.basis(inner, part.degree))
            for part in (drones, vertices, pulls)
        )
        forces = cable_forces(team, x, p, pull, np.ones(team.robots))
        rates = [_rates(drones, span, order) for order in (1, 2, 3)]
        demands = Demands(
            np.moveaxis(np.stack([x, *rates]), 0, -1),
            np.max(length(_rates(vertices, span, 1)), axis=1),
            loads_at_rest(team, forces),
            team.mass,
            team.max_thrust,
            limits,
            FINAL_SHARE,
        )
        factors.append(demands.stretch())
    taut = PiecewisePolynomial.constant(breaks, np.ones(team.robots))
    return turning_stretch(team, limits.body_rate, (drones, vertices, pulls, taut), max(factors))


def _rates(part: PiecewisePolynomial, pieces: slice, order: int) -> Array:
    """Return the coefficients (pieces · SPANS · ENCLOSING, items, 3) of a derivative by time.

    Of each of the pieces, on each of its SPANS spans in turn.
    """
    c, h = part.coefficients[pieces], part.durations[pieces]
    for _ in range(order):
        c = bernstein.differentiate(c)
    return _combined(c / h[:, None, None, None] ** order, _spans(bernstein.degree(c)))


def _combined(c: Array, rows: Array) -> Array:
    """Return combinations (pieces · J, *shape) of coefficients (pieces, *shape, m), rows (J, m)."""
    flat = c.reshape(len(c), -1, c.shape[-1])
    return (rows @ np.swapaxes(flat, 1, 2)).reshape(-1, *c.shape[1:-1])


@lru_cache
def _spans(order: int) -> Array:
    """(SPANS · ENCLOSING, order + 1): maps coefficients on a piece to those on its spans."""
    same = bernstein.elevate(np.eye(order + 1), ENCLOSING - 1)[:, None]
    starts = np.arange(SPANS) / SPANS
    spans: Array = bernstein.restrict(same, starts, starts + 1.0 / SPANS)
    spans = spans.reshape(order + 1, -1).T
    spans.setflags(write=False)
    return spans
