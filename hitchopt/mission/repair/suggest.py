"""Search for the smallest single change that makes a problem feasible."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.geometry import Outline
from hitchopt.hitch.cable_slack import balanced_legs
from hitchopt.mission.problem import HitchStart, Problem
from hitchopt.mission.repair.change import (
    BUDGET,
    Change,
    Edit,
    Edited,
    Kind,
    Suggestion,
    broken_constraints,
)
from hitchopt.mission.repair.editing import with_step_edit
from hitchopt.mission.repair.kinds import last_resorts, likely_kinds
from hitchopt.mission.solving import solve_problem
from hitchopt.steps.edits import SPACE, StepEdit
from hitchopt.steps.end_hitch import split_hitch
from hitchopt.steps.slack_split import RolledLegs, SlackSplit
from hitchopt.time_limit import Progress, TimeIsUp, time_left

SIZES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0)
"""Relative sizes tried in turn, those of all kinds before the next size."""

RESOLUTION = 0.005
"""Resolution of the smallest size, as a share of the new value."""

FAR = 4.0
"""Times the smallest change: those that are larger still are not looked for."""

ENOUGH = 3
"""Most suggestions: more would not be read."""


Verdict = Suggestion | frozenset[str]
"""A suggestion if a change is planned and certified, else the constraints that bind, if known."""


class _Judge:
    """Plans changed problems, and ends the search when its time is over."""

    def __init__(self, budget: float, progress: Progress | None, *, optimiser: bool) -> None:
        self._end = time.monotonic() + budget
        self._progress = progress
        self._optimiser = optimiser

    @property
    def over(self) -> bool:
        """Whether no further plan is to be begun."""
        return self.left <= 0.0 or time_left() <= 0.0

    @property
    def left(self) -> float:
        """Time that is left [s]."""
        return max(0.0, self._end - time.monotonic())

    def __call__(self, change: Change | None) -> Verdict | None:
        """Return the verdict; None where there is no change, or no time for it."""
        if change is None or self.over:
            return None
        if self._progress is not None:
            self._progress(f"trying {change}")
        try:
            found = solve_problem(change.problem, optimiser=self._optimiser)
        except InfeasibleError as error:
            return broken_constraints(error)
        except (HitchoptError, TimeIsUp):  # no timing found, or no time: larger changes may do
            return frozenset()
        return Suggestion(change, found.motion.duration)


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
    slow = _Judge(budget, progress, optimiser=True)
    kinds = likely_kinds(problem, error)
    longer = [kind for kind in kinds if error.note and kind.lasts]  # as long as a route takes
    known = _suggestions(slow(kind.change(kind.least)) for kind in longer)
    judge = _Judge(slow.left, progress, optimiser=False)
    others = [kind for kind in kinds if not (known and kind.lasts)]
    found = [
        *known,
        *_suggestions(map(judge, spread_changes(problem, error))),
        *_smallest(others, judge),
    ]
    if not found:
        found = _smallest(last_resorts(problem, error), judge)
    if not found and error.note:  # the optimiser was needed and may be needed still
        slow = _Judge(judge.left, progress, optimiser=True)
        found = _smallest(kinds, slow)
    return tuple(sorted(found, key=lambda s: abs(s.change.relative))[:ENOUGH])


def _suggestions(verdicts: Iterable[Verdict | None]) -> list[Suggestion]:
    return [verdict for verdict in verdicts if isinstance(verdict, Suggestion)]


def _smallest(kinds: Sequence[Kind], judge: _Judge) -> list[Suggestion]:
    """Return the smallest changes of the kinds of which the smallest sizes do."""
    # Sizes that are known to be needed may be enough.
    hinted = [judge(kind.change(kind.least)) if kind.least > 0.0 else None for kind in kinds]
    found = _suggestions(hinted)
    others = [k for k, v in zip(kinds, hinted, strict=True) if not isinstance(v, Suggestion)]
    attempts = [(kind, kind.least) for kind in others if _can_do(kind, judge)]
    families: set[str] = set()
    for size in SIZES:
        later = []
        for kind, failed in attempts:
            if judge.over:
                return found
            if kind.family in families:
                continue
            if size < kind.least and size != SIZES[-1]:
                later.append((kind, failed))
                continue
            current = _size(kind, size)
            verdict = judge(kind.change(current))
            if isinstance(verdict, Suggestion):
                found.append(_narrowed(kind, failed, current, verdict, judge))
                families |= {kind.family} - {""}
            # Where other things are broken larger changes would break them the more.
            elif verdict is not None and verdict <= kind.covers and current < kind.most:
                later.append((kind, current))
        attempts = later
        smallest = min((abs(s.change.relative) for s in found), default=math.inf)
        if len(found) >= ENOUGH or size >= FAR * smallest:
            break
    return found


def _can_do(kind: Kind, judge: _Judge) -> bool:
    """Return whether a kind that takes nothing away does at its largest size."""
    largest = kind.change(_size(kind, SIZES[-1])) if kind.relaxes else None
    return not kind.relaxes or isinstance(judge(largest), Suggestion)


def _size(kind: Kind, size: float) -> float:
    """Return the size to try in a round: one that can do, and not beyond the most."""
    return min(kind.most, max(size, 2.0 * kind.least if size < kind.least else size))


def _narrowed(
    kind: Kind, failed: float, size: float, found: Suggestion, judge: _Judge
) -> Suggestion:
    """Return the smallest change between a size that failed and one that did, by bisection."""
    while size - failed > RESOLUTION * (1.0 + size) and not judge.over:
        middle = 0.5 * (failed + size)
        change = kind.change(middle)
        if change is None:
            break
        verdict = found if change.new == found.change.new else judge(change)  # rounded to the same
        if isinstance(verdict, Suggestion):
            size, found = middle, verdict
        else:
            failed = middle
    return found


COVERS = SPACE | {"crossing", "arena"}


def spread_changes(problem: Problem, error: InfeasibleError) -> Iterator[Change]:
    """Yield the changes from given or balanced legs to spread ones, at the start and after steps.

    Their relative size is the farthest that a drone goes, over its cable's length.
    """
    if not broken_constraints(error) <= COVERS:
        return
    outline, start = problem.start_outline, problem.start
    places: list[tuple[str, SlackSplit, Outline, Edited]] = []
    if isinstance(start, HitchStart) and outline is not None:
        key, changed = "start.hitch.legs", replace(problem, start=replace(start, legs="spread"))
        places.append((key, start.legs, outline, Edited(changed, (Edit(key, "spread"),))))
    for i, step in enumerate(problem.mission):
        outline = step.polygon_left(problem.team, outline)
        legs = getattr(step, "legs", None)
        if legs is not None and outline is not None:
            edited = with_step_edit(problem, i, StepEdit("legs", "spread", {"legs": "spread"}))
            places.append((edited.edits[0].key, legs, outline, edited))
    for key, legs, shape, edited in places:
        sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
        if isinstance(sharing, str) and sharing == "spread":
            continue
        try:
            relative = _farthest(problem, shape, legs)
        except InfeasibleError:  # no cable is left for any legs
            continue
        words = legs if isinstance(legs, str) else "as given"
        yield Change(key, "", words, "spread", "", relative, edited.problem, edited.edits)


def _farthest(problem: Problem, outline: Outline, legs: SlackSplit) -> float:
    """Return how far a leg is from the spread ones at most, over its cable's length."""
    team = problem.team
    lengths = legs.sharing if isinstance(legs, RolledLegs) else legs
    given = balanced_legs(team, outline) if isinstance(lengths, str) else lengths
    spread = split_hitch(team, outline, 0.0, "spread", problem.requirements)
    return float(np.max(np.abs(spread.q_legs - given) / team.cable_length))
