"""Plain data: mappings, lists, text, numbers, booleans and nothing; bounded in depth and size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from hitchopt.errors import InputError

Plain = dict[str, "Plain"] | list["Plain"] | str | int | float | bool | None
"""Data that a problem file is made of."""

MAX_DEPTH = 20
"""Levels of nesting; a problem has six."""

MAX_NODES = 250_000
"""Values in all. A polygon for MAX_ROBOTS robots takes 30 000; reading so many takes seconds."""

MAX_TEXT = 10_000
"""Characters of one text; the longest meaningful one is the title."""

_LARGEST = 10**300
"""Whole numbers beyond it are infinite for every purpose here, and costly to print."""


def key_path(parts: Iterable[str | int]) -> str:
    """Return a path as messages show it, such as ``mission[0].morph.legs[1]``.

    Keys that are no names are quoted, so that no control character reaches a terminal.
    """
    path = ""
    for part in parts:
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            name = part if part.isidentifier() and part.isascii() else repr(part)
            name = name if len(name) <= 60 else f"{name[:57]}..."
            path += f".{name}" if path else name
    return path


class Budget:
    """Limits on plain data while they are read: MAX_NODES values, MAX_DEPTH levels, MAX_TEXT."""

    def __init__(self) -> None:
        self.nodes = 0

    def spend(self, path: list[str | int]) -> None:
        """Count one value at ``path``.

        Raises
        ------
        InputError: too deep, or too many.
        """
        self.nodes += 1
        if len(path) > MAX_DEPTH:
            bound = f"nested at most {MAX_DEPTH} levels deep"
            remedy = "no problem file needs more than six"
            raise InputError(key_path(path), f"{len(path)} levels", bound, remedy)
        if self.nodes > MAX_NODES:
            bound = f"within {MAX_NODES} values in all"
            remedy = "plan fewer steps at a time"
            raise InputError(key_path(path), f"{self.nodes} values", bound, remedy)

    def checked(self, value: Plain, path: list[str | int]) -> Plain:
        """Return a scalar, or raise InputError where it is too long a text."""
        if isinstance(value, str) and len(value) > MAX_TEXT:
            bound = f"at most {MAX_TEXT} characters long"
            raise InputError(key_path(path), value, bound, "shorten it")
        return value


def plain(data: object) -> Plain:
    """Return ``data`` with mappings as dict, sequences and arrays as list, scalars as Python's.

    Raises
    ------
    InputError: other types, keys that are not text, cycles, too deep or too large data.
    """
    return _plain(data, [], Budget())


def _plain(data: object, path: list[str | int], budget: Budget) -> Plain:
    budget.spend(path)
    if isinstance(data, np.ndarray | np.generic):
        if data.size > MAX_NODES:  # before a list of it is made
            bound = f"within {MAX_NODES} values in all"
            raise InputError(_where(path), f"{data.size} values", bound, "give less")
        data = data.tolist()
    if data is None or isinstance(data, bool | float):
        return data
    if isinstance(data, int):
        infinite = math.inf if data > 0 else -math.inf
        return int(data) if abs(data) <= _LARGEST else infinite
    if isinstance(data, str):
        return budget.checked(str(data), path)
    if isinstance(data, list | tuple):
        return [_plain(entry, [*path, i], budget) for i, entry in enumerate(data)]
    if not isinstance(data, Mapping):
        bound = "a mapping, list, text, number, boolean or nothing"
        raise InputError(_where(path), type(data).__name__, bound, "give plain data")
    for key in data:
        if not isinstance(key, str):
            bound, remedy = "a mapping whose keys are text", "write the key as a name"
            raise InputError(_where(path), key, bound, remedy)
    return {str(key): _plain(value, [*path, key], budget) for key, value in data.items()}


def _where(path: list[str | int]) -> str:
    return key_path(path) or "problem"
