"""Tension of a cable over clasps without friction, from the lengths and heights of its spans.

A span of chord s that carries the tension T sags by ``w s²/(8T)`` and is longer than its chord by
``(w/T)² s³/24``, w the weight per length [N/m]; a cable stretches by ``a (T - T₀)``. So the chords
ℓ of a cable of length L fit at the one T with

    ℓ - L + κ/T² - a (T - T₀) = 0,   κ = w² Σ s³/24,

a cubic with one positive root. The cable's energy is the maximum over T of

    w Σ s (z - z₀) + T (ℓ - L) - κ/T - a (T - T₀)²/2,

z the height of each chord's middle: its slope along a span is the tension in the middle of the
hanging span, ``T + w (z - z₀) - (w s)²/(8T)``, and what it has by heights puts half of each span's
weight on each of its ends. T is the tension at height z₀.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

NEWTON = 40
"""Number of Newton iterations for the cubic; from above they fall by a third at least, then
converge quadratically."""

SAG_RATIO = 4.0
"""A cable is slack where one of its spans hangs by more than its chord over this number. The
parabola ends there: below it the tension counts as constant."""


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
class CableLaw:
    """Lengths, weight and stretch of cables (…, n).

    Attributes
    ----------
    lengths: (…, n) [m], L at the tension T₀.
    weight: per length [N/m].
    compliance: (n,) [m/N], a: what a cable grows by per tension.
    reference: (…, n) [N], T₀.
    heights: (…, n) [m], z₀.
    least: (…, n) [N], tension below which a cable is slack and pulls no less.
    """

    lengths: Array
    weight: float
    compliance: Array
    reference: Array
    heights: Array
    least: Array

    def tensions(self, chords: Array) -> Array:
        """Return T (…, n) [N] for chords (…, n, 3) [m]."""
        a = self.compliance
        b = np.sum(chords, axis=-1) - self.lengths + a * self.reference
        if self.weight == 0.0:
            return np.asarray(np.maximum(self.least, b / a))
        k = self._arcs(chords)
        # From above Newton's method on a T³ - b T² - κ descends to the root.
        root = np.cbrt(k / a)
        slack = np.sqrt(k / np.maximum(-b, 1e-300))
        T = np.where(b > 0.0, b / a + root, np.minimum(root, slack))
        for _ in range(NEWTON):
            step: Array = (T * T * (a * T - b) - k) / (T * (3.0 * a * T - 2.0 * b))
            T = T - step
            if np.all(np.abs(step) <= 1e-15 * T):
                break
        return np.asarray(np.maximum(self.least, T))

    def slack(self, tensions: Array) -> NDArray[np.bool_]:
        """Return (…, n) whether cables of these tensions [N] are slack."""
        return np.asarray(tensions <= self.least)

    def energies(self, chords: Array, middles: Array, tensions: Array) -> Array:
        """Return (…, n) [J], but for a constant.

        Parameters
        ----------
        chords: (…, n, 3) [m]
        middles: (…, n, 3) [m], heights of their middles.
        tensions: (…, n) [N], those of ``tensions``.
        """
        heavy = self.weight * np.sum(chords * (middles - self.heights[..., None]), axis=-1)
        stretch = self.compliance * (tensions - self.reference) ** 2
        pulled = tensions * (np.sum(chords, axis=-1) - self.lengths) - 0.5 * stretch
        energies: Array = heavy + pulled - self._ratio(self._arcs(chords), tensions)
        return energies

    def span_tensions(self, chords: Array, middles: Array, tensions: Array) -> Array:
        """Return (…, n, 3) [N]: the slope of the energy along each chord."""
        T = tensions[..., None]
        if self.weight == 0.0:
            return np.broadcast_to(T, chords.shape)
        higher = self.weight * (middles - self.heights[..., None])
        return T + higher - self._ratio((self.weight * chords) ** 2, 8.0 * T)

    def chord_stiffness(self, chords: Array, tensions: Array) -> Array:
        """Return (…, n, 3, 3) [N/m]: second derivatives of the energy by the chords."""
        share, own = self._shares(chords, tensions)
        stiff: Array = self.tension_slopes(chords, tensions)[..., None, :] * share[..., :, None]
        sagging = -self._ratio(self.weight**2 * chords, 4.0 * tensions[..., None])
        return stiff + sagging[..., None] * np.eye(3) if own else stiff

    def tension_slopes(self, chords: Array, tensions: Array) -> Array:
        """Return (…, n, 3) [N/m]: derivatives of the tension by the chords."""
        share, _ = self._shares(chords, tensions)
        slopes: Array = self.length_slopes(chords, tensions)[..., None] * share
        return slopes

    def length_slopes(self, chords: Array, tensions: Array) -> Array:
        """Return (…, n) [N/m]: what the tension loses per length that the cable is longer."""
        soft = self.compliance + self._ratio(2.0 * self._arcs(chords), tensions**3)
        return np.where(self.slack(tensions), 0.0, 1.0 / soft)

    def _shares(self, chords: Array, tensions: Array) -> tuple[Array, bool]:
        """Return (…, n, 3) how much length a chord takes as it grows, and whether there is sag."""
        if self.weight == 0.0:
            return np.ones(chords.shape), False
        sag = self._ratio((self.weight * chords) ** 2, 8.0 * tensions[..., None] ** 2)
        return 1.0 + sag, True

    def _arcs(self, chords: Array) -> Array:
        arcs: Array = self.weight**2 * np.sum(chords**3, axis=-1) / 24.0
        return arcs

    def _ratio(self, a: Array, b: Array) -> Array:
        """Return a / b, 0 where cables have no weight and so neither arcs nor a least tension."""
        return a / b if self.weight > 0.0 else np.zeros(np.broadcast_shapes(a.shape, b.shape))
