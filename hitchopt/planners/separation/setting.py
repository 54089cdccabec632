"""A separation task on its time grid: splines that rest at both ends, limits and scales."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from hitchopt.geometry.vectors import TIE
from hitchopt.hitch.requirements import Arena
from hitchopt.planners.separation.routes import routes_around
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

RAMP_PIECES = 3
"""Number of pieces of a ramp: the fastest flight is resolved to within 2 %."""

MOST_PIECES = 20
"""Maximum number of pieces between the ramps; with fewer, each is as long as a ramp."""

WALL = 1e-9
"""Distance of curves to an arena's walls, relative to its coordinates."""

SHORTEST_RAMP = 1e-5
"""Shortest ramp, as a share of the duration: splines do not resolve shorter ones."""

SHORTEST = 0.2
"""Shortest flight, as a share of the longest one."""

DEGREE = 5
"""Degree of the curves, with which jerk is continuous as well."""

HELD = 3
"""Number of coefficients at each end that hold position, zero velocity and acceleration."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A task on its grid.

    Attributes
    ----------
    task: starts, goals and requirements.
    grid: the pieces of time.
    nominal: (N, count, 3) [m]: coefficients of the curves to stay near to.
    caps: (3, N): largest norms of the first three derivatives of each drone, by time.
    bound: no flight of all drones takes less [s].
    alone: estimate of the longest flight on routes around prisms, without other drones [s].
    size: the longest route [m], by which deviations are measured.
    """

    task: SeparationTask
    grid: Grid
    nominal: Array
    caps: Array
    bound: float
    alone: float
    size: float


def setting_of(task: SeparationTask, patience: float = 1.0) -> Setting:
    """Return the task on a grid that suits the drone with the longest flight.

    Parameters
    ----------
    patience: duration over that of the slowest flight; above 1, drones leave one after the other,
        and at 1 all leave at once.

    Raises
    ------
    InfeasibleError: the prisms leave no route.
    """
    limits, n = task.requirements.limits, task.drones
    given = limits.acceleration if task.acceleration is None else np.asarray(task.acceleration)
    acceleration = np.minimum(np.broadcast_to(given, n), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    straight, routes = np.linalg.norm(task.goal - task.start, axis=1), routes_around(task)
    (bound, _), (durations, own_rises) = (
        fastest_ramps(lengths, limits.speed, acceleration, limits.jerk)
        for lengths in (straight, routes.lengths)
    )
    slowest = int(np.argmax(durations))
    alone = float(durations[slowest])
    rise = max(float(own_rises[slowest]), SHORTEST_RAMP * alone)
    size = max(float(np.max(routes.lengths)), 2.0 * task.requirements.separation.radius)
    going = float(routes.lengths[slowest]) > 1e-6 * size  # else nobody goes anywhere
    cruise = max(patience * alone / rise - 2.0, 0.0) if going else 0.0  # as long as how many ramps
    first = np.linspace(0.0, 1.0, RAMP_PIECES + 1)
    middle = min(math.ceil(patience * MOST_PIECES), math.ceil(cruise - 1e-9))
    lasting = 1.0 + np.linspace(0.0, cruise, middle + 1)
    breaks = np.concatenate([first[:-1], lasting, 1.0 + cruise + first[1:]])
    grid = Grid(breaks / breaks[-1])
    s = np.linspace(0.0, 1.0, 12 * grid.pieces + 1)
    if patience > 1.0 and going:
        lasts = np.maximum(durations / alone, SHORTEST) / patience
        rises = np.full(n, 0.5)
        np.divide(own_rises, durations, out=rises, where=routes.lengths > 0.0)
        order = np.argsort(np.round(-lasts / TIE), kind="stable")  # who flies longest leaves first
        rank = np.argsort(order)
        leaving = (1.0 - lasts) * rank / max(1, n - 1)
        each = zip(leaving, lasts, rises, strict=True)
        shares = [_progress((s - leave) / share, float(rise)) for leave, share, rise in each]
    else:
        shares = [_progress(s, 1.0 / breaks[-1])] * n
    nominal = np.zeros((n, grid.count, 3))
    nominal[:, :HELD], nominal[:, -HELD:] = task.start[:, None], task.goal[:, None]
    missing = routes.points(np.stack(shares)) - grid.sampled(s) @ nominal
    nominal[:, grid.free] = grid.fitting(s) @ missing
    return Setting(task, grid, nominal, caps, float(np.max(bound)), alone, size)


def inside(arena: Arena | None, points: Array) -> Array:
    """Return points (…, 3) [m], clipped to the arena with a margin for rounding."""
    if arena is None:
        return points
    room = WALL * (np.abs(arena.lower) + np.abs(arena.upper))
    return np.clip(points, arena.lower + room, arena.upper - room)


@dataclass(frozen=True, eq=False)
class Grid:
    """The span of time [0, 1] cut into pieces, and the splines on it.

    Attributes
    ----------
    breaks: (pieces + 1,) from 0 to 1.
    """

    breaks: Array

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return len(self.breaks) - 1

    @property
    def count(self) -> int:
        """Number of coefficients of a spline."""
        return self.pieces + DEGREE

    @property
    def free(self) -> slice:
        """The coefficients that the ends do not hold."""
        return slice(HELD, self.count - HELD)

    @cached_property
    def splines(self) -> BSpline:
        """The basis functions, a clamped spline each."""
        ends = np.ones(DEGREE)
        return BSpline(np.concatenate([0.0 * ends, self.breaks, ends]), np.eye(self.count), DEGREE)

    @cached_property
    def extraction(self) -> Array:
        """(pieces, DEGREE + 1, DEGREE + 1): maps a piece's coefficients to Bernstein ones.

        Piece m is shaped by the spline's coefficients m … m + DEGREE.
        """
        each = PiecewisePolynomial.from_spline(self.splines)
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local: Array = np.take_along_axis(each.coefficients, index[..., None], axis=1)
        return np.swapaxes(local, 1, 2)

    def sampled(self, s: Array, derivative: int = 0) -> Array:
        """Return the basis functions, or a derivative of theirs, at ``s`` as (*s.shape, count)."""
        return self.splines(np.clip(s, 0.0, 1.0), derivative)

    def fitting(self, s: Array, stiffness: float = 0.0) -> Array:
        """Return what maps values at ``s`` to the free coefficients that fit them best.

        Parameters
        ----------
        stiffness: shortest bend that passes, as a share of the duration.
        """
        free, bends = self.sampled(s)[:, self.free], self.sampled(s, 3)[:, self.free]
        square = free.T @ free + stiffness**6 * bends.T @ bends
        return np.asarray(np.linalg.solve(square, free.T), dtype=np.float64)

    @cached_property
    def energies(self) -> tuple[Array, Array]:
        """Matrices (count, count) of a spline's mean square and of its third derivative's."""
        x, w = np.polynomial.legendre.leggauss(DEGREE + 1)  # exact for squares of splines
        h = np.diff(self.breaks)[:, None]
        s, weights = (self.breaks[:-1, None] + 0.5 * h * (x + 1.0)).ravel(), (0.5 * h * w).ravel()
        value, third = self.sampled(s), self.sampled(s, 3)
        return value.T @ (weights[:, None] * value), third.T @ (weights[:, None] * third)

    @cached_property
    def rates(self) -> list[Array]:
        """Matrices (count - k, count), k = 1, 2, 3, to coefficients of the k-th derivative.

        A derivative lies within the hull of its coefficients.
        """
        return [self.splines.derivative(k).c[: self.count - k] for k in (1, 2, 3)]

    def pieces_of(self, coefficients: Array) -> Array:
        """Return Bernstein coefficients (pieces, N, 3, DEGREE + 1) of splines (N, count, 3)."""
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local = coefficients[:, index]  # (N, pieces, DEGREE + 1, 3)
        pieces: Array = np.einsum("pbk,npkd->pndb", self.extraction, local, optimize=True)
        return pieces

    def curves(self, coefficients: Array, duration: float) -> PiecewisePolynomial:
        """Return the splines (N, count, 3) [m] flown in ``duration`` [s]."""
        return PiecewisePolynomial(duration * self.breaks, self.pieces_of(coefficients))


def _progress(s: Array, ramp: float) -> Array:
    """Return the share of a route flown at times ``s``, 0 to 1, with ramps of ``ramp`` ≤ ½."""
    fine = np.linspace(0.0, 1.0, 1001)
    rising, falling = (np.clip(x / ramp, 0.0, 1.0) for x in (fine, 1.0 - fine))
    speed = rising**2 * (3.0 - 2.0 * rising) * falling**2 * (3.0 - 2.0 * falling)
    gone = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))
    share: Array = np.interp(s, fine, gone / gone[-1])
    return share
