"""Which reader a path is for, and the report on what it reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError, InputError
from hitchopt.exports.directory import PLAN
from hitchopt.exports.formats.poly_csv import COLUMNS as POLY_COLUMNS
from hitchopt.exports.lint import crazyflie, shows
from hitchopt.exports.lint.findings import ERROR, NOTE, WARNING, Finding, Loaded, Report
from hitchopt.exports.lint.flight import flown_together
from hitchopt.exports.lint.places import flown_from_places
from hitchopt.exports.lint.together import Rules
from hitchopt.exports.manifest import FILE, part_folders, read_manifest
from hitchopt.exports.recording import orders_told, with_orders

SUFFIXES = (".csv", ".bin", ".skyc", ".zip", ".parquet", ".npz", ".json", ".mcap", ".db3")
"""Of files that are read; others in a folder are not looked at."""

OTHERS = {
    ".bag": "a ROS 1 bag",
    ".dae": "a COLLADA scene",
    ".path": "paths of another show format",
    ".pcap": "recorded radio",
    ".skyb": "a Skybrush binary show",
    ".vviz": "a VVIZ show",
    ".yaml": "settings",
    ".yml": "settings",
}
"""What files that are not read usually are, so that a message can name them."""

COMPANIONS = {crazyflie.SETTINGS, FILE}
"""Files that are read with others, and hitchopt's own."""

LATE = 1e-3
"""[s] By which durations may differ: formats round to it."""

MAX_FILES = 25_000


def lint(
    path: Path | str, rules: Rules | None = None, *, relative: bool = False
) -> tuple[Report, ...]:
    """Return the report on a file or folder; of an export that was cut, one for every part.

    Parameters
    ----------
    path: a file of a known format, or a folder of such files.
    rules: what is held against them.
    relative: whether every drone flies its trajectory from where it stands, as its settings or
        the show tell, instead of in the one frame of all.

    Raises
    ------
    FileError: nothing there that is known, or a damaged file.
    UnsupportedError: a library that its format needs is not installed.
    """
    place, held = Path(path), rules or Rules()
    parts = part_folders(place) if place.is_dir() else ()
    if parts:
        return tuple(_report(place / part, held, relative) for part in parts)
    return (_report(place, held, relative),)


def _report(path: Path, rules: Rules, relative: bool) -> Report:
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # such numbers are refused by name
            loaded = _as_told(load(path))
            if relative:
                loaded = flown_from_places(loaded)
            flight, found = flown_together(loaded, rules)
    except (FileError, InputError) as error:
        text = str(error)
        raise FileError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    findings = [*loaded.findings, *found, *_durations(loaded), *_listed(path), *_unread(path)]
    findings.sort(key=lambda f: (ERROR, WARNING, NOTE).index(f.level))
    frame = loaded.recording.frame
    if not frame:
        told = "the files do not say their axes; read as given"
        findings.append(Finding(NOTE, "frame", "", told))
    return Report(path, loaded.kind, frame, loaded.facts, flight, tuple(findings))


def _as_told(loaded: Loaded) -> Loaded:
    """Return samples joined by curves of no more derivatives than their files tell."""
    recording = loaded.recording
    if recording.smooth == 0 or any(fact.pieces for fact in loaded.facts):
        return loaded
    orders = orders_told(recording)
    if orders == recording.smooth:
        return loaded
    missing = "velocities" if orders == 0 else "accelerations"
    told = (
        "read as positions alone, joined by straight lines; accelerations are not checked"
        if orders == 0
        else "joined by cubics through positions and velocities"
    )
    note = Finding(NOTE, missing, "", f"none, or all zero although the drones move: {told}")
    findings = (*loaded.findings, note)
    return replace(loaded, recording=with_orders(recording, orders), findings=findings)


def load(path: Path) -> Loaded:
    """Return what a file or folder holds.

    Raises
    ------
    FileError: nothing that is known, or a damaged file.
    """
    if not path.exists():
        raise FileError(f"{path}: there is no such file or folder")
    if path.name == PLAN or (path / PLAN).is_file():
        raise FileError(f"{path}: holds a plan; `hitchopt check` is for that, lint for exports")
    if not path.is_dir():
        return _load_files(path, [path])
    if (path / "metadata.yaml").is_file():
        return shows.bag(path)
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.name != FILE)
    if len(files) > MAX_FILES:
        raise FileError(f"{path}: holds {len(files)} files; {MAX_FILES} are the most")
    if not files:
        others = [p for p in path.iterdir() if p.is_file()]
        held = f"; it holds {_named(others)}" if others else ""
        raise FileError(f"{path}: holds no file that ends in {', '.join(SUFFIXES)}{held}")
    return _load_files(path, files)


def _load_files(path: Path, files: list[Path]) -> Loaded:
    kinds = {file.suffix.lower() for file in files}
    if not kinds <= set(SUFFIXES):
        read = ", ".join(SUFFIXES)
        raise FileError(f"{path}: is {_named(files)}, no file of a known format ({read})")
    if len(kinds) > 1:
        raise FileError(
            f"{path}: holds files of several kinds ({', '.join(sorted(kinds))}); name one"
        )
    (kind,) = kinds
    if kind == ".bin":
        return crazyflie.byte_files(files)
    if kind == ".csv":
        return _load_csv(path, files)
    if len(files) > 1:
        raise FileError(f"{path}: holds {len(files)} files that end in {kind}; name one")
    (file,) = files
    if kind == ".skyc":
        return shows.show_file(file)
    if kind == ".zip":
        return shows.show_zip(file)
    if kind in {".mcap", ".db3"}:
        return shows.bag(file)
    return shows.table_file(file)


def _load_csv(path: Path, files: list[Path]) -> Loaded:
    kinds = Counter(_csv_kind(file) for file in files)
    if len(kinds) > 1:
        told = ", ".join(f"{count} of {kind}" for kind, count in kinds.items())
        raise FileError(f"{path}: holds CSV files of several kinds ({told}); name one")
    (kind,) = kinds
    if kind == "table":
        if len(files) > 1:
            raise FileError(f"{path}: holds {len(files)} tables; name one")
        return shows.table_file(files[0])
    if kind == "mavsdk_drone_show":
        return shows.setpoint_files(files)
    if kind == "skybrush_csv":
        return shows.show_csv(files)
    return crazyflie.poly_files(files)


def _csv_kind(path: Path) -> str:
    """Return which format's first line a file has; that of polynomials where it has numbers."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = file.readline(100_000).partition("#")[0].strip()
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read as text: {error}") from error
    labels = [label.strip() for label in header.split(",")]
    if labels[:2] == ["t", "drone"]:
        return "table"
    if labels[:3] == ["idx", "t", "px"]:
        return "mavsdk_drone_show"
    if labels[0].lower().startswith("time [msec]"):
        return "skybrush_csv"
    if labels[0].lower() == "duration" or len(labels) == POLY_COLUMNS:
        return "crazyswarm2"
    raise FileError(
        f"{path}: its first line, {header[:60]!r}, is of no known format (polynomials begin with "
        "duration, tables with t,drone, shows with idx,t,px or Time [msec])"
    )


def _durations(loaded: Loaded) -> list[Finding]:
    """Return whose file is shorter than the longest."""
    longest = max(fact.duration for fact in loaded.facts)
    short = [fact for fact in loaded.facts if fact.duration < longest - LATE]
    if not short:
        return []
    fact = min(short, key=lambda fact: fact.duration)
    return [
        Finding(
            WARNING,
            "duration",
            fact.name,
            f"lasts {fact.duration:.6g} s, the longest {longest:.6g} s ({len(short)} are shorter); "
            "let all end together",
        )
    ]


def _listed(path: Path) -> list[Finding]:
    """Return which files of an export are gone."""
    manifest = read_manifest(path) if path.is_dir() else None
    files = manifest.get("files") if manifest else None
    if not isinstance(files, list):
        return []
    there = {entry.name for entry in path.iterdir()}
    missing = [f for f in files if str(f) not in there]
    return [Finding(ERROR, "missing", str(f), "was exported and is not there") for f in missing]


def _unread(path: Path) -> list[Finding]:
    """Return which other files of a folder have not been read, by their kinds."""
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return []
    manifest = read_manifest(path) or {}
    files = manifest.get("files")
    known = {str(f) for f in files} if isinstance(files, list) else set()
    others = [
        entry
        for entry in path.iterdir()
        if entry.is_file()
        and entry.suffix.lower() not in SUFFIXES
        and entry.name not in known | COMPANIONS
        and not entry.name.startswith(".")
    ]
    return [Finding(NOTE, "not read", "", _named(others))] if others else []


def _named(files: Iterable[Path]) -> str:
    """Return how many files there are of each kind, and what such files usually are."""
    counts = Counter(file.suffix.lower() for file in files)
    return ", ".join(
        f"{count} {f'of {suffix}' if suffix else 'without an ending'}"
        + (f" ({OTHERS[suffix]})" if suffix in OTHERS else "")
        for suffix, count in sorted(counts.items())
    )
