"""Minimum of a hitch's energy by Newton's method, for many samples at once.

The Hessian is exact and sparse; a diagonal is added where a step does not descend, and steps are
shortened until the energy falls enough (Armijo). Where cables weigh nothing the energy is convex,
so that the minimum is global.
"""

from __future__ import annotations

import numpy as np

from hitchopt.settling.hitch_energy import HitchEnergy
from hitchopt.values import Array

SMALL_FORCE = 1e-11
"""[N] Forces this small on every node end the iteration."""

ROUNDED_FORCE = 16.0 * float(np.finfo(np.float64).eps)
"""Forces end it as well that are this small over the cables' stiffness times the coordinates."""

ITERATIONS = 200
"""Number of Newton iterations; warm starts take 5 to 30."""

HALVINGS = 30
"""Number of times that a step is halved before damping is raised."""

LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e6
"""[N/m] Range of the damping: clasps of slack cables have no stiffness of their own."""

FIRST_DAMPING = 1e-3
"""[N/m] Damping after the first step that does not descend."""

DESCENT = 1e-4
"""Share of the linear decrease that a step must bring (Armijo)."""

ROUNDING = 1e-14
"""Relative rounding of the energies, by which they may rise."""

LONGEST_STEP = 0.3
"""[m] Longest step of a node: directions change beyond it."""


def settled_nodes(energy: HitchEnergy, start: Array) -> Array:
    """Return the nodes (S, nodes, 3) [m] of least energy; the caller recomputes the residuals.

    Parameters
    ----------
    energy: of S samples.
    start: (S, nodes, 3) [m], where held drones are, and guesses for the other nodes.
    """
    x = start.copy()
    free = energy.rigging.free[:, None]
    damping = np.full(len(x), LEAST_DAMPING)
    values = energy.values(x)
    stiffest = 1.0 / np.min(energy.law.compliance)
    small = SMALL_FORCE + ROUNDED_FORCE * stiffest * np.max(np.abs(x), axis=(1, 2))
    for _ in range(ITERATIONS):
        slopes = np.where(free, energy.slopes(x), 0.0)
        active = np.max(np.abs(slopes), axis=(1, 2)) > small
        if not active.any():
            break
        added = energy.diagonal + damping[:, None]
        factor = energy.rigging.factor(energy.blocks(x), added)
        steps = -factor.solve(slopes)
        longest = np.max(np.linalg.norm(steps, axis=-1), axis=1)
        steps *= np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-300))[:, None, None]
        falls = np.einsum("sni,sni->s", steps, slopes)
        share = np.where(active & (falls < 0.0), 1.0, 0.0)
        found, reached = x, values
        pending = share > 0.0
        for _ in range(HALVINGS):
            if not pending.any():
                break
            tried = x + share[:, None, None] * steps
            energies = energy.values(tried)
            allowed = values + DESCENT * share * falls + ROUNDING * (1.0 + np.abs(values))
            good = pending & (energies <= allowed)
            found = np.where(good[:, None, None], tried, found)
            reached = np.where(good, energies, reached)
            pending &= ~good
            share = np.where(pending, 0.5 * share, share)
        failed = active & ((falls >= 0.0) | pending)
        raised = np.maximum(10.0 * damping, FIRST_DAMPING)
        damping = np.where(failed, raised, np.maximum(0.1 * damping, LEAST_DAMPING))
        damping = np.minimum(damping, MOST_DAMPING)
        x, values = found, reached
    return x
