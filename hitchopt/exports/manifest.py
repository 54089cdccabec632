"""export.json: what an exported folder holds, in which frame, and what was checked of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Format, Task
from hitchopt.exports.verification import Verdict

FILE = "export.json"

FORMAT = "hitchopt-export/1"

MAX_BYTES = 50_000_000
"""Of a manifest that is read."""


def manifest_of(
    kind: Format, task: Task, files: Sequence[str], verdict: Verdict, notes: Sequence[str]
) -> dict[str, Any]:
    """Return what the manifest of an export says."""
    return {
        "format": FORMAT,
        "exported_as": kind.name,
        "title": task.title,
        **task.room.to_dict(),
        "heading_rad": task.room.heading,
        "drones": {member.role: member.name for member in task.fleet.members},
        "duration": verdict.duration,
        "plan_span": list(task.span),
        "position_error_m": asdict(verdict.position),
        "velocity_error_m_s": asdict(verdict.velocity),
        "checks": Certificate(verdict.duration, verdict.checks).to_dict()["checks"],
        "not_carried": verdict.not_carried,
        "feed_forward": kind.feed_forward,
        "notes": list(notes),
        "files": sorted(files),
    }


def manifest_of_parts(kind: Format, tasks: Sequence[Task], parts: Sequence[str]) -> dict[str, Any]:
    """Return what stands beside the folders of an export that was cut."""
    task = tasks[0]
    return {
        "format": FORMAT,
        "exported_as": kind.name,
        "title": task.title,
        **task.room.to_dict(),
        "duration": tasks[-1].span[1],
        "parts": list(parts),
        "plan_spans": [list(part.span) for part in tasks],
        "files": [],
    }


def write_manifest(path: Path, content: dict[str, Any]) -> None:
    """Write the manifest.

    Raises
    ------
    OSError: the file cannot be written.
    """
    text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8", newline="\n")


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return what the manifest in a folder says; None where there is none, or not one of ours.

    Raises
    ------
    FileError: there is one that cannot be read.
    """
    path = folder / FILE
    try:
        if not path.is_file():
            return None
        if path.stat().st_size > MAX_BYTES:
            raise FileError(f"{path}: is too large for a manifest")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{path}: cannot be read: {error}; remove it, or export anew") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return None
    return content


def owned_files(folder: Path) -> tuple[str, ...]:
    """Return the names of an earlier export's files in a folder, its manifest among them.

    Plain names only, whatever the manifest says.

    Raises
    ------
    FileError: a manifest that cannot be read.
    """
    content = read_manifest(folder)
    if content is None:
        return ()
    given = content.get("files")
    names = [n for n in given if isinstance(n, str)] if isinstance(given, list) else []
    plain = [name for name in names if Path(name).name == name and not name.startswith(".")]
    return (*plain, FILE)


def part_folders(folder: Path) -> tuple[str, ...]:
    """Return the names of the folders that an earlier export cut its plan into."""
    content = read_manifest(folder) or {}
    given = content.get("parts")
    names = [n for n in given if isinstance(n, str)] if isinstance(given, list) else []
    plain = [name for name in names if Path(name).name == name and "\0" not in name]
    return tuple(name for name in plain if name.startswith("part"))
