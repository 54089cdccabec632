"""Pre-flight lint: read fleet files from any source and report errors.

The formats read files and report errors of single files. The rules for the joint flight of all
drones are here: limits, jumps, motion at the end, ranges and rates.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Check, worst_of
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF
from hitchopt.directory import changed_tables
from hitchopt.errors import FileError, InputError
from hitchopt.exports.contents import (
    ERROR,
    LEVELS,
    MANIFEST,
    NOTE,
    PLAN_COPY,
    DroneFacts,
    FileContents,
    Finding,
    error,
    is_sealed,
    largest_jump,
    listed_names,
    note,
    read_manifest,
    warning,
)
from hitchopt.exports.firmware import SETTINGS, mapping_at, settings_findings
from hitchopt.exports.format import Format, format_of, own_endings, usable_formats
from hitchopt.exports.formats.skybrush import DISTANCE, LOWEST, SHOW_LIMITS
from hitchopt.hitch import Swarm
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import Motion
from hitchopt.storage.archive import PLAN, reading
from hitchopt.storage.files import digest, has_other_line_ends, require_file
from hitchopt.storage.tables import headings, text_lines
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array, known, sequence
from hitchopt.values import path as checked_path
from hitchopt.values.fields import Key, Record, suggest_keywords
from hitchopt.values.units import ACCELERATION, SPEED

BAG_METADATA = "metadata.yaml"  # File name of a bag's metadata
MAX_COORDINATE = 1e6  # Maximum coordinate of a drone [m]
CROSSING_STEP = 1e-2  # Accuracy of times at which drones cross an altitude [s]
DURATION_TOLERANCE = 1e-3  # Maximum difference of durations due to rounding [s]
RELATIVE_START = 1e-3  # Maximum distance of starts in relative trajectories [m]
JOINT_TOLERANCE = 1e-2  # Maximum gap between parts of one drone's flight [m]
START_TOLERANCE = 0.1  # Maximum horizontal distance of a drone from its first point [m]
MIN_PIECE = 1e-9  # Minimum duration of a piece [s]: rates of shorter ones overflow
TRAILING = "drones trail positions by v kd/kp"  # Lag without velocities, by gains of their loops
DEFAULT_LIMITS = (("speed", "Velocity", 3.0), ("acceleration", "Acceleration", 10.0))
"""Name of a limit, part of its keys in shows, and default [m/s], [m/s²]."""

SPEED_OF_SOUND = 340.0  # [m/s]
WATCHDOG_TIME = 0.5  # Time without setpoints after which a Crazyflie levels itself [s]

CHANGED = "is not what was exported and verified; export it again, without edits"

REMEDIES = dict.fromkeys(("separation", DISTANCE), "move them apart") | {"maxAltitude": "fly lower"}
"""Remedies by check; all other checks bound rates, for which a slower flight is the remedy."""

NORMS: dict[str, Callable[[Enclosed], Bound]] = {
    "all": lambda rate: rate.norm_upper,
    "across": lambda rate: rate.xy.norm_upper,
    "up": lambda rate: rate[2].upper,
    "down": lambda rate: (rate[2] * -1.0).upper,
}
"""Norms of the components of a vector to which limits apply."""

RATES = {"speed": (1, "m/s", ("all",)), "acceleration": (2, "m/s²", ("all",))} | SHOW_LIMITS
"""Order of the derivative, unit and components, by limit."""


@dataclass(frozen=True)
class FleetFigures:
    """Figures of the joint flight of all drones over all time."""

    duration: float  # [s]
    speed: float  # maximum of all drones [m/s]
    acceleration: float  # maximum [m/s²]; nan if the files have none
    separation: float  # smallest ratio over pairs; inf for one drone, nan for relative positions
    jumps: tuple[float, ...]  # largest jumps of position, velocity, acceleration between pieces
    reach: float  # largest coordinate, including control points [m]
    speed_limit: float  # [m/s]; inf if only limits declared by the show apply
    acceleration_limit: float  # [m/s²]; inf if only limits declared by the show apply
    own: tuple[Check, ...] = ()  # checks of limits declared by the show


@dataclass(frozen=True)
class Report:
    """Findings and figures of a path."""

    path: Path  # file or folder
    kind: str  # name of the format
    frame: str  # enu, nwu or ned; empty if unknown
    facts: tuple[DroneFacts, ...]  # one per drone
    flight: FleetFigures
    findings: tuple[Finding, ...]  # errors first

    @property
    def sound(self) -> bool:
        """Return whether there are no errors; warnings are for the pilot to assess."""
        return all(finding.level != ERROR for finding in self.findings)


@dataclass(frozen=True)
class Rules(Record):
    """Limits of the flight.

    Larger jumps of position [m] between pieces make a flight fail; those of velocity [m/s] and
    acceleration [m/s²] excite oscillations.
    """

    speed: Annotated[
        float | None,
        Key(SPEED, "Largest speed; null: the show's, or a warning above 3"),
    ] = None
    acceleration: Annotated[
        float | None,
        Key(ACCELERATION, "Largest acceleration; null: the show's, or a warning above 10"),
    ] = None
    separation: Separation = field(default_factory=Separation)
    jumps: tuple[float, float, float] = (2e-3, 0.1, 2.0)

    def limits(self, own: Mapping[str, float]) -> dict[str, float]:
        """Return all limits by name, with a show's own; inf for rates that only these limit."""
        limits = dict(own)
        for name, key, default in DEFAULT_LIMITS:
            is_declared = {f"max{key}XY", f"max{key}Z"} <= set(own)
            limit = getattr(self, name)
            limits[name] = limit if limit is not None else math.inf if is_declared else default
        return limits


@suggest_keywords
def lint(path: Path | str | Sequence[Path | str], rules: Rules | None = None) -> tuple[Report, ...]:
    """Return the reports on files or folders, one each, or one per part of an export.

    ``path`` is one path, or several of flights that are independent of each other. ``rules`` are
    the limits of each flight. Raises FileError if a file is damaged or no known format is found,
    and UnsupportedError if a library is not installed.
    """
    paths = [path] if isinstance(path, Path | str) else sequence("path", path)
    if not paths:
        raise InputError("path", paths, "at least one path", "name a file or a folder")
    folders = [checked_path("path", each) for each in paths]
    parts = [part for folder in folders for part in _parts(folder)]
    return tuple(_report(part, Rules() if rules is None else rules) for part in parts)


def _parts(path: Path) -> list[Path]:
    """Return the folders of an export's parts; the path itself without parts."""
    names = listed_names(read_manifest(path), "parts") if path.is_dir() else []
    return [path / name for name in names] or [path]


def _report(path: Path, rules: Rules) -> Report:
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # such numbers are reported
            kind, contents = load(path)
            limits = rules.limits(contents.own)
            joint = JointFlight.of(contents, limits, rules)
            flight = _figures(joint, contents, limits)
            findings = [*_flight_findings(joint, kind, contents, rules)]
            settings = read_yaml(path / SETTINGS) if (path / SETTINGS).is_file() else None
            if isinstance(settings, Mapping):
                findings += settings_findings(settings, read_manifest(path))
    except (FileError, InputError) as exception:
        text = str(exception)
        raise FileError(text if text.startswith(str(path)) else f"{path}: {text}") from exception
    findings = [*contents.findings, *findings, *_manifest_findings(path, kind, contents)]
    if missing := contents.missing_derivative:
        is_linear = missing == "velocities"
        curves = "lines" if is_linear else "cubics through positions and velocities"
        trailing = f"; {TRAILING}, v up to {flight.speed:.2g} m/s" * is_linear
        findings.append(note(missing, "", f"none: joined by {curves}{trailing}"))
    if kind.velocity_settings:
        reason = f"follow from the curves with {kind.velocity_settings}; without them {TRAILING}"
        findings.append(note("velocities", "", f"{reason}, v up to {flight.speed:.2g} m/s"))
    if not contents.frame:
        stated = _manifest_of(path)[0].get("frame")
        exported = f", exported as {stated}" if isinstance(stated, str) else ""
        findings.append(note("frame", "", f"the files do not state their axes{exported}"))
    findings.sort(key=lambda f: LEVELS.index(f.level))
    return Report(path, kind.name, contents.frame, contents.facts, flight, tuple(findings))


def load(path: Path) -> tuple[Format, FileContents]:
    """Return format and contents of a file or folder; raises FileError if no format fits.

    A format of another package that cannot be loaded is named by a FaultWarning.
    """
    if not path.exists():
        raise FileError(f"{path}: there is no such file or folder")
    if path.name == PLAN or (path / PLAN).is_file():
        raise FileError(f"{path}: is a plan; use `hitchopt check` for plans, lint for exports")
    if (path / BAG_METADATA).is_file():
        return format_of("ros2bag"), format_of("ros2bag").load([path / BAG_METADATA])
    formats = usable_formats()
    files = _trajectory_files(path, formats)
    for file in files:
        require_file(file)
    manifest, listed = _manifest_of(path)
    exported_as = str(manifest.get("exported_as")) if listed else ""
    kinds = Counter(_kind(file, formats, exported_as) for file in files)
    first = next(iter(kinds))
    is_one_flight = len(files) == 1 or all(f.suffix.lower() in first.several for f in files)
    if len(kinds) > 1 or not is_one_flight:
        counts = ", ".join(f"{number} of {kind.name}" for kind, number in kinds.items())
        raise FileError(f"{path}: contains files of more than one flight ({counts}); name one")
    return first, first.load(files)


def _trajectory_files(path: Path, formats: Sequence[Format]) -> list[Path]:
    """Return the files with trajectories; raises FileError if there are none.

    Suffixes of other packages' formats count where there is no file with a suffix of hitchopt's:
    its exports have other files too, such as crazyflies.yaml.
    """
    content = sorted(path.iterdir()) if path.is_dir() else [path]
    own = own_endings()
    others = [ending for kind in formats for ending in kind.endings if ending not in own]
    for endings in (own, others):
        files = [each for each in content if each.suffix.lower() in endings]
        if files := [each for each in files if not _is_of_all_formats(each.name)]:
            return files
    suffixes = sorted({file.suffix.lower() or file.name for file in content}) or ["nothing"]
    read = ", ".join(dict.fromkeys((*own, *others)))
    raise FileError(f"{path}: only files of {read} are read; it contains {', '.join(suffixes)}")


def _is_of_all_formats(name: str) -> bool:
    """Return whether a file accompanies exports in all formats: a manifest, note or plan."""
    return name.endswith(MANIFEST) or name in (NOTE, PLAN_COPY)


def _kind(path: Path, formats: Sequence[Format], exported_as: str) -> Format:
    """Return the format of a file.

    It is the one that the manifest names, if its files have that suffix, and otherwise found by the
    suffix and by the first lines of a CSV file.
    """
    suffix = path.suffix.lower()
    candidates = [kind for kind in formats if suffix in kind.endings]
    if named := [kind for kind in candidates if kind.name == exported_as]:
        return named[0]
    if suffix != ".csv":
        return candidates[0]
    with reading(path, "text file"):
        lines = list(headings(lambda: text_lines(path)))
    for line in lines:
        for kind in reversed(candidates):  # polynomials last, since they may have no header
            if re.match(kind.header, line):
                return kind
    first, columns = next(filter(None, lines), "")[:60], "duration, t,drone, idx,t,px"
    reason = (
        f"is not in a known format ({columns}; separated by commas, semicolons, tabs or blanks)"
    )
    raise FileError(f"{path}: its first line, {first!r}, {reason}")


class Reach(NamedTuple):
    """The largest coordinate of any drone, including control points."""

    size: float  # [m]
    drone: str


@dataclass(frozen=True, eq=False)
class JointFlight:
    """What the windows of all D drones' flight have in common."""

    start: float  # [s]
    starts: Array  # (D, 3) [m], first positions
    last: PiecewisePolynomial  # the last piece
    checks: Mapping[str, Check]  # the worst of all windows, by name
    jumps: Sequence[tuple[float, int, float]]  # the largest by order: size, drone and time [s]
    reach: Reach
    longest: float  # longest piece [s]

    @classmethod
    def of(cls, contents: FileContents, limits: Mapping[str, float], rules: Rules) -> JointFlight:
        """Return the flight of files, read window by window; FileError for invalid numbers."""
        names = contents.names
        checks = dict[str, Check]()
        jumps = [(0.0, 0, 0.0)] * (contents.smooth + 1)
        reach = Reach(0.0, "")
        longest = 0.0
        windows = contents.windows()
        first = next(windows)
        starts = first.coefficients[0, ..., 0]
        separation = None if _are_relative(starts) else rules.separation
        last: PiecewisePolynomial | None = None
        for window in chain([first], windows):
            reach = max(reach, _valid_reach(window, names))
            for check in _checks(contents, window, limits, separation):
                checks[check.name] = worst_of([checks.get(check.name), check]) or check
            continued = window if last is None else joined([last, window])
            jumps = [max(jump, largest_jump(continued, i)) for i, jump in enumerate(jumps)]
            longest = max(longest, float(np.max(window.durations)))
            last = window.slice_pieces(slice(window.pieces - 1, window.pieces))
        start = float(first.breaks[0])
        return cls(start, starts, known(last), checks, jumps, reach, longest)


def _are_relative(starts: Array) -> bool:
    """Return whether all drones begin at one point, as relative trajectories do."""
    return len(starts) > 1 and float(np.max(np.ptp(starts, axis=0))) < RELATIVE_START


def _valid_reach(window: PiecewisePolynomial, names: Sequence[str]) -> Reach:
    """Return the reach of a window; FileError for far positions or pieces that are too short."""
    extents = np.max(np.abs(window.coefficients), axis=(0, 2, 3))
    farthest = int(np.argmax(extents))
    reach = Reach(float(extents[farthest]), names[farthest])
    if reach.size > MAX_COORDINATE:
        reason = f"goes {reach.size:.3g} m from the origin; units are metres"
        raise FileError(f"{reach.drone} {reason}")
    shortest = int(np.argmin(window.durations))
    duration = window.durations[shortest]
    if duration < MIN_PIECE:
        time = float(window.breaks[shortest])
        raise FileError(f"a piece lasts {duration:.2g} s at t = {time:g} s; omit it")
    return reach


def _figures(
    joint: JointFlight, contents: FileContents, limits: Mapping[str, float]
) -> FleetFigures:
    """Return the figures of a joint flight; FileError for speeds above that of sound."""
    checks = joint.checks
    fastest = checks.get("speed")
    if fastest is not None and fastest.worst > SPEED_OF_SOUND:
        reason = f"flies at {fastest.worst:.3g} m/s at t = {fastest.time:g} s, faster than sound"
        raise FileError(f"{fastest.where[0]} {reason}; are its times in other units?")
    values = defaultdict(lambda: math.nan, {name: check.worst for name, check in checks.items()})
    return FleetFigures(
        duration=float(joint.last.breaks[-1]) - joint.start,
        speed=values["speed"],
        acceleration=values["acceleration"],
        separation=values["separation"] if len(contents.names) > 1 else math.inf,
        jumps=tuple(size for size, _, _ in joint.jumps),
        reach=joint.reach.size,
        speed_limit=limits["speed"],
        acceleration_limit=limits["acceleration"],
        own=tuple(checks[key] for key in contents.own if key in checks),
    )


def _flight_findings(
    joint: JointFlight, kind: Format, contents: FileContents, rules: Rules
) -> Iterator[Finding]:
    """Yield the findings on a joint flight."""
    names = contents.names
    own = contents.own
    defaults = [name for name, *_ in DEFAULT_LIMITS if getattr(rules, name) is None]
    for check in joint.checks.values():
        if not check.holds:
            yield _violation(check, is_default=check.name in defaults)
    yield from _end_findings(joint.last, names, joint.jumps, rules)
    yield from _time_findings(kind, contents, joint.longest)
    reach = joint.reach
    if reach.size > kind.reach:
        reason = f"is up to {reach.size:.4g} m from the origin; receivers store {kind.reach:.5g} m"
        yield note("range", reach.drone, f"{reason}: move it")
    if joint.start != 0.0:
        yield warning("start", "", f"time begins at {joint.start:g} s, not at 0; shift it")
    if _are_relative(joint.starts):
        reason = "not checked: all begin at one point, as relative trajectories do"
        yield warning("separation", "", f"{reason}; specify their starts")
    elif kind.several:
        yield from _sequence_findings(names, joint.starts, joint.last.coefficients[-1, ..., -1])
    if {DISTANCE, LOWEST} <= set(own):
        yield note(DISTANCE, "", f"applies where both drones are above {own[LOWEST]:g} m")


def _checks(
    contents: FileContents,
    window: PiecewisePolynomial,
    limits: Mapping[str, float],
    separation: Separation | None,
) -> Iterator[Check]:
    """Yield the checks of a window against limits by name, in axes with z up.

    Derivatives of an order above ``contents.smooth`` + 1 are not defined, and not checked.
    """
    names, min_distance = contents.names, limits.get(DISTANCE)
    for key in (key for key in RATES if key in limits):
        order, unit, components = RATES[key]
        if order > contents.smooth + 1:
            continue
        if f"{key}Up" in limits:
            components = ("down",)
        rates = [largest_rate(window, order, size=NORMS[each]) for each in components]
        worst = max(rates, key=lambda rate: (rate.worst, rate.item, rate.time))
        drone = (names[worst.item],)
        yield Check.of(key, worst.worst, limits[key], "max", unit, worst.time, drone)
    separations = [] if separation is None else [("separation", separation, 1.0, "ratio")]
    if separations and min_distance is not None:
        sphere = Separation(0.5 * min_distance, 0.5 * min_distance)
        separations.append((DISTANCE, sphere, min_distance, "m"))
    for key, ellipsoid, ratio, unit in separations:
        requirements = Requirements(Limits(), ellipsoid)
        whole = [(window, np.arange(len(names)))]
        lowest = limits.get(LOWEST) if key == DISTANCE else None
        for part, drones in whole if lowest is None else _above(window, lowest):
            motion = Motion.single(Swarm(len(drones)), requirements, part, ())
            if (check := RULE_OF["separation"].check(motion)) is not None:
                where = tuple(names[drones[int(drone[1:])]] for drone in check.where)
                yield Check.of(key, check.worst * ratio, ratio, "min", unit, check.time, where)


def _above(
    window: PiecewisePolynomial, altitude: float
) -> Iterator[tuple[PiecewisePolynomial, NDArray[np.intp]]]:
    """Yield spans of a window with two or more drones above an altitude [m], and these drones.

    Their height is evaluated at the middle of a span; crossings are located to CROSSING_STEP.
    """
    heights, breaks = window.coefficients[..., 2, :], window.breaks
    mixed = (np.min(heights, axis=-1) <= altitude) & (np.max(heights, axis=-1) > altitude)
    times = [breaks]
    for k in np.flatnonzero(np.any(mixed, axis=1)):
        grid = np.arange(breaks[k], breaks[k + 1], CROSSING_STEP)
        high = window.at(grid)[..., 2] > altitude
        times.append(grid[1:][np.any(high[1:] != high[:-1], axis=1)])
    fine = on_breaks(window, merged_breaks(times))
    high = fine.at(0.5 * (fine.breaks[1:] + fine.breaks[:-1]))[..., 2] > altitude
    ends = np.flatnonzero(np.any(high[1:] != high[:-1], axis=1)) + 1
    for first, last in pairwise([0, *ends.tolist(), fine.pieces]):
        if len(drones := np.flatnonzero(high[first])) > 1:
            span = fine.slice_pieces(slice(first, last))
            yield span.replaced(span.coefficients[:, drones]), drones


def _violation(check: Check, *, is_default: bool) -> Finding:
    """Return the error that a limit is violated, or a warning for a default limit."""
    unit = "" if check.unit == "ratio" else f" {check.unit}"
    relation = "below" if check.sense == "min" else "above"
    reason = f"{check.worst:.4g}{unit} at t = {check.time:.4g} s is {relation} "
    reason += f"{check.limit:.4g}{unit}{', a default limit' if is_default else ''}; "
    reason += REMEDIES.get(check.name, "fly it more slowly")
    reason += f", or set --{check.name}" if is_default else ""
    return (warning if is_default else error)(check.name, ", ".join(check.where), reason)


def _end_findings(
    last: PiecewisePolynomial,
    names: Sequence[str],
    jumps: Sequence[tuple[float, int, float]],
    rules: Rules,
) -> Iterator[Finding]:
    """Yield findings on jumps between pieces, and on drones that move at the end."""
    rates = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s²"))
    for (what, unit), (size, drone, t), bound in zip(rates, jumps, rules.jumps, strict=False):
        if size > bound:
            reason = f"{what} jumps by {size:.3g} {unit} where pieces join at t = {t:.4g} s"
            level = error if what == "position" else warning
            yield level("jump", names[drone], f"{reason}; correct it")
    speeds, bound = np.linalg.norm(last.ends(1)[1][-1], axis=-1), rules.jumps[1]
    if speeds[fastest := int(np.argmax(speeds))] > bound:
        reason = f"still moves at {speeds[fastest]:.3g} m/s at t = {last.breaks[-1]:.4g} s"
        yield warning("end", names[fastest], f"{reason}; end at rest")


def _time_findings(kind: Format, contents: FileContents, longest: float) -> Iterator[Finding]:
    """Yield findings on long times between samples [s], and on drones that end early."""
    if longest * kind.streamed > 1.01:
        reason = f"{longest:.3g} s between two setpoints; send them at {kind.streamed:g} Hz or more"
        yield (error if longest > WATCHDOG_TIME else warning)("rate", "", reason)
    facts = sorted(contents.facts, key=lambda fact: fact.duration)
    if facts[0].duration < facts[-1].duration - DURATION_TOLERANCE:
        reason = f"lasts {facts[0].duration:.6g} s, another {facts[-1].duration:.6g} s"
        yield warning("duration", facts[0].name, f"{reason}; end all at the same time")


def _sequence_findings(names: Sequence[str], starts: Array, ends: Array) -> Iterator[Finding]:
    """Yield a note if files, in the order of numbers in their names, are successive parts.

    ``starts`` and ``ends`` (D, 3) [m] are those of the files.
    """
    keys = [[int(x) if x.isdigit() else x for x in re.split(r"(\d+)", n)] for n in names]
    order = sorted(range(len(names)), key=lambda i: keys[i])
    gaps = np.linalg.norm(starts[order[1:]] - ends[order[:-1]], axis=-1)
    if len(names) > 1 and np.max(gaps) < JOINT_TOLERANCE:
        files = f"{', '.join(names[i] for i in order[:3])}{', …' if len(names) > 3 else ''}"
        reason = (
            f"{files} each begin where the previous one ends: if they are successive parts of one "
            "drone, lint them one by one"
        )
        yield note("sequence", "", reason)


def _manifest_findings(path: Path, kind: Format, contents: FileContents) -> Iterator[Finding]:
    """Yield differences from an export's manifest, and what it warns of.

    That are reasons why the tension is undetermined, and understated tracking errors.
    """
    manifest, files = _manifest_of(path)
    if path.is_file() and path.name in changed_tables(path.parent):
        yield error("changed", path.name, "differs from the table written with the plan")
    if not files:
        return
    yield from _plan_findings(path, manifest)
    digests = mapping_at(manifest, "digests")
    for name, file in files.items():
        if not file.exists():
            yield error("missing", name, "was exported but is missing")
        elif digests.get(name) != digest(file):
            level = error if file.suffix.lower() in kind.endings else note
            yield level("changed", name, CHANGED)
    if other := [
        name for name, file in files.items() if file.exists() and has_other_line_ends(file)
    ]:
        more = f" and {len(other) - 1} more" * (len(other) > 1)
        yield note("line ends", f"{other[0]}{more}", "line ends of Windows; otherwise as exported")
    if (fleet := next(iter(files.values())).parent / SETTINGS).is_file():
        settings: Any = read_yaml(fleet)
        robots = mapping_at(settings if isinstance(settings, Mapping) else {}, "robots")
        offsets = mapping_at(manifest, "start_offsets")
        yield from _start_findings(fleet.name, robots, contents, offsets)
        yield from _identity_findings(fleet.name, robots, manifest)
    understated = mapping_at(manifest, "tracking").get("understated")
    reasons = {"tension": manifest.get("undetermined_tension"), "tracking": understated}
    for rule, texts in reasons.items():
        for text in texts if isinstance(texts, list) else ():
            yield warning(rule, "", str(text))


def _manifest_of(path: Path) -> tuple[dict[str, Any], dict[str, Path]]:
    """Return the manifest of a folder or file, and the paths of its files by listed name.

    A file has a manifest of its own, or that of its folder if that lists it.
    """
    if path.is_dir():
        manifest = read_manifest(path)
        return manifest, {name: path / name for name in listed_names(manifest, "files")}
    own, folder = (read_manifest(path.parent, f"{n}{MANIFEST}") for n in (f"{path.name}.", ""))
    names = listed_names(own or folder, "files")
    return own or folder, {name: path for name in names if own or name == path.name}


def _plan_findings(path: Path, manifest: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield errors for a manifest and a copy of the plan that are not those of the export.

    The copy is in the folder of the export, also that of its parts; single files have none.
    """
    folder = path if path.is_dir() else path.parent
    home = folder
    if folder.name in listed_names(read_manifest(folder.parent), "parts"):
        home = folder.parent
        manifests = {f"{home.name}/{MANIFEST}": read_manifest(home), MANIFEST: manifest}
    else:
        manifests = {MANIFEST: manifest}
    for name, content in manifests.items():
        if not is_sealed(content):
            yield error("changed", name, CHANGED)
    if path.is_file() and (folder / f"{path.name}.{MANIFEST}").is_file():
        return
    if not (copy := home / PLAN_COPY).is_file():
        yield error("missing", PLAN_COPY, "was exported but is missing; export the plan again")
    elif manifest.get("plan_digest") != digest(copy):
        yield error("changed", PLAN_COPY, f"is not the plan of {MANIFEST}; export the plan again")


def _identity_findings(
    fleet: str, robots: Mapping[str, Any], manifest: Mapping[str, Any]
) -> Iterator[Finding]:
    """Yield errors for robots that would fly trajectories, or have parameters, of other drones.

    Their addresses may be edited, but two robots may neither share nor exchange them.
    """
    remedy = "state names and addresses in a fleet file, and export again"
    exported = {uri: name for name, uri in mapping_at(manifest, "addresses").items()}
    owners = dict[Any, str]()
    for role, name in mapping_at(manifest, "drones").items():
        robot = mapping_at(robots, name)
        if (own := robot.get("role", role)) != role:
            reason = f"{fleet} names it {own}, but its trajectory is that of {role}"
            yield error("identity", name, f"{reason}; {remedy}")
        uri = robot.get("uri")
        other = owners.setdefault(uri, name)
        other = exported.get(uri, name) if other == name else other
        if uri is not None and other != name:
            reason = f"{fleet} gives it the radio address of {other}"
            yield error("identity", name, f"{reason}; {remedy}")


def _start_findings(
    fleet: str, robots: Mapping[str, Any], contents: FileContents, offsets: Mapping[str, Any]
) -> Iterator[Finding]:
    """Yield errors for drones whose initial positions are not below their first positions.

    ``offsets`` are the manifest's, of the first points of the files from these positions [m].
    """
    starts = next(contents.windows()).coefficients[0, :, :2, 0]
    for name, first in zip(contents.names, starts.tolist(), strict=True):
        offset = each if _is_point(each := offsets.get(name)) else [0.0, 0.0, 0.0]
        start = [first[0] - offset[0], first[1] - offset[1]]
        point = mapping_at(robots, name).get("initial_position")
        if not _is_point(point):
            yield error("start", name, f"is not in {fleet}; add its initial_position")
        elif (distance := math.dist(point[:2], start)) > START_TOLERANCE:
            reason = f"{fleet} places it {distance:.3g} m off the point below its first position, "
            yield error("start", name, f"{reason}{start[0]:.4g}, {start[1]:.4g}; correct it")


def _is_point(value: object) -> TypeGuard[list[float]]:
    """Return whether a value of a file is a point (3,)."""
    return isinstance(value, list) and len(value) == 3 and {*map(type, value)} <= {int, float}
