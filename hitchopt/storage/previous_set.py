"""The last whole set of files, kept in a subdirectory while its directory tells of a refusal."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Literal

from hitchopt.errors import FileError

PREVIOUS = "previous"
"""Name of the subdirectory."""

Fate = Literal["leave", "keep", "remove"]
"""What a writer does with the last whole set: nothing, keep it in PREVIOUS, or remove PREVIOUS."""


def kept_writers(
    target: Path, owned: Collection[str], seal: str
) -> dict[str, Callable[[Path], None]]:
    """Return what writes each file of the last whole set: that in ``target``, else in PREVIOUS."""
    place = target if (target / seal).is_file() else target / PREVIOUS
    return {
        name: partial(_link_or_copy, place / name) for name in owned if (place / name).is_file()
    }


def check_previous(target: Path) -> None:
    """Raise FileError if something else than a directory has the name of PREVIOUS."""
    path = target / PREVIOUS
    if os.path.lexists(path) and (path.is_symlink() or not path.is_dir()):
        raise FileError(f"{path}: is where hitchopt keeps the last plan; move it away")


def empty_previous(place: Path, home: Path, owned: Collection[str]) -> None:
    """Remove ``place`` with the files that are ours; others' go to ``home``, or stay if it is it.

    Raises
    ------
    OSError: it is not empty, or another's file cannot be moved.
    """
    for name in sorted(os.listdir(place)):
        path = place / name
        if name in owned and not path.is_dir():
            path.unlink()
        elif home != place and not os.path.lexists(home / name):
            home.mkdir(exist_ok=True)
            path.rename(home / name)
    place.rmdir()


def _link_or_copy(source: Path, path: Path) -> None:
    """Give a file a second name; where file systems have no such links, copy it."""
    try:
        os.link(source, path)
    except OSError:
        shutil.copy2(source, path)
