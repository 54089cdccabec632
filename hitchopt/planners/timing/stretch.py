"""How many times slower a flight must be so that it keeps its limits between all samples too."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import length
from hitchopt.hitch import Team
from hitchopt.hitch.statics import cable_forces
from hitchopt.planners.timing.demands import Demands, loads_at_rest
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

FINAL_SHARE = 0.9995
"""Share of the limits that the polynomials' enclosures may use; the certificate, which bounds
them by other means, has the rest to itself."""

SPANS = 8
"""Of a piece, on which its rates are enclosed: within about 0.1 %."""

ENCLOSING = 8
"""Coefficients on a span: those of the drones' septic pieces."""

CHUNK = 60_000
"""Coefficients of drones that are looked at in one go."""


class Timed(Protocol):
    """Drones, vertices and pulls on common breaks; as a Motion."""

    @property
    def drones(self) -> PiecewisePolynomial:
        """Of shape (2n, 3) [m]."""

    @property
    def vertices(self) -> PiecewisePolynomial:
        """Of shape (n, 3) [m]."""

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Of shape (2n,) [N], of the cables on the drones."""


def needed_stretch(team: Team, limits: Limits, flight: Timed) -> float:
    """Return how many times slower the flight must be to keep its limits.

    Rates are not sampled but enclosed: a vector polynomial stays within the hull of its
    coefficients, which lie close to it on a short span of time.
    """
    breaks, h = flight.drones.breaks, flight.drones.durations
    inner = np.linspace(0.0, 1.0, SPANS * ENCLOSING)
    size = max(1, CHUNK // (len(inner) * len(team.mass)))
    factors = []
    for first in range(0, len(h), size):  # a thousand robots fill the memory
        span = slice(first, first + size)
        at = breaks[:-1][span, None] + h[span, None] * inner
        demands = Demands(
            np.stack([_rates(flight.drones, span, order) for order in range(4)], axis=-1),
            np.max(length(_rates(flight.vertices, span, 1)), axis=1),
            _loads(team, flight, at.ravel()),
            team.mass,
            team.max_thrust,
            limits,
            FINAL_SHARE,
        )
        factors.append(demands.stretch())
    return max(factors)


def _rates(part: PiecewisePolynomial, pieces: slice, order: int) -> Array:
    """Return the coefficients (pieces · SPANS · ENCLOSING, items, 3) of a derivative by time.

    Of each of the pieces, on each of its SPANS spans in turn.
    """
    c, h = part.coefficients[pieces], part.durations[pieces]
    for _ in range(order):
        c = bernstein.differentiate(c)
    c = c / h[:, None, None, None] ** order
    rates = c @ _spans(bernstein.degree(c)).T
    return np.moveaxis(rates, -1, 1).reshape(-1, *rates.shape[1:-1])


@lru_cache
def _spans(order: int) -> Array:
    """(SPANS · ENCLOSING, order + 1): from coefficients on a piece to those on its spans."""
    same = bernstein.elevate(np.eye(order + 1), ENCLOSING - 1)[:, None]
    starts = np.arange(SPANS) / SPANS
    spans: Array = bernstein.restrict(same, starts, starts + 1.0 / SPANS)
    spans = spans.reshape(order + 1, -1).T
    spans.setflags(write=False)
    return spans


def _loads(team: Team, flight: Timed, t: Array) -> Array:
    """Return the thrust at rest (times, 2n, 3) [N] of what the polynomials say at t."""
    places = flight.drones.at(t), flight.vertices.at(t)
    return loads_at_rest(
        team, cable_forces(team, *places, flight.pulls.at(t), np.ones(team.robots))
    )
