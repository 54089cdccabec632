"""Drawn edges that are wrapped around an object: tangent, arc, tangent."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.values import Array

NO_TURN = 1e-6
"""[rad] Edges that turn by less are straight."""


def wrapped_lengths(first: Array, last: Array, contacts: Array) -> Array:
    """Return the lengths (…) [m] of edges; parameters as of ``wrapped_points``."""
    lengths: Array = np.sum(_parts(first, last, contacts)[0], axis=-1)
    return lengths


def wrapped_points(first: Array, last: Array, contacts: Array, shares: Array) -> Array:
    """Return points (…, points, 3) [m] of edges at shares (…, points) of their lengths.

    Parameters
    ----------
    first, last: (…, 3) [m], ends of the edges.
    contacts: (…, 2, 3) [m], where they meet and leave what they are wrapped around.
    """
    lengths, turn = _parts(first, last, contacts)
    start, end = contacts[..., 0, :], contacts[..., 1, :]
    along = shares * np.sum(lengths, axis=-1, keepdims=True)
    edges = np.cumsum(lengths, axis=-1)[..., None, :]
    before = np.clip(along / np.maximum(edges[..., 0], 1e-12), 0.0, 1.0)[..., None]
    after = np.clip(
        (along - edges[..., 1]) / np.maximum(edges[..., 2] - edges[..., 1], 1e-12), 0.0, 1.0
    )[..., None]
    points = first[..., None, :] + before * (start - first)[..., None, :]
    arc = np.clip((along - edges[..., 0]) / np.maximum(lengths[..., 1:2], 1e-12), 0.0, 1.0)
    angle = turn[..., None]
    chord, ahead = end - start, unit(start - first)
    # Along a circle the chord from its start has 2 R sin(φ/2), turned by φ/2 from the tangent.
    size = np.sin(0.5 * arc * angle) / np.where(angle > NO_TURN, np.sin(0.5 * angle), 1.0)
    size = np.where(angle > NO_TURN, size, arc)
    side = unit(chord - dot(chord, ahead)[..., None] * ahead)
    half = 0.5 * arc * angle
    towards = np.cos(half)[..., None] * ahead[..., None, :]
    towards = towards + np.sin(half)[..., None] * side[..., None, :]
    points = points + (size * length(chord)[..., None])[..., None] * towards
    points = points + after * (last - end)[..., None, :]
    return np.asarray(points)


def _parts(first: Array, last: Array, contacts: Array) -> tuple[Array, Array]:
    """Return the lengths (…, 3) [m] of tangent, arc and tangent, and by how much they turn (…)."""
    start, end = contacts[..., 0, :], contacts[..., 1, :]
    chord = length(end - start)
    cosine = dot(unit(start - first), unit(last - end))
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    sine = np.sin(0.5 * turn)
    arc = np.where(turn > NO_TURN, chord * 0.5 * turn / np.where(sine > 0.0, sine, 1.0), chord)
    return np.stack([length(start - first), arc, length(last - end)], axis=-1), turn
