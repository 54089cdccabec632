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
"""[s] How long to wait for another writer: a large plan takes about a minute to write."""

POLL = 0.05
"""[s] How often to look whether the other writer is done."""

if sys.platform == "win32":

    @contextlib.contextmanager
    def locked(path: Path) -> Iterator[None]:
        """Do nothing: this system has no locks that end with their process."""
        del path
        yield

else:
    import fcntl

    @contextlib.contextmanager
    def locked(path: Path) -> Iterator[None]:
        """Hold the lock file ``path`` within the block, and remove it afterwards.

        Raises
        ------
        FileError: another process held it all through PATIENCE.
        OSError: it cannot be created.
        """
        descriptor = _taken(path, time.monotonic() + PATIENCE)
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(descriptor)

    def _taken(path: Path, deadline: float) -> int:
        while True:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(descriptor)
                if time.monotonic() > deadline:
                    raise FileError(
                        f"{path}: another process has been writing there for {PATIENCE:g} s; "
                        "let it end, or name another directory"
                    ) from None
                time.sleep(POLL)
                continue
            except OSError:
                return descriptor  # a file system without locks: better unlocked than not at all
            if _names(path, descriptor):
                return descriptor
            os.close(descriptor)  # its last holder has removed it: what we hold locks nobody out

    def _names(path: Path, descriptor: int) -> bool:
        try:
            return os.path.samestat(path.stat(), os.fstat(descriptor))
        except FileNotFoundError:
            return False
