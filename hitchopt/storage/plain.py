"""Plain data: mappings, lists, text, numbers, booleans and nothing; bounded in depth and size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from hitchopt.errors import InputError

Plain = dict[str, "Plain"] | list["Plain"] | str | int | float | bool | None
"""What a problem file is made of."""

MAX_DEPTH = 20
"""Levels of nesting; a problem has six."""

MAX_NODES = 250_000
"""Values in all. A polygon for MAX_ROBOTS robots takes 30 000; reading so many takes seconds."""

MAX_TEXT = 10_000
"""Characters of one text; the longest that means something is the title."""

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
    """Counts values while data are read, and refuses to go on beyond MAX_NODES or MAX_DEPTH."""

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
            raise InputError(
                key_path(path),
                f"{len(path)} levels",
                f"nested at most {MAX_DEPTH} levels deep",
                "no problem file needs more than six",
            )
        if self.nodes > MAX_NODES:
            raise InputError(
                key_path(path),
                f"{self.nodes} values",
                f"within {MAX_NODES} values in all",
                "plan fewer steps at a time",
            )


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
            raise InputError(
                key_path(path),
                f"{data.size} values",
                f"within {MAX_NODES} values in all",
                "give less",
            )
        data = data.tolist()
    if data is None or isinstance(data, bool | float):
        return data
    if isinstance(data, int):
        if abs(data) > _LARGEST:
            return math.inf if data > 0 else -math.inf
        return int(data)
    if isinstance(data, str):
        if len(data) > MAX_TEXT:
            raise InputError(
                key_path(path), data, f"at most {MAX_TEXT} characters long", "shorten it"
            )
        return str(data)
    if isinstance(data, Mapping):
        return _plain_mapping(data, path, budget)
    if isinstance(data, list | tuple):
        return [_plain(entry, [*path, i], budget) for i, entry in enumerate(data)]
    raise InputError(
        key_path(path) or "problem",
        type(data).__name__,
        "a mapping, list, text, number, boolean or nothing",
        "give plain data",
    )


def _plain_mapping(
    data: Mapping[object, object], path: list[str | int], budget: Budget
) -> dict[str, Plain]:
    result: dict[str, Plain] = {}
    for key, value in data.items():
        if not isinstance(key, str):
            raise InputError(
                key_path(path) or "problem",
                key,
                "a mapping whose keys are text",
                "write the key as a name",
            )
        result[str(key)] = _plain(value, [*path, key], budget)
    return result
