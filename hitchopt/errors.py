"""Error types, the time limit, and short representations of errors and records.

``InputError`` reports an invalid value, ``InfeasibleError`` a valid request that cannot be met and
the limits that bind. The command line turns them into exit codes 2 and 3.
"""

from __future__ import annotations

import math
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from enum import StrEnum
from importlib import import_module
from typing import Any, NamedTuple

MAX_REPR = 100  # Maximum number of characters of a ``repr``
MAX_STRING = 30  # Maximum number of characters of a string in a ``repr``
MAX_ENTRIES = 8  # Maximum number of numbers that are written out


class OneLine:
    """A record whose ``repr`` is one line of at most MAX_REPR characters.

    The line shows the fields that differ from their defaults, until it is full.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            # ``dataclass`` does not replace methods that exist.
            cls.__repr__ = cls.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        return one_line(type(self).__name__, self._parts())

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore what was pickled or copied; arrays of records are read-only, as before."""
        if is_dataclass(self):  # players and replanners change their arrays
            for value in state.values():
                if hasattr(value, "setflags"):
                    value.setflags(write=False)
        vars(self).update(state)

    def _parts(self) -> Iterator[str]:
        """Yield the parts between the parentheses."""
        record: Any = self  # a dataclass
        for field in fields(record):
            value = short(getattr(self, field.name))
            factory = field.default_factory
            default = field.default if factory is MISSING else factory()
            if field.repr and (default is MISSING or value != short(default)):
                yield f"{field.name}={value}"


def one_line(name: str, parts: Iterable[str]) -> str:
    """Return ``name(part, …)`` on one line, truncated to MAX_REPR characters."""
    text = " ".join(f"{name}({', '.join(parts)})".split())  # a user's string may have line breaks
    return text if len(text) <= MAX_REPR else f"{text[: MAX_REPR - 2]}…)"


def short(value: object) -> str:
    """Return an abbreviated representation: of large arrays the shape, of records the name."""
    array: Any = value
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        constant = array.ndim == 1 and array.size > 0 and bool((array == array[0]).all())
        if not constant and array.size > MAX_ENTRIES:
            return f"array{array.shape}"
        value = array[0].item() if constant else array.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    is_word = isinstance(value, OneLine) and type(value).__str__ is not object.__str__
    if isinstance(value, str) or is_word:
        text = str(value)  # of an enumeration, or of a record that is written as a word, too
        return repr(text if len(text) <= MAX_STRING else f"{text[: MAX_STRING - 1]}…")
    if isinstance(value, tuple | list):
        text = f"[{', '.join(map(short, value[: MAX_ENTRIES + 1]))}]"
        return text if text.count(", ") < MAX_ENTRIES else f"<{len(value)} entries>"
    return repr(value) if isinstance(value, bool | int | None) else f"{type(value).__name__}(…)"


class HitchoptError(Exception):
    """Root of all errors that hitchopt raises."""

    def __repr__(self) -> str:
        return one_line(type(self).__name__, [repr(str(self))])

    def __reduce__(self) -> tuple[Any, ...]:
        """Let errors be pickled independently of the arguments of their constructors."""
        return _unpickled, (type(self), self.args, vars(self))


def _unpickled(kind: type[HitchoptError], args: tuple[object, ...], attributes: Any) -> Any:
    error = kind.__new__(kind, *args)
    vars(error).update(attributes)
    return error


class Place(NamedTuple):
    """A position in a file; line and column are counted from 1."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


class Missing:
    """Placeholder for the value of a missing key."""

    def __repr__(self) -> str:
        return "(missing)"


class Circumstance(str):
    """What is wrong, in words, where no value is: ``there is no hitch at that point``.

    Messages state it in place of a value and its bound.
    """


KNOWN = "a known "  # Beginning of the bound of a word that must exist; messages call others unknown
UNKNOWN_KEY = f"{KNOWN}key"  # The bound of a key that does not exist

YAML_LITERALS = {"None": "null", "True": "true", "False": "false"}
"""YAML literals of Python constants."""


class InputError(HitchoptError, ValueError):
    """A value of invalid type, count, range, sign, finiteness or shape.

    ``key`` is its path, such as ``mission[0].morph.polygon``, ``bound`` the end of "must be …",
    ``remedy`` the suggested change, and ``place`` the position in a file, if known.
    """

    def __init__(
        self, key: str, value: object, bound: str, remedy: str, place: Place | None = None
    ) -> None:
        self.key = key
        self.value = value
        self.bound = bound
        self.remedy = remedy
        self.place = place
        prefix = "" if place is None else f"{place}: "
        text = _truncated(value if place is None else _as_in_file(value))
        if place is not None and not isinstance(value, str):
            text = re.sub(r"\b(None|True|False)\b", lambda word: YAML_LITERALS[word[0]], text)
        summary = f"missing {key}" if isinstance(value, Missing) else f"{key} = {text}"
        if isinstance(value, Circumstance):
            summary = f"{key}: {value}"
        elif bound.startswith(KNOWN):
            summary = f"{summary}: unknown {bound.removeprefix(KNOWN)}"
        elif bound != "given" or not isinstance(value, Missing):
            summary = f"{summary}: must be {bound}"
        super().__init__(f"{prefix}{summary}; {remedy}")

    def renamed(self, rename: Callable[[str], str]) -> InputError:
        """Return the error with its key renamed by a function."""
        return InputError(rename(self.key), self.value, self.bound, self.remedy, self.place)

    def within(self, parent: str) -> InputError:
        """Return the error with its key prefixed by that of the enclosing mapping ``parent``."""
        return self.renamed(lambda key: _nested_key(parent, key))

    def located(self, place_of: Callable[[str], Place | None]) -> InputError:
        """Return the error with the position of its key in a file."""
        return InputError(self.key, self.value, self.bound, self.remedy, place_of(self.key))


MAX_LISTED = 20  # Maximum number of errors listed for one file


class JointInputError(InputError):
    """Several ``errors`` of one file; ``key``, ``value``, … are those of the first."""

    def __init__(self, errors: Sequence[InputError]) -> None:
        first = errors[0]
        super().__init__(first.key, first.value, first.bound, first.remedy, first.place)
        self.errors = tuple(errors)
        lines = [str(error) for error in self.errors[:MAX_LISTED]]
        if len(self.errors) > MAX_LISTED:
            lines.append(f"and {len(self.errors) - MAX_LISTED} more")
        self.args = ("\n".join(lines),)

    def renamed(self, rename: Callable[[str], str]) -> JointInputError:
        """Return the errors with their keys renamed by a function."""
        return JointInputError([error.renamed(rename) for error in self.errors])

    def located(self, place_of: Callable[[str], Place | None]) -> JointInputError:
        """Return the errors with the positions of their keys in a file."""
        return JointInputError([error.located(place_of) for error in self.errors])


def joint_error(errors: Sequence[InputError]) -> InputError:
    """Return the only error, or a JointInputError of several."""
    return errors[0] if len(errors) == 1 else JointInputError(errors)


class RequestError(InputError):
    """An InputError about the request that only planning finds: a step that its start rules out.

    Any other InputError while planning is a fault of a planner, which built a record from values
    of its own; it becomes a PlannerError.
    """


class UnitWarning(UserWarning):
    """A value so unusual that its unit may be wrong, such as degrees for radians.

    ``factor`` converts it from the unit that was probably meant; None if none is known.
    """

    def __init__(self, key: str, words: str, factor: float | None = None) -> None:
        self.key = key
        self.words = words
        self.factor = factor
        super().__init__(f"{key}: {words}")

    def within(self, parent: str) -> UnitWarning:
        """Return the warning with its key prefixed by that of the enclosing mapping ``parent``."""
        return UnitWarning(_nested_key(parent, self.key), self.words, self.factor)


class FaultWarning(UserWarning):
    """A fault in a search for changes, a picture or a note; the result is complete without it."""


@contextmanager
def contained(work: str) -> Iterator[None]:
    """Turn an error of the context into a FaultWarning of one line, so that it hides no result.

    ``work`` says what fails: a search for changes, a picture, a note. Interrupts and the time limit
    are raised.
    """
    try:
        yield
    except Exception as error:
        kind = "" if isinstance(error, HitchoptError) else f"{type(error).__name__}: "
        words = " ".join(f"{work} failed: {kind}{error}".split())
        warnings.warn(FaultWarning(words), stacklevel=3)  # the line of the context


class FileError(HitchoptError):
    """A file that cannot be read or written, or whose content does not match its name."""


class UnsupportedError(HitchoptError):
    """A valid request that this version, or this installation, does not support."""


def optional_module(module: str, purpose: str, extra: str) -> Any:
    """Import a module of an extra; UnsupportedError, from ``purpose`` on, if it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        reason = f"{purpose} {module.partition('.')[0]} ({error})"
        raise UnsupportedError(f"{reason}; pip install 'hitchopt[{extra}]'") from None


AT_END = "at the end"  # The end of a step, in ``Violation.when``.


class StepPlace(NamedTuple):
    """A step of a mission, or a phase of it."""

    step: int  # Index of the step
    name: str  # The step's name in the problem file, or what planners call the phase
    phase: str = ""  # Name of the phase, if it differs from the step's

    def __str__(self) -> str:
        return f"{self.step} ({', '.join(filter(None, self[1:]))})"


class Reason(StrEnum):
    """What a search did not find."""

    NO_GRIP = "no polygon grips the object"
    NO_ROUTE = "the best route that was tried breaks a limit"


@dataclass(frozen=True)
class Violation(OneLine):
    """One constraint that cannot be satisfied, with its value, limit, place and time.

    Attributes
    ----------
    constraint: name of the certificate's check.
    value: the quantity's worst value, in ``unit``.
    limit: the violated bound, in ``unit``.
    sense: ``min`` if the value must not be below the limit, ``max`` if not above it.
    unit: unit of both, for example ``m`` or ``ratio``.
    where: names of drones, cables or vertices.
    when: description of the time, for example ``at t = 1.25 s``; violations that are found before
        the timing have no t.
    remedy: suggested change.
    steps: the step in which it occurs, or all steps of a flight without a stop; empty if unknown.
    object: name of the object that it concerns, if any.
    reason: what a search did not find, if that is why.
    team: name of the team, if there are several.
    """

    constraint: str
    value: float
    limit: float
    sense: str
    unit: str
    where: tuple[str, ...]
    when: str
    remedy: str
    steps: tuple[StepPlace, ...] = ()
    object: str = ""
    reason: Reason | None = None
    team: str = ""

    def __str__(self) -> str:
        summary = self.constraint, self.value, self.limit, self.sense, self.unit, self.where
        return " ".join(filter(None, [broken_limit(*summary), self.moment])) + f"; {self.remedy}"

    @property
    def step(self) -> int | None:
        """Index of the first step in which it occurs; None if unknown."""
        return self.steps[0].step if self.steps else None

    @property
    def moment(self) -> str:
        """Time and step in words, for example ``at t = 1.25 s, in step 0 (morph)``."""
        of_team = f" of {self.team}" if self.team else ""
        if not self.steps:
            return f"{self.when}{of_team}".strip()
        joint = " of " if self.when == AT_END else ", in " if self.when else "in "
        return f"{self.when}{joint}step {' and '.join(map(str, self.steps))}{of_team}"

    def to_dict(self) -> dict[str, Any]:
        """Return the violation as plain values, for JSON."""
        names = ("constraint", "value", "limit", "sense", "unit", "where", "remedy")
        plain = {name: getattr(self, name) for name in names}
        return plain | {"when": self.moment, "step": self.step}


class InfeasibleError(HitchoptError):
    """A request that cannot be met: its ``violations``, and a ``note`` on attempts.

    ``unplanned`` are steps after the one that cannot be planned, as ``1 (hold)``.

    Violations that a certificate finds are in the order of its checks, not by size, except that at
    the start ``span`` precedes all others, which may follow from it.
    """

    def __init__(
        self, violations: Iterable[Violation], note: str = "", unplanned: Iterable[str] = ()
    ) -> None:
        self.violations = tuple(violations)
        self.note = note
        self.unplanned = tuple(unplanned)
        super().__init__("\n".join([*map(str, self.violations), *self.notes]))

    @property
    def notes(self) -> list[str]:
        """Lines on attempts and on steps that were not planned."""
        rest = [f"not checked yet: steps {', '.join(self.unplanned)}"] if self.unplanned else []
        return [*self.note.splitlines(), *rest]

    def with_violations(self, violations: Iterable[Violation]) -> InfeasibleError:
        """Return the error with other violations."""
        return InfeasibleError(violations, self.note, self.unplanned)

    def with_note(self, line: str) -> InfeasibleError:
        """Return the error with a further line of its note."""
        return InfeasibleError(self.violations, f"{self.note}\n{line}".strip(), self.unplanned)

    def at(self, when: str, **known: Any) -> InfeasibleError:
        """Return the error with the same description of the time for all violations.

        ``known`` are further fields of all violations; their steps are unknown.
        """
        known = {"when": when, "steps": ()} | known
        return self.with_violations(replace(each, **known) for each in self.violations)

    def of_team(self, name: str) -> InfeasibleError:
        """Return the error with a team's name before its drones; itself if the name is empty."""
        if not name:
            return self
        violations = [
            replace(each, where=tuple(f"{name}.{place}" for place in each.where), team=name)
            for each in self.violations
        ]
        unplanned = [f"{step} of {name}" for step in self.unplanned]
        return InfeasibleError(violations, self.note and f"{name}: {self.note}", unplanned)


@contextmanager
def violations_at(when: str, **known: Any) -> Iterator[None]:
    """State when the violations occur that the context raises; ``known`` as of ``at``."""
    try:
        yield
    except InfeasibleError as error:
        raise error.at(when, **known) from error


class PlannerError(HitchoptError):
    """A planner failed, with an error of its own; feasibility is undecided."""

    def __init__(self, error: HitchoptError) -> None:
        self.error = error
        super().__init__(f"a planner failed: {error}; please report it with the problem")


@contextmanager
def planners_faults() -> Iterator[None]:
    """Turn every InputError of the context but a RequestError into a PlannerError."""
    try:
        yield
    except RequestError:
        raise
    except InputError as error:
        raise PlannerError(error) from error


class TimeLimitError(InfeasibleError):
    """Planning reached its time limit; feasibility is undecided."""


EXCHANGED = ", or are x and y swapped?"  # End of a remedy if exchanged coordinates would be valid


def broken_limit(
    name: str, value: float, limit: float, sense: str, unit: str, where: Sequence[str]
) -> str:
    """Return "name: value is below the limit of … at …", in digits that distinguish the two."""
    relation = "below" if sense == "min" else "above"
    suffix = f" {unit}" if unit not in {"", "1", "ratio"} else ""
    place = f" at {', '.join(where)}" if where else ""
    texts = distinct(value, limit, 6)
    return f"{name}: {texts[0]}{suffix} is {relation} the limit of {texts[1]}{suffix}{place}"


def distinct(value: float, other: float, digits: int) -> tuple[str, str]:
    """Format two numbers with as many significant digits as distinguish them."""
    if abs(value) >= sys.float_info.max:  # a contradiction; files have no infinity
        value = math.copysign(math.inf, value)
    texts = "", ""
    for precision in (digits, 6, 9, 12, 17):
        texts = f"{value:.{precision}g}", f"{other:.{precision}g}"
        if texts[0] != texts[1]:
            break
    return texts


def rounded_up(value: float, digits: int) -> float:
    """Return a value rounded up to some significant digits, in which it still suffices."""
    nearest = float(f"{value:.{digits}g}")
    if nearest >= value:
        return nearest
    step = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - digits)
    return float(f"{nearest + step:.{digits}g}")


def rounded_down(value: float, digits: int) -> float:
    """Return a value rounded down to some significant digits, in which it is still allowed."""
    return -rounded_up(-value, digits)


def _nested_key(parent: str, key: str) -> str:
    separator = "" if key.startswith("[") or not key or not parent else "."
    return f"{parent}{separator}{key}"


def _as_in_file(value: Any) -> object:
    """Return a value as written in files: a record as its keys without default values."""
    if is_dataclass(value):
        items = {each.name: (getattr(value, each.name), each.default) for each in fields(value)}
        return {name: _as_in_file(v) for name, (v, default) in items.items() if v is not default}
    value = value.tolist() if hasattr(value, "tolist") else value
    return [_as_in_file(each) for each in value] if isinstance(value, tuple | list) else value


def _truncated(value: object) -> str:
    """Return the ``repr`` of a value, truncated to 80 characters."""
    try:
        text = repr(value) if isinstance(value, str) else " ".join(repr(value).split())
    except ValueError:  # Python formats no integer of more than 4300 digits
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= 80 else f"{text[:77]}..."


# The time limit applies to everything that is called in its context, in the same thread only.
# Loops call check_time; solvers in compiled code receive time_left.

Progress = Callable[[str], None]  # Status callback: called with a message about the current work

REMEDY = "raise the time limit (limit=), or simplify the problem"


class TimeIsUp(BaseException):
    """Planning is out of time.

    Not an Exception: planners that try alternatives must not catch it.
    """


_DEADLINE: ContextVar[float] = ContextVar("deadline", default=math.inf)
"""Time of the monotonic clock at which the limit is reached [s]."""


@contextmanager
def time_limit(seconds: float | None, progress: Progress | None = None) -> Iterator[Progress]:
    """Limit the time of the context to ``seconds``, if any, and to the limits of outer contexts.

    Yields a status callback; the TimeLimitError contains its last message.
    """
    last_message = ""

    def report(message: str) -> None:
        nonlocal last_message
        last_message = message
        if progress is not None:
            progress(message)

    start = time.monotonic()
    deadline = math.inf if seconds is None else start + seconds
    if seconds is None or _DEADLINE.get() <= deadline:  # an outer limit raises its own error
        yield report
        return
    token = _DEADLINE.set(deadline)
    try:
        yield report
    except TimeIsUp:
        when = f"(last: {last_message})" if last_message else ""
        elapsed = max(time.monotonic() - start, seconds)
        violation = Violation("time limit", elapsed, seconds, "max", "s", (), when, REMEDY)
        raise TimeLimitError([violation]) from None
    finally:
        _DEADLINE.reset(token)


def time_left() -> float:
    """Return the remaining time for planning, at least 0; infinite without a limit [s]."""
    deadline = _DEADLINE.get()
    return deadline if math.isinf(deadline) else max(0.0, deadline - time.monotonic())


def check_time() -> None:
    """Raise TimeIsUp if the time limit has been reached."""
    deadline = _DEADLINE.get()
    if deadline < math.inf and deadline <= time.monotonic():
        raise TimeIsUp
