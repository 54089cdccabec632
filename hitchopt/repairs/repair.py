"""Repair: the smallest changes that make a problem feasible, each verified by planning it.

Knobs that can repair all that binds are tried in the order of the size of their change; successful
changes are narrowed down by bisection. Without such a knob, the search takes those that repair a
part of the violations, and repairs the rest in the same way.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from hitchopt.checks.arena import ARENA
from hitchopt.errors import (
    InfeasibleError,
    OneLine,
    Progress,
    Reason,
    UnitWarning,
    contained,
    time_left,
)
from hitchopt.mission import MAX_SUGGESTIONS
from hitchopt.mission.problem import Problem
from hitchopt.repairs.alternatives import (
    retuning_changes,
    rim_changes,
    roll_changes,
    spread_changes,
    unit_change,
    vertex_changes,
)
from hitchopt.repairs.changes import Change, broken_constraints, change_of, size_of
from hitchopt.repairs.fitted_values import fitted_sizes
from hitchopt.repairs.knobs import SPACE_CHECKS, knobs_of
from hitchopt.repairs.trials import Trial, faults_of
from hitchopt.steps.knob import Knob
from hitchopt.values import known

BUDGET = 18.0  # Default time after which no further plan is started [s]: a refusal takes about 20 s

TRIAL_SHARE = 1.0 / 3.0
"""Share of this time after which the plan of a change is given up: others may be found at once."""


SIZES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0)
"""Relative sizes of changes; each is tried for all knobs before the next one."""

LOWERING_SIZES = tuple(size / (1.0 + size) for size in (*SIZES, 9.0))
"""Relative sizes of changes that lower a quantity towards zero, by the same factors."""

COARSE_SIZES = (0.1, 0.25, 0.6, 1.5)  # Relative sizes of changes of problems whose plans take long

COARSE_LOWERING = tuple(size / (1.0 + size) for size in COARSE_SIZES)
"""Relative sizes of changes that lower a quantity of such problems towards zero."""

QUICK_SHARE = 0.2
"""Share of the time for small changes: if none succeeds in it, COARSE_SIZES are tried."""

SIZE_DECIMALS = 6  # Decimals within which sizes tie
RESOLUTION = 0.005  # Tolerance of the bisection, relative to the new value

MAX_SIZE_RATIO = 4.0  # Maximum ratio of a suggestion's size to the smallest one

MAX_GROWTH = 20.0
"""Largest increase of a length in suggestions, over its value or extent: if more is needed, another
value is wrong."""

MAX_CHANGES = 3  # Maximum number of changes in one suggestion

MAX_ROUNDS = 2 * MAX_CHANGES
"""Maximum number of changes in one suggestion if several changes of one quantity count each."""

ROUTE_BUDGET = 12.0  # The same where each plan needs a search for routes [s]

ROUTE_SIZES = (0.05, 0.2, 0.5)
"""Relative sizes of changes that are tried with the optimiser, where no route was found."""


@dataclass(frozen=True, eq=False)
class Suggestion(OneLine):
    """A change with which the problem has a certified plan, and the plan's duration [s]."""

    change: Change
    duration: float

    @classmethod
    def of(cls, trial: Trial) -> Suggestion:
        """Return a certified trial as a suggestion."""
        return cls(trial.change, known(trial.duration))

    def __str__(self) -> str:
        return f"suggested change: {self.change}, verified: plan of {self.duration:.3g} s certified"

    def to_dict(self) -> dict[str, object]:
        """Return the suggestion as plain values, for JSON."""
        return {**self.change.to_dict(), "duration": self.duration, "message": str(self)}


Attempt = Callable[[Change | None], Trial | None]
"""Returns the trial of a change; None without a change, or if time is up."""


def find_suggestions(
    problem: Problem,
    error: InfeasibleError,
    budget: float = BUDGET,
    progress: Progress | None = None,
) -> tuple[Suggestion, ...]:
    """Return up to three changes that make a problem feasible, smallest first.

    Each has been planned and certified. If no single change is enough, up to MAX_CHANGES are
    combined. The search is a heuristic: smaller changes may exist, and an empty result does not
    prove that there are none. ``error`` is that of the problem; after ``budget`` [s] no further
    plan is started, and a plan that takes TRIAL_SHARE of it is given up. Unusual values among the
    trials cause no warnings. A fault of the search ends it with a warning; what it has found until
    then is returned.
    """
    search = _Search(problem, error, time.monotonic() + budget, progress, MAX_CHANGES)
    with contained("the search for changes"), warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitWarning)
        return search.suggestions()
    return search.found


class _Search:
    """Search for suggestions of at most ``max_changes`` changes, until ``end`` on the clock [s].

    Quantities that are ``already_changed`` may be changed further and do not count.
    """

    def __init__(
        self,
        problem: Problem,
        error: InfeasibleError,
        end: float,
        progress: Progress | None,
        max_changes: int,
        already_changed: tuple[str, ...] = (),
    ) -> None:
        start = time.monotonic()
        self._problem = problem
        self._error = error
        self._broken = broken_constraints(error)
        self._faults = faults_of(error)
        self._progress = progress
        self._end = end
        self._seconds = TRIAL_SHARE * (end - start)
        self._end_of_single = 0.5 * (start + end)  # of changes, once others can be combined
        self._end_of_small = start + QUICK_SHARE * (end - start)
        self._max_changes = max_changes
        self._already_changed = already_changed
        self._trials = dict[tuple[str, bool], Trial]()

    @property
    def _combines(self) -> bool:
        """Return whether it may combine changes."""
        return self._max_changes > (0 if self._already_changed else 1)

    @property
    def _succeeded(self) -> bool:
        """Return whether a change has led to a certified plan."""
        return any(trial.certified for trial in self._trials.values())

    @property
    def _repairing_all(self) -> list[Trial]:
        """The trials that repair all faults but cause others."""
        return [trial for trial in self._trials.values() if trial.repairs_all]

    def _trial(self, change: Change | None, *, optimiser: bool = False) -> Trial | None:
        """Return the trial of a change; None without a change, or if time is up."""
        combines = self._repairing_all and not self._succeeded and self._max_changes > 1
        end = self._end_of_single if combines else self._end
        if change is None or time.monotonic() >= end or time_left() <= 0.0:
            return None
        plain = self._trials.get((str(change), False))
        if plain is not None and plain.given_up:  # the optimiser takes even longer
            return plain
        key = str(change), optimiser
        if key not in self._trials:
            if self._progress is not None:
                self._progress(f"trying {change}")
            self._trials[key] = Trial.of(
                change, self._faults, optimiser=optimiser, seconds=self._seconds
            )
        return self._trials[key]

    def _quick_trial(self, change: Change | None) -> Trial | None:
        """Return the trial of a change; None if none has succeeded in the time of small ones."""
        in_time = self._succeeded or time.monotonic() < self._end_of_small
        return self._trial(change) if in_time else None

    @property
    def found(self) -> tuple[Suggestion, ...]:
        """The smallest of the single changes that have succeeded so far, not narrowed down."""
        return _smallest(Suggestion.of(trial) for trial in self._trials.values() if trial.certified)

    def suggestions(self) -> tuple[Suggestion, ...]:
        """Return up to three suggestions, smallest first."""
        problem = self._problem
        violations = self._error.violations
        changed = self._already_changed
        may_add = self._max_changes > 0
        if not changed:
            in_units = self._trial(unit_change(problem))
            if in_units is not None and in_units.certified:
                return (Suggestion.of(in_units),)
        knobs = [x for x in knobs_of(problem, violations) if may_add or x.key in changed]
        sufficient = [knob for knob in knobs if self._broken <= knob.covers]
        if any(violation.reason is Reason.NO_ROUTE for violation in violations):
            return _smallest(self._rerouted(sufficient))
        suggestions = list[Suggestion]()
        if may_add:
            trials = map(self._trial, self._alternatives())
            suggestions += [Suggestion.of(each) for each in trials if each and each.certified]
        suggestions += self._fitted(knobs)
        done = {(each.change.key, each.change.relative > 0.0) for each in suggestions}
        sufficient = [knob for knob in sufficient if (knob.key, knob.sign > 0) not in done]
        suggestions += self._single_changes(sufficient)
        if not suggestions and self._error.note:  # the optimiser may help
            suggestions += self._smallest_of(sufficient, partial(self._trial, optimiser=True))
        if not suggestions and self._combines:
            suggestions += self._combinations(knobs)
        return _smallest(suggestions)

    def _alternatives(self) -> Iterator[Change]:
        """Yield changes other than of one number."""
        if self._broken <= SPACE_CHECKS | {"crossing", "arena"}:
            yield from spread_changes(self._problem)
        yield from rim_changes(self._problem, self._error.violations)
        yield from retuning_changes(self._problem)

    def _single_changes(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of single changes, by coarser sizes if plans take long."""
        suggestions = self._smallest_of(knobs, self._quick_trial)
        if suggestions or time.monotonic() < self._end_of_small:
            return suggestions
        self._end_of_single = self._end  # combined changes would take even longer
        as_planned = partial(self._trial, optimiser=True)
        return self._smallest_of(knobs, as_planned, coarse=True)

    def _smallest_of(
        self, knobs: Sequence[Knob], attempt: Attempt, *, coarse: bool = False
    ) -> list[Suggestion]:
        """Return suggestions of the smallest changes of knobs."""
        smallest = _KnobSearch(self._problem, attempt).smallest(knobs, coarse=coarse)
        return [Suggestion.of(trial) for trial in smallest]

    def _rerouted(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions with which the optimiser finds a route, one per quantity."""
        problem = self._problem
        self._end = min(self._end, time.monotonic() + ROUTE_BUDGET)
        changes: list[Change | None] = [change_of(problem, knob, ROUTE_SIZES[0]) for knob in knobs]
        changes += roll_changes(problem)
        changes += vertex_changes(problem, self._error.violations)
        changes += [change_of(problem, knob, size) for size in ROUTE_SIZES[1:] for knob in knobs]
        suggestions = dict[str, Suggestion]()
        for change in changes:
            if change is None or change.key in suggestions:
                continue
            trial = self._trial(change, optimiser=True)
            if trial is None:
                break
            if trial.certified:
                suggestions[change.key] = Suggestion.of(trial)
            if len(suggestions) >= MAX_SUGGESTIONS:
                break
        return [*suggestions.values()]

    def _fitted(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of cable lengths and tensions of statics, which know no walls.

        Changes that repair a part are combined with others, if no single one suffices.
        """
        search = _KnobSearch(self._problem, self._trial)
        certified = dict[str, Trial]()
        partly = list[Trial]()
        useful = [knob for knob in knobs if knob.covers & self._broken - {ARENA.name}]
        for knob, size in fitted_sizes(self._problem, useful):
            if knob.key in certified:
                continue
            trial = self._trial(change_of(self._problem, knob, size))
            if trial is None:
                continue
            if trial.certified:
                certified[knob.key] = search.narrowed(knob, 0.0, size, trial)
            elif trial.repairs_part:
                partly.append(trial)
        if certified:
            return [Suggestion.of(trial) for trial in certified.values()]
        completions = map(self._completions, partly if self._combines else ())
        return next(filter(None, completions), [])

    def _combinations(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of combined changes, starting with changes that repair most."""

        def priority(trial: Trial) -> tuple[bool, float]:
            """Return whether a larger change of the quantity may be enough, and its size."""
            return trial.covers_rest, trial.change.size

        search = _KnobSearch(self._problem, self._trial, for_part=True)
        suggestions = list[Suggestion]()
        if self._repairing_all:
            suggestions += self._completions(min(self._repairing_all, key=priority))
        parts = {self._broken & knob.covers for knob in knobs} - {frozenset()}
        for covered in sorted(parts, key=lambda part: (-len(part), sorted(part))):
            if suggestions:
                break
            alike = [knob for knob in knobs if self._broken & knob.covers == covered]
            for trial in search.smallest(alike, count=1):
                is_complete = trial.certified
                suggestions += [Suggestion.of(trial)] if is_complete else self._completions(trial)
        return suggestions

    def _completions(self, first: Trial) -> list[Suggestion]:
        """Return suggestions that combine a first change with changes that repair the rest."""
        changed = self._already_changed
        if first.error is None or len(changed) >= MAX_ROUNDS:
            return []
        change = first.change
        rest = _Search(
            change.problem,
            first.error,
            self._end,
            self._progress,
            self._max_changes - (change.key not in changed),
            (*changed, change.key),
        )
        return [
            replace(suggestion, change=suggestion.change.after(change))
            for suggestion in rest.suggestions()
        ]


def _smallest(suggestions: Iterable[Suggestion]) -> tuple[Suggestion, ...]:
    """Return up to three suggestions, smallest first, none that adds changes to a smaller one.

    Those with a length that grows by more than MAX_GROWTH are left out.
    """
    plausible = (each for each in suggestions if not any(map(_is_absurd, each.change.together())))
    by_size = sorted(plausible, key=lambda s: round(s.change.size, SIZE_DECIMALS))
    smallest = list[tuple[frozenset[str], Suggestion]]()
    for each in by_size:
        keys = frozenset(change.key for change in each.change.together())
        if not any(fewer < keys for fewer, _ in smallest):
            smallest.append((keys, each))
    return tuple(each for _, each in smallest[:MAX_SUGGESTIONS])


def _is_absurd(change: Change) -> bool:
    """Return whether a change makes a length, or all lengths, grow by more than MAX_GROWTH."""
    return change.unit in {"m", "times"} and change.relative > MAX_GROWTH


@dataclass(eq=False)
class _Ladder:
    """The sizes of a knob that are tried one after the other."""

    knob: Knob  # The knob
    failed: float  # Largest size that is known to fail
    is_done: bool = False  # Whether a size succeeded, or no larger one can


@dataclass(frozen=True, eq=False)
class _KnobSearch:
    """Search for the smallest changes of knobs that succeed."""

    problem: Problem  # The problem that is changed
    attempt: Attempt  # Plans a change of it
    for_part: bool = False  # Whether a change also succeeds if it repairs the faults that it covers

    def succeeds(self, trial: Trial) -> bool:
        """Return whether a change suffices."""
        return trial.certified or (self.for_part and trial.repairs_part)

    def may_grow(self, trial: Trial) -> bool:
        """Return whether a larger change may succeed: all that still binds is covered."""
        return trial.covers_rest or (self.for_part and trial.improves)

    def smallest(
        self, knobs: Sequence[Knob], count: int = MAX_SUGGESTIONS, *, coarse: bool = False
    ) -> list[Trial]:
        """Return the trials of at most ``count`` of the smallest changes that succeed.

        Minimum sizes are tried first; then each size is tried for all knobs before the next one.
        """
        ladders = [_Ladder(knob, knob.min_size) for knob in knobs]
        rungs = list[tuple[float, int, float]]()  # rank, index of the ladder, size
        for i, knob in enumerate(knobs):
            for size in _sizes(knob, coarse=coarse):
                rank = size_of(knob.sign * size, is_factor=knob.extent is None)
                rungs.append((0.0 if size == knob.min_size else rank, i, size))
        successes = list[Trial]()
        last_rank = 0.0
        for rank, i, size in sorted(rungs):
            smallest = min((trial.change.size for trial in successes), default=math.inf)
            is_enough = len(successes) >= count or last_rank >= MAX_SIZE_RATIO * smallest
            if rank > last_rank and is_enough:
                break
            last_rank = rank
            ladder = ladders[i]
            if ladder.is_done:
                continue
            trial = self.attempt(change_of(self.problem, ladder.knob, size))
            if trial is not None and self.succeeds(trial):
                successes.append(self.narrowed(ladder.knob, ladder.failed, size, trial))
                ladder.is_done = True
                if count == 1:
                    break
            elif trial is not None and trial.is_without_effect:
                ladder.is_done = True
            elif rank > 0.0:  # not a minimum size, which may be too small for all faults
                ladder.is_done = trial is None or not self.may_grow(trial)
            ladder.failed = size
        return successes

    def narrowed(self, knob: Knob, failed: float, size: float, best: Trial) -> Trial:
        """Return the smallest change between a size that failed and the ``best`` one's, so far."""
        while size - failed > RESOLUTION * (1.0 + size):
            middle = 0.5 * (failed + size)
            change = change_of(self.problem, knob, middle)
            rounds_to_best = change is not None and change.new == best.change.new
            trial = best if rounds_to_best else self.attempt(change)
            if trial is None:
                break
            if self.succeeds(trial):
                size, best = middle, trial
            else:
                failed = middle
        return best


def _sizes(knob: Knob, *, coarse: bool) -> list[float]:
    """Return the sizes to try in order, starting at the minimum size if it is known."""
    raising, lowering = (COARSE_SIZES, COARSE_LOWERING) if coarse else (SIZES, LOWERING_SIZES)
    sizes = raising if knob.sign > 0 or knob.extent else lowering
    larger = [size for size in sizes if size > knob.min_size] or [2.0 * knob.min_size]
    trials = [knob.min_size, *larger] if knob.min_size else larger
    return sorted({min(size, knob.max_size) for size in trials})
