"""Changes of a problem, kinds of them by size, and those that are verified to make it feasible."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.mission.problem import Problem
from hitchopt.one_line import OneLine
from hitchopt.steps.edits import PLAN_DURATION

BUDGET = 15.0
"""Time [s] after which no further plan is begun: a user waits for it."""

NO_CHANGE = "no single change was found that makes it feasible"
"""Message where there is no suggestion."""

DIGITS = 3
"""Significant digits of a suggested value: what a person would type."""


LEAST_LEFT = 0.1
"""Share of a quantity that is left where it is lowered the most."""


@dataclass(frozen=True)
class Edit(OneLine):
    """What to write into a problem file.

    Attributes
    ----------
    key: path of the key, such as ``team.cable_length`` or ``mission[0].morph.polygon``.
    value: number, word, list or mapping, in the file's units.
    """

    key: str
    value: object


@dataclass(frozen=True, eq=False)
class Change(OneLine):
    """One quantity of a problem changed.

    Attributes
    ----------
    key: path of the quantity in the problem file.
    words: what it is, where the key does not tell.
    old, new: its values [unit].
    unit: such as ``m``; ``times`` for a factor, nothing for words.
    relative: size of the change over that of the quantity, with its sign.
    problem: with the change.
    edits: what to write into the problem's file for it.
    """

    key: str
    words: str
    old: float | str
    new: float | str
    unit: str
    relative: float
    problem: Problem
    edits: tuple[Edit, ...]

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        values = [v if isinstance(v, str) else f"{v:.6g}" for v in (self.old, self.new)]
        words = f"{self.words}, " if self.words else ""
        percent = 100.0 * self.relative
        share = f"{percent:+.3g}" if abs(percent) < 999.5 else f"{percent:+.0f}"
        return f"{self.key} {values[0]} -> {values[1]}{unit} ({words}{share} %)"


@dataclass(frozen=True, eq=False)
class Suggestion(OneLine):
    """A change with which the problem has been planned and certified.

    Attributes
    ----------
    change: the only one that is needed.
    duration: of the certified plan [s].
    """

    change: Change
    duration: float

    def __str__(self) -> str:
        return f"suggested change: {self.change}, verified: plan of {self.duration:.3g} s certified"

    def to_dict(self) -> dict[str, object]:
        """Return the suggestion as plain values, for JSON."""
        change = self.change
        return {
            "key": change.key,
            "old": change.old,
            "new": change.new,
            "unit": change.unit,
            "relative": change.relative,
            "duration": self.duration,
            "edits": [vars(edit) for edit in change.edits],
            "message": str(self),
        }


@dataclass(frozen=True, eq=False)
class Edited:
    """A problem with another value, and how a file says so."""

    problem: Problem
    edits: tuple[Edit, ...]


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number of a problem that can be changed.

    Attributes
    ----------
    key, old, unit, words: as of Change.
    put: gives the problem with another value.
    extent: what sizes are relative to [unit]; the old value unless given.
    """

    key: str
    old: float
    unit: str
    put: Callable[[float], Edited]
    words: str = ""
    extent: float | None = None


@dataclass(frozen=True, eq=False)
class Kind:
    """Changes of one quantity in one direction, by their size.

    Attributes
    ----------
    quantity: what is changed.
    sign: 1 where it is raised, -1 where it is lowered.
    covers: constraints that it can repair; where others are broken too it is not tried.
    least: sizes below are known not to do.
    most: sizes above make no sense.
    relaxes: it takes nothing away, so that no size can do where ``most`` does not.
    family: the first one that does stands for all kinds of this name, such as those of one cable.
    """

    quantity: Quantity
    sign: int
    covers: frozenset[str]
    least: float = 0.0
    most: float = math.inf
    relaxes: bool = False
    family: str = ""

    @property
    def lasts(self) -> bool:
        """Whether it gives a step the time that it is known to take at the least."""
        return self.least > 0.0 and self.quantity.key.endswith(".duration")

    def change(self, size: float) -> Change | None:
        """Return the change of a relative size, rounded away from the old value to DIGITS.

        There is none where a record refuses the value, such as an outline that a wall or a step no
        longer fits.
        """
        quantity = self.quantity
        extent = quantity.extent or quantity.old
        value = quantity.old + self.sign * size * extent
        new = tidy(value, self.sign, quantity.extent or abs(value))
        try:
            edited = quantity.put(new)
        except InputError:
            return None
        relative = (new - quantity.old) / extent
        names = quantity.key, quantity.words, quantity.old
        return Change(*names, new, quantity.unit, relative, edited.problem, edited.edits)


def lowered(
    quantity: Quantity, covers: frozenset[str], relaxes: bool = False, family: str = ""
) -> Kind:
    """Return the kind of changes that lower a quantity, but never to nothing."""
    return Kind(quantity, -1, covers, 0.0, 1.0 - LEAST_LEFT, relaxes, family)


def tidy(value: float, sign: int, scale: float) -> float:
    """Return ``value`` rounded up (sign 1) or down (sign -1) to DIGITS digits of ``scale``."""
    step = 10.0 ** (math.floor(math.log10(scale)) + 1 - DIGITS)
    steps = value / step  # a value that is tidy already is not to be moved by its rounding error
    rounded = math.ceil(steps - 1e-9) if sign > 0 else math.floor(steps + 1e-9)
    return float(f"{rounded * step:.12g}")


TIMES = frozenset({"duration", PLAN_DURATION})
"""Constraints that a faster plan, or more time, repairs."""


def broken_constraints(error: InfeasibleError) -> frozenset[str]:
    """Return the names of all constraints that bind."""
    return frozenset(name_of(violation) for violation in error.violations)


def name_of(violation: Violation) -> str:
    """Return the name of the constraint, a step's duration and the plan's told apart."""
    whole_plan = violation.constraint == "duration" and violation.sense == "max"
    return PLAN_DURATION if whole_plan else violation.constraint


def needed(violations: Sequence[Violation], name: str) -> float:
    """Return the size by which a limit has to be raised at the least."""
    return _largest(
        v.value / v.limit - 1.0 for v in violations if name_of(v) == name and v.limit > 0.0
    )


def short(violations: Sequence[Violation]) -> float:
    """Return the size by which a step has to be longer at the least."""
    return _largest(v.limit / v.value - 1.0 for v in violations if name_of(v) == "duration")


def _largest(sizes: Iterable[float]) -> float:
    """Return the largest finite one; a bound that is not finite tells no size."""
    return max((size for size in sizes if math.isfinite(size)), default=0.0)


def beyond(violations: Sequence[Violation]) -> float:
    """Return how far drones are beyond walls [m]."""
    return max((-v.value for v in violations if v.constraint == "arena"), default=0.0)
