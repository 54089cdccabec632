"""``python -m hitchopt`` is ``hitchopt``."""

from __future__ import annotations

import gc
import os

from hitchopt.storage.interrupts import exit_on_signals


def run() -> None:
    """Run the command line; Ctrl-C ends it quietly also while it is being imported."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads only wait for small matrices
    gc.set_threshold(200_000)  # what imports make stays; looking through it takes 0.1 s
    with exit_on_signals(final=True):
        try:
            from hitchopt.cli import main

            main(prog_name="hitchopt")
        finally:
            gc.freeze()  # looking through it once more as the process ends takes 0.3 s


if __name__ == "__main__":
    run()
