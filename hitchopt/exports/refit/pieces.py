"""Fewer pieces for the same curves: Hermite ends, least squares inside.

On every new piece the curves meet the plan's positions and first derivatives at both ends, so that
what is exported is as smooth across its pieces as the plan; the coefficients that this leaves free
are those nearest to the plan. Errors that decide where to put the ends are taken at points; the
certificate verifies the result over all time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

NODES = 25
"""Points of a piece at which the plan is met in the least squares, and errors are taken."""


@dataclass(frozen=True)
class Kind:
    """A format's kind of pieces.

    Attributes
    ----------
    degree: degree of every piece.
    match: how many derivatives, from the position on, are the plan's at both ends.
    quantum: durations are whole multiples of it [s].
    longest: longest duration of a piece [s].
    shortest: shortest duration of a piece, whatever its error [s]; whole curves may be shorter.
    """

    degree: int
    match: int
    quantum: float
    longest: float
    shortest: float = 0.0

    def __post_init__(self) -> None:
        if self.degree + 1 < 2 * self.match:
            raise ValueError("more is to be met at the ends than there are coefficients")

    @property
    def free(self) -> slice:
        """Coefficients that the ends leave free."""
        return slice(self.match, self.degree + 1 - self.match)


class Scale(NamedTuple):
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
    kind: kind of the new pieces.
    """
    ends = np.stack([curves.at(breaks, order) for order in range(kind.match)])
    hermite = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
    coefficients = np.array(bernstein.elevate(hermite.coefficients, kind.degree))
    x = bernstein.nodes(NODES - 1)
    basis = bernstein.basis(x, kind.degree)
    for c, start, h in zip(coefficients, breaks, np.diff(breaks), strict=False):
        # Hermite's own coefficients inside are a first guess; the rest is least squares.
        missing = np.moveaxis(curves.at(start + x * h), 0, -1) - c @ basis.T
        c[..., kind.free] += missing @ _solver(kind).T
    return PiecewisePolynomial(breaks, coefficients)


class SpanErrors:
    """The error of one piece over any span of time.

    Parameters
    ----------
    curves: (D, 3) [m]
    kind: kind of the piece.
    scale: errors that weigh alike.
    """

    def __init__(self, curves: PiecewisePolynomial, kind: Kind, scale: Scale) -> None:
        self._curves, self._kind, self._scale = curves, kind, scale
        self._x = bernstein.nodes(NODES - 1)
        self._basis = [bernstein.derivative_basis(self._x, kind.degree, i) for i in range(3)]

    def __call__(self, start: float, end: float) -> float:
        """Return the largest error over the scale, of any drone at the nodes of [start, end]."""
        h = end - start
        # By the span's own parameter: values and two derivatives, (3, NODES, D * 3).
        jet = np.moveaxis(self._curves.jet(start + self._x * h, 3), -1, 0)
        wanted = jet.reshape(3, NODES, -1) * h ** np.arange(3.0)[:, None, None]
        match = self._kind.match
        c = _hermite(self._kind) @ np.concatenate([wanted[:match, 0], wanted[:match, -1]])
        c[self._kind.free] += _solver(self._kind) @ (wanted[0] - self._basis[0] @ c)
        worst = 0.0
        for order, scale in enumerate(self._scale):
            missing = (self._basis[order] @ c - wanted[order]).reshape(-1, 3)
            size = float(np.max(np.einsum("ij,ij->i", missing, missing))) ** 0.5
            worst = max(worst, size / (scale * h**order))
        return worst


@lru_cache
def _solver(kind: Kind) -> Array:
    """Return the matrix (free, NODES) from what is missing at the nodes to free coefficients."""
    matrix = bernstein.basis(bernstein.nodes(NODES - 1), kind.degree)[:, kind.free]
    return np.asarray(np.linalg.pinv(matrix), dtype=np.float64)


@lru_cache
def _hermite(kind: Kind) -> Array:
    """Return the matrix (degree + 1, 2 match) from the left and right end's derivatives."""
    unit = np.eye(2 * kind.match)[:, None]
    ends = PiecewisePolynomial.hermite([0.0, 1.0], unit[: kind.match], unit[kind.match :])
    return np.array(ends.elevated(kind.degree).coefficients[0].T)
