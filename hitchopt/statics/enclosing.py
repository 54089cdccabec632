"""Polygons around a section and inside of it, with the clearance asked."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial import HalfspaceIntersection

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon
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

AXES, STRETCHES = 24, (1.0, 1.2, 1.4, 1.7, 2.0, 2.4, 3.0)
"""Directions and ratios in which regular polygons are stretched."""

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
    are improved one by one, from several starts. Where none such are found, as for many edges
    around a narrow section, it is a regular polygon that is stretched, of which some edges keep
    more.
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
        return _stretched(section, n, clearance)
    normals, far = outward[chosen], distances[chosen]
    pairs = np.stack([np.roll(normals, 1, axis=0), normals], axis=1)
    corners = np.linalg.solve(pairs, np.stack([np.roll(far, 1), far], axis=1)[..., None])[..., 0]
    return ConvexPolygon(corners)


def _stretched(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return the least regular n-gon, turned and stretched, that keeps a distance to a section."""
    axes, stretches, turns = np.meshgrid(
        math.pi * np.arange(AXES) / AXES, STRETCHES, np.arange(TURNS) / TURNS, indexing="ij"
    )
    along = np.stack([np.cos(axes), np.sin(axes)], axis=-1)[..., None, :]
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    round_ = 2.0 * math.pi / n * (turns[..., None] - np.arange(n))
    middle = sum(
        0.5 * (section.support(unit) - section.support(-unit))[..., None] * unit
        for unit in (along, across)
    )
    corners = (stretches[..., None] * np.cos(round_))[..., None] * along
    corners = corners + np.sin(round_)[..., None] * across
    edges = np.roll(corners, -1, axis=-2) - corners
    sizes = np.linalg.norm(edges, axis=-1, keepdims=True)
    outward = np.stack([-edges[..., 1], edges[..., 0]], axis=-1) / sizes
    far = section.support(outward) - np.sum(middle * outward, axis=-1) + clearance
    scale = np.max(far / np.sum(corners * outward, axis=-1), axis=-1)
    turn = np.arccos(np.sum(outward * np.roll(outward, 1, axis=-2), axis=-1))
    good = (turn > LEAST_TURN * 2.0 * math.pi / n) & (turn < SHARPEST)
    long = sizes[..., 0] > LEAST_EDGE * np.mean(sizes[..., 0], axis=-1, keepdims=True)
    squares = scale**2 * np.sum(sizes[..., 0] ** 2, axis=-1)
    least = np.argmin(np.where(np.all(good & long, axis=-1), squares, np.inf))
    best = np.unravel_index(least, squares.shape)
    return ConvexPolygon(middle[best] + scale[best] * corners[best])


def inner_polygon(section: Section, n: int, inset: float) -> ConvexPolygon:
    """Return a large n-gon whose vertices are a distance [m] inside of a section.

    Raises
    ------
    InfeasibleError: the section is too small for it.
    """
    boundary = _inner_boundary(section, inset)
    count = len(boundary)

    def lacks(choices: Indices) -> Array:
        """Return minus the areas (…) of polygons with vertices (…, n) of the boundary."""
        steps = (choices - np.roll(choices, -1, axis=-1)) % count
        possible = np.all(steps > 0, axis=-1) & (np.sum(steps, axis=-1) == count)
        corners = boundary[choices]
        onward = np.roll(corners, -1, axis=-2)
        ahead = onward - corners
        before = np.roll(ahead, 1, axis=-2)
        right = before[..., 1] * ahead[..., 0] - before[..., 0] * ahead[..., 1]
        turn = np.arctan2(right, np.sum(before * ahead, axis=-1))
        flat = np.maximum(LEAST_TURN * 2.0 * math.pi / n - turn, 0.0)
        areas = corners[..., 0] * onward[..., 1] - corners[..., 1] * onward[..., 0]
        total = 0.5 * np.sum(areas, axis=-1) + FLAT_COST * np.sum(flat, axis=-1) * section.area
        return np.where(possible, total, np.inf)

    polygon = ConvexPolygon(boundary[_improved(lacks, n, count)])
    if np.min(polygon.exterior_angles) < LEAST_TURN * 2.0 * math.pi / n:
        raise _too_narrow(float(np.min(polygon.edge_lengths)), inset)
    return polygon


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
    outward = np.stack([-sides[:, 1], sides[:, 0]], axis=1)
    outward /= np.maximum(np.hypot(*sides.T), np.finfo(float).tiny)[:, None]
    depth = np.sum((core - centre) * outward, axis=1) + section.rounding - inset
    if np.min(depth) <= inset:
        raise _too_narrow(float(np.min(depth)) + inset, inset)
    if len(core) == 1:
        angles = 2.0 * np.pi * np.arange(POINTS) / POINTS
        circle: Array = centre + depth * np.column_stack([np.cos(angles), np.sin(angles)])
        return circle
    corners = HalfspaceIntersection(np.column_stack([outward, -depth]), np.zeros(2)).intersections
    corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]) % (2.0 * np.pi))]
    ring = np.vstack([corners, corners[:1]])
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(ring, axis=0).T)))
    places = np.unique(np.append(along[:-1], np.linspace(0.0, along[-1], POINTS, endpoint=False)))
    points: Array = centre + np.stack([np.interp(places, along, x) for x in ring.T], axis=1)
    return points


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
    longest = float(np.max(polygon.edge_lengths))
    first = math.ceil((longest + 2.0 * LIMIT_MARGIN * requirements.limits.leg) / CENTIMETRE)
    last = first + round(LONGEST / CENTIMETRE)
    lengths = [centimetres / 100.0 for centimetres in range(first, last)]
    for cables, margin_of in ((lengths, reference_margin), (lengths[::STRIDE], _split_margin)):
        best, found = 0.0, 0.0
        for cable in cables:
            margin = min(margin_of(_spread_task(polygon, cable, requirements)), SPREAD_MARGIN)
            if margin > best + ROUNDING:
                best, found = margin, cable
            if best >= SPREAD_MARGIN:
                break
        if best >= LIMIT_MARGIN:
            return found
    fewer = "use fewer robots, or " if len(polygon) > 3 else ""
    remedy = f"{fewer}change the clearance"
    broken = Violation("separation", best, LIMIT_MARGIN, "min", "ratio", (), "", remedy)
    raise InfeasibleError([broken], "no cable length keeps drones around the object apart")


def _spread_task(polygon: ConvexPolygon, cable: float, requirements: Requirements) -> LegTask:
    team = Team(len(polygon), cable)
    return LegTask(
        team, requirements, polygon.vertices[None], balanced_legs(team, polygon)[None],
        requirements.limits.leg, SPREAD_MARGIN,
    )  # fmt: skip


def _split_margin(task: LegTask) -> float:
    return split_slack(task).margin
