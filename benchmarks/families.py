"""Wild families: success rates, proofs and processor time on problems drawn at random."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

import hitchopt as ho
from benchmarks.measuring import Array
from problems.random_morph import WILD_EDGE, WILD_SLACK, wild_polygon

FORM_DENSITY = 0.005
"""Density of cables that hang before they are tied [kg/m]."""

FORM_ALTITUDE = (1.2, 1.8)
"""Altitude of formed hitches, least and most [m]."""

SPAN = (0.35, 0.85)
"""Distance of the drones of a hanging cable over its length, least and most."""

HOVER = (1.0, 2.0)
"""Heights of hovering pairs, least and most [m]; the two drones differ by up to HOVER_STEP."""

HOVER_STEP = 0.15

MIN_REACH, GROWTH = 0.8, 1.01
"""Half the width of the square that robots start in, over the root of their number [m], and the
factor by which it grows until they fit in."""

ROBOTS_APART, DRONES_APART = 0.9, 0.35
"""Smallest distances of the middles of robots and of drones at the start, in plan view [m]."""


def wild_form(n: int, seed: int) -> dict[str, Any]:
    """Return a problem that ties an irregular n-gon from robots scattered about it.

    Half of the teams have equal cables, half stand on the ground, and a third take the edges in
    their order. Starts and goals are drawn until both are certified at rest.
    """
    rng = np.random.default_rng([n, seed, 1])
    edge, on_ground = rng.uniform(*WILD_EDGE), bool(rng.random() < 0.5)
    equal, fixed = bool(rng.random() < 0.5), bool(rng.random() < 1.0 / 3.0)
    slack = rng.uniform(*WILD_SLACK)
    altitude = round(float(rng.uniform(*FORM_ALTITUDE)), 2)
    for _ in range(10000):
        polygon = wild_polygon(n, edge, rng).translated(rng.uniform(-0.5, 0.5, 2))
        lengths = polygon.edge_lengths
        cables = np.full(n, np.max(lengths) + slack)
        if not equal:
            cables = lengths + rng.uniform(WILD_SLACK[0], max(slack, 0.8), n)
        cables = np.round(cables, 2)
        corners = np.round(polygon.vertices, 3)
        team: dict[str, Any] = {"robots": n, "cable_density": FORM_DENSITY}
        team["cable_length"] = float(cables[0]) if equal else cables.tolist()
        hitch = {"polygon": corners.tolist(), "altitude": altitude, "legs": "spread"}
        if not _holds(team, {"hitch": hitch}):
            continue
        start = None
        for _attempt in range(20):
            order = np.arange(n) if fixed or equal else rng.permutation(n)
            start = _scattered(cables[order], on_ground, rng)
            if _holds({**team, "cable_length": cables[order].tolist()}, {"drones": start}):
                break
            start = None
        if start is None:
            continue
        if not equal:
            team["cable_length"] = cables[order].tolist()
        break
    else:
        raise RuntimeError("nothing")
    form = {"polygon": corners.tolist(), "altitude": altitude}
    if fixed:
        form["assign"] = "fixed"
    return {
        "title": f"Wild form, n = {n}, seed {seed}",
        "team": team,
        "start": {"drones": start},
        "mission": [{"form": form}],
    }


def _scattered(cables: Array, on_ground: bool, rng: np.random.Generator) -> dict[str, Any]:
    n, reach = len(cables), MIN_REACH * math.sqrt(len(cables))
    while True:
        middles = rng.uniform(-reach, reach, (n, 2))
        angles = rng.uniform(-math.pi, math.pi, n)
        arms = 0.5 * (rng.uniform(*SPAN, n) * cables)[:, None]
        arms = arms * np.column_stack([np.cos(angles), np.sin(angles)])
        flat = np.stack([middles - arms, middles + arms], axis=1)
        if _closest(middles) > ROBOTS_APART and _closest(flat.reshape(-1, 2)) > DRONES_APART:
            break
        reach *= GROWTH
    heights = np.zeros((n, 2))
    if not on_ground:
        heights = rng.uniform(*HOVER, n)[:, None] + rng.uniform(-HOVER_STEP, HOVER_STEP, (n, 2))
    drones = np.round(np.concatenate([flat, heights[..., None]], axis=-1), 3)
    return {"q": drones[:, 0].tolist(), "r": drones[:, 1].tolist()}


def _closest(points: Array) -> float:
    """Return the smallest distance [m] of points (k, 2)."""
    return float(np.min(pdist(points)))


def _holds(team: dict[str, Any], start: dict[str, Any]) -> bool:
    problem = {"team": team, "start": start, "mission": [{"hold": {"seconds": 1.0}}]}
    try:
        ho.solve(ho.problem_from_dict(problem))
    except ho.InfeasibleError:
        return False
    return True
