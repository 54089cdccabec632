"""Moving points as seen from moving objects: polynomials, and how far they are off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.trajectory import bernstein
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Seen:
    """Points in an object's frame.

    Attributes
    ----------
    points: (pieces, items, corners, 3, degree + 1) [m]
    error: how far these are off, since a heading of polynomials is no unit vector [m].
    """

    points: Array
    error: float


def seen_from(pose: Array, hulls: Array) -> Seen:
    """Return points (pieces, items, corners, 3, degree + 1) [m] as seen from an object.

    Parameters
    ----------
    pose: of the object, (pieces or 1, 5, degree + 1).
    """
    order = max(bernstein.degree(pose), bernstein.degree(hulls))
    place = bernstein.elevate(pose[:, :3], order)
    away = bernstein.elevate(hulls, order) - place[:, None, None]
    turning = np.any(pose[:, 3:] != pose[0, 3:, :1])
    heading = pose[:, 3:] if turning else pose[:1, 3:, :1]
    c, s = heading[:, None, None, 0], heading[:, None, None, 1]
    x = bernstein.multiply(away[..., 0, :], c) + bernstein.multiply(away[..., 1, :], s)
    y = bernstein.multiply(away[..., 1, :], c) - bernstein.multiply(away[..., 0, :], s)
    z = bernstein.elevate(away[..., 2, :], bernstein.degree(x))
    reach = float(np.max(np.abs(away[..., :2, :]), initial=0.0))
    return Seen(np.stack([x, y, z], axis=-2), 2.0 * heading_error(heading) * reach)


def heading_error(heading: Array) -> float:
    """Return by how much the length of headings (pieces, 2, degree + 1) differs from 1 at most."""
    squared = bernstein.dot(heading, heading)
    return float(np.max(np.abs(squared - 1.0)))  # |h| - 1 is less than |h|² - 1
