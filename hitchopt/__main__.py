"""Run ``hitchopt`` as ``python -m hitchopt``."""

from __future__ import annotations

import os

from hitchopt.storage.interrupts import exit_on_signals


def run() -> None:
    """Run the command line; Ctrl-C ends it quietly even during imports."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads only wait for small matrices
    # Pictures are files. Jupyter names its backend for the commands of a cell; where that is not
    # installed, importing matplotlib fails, and toppra imports it.
    os.environ["MPLBACKEND"] = "Agg"
    with exit_on_signals(final=True):
        from hitchopt.cli import main

        main(prog_name="hitchopt")


if __name__ == "__main__":
    run()
