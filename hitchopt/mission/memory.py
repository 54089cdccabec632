"""What has been planned in this process, so that the very same need not be planned again.

A step after an edit of the last one, the first steps of a mission that a repair plans over and
over, a cell of a notebook run twice: the same function of the same arguments, to the last bit of
every array in them, gives the plan and the certificate that it gave before. Plans and refusals that
say what binds are remembered; what was interrupted, failed otherwise or has arguments that cannot
be compared in full is not. In memory only, of a bounded size, what was not used for longest going
first.

``HITCHOPT_MEMORY=off`` does without; ``forget`` empties it, as after a change of the code.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.mission.contents import UnknownContents, digest_of
from hitchopt.mission.sealing import Sealed, sealed

VARIABLE = "HITCHOPT_MEMORY"
OFF = "off"

MOST = 512
"""Things remembered."""

MOST_BYTES = 256 * 2**20
"""[B] Of all of them together: a mission of one step with 1000 robots takes 76 MB."""

Progress = Callable[[str], None]

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Refusal:
    """What an InfeasibleError says.

    Attributes
    ----------
    violations, note: of it.
    """

    violations: tuple[Violation, ...]
    note: str


class Memory:
    """Sealed values by digest, of a bounded number and size; for any number of threads.

    Parameters
    ----------
    most, most_bytes: values, and [B] of all of them, beyond which the least recently used one goes.
    """

    def __init__(self, most: int = MOST, most_bytes: int = MOST_BYTES) -> None:
        self._most, self._most_bytes = most, most_bytes
        self._values: OrderedDict[bytes, Sealed[Any]] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._values)

    @property
    def size(self) -> int:
        """Of all values together [B]."""
        return self._size

    def recall(self, key: bytes) -> Any | None:
        """Return the value of a key, or None."""
        with self._lock:
            found = self._values.get(key)
            if found is None:
                return None
            self._values.move_to_end(key)
            return found.value

    def keep(self, key: bytes, found: Sealed[Any]) -> None:
        """Keep a value, unless it alone is larger than all of them may be."""
        if found.size > self._most_bytes:
            return
        with self._lock:
            known = self._values.pop(key, None)
            self._size += found.size - (0 if known is None else known.size)
            self._values[key] = found
            while len(self._values) > self._most or self._size > self._most_bytes:
                self._size -= self._values.popitem(last=False)[1].size

    def forget(self) -> None:
        """Forget everything."""
        with self._lock:
            self._values.clear()
            self._size = 0


_MEMORY = Memory()


def forget() -> None:
    """Forget all plans of this process, so that the next ones are planned anew."""
    _MEMORY.forget()


def remembered(
    work: Callable[Concatenate[Progress | None, P], T], memory: Memory = _MEMORY
) -> Callable[Concatenate[Progress | None, P], T]:
    """Return a function that does its work once for the same arguments.

    Its first argument, which is told of progress, is none of them: ``work`` must return or raise
    the same whatever that is. All that ``work`` depends on has to be among the others.
    """

    @wraps(work)
    def found(progress: Progress | None, /, *args: P.args, **kwargs: P.kwargs) -> T:
        key = _key(work.__module__, work.__qualname__, args, sorted(kwargs.items()))
        known = None if key is None else memory.recall(key)
        if known is not None and progress is not None:
            progress("planned before, taken from memory")
        if isinstance(known, Refusal):
            raise InfeasibleError(known.violations, known.note)
        if known is not None:
            result: T = known
            return result
        listener = _Listener(progress)
        try:
            made = work(None if progress is None else listener, *args, **kwargs)
        except InfeasibleError as error:
            if type(error) is InfeasibleError:
                kept = None if listener.raised else key
                _sealed_and_kept(memory, kept, Refusal(error.violations, error.note))
            raise
        return _sealed_and_kept(memory, None if listener.raised else key, made)

    return found


class _Listener:
    """Passes on what is told, and knows whether it is the listener that has raised."""

    def __init__(self, progress: Progress | None) -> None:
        self.progress = progress
        self.raised = False

    def __call__(self, message: str) -> None:
        try:
            if self.progress is not None:
                self.progress(message)
        except BaseException:
            self.raised = True
            raise


def _key(*values: object) -> bytes | None:
    """Return the digest of all that a result depends on; None where it is not to be remembered."""
    if os.environ.get(VARIABLE, "").lower() == OFF:
        return None
    try:
        return digest_of(*values)
    except UnknownContents:
        return None


def _sealed_and_kept(memory: Memory, key: bytes | None, value: T) -> T:
    """Return the value as whoever asks next will get it, kept if it has a key.

    Sealed in any case, so that what comes after is the same whether or not things are remembered.
    """
    try:
        found = sealed(value)
    except UnknownContents:
        return value
    if key is not None:
        memory.keep(key, found)
    return found.value
