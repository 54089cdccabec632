"""What the cables of a team do to its drones, whether they hang free or hold a hitch."""

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


def cable_forces(team: Team, drones: Array, vertices: Array, pulls: Array, taut: Array) -> Array:
    """Return the force of cables on drones (…, 2n, 3) [N], between hanging free and taut.

    A leg pulls toward its vertex (at a chain's end along the edge), and a taut cable puts half of
    its weight on each of its drones. To the share that a cable is not yet taut, what a hanging one
    pulls with takes the place of that weight.

    Parameters
    ----------
    drones: (…, 2n, 3) [m]
    vertices: (…, points, 3) [m]
    pulls: (…, 2n) [N], of the legs; 0 while there is no hitch.
    taut: (…, n), from 0 to 1.
    """
    if not team.has_cables:
        return np.zeros(drones.shape)
    outward = drones - vertices[..., team.layout.pulled_to, :]
    lengths = np.linalg.norm(outward, axis=-1, keepdims=True)
    # A leg without length has no direction: no force rather than nan (certified plans have none).
    directions = np.divide(outward, lengths, out=np.zeros_like(outward), where=lengths > 0.0)
    forces: Array = 0.0 - pulls[..., None] * directions  # no negative zeros
    if team.cable_density > 0.0:
        share = np.repeat(taut, 2, axis=-1)
        forces[..., 2] -= share * team.cable_weight
        if np.any(share < 1.0):
            forces += (1.0 - share)[..., None] * hanging_forces(team, drones)
    return forces
