"""Formats crazyswarm2 and compressed: trajectories for upload into the Crazyflies' memory.

Feed-forward: the on-board controller computes acceleration from the curve and adds gravity, so the
cable force ``F`` cannot be included, and an integral term would move the drone to its position at
any tension. If the controller's stiffness is known and it has no integral, setpoints are moved
outward to hold the tension. Otherwise stream full states (ros2bag, csv) with ``a_ff = a - F / m``.
The manifest has the firmware's parameters of the filter, the controller and its gains for every
drone.

**crazyswarm2**: settings of the fleet, start files, and a CSV file per drone: a header, and 33
numbers per piece, ``duration,x^0..x^7,y^0..y^7,z^0..z^7,yaw^0..yaw^7``: ascending powers of the
time from the start of the piece in seconds; m and rad. The numbers are rounded to single precision,
as on the drone, before they are written, so the curves read back are those that are flown.

**compressed**: the bytes in memory, one file per drone. The start has 8 bytes (int16 x, y, z in mm,
yaw in 0.1°). Each segment has a header of 3 bytes (two bits per axis for its type, x lowest, yaw
highest; uint16 duration in ms) and int16 Bézier control points of each axis without the first one:
none (constant), 1 (linear), 3 (cubic) or 7. A segment of zero duration is the end marker; without
it the drone continues into remains of an earlier upload. Everything is little-endian. Control
points are integer millimetres, rounded jointly to keep velocity accurate. Yaw is constant, because
firmware up to 2026.04 flies changing yaw wrongly.
"""

from __future__ import annotations

import json
import math
import re
import struct
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import resources
from math import comb, factorial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.controllers import UNSTATED_LATENCY
from hitchopt.drones.firmware import CONTROLLER_NUMBERS
from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.contents import (
    NOTE,
    FileContents,
    Trajectory,
    error,
    separator_findings,
    warning,
)
from hitchopt.exports.firmware import SETTINGS, team_parameters
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.exports.options import ExportOptions
from hitchopt.exports.parts import cut_into_parts
from hitchopt.exports.placing import AXES, places_text
from hitchopt.exports.refit import (
    PieceKind,
    Scale,
    best_breaks,
    fit_breaks,
    fit_pieces,
    round_points,
)
from hitchopt.hitch import Team
from hitchopt.motion.flight import Flight
from hitchopt.storage.archive import reading
from hitchopt.storage.files import file_bytes
from hitchopt.storage.tables import COMMA_REMEDY, numeric_table, text_lines
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

BYTES = 4096  # Size of the memory for all trajectories of one drone [B]
DEGREE = 7  # Degree of pieces and segments
YAW_TOLERANCE = 2e-3  # Change of yaw up to which it is constant, above the resolution of 0.1° [rad]


class CrazyflieFormat(Format):
    """A format of trajectories for upload into a Crazyflie's memory."""

    frames = ("enu", "nwu")
    controllers = tuple(CONTROLLER_NUMBERS)
    has_gains = True
    feed_forward = (
        "not in these files: the on-board controller has no model of the cable; setpoints that "
        "hold the tension need its stiffness and no integral; or stream full states (hitchopt fly)"
    )
    kind: PieceKind  # of the pieces
    smooth: int  # order of the highest continuous derivative

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return the firmware parameters of all drones, by name in the plan."""
        return {"parameters": team_parameters(team, options.stiffness, options.damping)}

    @abstractmethod
    def max_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return the maximum number of pieces of some curves in memory."""

    @abstractmethod
    def upload(self, path: Path) -> Trajectory:
        """Read the file of one drone; raises FileError if it is damaged."""

    def load(self, files: Sequence[Path]) -> FileContents:
        """Read files, one per drone."""
        drones, findings = [self.upload(path) for path in files], []
        for drone in drones:
            if drone.size > BYTES:
                reason = f"takes {drone.size} of {BYTES} bytes; use fewer pieces, or cut it"
                findings.append(error("memory", drone.name, reason))
        frames = sorted({drone.frame for drone in drones} - {""})
        if len(frames) > 1:
            findings.append(error("frame", "", f"files are in {' and '.join(frames)}"))
        frame = frames[0] if len(frames) == 1 and frames[0] in AXES else ""
        return FileContents.of_curves(drones, frame, self.smooth, findings)

    def parts(
        self, task: ExportTask, share_of: Callable[[ExportTask], float]
    ) -> Sequence[ExportTask]:
        """Return a task cut at rests into parts that fit in memory; empty if none do."""

        def fits(part: ExportTask) -> bool:
            limit = self.max_pieces(part.flight.drones)
            breaks = fit_breaks(part.flight.drones, self.kind, share_of(part), limit)
            return len(breaks) - 1 <= limit

        return cut_into_parts(task, fits)

    def refusal(self, task: ExportTask) -> InfeasibleError:
        """Return the error that a task does not fit in memory."""
        flight = task.flight
        pieces = len(fit_breaks(flight.drones, self.kind, 1.0)) - 1.0
        when, limit = f"in {flight.duration:.4g} s", float(self.max_pieces(flight.drones))
        remedy = "add steps such as hold: {seconds: 3}, at which the plan can be cut"
        if task.rests_longer:
            remedy = "divide its longest step, since it is cut between phases already"
        note = "compressed holds three times as much as crazyswarm2; or stream it: format=ros2bag"
        violation = Violation("memory", pieces, limit, "max", "pieces", (), when, remedy)
        return InfeasibleError([violation], note)


POLY = PieceKind(DEGREE, 3, 1.0 / 1024.0, max_duration=60.0, min_duration=8.0 / 1024.0)
"""Durations are exact in single precision; position, velocity and acceleration are continuous.
Pieces of a millisecond would have coefficients of 1e12, with large rounding errors."""

POWERS = tuple(f"{axis}^{i}" for axis in ("x", "y", "z", "yaw") for i in range(DEGREE + 1))
HEADER = ",".join(("duration", *POWERS))
PIECE_BYTES = 4 * (1 + len(POWERS))  # Size of a piece in the drone's memory [B]
MAX_PIECES = BYTES // PIECE_BYTES  # Number of pieces in a drone's memory: 31
MAX_NAMED_DEGREE = 12  # Largest degree that messages name
MIN_ROWS = 2  # Minimum number of rows of a file, for the reader of Crazyswarm2
LANDED = 0.04  # Height at which landing stops the motors [m], unless drones hover below it


OF_POWERS = np.array(
    [[comb(i, j) / comb(DEGREE, j) for i in range(DEGREE + 1)] for j in range(DEGREE + 1)]
)
"""(8, 8): row j has the Bernstein coefficients of ``x^j``."""


class Crazyswarm2(CrazyflieFormat):
    """One CSV of polynomials per drone, crazyflies.yaml, fly.py and a note."""

    name = "crazyswarm2"
    file = "{name}.csv"
    header = r"duration|([^,]*,){32}(([^,]*,){4})?[^,]*$"  # or any 33 columns, or 37 of degree 8
    endings = several = (".csv",)
    kind = POLY
    smooth = 2
    accuracy = 1e-3

    def max_pieces(self, curves: PiecewisePolynomial) -> int:  # noqa: ARG002
        """Return 31."""
        return MAX_PIECES

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the best fit of at most 31 pieces, within a millimetre."""
        breaks = best_breaks(task.flight.drones, POLY, MAX_PIECES)
        if len(breaks) - 1 > MAX_PIECES:
            raise self.refusal(task)
        if len(breaks) <= MIN_ROWS:
            breaks = np.array([0.0, POLY.quantum * (breaks[-1] // (2 * POLY.quantum)), breaks[-1]])
        curves = task.placed(fit_pieces(task.curves, breaks, POLY))
        powers = np.zeros((curves.pieces, len(task.names), 4, DEGREE + 1))
        for order in range(DEGREE + 1):  # of seconds
            powers[:, :, :3, order] = curves.ends(order)[0] / factorial(order)
        powers[:, :, 3, 0] = task.frame.heading
        for i, file in enumerate(files := self.files(task)):
            write_poly_csv(folder / file, curves.durations, powers[:, i], task.frame.name)
        first, last = curves.coefficients[0, ..., 0], curves.coefficients[-1, ..., -1]
        texts = start_files(task, first, last, curves.duration)
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        used = curves.pieces * PIECE_BYTES
        reason = f"{curves.pieces} pieces, {used} of {BYTES} bytes of each drone's memory"
        warnings = (
            *parameter_notes(task),
            *_stacked(task, first, "take off from"),
            *_stacked(task, last, "land on"),
        )
        return FormatOutput((*files, *texts), (reason, *warnings))

    def upload(self, path: Path) -> Trajectory:
        """Return the pieces of one drone in single precision."""
        with reading(path, "text file"):
            text = list(text_lines(path))
        rows = numeric_table(text.copy, str(path), first=2)  # readers skip one line
        if rows.width != 1 + len(POWERS):
            raise FileError(f"{path}: {_width_error(rows.width)}")
        table = rows.numbers(range(rows.width))
        rows.check_finite(table, ("duration", *POWERS))
        with np.errstate(over="ignore"):  # reported below
            table = table.astype(np.float32).astype(np.float64)
        if not np.all(np.isfinite(table)):
            raise FileError(f"{path}: a number exceeds the single precision of drones")
        if np.any(invalid := table[:, 0] <= 0.0):
            row = int(np.argmax(invalid))
            raise FileError(f"{path}: row {row + 1}: its duration is {table[row, 0]:g} s")
        durations, powers = table[:, 0], table[:, 1:].reshape(-1, 4, DEGREE + 1)
        findings = separator_findings(rows, path.stem)
        if len(table) < MIN_ROWS:
            findings.append(error("one row", path.stem, "readers fail on it; split the piece"))
        if re.match(r"\s*[-+.]?\d", text[0]):
            reason = "has none, and readers skip the first line; put a line of names before it"
            findings.append(error("header", path.stem, reason))
        if any(line.partition("#")[0].strip() for line in text[1 : rows.first - 1]):
            reason = "has more than one line, and readers skip only the first; remove the others"
            findings.append(error("header", path.stem, reason))
        with reading(path, "table of polynomials"):
            breaks = np.concatenate([[0.0], np.cumsum(durations)])
            scale = durations[:, None, None] ** np.arange(DEGREE + 1.0)
            curves = PiecewisePolynomial(breaks, (powers * scale) @ OF_POWERS)
        left, right = curves.ends()
        jumps = np.abs(np.angle(np.exp(1j * (left[1:, 3] - right[:-1, 3]))))  # modulo 2π
        if np.max(jumps, initial=0.0) > YAW_TOLERANCE:
            size, t = math.degrees(np.max(jumps)), curves.breaks[int(np.argmax(jumps)) + 1]
            reason = f"yaw jumps by {size:.3g}° at t = {t:.4g} s; make the pieces meet"
            findings.append(warning("jump", path.stem, reason))
        curve = PiecewisePolynomial(curves.breaks, curves.coefficients[:, :3])
        frame, size = text[0].partition("frame:")[2].strip(), len(table) * PIECE_BYTES
        return Trajectory(path.stem, curve, size, frame, tuple(findings))


def _width_error(width: int) -> str:
    """Return the reason why lines of a number of cells are no pieces of a trajectory."""
    degree, rest = divmod(width - 5, 4)  # A duration, and coefficients of x, y, z and yaw
    if rest == 0 and DEGREE < degree <= MAX_NAMED_DEGREE:
        what = f"has polynomials of degree {degree}, {width} numbers in a line"
        return f"{what}; drones take degree {DEGREE}: fit the trajectory again with that degree"
    return f"has {width} numbers in a line, not {1 + len(POWERS)}; {COMMA_REMEDY}"


def write_poly_csv(path: Path, durations: Array, powers: Array, frame: str) -> None:
    """Write one drone's pieces, (rows,) and (rows, 4, 8); the header names the frame."""
    rows = np.column_stack([durations, powers.reshape(len(durations), -1)])
    single = rows.astype(np.float32).astype(np.float64) + 0.0  # no negative zeros
    header = f"{HEADER}  # frame: {frame}"
    np.savetxt(path, single, "%.9g", ",", header=header, comments="", encoding="ascii")


def settings_text(task: ExportTask) -> str:
    """Return crazyflies.yaml (fileversion 3) for drones on the ground below their first positions.

    Positions are the plan's: trims and offsets of setpoints do not move a drone on the floor.
    """
    fleet, defaults = task.fleet, json.loads(_template("crazyswarm2.json"))
    robots = []
    standing = task.frame.points(task.planned(0.0)) + 0.0  # no negative zeros
    for member, (x, y, _) in zip(fleet.members, standing.tolist(), strict=True):
        parameters = _merged(member.firmware_params, task.settings["parameters"][member.role])
        robots.append(
            f"  {member.name}:\n    enabled: true\n    uri: {json.dumps(member.uri)}\n"
            # ROS rejects lists that mix integers and floats, so every number has a point.
            f"    initial_position: [{x:.6f}, {y:.6f}, 0.0]\n    type: {json.dumps(member.type)}\n"
            f"    role: {member.role}\n    firmware_params:\n"
            + "".join(f"      {group}: {_flow(values)}\n" for group, values in parameters.items())
        )
    types = [
        f"  {json.dumps(name)}: {_flow(_merged(defaults['type'], fleet.types.get(name, {})))}\n"
        for name in dict.fromkeys(member.type for member in fleet.members)
    ]
    return _template("crazyflies.txt").format(
        frame=task.frame.name,
        robots="".join(robots),
        types="".join(types),
        all=_flow(_merged(defaults["all"], fleet.settings)),
    )


def pilot_checklist(flight: Flight) -> str:
    """Return the pilot's checklist before arming."""
    texts = json.loads(_template("crazyswarm2.json"))
    look = texts["look"] + (texts["look_at_cables"] if flight.has_cables else [])
    latency = max(kind.latency or UNSTATED_LATENCY for kind in flight.team.quadrotor)
    return "\n".join(look).format(latency=1e3 * max(latency, UNSTATED_LATENCY))


def start_files(task: ExportTask, first: Array, last: Array, duration: float) -> dict[str, str]:
    """Return crazyflies.yaml, fly.py and README.txt by name.

    Drones start on the floor below ``first`` (D, 3) [m]; the trajectories end at ``last``.
    """
    place = f"This is {task.part}.\n" if task.part else ""
    common = {
        "frame": task.frame.name,
        "duration": duration,
        "look": pilot_checklist(task.flight),
    }
    return {
        SETTINGS: settings_text(task),
        "fly.py": _fly_script(task, first, last, place, common),
        NOTE: _start_note(task, place, common),
    }


def _fly_script(
    task: ExportTask, first: Array, last: Array, place: str, common: Mapping[str, object]
) -> str:
    """Return the script that flies the trajectories, from ``first`` to ``last`` (D, 3) [m]."""
    starts = [[round(x, 6) for x in start] for start in first.tolist()]
    stands = task.heights(0.0) < LANDED
    has_landed = task.heights(task.flight.duration) < LANDED
    return _template("fly_script.txt").format(
        title=task.title.replace("\\", " ").replace('"', "'") or "a plan of hitchopt",
        place=place,
        heading=task.frame.heading,
        first=json.dumps(dict(zip(task.names, starts, strict=True)), indent=4),
        standing=[name for name, each in zip(task.names, stands, strict=True) if each],
        landed=bool(np.all(has_landed)),
        slack=json.dumps(_slack_points(task), indent=4),
        land=min(LANDED, round(float(np.min(last[:, 2])), 6) + 0.0),
        **common,
    )


def _start_note(task: ExportTask, place: str, common: Mapping[str, object]) -> str:
    """Return the note on how to start the trajectories."""
    texts = json.loads(_template("crazyswarm2.json"))
    hint = " (its radio addresses are placeholders: name yours in a fleet file when exporting)"
    pull = texts["held_pull" if task.holds_tension else "pull"]
    return _template("start_note.txt").format(
        title=task.title or "A plan of hitchopt",
        place=f"\n{place}{texts['parts']}\n" if place else "",
        drones=places_text(task.flight, task.fleet),
        placeholders=hint if task.fleet.is_placeholder else "",
        slack=texts["slack"] if _slack_points(task) else "",
        pull=f"\n{pull}\n{texts['mind']}" if task.flight.has_cables else "",
        **common,
    )


def _slack_points(task: ExportTask) -> dict[str, list[float]]:
    """Return the last positions in the plan of drones that end tied, if offsets hold the tension.

    With setpoints there the drones pull no longer, and distances are those of the plan.
    """
    if task.without_offsets is None:
        return {}
    ends = [
        np.full(len(each.motion.team.drone_names), each.motion.phases[-1].state.hitched)
        for each in task.flight.teams
    ]
    setpoints = task.planned(task.flight.duration) + task.trims
    places = task.frame.points(setpoints).round(6) + 0.0
    tied = zip(task.names, places.tolist(), np.concatenate(ends), strict=True)
    return {name: place for name, place, is_tied in tied if is_tied}


def parameter_notes(task: ExportTask) -> Iterator[str]:
    """Yield notes on the firmware parameters, and on those of the fleet that are replaced."""
    controllers = {"ctrlMel", "ctrlLee", "posCtlPid"}
    if all(controllers & {*groups} for groups in task.settings["parameters"].values()):
        yield (
            "gains, mass, thrust and filter parameters are exported; attitude gains assume the "
            "Crazyflie's proportions: check them on one drone"
        )
    else:
        yield (
            "only filter parameters are exported; for gains, mass and thrust set "
            "team.quadrotor.controller"
        )
    names = []
    for member in task.fleet.members:
        own = task.settings["parameters"][member.role]
        for group, values in member.firmware_params.items():
            others = (k for k, x in values.items() if own.get(group, {}).get(k, x) != x)
            names += [f"{member.name}: {group}.{key} ({values[key]})" for key in others]
    if names:
        yield f"firmware_params of the fleet's file are replaced by the plan's: {', '.join(names)}"


def _merged(defaults: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return defaults with overrides, merged recursively."""
    merged = {**defaults, **overrides}
    for key in {*defaults} & {*overrides}:
        if isinstance(defaults[key], Mapping) and isinstance(overrides[key], Mapping):
            merged[key] = _merged(defaults[key], overrides[key])
    return merged


def _flow(values: Mapping[str, Any]) -> str:
    """Return values in YAML flow style; numbers such as 1e-3 get a point, for YAML 1.1."""
    return re.sub(r"([ \[]-?\d+)(e[-+]\d+)", r"\1.0\2", json.dumps(values))


def _template(name: str) -> str:
    """Return the text of a file in this package, with fields in braces."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _stacked(task: ExportTask, points: Array, action: str) -> Iterator[str]:
    """Yield a warning if drones take off or land above one another, as fly.py moves vertically."""
    width = 1.9999 * task.flight.requirements.separation.radius
    for i, point in enumerate(points[:-1, :2]):
        near = np.linalg.norm(points[i + 1 :, :2] - point, axis=1) < width
        if np.any(near):
            other = task.names[i + 1 + int(np.argmax(near))]
            pair = f"{task.names[i]} and {other}, perhaps others too,"
            yield f"{pair} would {action} the same position: move them one by one, not with fly.py"
            return


MILLI = 1e-3  # Unit of durations [s] and control points [m]
POINTS = (0, 1, 3, DEGREE)  # Number of control points per axis of a segment, by type
MAX_COORDINATE = 32.767  # Maximum coordinate of a control point [m]
HEADER_BYTES = 3  # Size of the header of a segment [B]
START_BYTES = 8  # Size of the start, before the first segment [B]
END = b"\x00\x00\x00"  # Segment of zero duration

SEGMENT = PieceKind(DEGREE, 3, MILLI, max_duration=65.535)
EQUAL_ERRORS = Scale(position=2e-4, velocity=1e-2, acceleration=0.2)  # Errors of equal weight


CLIENT = (
    "no script is written, since crazyflie_py cannot upload these bytes: upload them with cflib "
    "(docs/how_to/export.md)"
)


class CompressedBytes(CrazyflieFormat):
    """Bytes for Crazyflies, one file per drone, with the frame in its name."""

    name = "compressed"
    file = "{name}_{frame}.bin"
    endings = several = (".bin",)
    kind = SEGMENT
    smooth = 1  # velocity jumps by a few mm/s, which are part of the velocity error
    accuracy = 2e-3
    bounds = (1.0, 0.6, 1.4, 0.4, 0.2)  # long pieces fit less well, but round better

    def max_pieces(self, curves: PiecewisePolynomial) -> int:
        """Return the maximum number of segments, which depends on the number of moving axes."""
        is_moving = np.ptp(curves.coefficients, axis=(0, 3)) > 0.0
        axes = max(1, int(np.max(np.sum(is_moving, axis=-1))))
        return (BYTES - START_BYTES - len(END)) // (HEADER_BYTES + 2 * DEGREE * axes)

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the bytes of every drone, refitted within the task's bound and rounded."""
        breaks = fit_breaks(task.flight.drones, SEGMENT, task.bound)
        fit = task.placed(fit_pieces(task.curves, breaks, SEGMENT))
        curves = round_points(fit, MILLI, EQUAL_ERRORS)
        durations = np.rint(np.diff(breaks) / MILLI).astype(np.int64)
        points = np.rint(curves.coefficients / MILLI).astype(np.int64)
        size = 0
        for i, file in enumerate(files := self.files(task)):
            data = encode(durations, points[:, i], task.frame.heading)
            (folder / file).write_bytes(data)
            size = max(size, len(data))
        if size > BYTES:
            raise self.refusal(task)
        note = f"up to {size} of {BYTES} bytes of each drone's memory; velocity jumps at joints"
        return FormatOutput(files, (note, CLIENT, *parameter_notes(task)))

    def upload(self, path: Path) -> Trajectory:
        """Return one drone's trajectory up to the end marker, or the end of the bytes."""
        with reading(path, "trajectory of bytes"):
            if path.stat().st_size > 16 * BYTES:
                raise FileError(f"is far larger than a drone's memory of {BYTES} bytes")
            curve, yaws, has_end, size = decode(file_bytes(path))
        stem, _, frame = path.stem.rpartition("_")
        name, frame = (stem, frame) if stem and frame in AXES else (path.stem, "")
        findings = []
        if not has_end:
            reason = "missing: the drone continues into stale memory"
            findings.append(error("end marker", name, f"{reason}; append three zero bytes"))
        if math.radians(0.1 * float(np.ptp(yaws))) > YAW_TOLERANCE:
            reason = "changes, which firmware up to 2026.04 flies wrongly; keep it constant"
            findings.append(warning("yaw", name, reason))
        if np.max(np.abs(curve.coefficients)) > MAX_COORDINATE - 0.5 * MILLI:
            reason = f"a control point is at ±{MAX_COORDINATE} m, perhaps cut off; move the origin"
            findings.append(error("range", name, reason))
        return Trajectory(name, curve, size, frame, tuple(findings))


def encode(durations: NDArray[np.int64], points: NDArray[np.int64], heading: float) -> bytes:
    """Return the bytes of one drone with durations [ms] and a constant heading [rad].

    ``points`` (segments, 3, 8) are Bézier control points [mm] of a continuous curve.
    """
    if (farthest := float(np.max(np.abs(points))) * MILLI) > MAX_COORDINATE:
        bounds = farthest, MAX_COORDINATE, "max", "m"
        raise InfeasibleError([Violation("range", *bounds, (), "", "move the plan with origin=")])
    yaw = round(math.degrees(heading) * 10.0)
    parts = [struct.pack("<hhhh", *points[0, :, 0].tolist(), yaw)]
    for duration, segment in zip(durations.tolist(), points, strict=True):
        is_moving = np.ptp(segment, axis=-1) > 0  # constant axes have no points, all others 7
        kind = sum(POINTS.index(DEGREE) << (2 * i) for i in np.flatnonzero(is_moving).tolist())
        values = segment[is_moving, 1:].astype("<i2").tobytes()
        parts.append(struct.pack("<BH", kind, duration) + values)
    return b"".join([*parts, END])


def decode(data: bytes) -> tuple[PiecewisePolynomial, list[int], bool, int]:
    """Return positions (3,) [m], all yaws [0.1°], whether there is an end marker, and the size."""
    if len(data) < START_BYTES:
        raise FileError(f"has {len(data)} bytes, and the start alone takes {START_BYTES}")
    *last, yaw = struct.unpack_from("<hhhh", data)
    offset, yaws, durations, segments = START_BYTES, [yaw], list[int](), list[list[Array]]()
    while offset < len(data):
        if offset + HEADER_BYTES > len(data):
            raise FileError(f"stops within a segment's header, at byte {offset}")
        kind, duration = struct.unpack_from("<BH", data, offset)
        offset += HEADER_BYTES
        if duration == 0:
            break
        counts = [POINTS[(kind >> (2 * i)) & 3] for i in range(4)]
        if offset + 2 * sum(counts) > len(data):
            raise FileError(f"stops within segment {len(durations)}, at byte {len(data)}")
        values = struct.unpack_from(f"<{sum(counts)}h", data, offset)
        offset += 2 * sum(counts)
        *axes, headings = np.split(np.array(values, dtype=np.float64), np.cumsum(counts)[:-1])
        axes = [np.append(start, axis) for start, axis in zip(last, axes, strict=True)]
        last = [axis[-1] for axis in axes]
        yaws += headings.tolist()
        durations.append(duration)
        segments.append([bernstein.elevate(axis, DEGREE) for axis in axes])
    if not durations:
        raise FileError("has no segment of nonzero duration")
    breaks = np.concatenate([[0], np.cumsum(durations)]) * MILLI
    return PiecewisePolynomial(breaks, np.array(segments) * MILLI), yaws, duration == 0, offset
