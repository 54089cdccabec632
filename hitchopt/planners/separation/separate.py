"""The separation planner: initial guesses, convex programs, and bounds that end the search."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import Check
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.spans import ROUNDING
from hitchopt.errors import InfeasibleError, Progress, Violation
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.planners.separation.guesses import pushed_apart, roundabout, scheduled, setting_of
from hitchopt.planners.separation.prioritized import prioritized
from hitchopt.planners.separation.program import (
    PLANE_MARGIN,
    Planes,
    ProgramError,
    moved_curves,
    planes_between,
    planes_to_prism,
)
from hitchopt.planners.separation.task import SeparationResult, SeparationTask, Setting
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.planners.timing.timed_motion import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

SIDE = 0.5
"""Strength of the pushes with which all drones give way to one side, in separations."""

MAX_PROGRAMS = 16
"""Maximum number of programs from one guess."""

SPEEDUP = 0.85
"""Target duration of the next program over the current one, while the curves are clear."""

MIN_DURATION_RATIO = 1.03
"""Smallest target duration over that of single flights; splines cannot be faster."""

GOOD_RATIO = 1.05
"""Duration over that of single flights at which the search ends."""

FAIR_RATIO = 1.15
"""Duration over that of single flights at which the search ends after MAX_IDLE_ROUNDS_FAIR."""

MIN_GAIN = 0.02
"""Smallest relative improvement."""

DAMPING = 1e-4
"""Weight of squared changes in a program, as in Levenberg and Marquardt's method."""

DAMPING_FACTOR = 10.0
"""Increase of that weight after every round without improvement."""

MAX_IDLE_ROUNDS_FAIR = 2
"""Maximum number of consecutive rounds without improvement of fair curves."""

MAX_IDLE_ROUNDS = 3
"""Maximum number of consecutive rounds without improvement of clear curves."""

MAX_IDLE_ROUNDS_UNCLEAR = 6
"""Maximum number of consecutive rounds without improvement of other curves."""

UNCLEAR_MERIT = 1e9
"""Merit of curves that violate a limit at any speed, per missing separation."""

PLANE_RANGE = 1.0
"""Separation [1] in excess of the limit up to which pairs of pieces have a plane."""

CROWD_PLANE_RANGE = 0.5
"""The same in crowds."""

LARGE_CROWD = 256
"""Number of drones above which a program moves only those that are too close, and the search ends
with the first clear curves: programs that couple all drones would need too much time."""

CLOSE_RANGE = 0.1
"""Separation [1] in excess of the limit below which such drones are too close."""


@dataclass(frozen=True, eq=False)
class SeparatedCurves:
    """A planner of curves of all drones that satisfy a task at every time."""

    task: SeparationTask

    @cached_property
    def problem(self) -> Setting:
        """The task on a time grid, with nominal curves."""
        return setting_of(self.task)

    def solve(self, progress: Progress | None = None) -> SeparationResult:
        """Return the curves.

        Parameters
        ----------
        progress: called with a description of the current stage.

        Raises
        ------
        InfeasibleError: the task is infeasible, or the search found no curves; the violations name
            the pair and the time.
        """
        report, task = progress or (lambda _: None), self.task
        _check_ends(task)
        setting = self.problem
        if task.duration is not None and task.duration < setting.bound:
            raise InfeasibleError([_too_short(task, setting.bound, "no drone can be as fast")])
        evaluations: list[CurveBounds] = []
        for own, guess, remark in _guesses(setting):
            report(f"guess: {remark or 'straight'}")
            evaluation = _improved(own, guess, report)
            if evaluation.clear and evaluation.duration <= (task.duration or math.inf):
                duration = task.duration or evaluation.duration
                curves = own.grid.curves(evaluation.coefficients, duration)
                return SeparationResult(curves, evaluation.closest, setting.bound, remark)
            evaluations.append(evaluation)
        return _last_resort(task, evaluations, report)


def _guesses(setting: Setting) -> Iterator[tuple[Setting, Array, str]]:
    """Yield settings with guesses (N, count, 3) [m] and their rules."""
    if evaluate(setting, setting.nominal).clear:  # no two drones meet
        yield setting, setting.nominal, ""
    circular = roundabout(setting)
    if circular is not None:
        yield setting, circular, "all go around where they meet, to the right"
    yield setting, pushed_apart(setting, SIDE), "all give way to the right where they meet"
    for schedule in () if setting.task.tethers else prioritized(setting.task):
        own = scheduled(setting.task, schedule)
        yield own, own.nominal, "some wait for others to pass"
    yield setting, pushed_apart(setting, -SIDE), "all give way to the left where they meet"


def _improved(setting: Setting, guess: Array, report: Progress) -> CurveBounds:
    """Return the best curves that programs reach from a guess."""
    task, idle = setting.task, 0
    current = best = evaluate(setting, guess)
    sides = np.zeros((0, 3), dtype=np.intp)
    for iteration in range(MAX_PROGRAMS):
        if best.clear and task.drones >= LARGE_CROWD:
            break
        planes, moving = _planes(setting, current, sides)
        sides = planes.sides[planes.sides[:, 2] >= 0]
        target = SPEEDUP * current.duration if current.clear else current.duration
        duration = max(target, task.duration or MIN_DURATION_RATIO * setting.single_duration)
        try:
            damping = DAMPING * DAMPING_FACTOR**idle
            moved = moved_curves(setting, current.coefficients, duration, planes, moving, damping)
        except ProgramError:
            break
        current, before = evaluate(setting, moved), best
        report(f"round {iteration + 1}: {current.duration:.3g} s, separation {current.closest:.3f}")
        best = min(before, current, key=lambda candidate: candidate.merit)
        idle = 0 if best.merit < (1.0 - MIN_GAIN) * before.merit else idle + 1
        if idle >= (MAX_IDLE_ROUNDS if best.clear else MAX_IDLE_ROUNDS_UNCLEAR):
            break
        if not best.clear:
            continue
        good = best.duration <= (task.duration or GOOD_RATIO * setting.single_duration)
        fair = best.duration <= (task.duration or FAIR_RATIO * setting.single_duration)
        if good or (fair and current.clear and idle >= MAX_IDLE_ROUNDS_FAIR):
            break
    return best


def _planes(
    setting: Setting, current: CurveBounds, required: Indices
) -> tuple[Planes, NDArray[np.bool_]]:
    """Return the planes of the next program, also of required sides, and the mask (N,) of movers.

    In a LARGE_CROWD only drones move that are too close to others, as long as there are any.
    """
    task, separation = setting.task, setting.task.requirements.separation
    pieces = setting.grid.pieces_of(current.coefficients)
    crowded = task.drones >= LARGE_CROWD and not current.clear
    cutoff = 1.0 + PLANE_MARGIN + (CROWD_PLANE_RANGE if crowded else PLANE_RANGE)
    planes = planes_between(pieces, separation, cutoff, required)
    moving = np.ones(task.drones, dtype=np.bool_)
    close = np.min(planes.gaps, axis=1) < 1.0 + PLANE_MARGIN + CLOSE_RANGE
    if crowded and np.any(close):
        moving[:] = False
        moving[planes.sides[close, 1:]] = True
    distance = separation.radius + 2.0 * setting.trust
    prisms = [
        planes_to_prism(pieces, prism, separation.radius, distance)
        for prism in task.requirements.keep_out
    ]
    return Planes._make(map(np.concatenate, zip(planes, *prisms, strict=True))), moving


def _last_resort(
    task: SeparationTask, evaluations: list[CurveBounds], report: Progress
) -> SeparationResult:
    """Return the fastest flight at the prescribed duration, or raise InfeasibleError."""
    nearest = max(evaluations, key=lambda evaluation: evaluation.closest)
    count = len(evaluations)
    note = f"no route was found from {count} guesses; the search is local: others may exist"
    if task.duration is None:
        raise InfeasibleError(nearest.violations, note)
    report("searching for a feasible duration")
    try:
        fastest = SeparatedCurves(replace(task, duration=None)).solve(report)
    except InfeasibleError:
        raise InfeasibleError(nearest.violations, note) from None
    duration = fastest.drones.duration
    if duration > task.duration:
        raise InfeasibleError([_too_short(task, duration, "the fastest route found takes longer")])
    return replace(fastest, drones=fastest.drones.stretched(task.duration / duration))


def _too_short(task: SeparationTask, duration: float, reason: str) -> Violation:
    """Return the violation of a task whose prescribed duration is below a feasible one [s]."""
    digit = 10.0 ** (math.floor(math.log10(duration)) - 3)
    rounded_up = digit * math.ceil(duration / digit * (1.0 + 1e-9))
    remedy = f"{reason}; allow {rounded_up:.4g} s, or raise the limits"
    limit = task.duration or math.nan
    return Violation("duration", duration, limit, "max", "s", (), "", remedy)


STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration, a reserve for rounding and refitting in exports."""

MIN_DURATION = 0.01
"""[s] Smallest duration, as of flights in which no drone moves."""

REMEDY = "allow more time or space, or move these drones apart"


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
    def merit(self) -> float:
        """Value to be minimised; curves with violations come last."""
        return self.duration if self.clear else UNCLEAR_MERIT * (2.0 - min(self.closest, 1.0))


def evaluate(setting: Setting, coefficients: Array) -> CurveBounds:
    """Return the evaluation of curves by the certificate's continuous-time bounds."""
    task, unit = setting.task, setting.grid.curves(coefficients, 1.0)
    factors = [MIN_DURATION]
    for order, cap in enumerate(setting.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    limit, shortest = task.requirements.limits.body_rate, STRETCH * max(factors)
    duration = turning_stretch(Swarm(task.drones), limit, (unit,), shortest)
    checks = _checks(task, unit.stretched(duration))
    violations = (
        check.violation(f"at t = {check.time:.4g} s of {duration:.4g} s", REMEDY)
        for check in checks
        if not check.holds
    )
    closest = next((check.worst for check in checks if check.name == "separation"), math.inf)
    return CurveBounds(coefficients, duration, closest, tuple(violations))


def _checks(task: SeparationTask, curves: PiecewisePolynomial) -> list[Check]:
    """Return the certificate's checks that do not depend on the duration, and that of tethers."""
    swarm = Swarm(task.drones)
    motion = Motion.single(swarm, task.requirements, curves, ())
    checks = [RULE_OF[name].check(motion) for name in ("separation", "arena", "keep_out")]
    if task.tethers:
        first, second, longest = task.tether_arrays
        x = curves.coefficients
        offsets = (x[:, first] - x[:, second]) / longest[:, None, None]
        size = float(np.max(np.abs(x))) / float(np.min(longest))
        bound = largest_rate(PiecewisePolynomial(curves.breaks, offsets), 0, 1.0)
        pair = tuple(swarm.drone_names[ends[bound.item]] for ends in (first, second))
        worst = bound.worst + ROUNDING * size
        checks.append(Check.of("span", worst, 1.0, "max", "ratio", bound.time, pair, size))
    names = dict(zip(swarm.drone_names, task.names, strict=True))

    def named(check: Check) -> Check:
        """Return the check with the task's names of drones and the nearest prism."""
        where = [names.get(name, name) for name in check.where]
        if check.name == "keep_out" and len(where) == 1:
            drone, prisms = swarm.drone_names.index(check.where[0]), task.requirements.keep_out
            point = curves.at([check.time])[0, drone : drone + 1]
            distances = [float(prism.clearance(point).distance[0]) for prism in prisms]
            where.append(task.prisms[int(np.argmin(distances))])
        return replace(check, where=tuple(where))

    return [named(check) for check in checks if check is not None]


def _check_ends(task: SeparationTask) -> None:
    """Raise InfeasibleError if starts or goals are too close, outside the arena or in a prism."""
    ends = (task.start, "at the start (t = 0)"), (task.goal, "at the goals (the plan's end)")
    violations = [
        check.violation(when, "move the named drones, or relax the limit")
        for points, when in ends
        for check in _checks(task, PiecewisePolynomial.constant([0.0, 1.0], points))
        if not check.holds
    ]
    if violations:
        raise InfeasibleError(violations)
