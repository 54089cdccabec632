"""The separation planner: initial guesses, convex programs, and bounds that end the search."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import Check
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import distances_of
from hitchopt.checks.spans import ROUNDING
from hitchopt.errors import InfeasibleError, Progress, Violation, rounded_up
from hitchopt.hitch import Swarm
from hitchopt.hitch.pairs import FIXED
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Candidate, Effort, first_certified, first_feasible
from hitchopt.planners.separation.guesses import (
    on_layers,
    on_routes,
    pushed_apart,
    roundabout,
    scheduled,
    setting_of,
    stuck_in_prisms,
)
from hitchopt.planners.separation.one_by_one import alone, in_a_row, order_of
from hitchopt.planners.separation.prioritized import prioritized
from hitchopt.planners.separation.program import (
    PLANE_MARGIN,
    Planes,
    moved_curves,
    planes_between,
    planes_to_prism,
)
from hitchopt.planners.separation.retiming import retimed
from hitchopt.planners.separation.task import SeparationResult, SeparationTask, Setting
from hitchopt.planners.timing.profile import LIMIT_SHARE, if_timed
from hitchopt.planners.timing.timed_motion import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.search import rough_bounds
from hitchopt.values import Array, Indices

SIDE = 0.5
"""Strength of the pushes with which all drones give way to one side, in separations."""

MAX_PROGRAMS = 16
"""Maximum number of programs from one guess."""

MAX_PROGRAMS_AMONG_PRISMS = 24
"""The same among prisms."""

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

MAX_RETIMINGS = 4
"""Maximum number of clocks of clear curves, each on the breaks of the last one."""

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

MAX_ITERATIONS = 1500
"""Maximum iterations of OSQP in one program."""

MAX_ITERATIONS_AMONG_PRISMS = 400
"""The same among prisms, whose planes change more from one program to the next."""

MAX_HURRIED_PROGRAMS = 10
"""Number of programs among prisms that apply the limits at once at the shortest duration, and not
at that of the current curves, while no curves are clear."""

MAX_HURRIED_IDLE = 4
"""Maximum number of consecutive rounds of such programs without improvement."""

STUCK_SHARE = 0.95
"""Share of the distance to a prism below which a drone counts as stuck in it after programs."""

MAX_STUCK_ROUNDS = 2
"""Maximum number of consecutive rounds without improvement, or too close to prisms alone, before
drones that are stuck in prisms are put back on their routes."""

MAX_RESETS = 6
"""Maximum number of rounds after which drones are put back."""

NEARLY_APART = 0.05
"""Shortfall of separations below which planes to prisms get the margin that curves lacked, after a
round without improvement."""

MAX_PRISM_MARGIN = 0.1
"""Largest such margin, over the distance."""

MAX_EFFORT = 150_000.0
"""Effort after which no further guess is tried but drones one by one; programs take one unit per
drone and piece."""

MAX_ONE_BY_ONE = 24
"""Largest number of drones that fly one after the other."""

UNCLEAR_MERIT = 1e9
"""Merit of curves that violate a limit at any speed, per missing separation."""

PLANE_RANGE = 1.0
"""Separation [1] in excess of the limit up to which pairs of pieces have a plane."""

CROWD_PLANE_RANGE = 0.5
"""The same in crowds."""

LARGE_CROWD = 256
"""Smallest number of drones for which a program moves only those that are too close, and the search
ends with the first clear curves: programs that couple all drones would need too much time."""

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
        report = progress or (lambda _: None)
        task = self.task
        _check_ends(task)
        bound = self.problem.bound
        if task.duration is not None and task.duration < bound:
            raise InfeasibleError([_too_short(task, bound, "no drone can be as fast")])
        effort = Effort()
        return first_certified(self._routes(report, effort), effort)

    def _routes(self, report: Progress, effort: Effort) -> Iterator[Candidate[SeparationResult]]:
        """Yield the routes from all guesses, then the fastest one at a prescribed duration.

        Raises InfeasibleError if the fastest one takes longer: its duration is a remedy that holds.
        """
        task = self.task
        for guess in _guesses(self.problem):
            yield Candidate("route", partial(self._route, guess, report, effort))
            if effort.spent > MAX_EFFORT:
                break
        if 1 < task.drones <= MAX_ONE_BY_ONE and not task.tethers:
            yield Candidate("flight of one drone after the other", partial(self._in_a_row, report))
        if task.duration is None:
            return
        report("searching for a feasible duration")
        untimed = SeparatedCurves(replace(task, duration=None))
        fastest = first_feasible([Candidate("fastest route", partial(untimed.solve, report))], None)
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
        task, best = self.task, _improved(guess, report, effort)
        if not best.clear:
            raise InfeasibleError(list(best.violations), LOCAL_SEARCH)
        curves, closest = _fastest(guess.setting, best)
        if task.duration is not None:
            if curves.duration > task.duration:
                violations = [_too_short(task, curves.duration, SLOW_ROUTE)]
                raise InfeasibleError(violations, LOCAL_SEARCH)
            curves = curves.stretched(task.duration / curves.duration)
        return SeparationResult(curves, closest, self.problem.bound, guess.rule)

    def _in_a_row(self, report: Progress) -> SeparationResult:
        """Return curves of one drone after the other; raise InfeasibleError without any."""
        report("guess: one after the other")
        task = self.task
        order = order_of(task)
        if order is None:
            raise InfeasibleError(
                [], "no order was found in which one drone can fly after the other"
            )
        flights = list[tuple[int, PiecewisePolynomial]]()
        for k, drone in enumerate(order):
            planner = SeparatedCurves(alone(task, drone, order[:k]))
            flight = first_feasible([Candidate("flight", planner.solve)], None)
            if flight is None:  # its violations are of prisms around others, not of the task
                name = task.names[drone]
                raise InfeasibleError([], f"no flight of {name} past the others at rest was found")
            flights.append((drone, flight.drones))
        curves = in_a_row(task, flights)
        if task.duration is not None:
            if curves.duration > task.duration:
                raise InfeasibleError([_too_short(task, curves.duration, SLOW_ROUTE)])
            curves = curves.stretched(task.duration / curves.duration)
        checks = _checks(task, curves)
        violations = [
            check.violation(f"at t = {check.time:.4g} s", REMEDY)
            for check in checks
            if not check.holds
        ]
        if violations:
            raise InfeasibleError(violations, LOCAL_SEARCH)
        return SeparationResult(curves, _closest(checks), self.problem.bound, "one after the other")


class Guess(NamedTuple):
    """Curves from which a search starts."""

    setting: Setting
    """The task on the time grid of the curves."""

    coefficients: Array
    """(N, count, 3) [m]"""

    rule: str
    """Which drones give way to others; empty for direct routes."""


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


def _improved(guess: Guess, report: Progress, effort: Effort) -> CurveBounds:
    """Return the best curves that programs reach from a guess, with some effort."""
    setting = guess.setting
    current = best = evaluate(setting, guess.coefficients)
    required_sides = np.zeros((0, 3), dtype=np.intp)
    prism_margin = 0.0
    idle_rounds = stuck_rounds = resets = 0
    is_hurried = among_prisms = bool(setting.task.requirements.keep_out)
    max_iterations = MAX_ITERATIONS_AMONG_PRISMS if among_prisms else MAX_ITERATIONS
    for iteration in range(MAX_PROGRAMS_AMONG_PRISMS if among_prisms else MAX_PROGRAMS):
        if best.clear and setting.task.drones >= LARGE_CROWD:
            break
        planes, moving = _planes(setting, current, required_sides, prism_margin)
        between_drones = planes.sides[:, 2] >= 0
        required_sides = planes.sides[between_drones]
        if not best.clear and is_hurried:
            is_hurried = idle_rounds < MAX_HURRIED_IDLE and iteration < MAX_HURRIED_PROGRAMS
            idle_rounds = idle_rounds if is_hurried else 0
        at_shortest = is_hurried or (among_prisms and best.clear and not idle_rounds)
        duration = _shortest(setting) if at_shortest else _target_duration(setting, current)
        damping = DAMPING * DAMPING_FACTOR**idle_rounds
        effort.spend(setting.task.drones * setting.grid.pieces)
        moved = moved_curves(
            setting, current.coefficients, duration, planes, moving, damping, max_iterations
        )
        if moved is None:
            break
        current = evaluate(setting, moved)
        report(f"round {iteration + 1}: {current.duration:.3g} s, separation {current.closest:.3f}")
        improved = current.merit < (1.0 - MIN_GAIN) * best.merit
        idle_rounds = 0 if improved else idle_rounds + 1
        if current.merit < best.merit:
            best = current
        if best.clear:
            prism_margin = 0.0
        elif idle_rounds and current.closest >= 1.0 - NEARLY_APART:
            prism_margin = min(prism_margin + 1.0 - current.to_prisms, MAX_PRISM_MARGIN)
        is_apart = current.closest >= 1.0
        stuck_rounds = 0 if current.clear or not (is_apart or idle_rounds) else stuck_rounds + 1
        if stuck_rounds >= MAX_STUCK_ROUNDS and resets < MAX_RESETS:
            stuck = stuck_in_prisms(setting, current.coefficients, STUCK_SHARE)
            if np.any(stuck) and not np.all(stuck):
                current = evaluate(setting, on_routes(setting, current.coefficients, stuck))
                required_sides = np.zeros((0, 3), dtype=np.intp)
                idle_rounds = stuck_rounds = 0
                resets += 1
        if _search_ends(setting, best, current, idle_rounds):
            break
    return best


def _shortest(setting: Setting) -> float:
    """Return the shortest duration [s] at which programs apply the limits."""
    return setting.task.duration or MIN_DURATION_RATIO * setting.single_duration


def _target_duration(setting: Setting, current: CurveBounds) -> float:
    """Return the duration [s] at which the next program applies the limits."""
    target = SPEEDUP * current.duration if current.clear else current.duration
    return max(target, _shortest(setting))


def _search_ends(
    setting: Setting, best: CurveBounds, current: CurveBounds, idle_rounds: int
) -> bool:
    """Return whether the best curves suffice, or too many rounds have not improved them."""
    if not best.clear:
        return idle_rounds >= MAX_IDLE_ROUNDS_UNCLEAR
    fair = best.duration <= (setting.task.duration or FAIR_RATIO * setting.single_duration)
    return (
        _is_good(setting, best.duration)
        or (fair and current.clear and idle_rounds >= MAX_IDLE_ROUNDS_FAIR)
        or idle_rounds >= MAX_IDLE_ROUNDS
    )


def _is_good(setting: Setting, duration: float) -> bool:
    """Return whether a duration [s] is the prescribed one, or near that of single flights."""
    return duration <= (setting.task.duration or GOOD_RATIO * setting.single_duration)


def _planes(
    setting: Setting, current: CurveBounds, required: Indices, prism_margin: float
) -> tuple[Planes, NDArray[np.bool_]]:
    """Return the planes of the next program, also of required sides, and the mask (N,) of movers.

    In a LARGE_CROWD only drones move that are too close to others, as long as there are any.
    ``prism_margin`` is what curves lacked before to prisms, over the distance.
    """
    task = setting.task
    separation = task.requirements.separation
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
    planes_to_prisms = [
        planes_to_prism(
            pieces, prism, separation.radius, distance, task.requirements.arena
        ).with_margin(prism_margin)
        for prism in task.requirements.keep_out
    ]
    return _concatenated([planes, *planes_to_prisms]), moving


def _concatenated(parts: Sequence[Planes]) -> Planes:
    """Return all planes of the parts, in their order."""
    return Planes(
        sides=np.concatenate([part.sides for part in parts]),
        normals=np.concatenate([part.normals for part in parts]),
        gaps=np.concatenate([part.gaps for part in parts]),
    )


SLOW_ROUTE = "the fastest route found takes longer"
"""Why a duration is too short."""

LOCAL_SEARCH = "the search of routes is local: others may exist"
"""Note on routes that violate a limit."""


def _too_short(task: SeparationTask, duration: float, reason: str) -> Violation:
    """Return the violation of a task whose prescribed duration is below a feasible one [s]."""
    remedy = f"{reason}; allow {rounded_up(duration, 4):.4g} s, or raise the limits"
    limit = task.duration or math.nan
    return Violation("duration", duration, limit, "max", "s", (), "", remedy)


STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration, a reserve for rounding and refitting in exports."""

MIN_DURATION = 0.01
"""[s] Smallest duration, as of flights in which no drone moves."""

REMEDY = "allow more time or space, or move these drones apart"
"""Suggested change for curves that violate a limit."""

END_REMEDY = "move the named drones, or relax the limit"
"""Suggested change for starts and goals that violate a limit."""


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
    timed, checks = _timed(setting, setting.grid.curves(coefficients, 1.0))
    duration = timed.duration
    violations = (
        check.violation(f"at t = {check.time:.4g} s of {duration:.4g} s", REMEDY)
        for check in checks
        if not check.holds
    )
    return CurveBounds(coefficients, duration, _closest(checks), tuple(violations))


def _closest(checks: Sequence[Check]) -> float:
    """Return the smallest separation of any two drones; infinite for one drone."""
    return next((check.worst for check in checks if check.name == "separation"), math.inf)


def _fastest(setting: Setting, best: CurveBounds) -> tuple[PiecewisePolynomial, float]:
    """Return clear curves retimed until they are good, or no faster, and their separation."""
    curves = setting.grid.curves(best.coefficients, best.duration)
    closest = best.closest
    for _ in range(MAX_RETIMINGS):
        if _is_good(setting, curves.duration):
            break
        on_faster_clock = if_timed(partial(retimed, setting, curves))
        if on_faster_clock is None:
            break
        faster, checks = _timed(setting, on_faster_clock)
        is_clear = all(check.holds for check in checks)
        if not is_clear or faster.duration > (1.0 - MIN_GAIN) * curves.duration:
            break
        curves = faster
        closest = _closest(checks)
    return curves, closest


def _timed(
    setting: Setting, curves: PiecewisePolynomial
) -> tuple[PiecewisePolynomial, list[Check]]:
    """Return curves in their shortest duration, and their checks by rough bounds."""
    in_a_second = curves.stretched(1.0 / curves.duration)
    timed = in_a_second.stretched(_shortest_duration(setting, in_a_second))
    with rough_bounds():
        return timed, _checks(setting.task, timed)


def _shortest_duration(setting: Setting, curves: PiecewisePolynomial) -> float:
    """Return the shortest duration [s], with reserves, of curves whose duration is one."""
    durations = [MIN_DURATION]
    for order, cap in enumerate(setting.caps, start=1):
        over_cap = PiecewisePolynomial(curves.breaks, curves.coefficients / cap[:, None, None])
        largest = max(largest_rate(over_cap, order).worst, 0.0)
        durations.append(float(np.power(largest, 1.0 / order)))
    body_rate = setting.task.requirements.limits.body_rate
    swarm = Swarm(setting.task.drones)
    return turning_stretch(swarm, body_rate, (curves,), STRETCH * max(durations))


CHECKED_RULES = distances_of("drones", *FIXED)
"""The certificate's rules that do not depend on the duration."""


def _checks(task: SeparationTask, curves: PiecewisePolynomial) -> list[Check]:
    """Return the checks of CHECKED_RULES and of tethers, with the task's names."""
    motion = Motion.single(Swarm(task.drones), task.requirements, curves, ())
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


def _check_ends(task: SeparationTask) -> None:
    """Raise InfeasibleError if starts or goals are too close, outside the arena or in a prism."""
    violations = [
        *_end_violations(task, task.start, "at the start (t = 0)"),
        *_end_violations(task, task.goal, "at the goals (the plan's end)"),
    ]
    if violations:
        raise InfeasibleError(violations)


def _end_violations(task: SeparationTask, points: Array, when: str) -> list[Violation]:
    """Return the violations of drones at rest at points (N, 3) [m]."""
    at_rest = PiecewisePolynomial.constant([0.0, 1.0], points)
    checks = _checks(task, at_rest)
    return [check.violation(when, END_REMEDY) for check in checks if not check.holds]
