"""Readers of shows and setpoints for the lint: Skybrush, mavsdk_drone_show, bags, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from hitchopt.exports.formats.file_reading import read_text
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.formats.long_table import Table
from hitchopt.exports.formats.mavsdk import read_table, recording_of_tables
from hitchopt.exports.formats.ros2_messages import bag_recording
from hitchopt.exports.formats.skybrush_csv import lines_of, read_zip
from hitchopt.exports.formats.skybrush_show import read_show
from hitchopt.exports.lint.findings import DroneFacts, Loaded, error, is_place, warning
from hitchopt.exports.lint.receiver_rules import receiver_findings
from hitchopt.exports.lint.show_limits import limits_of
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

MILLISECOND = 1e-3
"""[s] Skybrush rounds durations to it."""


def show_file(path: Path) -> Loaded:
    """Return what a ``.skyc`` holds.

    Raises
    ------
    FileError: it is none, or a damaged one.
    """
    show = read_show(path)
    own, unusable = limits_of(show.validation)
    places = {name: home for name, home in show.homes.items() if is_place(home, {2, 3})}
    findings = [
        error(
            "duration",
            name,
            f"a piece lasts {np.min(curve.durations):.2g} s, which Skybrush rounds to none; leave "
            "its point out",
        )
        for name, curve in show.curves.items()
        if float(np.min(curve.durations)) < 0.5 * MILLISECOND
    ]
    for key in unusable:
        fault = f"settings.validation.{key} is no positive number, so it is not checked; correct it"
        findings.append(warning("settings", "", fault))
    findings += [
        warning("start", name, "has no home of two or three numbers")
        for name in show.curves
        if name not in places
    ]
    loaded = _of_curves("skybrush", show.curves, 1)
    return replace(loaded, findings=tuple(findings), places=places, place_key="home", own=own)


def show_zip(path: Path) -> Loaded:
    """Return what a zip of Skybrush CSV files holds.

    Raises
    ------
    FileError: it is none, or a damaged one.
    """
    return _of_curves("skybrush_csv", read_zip(path), 0)


def show_csv(files: Sequence[Path]) -> Loaded:
    """Return what Skybrush CSV files hold, one drone each.

    Raises
    ------
    FileError: a damaged one.
    """
    curves = {path.stem: lines_of(read_text(path), str(path)) for path in files}
    return _of_curves("skybrush_csv", curves, 0)


def _of_curves(kind: str, curves: Mapping[str, PiecewisePolynomial], smooth: int) -> Loaded:
    recording = recording_of_curves(tuple(curves), tuple(curves.values()), "nwu", smooth)
    facts = tuple(DroneFacts(n, c.pieces, 0, float(c.breaks[-1])) for n, c in curves.items())
    return Loaded(kind, recording, facts)


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
        rows = f"has {lengths[shortest]} rows, others up to {max(lengths)}; let it rest at its end"
        findings.append(warning("duration", names[shortest], rows))
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
    return _sampled("ros2bag", bag_recording(path), streamed=True)


def table_file(path: Path) -> Loaded:
    """Return what a table for scripts holds: csv, parquet, npz or json.

    Raises
    ------
    UnsupportedError: pyarrow is not installed.
    FileError: a damaged one.
    """
    kind = path.suffix.lower().removeprefix(".")
    return _sampled(kind, cast(Table, format_of(kind)).read_file(path))


def _sampled(kind: str, recording: Recording, *, streamed: bool = False) -> Loaded:
    facts = tuple(DroneFacts(name) for name in recording.names)
    return Loaded(kind, recording, facts, (), streamed)
