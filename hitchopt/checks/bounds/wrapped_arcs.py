"""Lengths of the arcs of edges that are wrapped around what they hold, enclosed.

On a circle of radius R the arc over a chord s is ``2 R asin(s / 2R)``: enclosed by its Taylor
polynomial about the middle of the range of s. Between corners of a polygon arcs are sums of its
sides.
"""

from __future__ import annotations

import numpy as np

from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HoldBy
from hitchopt.objects import Section, SolidObject
from hitchopt.objects.placing import in_frame
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.values import Array, Indices

NO_ARC = 1e-9
"""[m] Chords that are shorter by far than a circle's radius: such arcs are their chords."""


def gripping(motion: Motion) -> list[tuple[int, str, SolidObject, Indices]]:
    """Return what is gripped: index and name of the object, itself, and the pieces (pieces,)."""
    found = []
    of_piece = motion.phase_of_piece
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        phases = [
            i
            for i, phase in enumerate(motion.phases)
            if phase.hold is not None and phase.hold.object == name and phase.hold.by is HoldBy.GRIP
        ]
        pieces = np.flatnonzero(np.isin(of_piece, phases))
        if len(pieces):
            found.append((index, name, body, pieces))
    return found


def wrapped_arcs(motion: Motion) -> Array:
    """Return chords of arcs, the radius of their circle, and the length of polygons' sides.

    Returns
    -------
    (pieces, n, 5, degree + 1) [m]: a chord's coordinates, and two constants.
    """
    contacts = motion.edge_contacts.coefficients
    rows = np.zeros((*contacts.shape[:2], 5, contacts.shape[-1]))
    rows[:, :, :3] = contacts[:, :, 1] - contacts[:, :, 0]
    for index, _, body, pieces in gripping(motion):
        section = body.section
        rows[pieces, :, 3] = section.rounding
        if section.outline is not None:
            poses = motion.object_poses.coefficients[pieces, index, :, 0]
            seen = in_frame(poses[:, None, None], contacts[pieces, ..., 0])
            rows[pieces, :, 4] = _sides(section, seen[..., :2])[..., None]
    return rows


def _sides(section: Section, contacts: Array) -> Array:
    """Return how long the outline is, clockwise, between contacts (…, 2, 2) [m]: (…) [m]."""
    core = section.core
    ring = np.append(0.0, np.cumsum(np.linalg.norm(np.roll(core, -1, axis=0) - core, axis=-1)))
    away = np.linalg.norm(contacts[..., None, :] - core, axis=-1)
    first, last = np.moveaxis(np.argmin(away, axis=-1), -1, 0)
    sides: Array = (ring[last] - ring[first]) % ring[-1]
    straight = np.linalg.norm(contacts[..., 1, :] - contacts[..., 0, :], axis=-1) < NO_ARC
    return np.where(straight, 0.0, sides)


def arc_enclosure(rows: Array) -> enclosure.Enclosure:
    """Enclose the lengths of arcs (cells,), given what ``wrapped_arcs`` returns (cells, 5, …)."""
    radius, sides = rows[:, 3, 0], rows[:, 4, 0]
    chord = enclosure.norm(rows[:, :3])
    low = np.min(chord.coefficients, axis=-1) - chord.radius
    high = np.max(chord.coefficients, axis=-1) + chord.radius
    round_ = radius > 0.0
    scale = np.where(round_, 2.0 * radius, 1.0)
    x0 = np.clip(0.5 * (low + high) / scale, 0.0, 1.0)
    spread = 0.5 * (high - low) / scale
    most = np.minimum(x0 + spread, 1.0)
    with np.errstate(all="ignore"):
        root = 1.0 - x0**2
        slope, bend = root**-0.5, x0 * root**-1.5
        left = 1.0 - most**2
        third = (1.0 + 2.0 * most**2) * left**-2.5  # asin''' grows with its argument
    x = (chord.coefficients - 0.0) / scale[:, None] - x0[:, None]
    squared = bernstein.multiply(x, x)
    order = bernstein.degree(squared)
    arc = bernstein.elevate(np.arcsin(x0)[:, None] + slope[:, None] * x, order)
    arc = arc + 0.5 * bend[:, None] * squared
    error = third * spread**3 / 6.0 + chord.radius / scale * left**-0.5
    error = np.where(np.isfinite(error), error * scale, np.inf)
    arc = np.where(round_[:, None], scale[:, None] * arc, 0.0) + sides[:, None]
    known = np.isfinite(arc)
    return enclosure.Enclosure(
        np.where(known, arc, 0.0),
        np.where(round_, np.where(np.all(known, axis=-1), error, np.inf), 0.0),
    )


def arc_at(rows: Array, x: Array) -> Array:
    """Return the lengths of arcs (cells,) at x (cells,)."""
    there = bernstein.evaluate(rows, x[:, None])
    radius, sides = there[:, 3], there[:, 4]
    chord = np.linalg.norm(there[:, :3], axis=-1)
    ratio = np.divide(chord, 2.0 * radius, out=np.zeros_like(chord), where=radius > 0.0)
    arc: Array = 2.0 * radius * np.arcsin(np.minimum(ratio, 1.0)) + sides
    return arc
