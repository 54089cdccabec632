"""Compiled flat outputs and drones of ``RetargetPath``, one time after the other.

Within, jets are Taylor coefficients, see ``series_kernels``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.series_kernels import (
    FACTORIALS,
    JET,
    Jet,
    edge,
    jet,
    minus,
    over,
    plus,
    times,
)
from hitchopt.values import Array, Indices


@kernel
def _slowed(start: Array, t: float, b: float) -> Jet:
    """Return the quartic of ``SmoothChange`` that brakes for b seconds."""
    p, v, a = start[0], start[1], start[2]
    cubic, quartic = -(v / b + 2.0 * a / 3.0) / b, (0.5 * v / b + 0.25 * a) / b**2
    s = min(t, b)
    value = p + s * (v + s * (0.5 * a + s * (cubic + s * quartic)))
    if t >= b:
        return value, 0.0, 0.0, 0.0
    first = v + s * (a + s * (3.0 * cubic + s * 4.0 * quartic))
    return value, first, 0.5 * a + s * (3.0 * cubic + s * 6.0 * quartic), cubic + s * 4.0 * quartic


@kernel
def _quintic(t: float, duration: float) -> Jet:
    """Return the quintic of ``SmoothChange`` from 0 to 1."""
    if t >= duration:
        return 1.0, 0.0, 0.0, 0.0
    x = t / duration
    return (
        x**3 * (10.0 + x * (6.0 * x - 15.0)),
        x**2 * (30.0 + x * (30.0 * x - 60.0)) / duration,
        x * (30.0 + x * (60.0 * x - 90.0)) / duration**2,
        (10.0 + x * (60.0 * x - 60.0)) / duration**3,
    )


@kernel
def _turned(shape: Array, yaw: float, moved: Jet) -> None:
    """Turn vectors (points, 3, 4) about the vertical by a share of an angle."""
    a1, a2, a3 = yaw * moved[1], yaw * moved[2], yaw * moved[3]
    c0, s0 = np.cos(yaw * moved[0]), np.sin(yaw * moved[0])
    c1, s1 = -a1 * s0, a1 * c0
    c2, s2 = -0.5 * a1 * s1 - a2 * s0, 0.5 * a1 * c1 + a2 * c0
    c3 = -(a1 * s2 + 2.0 * a2 * s1) / 3.0 - a3 * s0
    s3 = (a1 * c2 + 2.0 * a2 * c1) / 3.0 + a3 * c0
    c, s = (c0, c1, c2, c3), (s0, s1, s2, s3)
    for i in range(len(shape)):
        x, y = jet(shape[i, 0]), jet(shape[i, 1])
        across, along = minus(times(c, x), times(s, y)), plus(times(c, y), times(s, x))
        for k in range(JET):
            shape[i, 0, k], shape[i, 1, k] = across[k], along[k]


@kernel
def path_jets(
    start: Array,
    goal: Array,
    t: Array,
    timing: Array,
    stencil: Indices,
    has_leg: NDArray[np.bool_],
    team: Array,
) -> tuple[Array, Array, Array, Array]:
    """Return the jets of vertices, drones and legs, and thrusts.

    Parameters
    ----------
    start, goal: (mean point, shape, split) of ``RetargetPath``, (·, 3) and (·,).
    t: (J,) [s]
    timing: brake [s], shift [s] and yaw [rad].
    stencil, has_leg: of the layout, (n, 4) and (n, 2).
    team: (n, 7), cable lengths, tensions, masses of q and r, the weight of one kilogramme, and the
        largest thrusts of q and r.

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
            slowed = _slowed(start[i], t[step], brake)
            for k in range(JET):
                rows[i, k] = slowed[k] + (goal[i] - stop) * moved[k]
        points = rows[3 : 3 + 3 * count].copy().reshape(count, 3, JET)
        if yaw != 0.0:
            _turned(points, yaw, moved)
        points += rows[:3]
        for k in range(n):
            before, here, there, after = stencil[k]
            chord, nothing = edge(points, here, there)[3], (0.0, 0.0, 0.0, 0.0)
            slack = minus((team[k, 0], 0.0, 0.0, 0.0), chord)
            q_leg = times(jet(rows[3 + 3 * count + k]), slack) if has_leg[k, 0] else nothing
            q_leg = q_leg if has_leg[k, 1] else slack
            for end in range(2):
                leg = q_leg if end == 0 else minus(slack, q_leg)
                place = here if end == 0 else there
                x, y, z, size = edge(points, before if end == 0 else after, place)
                for axis in range(3):
                    along = over(x if axis == 0 else (y if axis == 1 else z), size)
                    curve = plus(jet(points[place, axis]), times(leg, along))
                    lift = team[k, 4] if axis == 2 else 0.0
                    force = team[k, 2 + end] * (2.0 * curve[2] + lift)
                    thrusts[step, 2 * k + end, axis] = force + team[k, 1] * along[0]
                    for order in range(JET):
                        drones[step, 2 * k + end, axis, order] = curve[order] * FACTORIALS[order]
                for order in range(JET):
                    legs[step, k, end, order] = leg[order] * FACTORIALS[order]
        vertices[step] = points * FACTORIALS
    return vertices, drones, legs, thrusts


@kernel
def largest_shares(
    vertices: Array, drones: Array, thrusts: Array, limits: Array, team: Array
) -> float:
    """Return ``excess`` of ``retarget_timing`` for jets of ``path_jets``; nan if any is nan.

    Parameters
    ----------
    limits: speed, acceleration, jerk, speed of vertices, and tilt.
    team: as of ``path_jets``.
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
                most[4] = max(most[4], np.sqrt(level + f[2] ** 2) / team[i // 2, 5 + i % 2])
                most[5] = max(most[5], np.arctan2(np.sqrt(level), f[2]) / limits[4])
        for i in range(vertices.shape[1] if step > 0 else 0):
            x = vertices[step, i, :, 1]
            most[0] = max(most[0], x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
    speed = max(np.sqrt(most[1]) / limits[0], np.sqrt(most[0]) / limits[3])
    others = max(np.sqrt(most[2]) / limits[1], most[4], most[5])
    return float(max(speed, np.sqrt(others), np.cbrt(np.sqrt(most[3]) / limits[2])))


@kernel
def path_share(
    start: Array,
    goal: Array,
    t: Array,
    timing: Array,
    stencil: Indices,
    has_leg: NDArray[np.bool_],
    team: Array,
    limits: Array,
) -> float:
    """Return ``largest_shares`` of ``path_jets``."""
    vertices, drones, _, thrusts = path_jets(start, goal, t, timing, stencil, has_leg, team)
    return float(largest_shares(vertices, drones, thrusts, limits, team))


@kernel
def brake_shares(
    start: Array,
    goal: Array,
    places: Array,
    brakes: Array,
    stencil: Indices,
    has_leg: NDArray[np.bool_],
    team: Array,
    limits: Array,
    enough: tuple[int, float],
) -> Array:
    """Return (brakes,) ``largest_shares`` of paths that come to rest wherever that is.

    Parameters
    ----------
    places: of the samples, relative to a brake's duration.
    brakes: durations [s].
    enough: so many that keep a share will do: what follows is left infinite.
    """
    found, kept = np.full(len(brakes), np.inf), 0
    for i in range(len(brakes)):
        timing = np.array([brakes[i], np.inf, 0.0])
        found[i] = path_share(
            start, goal, brakes[i] * places, timing, stencil, has_leg, team, limits
        )
        kept += found[i] <= enough[1]
        if kept == enough[0]:
            break
    return found
