"""Arrays as viser takes them: single precision, segments of lines, colours as bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

FADED, COLOUR_LEFT = (205, 208, 211), 0.2
"""Grey that pale things tend to, and the share of their own colour that is left."""


def single(values: Array) -> NDArray[np.float32]:
    """Return values in single precision, one after the other in memory."""
    return np.ascontiguousarray(values, dtype=np.float32)


def segments(curves: Array) -> NDArray[np.float32]:
    """Return the segments (m, 2, 3) of curves (n, points, 3)."""
    return single(np.stack([curves[:, :-1], curves[:, 1:]], axis=2).reshape(-1, 2, 3))


def per_segment(colours: NDArray[np.uint8], curves: Array) -> NDArray[np.uint8]:
    """Return colours (m, 2, 3) of the segments of curves, one colour each."""
    count = curves.shape[1] - 1
    return np.repeat(np.repeat(colours, count, axis=0)[:, None], 2, axis=1)


def as_bytes(colours: tuple[str, ...]) -> NDArray[np.uint8]:
    """Return colours such as #0b3c5d as bytes (…, 3)."""
    return np.array([list(bytes.fromhex(each[1:])) for each in colours], np.uint8).reshape(-1, 3)


def faded(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colours of which little is left, before the grey of what does not count any more."""
    mixed = COLOUR_LEFT * colours + (1.0 - COLOUR_LEFT) * np.array(FADED)
    return np.rint(mixed).astype(np.uint8)


def in_linear_light(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colours in linear light: viser takes those of lines to be."""
    share = colours / 255.0
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.rint(255.0 * light).astype(np.uint8)
