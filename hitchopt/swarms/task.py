"""The separation planner's task, result, and splines on a time grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.hitch.requirements import Arena, Requirements
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splines import bspline, extraction
from hitchopt.values import Array, Indices, positive


@dataclass(frozen=True, eq=False)
class SeparationTask:
    """The task of N drones that fly from rest to rest outside of each other's downwash.

    Parameters
    ----------
    start, goal: (N, 3) [m]
    requirements: limits of speed, acceleration and jerk, ellipsoids, the arena, and prisms with a
        distance of ``separation.radius``; the rest is not used.
    tethers: pairs of drones that hold one cable, and their largest distance [m].
    duration: prescribed duration [s], or None to minimise it.
    acceleration: (N,) [m/s²]: usable acceleration of each drone (thrust, tilt), or None for the
        limit.
    names: of the drones, for messages; default d0, d1, ….
    prisms: names of the prisms, for messages; default prism 0, prism 1, ….

    Raises
    ------
    InputError: inconsistent shapes or counts, or numbers that are not finite.
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
                raise InputError(name, points.shape, "(N, 3), finite", "use metres")
            points.setflags(write=False)
            object.__setattr__(self, name, points)
        drones = len(self.start)
        prisms = len(self.requirements.keep_out)
        if not self.names:
            object.__setattr__(self, "names", tuple(f"d{i}" for i in range(drones)))
        if not self.prisms:
            object.__setattr__(self, "prisms", tuple(f"prism {k}" for k in range(prisms)))
        for name, required in (("goal", drones), ("names", drones), ("prisms", prisms)):
            count = len(getattr(self, name))
            if count != required:
                raise InputError(name, count, str(required), "one for each")
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
class SeparationResult:
    """Curves that satisfy their task, by continuous-time bounds."""

    drones: PiecewisePolynomial
    """(N, 3) [m], from start to goal, with zero velocity and acceleration at both ends.

    Position, velocity and acceleration are continuous to 1e-9 or better."""

    closest: float  # Lower bound of the separation of any two drones (ratio)
    bound: float  # [s] Lower bound of the duration, from straight flights of single drones
    remark: str  # The priority rule of its initial guess


DEGREE = 5  # Degree of the curves, whose jerk is continuous

END_COUNT = 3
"""Number of coefficients at each end, fixed by position, zero velocity and zero acceleration."""

TRUST_RATIO = 2.5  # Trust radius over the radius of drones
WALL_MARGIN = 1e-9  # Distance of curves to the arena's walls, relative to its coordinates


@dataclass(frozen=True, eq=False)
class Grid:
    """Pieces of the unit interval, and the splines on them."""

    breaks: Array  # (pieces + 1,), from 0 to 1

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
        """The coefficients that are not fixed at the ends."""
        return slice(END_COUNT, self.count - END_COUNT)

    @property
    def knots(self) -> Array:
        """(count + DEGREE + 1,): knots of the clamped splines."""
        return np.pad(self.breaks, DEGREE, mode="edge")

    @cached_property
    def splines(self) -> PiecewisePolynomial:
        """The basis functions (count,)."""
        return bspline(self.knots, np.eye(self.count), DEGREE)

    @cached_property
    def extraction(self) -> Array:
        """(pieces, DEGREE + 1, DEGREE + 1): maps a piece's coefficients to Bernstein coefficients.

        Piece m depends on the spline's coefficients m … m + DEGREE.
        """
        return extraction(self.knots, DEGREE)[2]

    def sampled(self, s: Array, derivative: int = 0) -> Array:
        """Return the basis functions (*s.shape, count), or their derivatives, at s."""
        return self.splines.at(np.clip(s, 0.0, 1.0), derivative)

    def fitting(self, s: Array, smoothing_time: float = 0.0) -> Array:
        """Return the linear map of values at s to the free coefficients of the least-squares fit.

        Parameters
        ----------
        smoothing_time: time constant of a penalty on the third derivative, over the duration.
        """
        values = self.sampled(s)[:, self.free]
        thirds = self.sampled(s, 3)[:, self.free]
        normal_matrix = values.T @ values + smoothing_time**6 * thirds.T @ thirds
        return np.asarray(np.linalg.solve(normal_matrix, values.T), dtype=np.float64)

    @cached_property
    def energies(self) -> tuple[Array, Array]:
        """Matrices (count, count) of the mean squares of a spline and of its third derivative."""
        # Gauss's rule with so many nodes is exact for squares of splines.
        nodes, node_weights = np.polynomial.legendre.leggauss(DEGREE + 1)
        widths = np.diff(self.breaks)[:, None]
        s = (self.breaks[:-1, None] + 0.5 * widths * (nodes + 1.0)).ravel()
        weights = (0.5 * widths * node_weights).ravel()
        values = self.sampled(s)
        thirds = self.sampled(s, 3)
        value_energy = values.T @ (weights[:, None] * values)
        third_energy = thirds.T @ (weights[:, None] * thirds)
        return value_energy, third_energy

    @cached_property
    def rates(self) -> list[Array]:
        """Matrices (count - k, count) to the coefficients of the k-th derivative, k = 1, 2, 3.

        A derivative is in the convex hull of its coefficients.
        """
        rates = [np.eye(self.count)]
        for k in (1, 2, 3):
            starts = self.knots[k : self.count]
            ends = self.knots[DEGREE + 1 : DEGREE + 1 + self.count - k]
            spans = (ends - starts)[:, None]
            rates.append((DEGREE + 1 - k) * np.diff(rates[-1], axis=0) / spans)
        return rates[1:]

    def pieces_of(self, coefficients: Array) -> Array:
        """Return Bernstein coefficients (pieces, N, 3, DEGREE + 1) of splines (N, count, 3)."""
        index = np.arange(self.pieces)[:, None] + np.arange(DEGREE + 1)
        local = coefficients[:, index]  # (N, pieces, DEGREE + 1, 3)
        pieces: Array = np.einsum("pbk,npkd->pndb", self.extraction, local, optimize=True)
        return pieces

    def curves(self, coefficients: Array, duration: float) -> PiecewisePolynomial:
        """Return the splines (N, count, 3) [m] with a duration [s]."""
        return PiecewisePolynomial(duration * self.breaks, self.pieces_of(coefficients))


@dataclass(frozen=True, eq=False)
class Setting:
    """A task on a time grid."""

    task: SeparationTask  # Starts, goals and requirements
    grid: Grid  # The pieces of time
    # (N, count, 3) [m]: coefficients of the curves from which deviations are penalized
    nominal: Array
    caps: Array  # (3, N): limits of the first three time derivatives of each drone
    bound: float  # [s] Lower bound of the duration, from straight flights of single drones
    single_duration: float  # [s] Estimate of the longest single flight around prisms
    # [m] Length of the longest route, at least the diameter of a drone's ellipsoid
    length_scale: float

    @property
    def trust(self) -> float:
        """Trust radius: largest change of a coefficient along an axis in one program [m]."""
        return TRUST_RATIO * self.task.requirements.separation.radius


def inside(arena: Arena | None, points: Array) -> Array:
    """Return points (…, 3) [m] clipped to the arena, with a margin for rounding."""
    if arena is None:
        return points
    margin = WALL_MARGIN * (np.abs(arena.lower) + np.abs(arena.upper))
    return np.clip(points, arena.lower + margin, arena.upper - margin)
