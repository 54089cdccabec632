"""Plans made in this process, remembered so that the same request is not planned again.

A request is a function and its arguments; its key is a digest of their pickle, which distinguishes
all contents to the last bit. Two requests of equal contents have different keys only if objects are
shared in one of them and equal copies in the other; the plan is then made again.

What a caller does to a plan never changes the next one (``result_copies``). The environment
variable ``HITCHOPT_MEMORY=off`` turns the memory off; ``forget`` empties it, for example after a
change of the code.
"""

from __future__ import annotations

import copyreg
import hashlib
import io
import os
import pickle
import threading
from collections import OrderedDict
from collections.abc import Callable, Sized
from functools import wraps
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.mission.result_copies import Copies
from hitchopt.time_limit import Progress as Progress  # noqa: PLC0414, exported
from hitchopt.values import Array

VARIABLE = "HITCHOPT_MEMORY"
OFF = "off"

MAX_OUTCOMES = 512
"""Number of plans and refusals that are remembered."""

MAX_BYTES = 256 * 2**20
"""Total size of what is remembered [B]; a step of 1000 robots takes 76 MB."""

P = ParamSpec("P")
T = TypeVar("T")


def _read_only(array: Array) -> Any:
    """Return how an array is pickled: as read-only bytes, also if its memory has gaps."""
    if array.dtype.hasobject:
        return array.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
    order: Literal["F", "C"] = "F" if array.flags.fnc else "C"
    return np.ndarray, (array.shape, array.dtype, array.tobytes(order), 0, None, order)


class _Pickler(pickle.Pickler):
    """Pickles arrays as read-only ones."""

    dispatch_table = copyreg.dispatch_table | {np.ndarray: _read_only}


def pickled(value: object) -> bytes | None:
    """Return a value as bytes, or None if it cannot be pickled; the arrays in it are read-only."""
    stream = io.BytesIO()
    try:
        _Pickler(stream, pickle.HIGHEST_PROTOCOL).dump(value)
    except (pickle.PicklingError, AttributeError, TypeError, ValueError):
        return None
    return stream.getvalue()


class Memory:
    """Values by key, the least recently used ones dropped first; safe to share between threads.

    Parameters
    ----------
    max_outcomes, max_bytes: number of values, and their total length [B].
    """

    def __init__(self, max_outcomes: int = MAX_OUTCOMES, max_bytes: int = MAX_BYTES) -> None:
        self._max_outcomes, self._max_bytes = max_outcomes, max_bytes
        self._values: OrderedDict[bytes, Any] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._values)

    @property
    def size(self) -> int:
        """Total length of the values [B]."""
        return sum(map(len, self._values.values()))

    def recall(self, key: bytes) -> Any:
        """Return the value of a key, or None."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
            return self._values.get(key)

    def store(self, key: bytes, found: Sized) -> None:
        """Remember a value, unless it alone exceeds the memory budget."""
        if len(found) > self._max_bytes:
            return
        with self._lock:
            self._values.pop(key, None)
            self._values[key] = found
            while len(self) > self._max_outcomes or self.size > self._max_bytes:
                self._values.popitem(last=False)

    def forget(self) -> None:
        """Drop all values."""
        with self._lock:
            self._values.clear()


_MEMORY = Memory()


def forget() -> None:
    """Forget all plans of this process: the next ones are planned again."""
    _MEMORY.forget()


def request_key(*request: object) -> bytes | None:
    """Return the digest (32,) of a request, or None if it cannot be pickled or memory is off."""
    off = os.environ.get(VARIABLE, "").lower() == OFF
    given = None if off else pickled(request)
    return None if given is None else hashlib.sha256(given).digest()


def _copies(outcome: object) -> Copies | None:
    """Return what makes copies of an outcome, or None where it holds what it should not."""
    given = pickled(outcome)
    try:
        return None if given is None else Copies(pickle.loads(given), len(given))
    except TypeError:
        return None


def remembered(
    work: Callable[Concatenate[Progress | None, P], T],
    memory: Memory = _MEMORY,
    *,
    copied: bool = True,
) -> Callable[Concatenate[Progress | None, P], T]:
    """Return a function that does its work once for arguments of the same contents.

    Results and InfeasibleErrors are remembered; other errors are not, nor is anything that follows
    an exception of the progress callback. A result is a copy in any case, so that what comes after
    is the same with and without memory.

    Parameters
    ----------
    work: a function whose outcome depends on its arguments alone, except for the first one, the
        progress callback.
    memory: where outcomes are stored.
    copied: whether a new result is a copy too; not where its only user keeps it to itself.
    """

    @wraps(work)
    def found(progress: Progress | None, /, *args: P.args, **kwargs: P.kwargs) -> T:
        key = request_key(work.__module__, work.__qualname__, args, sorted(kwargs.items()))
        known: Copies | None = None if key is None else memory.recall(key)
        raised = []

        def tell(message: str) -> None:
            try:
                if progress is not None:
                    progress(message)
            except BaseException as error:
                raised.append(error)
                raise

        outcome: Any
        if known is not None:
            tell("planned before, taken from memory")
            outcome = known.copy()
        else:
            try:
                outcome = work(None if progress is None else tell, *args, **kwargs), None
            except InfeasibleError as error:
                if raised or type(error) is not InfeasibleError:  # a time limit proves nothing
                    raise
                outcome = None, (error.violations, error.note)
            known = _copies(outcome)
            if known is not None and key is not None and not raised:
                memory.store(key, known)
            if copied and known is not None:
                outcome = known.copy()
        result: T
        result, refusal = outcome
        if refusal is not None:
            raise InfeasibleError(*refusal)
        return result

    return found
