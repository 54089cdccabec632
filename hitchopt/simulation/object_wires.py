"""Outlines of objects in space, for the bodies of a simulation and its recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hitchopt.objects import Section, SolidObject

Floats = NDArray[np.float32]

POINTS = 48
"""Points of an outline, and the first one once more."""


def wires(objects: Mapping[str, SolidObject]) -> Floats:
    """Return outlines (objects, 3, POINTS + 1, 3) [m] of floor, ceiling and rim in their frames.

    Where there is no rim its outline is the ceiling's.
    """
    found = np.zeros((len(objects), 3, POINTS + 1, 3), dtype=np.float32)
    for rings, each in zip(found, objects.values(), strict=True):
        rim = (each.section, each.upper)
        if each.rim is not None:
            rim = (each.rim.section, each.rim.height)
        levels = ((each.section, each.lower), (each.section, each.upper), rim)
        for ring, (section, height) in zip(rings, levels, strict=True):
            ring[:, :2], ring[:, 2] = outline_points(section, POINTS), height
    return found


def outline_points(section: Section, count: int) -> NDArray[np.float64]:
    """Return points (count + 1, 2) [m] on an outline, the first one twice.

    Corners are among them where ``count`` is a multiple of their number.
    """
    share = np.linspace(0.0, 1.0, count + 1)
    if section.outline is None:
        angle = 2.0 * np.pi * share
        return section.rounding * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = np.vstack([section.outline, section.outline[:1]])
    place, ranks = share * len(section.outline), np.arange(len(corners))
    return np.column_stack([np.interp(place, ranks, corners[:, i]) for i in (0, 1)])
