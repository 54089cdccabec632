"""Fewer pieces for the same curves: Hermite ends, least squares inside.

On every new piece the curves meet the plan's positions and first derivatives at both ends, so that
what is exported is as smooth across its pieces as the plan; the coefficients that this leaves free
are those nearest to the plan. Errors that decide where to put the ends are taken at points; the
certificate verifies the result over all time.

Pieces end as far on as an error allows, one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, exp, floor, inf, log
from typing import NamedTuple

import numpy as np

from hitchopt.exports.recording import lasted
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

NODES = 25
"""Points of a piece at which the plan is met in the least squares, and errors are taken."""


CROWD = 200
"""Drones that are evaluated when ends are placed: larger teams are thinned out evenly."""

BISECTIONS = 9
"""Bisections of the logarithm of the error: enough to distinguish 31 pieces from 32."""

COARSEST, FINEST = 30.0, 1e-3
"""Errors over their scale between which is searched."""


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
    """Return the curves (D, 3) on few pieces, at rest after their own end.

    Parameters
    ----------
    curves: from t = 0.
    breaks: (pieces + 1,) [s], the new ones.
    kind: kind of the new pieces.
    """
    curves = lasted(curves, float(breaks[-1]))
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


def greedy_breaks(
    error: Callable[[float, float], float],
    duration: float,
    kind: Kind,
    bound: float,
    most: float = inf,
) -> Array | None:
    """Return breaks from 0 to ``duration``, rounded up to a quantum; None if they are too many.

    Every piece lasts as long as its error stays within ``bound``, or as short as it may.

    Parameters
    ----------
    error: error of one piece, from start to end [s].
    duration: duration of the curves [s].
    kind: kind of the pieces.
    bound: largest error of a piece.
    most: largest number of pieces.
    """
    last = max(1, ceil(duration / kind.quantum - 1e-9))
    longest = max(1, floor(kind.longest / kind.quantum))
    shortest = max(1, ceil(kind.shortest / kind.quantum - 1e-9))
    ticks = [0]
    stride = max(1, last // 8)

    def fits(stride: int) -> bool:
        return error(ticks[-1] * kind.quantum, (ticks[-1] + stride) * kind.quantum) <= bound

    while ticks[-1] < last:
        if len(ticks) > most:
            return None
        remaining = last - ticks[-1]
        stride = max(shortest, _farthest(fits, min(remaining, longest), stride))
        if remaining - stride < shortest:  # the last piece would be too short
            stride = remaining - shortest if stride < remaining >= 2 * shortest else remaining
        ticks.append(ticks[-1] + stride)
    return np.array(ticks) * kind.quantum


def _farthest(fits: Callable[[int], bool], most: int, guess: int) -> int:
    """Return the longest stride that fits, by doubling from a guess and bisection."""
    good, bad = 1, most + 1
    stride = min(guess, most)
    while good < stride < bad:
        if not fits(stride):
            bad = stride
            break
        good = stride
        stride = min(2 * stride, most)
    while good < most and bad - good > max(1, good // 64):
        middle = (good + bad) // 2
        if fits(middle):
            good = middle
        else:
            bad = middle
    return good


def best_breaks(curves: PiecewisePolynomial, kind: Kind, most: int) -> Array | None:
    """Return the breaks of at most so many pieces with the smallest error, from FINEST on.

    There are none where the error is beyond COARSEST.
    """
    found = breaks_within(curves, kind, FINEST, most)
    best = breaks_within(curves, kind, COARSEST, most) if found is None else found
    if best is None or found is not None:
        return best
    low, high = log(FINEST), log(COARSEST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        found = breaks_within(curves, kind, exp(middle), most)
        if found is None:
            low = middle
        else:
            best, high = found, middle
    return best


def breaks_within(
    curves: PiecewisePolynomial,
    kind: Kind,
    bound: float,
    most: float = inf,
    scale: Scale | None = None,
) -> Array | None:
    """Return the breaks of pieces whose errors stay within ``bound``; None if they are too many.

    No more than CROWD drones are evaluated.
    """
    end = ceil(float(curves.breaks[-1]) / kind.quantum) * kind.quantum
    step = max(1, curves.shape[0] // CROWD)
    some = PiecewisePolynomial(curves.breaks, curves.coefficients[:, ::step])
    error = SpanErrors(lasted(some, end), kind, scale or Scale())
    return greedy_breaks(error, float(curves.breaks[-1]), kind, bound, most)
