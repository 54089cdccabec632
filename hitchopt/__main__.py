"""``python -m hitchopt`` is ``hitchopt``."""

from __future__ import annotations

import gc

from hitchopt.storage.interrupts import ending_signals


def run() -> None:
    """Run the command line; Ctrl-C ends it quietly also while it is being imported."""
    gc.set_threshold(200_000)  # what imports make stays; looking through it takes 0.1 s
    with ending_signals(last=True):
        from hitchopt.cli import main

        main(prog_name="hitchopt")


if __name__ == "__main__":
    run()
