"""Lint of shows and setpoints: Skybrush, mavsdk_drone_show, ROS 2 bags, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.mavsdk import read_table, recording_of_tables
from hitchopt.exports.formats.skybrush_csv import lines_of, read_zip
from hitchopt.exports.formats.skybrush_show import read_show
from hitchopt.exports.lint.findings import ERROR, FARTHEST, WARNING, DroneFacts, Finding, Loaded
from hitchopt.exports.lint.receiving import receiver_findings
from hitchopt.exports.lint.show_limits import limits_of
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

MILLISECOND = 1e-3
"""[s] Skybrush rounds durations to it."""


def show_file(path: Path) -> Loaded:
    """Return what a ``.skyc`` holds.

    Raises
    ------
    FileError: it is none, or a damaged one.
    """
    show = read_show(path)
    curves, findings = show.curves, []
    for name, curve in curves.items():
        if float(np.min(curve.durations)) < 0.5 * MILLISECOND:
            findings.append(
                Finding(
                    ERROR,
                    "duration",
                    name,
                    f"a piece lasts {np.min(curve.durations):.2g} s, which Skybrush rounds to "
                    "none; leave its point out",
                )
            )
    own, unusable = limits_of(show.validation)
    for key in unusable:
        told = f"settings.validation.{key} is no positive number, so it is not held; correct it"
        findings.append(Finding(WARNING, "settings", "", told))
    places = {name: home for name, home in show.homes.items() if _is_home(home)}
    findings += [
        Finding(WARNING, "start", name, "has no home of two or three numbers")
        for name in curves
        if name not in places
    ]
    recording = recording_of_curves(tuple(curves), tuple(curves.values()), "nwu", 1)
    facts = _facts(curves)
    return Loaded(
        "skybrush", recording, facts, tuple(findings), places=places, place_key="home", own=own
    )


def _is_home(home: Any) -> bool:
    return (
        isinstance(home, list)
        and len(home) in {2, 3}
        and all(isinstance(x, float) and abs(x) <= FARTHEST for x in home)
    )


def show_zip(path: Path) -> Loaded:
    """Return what a zip of Skybrush CSV files holds.

    Raises
    ------
    FileError: it is none, or a damaged one.
    """
    return _lines(read_zip(path))


def show_csv(files: Sequence[Path]) -> Loaded:
    """Return what Skybrush CSV files hold, one drone each.

    Raises
    ------
    FileError: a damaged one.
    """
    curves = {}
    for path in files:
        try:
            text = path.read_text(encoding="utf-8-sig")
        except (OSError, ValueError) as error:
            raise FileError(f"{path}: cannot be read: {error}") from error
        curves[path.stem] = lines_of(text, str(path))
    return _lines(curves)


def _lines(curves: dict[str, PiecewisePolynomial]) -> Loaded:
    recording = recording_of_curves(tuple(curves), tuple(curves.values()), "nwu", 0)
    return Loaded("skybrush_csv", recording, _facts(curves))


def _facts(curves: Mapping[str, PiecewisePolynomial]) -> tuple[DroneFacts, ...]:
    return tuple(DroneFacts(n, c.pieces, 0, float(c.breaks[-1])) for n, c in curves.items())


def setpoint_files(files: Sequence[Path]) -> Loaded:
    """Return what CSV files of mavsdk_drone_show hold, one drone each.

    Raises
    ------
    FileError: a damaged one, or times that differ.
    """
    tables = [read_table(path) for path in files]
    names = tuple(path.stem for path in files)
    lengths = [len(table) for table in tables]
    findings = []
    if len(set(lengths)) > 1:
        shortest = int(np.argmin(lengths))
        findings.append(
            Finding(
                WARNING,
                "duration",
                names[shortest],
                f"has {lengths[shortest]} rows, others up to {max(lengths)}; let it rest at its "
                "end",
            )
        )
        tables = [_rested(table, max(tables, key=len)[:, 0]) for table in tables]
    findings += receiver_findings(files[0].parent, names, tables)
    facts = tuple(DroneFacts(n, 0, 0, float(t[-1, 0])) for n, t in zip(names, tables, strict=True))
    recording = recording_of_tables(names, tables, None)
    return Loaded("mavsdk_drone_show", recording, facts, tuple(findings), streamed=True)


def _rested(table: Array, t: Array) -> Array:
    rest = np.repeat(table[-1:], len(t) - len(table), axis=0)
    rest[:, 0] = t[len(table) :]
    rest[:, 4:] = 0.0
    return np.concatenate([table, rest])


def bag(path: Path) -> Loaded:
    """Return what a bag of trajectories holds.

    Raises
    ------
    UnsupportedError: rosbags is not installed.
    FileError: no bag, a damaged one, or one of other messages.
    """
    from hitchopt.exports.formats.ros2_messages import bag_recording

    return _sampled("ros2bag", bag_recording(path), streamed=True)


def table_file(path: Path) -> Loaded:
    """Return what a table for scripts holds: csv, parquet, npz or json.

    Raises
    ------
    UnsupportedError: pyarrow is not installed.
    FileError: a damaged one.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind == "csv":
        from hitchopt.exports.formats.csv_table import read_csv
        from hitchopt.exports.reference_frame import AXES

        frame = path.stem.rpartition("_")[2]
        recording = read_csv(path, frame if frame in AXES else "")
    elif kind == "parquet":
        from hitchopt.exports.formats.parquet_table import read_parquet

        recording = read_parquet(path)
    elif kind == "npz":
        from hitchopt.exports.formats.npz_table import read_npz

        recording = read_npz(path)
    elif kind == "json":
        from hitchopt.exports.formats.json_table import read_json

        recording = read_json(path)
    else:
        raise FileError(f"{path}: is no file of a known format")
    return _sampled(kind, recording)


def _sampled(kind: str, recording: Recording, *, streamed: bool = False) -> Loaded:
    facts = tuple(DroneFacts(name) for name in recording.names)
    return Loaded(kind, recording, facts, (), streamed)
