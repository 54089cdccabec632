"""Samples over time packed into text: 16 bits each, differenced twice, deflated, in base64.

A page decodes them (``page/samples.js``). Smooth motion has small second differences, and so packs
to about a third.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from hitchopt.values import Array

LEVELS = 65535
"""Largest 16-bit number."""


def packed(arrays: Mapping[str, Array]) -> tuple[list[dict[str, Any]], str]:
    """Return a description of arrays, ready for JSON, and their samples as text.

    Every sample is off by at most half of its axis's range over ``LEVELS``.

    Parameters
    ----------
    arrays: by name, (times, …, axes); all values of an axis share one range.
    """
    entries, planes = [], []
    for name, array in arrays.items():
        axes = array.shape[-1]
        flat = np.reshape(array, (-1, axes))
        lower = np.min(flat, axis=0, initial=np.inf) if len(flat) else np.zeros(axes)
        upper = np.max(flat, axis=0, initial=-np.inf) if len(flat) else np.ones(axes)
        step = np.where(upper > lower, (upper - lower) / LEVELS, 1.0)
        levels = np.rint((array - lower) / step).astype(np.int64)
        columns = np.reshape(levels, (len(array), -1))
        twice = np.diff(columns, n=2, axis=0, prepend=np.zeros((2, columns.shape[1]), np.int64))
        words = twice.T.astype(np.uint16)  # wraps around, as the page's sums do
        planes += [(part.astype(np.uint8)).tobytes() for part in (words & 255, words >> 8)]
        entries.append(
            {
                "name": name,
                "columns": columns.shape[1],
                "lower": lower.tolist(),
                "step": step.tolist(),
            }
        )
    return entries, base64.b64encode(zlib.compress(b"".join(planes), 9)).decode("ascii")
