"""Polygons of hitches around an object and below its rim, in the object's own frame."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.hold_polygons import HoldPolygons
from hitchopt.values import Array

ROOM = 0.045
"""[m] Room besides the distance to be kept: 25 mm, the most that edges have been seen to err, and
20 mm for where the object really is."""

INSET = 0.05
"""[m] Clasps are this far inside of a rim, and edges off the body, where there is as much room."""

LEAST_INSET = 0.01
"""[m] The same where there is less."""

ANGLES, ASPECTS = 12, 17
"""Numbers of orientations and of proportions that are tried."""

SHRINKS = np.linspace(0.05, 1.0, 96)
"""Sizes of a polygon below a rim that are tried, over the rim's own."""


def rest_polygons(name: str, body: SolidObject, robots: int, gap: float) -> HoldPolygons:
    """Return the polygons for a number of robots.

    Of regular polygons about the centre of mass, turned and stretched along the rim's axes, the one
    whose clasps are the farthest inside of the rim and edges off the body; of those with INSET to
    both the one with the widest support.

    Parameters
    ----------
    name, body: the object; it has a rim.
    robots: number of vertices.
    gap: how far edges around it keep from it [m].

    Raises
    ------
    InfeasibleError: no polygon fits between body and rim.
    """
    assert body.rim is not None
    rim, centre = body.rim.section, body.centre_of_mass[:2]
    frame, size = _axes(rim.core, rim.rounding)
    shapes = _shapes(robots)  # (shapes, n, 2)
    places = (shapes[:, None] * SHRINKS[:, None, None] * size) @ frame.T + centre
    inside = -np.max(rim.clearance(places)[0], axis=-1)
    onward = np.roll(places, -1, axis=-2) - places
    outward = np.stack([-onward[..., 1], onward[..., 0]], axis=-1)
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)  # of clockwise edges
    offsets = np.sum(outward * places, axis=-1)
    width = np.min(offsets - outward @ centre, axis=-1)
    inset = np.minimum(inside, INSET)
    if body.stem is not None:
        inset = np.minimum(inset, np.min(offsets - body.stem.support(outward), axis=-1))
    best = np.unravel_index(int(np.argmax(inset + 1e-3 * width)), inset.shape)
    if inset[best] < LEAST_INSET:
        value = float(inset[best])
        remedy = (
            f"give objects.{name} a wider rim, or use another number of robots: `hitchopt fit` "
            "tells with which its outline is held"
        )
        words = "below the rim of the object"
        raise InfeasibleError(
            [Violation("support", value, LEAST_INSET, "min", "m", (name,), words, remedy)]
        )
    sections = rim, body.section
    return HoldPolygons.about(places[best], centre, sections, gap)


def _axes(core: Array, rounding: float) -> tuple[Array, Array]:
    """Return the axes (2, 2) of a section as columns, and half of its widths along them [m]."""
    if len(core) < 3:
        return np.eye(2), np.full(2, rounding)
    sides = np.roll(core, -1, axis=0) - core
    sides = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    turned = np.stack([sides, np.stack([-sides[:, 1], sides[:, 0]], axis=1)], axis=2)
    widths = np.ptp(np.einsum("pd,sdi->spi", core, turned), axis=1)  # (sides, 2)
    best = int(np.argmin(np.prod(widths, axis=1)))
    return turned[best], 0.5 * widths[best]


def _shapes(robots: int) -> Array:
    """Return regular polygons (shapes, n, 2) of radius 1, clockwise, turned and stretched."""
    angles = 2.0 * math.pi / robots * np.arange(ANGLES) / ANGLES
    corners = angles[:, None] - 2.0 * math.pi * np.arange(robots) / robots
    regular = np.stack([np.cos(corners), np.sin(corners)], axis=-1)
    aspects = np.geomspace(0.5, 2.0, ASPECTS)
    stretch = np.stack([np.sqrt(aspects), 1.0 / np.sqrt(aspects)], axis=-1)
    stretch *= math.sqrt(2.0)
    found: Array = (regular[:, None] * stretch[:, None]).reshape(-1, robots, 2)
    return found
