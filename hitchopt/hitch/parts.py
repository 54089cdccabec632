"""A hitch as nodes and bodies, and the kinds of pairs of bodies that keep distances.

Nodes are the points, then the 2n drones (q0, r0, q1, …). Bodies are pairs of nodes: the 2n
drones (both nodes the same), then the taut parts of each cable k: its q-leg ``p_k q_k``, its edge
``p_k p_{k+1}``, its r-leg ``p_{k+1} r_k``; a leg that does not exist is no body.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.hitch.team import CLOSED, Layout, layout_of
from hitchopt.values import Array, Indices

SEPARATION, CABLE, CROSSING = 0, 1, 2
"""Kinds of pairs: drone and drone, drone and cable, cable and cable."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The bodies of a hitch: their two nodes (bodies, 2), and the cable that each belongs to."""

    layout: Layout
    nodes: Indices
    cable: Indices

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, robots: int, topology: str = CLOSED) -> Parts:
        """Return the bodies of a hitch of that many cables."""
        layout = layout_of(robots, topology)
        k, starts, ends = np.arange(layout.robots), layout.starts, layout.ends
        drones = layout.points + np.arange(2 * layout.robots)
        q, r = drones[0::2], drones[1::2]
        parts = np.stack([starts, q, starts, ends, ends, r], axis=1).reshape(-1, 2)
        nodes = np.concatenate([np.column_stack([drones, drones]), parts[layout.parts]])
        return cls(layout, nodes, np.concatenate([np.repeat(k, 2), layout.parts // 3]))

    def kind(self, i: Indices, j: Indices) -> Indices:
        """Return the kind of each pair of bodies (i below j), or -1 where they are free to touch.

        Free are a drone and its own legs, or its edge if it stands at its end, and parts that meet
        at a clasp.
        """
        drones = 2 * self.layout.robots
        i_drone, j_drone = i < drones, j < drones
        same = self.cable[i] == self.cable[j]
        edges = np.concatenate([np.zeros(drones, np.bool_), self.layout.parts % 3 == 1])
        on_leg = self.layout.has_leg.ravel()[np.minimum(i, drones - 1)]
        j_edge = edges[j] & on_leg
        drone_cable = i_drone & ~j_drone & (~same | j_edge)
        apart = ~i_drone & ~j_drone & ~self._have_common_clasp(i, j)
        kind = np.full(i.shape, -1)
        kind[i_drone & j_drone] = SEPARATION
        kind[drone_cable] = CABLE
        kind[apart] = CROSSING
        return kind

    def near(
        self, lowest: Array, highest: Array, limits: Array, cutoff: float
    ) -> tuple[Indices, Indices, Indices, Indices]:
        """Return (frame, body, body, kind) of all pairs whose boxes come near in a frame.

        Parameters
        ----------
        lowest, highest: (J, bodies, 2) [m], opposite corners of the boxes in J frames.
        limits: (3,) [m], distances by kind; pairs of a kind without one are left out.
        cutoff: [m]
        """
        # A third coordinate keeps the frames apart, so that one index serves them all.
        step = 4.0 * (cutoff + float(np.max(highest) - np.min(lowest)))
        bodies = len(self.nodes)
        level = np.repeat(np.arange(len(lowest)) * step, bodies)
        corners = (np.column_stack([c.reshape(-1, 2), level]) for c in (lowest, highest))
        pairs = close_pairs(Boxes(*corners), None, cutoff)
        frame, i = np.divmod(pairs.first, bodies)
        j = pairs.second % bodies
        kind = self.kind(i, j)
        wanted = (kind >= 0) & (limits[kind] > 0.0)
        return frame[wanted], i[wanted], j[wanted], kind[wanted]

    def _have_common_clasp(self, i: Indices, j: Indices) -> NDArray[np.bool_]:
        a, b = self.nodes[i], self.nodes[j]
        a = np.where(a < self.layout.points, a, -1)  # only vertices are clasps
        b = np.where(b < self.layout.points, b, -2)
        common: NDArray[np.bool_] = np.any(a[:, :, None] == b[:, None, :], axis=(1, 2))
        return common


def end_combinations(
    kind: Indices, first: Indices, second: Indices
) -> tuple[Indices, Indices, Indices]:
    """Return (pair, node of the first, node of the second) of all ends of pairs against all.

    Bodies whose ends all lie on their sides of a normal are apart by as much. Of kinds of pairs
    (m,) and the nodes (m, 2) at the ends of their bodies; a drone's are the same.
    """
    found: list[tuple[Indices, Indices, Indices]] = []
    for which, ends, other_ends in (
        (SEPARATION, (0,), (0,)),
        (CABLE, (0,), (0, 1)),
        (CROSSING, (0, 1), (0, 1)),
    ):
        pair = np.flatnonzero(kind == which)
        found += [(pair, first[pair, a], second[pair, b]) for a in ends for b in other_ends]
    pairs, a, b = (np.concatenate(column) for column in zip(*found, strict=True))
    return pairs, a, b
