"""Contents of exported files: the drones' curves, findings and manifests.

Invalid files raise FileError. Contents are the curves of the numbers in files of any
origin, after rounding. They are computed in consecutive windows, to save memory in long flights.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any, Self

import numpy as np

from hitchopt.errors import FileError, optional_module
from hitchopt.exports.placing import AXES
from hitchopt.storage.archive import reading
from hitchopt.storage.files import file_bytes, parsed_json, strict_json
from hitchopt.storage.tables import SEPARATORS, Table
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import BREAK_TOLERANCE, merged_breaks, on_breaks
from hitchopt.values import Array

WINDOW = 20_000  # Pieces times drones of a window: about 40 MB with bounds
MAX_SPANS = 20_000_000  # Maximum number of pieces times drones with merged breaks
SAME_TIME = 1e-9  # Maximum difference of equal times [s]
MAX_DURATION = 1e4  # Maximum duration of a flight [s]
MAX_TIME = 1e10  # Maximum time since 1970 [s]
MIN_STEP = 9e-5  # Minimum step of samples [s]; exports have 1e-4 s or more
LONG_STEP = 2.0  # Step of samples above which a note is given [s]
MIN_COSINE = 0.9
"""Minimum cosine between displacements and velocities: smaller ones indicate wrong units."""

MAX_RATIO = 10.0  # Maximum ratio of the sizes of displacements and velocities, likewise

# Levels of a finding
ERROR = "error"  # The flight fails
WARNING = "warning"  # It may fail
NOTE = "note"  # Information for the pilot
LEVELS = (ERROR, WARNING, NOTE)


@dataclass(frozen=True)
class Finding:
    """An error, warning or note on fleet files."""

    level: str  # ERROR, WARNING or NOTE
    rule: str  # name of the rule, such as ``memory`` or ``end marker``
    where: str  # drone or file; empty for all
    message: str  # value, bound and remedy

    def __str__(self) -> str:
        place = f" {self.where}:" if self.where else ""
        return f"{self.level}: {self.rule}:{place} {self.message}"


error, warning, note = (partial(Finding, level) for level in (ERROR, WARNING, NOTE))
"""Constructors of findings of each level from rule, place and message."""


@dataclass(frozen=True)
class DroneFacts:
    """Size and duration of one drone's file."""

    name: str
    pieces: int = 0  # of the curve; 0 for samples
    size: int = 0  # in the drone's memory [B]; 0 without upload
    duration: float = 0.0  # [s]; 0 if all drones share their times


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One drone's curve in a file."""

    name: str
    curve: PiecewisePolynomial  # positions (3,) [m], from t = 0
    size: int = 0  # in the drone's memory [B]; 0 without upload
    frame: str = ""  # as stated in the file, or empty
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class FileContents:
    """The curves of exported numbers, and findings of the reader."""

    names: tuple[str, ...]  # (D,) of the drones, in the file's order
    frame: str  # enu, nwu or ned; empty if not stated
    smooth: int  # order of the highest continuous derivative
    windows: Callable[[], Iterator[PiecewisePolynomial]]  # (D, 3) [m], consecutive spans
    facts: tuple[DroneFacts, ...]  # one per drone
    missing_derivative: str = ""  # first derivative of the format that the files lack
    findings: tuple[Finding, ...] = ()
    own: Mapping[str, float] = field(default_factory=dict)  # limits that a show declares, by key

    @classmethod
    def of_curves(
        cls,
        drones: Sequence[Trajectory],
        frame: str,
        smooth: int,
        findings: Iterable[Finding] = (),
        own: Mapping[str, float] | None = None,
    ) -> Self:
        """Return the contents with one curve per drone, with individual breaks.

        Drones hold their final positions until the end of the last one. Breaks are merged window by
        window, to save memory.
        """
        ends = [float(drone.curve.breaks[-1]) for drone in drones]
        check_times(np.array([0.0, max(ends)]))
        degree = max(drone.curve.degree for drone in drones)
        curves = [held_until(drone.curve.elevated(degree), max(ends)) for drone in drones]
        times = [curve.breaks for curve in curves]
        if all(np.array_equal(t, times[0]) for t in times):
            times = times[:1]
        spans = len(np.unique(np.rint(np.concatenate(times) / BREAK_TOLERANCE))) - 1
        if spans * len(curves) > MAX_SPANS:
            reason = f"{len(curves)} drones with {spans} spans of time exceed {MAX_SPANS} in all"
            raise FileError(f"{reason}; use the same times for all drones, or fewer points")
        breaks, size = merged_breaks(times), max(1, WINDOW // len(curves))

        def windows() -> Iterator[PiecewisePolynomial]:
            for start in range(0, len(breaks) - 1, size):
                part = breaks[start : start + size + 1]
                coefficients = [on_breaks(curve, part).coefficients for curve in curves]
                yield PiecewisePolynomial(part, np.stack(coefficients, axis=1))

        names = tuple(drone.name for drone in drones)
        pieces, sizes = zip(*((drone.curve.pieces, drone.size) for drone in drones), strict=True)
        facts = tuple(map(DroneFacts, names, pieces, sizes, ends))
        findings = (*(finding for drone in drones for finding in drone.findings), *findings)
        return cls(names, frame, smooth, windows, facts, findings=findings, own=own or {})

    @classmethod
    def of_samples(
        cls, names: Sequence[str], t: Array, values: Array, frame: str, smooth: int
    ) -> Self:
        """Return the contents with samples, interpolated by Hermite polynomials.

        ``values`` (S, D, 3 m) at ``t`` (S,) [s] are positions, and optionally velocities and
        accelerations: the curves are lines, cubics or quintics. ``smooth`` is the order of the
        format's highest derivative; an unknown ``frame`` is ignored.
        """
        check_times(t)
        if len(t) < 2:
            raise FileError("has fewer than two samples")
        jet = np.moveaxis(values.reshape(len(t), len(names), -1, 3), 2, 0)
        if len(jet) > 1:
            _check_units(t, jet[0], jet[1])
        missing = ("velocities", "accelerations")[len(jet) - 1] if len(jet) <= smooth else ""
        size = max(1, WINDOW // len(names))

        def windows() -> Iterator[PiecewisePolynomial]:
            for start in range(0, len(t) - 1, size):
                ends = jet[:, start : start + size + 1]
                breaks = t[start : start + size + 1]
                yield PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])

        frame, facts = frame if frame in AXES else "", tuple(map(DroneFacts, names))
        step, findings = float(np.median(np.diff(t))), tuple[Finding, ...]()
        if step > LONG_STEP:
            findings = (note("times", "", f"{step:.3g} apart, read as seconds"),)
        return cls(tuple(names), frame, len(jet) - 1, windows, facts, missing, findings)


def check_times(t: Array, source: str = "") -> None:
    """Raise FileError unless times (S,) of a flight increase, and are plausible in seconds."""
    place = f"{source}: " if source else ""
    if not np.all(np.isfinite(t)):
        raise FileError(f"{place}a time is nan or infinite; every row needs one in seconds")
    step = float(np.median(np.diff(t))) if len(t) > 1 else math.inf
    if np.any(t > MAX_TIME) or np.ptp(t) > MAX_DURATION or 0.0 < step < MIN_STEP:
        steps = f" in steps of {step:.3g}" if len(t) > 1 else ""
        reason = f"its times go from {np.min(t):.6g} to {np.max(t):.6g}{steps}"
        remedy = "convert milliseconds, microseconds, nanoseconds, minutes or hours"
        raise FileError(f"{place}{reason}: these are not seconds of a flight; {remedy}")
    for i in np.flatnonzero(np.diff(t) <= SAME_TIME)[:1]:
        back = t[i + 1] < t[i] - SAME_TIME
        reason = "its times go back from" if back else "repeats the time"
        raise FileError(f"{place}{reason} t = {t[i]:g} s; sort its rows by time, one for each")


def _check_units(t: Array, positions: Array, velocities: Array) -> None:
    """Raise FileError if velocities (S, D, 3) are a multiple of the derivatives of positions."""
    actual = np.diff(positions, axis=0)
    expected = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(t)[:, None, None]
    product, square = np.vdot(actual, expected), np.vdot(expected, expected)
    if product > MIN_COSINE * math.sqrt(square * np.vdot(actual, actual)):
        ratio = product / square
        if not 1.0 / MAX_RATIO < ratio < MAX_RATIO:
            reason = f"positions change by {ratio:.3g} times what their velocities imply"
            raise FileError(f"{reason}: times are not in seconds, or velocities not in m/s")


def largest_jump(curves: PiecewisePolynomial, order: int) -> tuple[float, int, float]:
    """Return size, drone and time of the largest jump of a derivative between pieces."""
    left, right = curves.ends(order)
    sizes = np.linalg.norm(left[1:] - right[:-1], axis=-1)
    if sizes.size == 0:
        return 0.0, 0, 0.0
    joint, drone = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    return float(sizes[joint, drone]), int(drone), float(curves.breaks[1 + int(joint)])


def held_until(curve: PiecewisePolynomial, end: float) -> PiecewisePolynomial:
    """Return the curve, extended by its final value until ``end`` [s] if that is later."""
    if end <= curve.breaks[-1]:
        return curve
    c = curve.coefficients
    rest = np.broadcast_to(c[-1:, ..., -1:], c[-1:].shape)
    return PiecewisePolynomial(np.append(curve.breaks, end), np.concatenate([c, rest]))


def present_columns(header: Container[str], vectors: Sequence[Sequence[str]]) -> list[str]:
    """Return the columns of positions, and of the derivatives that are complete up to an order."""
    complete = takewhile(lambda vector: all(name in header for name in vector), vectors[1:])
    return [name for vector in (vectors[0], *complete) for name in vector]


def separator_findings(table: Table, where: str) -> list[Finding]:
    """Return an error if a table is not separated by commas, which its receivers expect."""
    if table.separator == ",":
        return []
    reason = (
        f"{SEPARATORS[table.separator]} between cells; readers expect commas and decimal points"
    )
    return [error("separator", where, reason)]


required_module = partial(optional_module, purpose="this format needs", extra="export")
"""Return an optional module of a format; raises UnsupportedError if it is missing."""


MANIFEST = "export.json"
"""File name of an export's manifest, which has its contents, frame and checks."""

NOTE = "README.txt"  # File name of the note in the folder of an export
PLAN_COPY = "exported_plan.npz"  # File name of the copy of the plan in the folder of its export
MANIFEST_FORMAT = "hitchopt-export/1"  # Format of the manifest


def read_manifest(folder: Path, name: str = MANIFEST) -> dict[str, Any]:
    """Return a folder's manifest, or an empty one; raises FileError if it is invalid."""
    path = folder / name
    if not path.is_file():
        return {}
    with reading(path, "manifest of an export"):
        content = parsed_json(file_bytes(path))
    is_manifest = isinstance(content, dict) and content.get("format") == MANIFEST_FORMAT
    return content if is_manifest else {}


def sealed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with the digest of its own content."""
    return {**manifest, "digest": _content_digest(manifest)}


def is_sealed(manifest: Mapping[str, Any]) -> bool:
    """Return whether the content of a manifest that was read is that of its digest."""
    return manifest.get("digest") == _content_digest(manifest)


def _content_digest(manifest: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a manifest's values, whatever its layout and line ends."""
    content = parsed_json(strict_json({k: x for k, x in manifest.items() if k != "digest"}))
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def listed_names(manifest: Mapping[str, Any], key: str) -> list[str]:
    """Return the plain file names in a list of a manifest, ``files`` or ``parts``."""
    value = manifest.get(key)
    names = value if isinstance(value, list) else []
    return [n for n in names if isinstance(n, str) and re.fullmatch(r"[^/\\\0.][^/\\\0]*", n)]
