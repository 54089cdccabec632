"""Rows of a program that limit speed, acceleration and jerk, linearised about current curves."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import EAST, first_smallest, unit
from hitchopt.hitch.convex_qp import Rows
from hitchopt.planners.separation.setting import HELD, Setting
from hitchopt.values import Array

ACROSS = (0.3, 0.7)
"""Largest change across a derivative, as shares of its limit: at the limit, and at zero."""


def add_limits(
    rows: Rows, setting: Setting, coefficients: Array, duration: float, trust: float, slack: int
) -> None:
    """Limit the first three derivatives: along themselves to the limit, across to a share of it.

    Parameters
    ----------
    rows: collects them.
    setting: grid and limits.
    coefficients: (N, count, 3) [m], the current curves.
    duration: [s] for which they hold.
    trust: change of a coefficient that an unknown of one stands for [m]
    slack: column of the first drone's slack, in shares of the duration.
    """
    n, free = len(coefficients), setting.grid.count - 2 * HELD
    drones = np.arange(n)
    for order, (rate, cap) in enumerate(
        zip(setting.grid.rates, setting.caps, strict=True), start=1
    ):
        matrix = rate / duration**order
        current = np.einsum("rc,ncd->nrd", matrix, coefficients) / cap[:, None, None]
        size = np.linalg.norm(current, axis=-1)
        changing = matrix[:, HELD:-HELD] * trust
        r, f = np.nonzero(changing)
        columns = ((drones[:, None] * free + f)[..., None] * 3 + np.arange(3)).ravel()
        values = np.broadcast_to(changing[r, f] / cap[:, None], (n, len(r)))
        across = ACROSS[0] + (ACROSS[1] - ACROSS[0]) * np.clip(1.0 - size, 0.0, 1.0)
        for k, axis in enumerate(_frames(current)):
            entries = (values[..., None] * axis[:, r]).ravel()
            here = np.sum(current * axis, axis=-1)
            local = np.repeat(drones[:, None] * len(matrix) + r, 3)
            if k == 0:
                upper, lower = 1.0 - here, np.full(here.shape, -np.inf)
            else:  # no worse than it is
                bound = np.maximum(across, np.abs(here))
                upper, lower = bound - here, -bound - here
            first = rows.add(local, columns, entries, lower.ravel(), upper.ravel())
            if k == 0:
                every = np.arange(here.size)
                rows.extend(first + every, slack + every // len(matrix), -float(order))


def _frames(vectors: Array) -> tuple[Array, Array, Array]:
    """Return three orthogonal unit vectors for each of (…, 3), the first one along it."""
    along = unit(vectors, EAST, 1e-9)
    across = unit(np.cross(along, np.eye(3)[first_smallest(np.abs(along), 1.0)]))
    return along, across, np.cross(along, across)
