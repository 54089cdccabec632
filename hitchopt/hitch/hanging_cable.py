"""The shape of a hanging cable, for users."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.hitch.catenary import Catenary
from hitchopt.values import MAX_COORDINATE, Array, as_array, positive, whole

MAX_POINTS = 1_000_000
"""Points of one cable."""


def hanging_cable(first: ArrayLike, second: ArrayLike, length: float, points: int = 50) -> Array:
    """Return points (…, points, 3) [m] of a cable that hangs between two ends, in order.

    They are as far apart along the cable everywhere. Its weight does not matter for its shape: the
    catenary of this length.

    Parameters
    ----------
    first, second: its ends (…, 3) [m]; of several cables at once if there are further axes.
    length: of the cable [m], at least the distance of its ends.
    points: how many, both ends among them; at most MAX_POINTS.

    Raises
    ------
    InputError: no points in space, or a cable that is too short.
    """
    ends = []
    for name, given in (("first", first), ("second", second)):
        end = as_array(given)
        if end.shape[-1:] != (3,) or not np.all(np.abs(end) <= MAX_COORDINATE):  # nan too
            raise InputError(name, given, "points [x, y, z]", "give three numbers in metres")
        ends.append(end)
    try:
        a, b = np.broadcast_arrays(*ends)
    except ValueError:
        bound = f"of the shape of first, {ends[0].shape}"
        raise InputError("second", f"of shape {ends[1].shape}", bound, "pair the ends") from None
    size = positive("length", length)
    count = whole("points", points, 2, MAX_POINTS)
    apart = float(np.max(np.linalg.norm(b - a, axis=-1), initial=0.0))
    if size < apart:
        bound = f"at least the distance of its ends, {apart:.6g} m"
        raise InputError("length", length, bound, "lengthen the cable or move its ends")
    cable = Catenary.between(a[..., None, :], b[..., None, :], size)
    shares = np.linspace(0.0, 1.0, count)
    places = cable.place(shares)[..., None]  # -1 at the first end, 1 at the second one
    found: Array = 0.5 * ((1.0 - places) * a[..., None, :] + (1.0 + places) * b[..., None, :])
    found[..., 2] -= cable.depth(places[..., 0])
    found[..., 0, :], found[..., -1, :] = a, b
    return found
