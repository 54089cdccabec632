"""Repair: the smallest changes that make a problem feasible, each verified by planning it.

A knob is a number of the problem that can be raised or lowered. Those that can repair all that
binds are tried by the size of their change, and the ones that do are narrowed by bisection. Where
none does, those are that repair a part of it, and the rest is repaired in the same way.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import (
    HitchoptError,
    InfeasibleError,
    InputError,
    OneLine,
    Progress,
    TimeIsUp,
    Violation,
    time_left,
)
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import Quadrotor
from hitchopt.hitch.flight_controller import RETUNED, stiffest_gains
from hitchopt.hitch.requirements import Limits
from hitchopt.mission.problem import DronesStart, HitchStart, Problem
from hitchopt.mission.solving import UNPLANNED
from hitchopt.mission.teams import solve_any
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world
from hitchopt.steps.carrying import PAST, TransportObject
from hitchopt.steps.step import (
    DECIMALS,
    PLAN_DURATION,
    Edits,
    Knob,
    RolledLegs,
    checks_relaxed_by,
    outline_edit,
    points_scaled,
)
from hitchopt.steps.step import Edit as Edit  # noqa: PLC0414
from hitchopt.storage.yaml_file import split_key, with_value
from hitchopt.values import Array
from hitchopt.values.fields import keys_of

BUDGET, DIGITS = 30.0, 3
"""Time [s] after which no further plan is begun, and digits of a suggested value."""

NO_CHANGE = "no change was found that makes it feasible"
"""Message where there is no suggestion."""

SIZES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0)
"""Relative sizes in ascending order; each is tried for all knobs before the next."""

LOWERED = (*(size for size in SIZES if size < 1.0), 0.9, 0.95)
"""The same for quantities that are lowered towards zero."""

RESOLUTION = 0.005
"""Resolution of the smallest size, as a share of the new value."""

MAX_SIZE_RATIO, MAX_SUGGESTIONS, MAX_CHANGES = 4.0, 3, 3
"""Largest size of a change over the smallest one, and largest numbers of suggestions, and of
changes that are made together."""


@dataclass(frozen=True, eq=False)
class Change(OneLine):
    """One quantity of a problem changed.

    Attributes
    ----------
    key, words: path of the quantity in the problem file; what it is, where that does not tell.
    old, new, unit: its values [unit]; ``times`` for a factor, nothing for words.
    relative: size of the change over that of the quantity, with its sign; 0 for words.
    problem, edits: with the change; what to write into the problem's file for it.
    before: another change that is made with it; ``edits`` has those of both.
    covers: constraints that a larger one may repair.
    """

    key: str
    words: str
    old: float | str
    new: float | str
    unit: str
    relative: float
    problem: Problem
    edits: Edits
    before: Change | None = None
    covers: frozenset[str] = frozenset()

    def __str__(self) -> str:
        return f"{self.before} and {self._words}" if self.before else self._words

    def after(self, before: Change) -> Change:
        """Return the change of a changed problem with the change that was made before.

        Two changes of one quantity become one.
        """
        inner = before if self.before is None else self.before.after(before)
        both = replace(self, before=inner, edits=before.edits + self.edits)
        same = next((each for each in inner.together() if each.key == self.key), None)
        if same is None or not same.relative:
            return both
        first, mid, last = float(same.old), float(same.new), float(self.new)
        last = mid * last if self.unit == "times" else last
        share = same.relative * (last - first) / (mid - first)
        rest = [each for each in inner.together() if each is not same]
        chain: Change | None = None
        for each in rest:
            chain = replace(each, before=chain)
        return replace(both, old=first, new=last, relative=share, before=chain)

    def together(self) -> list[Change]:
        """Return all changes that are made, the first one first."""
        return [*(self.before.together() if self.before else ()), self]

    @property
    def size(self) -> float:
        """Size of the largest of all changes that are made."""
        return max(abs(each.relative) for each in self.together())

    def to_dict(self) -> dict[str, object]:
        """Return the change as plain values, for JSON."""
        unseen = {"problem", "words", "before", "covers"}
        plain = {k: v for k, v in vars(self).items() if k not in unseen}
        plain["edits"] = [vars(edit) for edit in self.edits]
        return plain | ({"before": self.before.to_dict()} if self.before else {})

    @property
    def _words(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        values = [v if isinstance(v, str) else f"{v:.6g}" for v in (self.old, self.new)]
        change = f"{self.key} {values[0]} -> {values[1]}{unit}"
        if not self.relative:
            return change
        words, percent = f"{self.words}, " if self.words else "", 100.0 * self.relative
        share = f"{percent:+.3g}" if abs(percent) < 999.5 else f"{percent:+.0f}"
        return f"{change} ({words}{share} %)"


@dataclass(frozen=True, eq=False)
class Suggestion(OneLine):
    """A change with which the problem is planned and certified, and how long its plan lasts [s]."""

    change: Change
    duration: float

    def __str__(self) -> str:
        return f"suggested change: {self.change}, verified: plan of {self.duration:.3g} s certified"

    def to_dict(self) -> dict[str, object]:
        """Return the suggestion as plain values, for JSON."""
        return {**self.change.to_dict(), "duration": self.duration, "message": str(self)}


Verdict = Suggestion | frozenset[str]
"""A suggestion if a change is planned and certified, else the constraints that bind, if known."""

UNMOVED, SAME = frozenset({"unmoved"}), 1e-3
"""Verdict of a change that makes no difference to what it might repair, by its share."""

Judge = Callable[[Change | None], Verdict | None]
"""Gives the verdict of a change; None where there is no change, or no time for it."""


def find_suggestions(
    problem: Problem,
    error: InfeasibleError,
    budget: float = BUDGET,
    progress: Progress | None = None,
) -> tuple[Suggestion, ...]:
    """Return up to three changes that make a problem feasible, smallest first.

    Each has been planned and certified. They are the smallest that were found: no value between
    the last one that failed and the one suggested is known to do. No result is no proof. ``error``
    says why the problem cannot be met; after ``budget`` [s] no further plan is begun. Where no
    single change does, up to MAX_CHANGES are made together.
    """
    end = time.monotonic() + budget
    return _Search(problem, error, end, progress, MAX_CHANGES).suggestions()


class _Search:
    """Suggestions of at most so many changes together, until a time on the clock [s].

    Quantities that were changed already, ``made``, may be changed further besides.
    """

    def __init__(
        self,
        problem: Problem,
        error: InfeasibleError,
        end: float,
        progress: Progress | None,
        most: int,
        made: frozenset[str] = frozenset(),
    ) -> None:
        self._problem, self._error, self._most, self._made = problem, error, most, made
        self._progress, self._end = progress, end
        self._half = 0.5 * (time.monotonic() + end)  # then more changes are made together
        self._broken, self._faults = broken_constraints(error), _faults(error)
        self._refusals, self._verdicts = dict[str, InfeasibleError](), dict[Any, Verdict]()
        self._others: list[Change] = []  # that repair all these faults, where others are left

    def _alone(self, change: Change | None, *, optimiser: bool = False) -> Verdict | None:
        """Return the verdict of a change by itself; None if there is no time for it."""
        found = any(isinstance(each, Suggestion) for each in self._verdicts.values())
        until = self._half if self._others and not found and self._most > 1 else self._end
        if change is None or time.monotonic() >= until or time_left() <= 0.0:
            return None
        asked = str(change), optimiser
        if asked not in self._verdicts:
            self._verdicts[asked] = self._tried(change, optimiser)
        return self._verdicts[asked]

    def _tried(self, change: Change, optimiser: bool) -> Verdict:
        if self._progress is not None:
            self._progress(f"trying {change}")
        try:
            plan = solve_any(change.problem, optimiser=optimiser)
        except InfeasibleError as refusal:
            self._refusals[str(change)], left = refusal, _faults(refusal)
            if not self._faults.keys() & left.keys():
                self._others.append(change)
            covered = [fault for fault in self._faults if fault[0] in change.covers]
            same = (np.allclose(left.get(x, np.inf), self._faults[x], rtol=SAME) for x in covered)
            return UNMOVED if covered and all(same) else broken_constraints(refusal)
        except (HitchoptError, TimeIsUp):  # no timing found, or no time: larger changes may do
            return frozenset()
        return Suggestion(change, plan.motion.duration)

    def _partly(self, covered: frozenset[str], change: Change | None) -> Verdict | None:
        """Return the verdict, that of a change that repairs the covered faults as if it did all.

        Others may have been hidden by them, but none may get worse, nor come at an earlier step.
        """
        verdict = self._alone(change)
        if change is None or (refusal := self._refusals.get(str(change))) is None:
            return verdict
        if isinstance(verdict, Suggestion) or verdict == UNMOVED:
            return verdict
        had, left = self._faults, _faults(refusal)
        kept = {fault for fault in left if fault in had and fault[0] in covered}
        others = (fault for fault in left.keys() & had.keys() if fault not in kept)
        worse = any(left[x][0] < had[x][0] - SAME * abs(had[x][0]) for x in others)
        first, before = (min((step for _, step in each), default=-1) for each in (left, had))
        if worse or first < before:
            return verdict
        return frozenset() if kept else Suggestion(change, math.nan)

    def suggestions(self) -> tuple[Suggestion, ...]:
        """Return up to three of them, smallest first."""
        problem, error, broken, most = self._problem, self._error, self._broken, self._most
        knobs = [x for x in _knobs(problem, error.violations) if most or x.key in self._made]
        enough = [knob for knob in knobs if broken <= knob.covers]
        crowded = broken <= SPACE | {"crossing", "arena"}
        named = [*(_spread(problem) if crowded else ()), *_retuned(problem)] if most else []
        found = [each for each in map(self._alone, named) if isinstance(each, Suggestion)]
        found += _smallest(problem, enough, self._alone)
        if broken <= PAST and most and len(found) < MAX_SUGGESTIONS:
            ways = map(self._alone, _around(problem, error.violations))
            found += [way for way in ways if isinstance(way, Suggestion)][:1]
        if not found and error.note.partition(UNPLANNED)[0]:  # the optimiser may be needed still
            found = _smallest(problem, enough, partial(self._alone, optimiser=True))
        if not found and most > (0 if self._made else 1):
            found = self._together(knobs)
        return tuple(sorted(found, key=lambda s: s.change.size)[:MAX_SUGGESTIONS])

    def _together(self, knobs: Sequence[Knob]) -> list[Suggestion]:
        """Return suggestions of changes that are made together, those that repair most first."""
        broken, found = self._broken, list[Suggestion]()

        def late(change: Change) -> tuple[bool, float]:
            """Return whether a larger change of the same may do alone, and its size."""
            left = broken_constraints(self._refusals[str(change)])
            return left <= change.covers, change.size

        if self._others:
            found += self._after(min(self._others, key=late))
        parts = {broken & knob.covers for knob in knobs} - {frozenset()}
        for covered in sorted(parts, key=lambda part: (-len(part), sorted(part))):
            if found:
                break
            some = [knob for knob in knobs if broken & knob.covers == covered]
            for first in _smallest(self._problem, some, partial(self._partly, covered), 1):
                known = str(first.change) in self._refusals
                found += self._after(first.change) if known else [first]
        return found

    def _after(self, first: Change) -> list[Suggestion]:
        """Return suggestions with what repairs the rest after a first change."""
        error, fewer = self._refusals[str(first)], self._most - (first.key not in self._made)
        given = first.problem, error, self._end, self._progress, fewer, self._made | {first.key}
        rest = _Search(*given).suggestions()
        return [replace(each, change=each.change.after(first)) for each in rest]


def _faults(error: InfeasibleError) -> dict[tuple[str, int], tuple[float, float]]:
    """Return values, negative if small ones are good, and limits, by constraints and steps."""
    faults = dict[tuple[str, int], tuple[float, float]]()
    for each in error.violations:
        step, value = re.search(r"step (\d+)", each.when), each.value
        fault = _name(each), int(step[1]) if step else -1
        faults.setdefault(fault, (-value if each.sense == "max" else value, each.limit))
    return faults


def _smallest(
    problem: Problem, knobs: Sequence[Knob], judge: Judge, most: int = MAX_SUGGESTIONS
) -> list[Suggestion]:
    """Return the smallest changes of the knobs of which the smallest sizes do, at most so many.

    What is needed at the least is tried first, then all knobs with one size before the next one.
    """
    suggestions, done, failed = list[Suggestion](), set[int](), [knob.least for knob in knobs]
    sizes = [(i, size) for i, knob in enumerate(knobs) for size in _sizes(knob)]
    tries = [(0.0 if size == knobs[i].least else size, i, size) for i, size in sizes]
    last = 0.0
    for turn, i, size in sorted(tries):
        smallest = min((abs(s.change.relative) for s in suggestions), default=math.inf)
        if turn > last and (len(suggestions) >= most or last >= MAX_SIZE_RATIO * smallest):
            break
        last, knob = turn, knobs[i]
        if i in done:
            continue
        verdict = judge(change_of(problem, knob, size))
        if isinstance(verdict, Suggestion):
            suggestions.append(_narrowed(problem, knob, failed[i], size, verdict, judge))
            done.add(i)
            if most == 1:
                break
        # Where other things are broken beyond the least, larger changes would break them the more.
        elif verdict == UNMOVED or (turn > 0.0 and (verdict is None or not verdict <= knob.covers)):
            done.add(i)
        failed[i] = size
    return suggestions


def _sizes(knob: Knob) -> list[float]:
    """Return the sizes that are tried: first what is needed at the least, where that is known."""
    every = SIZES if knob.sign > 0 or knob.extent else LOWERED
    larger = [size for size in every if size > knob.least] or [2.0 * knob.least]
    sizes = [knob.least, *larger] if knob.least else larger
    return sorted({min(size, knob.most) for size in sizes})


def _narrowed(
    problem: Problem, knob: Knob, failed: float, size: float, suggestion: Suggestion, judge: Judge
) -> Suggestion:
    """Return the smallest change between a size that failed and one that did, by bisection."""
    while size - failed > RESOLUTION * (1.0 + size):
        middle = 0.5 * (failed + size)
        change = change_of(problem, knob, middle)
        same = change is not None and change.new == suggestion.change.new  # rounded to it
        verdict = suggestion if same else judge(change)
        if verdict is None:  # no change, or no time
            break
        if isinstance(verdict, Suggestion):
            size, suggestion = middle, verdict
        else:
            failed = middle
    return suggestion


def change_of(problem: Problem, knob: Knob, size: float) -> Change | None:
    """Return the change of a relative size, rounded outward; None if records refuse it."""
    extent = knob.extent or knob.old
    value = knob.old + knob.sign * size * extent
    step = 10.0 ** (math.floor(math.log10(knob.extent or abs(value))) + 1 - DIGITS)
    steps = value / step  # a value that is tidy already is not to be moved by its rounding error
    rounded = math.ceil(steps - 1e-9) if knob.sign > 0 else math.floor(steps + 1e-9)
    new = float(f"{rounded * step:.12g}")
    edits = knob.edits(new)
    try:
        changed = with_edits(problem, edits)
    except InputError:
        return None
    relative = (new - knob.old) / extent
    given = knob.key, knob.words, knob.old, new, knob.unit, relative, changed, edits
    return Change(*given, covers=knob.covers)


def with_edits(problem: Problem, edits: Edits) -> Problem:
    """Return the problem that its file describes with these edits, or raise InputError."""
    names = ("team", "start", "mission", "arena", "limits", "objects")
    parts = {name: getattr(problem, name) for name in names}
    for edit in edits:
        name, *path = re.findall(r"[^.\[\]]+", edit.key)
        if name == "start":
            del path[0]  # its kind
        elif name == "mission":
            del path[1]
        if path:
            parts[name] = _put(parts[name], path, edit.value)
        else:
            parts[name] = keys_of(Problem)[name].from_file(name, edit.value)
    return replace(problem, **parts)


def with_edits_in(text: str, edits: Edits) -> str:
    """Return the text of a problem file with edits, and all else as it is, comments too."""
    for edit in edits:
        text = with_value(text, split_key(edit.key), edit.value)  # type: ignore[arg-type]
    return text


def _put(record: Any, path: Sequence[str], value: Any) -> Any:
    """Return a record with the value at a path of a problem file's keys."""
    key, *rest = path
    if isinstance(record, tuple):
        i = int(key)
        return (*record[:i], _put(record[i], rest, value), *record[i + 1 :])
    if isinstance(record, Mapping):  # of objects, by their names
        return {**record, key: _put(record[key], rest, value)}
    known = {each.name: (name, each) for name, each in keys_of(type(record)).items()}
    name, declared = known.get(key, (key, None))
    if rest:
        value = _put(getattr(record, name), rest, value)
    elif declared is not None:
        value = declared.from_file(key, value)
    return replace(record, **{name: value})


def broken_constraints(error: InfeasibleError) -> frozenset[str]:
    """Return the names of all constraints that bind."""
    return frozenset(map(_name, error.violations))


def _name(violation: Violation) -> str:
    """Return the name of the constraint, a step's duration distinct from the plan's."""
    whole_plan = violation.constraint == "duration" and violation.sense == "max"
    return PLAN_DURATION if whole_plan else violation.constraint


def _needed(violations: Iterable[Violation], name: str) -> float:
    """Return the size by which a limit, or a step's duration, has to be raised at the least."""
    pairs = [(v.value, v.limit) for v in violations if _name(v) == name]
    if name == "duration":
        pairs = [(limit, value) for value, limit in pairs]
    sizes = (large / small - 1.0 for large, small in pairs if small > 0.0)
    return max(filter(math.isfinite, sizes), default=0.0)


# Knobs: the changes that repair may make.

SPACE, RATES, FORCES = (
    checks_relaxed_by("length") | {"tracking_radius"},
    checks_relaxed_by("time"),
    checks_relaxed_by("tension"),
)

TIMES = frozenset({"duration", PLAN_DURATION})
"""Constraints that a faster plan, or more time, repairs."""

TOO_CLOSE = frozenset({"crossing", "cable_clearance", "separation", "tracking_radius"})
"""Constraints that more distance repairs."""

HEAVY, HELD = frozenset({"load"}), frozenset({"grip"})
"""Constraints that a higher tension, and those that lighter or rougher objects repair."""

ROUGHEST, STEEPEST, EASED = 1.0, 80.0, 0.95
"""Largest coefficient of friction, and largest tilt [deg] suggested; share of the largest mass at
rest from which on it is tried, as carrying pulls at it too."""

CHECK_OF = {"leg": "legs"}
"""Checks of limits that do not have their names."""


def _knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the knobs of a problem; distances that are there for safety stay as they are."""
    yield from _starts(problem)
    yield from _team(problem, violations)
    yield from _objects(problem, violations)
    for name, limit in keys_of(Limits).items():
        value, rule = getattr(problem.limits, name), RULE_OF.get(CHECK_OF.get(name, name))
        if value is None or rule is None:
            continue
        old, check = limit.to_file(value), PLAN_DURATION if name == "duration" else rule.name
        covers = frozenset({check}) | (TIMES if rule.derivative else frozenset())
        knob = Knob(f"limits.{limit.name}", old, rule.unit, covers=covers)
        most = STEEPEST / old - 1.0 if name == "tilt" else math.inf
        if rule.sense == "min":
            yield replace(knob, sign=-1)
        elif most > 0.0:
            yield replace(knob, least=_needed(violations, check), most=most)
    for i, step in enumerate(problem.mission):
        own = _needed((v for v in violations if f"step {i} " in v.when), "duration")
        for knob in step.knobs():

            def written(new: float, i: int = i, knob: Knob = knob) -> Edits:
                return _in_step(problem, i, knob.edits(new))

            key = f"mission[{i}].{step.name}.{knob.key}"
            least = own if "duration" in knob.covers else 0.0
            if isinstance(step, TransportObject) and knob.key == "lift":
                tops = [x.at[2] + x.upper for x in _in_the_way(problem, step, violations)]
                low = max(step.to[2], problem.objects[step.object].at[2])
                over = max(tops, default=0.0) + problem.separation.object - low
                least = max(0.0, float(over) / step.lift - 1.0)
            yield replace(knob, key=key, written=written, least=least)
    yield from _walls(problem, violations)


def _starts(problem: Problem) -> Iterator[Knob]:
    """Yield drones on free cables that start farther apart, or closer together."""
    start = problem.start
    if not isinstance(start, DronesStart):
        return
    middles, arms = 0.5 * (start.q + start.r)[:, :2], 0.5 * (start.r - start.q)[:, :2]

    def placed(middle: float, arm: float) -> Edits:
        """Return the edits that put middles apart and arms as long by factors."""
        centres = points_scaled(middles, middle, np.mean(middles, axis=0))
        edits = []
        for name, sign in (("q", -1.0), ("r", 1.0)):
            level = np.round(centres + sign * arm * arms, DECIMALS)
            place = np.column_stack([level, getattr(start, name)[:, 2]])
            edits.append(Edit(f"start.drones.{name}", place.tolist()))
        return tuple(edits)

    apart, drawn = (lambda factor: placed(factor, 1.0)), (lambda factor: placed(1.0, factor))
    key, span = "start.drones", frozenset({"span"})
    yield Knob(key, 1.0, "times", apart, 1, TOO_CLOSE, "robots from their middle")
    yield Knob(key, 1.0, "times", drawn, -1, span, "two drones of a robot")


def _team(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield cables, the outlines, and forces."""
    length, tension = _values(problem, "cable_length", "m"), _values(problem, "tension", "N")
    length = replace(length, words="all cables")
    yield replace(length, covers=SPACE)
    yield replace(length, sign=-1, covers=TOO_CLOSE | {"arena"})
    written = partial(outlines_scaled, problem)
    larger = Knob("polygon", 1.0, "times", written, 1, TOO_CLOSE, "scale of all polygons")
    yield replace(larger, sign=-1, covers=SPACE | RATES | TIMES | {"arena"})
    yield larger
    yield replace(tension, sign=-1, covers=FORCES)
    yield replace(tension, covers=HEAVY, least=_needed(violations, "load"))
    if np.any(problem.team.load > 0.0):
        covers = HEAVY | FORCES | TOO_CLOSE
        yield replace(_values(problem, "load", "kg"), sign=-1, covers=covers)
    thrust = _values(problem, "max_thrust", "N")
    key = "team.quadrotor.max_thrust" if thrust.unit == "N" else "team.quadrotor"
    yield replace(thrust, key=key, covers=TIMES | {"thrust"})


def _values(problem: Problem, name: str, unit: str) -> Knob:
    """Return the team's values as one knob: the value that all have, or a factor of them."""
    team = problem.team
    values: Array = team.max_thrust[::2] if name == "max_thrust" else getattr(team, name)
    same = bool(np.ptp(values) == 0.0)
    ratios = np.ones(len(values)) if same else values
    old, words = (float(values[0]), "") if same else (1.0, f"every {name}")

    def written(new: float) -> Edits:
        return (team_edit(problem, name, new * ratios),)

    return Knob(f"team.{name}", old, unit if same else "times", written, words=words)


def team_edit(problem: Problem, name: str, values: Array) -> Edit:
    """Return the edits for other values of a team: one value if all are equal."""
    rounded: list[Any] = [round(float(value), DECIMALS) for value in values]
    if name == "max_thrust":
        name, kinds = "quadrotor", problem.team.quadrotor
        thrusts = zip(kinds, rounded, strict=True)
        rounded = [_keys_of(kind) | {"max_thrust": x} for kind, x in thrusts]
    same = all(value == rounded[0] for value in rounded)
    return Edit(f"team.{name}", rounded[0] if same else rounded)


def _keys_of(kind: Quadrotor) -> dict[str, Any]:
    """Return the edits for a quadrotor: mass, thrust and all that differs from its default."""
    asked, usual = ("mass", "max_thrust"), vars(Quadrotor())
    given = {key: v for key, v in vars(kind).items() if key in asked or v != usual[key]}
    if kind.gains is not None:
        gains = {key: pair for key, pair in vars(kind.gains).items() if pair is not None}
        given["gains"] = {key: list(pair) for key, pair in gains.items()}
    return given


def _retuned(problem: Problem) -> Iterator[Change]:
    """Yield the change to the least distance that drones are known to be off, by stated limits.

    And the change from named controllers to the stiffest gains that fly.
    """
    if (off := problem.limits.tracking) is not None and off > RETUNED:
        edits = (Edit("limits.tracking", RETUNED),)
        share, changed = RETUNED / off - 1.0, with_edits(problem, edits)
        yield Change("limits.tracking", "", off, RETUNED, "m", share, changed, edits)
    kinds = problem.team.quadrotor
    named = [kind for kind in kinds if kind.controller is not None]
    if all(kind.loop.tracking == RETUNED for kind in named):
        return
    written = [
        _keys_of(replace(kind, controller=None, gains=None))
        | {"controller": "mellinger", "gains": stiffest_gains(kind.mass)}
        for kind in kinds
    ]
    same = all(each == written[0] for each in written)
    edits = (Edit("team.quadrotor", written[0] if same else written),)
    changed = with_edits(problem, edits)
    old = ", ".join(dict.fromkeys(str(kind.controller) for kind in named))
    new = f"mellinger with gains {written[0]['gains']}".replace("'", "")
    yield Change("team.quadrotor.controller", "", old, new, "", 0.0, changed, edits)


def outlines_scaled(problem: Problem, factor: float) -> Edits:
    """Return the edits that scale all outlines about their centroids, and points with them."""
    centre, edits = np.zeros(2), list[Edit]()
    if isinstance(problem.start, HitchStart):
        centre = problem.start.polygon.centroid
        edits.append(outline_edit("start.hitch.polygon", problem.start.polygon, factor))
    for i, step in enumerate(problem.mission):
        own, centre = step.scaled(factor, centre)
        edits += _in_step(problem, i, own)
    return tuple(edits)


def _in_step(problem: Problem, i: int, edits: Edits) -> Edits:
    """Return edits of step i, by their keys in the file."""
    name = problem.mission[i].name
    return tuple(Edit(f"mission[{i}].{name}.{edit.key}", edit.value) for edit in edits)


def _objects(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield objects that are lighter or rougher, where a refused hold names them."""
    grips = [v.value / v.limit for v in violations if v.constraint == "grip" and v.limit > 0.0]
    loads = [v.limit / v.value for v in violations if v.constraint == "load" and v.value > 0.0]
    rough, share = (
        EASED * min((each for each in shares if 0.0 < each < 1.0), default=1.0 / EASED)
        for shares in (grips, grips + loads)
    )
    for name, body in problem.objects.items():
        mentions = (f"objects.{name}" in v.when or name in v.where for v in violations)
        if body.fixed or not any(mentions):
            continue
        covers = HELD | HEAVY | FORCES | TOO_CLOSE | {"equilibrium", "keep_out"}
        least = round(1.0 - share, 9)
        yield Knob(f"objects.{name}.mass", body.mass, "kg", None, -1, covers, least=least)
        if 0.0 < body.friction <= rough * ROUGHEST:
            least, most = 1.0 / rough - 1.0, ROUGHEST / body.friction - 1.0
            key = f"objects.{name}.friction"
            yield Knob(key, body.friction, "", covers=HELD | HEAVY, least=least, most=most)


def _in_the_way(
    problem: Problem, step: TransportObject, violations: Sequence[Violation]
) -> list[SolidObject]:
    """Return the objects that violations name, but for the one that is carried."""
    names = dict.fromkeys(name for each in violations for name in each.where)
    return [x for name, x in problem.objects.items() if name in names and name != step.object]


def _around(problem: Problem, violations: Sequence[Violation]) -> Iterator[Change]:
    """Yield places beside obstacles, over which objects are carried: nearer ones first."""
    reach = float(np.max(problem.team.cable_length)) + problem.separation.radius
    for i, step in enumerate(problem.mission):
        if not isinstance(step, TransportObject) or step.via is not None:
            continue
        start, end = problem.objects[step.object].at, step.to
        along, high = unit(end[:2] - start[:2]), float(max(start[2], end[2])) + step.lift
        aside = np.array([-along[1], along[0]])
        for body in _in_the_way(problem, step, violations):
            section, centre = body.section, body.section.centroid
            middle = in_world(body.pose, np.append(centre, 0.0))[:2]
            far = reach + float(np.max(length(section.core - centre))) + section.rounding
            onward = (middle - start[:2]) @ along
            for side in (aside, -aside):
                level = start[:2] + onward * along + ((middle - start[:2]) @ side + far) * side
                place = np.round([*level, high], 2).tolist()
                edits = _in_step(problem, i, (Edit("via", [place]),))
                changed = with_edits(problem, edits)
                yield Change(edits[0].key, "", "none", str([place]), "", 0.0, changed, edits)


def _walls(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the arena's walls moved out, each alone, and all upright ones."""
    arena = problem.arena
    if arena is None:
        return
    beyond = max((-v.value for v in violations if v.constraint == "arena"), default=0.0)
    middle, extents = 0.5 * (arena.lower + arena.upper), arena.upper - arena.lower

    def widened(factor: float) -> Edits:
        half = 0.5 * extents * [factor, factor, 1.0]
        corners = {"lower": middle - half, "upper": middle + half}
        return (Edit("arena", {k: np.round(x, DECIMALS).tolist() for k, x in corners.items()}),)

    words, least = "length and width", 2.0 * beyond / float(np.min(extents[:2]))
    yield Knob("arena", 1.0, "times", widened, 1, frozenset({"arena"}), words, least=least)
    for axis in range(3):
        extent = float(extents[axis])
        for side, sign in (("lower", -1), ("upper", 1)):

            def written(new: float, side: str = side, axis: int = axis) -> Edits:
                corners = {name: getattr(arena, name).tolist() for name in ("lower", "upper")}
                corners[side][axis] = new
                return (Edit("arena", corners),)

            key, old = f"arena.{side}[{axis}]", float(getattr(arena, side)[axis])
            covers, least = frozenset({"arena"}), beyond / extent
            yield Knob(key, old, "m", written, sign, covers, "one wall", extent, least)


def _spread(problem: Problem) -> Iterator[Change]:
    """Yield the changes from given or balanced legs to spread ones, at the start or after steps."""
    records: list[tuple[str, object]] = [("start.hitch", problem.start)]
    records += [(f"mission[{i}].{step.name}", step) for i, step in enumerate(problem.mission)]
    for place, record in records:
        legs: Any = getattr(record, "legs", None)
        sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
        if sharing is None or (isinstance(sharing, str) and sharing == "spread"):
            continue
        edits = (Edit(f"{place}.legs", "spread"),)
        words, changed = legs if isinstance(legs, str) else "as given", with_edits(problem, edits)
        yield Change(edits[0].key, "", words, "spread", "", 0.0, changed, edits)
