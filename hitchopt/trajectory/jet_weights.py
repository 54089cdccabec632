"""Places of times in pieces, and the weights of values and derivatives there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

MAX_STORED_TIMES = 500
"""Maximum number of times for which the weights of jets are stored: 0.1 MB."""


def places(breaks: Array, times: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the pieces (…) of times (…), and their places in them (…), from 0 to 1."""
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
    """Return the weights of ``PiecewisePolynomial.jet``, which depend on breaks and times alone.

    Parameters
    ----------
    breaks, times: memory of the arrays, which is hashable.
    shape: of the times, (…).
    order: degree of the pieces.
    count: of derivatives.

    Returns
    -------
    (…), the pieces; (…, order + 1), the basis; (…, order + 1, count), it and its derivatives.
    """
    spans = np.frombuffer(breaks)
    piece, x = places(spans, np.frombuffer(times).reshape(shape))
    weights = bernstein.jet_basis(x, order, count)
    weights /= np.diff(spans)[piece][..., None, None] ** np.arange(count)
    return piece, bernstein.basis(x, order), weights


_stored_weights = lru_cache(maxsize=64)(_weights)
"""``_weights`` with a cache: a search uses a few grids on all of its paths."""


def jet_weights(
    breaks: Array, times: Array, order: int, count: int
) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the pieces of times, and the weights of coefficients there, as ``_weights``.

    Parameters
    ----------
    breaks: (pieces + 1,) [s]
    times: (…) [s]
    order: degree of the pieces.
    count: of derivatives, the zeroth included.
    """
    weights = _stored_weights if times.size <= MAX_STORED_TIMES else _weights
    return weights(breaks.tobytes(), times.tobytes(), times.shape, order, count)
