"""Tensions of edges over those of legs that lean against clasp friction."""

from __future__ import annotations

import numpy as np

from hitchopt.values import Array

PASSES = 6
"""Times that the angle which cables wrap and the ratio are computed from each other."""

SOFT = 0.05
"""Cosines of half of the angle between legs that are this far below the largest one count fully."""

TINY = 1e-12
"""Keeps quotients of friction finite where there is none."""


def edge_ratios(friction: Array, edges: Array, legs: Array, apart: float) -> Array:
    """Return tensions of edges over those of their legs (…, n) where legs lean.

    At a clasp both enclose ``β`` with ``cos(β_legs/2) = λ cos(β_edges/2)``. Legs that would come
    too near to each other lean less, and of both clasps of a cable the lesser friction counts.

    Parameters
    ----------
    friction: (…), coefficient of cables on each other that counts; negative where clasps open.
    edges: (…, n) [rad], between edges at clasps.
    legs: (…, n) [m], lengths of cables' legs.
    apart: how far neighbouring drones have to be apart [m].
    """
    rubbing, sign = np.abs(friction)[..., None], np.sign(friction)[..., None]
    cosine = np.cos(0.5 * edges)
    shorter = np.minimum(legs, np.roll(legs, 1, axis=-1))
    most = np.sqrt(np.maximum(1.0 - (0.5 * apart / shorter) ** 2, 0.1))
    ratio = np.ones_like(cosine)
    for _ in range(PASSES):
        wrapped = 0.5 * edges + np.arccos(np.clip(ratio * cosine, -1.0, 1.0))
        ratio = _below(np.exp(-sign * rubbing * wrapped) * cosine, most) / _below(cosine, most)
    one = np.abs(np.log(ratio)) + TINY
    other = np.roll(one, -1, axis=-1)
    lesser = one * other / (0.5 * (one**8 + other**8)) ** 0.125
    ratios: Array = np.exp(-sign * lesser)
    return ratios


def _below(values: Array, most: Array) -> Array:
    """Return values that smoothly stay below others, as they are where they are far below."""
    start = most - SOFT
    over: Array = np.maximum(values - start, 0.0)
    return values - over + SOFT * np.tanh(over / SOFT)
