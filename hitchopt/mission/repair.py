"""Repair: the smallest changes that make a problem feasible, each verified by planning it.

Knobs that can repair all that binds are tried in the order of the size of their change; successful
changes are narrowed down by bisection. Without such a knob, the search takes those that repair a
part of the violations, and repairs the rest in the same way.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    InputError,
    OneLine,
    Progress,
    TimeIsUp,
    UnitWarning,
    contained,
    time_left,
)
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.mission.alternatives import (
    retuning_changes,
    rim_changes,
    roll_changes,
    spread_changes,
    unit_change,
    vertex_changes,
)
from hitchopt.mission.changes import Change, broken_constraints, change_of, constraint_name, size_of
from hitchopt.mission.knobs import SPACE_CHECKS, knobs_of, two_cable_tension
from hitchopt.mission.problem import Problem
from hitchopt.mission.solving import UNPLANNED, solve_problem
from hitchopt.motion.motion import HoldBy
from hitchopt.planners.carrying.polygons import EDGE_MARGIN
from hitchopt.planners.fitting import separating_cables
from hitchopt.planners.grasps import shortest_judge
from hitchopt.planners.routes import BEST_ROUTE
from hitchopt.steps.step import Knob

BUDGET = 18.0
"""Default time after which no further plan is started [s]: a refusal takes about 20 s."""

NO_CHANGE = "no change was found that makes it feasible"  # Message without any suggestion

SIZES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0)
"""Relative sizes of changes; each is tried for all knobs before the next one."""

LOWERING_SIZES = tuple(size / (1.0 + size) for size in (*SIZES, 9.0))
"""Relative sizes of changes that lower a quantity towards zero, by the same factors."""

COARSE_SIZES = (0.1, 0.25, 0.6, 1.5)
"""Relative sizes of changes of problems whose plans take long."""

COARSE_LOWERING = tuple(size / (1.0 + size) for size in COARSE_SIZES)
"""Relative sizes of changes that lower a quantity of such problems towards zero."""

QUICK_SHARE = 0.2
"""Share of the time for small changes: if none succeeds in it, COARSE_SIZES are tried."""

SIZE_DECIMALS = 6  # Decimals within which sizes tie
RESOLUTION = 0.005  # Tolerance of the bisection, relative to the new value

MAX_SIZE_RATIO = 4.0
"""Maximum ratio of a suggestion's size to the smallest one."""

MAX_SUGGESTIONS = 3
"""Maximum number of suggestions."""

MAX_GROWTH = 20.0
"""Largest increase of a length in suggestions, over its value or extent: if more is needed, another
value is wrong."""

MAX_CHANGES = 3
"""Maximum number of changes in one suggestion."""

MAX_ROUNDS = 2 * MAX_CHANGES
"""Maximum number of changes in one suggestion if several changes of one quantity count each."""

PULL_SHARE = 0.9
"""Largest tension of suggestions over the largest horizontal pull, since motion needs more."""

ROUTE_BUDGET = 12.0  # The same where each plan needs a search for routes [s]

ROUTE_SIZES = (0.05, 0.2, 0.5)
"""Relative sizes of changes that are tried with the optimiser, where no route was found."""

BETWEEN = (0.25, 0.5, 0.75)
"""Fractions of the straight path between two polygons at which legs are separated as well."""


@dataclass(frozen=True, eq=False)
class Suggestion(OneLine):
    """A change with which the problem has a certified plan, and the plan's duration [s]."""

    change: Change
    duration: float

    def __str__(self) -> str:
        return f"suggested change: {self.change}, verified: plan of {self.duration:.3g} s certified"

    def to_dict(self) -> dict[str, object]:
        """Return the suggestion as plain values, for JSON."""
        return {**self.change.to_dict(), "duration": self.duration, "message": str(self)}


Verdict = Suggestion | frozenset[str]
"""A suggestion if the change leads to a certified plan, else the violated constraints, if known."""

UNMOVED = frozenset({"unmoved"})
"""Verdict of a change without effect on the constraints that it might repair."""

RELATIVE_TOLERANCE = 1e-3
"""Largest relative change of values that count as unmoved."""

Evaluator = Callable[[Change | None], Verdict | None]
"""Returns the verdict of a change; None without a change, or if time is up."""


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
    plan is started. Unusual values among the trials cause no warnings. A fault of the search ends
    it with a warning; what it has found until then is returned.
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
        self._problem, self._error, self._progress, self._end = problem, error, progress, end
        self._max_changes, self._already_changed = max_changes, already_changed
        start = time.monotonic()
        self._half = 0.5 * (start + end)  # end of the search for single changes
        self._quick_end = start + QUICK_SHARE * (end - start)  # end of that for small ones
        self._broken, self._faults = broken_constraints(error), _faults(error)
        self._errors, self._verdicts = dict[str, InfeasibleError](), dict[Any, Verdict]()
        self._partial: list[Change] = []  # changes that repair all faults but cause others

    def _verdict_of(self, change: Change | None, *, optimiser: bool = False) -> Verdict | None:
        """Return the verdict of a change; None if time is up."""
        combines = self._partial and not self._succeeded and self._max_changes > 1
        end = self._half if combines else self._end
        if change is None or time.monotonic() >= end or time_left() <= 0.0:
            return None
        key = str(change), optimiser
        if key not in self._verdicts:
            self._verdicts[key] = self._evaluate(change, optimiser)
        return self._verdicts[key]

    @property
    def _succeeded(self) -> bool:
        """Return whether a change has led to a certified plan."""
        return any(isinstance(each, Suggestion) for each in self._verdicts.values())

    def _quick_verdict_of(self, change: Change | None) -> Verdict | None:
        """Return the verdict of a change; None if none has succeeded in the time of small ones."""
        in_time = self._succeeded or time.monotonic() < self._quick_end
        return self._verdict_of(change) if in_time else None

    def _evaluate(self, change: Change, optimiser: bool) -> Verdict:
        if self._progress is not None:
            self._progress(f"trying {change}")
        try:
            plan = solve_problem(change.problem, optimiser=optimiser)
        except InfeasibleError as error:
            self._errors[str(change)], remaining = error, _faults(error)
            if not self._faults.keys() & remaining.keys():
                self._partial.append(change)
            covered = [fault for fault in self._faults if fault[0] in change.covers]
            pairs = [(remaining.get(x, np.inf), self._faults[x]) for x in covered]
            unmoved = covered and all(np.allclose(*x, rtol=RELATIVE_TOLERANCE) for x in pairs)
            return UNMOVED if unmoved else broken_constraints(error)
        except (HitchoptError, TimeIsUp):  # larger changes may still succeed
            return frozenset()
        return Suggestion(change, plan.flight.duration)

    def _partial_verdict(self, covered: frozenset[str], change: Change | None) -> Verdict | None:
        """Return the verdict; a change that repairs the covered faults counts as a suggestion.

        It may reveal other faults, but must not worsen any, nor cause one at an earlier step.
        """
        verdict = self._verdict_of(change)
        if change is None or (error := self._errors.get(str(change))) is None:
            return verdict
        if isinstance(verdict, Suggestion) or verdict == UNMOVED:
            return verdict
        before, after = self._faults, _faults(error)
        shared = after.keys() & before.keys()
        unrepaired = {fault for fault in shared if fault[0] in covered}
        slack = {x: RELATIVE_TOLERANCE * abs(before[x][0]) for x in shared - unrepaired}
        worse = any(after[x][0] < before[x][0] - slack[x] for x in slack)
        first, first_before = (min((step for _, step in x), default=-1) for x in (after, before))
        if worse or first < first_before:
            return verdict
        return frozenset() if unrepaired else Suggestion(change, math.nan)

    @property
    def found(self) -> tuple[Suggestion, ...]:
        """The smallest of the single changes that have succeeded so far, not narrowed down."""
        return _smallest(each for each in self._verdicts.values() if isinstance(each, Suggestion))

    def suggestions(self) -> tuple[Suggestion, ...]:
        """Return up to three suggestions, smallest first."""
        problem, error, broken = self._problem, self._error, self._broken
        changed, max_changes = self._already_changed, self._max_changes
        if not changed and isinstance(
            in_units := self._verdict_of(unit_change(problem)), Suggestion
        ):
            return (in_units,)
        knobs = [x for x in knobs_of(problem, error.violations) if max_changes or x.key in changed]
        sufficient = [knob for knob in knobs if broken <= knob.covers]
        if any(BEST_ROUTE in each.when for each in error.violations):
            return _smallest(self._rerouted(sufficient))
        changes = list[Change]()
        if max_changes and broken <= SPACE_CHECKS | {"crossing", "arena"}:
            changes += spread_changes(problem)
        if max_changes:
            changes += [*rim_changes(problem, error.violations), *retuning_changes(problem)]
        verdicts = map(self._verdict_of, changes)
        suggestions = [each for each in verdicts if isinstance(each, Suggestion)]
        suggestions += self._fitted(knobs)
        done = {(each.change.key, each.change.relative > 0.0) for each in suggestions}
        sufficient = [knob for knob in sufficient if (knob.key, knob.sign > 0) not in done]
        suggestions += self._single_changes(sufficient)
        if not suggestions and error.note.partition(UNPLANNED)[0]:  # the optimiser may help
            evaluate = partial(self._verdict_of, optimiser=True)
            suggestions = _smallest_changes(problem, sufficient, evaluate)
        if not suggestions and max_changes > (0 if changed else 1):
            suggestions = self._combinations(knobs)
        return _smallest(suggestions)

    def _single_changes(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of single changes, by coarser sizes if plans take long."""
        suggestions = _smallest_changes(self._problem, knobs, self._quick_verdict_of)
        if suggestions or time.monotonic() < self._quick_end:
            return suggestions
        self._half = self._end  # combined changes would take even longer
        evaluate = partial(self._verdict_of, optimiser=True)  # as the problem itself was planned
        return _smallest_changes(self._problem, knobs, evaluate, coarse=True)

    def _rerouted(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions with which the optimiser finds a route, one per quantity."""
        problem, violations = self._problem, self._error.violations
        self._end = min(self._end, time.monotonic() + ROUTE_BUDGET)
        changes: list[Change | None] = [change_of(problem, knob, ROUTE_SIZES[0]) for knob in knobs]
        changes += roll_changes(problem)
        changes += vertex_changes(problem, violations)
        changes += [change_of(problem, knob, size) for size in ROUTE_SIZES[1:] for knob in knobs]
        suggestions = dict[str, Suggestion]()
        for change in changes:
            if change is None or change.key in suggestions:
                continue
            verdict = self._verdict_of(change, optimiser=True)
            if isinstance(verdict, Suggestion):
                suggestions[change.key] = verdict
            out_of_time = verdict is None
            if out_of_time or len(suggestions) >= MAX_SUGGESTIONS:
                break
        return [*suggestions.values()]

    def _fitted(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of cable lengths and tensions that statics suggest.

        Changes that repair a part are combined with others, if no single one suffices.
        """
        suggestions, partial_changes = list[Suggestion](), list[Change]()
        useful = [knob for knob in knobs if knob.covers & self._broken]
        for knob, size in fitted_sizes(self._problem, useful):
            change = change_of(self._problem, knob, size)
            if change is None or change.key in {each.change.key for each in suggestions}:
                continue
            verdict = self._partial_verdict(knob.covers & self._broken, change)
            if not isinstance(verdict, Suggestion):
                continue
            if str(change) in self._errors:
                partial_changes.append(change)
            else:
                task = self._problem, knob, 0.0, size, verdict, self._verdict_of
                suggestions.append(_bisect(*task))
        if suggestions or self._max_changes <= (0 if self._already_changed else 1):
            return suggestions
        for change in partial_changes:
            if completed := self._completions(change):
                return completed
        return []

    def _combinations(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of combined changes, starting with changes that repair most."""
        broken, suggestions = self._broken, list[Suggestion]()

        def priority(change: Change) -> tuple[bool, float]:
            """Return whether a larger change of the quantity may be enough, and its size."""
            remaining = broken_constraints(self._errors[str(change)])
            return remaining <= change.covers, change.size

        if self._partial:
            suggestions += self._completions(min(self._partial, key=priority))
        parts = {broken & knob.covers for knob in knobs} - {frozenset()}
        for covered in sorted(parts, key=lambda part: (-len(part), sorted(part))):
            if suggestions:
                break
            candidates = [knob for knob in knobs if broken & knob.covers == covered]
            evaluate = partial(self._partial_verdict, covered)
            for first in _smallest_changes(self._problem, candidates, evaluate, 1):
                is_partial = str(first.change) in self._errors
                suggestions += self._completions(first.change) if is_partial else [first]
        return suggestions

    def _completions(self, first: Change) -> list[Suggestion]:
        """Return suggestions that combine a first change with changes that repair the rest."""
        changed, error = self._already_changed, self._errors[str(first)]
        if len(changed) >= MAX_ROUNDS:
            return []
        limits = self._max_changes - (first.key not in changed), (*changed, first.key)
        rest = _Search(first.problem, error, self._end, self._progress, *limits).suggestions()
        return [replace(each, change=each.change.after(first)) for each in rest]


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


def _faults(error: InfeasibleError) -> dict[tuple[str, int], tuple[float, float]]:
    """Return values, negated for upper limits, and limits by constraint and step."""
    faults = dict[tuple[str, int], tuple[float, float]]()
    for each in error.violations:
        step, value = re.search(r"step (\d+)", each.when), each.value
        fault = constraint_name(each), int(step[1]) if step else -1
        faults.setdefault(fault, (-value if each.sense == "max" else value, each.limit))
    return faults


def _smallest_changes(
    problem: Problem,
    knobs: Sequence[Knob],
    evaluate: Evaluator,
    count: int = MAX_SUGGESTIONS,
    *,
    coarse: bool = False,
) -> list[Suggestion]:
    """Return at most ``count`` of the smallest changes of knobs that succeed.

    Minimum sizes are tried first; then each size is tried for all knobs before the next one.
    """
    suggestions, spent, failed = list[Suggestion](), set[int](), [x.min_size for x in knobs]
    trials, last = list[tuple[float, int, float]](), 0.0
    for i, knob in enumerate(knobs):
        for size in _sizes(knob, coarse=coarse):
            rank = size_of(knob.sign * size, is_factor=knob.extent is None)
            trials.append((0.0 if size == knob.min_size else rank, i, size))
    for rank, i, size in sorted(trials):
        smallest = min((s.change.size for s in suggestions), default=math.inf)
        if rank > last and (len(suggestions) >= count or last >= MAX_SIZE_RATIO * smallest):
            break
        last, knob = rank, knobs[i]
        if i in spent:
            continue
        verdict = evaluate(change_of(problem, knob, size))
        if isinstance(verdict, Suggestion):
            suggestions.append(_bisect(problem, knob, failed[i], size, verdict, evaluate))
            spent.add(i)
            if count == 1:
                break
        # Larger changes would worsen violations that the knob does not cover.
        elif verdict == UNMOVED or (rank > 0.0 and (verdict is None or not verdict <= knob.covers)):
            spent.add(i)
        failed[i] = size
    return suggestions


def _sizes(knob: Knob, *, coarse: bool) -> list[float]:
    """Return the sizes to try in order, starting at the minimum size if it is known."""
    raising, lowering = (COARSE_SIZES, COARSE_LOWERING) if coarse else (SIZES, LOWERING_SIZES)
    sizes = raising if knob.sign > 0 or knob.extent else lowering
    larger = [size for size in sizes if size > knob.min_size] or [2.0 * knob.min_size]
    trials = [knob.min_size, *larger] if knob.min_size else larger
    return sorted({min(size, knob.max_size) for size in trials})


def _bisect(
    problem: Problem, knob: Knob, failed: float, size: float, best: Suggestion, evaluate: Evaluator
) -> Suggestion:
    """Return the smallest change between a size that failed and one that succeeded."""
    while size - failed > RESOLUTION * (1.0 + size):
        middle = 0.5 * (failed + size)
        change = change_of(problem, knob, middle)
        rounds_to_last = change is not None and change.new == best.change.new
        verdict = best if rounds_to_last else evaluate(change)
        if verdict is None:
            break
        if isinstance(verdict, Suggestion):
            size, best = middle, verdict
        else:
            failed = middle
    return best


# Cable lengths and tensions that statics suggest, as ``hitchopt fit`` does.


def fitted_sizes(problem: Problem, knobs: Sequence[Knob]) -> Iterator[tuple[Knob, float]]:
    """Yield knobs of all cables and tensions with relative sizes that statics suggest.

    Smaller changes come first, in both directions.
    """
    team, fitted = problem.team, list[tuple[str, float]]()
    if any(knob.key == "team.tension" for knob in knobs):
        pull = min(kind.level_pull(problem.limits.tilt)[0] for kind in team.quadrotor)
        tensions = min(kind.tension for kind in team.quadrotor), PULL_SHARE * pull
        smallest = two_cable_tension(problem)
        suitable = [value for value in tensions if value > 0.0 and value >= smallest]
        ratios = [value / float(np.max(team.tension)) for value in suitable]
        fitted += [("team.tension", ratio) for ratio in ratios]
    if any(knob.key == "team.cable_length" for knob in knobs):
        longest = float(np.max(team.cable_length))
        fitted += [("team.cable_length", value / longest) for value in fitting_cables(problem)]
    for key, ratio in sorted(fitted, key=lambda each: size_of(each[1] - 1.0, is_factor=True)):
        sign = 1 if ratio > 1.0 else -1
        size = abs(ratio - 1.0)
        for knob in knobs:
            least = max(knob.min_size, RESOLUTION)
            if (knob.key, knob.sign) == (key, sign) and size >= least:
                yield knob, size


def fitting_cables(problem: Problem) -> list[float]:
    """Return lengths of the longest cable [m] that fit the problem's polygons and held objects.

    Legs are separated on all polygons of the file, convex ones on the straight path between them
    and those below rims. For objects to be gripped, only the lengths that grip them are returned.
    """
    mission, team = problem.teams[""], problem.team
    requirements, outline = mission.requirements.with_reserve, mission.start_outline
    if team.robots == 2:
        return []
    outlines, lengths = [] if outline is None else [outline], list[float]()
    for step in mission.steps:
        after = step.checked_polygon_after(team, outline)
        if outline and after and vars(step).get("polygon"):
            outlines += _outlines_between(outline, after)
        outlines += [after] if after else []
        outline = after
    for name in dict.fromkeys(vars(step).get("object", "") for step in mission.steps):
        if name:
            found = _cables_around(problem, name)
            outlines += found[0]
            lengths += found[1]
    if outlines and not lengths:
        lengths += separating_cables(outlines, requirements, team)
    return lengths


def _outlines_between(first: Outline, last: Outline) -> list[Outline]:
    """Return the convex outlines on the straight path between two, at the shares BETWEEN."""
    outlines = list[Outline]()
    for share in BETWEEN:
        points = (1.0 - share) * first.vertices + share * last.vertices
        with contextlib.suppress(InputError):
            outlines.append(type(last)(points))
    return outlines


def _cables_around(problem: Problem, name: str) -> tuple[list[Outline], list[float]]:
    """Return lengths [m] of cables that carry an object, or outlines to rest on if none does."""
    mission, team, body = problem.teams[""], problem.team, problem.objects[name]
    requirements = mission.requirements.with_reserve
    gap = requirements.separation.object + EDGE_MARGIN
    try:
        if body.rim is not None:
            judge = shortest_judge(name, team, requirements, HoldBy.REST, gap, body.mass)
            if judge.carries(body.mass):
                return [], [float(judge.team.cable_length[0])]
            polygons = judge.planner.state.polygons
            return [ConvexPolygon(each) for each in (polygons.around, polygons.clasps)], []
        judge = shortest_judge(name, team, requirements, HoldBy.GRIP, gap, body.mass)
        return [], [float(judge.team.cable_length[0])]
    except HitchoptError:  # nothing is known of the object's polygons
        return [], []
