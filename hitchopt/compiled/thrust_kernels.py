"""Compiled bounds of thrust and tilt, one drone on one span of time."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import (
    Blocks,
    Found,
    add_product,
    combined,
    inner,
    largest_column,
    rows_elevated,
    value_at,
    values_at,
)
from hitchopt.values import Array, Indices

NEAR = 1e-9
"""Relative margin for rounding in comparing angles by their tangents."""


@kernel
def _enclosed(blocks: Blocks, along: Array, error: float) -> tuple[Array, float]:
    """Return a thrust and its error, as ``thrust_enclosure``, given the leg's direction."""
    free, _, pull, slop = blocks
    most = 0.0
    out = rows_elevated(free, along.shape[1] + pull.shape[1] - 2)
    for i in range(3):
        add_product(out[i], 1.0, along[i], pull[0])
    for k in range(pull.shape[1]):
        most = max(most, abs(pull[0, k]))
    return out, most * error + slop[0, 0]


@kernel
def _thrust_at(blocks: Blocks, x: float, short: float) -> tuple[Array, float]:
    """Return a thrust at x and by how much it may be off, as ``thrust_at``."""
    force, leg, tension = (
        values_at(blocks[0], x),
        values_at(blocks[1], x),
        value_at(blocks[2][0], x),
    )
    size = np.sqrt(inner(leg, leg))
    return (force + tension * leg / size, 0.0) if size > short else (force, abs(tension))


@kernel
def _spread(radius: float, size: float) -> float:
    """Return by how much a ball of a radius can turn a direction [deg]."""
    ratio = radius / size if size > radius else 1.0
    return float(np.degrees(np.arcsin(ratio))) if ratio < 1.0 else 180.0


@kernel
def angle_of(across: float, upward: float) -> float:
    """Return the angle from +z in the half plane of (across, upward) [deg]."""
    return float(np.degrees(np.arctan2(across, upward)))


@kernel
def _beyond_horizon(f: Array, radius: float) -> float:
    """Return the bound of ``tilt_bound`` for thrusts that may point below the horizon."""
    middle = values_at(f[:2], 0.5)
    size = np.sqrt(middle[0] ** 2 + middle[1] ** 2)
    azimuth = middle / size if size > 0.0 else np.zeros(2)
    level, least = -np.inf, np.inf
    for k in range(f.shape[1]):
        across = azimuth[0] * f[0, k] + azimuth[1] * f[1, k]
        spread = _spread(radius, np.hypot(across, f[2, k]))
        level = max(level, angle_of(across, f[2, k]) + spread)
        least = min(least, across - radius)
    return max(level, 90.0) if least > 0.0 else 180.0


@kernel
def _leaning(f: Array, radius: float) -> tuple[float, float]:
    """Return the bound of ``tilt_bound`` and the place of the largest angle."""
    steepest, smallest, x = -1.0, np.inf, 0.0
    for k in range(f.shape[1]):
        flat = np.sqrt(f[0, k] ** 2 + f[1, k] ** 2)
        ratio = flat / f[2, k] if f[2, k] > 0.0 else np.inf
        smallest = min(smallest, flat**2 + f[2, k] ** 2)
        if ratio > steepest:
            steepest, x = ratio, k / max(1, f.shape[1] - 1)
    if not steepest < np.inf:
        return _beyond_horizon(f, radius), _lowest(f)
    # What is less steep by more than the radius can turn anything decides nothing.
    least = angle_of(steepest, 1.0) - _spread(radius, np.sqrt(smallest))
    least = (1.0 - NEAR) * np.tan(np.radians(least)) if least > 0.0 else 0.0
    upright = -np.inf
    for k in range(f.shape[1]):
        flat = np.sqrt(f[0, k] ** 2 + f[1, k] ** 2)
        if flat >= least * f[2, k]:
            spread = _spread(radius, np.sqrt(flat**2 + f[2, k] ** 2))
            upright = max(upright, angle_of(flat, f[2, k]) + spread)
    return (upright if upright < 90.0 else _beyond_horizon(f, radius)), x


@kernel
def _lowest(f: Array) -> float:
    """Return the place of the largest angle from vertical."""
    most, x = -np.inf, 0.0
    for k in range(f.shape[1]):
        angle = angle_of(np.sqrt(f[0, k] ** 2 + f[1, k] ** 2), f[2, k])
        if angle > most:
            most, x = angle, k / max(1, f.shape[1] - 1)
    return x


@kernel
def tilt(blocks: Blocks, along: Array, error: float, short: float, enough: float) -> Found:
    """Return bound, value and place as ``tilt_bound``, given the leg's direction.

    No value is computed where the bound is no larger than ``enough``.
    """
    f, radius = _enclosed(blocks, along, error)
    bound, x = _leaning(f, radius)
    if bound <= enough:
        return bound, -np.inf, x
    there, off = _thrust_at(blocks, x, short)
    size = np.sqrt(inner(there, there))
    if off >= size:
        return bound, 180.0, x
    angle = angle_of(np.sqrt(there[0] ** 2 + there[1] ** 2), there[2])
    return bound, min(angle + _spread(off, size), 180.0), x


@kernel
def thrust(blocks: Blocks, along: Array, error: float, short: float, enough: float) -> Found:
    """Return bound, value and place as ``thrust_bound``, given the leg's direction.

    No value is computed where the bound is no larger than ``enough``.
    """
    f, radius = _enclosed(blocks, along, error)
    size, x = largest_column(f)
    if size + radius <= enough:
        return size + radius, -np.inf, x
    there, off = _thrust_at(blocks, x, short)
    return size + radius, np.sqrt(inner(there, there)) + off, x


@kernel
def static_thrusts(
    blocks: Blocks, along: Array, errors: Array, place: Indices, lower: Array
) -> tuple[Array, Array]:
    """Return thrusts (cells, 3, ·) and errors (cells,) as ``thrust_enclosure`` and ``reduced``.

    Parameters
    ----------
    blocks: (cells, rows, ·) each, of ``thrust_cells``.
    along, errors: directions (m, 3, ·) and their errors (m,).
    place: (cells,), the index of each leg's.
    lower: as a search's weights, for polynomials of thrusts in the degree that they are reduced to.
    """
    count, order = len(blocks[0]), lower.shape[1] - 1
    thrusts, radii = np.empty((count, 3, order + 1)), np.empty(count)
    for c in range(count):
        cell = (blocks[0][c], blocks[1][c], blocks[2][c], blocks[3][c])
        found, radius = _enclosed(cell, along[place[c]], errors[place[c]])
        degree = found.shape[1] - 1
        thrusts[c] = combined(combined(found, lower[: degree + 1]), lower[degree + 1 :])
        lost = largest_column(rows_elevated(thrusts[c], degree) - found)
        radii[c] = radius + lost[0]
    return thrusts, radii
