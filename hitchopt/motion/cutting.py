"""Plans cut where everything rests, and plans flown more slowly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

REST = 1e-6
"""Largest speed [m/s] and acceleration [m/s²] at rest."""


def rests(motion: Motion) -> NDArray[np.intp]:
    """Return the breaks, first and last included, at which no drone moves or accelerates."""
    still = np.ones(motion.drones.pieces - 1, dtype=np.bool_)
    for order in (1, 2):
        left, right = motion.drones.ends(order)
        for here in (right[:-1], left[1:]):
            still &= np.max(np.linalg.norm(here, axis=-1), axis=-1) <= REST
    return np.concatenate([[0], 1 + np.flatnonzero(still), [motion.drones.pieces]])


def cut(motion: Motion, first: int, last: int) -> Motion:
    """Return the pieces from break ``first`` to break ``last``, from t = 0 on."""
    start, end = float(motion.drones.breaks[first]), float(motion.drones.breaks[last])
    breaks = motion.drones.breaks[first : last + 1] - start

    def part(whole: PiecewisePolynomial) -> PiecewisePolynomial:
        return whole.alike(whole.coefficients[first:last], breaks)

    phases = [
        phase.lasting(max(phase.start, start) - start, min(phase.end, end) - start)
        for phase in motion.overlapping(start, end)
    ]
    return motion.changed(part, phases)


def stretched(motion: Motion, factor: float) -> Motion:
    """Return the same curves with all durations multiplied by ``factor``, and no limit on them.

    Raises
    ------
    InputError: a factor below 1.
    """
    if not 1.0 <= factor <= 100.0:
        raise InputError("--stretch", factor, "from 1 to 100", "1.05 flies 5 % slower")
    if factor == 1.0:
        return motion
    return motion.untimed.slowed(factor)
