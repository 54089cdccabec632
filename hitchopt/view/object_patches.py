"""Objects seen from above: where they stand at first, and where in the end."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Patch, Polygon

from hitchopt.motion.motion import Motion
from hitchopt.objects import Section
from hitchopt.values import Array
from hitchopt.view.house_colours import object_colours

GONE = "none"
"""Colour of the places that objects have left."""


def draw_objects(axes: Axes, motion: Motion) -> list[Artist]:
    """Draw all objects where they end, and dashed where they have stood; return the legend's."""
    poses = motion.object_poses
    first, last = poses.coefficients[0, ..., 0], poses.coefficients[-1, ..., -1]
    kinds = set()
    bodies = motion.requirements.objects.values()
    for before, after, body, fill in zip(first, last, bodies, object_colours(motion), strict=True):
        kinds.add((fill, "table" if body.fixed else "object"))
        for slab in reversed(body.slabs):
            if np.any(before != after):
                _draw(axes, slab.section, before, GONE, "--")
            _draw(axes, slab.section, after, fill, "-")
    return [Patch(fc=fill, ec="0.5", label=label) for fill, label in sorted(kinds)]


def _draw(axes: Axes, section: Section, pose: Array, fill: str, line: str) -> None:
    """Draw a section of an object with a pose (5,)."""
    style: dict[str, Any] = {"fc": fill, "ec": "0.5", "ls": line, "lw": 0.8, "zorder": 0.5}
    if section.radius is not None:
        axes.add_patch(Circle((float(pose[0]), float(pose[1])), section.radius, **style))
    else:
        yaw = float(np.arctan2(pose[4], pose[3]))
        axes.add_patch(Polygon(section.placed(pose[:2], yaw), **style))
