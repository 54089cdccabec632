"""Several faults of one problem file, reported at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from hitchopt.errors import InputError, Place
from hitchopt.units import seen_from

MAX_LISTED = 20
"""Most faults listed for one file; whoever has more will have fewer after repairing these."""

T = TypeVar("T")


class JointInputError(InputError):
    """Several faults at once; ``key``, ``value``, ``bound`` and ``remedy`` are the first one's.

    Attributes
    ----------
    errors: all of them, in the file's order.
    """

    def __init__(self, errors: Sequence[InputError]) -> None:
        first = errors[0]
        super().__init__(first.key, first.value, first.bound, first.remedy, first.place)
        self.errors = tuple(errors)
        lines = [str(error) for error in self.errors[:MAX_LISTED]]
        if len(self.errors) > MAX_LISTED:
            lines.append(f"and {len(self.errors) - MAX_LISTED} more")
        self.args = ("\n".join(lines),)

    def within(self, parent: str) -> JointInputError:
        """Return the same errors with their keys seen from the enclosing mapping ``parent``."""
        return JointInputError([error.within(parent) for error in self.errors])

    def located(self, place_of: Callable[[str], Place | None]) -> JointInputError:
        """Return the same errors with the places in a file that their keys have."""
        return JointInputError([error.located(place_of) for error in self.errors])


class Collector:
    """Gathers faults, so that one run names them all."""

    def __init__(self) -> None:
        self.inputs: list[InputError] = []

    def attempt(self, parent: str, make: Callable[[], T]) -> T | None:
        """Return ``make()``, or None where it raises, gathering the error under ``parent``."""
        try:
            with seen_from(parent):
                return make()
        except InputError as error:
            self.inputs.append(error)
        return None

    def check(self) -> None:
        """Raise what was gathered, as one error."""
        if self.inputs:
            raise one_or_all(self.inputs)

    def made(self, whole: T | None) -> T:
        """Return what was made of all parts, or raise what was gathered."""
        self.check()
        if whole is None:
            raise RuntimeError("a part is missing although nothing was refused")
        return whole


def one_or_all(errors: Sequence[InputError]) -> InputError:
    """Return the only error, or all as one."""
    return errors[0] if len(errors) == 1 else JointInputError(errors)
