"""Changes of a problem that may make it feasible, and the edits of its file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hitchopt.drones.controllers import Tube
from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation
from hitchopt.hitch import Quadrotor
from hitchopt.mission.problem import Problem
from hitchopt.steps.knob import PLAN_DURATION, Edit, Edits, Knob
from hitchopt.storage.yaml_file import split_key, with_value
from hitchopt.values.fields import keys_of

DIGITS = 3  # Number of significant digits of a suggested value


@dataclass(frozen=True, eq=False)
class Change(OneLine):
    """Change of one quantity of a problem.

    Attributes
    ----------
    key, words: path of the quantity in the problem file; its description if the path is not enough.
    old, new, unit: old and new value [unit]; the unit is ``times`` for a factor, empty for words.
    relative: signed size of the change relative to the quantity; 0 for words.
    is_factor: whether the quantity is positive, so that sizes are compared as factors.
    problem, edits: problem with the change; edits of the problem's file.
    before: change that is made before it; ``edits`` then has the edits of both.
    covers: constraints that a larger change may repair.
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
    is_factor: bool = True

    def __str__(self) -> str:
        return f"{self.before} and {self._words}" if self.before else self._words

    def after(self, before: Change) -> Change:
        """Return this change, of a problem changed by ``before``, combined with ``before``.

        Changes of the same quantity are merged, and omitted where the last undoes the others.
        """
        merged = dict[str, Change]()
        for each in (*before.together(), *self.together()):
            first = merged.pop(each.key, None)
            merged[each.key] = each if first is None else _merged(first, each)
        chain: Change | None = None
        for each in merged.values():
            if each.old != each.new:
                chain = replace(each, before=chain)
        edits = _last_of_each_key(before.edits + self.edits)
        return replace(chain or self, problem=self.problem, edits=edits, covers=self.covers)

    def together(self) -> list[Change]:
        """Return all changes in order."""
        return [*(self.before.together() if self.before else ()), self]

    @property
    def size(self) -> float:
        """Size of the largest of all changes, comparable between quantities (``size_of``)."""
        return max(size_of(each.relative, is_factor=each.is_factor) for each in self.together())

    def to_dict(self) -> dict[str, object]:
        """Return the change as plain values, for JSON."""
        hidden = {"problem", "words", "before", "covers", "is_factor"}
        plain = {k: v for k, v in vars(self).items() if k not in hidden}
        plain["edits"] = [vars(edit) for edit in self.edits]
        return plain | ({"before": self.before.to_dict()} if self.before else {})

    @property
    def _words(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        values = [v if isinstance(v, str) else f"{v:.6g}" for v in (self.old, self.new)]
        change = f"{self.key} {values[0]} -> {values[1]}{unit}"
        if not self.relative:
            return change
        words = f"{self.words}, " if self.words else ""
        percent = 100.0 * self.relative
        share = f"{percent:+.3g}" if abs(percent) < 999.5 else f"{percent:+.0f}"
        return f"{change} ({words}{share} %)"


def _merged(first: Change, second: Change) -> Change:
    """Return one change of a quantity in place of two after each other."""
    old, middle, new = first.old, first.new, second.new
    if isinstance(old, str) or isinstance(middle, str) or isinstance(new, str):
        return replace(second, old=old)
    new = middle * new if second.unit == "times" else new
    relative = first.relative * (new - old) / (middle - old)
    return replace(second, old=old, new=new, relative=relative)


def _last_of_each_key(edits: Edits) -> Edits:
    """Return the edits that no later edit of the same key replaces."""
    keys = [edit.key for edit in edits]
    return tuple(edit for i, edit in enumerate(edits) if edit.key not in keys[i + 1 :])


def size_of(relative: float, *, is_factor: bool) -> float:
    """Return the size of a relative change; half and twice as much of a factor are the same."""
    return abs(math.log1p(relative)) if is_factor else abs(relative)


def change_of(problem: Problem, knob: Knob, size: float) -> Change | None:
    """Return a change of a relative size, rounded away from the old value; None if invalid."""
    extent = knob.extent or knob.old
    value = knob.old + knob.sign * size * extent
    step = 10.0 ** (math.floor(math.log10(knob.extent or abs(value))) + 1 - DIGITS)
    steps = value / step  # the margin of 1e-9 keeps values that are already rounded
    rounded = math.ceil(steps - 1e-9) if knob.sign > 0 else math.floor(steps + 1e-9)
    new = float(f"{rounded * step:.12g}")
    edits = knob.edits(new)
    try:
        changed = with_edits(problem, edits)
    except InputError:
        return None
    quantity = knob.key, knob.words, knob.old, new, knob.unit
    relative = (new - knob.old) / extent
    is_factor = knob.extent is None
    return Change(*quantity, relative, changed, edits, covers=knob.covers, is_factor=is_factor)


def with_edits(problem: Problem, edits: Edits) -> Problem:
    """Return the problem with edits of its file, or raise InputError."""
    names = ("team", "start", "mission", "arena", "limits", "objects")
    parts = {name: getattr(problem, name) for name in names}
    for edit in edits:
        name, *path = re.findall(r"[^.\[\]]+", edit.key)
        if name == "start":
            del path[0]  # the kind of start
        elif name == "mission":
            del path[1]
        if path:
            parts[name] = _with_value(parts[name], path, edit.value)
        else:
            parts[name] = keys_of(Problem)[name].from_file(name, edit.value)
    return replace(problem, **parts)


def with_edits_in(text: str, edits: Edits) -> str:
    """Return the text of a problem file with edits; all else stays, including comments."""
    for edit in edits:
        text = with_value(text, split_key(edit.key), edit.value)  # type: ignore[arg-type]
    return text


def _with_value(record: Any, path: Sequence[str], value: Any) -> Any:
    """Return a record with the value at a path of file keys."""
    key, *rest = path
    if isinstance(record, tuple):
        i = int(key)
        return (*record[:i], _with_value(record[i], rest, value), *record[i + 1 :])
    if isinstance(record, Mapping):  # objects by name
        return {**record, key: _with_value(record[key], rest, value)}
    keys = {each.name: (name, each) for name, each in keys_of(type(record)).items()}
    name, declared = keys.get(key, (key, None))
    if rest:
        value = _with_value(getattr(record, name), rest, value)
    elif declared is not None:
        value = declared.from_file(key, value)
    return replace(record, **{name: value})


def broken_constraints(error: InfeasibleError) -> frozenset[str]:
    """Return the names of all violated constraints."""
    return frozenset(map(constraint_name, error.violations))


def constraint_name(violation: Violation) -> str:
    """Return the name of the constraint; PLAN_DURATION for the duration of the whole plan."""
    is_plan_duration = (violation.constraint, violation.sense) == ("duration", "max")
    return PLAN_DURATION if is_plan_duration else violation.constraint


def in_step(problem: Problem, i: int, edits: Edits) -> Edits:
    """Return edits of step i with their paths in the file."""
    name = problem.mission[i].name
    return tuple(Edit(f"mission[{i}].{name}.{edit.key}", edit.value) for edit in edits)


def quadrotor_keys(kind: Quadrotor) -> dict[str, Any]:
    """Return a quadrotor's values by key: mass, thrust and all that differs from the default."""
    required = ("mass", "max_thrust")
    defaults = vars(Quadrotor())
    values = {key: v for key, v in vars(kind).items() if key in required or v != defaults[key]}
    if kind.gains is not None:
        gains = {key: pair for key, pair in vars(kind.gains).items() if pair is not None}
        values["gains"] = {
            key: level if level == upright else [level, upright]
            for key, (level, upright) in gains.items()
        }
    if kind.trim is not None:
        values["trim"] = list(kind.trim)
    if isinstance(kind.tracking, Tube):
        values["tracking"] = vars(kind.tracking)
    return values
