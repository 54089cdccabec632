"""Verify the plan of a directory: ``python -m hitchopt.verify DIR``."""

import sys

from .driver import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
