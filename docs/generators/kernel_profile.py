"""The profile of the kernels that execute tutorials: nobody's own, and whole outputs of commands."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path

STARTUP = """
import subprocess

from IPython import get_ipython


def bash(line, cell):
    command = ["bash", "-c", cell]
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(command, **both, text=True, encoding="utf-8", check=False)
    print(done.stdout, end="")
    done.check_returncode()


get_ipython().register_magic_function(bash, "cell", "bash")
"""
"""IPython's own ``%%bash`` prints in pieces of 100 bytes, which end up on lines of their own."""


def kernel_profile() -> str:
    """Return a new directory for ``IPYTHONDIR``, in which ``%%bash`` prints all at once."""
    place = Path(tempfile.mkdtemp(prefix="hitchopt-docs-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    startup = place / "profile_default" / "startup"
    startup.mkdir(parents=True)
    (startup / "bash_magic.py").write_text(STARTUP, encoding="utf-8")
    return str(place)
