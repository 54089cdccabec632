"""Run one benchmark: ``python -m benchmarks NAME [OPTIONS]``; without a name list them."""

from __future__ import annotations

import ast
import importlib
import os
import sys
from pathlib import Path

NAMES = (
    "corpus",
    "page",
    "libraries",
    "morphs",
    "families",
    "forming",
    "separation",
    "teams",
    "carrying",
    "flights",
    "recordings",
    "real",
    "replay",
    "statics",
    "clasps",
    "live",
    "losses",
    "views",
    "tracking",
    "tracking_errors",
    "controllers",
    "mutations",
)


def main() -> int:
    """Run the benchmark that the command line names; return the exit code."""
    if len(sys.argv) > 1 and sys.argv[1] in NAMES:
        name = sys.argv.pop(1)
        sys.argv[0] = f"python -m benchmarks {name}"
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as hitchopt's own command line
        return int(importlib.import_module(f"benchmarks.{name}").main() or 0)
    print(__doc__)
    for name in NAMES:
        text = Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
        words = str(ast.get_docstring(ast.parse(text)))  # what a benchmark imports may be missing
        print(f"  {name:12s} {words.splitlines()[0]}")
    return 2 if sys.argv[1:] and sys.argv[1] not in ("-h", "--help") else 0


if __name__ == "__main__":
    sys.exit(main())
