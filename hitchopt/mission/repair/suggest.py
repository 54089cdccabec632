"""Search for the smallest single change that makes a problem feasible."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hitchopt.errors import HitchoptError, InfeasibleError, InputError
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair.change import Change, Kind, Suggestion
from hitchopt.mission.repair.constraints import broken_constraints
from hitchopt.mission.repair.kinds import last_resorts, likely_kinds
from hitchopt.mission.repair.spreading import spread_changes
from hitchopt.mission.solving import solve_problem
from hitchopt.time_limit import Progress, TimeIsUp, time_left

BUDGET = 15.0
"""Time [s] after which no further plan is begun: a user waits for it."""

SIZES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0)
"""Relative sizes tried in turn, those of all kinds before the next size."""

RESOLUTION = 0.005
"""Resolution of the smallest size, as a share of the new value."""

FAR = 4.0
"""Times the smallest change: those that are larger still are not looked for."""

ENOUGH = 3
"""Most suggestions: more would not be read."""


NO_CHANGE = "no single change was found that makes it feasible"
"""Message where there is no suggestion."""


@dataclass(frozen=True, eq=False)
class _Verdict:
    """What the planner says of a change: its plan's duration [s], or the constraints that bind."""

    duration: float | None
    broken: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A kind of change that may do at sizes above ``failed``, the last one that did not."""

    kind: Kind
    failed: float = 0.0


class _Judge:
    """Plans changed problems, and ends the search when its time is over."""

    def __init__(self, budget: float, progress: Progress | None, *, optimiser: bool) -> None:
        self._end = time.monotonic() + budget
        self._progress = progress
        self._optimiser = optimiser

    @property
    def over(self) -> bool:
        """Whether no further plan is to be begun."""
        return time.monotonic() >= self._end or time_left() <= 0.0

    @property
    def left(self) -> float:
        """Time that is left [s]."""
        return max(0.0, self._end - time.monotonic())

    def __call__(self, change: Change) -> _Verdict:
        if self._progress is not None:
            self._progress(f"trying {change}")
        try:
            found = solve_problem(change.problem, optimiser=self._optimiser)
        except InfeasibleError as error:
            return _Verdict(None, broken_constraints(error))
        except HitchoptError:
            return _Verdict(None)  # no timing found: larger changes may do
        except TimeIsUp:
            return _Verdict(None)  # the search is over; what it has found stays
        return _Verdict(found.motion.duration)


def find_suggestions(
    problem: Problem,
    error: InfeasibleError,
    budget: float = BUDGET,
    progress: Progress | None = None,
) -> tuple[Suggestion, ...]:
    """Return up to three single changes that make a problem feasible, smallest first.

    Each has been planned and certified. They are the smallest that were found: no value between
    the last one that failed and the one suggested is known to do. None proves nothing.

    Parameters
    ----------
    problem: one that cannot be met.
    error: why not.
    budget: how long to search [s]; the last plan that was begun is waited for, up to the time
        limit within which this is called.
    progress: called with what is being tried now.
    """
    judge = _Judge(budget, progress, optimiser=False)
    found = [
        *_judged(spread_changes(problem, error), judge),
        *_smallest(likely_kinds(problem, error), judge),
    ]
    if not found:
        found = _smallest(last_resorts(problem, error), judge)
    if not found and error.note:  # the optimiser was needed and may be needed still
        slow = _Judge(judge.left, progress, optimiser=True)
        found = _smallest(likely_kinds(problem, error), slow)
    return tuple(sorted(found, key=lambda s: abs(s.change.relative))[:ENOUGH])


def _judged(changes: Iterable[Change], judge: _Judge) -> list[Suggestion]:
    """Return those changes of one size only that do."""
    found = []
    for change in changes:
        duration = None if judge.over else judge(change).duration
        if duration is not None:
            found.append(Suggestion(change, duration))
    return found


def _smallest(kinds: Sequence[Kind], judge: _Judge) -> list[Suggestion]:
    """Return the smallest changes of the kinds of which the smallest sizes do."""
    found, others = _hinted(kinds, judge)
    attempts = [_Attempt(kind, kind.least) for kind in others if _can_do(kind, judge)]
    families: set[str] = set()
    for size in SIZES:
        later = []
        for attempt in attempts:
            if judge.over:
                return found
            if attempt.kind.family in families:
                continue
            if size < attempt.kind.least and size != SIZES[-1]:
                later.append(attempt)
                continue
            outcome = _try(attempt, size, judge)
            if isinstance(outcome, Suggestion):
                found.append(outcome)
                families |= {attempt.kind.family} - {""}
            elif outcome is not None:
                later.append(outcome)
        attempts = later
        smallest = min((abs(s.change.relative) for s in found), default=math.inf)
        if len(found) >= ENOUGH or size >= FAR * smallest:
            break
    return found


def _hinted(kinds: Sequence[Kind], judge: _Judge) -> tuple[list[Suggestion], list[Kind]]:
    """Return the changes of sizes known to be needed that are enough, and the kinds left to try."""
    found: list[Suggestion] = []
    others = []
    for kind in kinds:
        change = _change(kind, kind.least) if kind.least > 0.0 and not judge.over else None
        duration = None if change is None else judge(change).duration
        if change is None or duration is None:
            others.append(kind)
        else:
            found.append(Suggestion(change, duration))
    return found, others


def _can_do(kind: Kind, judge: _Judge) -> bool:
    """Return whether a kind that takes nothing away does at its largest size."""
    if not kind.relaxes:
        return True
    change = _change(kind, _size(kind, SIZES[-1]))
    return change is not None and not judge.over and judge(change).duration is not None


def _try(attempt: _Attempt, size: float, judge: _Judge) -> Suggestion | _Attempt | None:
    """Return what a size gives: a suggestion, the attempt to go on with, or None to give up."""
    kind, failed = attempt.kind, attempt.failed
    current = _size(kind, size)
    change = _change(kind, current)
    if change is None:
        return None
    verdict = judge(change)
    if verdict.duration is not None:
        return _narrowed(kind, failed, current, Suggestion(change, verdict.duration), judge)
    if not verdict.broken <= kind.covers:
        return None  # it breaks other things, and larger ones would break them the more
    return None if current >= kind.most else _Attempt(kind, current)


def _size(kind: Kind, size: float) -> float:
    """Return the size to try in a round: one that can do, and not beyond the most."""
    return min(kind.most, max(size, 2.0 * kind.least if size < kind.least else size))


def _narrowed(
    kind: Kind, failed: float, size: float, found: Suggestion, judge: _Judge
) -> Suggestion:
    """Return the smallest change between a size that failed and one that did, by bisection."""
    while size - failed > RESOLUTION * (1.0 + size) and not judge.over:
        middle = 0.5 * (failed + size)
        change = _change(kind, middle)
        if change is None:
            break
        if change.new == found.change.new:  # rounded to the same
            size = middle
            continue
        duration = judge(change).duration
        if duration is None:
            failed = middle
        else:
            size, found = middle, Suggestion(change, duration)
    return found


def _change(kind: Kind, size: float) -> Change | None:
    """Return the change of that size, or None where there is none."""
    try:
        return kind.of_size(size)
    except InputError:  # such as an outline that a wall or a step no longer fits
        return None
