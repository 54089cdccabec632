"""Records that compare by value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from hitchopt.errors import OneLine


class ByValue(OneLine):
    """A frozen record that equals others of its type with equal arguments, arrays included.

    Its dataclass is declared with ``eq=False``. Attributes that are derived from arguments do not
    count. Equal records have equal hashes.
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
        return tuple(_plain(getattr(values, each.name)) for each in fields(values) if each.init)


def _plain(value: Any) -> Any:
    """Return a hashable value; it is the same for arrays, lists and tuples of equal entries."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(map(_plain, value))
    if isinstance(value, Mapping):
        return frozenset((key, _plain(each)) for key, each in value.items())
    return value
