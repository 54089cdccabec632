"""How far survivors are from each other and from the lost drone."""

from __future__ import annotations

import numpy as np

from hitchopt.motion.motion import Motion
from hitchopt.values import Array


def to_lost(motion: Motion, survivors: Array, places: Array) -> float:
    """Return the smallest distance of survivors (k, 3) and places of the lost drone (m, 3) [m].

    It is over two radii in every direction: ellipsoids are higher for the downwash, which a drone
    without motors has not, and does not mind.
    """
    distances = np.linalg.norm(survivors[:, None] - places, axis=-1)
    return float(np.min(distances, initial=np.inf)) / (2.0 * motion.requirements.separation.radius)


def apart(motion: Motion, survivors: Array) -> float:
    """Return the smallest separation of two survivors (k, 3) [m]."""
    scale = motion.requirements.separation.scale
    i, j = np.triu_indices(len(survivors), 1)
    distances = np.linalg.norm((survivors[i] - survivors[j]) * scale, axis=-1)
    return float(np.min(distances, initial=np.inf))
