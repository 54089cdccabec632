"""The separation planner's task and result, and the splines on a time grid that it works on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from hitchopt.errors import InputError
from hitchopt.hitch.requirements import Arena, Requirements
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices, positive


@dataclass(frozen=True, eq=False)
class SeparationTask:
    """The task of N drones that fly from rest to rest outside of each other's downwash.

    Parameters
    ----------
    start, goal: (N, 3) [m]
    requirements: speed, acceleration and jerk of every drone, the ellipsoids, the arena and the
        prisms that drones stay out of by ``separation.radius``; the rest is not used.
    tethers: pairs of drones that hold one cable, and their largest distance [m].
    duration: exact duration [s], or None for the shortest that is found.
    acceleration: (N,) [m/s²]: what each drone can do, where that is less than the limit (thrust,
        tilt), or None.
    names: of the drones, for messages; none given: d0, d1, ….
    prisms: names of the prisms, for messages; none given: prism 0, prism 1, ….

    Raises
    ------
    InputError: places or counts that do not fit, numbers that are not finite.
    """

    start: Array
    goal: Array
    requirements: Requirements
    tethers: tuple[tuple[int, int, float], ...] = ()
    duration: float | None = None
    acceleration: ArrayLike | None = None
    names: tuple[str, ...] = ()
    prisms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("start", "goal"):
            points = np.array(getattr(self, name), dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):
                raise InputError(name, points.shape, "(N, 3), finite", "give metres")
            points.setflags(write=False)
            object.__setattr__(self, name, points)
        n, count = len(self.start), len(self.requirements.keep_out)
        object.__setattr__(self, "names", self.names or tuple(f"d{i}" for i in range(n)))
        object.__setattr__(self, "prisms", self.prisms or tuple(f"prism {k}" for k in range(count)))
        for name, number in (("goal", n), ("names", n), ("prisms", count)):
            if len(getattr(self, name)) != number:
                raise InputError(name, len(getattr(self, name)), str(number), "one for each")
        if self.duration is not None:
            positive("duration", self.duration)

    @property
    def drones(self) -> int:
        """Number N of drones."""
        return len(self.start)

    @property
    def tether_arrays(self) -> tuple[Indices, Indices, Array]:
        """First drones, second drones and largest distances [m] of all tethers, (tethers,) each."""
        first, second, longest = np.array(self.tethers, dtype=np.float64).reshape(-1, 3).T
        return first.astype(np.intp), second.astype(np.intp), longest


@dataclass(frozen=True, eq=False)
class Separated:
    """Curves that satisfy their task at every time, by bounds in continuous time.

    Attributes
    ----------
    drones: of shape (N, 3) [m], from start to goal, at rest (velocity and acceleration zero) at
        both ends; position, velocity and acceleration are continuous to 1e-9 or better.
    closest: no two drones' separation is smaller at any time (ratio).
    bound: no flight of these drones, even alone, takes less [s].
    remark: the priority rule that led to it.
    """

    drones: PiecewisePolynomial
    closest: float
    bound: float
    remark: str


DEGREE = 5
"""Degree of the curves, with which jerk is continuous as well."""

HELD = 3
"""Number of coefficients at each end that hold position, zero velocity and acceleration."""

TRUST = 2.5
"""Trust radius: largest move of a coefficient in one program, in drone radii."""

WALL = 1e-9
"""Distance of curves to an arena's walls, relative to its coordinates."""


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
        """Return the map of values at ``s`` to the free coefficients that fit them best.

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
    def trust(self) -> float:
        """Trust region: largest move of a coefficient along an axis in one program [m]."""
        return TRUST * self.task.requirements.separation.radius


def inside(arena: Arena | None, points: Array) -> Array:
    """Return points (…, 3) [m], clipped to the arena with a margin for rounding."""
    if arena is None:
        return points
    room = WALL * (np.abs(arena.lower) + np.abs(arena.upper))
    return np.clip(points, arena.lower + room, arena.upper - room)
