"""Start-up file of the kernels that execute pages.

``%%bash`` prints an output at once; IPython's own prints pieces of 100 bytes on separate lines.
``%script NAME`` runs ``problems/scripts/NAME.py``.
"""

import os
import runpy
import subprocess
import sys
from pathlib import Path

from IPython import get_ipython

SCRIPTS = Path(os.environ["IPYTHONDIR"]).parents[2] / "problems" / "scripts"


def bash(_line: str, cell: str) -> None:
    """Run a cell with bash."""
    command, to_stdout = ["bash", "-c", cell], subprocess.STDOUT
    process = subprocess.run(command, stdout=subprocess.PIPE, stderr=to_stdout, check=False)
    sys.stdout.write(process.stdout.decode())
    process.check_returncode()


def script(line: str) -> None:
    """Run a script to copy."""
    runpy.run_path(str(SCRIPTS / f"{line.strip()}.py"), run_name="__main__")


get_ipython().register_magic_function(script, "line", "script")
get_ipython().register_magic_function(bash, "cell", "bash")
