"""A separation task on its time grid: splines that rest at both ends, limits and scales."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from hitchopt.geometry.vectors import tied_order
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

SAMPLES = 3
"""Number of samples of every piece at which guesses are pushed."""

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

    @property
    def scale(self) -> Array:
        """(3,) [1/m]: the norm of an offset times this is a separation."""
        return self.task.requirements.separation.scale


def setting_of(task: SeparationTask, patience: float = 1.0) -> Setting:
    """Return the task on a grid that suits the drone with the longest flight.

    Parameters
    ----------
    task: starts, goals and requirements.
    patience: duration over that of the slowest flight; above 1, drones leave one after the other,
        and at 1 all leave at once.

    Raises
    ------
    InfeasibleError: the prisms leave no route.
    """
    limits = task.requirements.limits
    n = task.drones
    given = limits.acceleration if task.acceleration is None else task.acceleration
    acceleration = np.minimum(np.broadcast_to(np.asarray(given), (n,)), limits.acceleration)
    caps = np.stack([np.full(n, limits.speed), acceleration, np.full(n, limits.jerk)])
    straight = np.linalg.norm(task.goal - task.start, axis=1)
    bound = np.max(fastest_ramps(straight, limits.speed, acceleration, limits.jerk).duration)
    routes = routes_around(task)
    ramps = fastest_ramps(routes.lengths, limits.speed, acceleration, limits.jerk)
    slowest = int(np.argmax(ramps.duration))
    alone = float(ramps.duration[slowest])
    rise = max(float(ramps.rise[slowest]), SHORTEST_RAMP * alone)
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
        shares = np.maximum(ramps.duration / alone, SHORTEST) / patience
        rises = np.full(n, 0.5)
        np.divide(ramps.rise, ramps.duration, out=rises, where=routes.lengths > 0.0)
        rank = np.argsort(tied_order(-shares, 1.0))  # who flies longest leaves first
        leaving = (1.0 - shares) * rank / max(1, n - 1)
        own = [
            progress_along((s - leave) / share, float(rise))
            for leave, share, rise in zip(leaving, shares, rises, strict=True)
        ]
        points = routes.points(np.stack(own))
    else:
        share = progress_along(s, 1.0 / breaks[-1])
        points = routes.points(np.broadcast_to(share, (n, len(share))))
    nominal = _fitted(task, grid, s, points)
    return Setting(task, grid, nominal, caps, float(bound), alone, size)


def inside(arena: Arena, points: Array) -> Array:
    """Return points (…, 3) [m], clipped to the arena with a margin for rounding."""
    room = WALL * (np.abs(arena.lower) + np.abs(arena.upper))
    return np.clip(points, arena.lower + room, arena.upper - room)


def _fitted(task: SeparationTask, grid: Grid, s: Array, points: Array) -> Array:
    """Return the splines from start to goal nearest to points (N, samples, 3) at ``s``."""
    basis = grid.sampled(s)
    coefficients = np.zeros((len(points), grid.count, 3))
    coefficients[:, :HELD], coefficients[:, -HELD:] = task.start[:, None], task.goal[:, None]
    rest = points - np.einsum("sc,ncd->nsd", basis, coefficients)
    free = basis[:, grid.free]
    fitting = np.linalg.solve(free.T @ free, free.T)  # well conditioned: B-splines
    coefficients[:, grid.free] = np.einsum("fs,nsd->nfd", fitting, rest)
    return coefficients


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
    def knots(self) -> Array:
        """(pieces + 2·DEGREE + 1,): every end as often as a clamped spline needs it."""
        ends = np.ones(DEGREE)
        return np.concatenate([0.0 * ends, self.breaks, ends])

    @cached_property
    def extraction(self) -> Array:
        """(pieces, DEGREE + 1, DEGREE + 1): maps a piece's coefficients to Bernstein ones.

        Piece m is shaped by the spline's coefficients m … m + DEGREE.
        """
        each = PiecewisePolynomial.from_spline(BSpline(self.knots, np.eye(self.count), DEGREE))
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local: Array = np.take_along_axis(each.coefficients, index[..., None], axis=1)
        return np.swapaxes(local, 1, 2)

    def sampled(self, s: Array, derivative: int = 0) -> Array:
        """Return the basis functions, or a derivative of theirs, at ``s`` as (*s.shape, count)."""
        splines = BSpline(self.knots, np.eye(self.count), DEGREE)
        function = splines.derivative(derivative) if derivative else splines
        return function(np.clip(s, 0.0, 1.0))

    @cached_property
    def quadrature(self) -> tuple[Array, Array]:
        """Return samples (m,) and weights (m,) of an integral over [0, 1]: Gauss on each piece."""
        x, w = np.polynomial.legendre.leggauss(DEGREE + 1)  # exact for squares of splines
        h = np.diff(self.breaks)[:, None]
        s = self.breaks[:-1, None] + 0.5 * h * (x + 1.0)
        return s.ravel(), (0.5 * h * w).ravel()

    @cached_property
    def rates(self) -> tuple[Array, Array, Array]:
        """Matrices (count - k, count), k = 1, 2, 3, to coefficients of the k-th derivative.

        A derivative lies within the hull of its coefficients.
        """
        matrices = []
        matrix = np.eye(self.count)
        knots = self.knots
        for k in range(1, 4):
            order = DEGREE + 1 - k
            m = self.count - k
            widths = knots[k : k + m + order][order : order + m] - knots[k : k + m]
            matrix = order * np.diff(matrix, axis=0) / widths[:, None]
            matrices.append(matrix)
        return matrices[0], matrices[1], matrices[2]

    def pieces_of(self, coefficients: Array) -> Array:
        """Return Bernstein coefficients (pieces, N, 3, DEGREE + 1) of splines (N, count, 3)."""
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local = coefficients[:, index]  # (N, pieces, DEGREE + 1, 3)
        pieces: Array = np.einsum("pbk,npkd->pndb", self.extraction, local, optimize=True)
        return pieces

    def curves(self, coefficients: Array, duration: float) -> PiecewisePolynomial:
        """Return the splines (N, count, 3) [m] flown in ``duration`` [s]."""
        return PiecewisePolynomial(duration * self.breaks, self.pieces_of(coefficients))


def progress_along(s: Array, ramp: float) -> Array:
    """Return the share of a route flown at times ``s`` (from 0 to 1), with ramps of ``ramp``.

    Parameters
    ----------
    s: (…), below 0 at the start and above 1 at the goal.
    ramp: up to one half.
    """
    fine = np.linspace(0.0, 1.0, 1001)
    speed = _smooth(fine / ramp) * _smooth((1.0 - fine) / ramp)
    gone = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    share: Array = np.interp(s, fine, gone / gone[-1])
    return share


def _smooth(x: Array) -> Array:
    """Return a step from 0 to 1 that starts and ends level."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
