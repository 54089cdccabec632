"""Local parameters of times within pieces, and weights of values and derivatives there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

MAX_STORED_TIMES = 500  # Maximum number of times for which the weights of jets are stored: 0.1 MB


def locate(breaks: Array, times: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the pieces (…) of times (…), and the local parameters (…) in them, from 0 to 1."""
    first, last = breaks[0], breaks[-1]
    if not np.all((times >= first - 1e-9) & (times <= last + 1e-9)):
        raise InputError(
            "t", times, f"within [{first:g}, {last:g}] s", "pass times within the plan"
        )
    piece = np.clip(np.searchsorted(breaks, times, side="right") - 1, 0, len(breaks) - 2)
    return piece, np.clip((times - breaks[piece]) / np.diff(breaks)[piece], 0.0, 1.0)


def _weights(
    breaks: bytes, times: bytes, shape: tuple[int, ...], order: int, count: int
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the weights of ``PiecewisePolynomial.jet``, which only depend on breaks and times.

    Parameters
    ----------
    breaks, times: bytes of the arrays, which are hashable.
    shape: shape of the times, (…).
    order: degree of the pieces.
    count: number of derivatives, the zeroth included.

    Returns
    -------
    Pieces (…), the basis (…, order + 1), and the basis with its derivatives (…, order + 1, count).
    """
    spans = np.frombuffer(breaks)
    piece, x = locate(spans, np.frombuffer(times).reshape(shape))
    weights = bernstein.jet_basis(x, order, count)
    weights /= np.diff(spans)[piece][..., None, None] ** np.arange(count)
    return piece, bernstein.basis(x, order), weights


_stored_weights = lru_cache(maxsize=64)(_weights)
"""``_weights`` with a cache: a search evaluates all of its paths on a few grids."""


def jet_weights(
    breaks: Array, times: Array, order: int, count: int
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return ``_weights`` for breaks (pieces + 1,) and times (…) [s], cached for few times."""
    weights = _stored_weights if times.size <= MAX_STORED_TIMES else _weights
    return weights(breaks.tobytes(), times.tobytes(), times.shape, order, count)
