"""Derivatives of a settled hitch by its errors: one linear solve with the Hessian each.

At rest the energy's slope is zero for any error p, so ``H dx = -∂slope/∂p dp``. A tension's row
``A_k`` of derivatives by the nodes is at the same time, turned round, what a longer cable k does
to the slope: ``dx = H⁻¹ A_k dL_k``. Rows of outputs are found by the adjoint, ``Y = H⁻¹ B`` for the
outputs' derivatives B by the nodes, block by block: every output depends on every error, so that
the work grows with n², the memory with n.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from hitchopt.settling.hitch_energy import HitchEnergy
from hitchopt.settling.rigging import MIDDLES, Factor, Index, add_at_nodes
from hitchopt.values import Array

BLOCK = 48
"""Outputs that are solved for at once."""

LEAST_STIFFNESS = 1e-9
"""[N/m] Added to the Hessian's diagonal: slack cables hold their clasps by nothing."""


@dataclass(frozen=True, eq=False)
class Gradients:
    """Derivatives of some outputs, o of them, in S samples.

    Attributes
    ----------
    cable: (S, o, n) by the cables' lengths.
    position: (S, o, 2n, 3) by the drones' set points.
    force: (S, o, 2n, 3) by the forces on drones.
    """

    cable: Array
    position: Array
    force: Array


@dataclass(frozen=True, eq=False)
class Response:
    """First-order response of a hitch that has settled at nodes x (S, nodes, 3)."""

    energy: HitchEnergy
    x: Array

    @cached_property
    def _cables(self) -> tuple[Array, Array]:
        """Slopes of T by its cable's nodes (S, n, 4, 3), and by its length turned round (S, n)."""
        spans, law = self.energy.spans(self.x), self.energy.law
        T = law.tensions(spans)
        shorter = law.length_slopes(spans, T)
        along = shorter[..., None, None] * self.energy.length_slopes(spans, T)
        return along, shorter

    @cached_property
    def _tensions(self) -> Array:
        """Slopes (S, n, 4, 3) of the tensions in the edges' middles, by their cables' nodes."""
        slopes = self._cables[0].copy()
        slopes[..., 2] += self.energy.law.weight * MIDDLES[1]
        return slopes

    @cached_property
    def _hessian(self) -> tuple[csc_array, Factor]:
        blocks = self.energy.blocks(self.x)
        shape = (len(self.x), 3 * self.energy.rigging.count)
        diagonal = np.broadcast_to(self.energy.diagonal + LEAST_STIFFNESS, shape)
        rigging = self.energy.rigging
        return rigging.matrix(blocks, diagonal), rigging.factor(blocks, diagonal)

    def _times_hessian(self, nodes: Array) -> Array:
        """Return H times displacements (S, nodes, 3, o)."""
        flat = nodes.reshape(-1, nodes.shape[-1])
        return np.asarray(self._hessian[0] @ flat).reshape(nodes.shape)

    def gradients_of_tensions(self, cables: Index) -> Gradients:
        """Return the gradients of the tensions of some cables (o,) [N/m], [N/N]."""
        along, shorter = self._tensions, self._cables[1]
        seeds = np.zeros((*self.x.shape, len(cables)))
        nodes = self.energy.rigging.nodes[cables]
        for i, row in enumerate(nodes.T):  # the four nodes of a cable
            seeds[:, row, :, np.arange(len(cables))] += np.moveaxis(along[:, cables, i], 1, 0)
        found = self._adjoint(seeds)
        found.cable[:, np.arange(len(cables)), cables] -= shorter[:, cables]
        return found

    def gradients_of_points(self, points: Index) -> Gradients:
        """Return the gradients of points' coordinates, o = 3 for each of them, in order."""
        seeds = np.zeros((*self.x.shape, 3 * len(points)))
        nodes = np.repeat(self.energy.rigging.points[points], 3)
        axes = np.tile(np.arange(3), len(points))
        seeds[:, nodes, axes, np.arange(3 * len(points))] = 1.0
        return self._adjoint(seeds)

    def blocks(self, count: int, each: int) -> Iterator[Index]:
        """Give the indices of ``count`` items, each of them ``each`` outputs, in blocks."""
        size = max(1, BLOCK // each)
        for first in range(0, count, size):
            yield np.arange(first, min(first + size, count))

    def _adjoint(self, seeds: Array) -> Gradients:
        rigging, drones = self.energy.rigging, self.energy.rigging.drones
        found = self._hessian[1].solve(seeds)
        along, _ = self._cables
        cable = np.einsum("snaio,snai->son", found[:, rigging.nodes], along)
        soft = rigging.free[:drones]
        force = np.moveaxis(found[:, :drones], 3, 1)
        position = np.where(soft, self.energy.stiffness, 0.0)[:, None] * force
        if not np.all(soft):  # a drone that is held moves its node itself
            direct = (seeds - self._times_hessian(found))[:, :drones]
            position = np.where(soft[:, None], position, np.moveaxis(direct, 3, 1))
        return Gradients(cable, position, force)

    def to(self, cable: Array, position: Array, force: Array) -> tuple[Array, Array]:
        """Return the changes of nodes (o, nodes, 3) [m] and tensions (o, n) [N] of one sample.

        Parameters
        ----------
        cable: (o, n) [m], changes of the lengths.
        position, force: (o, 2n, 3) [m], [N], changes of set points and forces on drones.
        """
        rigging, drones = self.energy.rigging, self.energy.rigging.drones
        along, shorter = self._cables
        soft = rigging.free[:drones, None]
        held = np.zeros((len(cable), *self.x.shape[1:]))
        held[:, :drones] = np.where(soft, 0.0, position)
        stiffness = np.where(soft, self.energy.stiffness[:, None], 0.0)
        pushed = np.zeros(held.shape)
        pushed[:, :drones] = np.where(soft, stiffness * position + force, 0.0)
        add_at_nodes(pushed, rigging.nodes, cable[..., None, None] * along)
        columns = np.moveaxis(held, 0, 2)[None]
        right = np.moveaxis(pushed, 0, 2)[None] - self._times_hessian(columns)
        moved = np.moveaxis((columns + self._hessian[1].solve(right))[0], 2, 0)
        tensions = np.einsum("snai,nai->sn", moved[:, rigging.nodes], self._tensions[0])
        return moved, tensions - shorter * cable
