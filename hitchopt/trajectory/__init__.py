"""Piecewise polynomials of time in Bernstein form, for any quantity."""

import numpy as np

from hitchopt.trajectory.piecewise import PiecewisePolynomial as PiecewisePolynomial
from hitchopt.trajectory.piecewise import joined as joined

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


keep_freed_memory()
