"""Piecewise polynomials written on other breaks, so that several can be compared piece by piece."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hitchopt.trajectory import bernstein
from hitchopt.trajectory.piecewise import PiecewisePolynomial
from hitchopt.values import Array

SAME_BREAK = 1e-7
"""[s] Breaks closer than this count as one. Beyond its break by so little, a piece that joins
smoothly is off by its jump in jerk times 1e-21 s³, far below rounding."""


def merged_breaks(each: Sequence[Array]) -> Array:
    """Return all breaks in order; of those within SAME_BREAK of an earlier one's, the former.

    Parameters
    ----------
    each: (pieces + 1,) [s]; the first of them remain whatever the others are.
    """
    merged = np.asarray(each[0], dtype=np.float64)
    for breaks in each[1:]:
        at = np.searchsorted(merged, breaks)
        before = np.abs(breaks - merged[np.maximum(at - 1, 0)])
        after = np.abs(breaks - merged[np.minimum(at, len(merged) - 1)])
        merged = np.union1d(merged, breaks[np.minimum(before, after) > SAME_BREAK])
    return merged


def on_breaks(part: PiecewisePolynomial, breaks: Array) -> PiecewisePolynomial:
    """Return the same functions on ``breaks`` (within the part's), each within one of its pieces.

    Exact but for rounding, and for what lies within SAME_BREAK of the part's own breaks.
    """
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    piece = np.clip(np.searchsorted(part.breaks, middles, side="right") - 1, 0, part.pieces - 1)
    start, h = part.breaks[piece], part.durations[piece]
    lower = np.clip((breaks[:-1] - start) / h, 0.0, 1.0)
    upper = np.clip((breaks[1:] - start) / h, 0.0, 1.0)
    lower[np.abs(breaks[:-1] - start) <= SAME_BREAK] = 0.0
    upper[np.abs(breaks[1:] - part.breaks[piece + 1]) <= SAME_BREAK] = 1.0
    axes = (-1, *(1,) * len(part.shape))
    coefficients = part.coefficients[piece]
    whole = (lower == 0.0) & (upper == 1.0)
    if not np.all(whole):
        cut = ~whole
        coefficients[cut] = bernstein.restrict(
            coefficients[cut], lower[cut].reshape(axes), upper[cut].reshape(axes)
        )
    return PiecewisePolynomial(breaks, coefficients)
