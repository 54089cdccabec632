"""Problems of single drones for any N, as problem files: for tests, benchmarks and trying out.

Usage: python -m problems.swarm circle DRONES | grids SIDE | door WIDTH DRONES | stack DRONES |
random SEED | crowd DRONES > problem.yaml
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from hitchopt.hitch.requirements import Separation

Array = NDArray[np.float64]

SPACING = 1.5
"""Separation of neighbours on circles and grids, at the least."""

RANDOM_SPACING = 1.1
"""Separation of starts, and of goals, of random teams."""

Box = tuple[tuple[float, float, float], tuple[float, float, float]]

BOX: Box = ((-2.0, -2.0, 0.3), (2.0, 2.0, 2.3))
"""Box [m] in which random teams start and end, two corners."""


def antipodal_circle(n: int) -> dict[str, Any]:
    """Return n drones on a circle that all go straight to the opposite point, through the centre.

    The radius is 2 m, or as much as gives neighbours their SPACING.
    """
    across = 2.0 * Separation().radius * SPACING
    radius = max(2.0, 0.5 * across / math.sin(math.pi / n)) if n > 1 else 2.0
    angles = 2.0 * math.pi * np.arange(n) / n
    start = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(n, 1.5)])
    goal = start * np.array([-1.0, -1.0, 1.0])
    return problem(f"{n} drones trade places through the centre of a circle", start, goal)


def swapping_grids(side: int) -> dict[str, Any]:
    """Return two square grids of side² drones each that trade places."""
    step = 2.0 * Separation().radius * SPACING
    steps = step * np.arange(side)
    grid = np.stack(np.meshgrid(steps, steps, [1.2], indexing="ij"), axis=-1).reshape(-1, 3)
    grid[:, :2] -= 0.5 * steps[-1]
    shift = np.array([1.0 + steps[-1], 0.0, 0.0])
    left, right = grid - shift, grid + shift
    title = f"Two grids of {side} by {side} drones trade places"
    return problem(title, np.vstack([left, right]), np.vstack([right, left]))


def through_a_door(width: float, n: int) -> dict[str, Any]:
    """Return two rows of n drones on both sides of a wall that trade places through its door."""
    y = 0.5 * (np.arange(n) - 0.5 * (n - 1))
    row = np.column_stack([np.full(n, -2.0), y, np.full(n, 1.2)])
    other = row * np.array([-1.0, 1.0, 1.0])
    title = f"{2 * n} drones trade places through a door of {width:g} m"
    data = problem(title, np.vstack([row, other]), np.vstack([other, row]))
    x, half, wall = 0.1, 0.5 * width, 3.0
    data["arena"] = {"lower": [-3.0, -wall, 0.0], "upper": [3.0, wall, 2.8]}
    data["keep_out"] = [
        {
            "polygon": [[-x, low], [-x, high], [x, high], [x, low]],
            "lower": 0.0,
            "upper": 3.0,
        }
        for low, high in ((half, wall), (-wall, -half))
    ]
    return data


def reversed_stack(n: int) -> dict[str, Any]:
    """Return n drones hovering above one another whose order is turned upside down."""
    z = 0.5 + 2.0 * Separation().height * 1.2 * np.arange(n)
    start = np.column_stack([np.full(n, 0.4), np.full(n, -0.7), z])
    return problem(f"A stack of {n} drones turned upside down", start, start[::-1])


def random_team(seed: int) -> dict[str, Any]:
    """Return 10 to 30 drones between random places in a box of 4 by 4 by 2 m."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(10, 31))
    return problem(f"Random team {seed}", _apart(rng, n), _apart(rng, n))


def random_crowd(n: int, seed: int = 0) -> dict[str, Any]:
    """Return n drones between random places, as dense as 1000 of them in 20 by 20 by 10 m."""
    rng = np.random.default_rng(seed)
    size = 10.0 * (n / 1000.0) ** (1.0 / 3.0)
    box = ((-size, -size, 0.3), (size, size, 0.3 + size))
    return problem(f"Random crowd of {n} drones", _apart(rng, n, box), _apart(rng, n, box))


def problem(title: str, start: Array, goal: Array) -> dict[str, Any]:
    """Return the problem of drones that go from (N, 3) to (N, 3) [m]."""
    return {
        "title": title,
        "team": {"drones": len(start)},
        "start": np.round(start, 6).tolist(),
        "goal": np.round(goal, 6).tolist(),
    }


def _apart(rng: np.random.Generator, n: int, box: Box = BOX) -> Array:
    """(n, 3): random points in the box, none too close to another."""
    scale = Separation().scale
    points = np.empty((0, 3))
    while len(points) < n:
        point = rng.uniform(*box)
        if np.all(np.linalg.norm((points - point) * scale, axis=1) > RANDOM_SPACING):
            points = np.vstack([points, point])
    return points


if __name__ == "__main__":
    kind, *words = sys.argv[1:]
    if kind == "door":
        data = through_a_door(float(words[0]), int(words[1]))
    else:
        make = {
            "circle": antipodal_circle,
            "grids": swapping_grids,
            "stack": reversed_stack,
            "random": random_team,
            "crowd": random_crowd,
        }[kind]
        data = make(int(words[0]))
    yaml = YAML()  # keeps the keys in their order
    yaml.default_flow_style = None
    yaml.dump(data, sys.stdout)
