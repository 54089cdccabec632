"""Energy of drones that give way and of the cables between them, with slopes and Hessian.

Drones of stiffness k add ``½ k |x - x_set|² - F·x``, loads ``-w·x``, and cables what
``hitchopt.settling.cable_tension`` says. Without weight all of it is convex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.settling.cable_tension import CableLaw
from hitchopt.settling.rigging import INCIDENCE, MIDDLES, Rigging, add_at_nodes
from hitchopt.values import Array

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Spans:
    """Spans of the cables: chords (S, n, 3), directions (S, n, 3, 3), heights of the middles."""

    chords: Array
    directions: Array
    middles: Array


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
        ends = x[:, self.rigging.nodes]
        vectors = np.diff(ends, axis=2)
        chords = np.where(self.rigging.spans, np.linalg.norm(vectors, axis=-1), 0.0)
        long = np.where(chords > 0.0, chords, 1.0)[..., None]
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        return Spans(chords, np.where(chords[..., None] > 0.0, vectors / long, 0.0), middles)

    def tensions(self, x: Array) -> Array:
        """Return the tensions (S, n) [N]."""
        return self.law.tensions(self.spans(x).chords)

    def values(self, x: Array) -> Array:
        """Return the energies (S,) [J]."""
        spans = self.spans(x)
        T = self.law.tensions(spans.chords)
        cables = np.sum(self.law.energies(spans.chords, spans.middles, T), axis=-1)
        away = x[:, : self.rigging.drones] - self.places
        drones = 0.5 * np.einsum("sdi,d,sdi->s", away, self._soft, away)
        values: Array = cables + drones - np.einsum("sni,sni->s", self.forces, x)
        return values

    def slopes(self, x: Array) -> Array:
        """Return the slopes (S, nodes, 3) [N]: minus the force on every node."""
        spans = self.spans(x)
        T = self.law.tensions(spans.chords)
        along = self.law.span_tensions(spans.chords, spans.middles, T)[..., None]
        at_ends = np.einsum("pa,snpi->snai", INCIDENCE, along * spans.directions)
        at_ends[..., 2] += self.law.weight * spans.chords @ MIDDLES
        slopes: Array = -self.forces.copy()
        add_at_nodes(slopes, self.rigging.nodes, at_ends)
        away = x[:, : self.rigging.drones] - self.places
        slopes[:, : self.rigging.drones] += self._soft[:, None] * away
        return slopes

    def blocks(self, x: Array) -> Array:
        """Return (S, n, 12, 12) [N/m]: each cable's share of the Hessian, at its four nodes."""
        spans = self.spans(x)
        T = self.law.tensions(spans.chords)
        u = spans.directions
        along = self.law.span_tensions(spans.chords, spans.middles, T)
        slack = np.where(spans.chords > 0.0, along, 0.0)
        across = slack / np.where(spans.chords > 0.0, spans.chords, 1.0)
        stiff = self.law.chord_stiffness(spans.chords, T)
        # by the spans' vectors, then by their ends
        inner = stiff[:, :, :, None, :, None] * u[..., None, None] * u[:, :, None, None]
        side = across[..., None, None] * (np.eye(3) - u[..., :, None] * u[..., None, :])
        own = np.arange(3)
        inner[:, :, own, :, own, :] += np.moveaxis(side, 2, 0)
        blocks = _by_ends(_by_ends(inner, 2), 4)
        if self.law.weight > 0.0:
            lift = self.law.weight * np.einsum("pa,snpi,pb,j->snaibj", INCIDENCE, u, MIDDLES, UP)
            blocks += lift + np.einsum("snaibj->snbjai", lift)
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
