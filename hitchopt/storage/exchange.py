"""Exchanging two directory entries in one step: what POSIX lacks and kernels have.

``rename`` replaces a file at once, but a directory only when it is empty. Linux has
``renameat2(RENAME_EXCHANGE)`` and macOS ``renamex_np(RENAME_SWAP)``; Python offers neither.
"""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path

AT_FDCWD = -100
"""Linux: relative paths start at the current directory."""

RENAME_EXCHANGE = 2
"""Linux: the flag of renameat2."""

RENAME_SWAP = 2
"""MacOS: the flag of renamex_np."""


def exchange(first: Path, second: Path) -> None:
    """Let the two existing entries change places, at once.

    Raises
    ------
    OSError: ENOSYS where the system knows no such call; else what the system says.
    """
    a, b = os.fsencode(first), os.fsencode(second)
    library = ctypes.CDLL(None, use_errno=True) if os.name == "posix" else None
    if sys.platform == "darwin":
        call = getattr(library, "renamex_np", None)
        arguments: tuple[object, ...] = (a, b, ctypes.c_uint(RENAME_SWAP))
    else:
        call = getattr(library, "renameat2", None)
        arguments = (AT_FDCWD, a, AT_FDCWD, b, ctypes.c_uint(RENAME_EXCHANGE))
    if call is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS), str(second))
    if call(*arguments) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(second))
