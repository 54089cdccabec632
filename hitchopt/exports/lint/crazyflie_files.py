"""Readers and rules for files of a Crazyflie's memory: polynomials as CSV, compressed bytes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.errors import HitchoptError
from hitchopt.exports.formats.compressed import read_bytes
from hitchopt.exports.formats.compressed_bytes import LARGEST, LONGEST, MILLI, Compressed, decoded
from hitchopt.exports.formats.crazyflie_memory import BYTES
from hitchopt.exports.formats.crazyswarm2 import PIECE_BYTES, PolyTable, read_poly_csv
from hitchopt.exports.lint.findings import (
    DroneFacts,
    Finding,
    Loaded,
    error,
    is_place,
    note,
    warning,
)
from hitchopt.exports.recording import recording_of_curves
from hitchopt.exports.reference_frame import AXES
from hitchopt.requirements import Separation
from hitchopt.storage.yaml_file import read_yaml

LEAST_ROWS = 2
"""Rows of a polynomial file that the usual reader needs."""

CROWDED = 1.0 - 1e-4
"""Least separation of places before take-off, a ratio; below 1 by the rounding of file digits."""

MOST_CROWDED = 10
"""Largest number of pairs of places that are reported."""

STEADY = 2e-3
"""[rad] Yaw that changes less is constant: a tenth of a degree is the format's last digit."""

SETTINGS = "crazyflies.yaml"
"""Name of Crazyswarm2's settings."""


def poly_files(files: Sequence[Path]) -> Loaded:
    """Return what CSV files of polynomial pieces hold, one drone each.

    Raises
    ------
    FileError: a damaged one.
    """
    names = [path.stem for path in files]
    tables = [read_poly_csv(path) for path in files]
    facts, findings = [], []
    for path, name, table in zip(files, names, tables, strict=True):
        rows = len(table.durations)
        facts.append(DroneFacts(name, rows, rows * PIECE_BYTES, float(np.sum(table.durations))))
        findings += [*_memory(facts[-1]), *_rows(path, name, table)]
    frames = {table.frame for table in tables} - {""}
    if len(frames) > 1:
        findings.append(error("frame", "", f"files are in {' and '.join(sorted(frames))}"))
    frame = next(iter(frames)) if len(frames) == 1 and frames <= set(AXES) else ""
    places, faults = _places(files[0].parent / SETTINGS, set(names))
    return Loaded(
        "crazyswarm2",
        recording_of_curves(names, [table.curve for table in tables], frame, 2),
        tuple(facts),
        (*findings, *faults, *_crowded(places)),
        places=places,
        place_key="initial_position",
    )


def _rows(path: Path, name: str, table: PolyTable) -> Iterator[Finding]:
    """Yield what is wrong with one drone's table of pieces."""
    if len(table.durations) < LEAST_ROWS:
        yield error("one row", name, "the usual reader fails on it; split the piece")
    if _begins_with_number(path):
        yield error(
            "header",
            name,
            "has none: readers skip the first line, and with it the first piece; put a line of "
            "names before it",
        )
    longest = float(np.max(table.durations))
    if longest > LONGEST:
        most = f"a piece lasts {longest:.4g} s; compressed trajectories allow {LONGEST} s"
        yield note("duration", name, most)
    powers = table.powers[:, 3]
    ends = np.sum(powers * table.durations[:, None] ** np.arange(powers.shape[1]), axis=1)
    jumps = np.abs(np.angle(np.exp(1j * (powers[1:, 0] - ends[:-1]))))  # whole turns are none
    if np.max(jumps, initial=0.0) > STEADY:
        joint = int(np.argmax(jumps))
        yield warning(
            "jump",
            name,
            f"yaw jumps by {math.degrees(jumps[joint]):.3g}° at "
            f"t = {np.sum(table.durations[: joint + 1]):.4g} s; "
            "let every piece begin with the yaw at which the one before ends",
        )


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
    facts, findings = [], []
    for name, drone in zip(names, found, strict=True):
        facts.append(DroneFacts(name, drone.curve.pieces, drone.size, drone.curve.duration))
        findings += [*_memory(facts[-1]), *_segments(name, drone)]
    frame = frames.pop() if len(frames) == 1 else ""
    recording = recording_of_curves(names, [drone.curve for drone in found], frame, 1)
    return Loaded("compressed", recording, tuple(facts), tuple(findings))


def _segments(name: str, drone: Compressed) -> Iterator[Finding]:
    """Yield what is wrong with one drone's bytes."""
    if not drone.ended:
        yield error(
            "end marker",
            name,
            "no segment of no duration ends it: the drone flies on into earlier contents of its "
            "memory; append three zero bytes",
        )
    if float(np.ptp(drone.yaws)) > STEADY:
        yield warning(
            "yaw",
            name,
            f"turns by {math.degrees(np.ptp(drone.yaws)):.3g}°; firmware up to 2026.04 flies "
            "changing yaw wrongly; keep it constant",
        )
    if np.max(np.abs(drone.curve.coefficients)) > LARGEST - 0.5 * MILLI:
        yield error(
            "range",
            name,
            f"a control point is at the end of ±{LARGEST} m: it may have been cut off there; move "
            "the origin",
        )


def _memory(fact: DroneFacts) -> Iterator[Finding]:
    if fact.size > BYTES:
        yield error(
            "memory",
            fact.name,
            f"{fact.pieces} pieces take {fact.size} bytes, and a drone has {BYTES} for all its "
            "trajectories; refit it with fewer pieces, or cut it into parts",
        )


def _begins_with_number(path: Path) -> bool:
    with path.open(encoding="utf-8", errors="replace") as file:
        label = file.readline(100).partition(",")[0]
    with contextlib.suppress(ValueError):
        float(label)
        return True
    return False


def _places(path: Path, names: set[str]) -> tuple[dict[str, list[float]], list[Finding]]:
    """Return the places in the settings beside the trajectories, and the findings on them."""
    if not path.is_file():
        return {}, []
    try:
        data = read_yaml(path)
    except HitchoptError as fault:
        return {}, [warning("settings", path.name, f"cannot be read: {fault}")]
    robots = data.get("robots") if isinstance(data, dict) else None
    if not isinstance(robots, dict):
        return {}, [warning("settings", path.name, "has no robots")]
    found = []
    places: dict[str, list[float]] = {}
    for name in sorted(set(robots) ^ names):
        missing = "trajectory" if name in robots else f"entry in {path.name}"
        found.append(warning("settings", name, f"has no {missing}"))
    for name in sorted(set(robots) & names):
        entry = robots[name]
        place = entry.get("initial_position") if isinstance(entry, dict) else None
        if is_place(place, {3}):
            places[name] = place
        else:
            found.append(warning("settings", name, "has no initial_position of 3 numbers"))
    return places, found


def _crowded(places: Mapping[str, Sequence[float]]) -> Iterator[Finding]:
    """Yield which drones stand so close that they cannot take off together."""
    names = list(places)
    scaled = np.reshape(list(places.values()), (-1, 3)) * Separation().scale
    pairs = cKDTree(scaled).query_pairs(CROWDED, output_type="ndarray")
    for one, other in ((names[i], names[j]) for i, j in pairs[:MOST_CROWDED]):
        yield error(
            "start",
            f"{one}, {other}",
            f"their initial_positions are {math.dist(places[one], places[other]):.3g} m apart: "
            "they cannot take off together; place them apart, and see that the paths to their "
            "trajectories are free",
        )
