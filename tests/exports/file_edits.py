"""Edits of exported files: texts, rows, cells, bytes, and what is in a show."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

Edit = Callable[[Path], object]


def text(name: str, old: str, new: str) -> Edit:
    """Exchange a piece of a text, its first one."""

    def edit(folder: Path) -> None:
        before = (folder / name).read_text()
        after = before.replace(old, new, 1)
        assert after != before
        (folder / name).write_text(after)

    return edit


def rows(pattern: str, order: Callable[[list[str]], list[str]]) -> Edit:
    """Rearrange the lines of all files of a pattern."""

    def edit(folder: Path) -> None:
        for path in folder.glob(pattern):
            path.write_text("\n".join(order(path.read_text().splitlines())) + "\n")

    return edit


def cell(name: str, row: int, column: int, value: str) -> Edit:
    def order(lines: list[str]) -> list[str]:
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return rows(name, order)


def content(name: str, data: bytes | Callable[[bytes], bytes]) -> Edit:
    """Write other bytes, or those that a function makes of what is there."""

    def edit(folder: Path) -> None:
        path = folder / name
        path.write_bytes(data(path.read_bytes()) if callable(data) else data)

    return edit


def show(edit: Callable[[dict[str, Any]], object], name: str = "show.skyc") -> Edit:
    """Change the JSON files in a show, by their names."""

    def change(folder: Path) -> None:
        with zipfile.ZipFile(folder / name) as archive:
            files = {each: json.loads(archive.read(each)) for each in archive.namelist()}
        edit(files)
        write_show(folder / name, files)

    return change


def write_show(path: Path, files: dict[str, Any]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data if isinstance(data, str) else json.dumps(data))
    return path


def settings_of(files: dict[str, Any], drone: int = 0) -> dict[str, Any]:
    """Settings of a drone in a show."""
    found: dict[str, Any] = files["show.json"]["swarm"]["drones"][drone]["settings"]
    return found


def points_of(files: dict[str, Any], name: str = "d0") -> list[Any]:
    """Points of a drone's trajectory in a show."""
    found: list[Any] = files[f"drones/{name}/trajectory.json"]["points"]
    return found
