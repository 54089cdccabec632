"""Checks of single values, with one set of messages; records that compare by value."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError, OneLine
from hitchopt.values.arrays import plain as plain

Array = NDArray[np.float64]  # Type of arrays of real numbers
Indices = NDArray[np.intp]  # Type of arrays of indices
Points = ArrayLike | Sequence[Any]
"""Type of points that callers give: all that ``plain`` takes.

To type checkers ``[[0, -1], [-0.4, 0.5]]``, which mixes integers and floats, is a list of objects.
"""
T = TypeVar("T")

if TYPE_CHECKING:
    lazy = cached_property
else:

    class lazy(cached_property):  # noqa: N801, used like a function
        """A ``cached_property`` without a lock, which takes longer than short formulas."""

        def __get__(self, instance: object, owner: type | None = None) -> object:
            if instance is None:
                return self
            value = instance.__dict__[self.attrname] = self.func(instance)
            return value


MAX_COORDINATE = 1000.0
"""[m] Largest coordinate. Rounding makes accelerations jump in proportion to it: at 200 m by up to
9e-7 m/s² in the problems that hitchopt comes with, at this distance by 4e-7 to more than 2e-6. The
certificate allows 1e-6."""

TOO_FAR = "if these are millimetres, use metres; otherwise subtract an offset from all coordinates"
"""Remedy for coordinates that are too large."""

# Forms of values, as messages name them
SCALAR = "a number"
LIST = "a list"
WORD = "a word"
FLAG = "true or false"
MAPPING = "a mapping"

_FORMS = (
    ((bool, np.bool_), FLAG, "write true or false"),
    ((int, float, np.number), SCALAR, "use a plain number in SI units"),
    ((list, tuple, np.ndarray), LIST, "write a list in brackets"),
    ((str,), WORD, "put it in quotes if it is meant as text"),
    ((Mapping,), MAPPING, "write {key: value, …}"),
)


def known(value: T | None) -> T:
    """Return a value that callers have checked to exist; TypeError if it is None."""
    if value is None:
        raise TypeError("a value that must exist here is None")
    return value


def true_runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and the last index, exclusive, of each run of true values of a mask (k,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(first, last) for first, last in edges.reshape(-1, 2).tolist()]


def form_of(value: object) -> str:
    """Return the form of a value, "" if it has none; records are mappings."""
    if is_dataclass(value):
        return MAPPING
    return next((form for kinds, form, _ in _FORMS if isinstance(value, kinds)), "")


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as ``1 drone`` or ``2 drones``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def alternatives(words: Sequence[str]) -> str:
    """Return a list of words, the last one after "or"."""
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last


def form_error(key: str, value: object, *bounds: str) -> InputError:
    """Return the error for a value that has none of the forms ``bounds``."""
    remedy = next((remedy for _, form, remedy in _FORMS if form in bounds), "write a list")
    digits = value if SCALAR in bounds and isinstance(value, str) else ""
    if value is None:
        remedy = "set a value"
    elif re.fullmatch(r"[-+]?[\d.]+(e-?\d+)?", digits):
        remedy = "remove the quotes"
    elif re.fullmatch(r"[-+]?\d+,\d+", digits):
        remedy = f"write {digits.replace(',', '.')}: decimals have a point"
    return InputError(key, value, alternatives(bounds), remedy)


def check_instance(key: str, value: object, *kinds: type) -> None:
    """Raise InputError unless ``value`` is an instance of one of the public classes ``kinds``."""
    if not isinstance(value, kinds):
        names = " or ".join(f"hitchopt.{kind.__name__}" for kind in kinds)
        raise InputError(key, value, f"a {names}", f"build one with hitchopt.{kinds[0].__name__}")


def flag(key: str, value: object) -> bool:
    """Return ``value``, or raise InputError unless it is true or false."""
    if not isinstance(value, bool | np.bool_):
        raise form_error(key, value, FLAG)
    return bool(value)


def path(key: str, value: object) -> Path:
    """Return ``value`` as a path; raise InputError unless it is a path or a string."""
    if not isinstance(value, str | Path) or value == "":
        raise InputError(key, value, "a path", "pass a string or pathlib.Path")
    return Path(value)


SYNONYMS = {
    "hold": "wait sleep pause stay hover",
    "transport": "move fly goto go translate",
    "transport_object": "pick place deliver",
    "morph": "reshape deform shape",
    "form": "tie takeoff take_off",
    "release": "untie",
    "mission": "steps",
    "robots": "n count size",
    "cable_length": "cable cables",
    "to": "height target goal",
    "by": "height to distance",
    "altitude": "height z",
    "circle": "radius diameter",
    "polygon": "vertices points outline to",
    "outline": "polygon vertices points",
    "radius": "diameter circle r",
    "mass": "weight",
    "at": "position place origin",
    "speed": "velocity",
    "seconds": "duration time",
    "duration": "seconds time",
    "friction": "mu",
    "objects": "obstacles",
    "crazyflie_2.1": "cf cf2 cf21 cf2x cf2x_l250 crazyflie crazyflie2 crazyflie_2",
    "crazyflie_2.1_brushless": "cf21b cf21bl cf_bl cfbl bl brushless crazyflie_brushless",
    "crazyflie_2.1_upgraded": "cf21p cf21plus cf2x_t350 crazyflie_2.1+ upgraded thrust_upgrade",
    "paper_132g": "paper",
    "x260_bolt": "x260 bolt crazyflie_bolt",
    "crazyswarm2": "crazyflie crazyfly bitcraze cflib poly4d",
    "accurate": "precise exact fine",
    "mavsdk_drone_show": "mavsdk px4 mavlink",
    "skybrush": "skyc ardupilot",
    "ros2bag": "ros ros2 bag rosbag mcap db3",
    "csv": "npz npy json txt tsv xlsx table setpoints",
    "parquet": "pandas arrow feather polars",
    "gltf": "glb blender three.js threejs",
    "mjcf": "mujoco scene",
}
"""Words that users write in place of each valid word."""

MIN_SIMILARITY = 0.6  # Smallest ratio of ``difflib`` between a word and the one that it suggests
MIN_SIMILAR = 4  # Fewest characters of a synonym that a misspelling can suggest


def closest_word(word: str, valid: Sequence[str], fallback: str = "") -> str:
    """Return a question that suggests a valid word: a synonym, or the one with closest spelling.

    Misspelt synonyms count too. Without a match the result is ``fallback``, by default a list of
    all valid words.
    """
    lowered = word.lower()[:60]
    synonyms = {name: SYNONYMS.get(name, "").split() for name in valid}
    matches = [name for name in valid if lowered in synonyms[name]]
    if not matches:
        names = {each: name for name in valid for each in synonyms[name]}
        names = {each: name for each, name in names.items() if len(each) >= MIN_SIMILAR}
        names |= {name.lower(): name for name in valid}
        similar = difflib.get_close_matches(lowered, names, n=1, cutoff=MIN_SIMILARITY)
        matches = [names[each] for each in similar]
    if matches:
        return f"did you mean {matches[0]}?"
    return fallback or f"use one of {', '.join(valid)}"


def check_choice(key: str, value: object, names: Sequence[str]) -> None:
    """Raise InputError unless ``value`` is one of ``names``."""
    if not isinstance(value, str) or value not in names:
        remedy = closest_word(str(value), names, "choose one of them")
        raise InputError(key, value, alternatives(names), remedy)


def text(key: str, value: object) -> str:
    """Return ``value``, or raise InputError unless it is a string."""
    if not isinstance(value, str):
        raise InputError(key, value, "a string", "write it in quotation marks")
    return value


def line(key: str, value: object) -> str:
    """Return ``value``, or raise InputError unless it is text without control characters."""
    string = text(key, value)
    if not string.isprintable():
        raise InputError(key, string, "printable text on one line", "remove such characters")
    return string


def sequence(key: str, value: object) -> tuple[Any, ...]:
    """Return the entries of an iterable, or raise InputError if ``value`` is not iterable."""
    try:
        return tuple(plain(key, value))
    except TypeError:
        raise InputError(key, value, "a list", "write [ ] around it") from None


def integer(key: str, value: object, minimum: int, maximum: int | None = None) -> int:
    """Return ``value``, or raise InputError unless it is an integer in the range."""
    number = plain(key, value)
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise InputError(key, value, "an integer", "use a whole number")
    if number < minimum:
        raise InputError(key, value, f"at least {minimum}", f"use {minimum} or more")
    if maximum is not None and number > maximum:
        raise InputError(key, value, f"at most {maximum}", f"use {maximum} or less")
    return int(number)


def positive(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError unless it is finite and above zero."""
    number = finite(key, value)
    if number <= 0.0:
        raise InputError(key, value, "greater than 0", "use a positive number")
    return number


def nonnegative(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError unless it is finite and at least zero."""
    number = finite(key, value)
    if number < 0.0:
        raise InputError(key, value, "at least 0", "use zero or a positive number")
    return number


def finite(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError unless it is a finite number."""
    entry = plain(key, value)
    if not _is_number(entry):
        raise form_error(key, value, SCALAR)
    try:
        number = float(entry)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(key, value, "finite", "nan and inf are not quantities")
    return number


def coordinate(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError if it is beyond ±MAX_COORDINATE."""
    number = finite(key, value)
    if abs(number) > MAX_COORDINATE:
        raise InputError(key, value, f"within ±{MAX_COORDINATE:g} m", TOO_FAR)
    return number


def as_array(key: str, value: object) -> Array:
    """Return a copy of numbers, which may be nan, as an array; empty if they form no array.

    Raises InputError for an entry that is not a number.
    """
    entries = _nested_numbers(key, value)
    if not (isinstance(entries, list | tuple | np.ndarray) or _is_number(entries)):
        return np.empty(0)
    try:
        return np.array(entries, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0)


def _nested_numbers(key: str, value: object) -> Any:
    """Return an array, or lists of numbers; other values as they are, except entries of lists."""
    entries = plain(key, value)
    if isinstance(entries, np.ndarray) and entries.dtype == np.bool_:
        raise form_error(key, value, SCALAR)
    if not isinstance(entries, list | tuple) or set(map(type, entries)) <= {float, int}:
        return entries
    rows = [_nested_numbers(f"{key}[{i}]", entry) for i, entry in enumerate(entries)]
    for i, row in enumerate(rows):
        if not (isinstance(row, list | tuple | np.ndarray) or _is_number(row)):
            raise form_error(f"{key}[{i}]", row, SCALAR)
    return rows


def _is_number(value: object) -> bool:
    """Return whether a value is a real number; true and false are none."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def points(key: str, value: object, shape: tuple[int, int], bound: str, remedy: str) -> Array:
    """Return points [m] as a read-only array, or raise InputError if one exceeds MAX_COORDINATE.

    ``shape`` is the minimum number of points and the number of coordinates; ``bound`` and
    ``remedy`` go into the error for a wrong shape.
    """
    array = as_array(key, value)
    if array.ndim != 2 or array.shape[1] != shape[1] or len(array) < shape[0]:
        raise InputError(key, value, bound, remedy)
    return bounded_points(key, array)


def bounded_points(key: str, array: Array, largest: float = MAX_COORDINATE) -> Array:
    """Make points (…, d) [m] read-only and return them; raise InputError beyond ±``largest``."""
    bounded = np.all(np.abs(array) <= largest, axis=-1)  # False for nan
    if not np.all(bounded):
        k = int(np.argmin(bounded))
        path, point = (f"{key}[{k}]", array[k]) if array.ndim > 1 else (key, array)
        bound = f"finite and within ±{largest:g} m"
        raise InputError(path, point.tolist(), bound, TOO_FAR)
    array.setflags(write=False)
    return array


def per_robot(
    key: str,
    value: float | Sequence[float] | ArrayLike,
    robots: int,
    check: Callable[[str, object], float] = positive,
    owner: str = "robot",
) -> NDArray[np.float64]:
    """Return ``value`` as a read-only array (robots,); one number applies to all robots.

    ``check`` returns a checked number. ``owner`` names the items in messages.
    """
    given = plain(key, value)
    if _is_number(given):
        array = np.full(robots, check(key, float(given)))
    else:
        bound = f"one number, or a list of {robots} (one per {owner})"
        try:
            entries = [] if isinstance(given, str) else list(given)
        except TypeError:
            entries = []
        if not entries:
            raise InputError(key, value, bound, form_error(key, value, SCALAR).remedy)
        if len(entries) != robots:
            remedy = f"{len(entries)} were given; add or remove entries, or change team.robots"
            raise InputError(key, value, bound, remedy)
        array = np.array([check(f"{key}[{k}]", x) for k, x in enumerate(entries)])
    array.setflags(write=False)
    return array


class ByValue(OneLine):
    """A frozen record that equals others of its type with equal arguments, arrays included.

    Its dataclass is declared with ``eq=False``. Attributes that are derived from arguments are
    ignored. Equal records have equal hashes.
    """

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if not isinstance(other, ByValue) or type(self) is not type(other):
            return NotImplemented
        return self._arguments() == other._arguments()

    def __hash__(self) -> int:
        return hash((type(self), self._arguments()))

    def _arguments(self) -> tuple[Any, ...]:
        """Return the arguments of the record, hashable and comparable."""
        values: Any = self
        return tuple(
            _plain(getattr(values, each.name)) for each in dataclasses.fields(values) if each.init
        )


def _plain(value: Any) -> Any:
    """Return a hashable value; it is the same for arrays, lists and tuples of equal entries."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(map(_plain, value))
    if isinstance(value, Mapping):
        return frozenset((key, _plain(each)) for key, each in value.items())
    return value
