"""What several checks need of a motion, computed once for all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from hitchopt.motion.motion import Motion

T = TypeVar("T")

Shared = WeakKeyDictionary[Motion, dict[Callable[[Motion], Any], Any]]

_SHARED: ContextVar[Shared | None] = ContextVar("shared", default=None)


@contextmanager
def shared_values() -> Iterator[None]:
    """Keep values within the outermost context: they take more memory than the motion itself."""
    if _SHARED.get() is not None:
        yield
        return
    token = _SHARED.set(WeakKeyDictionary())
    try:
        yield
    finally:
        _SHARED.reset(token)


def once(motion: Motion, value: Callable[[Motion], T]) -> T:
    """Return a value of a motion, which within ``shared_values`` is computed once.

    Nobody may change it.
    """
    shared = _SHARED.get()
    if shared is None:
        return value(motion)
    kept = shared.setdefault(motion, {})
    if value not in kept:
        kept[value] = value(motion)
    found: T = kept[value]
    return found
