"""Compiled flat outputs and drones of ``RetargetPath``, one time after the other.

Within, jets are Taylor coefficients: derivatives over factorials, so that products are short sums.
"""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices

JET = 4
"""Number of derivatives, the zeroth included."""

_FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])


@kernel
def _times(a: Array, b: Array) -> Array:
    """Return a product."""
    out = np.zeros(JET)
    for i in range(JET):
        for j in range(JET - i):
            out[i + j] += a[i] * b[j]
    return out


@kernel
def _square_root(a: Array) -> Array:
    """Return a square root; nan where there is none."""
    out = np.empty(JET)
    out[0] = np.sqrt(a[0])
    for k in range(1, JET):
        known = a[k]
        for i in range(1, k):
            known -= out[i] * out[k - i]
        out[k] = known / (2.0 * out[0])
    return out


@kernel
def _over(a: Array, b: Array) -> Array:
    """Return a quotient; nan where there is none."""
    out = np.empty(JET)
    for k in range(JET):
        known = a[k]
        for i in range(k):
            known -= out[i] * b[k - i]
        out[k] = known / b[0]
    return out


@kernel
def _slowed(start: Array, t: float, b: float) -> Array:
    """Return the quartic of ``SmoothChange`` that brakes for b seconds."""
    p, v, a = start[0], start[1], start[2]
    cubic, quartic = -(v / b + 2.0 * a / 3.0) / b, (0.5 * v / b + 0.25 * a) / b**2
    out, s = np.zeros(JET), min(t, b)
    out[0] = p + s * (v + s * (0.5 * a + s * (cubic + s * quartic)))
    if t < b:
        out[1] = v + s * (a + s * (3.0 * cubic + s * 4.0 * quartic))
        out[2] = 0.5 * a + s * (3.0 * cubic + s * 6.0 * quartic)
        out[3] = cubic + s * 4.0 * quartic
    return out


@kernel
def _quintic(t: float, duration: float) -> Array:
    """Return the quintic of ``SmoothChange`` from 0 to 1."""
    out, x = np.zeros(JET), min(t / duration, 1.0)
    out[0] = x**3 * (10.0 + x * (6.0 * x - 15.0))
    if t < duration:
        out[1] = x**2 * (30.0 + x * (30.0 * x - 60.0)) / duration
        out[2] = x * (30.0 + x * (60.0 * x - 90.0)) / duration**2
        out[3] = (10.0 + x * (60.0 * x - 60.0)) / duration**3
    return out


@kernel
def _turned(shape: Array, angle: Array) -> None:
    """Turn vectors (points, 3, 4) about the vertical."""
    c, s = np.zeros(JET), np.zeros(JET)
    c[0], s[0] = np.cos(angle[0]), np.sin(angle[0])
    for k in range(1, JET):
        for i in range(1, k + 1):
            c[k] -= i * angle[i] * s[k - i] / k
            s[k] += i * angle[i] * c[k - i] / k
    for i in range(len(shape)):
        x, y = shape[i, 0].copy(), shape[i, 1].copy()
        shape[i, 0] = _times(c, x) - _times(s, y)
        shape[i, 1] = _times(c, y) + _times(s, x)


@kernel
def _unit(points: Array, first: int, last: int) -> Array:
    """Return the direction (3, 4) from one point to another."""
    along = points[last] - points[first]
    squared = np.zeros(JET)
    for axis in range(3):
        squared += _times(along[axis], along[axis])
    size = _square_root(squared)
    for axis in range(3):
        along[axis] = _over(along[axis], size)
    return along


@kernel
def path_jets(
    start: Array,
    goal: Array,
    t: Array,
    timing: Array,
    stencil: Indices,
    has_leg: Array,
    team: Array,
) -> tuple[Array, Array, Array, Array]:
    """Return the jets of vertices, drones and legs, and thrusts.

    Parameters
    ----------
    start, goal: (mean point, shape, split) of ``RetargetPath``, (·, 3) and (·,).
    t: (J,) [s]
    timing: brake [s], shift [s] and yaw [rad].
    stencil, has_leg: of the layout, (n, 4) and (n, 2).
    team: (n, 5), cable lengths, tensions, masses of q and r, and the weight of one kilogramme.

    Returns
    -------
    (J, points, 3, 4), (J, 2n, 3, 4), (J, n, 2, 4) and (J, 2n, 3).
    """
    n = len(stencil)
    count = (len(goal) - 3 - n) // 3
    vertices, drones = np.empty((len(t), count, 3, JET)), np.empty((len(t), 2 * n, 3, JET))
    legs, thrusts = np.empty((len(t), n, 2, JET)), np.empty((len(t), 2 * n, 3))
    brake, shift, yaw = timing[0], timing[1], timing[2]
    rows = np.empty((len(goal), JET))
    for step in range(len(t)):
        moved = _quintic(t[step], shift)
        for i in range(len(goal)):
            stop = start[i, 0] + 0.5 * brake * start[i, 1] + brake**2 / 12.0 * start[i, 2]
            rows[i] = _slowed(start[i], t[step], brake) + (goal[i] - stop) * moved
        points = rows[3 : 3 + 3 * count].copy().reshape(count, 3, JET)
        if yaw != 0.0:
            _turned(points, yaw * moved)
        points += rows[:3]
        for k in range(n):
            before, here, there, after = stencil[k]
            onward = points[there] - points[here]
            squared = np.zeros(JET)
            for axis in range(3):
                squared += _times(onward[axis], onward[axis])
            slack = -_square_root(squared)
            slack[0] += team[k, 0]
            q_leg = _times(rows[3 + 3 * count + k], slack)
            q_leg = q_leg if has_leg[k, 0] else np.zeros(JET)
            q_leg = q_leg if has_leg[k, 1] else slack
            legs[step, k, 0], legs[step, k, 1] = q_leg, slack - q_leg
            for end in range(2):
                place = here if end == 0 else there
                along = _unit(points, before, here) if end == 0 else _unit(points, after, there)
                for axis in range(3):
                    curve = points[place, axis] + _times(legs[step, k, end], along[axis])
                    drones[step, 2 * k + end, axis] = curve * _FACTORIALS
                    lift = team[k, 4] if axis == 2 else 0.0
                    force = team[k, 2 + end] * (2.0 * curve[2] + lift)
                    thrusts[step, 2 * k + end, axis] = force + team[k, 1] * along[axis, 0]
        legs[step] *= _FACTORIALS
        vertices[step] = points * _FACTORIALS
    return vertices, drones, legs, thrusts


@kernel
def largest_shares(
    vertices: Array, drones: Array, thrusts: Array, limits: Array, thrust_limits: Array
) -> float:
    """Return ``excess`` of ``retarget_timing`` for jets of ``path_jets``; nan if any is nan.

    Parameters
    ----------
    limits: speed, acceleration, jerk, speed of vertices, and tilt.
    thrust_limits: (2n,) [N]
    """
    most, total = np.zeros(6), np.sum(vertices) + np.sum(drones) + np.sum(thrusts)
    if not np.isfinite(total):
        return total - total
    for step in range(len(drones)):
        for i in range(drones.shape[1]):
            for order in range(1, JET):
                x = drones[step, i, :, order]
                if step > 0 or order == 3:
                    most[order] = max(most[order], x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
            if step > 0:
                f = thrusts[step, i]
                level = f[0] ** 2 + f[1] ** 2
                most[4] = max(most[4], np.sqrt(level + f[2] ** 2) / thrust_limits[i])
                most[5] = max(most[5], np.arctan2(np.sqrt(level), f[2]) / limits[4])
        for i in range(vertices.shape[1] if step > 0 else 0):
            x = vertices[step, i, :, 1]
            most[0] = max(most[0], x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
    speed = max(np.sqrt(most[1]) / limits[0], np.sqrt(most[0]) / limits[3])
    others = max(np.sqrt(most[2]) / limits[1], most[4], most[5])
    return max(speed, np.sqrt(others), np.cbrt(np.sqrt(most[3]) / limits[2]))
