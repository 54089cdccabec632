"""Contact forces at the clasps, and the hitch's vertices: the centres of these forces."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.statics import contact_forces
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.mujoco_world import World
from hitchopt.values import Array

BEARING_SHARE = 0.3
"""Least contact force of a clasp over the plan's. Cables that merely cross press by their weight
and by the drones' deviations, and Gauss's integral counts some of them as linked, since the lines
that close them cross there too."""


def least_bearing(task: Task) -> Array:
    """Return (samples, clasps) [N]: the contact force from which on a clasp bears.

    It is a share of the force with which a clasp presses without friction, which is
    ``|T (u_{k-1} + u_k)|`` where both its cables pull alike. A cable without tension bears nothing.
    """
    least = np.zeros((len(task.t), len(task.team.layout.clasps)))
    pulled = np.all(task.tensions > 0.0, axis=-1)
    directions = unit(task.team.layout.edges(task.vertices[pulled]))
    forces = contact_forces(directions, task.tensions[pulled], task.team.topology)
    least[pulled] = BEARING_SHARE * forces
    return least


class ClaspContacts:
    """Contact forces between neighbouring cables and their centres, gathered over some steps.

    Parameters
    ----------
    world: simulated world.
    team: defines which cables meet at which clasps.
    """

    def __init__(self, world: World, team: Team) -> None:
        self._world = world
        layout = team.layout
        ranks = np.arange(len(layout.clasps))
        self._clasp = np.full((team.robots, team.robots), -1)
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

    def collect(self, least: Array | float = 0.0) -> tuple[Array, Array]:
        """Return vertices and forces since the last call, and start again.

        Parameters
        ----------
        least: (clasps,) [N]; cables that press less do not bear on each other.

        Returns
        -------
        vertices: (clasps, 3) [m], centres of the contact force; nan where cables do not bear.
        forces: (clasps,) [N], mean sums of normal forces.
        """
        forces = self._force / max(self._count, 1)
        bears = (forces > 0.0) & (forces >= least)
        vertices = np.full_like(self._moment, np.nan)
        vertices[bears] = self._moment[bears] / self._force[bears, None]
        self._force[:], self._moment[:], self._count = 0.0, 0.0, 0
        return vertices, forces
