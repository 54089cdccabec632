"""The problem files of the repository in the order of the gallery, with their headers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

PROBLEMS = ROOT / "problems"

GALLERY = ROOT / "docs" / "gallery"

PICTURES = GALLERY / "pictures"
"""Directory of the pictures that ``make gallery`` draws."""


@dataclass(frozen=True)
class Section:
    """A folder of problem files.

    Attributes
    ----------
    folder: path relative to ``problems``.
    heading: heading of the section in the gallery.
    solved: whether the problems have plans.
    """

    folder: str
    heading: str
    solved: bool

    @property
    def files(self) -> list[Path]:
        """The problem files, by name."""
        return sorted((PROBLEMS / self.folder).glob("*.yaml"))

    def picture(self, file: Path) -> Path:
        """Return the path of a problem's picture."""
        return PICTURES / self.folder / f"{file.stem}.png"

    def page(self, file: Path) -> Path:
        """Return the path of a problem's page, relative to ``GALLERY``."""
        return Path("examples", self.folder, f"{file.stem}.md")


SECTIONS = (
    Section("", "Hitches", solved=True),
    Section("swarms", "Single drones", solved=True),
    Section("infeasible", "Hitches without a plan", solved=False),
    Section("swarms/infeasible", "Single drones without a plan", solved=False),
)
"""Folders whose problems have pictures."""

REFUSED = ("bad", "swarms/bad")
"""Folders of invalid files, which have no pictures."""


def caption(file: Path) -> list[str]:
    """Return the lines of a problem file's leading comment, without those for tests."""
    lines = takewhile(lambda line: line.startswith("#"), file.read_text("utf-8").splitlines())
    excluded = ("# Lasts: ", "# Binds: ", "# yaml-language-server")
    return [line.removeprefix("#").strip() for line in lines if not line.startswith(excluded)]


def entry(file: Path, key: str, default: str) -> str:
    """Return the text after ``key: `` at the start of a line of a problem file."""
    line = re.search(rf"^{key}: (.*)$", file.read_text("utf-8"), re.MULTILINE)
    return line[1].strip().strip("\"'") if line else default
