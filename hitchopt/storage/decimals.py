"""Text of many numbers with twelve significant digits, as ``"%#.12g"`` writes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

NUMBER = "%#.12g"
"""Twelve significant digits, with a decimal point: readers such as polars infer integers from the
first rows otherwise."""

WIDTH = 24
"""Bytes of a number with its separator; unused ones are zero, and are deleted from the text."""

EXPONENTS = range(-250, 3)
"""Decimal exponents of numbers that are formatted in arrays; Python formats the others."""

ROUNDING_ERROR = 1e-3
"""Bound of the error of a number times a power of ten, near 1e12: two roundings are below 3e-4.
Python formats numbers that are closer to the middle of two texts."""

Bytes = NDArray[np.uint8]


def formatted(values: Array) -> Bytes:
    """Return the texts (…, WIDTH) of numbers (…), each after a comma; a nan is empty."""
    flat = values.reshape(-1)
    size = np.abs(flat)
    with np.errstate(all="ignore"):  # numbers that Python formats
        exponent = np.floor(np.log10(size))
        nearest = np.clip(exponent, EXPONENTS[0], EXPONENTS[-1])
        row = np.where(size > 0.0, nearest - EXPONENTS[0], -EXPONENTS[0]).astype(np.intp)
        scaled = size * _SCALE[row]
        digits = np.rint(scaled)
        known = (exponent == nearest) & (np.abs(scaled - digits) < 0.5 - ROUNDING_ERROR)
        known &= (digits >= 1e11) & (digits < 1e12)  # else the exponent is another one
        digits[~known] = 0.0
        known |= size == 0.0
    # Integers of at most twelve digits, and zeros behind them: exact, and so are the quotients.
    leading = np.floor(digits / _UNIT[row])
    trailing = (digits - leading * _UNIT[row]) * _SHIFT[row]
    upper = np.floor(trailing / 1e8)
    text = np.empty((len(flat), WIDTH // 8), np.uint64)
    text[:, 0] = _HEADS[leading.astype(np.intp) + 1000 * np.signbit(flat)]
    quarters = text.view(np.uint32)
    for column, half in ((2, upper), (4, trailing - upper * 1e8)):
        first, second = np.divmod(half.astype(np.uint32), np.uint32(10_000))
        quarters[:, column] = _QUADS[first]
        quarters[:, column + 1] = _QUADS[second]
    for column, mask, end in zip((1, 2), _MASKS, _ENDS, strict=True):
        text[:, column] &= np.take(mask, row)
        text[:, column] |= np.take(end, row)
    out = text.view(np.uint8)
    for i in np.flatnonzero(~known):
        each = "" if np.isnan(flat[i]) else NUMBER % flat[i]
        out[i] = np.frombuffer(f",{each}".encode().ljust(WIDTH, b"\0"), np.uint8)
    return out.reshape(*values.shape, WIDTH)


def padded(texts: Sequence[str]) -> Bytes:
    """Return texts as rows of bytes of equal length, which end with zeros."""
    encoded = [text.encode() for text in texts]
    width = max(map(len, encoded))
    return _rows([each.ljust(width, b"\0") for each in encoded])


def _rows(texts: Sequence[bytes]) -> Bytes:
    return np.frombuffer(b"".join(texts), np.uint8).reshape(len(texts), -1)


FIXED = -4  # Smallest exponent of numbers that are written without one

_QUADS = _rows([b"%04d" % i for i in range(10_000)]).view(np.uint32)[:, 0]  # Four digits

_HEADS = _rows(
    [f",{sign}{i}.".encode().ljust(8, b"\0") for sign in ("", "-") for i in range(1000)]
).view(np.uint64)[:, 0]
"""Comma, sign, and digits up to the point."""

_FRACTION = [11 - k if k >= FIXED else 11 for k in EXPONENTS]
"""Number of digits after the point, by exponents."""

_SCALE = np.array([float(f"1e{11 - k}") for k in EXPONENTS])
_UNIT = np.array([10.0**count for count in _FRACTION])
_SHIFT = np.array([10.0 ** (16 - count) for count in _FRACTION])
"""Factors by exponents: to twelve digits before the point, the point's position in these, and to
sixteen digits after the point."""

_MASKS = _rows([(b"\xff" * count).ljust(16, b"\0") for count in _FRACTION]).view(np.uint64).T.copy()
_ENDS = (
    _rows([b"\0" * 11 + (b"" if k >= FIXED else b"e%03d" % k).ljust(5, b"\0") for k in EXPONENTS])
    .view(np.uint64)
    .T.copy()
)
"""Bytes of the digits after the point that are written, and exponents behind them."""
