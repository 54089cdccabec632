"""A taut part of a cable under its weight: an exact catenary, by power series of its sag.

The tension of a part is ``F_0`` at its first end and ``F_1 = F_0 + w L ẑ`` at its second one, for a
weight per length w and a length L: vectors toward the second end, of magnitudes ``T_0`` and ``T_1 =
T_0 + w h``. Their mean leads along the chord (D, h), D its level part and h its rise:

    (F_0 + F_1)/2 = (m / L) (D / B, h),   m = (T_0 + T_1)/2,   B = artanh(√x) / √x,

where ``x = (w L / 2m)²`` is tanh² σ of the steepness σ of ``hitchopt.hitch.catenary``. The length
follows from ``L² = h² + S D²``, ``S = (sinh σ / σ)² = 1 / ((1 - x) B²)``. The series err by less
than 2e-6 where a part sags by at most a tenth of its level length, x = 0.14.

Formulas hold for ``Series``, over arrays or casadi, and for enclosed values and their jets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchopt.hitch.series import Series

BULGE = (1.0, 1.0 / 3.0, 1.0 / 5.0, 1.0 / 7.0, 1.0 / 9.0, 1.0 / 11.0)
"""Coefficients of B in x."""

STRETCH = (1.0, 1.0 / 3.0, 4.0 / 15.0, 44.0 / 189.0, 428.0 / 2025.0, 10196.0 / 51975.0)
"""Coefficients of S in x."""

LARGEST_SMALL = 0.12
"""Largest ``(w / 2m)²`` times the squared chord of parts that the series serve: 2e-6."""

NEWTON_ITERATIONS = 8  # Of large sags; 6 reach the last digits for x up to 0.6
FLAT = 1e-8  # x below which B is 1 + x / 3 to the last digit

ITERATIONS = (2, 3, 4, 6)
"""Terms of S in the fixed-point iterations for x, each of which divides the error by 15 or more."""


@dataclass(frozen=True, eq=False)
class TautPart:
    """A part of a cable by its chord; forces are relative to the tension at its first end."""

    chord: Any  # [m], vector to the second end
    length: Any  # [m], L
    level: Any  # [1/m], the mean force over the level chord
    rise: Any  # [1/m], the mean force over the rise
    half_weight: Any  # w L / 2

    def force(self, *, second: bool = False) -> Any:
        """Return the tension at the first or the second end, a vector toward the second one."""
        weight = self.half_weight if second else -self.half_weight
        return (
            self.chord * self.level + (self.chord[2] * (self.rise - self.level) + weight).along_z()
        )


def taut_part(
    chord: Any,
    ratio: Any,
    low: Callable[[Any], Any] = lambda value: value,
    sag_of: Callable[[Any, Any], Sag] | None = None,
) -> TautPart:
    """Return the part with a chord, a vector [m].

    Parameters
    ----------
    ratio: half of the weight per length over the tension at the first end [1/m].
    low: reduces the degree of a factor; the identity for values without a degree.
    sag_of: function in place of ``series_sag``.
    """
    level = chord.xy
    rise = chord[2]
    mean = 1.0 + ratio * rise  # of the tensions at both ends
    weight = low(ratio * mean.inverse)  # w / 2m
    squared_weight = weight * weight
    squared_level = level.dot(level)
    squared_rise = rise * rise
    of_level, of_rise = low(squared_level * squared_weight), low(squared_rise * squared_weight)
    sag = series_sag(of_level, of_rise, low) if sag_of is None else sag_of(of_level, of_rise)
    length = (squared_rise + squared_level * sag.stretch).root
    per_length = mean * length.inverse
    level_force = low(per_length * sag.bulge.inverse)
    return TautPart(chord, length, level_force, low(per_length), ratio * length)


@dataclass(frozen=True, eq=False)
class Sag:
    """Terms of a part's sag."""

    x: Any  # tanh² σ
    stretch: Any  # S
    bulge: Any  # B

    @property
    def bulge_slope(self) -> Any:
        """Derivative of B by x, for arrays: ``2 x B' = 1 / (1 - x) - B``."""
        is_flat = np.abs(self.x) < FLAT
        x = np.where(is_flat, 1.0, self.x)
        return np.where(is_flat, 1.0 / 3.0, (1.0 / (1.0 - self.x) - self.bulge) / (2.0 * x))

    @property
    def stretch_slope(self) -> Any:
        """Derivative of S by x, for arrays."""
        return self.stretch * (1.0 / (1.0 - self.x) - 2.0 * self.bulge_slope / self.bulge)


def series_sag(of_level: Any, of_rise: Any, low: Callable[[Any], Any] = lambda value: value) -> Sag:
    """Return the sag of a part, for ``(w D / 2m)²`` and ``(w h / 2m)²``: arrays or as above.

    It solves ``x = (w h / 2m)² + (w D / 2m)² S(x)``.
    """
    x = of_level + of_rise
    for terms in ITERATIONS:
        stretch = polynomial(STRETCH[:terms], x, low)
        x = low(of_rise + of_level * stretch)
    return Sag(x, stretch, polynomial(BULGE, x, low))


def closed_sag(of_level: Any, of_rise: Any) -> Sag:
    """Return ``series_sag`` for real or complex arrays of any sag, in closed form.

    Newton's method solves for x.
    """
    x = of_level + of_rise
    for _ in range(NEWTON_ITERATIONS):
        sag = _closed_form(x)
        x = x - (x - of_rise - of_level * sag.stretch) / (1.0 - of_level * sag.stretch_slope)
    return _closed_form(x)


def _closed_form(x: Any) -> Sag:
    """Return the terms at x."""
    is_flat = np.abs(x) < FLAT
    root = np.sqrt(np.where(is_flat, 0.25, x))
    bulge = np.where(is_flat, 1.0 + x / 3.0, np.arctanh(root) / root)
    return Sag(x, 1.0 / ((1.0 - x) * bulge * bulge), bulge)


def taut_chord(direction: Series, cable: Series, ratio: Series) -> Series:
    """Return the chord [m] of a part by its length and the direction of its first end.

    Parameters
    ----------
    direction: of the tension at the first end, a unit vector.
    cable: its length L [m].
    ratio: half of the weight per length over the tension at the first end [1/m].
    """
    half_weight = ratio * cable
    rise = direction[2] + half_weight  # of the mean force
    second = (1.0 + 4.0 * (half_weight * rise)).root  # T_1 / T_0
    inverse_mean = 2.0 * (1.0 + second).inverse
    weight = half_weight * inverse_mean
    bulge = polynomial(BULGE, weight * weight)
    per_force = cable * inverse_mean
    chord: Series = per_force * (bulge * direction + (rise - bulge * direction[2]).along_z())
    return chord


def polynomial(
    coefficients: Sequence[float], x: Any, low: Callable[[Any], Any] = lambda value: value
) -> Any:
    """Return the polynomial with coefficients of 1, x, x², … at x, by Horner's rule."""
    *others, last = coefficients
    total = x * last
    for coefficient in others[:0:-1]:
        total = low(x * (coefficient + total))
    return others[0] + total
