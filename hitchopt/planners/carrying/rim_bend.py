"""Legs that bend over the edge of a rim: level from the clasp up to the edge, rising beyond it.

At the clasp such legs pull level, with their cable's tension: a weight does not turn them toward
each other, as it does where it hangs at the clasp. Simulated legs that lean as if it hung there
drag their clasps outward below the rim.
"""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import unit
from hitchopt.values import Array


def bent_legs(
    edges: Array, tension: Array, forces: Array, legs: tuple[Array, Array], halves: Array,
    share: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the directions of q- and r-legs (…, n, 3) beyond the rim's edge.

    They rise as legs do that carry the load at their clasps. They pull level by a mean of what such
    legs do and of their cables' tensions.

    Parameters
    ----------
    edges: (…, n, 3) level unit vectors ``u_k``.
    tension: (…, n) [N]
    forces: (…, n, 3) [N], on the clasps.
    legs: q and r as of ``statics.leg_directions`` with these forces.
    halves: (…, n, 2) [N], as of ``ClaspLoads``.
    share: (…), how far the rim presses on the legs, from 0 to 1.
    """
    q, r = legs[0], np.roll(legs[1], 1, axis=-2)  # at the same clasp
    u, behind = edges[..., :2], np.roll(edges, 1, axis=-2)[..., :2]
    T, T_behind = tension, np.roll(tension, 1, axis=-1)
    V = T_behind[..., None] * behind - T[..., None] * u - forces[..., :2]
    q_hung, r_hung = _level_pull(q, T, halves[..., 1]), _level_pull(r, T_behind, halves[..., 0])
    q_bent, r_bent = (
        hung + share[..., None] * (whole - hung)
        for hung, whole in ((q_hung, T), (r_hung, T_behind))
    )
    q_before, r_before = _triangle(V, u + behind, q_hung, r_hung)
    q_after, r_after = _triangle(V, u + behind, q_bent, r_bent)
    return _turned(q, q_before, q_after), np.roll(_turned(r, r_before, r_after), -1, axis=-2)


def _level_pull(legs: Array, tension: Array, half: Array) -> Array:
    """Return what legs (…, n, 3) that carry loads at their clasps pull with level (…, n) [N]."""
    pull: Array = (tension + half * legs[..., 2]) * np.hypot(legs[..., 0], legs[..., 1])
    return pull


def _triangle(V: Array, onward: Array, q_pull: Array, r_pull: Array) -> tuple[Array, Array]:
    """Return directions (…, n, 2) of q- and r-legs whose level pulls (…, n) [N] add up to V."""
    size = np.linalg.norm(V, axis=-1)
    along = unit(V)
    aside = unit(onward - np.sum(onward * along, axis=-1, keepdims=True) * along)
    a = (size**2 + q_pull**2 - r_pull**2) / (2.0 * size)
    b = np.sqrt(np.maximum(q_pull**2 - a**2, 0.0))[..., None] * aside
    a_along, rest = a[..., None] * along, (size - a)[..., None] * along
    return unit(a_along + b), unit(rest - b)


def _turned(legs: Array, before: Array, after: Array) -> Array:
    """Return legs (…, n, 3) turned about the vertical by the angle between directions (…, n, 2)."""
    c = np.sum(before * after, axis=-1)
    s = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    x, y = legs[..., 0], legs[..., 1]
    return np.stack([c * x - s * y, s * x + c * y, legs[..., 2]], axis=-1)
