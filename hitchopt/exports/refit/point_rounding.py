"""Control points rounded together, and moved by a unit where rounding breaks a limit of the plan.

A control point rounded on its own is off by half a quantum, its neighbour by as much in the
opposite direction: over a piece of degree N and h seconds that is up to ``N / h`` quanta a second
of velocity. So each is rounded with the errors of those before it in mind: among the remaining real
coefficients the ones that make up best for them are found by least squares (Babai's nearest plane),
in a norm of the errors of position, velocity and acceleration over the piece.

A plan that flies at a limit has nothing left for rounding. But of the many roundings within the
accuracy some keep it: single inner control points, and pairs of them, are moved by one quantum as
long as that lowers what is beyond the limits. Limits are checked in points; the certificate
verifies the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from hitchopt.exports.refit.piece_fitting import Scale
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

POINTS = 33
"""Points of a piece at which limits are checked."""

MARGIN = 3e-4
"""Relative distance from the limits, for what lies between the points and for the bounds."""

MOST = 500
"""Pieces of single drones that are settled, at some 10 ms each; with more, limits are too tight."""

STEPS = 12
"""Largest number of moves of one piece."""

NEAR = 0.85
"""Share of the accuracy beyond which errors cost."""


def rounded(curves: PiecewisePolynomial, quantum: float, scale: Scale) -> PiecewisePolynomial:
    """Return the curves (D, 3) with all coefficients multiples of ``quantum``, joined exactly.

    Parameters
    ----------
    curves: whose pieces meet at their ends.
    quantum: [m]
    scale: errors that weigh alike.
    """
    wanted = curves.coefficients / quantum
    found = np.empty_like(wanted)
    last = np.rint(wanted[0, ..., 0])
    for piece, h in enumerate(curves.durations):
        found[piece] = _nearest(wanted[piece], last, _gram(curves.degree, float(h), scale))
        last = found[piece, ..., -1]
    return PiecewisePolynomial(curves.breaks, found * quantum)


def _nearest(wanted: Array, first: Array, gram: Array) -> Array:
    """Return integers (…, N + 1) near to ``wanted`` in the norm, the first of them given."""
    # With G = L Lᵀ the error's norm is |Lᵀ e|: row i of Lᵀ holds e_i and those after it. The last
    # coefficient to be chosen is thus the first one of the basis, so the order is turned round.
    factor = np.linalg.cholesky(gram[::-1, ::-1]).T
    c = wanted[..., ::-1]
    size = c.shape[-1]
    errors = np.zeros_like(c)
    found = np.empty_like(c)
    for i in range(size - 1, -1, -1):
        aim = c[..., i] - errors[..., i + 1 :] @ factor[i, i + 1 :] / factor[i, i]
        found[..., i] = first if i == size - 1 else np.rint(aim)
        errors[..., i] = found[..., i] - c[..., i]
    return found[..., ::-1]


def _gram(degree: int, h: float, scale: Scale) -> Array:
    """Return the basis's Gram matrix (N + 1, N + 1) for errors over a piece of ``h`` seconds."""
    nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
    x = 0.5 * (nodes + 1.0)
    gram = np.zeros((degree + 1, degree + 1))
    for order, size in enumerate(scale):
        values = bernstein.derivative_basis(x, degree, order) / (size * h**order)
        gram += values.T @ (0.5 * weights[:, None] * values)
    return gram


@dataclass(frozen=True, eq=False)
class Keeping:
    """The limits that are enforced.

    Attributes
    ----------
    speed: of every drone [m/s].
    mass, max_thrust: (D,) [kg], [N].
    load: (pieces, POINTS, D, 3) [N]: what thrust carries besides acceleration, ``m g ẑ - F``.
    accuracy: largest error of positions [m].
    """

    speed: float
    mass: Array
    max_thrust: Array
    load: Array
    accuracy: float


def settling_times(breaks: Array) -> Array:
    """Return the times (pieces, POINTS) [s] at which limits are checked."""
    x = np.linspace(0.0, 1.0, POINTS)
    return breaks[:-1, None] + x * np.diff(breaks)[:, None]


def settled(
    curves: PiecewisePolynomial, wanted: PiecewisePolynomial, quantum: float, keeping: Keeping
) -> PiecewisePolynomial:
    """Return the curves (D, 3), moved by quanta within pieces; their ends stay.

    Parameters
    ----------
    curves: curves whose control points are multiples of ``quantum``.
    wanted: what they were rounded from, on the same pieces.
    quantum: [m]
    keeping: the limits.
    """
    c = np.array(curves.coefficients)
    beyond = np.stack([_beyond(c[p], h, keeping, p) for p, h in enumerate(curves.durations)])
    pieces, drones = np.nonzero(beyond > 0.0)
    if len(pieces) > MOST:
        return curves
    for p, d in zip(pieces.tolist(), drones.tolist(), strict=True):
        h = float(curves.durations[p])
        c[p, d] = _one_settled(c[p, d], wanted.coefficients[p, d], h, quantum, keeping, p, d)
    return PiecewisePolynomial(curves.breaks, np.rint(c / quantum) * quantum)


def _one_settled(
    c: Array, wanted: Array, h: float, quantum: float, keeping: Keeping, piece: int, drone: int
) -> Array:
    """Return the control points (3, N + 1) of one drone's piece after the moves that help most."""
    moves = quantum * _moves(bernstein.degree(c))
    basis, slopes, _ = _bases(bernstein.degree(c))
    goal, pace = basis @ wanted.T, slopes @ wanted.T / h
    for _ in range(STEPS):
        each = c + moves  # (moves, 3, N + 1)
        beyond = _beyond(each, h, keeping, piece, slice(drone, drone + 1))
        if beyond[0] == 0.0:  # the first one moves nothing
            break
        off = np.max(np.linalg.norm(np.einsum("tn,mdn->mtd", basis, each) - goal, axis=-1), axis=1)
        wild = np.einsum("tn,mdn->mtd", slopes, each) / h - pace
        cost = (
            1e5 * beyond
            + 2e1 * np.maximum(off / keeping.accuracy - NEAR, 0.0)
            + np.max(np.linalg.norm(wild, axis=-1), axis=1) / keeping.speed
        )
        best = int(np.argmin(cost))
        if best == 0:
            break
        c = each[best]
    return c


def _beyond(
    each: Array, h: float, keeping: Keeping, piece: int, drones: slice = slice(None)
) -> Array:
    """Return by how much pieces (m, 3, N + 1) are beyond their limits, relative to these, (m,).

    The root of the mean of squares over the points: a move that helps one of several counts.
    """
    _, slopes, bends = _bases(bernstein.degree(each))
    speed = np.linalg.norm(np.einsum("tn,mdn->mtd", slopes, each) / h, axis=-1)
    pull = np.einsum("tn,mdn->mtd", bends, each) / h**2
    load = np.moveaxis(keeping.load[piece, :, drones], 1, 0)
    thrust = keeping.mass[drones, None, None] * pull + load
    pushed = np.linalg.norm(thrust, axis=-1) / keeping.max_thrust[drones, None]
    most = 1.0 - MARGIN
    squares = np.maximum(speed / keeping.speed - most, 0.0) ** 2
    squares += np.maximum(pushed - most, 0.0) ** 2
    beyond: Array = np.sqrt(np.mean(squares, axis=1))
    return beyond


@lru_cache
def _bases(degree: int) -> tuple[Array, Array, Array]:
    """Return basis, slopes and bends by the local parameter, (POINTS, degree + 1) each."""
    x = np.linspace(0.0, 1.0, POINTS)
    basis, slopes, bends = (bernstein.derivative_basis(x, degree, order) for order in range(3))
    return basis, slopes, bends


@lru_cache
def _moves(degree: int) -> Array:
    """Return moves (moves, 3, degree + 1): none, runs of inner control points, any two of them."""
    runs = []
    for first, last in combinations(range(1, degree + 1), 2):
        for axis in range(3):
            run = np.zeros((3, degree + 1))
            run[axis, first:last] = 1.0
            runs += [run, -run]
    single = [run for run in runs if np.abs(run).sum() == 1.0]
    pairs = [a + b for a, b in combinations(single, 2)]
    return np.array([np.zeros((3, degree + 1)), *runs, *pairs])
