"""Random problems beyond single morphs: a vertex writes, with times or without, and steps blend.

Usage: python -m problems.random_steps curves|timed|blends|timed_blends SEED > problem.yaml
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from scipy.interpolate import CubicSpline

import hitchopt as ho
from hitchopt.errors import HitchoptError
from hitchopt.geometry import ConvexPolygon
from hitchopt.values import Array
from problems.random_morph import WILD_EDGE, WILD_SLACK, is_certified, wild_polygon

ROBOTS = range(3, 9)
"""Numbers of robots of hitches, in turn."""

ALTITUDE = 1.5
"""Altitude of hitches [m]."""

STROKES = {
    "S": [[1.0, 1.8], [0.5, 2.0], [0.0, 1.6], [0.5, 1.0], [1.0, 0.5], [0.5, 0.0], [0.0, 0.2]],
    "U": [[0.0, 2.0], [0.0, 0.6], [0.5, 0.0], [1.0, 0.6], [1.0, 2.0]],
    "C": [[1.0, 1.7], [0.5, 2.0], [0.0, 1.0], [0.5, 0.0], [1.0, 0.3]],
    "3": [[0.0, 1.8], [0.8, 1.8], [0.4, 1.1], [1.0, 0.5], [0.0, 0.1]],
    "8": [[0.5, 1.0], [1.0, 1.5], [0.5, 2.0], [0.0, 1.5], [1.0, 0.5], [0.5, 0.0], [0.0, 0.5]],
    "e": [[0.0, 1.0], [1.0, 1.1], [0.5, 1.7], [0.0, 1.0], [0.5, 0.1], [1.0, 0.4]],
}
"""Points of letters and digits, which are written from the first to the last, of width 1."""

HARMONICS = 3
"""Number of harmonics of a closed curve."""

CURVE_POINTS = 24
"""Number of points of a curve after its start."""

CURVE_SIZE = (0.15, 0.6)
"""Larger width of a curve, minimum and maximum [m]."""

CURVE_SPEED = 0.3
"""Speed of a vertex on a curve without times [m/s]."""

CURVE_TRIES = 20
"""Number of curves that are drawn for a hitch before another hitch is drawn."""

NEAR = 2e-3
"""Distance of a written curve from its points at samples, at most [m]."""

SKIPPED_SEEDS = 1000 * len(ROBOTS)
"""Number added to a seed whose problem is skipped."""

TIME_FACTOR = 1.3
"""Times of points over those at which the flight without times passes them."""


def random_curve(seed: int) -> dict[str, Any]:
    """Return a problem in which a vertex of an irregular hitch writes a letter or a closed curve.

    Hitches at all points are certified at rest with spread legs.
    """
    n = ROBOTS[seed % len(ROBOTS)]
    rng = np.random.default_rng([n, seed, 8])
    while True:
        hitch, team = _random_hitch(n, rng)
        for _ in range(CURVE_TRIES):
            vertex = int(rng.integers(n))
            name, curve = _curve(rng)
            curve = np.round(curve - curve[0] + hitch["polygon"][vertex], 3)[1:]
            outlines = [_moved(hitch, vertex, point) for point in curve.tolist()]
            if None not in outlines and all(
                is_certified(team, {"hitch": {**hitch, "polygon": each}}) for each in outlines
            ):
                step = {"vertex": vertex, "path": curve.tolist(), "speed": CURVE_SPEED}
                return {
                    "title": f"Vertex {vertex} writes {name}, n = {n}, seed {seed}",
                    "team": team,
                    "start": {"hitch": hitch},
                    "mission": [{"follow_vertex": step}],
                }


def random_timed_curve(seed: int) -> dict[str, Any]:
    """Return a curve whose points have the times of its flight without times, stretched.

    Seeds whose flight stops on the way, or that are not planned, are skipped.
    """
    while True:
        problem = random_curve(seed)
        seed += SKIPPED_SEEDS
        step = problem["mission"][0]["follow_vertex"]
        try:
            motion = ho.solve(ho.problem_from_dict(problem)).motion
        except HitchoptError:
            continue
        if len(motion.phases) > 1:
            continue
        t = np.linspace(0.0, motion.duration, 4001)
        times = _times_at(motion.vertices.at(t)[:, step["vertex"], :2], step["path"], t)
        times[-1] = motion.duration
        stretched = np.round(TIME_FACTOR * np.array(times), 3).tolist()
        step["path"] = [[time, *point] for time, point in zip(stretched, step["path"], strict=True)]
        del step["speed"]
        return problem


def _times_at(written: Array, points: list[list[float]], t: Array) -> list[float]:
    """Return when a written curve (J, 2) [m] at times t (J,) [s] is at each of its points."""
    times = list[float]()
    first = 0
    for point in points:
        distances = np.linalg.norm(written[first:] - point, axis=1)
        is_nearest = (distances[:-1] < NEAR) & (distances[1:] >= distances[:-1])
        first += int(np.argmax(is_nearest))
        times.append(float(t[first]))
        first += 1
    return times


BLENDED_STEPS = (2, 4)
"""Number of steps in a row without a stop, minimum and maximum."""

MAX_MOVE = 0.35
"""Largest displacement of a vertex along either axis [m]."""


TIMED_SHARE = 0.4
"""Share of steps with a duration."""

STANDING = 0.02
"""Duration below which a step moves nothing [s]."""

BLENDED_SHARE = 0.75
"""Share of steps that blend."""

SLOWDOWN = (1.0, 3.0)
"""Durations over those of steps without one, minimum and maximum."""


def random_blend(seed: int) -> dict[str, Any]:
    """Return a problem whose steps blend, and are certified with stops in between."""
    n = ROBOTS[seed % len(ROBOTS)]
    rng = np.random.default_rng([n, seed, 9])
    while True:
        hitch, team = _random_hitch(n, rng, heavy=bool(rng.random() < 0.25))
        mission = list[dict[str, Any]]()
        now = hitch
        for _ in range(int(rng.integers(*BLENDED_STEPS, endpoint=True))):
            after, step = _random_step(n, now, rng)
            if after is None or not is_certified(team, {"hitch": after}):
                break
            mission.append(step)
            now = after
        else:
            problem = {
                "title": f"Blended steps, n = {n}, seed {seed}",
                "team": team,
                "start": {"hitch": hitch},
                "mission": mission,
            }
            try:
                ho.solve(ho.problem_from_dict(problem))
            except HitchoptError:
                continue
            blended = [
                {name: {**step, "blend": True} for name, step in item.items()}
                for item in mission[:-1]
            ]
            return {**problem, "mission": [*blended, mission[-1]]}


def random_timed_blend(seed: int) -> dict[str, Any]:
    """Return a problem of which some steps blend and some have durations, certified with stops."""
    n = ROBOTS[seed % len(ROBOTS)]
    rng = np.random.default_rng([n, seed, 10])
    while True:
        hitch, team = _random_hitch(n, rng)
        steps = [_random_kind(n, hitch, rng) for _ in range(rng.integers(*BLENDED_STEPS) + 1)]
        problem = {
            "title": f"Timed blends, n = {n}, seed {seed}",
            "team": team,
            "start": {"hitch": hitch},
            "mission": [{name: keys} for name, keys in steps],
        }
        try:
            phases = ho.solve(ho.problem_from_dict(problem)).motion.phases
        except HitchoptError:
            continue
        for index, (_, keys) in enumerate(steps):
            flown = sum(phase.end - phase.start for phase in phases if phase.step == index)
            if flown < STANDING:
                break
            if rng.random() < TIMED_SHARE:
                keys["duration"] = round(flown * rng.uniform(*SLOWDOWN) + 0.005, 2)
            if index < len(steps) - 1 and rng.random() < BLENDED_SHARE:
                keys["blend"] = True
        else:
            return problem


def _random_kind(
    n: int, hitch: dict[str, Any], rng: np.random.Generator
) -> tuple[str, dict[str, Any]]:
    """Return the name of a random step of any kind that blends, and its keys."""
    corners = np.array(hitch["polygon"])
    item = int(rng.integers(n))
    by = np.round(rng.uniform(-MAX_MOVE, MAX_MOVE, 2), 3).tolist()
    goal = wild_polygon(n, np.mean(np.ptp(corners, axis=0)) * rng.uniform(0.3, 0.6), rng)
    to = [*np.round(rng.uniform(-1.0, 1.0, 2), 3).tolist(), ALTITUDE]
    kinds: dict[str, dict[str, Any]] = {
        "morph": {"polygon": np.round(goal.vertices, 3).tolist()},
        "move_vertex": {"vertex": item, "by": by},
        "move_edge": {"edge": item, "by": by},
        "adjust": {"legs": str(rng.choice(["balanced", "spread"]))},
        "transport": {"to": to, "yaw_deg": round(float(rng.uniform(-90.0, 90.0)), 1)},
    }
    name = str(rng.choice(list(kinds)))
    return name, kinds[name]


def _random_hitch(
    n: int, rng: np.random.Generator, *, heavy: bool = False
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return an irregular hitch that is certified at rest, and its team."""
    while True:
        polygon = wild_polygon(n, rng.uniform(*WILD_EDGE), rng)
        cable = float(np.max(polygon.edge_lengths) + rng.uniform(*WILD_SLACK))
        team: dict[str, Any] = {"robots": n, "cable_length": round(cable, 2)}
        team |= {"cable_friction": 0.1} if heavy else {}
        corners = np.round(polygon.vertices, 3).tolist()
        hitch = {"polygon": corners, "altitude": ALTITUDE, "legs": "spread"}
        if _is_convex(corners) and is_certified(team, {"hitch": hitch}):
            return hitch, team


def _random_step(
    n: int, hitch: dict[str, Any], rng: np.random.Generator
) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Return the hitch after a random step, None if it is not convex, and the step."""
    corners = np.array(hitch["polygon"])
    if rng.random() < 0.5:
        vertex = int(rng.integers(n))
        by = np.round(rng.uniform(-MAX_MOVE, MAX_MOVE, 2), 3)
        return _after(hitch, vertex, corners[vertex] + by), {
            "move_vertex": {"vertex": vertex, "by": by.tolist()}
        }
    edge = float(np.mean(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)))
    goal = wild_polygon(n, edge * float(rng.uniform(0.7, 1.2)), rng)
    goal = goal.translated(np.mean(corners, axis=0) + rng.uniform(-0.5, 0.5, 2))
    points = np.round(goal.vertices, 3).tolist()
    after = {**hitch, "polygon": points} if _is_convex(points) else None
    return after, {"morph": {"polygon": points}}


def _after(hitch: dict[str, Any], vertex: int, point: Array) -> dict[str, Any] | None:
    """Return the hitch with a vertex at a point (2,) [m]; None if it is not convex."""
    corners = _moved(hitch, vertex, np.round(point, 3).tolist())
    return None if corners is None else {**hitch, "polygon": corners}


def _moved(hitch: dict[str, Any], vertex: int, point: list[float]) -> list[list[float]] | None:
    """Return the polygon with a vertex at a point [m]; None if it is not convex."""
    corners = [*hitch["polygon"]]
    corners[vertex] = point
    return corners if _is_convex(corners) else None


def _is_convex(corners: list[list[float]]) -> bool:
    """Return whether corners are those of a convex polygon."""
    try:
        ConvexPolygon(corners)
    except HitchoptError:
        return False
    return True


def _curve(rng: np.random.Generator) -> tuple[str, Array]:
    """Return the name of a letter or a closed curve, and its points, evenly spaced (J, 2) [m]."""
    s = np.linspace(0.0, 1.0, 401)
    name = str(rng.choice([*STROKES, "a curve", "a curve"]))
    if name in STROKES:
        stroke = np.array(STROKES[name])
        lengths = np.linalg.norm(np.diff(stroke, axis=0), axis=1)
        knots = np.append(0.0, np.cumsum(lengths)) / np.sum(lengths)
        points = CubicSpline(knots, stroke)(s)
    else:
        order = np.arange(1, HARMONICS + 1)
        factors = rng.normal(size=(HARMONICS, 2, 2)) / order[:, None, None] ** 1.5
        phase = 2.0 * math.pi * np.outer(s, order)
        waves = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        points = np.einsum("skw,kwd->sd", waves, factors)
    covered = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    even = np.linspace(0.0, covered[-1], CURVE_POINTS + 1)
    points = np.column_stack([np.interp(even, covered, axis) for axis in points.T])
    angle = rng.uniform(0.0, 2.0 * math.pi)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return name, rng.uniform(*CURVE_SIZE) / np.max(np.ptp(points, axis=0)) * points @ turn.T


FAMILIES = {
    "curves": random_curve,
    "timed": random_timed_curve,
    "blends": random_blend,
    "timed_blends": random_timed_blend,
}

if __name__ == "__main__":
    yaml = YAML()  # keeps the keys in their order
    yaml.default_flow_style = None
    yaml.dump(FAMILIES[sys.argv[1]](int(sys.argv[2])), sys.stdout)
