"""Evaluation of ends and curves: requirements they break, the shortest time within limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.checks import Check, arena, keep_out, separation
from hitchopt.checks.bounds.rates import largest_rate, norm_bound
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.certificate import within
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.planners.separation.setting import Setting
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.planners.timing.demands import LIMIT_SHARE
from hitchopt.planners.timing.turning_stretch import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.extremum import Cells, largest
from hitchopt.values import Array

STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration: a reserve for the rounding and refitting of exports."""

IDLE = 0.01
"""[s] Duration where no drone moves."""

REMEDY = "give more time or room, or move the drones concerned apart"

HALF = 0.5
"""Share of the checks' tolerance that is used here; certificates need the rest for rounding."""

MOST = 10
"""Maximum number of violations of one kind that are reported."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Bounds on curves that hold at every time.

    Attributes
    ----------
    coefficients: (N, count, 3) [m].
    duration: the shortest in which they keep speed, acceleration, jerk and body rate [s].
    closest: lower bound of the smallest separation of any pair.
    broken: violations that no duration removes; times are for ``duration``.
    """

    coefficients: Array
    duration: float
    closest: float
    broken: tuple[Violation, ...]

    @property
    def clear(self) -> bool:
        """Whether the curves, in their duration or a longer one, break nothing."""
        return not self.broken


def evaluate(setting: Setting, coefficients: Array) -> Evaluation:
    """Return the evaluation of curves, by the certificate's bounds that hold at every time."""
    task = setting.task
    duration = needed_duration(setting, setting.grid.curves(coefficients, 1.0))
    curves = setting.grid.curves(coefficients, duration)
    swarm = Swarm(task.drones)
    motion = Motion.single(swarm, task.requirements, curves, ())
    apart, *others = (rule.check(motion) for rule in (separation.RULE, arena.RULE, keep_out.RULE))
    names = dict(zip(swarm.drone_names, task.names, strict=True))
    broken = [
        replace(check, where=tuple(names.get(name, name) for name in check.where)).violation(
            f"at t = {check.time:.4g} s of {duration:.4g} s", REMEDY
        )
        for check in (apart, *others, _span(setting, curves, swarm))
        if check is not None and not check.holds
    ]
    closest = np.inf if apart is None else apart.bound
    return Evaluation(coefficients, duration, closest, tuple(broken))


def needed_duration(setting: Setting, unit: PiecewisePolynomial) -> float:
    """Return the shortest duration in which curves, given over 1 s, keep all limits [s]."""
    factors = []
    for order, cap in enumerate(setting.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    duration = max(*factors, IDLE) * STRETCH
    limits = setting.task.requirements.limits
    return turning_stretch(Swarm(setting.task.drones), limits.body_rate, (unit,), duration)


def _span(setting: Setting, curves: PiecewisePolynomial, swarm: Swarm) -> Check | None:
    """Return the check of the tethers' lengths; None without tethers."""
    if not setting.task.tethers:
        return None
    first, second, longest = setting.task.tether_arrays
    x = curves.coefficients
    offsets = (x[:, first] - x[:, second]) / longest[:, None, None]
    size = float(np.max(np.abs(x))) / float(np.min(longest))
    cells = Cells.over(curves.breaks, [offsets], ROUNDING * size)
    found = largest(cells, norm_bound, within(1.0, "max", size, 0.5))
    pair = tuple(swarm.drone_names[ends[found.item]] for ends in (first, second))
    return Check.of("span", found.worst, 1.0, "max", "ratio", found.time, pair, size)


def check_ends(task: SeparationTask) -> None:
    """Raise InfeasibleError where starts or goals are too close, outside or within a prism."""
    found: list[Violation] = []
    for points, when, end in (
        (task.start, "at the start (t = 0)", "start"),
        (task.goal, "at the goals (the plan's end)", "goal"),
    ):
        for violations in (_too_close, _outside, _within, _parted):
            found += violations(task, points, when, end)
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
    remedy = f"move the {end} away from it"
    for k, prism in enumerate(task.requirements.keep_out):
        distances = np.maximum(prism.clearance(points).distance, 0.0)
        for i, distance in _worst(distances, limit, "min", float(np.max(np.abs(points)))):
            where = (task.names[i], task.prisms[k])
            yield Violation("keep_out", distance, limit, "min", "m", where, when, remedy)


def _parted(task: SeparationTask, points: Array, when: str, end: str) -> Iterator[Violation]:
    first, second, longest = task.tether_arrays
    ratios = np.linalg.norm(points[first] - points[second], axis=1) / longest
    size = float(np.max(np.abs(points)) / np.min(longest, initial=np.inf))
    remedy = f"move the {end}s together, or take a longer cable"
    for k, ratio in _worst(ratios, 1.0, "max", size):
        names = (task.names[first[k]], task.names[second[k]])
        yield Violation("span", ratio, 1.0, "max", "ratio", names, when, remedy)
