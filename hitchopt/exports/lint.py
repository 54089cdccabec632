"""Pre-flight lint: read fleet files of any origin and report faults.

Files are read by the formats that write them, which find what is wrong with a file; the rules for
the drones' joint flight are here: limits, jumps, ends in mid-flight, ranges and rates.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Check, worst_of
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import FileError, InputError
from hitchopt.exports.directory import changed_tables
from hitchopt.exports.firmware import SETTINGS, settings_findings
from hitchopt.exports.format import Format, format_of
from hitchopt.exports.formats.skybrush import DISTANCE, LOWEST, OWN_LIMITS
from hitchopt.exports.options import ENDINGS, HOMES
from hitchopt.exports.recording import (
    ERROR,
    LEVELS,
    MANIFEST,
    DroneFacts,
    Finding,
    Recording,
    error,
    largest_jump,
    listed,
    note,
    read_manifest,
    warning,
)
from hitchopt.hitch import Swarm
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import Motion
from hitchopt.storage.archive import PLAN, reading
from hitchopt.storage.files import digest
from hitchopt.storage.tables import headings, text_lines
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array
from hitchopt.values import path as checked_path

BAG = "metadata.yaml"  # File that makes a folder a bag
FLEET = "crazyflies.yaml"  # File that says where drones stand
FARTHEST = 1e6  # [m] Drones are no farther from their origin: squares of such numbers stay finite
CROSSING = 1e-2  # [s] Times at which drones cross an altitude are exact to this
LATE = 1e-3  # [s] Durations may differ by this: formats round to it
SAME_START = 1e-3  # [m] Drones that begin this close to one another are given relative trajectories
SAME_PLACE = 1e-2  # [m] Parts of one drone's flight meet as closely as this
SAME_SPOT = 0.1  # [m] Drones stand within this of the points below their first ones
SHORTEST = 1e-9  # [s] Shortest piece: rates over shorter times overflow
USUAL = (("speed", "Velocity", 3.0), ("acceleration", "Acceleration", 10.0))
"""Names here and in a show's keys of what has a default limit [m/s], [m/s²], and the limit."""

RADIOED = 32.767  # [m] Largest coordinate in formats of whole millimetres in 16 bits
SOUND = 340.0  # [m/s] No drone is faster
WATCHDOG = 0.5  # [s] Longest gap between setpoints before a Crazyflie levels itself

REMEDIES = dict.fromkeys(("separation", DISTANCE), "move them apart") | {"maxAltitude": "fly lower"}
"""Remedies by check; all others bound rates, which fall where a flight is slower."""

SIZES: dict[str, Callable[[Enclosed], Bound]] = {
    "all": lambda rate: rate.norm_above,
    "across": lambda rate: rate.level.norm_above,
    "up": lambda rate: rate[2].above,
    "down": lambda rate: (rate[2] * -1.0).above,
}
"""Sizes of the parts of a vector that limits count."""

RATES = {"speed": (1, "m/s", ("all",)), "acceleration": (2, "m/s²", ("all",))} | OWN_LIMITS
"""Derivative by time, unit and parts that count, by limit."""


@dataclass(frozen=True)
class Flight:
    """Figures of the drones' joint flight over all of the time."""

    duration: float  # [s]
    speed: float  # the largest of any drone [m/s]
    acceleration: float  # [m/s²]; nan where the files have none
    separation: float  # smallest ratio over pairs; inf for one drone, nan of unknown places
    jumps: tuple[float, ...]  # the largest between pieces, of position, velocity, acceleration
    reach: float  # the largest coordinate, control points included [m]
    speed_limit: float  # [m/s]; inf where only the show's own limits apply
    acceleration_limit: float  # [m/s²]; likewise
    own: tuple[Check, ...] = ()  # checks of the show's own limits


@dataclass(frozen=True)
class Report:
    """Findings and figures of a path."""

    path: Path  # file or folder that was read
    kind: str  # of format
    frame: str  # enu, nwu or ned; empty where the files do not state it
    facts: tuple[DroneFacts, ...]  # one per drone
    flight: Flight  # of all drones together
    findings: tuple[Finding, ...]  # the errors first

    @property
    def sound(self) -> bool:
        """Whether there is no error; warnings are for the pilot to judge."""
        return all(finding.level != ERROR for finding in self.findings)


@dataclass(frozen=True)
class Rules:
    """Limits of the drones' flight; None is a show's own, or the default where it has none.

    Jumps between pieces are limited in position [m], beyond which a flight is expected to fail,
    velocity [m/s] and acceleration [m/s²], beyond which it shakes.
    """

    speed: float | None = None  # [m/s]
    acceleration: float | None = None  # [m/s²]
    separation: Separation = field(default_factory=Separation)
    jumps: tuple[float, float, float] = (2e-3, 0.1, 2.0)

    def limits(self, own: Mapping[str, float]) -> dict[str, float]:
        """Return the limits of a show by name, its own among them; inf where these stand alone."""
        limits = dict(own)
        for name, key, usual in USUAL:
            alone = {f"max{key}XY", f"max{key}Z"} <= set(own)
            given = getattr(self, name)
            limits[name] = given if given is not None else math.inf if alone else usual
        return limits


def lint(path: Path | str, rules: Rules | None = None) -> tuple[Report, ...]:
    """Return the report on a file or folder; of an export that was cut, one for every part.

    FileError tells of a damaged file, or of nothing there that is known, UnsupportedError of a
    library that its format needs. ``rules`` are the limits of the flight.
    """
    place = checked_path("path", path)
    parts = listed(read_manifest(place), "parts") if place.is_dir() else []
    each = map(place.joinpath, parts or [""])
    return tuple(_report(part, Rules() if rules is None else rules) for part in each)


def _report(path: Path, rules: Rules) -> Report:
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # such numbers are refused by name
            kind, recording = load(path)
            flight, findings = _flown_together(kind, recording, rules)
            findings += _settings(path)
    except (FileError, InputError) as fault:
        text = str(fault)
        raise FileError(text if text.startswith(str(path)) else f"{path}: {text}") from fault
    findings = [*recording.findings, *findings, *_exported(path, kind, recording)]
    if missing_derivative := recording.missing_derivative:
        words = (
            "lines"
            if missing_derivative == "velocities"
            else "cubics through positions and velocities"
        )
        findings.append(note(missing_derivative, "", f"none: joined by {words}"))
    if not recording.frame:
        findings.append(note("frame", "", "the files do not state their axes; read as given"))
    findings.sort(key=lambda f: LEVELS.index(f.level))
    return Report(path, kind.name, recording.frame, recording.facts, flight, tuple(findings))


def load(path: Path) -> tuple[Format, Recording]:
    """Return the format of a file or folder and what it holds; raise FileError of others."""
    if not path.exists():
        raise FileError(f"{path}: there is no such file or folder")
    if path.name == PLAN or (path / PLAN).is_file():
        raise FileError(f"{path}: is a plan; use `hitchopt check` for plans, lint for exports")
    if (path / BAG).is_file():
        return format_of("ros2bag"), format_of("ros2bag").load([path / BAG])
    there = sorted(path.iterdir()) if path.is_dir() else [path]
    files = [p for p in there if p.suffix.lower() in ENDINGS and p.name != MANIFEST]
    if not files:
        held = ", ".join(sorted({file.suffix.lower() or file.name for file in there})) or "nothing"
        raise FileError(f"{path}: files of {', '.join(ENDINGS)} are read; it holds {held}")
    known = [format_of(name) for name in HOMES]
    kinds = Counter(_kind(file, known) for file in files)
    first = next(iter(kinds))
    alone = len(files) == 1 or all(f.suffix.lower() in first.several for f in files)
    if len(kinds) > 1 or not alone:
        counts = ", ".join(f"{number} of {kind.name}" for kind, number in kinds.items())
        raise FileError(f"{path}: holds files that are not of one flight ({counts}); name one")
    return first, first.load(files)


def _kind(path: Path, known: Sequence[Format]) -> Format:
    """Return the format of a file, by its ending and by the first lines of a CSV file."""
    suffix = path.suffix.lower()
    here = [kind for kind in known if suffix in kind.endings]
    if suffix != ".csv":
        return here[0]
    with reading(path, "text"):
        lines = list(headings(lambda: text_lines(path)))
    for line in lines:
        for kind in reversed(here):  # polynomials, which may begin with numbers, come last
            if re.match(kind.header, line):
                return kind
    first, columns = next(filter(None, lines), "")[:60], "duration, t,drone, idx,t,px, Time [msec]"
    words = f"is of no known format ({columns}; apart by commas, semicolons, tabs or blanks)"
    raise FileError(f"{path}: its first line, {first!r}, {words}")


def _flown_together(
    kind: Format, recording: Recording, rules: Rules
) -> tuple[Flight, list[Finding]]:
    """Return the figures of the joint flight, and the findings on it."""
    names, own = recording.names, recording.own
    limits, checks = rules.limits(own), dict[str, Check]()
    jumps = [(0.0, 0, 0.0)] * (recording.smooth + 1)
    windows = recording.windows()
    last = next(windows)
    first, start = last.coefficients[0, ..., 0], float(last.breaks[0])
    relative = len(first) > 1 and float(np.max(np.ptp(first, axis=0))) < SAME_START
    reach, longest = (0.0, ""), 0.0
    for window in (last, *windows):
        reach = max(reach, _reach(window, names))
        for check in _checks(recording, window, limits, None if relative else rules.separation):
            checks[check.name] = worst_of([checks.get(check.name), check]) or check
        whole = window if window is last else joined([last, window])
        jumps = [max(jump, largest_jump(whole, order)) for order, jump in enumerate(jumps)]
        longest = max(longest, float(np.max(window.durations)))
        last = window.slice_pieces(slice(window.pieces - 1, window.pieces))
    values = defaultdict(lambda: math.nan, {name: check.bound for name, check in checks.items()})
    if (fastest := checks.get("speed")) is not None and fastest.bound > SOUND:
        words = f"flies at {fastest.bound:.3g} m/s at t = {fastest.time:g} s, faster than sound"
        raise FileError(f"{fastest.where[0]} {words}; are its times in other units?")
    flight = Flight(
        float(last.breaks[-1]) - start,
        *(values["speed"], values["acceleration"]),
        values["separation"] if len(names) > 1 else math.inf,
        tuple(jump[0] for jump in jumps),
        reach[0],
        *(limits["speed"], limits["acceleration"]),
        tuple(checks[key] for key in own if key in checks),
    )
    unset = [name for name, key, usual in USUAL if getattr(rules, name) is None]
    broken = (check for check in checks.values() if not check.holds)
    findings = [_broken(check, given=check.name not in unset) for check in broken]
    findings += [*_joining(last, names, jumps, rules), *_timing(kind, recording, longest)]
    if reach[0] > RADIOED:
        words = f"goes {reach[0]:.4g} m from the origin, and 16 bits hold {RADIOED} m; move it"
        findings.append(note("range", reach[1], words))
    if start != 0.0:
        findings.append(warning("start", "", f"time begins at {start:g} s, not at 0; shift it"))
    if relative:
        words = (
            "not checked: all begin at one point, as relative trajectories do; give their starts"
        )
        findings.append(warning("separation", "", words))
    elif kind.several:
        findings += _sequence(names, first, last.coefficients[-1, ..., -1])
    if {DISTANCE, LOWEST} <= set(own):
        findings.append(
            note(DISTANCE, "", f"counts above {own[LOWEST]:g} m, where both drones are")
        )
    return flight, findings


def _reach(window: PiecewisePolynomial, names: Sequence[str]) -> tuple[float, str]:
    """Return the largest coordinate [m] and whose it is; raise FileError of absurd numbers."""
    each = np.max(np.abs(window.coefficients), axis=(0, 2, 3))
    farthest = float(np.max(each)), names[int(np.argmax(each))]
    if farthest[0] > FARTHEST:
        raise FileError(f"{farthest[1]} goes {farthest[0]:.3g} m from the origin; units are metres")
    if (shortest := np.min(window.durations)) < SHORTEST:
        at = float(window.breaks[np.argmin(window.durations)])
        raise FileError(f"a piece lasts {shortest:.2g} s at t = {at:g} s; leave it out")
    return farthest


def _checks(
    recording: Recording,
    window: PiecewisePolynomial,
    limits: Mapping[str, float],
    separation: Separation | None,
) -> Iterator[Check]:
    """Yield the checks of a window against limits by name, in axes with z up.

    From the second derivative after the highest that does not jump on they mean nothing.
    """
    names, least = recording.names, limits.get(DISTANCE)
    for key in (key for key in RATES if key in limits):
        order, unit, parts = RATES[key]
        if order > recording.smooth + 1:
            continue
        counted = ("down",) if f"{key}Up" in limits else parts  # upwards, its own key counts
        each = [largest_rate(window, order, size=SIZES[part]) for part in counted]
        most = max(each, key=lambda found: (found.worst, found.item, found.time))
        whose = (names[most.item],)
        yield Check.of(key, most.worst, limits[key], "max", unit, most.time, whose)
    distances_by_key = [] if separation is None else [("separation", separation, 1.0, "ratio")]
    if distances_by_key and least is not None:
        distances_by_key.append((DISTANCE, Separation(0.5 * least, 0.5 * least), least, "m"))
    for key, distances, ratio, unit in distances_by_key:
        requirements = Requirements(Limits(), distances)
        whole = [(window, np.arange(len(names)))]
        lowest = limits.get(LOWEST) if key == DISTANCE else None
        for part, drones in whole if lowest is None else _above(window, lowest):
            motion = Motion.single(Swarm(len(drones)), requirements, part, ())
            if (check := RULE_OF["separation"].check(motion)) is not None:
                where = tuple(names[drones[int(drone[1:])]] for drone in check.where)
                yield Check.of(key, check.bound * ratio, ratio, "min", unit, check.time, where)


def _above(
    window: PiecewisePolynomial, altitude: float
) -> Iterator[tuple[PiecewisePolynomial, NDArray[np.intp]]]:
    """Yield spans of a window in which two drones or more are above an altitude [m], and which.

    Drones are above or below in the middle of a span; times of crossing are exact to CROSSING.
    """
    heights, breaks = window.coefficients[..., 2, :], window.breaks
    mixed = (np.min(heights, axis=-1) <= altitude) & (np.max(heights, axis=-1) > altitude)
    times = [breaks]
    for k in np.flatnonzero(np.any(mixed, axis=1)):
        grid = np.arange(breaks[k], breaks[k + 1], CROSSING)
        high = window.at(grid)[..., 2] > altitude
        times.append(grid[1:][np.any(high[1:] != high[:-1], axis=1)])
    fine = on_breaks(window, merged_breaks(times))
    high = fine.at(0.5 * (fine.breaks[1:] + fine.breaks[:-1]))[..., 2] > altitude
    ends = np.flatnonzero(np.any(high[1:] != high[:-1], axis=1)) + 1
    for first, last in pairwise([0, *ends.tolist(), fine.pieces]):
        if len(drones := np.flatnonzero(high[first])) > 1:
            here = fine.slice_pieces(slice(first, last))
            yield here.alike(here.coefficients[:, drones]), drones


def _broken(check: Check, *, given: bool) -> Finding:
    """Return the error that a limit is broken; a warning for a default limit."""
    unit = "" if check.unit == "ratio" else f" {check.unit}"
    relation = "below" if check.sense == "min" else "above"
    words = f"{check.bound:.4g}{unit} at t = {check.time:.4g} s is {relation} "
    words += f"{check.limit:.4g}{unit}{'' if given else ', a default limit'}; "
    words += REMEDIES.get(check.name, "fly it more slowly")
    words += "" if given else f", or set --{check.name}"
    return (error if given else warning)(check.name, ", ".join(check.where), words)


def _joining(
    last: PiecewisePolynomial,
    names: Sequence[str],
    jumps: Sequence[tuple[float, int, float]],
    rules: Rules,
) -> Iterator[Finding]:
    """Yield jumps where pieces join, and who still moves at the end."""
    rates = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s²"))
    for (what, unit), (size, drone, t), bound in zip(rates, jumps, rules.jumps, strict=False):
        if size > bound:
            words = f"{what} jumps by {size:.3g} {unit} where pieces join at t = {t:.4g} s; mend it"
            yield (error if what == "position" else warning)("jump", names[drone], words)
    speeds, bound = np.linalg.norm(last.ends(1)[1][-1], axis=-1), rules.jumps[1]
    if speeds[fastest := int(np.argmax(speeds))] > bound:
        words = (
            f"still moves at {speeds[fastest]:.3g} m/s at t = {last.breaks[-1]:.4g} s; end at rest"
        )
        yield warning("end", names[fastest], words)


def _timing(kind: Format, recording: Recording, longest: float) -> Iterator[Finding]:
    """Yield too long a time between two samples [s], and early ends."""
    if longest * kind.streamed > 1.01:
        words = f"{longest:.3g} s between two setpoints; send them at {kind.streamed:g} Hz or more"
        yield (error if longest > WATCHDOG else warning)("rate", "", words)
    shortest = min(recording.facts, key=lambda fact: fact.duration)
    if shortest.duration < (most := max(fact.duration for fact in recording.facts)) - LATE:
        words = f"lasts {shortest.duration:.6g} s, another {most:.6g} s; let all end together"
        yield warning("duration", shortest.name, words)


def _sequence(names: Sequence[str], starts: Array, ends: Array) -> Iterator[Finding]:
    """Yield that files, in the order of their names, begin where the ones before them end.

    Names (D,) count up in their numbers; ``starts`` and ``ends`` (D, 3) [m] are those of the files.
    """
    counted = [[int(x) if x.isdigit() else x for x in re.split(r"(\d+)", n)] for n in names]
    order = sorted(range(len(names)), key=lambda i: counted[i])
    gaps = np.linalg.norm(starts[order[1:]] - ends[order[:-1]], axis=-1)
    if len(names) > 1 and np.max(gaps) < SAME_PLACE:
        each = f"{', '.join(names[i] for i in order[:3])}{', …' if len(names) > 3 else ''}"
        words = (
            f"{each} each begin where the one before ends: if they are one drone's parts, flown "
        )
        words += "one after another, drones are not near one another; lint them one by one"
        yield note("sequence", "", words)


def _exported(path: Path, kind: Format, recording: Recording) -> Iterator[Finding]:
    """Yield differences to an export's manifest, and why the tension is undetermined."""
    if path.is_dir():
        manifest = read_manifest(path)
        files = {name: path / name for name in listed(manifest, "files")}
    else:
        own, folder = (read_manifest(path.parent, f"{n}{MANIFEST}") for n in (f"{path.name}.", ""))
        manifest = own or folder
        files = {name: path for name in listed(manifest, "files") if own or name == path.name}
        if path.name in changed_tables(path.parent):
            yield error("changed", path.name, "is not what was written with the plan beside it")
    if not files:
        return
    known = manifest.get("digests")
    digests = known if isinstance(known, dict) else {}
    for file, here in files.items():
        if not here.exists():
            yield error("missing", file, "was exported and is not there")
        elif digests.get(file) != digest(here):
            words = "is not what was exported and verified; export it again, without edits"
            yield (error if here.suffix.lower() in kind.endings else note)("changed", file, words)
    if (fleet := next(iter(files.values())).parent / FLEET).is_file():
        yield from _placed(fleet, recording)
    reasons = manifest.get("undetermined_tension")
    for reason in reasons if isinstance(reasons, list) else ():
        yield warning("tension", "", str(reason))


def _placed(fleet: Path, recording: Recording) -> Iterator[Finding]:
    """Yield the drones that a fleet's file does not place below their first points."""
    starts = next(recording.windows()).coefficients[0, :, :2, 0]
    given: Any = read_yaml(fleet)
    robots: Any = given.get("robots") if isinstance(given, Mapping) else None
    for name, start in zip(recording.names, starts, strict=True):
        robot = robots.get(name) if isinstance(robots, Mapping) else None
        place = robot.get("initial_position") if isinstance(robot, Mapping) else None
        if not (
            isinstance(place, list) and len(place) == 3 and {*map(type, place)} <= {int, float}
        ):
            yield error("start", name, f"is nowhere in {fleet.name}; give its initial_position")
        elif (apart := math.dist(place[:2], start)) > SAME_SPOT:
            words = f"{fleet.name} places it {apart:.3g} m from below its first point, "
            yield error("start", name, f"{words}{start[0]:.4g}, {start[1]:.4g}; correct it")


def _settings(path: Path) -> Iterator[Finding]:
    """Yield faults in the parameters of a folder's Crazyflies."""
    if (path / SETTINGS).is_file() and isinstance(found := read_yaml(path / SETTINGS), Mapping):
        yield from settings_findings(found, read_manifest(path))
