"""Polygons around a section and inside of it, with the clearance asked."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.leg_program import LIMIT_MARGIN, SPREAD_MARGIN, LegTask
from hitchopt.hitch.legs import reference_margin, split_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import Section
from hitchopt.values import Array

AXES, TURNS, STRETCHES = 24, 16, np.geomspace(0.25, 4.0, 41)
"""Regular polygons are turned by so many parts of their symmetry, and stretched in so many
directions besides those of the section's sides, by these ratios over the section's own."""

LEAST_TURN, LEAST_EDGE = 0.6, 0.5
"""Smallest exterior angle and smallest edge, over their means."""

ROUNDING = 1e-9
"""Sizes and margins that differ by less are the same: drones in one place are not 3e-16 apart."""

CENTIMETRE = 0.01
"""[m] Step of cable lengths."""

STRIDE = 20
"""Centimetres between the lengths that are tried with legs that are not balanced."""

LONGEST = 1.0
"""Longest cable that is tried: so many metres more than legs need."""


def _shapes(section: Section, n: int, inset: float) -> Array:
    """Return clockwise n-gons (shapes, n, 2), stretched to a section's widths less an inset [m]."""
    core, angles = section.core, math.pi * np.arange(AXES) / AXES
    sides = unit(np.roll(core, -1, axis=0) - core)[: len(core) if len(core) > 1 else 0]
    along = np.concatenate([np.column_stack([np.cos(angles), np.sin(angles)]), sides])
    axes = np.stack([along, np.column_stack([-along[:, 1], along[:, 0]])], axis=1)
    widths = 0.5 * (section.support(axes) + section.support(-axes)) - inset
    ratios = np.column_stack([np.sqrt(STRETCHES), 1.0 / np.sqrt(STRETCHES)])
    corners = 2.0 * math.pi / n * (np.arange(TURNS)[:, None] / TURNS - np.arange(n))
    regular = np.stack([np.cos(corners), np.sin(corners)], axis=-1)
    shapes = np.einsum("aj,kj,tnj,aji->aktni", widths, ratios, regular, axes)
    return np.asarray(shapes.reshape(-1, n, 2))


def _even(polygons: Any) -> Any:
    """Return whether polygons (…, n, 2) are convex, without flat corners and short edges."""
    edges = np.roll(polygons, -1, axis=-2) - polygons
    before, sizes = np.roll(edges, 1, axis=-2), length(edges)
    right = before[..., 1] * edges[..., 0] - before[..., 0] * edges[..., 1]
    turns = np.arctan2(right, dot(before, edges))
    good = np.isclose(np.sum(turns, axis=-1), 2.0 * math.pi)
    good &= np.all(turns >= LEAST_TURN * 2.0 * math.pi / turns.shape[-1], axis=-1)
    return np.asarray(good & (np.min(sizes, axis=-1) >= LEAST_EDGE * np.mean(sizes, axis=-1)))


def enclosing_polygon(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return an n-gon of short edges, much alike, that keep a distance [m] to a section.

    Edges face as those of regular polygons that are turned and stretched, and keep just the
    distance; of these n-gons it has the least sum of squares of edges.

    Raises
    ------
    InfeasibleError: all have flat corners or short edges, as many edges around a narrow section.
    """
    shapes = _shapes(section, n, -clearance)
    edges = unit(np.roll(shapes, -1, axis=-2) - shapes)
    outward = np.stack([-edges[..., 1], edges[..., 0]], axis=-1)
    far = section.support(outward) + clearance
    pairs = np.stack([np.roll(outward, 1, axis=-2), outward], axis=-2)
    sides = np.stack([np.roll(far, 1, axis=-1), far], axis=-1)
    corners = np.linalg.solve(pairs, sides[..., None])[..., 0]
    onward = np.roll(corners, -1, axis=-2) - corners
    good = _even(corners) & np.all(dot(onward, edges) > 0.0, axis=-1)
    if not np.any(good):
        broken = Violation("convexity", n, n - 1, "max", "edges", (), "", "use fewer robots")
        raise InfeasibleError([broken], "the section is too narrow for so many edges around it")
    squares = np.where(good, np.sum(onward**2, axis=(-2, -1)), np.inf)
    return ConvexPolygon(corners[np.argmax(squares <= (1.0 + ROUNDING) * np.min(squares))])


def inner_polygon(section: Section, n: int, inset: float) -> ConvexPolygon:
    """Return the largest n-gon whose vertices are a distance [m] inside of a section.

    It is regular, but turned and stretched about the section's centroid.

    Raises
    ------
    InfeasibleError: the section is too small for it.
    """
    core, centre = section.core, section.centroid
    sides = np.roll(core, -1, axis=0) - core
    outward = unit(np.stack([-sides[:, 1], sides[:, 0]], axis=1))
    depth = dot(core - centre, outward) + section.rounding - inset
    if np.min(depth) <= inset:
        broken = Violation(
            "support", float(np.min(depth)) + inset, 2.0 * inset, "min", "m", (), "",
            "lower the clearance, or grip it",
        )  # fmt: skip
        raise InfeasibleError([broken], "the section is too narrow for such a polygon inside of it")
    shapes = _shapes(section, n, inset)
    shapes = shapes[_even(shapes)]
    reach = shapes @ (outward / depth[:, None]).T
    if section.radius is not None:
        reach = length(shapes)[..., None] / depth
    shapes = shapes / np.max(reach, axis=(-2, -1))[:, None, None]
    onward = np.roll(shapes, -1, axis=-2)
    areas = np.sum(onward[..., 0] * shapes[..., 1] - onward[..., 1] * shapes[..., 0], axis=-1)
    return ConvexPolygon(centre + shapes[np.argmax(areas >= (1.0 - ROUNDING) * np.max(areas))])


def shortest_cable(polygon: ConvexPolygon, requirements: Requirements) -> float:
    """Return the shortest cables [m], in whole centimetres, whose balanced legs are ``spread``.

    Where none are, the length that is found with the largest margin, legs split as they may be.

    Raises
    ------
    InfeasibleError: there are none of up to a metre more than legs need.
    """
    longest, leg = float(np.max(polygon.edge_lengths)), requirements.limits.leg
    first = math.ceil((longest + 2.0 * LIMIT_MARGIN * leg) / CENTIMETRE)
    lengths = np.arange(first, first + round(LONGEST / CENTIMETRE)) / 100.0
    for cables, balanced in ((lengths, True), (lengths[::STRIDE], False)):
        best, found = 0.0, 0.0
        for cable in cables.tolist():
            team = Team(len(polygon), cable)
            shape = polygon.vertices[None], balanced_legs(team, polygon)[None]
            task = LegTask(team, requirements, *shape, leg, SPREAD_MARGIN)
            margin = reference_margin(task) if balanced else split_slack(task).margin
            if min(margin, SPREAD_MARGIN) > best + ROUNDING:
                best, found = min(margin, SPREAD_MARGIN), cable
            if best >= SPREAD_MARGIN:
                break
        if best >= LIMIT_MARGIN:
            return found
    fewer = "use fewer robots, or " if len(polygon) > 3 else ""
    remedy = f"{fewer}change the clearance"
    broken = Violation("separation", best, LIMIT_MARGIN, "min", "ratio", (), "", remedy)
    raise InfeasibleError([broken], "no cable length keeps drones around the object apart")
