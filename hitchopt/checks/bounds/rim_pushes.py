"""Level forces of a rim on the legs that bend over its edge, enclosed.

A clasp below a rim has its legs inside of the rim's outline. They run level up to its edge, with
their cable's tension T, bend there, and rise beyond it along d with the chord's pull P. The rim
pushes each one outward by what the level parts differ by, ``T ĥ - P d``, ĥ the level direction, to
the share that the object is borne. These pushes are forces within the rim: they balance each other.
A leg that sinks below its clasp touches no rim: what its push could be counts as an error.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.thrust_enclosure import NO_DIRECTION
from hitchopt.geometry.vectors import unit
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.values import Array

LEVEL = np.array([1.0, 1.0, 0.0])
"""Picks the level part of vectors."""


def rim_push(
    legs: Array, along: enclosure.Enclosure, pulls: Array, tensions: Array, share: Array,
    noise: float,
) -> enclosure.Enclosure:  # fmt: skip
    """Enclose the sum of the pushes on both legs of a clasp (cells, 3, degree + 1) [N].

    Parameters
    ----------
    legs: (cells, 2, 3, …) [m], from clasps to drones.
    along: their directions.
    pulls, tensions: P and T (cells, 2, …) [N].
    share: (cells, 1, …), to which the object is borne.
    noise: of positions [m].
    """
    level = enclosure.direction(legs * LEVEL[:, None], noise)
    outer = bernstein.multiply(pulls[..., None, :], along.coefficients * LEVEL[:, None])
    inner = bernstein.multiply(tensions[..., None, :], level.coefficients)
    order = max(bernstein.degree(inner), bernstein.degree(outer))
    pushed = bernstein.elevate(inner, order) - bernstein.elevate(outer, order)
    pushed = bernstein.multiply(share[:, :, None], pushed)
    T, P = np.max(tensions, axis=-1), np.max(pulls, axis=-1)
    sinks = np.maximum(along.radius - np.min(along.coefficients[:, :, 2], axis=-1), 0.0)
    error = T * level.radius + P * along.radius
    # Of a leg that sinks by sin α: |T ĥ - P d| <= T (1 - cos α) + (P - T), and P < T there.
    least = np.min(pulls, axis=-1)
    error = error + np.where(sinks > 0.0, T * sinks**2 + np.maximum(T - least, 0.0), 0.0)
    radius = np.max(share, axis=-1) * error
    return enclosure.Enclosure(np.sum(pushed, axis=1), np.sum(radius, axis=1))


def rim_pushes_at(legs: Array, pulls: Array, tensions: Array, share: Array) -> Array:
    """Return the pushes (cells, legs, 3) [N] at one time each, of what ``rim_push`` takes."""
    length = np.linalg.norm(legs, axis=-1, keepdims=True)
    beyond = np.divide(legs, length, out=np.zeros_like(legs), where=length > NO_DIRECTION)
    inner, outer = tensions[..., None] * unit(legs * LEVEL), pulls[..., None] * beyond * LEVEL
    pushed: Array = share[..., None] * (inner - outer)
    return pushed
