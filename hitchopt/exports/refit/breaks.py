"""Ends of few pieces: each as far on as an error allows, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, exp, floor, inf, log

import numpy as np

from hitchopt.exports.recording import lasted
from hitchopt.exports.refit.pieces import Kind, Scale, SpanErrors, fitted
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

CROWD = 200
"""Drones that are evaluated when ends are placed: larger teams are thinned out evenly."""

BISECTIONS = 9
"""Bisections of the logarithm of the error: enough to distinguish 31 pieces from 32."""

COARSEST, FINEST = 30.0, 1e-3
"""Errors over their scale between which is searched."""


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


def refitted(curves: PiecewisePolynomial, breaks: Array, kind: Kind) -> PiecewisePolynomial:
    """Return the curves on these pieces, at rest after their own end."""
    return fitted(lasted(curves, float(breaks[-1])), breaks, kind)
