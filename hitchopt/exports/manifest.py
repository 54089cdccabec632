"""The manifest ``export.json``: what an export holds, in which frame, and what was checked."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Candidate, Format, Task
from hitchopt.exports.verification import Verdict

FILE = "export.json"

FORMAT = "hitchopt-export/1"

MAX_BYTES = 50_000_000
"""Size limit of a manifest that is read [B]."""

HELD = "none: the offsets of the set points hold the tension; nothing is to be fed forward"
"""What the manifest says of feed-forward where the tension is held."""


def manifest_of(kind: Format, task: Task, candidate: Candidate, verdict: Verdict) -> dict[str, Any]:
    """Return the manifest of files that were verified."""
    receiver = {"receiver": dict(candidate.receiver)} if candidate.receiver else {}
    return {
        **_head(kind, task),
        "heading_rad": task.frame.heading,
        "drones": {member.role: member.name for member in task.fleet.members},
        "duration": verdict.duration,
        "plan_span": list(task.span),
        "position_error_m": asdict(verdict.position),
        "velocity_error_m_s": asdict(verdict.velocity),
        "checks": Certificate(verdict.duration, verdict.checks).to_dict()["checks"],
        "not_carried": verdict.not_carried,
        "feed_forward": HELD if task.options.hold_tension else kind.feed_forward,
        "undetermined_tension": list(task.undetermined),
        "notes": list(candidate.notes),
        "files": sorted(candidate.writers),
        **receiver,
    }


def parts_manifest(kind: Format, tasks: Sequence[Task], parts: Sequence[str]) -> dict[str, Any]:
    """Return the manifest of a plan that was cut; its parts are folders."""
    return {
        **_head(kind, tasks[0]),
        "duration": tasks[-1].span[1],
        "parts": list(parts),
        "plan_spans": [list(part.span) for part in tasks],
        "files": [],
    }


def _head(kind: Format, task: Task) -> dict[str, Any]:
    head = {"format": FORMAT, "exported_as": kind.name, "title": task.title}
    return {**head, **task.frame.to_dict()}


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

    Raises
    ------
    FileError: a manifest that cannot be read.
    """
    content = read_manifest(folder)
    return () if content is None else (*_plain_names(content, "files"), FILE)


def part_folders(folder: Path) -> tuple[str, ...]:
    """Return the names of the folders that an earlier export cut its plan into."""
    names = _plain_names(read_manifest(folder) or {}, "parts")
    return tuple(name for name in names if name.startswith("part"))


def _plain_names(content: dict[str, Any], key: str) -> tuple[str, ...]:
    """Return the plain names in a list of the manifest, whatever else it says."""
    given = content.get(key)
    names = [n for n in given if isinstance(n, str)] if isinstance(given, list) else []
    return tuple(n for n in names if Path(n).name == n and "\0" not in n and not n.startswith("."))
