"""Straight parts of edges around an object, and where clasps are for them to carry what they do."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import length, unit
from hitchopt.holding.wraps import Wraps
from hitchopt.values import Array

SOFT = 1e-2
"""Damping over stiffness: clasps do not turn about objects that are nearly round."""


def contacts_of(polygon: Array, wraps: Wraps, core: Array) -> Array:
    """Return where edges meet and leave the section (…, n, 2, 2) [m].

    Of straight edges that is the point which comes to touch the section first.
    """
    chord = np.roll(polygon, -1, axis=-2) - polygon
    along = unit(chord)
    corner = core[wraps.bends.corners[..., 0]]
    ahead = np.sum((corner - polygon) * along, axis=-1, keepdims=True)
    nearest = polygon + np.clip(ahead, 0.0, length(chord)[..., None]) * along
    touching = wraps.bends.touching[..., None, None]
    return np.where(touching, wraps.contacts, nearest[..., None, :])


def straight_parts(polygon: Array, contacts: Array, z: Array) -> tuple[Array, Array]:
    """Return the straight parts (…, n, 3) [m] of edges at ``p_k``, and at ``p_{k+1}``."""
    leaving = np.concatenate([contacts[..., 0, :] - polygon, -z[..., None]], axis=-1)
    onward = np.roll(polygon, -1, axis=-2) - contacts[..., 1, :]
    return leaving, np.concatenate([onward, np.roll(z, -1, axis=-1)[..., None]], axis=-1)


def balanced(
    polygon: Array, T: Array, parts: tuple[Array, Array], arms: Array, pulled: Array
) -> Array:
    """Return clasps (…, n, 2) [m], moved and turned together, whose edges pull with a level force.

    One damped step of Newton's: moved across itself a straight part of length t turns, and pulls
    with ``T / t`` more per metre. No edge turns a disc.

    Parameters
    ----------
    polygon: (…, n, 2) [m], clasps, from the centre of mass.
    parts: (…, n, 3) [m], straight parts of edges at ``p_k`` and at ``p_{k+1}``.
    arms: (…, n, 2, 2) [m], contacts, from the centre of mass.
    pulled: (…, 2) [N], level force on the object there.
    """
    ends = polygon, np.roll(polygon, -1, axis=-2)
    size = np.mean(length(arms), axis=(-1, -2))[..., None, None]
    lacking: Array = np.append(pulled, np.zeros((*pulled.shape[:-1], 1)), axis=-1)
    stiffness: Array = np.zeros((*lacking.shape, 3))
    for i, (part, end, sign) in enumerate(zip(parts, ends, (-1.0, 1.0), strict=True)):
        along = unit(part)[..., :2]
        rows, moved = _with_moments(arms[..., i, :] / size), _with_moments(end / size)
        across = np.eye(2) - along[..., :, None] * along[..., None, :]
        stiff = (T / length(part))[..., None, None] * across
        lacking = lacking - sign * np.einsum("...nij,...ni->...j", rows, T[..., None] * along)
        stiffness = stiffness + np.einsum("...nij,...nik,...nkl->...jl", rows, stiff, moved)
    soft = (SOFT * np.linalg.norm(stiffness, axis=(-2, -1)))[..., None, None] ** 2 * np.eye(3)
    transposed = np.swapaxes(stiffness, -2, -1)
    right = transposed @ lacking[..., None]
    found = np.linalg.solve(transposed @ stiffness + soft, right)[..., 0]
    even: Array = polygon + np.einsum("...nij,...j->...ni", _with_moments(polygon / size), found)
    return even


def _with_moments(arms: Array) -> Array:
    """Return rows (…, n, 2, 3): level forces at arms (…, n, 2) times them are force and moment.

    Times a small displacement and turn they are how far the arms' ends move.
    """
    rows = np.zeros((*arms.shape, 3))
    rows[..., :2] = np.eye(2)
    rows[..., 0, 2], rows[..., 1, 2] = -arms[..., 1], arms[..., 0]
    return rows


def lifting_heights(T: Array, leaving: Array, arriving: Array, arms: Array, weight: Array) -> Array:
    """Return the heights (…, n) [m] of clasps at which edges carry a weight (…) [N].

    Clasp k lifts with ``f_k = z_k (T_k / t + T_{k-1} / t')``, t and t' its edges' straight parts,
    at their contacts. Of all ``f`` with that sum and no moment about level axes the nearest to
    equal ones is taken.

    Parameters
    ----------
    arms: (…, n, 2, 2) [m], contacts seen from the centre of mass.
    """
    ahead = T / length(leaving)
    behind = np.roll(T / length(arriving), 1, axis=-1)
    rate = ahead + behind
    each = ahead[..., None] * arms[..., 0, :]
    each = (each + behind[..., None] * np.roll(arms[..., 1, :], 1, axis=-2)) / rate[..., None]
    rows = np.concatenate([np.ones_like(rate)[..., None, :], np.swapaxes(each, -1, -2)], axis=-2)
    wanted = np.stack([weight, 0.0 * weight, 0.0 * weight], axis=-1)
    equal = np.repeat(weight[..., None] / T.shape[-1], T.shape[-1], axis=-1)
    short = wanted - np.einsum("...ij,...j->...i", rows, equal)
    forces = equal + np.einsum("...ij,...j->...i", np.linalg.pinv(rows), short)
    heights: Array = forces / rate
    return heights
