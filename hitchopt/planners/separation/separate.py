"""The separation planner: guesses, convex programs around them, and bounds that end the search."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import Check
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.spans import ROUNDING
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.planners.separation.guesses import pushed_apart, roundabout, setting_of
from hitchopt.planners.separation.program import (
    MARGIN,
    Planes,
    ProgramError,
    moved_curves,
    planes_between,
    walls_before,
)
from hitchopt.planners.separation.task import Separated, SeparationTask, Setting
from hitchopt.planners.timing.flight import turning_stretch
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

Progress = Callable[[str], None]

RULES = ((0.5, 1.0), (0.5, 1.5), (-0.5, 1.0), (0.5, 2.0), (0.5, 3.0))
"""Shift of drones to the right where they meet, and the duration over that of the
slowest flight (above 1, departures are staggered), in the order in which they are tried."""

MAX_PROGRAMS = 16
"""Maximum number of programs around one guess."""

FASTER = 0.85
"""Share of the present duration that the next program aims at while the curves are clear."""

BARELY = 1.03
"""Smallest duration to aim at, over that of single flights: splines cannot be faster."""

GOOD, NEARLY = 1.05, 1.15
"""Durations over that of single flights at which the search ends, and at which it ends after one
round without a gain."""

GAIN = 0.04
"""Smallest relative gain that counts."""

PATIENCE, STALLED = 3, 6
"""Maximum consecutive rounds without a gain, and while drones still meet."""

UNCLEAR = 1e9
"""Offset of the merit for curves that break a limit at any speed."""

REACH, NARROW = 1.0, 0.5
"""Excess of the separation [1] up to which pairs of pieces get a plane, and that in crowds."""

LARGE = 256
"""Number of drones from which on only those that are too close are moved, until curves are clear,
which ends the search: a program of all is coupled by so many planes that its factors fill."""

CLOSE = 0.1
"""Excess of the separation [1] below which drones are too close in this sense."""


@dataclass(frozen=True, eq=False)
class SeparatedFlight:
    """The planner of curves for all drones that satisfy a task at every time."""

    task: SeparationTask

    @cached_property
    def problem(self) -> Setting:
        """The splines on a time grid among which curves are looked for."""
        return setting_of(self.task)

    def solve(self, progress: Progress | None = None) -> Separated:
        """Return the curves.

        Parameters
        ----------
        progress: called with a description of the present stage.

        Raises
        ------
        InfeasibleError: the task cannot be met, or the search found no curves; the violations name
            the pair and the time.
        """
        say, task = progress or (lambda _: None), self.task
        _check_ends(task)
        setting = self.problem
        if task.duration is not None and task.duration < setting.bound:
            raise InfeasibleError([_too_short(task, setting.bound, "no drone can be as fast")])
        tried: list[Evaluation] = []
        for own, guess, remark in _guesses(setting):
            say(f"guess: {remark or 'straight'}")
            evaluation = _improved(own, guess, say)
            if evaluation.clear and evaluation.duration <= (task.duration or math.inf):
                curves = own.grid.curves(
                    evaluation.coefficients, task.duration or evaluation.duration
                )
                return Separated(curves, evaluation.closest, setting.bound, remark)
            tried.append(evaluation)
        return _last_resort(task, tried, say)


def _guesses(setting: Setting) -> Iterator[tuple[Setting, Array, str]]:
    """Yield settings with first curves (N, count, 3) [m] and the rule that they follow."""
    if evaluate(setting, setting.nominal).clear:  # no two drones meet
        yield setting, setting.nominal, ""
    around = roundabout(setting)
    if around is not None:
        yield setting, around, "all go around where they meet, to the right"
    for side, patience in RULES:
        if patience * setting.alone > (setting.task.duration or math.inf):
            continue
        own = setting if patience == 1.0 else setting_of(setting.task, patience)
        words = f"all give way to the {'right' if side > 0.0 else 'left'} where they meet"
        yield own, pushed_apart(own, side), ("some leave later; " if patience > 1.0 else "") + words


def _improved(setting: Setting, guess: Array, say: Progress) -> Evaluation:
    """Return the best curves that programs around a guess reach."""
    task, idle = setting.task, 0
    here = best = evaluate(setting, guess)
    known = np.zeros((0, 3), dtype=np.intp)
    for round_number in range(MAX_PROGRAMS):
        if best.clear and task.drones >= LARGE:
            break
        planes, moving = _planes(setting, here, known)
        known = planes.sides[planes.sides[:, 2] >= 0]
        aimed = FASTER * here.duration if here.clear else here.duration
        duration = max(aimed, task.duration or BARELY * setting.alone)
        try:
            moved = moved_curves(setting, here.coefficients, duration, planes, moving)
        except ProgramError:
            break
        here, before = evaluate(setting, moved), best
        say(f"round {round_number + 1}: {here.duration:.3g} s, separation {here.closest:.3f}")
        best = min(before, here, key=lambda candidate: candidate.merit)
        idle = 0 if best.merit < (1.0 - GAIN) * before.merit else idle + 1
        if idle >= (PATIENCE if best.clear else STALLED):
            break
        if not best.clear:
            continue
        within = best.duration <= (task.duration or GOOD * setting.alone)
        nearly = best.duration <= (task.duration or NEARLY * setting.alone)
        if within or (nearly and here.clear and idle):
            break
    return best


def _planes(setting: Setting, here: Evaluation, known: Indices) -> tuple[Planes, NDArray[np.bool_]]:
    """Return the planes of the next program, those of the last one among them, and who moves (N,).

    All do, but of LARGE crowds only those that are too close to others, as long as there are any.
    """
    task, separation = setting.task, setting.task.requirements.separation
    pieces = setting.grid.pieces_of(here.coefficients)
    few = task.drones >= LARGE and not here.clear
    cutoff = 1.0 + MARGIN + (NARROW if few else REACH)
    planes = planes_between(pieces, separation, cutoff, known)
    moving = np.ones(task.drones, dtype=np.bool_)
    close = np.min(planes.gaps, axis=1) < 1.0 + MARGIN + CLOSE
    if few and np.any(close):
        moving[:] = False
        moving[planes.sides[close, 1:]] = True
    reach = separation.radius + 2.0 * setting.trust
    walls = [
        walls_before(pieces, prism, separation.radius, reach)
        for prism in task.requirements.keep_out
    ]
    return Planes._make(map(np.concatenate, zip(planes, *walls, strict=True))), moving


def _last_resort(task: SeparationTask, tried: list[Evaluation], say: Progress) -> Separated:
    """Return the fastest flight slowed to the given duration, or refuse with the time it takes."""
    nearest = max(tried, key=lambda evaluation: evaluation.closest)
    note = f"no route was found from {len(tried)} guesses; the search is local: others may exist"
    if task.duration is None:
        raise InfeasibleError(nearest.broken, note)
    say("searching for a feasible duration")
    try:
        fastest = SeparatedFlight(replace(task, duration=None)).solve(say)
    except InfeasibleError:
        raise InfeasibleError(nearest.broken, note) from None
    needed = fastest.drones.duration
    if needed > task.duration:
        raise InfeasibleError([_too_short(task, needed, "the fastest route found takes longer")])
    return replace(fastest, drones=fastest.drones.stretched(task.duration / needed))


def _too_short(task: SeparationTask, needed: float, which: str) -> Violation:
    grain = 10.0 ** (math.floor(math.log10(needed)) - 3)  # rounded up
    enough = grain * math.ceil(needed / grain * (1.0 + 1e-9))
    remedy = f"{which}; allow {enough:.4g} s, or raise the limits"
    limit = task.duration or math.nan
    return Violation("duration", needed, limit, "max", "s", (), "", remedy)


STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration: a reserve for the rounding and refitting of exports."""

IDLE = 0.01
"""[s] Duration where no drone moves."""

REMEDY = "give more time or room, or move the drones concerned apart"


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

    @property
    def merit(self) -> float:
        """Smaller for better curves; those that are not clear come last."""
        return self.duration if self.clear else UNCLEAR * (2.0 - min(self.closest, 1.0))


def evaluate(setting: Setting, coefficients: Array) -> Evaluation:
    """Return the evaluation of curves, by the certificate's bounds that hold at every time."""
    task, unit = setting.task, setting.grid.curves(coefficients, 1.0)
    factors = [IDLE]
    for order, cap in enumerate(setting.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    limit, least = task.requirements.limits.body_rate, STRETCH * max(factors)
    duration = turning_stretch(Swarm(task.drones), limit, (unit,), least)
    checks = _checks(task, unit.stretched(duration))
    broken = (
        check.violation(f"at t = {check.time:.4g} s of {duration:.4g} s", REMEDY)
        for check in checks
        if not check.holds
    )
    closest = next((check.bound for check in checks if check.name == "separation"), math.inf)
    return Evaluation(coefficients, duration, closest, tuple(broken))


def _checks(task: SeparationTask, curves: PiecewisePolynomial) -> list[Check]:
    """Return the certificate's checks of curves that no duration changes, and of tethers."""
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
        """Return the check with the task's names, also of the prism that is nearest."""
        where = [names.get(name, name) for name in check.where]
        if check.name == "keep_out" and len(where) == 1:
            drone, prisms = swarm.drone_names.index(check.where[0]), task.requirements.keep_out
            place = curves.at([check.time])[0, drone : drone + 1]
            away = [float(prism.clearance(place).distance[0]) for prism in prisms]
            where.append(task.prisms[int(np.argmin(away))])
        return replace(check, where=tuple(where))

    return [named(check) for check in checks if check is not None]


def _check_ends(task: SeparationTask) -> None:
    """Raise InfeasibleError where starts or goals are too close, outside or within a prism."""
    ends = (task.start, "at the start (t = 0)"), (task.goal, "at the goals (the plan's end)")
    violations = [
        check.violation(when, "move the drones named there, or ease the limit")
        for points, when in ends
        for check in _checks(task, PiecewisePolynomial.constant([0.0, 1.0], points))
        if not check.holds
    ]
    if violations:
        raise InfeasibleError(violations)
