"""Whether compiled code is used: only where it pays, as numba takes a while to load."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, partial
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from hitchopt.values import Array

F = TypeVar("F", bound=Callable[..., Any])

_ON: ContextVar[bool] = ContextVar("on", default=False)


def kernels_on() -> bool:
    """Return whether compiled code is to be used here."""
    return _ON.get()


@contextmanager
def kernels(*, on: bool = True) -> Iterator[bool]:
    """Use compiled code within the context, in its own thread, if numba is installed.

    Plans that are made within take less time, and differ from others by rounding, as do their
    certificates. Code is compiled where it is first called, which takes up to a minute, and
    kept on disk: this pays where many plans are made. ``Replanner`` and ``Feedback`` use it anyway.

    Yields whether it is used.
    """
    used = on and find_spec("numba") is not None
    token = _ON.set(used)
    try:
        yield used
    finally:
        _ON.reset(token)


def inlined(function: F) -> F:
    """Compile a function as ``kernel`` does, and what calls it with a copy of it.

    For what is called from one place, many times.
    """
    return kernel(function, inline=True)


def kernel(function: F, *, inline: bool = False) -> F:
    """Compile a function when it is first called, and keep the result on disk where that can be.

    Divisions by zero give what numpy makes of them. Numba notices changes of a kernel's own file
    only, not of other kernels that it calls: names of its files carry the digest of them all.
    """
    from numba import njit

    compile_it = partial(njit, error_model="numpy", forceinline=inline)
    try:
        function.__qualname__ += f"_{sources_digest(Path(function.__code__.co_filename).parent)}"
        return cast(F, compile_it(function, cache=True))
    except (OSError, RuntimeError):  # no sources, or no place that can be written
        return cast(F, compile_it(function))


def writable(values: Array) -> Array:
    """Return an array as kernels take it, a copy where it is read-only or not in order.

    Code is compiled for one kind of memory.
    """
    return values if values.flags.carray else np.array(values, order="C")


@cache
def sources_digest(folder: Path) -> str:
    """Return a digest of all Python files in a folder."""
    digest = sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(sha256(path.name.encode() + b"\0" + path.read_bytes()).digest())
    return digest.hexdigest()[:16]
