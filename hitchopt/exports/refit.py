"""Fewer pieces for the same curves, and their control points rounded.

**Fewer pieces.** On every new piece the curves meet the plan's positions and first derivatives at
both ends, so that what is exported is as smooth across its pieces as the plan; the coefficients
that this leaves free are those nearest to the plan. Pieces end as far on as an error allows, one
after the other; errors are taken at points, the certificate verifies the result over all time.

**Rounded together.** A control point rounded on its own is off by half a quantum, its neighbour by
as much in the opposite direction: over a piece of degree N and h seconds that is up to ``N / h``
quanta a second of velocity. So each is rounded with the errors of those before it in mind: among
the remaining real coefficients the ones that make up best for them are found by least squares
(Babai's nearest plane), in a norm of the errors of position, velocity and acceleration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, exp, floor, inf, log
from typing import NamedTuple

import numpy as np

from hitchopt.exports.recording import held_until
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

NODES = 25  # Points of a piece at which the plan is met in the least squares, and errors are taken
CROWD = 200  # Drones that are evaluated when ends are placed: larger teams are thinned out evenly
BISECTIONS = 9  # Bisections of the logarithm of the error: enough to distinguish 31 pieces from 32
COARSEST, FINEST = 1.0, 1e-3  # Errors over their scale between which is searched


class Scale(NamedTuple):
    """Errors that weigh alike."""

    position: float = 1e-3  # [m]
    velocity: float = 1e-2  # [m/s]
    acceleration: float = 1e-1  # [m/s²]


@dataclass(frozen=True)
class Kind:
    """A format's kind of pieces."""

    degree: int
    match: int  # how many derivatives, from the position on, are the plan's at both ends
    quantum: float  # durations are whole multiples of it [s]
    longest: float  # duration of a piece [s]
    shortest: float = 0.0  # duration of a piece, whatever its error [s]; whole curves may be so
    scale: Scale = Scale()  # noqa: RUF009 - a tuple


def fitted(curves: PiecewisePolynomial, breaks: Array, kind: Kind) -> PiecewisePolynomial:
    """Return the curves (D, 3), from t = 0, on pieces of a kind; at rest after their own end."""
    curves = held_until(curves, float(breaks[-1]))
    pieces = [_piece(curves, kind, start, end)[0].T for start, end in pairwise(breaks.tolist())]
    shape = (len(pieces), *curves.shape, kind.degree + 1)
    return PiecewisePolynomial(breaks, np.reshape(pieces, shape))


def _piece(
    curves: PiecewisePolynomial, kind: Kind, start: float, end: float
) -> tuple[Array, float]:
    """Return the coefficients (N + 1, D * 3) of one piece, and its largest error over the scale."""
    h, match = end - start, kind.match
    basis, hermite, solver = _matrices(kind.degree, match)
    # By the span's own parameter: values and two derivatives, (3, NODES, D * 3).
    jet = np.moveaxis(curves.jet(start + bernstein.nodes(NODES - 1) * h, 3), -1, 0)
    wanted = jet.reshape(3, NODES, -1) * h ** np.arange(3.0)[:, None, None]
    c = hermite @ np.concatenate([wanted[:match, 0], wanted[:match, -1]])
    c[match : kind.degree + 1 - match] += solver @ (wanted[0] - basis[0] @ c)
    squares = np.sum(((basis @ c - wanted) ** 2).reshape(3, NODES, -1, 3), axis=-1)
    errors = np.sqrt(np.max(squares, axis=(1, 2))) / (kind.scale * h ** np.arange(3.0))
    return c, float(np.max(errors))


@lru_cache
def _matrices(degree: int, match: int) -> tuple[Array, Array, Array]:
    """Return the basis at the nodes and two derivatives of it (3, NODES, N + 1), and two matrices.

    They give the coefficients of derivatives at both ends, and the free ones of what is missing.
    """
    x = bernstein.nodes(NODES - 1)
    basis = np.stack([bernstein.derivative_basis(x, degree, order) for order in range(3)])
    unit = np.eye(2 * match)[:, None]
    ends = PiecewisePolynomial.hermite([0.0, 1.0], unit[:match], unit[match:])
    solver = np.linalg.pinv(basis[0][:, match : degree + 1 - match])
    return basis, np.array(ends.elevated(degree).coefficients[0].T), solver


def breaks_within(
    curves: PiecewisePolynomial, kind: Kind, bound: float, most: float = inf
) -> Array:
    """Return the breaks of pieces whose errors stay within ``bound``, from 0 to the curves' end.

    The end is rounded up to a quantum. Every piece lasts as long as its error allows, or as short
    as it may. Pieces beyond ``most`` are not placed: more than so many are too many.
    """
    last = max(1, ceil(curves.duration / kind.quantum - 1e-9))
    longest = max(1, floor(kind.longest / kind.quantum))
    shortest = max(1, ceil(kind.shortest / kind.quantum - 1e-9))
    step = max(1, curves.shape[0] // CROWD)
    some = PiecewisePolynomial(curves.breaks, curves.coefficients[:, ::step])
    some = held_until(some, last * kind.quantum)
    ticks, stride = [0], max(1, last // 8)

    def fits(stride: int) -> bool:
        span = (ticks[-1] * kind.quantum, (ticks[-1] + stride) * kind.quantum)
        return _piece(some, kind, *span)[1] <= bound

    while ticks[-1] < last and len(ticks) <= most + 1:
        remaining = last - ticks[-1]
        stride = max(shortest, _farthest(fits, min(remaining, longest), stride))
        if remaining - stride < shortest:  # the last piece would be too short
            stride = remaining - shortest if stride < remaining >= 2 * shortest else remaining
        ticks.append(ticks[-1] + stride)
    return np.array(ticks) * kind.quantum


def _farthest(fits: Callable[[int], bool], most: int, guess: int) -> int:
    """Return the longest stride that fits, by doubling from a guess and bisection."""
    good, bad, stride = 1, most + 1, min(guess, most)
    while good < most and bad - good > max(1, good // 64):
        if stride > good:
            good, bad = (stride, bad) if fits(stride) else (good, stride)
        stride = min(2 * good, most) if bad > most else (good + bad) // 2
    return good


def best_breaks(curves: PiecewisePolynomial, kind: Kind, most: int) -> Array:
    """Return the breaks of at most so many pieces with the smallest error; else more of them."""
    if len(best := breaks_within(curves, kind, FINEST, most)) - 1 <= most:
        return best
    best, low, high = breaks_within(curves, kind, COARSEST, most), log(FINEST), log(COARSEST)
    for _ in range(BISECTIONS if len(best) - 1 <= most else 0):
        middle = 0.5 * (low + high)
        if len(breaks := breaks_within(curves, kind, exp(middle), most)) - 1 > most:
            low = middle
        else:
            best, high = breaks, middle
    return best


def rounded(curves: PiecewisePolynomial, quantum: float, scale: Scale) -> PiecewisePolynomial:
    """Return the curves (D, 3) with coefficients multiples of ``quantum`` [m], joined exactly.

    ``scale`` has the errors of rounding that weigh alike.
    """
    wanted = curves.coefficients / quantum
    counts = np.empty_like(wanted)
    last = np.rint(wanted[0, ..., 0])
    for piece, h in enumerate(curves.durations):
        counts[piece] = _nearest(wanted[piece], last, _gram(curves.degree, float(h), scale))
        last = counts[piece, ..., -1]
    return PiecewisePolynomial(curves.breaks, counts * quantum)


def _nearest(wanted: Array, first: Array, gram: Array) -> Array:
    """Return integers (…, N + 1) near to ``wanted`` in the norm, the first of them given."""
    # With G = L Lᵀ the error's norm is |Lᵀ e|: row i of Lᵀ holds e_i and those after it. The last
    # coefficient to be chosen is thus the first one of the basis, so the order is turned round.
    factor = np.linalg.cholesky(gram[::-1, ::-1]).T
    c = wanted[..., ::-1]
    size = c.shape[-1]
    errors = np.zeros_like(c)
    counts = np.empty_like(c)
    for i in range(size - 1, -1, -1):
        aim = c[..., i] - errors[..., i + 1 :] @ factor[i, i + 1 :] / factor[i, i]
        counts[..., i] = first if i == size - 1 else np.rint(aim)
        errors[..., i] = counts[..., i] - c[..., i]
    return counts[..., ::-1]


def _gram(degree: int, h: float, scale: Scale) -> Array:
    """Return the basis's Gram matrix (N + 1, N + 1) for errors over a piece of ``h`` seconds."""
    nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
    x = 0.5 * (nodes + 1.0)
    gram = np.zeros((degree + 1, degree + 1))
    for order, size in enumerate(scale):
        values = bernstein.derivative_basis(x, degree, order) / (size * h**order)
        gram += values.T @ (0.5 * weights[:, None] * values)
    return gram
