"""The separation planner: guesses, convex programs around them, and bounds that end the search."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import Check
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.spans import ROUNDING
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.planners.separation.guesses import PriorityRule, pushed_apart, roundabout
from hitchopt.planners.separation.planes import (
    ClosePieces,
    close_pieces,
    planes_between,
    walls_before,
)
from hitchopt.planners.separation.program import (
    MARGIN,
    MOST_ITERATIONS,
    Around,
    ProgramError,
    build_program,
    solve_program,
)
from hitchopt.planners.separation.setting import Setting, setting_of
from hitchopt.planners.separation.task import Separated, SeparationTask
from hitchopt.planners.timing.demands import LIMIT_SHARE
from hitchopt.planners.timing.flight import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

Progress = Callable[[str], None]

GUESSES = (
    PriorityRule(0.5),
    PriorityRule(0.5, patience=1.5),
    PriorityRule(-0.5),
    PriorityRule(0.5, patience=2.0),
    PriorityRule(0.5, patience=3.0),
)
"""Priority rules in the order in which they are tried."""

ROUNDS = 16
"""Maximum number of programs around one guess."""

AROUND_CROWDS = 150
"""Iterations in a program around a roundabout. Rounds correct what these leave. With 75 a circle of
128 drones takes 2.0 % longer; with 200 circles of 48 to 96 take 0.2 to 1.2 % longer, one of 128
takes 0.6 % less."""

FASTER = 0.85
"""Share of the present duration that the next program aims at while the curves are clear."""

BARELY = 1.03
"""Smallest duration to aim at, over that of single flights: splines cannot be faster."""

GOOD = 1.05
"""Duration over that of single flights at which the search ends."""

PATIENCE = 3
"""Maximum consecutive rounds without a gain."""

GAIN = 0.02
"""Smallest relative gain that counts."""

TRUST = 2.5
"""Trust radius: largest move of a coefficient in one program, in drone radii."""

STALLED = 6
"""Maximum consecutive rounds without a gain while drones still meet."""

UNCLEAR, LATE = 1e9, 1e6
"""Offsets of the merit for curves that break a limit at any speed, and that take too long."""

REACH = 1.0
"""Excess of the separation [1] up to which pairs of pieces get a plane."""

LARGE = 256
"""Number of drones from which on only those that are too close are moved, until curves are clear,
which ends the search."""

NARROW, CAREFUL = 0.5, 0.4
"""REACH, and largest move in trust radii, of drones in those programs that are not DEEP. With fewer
planes factors fill a tenth as much, and with smaller moves drones meet no others that have none."""

DEEP = 0.5
"""Separation below which drones must move farther than that."""

CLOSE = 0.1
"""Excess of the separation [1] below which drones are too close in this sense."""

NEARLY = 1.15
"""Duration over that of single flights at which one round without a gain ends the search."""

WORTHWHILE = 0.075
"""Smallest relative gain that counts around a roundabout once a flight is NEARLY as fast: half of
what a round aims at."""


def separate(task: SeparationTask, progress: Progress | None = None) -> Separated:
    """Return curves for all drones that satisfy the task at every time.

    Parameters
    ----------
    task: starts, goals and requirements.
    progress: called with a description of the present stage.

    Raises
    ------
    InfeasibleError: the task cannot be met, or the search found no curves; the violations name the
        pair and the time.
    """
    say = progress if progress is not None else _silent
    check_ends(task)
    setting = setting_of(task)
    if task.duration is not None and task.duration < setting.bound:
        raise InfeasibleError([_too_short(task, setting.bound, "no drone can be as fast")])
    tried: list[Evaluation] = []
    if evaluate(setting, setting.nominal).clear:  # no two drones meet
        found = _improved(setting, setting.nominal, say)
        if found.clear and found.duration <= (task.duration or math.inf):
            return _separated(setting, found, "")
        tried.append(found)
    if (around := roundabout(setting)) is not None:
        say("guess: a roundabout")
        found = _improved(setting, around, say, crowd=True)
        if found.clear and found.duration <= (task.duration or math.inf):
            return _separated(setting, found, "all go around where they meet, to the right")
        tried.append(found)
    for rule in GUESSES:
        patience = rule.patience
        if task.duration is not None and patience * setting.alone > task.duration:
            continue
        say(f"guess: {rule}")
        delayed = setting if patience == 1.0 else setting_of(task, patience)
        found = _improved(delayed, pushed_apart(delayed, rule), say)
        if found.clear and found.duration <= (task.duration or math.inf):
            return _separated(delayed, found, str(rule))
        tried.append(found)
    return _last_resort(task, tried, say)


def _improved(setting: Setting, guess: Array, say: Progress, *, crowd: bool = False) -> Evaluation:
    """Return the best curves that programs around a guess, perhaps a crowd's, reach."""
    iterations = AROUND_CROWDS if crowd else MOST_ITERATIONS
    here = best = evaluate(setting, guess)
    known: ClosePieces | None = None
    idle = 0
    for round_number in range(ROUNDS):
        if best.clear and _large(setting):
            break
        around = _around(setting, here, known)
        known = around.planes.between
        built = build_program(setting, around)
        moving = _moving(setting, here, around)
        try:
            solution = np.zeros(len(built.program.q))  # unknowns are changes
            if np.all(moving):
                solution = solve_program(built.program, solution, iterations)
            else:
                part, kept = built.among(moving)
                solution[kept] = solve_program(part, solution[kept], iterations)
        except ProgramError:
            break
        here = evaluate(setting, built.moved(solution))
        say(f"round {round_number + 1}: {here.duration:.3g} s, separation {here.closest:.3f}")
        before, after = _merit(setting, best), _merit(setting, here)
        if after < before:
            best = here
        least = WORTHWHILE if crowd and _nearly(setting, best) else GAIN
        idle = 0 if after < (1.0 - least) * before else idle + 1
        if _enough(setting, here, best, idle):
            break
    return best


def _around(setting: Setting, here: Evaluation, known: ClosePieces | None) -> Around:
    """Return the data of the next program; it has the planes of the last one as well."""
    task = setting.task
    radius = task.requirements.separation.radius
    aimed = FASTER * here.duration if here.clear else here.duration
    floor = BARELY * setting.alone if task.duration is None else task.duration
    pieces = setting.grid.pieces_of(here.coefficients)
    scaled = pieces * setting.scale[:, None]
    close = close_pieces(scaled, 1.0 + MARGIN + REACH)
    moves = np.ones(task.drones)
    if _large(setting) and not here.clear:
        gaps = np.min(planes_between(scaled, close).gaps, axis=1)
        moves[:] = CAREFUL
        for ends in (close.first, close.second):
            moves[ends[gaps < DEEP]] = 1.0
        deep = np.maximum(moves[close.first], moves[close.second]) == 1.0
        close = close.taken((gaps < 1.0 + MARGIN + NARROW) | deep)
    if known is not None:
        close = close.united(known, task.drones)
    trust = TRUST * radius
    walls = walls_before(pieces, task.requirements.keep_out, radius, radius + 2.0 * trust)
    planes = planes_between(scaled, close)
    return Around(here.coefficients, max(aimed, floor), trust, planes, walls, moves)


def _moving(setting: Setting, here: Evaluation, around: Around) -> NDArray[np.bool_]:
    """Return which drones (N,) the next program moves.

    All of them, but of crowds that are LARGE only those that are too close to others, as long as
    there are any: a program of all is coupled by so many planes that its factors fill.
    """
    everyone = np.ones(setting.task.drones, dtype=np.bool_)
    if here.clear or not _large(setting):
        return everyone
    planes = around.planes
    close = np.min(planes.gaps, axis=1) < 1.0 + MARGIN + CLOSE
    moving = ~everyone
    moving[planes.between.first[close]] = True
    moving[planes.between.second[close]] = True
    return moving if np.any(moving) else everyone


def _large(setting: Setting) -> bool:
    """Return whether a crowd is LARGE, nothing but drones in its way, and may take its time."""
    task = setting.task
    bound = task.tethers or task.requirements.keep_out or task.duration is not None
    return task.drones >= LARGE and not bound


def _enough(setting: Setting, here: Evaluation, best: Evaluation, idle: int) -> bool:
    """Return whether the search around this guess ends."""
    if not best.clear:
        return idle >= STALLED
    if setting.task.duration is not None:
        return idle >= (1 if best.duration <= setting.task.duration else PATIENCE)
    if best.duration <= max(GOOD, BARELY) * setting.alone:
        return True
    return idle >= (1 if _nearly(setting, best) and here.clear else PATIENCE)


def _nearly(setting: Setting, best: Evaluation) -> bool:
    """Return whether curves are clear and NEARLY as fast as single flights, where that matters."""
    fast = best.duration <= NEARLY * setting.alone
    return best.clear and fast and setting.task.duration is None


def _merit(setting: Setting, evaluation: Evaluation) -> float:
    """Return the merit of curves, smaller for better ones.

    Curves that are not clear come last. Of the others the fastest is best or, where a given
    duration is satisfied, the one nearest to the nominal curves.
    """
    given = setting.task.duration
    if not evaluation.clear:
        return UNCLEAR * (2.0 - min(evaluation.closest, 1.0))
    if given is None:
        return evaluation.duration
    if evaluation.duration > given:
        return LATE * evaluation.duration / given
    s, weights = setting.grid.quadrature
    offset = np.einsum(
        "sc,ncd->nsd", setting.grid.sampled(s), evaluation.coefficients - setting.nominal
    )
    return float(np.sum(weights[:, None] * offset**2)) / setting.size**2 / len(offset)


def _separated(setting: Setting, found: Evaluation, remark: str) -> Separated:
    duration = found.duration if setting.task.duration is None else setting.task.duration
    curves = setting.grid.curves(found.coefficients, duration)
    return Separated(curves, found.closest, setting.bound, remark)


def _last_resort(task: SeparationTask, tried: list[Evaluation], say: Progress) -> Separated:
    """Return the fastest flight slowed to the given duration, or refuse with the time it takes."""
    nearest = max(tried, key=lambda evaluation: evaluation.closest)
    note = f"no route was found from {len(tried)} guesses; the search is local: others may exist"
    if task.duration is None:
        raise InfeasibleError(nearest.broken, note)
    say("looking for a duration that would do")
    try:
        found = separate(replace(task, duration=None), say)
    except InfeasibleError:
        raise InfeasibleError(nearest.broken, note) from None
    needed = found.drones.duration
    if needed > task.duration:
        raise InfeasibleError([_too_short(task, needed, "the fastest route found takes longer")])
    return replace(found, drones=found.drones.stretched(task.duration / needed))


def _too_short(task: SeparationTask, needed: float, which: str) -> Violation:
    grain = 10.0 ** (math.floor(math.log10(needed)) - 3)  # rounded up
    enough = grain * math.ceil(needed / grain * (1.0 + 1e-9))
    remedy = f"{which}; allow {enough:.4g} s, or raise the limits"
    limit = task.duration or math.nan
    return Violation("duration", needed, limit, "max", "s", (), "", remedy)


def _silent(_: str) -> None:
    pass


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


def evaluate(setting: Setting, coefficients: Array) -> Evaluation:
    """Return the evaluation of curves, by the certificate's bounds that hold at every time."""
    task = setting.task
    duration = needed_duration(setting, setting.grid.curves(coefficients, 1.0))
    curves = setting.grid.curves(coefficients, duration)
    checks = _checks(task, curves)
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
    found = [RULE_OF[name].check(motion) for name in ("separation", "arena", "keep_out")]
    found.append(_span(task, curves, swarm))

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

    return [named(check) for check in found if check is not None]


def needed_duration(setting: Setting, unit: PiecewisePolynomial) -> float:
    """Return the shortest duration in which curves, given over 1 s, keep all limits [s]."""
    factors = []
    for order, cap in enumerate(setting.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    duration = max(*factors, IDLE) * STRETCH
    limits = setting.task.requirements.limits
    return turning_stretch(Swarm(setting.task.drones), limits.body_rate, (unit,), duration)


def _span(task: SeparationTask, curves: PiecewisePolynomial, swarm: Swarm) -> Check | None:
    """Return the check of the tethers' lengths; None without tethers."""
    if not task.tethers:
        return None
    first, second, longest = task.tether_arrays
    x = curves.coefficients
    offsets = (x[:, first] - x[:, second]) / longest[:, None, None]
    size = float(np.max(np.abs(x))) / float(np.min(longest))
    found = largest_rate(PiecewisePolynomial(curves.breaks, offsets), 0, 1.0)
    pair = tuple(swarm.drone_names[ends[found.item]] for ends in (first, second))
    worst = found.worst + ROUNDING * size
    return Check.of("span", worst, 1.0, "max", "ratio", found.time, pair, size)


def check_ends(task: SeparationTask) -> None:
    """Raise InfeasibleError where starts or goals are too close, outside or within a prism."""
    ends = (task.start, "at the start (t = 0)"), (task.goal, "at the goals (the plan's end)")
    found = [
        check.violation(when, "move the drones named there, or ease the limit")
        for points, when in ends
        for check in _checks(task, PiecewisePolynomial.constant([0.0, 1.0], points))
        if not check.holds
    ]
    if found:
        raise InfeasibleError(found)
