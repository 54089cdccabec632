"""One writer at a time, by a lock that a killed process leaves open."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hitchopt.errors import FileError

PATIENCE = 120.0
"""Longest wait for another writer [s]: a large plan takes about a minute to write."""

POLL = 0.05
"""Interval between looks whether the other writer is done [s]."""

if sys.platform != "win32":
    import fcntl


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock file ``path`` within the block, and remove it afterwards.

    Windows has no locks that end with their process: there the block is entered at once.

    Raises
    ------
    FileError: another process held it all through PATIENCE.
    OSError: it cannot be created.
    """
    if sys.platform == "win32":
        yield
        return
    descriptor = _taken(path)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _taken(path: Path) -> int:
    deadline = time.monotonic() + PATIENCE
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(path.stat(), os.fstat(descriptor)):
                return descriptor
        except (BlockingIOError, FileNotFoundError):
            pass  # another process holds it, or has just removed it: ours locks nobody out
        except OSError:
            return descriptor  # a file system without locks: better unlocked than not at all
        os.close(descriptor)
        if time.monotonic() > deadline:
            raise FileError(
                f"{path}: another process has been writing there for {PATIENCE:g} s; "
                "let it end, or name another directory"
            )
        time.sleep(POLL)
