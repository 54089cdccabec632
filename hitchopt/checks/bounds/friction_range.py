"""What friction can make of a cable's tension at a clasp, as a bound for the legs' pulls."""

from __future__ import annotations

from functools import partial

import numpy as np

from hitchopt.checks.bounds.bodies import bent_edges, concatenated, pull_vectors
from hitchopt.checks.bounds.rounding_margins import ROUNDING, position_margin
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, largest
from hitchopt.values import Array


def beyond_friction(motion: Motion) -> Extremum:
    """Return by how much of the tension a drone's pull is more than friction allows, at most.

    A cable that wraps an angle θ about a clasp pulls on one side with between ``e^{-μ θ}`` and
    ``e^{μ θ}`` times what it pulls with on the other; θ is by how much it turns there, from its leg
    to its edge. At a chain's ends it turns about nothing. Not positive, but for rounding, where
    every pull obeys that; ``item`` is the drone.
    """
    order = max(motion.pulls.degree, motion.tensions.degree)
    pulls, tensions = (
        part.elevated(order).coefficients for part in (motion.pulls, motion.tensions)
    )
    both = np.stack([pulls, np.repeat(tensions, 2, axis=1)], axis=2)
    bound = partial(_bound, friction=motion.team.cable_friction, noise=position_margin(motion))
    return largest(Cells.over(motion.drones.breaks, [wrapping_vectors(motion), both]), bound)


def wrapping_vectors(motion: Motion) -> Array:
    """Return (pieces, 2n, 6, degree + 1) [m]: to each drone along its leg, and along its edge."""
    leaving, arriving = bent_edges(motion)
    away = np.stack([leaving, -arriving], axis=2).reshape(len(leaving), -1, *leaving.shape[2:])
    return concatenated([pull_vectors(motion), away], axis=2)


def _bound(blocks: tuple[Array, ...], friction: float, noise: float) -> Estimate:
    rows, both = blocks
    pull, tension = both[:, 0], both[:, 1]
    # A quotient of polynomials lies between those of their coefficients, the divisor positive.
    pulling = np.all(tension > 0.0, axis=-1)
    ratios = np.divide(pull, tension, out=np.ones_like(pull), where=pull != tension)
    held = np.exp(friction * wrapped(rows, noise))
    most, least = np.max(ratios, axis=-1), np.min(ratios, axis=-1)
    bound = np.maximum(most * (1.0 + ROUNDING) - held, 1.0 / held - least * (1.0 - ROUNDING))
    alone = np.all(pull == tension, axis=-1)  # as where the tension rises from zero
    bound = np.where(pulling | alone, bound, np.inf)
    middle = np.full(len(rows), 0.5)
    angle = angles_at(rows, middle)
    here, there = bernstein.evaluate(pull, middle), bernstein.evaluate(tension, middle)
    ratio = np.divide(here, there, out=np.ones_like(here), where=here != there)
    value = np.maximum(ratio - np.exp(friction * angle), np.exp(-friction * angle) - ratio)
    return Estimate(bound, np.where(pulling | alone, value, np.inf), middle)


def angles_at(rows: Array, x: Array) -> Array:
    """Return (cells,) [rad] the angle between ``-a`` and ``b`` of ``wrapped`` at x (cells,)."""
    a, b = np.split(bernstein.evaluate(rows, x[:, None]), 2, axis=-1)
    sizes = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    angles: Array = np.pi - np.arccos(np.clip(np.sum(a * b, axis=-1) / sizes, -1.0, 1.0))
    return angles


def wrapped(rows: Array, noise: float) -> Array:
    """Return (cells,) [rad], which the angle between ``-a`` and ``b`` does not fall below.

    Parameters
    ----------
    rows: (cells, 6, degree + 1), a and b: to the drone, and along the edge.
    noise: of their ends [m].
    """
    a, b = rows[:, :3], rows[:, 3:]
    along = np.sum(bernstein.multiply(a, b), axis=1)
    (least_a, most_a), (least_b, most_b) = _lengths(a, noise), _lengths(b, noise)
    lowest = np.min(along, axis=-1) - 2.0 * noise * (most_a + most_b)
    sizes = np.where(lowest >= 0.0, most_a * most_b, least_a * least_b)
    cosine = np.divide(lowest, sizes, out=np.full_like(lowest, -1.0), where=sizes > 0.0)
    angle: Array = np.pi - np.arccos(np.clip(cosine - ROUNDING, -1.0, 1.0))
    return angle


def _lengths(vectors: Array, noise: float) -> tuple[Array, Array]:
    """Return the least and the largest length (cells,) of vectors (cells, 3, degree + 1)."""
    sizes = np.linalg.norm(vectors, axis=1)
    middle = np.mean(vectors, axis=-1, keepdims=True)
    spread = np.max(np.linalg.norm(vectors - middle, axis=1), axis=-1)
    shortest = np.linalg.norm(middle[..., 0], axis=-1) - spread - 2.0 * noise
    return np.maximum(shortest, 0.0), np.max(sizes, axis=-1) + 2.0 * noise
