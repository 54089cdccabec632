"""Checks of single values, with one set of messages for all records."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError

Array = NDArray[np.float64]
"""Type of arrays of real numbers."""

Indices = NDArray[np.intp]
"""Type of arrays of indices."""

MAX_COORDINATE = 1e5
"""Largest coordinate [m]: double precision does not resolve the tolerances of a plan beyond it."""


ONE, EACH, WORD, FLAG, MAPPING = "a number", "a list", "a word", "true or false", "a mapping"
"""Forms of values."""

_FORMS = (
    ((bool, np.bool_), FLAG, "write true or false"),
    ((int, float, np.number), ONE, "give a plain number in SI units"),
    ((list, tuple, np.ndarray), EACH, "write a list in brackets"),
    ((str,), WORD, "put it in quotes if it is meant as text"),
    ((Mapping,), MAPPING, "write {key: value, …}"),
)


def form_of(value: object) -> str:
    """Return the form of a value, empty for others; records are mappings."""
    if is_dataclass(value):
        return MAPPING
    return next((form for kinds, form, _ in _FORMS if isinstance(value, kinds)), "")


def misfit(key: str, value: object, *bounds: str) -> InputError:
    """Return the error of a value that has none of the forms, or other bounds."""
    remedy = next((remedy for _, form, remedy in _FORMS if form in bounds), "write a list")
    if value is None:
        remedy = "give a value, or leave it out"
    elif ONE in bounds and isinstance(value, str) and re.fullmatch(r"[-+]?[\d.]+(e-?\d+)?", value):
        remedy = "remove the quotes"
    elif ONE in bounds and isinstance(value, str) and re.fullmatch(r"[-+]?\d+,\d+", value):
        remedy = f"write {value.replace(',', '.')}: decimals have a point"
    return InputError(key, value, " or ".join(bounds), remedy)


def instance(key: str, value: object, *kinds: type) -> None:
    """Raise InputError unless ``value`` is of one of the public classes ``kinds``."""
    if not isinstance(value, kinds):
        names = " or ".join(f"hitchopt.{kind.__name__}" for kind in kinds)
        raise InputError(key, value, f"a {names}", f"build one with hitchopt.{kinds[0].__name__}")


def flag(key: str, value: object) -> bool:
    """Return ``value``, or raise InputError unless it is true or false."""
    if not isinstance(value, bool | np.bool_):
        raise misfit(key, value, FLAG)
    return bool(value)


def path(key: str, value: object) -> Path:
    """Return ``value`` as a path, or raise InputError unless it is a path or a string."""
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
    "mass": "weight",
    "at": "position place origin",
    "speed": "velocity",
    "seconds": "duration time",
    "duration": "seconds time",
    "friction": "mu",
    "objects": "obstacles",
    "crazyswarm2": "crazyflie crazyfly",
}
"""Words that users write, by what they may mean where it is known."""


def closest_word(word: str, known: Sequence[str], otherwise: str = "") -> str:
    """Return the question whether a valid word was meant, one of the same sense or the closest.

    Where there is none it is ``otherwise``, by default all valid words.
    """
    close = [name for name in known if word.lower() in SYNONYMS.get(name, "").split()]
    close += difflib.get_close_matches(word[:60], known, n=1, cutoff=0.6)
    listed = otherwise or f"use one of {', '.join(known)}"
    return f"did you mean {close[0]}?" if close else listed


def choice(key: str, value: object, names: Sequence[str]) -> None:
    """Raise InputError unless ``value`` is one of ``names``."""
    if not isinstance(value, str) or value not in names:
        remedy = closest_word(str(value), names, f"write {names[0]!r}")
        raise InputError(key, value, f"one of {', '.join(names)}", remedy)


def text(key: str, value: object) -> str:
    """Return ``value``, or raise InputError unless it is a string."""
    if not isinstance(value, str):
        raise InputError(key, value, "a string", "write it in quotation marks")
    return value


def sequence(key: str, value: object) -> tuple[Any, ...]:
    """Return the entries of a list or another iterable, or raise InputError if it is none."""
    try:
        return tuple(value)  # type: ignore[arg-type]
    except TypeError:
        raise InputError(key, value, "a list", "write [ ] around it") from None


def whole(key: str, value: object, least: int, most: int | None = None) -> int:
    """Return ``value``, or raise InputError unless it is an integer from ``least`` to ``most``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InputError(key, value, "an integer", "give a whole number")
    if value < least:
        raise InputError(key, value, f"at least {least}", f"give {least} or more")
    if most is not None and value > most:
        raise InputError(key, value, f"at most {most}", f"give {most} or less")
    return int(value)


def positive(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError unless it is finite and above zero."""
    number = finite(key, value)
    if number <= 0.0:
        raise InputError(key, value, "greater than 0", "give a positive number")
    return number


def not_negative(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError unless it is finite and at least zero."""
    number = finite(key, value)
    if number < 0.0:
        raise InputError(key, value, "at least 0", "give zero or a positive number")
    return number


def finite(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError unless it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise misfit(key, value, ONE)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(key, value, "finite", "nan and inf are no quantities")
    return number


def coordinate(key: str, value: object) -> float:
    """Return ``value`` as a float, or raise InputError if it is beyond ±MAX_COORDINATE."""
    number = finite(key, value)
    if abs(number) > MAX_COORDINATE:
        bound = f"within ±{MAX_COORDINATE:g} m"
        raise InputError(key, value, bound, "double precision does not resolve plans beyond")
    return number


def as_array(value: object) -> Array:
    """Return a copy of ``value`` as an array; an empty one if it is no array of numbers."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.empty(0)


def points(key: str, value: object, shape: tuple[int, int], bound: str, remedy: str) -> Array:
    """Return points [m] as a read-only array, or raise InputError if one exceeds MAX_COORDINATE.

    ``shape`` is the minimum number of points, and their number of coordinates; ``bound`` and
    ``remedy`` are those of the error for another shape.
    """
    array = as_array(value)
    if array.ndim != 2 or array.shape[1] != shape[1] or len(array) < shape[0]:
        raise InputError(key, value, bound, remedy)
    good = np.abs(array) <= MAX_COORDINATE  # not of nan
    if not good.all():
        k = int(np.argmin(np.all(good, axis=1)))
        bound, remedy = f"finite and within ±{MAX_COORDINATE:g} m", "check the point's coordinates"
        raise InputError(f"{key}[{k}]", array[k].tolist(), bound, remedy)
    array.setflags(write=False)
    return array


def per_robot(
    key: str,
    value: float | Sequence[float] | ArrayLike,
    robots: int,
    checked: Callable[[str, object], float] = positive,
    owner: str = "robot",
) -> NDArray[np.float64]:
    """Return ``value`` as a read-only array (robots,); one number applies to all robots.

    ``owner`` names the items in messages if they are not robots. ``checked`` checks every number.
    """
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        array = np.full(robots, checked(key, float(value)))
    else:
        bound = f"one number, or a list of {robots} (one per {owner})"
        try:
            entries = [] if isinstance(value, str) else list(value)  # type: ignore[arg-type]
        except TypeError:
            entries = []
        if not entries:
            raise InputError(key, value, bound, misfit(key, value, ONE).remedy)
        if len(entries) != robots:
            remedy = f"{len(entries)} were given; add or remove entries, or change team.robots"
            raise InputError(key, value, bound, remedy)
        array = np.array([checked(f"{key}[{k}]", x) for k, x in enumerate(entries)])
    array.setflags(write=False)
    return array
