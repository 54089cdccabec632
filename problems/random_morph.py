"""Random convex morphs for any n, as problem files: for tests, benchmarks and trying things out.

Usage: python -m problems.random_morph ROBOTS SEED > problem.yaml
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from hitchopt.geometry import random_convex_polygon

EDGE = 1.3
"""Mean length of an edge [m]."""

JITTER = 0.18
"""Jitter of the vertices: edges stay long enough for two legs and two drones."""

SLACK = (0.32, 0.7)
"""Slack of a cable for both legs where its edge is longest, least and most [m]."""

BETWEEN = 0.45
"""Least distance ``l - d - e`` [m] of a cable's two drones along a nearly straight outline."""


def random_morph(n: int, seed: int, *, hard: bool = False) -> dict[str, Any]:
    """Return a problem that turns, scales, shifts and reshapes a random convex n-gon a little.

    Off the origin, with unequal cables; most can be solved along straight vertex paths. A ``hard``
    one goes to a polygon of its own: turned by any angle, shifted by up to a metre either way,
    scaled by up to a tenth, of other proportions. From about n = 12 on the distance to cables is
    asked for as the geometry allows: a drone stands ``e sin β`` from its neighbour's cable, and β
    nears 180°.
    """
    rng = np.random.default_rng([n, seed])
    first = random_convex_polygon(n, EDGE, rng, JITTER)
    first = first.translated(rng.uniform(-2.0, 2.0, 2))
    centre = first.centroid
    wobble = 1.0 + 0.04 / math.sqrt(n) * rng.uniform(-1.0, 1.0)
    second = first.translated(-centre).scaled(wobble).rotated(rng.uniform(-0.5, 0.5) / n)
    second = second.translated(centre + rng.uniform(-0.5, 0.5, 2))
    if hard:
        other = random_convex_polygon(n, EDGE * rng.uniform(0.9, 1.1), rng, JITTER)
        second = other.translated(centre + rng.uniform(-1.0, 1.0, 2))
    longest = np.maximum(first.edge_lengths, second.edge_lengths)
    shortest = np.minimum(first.edge_lengths, second.edge_lengths)
    slack = np.clip(shortest - BETWEEN, *SLACK) * rng.uniform(0.97, 1.0, n)
    lengths = longest + slack
    bluntest = math.sin(float(np.min(first.exterior_angles)))
    clearance = min(0.10, 0.2 * float(np.min(slack)) * bluntest)
    return {
        "title": f"Random {'hard ' if hard else ''}morph, n = {n}, seed {seed}",
        "team": {"robots": n, "cable_length": [round(float(x), 4) for x in lengths]},
        "separation": {"cable": round(clearance, 6), "crossing": min(0.05, round(clearance, 6))},
        "start": {"hitch": {"polygon": _points(first.vertices), "altitude": 1.0}},
        "mission": [{"morph": {"polygon": _points(second.vertices)}}],
    }


def _points(vertices: np.ndarray) -> list[list[float]]:
    return [[round(float(x), 6), round(float(y), 6)] for x, y in vertices]


if __name__ == "__main__":
    robots, seed = (int(word) for word in sys.argv[1:3])
    yaml = YAML()  # keeps the keys in their order
    yaml.default_flow_style = None
    yaml.dump(random_morph(robots, seed), sys.stdout)
