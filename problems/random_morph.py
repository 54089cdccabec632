"""Random convex morphs for any n, as problem files: for tests, benchmarks and trying things out.

Usage: python -m problems.random_morph ROBOTS SEED [--wild] > problem.yaml
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from scipy.spatial import ConvexHull

import hitchopt as ho
from hitchopt.geometry import ConvexPolygon

EDGE = 1.3
"""Mean length of an edge [m]."""

JITTER = 0.18
"""Jitter of the vertices: edges stay long enough for two legs and two drones."""

SLACK = (0.32, 0.7)
"""Slack of a cable for both legs where its edge is longest, minimum and maximum [m]."""

BETWEEN = 0.45
"""Least distance ``l - d - e`` [m] of a cable's two drones along a nearly straight outline."""

STRETCH = 0.12
"""Largest relative stretch of a polygon along either axis."""


def random_convex_polygon(
    n: int, edge: float, rng: np.random.Generator, jitter: float = 0.3
) -> ConvexPolygon:
    """Return a random convex n-gon about the origin.

    Points of a circle at jittered angles, then stretched: both keep it convex.

    Parameters
    ----------
    n: number of vertices.
    edge: length of an edge, about [m].
    rng: source of randomness.
    jitter: by how much a vertex may be off a regular polygon's, as a share of the angle between
        two vertices, below 0.5.
    """
    step = 2.0 * math.pi / n
    angles = -step * (np.arange(n) + jitter * rng.uniform(-1.0, 1.0, n))
    angles += rng.uniform(0.0, 2.0 * math.pi)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    points *= 1.0 + STRETCH * rng.uniform(-1.0, 1.0, 2)
    polygon = ConvexPolygon(0.5 * edge / math.sin(0.5 * step) * points)
    return polygon.rotated(rng.uniform(0.0, 2.0 * math.pi))


def random_morph(n: int, seed: int) -> dict[str, Any]:
    """Return a problem that turns, scales, shifts and reshapes a random convex n-gon a little.

    Off the origin, with unequal cables; most can be solved along straight vertex paths. From about
    n = 12 on the distance to cables is asked for as the geometry allows: a drone stands ``e sin β``
    from its neighbour's cable, and β nears 180°.
    """
    rng = np.random.default_rng([n, seed])
    first = random_convex_polygon(n, EDGE, rng, JITTER)
    first = first.translated(rng.uniform(-2.0, 2.0, 2))
    centre = first.centroid
    wobble = 1.0 + 0.04 / math.sqrt(n) * rng.uniform(-1.0, 1.0)
    second = first.translated(-centre).scaled(wobble).rotated(rng.uniform(-0.5, 0.5) / n)
    second = second.translated(centre + rng.uniform(-0.5, 0.5, 2))
    longest = np.maximum(first.edge_lengths, second.edge_lengths)
    shortest = np.minimum(first.edge_lengths, second.edge_lengths)
    slack = np.clip(shortest - BETWEEN, *SLACK) * rng.uniform(0.97, 1.0, n)
    lengths = longest + slack
    bluntest = math.sin(float(np.min(first.exterior_angles)))
    clearance = min(0.10, 0.2 * float(np.min(slack)) * bluntest)
    return {
        "title": f"Random morph, n = {n}, seed {seed}",
        "team": {"robots": n, "cable_length": [round(float(x), 4) for x in lengths]},
        "separation": {"cable": round(clearance, 6), "crossing": min(0.05, round(clearance, 6))},
        "start": {"hitch": {"polygon": _points(first.vertices), "altitude": 1.0}},
        "mission": [{"morph": {"polygon": _points(second.vertices)}}],
    }


WILD_EDGE = (0.7, 1.8)
"""Mean edge of the larger of two wild polygons, minimum and maximum [m]."""

MAX_RATIO = 2.5
"""Largest ratio of the sizes of two wild polygons."""

WILD_SLACK = (0.45, 2.2)
"""Length of the cables beyond the longest edge of two wild polygons, minimum and maximum [m]."""

MAX_SHIFT = 0.5
"""Largest shift of the centre of a wild polygon along either axis [m]."""

HEAVY = {"cable_density": 0.006, "tension": 0.6}
"""Cables with weight [kg/m], and the tension that carries it [N]."""


def wild_polygon(n: int, edge: float, rng: np.random.Generator) -> ConvexPolygon:
    """Return a random convex n-gon about the origin, with a mean edge [m].

    Its vertices are those of an ellipse at uniform angles, or of the hull of uniform points.
    """
    if rng.random() < 0.5:
        angles = -np.sort(rng.uniform(0.0, 2.0 * math.pi, n))
        axes = np.array([1.0, rng.uniform(0.5, 1.0)])
        corners = axes * np.column_stack([np.cos(angles), np.sin(angles)])
    else:
        while True:
            points = rng.uniform(-1.0, 1.0, (rng.integers(n, 4 * n), 2))
            hull = ConvexHull(points).vertices[::-1]  # clockwise
            if len(hull) == n:
                break
        corners = points[np.roll(hull, rng.integers(n))]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    corners = edge / np.mean(lengths) * (corners - np.mean(corners, axis=0))
    return ConvexPolygon(corners).rotated(rng.uniform(0.0, 2.0 * math.pi))


def irregular_pairs() -> list[dict[str, Any]]:
    """Return pairs of irregular polygons with n and cable length, whose hitches are certified.

    The hitches have spread legs: fair pairs without roll, wild ones with automatic roll.
    """
    path = Path(__file__).with_name("irregular_pairs.json")
    pairs: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return pairs


def wild_morph(n: int, seed: int, *, heavy: bool = False) -> dict[str, Any]:
    """Return a problem between two irregular n-gons of any turn, with sizes up to 1 : 2.5.

    Legs are spread at both ends, which are rolled where limits need that. Polygons are drawn until
    both hitches are certified at rest. Cables are ``heavy`` or weightless.
    """
    rng = np.random.default_rng([n, seed])
    edge, ratio = rng.uniform(*WILD_EDGE), rng.uniform(1.0, MAX_RATIO)
    edges = [edge, edge / ratio] if rng.random() < 0.5 else [edge / ratio, edge]
    slack, shift = rng.uniform(*WILD_SLACK), rng.uniform(-MAX_SHIFT, MAX_SHIFT, 2)
    while True:
        start, goal = (wild_polygon(n, each, rng) for each in edges)
        goal = goal.translated(shift)
        longest = max(float(np.max(polygon.edge_lengths)) for polygon in (start, goal))
        cable = round(longest + slack, 2)
        team = {"robots": n, "cable_length": cable, **(HEAVY if heavy else {})}
        hitches = [
            {"polygon": _points(polygon.vertices), "altitude": 1.5, "legs": "spread"}
            for polygon in (start, goal)
        ]
        if all(is_certified(team, {"hitch": hitch}) for hitch in hitches):
            break
    return {
        "title": f"Wild morph, n = {n}, seed {seed}",
        "team": team,
        "start": {"hitch": hitches[0]},
        "mission": [{"morph": {"polygon": hitches[1]["polygon"]}}],
    }


def is_certified(
    team: dict[str, Any], start: dict[str, Any], options: dict[str, Any] | None = None
) -> bool:
    """Return whether a team keeps all limits at rest at a start; ``options`` are further keys."""
    problem = {"team": team, "start": start, "mission": [{"hold": {"seconds": 1.0}}]}
    try:
        ho.solve(ho.problem_from_dict({**problem, **(options or {})}))
    except ho.InfeasibleError:
        return False
    return True


def _points(vertices: np.ndarray) -> list[list[float]]:
    return [[round(float(x), 6), round(float(y), 6)] for x, y in vertices]


if __name__ == "__main__":
    robots, seed = (int(word) for word in sys.argv[1:3])
    draw = wild_morph if "--wild" in sys.argv else random_morph
    yaml = YAML()  # keeps the keys in their order
    yaml.default_flow_style = None
    yaml.dump(draw(robots, seed), sys.stdout)
