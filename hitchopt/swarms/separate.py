"""The separation planner: routes from all guesses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

from hitchopt.errors import InfeasibleError, Progress, Violation, rounded_up
from hitchopt.planners.candidates import Candidate, Effort, first_certified, if_feasible
from hitchopt.planners.timing.profile import if_timed
from hitchopt.swarms.evaluation import (
    CurveBounds,
    checks_of,
    closest_of,
    evaluate,
    timed_in_shortest,
)
from hitchopt.swarms.guesses import on_layers, pushed_apart, roundabout, scheduled
from hitchopt.swarms.nominal import setting_of
from hitchopt.swarms.prioritized import prioritized
from hitchopt.swarms.retiming import retimed
from hitchopt.swarms.search import IN_FREE_SPACE, Guess, improved, is_good
from hitchopt.swarms.task import SeparationResult, SeparationTask, Setting
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SIDE = 0.5  # Strength of the pushes with which all drones give way to one side, in separations
MAX_RETIMINGS = 4  # Maximum number of clocks of clear curves, each on the breaks of the last one

MAX_EFFORT = 150_000.0
"""Effort after which no further guess is tried; programs take one unit per drone and piece."""


@dataclass(frozen=True, eq=False)
class SeparatedCurves:
    """A planner of curves of all drones that satisfy a task at every time."""

    task: SeparationTask

    @cached_property
    def setting(self) -> Setting:
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
        report = progress or (lambda _: None)
        task = self.task
        violations = [
            *_violations_at_rest(task, task.start, "at the start (t = 0)"),
            *_violations_at_rest(task, task.goal, "at the goals (the plan's end)"),
        ]
        if violations:
            raise InfeasibleError(violations)
        bound = self.setting.bound
        if task.duration is not None and task.duration < bound:
            raise InfeasibleError([_too_short(task, bound, "no drone can be as fast")])
        effort = Effort()
        return first_certified(self._routes(report, effort), effort)

    def _routes(self, report: Progress, effort: Effort) -> Iterator[Candidate[SeparationResult]]:
        """Yield the routes from all guesses, then the fastest one at a prescribed duration.

        Raises InfeasibleError if the fastest one takes longer: its duration is a remedy that holds.
        """
        task = self.task
        for guess in _guesses(self.setting):
            yield Candidate("route", partial(self._route, guess, report, effort))
            if effort.spent > MAX_EFFORT:
                break
        if task.duration is None:
            return
        report("searching for a feasible duration")
        untimed = SeparatedCurves(replace(task, duration=None))
        fastest = if_feasible("fastest route", partial(untimed.solve, report), None)
        if fastest is None:
            return
        duration = fastest.drones.duration
        if duration > task.duration:
            raise InfeasibleError([_too_short(task, duration, SLOW_ROUTE)])
        slowed = replace(fastest, drones=fastest.drones.stretched(task.duration / duration))
        yield Candidate("slowed route", lambda: slowed)

    def _route(self, guess: Guess, report: Progress, effort: Effort) -> SeparationResult:
        """Return the curves that programs reach from a guess; raise InfeasibleError otherwise."""
        report(f"guess: {guess.rule or 'straight'}")
        task, best = self.task, improved(guess, report, effort)
        if not best.clear:
            raise InfeasibleError(list(best.violations), LOCAL_SEARCH)
        curves, closest = _fastest(guess.setting, best)
        if task.duration is not None:
            if curves.duration > task.duration:
                violations = [_too_short(task, curves.duration, SLOW_ROUTE)]
                raise InfeasibleError(violations, LOCAL_SEARCH)
            curves = curves.stretched(task.duration / curves.duration)
        return SeparationResult(curves, closest, self.setting.bound, guess.rule)


def _guesses(setting: Setting) -> Iterator[Guess]:
    """Yield guesses in the order in which they are tried."""
    if evaluate(setting, setting.nominal).clear:  # no two drones meet
        yield Guess(setting, setting.nominal, "")
    among_prisms = bool(setting.task.requirements.keep_out)
    layered = on_layers(setting) if among_prisms else None
    if layered is not None:
        yield Guess(setting, pushed_apart(layered, SIDE), "altitudes by heading")
    circular = None if among_prisms else roundabout(setting)
    if circular is not None:
        yield Guess(setting, circular, "all go around where they meet, to the right")
    right = pushed_apart(setting, SIDE)
    yield Guess(setting, right, "all give way to the right where they meet")
    if not setting.task.tethers:
        for schedule in prioritized(setting.task):
            on_schedule = scheduled(setting.task, schedule)
            yield Guess(on_schedule, on_schedule.nominal, "some wait for others to pass")
    left = pushed_apart(setting, -SIDE)
    yield Guess(setting, left, "all give way to the left where they meet")


SLOW_ROUTE = "the fastest route found takes longer"  # Why a duration is too short

LOCAL_SEARCH = "the search of routes is local: others may exist"
"""Note on routes that violate a limit."""


def _too_short(task: SeparationTask, duration: float, reason: str) -> Violation:
    """Return the violation of a task whose prescribed duration is below a feasible one [s]."""
    remedy = f"{reason}; allow {rounded_up(duration, 4):.4g} s, or raise the limits"
    limit = task.duration or math.nan
    return Violation("duration", duration, limit, "max", "s", (), "", remedy)


def _fastest(setting: Setting, best: CurveBounds) -> tuple[PiecewisePolynomial, float]:
    """Return clear curves retimed until they are good, or no faster, and their separation."""
    curves = setting.grid.curves(best.coefficients, best.duration)
    closest = best.closest
    for _ in range(MAX_RETIMINGS):
        if is_good(setting, curves.duration):
            break
        on_faster_clock = if_timed(partial(retimed, setting, curves))
        if on_faster_clock is None:
            break
        faster, checks = timed_in_shortest(setting, on_faster_clock)
        is_clear = all(check.holds for check in checks)
        if not is_clear or faster.duration > (1.0 - IN_FREE_SPACE.min_gain) * curves.duration:
            break
        curves = faster
        closest = closest_of(checks)
    return curves, closest


END_REMEDY = "move the named drones, or relax the limit"
"""Suggested change for starts and goals that violate a limit."""


def _violations_at_rest(task: SeparationTask, points: Array, when: str) -> list[Violation]:
    """Return the violations of drones at rest at points (N, 3) [m]."""
    at_rest = PiecewisePolynomial.constant([0.0, 1.0], points)
    checks = checks_of(task, at_rest)
    return [check.violation(when, END_REMEDY) for check in checks if not check.holds]
