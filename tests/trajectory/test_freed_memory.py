"""Freed memory of arrays is used again."""

import os
import platform
import subprocess
import sys

import pytest

PROBE = """
import resource
import numpy as np
import hitchopt.trajectory
def pages():
    for _ in range(3):
        begun = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        each = [np.ones(250_000) for _ in range(6)]  # 2 MB, 489 pages of 4 KB
        del each
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begun
print(pages())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do as they do")
def test_arrays_are_made_where_others_were_freed() -> None:
    own = {k: v for k, v in os.environ.items() if "MALLOC" not in k and k != "GLIBC_TUNABLES"}
    told = subprocess.check_output([sys.executable, "-c", PROBE], text=True, env=own)
    assert int(told) < 100  # of 2934
