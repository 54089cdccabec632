"""Taut parts of cables under their weight: exact catenaries between two points.

The chord of a part has the horizontal part D and rises by h from its first end to its second one.
Its tensions there are vectors along it, ``F - w L ẑ / 2`` and ``F + w L ẑ / 2``, for a weight w per
length and the length L. With the mean m of their sizes T and ``T + w h``, and σ, half of the
difference of arsinh of the slopes at both ends,

    tanh σ = w L / 2 m,   L² = h² + (D sinh σ / σ)²,   F = (m / L) (D tanh σ / σ, h).

Together this is one equation of σ², ``tanh² σ = a + b (sinh σ / σ)²`` with ``a = (w h / 2 m)²`` and
``b = (w D / 2 m)²``. Its left side is concave and its right side convex in σ²: Newton's method
rises from below to the smaller solution, that of a taut part.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .arithmetic import TINY, UP, Array, Line, concatenate

ITERATIONS = 40  # of Newton's method
LAST_STEP = 1e-7  # relative to σ²; the error is of the order of its square


class Part(NamedTuple):
    """A taut part of a cable on spans of time."""

    length: Line  # (m, 1) [m]
    mean: Line  # (m, 3) [N] F, toward the second end
    half_weight: Line  # (m, 1) [N]

    @property
    def first(self) -> Line:
        """Tension at the first end (m, 3) [N], toward the second one."""
        return self.mean - self.half_weight * UP

    @property
    def second(self) -> Line:
        """Tension at the second end (m, 3) [N], away from the first one."""
        return self.mean + self.half_weight * UP


class Catenary:
    """The shape of taut parts along chords (m, 3) [m], given their ``ratio`` w / T [1/m]."""

    def __init__(self, chord: Line, ratio: Line) -> None:
        self.level, self.rise = chord[:2], chord[2]
        half = ratio * 0.5
        self.mean = self.rise * half + 1.0  # m / T
        self.weight = half * self.mean.inverse()  # w / 2 m
        squared_weight = self.weight * self.weight
        a = self.rise * self.rise * squared_weight
        self.squared_sigma = squared_sigma(a, self.level.dot(self.level) * squared_weight)
        self.stretch = self.squared_sigma.map(sinh_over, sinh_over_slope)
        self.length = concatenate(self.level * self.stretch, self.rise).norm()

    @property
    def along(self) -> Line:
        """The direction of F, times L."""
        flatness = self.squared_sigma.map(tanh_over, tanh_over_slope)
        return concatenate(self.level * flatness, self.rise)


def taut_part(chord: Line, T: Line, ratio: Line | None) -> Part:
    """Return the part along a chord, of tension T [N] at its first end.

    ``ratio`` is the weight per length over T [1/m], None without weight.
    """
    if ratio is None:
        size = chord.norm()
        return Part(size, chord * (T * size.inverse()), T * 0.0)
    shape = Catenary(chord, ratio)
    length = shape.length
    return Part(length, shape.along * (T * shape.mean * length.inverse()), T * ratio * length * 0.5)


def taut_length(chord: Line, ratio: Line | None) -> Line:
    """Return the length of the part along a chord; parameters are those of ``taut_part``."""
    return chord.norm() if ratio is None else Catenary(chord, ratio).length


def stretch(chord: Line, ratio: Line) -> Line:
    """Return the length of a level part over that of its chord, which may vanish."""
    return Catenary(chord, ratio).stretch


def depth_below(chord: Line, ratio: Line) -> Line:
    """Return how far a broken line is below a chord that is nowhere above the part.

    This depth is ``(σ L + |h| σ² / 3) / 4``, from the first to the third quarter of the chord. The
    part slopes from the chord by at most ``(σ L + |h| (σ coth σ - 1)) / D``, at an end, and is at
    most ``L tanh(σ/2) / 2 + |h| σ³ / 72`` below it.
    """
    shape = Catenary(chord, ratio)
    sigma = shape.length * shape.weight
    sigma = sigma.map(np.arctanh, lambda x: 1.0 / (1.0 - x**2))
    return sigma * (shape.length + shape.rise.norm() * sigma * (1.0 / 3.0)) * 0.25


def chord_of(first: Line, length: Line, weight: float) -> Line:
    """Return the chord (m, 3) [m] of a part by its tension [N] at its first end, and its length.

    The weight is that per length [N/m]; ``F = (m / L) (D tanh σ / σ, h)`` holds the chord.
    """
    added = length * weight
    mean = first + added * UP * 0.5
    m = (first.norm() + (first + added * UP).norm()) * 0.5
    x = added * m.inverse() * 0.5  # tanh σ
    per_force = length * m.inverse()
    bulged = (x * x).map(artanh_over, artanh_over_slope)
    return concatenate(mean[:2] * bulged, mean[2]) * per_force


def squared_sigma(a: Line, b: Line) -> Line:
    """Return σ²; nan if no part hangs so.

    Its slope is ``(a' + b' (sinh σ / σ)²)`` over the difference of both sides' slopes by σ², which
    decreases with a and b, as σ² increases with them.
    """
    bounds = [np.stack([x.v[:, 0], np.maximum(x.low, 0.0), x.high]) for x in (a, b)]
    y = solve(*bounds)  # (3, m): at midpoints, least, largest
    S = sinh_over(y) ** 2
    N = slope_difference(y, bounds[1])
    g = (a.g + b.g * S[0][:, None]) / N[0][:, None]
    spread = np.maximum(S[2] - S[0], S[0] - S[1])
    q = (a.q + b.q * S[2] + b.slope * spread) / N[2]
    turn = np.maximum(N[0] / N[2] - 1.0, 1.0 - N[0] / N[1])
    return Line(y[0][:, None], g, q + np.abs(g[:, 0]) * turn, a.t)


def solve(a: Any, b: Any) -> Any:
    """Return σ² for arrays a and b, with complex steps if they have them; nan without a solution.

    The start, which is exact to the second order, is below the solution.
    """
    real_a, real_b = np.real(a), np.real(b)
    total = real_a + real_b
    y = total * (1.0 + total * (2.0 / 3.0) + real_b * (1.0 / 3.0))
    with np.errstate(all="ignore"):  # without a solution, steps may be of any size
        for _ in range(ITERATIONS):
            step = -imbalance(y, real_a, real_b) / slope_difference(y, real_b)
            y = y + step
            moves = np.abs(step) > LAST_STEP * y
            if not np.any(moves):  # also where they are nan
                break
    y = np.where(moves, np.nan, y)
    if np.iscomplexobj(a) or np.iscomplexobj(b):
        return y - imbalance(y, a, b) / slope_difference(y, real_b)
    return y


def imbalance(y: Any, a: Any, b: Any) -> Any:
    """Return ``tanh² σ - a - b (sinh σ / σ)²`` for ``y = σ²``."""
    x = y * tanh_over(y) ** 2
    return x - a - b * sinh_over(y) ** 2


def slope_difference(y: Array, b: Array) -> Array:
    """Return the derivative of ``imbalance`` by y."""
    K = tanh_over(y)
    x = y * K**2
    return np.asarray(K * (1.0 - x) - b * K**2 / (1.0 - x) * (1.0 / K - 1.0) / (y + TINY))


def tanh_over(y: Any) -> Any:
    """Return ``tanh σ / σ`` for ``y = σ²``."""
    sigma = np.sqrt(y + TINY)
    return np.tanh(sigma) / sigma


def tanh_over_slope(y: Array) -> Array:
    """Return the derivative of ``tanh_over`` by y."""
    K = tanh_over(y)
    return np.asarray((1.0 - y * K**2 - K) / (2.0 * y + TINY))


def sinh_over(y: Any) -> Any:
    """Return ``sinh σ / σ`` for ``y = σ²``."""
    K = tanh_over(y)
    return K / np.sqrt(1.0 - y * K**2)


def sinh_over_slope(y: Array) -> Array:
    """Return the derivative of ``sinh_over`` by y."""
    return np.asarray(sinh_over(y) * (1.0 / tanh_over(y) - 1.0) / (2.0 * y + TINY))


def artanh_over(x: Array) -> Array:
    """Return ``artanh √x / √x``, which is ``σ / tanh σ`` for ``x = tanh² σ``."""
    root = np.sqrt(x + TINY)
    return np.asarray(np.arctanh(root) / root)


def artanh_over_slope(x: Array) -> Array:
    """Return the derivative of ``artanh_over``."""
    return np.asarray((1.0 / (1.0 - x) - artanh_over(x)) / (2.0 * x + TINY))
