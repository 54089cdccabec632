"""Contents of exported files: text, tables, manifests, and the drones' curves of time.

Every fault of a file is a FileError. A recording is read off exported numbers, ours or anybody
else's, after rounding. Windows follow one another without a gap, so that the curves and bounds of
long flights are not held in memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from typing import Any, Self

import numpy as np

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.exports.placing import AXES
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import SEPARATORS, Table
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import SAME_BREAK, merged_breaks, on_breaks
from hitchopt.values import Array

WINDOW = 20_000  # Pieces times drones that are read together: about 40 MB with their bounds
MAX_SPANS = 20_000_000  # Largest number of them with all drones' breaks merged; no show has more
SAME_TIME = 1e-9  # Largest difference of samples of one time [s]
LONGEST, LATEST = 1e4, 1e10  # [s] No flight lasts longer, nor ends later after 1970
SHORTEST = 9e-5  # [s] Samples are no nearer to one another: exports have 1e-4 s at least
RARE = 2.0  # [s] Samples are seldom farther apart
ALIKE, APART = 0.9, 10.0
"""Cosine of displacements and velocities, and the ratio of their sizes, that units tell apart."""

ERROR, WARNING, NOTE = LEVELS = ("error", "warning", "note")
"""Levels of a finding: the flight fails; it may fail; information for the pilot."""


@dataclass(frozen=True)
class Finding:
    """One problem, or one piece of information, found in fleet files."""

    level: str  # ERROR, WARNING or NOTE
    rule: str  # its name in one word or two, such as ``memory`` or ``end marker``
    where: str  # drone or file; empty for all of them
    message: str  # value, bound, and the remedy

    def __str__(self) -> str:
        place = f" {self.where}:" if self.where else ""
        return f"{self.level}: {self.rule}:{place} {self.message}"


error, warning, note = (partial(Finding, level) for level in (ERROR, WARNING, NOTE))
"""Constructors of findings of each level from rule, place and message."""


@dataclass(frozen=True)
class DroneFacts:
    """Size and duration of one drone's file."""

    name: str
    pieces: int = 0  # of its curve; 0 where it is sampled
    size: int = 0  # [bytes] in the drone's memory; 0 where it is not uploaded
    duration: float = 0.0  # [s] of its own file; 0 where all drones share their times


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One drone's curve as it stands in a file."""

    name: str
    curve: PiecewisePolynomial  # positions (3,) [m], from t = 0 on
    size: int = 0  # in the drone's memory [bytes]; 0 where it is not uploaded
    frame: str = ""  # that the file names; empty where it names none
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """The curves that exported numbers stand for, and what was found while reading them."""

    names: tuple[str, ...]  # (D,) of the drones, in the file's order
    frame: str  # enu, nwu or ned; empty where the file does not say
    smooth: int  # highest derivative by time that does not jump: 0 positions, 1 velocities, …
    windows: Callable[[], Iterator[PiecewisePolynomial]]  # (D, 3) [m], one span after the other
    facts: tuple[DroneFacts, ...]  # one per drone
    missing_derivative: str = (
        ""  # the first derivative that the format has and the files do not hold
    )
    findings: tuple[Finding, ...] = ()
    own: Mapping[str, float] = field(default_factory=dict)  # a show's own limits, by its keys

    @classmethod
    def of_curves(
        cls,
        drones: Sequence[Trajectory],
        frame: str,
        smooth: int,
        findings: Iterable[Finding] = (),
        own: Mapping[str, float] | None = None,
    ) -> Self:
        """Return the recording of one curve per drone, each with breaks of its own.

        Drones that end before the others stay where they ended. Curves are put on common breaks
        window by window: they take no more memory than their files.
        """
        ends = [float(drone.curve.breaks[-1]) for drone in drones]
        check_times(np.array([0.0, max(ends)]))
        degree = max(drone.curve.degree for drone in drones)
        each = [held_until(drone.curve.elevated(degree), max(ends)) for drone in drones]
        times = [curve.breaks for curve in each]
        if all(np.array_equal(t, times[0]) for t in times):
            times = times[:1]
        spans = len(np.unique(np.rint(np.concatenate(times) / SAME_BREAK))) - 1
        if spans * len(each) > MAX_SPANS:
            words = f"{len(each)} drones with {spans} spans of time are too many to be read"
            raise FileError(f"{words}; give all drones the same times, or fewer points")
        breaks, size = merged_breaks(times), max(1, WINDOW // len(each))

        def windows() -> Iterator[PiecewisePolynomial]:
            for start in range(0, len(breaks) - 1, size):
                here = breaks[start : start + size + 1]
                parts = [on_breaks(curve, here).coefficients for curve in each]
                yield PiecewisePolynomial(here, np.stack(parts, axis=1))

        names = tuple(drone.name for drone in drones)
        pieces, sizes = zip(*((drone.curve.pieces, drone.size) for drone in drones), strict=True)
        facts = tuple(map(DroneFacts, names, pieces, sizes, ends))
        every = (*(finding for drone in drones for finding in drone.findings), *findings)
        return cls(names, frame, smooth, windows, facts, findings=every, own=own or {})

    @classmethod
    def of_samples(
        cls, names: Sequence[str], t: Array, values: Array, frame: str, smooth: int
    ) -> Self:
        """Return the recording of samples: between two of them the curve that meets both.

        ``values`` (S, D, 3 m) at ``t`` (S,) [s] are positions, then velocities and accelerations as
        far as there are any: lines, cubics or quintics run through them. ``smooth`` is the highest
        derivative that the format has; an unknown ``frame`` becomes none.
        """
        check_times(t)
        if len(t) < 2:
            raise FileError("has fewer than two samples; nothing moves between them")
        given = np.moveaxis(values.reshape(len(t), len(names), -1, 3), 2, 0)
        if len(given) > 1:
            _check_rates(t, given[0], given[1])
        missing_derivative = (
            ("velocities", "accelerations")[len(given) - 1] if len(given) <= smooth else ""
        )
        size = max(1, WINDOW // len(names))

        def windows() -> Iterator[PiecewisePolynomial]:
            for start in range(0, len(t) - 1, size):
                ends = given[:, start : start + size + 1]
                here = t[start : start + size + 1]
                yield PiecewisePolynomial.hermite(here, ends[:, :-1], ends[:, 1:])

        known, facts = frame if frame in AXES else "", tuple(map(DroneFacts, names))
        rare = (step := float(np.median(np.diff(t)))) > RARE
        findings = [note("times", "", f"{step:.3g} apart, read as seconds")] if rare else []
        return cls(
            tuple(names), known, len(given) - 1, windows, facts, missing_derivative, tuple(findings)
        )


def check_times(t: Array, source: str = "") -> None:
    """Raise FileError unless times (S,) [s] of a flight increase, naming what they do instead."""
    place = f"{source}: " if source else ""
    if not np.all(np.isfinite(t)):
        raise FileError(f"{place}a time is nan or infinite; every row needs one in seconds")
    step = float(np.median(np.diff(t))) if len(t) > 1 else math.inf
    if np.any(t > LATEST) or np.ptp(t) > LONGEST or 0.0 < step < SHORTEST:
        steps = f" in steps of {step:.3g}" if len(t) > 1 else ""
        words = f"its times go from {np.min(t):.6g} to {np.max(t):.6g}{steps}"
        remedy = "convert milliseconds, microseconds, nanoseconds, minutes or hours"
        raise FileError(f"{place}{words}: those are no seconds of a flight; {remedy}")
    for i in np.flatnonzero(np.diff(t) <= SAME_TIME)[:1]:
        back = t[i + 1] < t[i] - SAME_TIME
        words = "its times go back from" if back else "repeats the time"
        raise FileError(f"{place}{words} t = {t[i]:g} s; sort its rows, one of every time")


def _check_rates(t: Array, positions: Array, velocities: Array) -> None:
    """Raise FileError if positions (S, D, 3) move as velocities say, but in other units of time."""
    moved = np.diff(positions, axis=0)
    said = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(t)[:, None, None]
    both, squares, whole = np.vdot(moved, said), np.vdot(said, said), np.vdot(moved, moved)
    if both > ALIKE * math.sqrt(squares * whole) and not 1.0 / APART < both / squares < APART:
        words = f"positions change by {both / squares:.3g} times what velocities say"
        raise FileError(f"{words}: times are in other units than seconds, or velocities than m/s")


def largest_jump(curves: PiecewisePolynomial, order: int) -> tuple[float, int, float]:
    """Return size, drone and time of the largest jump of a derivative where pieces join."""
    left, right = curves.ends(order)
    sizes = np.linalg.norm(left[1:] - right[:-1], axis=-1)
    if sizes.size == 0:
        return 0.0, 0, 0.0
    joint, drone = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    return float(sizes[joint, drone]), int(drone), float(curves.breaks[1 + int(joint)])


def held_until(curve: PiecewisePolynomial, end: float) -> PiecewisePolynomial:
    """Return the curve, staying where it ended until ``end`` [s], if that is later."""
    if end <= curve.breaks[-1]:
        return curve
    c = curve.coefficients
    rest = np.broadcast_to(c[-1:, ..., -1:], c[-1:].shape)
    return PiecewisePolynomial(np.append(curve.breaks, end), np.concatenate([c, rest]))


def present_columns(header: Container[str], vectors: Sequence[Sequence[str]]) -> list[str]:
    """Return the columns that a table tells: places, then whole vectors of rates in a row."""
    complete = takewhile(lambda vector: all(name in header for name in vector), vectors[1:])
    return [name for vector in (vectors[0], *complete) for name in vector]


def unusual(table: Table, where: str) -> list[Finding]:
    """Return the error that the receivers of a file of commas do not read a table."""
    if table.separator == ",":
        return []
    words = f"{SEPARATORS[table.separator]} between cells; readers take commas, and decimal points"
    return [error("separator", where, words)]


def needed(module: str) -> Any:
    """Return a module that only some formats need; UnsupportedError says what to install."""
    try:
        return import_module(module)
    except ImportError as fault:
        package = module.partition(".")[0]
        words = f"this format needs the package {package} ({fault}); pip install 'hitchopt[export]'"
        raise UnsupportedError(words) from fault


MANIFEST, MANIFEST_FORMAT = "export.json", "hitchopt-export/1"
"""Name of an export's manifest (contents, frame and checks), and its format."""


def read_manifest(folder: Path, name: str = MANIFEST) -> dict[str, Any]:
    """Return a folder's manifest; empty if it is not of this package; raise FileError."""
    path = folder / name
    if not path.is_file():
        return {}
    with reading(path, "manifest of an export"):
        content = parsed_json(path.read_bytes())
    ours = isinstance(content, dict) and content.get("format") == MANIFEST_FORMAT
    return content if ours else {}


def listed(manifest: Mapping[str, Any], key: str) -> list[str]:
    """Return the plain names in a list of a manifest, ``files`` or ``parts``."""
    given = manifest.get(key)
    each = given if isinstance(given, list) else []
    return [n for n in each if isinstance(n, str) and re.fullmatch(r"[^/\\\0.][^/\\\0]*", n)]
