"""Sizes of errors that nobody knows: bounds, or standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

from hitchopt.errors import InputError
from hitchopt.one_line import OneLine
from hitchopt.values import not_negative

DEVIATIONS = 3.0
"""Standard deviations that a range covers: 99.7 % of normal errors."""

MARK = "sd:"
"""What a standard deviation begins with on the command line: ``sd:0.01``."""


@dataclass(frozen=True)
class ErrorSize(OneLine):
    """Size of one kind of error, alike and independent for all that it befalls.

    Parameters
    ----------
    bound: largest error; of vectors their largest length.
    deviation: standard deviation, of vectors per axis; it adds to the bound.

    Raises
    ------
    InputError: a negative number.
    """

    bound: float = 0.0
    deviation: float = 0.0

    def __post_init__(self) -> None:
        for name in ("bound", "deviation"):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))

    @classmethod
    def of(cls, key: str, given: ErrorSize | float) -> ErrorSize:
        """Return the size; a number is a bound.

        Raises
        ------
        InputError: a negative number.
        """
        return given if isinstance(given, ErrorSize) else cls(not_negative(key, given))

    @classmethod
    def parsed(cls, key: str, text: str) -> ErrorSize:
        """Return the size that a text says: ``0.01`` is a bound, ``sd:0.01`` a deviation.

        Raises
        ------
        InputError: no such text.
        """
        try:
            number = float(text.removeprefix(MARK))
        except ValueError:
            raise InputError(key, text, "a number, or sd:number", f"write {MARK}0.01") from None
        size = not_negative(key, number)
        return cls(deviation=size) if text.startswith(MARK) else cls(size)

    @property
    def words(self) -> str:
        """What it says, without a unit: ``±0.01`` or ``sd 0.01``."""
        parts = [f"±{self.bound:g}"] if self.bound or not self.deviation else []
        return " and ".join([*parts, *([f"sd {self.deviation:g}"] if self.deviation else [])])


@dataclass(frozen=True)
class Errors:
    """Errors of a hitch.

    Parameters
    ----------
    cable: of every cable's length [m].
    position: of every drone's set point, a vector [m].
    force: of every drone's force feed-forward, a vector [N].
    """

    cable: ErrorSize = ErrorSize()
    position: ErrorSize = ErrorSize()
    force: ErrorSize = ErrorSize()
