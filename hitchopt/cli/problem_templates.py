"""The problem files that ``hitchopt init`` writes: a commented one to start from, and examples."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

import hitchopt
from hitchopt.errors import FileError, InputError

SUFFIXES = {".yaml", ".yml"}

PACKAGE = Path(hitchopt.__file__).parent

SCHEMA = PACKAGE / "mission" / "problem.schema.json"
"""The schema with which editors complete and check problem files."""

MODELINE = "# yaml-language-server: $schema="
"""Beginning of the line that names the schema to editors."""


def template_text() -> str:
    """Return a commented problem file that solves as it is."""
    return _with_schema((PACKAGE / "mission" / "template.yaml").read_text(encoding="utf-8"))


def example_files() -> list[Path]:
    """Return the examples: in the package where it is installed, else in the checkout."""
    packed = PACKAGE / "examples"
    place = packed if packed.is_dir() else PACKAGE.parent / "problems"
    return sorted([*place.glob("*.yaml"), *(place / "swarms").glob("*.yaml")])


def all_examples() -> list[tuple[Path, str]]:
    """Return the examples with their titles."""
    found = []
    for path in example_files():
        title = re.search(r"^title: (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        found.append((path, title.group(1).strip("'\"") if title else ""))
    return found


def example_text(name: str) -> str:
    """Return an example's problem file.

    Raises
    ------
    InputError: there is none of that name.
    """
    files = {path.stem: path for path in example_files()}
    if name not in files:
        import difflib

        near = difflib.get_close_matches(name, files, 1)
        remedy = f"did you mean {near[0]}?" if near else "hitchopt init --list names them"
        raise InputError("--example", name, "an example's name", remedy)
    return _with_schema(files[name].read_text(encoding="utf-8"))


def _with_schema(text: str) -> str:
    """Return the text of a problem file; its first line names the installed schema."""
    lines = [line for line in text.splitlines() if not line.startswith(MODELINE)]
    return "\n".join([f"{MODELINE}{SCHEMA.as_posix()}", *lines]) + "\n"


def write_problem(name: str, text: str) -> Path:
    """Write a problem file to ``name``, with the suffix .yaml, completely or not at all.

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
                file.write(text)
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
