"""Energy and tension of cables that run over clasps without friction, from their spans.

A hanging span with chord v, of length s and level length h, and with the tension m at the height of
its chord's middle, costs the energy ``∫ (tension) ds``; to the second order in its weight w over m

    E(v, m) = m s - w² s h²/(24 m).

Its slope by m is its arc length ``s + w² s h²/(24 m²)``, its slope by v the force on its ends but
for half of its weight. Tension grows with height: ``m = T + w (z - z₀)``, z the height of the
chord's middle, with one T for all spans of a cable. With the cable's length L and its stretch
``a (T - T₀)`` the energy of a cable is the maximum over T of

    Σ E(v, m) - T L - a (T - T₀)²/2;

at the maximum arcs and stretch make up the length. The next order is ``7 (w s/m)⁴ m s/1920``, and
nothing where spans hang by less than a tenth of their chord. T is at least the tension at which the
cable is slack; below that tension arcs are taken to be constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

NEWTON = 60
"""Number of Newton iterations for T; from below they rise by half at least, then converge
quadratically."""

CONVERGED = 1e-11
"""Relative step that ends the iteration: the next one would be the square of it."""

BEGINNING = 1e-9
"""Rounding of the tension at which a span begins to be taut, over that tension."""

SAG_RATIO = 4.0
"""A cable is slack where a level span as long as its longest one would hang by more than its chord
over this number."""

LEVEL = np.array([1.0, 1.0, 0.0])
"""Level part of a vector."""


def least_tension(weight: float, chords: Array) -> Array:
    """Return (…, n) [N] the tension at which the longest span hangs by its chord over SAG_RATIO.

    Parameters
    ----------
    weight: of the cables per length [N/m].
    chords: (…, n, 3) [m], of the spans.
    """
    least: Array = weight * SAG_RATIO / 8.0 * np.max(chords, axis=-1)
    return least


@dataclass(frozen=True, eq=False)
class Spans:
    """Spans of cables.

    Attributes
    ----------
    vectors: (…, n, 3, 3) [m], from end to end; zero where a chain's end has no leg.
    middles: (…, n, 3) [m], heights of their middles.
    chords: (…, n, 3) [m], lengths.
    directions: (…, n, 3, 3), zero where there is no length.
    bulges: (…, n, 3) [m³], ``s h²``.
    """

    vectors: Array
    middles: Array
    chords: Array
    directions: Array
    bulges: Array

    @classmethod
    def between(cls, ends: Array, exist: NDArray[np.bool_]) -> Spans:
        """Return the spans between the four nodes (…, n, 4, 3) [m] of cables.

        Parameters
        ----------
        exist: (n, 3), which of them there are.
        """
        vectors = np.where(exist[..., None], np.diff(ends, axis=-2), 0.0)
        chords = np.linalg.norm(vectors, axis=-1)
        directions = vectors / np.where(chords > 0.0, chords, 1.0)[..., None]
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        level = np.sum(vectors[..., :2] ** 2, axis=-1)
        return cls(vectors, middles, chords, directions, chords * level)

    @property
    def bulge_slopes(self) -> Array:
        """(…, n, 3, 3) [m²]: slopes of the bulges by the vectors."""
        level = np.sum(self.vectors[..., :2] ** 2, axis=-1)[..., None]
        return np.asarray(
            level * self.directions + 2.0 * self.chords[..., None] * self.vectors * LEVEL
        )

    def curvatures(self, tensions: Array, sagging: Array) -> Array:
        """Return (…, n, 3, 3, 3): second derivatives by the vectors.

        Parameters
        ----------
        tensions, sagging: (…, n, 3), factors of the chords and of the bulges.
        """
        u, v = self.directions, self.vectors * LEVEL
        across = np.eye(3) - u[..., :, None] * u[..., None, :]
        across /= np.where(self.chords > 0.0, self.chords, np.inf)[..., None, None]
        mixed = u[..., :, None] * v[..., None, :]
        level = np.sum(self.vectors[..., :2] ** 2, axis=-1)
        found = (tensions + sagging * level)[..., None, None] * across
        found += 2.0 * sagging[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
        found += 2.0 * (sagging * self.chords)[..., None, None] * np.diag(LEVEL)
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class CableLaw:
    """Lengths, weight and stretch of cables (…, n).

    Attributes
    ----------
    lengths: (…, n) [m], L at the tension T₀.
    weight: per length [N/m].
    compliance: (n,) [m/N], a: what a cable grows by per tension.
    reference: (…, n) [N], T₀.
    heights: (…, n) [m], z₀.
    least: (…, n) [N], tension at which a cable is slack.
    """

    lengths: Array
    weight: float
    compliance: Array
    reference: Array
    heights: Array
    least: Array

    def tensions(self, spans: Spans) -> Array:
        """Return T (…, n) [N]."""
        a = self.compliance
        spare = np.sum(spans.chords, axis=-1) - self.lengths + a * self.reference
        if self.weight == 0.0:
            return np.asarray(np.maximum(self.least, spare / a))
        # The excess of length falls with T. It is convex but where a span begins to pull with more
        # than the least tension: from the last such T at which there is an excess, Newton's method
        # rises to the solution.
        T = np.maximum(self.least, np.maximum(spare / a, 0.0))
        c = self.weight**2 / 24.0

        def excess(T: Array) -> tuple[Array, Array]:
            """Return the excess of length and how much it falls with T."""
            m, least = self.middle_tensions(spans, T), self.least[..., None]
            held = np.maximum(m, least)
            arcs = c * spans.bulges / held**2
            falling = np.where(m >= (1.0 - BEGINNING) * least, 2.0 * arcs / held, 0.0)
            return spare - a * T + np.sum(arcs, axis=-1), a + np.sum(falling, axis=-1)

        begins = self.least[..., None] + self.weight * (self.heights[..., None] - spans.middles)
        for begin in np.moveaxis(begins, -1, 0):
            if np.any(begin > T):
                T = np.where((begin > T) & (excess(begin)[0] >= 0.0), begin, T)
        for _ in range(NEWTON):
            over, fall = excess(T)
            step: Array = np.maximum(over, 0.0) / fall
            T = T + step
            if np.all(step <= CONVERGED * T):
                break
        return np.asarray(T)

    def slack(self, tensions: Array) -> NDArray[np.bool_]:
        """Return (…, n) whether cables of these tensions [N] are slack."""
        return np.asarray(tensions <= self.least)

    def hanging(self, spans: Spans, tensions: Array) -> NDArray[np.bool_]:
        """Return (…, n) whether cables of these tensions [N] are slack, or hang as slack ones do.

        A span that has come down pulls with less than T: it hangs by its chord over SAG_RATIO where
        its own tension is ``SAG_RATIO w s/8``.
        """
        m = self.middle_tensions(spans, tensions)
        deep = 8.0 * m < SAG_RATIO * self.weight * spans.chords
        return np.asarray(self.slack(tensions) | np.any(deep, axis=-1))

    def middle_tensions(self, spans: Spans, tensions: Array) -> Array:
        """Return m (…, n, 3) [N] at the heights of the spans' middles."""
        higher = spans.middles - self.heights[..., None]
        found: Array = tensions[..., None] + self.weight * higher
        return found

    def energies(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n) [J], but for a constant; T is that of ``tensions``."""
        m = self.middle_tensions(spans, tensions)
        hanging = m * spans.chords + self._factors(m)[0] * spans.bulges
        stretch = 0.5 * self.compliance * (tensions - self.reference) ** 2
        energies: Array = np.sum(hanging, axis=-1) - tensions * self.lengths - stretch
        return energies

    def pulls(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3, 3) [N]: slopes of the energy by the spans' vectors."""
        m = self.middle_tensions(spans, tensions)
        sagging = self._factors(m)[0][..., None] * spans.bulge_slopes
        return np.asarray(m[..., None] * spans.directions + sagging)

    def weights(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3) [N] the weights of the spans: slopes of the energy by their heights."""
        return np.asarray(self.weight * (spans.chords + self.arcs(spans, tensions)))

    def arcs(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3) [m]: what arcs are longer than their chords."""
        m = self.middle_tensions(spans, tensions)
        return np.asarray(self._factors(m)[1] * spans.bulges)

    def softness(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n) [m/N]: what a cable gives per tension, by stretch and by less sag."""
        m = self.middle_tensions(spans, tensions)
        sag = np.sum(self._factors(m)[2] * spans.bulges, axis=-1)
        return np.asarray(self.compliance - sag)

    def length_slopes(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n) [N/m]: what T loses per length that the cable is longer."""
        return np.where(self.slack(tensions), 0.0, 1.0 / self.softness(spans, tensions))

    def arc_slopes(self, spans: Spans, tensions: Array) -> tuple[Array, Array]:
        """Return the slopes of the arc lengths by vectors (…, n, 3, 3) and heights (…, n, 3)."""
        _, second, third = self._factors(self.middle_tensions(spans, tensions))
        by_vectors = spans.directions + second[..., None] * spans.bulge_slopes
        return by_vectors, self.weight * third * spans.bulges

    def curvatures(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3, 3, 3) [N/m]: second derivatives by the vectors at constant T."""
        m = self.middle_tensions(spans, tensions)
        return spans.curvatures(m, self._factors(m)[0])

    def _factors(self, m: Array) -> tuple[Array, Array, Array]:
        """Return the factors of the bulges in energy, arc length, and its slope by m."""
        if self.weight == 0.0:
            return (np.zeros_like(m),) * 3
        c = self.weight**2 / 24.0
        held = np.maximum(m, self.least[..., None])
        inside = np.where(m > self.least[..., None], -2.0 * c / held**3, 0.0)
        return c * (-1.0 / held + (m - held) / held**2), c / held**2, inside
