"""Problems of single drones for any N, as problem files: for tests, benchmarks and trying out.

Usage: python -m problems.swarm circle DRONES | grids SIDE | door WIDTH DRONES | stack DRONES |
random SEED | crowd DRONES > problem.yaml
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from hitchopt.hitch.requirements import Prism, Separation

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
    """Return two square grids of side² drones each that swap positions."""
    step = 2.0 * Separation().radius * SPACING
    steps = step * np.arange(side)
    grid = np.stack(np.meshgrid(steps, steps, [1.2], indexing="ij"), axis=-1).reshape(-1, 3)
    grid[:, :2] -= 0.5 * steps[-1]
    shift = np.array([1.0 + steps[-1], 0.0, 0.0])
    left, right = grid - shift, grid + shift
    title = f"Two grids of {side} by {side} drones trade places"
    return problem(title, np.vstack([left, right]), np.vstack([right, left]))


def through_a_door(width: float, n: int) -> dict[str, Any]:
    """Return two rows of n drones on both sides of a wall that swap positions through its door."""
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
    """Return 10 to 30 drones between random positions in a box of 4 by 4 by 2 m."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(10, 31))
    return problem(f"Random team {seed}", _apart(rng, n), _apart(rng, n))


def random_crowd(n: int, seed: int = 0) -> dict[str, Any]:
    """Return n drones between random positions, as dense as 1000 of them in 20 by 20 by 10 m."""
    rng = np.random.default_rng(seed)
    size = 10.0 * (n / 1000.0) ** (1.0 / 3.0)
    box = ((-size, -size, 0.3), (size, size, 0.3 + size))
    return problem(f"Random crowd of {n} drones", _apart(rng, n, box), _apart(rng, n, box))


def random_door(seed: int) -> dict[str, Any]:
    """Return 4 to 16 drones in a flat box, half of them on each side of a door, that change sides.

    The door lets one drone through at a time, with 1 to 60 % more than it needs.
    """
    rng = np.random.default_rng(seed)
    n, radius = int(rng.integers(2, 9)), Separation().radius
    half_width = radius * float(rng.uniform(1.01, 1.6))
    length, wall = float(rng.uniform(1.2, 2.6)), float(rng.uniform(0.8, 1.6))
    middle, half_height = 1.0, float(rng.uniform(0.03, 0.3))
    gap = radius + 0.15
    left, right = ([sign * gap, sign * (length + gap)] for sign in (-1.0, 1.0))
    sides = [
        (
            (min(x), radius - wall, middle - half_height),
            (max(x), wall - radius, middle + half_height),
        )
        for x in (left, right)
    ]
    rows = [_apart(rng, n, side) for side in (*sides, *sides)]
    start, goal = np.vstack([rows[0], rows[1]]), np.vstack([rows[3], rows[2]])
    data = problem(f"Random door {seed}: {2 * n} drones", start, goal)
    end = length + gap + radius
    data["arena"] = {
        "lower": [-end, -wall, middle - half_height],
        "upper": [end, wall, middle + half_height],
    }
    data["keep_out"] = [
        _block(-0.1, 0.1, low, high)
        for low, high in ((half_width, wall + 0.2), (-wall - 0.2, -half_width))
    ]
    return data


def random_corridor(seed: int) -> dict[str, Any]:
    """Return two or four drones that trade the ends of a corridor for one, with a bay midway.

    The bay holds the drones of one end side by side.
    """
    rng = np.random.default_rng(seed)
    n, radius = int(rng.integers(1, 3)), Separation().radius
    half_width = radius * float(rng.uniform(1.1, 1.6))
    depth = radius * float(rng.uniform(2.3, 3.0))
    half_bay = radius * (n + 1.0) * float(rng.uniform(1.1, 1.4))
    first, spacing = half_bay + float(rng.uniform(0.3, 1.5)), 2.2 * radius
    x = first + spacing * np.arange(n)
    row = np.column_stack([x, np.zeros(n), np.ones(n)])
    other = row * np.array([-1.0, 1.0, 1.0])
    ends = row[::-1] if rng.random() < 0.5 else row
    start, goal = np.vstack([row, other]), np.vstack([ends * np.array([-1.0, 1.0, 1.0]), ends])
    data = problem(f"Random corridor {seed}: {2 * n} drones", start, goal)
    end = float(x[-1]) + 0.2
    data["arena"] = {"lower": [-end, -1.0, 0.9], "upper": [end, 1.0, 1.1]}
    outer = end + 0.2
    data["keep_out"] = [
        _block(-outer, outer, -1.2, -half_width),
        _block(-outer, -half_bay, half_width, 1.2),
        _block(half_bay, outer, half_width, 1.2),
        _block(-half_bay, half_bay, half_width + depth, 1.2),
    ]
    return data


def random_box(seed: int) -> dict[str, Any]:
    """Return 8 to 40 drones between random positions in a tight box with up to three pillars."""
    rng = np.random.default_rng(seed)
    n, separation = int(rng.integers(8, 41)), Separation()
    flat = bool(rng.random() < 0.4)
    height = 0.1 if flat else float(rng.uniform(0.7, 1.6))
    layers = 1.0 if flat else 1.0 + height / (2.0 * separation.height)
    width = 2.0 * separation.radius * math.sqrt(n / layers) * float(rng.uniform(1.7, 2.4))
    box = ((-0.5 * width, -0.5 * width, 0.5), (0.5 * width, 0.5 * width, 0.5 + height))
    pillars = []
    for _ in range(int(rng.integers(0, 4))):
        x, y = rng.uniform(-0.4 * width, 0.4 * width, 2)
        pillars.append(_block(x - 0.1, x + 0.1, y - 0.1, y + 0.1))
    start, goal = (_apart(rng, n, box, pillars) for _ in range(2))
    data = problem(f"Random box {seed}: {n} drones", start, goal)
    lower, upper = np.array(box)
    reach = np.array([separation.radius, separation.radius, 0.0])
    data["arena"] = {"lower": (lower - reach).tolist(), "upper": (upper + reach).tolist()}
    data["keep_out"] = pillars
    return data


def _block(left: float, right: float, near: float, far: float) -> dict[str, Any]:
    """Return a prism that no drone flies over, between two x and two y [m]."""
    corners = [[left, near], [left, far], [right, far], [right, near]]
    return {"polygon": corners, "lower": 0.0, "upper": 4.0}


MISSION_HALF_WIDTH = 4.0
"""[m] Half the side of the square around which missions of Park and others start."""

MISSION_ARENA = {"lower": [-5.5, -5.5, 0.0], "upper": [5.5, 5.5, 2.8]}
"""Arena [m] of these missions."""

TREES = 20
"""Number of pillars of a forest."""

TREE_RADIUS = 0.35
"""[m] Radius of a pillar's corners."""


def square_mission(n: int, radius: float, seed: int | None = None) -> dict[str, Any]:
    """Return n drones, a multiple of 8, around a square that all go to the opposite point.

    Starts, goals and sizes are those of the missions that come with the planner of Park, Kim, Jang
    and Kim, "Efficient multi-agent trajectory planning with feasibility guarantee using relative
    Bernstein polynomial" (ICRA 2020; github.com/qwerty35/swarm_simulator, MIT licence).

    Parameters
    ----------
    radius: of a drone [m]; ellipsoids are twice as high.
    seed: of a forest of TREES pillars, which are not those of the missions; None for none.
    """
    place = 8.0 * MISSION_HALF_WIDTH * (np.arange(n) / n - 0.125)  # along the square from a corner
    side, along = np.divmod(place, 2.0 * MISSION_HALF_WIDTH)
    turned = np.exp(0.5j * np.pi * side) * (MISSION_HALF_WIDTH + 1j * (along - MISSION_HALF_WIDTH))
    start = np.column_stack([turned.real, turned.imag, np.ones(n)])
    goal = start * np.array([-1.0, -1.0, 1.0])
    where = "in the open" if seed is None else f"in forest {seed}"
    data = problem(f"{n} drones of {radius:g} m around a square, {where}", start, goal)
    data["separation"] = {"radius": radius, "height": 2.0 * radius}
    data["limits"] = {"speed": 1.7, "acceleration": 6.2, "jerk": 60.0}
    data["arena"] = MISSION_ARENA
    if seed is None:
        return data
    rng = np.random.default_rng(seed)
    angles = -np.pi / 3.0 * np.arange(6)
    outline = TREE_RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    trees = list[dict[str, Any]]()
    while len(trees) < TREES:
        corners = np.round(rng.uniform(-5.0, 5.0, 2) + outline, 4)
        tree = {"polygon": corners.tolist(), "lower": 0.0, "upper": 3.0}
        if np.min(Prism(corners, 0.0, 3.0).clearance(start).distance) > 1.3 * radius:
            trees.append(tree)
    data["keep_out"] = trees
    return data


def problem(title: str, start: Array, goal: Array) -> dict[str, Any]:
    """Return the problem of drones that go from (N, 3) to (N, 3) [m]."""
    return {
        "title": title,
        "team": {"drones": len(start)},
        "start": np.round(start, 6).tolist(),
        "goal": np.round(goal, 6).tolist(),
    }


def _apart(
    rng: np.random.Generator, n: int, box: Box = BOX, blocks: Sequence[dict[str, Any]] = ()
) -> Array:
    """(n, 3): random points in the box, none too close to another or to a block."""
    scale, radius = Separation().scale, Separation().radius
    prisms = [Prism(block["polygon"], block["lower"], block["upper"]) for block in blocks]
    points = np.empty((0, 3))
    while len(points) < n:
        point = rng.uniform(*box)
        far = np.all(np.linalg.norm((points - point) * scale, axis=1) > RANDOM_SPACING)
        if far and all(prism.clearance(point).distance > 1.05 * radius for prism in prisms):
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
