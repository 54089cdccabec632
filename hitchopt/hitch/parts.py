"""A hitch as nodes and bodies, and the kinds of pairs of bodies that keep distances.

Nodes are the points, then the 2n drones (q0, r0, q1, …). Bodies are pairs of nodes: the 2n
drones (both nodes the same), then the taut parts of each cable k: its q-leg ``p_k q_k``, its edge
``p_k p_{k+1}``, its r-leg ``p_{k+1} r_k``; a leg that does not exist is no body.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, close_pairs, few_close_pairs
from hitchopt.hitch.team import CLOSED, Layout, layout_of
from hitchopt.values import Array
from hitchopt.values import Indices as Index

SEPARATION, CABLE, CROSSING = 0, 1, 2
"""Kinds of pairs: drone and drone, drone and cable, cable and cable."""

FEW = 40
"""Number of bodies up to which all of their pairs are compared, without an index."""

NEIGHBOURS = 100
"""Number of an index's candidates per body up to which pairs whose sweeps through all frames come
near are compared in every frame, which costs less than an index of all frames."""

CHUNK = 200_000
"""Number of pairs times frames that are compared at a time: the arrays fit in a core's cache."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The bodies of a hitch of n cables.

    Attributes
    ----------
    layout: indices of points, cables and drones.
    nodes: (bodies, 2), the two nodes of each body.
    cable: (bodies,), the cable that each belongs to.
    """

    layout: Layout
    nodes: Index
    cable: Index

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

    def kind(self, i: Index, j: Index) -> Index:
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
    ) -> tuple[Index, Index, Index, Index]:
        """Return (frame, body, body, kind) of all pairs whose boxes come near in a frame.

        Parameters
        ----------
        lowest, highest: (J, bodies, 2) [m], opposite corners of the boxes in J frames.
        limits: (3,) [m], distances by kind; pairs of a kind without one are left out.
        cutoff: [m]
        """
        listed = self._listed(lowest, highest, cutoff)
        if listed is not None:
            i, j, kind = (part[limits[listed[2]] > 0.0] for part in listed)
            if len(lowest) == 1 and self.many:  # listed as near
                return np.zeros_like(i), i, j, kind
            pair, frame = _close(lowest, highest, i, j, cutoff)
            return frame, i[pair], j[pair], kind[pair]
        # A third coordinate keeps the frames apart, so that one tree serves them all.
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

    def _listed(
        self, lowest: Array, highest: Array, cutoff: float
    ) -> tuple[Index, Index, Index] | None:
        """Return bodies (i, j) and kinds of pairs that may come near, or None: too many."""
        if not self.many:
            return self.all_pairs
        if len(lowest) == 1:
            single = close_pairs(Boxes(lowest[0], highest[0]), None, cutoff)
            return self._not_free(single.first, single.second)
        swept = Boxes(np.min(lowest, axis=0), np.max(highest, axis=0))
        found = few_close_pairs(swept, None, cutoff, NEIGHBOURS * len(self.nodes))
        return None if found is None else self._not_free(found.first, found.second)

    def _not_free(self, i: Index, j: Index) -> tuple[Index, Index, Index]:
        kind = self.kind(i, j)
        return i[kind >= 0], j[kind >= 0], kind[kind >= 0]

    @property
    def many(self) -> bool:
        """Whether there are too many bodies to compare all of their pairs."""
        return len(self.nodes) > FEW

    @cached_property
    def all_pairs(self) -> tuple[Index, Index, Index]:
        """Bodies (i, j) and kinds of all pairs that are not free to touch."""
        return self._not_free(*np.triu_indices(len(self.nodes), 1))

    def _have_common_clasp(self, i: Index, j: Index) -> NDArray[np.bool_]:
        a, b = self.nodes[i], self.nodes[j]
        a = np.where(a < self.layout.points, a, -1)  # only vertices are clasps
        b = np.where(b < self.layout.points, b, -2)
        common: NDArray[np.bool_] = np.any(a[:, :, None] == b[:, None, :], axis=(1, 2))
        return common


def _close(lowest: Array, highest: Array, i: Index, j: Index, cutoff: float) -> tuple[Index, Index]:
    """Return (pair, frame) of all pairs of boxes (i, j) that come within the cutoff in a frame."""
    sides = [(lower.copy(), upper.copy()) for lower, upper in zip(lowest.T, highest.T, strict=True)]
    size = max(1, CHUNK // len(lowest))
    found = []
    for first in range(0, max(len(i), 1), size):
        a, b = i[first : first + size], j[first : first + size]
        squared = np.zeros((len(a), len(lowest)))
        for lower, upper in sides:  # along x, then y
            gap = np.maximum(lower[a] - upper[b], lower[b] - upper[a])
            squared += np.maximum(gap, 0.0) ** 2
        pair, frame = np.nonzero(squared <= cutoff * cutoff)
        found.append((pair + first, frame))
    pairs, frames = (np.concatenate(part) for part in zip(*found, strict=True))
    return pairs, frames


def end_combinations(kind: Index, first: Index, second: Index) -> tuple[Index, Index, Index]:
    """Return (pair, node of the first, node of the second) of all ends of pairs against all.

    Bodies whose ends all lie on their sides of a normal are apart by as much.

    Parameters
    ----------
    kind: (m,), kinds of pairs.
    first, second: (m, 2), the nodes at the ends of their bodies; a drone's are the same.
    """
    found: list[tuple[Index, Index, Index]] = []
    for which, ends, other_ends in (
        (SEPARATION, (0,), (0,)),
        (CABLE, (0,), (0, 1)),
        (CROSSING, (0, 1), (0, 1)),
    ):
        pair = np.flatnonzero(kind == which)
        found += [(pair, first[pair, a], second[pair, b]) for a in ends for b in other_ends]
    pairs, a, b = (np.concatenate(column) for column in zip(*found, strict=True))
    return pairs, a, b
