"""Estimates with their standard errors, and a robust mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.one_line import OneLine
from hitchopt.values import Array

ROUNDS = 30
"""Number of reweightings of a robust mean, which converge by a factor of some 3 each."""

TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class Estimate(OneLine):
    """One estimated quantity.

    Attributes
    ----------
    value: nan where the recording does not determine it.
    error: standard error; infinite where it is not determined.
    remark: why it is not determined, or empty.
    """

    value: float
    error: float
    remark: str = ""

    @property
    def known(self) -> bool:
        """Whether the recording determines it."""
        return not self.remark

    @classmethod
    def unknown(cls, remark: str) -> Estimate:
        """Return the estimate of a quantity that the recording does not determine."""
        return cls(float("nan"), float("inf"), remark)


def scale_of(residuals: Array, axis: int | None = None) -> Array:
    """Return the spread of residuals about zero that outliers do not change."""
    spread: Array = np.asarray(TO_SIGMA * np.median(np.abs(residuals), axis=axis))
    return spread


def robust_mean(values: Array, least_scale: float) -> tuple[Array, Array]:
    """Return means over the first axis that outliers hardly change, and their standard errors.

    It minimises ``Σ 2 (√(1 + (r/s)²) - 1)``, the loss ``soft_l1`` of scipy's ``least_squares``, by
    reweighting, all columns at once.

    Parameters
    ----------
    values: (samples, …), independent ones.
    least_scale: smallest scale s.
    """
    centre = np.median(values, axis=0)
    scale = np.maximum(scale_of(values - centre, 0), least_scale)
    weights = np.ones_like(values)
    for _ in range(ROUNDS):
        weights = 1.0 / np.sqrt(1.0 + ((values - centre) / scale) ** 2)
        centre = np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
    count = len(values)
    if count < 2:
        return centre, np.full_like(centre, np.inf)
    # Of an M-estimator: the influence r w(r) over its slope, which is w³ for this loss.
    influence = np.sum((weights * (values - centre)) ** 2, axis=0) * count / (count - 1.0)
    errors = np.sqrt(influence) / np.sum(weights**3, axis=0)
    return centre, np.maximum(errors, least_scale / np.sqrt(count))
