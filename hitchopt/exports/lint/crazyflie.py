"""Lint of files for a Crazyflie's memory: polynomials as CSV, and compressed bytes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.errors import HitchoptError
from hitchopt.exports.formats.compressed import read_bytes
from hitchopt.exports.formats.compressed_bytes import LARGEST, LONGEST, MILLI, decoded
from hitchopt.exports.formats.crazyflie_memory import BYTES
from hitchopt.exports.formats.poly_csv import PIECE_BYTES, PolyTable, read_poly_csv
from hitchopt.exports.lint.findings import (
    ERROR,
    FARTHEST,
    NOTE,
    WARNING,
    DroneFacts,
    Finding,
    Loaded,
)
from hitchopt.exports.recording import recording_of_curves
from hitchopt.exports.reference_frame import AXES
from hitchopt.requirements import Separation

Array = NDArray[np.float64]

LEAST_ROWS = 2

CROWDED = 1.0 - 1e-4
"""Of the separation in which drones stand: less is too close; file digits are let off."""

MOST_CROWDED = 10
"""Pairs that are told of."""

STEADY = 2e-3
"""[rad] Yaw that changes less is constant: a tenth of a degree is the format's last digit."""

SETTINGS = "crazyflies.yaml"


def poly_files(files: Sequence[Path]) -> Loaded:
    """Return what CSV files of polynomial pieces hold, one drone each.

    Raises
    ------
    FileError: a damaged one.
    """
    tables = [read_poly_csv(path) for path in files]
    names = [path.stem for path in files]
    findings, facts = [], []
    for path, name, table in zip(files, names, tables, strict=True):
        rows = len(table.durations)
        size = rows * PIECE_BYTES
        facts.append(DroneFacts(name, rows, size, float(np.sum(table.durations))))
        findings += _too_large(name, rows, size)
        if rows < LEAST_ROWS:
            findings.append(
                Finding(ERROR, "one row", name, "the usual reader fails on it; split the piece")
            )
        if _begins_with_number(path):
            findings.append(
                Finding(
                    ERROR,
                    "header",
                    name,
                    "has none: readers skip the first line, and with it "
                    "the first piece; put a line of names before it",
                )
            )
        findings += _long(name, float(np.max(table.durations)))
        findings += _yaw_jumps(name, table)
    frames = {table.frame for table in tables} - {""}
    if len(frames) > 1:
        findings.append(Finding(ERROR, "frame", "", f"files are in {' and '.join(sorted(frames))}"))
    frame = next(iter(frames)) if len(frames) == 1 and frames <= set(AXES) else ""
    curves = [table.curve for table in tables]
    places, told = _settings(files[0].parent / SETTINGS, names)
    findings += told
    recording = recording_of_curves(names, curves, frame, 2)
    return Loaded(
        "crazyswarm2",
        recording,
        tuple(facts),
        tuple(findings),
        places=places,
        place_key="initial_position",
    )


def _yaw_jumps(name: str, table: PolyTable) -> list[Finding]:
    """Return the largest jump of yaw where pieces join, whole turns being none."""
    if len(table.durations) < LEAST_ROWS:
        return []
    powers = table.powers[:, 3]
    ends = np.sum(powers * table.durations[:, None] ** np.arange(powers.shape[1]), axis=1)
    jumps = np.abs(np.angle(np.exp(1j * (powers[1:, 0] - ends[:-1]))))
    joint = int(np.argmax(jumps))
    if jumps[joint] <= STEADY:
        return []
    after = float(np.sum(table.durations[: joint + 1]))
    return [
        Finding(
            WARNING,
            "jump",
            name,
            f"yaw jumps by {math.degrees(jumps[joint]):.3g}° at t = {after:.4g} s; "
            "let every piece begin with the yaw at which the one before ends",
        )
    ]


def byte_files(files: Sequence[Path]) -> Loaded:
    """Return what files of compressed bytes hold, one drone each.

    Raises
    ------
    FileError: a damaged one.
    """
    found = [decoded(read_bytes(path), str(path)) for path in files]
    stems = [path.stem.rpartition("_") for path in files]
    framed = all(stem[2] in AXES and stem[0] for stem in stems)
    names = [stem[0] if framed else path.stem for stem, path in zip(stems, files, strict=True)]
    frames = {stem[2] for stem in stems} if framed else set()
    findings, facts = [], []
    for name, drone in zip(names, found, strict=True):
        pieces = drone.curve.pieces
        facts.append(DroneFacts(name, pieces, drone.size, drone.curve.duration))
        findings += _too_large(name, pieces, drone.size)
        if not drone.ended:
            findings.append(
                Finding(
                    ERROR,
                    "end marker",
                    name,
                    "no segment of no duration ends it: the drone "
                    "flies on into what its memory held before; append three zero bytes",
                )
            )
        if float(np.ptp(drone.yaws)) > STEADY:
            findings.append(
                Finding(
                    WARNING,
                    "yaw",
                    name,
                    f"turns by {math.degrees(np.ptp(drone.yaws)):.3g}°; "
                    "firmware up to 2026.04 flies changing yaw wrongly; keep it constant",
                )
            )
        if np.max(np.abs(drone.curve.coefficients)) > LARGEST - 0.5 * MILLI:
            findings.append(
                Finding(
                    ERROR,
                    "range",
                    name,
                    f"a control point is at the end of ±{LARGEST} m: it "
                    "may have been cut off there; move the origin",
                )
            )
    curves = [drone.curve for drone in found]
    frame = next(iter(frames)) if len(frames) == 1 else ""
    recording = recording_of_curves(names, curves, frame, 1)
    return Loaded("compressed", recording, tuple(facts), tuple(findings))


def _too_large(name: str, pieces: int, size: int) -> list[Finding]:
    if size <= BYTES:
        return []
    return [
        Finding(
            ERROR,
            "memory",
            name,
            f"{pieces} pieces take {size} bytes, and a drone has {BYTES} for all its trajectories; "
            "refit it with fewer pieces, or cut it into parts",
        )
    ]


def _long(name: str, longest: float) -> list[Finding]:
    if longest <= LONGEST:
        return []
    return [
        Finding(
            NOTE,
            "duration",
            name,
            f"a piece lasts {longest:.4g} s; compressed trajectories allow {LONGEST} s",
        )
    ]


def _begins_with_number(path: Path) -> bool:
    with path.open(encoding="utf-8", errors="replace") as file:
        label = file.readline(100).partition(",")[0]
    try:
        float(label)
    except ValueError:
        return False
    return True


def _settings(path: Path, names: Sequence[str]) -> tuple[dict[str, list[float]], list[Finding]]:
    """Return the places in the settings beside the trajectories, and what is wrong with them."""
    if not path.is_file():
        return {}, []
    from hitchopt.storage.yaml_file import read_yaml

    try:
        data = read_yaml(path)
    except HitchoptError as error:
        return {}, [Finding(WARNING, "settings", path.name, f"cannot be read: {error}")]
    robots = data.get("robots") if isinstance(data, dict) else None
    if not isinstance(robots, dict):
        return {}, [Finding(WARNING, "settings", path.name, "has no robots")]
    found = []
    places: dict[str, list[float]] = {}
    for name in sorted(set(robots) ^ set(names)):
        missing = "trajectory" if name in robots else f"entry in {path.name}"
        found.append(Finding(WARNING, "settings", name, f"has no {missing}"))
    for name in sorted(set(robots) & set(names)):
        entry = robots[name]
        place = entry.get("initial_position") if isinstance(entry, dict) else None
        if _is_point(place):
            places[name] = place
        else:
            found.append(Finding(WARNING, "settings", name, "has no initial_position of 3 numbers"))
    return places, found + _crowded(places)


def _crowded(places: Mapping[str, Sequence[float]]) -> list[Finding]:
    """Return which drones stand so close that they cannot take off together."""
    if len(places) < 2:
        return []
    names = list(places)
    scaled = np.array(list(places.values())) * Separation().scale
    pairs = cKDTree(scaled).query_pairs(CROWDED, output_type="ndarray")
    found = []
    for i, j in pairs[:MOST_CROWDED]:
        apart = math.dist(places[names[i]], places[names[j]])
        found.append(
            Finding(
                ERROR,
                "start",
                f"{names[i]}, {names[j]}",
                f"their initial_positions are {apart:.3g} m apart: they cannot take off together; "
                "place them apart, and see that the ways to their trajectories are free",
            )
        )
    return found


def _is_point(value: object) -> TypeGuard[list[float]]:
    return (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        and all(abs(x) <= FARTHEST for x in value)
    )
