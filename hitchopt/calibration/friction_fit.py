"""Friction at the clasps, from tensions on both sides of cables that slide through them.

``clasp_sliding`` has the law. Of the logarithms of a clasp's two ratios the sum follows from the
directions of legs and edges; the difference is that of the two cables' tensions, which drones
measure by giving way, and which their noise changes much more. They are weighed by their scatter,
and by how well the law knows their direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_array, diags_array, vstack
from scipy.sparse.linalg import splu

from hitchopt.calibration.clasp_sliding import GEOMETRY_ERROR, SlidingClasps
from hitchopt.calibration.estimates import Estimate, scale_of
from hitchopt.calibration.force_balance import ForceBalance
from hitchopt.values import Array

SLID = 0.02
"""Least distance that cables must slide, all clasps taken together, to determine friction [m]."""

OFFSET_SCALE, FORCE_SHARE = 1e-2, 0.02
"""Assumed scatter of drones' displacements [m], which is that of the positions that they measure,
and of forces on clasps over the tension."""

LEAST_SCATTER = 0.01
"""Least scatter that is assumed of the logarithm of a ratio."""

OFFSET_SCATTER = 0.03
"""Standard deviation, known beforehand, of an offset that is common to the sums of clasps' ratios:
sagging spans pull less along their chords than at their clasps, and thick cables pass the measured
vertex at one side, which turns legs by 0.02 rad."""

ROUNDS = 3
"""Rounds in which scatter and friction are estimated by turns."""

LARGEST_ERROR = 0.1
"""Largest standard error of a friction coefficient that counts as determined."""


def part_tensions(
    balance: ForceBalance, compliance: Array, wind: Array, feed_forward: NDArray[np.bool_]
) -> Array:
    """Return the tensions (windows, unknowns) [N] that fit displaced drones and clasps best.

    Parameters
    ----------
    balance: at the windows; drones that move steadily count as if they were at rest.
    compliance: of each drone (2n,) [m/N].
    wind: (2,) [N], steady level force on every drone.
    feed_forward: (2n,), whether controllers add the cable forces of the set points.
    """
    windows = balance.windows
    tension = float(np.median(windows.tensions))
    wanted = (windows.drones - windows.commanded) / compliance[:, None]
    wanted -= balance.surplus(feed_forward)
    wanted[..., :2] -= wind
    weight = np.broadcast_to(compliance[:, None] / OFFSET_SCALE, wanted.shape).ravel()
    force = 1.0 / (FORCE_SHARE * tension)
    matrix = csr_array(
        vstack([diags_array(weight) @ balance.leg_pulls(), force * balance.clasps], format="csr")
    )
    target = np.concatenate([weight * wanted.ravel(), force * balance.weights])
    normal = (matrix.T @ matrix).tocsc()
    solved: Array = splu(normal).solve(matrix.T @ target)
    return solved.reshape(len(windows.t), balance.per_window)


def fit_friction(found: SlidingClasps) -> Estimate:
    """Return the coefficient that explains the ratios, by robust regression.

    The standard error is the larger of two: with errors that are common to a window, since all of
    its ratios follow from the same positions, and with errors that are common to a clasp, since
    cables differ. The geometry's error is added.
    """
    slid = float(np.sum(found.slid))
    if slid < SLID:
        return Estimate.unknown(
            f"cables slide through clasps by {100 * slid:.1f} cm in all, less than {100 * SLID:g} "
            "cm: friction is not seen; move a vertex by some decimetres"
        )
    modes = np.array([[1.0, 1.0], [1.0, -1.0]])  # sum and difference
    ratios, pulls = found.ratios @ modes, found.pulls @ modes
    unsure = np.linalg.norm(found.unsure, axis=-1, keepdims=True)  # of both modes alike
    x = np.array([np.sum(pulls * ratios) / np.sum(pulls**2), 0.0])  # friction and offset
    columns = np.stack([pulls, np.broadcast_to([1.0, 0.0], pulls.shape)], axis=-1)
    for _ in range(ROUNDS):
        scale = np.maximum(scale_of(ratios - columns @ x, axis=0), LEAST_SCATTER)
        scale = np.hypot(scale, x[0] * unsure)
        wanted, by = ratios / scale, columns / scale[..., None]
        rows, right = by.reshape(-1, 2), wanted.ravel()
        rows = np.vstack([rows, [0.0, 1.0 / OFFSET_SCATTER]])
        right = np.append(right, 0.0)
        x = least_squares(_misfit, x, loss="soft_l1", args=(rows, right)).x
    residuals = wanted - by @ x
    weights = 1.0 / np.sqrt(1.0 + residuals**2)
    scores = np.sum((weights * residuals)[..., None] * by, axis=1)
    prior = np.diag([0.0, 1.0 / OFFSET_SCATTER**2])
    inverse = np.linalg.inv(np.einsum("ij,ijk,ijl->kl", weights**3, by, by) + prior)
    errors = []
    for group in (found.windows, found.clasps):
        sums = np.stack([np.bincount(group, column) for column in scores.T])
        errors.append(float((inverse @ (sums @ sums.T + prior) @ inverse)[0, 0]))
    mu, scatter = float(x[0]), float(np.sqrt(max(errors)))
    if scatter > LARGEST_ERROR or len(np.unique(found.windows)) < 3:
        return Estimate.unknown(
            f"its standard error would be {scatter:.2g}: tensions scatter by more than friction "
            "changes them; move vertices farther, or record more precisely"
        )
    return Estimate(max(mu, 0.0), float(np.hypot(scatter, GEOMETRY_ERROR * mu)))


def _misfit(x: Array, rows: Array, right: Array) -> Array:
    """Return the residuals of linear equations."""
    return rows @ x - right
