"""Checks before planning: starts and goals that break a limit themselves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.checks.certificate import within
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.values import Array

HALF = 0.5
"""Share of the checks' tolerance that is used here; certificates need the rest for rounding."""

MOST = 10
"""Maximum number of violations of one kind that are reported."""


def check_ends(task: SeparationTask) -> None:
    """Raise InfeasibleError where starts or goals are too close, outside or within a prism."""
    found: list[Violation] = []
    for points, when, end in (
        (task.start, "at the start (t = 0)", "start"),
        (task.goal, "at the goals (the plan's end)", "goal"),
    ):
        found += _too_close(task, points, when, end)
        found += _outside(task, points, when, end)
        found += _within(task, points, when, end)
        found += _parted(task, points, when, end)
    if found:
        raise InfeasibleError(found)


def _worst(values: Array, limit: float, sense: str, size: float) -> list[tuple[int, float]]:
    """Return the index of each value that is beyond its limit and the value, MOST at most."""
    sign = 1.0 if sense == "min" else -1.0
    least = sign * within(limit, sense, size, HALF)
    order = np.argsort(sign * values)[:MOST].tolist()
    return [(i, float(values[i])) for i in order if sign * values[i] < least]


def _too_close(task: SeparationTask, points: Array, when: str, end: str) -> Iterator[Violation]:
    scaled = points * task.requirements.separation.scale
    pairs = np.sort(cKDTree(scaled).query_pairs(1.0, output_type="ndarray"), axis=1)
    ratios = np.linalg.norm(scaled[pairs[:, 0]] - scaled[pairs[:, 1]], axis=1)
    for k, ratio in _worst(ratios, 1.0, "min", float(np.max(np.abs(scaled)))):
        i, j = pairs[k]
        apart = np.linalg.norm(points[i] - points[j])
        remedy = f"they are {apart:.3g} m apart: move one {end} away from the other"
        names = (task.names[i], task.names[j])
        yield Violation("separation", ratio, 1.0, "min", "ratio", names, when, remedy)


def _outside(task: SeparationTask, points: Array, when: str, end: str) -> Iterator[Violation]:
    arena = task.requirements.arena
    if arena is not None:
        inside = np.minimum(points - arena.lower, arena.upper - points).min(axis=1)
        remedy = f"move the {end} inside, or the wall out"
        for i, distance in _worst(inside, 0.0, "min", float(np.max(np.abs(points)))):
            yield Violation("arena", distance, 0.0, "min", "m", (task.names[i],), when, remedy)


def _within(task: SeparationTask, points: Array, when: str, end: str) -> Iterator[Violation]:
    limit = task.requirements.separation.radius
    remedy = f"move the {end} away from the prism"
    for k, prism in enumerate(task.requirements.keep_out):
        distances = np.maximum(prism.clearance(points).distance, 0.0)
        for i, distance in _worst(distances, limit, "min", float(np.max(np.abs(points)))):
            where = (task.names[i], f"prism {k}")
            yield Violation("keep_out", distance, limit, "min", "m", where, when, remedy)


def _parted(task: SeparationTask, points: Array, when: str, end: str) -> Iterator[Violation]:
    first, second, longest = task.tether_arrays
    ratios = np.linalg.norm(points[first] - points[second], axis=1) / longest
    size = float(np.max(np.abs(points)) / np.min(longest, initial=np.inf))
    remedy = f"move the {end}s together, or take a longer cable"
    for k, ratio in _worst(ratios, 1.0, "max", size):
        names = (task.names[first[k]], task.names[second[k]])
        yield Violation("span", ratio, 1.0, "max", "ratio", names, when, remedy)
