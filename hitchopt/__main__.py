"""``python -m hitchopt`` is ``hitchopt``."""

from __future__ import annotations

from hitchopt.interrupts import INTERRUPTED, ending_signals


def run() -> None:
    """Run the command line; Ctrl-C ends it quietly also while it is being imported."""
    with ending_signals():
        try:
            from hitchopt.cli import main

            main(prog_name="hitchopt")
        except KeyboardInterrupt:
            raise SystemExit(INTERRUPTED) from None


if __name__ == "__main__":
    run()
