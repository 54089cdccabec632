"""What free cables of a team do to its drones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.team import GRAVITY, Team

Array = NDArray[np.float64]


def hanging_forces(team: Team, drones: Array) -> Array:
    """Return the force of hanging cables on drones that are at (…, 2n, 3) [m], in [N] likewise.

    Zero where cables weigh nothing.
    """
    if team.cable_density == 0.0:
        return np.zeros(drones.shape)
    q, r = drones[..., 0::2, :], drones[..., 1::2, :]
    pull = Catenary.between(q, r, team.cable_length).pull(q, r)
    forces: Array = GRAVITY * team.cable_density * pull.reshape(drones.shape)
    return forces
