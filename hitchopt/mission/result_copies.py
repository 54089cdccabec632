"""Copies of a result, made faster than by unpickling it: records are new, arrays share bytes."""

from __future__ import annotations

from dataclasses import is_dataclass
from enum import Enum
from typing import Any

import numpy as np

Part = tuple[type, Any, tuple[tuple[Any, int], ...]]
"""A record, dict, tuple or array: its kind, what copies share, and which parts it holds where."""

SHARED = (str, bool, int, float, type(None), Enum, np.generic)
"""Kinds of values that nobody can change."""


class Copies:
    """Makes copies of a value; what is done to one copy, even by force, changes no other.

    Parameters
    ----------
    value: of records, dicts, tuples, numbers, texts and arrays over bytes, which stay read-only.
    size: memory that it takes [B], given as its length.

    Raises
    ------
    TypeError: it holds anything else.
    """

    def __init__(self, value: Any, size: int) -> None:
        self._size = size
        self._parts: list[Part] = []
        self._indices: dict[int, int] = {}
        self._add(value)
        self._indices.clear()

    def __len__(self) -> int:
        return self._size

    def _add(self, value: Any) -> int:
        """Return the index of a part, added after those that it holds."""
        if id(value) not in self._indices:
            self._parts.append(self._part(value))
            self._indices[id(value)] = len(self._parts) - 1
        return self._indices[id(value)]

    def _part(self, value: Any) -> Part:
        kind = type(value)
        if kind is np.ndarray or isinstance(value, SHARED):
            return (np.ndarray if kind is np.ndarray else object), value, ()
        if kind is tuple:
            return tuple, None, tuple((None, self._add(item)) for item in value)
        if kind is not dict and not is_dataclass(value):
            raise TypeError(f"no copies of {kind.__name__}")
        items = value if kind is dict else vars(value)
        own = {key: item for key, item in items.items() if isinstance(item, SHARED)}
        held = ((key, self._add(item)) for key, item in items.items() if key not in own)
        return kind, own, tuple(held)

    def copy(self) -> Any:
        """Return another copy."""
        made: list[Any] = []
        for kind, own, held in self._parts:
            if kind is np.ndarray:
                made.append(own.view())
            elif kind is tuple:
                made.append(tuple([made[i] for _, i in held]))
            elif kind is object:
                made.append(own)
            else:
                found: Any = {} if kind is dict else object.__new__(kind)  # has been checked
                items = found if kind is dict else found.__dict__
                items.update(own)
                for key, i in held:
                    items[key] = made[i]
                made.append(found)
        return made[-1]
