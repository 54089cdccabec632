"""What every refusal has: the key of what is wrong, words that say how, and what to do."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

import hitchopt as ho

# A call, the key that its error names, and a part of its message
Refusal = tuple[Callable[[], object], str, str]


@contextmanager
def memory_below(limit: float) -> Iterator[None]:
    """Check that Python allocates less than a limit [B] in the context."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < limit


def assert_refused(call: Callable[[], object], key: str, words: str) -> None:
    """Check that a call ends with an InputError of this key and with these words in it."""
    with pytest.raises(ho.InputError) as caught:
        call()
    assert caught.value.key == key
    assert words in str(caught.value)
    assert caught.value.bound
    assert caught.value.remedy
