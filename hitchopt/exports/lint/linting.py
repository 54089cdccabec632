"""Lint of a file or folder: choose its reader, apply the rules, report the findings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError, InputError
from hitchopt.exports.formats.crazyswarm2 import COLUMNS as POLY_COLUMNS
from hitchopt.exports.lint import crazyflie_files, show_files
from hitchopt.exports.lint.findings import LEVELS, Finding, Loaded, Report, error, note, warning
from hitchopt.exports.lint.flight_rules import flown_from_places, flown_together
from hitchopt.exports.lint.joint_flight import Rules
from hitchopt.exports.manifest import FILE, part_folders, read_manifest
from hitchopt.exports.recording import orders_told, with_orders
from hitchopt.storage.archive import PLAN
from hitchopt.values import path as checked_path

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
"""Usual kinds of files that are not read, so that a message can name them."""

COMPANIONS = {crazyflie_files.SETTINGS, FILE}
"""Files that are read with others, and hitchopt's own."""

LATE = 1e-3
"""[s] Durations may differ by this: formats round to it."""

MAX_FILES = 25_000
"""Largest number of files in a folder that are read."""


def lint(
    path: Path | str, rules: Rules | None = None, *, relative: bool = False
) -> tuple[Report, ...]:
    """Return the report on a file or folder; of an export that was cut, one for every part.

    Parameters
    ----------
    path: a file of a known format, or a folder of such files.
    rules: limits of the flight.
    relative: whether every drone flies its trajectory from where it stands, as its settings or
        the show state, instead of in the one frame of all.

    Raises
    ------
    FileError: nothing there that is known, or a damaged file.
    UnsupportedError: a library that its format needs is not installed.
    """
    place = checked_path("path", path)
    applied = Rules() if rules is None else rules
    parts = part_folders(place) if place.is_dir() else ()
    return tuple(_report(part, applied, relative) for part in map(place.joinpath, parts or ("",)))


def _report(path: Path, rules: Rules, relative: bool) -> Report:
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # such numbers are refused by name
            loaded = _with_orders_given(load(path))
            if relative:
                loaded = flown_from_places(loaded)
            flight, found = flown_together(loaded, rules)
    except (FileError, InputError) as fault:
        text = str(fault)
        raise FileError(text if text.startswith(str(path)) else f"{path}: {text}") from fault
    findings = [*loaded.findings, *found, *_durations(loaded), *_listed(path), *_tension(path)]
    findings.sort(key=lambda f: LEVELS.index(f.level))
    frame = loaded.recording.frame
    if not frame:
        findings.append(note("frame", "", "the files do not state their axes; read as given"))
    return Report(path, loaded.kind, frame, loaded.facts, flight, tuple(findings))


def _with_orders_given(loaded: Loaded) -> Loaded:
    """Return samples joined by curves of no more derivatives than their files hold."""
    recording = loaded.recording
    if recording.smooth == 0 or any(fact.pieces for fact in loaded.facts):
        return loaded
    orders = orders_told(recording)
    if orders == recording.smooth:
        return loaded
    missing, joined = "accelerations", "joined by cubics through positions and velocities"
    if orders == 0:
        missing = "velocities"
        joined = "read as positions alone, joined by straight lines; accelerations are not checked"
    zeros = note(missing, "", f"none, or all zero although the drones move: {joined}")
    findings = (*loaded.findings, zeros)
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
        raise FileError(f"{path}: is a plan; use `hitchopt check` for plans, lint for exports")
    if not path.is_dir():
        return _load_files(path, [path])
    if (path / "metadata.yaml").is_file():
        return show_files.bag(path)
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.name != FILE)
    if len(files) > MAX_FILES:
        raise FileError(f"{path}: holds {len(files)} files; {MAX_FILES} are the most")
    if not files:
        others = [p for p in path.iterdir() if p.is_file()]
        held = f"; it holds {_named(others)}" if others else ""
        raise FileError(f"{path}: holds no file that ends in {', '.join(SUFFIXES)}{held}")
    return _load_files(path, files)


def _load_files(path: Path, files: list[Path]) -> Loaded:
    if not {file.suffix.lower() for file in files} <= set(SUFFIXES):
        read = ", ".join(SUFFIXES)
        raise FileError(f"{path}: is {_named(files)}, no file of a known format ({read})")
    kinds = Counter(_kind(file) for file in files)
    if len(kinds) > 1:
        counts = ", ".join(f"{count} of {kind}" for kind, count in kinds.items())
        raise FileError(f"{path}: holds files of several kinds ({counts}); name one")
    (kind,) = kinds
    if kind in SEVERAL:
        return SEVERAL[kind](files)
    if len(files) > 1:
        raise FileError(f"{path}: holds {len(files)} files of the kind {kind}; name one")
    return SINGLE[kind](files[0])


SEVERAL: dict[str, Callable[[Sequence[Path]], Loaded]] = {
    ".bin": crazyflie_files.byte_files,
    "crazyswarm2": crazyflie_files.poly_files,
    "mavsdk_drone_show": show_files.setpoint_files,
    "skybrush_csv": show_files.show_csv,
}
"""Readers of files of one drone each, by their ending or by what a CSV file holds."""

SINGLE: dict[str, Callable[[Path], Loaded]] = {
    ".skyc": show_files.show_file,
    ".zip": show_files.show_zip,
    ".parquet": show_files.table_file,
    ".npz": show_files.table_file,
    ".json": show_files.table_file,
    ".mcap": show_files.bag,
    ".db3": show_files.bag,
    "table": show_files.table_file,
}
"""Readers of files of all drones, by their ending or by what a CSV file holds."""

SUFFIXES = (".csv", *(kind for kind in (*SEVERAL, *SINGLE) if kind.startswith(".")))
"""Endings of files that are read; others in a folder are ignored."""


def _kind(path: Path) -> str:
    """Return a file's ending; the format of its first line where that is ``.csv``.

    Polynomials may begin with numbers.
    """
    suffix = path.suffix.lower()
    if suffix != ".csv":
        return suffix
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = file.readline(100_000).partition("#")[0].strip()
    except (OSError, ValueError) as fault:
        raise FileError(f"{path}: cannot be read as text: {fault}") from fault
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


def _durations(loaded: Loaded) -> Iterator[Finding]:
    """Yield whose file is shorter than the longest."""
    longest = max(fact.duration for fact in loaded.facts)
    short = [fact for fact in loaded.facts if fact.duration < longest - LATE]
    if short:
        fact = min(short, key=lambda fact: fact.duration)
        yield warning(
            "duration",
            fact.name,
            f"lasts {fact.duration:.6g} s, the longest {longest:.6g} s ({len(short)} are shorter); "
            "let all end together",
        )


def _listed(path: Path) -> Iterator[Finding]:
    """Yield which files of an export are gone, and which others of the folder are not read."""
    if not path.is_dir():
        return
    listed = (read_manifest(path) or {}).get("files")
    files = [str(file) for file in listed] if isinstance(listed, list) else []
    there = {entry.name: entry for entry in path.iterdir()}
    for file in files:
        if file not in there:
            yield error("missing", file, "was exported and is not there")
    others = [
        entry
        for name, entry in there.items()
        if entry.is_file()
        and entry.suffix.lower() not in SUFFIXES
        and name not in {*files, *COMPANIONS}
        and not name.startswith(".")
    ]
    if others and "metadata.yaml" not in there:
        yield note("not read", "", _named(others))


def _tension(path: Path) -> Iterator[Finding]:
    """Yield why the files of an export leave the cables' tension undetermined."""
    if not path.is_dir():
        return
    words = (read_manifest(path) or {}).get("undetermined_tension")
    for reason in words if isinstance(words, list) else []:
        yield warning("tension", "", str(reason))


def _named(files: Iterable[Path]) -> str:
    """Return how many files there are of each kind, and what such files usually are."""
    counts = Counter(file.suffix.lower() for file in files)
    return ", ".join(
        f"{count} {f'of {suffix}' if suffix else 'without an ending'}"
        + (f" ({OTHERS[suffix]})" if suffix in OTHERS else "")
        for suffix, count in sorted(counts.items())
    )
