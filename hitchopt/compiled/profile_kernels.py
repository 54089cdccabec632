"""Compiled passes along a path's grid: what limits allow there, and the fastest motion from it."""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices


@kernel
def _dot(a: Array, b: Array) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def ray_ends(
    jets: Array, loads: Array, team: Array, limits: Array, rays: tuple[Array, Array]
) -> Array:
    """Return how far along rays every drone's limits hold; see ``Demands.reach``.

    Parameters
    ----------
    jets, loads: (J, drones, 3, 4) and (J, drones, 3), of ``Demands``.
    team: (2, drones), masses and largest thrusts that are planned.
    limits: acceleration that is planned, and 1 + tan² of the tilt.
    rays: (J, m) each, their s̈ and ṡ².
    """
    u, x = rays
    ends = np.empty(u.shape)
    squared, others = np.empty(u.shape[1]), np.empty(u.shape[1])
    for j in range(len(u)):
        shut = False
        squared[:], others[:] = 0.0, 0.0
        for d in range(jets.shape[1]):
            first, second, load, mass = jets[j, d, :, 1], jets[j, d, :, 2], loads[j, d], team[0, d]
            a, b, c = _dot(first, first), _dot(first, second), _dot(second, second)
            along, across = _dot(first, load), _dot(second, load)
            for k in range(u.shape[1]):
                s, t = u[j, k], x[j, k]
                squared[k] = max(squared[k], a * s * s + 2.0 * b * s * t + c * t * t)
            for tilted in range(2):
                slope = limits[1] if tilted == 1 else 0.0
                rest = _dot(load, load)
                rest -= slope * load[2] * load[2] if tilted == 1 else team[1, d] * team[1, d]
                shut |= rest >= 0.0
                inverse = mass / -rest if rest < 0.0 else mass
                p = inverse * (along - slope * load[2] * first[2])
                q = inverse * (across - slope * load[2] * second[2])
                factor = mass * inverse
                fa = factor * (a - slope * first[2] * first[2]) + p * p
                fb = factor * (b - slope * first[2] * second[2]) + p * q
                fc = factor * (c - slope * second[2] * second[2]) + q * q
                for k in range(u.shape[1]):
                    s, t = u[j, k], x[j, k]
                    root = fa * s * s + 2.0 * fb * s * t + fc * t * t
                    value = np.sqrt(max(root, 0.0)) + p * s + q * t
                    others[k] = max(others[k], value if root >= 0.0 else 0.0)
        for k in range(u.shape[1]):
            slowest = max(np.sqrt(squared[k]) / limits[0], others[k], 1e-150)
            ends[j, k] = 0.0 if shut else 1.0 / slowest
    return ends


@kernel
def _where(along: Array, values: Array, level: float, low: int, high: int) -> float:
    """Return the value where ``along``, rising from index ``low`` to ``high``, reaches a level."""
    k, end = low, high
    while k < end:
        middle = (k + end) // 2
        if along[middle] < level:
            k = middle + 1
        else:
            end = middle
    if k == low or (k == high and high == len(along)):
        return float(values[min(k, len(along) - 1)])
    rise = along[k] - along[k - 1]
    share = min(1.0, (level - along[k - 1]) / rise) if rise > 0.0 else 0.0
    return float(values[k - 1] + share * (values[k] - values[k - 1]))


@kernel
def quick_squares(corners: Array, steps: Array, tie: float) -> Array:
    """Return nearly the largest ṡ² (J + 1,) from rest to rest; see ``quick_profile``.

    Parameters
    ----------
    corners: (J, m, 2), what is allowed at the points but the last one, s̈ from the largest on.
    steps: (J,), between the points.
    tie: share of ṡ² below it at which the largest s̈ is read.
    """
    count, m = corners.shape[0], corners.shape[1]
    most, square, after = np.zeros(count + 1), np.zeros(count + 1), np.empty(m)
    for i in range(count - 1, -1, -1):
        u, x = corners[i, :, 0], corners[i, :, 1]
        for k in range(m):
            after[k] = -(x[k] + 2.0 * steps[i] * u[k])
        top, end = int(np.argmax(x)), int(np.argmax(after)) + 1
        most[i] = _where(after, x, -most[i + 1], top, end)
    for i in range(count):
        u, x = corners[i, :, 0], corners[i, :, 1]
        fastest = _where(x, u, (1.0 - tie) * square[i], 0, int(np.argmax(x)))
        square[i + 1] = min(square[i] + 2.0 * steps[i] * fastest, most[i + 1])
    return square


@kernel
def step_programs(corners: Array, s: Array, length: float, unit: float) -> Array:
    """Return (J, 3, 2m + 2): rows of the steps between points, as ``speed_profile`` builds them.

    Parameters
    ----------
    corners: (J + 1, m + 1, 2), of what is allowed at the points.
    s: (J + 1,), the points.
    length, unit: of the path, and of ṡ² times length.
    """
    count, m = len(s) - 1, corners.shape[1] - 1
    rows = np.empty((count + 1, 3, m))
    for i in range(count + 1):
        for k in range(m):
            u, x = corners[i, k, 0], corners[i, k, 1]
            p, q = corners[i, k + 1, 1] - x, u - corners[i, k + 1, 0]
            size = np.sqrt(p * p + q * q)
            p, q = (p / size, q / size) if size > 0.0 else (0.0, 1.0)
            bound = (p * u + q * x) / unit
            q = q / length
            size = np.sqrt(p * p + q * q)
            rows[i, 0, k], rows[i, 1, k], rows[i, 2, k] = p / size, q / size, bound / size
    programs = np.zeros((count, 3, 2 * m + 2))
    for i in range(count):
        twice = 2.0 * (s[i + 1] - s[i]) * length
        programs[i, 0, 0], programs[i, 1, 0] = twice, 1.0
        programs[i, 0, 1], programs[i, 1, 1] = -twice, -1.0
        for k in range(m):
            programs[i, 0, 2 + k], programs[i, 1, 2 + k] = rows[i, 0, k], rows[i, 1, k]
            programs[i, 2, 2 + k], programs[i, 2, 2 + m + k] = -rows[i, 2, k], -rows[i + 1, 2, k]
            programs[i, 0, 2 + m + k] = rows[i + 1, 0, k] + twice * rows[i + 1, 1, k]
            programs[i, 1, 2 + m + k] = rows[i + 1, 1, k]
    return programs


@kernel
def _along(rows: Array, order: Indices, count: int, row: int, slow: float, bound: float) -> Array:
    """Return the best point on a row's line that the box and the first rows of an order allow.

    Not a number where there is none.
    """
    a, b, c = rows[0, row], rows[1, row], rows[2, row]
    size = a * a + b * b
    if size == 0.0:
        return np.full(2, np.nan)
    u, x, du, dx = -c * a / size, -c * b / size, -b, a
    least, most = -np.inf, np.inf
    for i in range(count + 4):
        if i < 4:  # -bound ≤ u ≤ bound, 0 ≤ x ≤ bound
            sign = 1.0 if i % 2 == 0 else -1.0
            p, q = (sign, 0.0) if i < 2 else (0.0, sign)
            r = 0.0 if i == 3 else -bound
        else:
            p, q, r = rows[0, order[i - 4]], rows[1, order[i - 4]], rows[2, order[i - 4]]
        rise, left = p * du + q * dx, -(p * u + q * x + r)
        if abs(rise) <= 1e-14:
            if left < -1e-10:
                return np.full(2, np.nan)
        elif rise > 0.0:
            most = min(most, left / rise)
        else:
            least = max(least, left / rise)
    if least > most + 1e-10:
        return np.full(2, np.nan)
    t = most if dx - slow * du > 0.0 else least
    return np.array([u + t * du, x + t * dx])


@kernel
def _best(rows: Array, order: Indices, slow: float, bound: float) -> float:
    """Return the largest x that rows ``a u + b x + c ≤ 0`` allow; not a number where there is none.

    Rows are looked at one after the other (Seidel's algorithm); those that bind come first in the
    order afterwards.

    Parameters
    ----------
    rows: (3, m)
    order: (m,), of the rows.
    slow: weight of u beside that of x, which chooses among points of equal x.
    bound: of u, to either side, and of x.
    """
    u, x = -bound, bound
    for i in range(rows.shape[1]):
        row = order[i]
        if rows[0, row] * u + rows[1, row] * x + rows[2, row] > 1e-13 * (1.0 + abs(rows[2, row])):
            found = _along(rows, order, i, row, slow, bound)
            u, x = found[0], found[1]
            if np.isnan(x):
                return np.nan
            for k in range(i, 0, -1):
                order[k] = order[k - 1]
            order[0] = row
    return x


@kernel
def fastest_squares(programs: Array, slow: float, bound: float, tiny: float) -> Array:
    """Return the largest ṡ² (J + 1,) from rest to rest; see ``speed_profile._fastest_squares``.

    Parameters
    ----------
    programs: (J, 3, m), of the steps.
    slow, bound, tiny: weight of s̈, bound of s̈ and ṡ², and by how much to stay below.
    """
    count, m = programs.shape[0], programs.shape[2]
    most, squares, order = np.zeros(count + 1), np.zeros(count + 1), np.arange(m)
    for i in range(count - 1, -1, -1):
        programs[i, 2, 0] = -most[i + 1]
        most[i] = _best(programs[i], order, slow, bound)
        if np.isnan(most[i]):
            return np.full(count + 1, np.nan)
    for i in range(count):
        least = np.inf
        for k in range(m):
            a = programs[i, 0, k]
            if a > 0.0:
                left = -programs[i, 2, k] / a - programs[i, 1, k] / a * squares[i]
                least = min(least, left)
        after = squares[i] + programs[i, 0, 0] * least
        squares[i + 1] = min(most[i + 1], max(after - tiny, 0.9999 * after, 0.0))
    return squares
