"""Clocks of recordings: shifts between two records of the same motion."""

from __future__ import annotations

import numpy as np

from hitchopt.values import Array

STEP = 0.02  # Between the shifts that are tried [s]
MAX_SAMPLES = 600  # Samples that are compared
MAX_RESIDUAL = 0.05  # Largest root mean square distance of two records of one motion [m]
MIN_GAIN, GAIN_TIME = 1.2, 0.1  # Smallest growth of the distance at a shift [s] from the best one
MIN_OVERLAP = 0.5  # Smallest share of samples at times of both records


def fitted_shift(
    own: Array, reference: Array, span: tuple[float, float]
) -> tuple[float, float] | None:
    """Return the shift of a record's clock [s], and the remaining distance [m].

    ``own`` and ``reference`` are rows (m, 4) of time [s] and position [m] of one body; own times
    plus the shift, within ``span``, are reference times. None if the records differ, or the body
    moves too little to tell.
    """
    own, reference = (x[np.isfinite(x).all(axis=1)] for x in (own, reference))
    reference = reference[np.argsort(reference[:, 0], kind="stable")]
    if len(own) < 2 or len(reference) < 2:
        return None
    own = own[:: max(len(own) // MAX_SAMPLES, 1)]

    def distance(shift: float) -> float:
        t = own[:, 0] + shift
        inside = (t >= reference[0, 0]) & (t <= reference[-1, 0])
        if np.mean(inside) < MIN_OVERLAP:
            return np.inf
        at = [np.interp(t[inside], reference[:, 0], x) for x in reference.T[1:]]
        squares = np.sum((own[inside, 1:] - np.stack(at, axis=1)) ** 2, axis=1)
        return float(np.sqrt(np.mean(np.minimum(squares, np.quantile(squares, 0.95)))))

    shifts = np.arange(span[0], span[1] + STEP, STEP)
    distances = np.array([distance(shift) for shift in shifts.tolist()])
    best, step = float(shifts[np.argmin(distances)]), STEP
    while step > 1e-4:
        step *= 0.5
        best = min((best - step, best, best + step), key=distance)
    residual = distance(best)
    nearby = min(distance(best - GAIN_TIME), distance(best + GAIN_TIME))
    if not residual < MAX_RESIDUAL or not nearby > MIN_GAIN * residual + 1e-6:
        return None
    return best, residual
