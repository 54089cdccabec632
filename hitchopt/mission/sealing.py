"""Records that nobody can change any more, not even who asks numpy to let them."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import Enum
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.mission.contents import KINDS, UnknownContents, held_by

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Sealed(Generic[T]):
    """A record whose arrays all lie in memory that cannot be written to.

    Attributes
    ----------
    value: the record.
    size: memory that it takes [B], about.
    """

    value: T
    size: int


def sealed(value: T) -> Sealed[T]:
    """Return a copy of a record of arrays, numbers, words and tuples of these, sealed.

    Parts that were one stay one.

    Raises
    ------
    UnknownContents: it holds anything else, such as a list, or a record that is not frozen.
    """
    copier = _Copier()
    copy: T = copier.copied(value)
    return Sealed(copy, copier.size)


class _Copier:
    """Copies what it has not copied yet."""

    def __init__(self) -> None:
        self.size = 0
        self._known: dict[int, Any] = {}

    def copied(self, value: Any) -> Any:
        kind = type(value)
        if value is None or kind in {bool, int, float, str} or isinstance(value, np.generic | Enum):
            self.size += sys.getsizeof(value)
            return value
        found = self._known.get(id(value))
        if found is None:
            found = self._known[id(value)] = self._new(value)
            self.size += sys.getsizeof(found)
        return found

    def _new(self, value: Any) -> Any:
        kind = type(value)
        if kind is np.ndarray and value.dtype.kind in KINDS:
            self.size += value.nbytes
            return _written_down(value)
        if kind is tuple:
            return tuple(self.copied(item) for item in value)
        held = held_by(value)
        if not kind.__dataclass_params__.frozen:
            raise UnknownContents(f"{kind.__qualname__}, which is not frozen")
        record = object.__new__(kind)  # it has been checked when it was made
        for name, part in held.items():
            object.__setattr__(record, name, self.copied(part))
        return record


def _written_down(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array in bytes of Python's, which numpy never writes to, its axes in order."""
    dense = array.copy(order="K")
    memory = dense.ravel(order="K").tobytes()
    return np.ndarray(dense.shape, dense.dtype, memory, strides=dense.strides)
