"""Checks before planning: starts and goals that break a limit themselves."""

from __future__ import annotations

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
    ends = (
        (task.start, "at the start (t = 0)", "start"),
        (task.goal, "at the goals (the plan's end)", "goal"),
    )
    checks = (_too_close, _outside, _within, _parted)
    found = [violation for end in ends for check in checks for violation in check(task, *end)]
    if found:
        raise InfeasibleError(found)


def _too_close(task: SeparationTask, points: Array, when: str, end: str) -> list[Violation]:
    scaled = points * task.requirements.separation.scale
    least = within(1.0, "min", float(np.max(np.abs(scaled))), HALF)
    pairs = cKDTree(scaled).query_pairs(least, output_type="ndarray")
    ratio = np.linalg.norm(scaled[pairs[:, 0]] - scaled[pairs[:, 1]], axis=1)
    found = []
    for k in np.argsort(ratio)[:MOST]:
        i, j = sorted(pairs[k])
        apart = float(np.linalg.norm(points[i] - points[j]))
        remedy = f"they are {apart:.3g} m apart: move one {end} away from the other"
        names = (task.names[i], task.names[j])
        value = float(ratio[k])
        found.append(Violation("separation", value, 1.0, "min", "ratio", names, when, remedy))
    return found


def _outside(task: SeparationTask, points: Array, when: str, end: str) -> list[Violation]:
    if task.requirements.arena is None:
        return []
    lower, upper = task.requirements.arena.lower, task.requirements.arena.upper
    room = np.minimum(points - lower, upper - points).min(axis=1)
    least = within(0.0, "min", float(np.max(np.abs(points))), HALF)
    remedy = f"move the {end} inside, or the wall out"
    return [
        Violation("arena", float(room[i]), 0.0, "min", "m", (task.names[i],), when, remedy)
        for i in np.argsort(room)[:MOST]
        if room[i] < least
    ]


def _within(task: SeparationTask, points: Array, when: str, end: str) -> list[Violation]:
    limit = task.requirements.separation.radius
    least = within(limit, "min", float(np.max(np.abs(points))), HALF)
    remedy = f"move the {end} away from the prism"
    found = []
    for k, prism in enumerate(task.requirements.keep_out):
        distance = np.maximum(prism.clearance(points).distance, 0.0)
        for i in np.argsort(distance)[:MOST]:
            if distance[i] < least:
                where = (task.names[i], f"prism {k}")
                value = float(distance[i])
                found.append(Violation("keep_out", value, limit, "min", "m", where, when, remedy))
    return found


def _parted(task: SeparationTask, points: Array, when: str, end: str) -> list[Violation]:
    first, second, longest = task.tether_arrays
    ratios = np.linalg.norm(points[first] - points[second], axis=1) / longest
    sizes = np.max(np.abs(points)) / longest
    remedy = f"move the {end}s together, or take a longer cable"
    found = []
    for i, j, ratio, size in zip(first, second, ratios.tolist(), sizes.tolist(), strict=True):
        if ratio > within(1.0, "max", size, HALF):
            names = (task.names[i], task.names[j])
            found.append(Violation("span", ratio, 1.0, "max", "ratio", names, when, remedy))
    return found
