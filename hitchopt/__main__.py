"""``python -m hitchopt`` is ``hitchopt``."""

from __future__ import annotations

import os

from hitchopt.storage.interrupts import exit_on_signals


def run() -> None:
    """Run the command line; Ctrl-C ends it quietly also while it is being imported."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads only wait for small matrices
    with exit_on_signals(final=True):
        from hitchopt.cli import main

        main(prog_name="hitchopt")


if __name__ == "__main__":
    run()
