"""Loads that hang at the clasps: mass of the nodes where both cables of a clasp touch.

A load hangs on both cables like a ring through two links of a chain. Its mass is that of the nodes
that press on each other there, such that its weight and its inertia act; as cables slide through
the clasp it passes to the nodes that follow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.simulation.mujoco_world import World

Array = NDArray[np.float64]

SMOOTHING = 0.05
"""Time constant with which a load passes from nodes to others as contacts come and go [s]."""

LEAST_FORCE = 1e-9
"""Normal force below which cables do not touch [N]."""


class HungLoads:
    """Loads at the clasps of a simulated hitch.

    Parameters
    ----------
    world: simulated world.
    team: its loads, and which cables meet at which clasps.
    """

    def __init__(self, world: World, team: Team) -> None:
        self._world, self._mass = world, team.load
        layout, clasps = team.layout, len(team.load)
        self._clasp = np.full((team.robots, team.robots), -1)
        self._clasp[layout.behind, layout.ahead] = np.arange(clasps)
        self._clasp[layout.ahead, layout.behind] = np.arange(clasps)
        self._cable = np.repeat(np.arange(team.robots), np.diff(world.cable_vertices))
        self._bodies = world.model.flex_vertbodyid
        self._empty = world.model.body_mass[self._bodies]
        self._on_nodes = np.zeros((clasps, len(self._bodies)))  # share of a load on every node

    def apply(self, shares: Array, seconds: float) -> None:
        """Put the loads on the nodes at their clasps for the next ``seconds``.

        A clasp whose cables do not touch loses its load.

        Parameters
        ----------
        shares: (n,), share of its half of a load that each cable carries already.
        seconds: time until the next call.
        """
        kept = np.exp(-seconds / SMOOTHING)
        self._on_nodes = kept * self._on_nodes + (1.0 - kept) * self._touching()
        added = self._mass @ self._on_nodes * shares[self._cable]
        self._world.model.body_mass[self._bodies] = self._empty + added

    def _touching(self) -> Array:
        """Return the share of its contact force on every node of every clasp (clasps, nodes)."""
        data, first = self._world.data, self._world.cable_vertices
        flexes, rows = data.contact.flex, data.contact.efc_address
        chosen = np.flatnonzero(np.all(flexes >= 0, axis=1) & (rows >= 0))
        chosen = chosen[self._clasp[flexes[chosen, 0], flexes[chosen, 1]] >= 0]
        cables = flexes[chosen]
        clasp = self._clasp[cables[:, 0], cables[:, 1]]
        force = np.maximum(data.efc_force[rows[chosen]], LEAST_FORCE)
        force = force / np.bincount(clasp, force, len(self._mass))[clasp]
        node = first[cables] + data.contact.elem[chosen]
        shares = np.zeros_like(self._on_nodes)
        for end in (0, 1):  # of both elements that touch
            np.add.at(shares, (clasp[:, None], node + end), 0.25 * force[:, None])
        return shares
