"""Compiled bounds of what cables have to satisfy, one cell at a time."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import (
    Found,
    add_product,
    column_norms,
    elevated,
    inner,
    length,
    product,
    rows_elevated,
    value_at,
    values_at,
)
from hitchopt.compiled.thrust_kernels import angle_of
from hitchopt.values import Array, Indices

_SIGNS = np.array([1.0, 1.0, 1.0, -1.0])


@kernel
def balance(
    rows: Array, pulls: Array, along: Array, wrong: Array, place: Indices, numbers: Array
) -> Found:
    """Return bound, value and place as the bound of ``equilibrium``, of clasps without loads.

    Parameters
    ----------
    rows, pulls: blocks of the cell.
    along, wrong: directions (m, 3, ·) and their errors (m,).
    place: (4,), the indices of this cell's.
    numbers: as of a search.
    """
    short, rounding = numbers[1], numbers[2]
    order = along.shape[2] + pulls.shape[1] - 2
    residual, errors = np.zeros((3, order + 1)), np.full(2, rounding)
    for i in range(4):
        errors[i // 2] += wrong[place[i]]
        for j in range(3):
            add_product(residual[j], _SIGNS[i], along[place[i], j], pulls[i // 2])
    tension, norms = rows_elevated(pulls, order), column_norms(residual)
    sizes = rows_elevated(np.abs(pulls), order)
    norms += sizes[0] * errors[0] + sizes[1] * errors[1]
    least = np.minimum(tension[0], tension[1])
    pulling, bound, x = np.max(least) > 0.0, -np.inf, 0.0
    for k in range(order + 1):
        reach = norms[k] / least[k] if least[k] > 0.0 else np.inf
        if pulling and norms[k] == 0.0 and least[k] == 0.0:
            reach = 0.0
        if reach > bound:
            bound, x = reach, k / max(1, order)
    there, P = values_at(rows, x), values_at(pulls, x)
    total, unknown = np.zeros(3), 0.0
    for i in range(4):
        vector, force = there[3 * i : 3 * i + 3], _SIGNS[i] * P[i // 2]
        size = np.sqrt(inner(vector, vector))
        if size > short:
            total += vector / size * force
        else:
            unknown += abs(force)
    left, weakest = np.sqrt(inner(total, total)) + unknown, min(P[0], P[1])
    if pulling and left == 0.0 and weakest == 0.0:
        return bound, 0.0, x
    return bound, left / weakest if weakest > 0.0 else np.inf, x


@kernel
def lengths(rows: Array, stored: Array, weights: Array) -> Found:
    """Return bound, value and place as the bound of ``cable_length``, of straight cables."""
    order = max(weights.shape[1], stored.shape[1]) - 1
    excess, given, errors = np.full(order + 1, -1.0), rows_elevated(stored, order), np.zeros(3)
    for i in range(3):
        part, errors[i] = length(rows[3 * i : 3 * i + 3], weights)
        part = elevated(part, order)
        excess += part
        if i < 2:
            given[i] = np.abs(given[i] - part) + errors[i]
    reach = np.maximum(np.abs(excess) + np.sum(errors), np.maximum(given[0], given[1]))
    k = np.argmax(reach)
    x = k / max(1, order)
    there, legs, left, value = values_at(rows, x), values_at(stored, x), -1.0, 0.0
    for i in range(3):
        vector = there[3 * i : 3 * i + 3]
        size = np.sqrt(inner(vector, vector))
        left += size
        if i < 2:
            value = max(value, abs(legs[i] - size))
    return max(reach[k], 0.0), max(value, abs(left)), x


@kernel
def turns(rows: Array, added: float, numbers: Array) -> Found:
    """Return bound, value and place as the bound of ``convexity``."""
    noise, short, rounding = numbers[0], numbers[1], numbers[2]
    along = product(rows[0], rows[2]) + product(rows[1], rows[3])
    right = product(rows[1], rows[2]) - product(rows[0], rows[3])
    x0, y0 = value_at(along, 0.5), value_at(right, 0.5)
    ahead, aside = x0 * along + y0 * right, x0 * right - y0 * along
    relative, start = np.degrees(np.arctan2(aside, ahead)), np.degrees(np.arctan2(y0, x0))
    least, sizes = np.min(ahead) / np.hypot(x0, y0), 0.0
    for i in range(4):
        sizes += np.max(np.abs(rows[i]))
    spread = 4.0 * (rounding * np.max(np.abs(rows)) + noise)
    spread = np.degrees(spread * sizes / least)
    low, high = start + np.min(relative) - spread, start + np.max(relative) + spread
    wedge = least > 0.0 and spread < 1.0 and high < 180.0
    k = np.argmin(relative if wedge else np.arctan2(right, along))
    x = k / max(1, len(along) - 1)
    bx, by, ax, ay = values_at(rows, x)
    value = -180.0
    if min(np.hypot(bx, by), np.hypot(ax, ay)) > short:
        value = angle_of(by * ax - bx * ay, bx * ax + by * ay)
    return added + low if wedge and low > -180.0 else -180.0, added + value, x


@kernel
def band(pull: Array, least: float, most: float) -> Found:
    """Return bound, value and place as the bound of ``tension``, of legs without friction."""
    k = np.argmax(np.maximum(pull - most, least - pull))
    x = k / max(1, len(pull) - 1)
    here = value_at(pull, x)
    bound = max(np.max(pull) - most, least - np.min(pull))
    return max(bound, 0.0), max(here - most, least - here, 0.0), x
