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
from functools import partial, reduce
from itertools import chain, islice, product, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, optional_module
from hitchopt.flights.recordings import RecordedFlight, Track
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array, check_choice

# Units of length [m], and names of units in files
UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
NAMES = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "inches": "in", "feet": "ft"}

MAX_DISTANCE = 50.0  # Largest median distance from the origin of lengths in metres [m]
MAX_STEP = 1.0  # Largest median step of times in seconds [s]
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
BLANK = ' ",;\t'  # Characters of a line without content

POSE = "motion_capture_tracking_interfaces/msg/NamedPose"  # Messages of crazyswarm2
MESSAGES = {POSE: "string name\ngeometry_msgs/Pose pose\n"}
MESSAGES[f"{POSE}Array"] = f"std_msgs/Header header\n{POSE.replace('msg/', '')}[] poses\n"

# Message types with bodies, by preference, and functions that return name, header and position of
# each body from the parts of a topic and a message; type with markers
Bodies = list[tuple[str, Any, Any]]
BODIES: dict[str, Callable[[Sequence[str], Any], Bodies]] = {
    f"{POSE}Array": lambda _, m: [(x.name, m.header, x.pose.position) for x in m.poses],
    "geometry_msgs/msg/PoseStamped": lambda topic, m: [(topic[-2:][0], m.header, m.pose.position)],
    "tf2_msgs/msg/TFMessage": lambda _, m: [
        (x.child_frame_id, x.header, x.transform.translation) for x in m.transforms
    ],
}
CLOUD, FLOAT32 = "sensor_msgs/msg/PointCloud2", 7

# Variables of a uSD log with positions and with commands, by preference, and their scales [m]
USD_POSITIONS = {"stateEstimate": 1.0, "stateEstimateZ": 1e-3, "locSrv": 1.0}
USD_COMMANDS = {"ctrltarget": 1.0, "ctrltargetZ": 1e-3}

ULOG_POSITIONS = ("vehicle_visual_odometry", "vehicle_local_position")  # By preference


def read_flight(path: Path | str, unit: str | None = None) -> RecordedFlight:
    """Return the content of a recording in a supported format.

    Parameters
    ----------
    path: file, or directory of a bag, a simulated flight or drones' logs.
    unit: of lengths: ``m``, ``cm``, ``mm``, ``in`` or ``ft``; None: as stated, else metres.

    Raises
    ------
    FileError: a missing or damaged file, an unknown format, or implausible times or positions.
    InputError: an unknown unit.
    """
    path = Path(path)
    if unit is not None:
        check_choice("unit", unit, tuple(UNITS))
    with reading(path, "recording"):
        flight = _read(path, unit)
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
        return flight


def _read(path: Path, unit: str | None) -> RecordedFlight:
    if not path.exists():
        raise FileError(f"{path}: there is no such file; give a recording")
    if all((path / name).is_file() for name in TABLES):
        return read_simulated(path)
    files = sorted(x for x in path.iterdir() if x.is_file()) if path.is_dir() else [path]
    heads = dict[Path, bytes]()
    for file in files:
        with file.open("rb") as stream:
            heads[file] = stream.read(64).replace(b"\0", b"")  # Zero bytes of UTF-16
    for pattern, (_, read) in FORMATS.items():
        if matching := [file for file in files if re.match(pattern, heads[file])]:
            return read(matching, unit)
    known = ", ".join(name for name, _ in FORMATS.values())
    known += f", the directory of a simulated flight, or a table with the columns {HEADER}"
    if path.is_dir():
        listed = ", ".join(each.name for each in files[:5]) or "no file"
        raise FileError(f"holds {listed}: no recording; give {known}")
    try:
        table = labelled_table(partial(text_lines, path), HEADER.split(","), str(path))
    except FileError as error:
        raise FileError(f"{error}; give {known}") from None
    rows, names = table.numbers(["t", "x", "y", "z"], blanks=True), table.words("name")
    return flight_of("table", _by_name(names, rows), unit or "m")


def _by_name(names: Sequence[str], rows: Array) -> dict[str, Array]:
    """Return the rows (m, 4) of each name, in order of first occurrence."""
    return {name: rows[np.array(names) == name] for name in dict.fromkeys(names)}


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
    word = unit.strip().casefold()
    scale, epoch = UNITS.get(NAMES.get(word, word), 0.0), 0.0
    if not scale:
        raise FileError(f"its unit of length, {unit!r}, is unknown; state unit='m', 'cm' or 'mm'")
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
            problem = f"times do not ascend: {a:.9g} s is followed by {b:.9g} s"
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
    t: Array, points: Mapping[int, Array], labels: Sequence[str], bodies: Collection[str] = ()
) -> dict[str, Array]:
    """Return rows (m, 4) of bodies and of MARKER, from points of ``table_of`` and their labels.

    Points that are not labelled as ``bodies`` are markers. Markers of one subject also form a body,
    at their mean while all of them are visible.
    """
    rows, markers = dict[str, Array](), [np.zeros((0, 4))]
    subjects = defaultdict[str, list[Array]](list)
    for k, point in points.items():
        samples = np.column_stack([t[point[:, 0].astype(np.intp)], point[:, 1:]])
        label, subject = labels[k], labels[k].partition(":")[0]
        if label in bodies:
            rows[label] = samples
        else:
            markers.append(samples)
            if subject not in bodies and not label.casefold().startswith(UNLABELED):
                subjects[subject].append(samples)
    for subject, each in subjects.items():
        common = reduce(np.intersect1d, [point[:, 0] for point in each])
        rows[subject] = np.mean([point[np.isin(point[:, 0], common)] for point in each], axis=0)
    return rows | {MARKER: np.concatenate(markers)}


def read_motive(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Motive 1.21 to 1.25, by its row ``Frame`` and those above.

    Times follow from frame numbers, as printed times are truncated to milliseconds. Markers of
    rigid bodies are ignored: the table lists them twice, as expected and as measured.
    """
    lines = text_lines(paths[0])
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
    samples = rows_of(t, points, [names[j] for j in columns], bodies)
    length_unit = unit or metadata.get("Length Units", "")
    return flight_of(f"Motive CSV {metadata[MOTIVE]}", samples, length_unit, notes=notes)


def read_vicon(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a Vicon table with sections of bodies and of markers."""
    samples, lines, length_unit = dict[str, Array](), text_lines(paths[0]), "m"
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
        if title != VICON[-1]:
            labels = [label.partition(":")[0] for label in labels]
        bodies = samples if title == VICON[-1] else labels
        samples |= rows_of(head[:, 0] / hertz, points, labels, bodies)
        length_unit = units[columns[0]] if columns else length_unit
    return flight_of("Vicon CSV", samples, unit or length_unit)


library = partial(optional_module, purpose="reading it needs", extra="logs", kind=FileError)
"""Return an optional module; FileError names the extra to install."""


def read_c3d(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a C3D file, with a body per subject."""
    with reading(paths[0], "C3D file", Exception):
        content = library("ezc3d").c3d(str(paths[0]))
        parameters = content["parameters"]["POINT"]
        point = {name: each["value"] for name, each in parameters.items() if "value" in each}
        labels = [label for i in ("", *range(2, 99)) for label in point.get(f"LABELS{i}", ())]
        positions = np.asarray(content["data"]["points"], np.float64)[:3].T  # (frames, points, 3)
        visible = np.isfinite(positions).all(axis=2) & np.any(positions != 0.0, axis=2)
        samples = [
            np.column_stack([np.flatnonzero(x), y[x]])
            for x, y in zip(visible.T, positions.swapaxes(0, 1), strict=True)
        ]
        first, last = struct.unpack_from("<2H", paths[0].read_bytes(), 6)  # As stated in the file
        frames, total = len(positions), last - first + 1
        notes = [f"truncated: read to frame {frames} of {total}"] if frames < total else []
        t = np.arange(frames) / float(point["RATE"][0])
        rows = rows_of(t, dict(enumerate(samples)), labels)
        return flight_of("C3D", rows, unit or point["UNITS"][0], notes=notes)


def read_bag(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with or without definitions of its types."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for kind, text in MESSAGES.items():
        store.register(typesys.get_types_from_msg(text, kind))
    rows, path = defaultdict[str, list[Array]](list), paths[0]
    path = path.parent if (path.parent / "metadata.yaml").is_file() else path
    with (  # Exceptions of rosbags have no common base
        reading(path, "bag", Exception),
        highlevel.AnyReader([path], default_typestore=store) as bag,
    ):
        kinds = {connection.msgtype for connection in bag.connections}
        chosen = next((kind for kind in BODIES if kind in kinds), None)
        if chosen is None:
            raise FileError(f"holds none of {', '.join(BODIES)}, but {', '.join(sorted(kinds))}")
        clouds = sorted({c.topic for c in bag.connections if c.msgtype == CLOUD})
        used = [c for c in bag.connections if c.msgtype == chosen or c.topic in clouds[:1]]
        for connection, received, data in bag.messages(used):
            message = bag.deserialize(data, connection.msgtype)
            if connection.msgtype == CLOUD:
                each = [(MARKER, message.header, points_of(message))]
            else:
                bodies = BODIES[chosen](connection.topic.strip("/").split("/"), message)
                each = [(name, header, np.array([[p.x, p.y, p.z]])) for name, header, p in bodies]
            for name, header, positions in each:
                t = 1e-9 * (10**9 * header.stamp.sec + header.stamp.nanosec or received)
                rows[name].append(np.insert(positions, 0, t, axis=1))
    notes = [f"markers are of {clouds[0]}, not of {', '.join(clouds[1:])}"] if clouds[1:] else []
    merged = {name: np.concatenate(own) for name, own in rows.items()}
    return flight_of(f"ROS {'2' if bag.is2 else '1'} bag", merged, unit or "m", notes=notes)


def points_of(message: Any) -> Array:
    """Return the points (k, 3) of a cloud of float32."""
    offsets = {field.name: field.offset for field in message.fields if field.datatype == FLOAT32}
    layout: Any = {"names": list("xyz"), "formats": ["<f4"] * 3}
    layout |= {"offsets": [offsets[axis] for axis in "xyz"], "itemsize": message.point_step}
    cloud: Any = np.frombuffer(bytes(message.data), layout, message.width * message.height)
    return np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)


def read_logs(
    source: str, read: Callable[[Path], Any], paths: Sequence[Path], unit: str | None
) -> RecordedFlight:
    """Return the flight in drones' logs, whose file names are the drones' names.

    ``read`` returns rows of positions [m], rows of commands or None, and notes.
    """
    if unit is not None:
        raise FileError("is of a format with fixed units; leave unit= out")
    rows, commands, notes = dict[str, Array](), dict[str, Array](), list[str]()
    for path in paths:
        with reading(path, source, Exception):
            rows[path.stem], command, file_notes = read(path)
            commands |= {} if command is None else {path.stem: command}
            notes += [f"{path.stem}: {note}" for note in file_notes]
    return flight_of(source, rows, notes=notes, setpoints=commands, one_clock=len(paths) == 1)


def read_usd(path: Path) -> tuple[Array, Array | None, list[str]]:
    """Return positions, commands and notes of a log of a Crazyflie's uSD card."""
    events, notes = usd_events(path.read_bytes())

    def logged_rows(groups: Mapping[str, float]) -> tuple[str, Array | None]:
        for group, event in product(groups, events):
            axes = [f"{group}.{axis}" for axis in "xyz"]
            if set(axes) <= set(event):
                positions = [groups[group] * event[axis] for axis in axes]
                return group, np.stack([event["t"], *positions], axis=1)
        return "", None

    group, rows = logged_rows(USD_POSITIONS)
    if rows is None:
        available = ", ".join(sorted({name for event in events for name in event}))
        expected = ", ".join(f"{each}.x" for each in USD_POSITIONS)
        raise FileError(f"logs none of {expected}, but {available[:200]}")
    return rows, logged_rows(USD_COMMANDS)[1], [*notes, f"positions are of {group}"]


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


def read_ulog(path: Path) -> tuple[Array, None, list[str]]:
    """Return positions and notes of a PX4 ulog, converted from north, east, down.

    Positions of motion capture are preferred; others count from the drone's own origin.
    """
    with path.open("rb") as file:
        log = library("pyulog").ULog(file, list(ULOG_POSITIONS))
    topics = {topic.name: topic.data for topic in log.data_list[::-1]}
    topic = next((name for name in ULOG_POSITIONS if name in topics), None)
    if topic is None:
        raise FileError(f"logs none of {', '.join(ULOG_POSITIONS)}")
    values = topics[topic]
    axes = "xyz" if "x" in values else [f"position[{i}]" for i in range(3)]
    north, east, down = (values[axis].astype(np.float64) for axis in axes)
    t = 1e-6 * values.get("timestamp_sample", values["timestamp"]).astype(np.float64)
    own = ", from the drone's own origin" if topic != ULOG_POSITIONS[0] else ""
    notes, lost = [f"positions are of {topic}{own}"], sum(gap.duration for gap in log.dropouts)
    notes += [f"{1e-3 * lost:.1f} s were not logged"] * bool(lost)
    return np.stack([t, east, north, -down], axis=1), None, notes


# Formats by their first bytes: names, and readers of all files of a format in a unit
TEXT = rb'^(\xef\xbb\xbf|\xff\xfe|\xfe\xff)?[\s"]*'
FORMATS: dict[bytes, tuple[str, Callable[[Sequence[Path], str | None], RecordedFlight]]] = {
    TEXT + MOTIVE.encode(): ("a table of Motive with its header", read_motive),
    TEXT + rb"(Segments|Objects|Trajectories)[\",;\s]": ("of Vicon", read_vicon),
    rb"^[\x01-\x1f]P": ("C3D", read_c3d),
    rb"^(SQLite format 3|\x89MCAP0\r\n|#ROSBAG V2\.0)": ("a ROS bag", read_bag),
    rb"^\xbc": ("Crazyflie uSD logs", partial(read_logs, "Crazyflie uSD log", read_usd)),
    rb"^ULog\x01\x12\x35": ("PX4 ulogs", partial(read_logs, "PX4 ulog", read_ulog)),
}
