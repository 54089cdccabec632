"""Piecewise polynomials of time in Bernstein form, for any quantity."""

import numpy as np

from hitchopt.trajectory.piecewise import PiecewisePolynomial as PiecewisePolynomial
from hitchopt.trajectory.piecewise import joined as joined

MMAP_THRESHOLD = 2**25 - 2**16
"""[B] Just below 32 MiB: glibc, the C library of Linux, does not adapt to larger arrays."""


# Let the C library reuse the memory of freed arrays, up to twice MMAP_THRESHOLD. By default glibc
# returns arrays of 128 KiB and more to the system when they are freed, and maps each new one page
# by page: 24,000 page faults in a certificate of 100 robots. Freeing an array of up to 32 MiB
# raises that threshold to its size. The array here is never written to, so it takes no memory
# itself. Other C libraries are not affected.
np.empty(MMAP_THRESHOLD, dtype=np.uint8)
