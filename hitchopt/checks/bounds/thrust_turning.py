"""How fast every drone's thrust turns, enclosed: ``ω = f × ḟ / |f|²`` for the thrust f.

f is that of ``thrust_enclosure``: the blocks of its cells are polynomials, so their derivatives
stand in blocks next to them. The pull of a leg along y turns with ``d/dt (y/|y|) = v - û (û·v)``,
``û = y/|y|``, ``v = ẏ/|y|``; a hanging cable's with its steepness. Products are written in a low
degree, as cells are short where it matters.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from hitchopt.checks.bounds.hanging_links import steepness_range
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin, position_margin
from hitchopt.checks.bounds.thrust_enclosure import pulled, thrust_cells, thrust_enclosure
from hitchopt.hitch.catenary import level_length, pull_terms
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed_products import (
    crossed,
    exact,
    inner,
    largest_norm,
    reduced,
    scaled,
    total,
)
from hitchopt.trajectory.enclosure import Enclosure, direction, inverse_norm, norm
from hitchopt.trajectory.extremum import Bound, Cells, Estimate
from hitchopt.values import Array

ORDER = 6
"""Degree in which factors are written: on the cells that matter they err by 1e-9 then."""

FORCE_BLOCKS = {8: 4, 10: 5, 15: 8}
"""Number of blocks of the force by the number of all, as all that vary have a derivative: without
weight, with taut cables alone, with cables that hang too."""

NEAREST = 1e-9
"""[m] Drones of a cable that may be one above the other count as this far apart from above: what
their cable's pull changes by has no bound there, and is all but infinite then."""

DIFFERENTIATED = 3
"""Number of blocks of thrust cells, from the first, that a rate needs the derivatives of."""


def turning_cells(motion: Motion) -> Cells:
    """Return one cell per piece and drone, with the blocks that ``turning_bound`` takes.

    They are those of thrust cells, the derivatives by time of those that vary, and how far the
    drone's own part of the thrust's derivative may be off [N/s].
    """
    force = thrust_cells(motion)
    seconds = (force.end - force.start)[:, None, None]
    slopes = [
        bernstein.differentiate(block) / seconds
        for block in (*force.blocks[:DIFFERENTIATED], *force.blocks[4:7])
    ]
    slop = derivative_margin(motion.drones, 3) * motion.team.mass
    slop = slop.ravel() + ROUNDING * np.max(np.abs(slopes[0]), axis=(-2, -1))
    blocks = (*force.blocks, *slopes, slop[:, None, None])
    return Cells(blocks, force.item, force.start, force.end, force.margin)


def turning_bound(motion: Motion) -> Bound:
    """Return what bounds the turning rate on ``turning_cells`` from above [rad/s]."""
    return partial(_bound, noise=position_margin(motion), rate_noise=rate_margin(motion))


def rate_margin(motion: Motion) -> float:
    """Return what rounding adds to the velocity of a leg [m/s]."""
    parts = (motion.drones, motion.vertices)
    return sum(float(np.max(derivative_margin(part, 1), initial=0.0)) for part in parts)


def _bound(blocks: tuple[Array, ...], noise: float, rate_noise: float) -> Estimate:
    force, slopes, slop = _divided(blocks)
    rate = total(exact(slopes[0], slop), load_rate(blocks, noise, rate_noise))
    return turning(thrust_enclosure(force, noise), rate)


def _divided(blocks: tuple[Array, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...], Array]:
    """Return the blocks of the force, those of its derivatives, and the slop (cells,)."""
    count = FORCE_BLOCKS[len(blocks)]
    return blocks[:count], blocks[count:-1], blocks[-1][:, 0, 0]


def load_rate(blocks: tuple[Array, ...], noise: float, rate_noise: float) -> Enclosure:
    """Enclose the derivative (cells, 3) of what cables add to the thrust [N/s]."""
    force, slopes, _ = _divided(blocks)
    parts = [_leg_rate(force[1:3], slopes[1:3], noise, rate_noise)]
    if len(force) > 4:
        parts.append(_carried_rate(force[1], force[4], slopes[1], slopes[3], noise, rate_noise))
    if len(force) > 5:
        parts.append(_hanging_rate(force[5:], slopes[4:]))
    return total(*parts)


def turning(thrust: Enclosure, rate: Enclosure) -> Estimate:
    """Bound from above how fast a thrust (cells, 3) with a derivative by time turns [rad/s]."""
    thrust, rate = reduced(thrust, ORDER), reduced(rate, ORDER)
    inverse = inverse_norm(thrust.coefficients, thrust.radius)
    found = reduced(scaled(crossed(thrust, rate), inverse), ORDER)
    found = scaled(found, inverse)
    norms = np.linalg.norm(found.coefficients, axis=-2)
    x = np.argmax(norms, axis=-1) / max(1, bernstein.degree(norms))
    here = np.linalg.norm(bernstein.evaluate(found.coefficients, x[:, None]), axis=-1)
    bound = (np.max(norms, axis=-1) + found.radius) * (1.0 + ROUNDING)
    bound = np.where(np.isfinite(inverse.radius), bound, np.inf)  # a thrust of no direction
    return Estimate(bound, np.maximum(here - found.radius, 0.0), x)


def _leg_rate(
    leg_and_tension: tuple[Array, ...],
    slopes: tuple[Array, ...],
    noise: float,
    rate_noise: float,
) -> Enclosure:
    """Enclose the derivative of what legs (cells, 3, …) pull with: ``Ṫ û + T û̇``."""
    legs, tension = leg_and_tension
    along = reduced(direction(legs, noise), ORDER)
    per_length = inverse_norm(legs, noise)
    swept = reduced(scaled(exact(slopes[0], rate_noise), per_length), ORDER)
    radial = reduced(inner(along, swept), ORDER)
    minus = exact(-radial.coefficients, radial.radius)
    turning = total(swept, scaled(along, minus))
    return total(scaled(along, exact(slopes[1])), scaled(turning, exact(tension)))


def _carried_rate(
    legs: Array, weight: Array, moved: Array, gained: Array, noise: float, rate_noise: float
) -> Enclosure:
    """Enclose the derivative of the weight w |y| of taut legs y (cells, 3): ``ẇ |y| + w û·ẏ``."""
    sizes = norm(legs)
    size = Enclosure(sizes.coefficients[:, None], sizes.radius + 2.0 * noise)
    growing = inner(reduced(direction(legs, noise), ORDER), exact(moved, rate_noise))
    rate = total(scaled(size, exact(gained)), scaled(growing, exact(weight)))
    upward = np.zeros((len(legs), 3, rate.coefficients.shape[-1]))
    upward[:, 2:] = rate.coefficients
    return Enclosure(upward, rate.radius)


def _hanging_rate(force: tuple[Array, ...], slopes: tuple[Array, ...]) -> Enclosure:
    """Enclose the derivative of what free cables add to the thrust (cells, 3).

    The factors of the pull (``hitchopt.hitch.catenary.pull_terms``) and their derivatives are taken
    between bounds: ``(coth σ - 1/σ) σ̇ = Λ̇/Λ - ṡ/s``, s the ends' distance as seen from above, h
    their height difference and ``Λ² = L² - h²``; 1/σ falls by ``σ̇/σ²`` and coth σ by
    ``σ̇/sinh² σ``.
    """
    (partner, weight, length), (moved, gained) = force, slopes
    L = length[:, 0, 0]
    lower, upper = steepness_range(partner, L)
    most, least = (np.array(pull_terms(sigma)) for sigma in (lower, upper))  # both fall with σ
    level, height = partner[:, :2], partner[:, 2:]
    spans = _ends(level)
    rises = _ends(height)
    whole = level_length(rises[1], L), level_length(rises[0], L)
    widening = _product(_hull(level, moved[:, :2]), _inverse_square(spans))
    lifting = _product(_hull(height, moved[:, 2:]), _inverse_square(whole))
    flatter = widening[0] + lifting[0], widening[1] + lifting[1]
    slope = most[1] - most[0], least[1] - least[0]  # coth σ - 1/σ rises with σ
    falling = _product(flatter, (1.0 / slope[1], 1.0 / slope[0]))  # -σ̇
    inward = _product(falling, (least[0] ** 2, most[0] ** 2))
    downward = _product(falling, (least[1] ** 2 - 1.0, most[1] ** 2 - 1.0))
    change = np.array([inward[0], downward[0]]), np.array([inward[1], downward[1]])
    return total(
        pulled(partner, gained, least, most, length),
        pulled(moved, weight, least, most),
        pulled(partner, weight, *change),
    )


Interval = tuple[Array, Array]
"""Smallest and largest values (cells,)."""


def _ends(vectors: Array) -> Interval:
    """Return bounds of the norm of vectors (cells, d, degree + 1)."""
    half = bernstein.basis(np.array(0.5), bernstein.degree(vectors))
    middle = vectors @ half
    size = np.linalg.norm(middle, axis=-1, keepdims=True)
    along = np.divide(middle, size, out=np.zeros_like(middle), where=size > 0.0)
    nearest = np.min(np.einsum("ci,cin->cn", along, vectors), axis=-1)
    return np.maximum(nearest, 0.0), largest_norm(vectors)


def _hull(a: Array, b: Array) -> Interval:
    """Return bounds of the scalar product of vectors."""
    product = bernstein.dot(a, b)
    return np.min(product, axis=-1), np.max(product, axis=-1)


def _inverse_square(size: Interval) -> Interval:
    least, most = (np.maximum(each, NEAREST) for each in size)
    return 1.0 / most**2, 1.0 / least**2


def _product(a: Interval, b: Interval) -> Interval:
    products = np.stack([x * y for x in a for y in b])
    return np.min(products, axis=0), np.max(products, axis=0)
