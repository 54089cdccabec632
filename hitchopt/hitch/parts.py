"""A hitch as nodes and parts: which parts of cables and which drones must keep apart.

Nodes are the n vertices, then the 2n drones (q0, r0, q1, …). Bodies are pairs of nodes: the 2n
drones (both nodes the same), then three taut parts of each cable k: its q-leg ``p_k q_k``, its
edge ``p_k p_{k+1}``, its r-leg ``p_{k+1} r_k``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]

SEPARATION, CABLE, CROSSING = 0, 1, 2
"""Kinds of pairs: drone and drone, drone and cable, cable and cable."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The bodies of a closed hitch of n cables.

    Attributes
    ----------
    robots: n
    nodes: (5n, 2), the two nodes of each body.
    cable: (5n,), the cable that each belongs to.
    """

    robots: int
    nodes: Index
    cable: Index

    @classmethod
    def of(cls, robots: int) -> Parts:
        """Return the bodies of a closed hitch of that many cables."""
        k = np.arange(robots)
        drones = robots + np.arange(2 * robots)
        q, r, following = robots + 2 * k, robots + 2 * k + 1, (k + 1) % robots
        parts = np.stack(
            [
                np.column_stack([k, q]),
                np.column_stack([k, following]),
                np.column_stack([following, r]),
            ],
            axis=1,
        ).reshape(-1, 2)
        nodes = np.concatenate([np.column_stack([drones, drones]), parts])
        return cls(robots, nodes, np.concatenate([np.repeat(k, 2), np.repeat(k, 3)]))

    def kind(self, i: Index, j: Index) -> Index:
        """Return the kind of each pair of bodies (i below j), or -1 where they are free to touch.

        Free are a drone and its own legs, and parts that meet at a clasp.
        """
        drones = 2 * self.robots
        i_drone, j_drone = i < drones, j < drones
        same = self.cable[i] == self.cable[j]
        j_edge = ~j_drone & ((j - drones) % 3 == 1)
        drone_cable = i_drone & ~j_drone & (~same | j_edge)
        apart = ~i_drone & ~j_drone & ~self._share_clasp(i, j)
        kind = np.full(i.shape, -1)
        kind[i_drone & j_drone] = SEPARATION
        kind[drone_cable] = CABLE
        kind[apart] = CROSSING
        return kind

    def _share_clasp(self, i: Index, j: Index) -> NDArray[np.bool_]:
        a, b = self.nodes[i], self.nodes[j]
        a = np.where(a < self.robots, a, -1)  # only vertices are clasps
        b = np.where(b < self.robots, b, -2)
        shared: NDArray[np.bool_] = np.any(a[:, :, None] == b[:, None, :], axis=(1, 2))
        return shared
