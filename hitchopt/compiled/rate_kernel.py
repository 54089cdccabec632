"""Compiled interior-point method of ``fastest_rate``; its names are those of that module."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array, Indices

WIDTH = 4
"""Number of coefficients that a sample sees."""


class RateTables(NamedTuple):
    """A ``RateProgram`` in arrays of M samples with R rows each.

    Attributes
    ----------
    first, values: (M,) and (M, 3, 4), of the ``SplineBasis``.
    convex, forms, b, c, e: (M, R, …), of the ``RateRows``, ``convex`` their Q.
    weights: (M,) [s]
    """

    first: Indices
    values: Array
    convex: Array
    forms: Array
    b: Array
    c: Array
    e: Array
    weights: Array


class RateSettings(NamedTuple):
    """Numbers that steer the search, as ``fastest_rate`` names them."""

    steps: int
    gap: float
    least: float
    inside: float
    shrink: float
    backtrack: float
    smallest: float
    least_left: float


@kernel
def _at(tables: RateTables, coefficients: Array) -> Array:
    """Return value and derivatives (M, 3)."""
    p = np.zeros((len(tables.first), 3))
    for m in range(len(p)):
        for o in range(3):
            for k in range(WIDTH):
                p[m, o] += tables.values[m, o, k] * coefficients[tables.first[m] + k]
    return p


@kernel
def _transposed(tables: RateTables, forces: Array, count: int) -> Array:
    """Return what (M, 3) by value and derivatives is by coefficients (count,)."""
    out = np.zeros(count)
    for m in range(len(forces)):
        for k in range(WIDTH):
            for o in range(3):
                out[tables.first[m] + k] += forces[m, o] * tables.values[m, o, k]
    return out


@kernel
def _slack(tables: RateTables, coefficients: Array, p: Array, least: float, out: Array) -> bool:
    """Fill in the slack (M · R + count,) of rows and coefficients; whether all are positive."""
    R, inner = tables.c.shape[1], tables.c.size
    for i in range(len(coefficients)):
        out[inner + i] = coefficients[i] - least
        if not out[inner + i] > 0.0:
            return False
    for m in range(len(p)):
        x, y, z = p[m, 0], p[m, 1], p[m, 2]
        if not x > 0.0:
            return False
        for r in range(R):
            f, b = tables.forms[m, r], tables.b[m, r]
            value = x * (f[0, 0] * x + f[0, 1] * y + f[0, 2] * z + b[0])
            value += y * (f[1, 0] * x + f[1, 1] * y + f[1, 2] * z + b[1])
            value += z * (f[2, 0] * x + f[2, 1] * y + f[2, 2] * z + b[2])
            value += tables.c[m, r] - tables.e[m, r] / x
            out[m * R + r] = -value
            if not value < 0.0:
                return False
    return True


@kernel
def _gradients(tables: RateTables, p: Array) -> Array:
    """Return the rows' derivatives by p (M, R, 3)."""
    g: Array = np.empty_like(tables.b)
    for m in range(g.shape[0]):
        x, y, z = p[m, 0], p[m, 1], p[m, 2]
        for r in range(g.shape[1]):
            f, b = tables.forms[m, r], tables.b[m, r]
            for i in range(3):
                g[m, r, i] = 2.0 * (f[i, 0] * x + f[i, 1] * y + f[i, 2] * z) + b[i]
            g[m, r, 0] += tables.e[m, r] / (x * x)
    return g


@kernel
def _band(
    tables: RateTables, p: Array, g: Array, force: Array, slack: Array, count: int, convex: bool
) -> Array:
    """Return the lower band (4, count) of Newton's matrix."""
    R, inner = tables.c.shape[1], tables.c.size
    band, bends = np.zeros((WIDTH, count)), tables.convex if convex else tables.forms
    for m in range(len(p)):
        xx, xy, xz, yy, yz, zz = 0.75 * tables.weights[m] * p[m, 0] ** -2.5, 0.0, 0.0, 0.0, 0.0, 0.0
        for r in range(R):
            own = force[m * R + r]
            stiff, twice = own / slack[m * R + r], 2.0 * own
            x, y, z, f = g[m, r, 0], g[m, r, 1], g[m, r, 2], bends[m, r]
            xx += stiff * x * x + twice * f[0, 0]
            xy += stiff * x * y + twice * f[0, 1]
            xz += stiff * x * z + twice * f[0, 2]
            yy += stiff * y * y + twice * f[1, 1]
            yz += stiff * y * z + twice * f[1, 2]
            zz += stiff * z * z + twice * f[2, 2]
            if not convex:
                xx -= twice * tables.e[m, r] / p[m, 0] ** 3
        v, first = tables.values[m], tables.first[m]
        for i in range(WIDTH):
            x = v[0, i] * xx + v[1, i] * xy + v[2, i] * xz
            y = v[0, i] * xy + v[1, i] * yy + v[2, i] * yz
            z = v[0, i] * xz + v[1, i] * yz + v[2, i] * zz
            for j in range(i + 1):
                band[i - j, first + j] += x * v[0, j] + y * v[1, j] + z * v[2, j]
    for k in range(count):
        band[0, k] += force[inner + k] / slack[inner + k]
    return band


@kernel
def _factored(band: Array) -> bool:
    """Factor a banded matrix in place (Cholesky); whether it is positive definite."""
    count = band.shape[1]
    for k in range(count):
        for back in range(1, min(WIDTH, k + 1)):
            for i in range(WIDTH - back):
                band[i, k] -= band[back + i, k - back] * band[back, k - back]
        if not band[0, k] > 0.0:
            return False
        root = np.sqrt(band[0, k])
        for i in range(WIDTH):
            band[i, k] /= root
    return True


@kernel
def _solved(factor: Array, right: Array) -> Array:
    """Return the solution of a factored system."""
    x, count = right.copy(), factor.shape[1]
    for k in range(count):
        for back in range(1, min(WIDTH, k + 1)):
            x[k] -= factor[back, k - back] * x[k - back]
        x[k] /= factor[0, k]
    for k in range(count - 1, -1, -1):
        for ahead in range(1, min(WIDTH, count - k)):
            x[k] -= factor[ahead, k] * x[k + ahead]
        x[k] /= factor[0, k]
    return x


@kernel
def _step(
    tables: RateTables,
    g: Array,
    state: tuple[Array, Array],
    residual: Array,
    factor: Array,
    aim: float,
) -> tuple[Array, Array, Array]:
    """Return the steps of coefficients, slack and forces towards products of ``aim`` each."""
    force, slack = state
    R, inner, count = tables.c.shape[1], tables.c.size, len(residual)
    pull, dslack = aim / slack - force, np.empty(len(slack))
    pushed = np.zeros((len(g), 3))
    for m in range(len(g)):
        for r in range(R):
            for i in range(3):
                pushed[m, i] += pull[m * R + r] * g[m, r, i]
    dc = _solved(factor, pull[inner:] - residual - _transposed(tables, pushed, count))
    dp = _at(tables, dc)
    for m in range(len(g)):
        for r in range(R):
            along = g[m, r, 0] * dp[m, 0] + g[m, r, 1] * dp[m, 1] + g[m, r, 2] * dp[m, 2]
            dslack[m * R + r] = -along
    dslack[inner:] = dc
    return dc, dslack, pull - force / slack * dslack


@kernel
def _share(values: Array, steps: Array, inside: float) -> float:
    """Return how much of a step keeps the values above zero, at most all of it."""
    fastest = 0.0
    for i in range(len(values)):
        fastest = min(fastest, steps[i] / values[i])
    return min(1.0, inside / -fastest) if fastest < 0.0 else 1.0


@kernel
def fastest_rate(tables: RateTables, start: Array, settings: RateSettings) -> Array:
    """Return the coefficients of the fastest rate that is found from a start inside of all rows."""
    R, inner, count = tables.c.shape[1], tables.c.size, len(start)
    slack, left_over = np.empty(inner + count), np.empty(inner + count)
    c, p = start.copy(), _at(tables, start)
    if not _slack(tables, c, p, settings.least, slack):
        return c
    force = 0.1 * np.sum(tables.weights / np.sqrt(p[:, 0])) / len(slack) / slack
    for _ in range(settings.steps):
        p = _at(tables, c)
        duration, gap = np.sum(tables.weights / np.sqrt(p[:, 0])), np.sum(force * slack)
        g = _gradients(tables, p)
        pulled = np.zeros((len(p), 3))
        for m in range(len(p)):
            for r in range(R):
                for i in range(3):
                    pulled[m, i] += force[m * R + r] * g[m, r, i]
            pulled[m, 0] -= 0.5 * tables.weights[m] * p[m, 0] ** -1.5
        residual = _transposed(tables, pulled, count) - force[inner:]
        goal = settings.gap * duration
        if gap < goal and np.max(np.abs(residual)) < goal:
            break
        factor = _band(tables, p, g, force, slack, count, False)
        if not _factored(factor):
            factor = _band(tables, p, g, force, slack, count, True)
            if not _factored(factor):
                break
        dc, dslack, dforce = _step(tables, g, (force, slack), residual, factor, 0.0)
        next_slack = slack + _share(slack, dslack, settings.inside) * dslack
        next_force = force + _share(force, dforce, settings.inside) * dforce
        left = min(max(np.sum(next_slack * next_force) / gap, settings.least_left), 1.0)
        aim = max(gap * left**3, 0.1 * goal)
        dc, dslack, dforce = _step(tables, g, (force, slack), residual, factor, aim / len(slack))
        share, least = _share(slack, dslack, settings.inside), settings.shrink * slack
        while True:
            moved = c + share * dc
            there = _at(tables, moved)
            if _slack(tables, moved, there, settings.least, left_over) and np.all(
                left_over >= least
            ):
                break
            share *= settings.backtrack
            if share < settings.smallest:
                return c
        c, slack = moved, left_over.copy()
        force = force + _share(force, dforce, settings.inside) * dforce
    return c
