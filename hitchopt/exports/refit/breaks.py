"""Where to put the ends of few pieces: as far on as an error allows, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from hitchopt.exports.recording import lasted
from hitchopt.exports.refit.pieces import Kind, Scale, SpanErrors
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

CROWD = 200
"""Drones that are looked at when ends are placed: every so-manieth of larger teams."""

BISECTIONS = 9
"""Of the logarithm of the error: enough to tell 31 pieces from 32."""

COARSEST, FINEST = 30.0, 1e-3
"""Errors over their scale between which is searched."""


def greedy_breaks(
    error: Callable[[float, float], float], duration: float, kind: Kind, bound: float, most: int
) -> Array | None:
    """Return breaks from 0 to ``duration``, rounded up to a quantum; None if they are too many.

    Every piece lasts as long as its error stays within ``bound``, or as short as it may.

    Parameters
    ----------
    error: of one piece, from start to end [s].
    duration: of the curves [s].
    kind: of the pieces.
    bound: of the error.
    most: pieces that there may be.
    """
    last = max(1, ceil(duration / kind.quantum - 1e-9))
    longest = max(1, floor(kind.longest / kind.quantum))
    shortest = max(1, ceil(kind.shortest / kind.quantum - 1e-9))
    ticks = [0]
    stride = max(1, last // 8)
    while ticks[-1] < last:
        if len(ticks) > most:
            return None
        here = ticks[-1]
        limit = min(last, here + longest)
        stride = max(shortest, _farthest(error, kind.quantum, here, limit, bound, stride))
        remaining = last - here
        if remaining - stride < shortest:  # the last piece would be too short
            stride = remaining - shortest if stride < remaining >= 2 * shortest else remaining
        ticks.append(here + stride)
    return np.array(ticks) * kind.quantum


def _farthest(
    error: Callable[[float, float], float],
    quantum: float,
    here: int,
    limit: int,
    bound: float,
    guess: int,
) -> int:
    """Return the longest stride whose error is within the bound, by doubling and bisection."""

    def fits(stride: int) -> bool:
        return error(here * quantum, (here + stride) * quantum) <= bound

    most = limit - here
    good, bad = 1, most + 1
    stride = min(guess, most)
    while good < stride < bad:
        if not fits(stride):
            bad = stride
            break
        good = stride
        stride = min(2 * stride, most)
    if good == most:
        return good
    while bad - good > max(1, good // 64):
        middle = (good + bad) // 2
        if fits(middle):
            good = middle
        else:
            bad = middle
    return good


def best_breaks(
    curves: PiecewisePolynomial,
    kind: Kind,
    most: int,
    scale: Scale | None = None,
    finest: float = FINEST,
) -> Array | None:
    """Return the breaks of at most so many pieces with the smallest error, from ``finest`` on.

    None if there are none within COARSEST.
    """
    duration = float(curves.breaks[-1])
    error = span_error(curves, kind, scale)

    def breaks(bound: float) -> Array | None:
        return greedy_breaks(error, duration, kind, bound, most)

    found = breaks(finest)
    if found is not None:
        return found
    best = breaks(COARSEST)
    if best is None:
        return None
    low, high = np.log(finest), np.log(COARSEST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        found = breaks(float(np.exp(middle)))
        if found is None:
            low = middle
        else:
            best, high = found, middle
    return best


def span_error(curves: PiecewisePolynomial, kind: Kind, scale: Scale | None = None) -> SpanErrors:
    """Return what tells the error of one piece, looking at no more than CROWD drones."""
    end = ceil(float(curves.breaks[-1]) / kind.quantum) * kind.quantum
    step = max(1, curves.shape[0] // CROWD)
    some = PiecewisePolynomial(curves.breaks, curves.coefficients[:, ::step])
    return SpanErrors(lasted(some, end), kind, scale or Scale())
