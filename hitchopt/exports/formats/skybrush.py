"""Format skybrush: shows of cubic Bézier curves for Skybrush.

``show.skyc`` is a zip with ``show.json`` and one ``trajectory.json`` per drone: points ``[t, [x, y,
z], control points]`` with t in seconds from takeoff, north-west-up; the control points precede
their point. Skybrush's server stores integer milliseconds and millimetres (multiples of s
millimetres from 32.768 (s - 1) m), and truncates other digits. Therefore points are rounded here,
and the curves that the server stores are read back and certified.

**Coordinated returns** of drones without cables are in ``settings.rthPlan`` of every drone:
``{"version": 1, "landingSpeed", "entries": [{"time", "action", "target", "duration", "preDelay",
"postDelay"}]}``, in integer seconds, at the same times for all drones. A command at t selects the
first entry after t: the show continues until the entry's time, then the drone waits, flies
horizontally to its target on a straight line (``goToKeepAlt``) or not at all (``land``), waits, and
descends. After the last entry drones land at their positions. Velocity jumps at corners;
distances, positions and speeds are certified.

Feed-forward: autopilots of Skybrush track positions with their own controllers, and velocities of
the cubics by default. The format has no accelerations, and thus no cable forces.
"""

from __future__ import annotations

import json
import math
import posixpath
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks.certificate import Check
from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.contents import (
    FileContents,
    Finding,
    Trajectory,
    check_times,
    error,
    largest_jump,
    warning,
)
from hitchopt.exports.firmware import mapping_at
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.exports.refit import PieceKind, Scale, fit_breaks, fit_pieces, round_points
from hitchopt.exports.verification import EXPORT_RULES
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, Phase
from hitchopt.storage.archive import read_members, reading
from hitchopt.storage.files import opened, parsed_json
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import merged_breaks
from hitchopt.values import Array, counted

MILLI = 1e-3  # Unit of lengths [m] and times [s] that Skybrush's server stores
INT16_RANGE = 32768  # Number of negative values of a signed 16-bit integer
MAX_SCALE = 127  # Largest multiple of a millimetre that the server stores, in 7 bits
MAX_DRONES = 20_000  # Maximum number of drones of a show
HOME_TOLERANCE = 0.1  # Largest distance of a show's first point from its home [m]
GROUND_SAMPLES = 9  # Number of times in a piece at which its height is compared with the ground
DEGREE = 3  # Degree of the pieces
SMOOTH = 1  # Acceleration jumps after rounding; the small jumps of velocity are in a note

CUBIC = PieceKind(
    DEGREE, 2, MILLI, max_duration=1.0, min_duration=0.1, scale=Scale(1e-3, 3e-2, 0.5)
)
"""Durations above 1 s may lose a millisecond in the server's arithmetic. A millimetre of a control
point changes the velocity by 30 mm/s for pieces of 0.1 s, by 150 mm/s for 0.02 s."""

EQUAL_ERRORS = Scale(5e-4, 1e-2, 0.2)  # Rounding errors of equal weight

CLOSER_ERRORS = Scale(2e-4, 1e-2, 0.2)
"""Rounding errors with smaller position errors, for cable lengths."""

TRUNCATION_MARGIN = 1e-6  # Offset away from zero, as the server truncates binary fractions [m]
DISTANCE = "minDistance"  # Key of the minimum distance between two drones [m]
LOWEST = "minNavAltitude"  # Key of the minimum altitude [m] at which DISTANCE applies
DEFAULT_LOWEST = 2.5  # Default of LOWEST for outdoor shows, as in Skybrush Viewer [m]

SHOW_LIMITS = {"maxAltitude": (0, "m", ("up",))} | {
    f"max{rate}{key}": (order, unit, parts)
    for rate, order, unit in (("Velocity", 1, "m/s"), ("Acceleration", 2, "m/s²"))
    for key, parts in (("XY", ("across",)), ("Z", ("up", "down")), ("ZUp", ("up",)))
}
"""Limits that shows declare in addition to DISTANCE: derivative, unit, components."""

WORD_START = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Starts of words in these keys. Older shows join words by underscores: ``max_velocity_z_up``."""

LAND = "land"  # Action: descend directly
LEVEL = "goToKeepAlt"  # Action: descend after a horizontal flight
SPEED_SHARE = 0.9  # Fraction of the speed limit for returns, whose durations are integer seconds
RETURN = "a return"  # What needs the ground, in messages without one
LANDING_SPEED = 0.5  # Default speed of a descent [m/s]
MIN_SEPARATION = 1.01  # Minimum separation of planned returns, with a margin for rounding
MAX_RETURNS = 60  # Maximum number of returns of a plan
Entries = Sequence[Mapping[str, Any]]  # One entry per drone, all at one time


class SkybrushShow(Format):
    """A Skybrush show of cubic curves, .skyc."""

    name = "skybrush"
    file = "show.skyc"
    endings = (".skyc",)
    has_heading = False
    velocity_settings = "SHOW_CTRL_MODE 1 and SHOW_VEL_FF_GAIN 1, the defaults of ArduPilot's shows"
    frames = ("nwu",)
    accuracy = 2e-3
    reach = MAX_SCALE * (INT16_RANGE - 1) * MILLI
    feed_forward = (
        "not in this file: autopilots track positions with their own controllers, and the format "
        "has no accelerations"
    )
    bounds = (1.0, 0.6, 1.4, 0.4, 0.2)  # long segments fit less well, but round better

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the show, refitted within the task's bound and rounded."""
        flight = task.flight
        plans = list[Any]([None] * len(task.names))
        notes = []
        if _has_returns(flight):
            returns = plan_returns(flight, task.frame)
            head = {"version": 1, "landingSpeed": _landing_speed(flight)}
            plans = [{**head, "entries": [e[i] for e in returns]} for i in range(len(plans))]
            notes = [
                f"rthPlan: {len(returns)} coordinated returns that begin where drones can stop"
            ]
        breaks = fit_breaks(flight.drones, CUBIC, task.bound)
        fit = task.frame.placed(fit_pieces(task.curves, breaks, CUBIC))
        quantum = MILLI * storage_scale(fit, 2.0 * MILLI)
        # Independent rounding is better for drones at rest.
        independent = np.rint(fit.coefficients / quantum) * quantum
        joint = round_points(fit, quantum, EQUAL_ERRORS if task.bound >= 1.0 else CLOSER_ERRORS)
        candidates = joint, PiecewisePolynomial(fit.breaks, independent)
        curves = min(candidates, key=lambda curves: largest_jump(curves, 1))
        write_show(folder / self.file, task, curves, plans)
        jump = 1e3 * largest_jump(curves, 1)[0]
        summary = (
            f"{len(breaks)} points per drone; LEDs, takeoff and landing are left to Skybrush",
            f"points are multiples of {1e3 * quantum:g} mm, as Skybrush's server stores "
            f"them; velocity jumps by up to {jump:.3g} mm/s where segments join",
        )
        return FormatOutput((self.file,), (*summary, *notes))

    def load(self, files: Sequence[Path]) -> FileContents:
        """Read a ``.skyc`` show."""
        show = read_show(files[0])
        limits, findings = _limits(show)
        for name, curve in show.curves.items():
            if (shortest := float(np.min(curve.durations))) < 0.5 * MILLI:
                reason = f"a piece lasts {shortest:.2g} s, which rounds to zero; omit it"
                findings.append(error("duration", name, reason))
        findings += _ground_findings(show)
        drones = [Trajectory(name, curve) for name, curve in show.curves.items()]
        return FileContents.of_curves(drones, "nwu", SMOOTH, findings, limits)

    def read(self, folder: Path, task: ExportTask) -> FileContents:
        """Return the curves of the show as Skybrush's server stores them; certify its returns."""
        show = read_show(folder / self.file)
        drones = [Trajectory(name, stored_curve(curve)) for name, curve in show.curves.items()]
        if _has_returns(task.flight):
            curves = {drone.name: drone.curve for drone in drones}
            certify_returns(folder / self.file, show, curves, task)
        return FileContents.of_curves(drones, "nwu", SMOOTH)


def _ground_findings(show: Show) -> Iterator[Finding]:
    """Yield findings on drones that do not begin at their homes on the ground, or fly below it.

    Skybrush takes drones off from their homes: trajectories include take-off and landing. The
    ground is at height 0, and at homes that are lower. Each finding names the worst drone.
    """
    away, above, below = (dict[str, float]() for _ in range(3))
    for name, curve in show.curves.items():
        first = curve.coefficients[0, :, 0]
        home = show.homes[name]
        place = np.array([*first[:2], 0.0])
        if _is_place(home):
            place[: len(home)] = home
        elif home is not None:
            yield warning("settings", name, "its home is not a point [x, y, z]; correct it")
        ground = min(float(place[2]), 0.0)
        away[name] = math.dist(first[:2], place[:2])
        above[name] = float(first[2]) - ground
        below[name] = ground - _lowest(curve, ground - HOME_TOLERANCE)
    for level, rule, distances, words in (
        (warning, "start", away, "away from its home; place it there, or begin at its home"),
        (warning, "start", above, "above the ground; begin with the take-off from its home"),
        (error, "ground", below, "below the ground; fly higher"),
    ):
        drones = [name for name, distance in distances.items() if distance > HOME_TOLERANCE]
        if drones:
            worst = max(drones, key=lambda name: distances[name])
            verb = "begins" if rule == "start" else "flies"
            others = f" ({len(drones)} drones do so)" if len(drones) > 1 else ""
            yield level(rule, worst, f"{verb} {distances[worst]:.4g} m {words}{others}")


def _lowest(curve: PiecewisePolynomial, bound: float) -> float:
    """Return the lowest sampled height [m] of the pieces that may be below a bound."""
    heights = curve.coefficients[:, 2]
    low = heights[np.min(heights, axis=-1) < bound]
    samples = bernstein.basis(np.linspace(0.0, 1.0, GROUND_SAMPLES), curve.degree)
    return float(np.min(low @ samples.T, initial=math.inf))


def _is_place(home: Any) -> TypeGuard[list[float]]:
    """Return whether the home of a drone in a file is [x, y] or [x, y, z] [m]."""
    return (
        isinstance(home, list)
        and len(home) in (2, 3)
        and all(type(x) in (int, float) and abs(x) <= SkybrushShow.reach for x in home)
    )


def _limits(show: Show) -> tuple[dict[str, float], list[Finding]]:
    """Return the valid limits in a show's ``settings.validation``, and findings on invalid ones."""
    limits = {LOWEST: DEFAULT_LOWEST} if show.outdoors else dict[str, float]()
    findings = list[Finding]()
    for key in (*SHOW_LIMITS, DISTANCE, LOWEST):
        older = WORD_START.sub("_", key).lower()
        written = older if key not in show.validation else key
        value = show.validation.get(written)
        if isinstance(value, float) and (value > 0.0 or key == LOWEST) and abs(value) < math.inf:
            limits[key] = value
        elif value is not None:
            reason = f"validation.{written} is not a positive number and is not checked; correct it"
            findings.append(warning("settings", "", reason))
    return limits, findings


def write_show(
    path: Path, task: ExportTask, curves: PiecewisePolynomial, plans: Sequence[Any]
) -> None:
    """Write a show of cubic curves (D, 3), north-west-up, with points in integer millimetres.

    ``plans`` has the ``rthPlan`` of every drone, or None. The plan's limits are declared.
    """
    speed = max(each.motion.requirements.limits.speed for each in task.flight.teams)
    validation = {"minDistance": 2.0 * task.flight.requirements.separation.radius}
    validation |= {"maxVelocityXY": speed, "maxVelocityZ": speed}
    times = [round(t, 3) for t in curves.breaks.tolist()]
    points = curves.coefficients
    offsets = np.copysign(TRUNCATION_MARGIN, points) * (points != 0.0)
    points = np.round(points + offsets, 6) + 0.0
    drones = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, pieces, plan in zip(task.names, np.moveaxis(points, 1, 0), plans, strict=True):
            first = pieces[0, :, 0].tolist()
            last = pieces[-1, :, 3].tolist()
            rows: list[Any] = [[times[0], first, []]]
            rows += [
                [t, piece[:, 3].tolist(), [piece[:, 1].tolist(), piece[:, 2].tolist()]]
                for t, piece in zip(times[1:], pieces, strict=True)
            ]
            head = {"version": 1, "takeoffTime": 0, "landingTime": times[-1]}
            file = f"drones/{name}/trajectory.json"
            _add(archive, file, json.dumps({**head, "points": rows}, allow_nan=False))
            settings = {"name": name, "home": first, "landAt": last}
            settings |= {} if plan is None else {"rthPlan": plan}
            settings["trajectory"] = {"$ref": f"./{file}#"}
            drones.append({"type": "generic", "settings": settings})
        show = {
            "version": 1,
            "environment": {"type": "indoor"},
            "settings": {"validation": validation},
            "meta": {"title": task.title, **task.frame.to_dict()},
            "swarm": {"drones": drones},
        }
        _add(archive, "show.json", json.dumps(show, allow_nan=False))


def _add(archive: zipfile.ZipFile, name: str, text: str) -> None:
    """Add a file without a time stamp, so that equal plans give equal archives."""
    archive.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)


@dataclass(frozen=True, eq=False)
class Show:
    """Contents of a show by drone; only the curves are validated."""

    curves: dict[str, PiecewisePolynomial]  # positions (3,) [m]
    homes: dict[str, Any]  # where drones stand before the show [m], or None
    validation: Mapping[str, Any]  # declared limits
    outdoors: bool
    returns: dict[str, Any]  # rthPlan, or None


def read_show(path: Path) -> Show:
    """Return the show; files that several drones refer to are read once."""
    with reading(path, "Skybrush show"), opened(path) as file, zipfile.ZipFile(file) as archive:
        (content,) = read_members(path, archive, [archive.getinfo("show.json")])
        show = parsed_json(content)
        drones = show["swarm"]["drones"]
        if not isinstance(drones, list) or not 0 < len(drones) <= MAX_DRONES:
            raise FileError(f"{path}: show.json names no drones, or more than {MAX_DRONES}")
        settings: dict[str, Any] = {}
        for number, drone in enumerate(drones, 1):
            name = str(drone["settings"].get("name", number))
            if name in settings:
                raise FileError(f"{path}: two drones are called {name!r}")
            settings[name] = drone["settings"]
        routes = {name: each["trajectory"] for name, each in settings.items()}
        files = {
            name: posixpath.normpath(route["$ref"].partition("#")[0])
            for name, route in routes.items()
            if "$ref" in route
        }
        members = {file: archive.getinfo(file) for file in files.values()}
        each = zip(members, read_members(path, archive, list(members.values())), strict=True)
        shared = {file: _curve(f"{path}: {file}", parsed_json(data)) for file, data in each}
        curves = {
            name: shared[files[name]] if name in files else _curve(f"{path}: {name}", route)
            for name, route in routes.items()
        }
    validation = mapping_at(mapping_at(show, "settings"), "validation")
    outdoors = mapping_at(show, "environment").get("type") == "outdoor"
    homes, returns = (
        {name: each.get(key) for name, each in settings.items()} for key in ("home", "rthPlan")
    )
    return Show(curves, homes, validation, outdoors, returns)


def _curve(source: str, trajectory: Any) -> PiecewisePolynomial:
    """Return the cubics (3,) [m] of a trajectory, constant until takeoff."""
    points = trajectory["points"]
    count = len(points) if isinstance(points, list) else 0
    if count < 2:
        raise FileError(
            f"{source}: its trajectory has {counted(count, 'point')}; at least two are needed"
        )
    start = float(trajectory.get("takeoffTime", 0.0))
    times = start + np.array([point[0] for point in points], dtype=np.float64)
    check_times(times, source)
    pieces = []
    for before, point in pairwise(points):
        controls = np.array([before[1], *(point[2:] and point[2]), point[1]], dtype=np.float64)
        if controls.ndim != 2 or controls.shape[1] != 3:
            raise FileError(f"{source}: its points are not [t, [x, y, z], [[x, y, z], …]]")
        if len(controls) > DEGREE + 1:
            inner = len(controls) - 2
            raise FileError(f"{source}: {inner} control points; at most cubic is supported")
        pieces.append(bernstein.elevate(controls.T, DEGREE))
    if times[0] > 0.0:
        times = np.concatenate([[0.0], times])
        pieces.insert(0, np.repeat(pieces[0][:, :1], DEGREE + 1, axis=1))
    return PiecewisePolynomial(times, np.array(pieces))


def storage_scale(curves: PiecewisePolynomial, margin: float = 0.0) -> int:
    """Return the smallest multiple of millimetres in which all drones (…, 3) can be stored.

    ``margin`` [m] is the maximum change of points by rounding.
    """
    extent = np.max(np.abs(curves.coefficients), axis=(0, -2, -1)) + margin
    scales = (np.ceil(extent / MILLI).astype(np.int64) + INT16_RANGE) // INT16_RANGE
    return int(np.lcm.reduce(np.atleast_1d(scales)))


def stored_curve(curve: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the curve (3,) of one drone as the server stores it, with truncated digits."""
    scale = storage_scale(curve)
    points = np.trunc(curve.coefficients * (1000.0 / scale)) * (scale * MILLI)
    durations = np.floor(np.round(curve.durations, 3) * 1000.0) * MILLI
    start = float(np.round(curve.breaks[0], 3))
    return PiecewisePolynomial(start + np.concatenate([[0.0], np.cumsum(durations)]), points)


def _has_returns(flight: Flight) -> bool:
    """Return whether drones have coordinated returns: without cables and other plans."""
    return not (flight.has_cables or flight.others)


def _return_speed(flight: Flight) -> float:
    """Return the speed of returns within the limits of all groups [m/s]."""
    return SPEED_SHARE * min(each.motion.requirements.limits.speed for each in flight.teams)


def _landing_speed(flight: Flight) -> float:
    return min(LANDING_SPEED, _return_speed(flight))  # [m/s]


@lru_cache(maxsize=1)
def plan_returns(flight: Flight, frame: ReferenceFrame) -> list[Entries]:
    """Return the entries of all feasible returns, at integer seconds, the last after the end."""
    returns = []
    interval = max(1, ceil(flight.duration / MAX_RETURNS))
    for time in range(0, ceil(flight.duration) + interval, interval):
        start = flight.drones.at(min(float(time), flight.duration))
        for entries in _return_candidates(flight, time, start, frame):
            checks = return_checks(flight, entries, start, _landing_speed(flight), frame)
            separations = (check.worst for check in checks if check.name == "separation")
            has_margin = all(bound >= MIN_SEPARATION for bound in separations)
            if has_margin and all(check.holds for check in checks):
                returns.append(entries)
                break
    return returns


def _return_candidates(
    flight: Flight, time: int, start: Array, frame: ReferenceFrame
) -> Iterator[Entries]:
    """Yield returns: down, or to positions of the plan, jointly or in order of height."""
    from scipy.optimize import linear_sum_assignment  # heavy

    def entries(goal: Array, duration: int, before: ArrayLike, after: ArrayLike) -> Entries:
        points = np.round(frame.points(np.column_stack([goal, start[:, 2]])), 3) + 0.0
        delays = np.column_stack([before, after]).astype(int).tolist()
        head = {"time": time, "action": LEVEL if duration else LAND, "duration": duration}
        return [
            {**head, "target": point, "preDelay": first, "postDelay": second}
            for point, (first, second) in zip(points.tolist(), delays, strict=True)
        ]

    level = start[:, :2]
    zero = np.zeros(len(start))
    yield entries(level, 0, zero, zero)
    height = float(np.max(start[:, 2])) - flight.requirements.ground_for(RETURN)
    descent = ceil(height / _landing_speed(flight)) + 1
    # Drones of equal height descend together, the lowest first.
    rank = np.unique(np.round(start[:, 2], 2), return_inverse=True)[1].reshape(-1)
    for targets in (flight.drones.at(flight.duration)[:, :2], flight.drones.at(0.0)[:, :2], level):
        # Synchronous motions along lines with the least sum of squares do not collide.
        squares = np.sum((level[:, None] - targets) ** 2, axis=-1)
        goal = targets[linear_sum_assignment(squares)[1]]
        distance = float(np.max(np.linalg.norm(goal - level, axis=-1)))
        duration = max(1, ceil(distance / _return_speed(flight)))
        yield entries(goal, duration, zero, zero)
        yield entries(goal, duration, zero, descent * rank)
        yield entries(goal, duration, (descent + duration) * rank, zero)


def return_checks(
    flight: Flight, entries: Entries, start: Array, landing_speed: float, frame: ReferenceFrame
) -> list[Check]:
    """Return the checks of a return from ``start`` (D, 3) [m] with a landing speed [m/s].

    ``entries`` are those of all drones at one time. Raises ValueError if they are inconsistent.
    """
    ((time, action, duration),) = {(e["time"], e["action"], e["duration"]) for e in entries}
    if action not in (LAND, LEVEL) or float(time) % 1.0:
        raise ValueError("an unknown action, or a time that is not a whole second")
    floor = flight.requirements.ground_for(RETURN)
    level = start[:, :2]
    starts, after = (
        np.array([entry[key] for entry in entries], dtype=np.float64)
        for key in ("preDelay", "postDelay")
    )
    ends = starts
    if action == LEVEL:
        targets = np.array([entry["target"] for entry in entries], dtype=np.float64)
        ends = starts + float(duration)
        level = frame.planned(targets)[:, :2]
    descents = ends + after
    landings = descents + np.maximum(start[:, 2] - floor, 0.0) / landing_speed
    times = np.round(np.concatenate([starts, ends, descents, landings]), 9)
    last = float(np.max(landings)) + 1e-2
    breaks = merged_breaks([np.unique(np.append(times[times < last], [0.0, 1e-2, last]))])

    def share(first: Array, last: Array) -> Array:
        shares: Array = (breaks[:, None] - first) / np.maximum(last - first, 1e-12)
        return np.clip(shares, 0.0, 1.0)[..., None]

    positions = start + share(starts, ends) * (np.column_stack([level, start[:, 2]]) - start)
    positions[..., 2:] += share(descents, landings) * (floor - start[:, 2:])
    curves = PiecewisePolynomial(breaks, np.stack([positions[:-1], positions[1:]], axis=-1))
    phase = Phase("return", 0, 0.0, curves.duration)
    whole = Motion.single(flight.team, flight.requirements.untimed, curves, [phase])
    rules = (rule for rule in EXPORT_RULES if rule.derivative <= 1)  # velocity jumps at corners
    return list(filter(None, (rule.check(whole, exported=True) for rule in rules)))


def certify_returns(
    path: Path, show: Show, curves: Mapping[str, PiecewisePolynomial], task: ExportTask
) -> None:
    """Certify the returns of a show, each from the stored curves at its time."""
    last = -math.inf
    violations = list[Violation]()
    with reading(path, "show with an rthPlan for every drone"):
        plans, each = zip(*((show.returns[n], curves[n]) for n in task.names), strict=True)
        (landing_speed,) = {float(plan["landingSpeed"]) for plan in plans}
        for entries in zip(*(plan["entries"] for plan in plans), strict=True):
            if (time := float(entries[0]["time"])) <= last:
                raise ValueError("its times do not increase")
            last = time
            start = np.array([curve.at(min(time, curve.breaks[-1])) for curve in each])
            positions = task.frame.planned(start)
            checks = return_checks(task.flight, entries, positions, landing_speed, task.frame)
            context = f"in the return from t = {time:g} s", "plan with a wider margin"
            violations += [check.violation(*context) for check in checks if not check.holds]
    if violations:
        raise InfeasibleError(violations, "a coordinated return of the show breaks a limit")
