"""Polygons around a section and inside of it, with the clearance asked."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial import HalfspaceIntersection

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.leg_program import LIMIT_MARGIN, SPREAD_MARGIN, LegTask
from hitchopt.hitch.legs import reference_margin, split_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import Section
from hitchopt.values import Array, Indices

DIRECTIONS = 240
"""Directions in which edges of a polygon may face, besides those of the section's sides; rounded
to a multiple of the number of edges."""

POINTS = 240
"""Points of the section's boundary at which vertices inside of it may be."""

TURNS = 8
"""Starting polygons, turned by equal parts of their symmetry."""

SHARPEST = math.radians(150.0)
"""[rad] Largest exterior angle."""

LEAST_TURN, LEAST_EDGE = 0.6, 0.5
"""Smallest exterior angle and smallest edge, over their means."""

FLAT_COST = 4.0
"""Share of the section's area that a radian less than the least turn costs in the search."""

GAIN = 1e-9
"""[m²] Least gain of area, or of edges squared, that counts."""

ROUNDING = 1e-9
"""Margins that differ by less are the same: drones in one place are not 3e-16 apart."""

CENTIMETRE = 0.01
"""[m] Step of cable lengths."""

STRIDE = 20
"""Centimetres between the lengths that are tried with legs that are not balanced."""

LONGEST = 1.0
"""Longest cable that is tried: so many metres more than legs need."""


def enclosing_polygon(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return an n-gon of short edges, much alike, that keep a distance [m] to a section.

    It has the least sum of squares of edges that is found, edges that are not much shorter than
    others, and no flat corners. The directions of its edges, all of which keep just the distance,
    are improved one by one, from several starts.

    Raises
    ------
    InfeasibleError: none such are found, as for many edges around a narrow section.
    """
    sides = np.roll(section.core, -1, axis=0) - section.core
    of_sides = np.arctan2(sides[:, 0], -sides[:, 1]) if len(sides) > 1 else np.zeros(0)
    count = n * -(-DIRECTIONS // n)
    even = 2.0 * math.pi * np.arange(count) / count
    angles = np.unique(np.concatenate([even, of_sides % (2.0 * math.pi)]))
    outward = np.column_stack([np.cos(angles), np.sin(angles)])
    distances = section.support(outward) + clearance
    worst = n * (16.0 * np.max(distances - outward @ section.centroid)) ** 2

    def squares(choices: Indices) -> Array:
        """Return the sums (…) of squares of edges that face directions (…, n), clockwise."""
        faces, far = angles[choices], distances[choices]
        turn = (faces - np.roll(faces, -1, axis=-1)) % (2.0 * math.pi)
        possible = np.all((turn > 0.0) & (turn < SHARPEST), axis=-1, keepdims=True)
        safe = np.where(possible, turn, 1.0)
        ahead = (np.roll(far, -1, axis=-1) - far * np.cos(safe)) / np.sin(safe)
        before = (far - np.roll(far, -1, axis=-1) * np.cos(safe)) / np.sin(safe)
        edges = ahead + np.roll(before, 1, axis=-1)
        around = np.isclose(np.sum(turn, axis=-1), 2.0 * math.pi)
        flat = np.maximum(LEAST_TURN - turn / (2.0 * math.pi / n), 0.0)
        short = np.maximum(LEAST_EDGE - edges / np.mean(edges, axis=-1, keepdims=True), 0.0)
        lacks = np.sum(flat + short, axis=-1)
        total = np.sum(edges * edges, axis=-1) + np.where(lacks > 0.0, worst * (1.0 + lacks), 0.0)
        return np.where(possible[..., 0] & around, total, np.inf)

    chosen = _improved(squares, n, len(angles))
    if squares(chosen) > worst:
        remedy = "use fewer robots"
        broken = Violation("convexity", n, n - 1, "max", "edges", (), "", remedy)
        raise InfeasibleError([broken], "the section is too narrow for so many edges around it")
    normals, far = outward[chosen], distances[chosen]
    pairs = np.stack([np.roll(normals, 1, axis=0), normals], axis=1)
    corners = np.linalg.solve(pairs, np.stack([np.roll(far, 1), far], axis=1)[..., None])[..., 0]
    return ConvexPolygon(corners)


def inner_polygon(section: Section, n: int, inset: float) -> ConvexPolygon:
    """Return a large n-gon whose vertices are a distance [m] inside of a section.

    Raises
    ------
    InfeasibleError: the section is too small for it.
    """
    boundary = _inner_boundary(section, inset)
    count, least = len(boundary), LEAST_TURN * 2.0 * math.pi / n

    def lacks(choices: Indices) -> tuple[Array, Array]:
        """Return minus the areas (…) of polygons of points (…, n) of the boundary, and turns."""
        steps = (choices - np.roll(choices, -1, axis=-1)) % count
        possible = np.all(steps > 0, axis=-1) & (np.sum(steps, axis=-1) == count)
        corners = boundary[choices]
        onward = np.roll(corners, -1, axis=-2)
        ahead = onward - corners
        before = np.roll(ahead, 1, axis=-2)
        right = before[..., 1] * ahead[..., 0] - before[..., 0] * ahead[..., 1]
        turn = np.arctan2(right, np.sum(before * ahead, axis=-1))
        flat = np.sum(np.maximum(least - turn, 0.0), axis=-1)
        areas = corners[..., 0] * onward[..., 1] - corners[..., 1] * onward[..., 0]
        total = 0.5 * np.sum(areas, axis=-1) + FLAT_COST * flat * section.area
        return np.where(possible, total, np.inf), turn

    chosen = _improved(lambda choices: lacks(choices)[0], n, count)
    corners = boundary[chosen]
    if np.min(lacks(chosen)[1]) < least:
        raise _too_narrow(float(np.min(length(corners - np.roll(corners, 1, axis=0)))), inset)
    return ConvexPolygon(corners)


def _improved(cost: Callable[[Indices], Array], n: int, count: int) -> Indices:
    """Return the choices (n,) of least cost out of ``count``, changed one by one from starts.

    Choices fall along the polygon: directions and boundaries count counter-clockwise.
    """
    best, least = np.zeros(n, dtype=np.intp), np.inf
    for turn in range(TURNS):
        shares = turn / (n * TURNS) - np.arange(n) / n
        x = np.round(shares * count).astype(np.intp) % count
        now, found = float(cost(x)), np.inf
        while now < found - GAIN:
            found = now
            for k in range(n):
                trials = np.repeat(x[None], count, axis=0)
                trials[:, k] = np.arange(count)
                costs = cost(trials)
                first = int(np.argmin(costs))
                if costs[first] < now - GAIN:
                    x, now = trials[first], float(costs[first])
        if now < least - GAIN:
            best, least = x, now
    return best


def _inner_boundary(section: Section, inset: float) -> Array:
    """Return points (points, 2) [m], counter-clockwise, on the boundary of a smaller section."""
    centre, core = section.centroid, section.core
    sides = np.roll(core, -1, axis=0) - core
    outward = unit(np.stack([-sides[:, 1], sides[:, 0]], axis=1))
    depth = np.sum((core - centre) * outward, axis=1) + section.rounding - inset
    if np.min(depth) <= inset:
        raise _too_narrow(float(np.min(depth)) + inset, inset)
    if section.radius is not None:
        angles = 2.0 * np.pi * np.arange(POINTS) / POINTS
        return np.asarray(centre + depth * np.column_stack([np.cos(angles), np.sin(angles)]))
    corners = HalfspaceIntersection(np.column_stack([outward, -depth]), np.zeros(2)).intersections
    corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]) % (2.0 * np.pi))]
    ring = np.vstack([corners, corners[:1]])
    along = np.append(0.0, np.cumsum(length(np.diff(ring, axis=0))))
    places = np.unique(np.append(along[:-1], np.linspace(0.0, along[-1], POINTS, endpoint=False)))
    return np.asarray(centre + np.stack([np.interp(places, along, x) for x in ring.T], axis=1))


def _too_narrow(size: float, inset: float) -> InfeasibleError:
    remedy = "lower the clearance, or grip it"
    broken = Violation("support", size, 2.0 * inset, "min", "m", (), "", remedy)
    return InfeasibleError([broken], "the section is too narrow for such a polygon inside of it")


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
