"""Where the hitch's vertices are: where neighbouring cables bear on each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.simulate.world import World

Array = NDArray[np.float64]

LEAST_BEARING = 1e-3
"""[N] Cables that press less do not bear on each other."""


class Bearing:
    """Contact forces between neighbouring cables, and their centre, gathered over some steps.

    Parameters
    ----------
    world: whose contacts they are.
    team: whose cables meet at which clasps.
    """

    def __init__(self, world: World, team: Team) -> None:
        self._world = world
        layout = team.layout
        n = team.robots
        self._clasp = np.full((n, n), -1)
        ranks = np.arange(len(layout.clasps))
        self._clasp[layout.behind, layout.ahead] = ranks
        self._clasp[layout.ahead, layout.behind] = ranks
        self._force = np.zeros(len(ranks))
        self._moment = np.zeros((len(ranks), 3))
        self._count = 0

    def gather(self) -> None:
        """Add the contacts of the last step."""
        self._count += 1
        data = self._world.data
        if not data.ncon:
            return
        flexes, rows = data.contact.flex, data.contact.efc_address
        between = np.flatnonzero(np.all(flexes >= 0, axis=1) & (rows >= 0))
        clasp = self._clasp[flexes[between, 0], flexes[between, 1]]
        chosen = between[clasp >= 0]
        clasp = clasp[clasp >= 0]
        force = np.maximum(data.efc_force[rows[chosen]], 0.0)  # elliptic: the normal comes first
        np.add.at(self._force, clasp, force)
        np.add.at(self._moment, clasp, force[:, None] * data.contact.pos[chosen])

    def collect(self) -> tuple[Array, Array]:
        """Return the vertices and the forces since the last time, and begin anew.

        Returns
        -------
        vertices: (clasps, 3) [m], centres of the contact force; nan where cables do not bear.
        forces: (clasps,) [N], mean sums of normal forces.
        """
        forces = self._force / max(self._count, 1)
        bears = forces > LEAST_BEARING
        vertices = np.full_like(self._moment, np.nan)
        vertices[bears] = self._moment[bears] / self._force[bears, None]
        self._force[:], self._moment[:], self._count = 0.0, 0.0, 0
        return vertices, forces
