"""Pre-flight lint: fleet files read back, ours or anybody else's, and what would go wrong.

Files are read by the formats that write them, which find what is wrong with a file; the rules for
the drones' joint flight are here: limits, jumps, ends in mid-flight, ranges and rates.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.checks.drones import largest_rate
from hitchopt.errors import FileError, InputError, UnitWarning
from hitchopt.exports.exporting import drone_check, part_folders
from hitchopt.exports.format import (
    ERROR,
    LEVELS,
    DroneFacts,
    Finding,
    Format,
    Loaded,
    error,
    format_of,
    note,
    warning,
)
from hitchopt.exports.formats.skybrush import ACROSS, DISTANCE, DOWN, OWN_LIMITS, UP
from hitchopt.exports.options import HOMES
from hitchopt.exports.recording import MANIFEST, read_manifest
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.storage.archive import PLAN
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.values import path as checked_path
from hitchopt.values import units

BAG = "metadata.yaml"  # File that makes a folder a bag
FARTHEST = 1e6  # [m] Drones are no farther from their origin: squares of such numbers stay finite
LATE = 1e-3  # [s] Durations may differ by this: formats round to it
MAX_FILES = 25_000  # Largest number of files in a folder that are read
SAME_START = 1e-3  # [m] Drones that begin this close to one another are given relative trajectories
SHORTEST = 1e-9  # [s] Shortest piece: rates over shorter times overflow
SPEED, ACCELERATION = 3.0, 10.0  # [m/s], [m/s²] Default limits
RADIOED = 32.767  # [m] Largest coordinate in formats of whole millimetres in 16 bits
WATCHDOG = 0.5  # [s] Longest gap between setpoints before a Crazyflie levels itself
SLOWEST = 30.0  # [Hz] Lowest rate at which full states are usefully streamed

REMEDIES = {
    "separation": "move them apart",
    DISTANCE: "move them apart",
    "maxAltitude": "fly lower",
}
"""Remedies by check; all others bound rates, which fall where a flight is slower."""

SIZES: dict[int, Callable[[Enclosed], Bound]] = {
    ACROSS: lambda rate: rate.level.norm_above,
    UP: lambda rate: rate[2].above,
    DOWN: lambda rate: (rate[2] * -1.0).above,
}
"""Sizes of a vector in the directions of own limits."""

UNTOLD = {
    "velocities": "none: joined by straight lines; accelerations are not checked",
    "accelerations": "none: joined by cubics through positions and velocities",
}
"""What is said of files that do not hold a derivative."""

Jump = tuple[float, str, float]  # Size, drone and time of a jump where pieces join


@dataclass(frozen=True)
class Flight:
    """Figures of the drones' joint flight over all of the time.

    Attributes
    ----------
    duration: [s]
    speed, acceleration: the largest of any drone [m/s], [m/s²]; nan where the files have none.
    separation: smallest ratio over pairs, 1 where ellipsoids touch; inf for one drone, nan where
        all trajectories begin at one point, relative to places that are not known.
    jumps: the largest between pieces, of position [m], velocity [m/s] and acceleration [m/s²], as
        far as the format means them to be smooth.
    reach: the largest coordinate, control points included [m].
    speed_limit, acceleration_limit: limits of these two [m/s], [m/s²]; inf where only the show's
        own limits apply.
    own: checks of the show's own limits.
    """

    duration: float
    speed: float
    acceleration: float
    separation: float
    jumps: tuple[float, ...]
    reach: float
    speed_limit: float
    acceleration_limit: float
    own: tuple[Check, ...] = ()


@dataclass(frozen=True)
class Report:
    """Findings and figures of a path.

    Attributes
    ----------
    path: file or folder that was read.
    kind: of format.
    frame: enu, nwu or ned; empty where the files do not state it.
    facts: one per drone.
    flight: of all drones together.
    findings: the errors first.
    """

    path: Path
    kind: str
    frame: str
    facts: tuple[DroneFacts, ...]
    flight: Flight
    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        """Whether there is no error; warnings are for the pilot to judge."""
        return all(finding.level != ERROR for finding in self.findings)


@dataclass(frozen=True)
class Rules:
    """Limits of the drones' flight.

    Attributes
    ----------
    speed: [m/s], of every drone; None: the show's own limits alone, or SPEED where it has none.
    acceleration: [m/s²], of every drone; None: the show's own, or ACCELERATION.
    separation: of any two drones.
    jumps: between pieces, of position [m], velocity [m/s], acceleration [m/s²]: beyond the first a
        flight is expected to fail, beyond the others to shake.
    """

    speed: float | None = None
    acceleration: float | None = None
    separation: Separation = field(default_factory=Separation)
    jumps: tuple[float, float, float] = (2e-3, 0.1, 2.0)

    def limits(self, own: Mapping[str, float]) -> tuple[float, float]:
        """Return the limits of speed and acceleration for a show; inf where its own stand alone."""

        def limit(given: float | None, default: float, name: str) -> float:
            if given is not None:
                return given
            return math.inf if {f"max{name}XY", f"max{name}Z"} <= set(own) else default

        speed = limit(self.speed, SPEED, "Velocity")
        return speed, limit(self.acceleration, ACCELERATION, "Acceleration")


def lint(path: Path | str, rules: Rules | None = None) -> tuple[Report, ...]:
    """Return the report on a file or folder; of an export that was cut, one for every part.

    Parameters
    ----------
    path: a file of a known format, or a folder of such files.
    rules: limits of the flight.

    Raises
    ------
    FileError: nothing there that is known, or a damaged file.
    UnsupportedError: a library that its format needs is not installed.
    """
    place = checked_path("path", path)
    parts = part_folders(place) if place.is_dir() else ()
    each = map(place.joinpath, parts or ("",))
    return tuple(_report(part, Rules() if rules is None else rules) for part in each)


def _report(path: Path, rules: Rules) -> Report:
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # such numbers are refused by name
            loaded = load(path)
            flight, found = _flown_together(loaded, rules)
    except (FileError, InputError) as fault:
        text = str(fault)
        raise FileError(text if text.startswith(str(path)) else f"{path}: {text}") from fault
    findings = [*loaded.findings, *found, *_missing(path)]
    if untold := loaded.recording.untold:
        findings.append(note(untold, "", UNTOLD[untold]))
    if not (frame := loaded.recording.frame):
        findings.append(note("frame", "", "the files do not state their axes; read as given"))
    findings.sort(key=lambda f: LEVELS.index(f.level))
    return Report(path, loaded.kind, frame, loaded.facts, flight, tuple(findings))


def load(path: Path) -> Loaded:
    """Return what a file or folder holds; raise FileError if that is not known, or damaged."""
    if not path.exists():
        raise FileError(f"{path}: there is no such file or folder")
    if path.name == PLAN or (path / PLAN).is_file():
        raise FileError(f"{path}: is a plan; use `hitchopt check` for plans, lint for exports")
    if (path / BAG).is_file():
        return format_of("ros2bag").load([path / BAG])
    known = [format_of(name) for name in HOMES]
    endings = tuple(dict.fromkeys(ending for kind in known for ending in kind.endings))
    there = sorted(path.iterdir()) if path.is_dir() else [path]
    files = [p for p in there if p.suffix.lower() in endings and p.name != MANIFEST]
    if not 0 < len(files) <= MAX_FILES:
        others = Counter(file.suffix.lower() or "no ending" for file in there)
        held = ", ".join(f"{count} of {ending}" for ending, count in sorted(others.items()))
        bound = f"from 1 to {MAX_FILES} files that end in {', '.join(endings)} are read"
        raise FileError(f"{path}: {bound}; it holds {held or 'nothing'}")
    kinds = Counter(_kind(file, known) for file in files)
    first = next(iter(kinds))
    if len(kinds) > 1 or (
        len(files) > 1 and not all(f.suffix.lower() in first.several for f in files)
    ):
        counts = ", ".join(f"{number} of {kind.name}" for kind, number in kinds.items())
        raise FileError(f"{path}: holds files that are not of one flight ({counts}); name one")
    return first.load(files)


def _kind(path: Path, known: Sequence[Format]) -> Format:
    """Return the format of a file, by its ending and by the first line of a CSV file."""
    suffix = path.suffix.lower()
    here = [kind for kind in known if suffix in kind.endings]
    if suffix != ".csv":
        return here[0]
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = file.readline(100_000).partition("#")[0].strip()
    except (OSError, ValueError) as fault:
        raise FileError(f"{path}: cannot be read as text: {fault}") from fault
    labels = [label.strip().lower() for label in header.split(",")]
    for kind in reversed(here):  # polynomials, which may begin with numbers, come last
        if kind.recognises(labels):
            return kind
    raise FileError(
        f"{path}: its first line, {header[:60]!r}, is of no known format (polynomials begin with "
        "duration, tables with t,drone, shows with idx,t,px or Time [msec])"
    )


def _flown_together(loaded: Loaded, rules: Rules) -> tuple[Flight, list[Finding]]:
    """Return the figures of the joint flight, and the findings on it."""
    names, smooth = loaded.recording.names, loaded.recording.smooth
    limits, checks = rules.limits(loaded.own), dict[str, list[Check]]()
    jumps: list[Jump] = [(0.0, "", 0.0)] * (smooth + 1)
    windows = loaded.recording.windows()
    last = next(windows)
    first, start = last.coefficients[0, ..., 0], float(last.breaks[0])
    # Several drones that begin at one point have an origin each.
    scattered = len(first) == 1 or float(np.max(np.ptp(first, axis=0))) >= SAME_START
    reach, longest = (0.0, ""), 0.0
    for window in (last, *windows):
        reach = max(reach, _reach(window, names))
        for check in _checks(loaded, window, limits, rules.separation, scattered):
            checks.setdefault(check.name, []).append(check)
        whole = window if window is last else joined([last, window])
        jumps = [max(jump, _jump(whole, order, names)) for order, jump in enumerate(jumps)]
        longest = max(longest, float(np.max(window.durations)))
        last = window.taken(slice(window.pieces - 1, window.pieces))
    worst = {name: each for name, found in checks.items() if (each := most_pressing(found))}
    values = {name: check.bound for name, check in worst.items()}
    flight = Flight(
        float(last.breaks[-1]) - start,
        values.get("speed", math.nan),
        values.get("acceleration", math.nan),
        values.get("separation", math.nan) if len(names) > 1 else math.inf,
        tuple(jump[0] for jump in jumps),
        reach[0],
        *limits,
        tuple(worst[key] for key in loaded.own if key in worst),
    )
    found = [*_broken(worst.values()), *_joining(last, names, jumps, rules)]
    if start != 0.0:
        found.append(warning("start", "", f"time begins at {start:g} s, not at 0; shift it"))
    if not scattered:
        words = "all drones begin at one point, so these are relative trajectories: how close "
        words += "they come depends on where they start, and is not checked"
        found.append(warning("separation", "", words))
    return flight, [*found, *_sampled(loaded, reach, longest)]


def _reach(window: PiecewisePolynomial, names: Sequence[str]) -> tuple[float, str]:
    """Return the largest coordinate [m] and whose it is; raise FileError of absurd numbers."""
    each = np.max(np.abs(window.coefficients), axis=(0, 2, 3))
    farthest = (float(np.max(each)), names[int(np.argmax(each))])
    if farthest[0] > FARTHEST:
        raise FileError(f"{farthest[1]} goes {farthest[0]:.3g} m from the origin; units are metres")
    if (shortest := np.min(window.durations)) < SHORTEST:
        at = float(window.breaks[np.argmin(window.durations)])
        raise FileError(f"a piece lasts {shortest:.2g} s at t = {at:g} s; leave it out")
    return farthest


def _checks(
    loaded: Loaded,
    window: PiecewisePolynomial,
    limits: tuple[float, float],
    separation: Separation,
    scattered: bool,
) -> Iterator[Check]:
    """Yield the checks of a window, the show's own limits among them, in axes with z up.

    From the second derivative after the highest that does not jump on they mean nothing.
    """
    names, smooth = loaded.recording.names, loaded.recording.smooth
    most = (units.SPEED.possible[1], units.ACCELERATION.possible[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitWarning)  # a show may have no limit
        fastest, steepest = map(min, limits, most)
        asked = Requirements(Limits(speed=fastest, acceleration=steepest), separation)
    found = [drone_check("speed", window, asked)]
    if len(names) > 1 and scattered:
        found.append(drone_check("separation", window, asked))
        if (least := loaded.own.get(DISTANCE)) is not None:
            apart = replace(asked, separation=Separation(0.5 * least, 0.5 * least))
            if (check := drone_check("separation", window, apart)) is not None:
                metres = check.bound * least
                own = Check.of(DISTANCE, metres, least, "min", "m", check.time, check.where)
                found.append(own)
    if smooth > 0:
        found.append(drone_check("acceleration", window, asked))
    for check in filter(None, found):
        yield replace(check, where=tuple(names[int(drone[1:])] for drone in check.where))
    for key, limit in loaded.own.items():
        order, unit, directions = OWN_LIMITS[key]
        if key == DISTANCE or order > smooth + 1:
            continue
        if f"{key}Up" in loaded.own:
            directions = (DOWN,)  # upwards, the other key takes precedence
        each = [largest_rate(window, order, size=SIZES[d]) for d in directions]
        worst = max(each, key=lambda found: (found.worst, found.item, found.time))
        yield Check.of(key, worst.worst, limit, "max", unit, worst.time, (names[worst.item],))


def _jump(window: PiecewisePolynomial, order: int, names: Sequence[str]) -> Jump:
    """Return the largest jump of a derivative where pieces join."""
    left, right = window.ends(order)
    sizes = np.linalg.norm(left[1:] - right[:-1], axis=-1)
    if sizes.size == 0:
        return (0.0, "", 0.0)
    joint, drone = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    return (float(sizes[joint, drone]), names[int(drone)], float(window.breaks[1 + int(joint)]))


def _broken(checks: Iterable[Check]) -> Iterator[Finding]:
    for check in checks:
        if not check.holds:
            unit = "" if check.unit == "ratio" else f" {check.unit}"
            relation = "below" if check.sense == "min" else "above"
            yield error(
                check.name,
                ", ".join(check.where),
                f"{check.bound:.4g}{unit} at t = {check.time:.4g} s is {relation} "
                f"{check.limit:.4g}{unit}; {REMEDIES.get(check.name, 'fly it more slowly')}",
            )


def _joining(
    last: PiecewisePolynomial, names: Sequence[str], jumps: Sequence[Jump], rules: Rules
) -> Iterator[Finding]:
    """Yield jumps where pieces join, and who still moves at the end."""
    rates = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s²"))
    for (what, unit), (size, drone, t), bound in zip(rates, jumps, rules.jumps, strict=False):
        if size > bound:
            yield (error if what == "position" else warning)(
                "jump",
                drone,
                f"{what} jumps by {size:.3g} {unit} where pieces join at t = {t:.4g} s "
                f"(more than {bound:g} {unit}); make the pieces meet",
            )
    speeds, bound = np.linalg.norm(last.ends(1)[1][-1], axis=-1), rules.jumps[1]
    if speeds[fastest := int(np.argmax(speeds))] > bound:
        yield warning(
            "end",
            names[fastest],
            f"still moves at {speeds[fastest]:.3g} m/s at its end, t = {last.breaks[-1]:.4g} s "
            f"(more than {bound:g} m/s); let it come to rest: is something cut off?",
        )


def _sampled(loaded: Loaded, reach: tuple[float, str], longest: float) -> Iterator[Finding]:
    """Yield how far drones go [m], too long a time between two samples [s], and early ends."""
    if reach[0] > RADIOED:
        words = f"goes {reach[0]:.4g} m from the origin; formats of millimetres in 16 bits hold "
        yield note("range", reach[1], f"{words}±{RADIOED} m; move the origin")
    if loaded.streamed and longest > WATCHDOG:
        words = f"{longest:.3g} s between two setpoints; the drones' watchdog waits {WATCHDOG} s"
        yield error("rate", "", f"{words}; sample at {SLOWEST:g} Hz or more")
    elif loaded.kind == "ros2bag" and longest * SLOWEST > 1.01:
        words = f"{1.0 / longest:.3g} Hz; full states are to be streamed at {SLOWEST:g} to 100 Hz"
        yield warning("rate", "", f"{words}; sample more often")
    durations = [fact.duration for fact in loaded.facts]
    shortest, most = min(loaded.facts, key=lambda fact: fact.duration), max(durations)
    if shortest.duration < most - LATE:
        words = f"lasts {shortest.duration:.6g} s, the longest {most:.6g} s; let all end together"
        yield warning("duration", shortest.name, words)


def _missing(path: Path) -> Iterator[Finding]:
    """Yield which files of an export are gone, and why the tension is undetermined."""
    manifest = (read_manifest(path) or {}) if path.is_dir() else {}
    listed, reasons = (
        [str(each) for each in given] if isinstance(given, list) else []
        for given in (manifest.get("files"), manifest.get("undetermined_tension"))
    )
    there = {entry.name for entry in path.iterdir()} if listed else set()
    for file in listed:
        if file not in there:
            yield error("missing", file, "was exported and is not there")
    for reason in reasons:
        yield warning("tension", "", reason)
