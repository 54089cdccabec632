"""Compiled bounds of what cables have to satisfy, one cell at a time."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.enclosure_kernels import length
from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import (
    Found,
    add_product,
    column_norms,
    elevated,
    inner,
    rows_elevated,
    value_at,
    values_at,
)
from hitchopt.compiled.thrust_kernels import angle_of
from hitchopt.values import Array, Indices

_SIGNS = np.array([1.0, 1.0, 1.0, -1.0])


@kernel
def balance(
    rows: Array,
    pulls: Array,
    along: Array,
    wrong: Array,
    place: Indices,
    numbers: tuple[float, float, float],
    enough: float,
) -> Found:
    """Return bound, value and place as the bound of ``equilibrium``, of clasps without loads.

    Parameters
    ----------
    rows, pulls: blocks of the cell.
    along, wrong: directions (m, 3, ·) and their errors (m,).
    place: (4,), the indices of this cell's.
    numbers: as of a search.
    enough: no value is computed where the bound is no larger.
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
        if not reach <= bound:
            bound, x = reach, k / max(1, order)
    if bound <= enough:
        return bound, -np.inf, x
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
def lengths(rows: Array, stored: Array, weights: Array, space: Array, enough: float) -> Found:
    """Return bound, value and place as the bound of ``cable_length``, of straight cables.

    Parameters
    ----------
    space: memory of enclosures.
    enough: no value is computed where the bound is no larger.
    """
    nodes = weights.shape[1]
    order = max(nodes, stored.shape[1]) - 1
    excess, given, part = np.full(order + 1, -1.0), rows_elevated(stored, order), np.empty(nodes)
    errors, bound, x = 0.0, 0.0, 0.0
    for i in range(3):
        error = length(part, rows[3 * i : 3 * i + 3], weights, space)
        whole, errors = elevated(part, order), errors + error
        for k in range(order + 1):
            excess[k] += whole[k]
            if i < 2:
                given[i, k] = abs(given[i, k] - whole[k]) + error
    for k in range(order + 1):
        reach = max(abs(excess[k]) + errors, given[0, k], given[1, k])
        if not reach <= bound:
            bound, x = reach, k / max(1, order)
    if bound <= enough:
        return bound, -np.inf, x
    there, legs, left, value = values_at(rows, x), values_at(stored, x), -1.0, 0.0
    for i in range(3):
        vector = there[3 * i : 3 * i + 3]
        size = np.sqrt(inner(vector, vector))
        left += size
        if i < 2:
            value = max(value, abs(legs[i] - size))
    return bound, max(value, abs(left)), x


@kernel
def turns(rows: Array, added: float, numbers: tuple[float, float, float]) -> Found:
    """Return bound, value and place as the bound of ``convexity``."""
    noise, short, rounding = numbers[0], numbers[1], numbers[2]
    degree = 2 * (rows.shape[1] - 1)
    along, right = np.zeros(degree + 1), np.zeros(degree + 1)
    add_product(along, 1.0, rows[0], rows[2])
    add_product(along, 1.0, rows[1], rows[3])
    add_product(right, 1.0, rows[1], rows[2])
    add_product(right, -1.0, rows[0], rows[3])
    x0, y0 = value_at(along, 0.5), value_at(right, 0.5)
    size = np.hypot(x0, y0)
    x0, y0 = (x0 / size, y0 / size) if size > 0.0 else (0.0, 0.0)  # as without direction
    least, turned, most, sizes, x, low = np.inf, np.inf, -np.inf, 0.0, 0.0, -180.0
    for k in range(degree + 1):
        ahead, aside = x0 * along[k] + y0 * right[k], x0 * right[k] - y0 * along[k]
        least = min(least, ahead)
        most = max(most, aside / ahead)
        if aside / ahead < turned:  # of no use unless all are ahead
            turned, x = aside / ahead, k / max(1, degree)
    for i in range(4):
        sizes += np.max(np.abs(rows[i]))
    spread = np.degrees(4.0 * (rounding * np.max(np.abs(rows)) + noise) * sizes / least)
    wedge = least > 0.0 and spread < 1.0
    if wedge:
        start = np.degrees(np.arctan2(y0, x0))
        low = start + np.degrees(np.arctan(turned)) - spread
        wedge = start + np.degrees(np.arctan(most)) + spread < 180.0
    if not wedge:
        turned = np.inf
        for k in range(degree + 1):
            angle = np.arctan2(right[k], along[k])
            if angle < turned:
                turned, x = angle, k / max(1, degree)
    bx, by, ax, ay = values_at(rows, x)
    value = -180.0
    if min(np.hypot(bx, by), np.hypot(ax, ay)) > short:
        value = angle_of(by * ax - bx * ay, bx * ax + by * ay)
    return added + low if wedge and low > -180.0 else -180.0, added + value, x


@kernel
def band(pull: Array, least: float, most: float) -> Found:
    """Return bound, value and place as the bound of ``tension``, of legs without friction."""
    bound, at = -np.inf, 0
    for k in range(len(pull)):
        beyond = max(pull[k] - most, least - pull[k])
        if not beyond <= bound:
            bound, at = beyond, k
    x = at / max(1, len(pull) - 1)
    here = value_at(pull, x)
    return max(bound, 0.0), max(here - most, least - here, 0.0), x
