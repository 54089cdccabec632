"""Start-up file of the kernels that execute tutorials: ``%%bash`` prints an output at once.

IPython's own magic prints pieces of 100 bytes on separate lines.
"""

import subprocess
import sys

from IPython import get_ipython


def bash(_line: str, cell: str) -> None:
    """Run a cell with bash."""
    command, to_stdout = ["bash", "-c", cell], subprocess.STDOUT
    process = subprocess.run(command, stdout=subprocess.PIPE, stderr=to_stdout, check=False)
    sys.stdout.write(process.stdout.decode())
    process.check_returncode()


get_ipython().register_magic_function(bash, "cell", "bash")
