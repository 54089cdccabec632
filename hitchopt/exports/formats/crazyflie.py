"""Formats crazyswarm2 and compressed: trajectories that are uploaded into Crazyflies' memory.

Feed-forward: the drone's own controller takes acceleration from the curve and adds gravity, so the
cable's pull ``F`` cannot be in it, and an integral would bring the drone to its place, where any
tension may be. Export with ``--hold-tension``, without an integral, or stream full states (ros2bag,
csv) with ``a_ff = a - F / m``. The filter, the controller and its gains are parameters
of the firmware, which the manifest has for every drone.

**crazyswarm2**: settings of the fleet, how to start, and a CSV file per drone, a header, then 33
numbers per piece: ``duration,x^0..x^7,y^0..y^7,z^0..z^7,yaw^0..yaw^7``: ascending powers of the
piece's own time in seconds; m and rad. The drone holds them in single precision, so the numbers are
rounded to that before they are written, and what is read back is what is flown.

**compressed**: the bytes in memory, one file per drone. 8 bytes of the start (int16 x, y, z in mm,
yaw in 0.1°), then per segment 3 bytes of header (two bits per axis for its type, x lowest, yaw
highest; uint16 duration in ms) and int16 Bézier control points of each axis in turn, the first one
left out as the segment before ends there: none (constant), 1 (linear), 3 (cubic) or 7. A segment of
no duration ends it: without one the drone flies on into what an earlier upload left in its memory.
Everything is little-endian. Control points are whole millimetres, rounded together so that velocity
suffers little, and yaw is constant: firmware up to 2026.04 flies changing yaw wrongly.
"""

from __future__ import annotations

import json
import math
import re
import struct
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from math import comb, factorial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.firmware import CONTROLLERS, SETTINGS, team_parameters
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.options import ExportOptions
from hitchopt.exports.placing import AXES
from hitchopt.exports.recording import (
    Recording,
    Trajectory,
    error,
    unusual,
    warning,
)
from hitchopt.exports.refit import Kind, Scale, best_breaks, breaks_within, fitted, rounded
from hitchopt.hitch import Team
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.retiming import cut, rest_breaks
from hitchopt.storage.archive import reading
from hitchopt.storage.tables import ADVICE, numeric_table, text_lines
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

BYTES = 4096  # Size of the memory for all trajectories of one drone [B]
DEGREE = 7  # Degree of pieces and segments
STEADY = 2e-3  # [rad] Yaw that changes less is constant: bytes have tenths of a degree


class CrazyflieFormat(Format):
    """A format of trajectories that are uploaded into a Crazyflie's memory."""

    frames = ("enu", "nwu")
    controllers = tuple(CONTROLLERS)
    receiver_integral = True
    feed_forward = (
        "not in these files: the on-board controller knows no cable: hold_tension is for one "
        "without an integral, or stream full states (hitchopt fly, ros2bag)"
    )
    kind: Kind  # of its pieces
    smooth: int  # highest derivative that does not jump

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return the firmware's parameters of every drone, by its name in the plan."""
        return {"parameters": team_parameters(team, options.stiffness, options.damping)}

    @abstractmethod
    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many pieces of some curves memory holds."""

    @abstractmethod
    def upload(self, path: Path) -> Trajectory:
        """Read the file of one drone; raise FileError if it is damaged."""

    def load(self, files: Sequence[Path]) -> Recording:
        """Read files, one per drone."""
        drones, findings = [self.upload(path) for path in files], []
        for drone in drones:
            if drone.size > BYTES:
                words = f"takes {drone.size} of {BYTES} bytes; give it fewer pieces, or cut it"
                findings.append(error("memory", drone.name, words))
        frames = sorted({drone.frame for drone in drones} - {""})
        if len(frames) > 1:
            findings.append(error("frame", "", f"files are in {' and '.join(frames)}"))
        frame = frames[0] if len(frames) == 1 and frames[0] in AXES else ""
        return Recording.of_curves(drones, frame, self.smooth, findings)

    def parts(self, task: Task, share: float) -> Sequence[Task]:
        """Return the task cut at rests into the fewest parts that memory holds; nothing if none.

        Beside others nothing is cut: they fly on while drones wait for the next part.
        """
        motion, most = task.motion, self.most_pieces(task.motion.drones)
        if motion.others:
            return ()
        at, times = rest_breaks(motion).tolist(), motion.drones.breaks
        starts = at[:1]
        while starts[-1] < at[-1]:
            remaining = cut(motion, starts[-1], at[-1]).drones
            pieces = breaks_within(remaining, self.kind, share, most)[: most + 1]
            reach = times[starts[-1]] + pieces[-1]
            end = max(each for each in at if times[each] <= reach + JOINT)
            if end == starts[-1]:
                return ()
            starts.append(end)
        spans, count = list(pairwise(starts)), len(starts) - 1
        why = (
            f"the plan is cut into {count} parts at rests, as a drone's memory or a limit asks: "
            "fly one, goTo the point where each drone hovers, and only then upload the next (it "
            "overwrites the memory that a finished trajectory is flown from)"
        )
        tasks = []
        for i, (first, last) in enumerate(spans if count > 1 else (), 1):
            begins, end = motion.drones.breaks[[first, last]].tolist()
            part = f"part {i} of {count}, t = {begins:.3f} s to {end:.3f} s of the plan"
            here = replace(task, motion=cut(motion, first, last), begins=begins, number=i)
            tasks.append(replace(here, part=part, notes=(*task.notes, f"{part}: {why}")))
        return tasks

    def refusal(self, motion: Motion) -> InfeasibleError:
        """Return the error that memory does not hold a motion."""
        pieces = len(breaks_within(motion.drones, self.kind, 1.0)) - 1.0
        when, most = f"in {motion.duration:.4g} s", float(self.most_pieces(motion.drones))
        remedy = "let the plan rest now and then, where it can be cut"
        words = "compressed holds three times as much as crazyswarm2; or stream it: format=ros2bag"
        broken = Violation("memory", pieces, most, "max", "pieces", (), when, remedy)
        return InfeasibleError([broken], words)


POLY = Kind(degree=DEGREE, match=3, quantum=1.0 / 1024.0, longest=60.0, shortest=8.0 / 1024.0)
"""Durations are exact in single precision; position, velocity and acceleration are continuous. A
piece of a millisecond would have coefficients of 1e12, and their rounding jolts."""

POWERS = tuple(f"{axis}^{i}" for axis in ("x", "y", "z", "yaw") for i in range(DEGREE + 1))
HEADER = ",".join(("duration", *POWERS))
PIECE_BYTES = 4 * (1 + len(POWERS))  # Size of a piece in the drone's memory [B]
MAX_PIECES = BYTES // PIECE_BYTES  # Pieces that a drone's memory holds: 31
LEAST = 2  # Rows of a file at least: the usual reader fails on one

LANDED = 0.04  # Height at which landing cuts the motors [m], unless drones hover below it


OF_POWERS = np.array(
    [[comb(i, j) / comb(DEGREE, j) for i in range(DEGREE + 1)] for j in range(DEGREE + 1)]
)
"""(8, 8): row j has the Bernstein coefficients of ``x^j``."""


class Crazyswarm2(CrazyflieFormat):
    """One CSV of polynomials per drone, crazyflies.yaml, fly.py and a note."""

    name = "crazyswarm2"
    file = "{name}.csv"
    header = r"duration|([^,]*,){32}[^,]*$"  # or 33 columns of whatever
    endings = several = (".csv",)
    kind = POLY
    smooth = 2
    accuracy = 1e-3

    def most_pieces(self, curves: PiecewisePolynomial) -> int:  # noqa: ARG002
        """Return 31."""
        return MAX_PIECES

    def write(self, folder: Path, task: Task) -> Written:
        """Write the best fit of at most 31 pieces, within a millimetre."""
        breaks = best_breaks(task.motion.drones, POLY, MAX_PIECES)
        if len(breaks) - 1 > MAX_PIECES:
            raise self.refusal(task.motion)
        if len(breaks) <= LEAST:
            breaks = np.array([0.0, POLY.quantum * (breaks[-1] // (2 * POLY.quantum)), breaks[-1]])
        curves = task.frame.placed(fitted(task.motion.drones, breaks, POLY))
        powers = np.zeros((curves.pieces, len(task.names), 4, DEGREE + 1))
        powers[:, :, :3] = to_powers(curves)
        powers[:, :, 3, 0] = task.frame.heading
        for i, file in enumerate(files := self.files(task)):
            write_poly_csv(folder / file, curves.durations, powers[:, i], task.frame.name)
        first, last = curves.coefficients[0, ..., 0], curves.coefficients[-1, ..., -1]
        texts = start_files(task, first, last, curves.duration)
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        used = curves.pieces * PIECE_BYTES
        words = f"{curves.pieces} pieces, {used} of {BYTES} bytes of each drone's memory"
        warnings = (
            *parameter_notes(task),
            *_stacked(task, first, "take off from"),
            *_stacked(task, last, "land on"),
        )
        return Written((*files, *texts), (words, *warnings))

    def upload(self, path: Path) -> Trajectory:
        """Return the pieces of one drone, in single precision as it holds them."""
        with reading(path, "text"):
            text = list(text_lines(path))
        rows = numeric_table(text.copy, str(path), first=2)  # readers skip one line, any
        if rows.width != 1 + len(POWERS):
            words = f"has {rows.width} numbers in a line, not {1 + len(POWERS)}; {ADVICE}"
            raise FileError(f"{path}: {words}")
        table = rows.numbers(range(rows.width))
        with np.errstate(over="ignore"):  # reported below
            table = table.astype(np.float32).astype(np.float64)
        if not np.all(np.isfinite(table)):
            raise FileError(f"{path}: a number is beyond single precision, which drones hold")
        if np.any(wrong := table[:, 0] <= 0.0):
            row = int(np.argmax(wrong))
            raise FileError(f"{path}: row {row + 1}: its duration is {table[row, 0]:g} s")
        durations, powers = table[:, 0], table[:, 1:].reshape(-1, 4, DEGREE + 1)
        faults = unusual(rows, path.stem)
        if len(table) < LEAST:
            faults.append(error("one row", path.stem, "readers fail on it; split the piece"))
        if re.match(r"\s*[-+.]?\d", text[0]):
            words = "has none, and readers skip the first line; put a line of names before it"
            faults.append(error("header", path.stem, words))
        if any(line.partition("#")[0].strip() for line in text[1 : rows.first - 1]):
            words = "has more than one line, and readers skip only the first; remove the others"
            faults.append(error("header", path.stem, words))
        with reading(path, "table of polynomials"):
            curves = of_powers(durations, powers)
        left, right = curves.ends()
        jumps = np.abs(np.angle(np.exp(1j * (left[1:, 3] - right[:-1, 3]))))  # no whole turns
        if np.max(jumps, initial=0.0) > STEADY:
            size, t = math.degrees(np.max(jumps)), curves.breaks[int(np.argmax(jumps)) + 1]
            words = f"yaw jumps by {size:.3g}° at t = {t:.4g} s; make the pieces meet"
            faults.append(warning("jump", path.stem, words))
        frame, places = text[0].partition("frame:")[2].strip(), curves.coefficients[:, :3]
        curve = PiecewisePolynomial(curves.breaks, places)
        return Trajectory(path.stem, curve, len(table) * PIECE_BYTES, frame, tuple(faults))


def to_powers(curves: PiecewisePolynomial) -> Array:
    """Return ascending powers of seconds (pieces, D, 3, 8) of curves (D, 3) of degree 7."""
    jet = [curves.ends(order)[0] / factorial(order) for order in range(DEGREE + 1)]
    return np.stack(jet, axis=-1)


def of_powers(durations: Array, powers: Array) -> PiecewisePolynomial:
    """Return the curves (4,) of ascending powers (pieces, 4, 8) of seconds."""
    breaks = np.concatenate([[0.0], np.cumsum(durations)])
    scale = durations[:, None, None] ** np.arange(DEGREE + 1.0)
    return PiecewisePolynomial(breaks, (powers * scale) @ OF_POWERS)


def write_poly_csv(path: Path, durations: Array, powers: Array, frame: str) -> None:
    """Write one drone's pieces, (rows,) and (rows, 4, 8); the header names the frame."""
    rows = np.column_stack([durations, powers.reshape(len(durations), -1)])
    single = rows.astype(np.float32).astype(np.float64) + 0.0  # no negative zeros
    header = f"{HEADER}  # frame: {frame}"
    np.savetxt(path, single, "%.9g", ",", header=header, comments="", encoding="ascii")


def settings_text(task: Task, first: Array) -> str:
    """Return crazyflies.yaml (fileversion 3) for drones on the floor below places (D, 3) [m]."""
    fleet, usual = task.fleet, json.loads(_template("crazyswarm2.json"))
    robots = []
    for member, (x, y, _) in zip(fleet.members, first.tolist(), strict=True):
        own = _merged(member.firmware_params, task.settings["parameters"][member.role])
        robots.append(
            f"  {member.name}:\n    enabled: true\n    uri: {json.dumps(member.uri)}\n"
            # ROS refuses lists that mix integers and floats, so every number has a point.
            f"    initial_position: [{x:.6f}, {y:.6f}, 0.0]\n    type: {json.dumps(member.type)}\n"
            f"    role: {member.role}\n    firmware_params:\n"
            + "".join(f"      {group}: {_flow(values)}\n" for group, values in own.items())
        )
    types = [
        f"  {json.dumps(name)}: {_flow(_merged(usual['type'], fleet.types.get(name, {})))}\n"
        for name in dict.fromkeys(member.type for member in fleet.members)
    ]
    return _template("crazyflies.txt").format(
        frame=task.frame.name,
        robots="".join(robots),
        types="".join(types),
        all=_flow(_merged(usual["all"], fleet.settings)),
    )


def pilot_checklist(*, cables: bool) -> str:
    """Return the pilot's checklist before arming: ten lines, eight without cables."""
    texts = json.loads(_template("crazyswarm2.json"))
    return "\n".join(texts["look"] + (texts["look_at_cables"] if cables else []))


def start_files(task: Task, first: Array, last: Array, duration: float) -> dict[str, str]:
    """Return crazyflies.yaml, fly.py and README.txt by their names.

    Trajectories lead from ``first`` (D, 3) [m], with drones on the floor below, to ``last``.
    """
    texts = json.loads(_template("crazyswarm2.json"))
    low = task.heights(0.0) < LANDED, task.heights(task.motion.duration) < LANDED
    places = {n: [round(x, 6) for x in p] for n, p in zip(task.names, first.tolist(), strict=True)}
    place = f"This is {task.part}.\n" if task.part else ""
    hint = " (its radio addresses are placeholders: name yours in a fleet file when exporting)"
    look = pilot_checklist(cables=task.motion.has_cables)
    common = {"frame": task.frame.name, "duration": duration, "look": look}
    return {
        SETTINGS: settings_text(task, first),
        "fly.py": _template("fly_script.txt").format(
            title=task.title.replace("\\", " ").replace('"', "'") or "a plan of hitchopt",
            place=place,
            heading=task.frame.heading,
            first=json.dumps(places, indent=4),
            standing=[name for name, stands in zip(task.names, low[0], strict=True) if stands],
            landed=bool(np.all(low[1])),
            land=min(LANDED, round(float(np.min(last[:, 2])), 3) + 0.0),
            **common,
        ),
        "README.txt": _template("start_note.txt").format(
            title=task.title or "A plan of hitchopt",
            place=f"\n{place}{texts['parts']}\n" if place else "",
            placeholders="" if task.fleet.given else hint,
            pull=_pull(task, texts),
            **common,
        ),
    }


def parameter_notes(task: Task) -> Iterator[str]:
    """Yield notes on the parameters, and on those of the fleet that are replaced."""
    known = {"ctrlMel", "ctrlLee", "posCtlPid"}
    if all(known & {*groups} for groups in task.settings["parameters"].values()):
        yield (
            "the firmware's parameters are those of team.quadrotor, with the attitude gains of a "
            "drone of the Crazyflie's proportions and max_thrust at full command"
        )
    else:
        yield (
            "parameters of the firmware's filter alone are exported: for gains, mass and thrust "
            "name team.quadrotor.controller, or state its stiffness"
        )
    names = []
    for member in task.fleet.members:
        own = task.settings["parameters"][member.role]
        for group, values in member.firmware_params.items():
            others = (k for k, x in values.items() if own.get(group, {}).get(k, x) != x)
            names += [f"{member.name}: {group}.{key} ({values[key]})" for key in others]
    if names:
        yield f"firmware_params of the fleet's file are replaced by the plan's: {', '.join(names)}"


def _merged(usual: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return both mappings, and those in them, as one in which what is given goes first."""
    both = {**usual, **given}
    for key in {*usual} & {*given}:
        if isinstance(usual[key], Mapping) and isinstance(given[key], Mapping):
            both[key] = _merged(usual[key], given[key])
    return both


def _flow(values: Mapping[str, Any]) -> str:
    """Return values on one line of YAML; numbers that YAML 1.1 takes for texts get a point."""
    return re.sub(r"([ \[]-?\d+)(e[-+]\d+)", r"\1.0\2", json.dumps(values))


def _pull(task: Task, texts: Mapping[str, str]) -> str:
    """Return the note on the cables; empty without them."""
    if not task.motion.has_cables:
        return ""
    return f"\n{texts['held_pull' if task.options.hold_tension else 'pull']}\n{texts['mind']}"


def _template(name: str) -> str:
    """Return the text of a file next to this module, with fields in braces."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _stacked(task: Task, places: Array, what: str) -> Iterator[str]:
    """Give a warning where drones start, or land, below one another: fly.py goes straight up."""
    width = 1.9999 * task.motion.requirements.separation.radius
    for i, place in enumerate(places[:-1, :2]):
        near = np.linalg.norm(places[i + 1 :, :2] - place, axis=1) < width
        if np.any(near):
            other = task.names[i + 1 + int(np.argmax(near))]
            pair = f"{task.names[i]} and {other}, perhaps others too,"
            yield f"{pair} would {what} one place: move them one by one, not with fly.py"
            return


MILLI = 1e-3  # Unit of durations [s] and control points [m]
POINTS = (0, 1, 3, DEGREE)  # Control points that a segment of each type gives for an axis
LARGEST = 32.767  # Largest distance of a control point from zero along an axis [m]
HEADER_BYTES, START_BYTES = 3, 8
END = b"\x00\x00\x00"  # The segment of no duration

SEGMENT = Kind(degree=DEGREE, match=3, quantum=MILLI, longest=65.535)
EQUAL_ERRORS = Scale(position=2e-4, velocity=1e-2, acceleration=0.2)  # Errors that weigh alike


class CompressedBytes(CrazyflieFormat):
    """Bytes for Crazyflies, a file per drone, whose name tells the frame as they cannot."""

    name = "compressed"
    file = "{name}_{frame}.bin"
    endings = several = (".bin",)
    kind = SEGMENT
    smooth = 1  # velocity jumps too, by a few mm/s: see the velocity error
    accuracy = 2e-3
    bounds = (1.0, 0.6, 1.4, 0.4, 0.2)  # long pieces fit worse and suffer less from rounding

    def most_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return how many segments memory holds: they are longer the more axes move."""
        moving = np.ptp(curves.coefficients, axis=(0, 3)) > 0.0
        axes = max(1, int(np.max(np.sum(moving, axis=-1))))
        return (BYTES - START_BYTES - len(END)) // (HEADER_BYTES + 2 * DEGREE * axes)

    def write(self, folder: Path, task: Task) -> Written:
        """Write the bytes of every drone, refitted within the task's bound and rounded."""
        breaks = breaks_within(task.motion.drones, SEGMENT, task.bound)
        whole = rounded(
            task.frame.placed(fitted(task.motion.drones, breaks, SEGMENT)), MILLI, EQUAL_ERRORS
        )
        durations = np.rint(np.diff(breaks) / MILLI).astype(np.int64)
        points = np.rint(whole.coefficients / MILLI).astype(np.int64)
        most = 0
        for i, file in enumerate(files := self.files(task)):
            data = encoded(durations, points[:, i], task.frame.heading)
            (folder / file).write_bytes(data)
            most = max(most, len(data))
        if most > BYTES:
            raise self.refusal(task.motion)
        note = f"up to {most} of {BYTES} bytes of each drone's memory; velocity jumps at joints"
        return Written(files, (note, *parameter_notes(task)))

    def upload(self, path: Path) -> Trajectory:
        """Return one drone's trajectory up to its end, or that of the bytes."""
        with reading(path, "trajectory of bytes"):
            if path.stat().st_size > 16 * BYTES:
                raise FileError(f"is far larger than a drone's memory of {BYTES} bytes")
            curve, yaws, ended, size = decoded(path.read_bytes())
        stem, _, frame = path.stem.rpartition("_")
        name, frame = (stem, frame) if stem and frame in AXES else (path.stem, "")
        faults = []
        if not ended:
            words = (
                "missing: the drone flies on into what was in its memory; append three zero bytes"
            )
            faults.append(error("end marker", name, words))
        if math.radians(0.1 * float(np.ptp(yaws))) > STEADY:
            words = "changes, which firmware up to 2026.04 flies wrongly; keep it constant"
            faults.append(warning("yaw", name, words))
        if np.max(np.abs(curve.coefficients)) > LARGEST - 0.5 * MILLI:
            words = f"a control point is at ±{LARGEST} m, perhaps cut off; move the origin"
            faults.append(error("range", name, words))
        return Trajectory(name, curve, size, frame, tuple(faults))


def encoded(durations: NDArray[np.int64], points: NDArray[np.int64], heading: float) -> bytes:
    """Return the bytes of one drone: durations [ms], a constant heading [rad].

    ``points`` (segments, 3, 8) are Bézier control points [mm], each segment from where the last
    ended.
    """
    if (farthest := float(np.max(np.abs(points))) * MILLI) > LARGEST:
        remedy = "move the plan with origin="
        raise InfeasibleError([Violation("range", farthest, LARGEST, "max", "m", (), "", remedy)])
    yaw = round(math.degrees(heading) * 10.0)
    parts = [struct.pack("<hhhh", *points[0, :, 0].tolist(), yaw)]
    for duration, segment in zip(durations.tolist(), points, strict=True):
        moving = np.ptp(segment, axis=-1) > 0  # what stays needs no points, all else has 7
        kind = sum(POINTS.index(DEGREE) << (2 * i) for i in np.flatnonzero(moving).tolist())
        values = segment[moving, 1:].astype("<i2").tobytes()
        parts.append(struct.pack("<BH", kind, duration) + values)
    return b"".join([*parts, END])


def decoded(data: bytes) -> tuple[PiecewisePolynomial, list[int], bool, int]:
    """Return positions (3,) [m], all yaws [0.1°], whether bytes end it, and how many are read."""
    if len(data) < START_BYTES:
        raise FileError(f"has {len(data)} bytes, and the start alone takes {START_BYTES}")
    *last, yaw = struct.unpack_from("<hhhh", data)
    at, yaws, durations, segments = START_BYTES, [yaw], list[int](), list[list[Array]]()
    while at < len(data):
        if at + HEADER_BYTES > len(data):
            raise FileError(f"stops within a segment's header, at byte {at}")
        kind, duration = struct.unpack_from("<BH", data, at)
        at += HEADER_BYTES
        if duration == 0:
            break
        counts = [POINTS[(kind >> (2 * i)) & 3] for i in range(4)]
        if at + 2 * sum(counts) > len(data):
            raise FileError(f"stops within segment {len(durations)}, at byte {len(data)}")
        values = struct.unpack_from(f"<{sum(counts)}h", data, at)
        at += 2 * sum(counts)
        *axes, turns = np.split(np.array(values, dtype=np.float64), np.cumsum(counts)[:-1])
        axes = [np.append(start, axis) for start, axis in zip(last, axes, strict=True)]
        last = [axis[-1] for axis in axes]
        yaws += turns.tolist()
        durations.append(duration)
        segments.append([bernstein.elevate(axis, DEGREE) for axis in axes])
    if not durations:
        raise FileError("has no segment that lasts")
    breaks = np.concatenate([[0], np.cumsum(durations)]) * MILLI
    return PiecewisePolynomial(breaks, np.array(segments) * MILLI), yaws, duration == 0, at
