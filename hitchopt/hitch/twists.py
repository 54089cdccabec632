"""Friction of the two cables of a clasp, which twist about each other.

Leg and edge of a cable are in the plane of those of the other one, and each cable turns by an angle
θ from its leg to its edge. Taut cables pass under and over each other there, by half a turn of a
double helix around the bisector. Its tangents cross at θ, and cables bend by ``π sin(θ/2)`` along
it, more than by θ, whatever their thickness. By the capstan equation, ``ln(T_leg/T_edge)`` is ``μ
z`` times this bend, where z is the share of the friction that a cable uses.

Both cables share one contact, whose friction opposes their relative velocity. Where they slide
toward their legs at the rates v and w, their shares are ``(v - w cos θ)/s`` and ``(w - v cos
θ)/s``, with ``s² = v² + w² - 2 v w cos θ``: the relative velocity, of size s, along each of them. A
cable that slides alone has all of it. Two that slide alike each have ``sin(θ/2)``. The shares x and
y of cables that stick are within the ellipse ``x² + y² + 2 x y cos θ ≤ sin² θ``, whose normal is
(v, w).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hitchopt.values import Array


def bend(cosine: Any) -> Any:
    """Return the bends [rad] of cables that turn by angles of these cosines, real or complex."""
    return math.pi * np.sqrt(0.5 - 0.5 * cosine)


def cosine_of(bend: Array) -> Array:
    """Return the cosines of the angles by which cables with these bends [rad] turn."""
    return np.asarray(1.0 - 2.0 * (bend / math.pi) ** 2)


def bend_together(turn: Array) -> Array:
    """Return the bends [rad] times the share of friction of cables that slide alike.

    Both turn by the angles ``turn`` [rad].
    """
    return np.asarray(math.pi * np.sin(0.5 * turn) ** 2)


def sliding_parts(cosine: Array, rates: Array) -> tuple[Array, Array]:
    """Return relative velocities along both cables (…, 2), and their sizes (…) [m/s].

    Shares of friction are their quotients. ``cosine`` (…) are those of the angles at which cables
    cross, ``rates`` (…, 2) [m/s] those toward their legs.
    """
    along = rates - cosine[..., None] * rates[..., ::-1]
    squares = np.sum(rates * along, axis=-1)
    return along, np.sqrt(np.maximum(squares, 0.0))


def half_axes(cosine: Array) -> tuple[Array, Array]:
    """Return the largest shares (…) of both cables, of the same and of opposite signs."""
    return np.sqrt(0.5 - 0.5 * cosine), np.sqrt(0.5 + 0.5 * cosine)
