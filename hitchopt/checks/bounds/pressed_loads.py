"""What carried objects press with on clasps, with the rounding of second derivatives."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.motion.carried import object_loads
from hitchopt.motion.motion import Motion
from hitchopt.values import Array


def pressed_loads(motion: Motion) -> Array | None:
    """Return forces on clasps and, in a fourth row, what these err by; None where there are none.

    Returns
    -------
    (pieces, clasps, 4, degree + 1) [N]
    """
    loads = object_loads(motion)
    if loads is None:
        return None
    mass = sum(each.mass for each in motion.requirements.objects.values() if not each.fixed)
    error = mass * derivative_margin(motion.vertices, 2)[:, motion.team.layout.clasps]
    error = np.where(np.any(loads != 0.0, axis=(2, 3)), error, 0.0)
    rows = np.broadcast_to(error[..., None, None], (*loads.shape[:2], 1, loads.shape[-1]))
    return np.concatenate([loads, rows], axis=2)
