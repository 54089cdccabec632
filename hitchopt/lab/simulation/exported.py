"""Flights of exported files: the curves or samples that receivers get, and their parameters.

The parts of an export are flown one after another, with what fly.py does between them: drones hover
where a part ends, go to the first points of the next one, and wait for its upload. Drones whose
hitch is not tied yet take off as in the script; tied ones begin at their first points. The plan
that the files were exported from adds cables, tensions and objects. Its rests are prolonged by the
time that the files and the script take.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.drones.controllers import (
    PX4_RANGES,
    EstimatorParameters,
    FlightController,
    Gains,
)
from hitchopt.drones.firmware import CONTROLLER_NUMBERS
from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.exports.contents import (
    MANIFEST,
    PLAN_COPY,
    is_sealed,
    listed_names,
    read_manifest,
)
from hitchopt.exports.firmware import SETTINGS, mapping_at
from hitchopt.exports.format import Format, format_of
from hitchopt.exports.formats.crazyflie import LANDED, CrazyflieFormat
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.lab.simulation.commands import (
    CURVE_RATES,
    PACKET_RATES,
    body_rates,
    named_controllers,
    packets,
)
from hitchopt.lab.simulation.task import RATE, Commands, Received, Task, TeamTask, read_task
from hitchopt.motion.flight import Flight
from hitchopt.motion.plan_file import read_saved_plan
from hitchopt.motion.retiming import padded, shifted
from hitchopt.motion.states import sample_times
from hitchopt.plan import Plan
from hitchopt.storage.archive import PLAN
from hitchopt.storage.files import digest
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.support import Feature
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.values import Array, Indices, counted
from hitchopt.values import path as checked_path

TAKE_OFF_TIME = 3.0  # Duration of the script's take-off [s]
SETTLE_TIME = 2.0  # The script's wait after a take-off or a goTo [s]
GO_TIME = 4.0  # Duration of a goTo [s]
UPLOAD_TIME = 1.0  # The script's wait after an upload [s]
END_TIME = 1.0  # The script's wait after a trajectory [s]
BETWEEN = END_TIME + GO_TIME + SETTLE_TIME + UPLOAD_TIME  # From a part's end to the next [s]
BEFORE = TAKE_OFF_TIME + SETTLE_TIME + GO_TIME + SETTLE_TIME + UPLOAD_TIME  # The first part [s]
REST_HEIGHT = 0.035  # Height of a standing drone's centre [m]
BREAK_TOLERANCE = 1e-9  # Tolerance of times of samples [s]


@dataclass(frozen=True, eq=False)
class ExportedPart:
    """The files of one part."""

    begins: float  # start in the plan [s]
    ends: float  # end in the plan [s]
    curves: PiecewisePolynomial  # of all drones (2n, 3) [m] from t = 0, in the plan's frame
    parameters: tuple[Mapping[str, Any], ...]  # of the receivers' firmware (2n,)


@dataclass(frozen=True, eq=False)
class ExportedFlight:
    """An export with its plan, ready to fly."""

    format: str  # name
    title: str  # of the plan
    parts: tuple[ExportedPart, ...]
    takes_off: bool  # whether drones take off and go to their first points before
    changed: tuple[str, ...]  # files that are not those that were exported
    task: Task

    def __str__(self) -> str:
        seconds = " + ".join(f"{part.curves.duration:.2f} s" for part in self.parts)
        count = counted(len(self.parts), "part")
        start = "with its take-off" if self.takes_off else "starting at their first setpoints"
        words = f"flies the {self.format} files in {count} ({seconds}) {start}"
        waits = f", {BETWEEN:g} s between parts for goTo and upload" if len(self.parts) > 1 else ""
        words = f"{words}{waits}: {self.task.duration:.2f} s"
        if not self.changed:
            return words
        return f"{words}; changed since they were exported: {', '.join(self.changed)}"

    @property
    def flight(self) -> Flight:
        """The plan with the times of files and script."""
        flight = self.task.flight
        if flight is None:
            raise ValueError("the task of an export has a plan")
        return flight

    @property
    def facts(self) -> dict[str, Any]:
        """Format, duration and parts as data for JSON."""
        parts = [
            {"plan_span": [part.begins, part.ends], "duration": part.curves.duration}
            for part in self.parts
        ]
        facts: dict[str, Any] = {"format": self.format, "duration": self.task.duration}
        return facts | {"takes_off": self.takes_off, "parts": parts, "changed": [*self.changed]}


def is_export(path: Path) -> bool:
    """Return whether a path is a folder or a file that ``hitchopt export`` wrote."""
    return not (path / PLAN).exists() and bool(_manifest(path))


def read_flown(path: Path) -> Task:
    """Return the task of a plan's directory, or of an export with the times of files and script.

    Raises FileError as ``read_task`` and ``read_exported`` do, and for an export without a copy of
    its plan.
    """
    if not is_export(path):
        return read_task(path)
    if not (path / PLAN_COPY).is_file():
        remedy = "name the directory of the plan that was exported"
        raise FileError(f"{path}: holds no copy of the plan; {remedy}")
    return read_exported(path).task


def team_task(plan: TeamTask | Plan | Path | str, feature: Feature) -> TeamTask:
    """Return the task of a plan, its directory or an export, for a ``feature`` of one team.

    Raises FileError if the plan is missing or damaged, and UnsupportedError for several teams.
    """
    if isinstance(plan, TeamTask):
        return plan
    task = (
        Task.of(plan.flight) if isinstance(plan, Plan) else read_flown(checked_path("plan", plan))
    )
    return task.of_one_team(feature)


def _manifest(path: Path) -> dict[str, Any]:
    if path.is_dir():
        return read_manifest(path)
    return read_manifest(path.parent, f"{path.name}.{MANIFEST}") if path.is_file() else {}


def read_exported(path: Path, plan: Path | None = None) -> ExportedFlight:
    """Return an export with the plan in its folder, or that of a file ``plan``.

    Raises FileError for another plan than the exported one, damaged files, or other drones;
    InputError for an export without a plan; and UnsupportedError for files that are not flown.
    """
    manifest = _manifest(path)
    if not manifest:
        raise FileError(
            f"{path}: contains no {MANIFEST}; name a folder that `hitchopt export` wrote"
        )
    kind = format_of(str(manifest.get("exported_as")))
    if not kind.flown_by:
        raise UnsupportedError(f"{kind.name}: these files are for viewers; no drone flies them")
    flight, title = _plan_of(path, manifest, plan)
    drones = Task.of(flight).team.drone_names
    parts = list[ExportedPart]()
    changed = list[str]()
    stretch = 1.0
    for folder in [path / name for name in listed_names(manifest, "parts")] or [path]:
        content = _manifest(folder)
        files = [path] if path.is_file() else [folder / x for x in listed_names(content, "files")]
        parts.append(_part(kind, content, files, drones))
        changed += _changed_files(content, files)
        stretch = float(content.get("stretch", 1.0))
    return _flown(kind, title, parts, changed, flight.stretched(stretch))


def _changed_files(content: Mapping[str, Any], files: Sequence[Path]) -> list[str]:
    """Return the names of exported files that have changed, and of a changed manifest."""
    digests = mapping_at(content, "digests")
    changed = [file.name for file in files if digests.get(file.name, digest(file)) != digest(file)]
    return changed if is_sealed(content) else [*changed, MANIFEST]


def _plan_of(path: Path, manifest: Mapping[str, Any], plan: Path | None) -> tuple[Flight, str]:
    """Return the flight and the title of the plan that was exported."""
    copy = path / PLAN_COPY
    if plan is None and not copy.is_file():
        remedy = "add --plan with the directory of the plan that was exported"
        raise InputError("plan", None, "given for an export without a copy of its plan", remedy)
    source = copy if plan is None else plan
    if (expected := manifest.get("plan_digest")) != digest(source):
        reason = "is not the plan that was exported" if expected else "cannot be compared"
        raise FileError(f"{source}: {reason}; export the plan again, and fly that export")
    saved = read_saved_plan(source)
    return saved.flight, saved.title


def _part(
    kind: Format, content: Mapping[str, Any], files: Sequence[Path], drones: Sequence[str]
) -> ExportedPart:
    """Return the files of one part, with drones in order along the hitch."""
    trajectories = [file for file in files if file.suffix.lower() in kind.endings]
    contents = kind.sent(trajectories, content)
    frame = ReferenceFrame(
        content["frame"], content["origin_enu"], math.radians(content["yaw_deg"])
    )
    names = [str(mapping_at(content, "drones").get(drone)) for drone in drones]
    if missing := [name for name in names if name not in contents.names]:
        raise FileError(f"{files[0].parent}: {kind.name} has no drone {missing[0]}")
    order = [contents.names.index(name) for name in names]
    windows = [x.replaced(x.coefficients[:, order]) for x in contents.windows()]
    settings = files[0].parent / SETTINGS
    fleet: Any = read_yaml(settings) if settings.is_file() else {}
    robots = mapping_at(fleet, "robots") if isinstance(fleet, Mapping) else {}
    exported = mapping_at(mapping_at(content, "receiver"), "parameters")
    parameters = tuple(
        mapping_at(mapping_at(robots, name), "firmware_params") or mapping_at(exported, drone)
        for name, drone in zip(names, drones, strict=True)
    )
    begins, ends = content["plan_span"]
    return ExportedPart(begins, ends, frame.in_plan(joined(windows)), parameters)


def _flown(
    kind: Format,
    title: str,
    parts: Sequence[ExportedPart],
    changed: Sequence[str],
    planned: Flight,
) -> ExportedFlight:
    """Return the export as it is flown: setpoints at the samples of a prolonged plan."""
    legs, before = list[Flight](), 0.0
    begins_tied = any(bool(each.motion.formed[0]) for each in planned.teams)
    first = parts[0].curves.at(0.0)
    floor = planned.requirements.ground_or(float(np.min(first[:, 2])))
    is_scripted = isinstance(kind, CrazyflieFormat)
    if is_scripted and not begins_tied and float(np.min(first[:, 2])) - floor > LANDED:
        before = BEFORE
    for i, part in enumerate(parts):
        leg = planned.between(part.begins, part.ends) if len(parts) > 1 else planned
        wait = BETWEEN if i + 1 < len(parts) else 0.0
        longer = max(0.0, part.curves.duration - leg.duration) + wait
        legs.append(leg.prolonged(longer))
    if before:
        last = legs[0].duration
        legs[0] = legs[0].each_team(lambda each: shifted(padded(each, -before, last), before))
    whole, starts = legs[0], [before]
    for leg in legs[1:]:
        starts.append(whole.duration)
        whole = whole.followed_by(leg)
    task = Task.of(whole)
    t = sample_times(whole.duration, RATE)
    jets = _jets(kind, parts, starts, t)
    places = task.states.positions.copy()
    if before:
        _take_off(jets, t, first, floor)
        places[t < before] = jets[0, t < before]
    trims = np.insert(task.team.trim, 2, 0.0, axis=1)  # simulated drones add theirs
    commands = _commands(kind, jets, trims, task, parts[0])
    received = Received(commands, _loops(parts[0], task), _estimator(parts[0]), kind.flown_by)
    task = replace(task.with_positions(places), received=received)
    return ExportedFlight(kind.name, title, tuple(parts), bool(before), tuple(changed), task)


def _jets(kind: Format, parts: Sequence[ExportedPart], starts: Sequence[float], t: Array) -> Array:
    """Return positions, velocities and accelerations (3, S, 2n, 3) that drones receive at t."""
    drones = parts[0].curves.shape[0]
    jets = np.zeros((3, len(t), drones, 3))
    part_at = np.maximum(np.searchsorted(starts, t + BREAK_TOLERANCE, side="right") - 1, 0)
    for i, (part, start) in enumerate(zip(parts, starts, strict=True)):
        rows = np.flatnonzero(part_at == i)
        jets[:, rows] = _received(kind, part.curves, t[rows] - start)
    for (part, following), start in zip(pairwise(parts), starts[1:], strict=True):
        leave = start - GO_TIME - SETTLE_TIME - UPLOAD_TIME
        end = part.curves.at(part.curves.duration)
        _go_to(jets, t, (leave, start), end, following.curves.at(0.0))
    return jets


def _received(kind: Format, curves: PiecewisePolynomial, elapsed: Array) -> Array:
    """Return the jets (3, S, 2n, 3) that drones receive at times (S,) after a part's start [s].

    Receivers of streams hold the last sample, with its force; drones with an uploaded trajectory
    rest before and after it.
    """
    within = np.clip(elapsed, 0.0, curves.duration)
    if kind.flown_by == "stream":
        sample = np.searchsorted(curves.breaks, within + BREAK_TOLERANCE, side="right") - 1
        within = curves.breaks[np.maximum(sample, 0)]
    jets: Array = np.moveaxis(curves.jet(within, 3), -1, 0)
    if kind.flown_by == "upload":
        at_rest = (elapsed < 0.0) | (elapsed > curves.duration + BREAK_TOLERANCE)
        jets[1:, at_rest] = 0.0
    return jets


def _go_to(jets: Array, t: Array, span: tuple[float, float], start: Array, goal: Array) -> None:
    """Set the jets of a goTo, which begins at the span's start, and of the wait after it."""
    rows = np.flatnonzero((t >= span[0]) & (t < span[1] - BREAK_TOLERANCE))
    _move(jets, rows, (t[rows] - span[0]) / GO_TIME, GO_TIME, start, goal)


def _move(
    jets: Array, rows: Indices, share: Array, seconds: float, start: Array, goal: Array
) -> None:
    """Set the jets of the firmware's move of degree 7, at rest up to the jerk at both ends."""
    x = np.clip(share, 0.0, 1.0)[:, None, None]
    rise = x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)
    rate = 140.0 * x**3 * (1.0 - x) ** 3 / seconds
    change = 420.0 * x**2 * (1.0 - x) ** 2 * (1.0 - 2.0 * x) / seconds**2
    jets[0, rows] = start + rise * (goal - start)
    jets[1, rows], jets[2, rows] = rate * (goal - start), change * (goal - start)


def _take_off(jets: Array, t: Array, first: Array, floor: float) -> None:
    """Set the jets before the first part: up from the floor, and on to the first points."""
    standing, above = first.copy(), first.copy()
    standing[:, 2], above[:, 2] = floor + REST_HEIGHT, np.min(first[:, 2])
    rows = np.flatnonzero(t < BEFORE - BREAK_TOLERANCE)
    _move(jets, rows, t[rows] / TAKE_OFF_TIME, TAKE_OFF_TIME, standing, above)
    _go_to(jets, t, (TAKE_OFF_TIME + SETTLE_TIME, BEFORE), above, first)


def _commands(kind: Format, jets: Array, trims: Array, task: Task, part: ExportedPart) -> Commands:
    """Return what controllers receive, without the trims that simulated drones add."""
    names = {_controller(part)} if _controller(part) else named_controllers(task)
    followers = PACKET_RATES if kind.flown_by == "stream" else CURVE_RATES
    follows = names <= {*followers}
    mass = task.team.mass[:, None]
    rates = body_rates(mass, jets[2], task.states.t, follows=follows)
    commands = Commands(jets[0] - trims, jets[1], jets[2], rates)
    return packets(commands) if kind.flown_by == "stream" else commands


def _controller(part: ExportedPart) -> str:
    """Return the name of the controller that a part's parameters select; empty for others."""
    if PX4_RANGES.keys() <= part.parameters[0].keys():
        return "px4"
    value = mapping_at(part.parameters[0], "stabilizer").get("controller")
    return next((name for name, number in CONTROLLER_NUMBERS.items() if number == value), "")


def _loops(part: ExportedPart, task: Task) -> tuple[FlightController, ...]:
    """Return the position loops (2n,) of a part's parameters; empty if a drone has no gains."""
    masses = task.team.mass.tolist()
    each = zip(part.parameters, masses, strict=True)
    loops = [_loop(_controller(part), parameters, mass) for parameters, mass in each]
    known = tuple(loop for loop in loops if loop is not None)
    return known if len(known) == len(loops) else ()


def _loop(name: str, parameters: Mapping[str, Any], mass: float) -> FlightController | None:
    """Return the position loop of a drone's parameters; None without gains."""
    if name == "px4":
        return FlightController.of_px4(parameters, mass)
    if name == "pid":
        return FlightController.of(name, mass)
    if name == "mellinger" and (group := mapping_at(parameters, "ctrlMel")):
        gains = Gains(*((group[f"{key}_xy"], group[f"{key}_z"]) for key in ("kp", "kd", "ki")))
        return FlightController.of(name, mass, gains)
    if name == "lee" and (group := mapping_at(parameters, "ctrlLee")):
        pairs = ((group[f"Kpos_{term}x"], group[f"Kpos_{term}z"]) for term in "PDI")
        scaled = ((mass * level, mass * upright) for level, upright in pairs)
        return FlightController.of(name, mass, Gains(*scaled))
    return None


def _estimator(part: ExportedPart) -> EstimatorParameters | None:
    """Return the filter of a part's parameters; None if they have none."""
    kalman = mapping_at(part.parameters[0], "kalman")
    errors = mapping_at(part.parameters[0], "locSrv")
    if not kalman or not errors:
        return None
    return EstimatorParameters(
        kalman["pNAcc_xy"], kalman["pNAcc_z"], errors["extPosStdDev"], errors.get("extQuatStdDev")
    )
