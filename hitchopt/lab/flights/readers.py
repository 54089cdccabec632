"""Readers of recorded flights. Formats are recognized by their first bytes, and units are checked.

Readers return rows of time and position by label, which ``flight_of`` converts to bodies and
markers. Motion capture yields one cloud of markers: labels are ignored, as they swap and end. The
cloud may contain the drones' own markers. Drones log one file each, on a clock that starts at boot.
"""

from __future__ import annotations

import csv
import re
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from itertools import chain, islice, product, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, optional_module
from hitchopt.geometry.vectors import length
from hitchopt.lab.flights.recordings import RecordedFlight, Track
from hitchopt.lab.flights.topics import (
    LOG_TOPICS,
    Topic,
    bag_topics,
    distinct_names,
    log_topics,
    taken_topics,
)
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array, check_choice
from hitchopt.values import path as checked_path

# Units of length [m], and names of units in files
UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
NAMES = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "inches": "in", "feet": "ft"}

MAX_DISTANCE = 50.0  # Largest median distance from the origin of lengths in metres [m]
MAX_STEP = 1.0  # Largest median step of times in seconds [s]
# Smallest jump to and fro between samples [m] and its smallest speed [m/s]; largest share of these
JUMP, JUMP_SPEED, MAX_JUMPS = 0.1, 10.0, 0.1
CLOCKS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
RATES = (4.0, 3000.0)  # Plausible sampling rates [Hz]
MIN_EPOCH = 1e7  # Smallest time that counts from a date or from a computer's start [s]

# Required columns of a plain table, in any order: time [s], the name of a body (q0, r0, …, a vertex
# p0, …, or any name) or MARKER for an unlabeled point, and its position [m]
HEADER, MARKER = "t,name,x,y,z", "marker"

# Files of a simulated flight; columns of names in its tables, and prefixes of the names
TABLES, SUMMARY = {"vertices.csv": ("vertex", "p"), "drones.csv": ("drone", "")}, "simulation.json"

MOTIVE, VICON = "Format Version", ("Segments", "Objects", "Trajectories")
UNLABELED = ("*", "unlabel", "unidentified", "u_", MARKER)  # Prefixes of labels without a subject
MAX_HEADER_LINES = 50  # Lines in which the titles of a Motive table are searched
TIME_TOLERANCE = 2e-3  # Largest rounding error of the printed time of a frame [s]
BODY_RADIUS = 0.3  # Largest distance of markers from the middle of their body [m]
MAX_FIXED = 0.05  # Largest motion of a frame that does not move [m]
BLANK = ' ",;\t'  # Characters of a line without content

POSE = "motion_capture_tracking_interfaces/msg/NamedPose"  # Messages of crazyswarm2
MESSAGES = {POSE: "string name\ngeometry_msgs/Pose pose\n"}
MESSAGES[f"{POSE}Array"] = f"std_msgs/Header header\n{POSE.replace('msg/', '')}[] poses\n"

# Message types with positions, by preference: whether messages name the bodies, and functions that
# return the frame of each body, its header and its position from a message
Bodies = list[tuple[str, Any, Any]]
MESSAGE_TYPES: dict[str, tuple[bool, Callable[[Any], Bodies]]] = {
    f"{POSE}Array": (True, lambda m: [(x.name, m.header, x.pose.position) for x in m.poses]),
    "geometry_msgs/msg/TransformStamped": (
        False, lambda m: [(m.child_frame_id, m.header, m.transform.translation)],
    ),
    "tf2_msgs/msg/TFMessage": (
        True, lambda m: [(x.child_frame_id, x.header, x.transform.translation)
                         for x in m.transforms],
    ),
    "geometry_msgs/msg/PoseStamped": (False, lambda m: [("", m.header, m.pose.position)]),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        False, lambda m: [("", m.header, m.pose.pose.position)],
    ),
    "nav_msgs/msg/Odometry": (
        False, lambda m: [(m.child_frame_id, m.header, m.pose.pose.position)],
    ),
}  # fmt: skip
STATIC = "/tf_static"  # Topic of frames that do not move
CLOUD, FLOAT32 = "sensor_msgs/msg/PointCloud2", 7

# Topic of a uSD log that repeats the last position, or zeros, until the next; scales [m], else 1
HELD = "locSrv"
USD_SCALES = {"ctrltargetZ": 1e-3, "stateEstimateZ": 1e-3, "stateEstimateZ.p": 1e-3}
# Topics with the drone's positions in logs
USD_POSITIONS = ("stateEstimate", "stateEstimateZ", "locSrv")
ULOG_POSITIONS = ("vehicle_visual_odometry", "vehicle_local_position")


Reader = Callable[[Sequence[Path], str | None, str | None], RecordedFlight]
"""Reader of all files of a format, in a unit, with a topic if requested."""


def read_flight(
    path: Path | str, unit: str | None = None, topic: str | None = None
) -> RecordedFlight:
    """Return the content of a recording in a supported format.

    Parameters
    ----------
    path: file, or directory of a bag, a simulated flight or drones' logs.
    unit: of lengths: ``m``, ``cm``, ``mm``, ``in`` or ``ft``; None: as stated, else metres.
    topic: topic of a bag or a log with the drones' positions, such as ``/*/pose``, where ``*``
        stands for any text; None: measured before estimated before commanded positions.

    Raises
    ------
    FileError: a missing or damaged file, an unknown format, implausible times or positions, or two
        topics of the same kind and type with positions of a body.
    InputError: an unknown unit.
    """
    path = checked_path("path", path)
    if unit is not None:
        check_choice("unit", unit, tuple(UNITS))
    with reading(path, "recording"):
        flight = _read(path, unit, topic)
        if not flight.tracks:
            raise FileError("holds no position of a body; record the drones")
        for name, track in flight.tracks.items():
            step = float(np.median(np.diff(track.t))) if len(track.t) > 1 else 0.0
            if step >= MAX_STEP:
                units = [
                    f"{each}, divide by {many:.0e}"
                    for each, many in CLOCKS.items()
                    if step / many * RATES[0] <= 1.0 <= step / many * RATES[1]
                ]
                problem = f"times of {name} step by {step:.4g} s: not in seconds"
                raise FileError(f"{problem}; if they are {' or if '.join(units) or 'other units'}")
        positions = np.concatenate([track.positions for track in flight.tracks.values()])
        distance = float(np.median(np.linalg.norm(positions, axis=1)))
        if distance > MAX_DISTANCE and unit is None:
            problem = f"positions are {distance:.4g} m from the origin at the median"
            raise FileError(f"{problem}, over {MAX_DISTANCE:g} m: millimetres? unit='mm'")
        return _without_jumping_bodies(flight)


def _without_jumping_bodies(flight: RecordedFlight) -> RecordedFlight:
    """Return a flight without bodies that jump to and fro; FileError if none is left."""
    tracks, notes = dict(flight.tracks), list[str]()
    for name, track in flight.tracks.items():
        steps, across = (length(track.positions[k:] - track.positions[:-k]) for k in (1, 2))
        there = (steps > JUMP) & (steps > JUMP_SPEED * np.diff(track.t))
        jumps = there[:-1] & there[1:] & (across < 0.5 * np.minimum(steps[:-1], steps[1:]))
        if np.sum(jumps) > MAX_JUMPS * len(track.t):
            size = f"to and fro by {np.median(steps[:-1][jumps]):.2g} m"
            share = f"{np.sum(jumps) / len(jumps):.0%} of its samples jump {size}"
            notes.append(f"{name} omitted: {share}, as of two sources in one")
            del tracks[name]
    if not tracks:
        raise FileError("; ".join(notes))
    return replace(flight, tracks=tracks, notes=(*flight.notes, *notes))


def _read(path: Path, unit: str | None, topic: str | None) -> RecordedFlight:
    if not path.exists():
        raise FileError(f"{path}: there is no such file; give a recording")
    if all((path / name).is_file() for name in TABLES):
        _refuse_topic(topic)
        return read_simulated(path)
    files = sorted(x for x in path.iterdir() if x.is_file()) if path.is_dir() else [path]
    heads = dict[Path, bytes]()
    for file in files:
        with file.open("rb") as stream:
            heads[file] = stream.read(64).replace(b"\0", b"")  # Zero bytes of UTF-16
    for pattern, (_, read) in FORMATS.items():
        if matching := [file for file in files if re.match(pattern, heads[file])]:
            return read(matching, unit, topic)
    known = ", ".join(name for name, _ in FORMATS.values())
    known += f", the directory of a simulated flight, or a table with the columns {HEADER}"
    if path.is_dir():
        listed = ", ".join(each.name for each in files[:5]) or "no file"
        raise FileError(f"holds {listed}: no recording; give {known}")
    try:
        table = labelled_table(partial(text_lines, path), HEADER.split(","), str(path))
    except FileError as error:
        raise FileError(f"{error}; give {known}") from None
    _refuse_topic(topic)
    rows, names = table.numbers(["t", "x", "y", "z"], blanks=True), table.words("name")
    return flight_of("table", _by_name(names, rows), unit or "m")


def _refuse_topic(topic: str | None) -> None:
    if topic is not None:
        raise FileError("is of a format without topics; leave topic= out")


def _single(paths: Sequence[Path]) -> Path:
    """Return the only file of a recording; FileError if a directory has several."""
    if len(paths) > 1:
        listed = ", ".join(path.name for path in paths[:5])
        raise FileError(f"holds {len(paths)} recordings, {listed}: give one file")
    return paths[0]


def table_reader(read: Callable[[Path, str | None], RecordedFlight]) -> Reader:
    """Return a reader of a format with one file per flight, and without topics."""

    def read_one(paths: Sequence[Path], unit: str | None, topic: str | None) -> RecordedFlight:
        _refuse_topic(topic)
        return read(_single(paths), unit)

    return read_one


def _by_name(names: Sequence[str], rows: Array) -> dict[str, Array]:
    """Return the rows (m, 4) of each name, in order of first occurrence."""
    return {name: rows[np.array(names) == name] for name in dict.fromkeys(names)}


def scale_of(unit: str) -> float:
    """Return a unit of length [m]; FileError if it is unknown."""
    word = unit.strip().casefold()
    scale = UNITS.get(NAMES.get(word, word), 0.0)
    if not scale:
        raise FileError(f"its unit of length, {unit!r}, is unknown; state unit='m', 'cm' or 'mm'")
    return scale


def flight_of(
    source: str,
    rows: Mapping[str, Array],
    unit: str = "m",
    *,
    notes: Sequence[str] = (),
    setpoints: Mapping[str, Array] | None = None,
    one_clock: bool = True,
    simulated: Mapping[str, Any] | None = None,
) -> RecordedFlight:
    """Return a flight from rows (time [s], x, y, z [unit]) (m, 4) of every body, and of MARKER.

    ``setpoints`` are rows too; for other arguments see ``RecordedFlight``. Rows without a position
    and rows that repeat a time are omitted. Raises FileError for an unknown unit or descending
    times.
    """
    scale, epoch = scale_of(unit), 0.0
    bodies = {name: samples for name, samples in rows.items() if name != MARKER and len(samples)}
    start = min((float(samples[0, 0]) for samples in bodies.values()), default=0.0)
    if one_clock and abs(start) >= MIN_EPOCH:
        epoch, clock = start, f"at {start:.3f} s of the recording's clock"
        notes = [*notes, f"times count from the first position, {clock}"]

    def track(samples: Array) -> Track:
        if not np.isfinite(samples[:, 0]).all():
            raise FileError("a time is not finite; leave out rows without a time")
        samples = samples[np.isfinite(samples).all(axis=1)]
        steps = np.diff(samples[:, 0], prepend=-np.inf)
        if np.any(steps < 0.0):
            a, b = samples[(i := int(np.argmax(steps < 0.0))) - 1 : i + 1, 0]
            digits = next((n for n in range(9, 17) if f"{a:.{n}g}" != f"{b:.{n}g}"), 17)
            problem = f"times do not ascend: {a:.{digits}g} s is followed by {b:.{digits}g} s"
            raise FileError(f"{problem}; give one flight, in the order in which it was recorded")
        return Track(samples[steps > 0.0, 0] - epoch, scale * samples[steps > 0.0, 1:])

    tracks = {name: track(samples) for name, samples in bodies.items()}
    count = sum(map(len, bodies.values()))
    if omitted := count - sum(len(one.t) for one in tracks.values()):
        notes = [*notes, f"{omitted} of {count} rows omitted: no position, or a repeated time"]
    cloud = rows.get(MARKER, np.zeros((0, 4)))
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    cloud = cloud[np.argsort(cloud[:, 0], kind="stable")]
    return RecordedFlight(
        source,
        {name: one for name, one in tracks.items() if len(one.t)},
        Track(cloud[:, 0] - epoch, scale * cloud[:, 1:]),
        {name: track(samples) for name, samples in (setpoints or {}).items()},
        epoch,
        one_clock,
        tuple(notes),
        simulated or {},
    )


def read_simulated(path: Path) -> RecordedFlight:
    """Return the flight in a results directory of ``hitchopt simulate``."""
    rows, end = dict[str, Array](), np.inf
    for file, (kind, prefix) in TABLES.items():
        table = labelled_table(partial(text_lines, path / file), ("t", kind, "x"), file)
        values = table.numbers(["t", "x", "y", "z"], blanks=True)
        values[values[:, 0] > end] = np.nan  # Drones are recorded for longer
        end = float(np.max(values[:, 0]))
        for name, samples in _by_name(table.words(kind), values).items():
            rows[prefix + name] = samples[np.isfinite(samples).all(axis=1)]
    try:
        content = parsed_json((path / SUMMARY).read_text(encoding="utf-8"))
        loops = [content["position_loops"][name] for name in ("feed_forward", "integral")]
        enabled = [np.array([np.any(drone) for drone in loop]) for loop in loops]
        density = float(content["density"]["simulated"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"not a summary of this flight; simulate again ({error})"
        raise FileError(f"{path / SUMMARY}: {problem}") from error
    simulated = {"density": density, "feed_forward": enabled[0], "integral": enabled[1]}
    return flight_of("simulated flight", rows, simulated=simulated)


def table_of(
    lines: Iterable[str], separator: str, columns: Sequence[int]
) -> tuple[Array, dict[int, Array]]:
    """Return the first two columns (rows, 2), and points by their index into ``columns``.

    Points (m, 4) are row and position, in three columns each; blank cells, most of a wide table,
    are omitted. Reading stops at a blank line. Raises ValueError for cells that are no numbers.
    """
    head = list[list[float]]()
    points = {k: list[tuple[float, ...]]() for k in range(len(columns))}
    for row, line in enumerate(takewhile(lambda line: line.strip(BLANK), lines)):
        text = (line if separator == "," else line.replace(",", ".")).replace('"', "")
        cells = text.replace(" ", "").split(separator)
        cells += [""] * (max(columns, default=0) + 3 - len(cells))
        head.append([float(cell or "nan") for cell in cells[:2]])
        for k, j in enumerate(columns):
            if cells[j] and cells[j + 1] and cells[j + 2]:
                points[k].append((row, *map(float, cells[j : j + 3])))
    arrays = {k: np.array(point).reshape(-1, 4) for k, point in points.items()}
    return np.array(head).reshape(-1, 2), arrays


def rows_of(
    t: Array,
    points: Mapping[int, Array],
    labels: Sequence[str],
    unit: str,
    bodies: Collection[str] = (),
) -> tuple[dict[str, Array], list[str]]:
    """Return rows (m, 4) of bodies and of MARKER, and notes, from points of ``table_of``.

    Points that are not labelled as ``bodies`` are markers. Markers of one subject also form a body,
    at their mean while all of them are visible; those that are far from each other are bodies of
    their own, with the names of the markers.
    """
    rows, markers, notes = dict[str, Array](), [np.zeros((0, 4))], list[str]()
    subjects = defaultdict[str, dict[str, Array]](dict)
    for k, point in points.items():
        samples = np.column_stack([t[point[:, 0].astype(np.intp)], point[:, 1:]])
        label, subject = labels[k], labels[k].partition(":")[0]
        if label in bodies:
            rows[label] = samples
        else:
            markers.append(samples)
            if subject not in bodies and not label.casefold().startswith(UNLABELED):
                subjects[subject][label] = samples
    for subject, each in subjects.items():
        common = reduce(np.intersect1d, [samples[:, 0] for samples in each.values()])
        group = np.stack([samples[np.isin(samples[:, 0], common)] for samples in each.values()])
        middle = np.mean(group, axis=0)
        distances = np.max(np.linalg.norm((group - middle)[..., 1:], axis=-1), axis=0)
        radius = scale_of(unit) * float(np.median(distances)) if len(common) else 0.0
        if radius > BODY_RADIUS:
            own = {label: label.partition(":")[2] for label in each}
            rows |= {name if name not in rows else x: each[x] for x, name in own.items()}
            far = f"up to {radius:.2g} m from their middle"
            notes.append(f"markers of {subject} are bodies of their own: they are {far}")
        else:
            rows[subject] = middle
    return rows | {MARKER: np.concatenate(markers)}, notes


def read_motive(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Motive 1.21 to 1.25, by its row ``Frame`` and those above.

    Times follow from frame numbers, as printed times are truncated to milliseconds. Markers of
    rigid bodies are ignored: the table lists them twice, as expected and as measured.
    """
    lines = text_lines(path)
    top = list(islice(lines, MAX_HEADER_LINES))
    separator = top[0].lstrip('"')[len(MOTIVE) :].lstrip('"')[:1] or ","
    rows = [list(map(str.strip, cells)) for cells in csv.reader(top, delimiter=separator)]
    header = next((i for i, cells in enumerate(rows) if cells[:1] == ["Frame"]), 0)
    titles = [cells for cells in rows[1:header] if any(cells)]
    if len(titles) < 3:
        raise FileError("has no titles above a row 'Frame'; export it with its header")
    metadata = dict(zip(rows[0], rows[0][1:], strict=False))
    if metadata.get("Coordinate Space", "Global").casefold() != "global":
        raise FileError("is in Local space, each body in its own; export it in Global space")
    kinds, names = titles[:2]
    columns = [j for j, x in enumerate(titles[-1]) if (x, rows[header][j]) == ("Position", "X")]
    bodies = {names[j] for j in columns if kinds[j] == "Rigid Body"}
    subjects = [name.partition(":")[0] for name in names]
    markers = {j for j in columns if kinds[j] == "Marker" and subjects[j] not in bodies}
    columns = [j for j in columns if kinds[j] == "Rigid Body" or j in markers]
    head, points = table_of(chain(top[header + 1 :], lines), separator, columns)
    hertz = float(metadata.get("Export Frame Rate") or metadata["Capture Frame Rate"])
    t, notes = (head[:, 0] - head[0, 0]) / hertz + head[0, 1], list[str]()
    if np.any(np.abs(t - head[:, 1]) > TIME_TOLERANCE):
        t, notes = head[:, 1], [f"times are as printed: they differ from frames at {hertz:g} Hz"]
    length_unit = unit or metadata.get("Length Units", "")
    labels = [names[j] for j in columns]
    samples, row_notes = rows_of(t, points, labels, length_unit, bodies)
    notes += row_notes
    return flight_of(f"Motive CSV {metadata[MOTIVE]}", samples, length_unit, notes=notes)


def read_vicon(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a Vicon table with sections of bodies and of markers."""
    samples, lines, length_unit, notes = dict[str, Array](), text_lines(path), "m", list[str]()
    for title in (line.strip(BLANK) for line in lines):
        if title not in VICON:
            continue
        rate, *top = islice(lines, 4)
        hertz, separator = float(rate.strip(BLANK).replace(",", ".")), max(",;\t", key=top[1].count)
        if not hertz > 0.0:
            raise FileError(f"section {title}: a rate of {hertz:g} Hz; export it again")
        parsed = csv.reader(top, delimiter=separator)
        names, axes, units = (list(map(str.strip, cells)) for cells in parsed)
        columns = [j for j, x in enumerate(axes) if x == ("X" if title == VICON[-1] else "TX")]
        head, points = table_of(lines, separator, columns)
        points = {k: x[np.any(x[:, 1:] != 0.0, axis=1)] for k, x in points.items()}  # Gaps are 0
        labels = [next((name for name in names[j::-1] if name), "") for j in columns]
        if title != VICON[-1]:  # A subject, or segments of one
            subjects = [label.partition(":")[0] for label in labels]
            labels = [
                subject if subjects.count(subject) == 1 else label.partition(":")[2]
                for label, subject in zip(labels, subjects, strict=True)
            ]
        bodies = samples if title == VICON[-1] else labels
        length_unit = units[columns[0]] if columns else length_unit
        rows, row_notes = rows_of(head[:, 0] / hertz, points, labels, unit or length_unit, bodies)
        samples, notes = samples | rows, notes + row_notes
    return flight_of("Vicon CSV", samples, unit or length_unit, notes=notes)


library = partial(optional_module, purpose="reading it needs", extra="logs")
"""Return an optional module; UnsupportedError names the extra to install."""


def read_c3d(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a C3D file, with a body per subject."""
    with reading(path, "C3D file", Exception):
        content = library("ezc3d").c3d(str(path))
        parameters = content["parameters"]["POINT"]
        point = {name: each["value"] for name, each in parameters.items() if "value" in each}
        labels = [label for i in ("", *range(2, 99)) for label in point.get(f"LABELS{i}", ())]
        positions = np.asarray(content["data"]["points"], np.float64)[:3].T  # (frames, points, 3)
        visible = np.isfinite(positions).all(axis=2) & np.any(positions != 0.0, axis=2)
        samples = [
            np.column_stack([np.flatnonzero(x), y[x]])
            for x, y in zip(visible.T, positions.swapaxes(0, 1), strict=True)
        ]
        first, last = struct.unpack_from("<2H", path.read_bytes(), 6)  # As stated in the file
        frames, total = len(positions), last - first + 1
        notes = [f"truncated: read to frame {frames} of {total}"] if frames < total else []
        t = np.arange(frames) / float(point["RATE"][0])
        length_unit = unit or point["UNITS"][0]
        rows, row_notes = rows_of(t, dict(enumerate(samples)), labels, length_unit)
        return flight_of("C3D", rows, length_unit, notes=[*notes, *row_notes])


def read_bag(paths: Sequence[Path], unit: str | None, topic: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with or without definitions of its types."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for kind, text in MESSAGES.items():
        store.register(typesys.get_types_from_msg(text, kind))
    path, parents = paths[0].parent, dict[tuple[str, str], str]()
    path = path if (path / "metadata.yaml").is_file() else _single(paths)
    rows = defaultdict[tuple[str, str], list[Array]](list)  # Of frames by topic
    with (  # Exceptions of rosbags have no common base
        reading(path, "bag", Exception),
        highlevel.AnyReader([path], default_typestore=store) as bag,
    ):
        kinds = {c.topic: c.msgtype for c in bag.connections if c.msgcount}
        positions = {x: kind for x, kind in kinds.items() if kind in MESSAGE_TYPES and x != STATIC}
        if not positions:
            held = ", ".join(sorted(set(kinds.values())))
            raise FileError(f"holds none of {', '.join(MESSAGE_TYPES)}, but {held}")
        preferences = {kind: names_bodies for kind, (names_bodies, _) in MESSAGE_TYPES.items()}
        taken, notes = taken_topics(bag_topics(positions, preferences), topic)
        clouds = sorted(name for name, kind in kinds.items() if kind == CLOUD)
        names = {x.name for x in taken}.union(clouds[:1])
        used = [c for c in bag.connections if c.topic in names]
        for connection, received, data in bag.messages(used):
            message = bag.deserialize(data, connection.msgtype)
            if connection.msgtype == CLOUD:
                each = [(MARKER, message.header, points_of(message))]
            else:
                bodies = MESSAGE_TYPES[connection.msgtype][1](message)
                each = [(name, header, np.array([[p.x, p.y, p.z]])) for name, header, p in bodies]
            for name, header, points in each:
                t = 1e-9 * (10**9 * header.stamp.sec + header.stamp.nanosec or received)
                key = connection.topic, name.strip("/")
                rows[key].append(np.insert(points, 0, t, axis=1))
                parents[key] = header.frame_id.strip("/")
        markers = rows.pop((clouds[0], MARKER), []) if clouds else []
        joined = {key: np.concatenate(own) for key, own in rows.items()}
        merged, frame_notes = _bodies_of_frames(joined, parents, taken)
        merged |= {MARKER: np.concatenate(markers)} if markers else {}
    notes += frame_notes
    notes += [f"markers are of {clouds[0]}, not of {', '.join(clouds[1:])}"] if clouds[1:] else []
    return flight_of(f"ROS {'2' if bag.is2 else '1'} bag", merged, unit or "m", notes=notes)


def _bodies_of_frames(
    rows: Mapping[tuple[str, str], Array],
    parents: Mapping[tuple[str, str], str],
    topics: Sequence[Topic],
) -> tuple[dict[str, Array], list[str]]:
    """Return rows by body, and notes, from rows and parents of frames by topic.

    Frames with a moving parent are omitted. Raises FileError if two topics have the same body.
    """
    bodies, owners, omitted = dict[str, Array](), dict[str, Topic](), list[str]()
    for topic in topics:
        frames = [frame for name, frame in rows if name == topic.name]
        names = {frames[0]: topic.body} if len(frames) == 1 and topic.body else {}
        for frame, name in (names or distinct_names(frames)).items():
            parent = rows.get((topic.name, parents[topic.name, frame]))
            if parent is not None and np.max(np.ptp(parent[:, 1:], axis=0)) > MAX_FIXED:
                omitted.append(frame)
                continue
            body = name or topic.name.strip("/")
            if body in owners:
                both = " and ".join(sorted((owners[body].family, topic.family)))
                raise FileError(f"{body} has positions in {both}: choose one with topic=")
            bodies[body], owners[body] = rows[topic.name, frame], topic
    relative = [f"{', '.join(omitted)} omitted: positions in frames that move"] if omitted else []
    return bodies, relative


def points_of(message: Any) -> Array:
    """Return the points (k, 3) of a cloud of float32."""
    offsets = {field.name: field.offset for field in message.fields if field.datatype == FLOAT32}
    layout: Any = {"names": list("xyz"), "formats": ["<f4"] * 3}
    layout |= {"offsets": [offsets[axis] for axis in "xyz"], "itemsize": message.point_step}
    cloud: Any = np.frombuffer(bytes(message.data), layout, message.width * message.height)
    return np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)


def read_logs(
    source: str,
    read: Callable[[Path], tuple[dict[str, Array], list[str]]],
    paths: Sequence[Path],
    unit: str | None,
    topic: str | None,
) -> RecordedFlight:
    """Return the flight in drones' logs, whose file names are the drones' names.

    ``read`` returns rows of positions [m] by topic of LOG_TOPICS, and notes.
    """
    if unit is not None:
        raise FileError("is of a format with fixed units; leave unit= out")
    rows, commands, drones = (
        dict[str, Array](),
        dict[str, Array](),
        defaultdict[str, list[str]](list),
    )
    for path in paths:
        with reading(path, source, Exception):
            logged, file_notes = read(path)
            taken, topic_notes = taken_topics(log_topics(list(logged)), topic)
            if len(taken) > 1:
                both = " and ".join(each.name for each in taken)
                raise FileError(f"has positions in {both}: choose one with topic=")
            rows[path.stem] = logged[taken[0].name]
            command, command_notes = _setpoints(logged, taken[0].name)
            commands |= {} if command is None else {path.stem: command}
            for note in (*file_notes, *topic_notes, *command_notes):
                drones[note].append(path.stem)
    notes = [f"{', '.join(names)}: {note}" for note, names in drones.items()]
    return flight_of(source, rows, notes=notes, setpoints=commands, one_clock=len(paths) == 1)


def _setpoints(logged: Mapping[str, Array], taken: str) -> tuple[Array | None, list[str]]:
    """Return a drone's set points among topics of its log, and a note if they are of its load.

    Commands are the set points of the body that they are nearest to, at the median.
    """
    of_kind = {kind: name for name, kind in reversed(LOG_TOPICS.items()) if name in logged}
    command, load = of_kind.get("commanded"), of_kind.get("load")
    if command is None or load is None:
        return logged.get(command or ""), []

    def distance(topic: str) -> float:
        t, *at = logged[topic].T
        position = np.stack([np.interp(logged[command][:, 0], t, x) for x in at], axis=1)
        return float(np.nanmedian(np.linalg.norm(logged[command][:, 1:] - position, axis=1)))

    own, carried = distance(taken), distance(load)
    if own <= carried:
        return logged[command], []
    words = f"{carried:.2f} m from {load} at the median, and {own:.2f} m from {taken}"
    return None, [f"{command} is the target of the load, not of the drone: {words}"]


def read_usd(path: Path) -> tuple[dict[str, Array], list[str]]:
    """Return rows by topic, and notes, of a log of a Crazyflie's uSD card."""
    events, notes = usd_events(path.read_bytes())
    rows = dict[str, Array]()
    for topic, event in product(LOG_TOPICS, events):
        prefix = topic if topic.endswith(".p") else f"{topic}."
        axes = [f"{prefix}{axis}" for axis in "xyz"]
        if topic not in rows and set(axes) <= set(event):
            positions = [USD_SCALES.get(topic, 1.0) * event[axis] for axis in axes]
            samples = np.stack([event["t"], *positions], axis=1)
            if topic == HELD:
                steps = np.diff(samples[:, 1:], axis=0, prepend=0.0)
                samples = samples[np.any(steps != 0.0, axis=1)]
            rows |= {topic: samples} if len(samples) else {}
    if not rows.keys() & set(USD_POSITIONS):
        available = ", ".join(sorted({name for event in events for name in event}))
        expected = ", ".join(f"{each}.x" for each in USD_POSITIONS)
        raise FileError(f"logs none of {expected}, but {available[:200]}")
    return rows, notes


def usd_events(data: bytes) -> tuple[list[dict[str, Array]], list[str]]:
    """Return the variables of every event type, including ``t`` [s], and notes on damage.

    The header lists event types, each with a number and variables ``group.name(type)``. Records of
    events and a checksum follow.
    """
    version, event_types = struct.unpack_from("<HH", data, 1)
    if version not in {1, 2}:
        raise FileError(f"is of version {version}; 1 and 2 are supported")
    offset, kinds = 5, dict[int, Any]()
    for _ in range(event_types):
        number, offset = struct.unpack_from("<H", data, offset)[0], data.index(0, offset + 2) + 1
        (count,) = struct.unpack_from("<H", data, offset)
        offset, fields = offset + 2, list[tuple[str, str]]()
        for _ in range(count):
            end = data.index(0, offset)
            text, offset = data[offset:end].decode("ascii"), end + 1
            fields.append((text[:-3], f"<{text[-2]}"))
        kinds[number] = np.dtype([("", "<H"), ("t", "<I" if version == 1 else "<Q"), *fields])
    intact = len(data) >= offset + 4 and zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]
    end, records = len(data) - 4 * intact, defaultdict[int, bytearray](bytearray)
    while offset + 2 <= end:
        (number,) = struct.unpack_from("<H", data, offset)
        if number not in kinds or offset + (size := kinds[number].itemsize) > end:
            break
        records[number] += data[offset : offset + size]
        offset += size
    events, tick = list[dict[str, Array]](), 1e-3 if version == 1 else 1e-6
    for number, record in records.items():
        values: Any = np.frombuffer(record, kinds[number])
        events.append({name: values[name].astype(np.float64) for name in values.dtype.names})
        events[-1]["t"] *= tick
    last = max((event["t"][-1] for event in events), default=0.0)
    return events, [] if intact else [f"truncated or damaged: read to the record at {last:.3f} s"]


def read_ulog(path: Path) -> tuple[dict[str, Array], list[str]]:
    """Return rows by topic, and notes, of a PX4 ulog, converted from north, east, down."""
    with path.open("rb") as file:
        log = library("pyulog").ULog(file, list(ULOG_POSITIONS))
    rows = dict[str, Array]()
    for name, values in {topic.name: topic.data for topic in log.data_list[::-1]}.items():
        axes = "xyz" if "x" in values else [f"position[{i}]" for i in range(3)]
        north, east, down = (values[axis].astype(np.float64) for axis in axes)
        t = 1e-6 * values.get("timestamp_sample", values["timestamp"]).astype(np.float64)
        rows[name] = np.stack([t, east, north, -down], axis=1)
    if not rows:
        raise FileError(f"logs none of {', '.join(ULOG_POSITIONS)}")
    lost = sum(gap.duration for gap in log.dropouts)
    return rows, [f"{1e-3 * lost:.1f} s were not logged"] * bool(lost)


# Formats by their first bytes: names, and readers of all files of a format in a unit
TEXT = rb'^(\xef\xbb\xbf|\xff\xfe|\xfe\xff)?[\s"]*'
FORMATS: dict[bytes, tuple[str, Reader]] = {
    TEXT + MOTIVE.encode(): ("a table of Motive with its header", table_reader(read_motive)),
    TEXT + rb"(Segments|Objects|Trajectories)[\",;\s]": ("of Vicon", table_reader(read_vicon)),
    rb"^[\x01-\x1f]P": ("C3D", table_reader(read_c3d)),
    rb"^(SQLite format 3|\x89MCAP0\r\n|#ROSBAG V2\.0)": ("a ROS bag", read_bag),
    rb"^\xbc": ("Crazyflie uSD logs", partial(read_logs, "Crazyflie uSD log", read_usd)),
    rb"^ULog\x01\x12\x35": ("PX4 ulogs", partial(read_logs, "PX4 ulog", read_ulog)),
}
