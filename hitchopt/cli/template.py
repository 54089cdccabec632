"""The problem file that ``hitchopt init`` writes."""

from __future__ import annotations

import contextlib
import os
from importlib import resources
from pathlib import Path

from hitchopt.errors import FileError

SUFFIXES = {".yaml", ".yml"}


def template_text() -> str:
    """Return a commented problem file that solves as it is."""
    return (resources.files("hitchopt.mission") / "template.yaml").read_text(encoding="utf-8")


def write_template(name: str) -> Path:
    """Write the template to ``name``, with the suffix .yaml, completely or not at all.

    Raises
    ------
    FileError: the file exists, or its directory cannot be written to.
    """
    path = Path(name)
    if not path.name.strip("."):
        raise FileError(f"{name!r}: is no name for a file; give one, such as problem.yaml")
    if path.suffix not in SUFFIXES:
        path = path.with_name(f"{path.name}.yaml")
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            with open(draft, "x", encoding="utf-8") as file:
                file.write(template_text())
            _publish(draft, path)
        finally:
            with contextlib.suppress(OSError):
                draft.unlink()
    except FileExistsError:
        raise FileError(f"{path}: exists already; give another name, or remove it") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise FileError(f"{str(path)!r}: cannot be written ({reason}); give another name") from None
    return path


def _publish(draft: Path, path: Path) -> None:
    """Give the draft its name; an existing file is not replaced, unlike in a rename."""
    try:
        os.link(draft, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if path.exists():
            raise FileExistsError(str(path)) from None
        draft.rename(path)
