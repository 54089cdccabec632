"""Draws the steps of forming of a problem: python -m problems.forming_steps FILE PICTURE."""

from __future__ import annotations

import sys
from pathlib import Path

import hitchopt as ho
from hitchopt.view.forming_steps import save_forming_steps


def main(file: str, picture: str) -> None:
    """Plan the problem in ``file`` and draw its steps of forming."""
    motion = ho.solve(file).motion
    if not motion.team.has_cables:
        raise SystemExit(f"{file}: forms no hitch")
    save_forming_steps(Path(picture), motion)


if __name__ == "__main__":
    main(*sys.argv[1:])
