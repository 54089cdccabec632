"""Friction at the clasps, from tensions on both sides of cables that slide through them.

A cable that slides toward its leg is pulled harder there than along its edge, by ``e^{μβ}``, β
being the angle by which it turns at the clasp. A cable that does not slide may have any ratio up to
that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_array, diags_array, vstack
from scipy.sparse.linalg import splu

from hitchopt.calibration.estimates import Estimate, scale_of
from hitchopt.calibration.force_balance import ForceBalance
from hitchopt.hitch import Team
from hitchopt.hitch.cable_parts import CableParts
from hitchopt.values import Array

SLIDING = 4e-3
"""Least rate at which a cable slides through a clasp that counts as sliding [m/s]. The plan must
slide it the same way at that rate: where only noise moves drones, clasps may stick."""

SLID = 0.02
"""Least distance that cables must slide, all clasps taken together, to determine friction [m]."""

OFFSET_SCALE, FORCE_SHARE = 2e-3, 0.02
"""Assumed scatter of drones' displacements [m], and of forces on clasps over the tension."""

LEAST_RATIO = 0.05
"""Least tension over the planned one at which a ratio is formed."""

LARGEST_ERROR = 0.1
"""Largest standard error of a friction coefficient that counts as determined."""


@dataclass(frozen=True, eq=False)
class SlidingClasps:
    """Cables that slide through a clasp in a window, one entry each.

    Attributes
    ----------
    windows, drones: which window, and the drone at the leg.
    ratios: logarithms of the leg's tension over the edge's.
    turns: angle by which the cable turns at the clasp [rad], positive where it slides toward its
        leg, else negative.
    slid: distance that it slides meanwhile [m].
    """

    windows: NDArray[np.intp]
    drones: NDArray[np.intp]
    ratios: Array
    turns: Array
    slid: Array


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


def sliding_clasps(team: Team, balance: ForceBalance, tensions: Array) -> SlidingClasps:
    """Return the cables that slide through their clasps, from consecutive windows.

    Parameters
    ----------
    team: cables and drones.
    balance: at consecutive windows.
    tensions: (windows, unknowns) [N]
    """
    windows, parts, layout = balance.windows, balance.parts, team.layout
    drones = layout.drones_with_legs
    steps = np.diff(windows.t)
    rate = np.diff(parts.legs[:, drones], axis=0) / steps[:, None]
    before, after = rate[:-1], rate[1:]  # in and out of the windows in between
    asked = CableParts.of(team, windows.commanded, windows.planned).legs[:, drones]
    planned = (asked[2:] - asked[:-2]) / (windows.t[2:] - windows.t[:-2])[:, None]
    neighbours = (steps[:-1] < 2.0 * np.min(steps)) & (steps[1:] < 2.0 * np.min(steps))
    steady = (np.minimum(np.abs(before), np.abs(after)) > SLIDING) & (before * after > 0.0)
    steady &= neighbours[:, None] & (before * planned > 0.0) & (np.abs(planned) > SLIDING)
    edge = parts.along[1:-1][:, drones // 2] * np.where(drones % 2 == 0, 1.0, -1.0)[:, None]
    turn = np.arccos(np.clip(-np.sum(parts.outward[1:-1][:, drones] * edge, axis=-1), -1.0, 1.0))
    leg = tensions[1:-1][:, balance.leg_unknown[drones]]
    along = tensions[1:-1][:, drones // 2]
    least = LEAST_RATIO * windows.tensions[1:-1][:, drones // 2]
    steady &= (leg > least) & (along > least)
    w, d = np.nonzero(steady)
    mean_rate = 0.5 * (before + after)[w, d]
    return SlidingClasps(
        w + 1,
        drones[d],
        np.log(leg[w, d] / along[w, d]),
        np.sign(mean_rate) * turn[w, d],
        np.abs(mean_rate) * 0.5 * (steps[w] + steps[w + 1]),
    )


def fit_friction(found: SlidingClasps) -> Estimate:
    """Return the coefficient that explains the ratios, by robust regression.

    The standard error is the larger of two: with errors that are common to a window, since all of
    its ratios follow from the same positions, and with errors that are common to a clasp's side,
    since cables differ.
    """
    slid = float(np.sum(found.slid))
    if slid < SLID:
        return Estimate.unknown(
            f"cables slide through clasps by {100 * slid:.1f} cm in all, less than {100 * SLID:g} "
            "cm: friction is not seen; move a vertex by some decimetres"
        )
    start = float(np.sum(found.turns * found.ratios) / np.sum(found.turns**2))
    scale = max(float(scale_of(found.ratios - start * found.turns)), 1e-3)

    def misfit(x: Array) -> Array:
        return np.asarray(found.ratios - x[0] * found.turns)

    fit = least_squares(misfit, [start], loss="soft_l1", f_scale=scale)
    mu = float(fit.x[0])
    residuals = found.ratios - mu * found.turns
    weights = 1.0 / np.sqrt(1.0 + (residuals / scale) ** 2)
    scores = weights * residuals * found.turns
    information = float(np.sum(weights**3 * found.turns**2))
    sums = [np.bincount(group, scores) for group in (found.windows, found.drones)]
    error = float(max(np.sqrt(np.sum(one**2)) for one in sums)) / information
    if error > LARGEST_ERROR or len(np.unique(found.windows)) < 3:
        return Estimate.unknown(
            f"its standard error would be {error:.2g}: tensions scatter by more than friction "
            "changes them; move vertices farther, or record more precisely"
        )
    return Estimate(max(mu, 0.0), error)
