"""Readers of shows and setpoints for the lint: Skybrush, mavsdk_drone_show, bags, tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import read_text
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.formats.long_table import Table
from hitchopt.exports.formats.mavsdk import read_table, recording_of_tables
from hitchopt.exports.formats.mavsdk_receiver import LATE, NAMES, Receiver
from hitchopt.exports.formats.ros2_messages import bag_recording
from hitchopt.exports.formats.skybrush_csv import lines_of, read_zip
from hitchopt.exports.formats.skybrush_show import read_show
from hitchopt.exports.lint.findings import (
    DroneFacts,
    Finding,
    Loaded,
    and_more,
    error,
    is_place,
    note,
    warning,
)
from hitchopt.exports.lint.show_limits import limits_of
from hitchopt.exports.manifest import read_manifest
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


REMAINING = 0.1
"""[m] Rows that move a drone no farther, seen from above, may be replaced by a climb or a landing;
so far may a first row be from the ground."""


def receiver_findings(
    folder: Path, names: Sequence[str], tables: Sequence[Array]
) -> Iterator[Finding]:
    """Yield which rows are not flown as they stand, one finding a rule.

    The settings are those that the folder's manifest states, else those that the show comes with.

    Parameters
    ----------
    folder: of the files.
    names: (D,) of the drones.
    tables: of each drone, (S, 10) as they stand in its file, with common times.

    Raises
    ------
    FileError: a manifest that cannot be read.
    """
    settings = _settings(folder)
    receiver = Receiver() if settings is None else Receiver.of(settings)
    t = tables[0][:, 0]
    places = np.stack([table[:, 1:4] for table in tables], axis=1)
    followed = receiver.followed(t, places, 0.0 if settings is None else LATE)
    yield from _never(receiver, names, places, followed)
    yield from _replaced(receiver, names, t, places, followed)
    # Without settings the mode is unknown; every mode but one counts from the first row.
    yield from _lowered(
        Receiver(shared_origin=False) if settings is None else receiver, names, places
    )
    if settings is not None and receiver != Receiver():
        stated = ", ".join(f"{name} = {value}" for name, value in receiver.settings().items())
        yield note("settings", "", f"flown as they stand only with {stated} in src/params.py")


def _settings(folder: Path) -> dict[str, object] | None:
    """Return the receiver's settings in the manifest; None where it has none."""
    receiver = (read_manifest(folder) or {}).get("receiver")
    settings = receiver.get("settings") if isinstance(receiver, dict) else None
    if settings is not None and not isinstance(settings, dict):
        raise FileError(f"{folder}: its manifest's settings of the receiver are no map")
    return settings


def _never(
    receiver: Receiver, names: Sequence[str], places: Array, followed: NDArray[np.bool_]
) -> Iterator[Finding]:
    never = np.flatnonzero(~followed.any(axis=0))
    if len(never) > 0:
        highest = float(np.max(-places[:, never, 2] - receiver.lowered(places)[never]))
        yield error(
            "climb",
            and_more(names[never[0]], len(never)),
            f"mavsdk_drone_show flies none of its rows: it climbs until a row is at "
            f"{receiver.climb_altitude:g} m and {receiver.climb_time:g} s have passed, and they go "
            f"up to {highest:.4g} m; set {NAMES['climb_altitude']} below them and "
            f"{NAMES['climb_time']} to 0",
        )


def _replaced(
    receiver: Receiver, names: Sequence[str], t: Array, places: Array, followed: NDArray[np.bool_]
) -> Iterator[Finding]:
    """Yield whose rows before the first and after the last one that is flown move it."""
    flown = followed.any(axis=0)
    first = np.argmax(followed, axis=0)
    last = len(t) - 1 - np.argmax(followed[::-1], axis=0)
    each = np.arange(places.shape[1])
    rows = np.arange(len(t))[:, None]
    lower = f"{NAMES['climb_altitude']} and {NAMES['climb_time']} lower"
    land = f"{NAMES['ground_altitude']} below {receiver.ground_altitude:g}"
    for rule, lost, met, end, remedy in (
        ("climb", rows < first, first, "before", f"let it wait until then, or set {lower}"),
        ("landing", rows > last, last, "after", f"end higher, or set {land}"),
    ):
        across = np.linalg.norm((places - places[met, each])[..., :2], axis=-1)
        moved = np.max(np.where(lost, across, 0.0), axis=0) * flown
        drone = int(np.argmax(moved))
        if moved[drone] > REMAINING:
            yield warning(
                rule,
                and_more(names[drone], np.count_nonzero(moved > REMAINING)),
                f"mavsdk_drone_show replaces its rows {end} t = {t[met[drone]]:.4g} s by a "
                f"{rule}, and they move it by {moved[drone]:.3g} m across; {remedy}",
            )


def _lowered(receiver: Receiver, names: Sequence[str], places: Array) -> Iterator[Finding]:
    """Yield who flies lower than its rows because its first one is not on the ground."""
    lower = receiver.lowered(places)
    drone = int(np.argmax(np.abs(lower)))
    if abs(lower[drone]) > REMAINING:
        yield warning(
            "launch",
            and_more(names[drone], np.count_nonzero(np.abs(lower) > REMAINING)),
            f"its first row is at {lower[drone]:.3g} m: unless {NAMES['shared_origin']} is on, "
            "altitudes are counted from there, and it flies so much lower; begin on the ground",
        )
