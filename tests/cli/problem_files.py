"""The problem files of this repository, and what their headers say of them."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
GOOD = sorted((ROOT / "problems").glob("*.yaml"))
BAD = sorted((ROOT / "problems" / "bad").glob("*.yaml"))
INFEASIBLE = sorted((ROOT / "problems" / "infeasible").glob("*.yaml"))


def header(path: Path, word: str) -> str:
    """What the comment ``# word: …`` of a problem says."""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"# {word}: "):
            return line.removeprefix(f"# {word}: ")
    raise KeyError(f"{path} has no comment '# {word}: …'")
