"""Memory of arrays that are no longer used, kept for the next ones."""

from __future__ import annotations

import numpy as np

LARGEST = 2**25 - 2**16
"""[B] Just below 32 MiB: glibc, the C library of Linux, learns nothing from larger arrays."""


def keep_freed_memory() -> None:
    """Let the C library keep freed memory of arrays for the next ones: up to twice LARGEST.

    At first glibc returns arrays of 128 KiB and more to the system when they are freed, and each
    new one is mapped page by page: 24,000 page faults in a certificate of 100 robots. The largest
    array that was freed, up to 32 MiB, raises that size. This one is never written to, and so
    takes no memory itself. Other C libraries go on as before.
    """
    np.empty(LARGEST, dtype=np.uint8)
