"""Whether edges are where a plan says: straight, or wrapped around the section that they grip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.object_frames import seen_from
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.values import Array, Indices

Mask = NDArray[np.bool_]

CONTACT = 2e-5
"""[m] Edges lie on sections, and sections behind edges, this closely."""


def bent(motion: Motion) -> Mask:
    """Return (pieces,) where an edge is not straight."""
    contacts = motion.edge_contacts
    order = max(motion.vertices.degree, contacts.degree)
    vertices = motion.vertices.elevated(order).coefficients
    first, last = np.moveaxis(contacts.elevated(order).coefficients, 2, 0)
    layout = motion.team.layout
    straight = _straight(vertices[:, layout.starts], first, last, vertices[:, layout.ends])
    found: Mask = np.any(~straight, axis=1)
    return found


def misplaced(motion: Motion, index: int, body: SolidObject, pieces: Indices) -> Mask:
    """Return which of some pieces contradict that edges are wrapped around an object.

    Seen from the object, every edge is straight or touches its section at both of its contacts, all
    of the section is on its right, and it turns to the right by less than half a turn. Contacts are
    at one height, on the body.

    Parameters
    ----------
    index: of the object.
    pieces: (k,), at which it is gripped.
    """
    layout, pose = motion.team.layout, motion.object_poses.coefficients[pieces, index]
    order = max(motion.vertices.degree, motion.edge_contacts.degree)
    vertices = motion.vertices.elevated(order).coefficients[pieces]
    contacts = motion.edge_contacts.elevated(order).coefficients[pieces]
    ends = [vertices[:, layout.starts], contacts[:, :, 0], contacts[:, :, 1]]
    hulls = np.stack([*ends, vertices[:, layout.ends]], axis=2)
    seen = seen_from(pose, hulls)
    start, first, last, end = np.moveaxis(seen.points, 2, 0)  # (k, n, 3, degree + 1) each
    tolerance = CONTACT + seen.error
    wrong = ~(_straight(start, first, last, end) | _touching(body, first, last, tolerance))
    wrong |= _before(body, start, first, tolerance) | _before(body, last, end, tolerance)
    leaving, arriving = first - start, end - last
    right = bernstein.multiply(leaving[:, :, 1], arriving[:, :, 0])
    right = right - bernstein.multiply(leaving[:, :, 0], arriving[:, :, 1])
    along = bernstein.dot(leaving[:, :, :2], arriving[:, :, :2])
    back = np.min(right, axis=-1) < -tolerance * np.max(np.abs(along), axis=-1)
    wrong |= back | ((np.min(along, axis=-1) <= 0.0) & (np.min(right, axis=-1) <= 0.0))
    heights = seen.points[:, :, 1:3, 2]
    wrong |= np.max(np.abs(heights - heights[:, :, :1, :1]), axis=(2, 3)) > tolerance
    wrong |= np.any((heights < body.lower) | (heights > body.upper), axis=(2, 3))
    found: Mask = np.any(wrong, axis=1)
    return found


def _straight(start: Array, first: Array, last: Array, end: Array) -> Mask:
    """Return (pieces, edges) where contacts are one point, on the line between both ends."""
    leaving, arriving = first - start, end - last
    x, y, z = (
        bernstein.multiply(leaving[:, :, i], arriving[:, :, j])
        - bernstein.multiply(leaving[:, :, j], arriving[:, :, i])
        for i, j in ((1, 2), (2, 0), (0, 1))
    )
    aside = np.sqrt(np.max(x * x + y * y + z * z, axis=-1))
    size = np.max(np.linalg.norm(end - start, axis=2), axis=-1)
    apart = np.max(np.linalg.norm(last - first, axis=2), axis=-1)
    straight: Mask = (aside <= CONTACT * size) & (apart <= CONTACT)
    return straight


def _touching(body: SolidObject, first: Array, last: Array, tolerance: float) -> Mask:
    """Return (pieces, edges) where both contacts are on the section, a polygon's at corners."""
    section = body.section
    found = np.ones(first.shape[:2], dtype=np.bool_)
    for point in (first, last):
        away = point[:, :, None, :2] - section.core[:, :, None]
        if section.outline is None:
            squared = bernstein.dot(away, away) - section.rounding**2
            off = np.max(np.abs(squared), axis=(2, 3)) / section.rounding
        else:
            off = np.min(np.max(np.linalg.norm(away, axis=3), axis=-1), axis=-1)
        found &= off <= tolerance
    return found


def _before(body: SolidObject, start: Array, end: Array, tolerance: float) -> Mask:
    """Return (pieces, edges) where a part of the section is on the left of a straight part."""
    section, along = body.section, end - start
    size = enclosure.norm(_level(along))
    least = np.min(size.coefficients, axis=-1) - size.radius
    core = section.core[:, :, None] - start[:, :, None, :2]
    left = bernstein.multiply(along[:, :, None, 0], core[:, :, :, 1])
    left = left - bernstein.multiply(along[:, :, None, 1], core[:, :, :, 0])
    order = max(bernstein.degree(left), bernstein.degree(size.coefficients))
    reach = bernstein.elevate(left, order)
    reach = reach + section.rounding * bernstein.elevate(size.coefficients, order)[:, :, None]
    most = np.max(reach, axis=(2, 3)) + section.rounding * size.radius
    # A part without length says nothing: the other part of its edge does.
    found: Mask = (most > tolerance * np.maximum(least, 0.0)) & (
        np.max(size.coefficients, -1) > CONTACT
    )
    return found


def _level(vectors: Array) -> Array:
    level = vectors.copy()
    level[..., 2, :] = 0.0
    return level
