"""Refit curves with fewer pieces, and round their control points.

**Fewer pieces.** Every new piece interpolates the plan's position and first derivatives at both
ends, so that the exported curve is as smooth across pieces as the plan. The remaining coefficients
are a least-squares fit. Each piece is as long as the error bound allows. Errors are evaluated at
points; the certificate verifies the result over all time.

**Joint rounding.** Independent rounding moves control points by half a quantum, and neighbours in
opposite directions: over a piece of degree N and h seconds that is up to ``N / h`` quanta per
second of velocity. Therefore each control point is rounded after compensation for the errors of the
previous ones, by least squares (Babai's nearest plane) in a norm of the errors of position,
velocity and acceleration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, exp, floor, inf, log
from typing import NamedTuple

import numpy as np

from hitchopt.exports.contents import held_until
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

FIT_POINTS = 25  # Points of a piece for the least-squares fit and the evaluation of errors
MAX_FIT_DRONES = 200  # Drones that determine breaks; of larger teams a uniform sample
BISECTIONS = 9  # Bisections of the logarithm of the error, enough to tell 31 pieces from 32
MAX_ERROR = 1.0  # Largest error of the search, over its scale
MIN_ERROR = 1e-3  # Smallest error of the search, over its scale


class Scale(NamedTuple):
    """Errors of equal weight."""

    position: float = 1e-3  # [m]
    velocity: float = 1e-2  # [m/s]
    acceleration: float = 1e-1  # [m/s²]


@dataclass(frozen=True)
class PieceKind:
    """The kind of pieces of a format."""

    degree: int
    interpolated: int  # number of derivatives at both ends equal to the plan's, with the zeroth
    quantum: float  # durations are multiples of it [s]
    max_duration: float  # of a piece [s]
    min_duration: float = 0.0  # of a piece, which takes precedence over its error [s]
    scale: Scale = Scale()  # noqa: RUF009 - a tuple


def fit_pieces(curves: PiecewisePolynomial, breaks: Array, kind: PieceKind) -> PiecewisePolynomial:
    """Return the curves (D, 3), from t = 0, on pieces of a kind, constant after their end."""
    curves = held_until(curves, float(breaks[-1]))
    pieces = [_fit_piece(curves, kind, start, end)[0].T for start, end in pairwise(breaks.tolist())]
    shape = (len(pieces), *curves.shape, kind.degree + 1)
    return PiecewisePolynomial(breaks, np.reshape(pieces, shape))


def _fit_piece(
    curves: PiecewisePolynomial, kind: PieceKind, start: float, end: float
) -> tuple[Array, float]:
    """Return the coefficients (N + 1, D * 3) of one piece, and its largest error over the scale."""
    h = end - start
    count = kind.interpolated
    basis, hermite, solver = _matrices(kind.degree, count)
    # Values and two derivatives by the piece's parameter, (3, FIT_POINTS, D * 3).
    jet = np.moveaxis(curves.jet(start + bernstein.nodes(FIT_POINTS - 1) * h, 3), -1, 0)
    target = jet.reshape(3, FIT_POINTS, -1) * h ** np.arange(3.0)[:, None, None]
    c = hermite @ np.concatenate([target[:count, 0], target[:count, -1]])
    c[count : kind.degree + 1 - count] += solver @ (target[0] - basis[0] @ c)
    squares = np.sum(((basis @ c - target) ** 2).reshape(3, FIT_POINTS, -1, 3), axis=-1)
    errors = np.sqrt(np.max(squares, axis=(1, 2))) / (kind.scale * h ** np.arange(3.0))
    return c, float(np.max(errors))


@lru_cache
def _matrices(degree: int, count: int) -> tuple[Array, Array, Array]:
    """Return the basis with two derivatives at the points (3, FIT_POINTS, N + 1), and two matrices.

    The first matrix gives coefficients from ``count`` derivatives at both ends, the second one the
    free coefficients from residuals.
    """
    x = bernstein.nodes(FIT_POINTS - 1)
    basis = np.stack([bernstein.derivative_basis(x, degree, order) for order in range(3)])
    unit = np.eye(2 * count)[:, None]
    ends = PiecewisePolynomial.hermite([0.0, 1.0], unit[:count], unit[count:])
    solver = np.linalg.pinv(basis[0][:, count : degree + 1 - count])
    return basis, np.array(ends.elevated(degree).coefficients[0].T), solver


def fit_breaks(
    curves: PiecewisePolynomial, kind: PieceKind, bound: float, max_pieces: float = inf
) -> Array:
    """Return the breaks of pieces with errors up to ``bound``, from 0 to the end of the curves.

    The end is rounded up to a quantum. Every piece is as long as its error allows, but not shorter
    than the minimum. The search stops after ``max_pieces`` + 1 pieces.
    """
    last = max(1, ceil(curves.duration / kind.quantum - 1e-9))
    max_duration = max(1, floor(kind.max_duration / kind.quantum))
    min_duration = max(1, ceil(kind.min_duration / kind.quantum - 1e-9))
    step = max(1, curves.shape[0] // MAX_FIT_DRONES)
    sample = PiecewisePolynomial(curves.breaks, curves.coefficients[:, ::step])
    sample = held_until(sample, last * kind.quantum)
    ticks = [0]
    stride = max(1, last // 8)

    def fits(stride: int) -> bool:
        span = (ticks[-1] * kind.quantum, (ticks[-1] + stride) * kind.quantum)
        return _fit_piece(sample, kind, *span)[1] <= bound

    while ticks[-1] < last and len(ticks) <= max_pieces + 1:
        remaining = last - ticks[-1]
        stride = max(min_duration, _longest_stride(fits, min(remaining, max_duration), stride))
        if remaining - stride < min_duration:  # the last piece would be too short
            is_split = stride < remaining >= 2 * min_duration
            stride = remaining - min_duration if is_split else remaining
        ticks.append(ticks[-1] + stride)
    return np.array(ticks) * kind.quantum


def _longest_stride(fits: Callable[[int], bool], max_stride: int, guess: int) -> int:
    """Return the longest stride that fits, by doubling from a guess and bisection."""
    good = 1
    bad = max_stride + 1
    stride = min(guess, max_stride)
    while good < max_stride and bad - good > max(1, good // 64):
        if stride > good:
            good, bad = (stride, bad) if fits(stride) else (good, stride)
        stride = min(2 * good, max_stride) if bad > max_stride else (good + bad) // 2
    return good


def best_breaks(curves: PiecewisePolynomial, kind: PieceKind, max_pieces: int) -> Array:
    """Return the breaks of ``max_pieces`` with the smallest error; more if MAX_ERROR needs more."""
    finest = fit_breaks(curves, kind, MIN_ERROR, max_pieces)
    if len(finest) - 1 <= max_pieces:
        return finest
    best = fit_breaks(curves, kind, MAX_ERROR, max_pieces)
    if len(best) - 1 > max_pieces:
        return best
    low, high = log(MIN_ERROR), log(MAX_ERROR)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        breaks = fit_breaks(curves, kind, exp(middle), max_pieces)
        if len(breaks) - 1 > max_pieces:
            low = middle
        else:
            best, high = breaks, middle
    return best


def round_points(curves: PiecewisePolynomial, quantum: float, scale: Scale) -> PiecewisePolynomial:
    """Return continuous curves (D, 3) with coefficients rounded to multiples of ``quantum`` [m].

    ``scale`` weights the rounding errors.
    """
    exact = curves.coefficients / quantum
    counts = np.empty_like(exact)
    last = np.rint(exact[0, ..., 0])
    nodes, weights = np.polynomial.legendre.leggauss(curves.degree + 1)
    x = 0.5 * (nodes + 1.0)
    bases = [bernstein.derivative_basis(x, curves.degree, order) for order in range(len(scale))]
    for piece, h in enumerate(curves.durations.tolist()):
        gram = np.zeros((len(x), len(x)))  # of the basis, for errors over the piece
        for order, (basis, size) in enumerate(zip(bases, scale, strict=True)):
            values = basis / (size * h**order)
            gram += values.T @ (0.5 * weights[:, None] * values)
        counts[piece] = _nearest_integers(exact[piece], last, gram)
        last = counts[piece, ..., -1]
    return PiecewisePolynomial(curves.breaks, counts * quantum)


def _nearest_integers(exact: Array, first: Array, gram: Array) -> Array:
    """Return integers (…, N + 1) close to ``exact`` in the norm, with a prescribed first one."""
    # With G = L Lᵀ the error's norm is |Lᵀ e|: row i of Lᵀ has e_i and the following errors. The
    # coefficient that is rounded last is then the first of the basis, so the order is reversed.
    factor = np.linalg.cholesky(gram[::-1, ::-1]).T
    c = exact[..., ::-1]
    size = c.shape[-1]
    errors = np.zeros_like(c)
    counts = np.empty_like(c)
    for i in range(size - 1, -1, -1):
        target = c[..., i] - errors[..., i + 1 :] @ factor[i, i + 1 :] / factor[i, i]
        counts[..., i] = first if i == size - 1 else np.rint(target)
        errors[..., i] = counts[..., i] - c[..., i]
    return counts[..., ::-1]
