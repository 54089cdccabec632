"""Fewer pieces for the same curves: Hermite ends, least squares inside.

On every new piece the curves meet the plan's positions and first derivatives at both ends, so that
what is exported is as smooth across its pieces as the plan; the coefficients that this leaves free
are those nearest to the plan. Errors that decide where to put the ends are taken at points; whether
the result will do is for the certificate to say, over all time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np
from numpy.typing import NDArray

from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

NODES = 25
"""Points of a piece at which the plan is met in the least squares, and errors are taken."""


@dataclass(frozen=True)
class Kind:
    """What the pieces of a format are.

    Attributes
    ----------
    degree: of every piece.
    match: how many derivatives, from the position on, are the plan's at both ends.
    quantum: durations are whole multiples of it [s].
    longest: that a piece may last [s].
    shortest: that a piece may last, whatever its error [s]; whole curves may be shorter.
    """

    degree: int
    match: int
    quantum: float
    longest: float
    shortest: float = 0.0

    def __post_init__(self) -> None:
        if self.degree + 1 < 2 * self.match:
            raise ValueError("more is to be met at the ends than there are coefficients")


@dataclass(frozen=True)
class Scale:
    """Errors that weigh alike: of position [m], velocity [m/s] and acceleration [m/s²]."""

    position: float = 1e-3
    velocity: float = 1e-2
    acceleration: float = 1e-1


def fitted(curves: PiecewisePolynomial, breaks: Array, kind: Kind) -> PiecewisePolynomial:
    """Return the curves (D, 3) on few pieces.

    Parameters
    ----------
    curves: from t = 0 to at least the last break.
    breaks: (pieces + 1,) [s], the new ones.
    kind: of the new pieces.
    """
    ends = np.stack([curves.at(breaks, order) for order in range(kind.match)])
    hermite = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
    coefficients = np.array(bernstein.elevate(hermite.coefficients, kind.degree))
    free = kind.degree + 1 - 2 * kind.match
    if free > 0:
        x = bernstein.nodes(NODES - 1)
        inside = np.arange(kind.match, kind.degree + 1 - kind.match)
        # Hermite's own coefficients there are a first guess; the rest is least squares.
        solve = _solver(kind.degree, kind.match)
        for piece in range(len(breaks) - 1):
            a, b = breaks[piece], breaks[piece + 1]
            wanted = curves.at(a + x * (b - a))
            c = coefficients[piece]
            missing = wanted - np.moveaxis(c @ bernstein.basis(x, kind.degree).T, -1, 0)
            c[..., inside] += np.moveaxis(np.tensordot(solve, missing, 1), 0, -1)
    return PiecewisePolynomial(breaks, coefficients)


@lru_cache
def _solver(degree: int, match: int) -> Array:
    """(free, NODES): from what is missing at the nodes to the free coefficients."""
    inside = slice(match, degree + 1 - match)
    matrix = bernstein.basis(bernstein.nodes(NODES - 1), degree)[:, inside]
    return np.asarray(np.linalg.pinv(matrix), dtype=np.float64)


class SpanErrors:
    """How well one piece does over any span of time.

    Parameters
    ----------
    curves: (D, 3) [m]
    kind: of the piece.
    scale: of errors.
    """

    def __init__(self, curves: PiecewisePolynomial, kind: Kind, scale: Scale) -> None:
        self._rates = [curves.differentiated(order) for order in range(3)]
        self._kind = kind
        self._scale = (scale.position, scale.velocity, scale.acceleration)
        self._x = bernstein.nodes(NODES - 1)
        n, m = kind.degree, kind.match
        self._basis = [_derivative_basis(self._x, n, order) for order in range(3)]
        self._free = _solver(n, m) if n + 1 > 2 * m else None
        self._left, self._right = _hermite(n, m)

    def __call__(self, start: float, end: float) -> float:
        """Return the largest error over the scale, of any drone at the nodes of [start, end]."""
        h = end - start
        t = start + self._x * h
        wanted = [self._values(order, t) for order in range(3)]  # (NODES, D, 3) each
        m = self._kind.match
        ends = [np.stack([wanted[k][i] * h**k for k in range(m)]).reshape(m, -1) for i in (0, -1)]
        c = self._left @ ends[0] + self._right @ ends[1]  # (degree + 1, D * 3)
        flat = [values.reshape(len(t), -1) for values in wanted]
        if self._free is not None:
            c[m : self._kind.degree + 1 - m] += self._free @ (flat[0] - self._basis[0] @ c)
        worst = 0.0
        for order, scale in enumerate(self._scale):
            missing = (self._basis[order] @ c / h**order - flat[order]).reshape(-1, 3)
            worst = max(
                worst, float(np.max(np.einsum("ij,ij->i", missing, missing))) ** 0.5 / scale
            )
        return worst

    def _values(self, order: int, t: Array) -> Array:
        rate = self._rates[order]
        piece = np.clip(np.searchsorted(rate.breaks, t, side="right") - 1, 0, rate.pieces - 1)
        x = np.clip((t - rate.breaks[piece]) / rate.durations[piece], 0.0, 1.0)
        weights = bernstein.basis(x, rate.degree)
        values: Array = np.einsum("tn,tdin->tdi", weights, rate.coefficients[piece])
        return values


def _derivative_basis(x: Array, degree: int, order: int) -> Array:
    """(nodes, degree + 1): the order-th derivative by the local parameter of every basis."""
    rows = np.eye(degree + 1)
    for _ in range(order):
        rows = bernstein.differentiate(rows)
    basis: Array = bernstein.basis(x, rows.shape[-1] - 1) @ rows.T
    return basis


@lru_cache
def _hermite(degree: int, match: int) -> tuple[Array, Array]:
    """(degree + 1, match) each: coefficients from local derivatives at the left and right end."""
    order = 2 * match - 1
    left, right = np.zeros((order + 1, match)), np.zeros((order + 1, match))
    for end, sign, matrix in ((0, 1, left), (order, -1, right)):
        for j in range(match):
            step = sign**j * factorial(order - j) / factorial(order)
            for i in range(j, match):
                matrix[end + sign * i, j] = bernstein.binomials(i)[j] * step
    up = bernstein.elevation(order, degree)
    return up @ left, up @ right
