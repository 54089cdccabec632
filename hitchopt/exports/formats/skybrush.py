"""Formats skybrush and skybrush_csv: cubic Bézier curves, and positions by the clock, for Skybrush.

``show.skyc`` is a zip with ``show.json`` and one ``trajectory.json`` per drone: points ``[t, [x, y,
z], control points]``, t in seconds from takeoff, north-west-up, the control points leading into
their point. Skybrush's server stores whole milliseconds and whole millimetres (multiples of s
millimetres from 32.768 (s - 1) m on), and cuts off what is beyond them. So points are rounded here,
and what is read back and certified are the curves that the server stores.

**Coordinated returns** of drones without cables are every drone's ``settings.rthPlan``:
``{"version": 1, "landingSpeed", "entries": [{"time", "action", "target", "duration", "preDelay",
"postDelay"}]}``, in whole seconds, at the same times for all drones. A command at t takes the first
entry from t on: the show goes on until its time, then the drone waits, flies level to its target on
a line (``goToKeepAlt``) or nowhere (``land``), waits and goes down. After the last entry drones
land where they are. Velocity jumps where lines meet: certified are distances, places and speeds.

``show.zip`` has one CSV per drone for Skybrush's importers, ``Time [msec],x [m],y [m],z [m],Red,
Green,Blue``: positions at whole milliseconds, straight lines between them.

Feed-forward: the autopilots behind Skybrush track positions (and velocities) with controllers of
their own; the formats have no place for accelerations, so the cable's pull is not in them.
"""

from __future__ import annotations

import json
import math
import posixpath
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks.certificate import Check
from hitchopt.errors import FileError, InfeasibleError, InputError, Violation
from hitchopt.exports.exporting import FLOWN
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.exports.recording import (
    Finding,
    Recording,
    Trajectory,
    check_times,
    error,
    largest_jump,
    unusual,
    warning,
)
from hitchopt.exports.refit import Kind, Scale, breaks_within, fitted, rounded
from hitchopt.motion.motion import Motion, Phase
from hitchopt.storage.archive import read_members, reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import decoded_lines, labelled_table, text_lines
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import merged_breaks
from hitchopt.values import Array

MILLI = 1e-3  # Unit of what Skybrush's server stores, [m] and [s]
REACH = 32768  # Numbers on either side of zero that 16 bits with a sign hold
MAX_DRONES = 20_000  # Size limit of a show that is read
DEGREE = 3  # Degree of the pieces
SMOOTH = 1  # Acceleration jumps after rounding; so does velocity, by as much as the note says

CUBIC = Kind(DEGREE, 2, MILLI, longest=1.0, shortest=0.1, scale=Scale(1e-3, 3e-2, 0.5))
"""Some durations above 1 s lose a millisecond in the server's arithmetic; a millimetre of a
control point is 30 mm/s of velocity at 0.1 s, and 150 mm/s at 0.02 s."""

EQUAL_ERRORS, CLOSER_ERRORS = Scale(5e-4, 1e-2, 0.2), Scale(2e-4, 1e-2, 0.2)
"""Errors of rounding that weigh alike: the latter cost less place, as lengths of cables need it."""

NUDGE = 1e-6  # [m] Points lie beyond their millimetres: the server cuts off, binary lies below
DISTANCE = "minDistance"  # Key of the smallest distance between two drones [m]
LOWEST = "minNavAltitude"  # Key of the altitude [m] from which on DISTANCE counts
OUTDOORS = 2.5  # [m] That altitude of shows outdoors that state none, as Skybrush Viewer takes it

OWN_LIMITS = {"maxAltitude": (0, "m", ("up",))} | {
    f"max{rate}{key}": (order, unit, parts)
    for rate, order, unit in (("Velocity", 1, "m/s"), ("Acceleration", 2, "m/s²"))
    for key, parts in (("XY", ("across",)), ("Z", ("up", "down")), ("ZUp", ("up",)))
}
"""Limits that shows set themselves besides DISTANCE: derivative, unit, the parts that count."""

LAND, LEVEL = "land", "goToKeepAlt"  # Actions: down where the drone is, or after a level flight
SHARE = 0.9  # Share of the speed limit that returns use: their durations are whole seconds
LANDING = 0.5  # [m/s] Usual speed of a descent
SPARE = 1.01  # Separation of a return that is planned: rounding to millimetres takes some of it
MAX_RETURNS = 60  # Number of returns of a plan: with fewer, a command waits longer for the next one
Entries = Sequence[Mapping[str, Any]]  # One entry per drone, all of one time


class SkybrushShow(Format):
    """A Skybrush show of cubic curves, .skyc."""

    name = "skybrush"
    file = "show.skyc"
    endings = (".skyc",)
    frames = ("nwu",)
    accuracy = 2e-3
    feed_forward = (
        "not in this file: the autopilots track positions with controllers of their own, and the "
        "format has no accelerations"
    )

    bounds = (1.0, 0.6, 1.4, 0.4, 0.2)  # long segments fit worse and suffer less from rounding

    def write(self, folder: Path, task: Task) -> Written:
        """Write the show, refitted within the task's bound and rounded."""
        motion, plans, notes = task.motion, list[Any]([None] * len(task.names)), []
        if _returning(motion):
            returns = planned_returns(motion, task.frame)
            head = {"version": 1, "landingSpeed": _landing(motion)}
            plans = [{**head, "entries": [e[i] for e in returns]} for i in range(len(plans))]
            notes = [f"rthPlan: {len(returns)} coordinated returns, from where drones stop at once"]
        breaks = breaks_within(motion.drones, CUBIC, task.bound)
        fit = task.frame.placed(fitted(motion.drones, breaks, CUBIC))
        quantum = MILLI * storage_scale(fit, 2.0 * MILLI)
        # Rounded one point at a time less velocity is lost where drones rest.
        each = PiecewisePolynomial(fit.breaks, np.rint(fit.coefficients / quantum) * quantum)
        together = rounded(fit, quantum, EQUAL_ERRORS if task.bound >= 1.0 else CLOSER_ERRORS)
        whole = min(together, each, key=lambda curves: largest_jump(curves, 1))
        write_show(folder / self.file, task, whole, plans)
        jump = 1e3 * largest_jump(whole, 1)[0]
        about = (
            f"{len(breaks)} points per drone; LEDs, takeoff and landing are left to Skybrush",
            f"points are multiples of {1e3 * quantum:g} mm, as Skybrush's server stores "
            f"them; velocity jumps by up to {jump:.3g} mm/s where segments join",
        )
        return Written((self.file,), (*about, *notes))

    def load(self, files: Sequence[Path]) -> Recording:
        """Read the show in a ``.skyc``."""
        show = read_show(files[0])
        own, findings = _limits(show)
        for name, curve in show.curves.items():
            if (shortest := float(np.min(curve.durations))) < 0.5 * MILLI:
                words = f"a piece lasts {shortest:.2g} s, which is rounded to none; leave it out"
                findings.append(error("duration", name, words))
        drones = [Trajectory(name, curve) for name, curve in show.curves.items()]
        return Recording.of_curves(drones, "nwu", SMOOTH, findings, own)

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves of the show as Skybrush's server stores them; certify its returns."""
        show = read_show(folder / self.file)
        drones = [Trajectory(name, stored(curve)) for name, curve in show.curves.items()]
        if _returning(task.motion):
            curves = {drone.name: drone.curve for drone in drones}
            certify_returns(folder / self.file, show, curves, task)
        return Recording.of_curves(drones, "nwu", SMOOTH)


def _limits(show: Show) -> tuple[dict[str, float], list[Finding]]:
    """Return the limits in a show's ``settings.validation``, and the findings on the others."""
    own, findings = {LOWEST: OUTDOORS} if show.outdoors else dict[str, float](), list[Finding]()
    for key in (*OWN_LIMITS, DISTANCE, LOWEST):
        value = show.validation.get(key)
        if isinstance(value, float) and (value > 0.0 or key == LOWEST) and abs(value) < math.inf:
            own[key] = value
        elif value is not None:
            words = f"validation.{key} is no positive number: not checked; correct it"
            findings.append(warning("settings", "", words))
    return own, findings


def write_show(path: Path, task: Task, curves: PiecewisePolynomial, plans: Sequence[Any]) -> None:
    """Write the show of cubic curves (D, 3), north-west-up, of whole millimetres.

    ``plans`` has ``rthPlan`` of every drone, or None; the plan's limits are for Skybrush's checks.
    """
    speed = max(each.motion.requirements.limits.speed for each in task.motion.groups)
    validation = {"minDistance": 2.0 * task.motion.requirements.separation.radius}
    validation |= {"maxVelocityXY": speed, "maxVelocityZ": speed}
    times = [round(t, 3) for t in curves.breaks.tolist()]
    points = curves.coefficients
    points = np.round(points + np.copysign(NUDGE, points) * (points != 0.0), 6) + 0.0
    drones = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, here, plan in zip(task.names, np.moveaxis(points, 1, 0), plans, strict=True):
            first, last = here[0, :, 0].tolist(), here[-1, :, 3].tolist()
            rows: list[Any] = [[times[0], first, []]]
            rows += [
                [t, piece[:, 3].tolist(), [piece[:, 1].tolist(), piece[:, 2].tolist()]]
                for t, piece in zip(times[1:], here, strict=True)
            ]
            head = {"version": 1, "takeoffTime": 0, "landingTime": times[-1]}
            file = f"drones/{name}/trajectory.json"
            archive.writestr(file, json.dumps({**head, "points": rows}, allow_nan=False))
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
        archive.writestr("show.json", json.dumps(show, allow_nan=False))


@dataclass(frozen=True, eq=False)
class Show:
    """Contents of a show that are read, by drone; only the curves are checked."""

    curves: dict[str, PiecewisePolynomial]  # positions (3,) [m] over the show's time
    validation: Mapping[str, Any]  # the limits that the show sets itself
    outdoors: bool  # whether its environment says so
    returns: dict[str, Any]  # rthPlan; None where nothing stands


def read_show(path: Path) -> Show:
    """Return the show; each file in the zip is read once, however many drones refer to it."""
    with reading(path, "Skybrush show"), zipfile.ZipFile(path) as archive:
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
    validation, around = _block(_block(show, "settings"), "validation"), _block(show, "environment")
    returns = {name: each.get("rthPlan") for name, each in settings.items()}
    return Show(curves, validation, around.get("type") == "outdoor", returns)


def _block(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return the mapping under a key; an empty one where there is none."""
    value = content.get(key)
    return value if isinstance(value, dict) else {}


def _curve(source: str, trajectory: Any) -> PiecewisePolynomial:
    """Return the cubics (3,) [m] of a trajectory, at its first place until it takes off."""
    points = trajectory["points"]
    count = len(points) if isinstance(points, list) else 0
    if count < 2:
        raise FileError(f"{source}: its trajectory has {count} points; two are the least")
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
            raise FileError(f"{source}: {inner} control points; cubic is the most there is")
        pieces.append(bernstein.elevate(controls.T, DEGREE))
    if times[0] > 0.0:  # it waits for its turn to take off
        times = np.concatenate([[0.0], times])
        pieces.insert(0, np.repeat(pieces[0][:, :1], DEGREE + 1, axis=1))
    return PiecewisePolynomial(times, np.array(pieces))


def storage_scale(curves: PiecewisePolynomial, beyond: float = 0.0) -> int:
    """Return the least multiple of millimetres that all drones (…, 3) can be stored in.

    Rounding may move points ``beyond`` [m] where they are.
    """
    reach = np.max(np.abs(curves.coefficients), axis=(0, -2, -1)) + beyond
    scales = (np.ceil(reach / MILLI).astype(np.int64) + REACH) // REACH
    return int(np.lcm.reduce(np.atleast_1d(scales)))


def stored(curve: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the curve (3,) of one drone as the server stores it: digits beyond are cut off."""
    scale = storage_scale(curve)
    points = np.trunc(curve.coefficients * (1000.0 / scale)) * (scale * MILLI)
    lasting = np.floor(np.round(curve.durations, 3) * 1000.0) * MILLI
    first = float(np.round(curve.breaks[0], 3))
    return PiecewisePolynomial(first + np.concatenate([[0.0], np.cumsum(lasting)]), points)


def _returning(motion: Motion) -> bool:
    """Whether drones have coordinated returns: without cables, and others that fly besides."""
    return not (motion.has_cables or motion.others)


def _speed(motion: Motion) -> float:
    """Return the speed of returns that all groups keep [m/s]."""
    return SHARE * min(each.motion.requirements.limits.speed for each in motion.groups)


def _landing(motion: Motion) -> float:
    return min(LANDING, _speed(motion))  # [m/s]


@lru_cache(maxsize=1)
def planned_returns(motion: Motion, frame: ReferenceFrame) -> list[Entries]:
    """Return every drone's entry of each return, at whole seconds, the last one after the end.

    Times without such a return are left out: a command then waits for the next one.
    """
    returns, every = [], max(1, ceil(motion.duration / MAX_RETURNS))
    for time in range(0, ceil(motion.duration) + every, every):
        start = motion.drones.at(min(float(time), motion.duration))
        for entries in _tries(motion, time, start, frame):
            checks = return_checks(motion, entries, start, _landing(motion), frame)
            spare = all(check.bound >= SPARE for check in checks if check.name == "separation")
            if spare and all(check.holds for check in checks):
                returns.append(entries)
                break
    return returns


def _tries(motion: Motion, time: int, start: Array, frame: ReferenceFrame) -> Iterator[Entries]:
    """Yield returns: down at once, then to places of the plan, at once or the lower ones first."""
    from scipy.optimize import linear_sum_assignment  # heavy, and for single drones alone

    def entries(goal: Array, duration: int, before: ArrayLike, after: ArrayLike) -> Entries:
        points = np.round(frame.points(np.column_stack([goal, start[:, 2]])), 3) + 0.0
        delays = np.column_stack([before, after]).astype(int).tolist()
        head = {"time": time, "action": LEVEL if duration else LAND, "duration": duration}
        return [
            {**head, "target": point, "preDelay": first, "postDelay": second}
            for point, (first, second) in zip(points.tolist(), delays, strict=True)
        ]

    level, zero = start[:, :2], np.zeros(len(start))
    yield entries(level, 0, zero, zero)
    fall = ceil((float(np.max(start[:, 2])) - motion.requirements.floor) / _landing(motion)) + 1
    # Drones of one height go down together, the lowest first.
    turn = np.unique(np.round(start[:, 2], 2), return_inverse=True)[1].reshape(-1)
    for place in (motion.drones.at(motion.duration)[:, :2], motion.drones.at(0.0)[:, :2], level):
        # The least squares of distances: lines of one clock then do not cross at one time.
        squares = np.sum((level[:, None] - place) ** 2, axis=-1)
        goal = place[linear_sum_assignment(squares)[1]]
        far = float(np.max(np.linalg.norm(goal - level, axis=-1)))
        duration = max(1, ceil(far / _speed(motion)))
        yield entries(goal, duration, zero, zero)
        yield entries(goal, duration, zero, fall * turn)
        yield entries(goal, duration, (fall + duration) * turn, zero)


def return_checks(
    motion: Motion, entries: Entries, start: Array, landing: float, frame: ReferenceFrame
) -> list[Check]:
    """Return the checks of a return from ``start`` (D, 3) [m] that descends at ``landing`` [m/s].

    It is that which every drone's entry of one time describes; ValueError says that they are none.
    """
    ((time, action, lasts),) = {(e["time"], e["action"], e["duration"]) for e in entries}
    if action not in (LAND, LEVEL) or float(time) % 1.0:
        raise ValueError("an action is not known, or its time is no whole second")
    floor, level = motion.requirements.floor, start[:, :2]
    begins, after = (
        np.array([entry[key] for entry in entries], dtype=np.float64)
        for key in ("preDelay", "postDelay")
    )
    ends = begins
    if action == LEVEL:
        targets = np.array([entry["target"] for entry in entries], dtype=np.float64)
        ends, level = begins + float(lasts), frame.planned(targets)[:, :2]
    lowers = ends + after
    lands = lowers + np.maximum(start[:, 2] - floor, 0.0) / landing
    times = np.round(np.concatenate([begins, ends, lowers, lands]), 9)
    last = float(np.max(lands)) + 1e-2
    breaks = merged_breaks([np.unique(np.append(times[times < last], [0.0, 1e-2, last]))])

    def share(first: Array, last: Array) -> Array:
        found: Array = np.clip(
            (breaks[:, None] - first) / np.maximum(last - first, 1e-12), 0.0, 1.0
        )
        return found[..., None]

    places = start + share(begins, ends) * (np.column_stack([level, start[:, 2]]) - start)
    places[..., 2:] += share(lowers, lands) * (floor - start[:, 2:])
    curves = PiecewisePolynomial(breaks, np.stack([places[:-1], places[1:]], axis=-1))
    phase = Phase("return", 0, 0.0, curves.duration)
    whole = Motion.single(motion.team, motion.requirements.untimed, curves, [phase])
    rules = [rule for rule in FLOWN if rule.derivative <= 1]  # velocity jumps where lines meet
    return list(filter(None, (rule.check(whole, exported=True) for rule in rules)))


def certify_returns(
    path: Path, show: Show, curves: Mapping[str, PiecewisePolynomial], task: Task
) -> None:
    """Certify a show's returns, each flown from its time on, from stored curves."""
    last, broken = -math.inf, list[Violation]()
    with reading(path, "show with an rthPlan for every drone"):
        plans, each = zip(*((show.returns[n], curves[n]) for n in task.names), strict=True)
        (landing,) = {float(plan["landingSpeed"]) for plan in plans}
        for entries in zip(*(plan["entries"] for plan in plans), strict=True):
            if (time := float(entries[0]["time"])) <= last:
                raise ValueError("its times do not increase")
            last = time
            start = np.array([curve.at(min(time, curve.breaks[-1])) for curve in each])
            places = task.frame.planned(start)
            checks = return_checks(task.motion, entries, places, landing, task.frame)
            context = f"in the return from t = {time:g} s", "plan with a wider margin"
            broken += [check.violation(*context) for check in checks if not check.holds]
    if broken:
        raise InfeasibleError(broken, "a coordinated return of the show breaks a limit")


HEADER = "Time [msec],x [m],y [m],z [m],Red,Green,Blue"
ROW = "%d,%.6f,%.6f,%.6f,255,255,255"


class SkybrushCsv(Format):
    """A zip of positions by the clock, for Skybrush."""

    name = "skybrush_csv"
    file = "show.zip"
    endings = (".zip", ".csv")
    several = (".csv",)  # outside of a zip
    header = r"time \[msec\]"
    frames = ("nwu",)
    rate = 20.0
    accuracy = 2e-3
    feed_forward = "not in these files: they hold positions alone"

    def write(self, folder: Path, task: Task) -> Written:
        """Write the zip, drone by drone; raise InputError for more than 1000 samples a second."""
        if task.rate > 1000.0:
            raise InputError("rate", task.rate, "at most 1000 Hz", "the format has milliseconds")
        drones = task.motion.drones
        samples = ceil(drones.duration * task.rate - 1e-6)
        milliseconds = np.rint(np.arange(samples + 1) * (1e3 / task.rate))
        places = drones.at(np.minimum(milliseconds * 1e-3, float(drones.breaks[-1])))
        with zipfile.ZipFile(folder / self.file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = f"frame: {task.frame.name}".encode()
            for i, name in enumerate(task.names):
                rows = np.column_stack([milliseconds, task.frame.points(places[:, i]) + 0.0])
                with archive.open(f"{name}.csv", "w") as file:
                    np.savetxt(file, rows, ROW, header=HEADER, comments="")
        return Written((self.file,))

    def load(self, files: Sequence[Path]) -> Recording:
        """Return the lines through the positions in a zip, or in CSV files of one drone each."""
        path = files[0]
        if path.suffix.lower() == ".zip":
            with reading(path, "zip of CSV files"), zipfile.ZipFile(path) as archive:
                members = [m for m in archive.infolist() if m.filename.lower().endswith(".csv")]
                each = zip(members, read_members(path, archive, members), strict=True)
                texts = [(f"{path}/{m.filename}", decoded_lines(data)) for m, data in each]
        else:
            with reading(path, "text"):
                texts = [(str(file), list(text_lines(file))) for file in files]
        drones, wanted = list[Trajectory](), HEADER.split(",")[:4]
        for source, lines in texts:
            table = labelled_table(lines.copy, wanted, source)
            numbers = table.numbers(wanted, least=2)
            t, points, name = numbers[:, 0] * 1e-3, numbers[None, :, 1:], Path(source).stem
            check_times(t, source)
            with reading(path, "table of positions"):
                curve = PiecewisePolynomial.hermite(t, points[:, :-1], points[:, 1:])
            drones.append(Trajectory(name, curve, findings=tuple(unusual(table, name))))
        if not 0 < len(drones) == len({drone.name for drone in drones}):
            raise FileError(f"{path}: holds no CSV file, or two of one name")
        return Recording.of_curves(drones, "nwu", 0)
