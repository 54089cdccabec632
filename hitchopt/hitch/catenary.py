"""A cable that hangs between its two ends: the catenary of given length, in closed form.

The cable hangs in the vertical plane through its ends. Their horizontal distance is s, and the
second end is h higher than the first. With ``Λ² = L² - h²`` the steepness σ solves ``sinh σ / σ = Λ
/ s``. The parameter μ of a point on the cable runs from -1 at the first end to 1 at the second one,
proportional to the horizontal distance. The depth below the chord is

    depth = L P + h Q,   P = (cosh σ - cosh μσ) / 2 sinh σ,   Q = (μ - sinh μσ / sinh σ) / 2.

For every μ both change by at most ¼ per unit of σ, so an interval of σ encloses the cable. (With
``a = (1+μ)σ, b = (1-μ)σ``: ``0 ≤ 4σ sinh²σ dP/dσ = b (cosh a - 1) + a (cosh b - 1)``, whose power
series is below that of ``σ sinh²σ``; likewise for Q.) The weight per length affects the pull, but
not the shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.values import MAX_COORDINATE, Array, as_array, integer, positive
from hitchopt.values.fields import suggest_keywords

NEWTON_ITERATIONS = 8
"""Number of Newton iterations; 6 reach the last digit for all ratios up to 1e9."""

MIN_RELATIVE_SPAN = 1e-6  # Smallest horizontal distance of the ends, relative to L

SERIES_LIMIT = 1e-3
"""σ below which power series replace closed forms, which lose digits by cancellation."""


def steepness(ratio: ArrayLike) -> Array:
    """Return σ ≥ 0 (…) with ``sinh σ / σ = ratio``; 0 where the ratio is at most 1 (a taut cable).

    Newton's method solves the logarithm of both sides, which is convex and nearly linear.
    """
    rho = np.maximum(np.asarray(ratio, dtype=np.float64), 1.0)
    excess = rho - 1.0
    near = np.sqrt(6.0 * excess / (1.0 + 0.3 * np.minimum(excess, 1.0)))
    wide = np.log(2.0 * np.maximum(rho, 2.0))
    sigma = np.where(rho < 3.0, near, wide + np.log(wide))
    target = np.log1p(excess)
    for _ in range(NEWTON_ITERATIONS):
        x = np.maximum(sigma, SERIES_LIMIT)
        # log(sinh x / x) without overflow
        value = x + np.log(-np.expm1(-2.0 * x) / (2.0 * x)) - target
        slope = 1.0 / np.tanh(x) - 1.0 / x
        sigma = np.where(sigma > SERIES_LIMIT, np.maximum(x - value / slope, SERIES_LIMIT), sigma)
    # log(sinh σ / σ) = σ²/6 - σ⁴/180 + …
    small: Array = np.sqrt(np.maximum(6.0 * target + 1.2 * target * target, 0.0))
    return np.where(small < 2.0 * SERIES_LIMIT, small, sigma)


def depth_rate(sigma: Array) -> Array:
    """Return upper bounds (…) of |dP/dσ| for all μ and every steepness of at least σ.

    With ``α = (1+μ)σ/2, β = (1-μ)σ/2`` it is ``(β sinh² α + α sinh² β) / σ sinh² σ``, and
    ``sinh α ≤ e⁻ᵝ sinh σ``. The rate is at most ``(β e⁻²ᵝ + α e⁻²ᵅ)/σ``: the first term is at most
    1/2e, and the second one, for the larger of both, ``σ e⁻ˢ/2`` with s = σ for σ ≥ 1.
    """
    wide = np.maximum(sigma, 1.0)
    rate: Array = np.minimum(0.25, 0.5 * (np.exp(-1.0) / wide + np.exp(-wide)))
    return rate


SHIFT_RATIO = 1.12
"""Bound of the displacement of a point at fixed σ over that of the ends: at most √(1 + ¼), since
the point's fractions of their horizontal and vertical motion differ by up to one half."""


def displacement_bound(
    across: tuple[Array, Array],
    rise: Array,
    length: ArrayLike,
    radius: float,
    height_ratio: float = 1.0,
) -> Array:
    """Return upper bounds (…) [m] of displacements of cable points if ends move by a radius [m].

    A point at μ follows its two ends: horizontally with weights ``(1 ± μ)/2``, vertically with
    ``(1 ± sinh μσ / sinh σ)/2``. A change of σ moves it by at most ``depth_rate`` L + ¼ |h| per
    unit. This change follows from ``(coth σ - 1/σ) dσ = d ln(Λ/s)``, where s and h change by at
    most 2r. The bound is infinite for cables that may be nearly taut.

    With a ``height_ratio``, ends move that many times farther vertically, and heights of
    displacements are divided by it. A change of σ moves points vertically.

    Parameters
    ----------
    across: smallest and largest s (…) [m].
    rise: largest |h| (…) [m].
    """
    L = np.asarray(length)
    closest, farthest = across
    closer = closest - 2.0 * radius
    higher = rise + 2.0 * radius * height_ratio
    unbounded = (closer <= 0.0) | (higher >= L)
    closest = np.where(unbounded, 1.0, closest)
    closer = np.where(unbounded, 1.0, closer)
    higher = np.where(unbounded, 0.0, higher)
    flattest = steepness(level_length(higher, L) / (farthest + 2.0 * radius))
    unbounded |= flattest < SERIES_LIMIT
    flattest = np.maximum(flattest, SERIES_LIMIT)
    by_distance = np.log(closest / closer)
    by_height = np.log(level_length(np.minimum(rise, higher), L) / level_length(higher, L))
    sigma_change = (by_distance + by_height) / (1.0 / np.tanh(flattest) - 1.0 / flattest)
    rate = (L * depth_rate(flattest) + 0.25 * higher) / height_ratio
    bound: Array = np.where(unbounded, np.inf, SHIFT_RATIO * radius + rate * sigma_change)
    return bound


def bounded_radius(
    across: tuple[Array, Array], length: ArrayLike, height_ratio: float = 1.0
) -> Array:
    """Return the radii (…) [m] with finite ``displacement_bound`` for ends at equal heights.

    Ends that move by r are up to x = 2r closer or farther apart, and ρ x higher, where ρ is the
    height ratio: cables are taut where (s + x)² + (ρ x)² = L².
    """
    closest, farthest = across
    nearly_taut = np.asarray(length) * SERIES_LIMIT / np.sinh(SERIES_LIMIT)
    share = 1.0 + height_ratio**2
    root = np.sqrt(np.maximum(farthest**2 + share * (nearly_taut**2 - farthest**2), 0.0))
    return np.asarray(0.5 * np.minimum((root - farthest) / share, closest))


@dataclass(frozen=True, eq=False)
class Catenary:
    """Cables (…) that hang between two ends."""

    across: Array  # (…) [m], s, horizontal distances of the ends
    rise: Array  # (…) [m], h, heights of the second ends over the first ones
    length: Array  # (…) [m], L, lengths of the cables
    sigma: Array  # (…), σ, the steepness
    tilt: Array  # (…), ``h / Λ``

    @classmethod
    def between(cls, first: Array, second: Array, length: ArrayLike) -> Catenary:
        """Return the cables between ends (…, 3) [m]; straight if the ends are too far apart."""
        offset = second - first
        return cls.spanning(np.hypot(offset[..., 0], offset[..., 1]), offset[..., 2], length)

    @classmethod
    def spanning(cls, across: ArrayLike, rise: ArrayLike, length: ArrayLike) -> Catenary:
        """Return the cables with horizontal distances s and heights h of their ends (…) [m]."""
        s, h, L = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (across, rise, length)))
        s = np.maximum(s, MIN_RELATIVE_SPAN * L)
        level = level_length(h, L)
        return cls(s, h, L, steepness(level / s), h / level)

    def depth(self, mu: ArrayLike) -> Array:
        """Return the depth of the cables below the chord at μ (…) [m]."""
        level, skew = depth_terms(self.sigma, mu)
        return self.length * level + self.rise * skew

    def parameter(self, share: ArrayLike) -> Array:
        """Return μ (…) of the points at fractions (…) of the cable's length from its first end."""
        sigma = np.maximum(self.sigma, SERIES_LIMIT)
        start = -np.sinh(sigma + np.arcsinh(-self.tilt))
        along = start + 2.0 * sigma * np.asarray(share) * self.length / self.across
        mu = (np.arcsinh(along) - np.arcsinh(self.tilt)) / sigma
        return np.where(
            self.sigma > SERIES_LIMIT, np.clip(mu, -1.0, 1.0), 2.0 * np.asarray(share) - 1.0
        )

    def extra_displacement(self, off: float, height_ratio: float = 1.0) -> Array:
        """Return bounds (…) [m] of displacements of points beyond ``off``, that of both ends.

        ``height_ratio`` is that of ``displacement_bound``.
        """
        if not off:
            return np.zeros(self.across.shape)
        across = self.across, self.across
        rise = np.abs(self.rise)
        return displacement_bound(across, rise, self.length, off, height_ratio) - off

    @property
    def lowest(self) -> Array:
        """(…) [m]: height of the lowest point above the first end, zero or negative."""
        sigma = np.maximum(self.sigma, SERIES_LIMIT)
        mu = np.clip(-np.arcsinh(self.tilt) / sigma, -1.0, 1.0)
        return 0.5 * (1.0 + mu) * self.rise - self.depth(mu)

    def pull(self, first: Array, second: Array) -> Array:
        """Return the force of a cable of unit weight per length on both ends (…, 2, 3) [m].

        Times the weight per length [N/m] it is a force [N].
        """
        inverse_steepness, coth = pull_terms(self.sigma)
        offset = second - first
        # The tension draws the first end toward the second one, and the second end back
        toward_second = 0.5 * offset * np.array([1.0, 1.0, 0.0]) * inverse_steepness[..., None]
        toward_second[..., 2] = 0.5 * offset[..., 2] * coth
        pulls = np.stack([toward_second, -toward_second], axis=-2)
        half_weight = 0.5 * self.length[..., None]
        pulls[..., 2] -= half_weight
        return pulls


def depth_terms(sigma: ArrayLike, mu: ArrayLike) -> tuple[Array, Array]:
    """Return P and Q of the depth, for σ and μ that broadcast."""
    sigma = np.asarray(sigma, np.float64)
    mu = np.asarray(mu, np.float64)
    steep = np.maximum(sigma, SERIES_LIMIT)
    sine = np.sinh(steep)
    level = np.sinh(0.5 * (1.0 + mu) * steep) * np.sinh(0.5 * (1.0 - mu) * steep) / sine
    skew = 0.5 * (mu - np.sinh(mu * steep) / sine)
    is_flat = sigma < SERIES_LIMIT
    parabola = 1.0 - mu * mu
    flat_level = 0.25 * parabola * sigma
    flat_skew = mu * parabola * sigma * sigma / 12.0
    return np.where(is_flat, flat_level, level), np.where(is_flat, flat_skew, skew)


def pull_terms(sigma: ArrayLike) -> tuple[Array, Array]:
    """Return 1/σ and coth σ, the factors of the horizontal distance and of the rise in the pull.

    Both decrease with σ. The pull of a taut cable (σ = 0) would be infinite: σ is at least 1e-3.
    """
    steep = np.maximum(np.asarray(sigma, dtype=np.float64), SERIES_LIMIT)
    return 1.0 / steep, 1.0 / np.tanh(steep)


def level_length(rise: Array, length: Array) -> Array:
    """Return Λ (…) [m], bounded away from zero where the cable hangs straight down."""
    squared: Array = np.maximum(
        (length - rise) * (length + rise), (MIN_RELATIVE_SPAN * length) ** 2
    )
    return np.sqrt(squared)


@suggest_keywords
def hanging_cable(first: ArrayLike, second: ArrayLike, length: float, points: int = 50) -> Array:
    """Return points (…, points, 3) [m] along a cable that hangs between two ends, in order.

    They are evenly spaced along the cable. Its shape does not depend on its weight.

    Parameters
    ----------
    first, second: ends of the cable (…, 3) [m]; leading axes hold several cables.
    length: of the cable [m], at least the distance of its ends.
    points: number of points, including both ends; at most a million.

    Raises
    ------
    InputError: an end that is not a point in space, or a cable that is too short.
    """
    ends = []
    for name, point in (("first", first), ("second", second)):
        position = as_array(name, point)
        is_within = np.all(np.abs(position) <= MAX_COORDINATE)  # nan is not
        if position.shape[-1:] != (3,) or not is_within:
            bound = f"points [x, y, z] within ±{MAX_COORDINATE:g} m"
            raise InputError(name, point, bound, "specify three numbers in metres")
        ends.append(position)
    try:
        start, end = np.broadcast_arrays(*ends)
    except ValueError:
        bound = f"of the same shape as first, {ends[0].shape}"
        raise InputError("second", f"of shape {ends[1].shape}", bound, "pair the ends") from None
    cable_length = positive("length", length)
    count = integer("points", points, 2, 1_000_000)
    distance = float(np.max(np.linalg.norm(end - start, axis=-1), initial=0.0))
    if cable_length < distance:
        bound = f"at least the distance of its ends, {distance:.6g} m"
        raise InputError("length", length, bound, "lengthen the cable or move its ends")
    cable = Catenary.between(start[..., None, :], end[..., None, :], cable_length)
    mu = cable.parameter(np.linspace(0.0, 1.0, count))[..., None]
    curve: Array = 0.5 * ((1.0 - mu) * start[..., None, :] + (1.0 + mu) * end[..., None, :])
    curve[..., 2] -= cable.depth(mu[..., 0])
    curve[..., 0, :] = start
    curve[..., -1, :] = end
    return curve
