"""Energy of drones that give way and of the cables between them, with slopes and Hessian.

Drones of stiffness k add ``½ k |x - x_set|² - F·x``, loads ``-w·x``, and cables what
``hitchopt.settling.cable_tension`` says. Without weight all of it is convex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.settling.cable_tension import CableLaw, Spans
from hitchopt.settling.rigging import INCIDENCE, MIDDLES, Rigging, add_at_nodes
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class HitchEnergy:
    """The energy of S samples of a hitch.

    Attributes
    ----------
    rigging: nodes and spans.
    law: of the cables, (S, n) where it says (…, n).
    places: (S, 2n, 3) [m], where drones are led.
    stiffness: (2n,) [N/m], finite for those that give way.
    forces: (S, nodes, 3) [N], of feed-forward on drones and of loads on clasps.
    """

    rigging: Rigging
    law: CableLaw
    places: Array
    stiffness: Array
    forces: Array

    def spans(self, x: Array) -> Spans:
        """Return the spans between nodes x (S, nodes, 3) [m]."""
        return Spans.between(x[:, self.rigging.nodes], self.rigging.spans)

    def values(self, x: Array) -> Array:
        """Return the energies (S,) [J]."""
        spans = self.spans(x)
        cables = np.sum(self.law.energies(spans, self.law.tensions(spans)), axis=-1)
        away = x[:, : self.rigging.drones] - self.places
        drones = 0.5 * np.einsum("sdi,d,sdi->s", away, self._soft, away)
        values: Array = cables + drones - np.einsum("sni,sni->s", self.forces, x)
        return values

    def slopes(self, x: Array) -> Array:
        """Return the slopes (S, nodes, 3) [N]: minus the force on every node."""
        spans = self.spans(x)
        T = self.law.tensions(spans)
        at_ends = np.einsum("pa,snpi->snai", INCIDENCE, self.law.pulls(spans, T))
        at_ends[..., 2] += self.law.weights(spans, T) @ MIDDLES
        slopes: Array = -self.forces.copy()
        add_at_nodes(slopes, self.rigging.nodes, at_ends)
        away = x[:, : self.rigging.drones] - self.places
        slopes[:, : self.rigging.drones] += self._soft[:, None] * away
        return slopes

    def length_slopes(self, spans: Spans, tensions: Array) -> Array:
        """Return (S, n, 4, 3): slopes of the cables' arc lengths by their four nodes."""
        by_vectors, by_heights = self.law.arc_slopes(spans, tensions)
        slopes = np.einsum("pa,snpi->snai", INCIDENCE, by_vectors)
        slopes[..., 2] += by_heights @ MIDDLES
        return np.asarray(slopes)

    def blocks(self, x: Array) -> Array:
        """Return (S, n, 12, 12) [N/m]: each cable's share of the Hessian, at its four nodes."""
        spans, law = self.spans(x), self.law
        T = law.tensions(spans)
        inner = np.zeros((*T.shape, 3, 3, 3, 3))
        own = np.arange(3)
        inner[:, :, own, :, own, :] = np.moveaxis(law.curvatures(spans, T), 2, 0)
        blocks = _by_ends(_by_ends(inner, 2), 4)
        if law.weight > 0.0:  # forces grow with height, and weights with arcs
            by_vectors, by_heights = law.arc_slopes(spans, T)
            lift = law.weight * np.einsum("pa,snpi,pb->snaib", INCIDENCE, by_vectors, MIDDLES)
            blocks[..., 2] += lift
            blocks[:, :, :, 2] += np.einsum("snbja->snabj", lift)
            higher = law.weight * np.einsum("pa,snp,pb->snab", MIDDLES, by_heights, MIDDLES)
            blocks[:, :, :, 2, :, 2] += higher
        longer = self.length_slopes(spans, T)
        stiff = law.length_slopes(spans, T)[..., None, None, None, None]
        blocks += stiff * longer[..., :, :, None, None] * longer[:, :, None, None]
        return np.asarray(blocks.reshape(*T.shape, 12, 12))

    @property
    def diagonal(self) -> Array:
        """(3 nodes,) [N/m]: what the drones' stiffness adds to the Hessian."""
        diagonal = np.zeros(3 * self.rigging.count)
        diagonal[: 3 * self.rigging.drones] = np.repeat(self._soft, 3)
        return diagonal

    @property
    def _soft(self) -> Array:
        free = self.rigging.free[: self.rigging.drones]
        return np.where(free, np.where(free, self.stiffness, 1.0), 0.0)


def _by_ends(values: Array, axis: int) -> Array:
    """Return what derivatives by three spans are by their four ends, along ``axis``: INCIDENCEᵀ."""
    wide = [(0, 0)] * values.ndim
    wide[axis] = (1, 1)
    return np.asarray(-np.diff(np.pad(values, wide), axis=axis))
