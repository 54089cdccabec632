"""What a planner returns: polynomials of time from t = 0, and which drones they move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.trajectory import PiecewisePolynomial

MOVES = 1e-9
"""[m] Distance from its first place within which a drone or vertex counts as at rest."""


@dataclass(frozen=True, eq=False)
class Flight:
    """The curves of a formed hitch on common breaks, from rest to rest.

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
        """Duration from rest to rest [s]."""
        return self.drones.duration

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Pulls of the legs (2n,) [N]: every leg pulls with its cable's tension."""
        both = np.repeat(self.tensions.coefficients, 2, axis=1)
        return PiecewisePolynomial(self.tensions.breaks, both)

    def lasting(self, duration: float) -> Flight:
        """Return the same curves flown in exactly ``duration`` [s]."""
        breaks = duration / self.duration * self.drones.breaks
        breaks[-1] = duration
        parts = (self.drones, self.vertices, self.legs, self.tensions)
        return Flight(*(PiecewisePolynomial(breaks, part.coefficients) for part in parts))


def check_duration(duration: float, fastest: float, when: str = "") -> None:
    """Raise InfeasibleError where a wanted duration is shorter than the fastest one [s]."""
    if duration < fastest:
        remedy = f"give it {fastest:.6g} s or more, or raise the limits of motion"
        raise InfeasibleError(
            [Violation("duration", duration, fastest, "min", "s", (), when, remedy)]
        )


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
