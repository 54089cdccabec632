"""Rigging: the drones and clasps of a hitch as nodes, and its cables as spans between them.

Nodes are the drones q0, r0, q1, …, then the clasps. Every cable runs over four of them, drone,
clasp, clasp, drone. Where a chain's end has no leg the drone stands in for the clasp as well, and
the span between the two is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import SuperLU, splu

from hitchopt.hitch import Team
from hitchopt.values import Array

Index = NDArray[np.intp]

INCIDENCE = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, -1.0, 1.0, 0.0], [0.0, 0.0, -1.0, 1.0]])
"""(3, 4): each span of a cable from one of its nodes to the next."""

MIDDLES = 0.5 * np.abs(INCIDENCE)
"""(3, 4): the middle of each span."""


def add_at_nodes(totals: Array, nodes: Index, added: Array) -> None:
    """Add values (S, *k, …) to those of the nodes (*k) in totals (S, nodes, …); nodes may recur."""
    np.add.at(totals.swapaxes(0, 1), nodes, np.moveaxis(added, 0, nodes.ndim))


@dataclass(frozen=True, eq=False)
class Rigging:
    """Nodes and spans of a team, and which nodes give way.

    Attributes
    ----------
    drones: number 2n of drones, the first nodes.
    clasps: (c,), the points that are clasps; their nodes follow.
    nodes: (n, 4), nodes that each cable runs over.
    spans: (n, 3), whether q-leg, edge and r-leg exist.
    free: (2n + c,), whether a node moves: clasps, and drones that are not held in place.
    points: (points,), the node at each point.
    """

    drones: int
    clasps: Index
    nodes: Index
    spans: NDArray[np.bool_]
    free: NDArray[np.bool_]
    points: Index

    @classmethod
    def of(cls, team: Team, held: NDArray[np.bool_]) -> Rigging:
        """Return the rigging of a team whose drones (2n,) are held in place or give way."""
        layout, n = team.layout, team.robots
        points = np.zeros(layout.points, dtype=np.intp)
        points[layout.clasps] = 2 * n + np.arange(len(layout.clasps))
        for point, drone in ((0, 0), (layout.points - 1, 2 * n - 1)) if not layout.closed else ():
            points[point] = drone
        cables = np.arange(n)
        nodes = np.column_stack(
            [2 * cables, points[layout.starts], points[layout.ends], 2 * cables + 1]
        )
        spans = np.column_stack([layout.has_leg[:, 0], np.ones(n, np.bool_), layout.has_leg[:, 1]])
        free = np.concatenate([~held, np.ones(len(layout.clasps), np.bool_)])
        return cls(2 * n, layout.clasps, nodes, spans, free, points)

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.free)

    @cached_property
    def unknowns(self) -> Index:
        """(m,): indices of the coordinates that move, in an array (nodes, 3) that is flattened."""
        return np.flatnonzero(np.repeat(self.free, 3))

    @cached_property
    def _pattern(self) -> tuple[Index, Index, csc_array]:
        """Rows and columns of the entries of a Hessian, and the sum of blocks into entries."""
        coordinates = (3 * self.nodes[:, :, None] + np.arange(3)).reshape(-1, 12)
        rows = np.concatenate(
            [np.repeat(coordinates, 12, axis=1).ravel(), np.arange(3 * self.count)]
        )
        columns = np.concatenate([np.tile(coordinates, 12).ravel(), np.arange(3 * self.count)])
        keys, place = np.unique(columns * (3 * self.count) + rows, return_inverse=True)
        shape = (len(keys), len(rows))
        total = coo_array((np.ones(len(rows)), (place, np.arange(len(rows)))), shape=shape)
        return keys % (3 * self.count), keys // (3 * self.count), csc_array(total)

    def matrix(self, blocks: Array, diagonal: Array) -> csc_array:
        """Return the block-diagonal matrix (S N, S N) of the Hessians of S samples, N = 3 nodes.

        Parameters
        ----------
        blocks: (S, n, 12, 12), one per cable and its four nodes.
        diagonal: (S, N), added to it.
        """
        rows, columns, total = self._pattern
        samples, size = len(blocks), 3 * self.count
        parts = np.concatenate([blocks.reshape(samples, -1), diagonal], axis=1)
        values = (total @ parts.T).T
        shift = size * np.arange(samples)[:, None]
        places = ((rows + shift).ravel(), (columns + shift).ravel())
        return csc_array((values.ravel(), places), shape=(samples * size, samples * size))

    def factor(self, blocks: Array, diagonal: Array) -> Factor:
        """Return the factors of the Hessians in the coordinates that move."""
        samples, size = len(blocks), 3 * self.count
        moving = (self.unknowns + size * np.arange(samples)[:, None]).ravel()
        inner = self.matrix(blocks, diagonal)[moving][:, moving]
        # Symmetric and all but positive definite: the diagonal serves as pivots.
        factors = splu(
            csc_array(inner),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return Factor(self, samples, factors)


@dataclass(frozen=True, eq=False)
class Factor:
    """Factors of the Hessians of some samples."""

    rigging: Rigging
    samples: int
    factors: SuperLU

    def solve(self, forces: Array) -> Array:
        """Return the displacements that forces (S, nodes, 3, …) cause, of the same shape."""
        shape = forces.shape
        unknowns = self.rigging.unknowns
        flat = forces.reshape(self.samples, 3 * self.rigging.count, -1)
        right = np.ascontiguousarray(flat[:, unknowns].reshape(-1, flat.shape[-1]))
        found = np.zeros(flat.shape)
        solved = self.factors.solve(right)
        found[:, unknowns] = solved.reshape(self.samples, len(unknowns), -1)
        return found.reshape(shape)
