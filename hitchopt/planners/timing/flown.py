"""What a planner hands over: polynomials of time from t = 0, and which drones they move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.planners.path.shape_path import Path
from hitchopt.planners.timing.flight import Flight, fly
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial

BRIEF = 0.05
"""[s] No move is faster: one of micrometres would be over before its polynomials' rounding is."""

MOVES = 1e-9
"""[m] Whatever stays within this of its first place does not move."""


class Flown(Protocol):
    """Drones, vertices, legs and tensions as in a Motion, on common breaks from t = 0."""

    @property
    def drones(self) -> PiecewisePolynomial:
        """Of shape (2n, 3) [m]."""

    @property
    def vertices(self) -> PiecewisePolynomial:
        """Of shape (n, 3) [m]."""

    @property
    def legs(self) -> PiecewisePolynomial:
        """Of shape (n, 2) [m]."""

    @property
    def tensions(self) -> PiecewisePolynomial:
        """Of shape (n,) [N]."""

    @property
    def duration(self) -> float:
        """From rest to rest [s]."""


@dataclass(frozen=True, eq=False)
class TimedFlight:
    """A flight whose times were given, not found.

    Attributes
    ----------
    drones, vertices, legs, tensions: as in a Motion, from t = 0.
    """

    drones: PiecewisePolynomial
    vertices: PiecewisePolynomial
    legs: PiecewisePolynomial
    tensions: PiecewisePolynomial

    @property
    def duration(self) -> float:
        """From rest to rest [s]."""
        return self.drones.duration


def fly_unhurried(path: Path, limits: Limits, duration: float | None = None) -> Flight:
    """Return the flight along a path as ``fly`` does, at least BRIEF unless told otherwise.

    Raises
    ------
    InfeasibleError, TimingError, WarpError: as fly.
    """
    flight = fly(path, limits, duration)
    if duration is None and flight.duration < BRIEF:
        return flight.lasting(BRIEF)
    return flight


def moving(drones: PiecewisePolynomial) -> NDArray[np.bool_]:
    """Return which drones (2n,) leave their first place, by the hull of their polynomials.

    Parameters
    ----------
    drones: of shape (2n, 3) [m].
    """
    c = drones.coefficients
    away = np.linalg.norm(c - c[0, ..., :1], axis=-2)
    moved: NDArray[np.bool_] = np.max(away, axis=(0, -1)) > MOVES
    return moved
