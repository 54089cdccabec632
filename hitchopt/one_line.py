"""Short texts of records: one line each, however much they hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

LONGEST = 100
"""Most characters of a record's text."""

LONGEST_TEXT = 30
"""Most characters of a text in it."""

SMALL = 8
"""Most numbers of an array that is written out."""


class OneLine:
    """A record whose ``repr`` is one line of at most LONGEST characters.

    It names the fields that differ from their defaults, until the line is full.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            # What is there already, ``dataclass`` does not replace.
            cls.__repr__ = cls.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        return one_line(type(self).__name__, self._parts())

    def _parts(self) -> Iterator[str]:
        """Yield what stands between the parentheses."""
        assert is_dataclass(self)
        for field in fields(self):
            value = getattr(self, field.name)
            if field.repr and not _is_default(value, field.default, field.default_factory):
                yield f"{field.name}={short(value)}"


def one_line(name: str, parts: Iterable[str]) -> str:
    """Return ``name(part, …)`` on one line, cut at LONGEST characters."""
    text = " ".join(f"{name}({', '.join(parts)})".split())  # a user's words may have line breaks
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 2]}…)"


def short(value: object) -> str:
    """Return a value in few characters: arrays by their shape, records by their name."""
    array: Any = value
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        same = array.ndim == 1 and array.size > 0 and bool((array == array[0]).all())
        if not same and array.size > SMALL:
            return f"array{array.shape}"
        value = array[0].item() if same else array.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str):
        text = str(value)  # of an enumeration too
        return repr(text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 1]}…")
    if isinstance(value, tuple | list):
        if _count(value) <= SMALL:
            return f"[{', '.join(map(short, value))}]"
        return f"<{len(value)} entries>"
    return repr(value) if isinstance(value, bool | int | None) else f"{type(value).__name__}(…)"


def _count(values: object) -> int:
    """Return how many values a sequence of sequences holds; more than SMALL if any is none."""
    if isinstance(values, tuple | list):
        return sum(map(_count, values))
    return 1 if isinstance(values, str | bool | int | float | None) else SMALL + 1


def _is_default(value: object, default: object, factory: Any) -> bool:
    """Return whether a field need not be said."""
    if factory is not MISSING:
        default = factory()
    if value is default:
        return True
    return (
        isinstance(value, str | bool | int | float | tuple | OneLine)
        and type(value) is type(default)
        and bool(value == default)
    )
