"""Start-up file of the kernels that execute tutorials: ``%%bash`` prints all of an output at once.

IPython's own prints in pieces of 100 bytes, which end up on lines of their own.
"""

import subprocess
import sys

from IPython import get_ipython


def bash(_line: str, cell: str) -> None:
    """Run a cell with bash."""
    command, both = ["bash", "-c", cell], subprocess.STDOUT
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=both, check=False)
    sys.stdout.write(done.stdout.decode())
    done.check_returncode()


get_ipython().register_magic_function(bash, "cell", "bash")
