"""Slowing of a flight until no thrust turns faster than its limit.

Slowed by κ, a thrust ``m a + l`` (l holds weight and cable) becomes ``m a / κ² + l`` and its
derivative ``m j / κ³ + l̇ / κ``: where nothing cancels, the turning rate falls with κ or faster.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import Team
from hitchopt.hitch.statics import cable_force_rates, cable_forces
from hitchopt.planners.timing.demands import LIMIT_SHARE, loads_at_rest
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

SAMPLES = 33
"""Number of samples of a piece, ends included: a rate errs by 1e-3 of its change on the piece."""

CHUNK = 60_000
"""Number of samples of drones that are processed in one go."""

SLOWEST = 1e6
"""Largest stretch that is tried."""

PRECISION = 1e-4
"""Relative precision of a stretch."""


@dataclass(frozen=True, eq=False)
class Turning:
    """What turns thrusts, at any samples (…, 3).

    Attributes
    ----------
    acceleration, jerk: mass times these [N], [N/s].
    load, load_rate: thrust at rest and its derivative [N], [N/s].
    """

    acceleration: Array
    jerk: Array
    load: Array
    load_rate: Array

    def fastest(self, stretch: float) -> float:
        """Return the largest turning rate [rad/s] of the flight that many times slower."""
        thrust = self.acceleration / stretch**2 + self.load
        rate = self.jerk / stretch**3 + self.load_rate / stretch
        squared = dot(thrust, thrust)
        if not np.all(squared > 0.0):
            return math.inf
        return float(np.max(length(np.cross(thrust, rate)) / squared))

    def stretch(self, limit: float, least: float) -> float:
        """Return a stretch, ``least`` or little more than it takes, that keeps the limit [rad/s].

        Infinite where none was found.
        """
        aim = LIMIT_SHARE * limit
        if self.fastest(least) <= aim:
            return least
        slow = 2.0 * least
        while self.fastest(slow) > aim:
            slow *= 2.0
            if slow > SLOWEST:
                return math.inf
        fast = 0.5 * slow
        while slow > (1.0 + PRECISION) * fast:
            middle = math.sqrt(fast * slow)
            fast, slow = (fast, middle) if self.fastest(middle) <= aim else (middle, slow)
        return slow


def turning_stretch(
    team: Team, limit: float | None, curves: Sequence[PiecewisePolynomial], least: float = 1.0
) -> float:
    """Return how many times slower, at least ``least``, a flight must be to keep its body rates.

    Parameters
    ----------
    limit: of the body rate [rad/s]; None for no limit.
    curves: drones (2n, 3) [m], vertices (points, 3) [m], pulls (2n,) [N] and tautness (n,), as
        ``cable_forces`` takes them, on common breaks; of single drones the first one.
    """
    factor = least
    while limit is not None:  # a rate may rise again where slowing ends a cancellation
        needed = max(chunk.stretch(limit, factor) for chunk in _chunks(team, curves))
        if needed <= factor or math.isinf(needed):
            return needed
        factor = needed
    return factor


def _chunks(team: Team, curves: Sequence[PiecewisePolynomial]) -> Iterator[Turning]:
    """Yield what turns the thrusts at samples of some pieces, which bounds the memory."""
    drones, mass = curves[0], team.mass[:, None]
    size = max(1, CHUNK // (SAMPLES * len(mass)))
    for first in range(0, drones.pieces, size):
        pieces = slice(first, first + size)
        jets = [[_samples(part, pieces, order) for part in curves] for order in (0, 1)]
        forces = rates = np.zeros_like(jets[0][0])
        if team.has_cables:
            forces = cable_forces(team, *jets[0])
            rates = cable_force_rates(team, tuple(jets[0]), tuple(jets[1]))
        acceleration, jerk = (mass * _samples(drones, pieces, order) for order in (2, 3))
        yield Turning(acceleration, jerk, loads_at_rest(team, forces), -rates)


def _samples(part: PiecewisePolynomial, pieces: slice, order: int) -> Array:
    """Return a derivative by time at SAMPLES places on each of the pieces, (…, *shape)."""
    c = part.coefficients[pieces]
    rows = bernstein.derivative_basis(np.linspace(0.0, 1.0, SAMPLES), bernstein.degree(c), order)
    found = np.moveaxis(c @ rows.T, -1, 1)
    h = part.durations[pieces].reshape(-1, *(1,) * (found.ndim - 1))
    values: Array = (found / h**order).reshape(-1, *part.shape)
    return values
