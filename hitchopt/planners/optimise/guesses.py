"""First guesses of the path from one polygon to another, each of another homotopy.

Straight lines need not stay convex, and a half turn along them collapses to a point. Turning the
edges' directions evenly, with the nearest lengths that close, gives convex polygons; so does
turning the whole polygon while its shape changes, where the shapes are alike.
"""

from __future__ import annotations

import math

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.outline import centroids
from hitchopt.values import Array

SHORTEST_EDGE = 0.3
"""Least share of the shorter of an edge's two lengths on the path."""

OTHER_TURN = 0.75 * math.pi
"""[rad] Smallest turn for which turning in the other direction is a guess as well."""


def guesses(first: ConvexPolygon, last: ConvexPolygon, count: int) -> dict[str, Array]:
    """Return guesses (count, n, 2) [m] by their names, the straight one first."""
    s = np.linspace(0.0, 1.0, count)
    found = {"straight": _line(first.vertices, last.vertices, s)}
    turn = mean_turn(first, last)
    turns = [turn]
    if abs(turn) > OTHER_TURN:
        turns.append(turn - math.copysign(2.0 * math.pi, turn))
    for angle in turns:
        found[f"turned {math.degrees(angle):.0f}°"] = _turned(first, last, angle, s)
        edges = _edgewise(first, last, angle, s)
        if edges is not None:
            found[f"edges turned {math.degrees(angle):.0f}°"] = edges
    return found


def mean_turn(first: ConvexPolygon, last: ConvexPolygon) -> float:
    """Return by how much the edges turn on average, in (-π, π], counter-clockwise [rad].

    Edges turn by amounts that differ by less than a full turn altogether, so one unwrapping
    serves them all.
    """
    turns = _unwrapped(last) - _unwrapped(first)
    mean = float(np.mean(turns))
    return mean - 2.0 * math.pi * math.ceil((mean - math.pi) / (2.0 * math.pi))


def _unwrapped(polygon: ConvexPolygon) -> Array:
    """Return the edges' directions (n,) [rad], falling by the exterior angles from edge to edge."""
    u = polygon.edge_directions[0]
    start = math.atan2(u[1], u[0])
    return start - np.append(0.0, np.cumsum(polygon.exterior_angles[1:]))


def _line(first: Array, last: Array, s: Array) -> Array:
    return first + s[:, None, None] * (last - first)


def _rotated(points: Array, angles: Array) -> Array:
    """Return (J, n, 2): points (n, 2) or (J, n, 2) turned by angles (J,)."""
    c, s = np.cos(angles), np.sin(angles)
    turn = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    turned: Array = points @ turn
    return turned


def _turned(first: ConvexPolygon, last: ConvexPolygon, angle: float, s: Array) -> Array:
    """Return polygons that turn as a whole by ``angle`` while centre and shape change evenly."""
    centres = _line(first.centroid[None], last.centroid[None], s)
    shape = first.vertices - first.centroid
    goal = _rotated(last.vertices - last.centroid, np.array([-angle]))[0]
    return centres + _rotated(_line(shape, goal, s), angle * s)


def _edgewise(first: ConvexPolygon, last: ConvexPolygon, angle: float, s: Array) -> Array | None:
    """Return polygons whose edges turn evenly, by ``angle`` on average."""
    start, goal = _unwrapped(first), _unwrapped(last)
    goal = goal + angle - float(np.mean(goal - start))
    directions = start + s[:, None] * (goal - start)
    lengths = first.edge_lengths + s[:, None] * (last.edge_lengths - first.edge_lengths)
    closed = _closed_lengths(
        directions, lengths, SHORTEST_EDGE * np.minimum(first.edge_lengths, last.edge_lengths)
    )
    if closed is None:
        return None
    edges = closed[..., None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    corners = np.cumsum(edges, axis=1) - edges
    wanted = _line(first.centroid[None], last.centroid[None], s)
    placed: Array = corners + wanted - centroids(corners)[:, None]
    return placed


def _closed_lengths(directions: Array, lengths: Array, shortest: Array) -> Array | None:
    """Return the lengths (J, n) nearest to given ones that close; None if one is too short."""
    sides = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    gaps = np.swapaxes(sides, 1, 2) @ lengths[..., None]
    pushes = np.linalg.solve(np.swapaxes(sides, 1, 2) @ sides, gaps)
    projected: Array = lengths - (sides @ pushes)[..., 0]
    return projected if np.all(projected >= shortest) else None
