"""Errors as types: one root, and one class for every reaction of a caller.

``InputError`` is a mistake in what was given; ``InfeasibleError`` is a well-formed request that
cannot be met and says what binds; the command line turns them into exit codes 2 and 3.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hitchopt.one_line import OneLine, one_line


class HitchoptError(Exception):
    """Root of every error that hitchopt raises on purpose."""

    def __repr__(self) -> str:
        return one_line(type(self).__name__, [repr(str(self))])


class Place(NamedTuple):
    """A place in a file; line and column are counted from 1."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


class InputError(HitchoptError, ValueError):
    """A value that is wrong in itself: type, count, range, sign, finiteness or shape.

    Parameters
    ----------
    key: path of the value, such as ``limits.speed`` or ``mission[0].morph.polygon``.
    value: the value that was given.
    bound: the end of "must be …".
    remedy: what to write instead.
    place: where the value is in a file; None where it is in none, or that is not known.
    """

    def __init__(
        self, key: str, value: object, bound: str, remedy: str, place: Place | None = None
    ) -> None:
        self.key = key
        self.value = value
        self.bound = bound
        self.remedy = remedy
        self.place = place
        where = "" if place is None else f"{place}: "
        super().__init__(f"{where}{key} = {_shown(value)}: must be {bound}; {remedy}")

    def within(self, parent: str) -> InputError:
        """Return the same error with its key seen from the enclosing mapping ``parent``."""
        key = _joint_key(parent, self.key)
        return InputError(key, self.value, self.bound, self.remedy, self.place)

    def located(self, place_of: Callable[[str], Place | None]) -> InputError:
        """Return the same error with the place in a file that its key has."""
        return InputError(self.key, self.value, self.bound, self.remedy, place_of(self.key))


class UnitWarning(UserWarning):
    """A value so unusual that it may have been given in another unit.

    Attributes
    ----------
    key: path of the value, as of an InputError.
    words: the value, what is usual, and what it would be in another unit.
    """

    def __init__(self, key: str, words: str) -> None:
        self.key = key
        self.words = words
        super().__init__(f"{key}: {words}")

    def within(self, parent: str) -> UnitWarning:
        """Return the same warning with its key seen from the enclosing mapping ``parent``."""
        return UnitWarning(_joint_key(parent, self.key), self.words)


class FileError(HitchoptError):
    """A file that cannot be read or written, or whose content does not match its name."""


class UnsupportedError(HitchoptError):
    """A request that hitchopt's interface knows and this version cannot plan yet."""


@dataclass(frozen=True)
class Violation(OneLine):
    """One constraint that cannot be satisfied, with its value, limit, place and time.

    Attributes
    ----------
    constraint: name of the certificate's check.
    value: the quantity's worst value, in ``unit``.
    limit: the bound that it breaks, in ``unit``.
    sense: ``min`` if the value must not be below the limit, ``max`` if not above it.
    unit: unit of both, for example ``m`` or ``ratio``.
    where: names of drones, cables or vertices.
    when: time in words, for example ``at t = 1.25 s of step 0 (morph)``: some violations are found
        before the timing.
    remedy: what to change.
    """

    constraint: str
    value: float
    limit: float
    sense: str
    unit: str
    where: tuple[str, ...]
    when: str
    remedy: str

    def __str__(self) -> str:
        when = f" {self.when}" if self.when else ""
        broken = broken_limit(
            self.constraint, self.value, self.limit, self.sense, self.unit, self.where
        )
        return f"{broken}{when}; {self.remedy}"


class InfeasibleError(HitchoptError):
    """A well-formed request that cannot be met.

    Attributes
    ----------
    violations: the broken constraints, the worst first.
    note: what else was tried, or an empty text.
    """

    def __init__(self, violations: Iterable[Violation], note: str = "") -> None:
        self.violations = tuple(violations)
        self.note = note
        lines = [str(v) for v in self.violations] + ([note] if note else [])
        super().__init__("\n".join(lines))


class TimeLimitError(InfeasibleError):
    """Planning that ended at its time limit: it is not known whether a plan exists."""


def broken_limit(
    name: str, value: float, limit: float, sense: str, unit: str, where: Sequence[str]
) -> str:
    """Return "name: value is below the limit of … at …", in digits that distinguish the two."""
    relation = "below" if sense == "min" else "above"
    words = f" {unit}" if unit not in {"", "1", "ratio"} else ""
    place = f" at {', '.join(where)}" if where else ""
    if abs(value) >= sys.float_info.max:  # what contradicts itself; files hold no infinity
        value = math.copysign(math.inf, value)
    texts = [f"{value:.6g}", f"{limit:.6g}"]
    for digits in (9, 12, 17):
        if texts[0] != texts[1]:
            break
        texts = [f"{value:.{digits}g}", f"{limit:.{digits}g}"]
    return f"{name}: {texts[0]}{words} is {relation} the limit of {texts[1]}{words}{place}"


def _joint_key(parent: str, key: str) -> str:
    joint = "" if key.startswith("[") or not key or not parent else "."
    return f"{parent}{joint}{key}"


def _shown(value: object) -> str:
    """Return ``value`` in at most 80 characters, short enough for a message."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits
        text = f"a {type(value).__name__} too long to write"
    return text if len(text) <= 80 else f"{text[:77]}..."
