"""Evaluation of curves of single drones by the certificate's bounds, in their shortest duration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks import Check
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import distances_of
from hitchopt.checks.spans import ROUNDING
from hitchopt.errors import Violation
from hitchopt.hitch import Swarm
from hitchopt.hitch.pairs import FIXED
from hitchopt.motion.motion import Motion
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.planners.timing.stretch import further_stretch
from hitchopt.swarms.task import SeparationTask, Setting
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.search import rough_bounds
from hitchopt.values import Array

UNCLEAR_MERIT = 1e9  # Merit of curves that violate a limit at any speed, per missing separation

STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration, a reserve for rounding and refitting in exports."""

MIN_DURATION = 0.01  # [s] Smallest duration, as of flights in which no drone moves

REMEDY = "allow more time or space, or move these drones apart"
"""Suggested change for curves that violate a limit."""


@dataclass(frozen=True, eq=False)
class CurveBounds:
    """Continuous-time bounds of curves.

    Attributes
    ----------
    coefficients: (N, count, 3) [m].
    duration: shortest duration [s] within the limits of speed, acceleration, jerk and body rate.
    closest: lower bound of the minimum separation of any pair.
    violations: those of any duration; their times refer to ``duration``.
    """

    coefficients: Array
    duration: float
    closest: float
    violations: tuple[Violation, ...]

    @property
    def clear(self) -> bool:
        """Return whether the curves satisfy all requirements in their duration or a longer one."""
        return not self.violations

    @property
    def to_prisms(self) -> float:
        """Smallest distance of drones to prisms, over its limit; at most 1."""
        short = (each for each in self.violations if each.constraint == "keep_out")
        return min((each.value / each.limit for each in short), default=1.0)

    @property
    def nearest(self) -> float:
        """Smallest distance of drones to each other and to prisms, over its limit; at most 1."""
        return min(1.0, self.closest, self.to_prisms)

    @property
    def merit(self) -> float:
        """Value to be minimised; curves with violations come last."""
        return self.duration if self.clear else UNCLEAR_MERIT * (2.0 - self.nearest)


def evaluate(setting: Setting, coefficients: Array) -> CurveBounds:
    """Return the evaluation of curves by the certificate's continuous-time bounds."""
    timed, checks = timed_in_shortest(setting, setting.grid.curves(coefficients, 1.0))
    duration = timed.duration
    violations = (
        check.violation(f"at t = {check.time:.4g} s of {duration:.4g} s", REMEDY)
        for check in checks
        if not check.holds
    )
    return CurveBounds(coefficients, duration, closest_of(checks), tuple(violations))


def closest_of(checks: Sequence[Check]) -> float:
    """Return the smallest separation of any two drones; infinite for one drone."""
    return next((check.worst for check in checks if check.name == "separation"), math.inf)


def timed_in_shortest(
    setting: Setting, curves: PiecewisePolynomial
) -> tuple[PiecewisePolynomial, list[Check]]:
    """Return curves in their shortest duration, and their checks by rough bounds."""
    in_a_second = curves.stretched(1.0 / curves.duration)
    durations = [MIN_DURATION]
    for order, cap in enumerate(setting.caps, start=1):
        over_cap = in_a_second.replaced(in_a_second.coefficients / cap[:, None, None])
        largest = max(largest_rate(over_cap, order).worst, 0.0)
        durations.append(float(np.power(largest, 1.0 / order)))
    motion = _swarm_motion(setting.task, in_a_second)
    timed = in_a_second.stretched(further_stretch(motion, STRETCH * max(durations)))
    with rough_bounds():
        return timed, checks_of(setting.task, timed)


CHECKED_RULES = distances_of("drones", *FIXED)
"""The certificate's rules that do not depend on the duration."""


def _swarm_motion(task: SeparationTask, curves: PiecewisePolynomial) -> Motion:
    """Return curves as the motion of a swarm."""
    return Motion.single(Swarm(task.drones), task.requirements, curves, ())


def checks_of(task: SeparationTask, curves: PiecewisePolynomial) -> list[Check]:
    """Return the checks of CHECKED_RULES and of tethers, with the task's names."""
    motion = _swarm_motion(task, curves)
    checks = [rule.check(motion) for rule in CHECKED_RULES]
    if task.tethers:
        checks.append(_tether_check(task, curves))
    return [_with_names(check, task, curves) for check in checks if check is not None]


def _tether_check(task: SeparationTask, curves: PiecewisePolynomial) -> Check:
    """Return the check of the largest distance of tethered drones, over its limit."""
    first, second, longest = task.tether_arrays
    positions = curves.coefficients
    offsets = (positions[:, first] - positions[:, second]) / longest[:, None, None]
    coordinate_ratio = float(np.max(np.abs(positions))) / float(np.min(longest))
    span = largest_rate(PiecewisePolynomial(curves.breaks, offsets), 0, 1.0)
    names = Swarm(task.drones).drone_names
    return Check.of(
        "span",
        worst=span.worst + ROUNDING * coordinate_ratio,
        limit=1.0,
        sense="max",
        unit="ratio",
        time=span.time,
        where=(names[first[span.item]], names[second[span.item]]),
        size=coordinate_ratio,
    )


def _with_names(check: Check, task: SeparationTask, curves: PiecewisePolynomial) -> Check:
    """Return the check with the task's names of drones and the nearest prism."""
    swarm_names = Swarm(task.drones).drone_names
    task_names = dict(zip(swarm_names, task.names, strict=True))
    where = [task_names.get(name, name) for name in check.where]
    if check.name == "keep_out" and len(where) == 1:
        drone = swarm_names.index(check.where[0])
        point = curves.at([check.time])[0, drone : drone + 1]
        prisms = task.requirements.keep_out
        distances = [float(prism.clearance(point).distance[0]) for prism in prisms]
        where.append(task.prisms[int(np.argmin(distances))])
    return replace(check, where=tuple(where))
