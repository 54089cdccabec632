"""Reading recorded flights: formats are recognized by their first bytes, and units are doubted.

Readers return rows, time and position, of every label; one function makes bodies and markers of
them. Motion capture has one cloud of measured markers, whatever their labels, which swap and break
off; markers of the drones may be in it. Logs are one a drone, each with a clock that starts as the
drone boots.
"""

from __future__ import annotations

import csv
import re
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial, reduce
from importlib import import_module
from itertools import chain, islice, product, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.recordings import RecordedFlight, Track
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array, check_choice

# Units of length [m], and their names in files
UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
NAMES = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "inches": "in", "feet": "ft"}

MAX_DISTANCE = 50.0  # Median distance from the origin beyond which lengths are no metres [m]
MAX_STEP = 1.0  # Median step of times from which on they are no seconds [s]
CLOCKS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
RATES = (4.0, 3000.0)  # Rates at which flights are recorded [Hz]
ABSOLUTE = 1e7  # Times from which on they are a date, or those of a computer [s]

# Columns of a plain table, in any order and among others: time [s], a body (q0, r0, …, a vertex
# p0, …, or any name) or MARKER, a point without a name, and its position [m]
HEADER, MARKER = "t,name,x,y,z", "marker"

# Files of a simulated flight, whose tables have "vertex" and "drone" in place of "name"
TABLES, SUMMARY = {"vertices.csv": ("vertex", "p"), "drones.csv": ("drone", "")}, "simulation.json"

MOTIVE, VICON = "Format Version", ("Segments", "Objects", "Trajectories")
UNLABELED = ("*", "unlabel", "unidentified", "u_", MARKER)  # How labels of no subject begin
MAX_TITLES = 50  # Lines among which the titles of a table of Motive are searched
CUT = 2e-3  # Largest difference between a frame's time and the printed one [s], by rounding
BLANK = ' ",;\t'  # Characters of a line without a cell

POSE = "motion_capture_tracking_interfaces/msg/NamedPose"  # Messages of crazyswarm2
MESSAGES = {POSE: "string name\ngeometry_msgs/Pose pose\n"}
MESSAGES[f"{POSE}Array"] = f"std_msgs/Header header\n{POSE.replace('msg/', '')}[] poses\n"

# Messages with bodies, of which the first kind in a bag is read: name, header and position of each,
# from the parts of a topic and a message. Message with markers
Bodies = list[tuple[str, Any, Any]]
BODIES: dict[str, Callable[[Sequence[str], Any], Bodies]] = {
    f"{POSE}Array": lambda _, m: [(x.name, m.header, x.pose.position) for x in m.poses],
    "geometry_msgs/msg/PoseStamped": lambda topic, m: [(topic[-2:][0], m.header, m.pose.position)],
    "tf2_msgs/msg/TFMessage": lambda _, m: [
        (x.child_frame_id, x.header, x.transform.translation) for x in m.transforms
    ],
}
CLOUD, FLOAT32 = "sensor_msgs/msg/PointCloud2", 7

# Variables of a uSD log with positions and with commands, by preference, and their units [m]
USD_POSITIONS = {"stateEstimate": 1.0, "stateEstimateZ": 1e-3, "locSrv": 1.0}
USD_COMMANDS = {"ctrltarget": 1.0, "ctrltargetZ": 1e-3}

ULOG_POSITIONS = ("vehicle_visual_odometry", "vehicle_local_position")  # By preference


def read_flight(path: Path | str, unit: str | None = None) -> RecordedFlight:
    """Return the content of a recording in any of the known formats.

    Parameters
    ----------
    path: file, or directory of a bag, of a simulated flight, or of drones' logs.
    unit: of its lengths, ``m``, ``cm``, ``mm``, ``in`` or ``ft``; None: as it states, else metres.

    Raises
    ------
    FileError: no such file, an unknown format, a damaged file, or numbers that are no flight's.
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
                words = f"times of {name} step by {step:.4g} s: not in seconds"
                raise FileError(f"{words}; if they are {' or if '.join(units) or 'other units'}")
        positions = np.concatenate([track.positions for track in flight.tracks.values()])
        far = float(np.median(np.linalg.norm(positions, axis=1)))
        if far > MAX_DISTANCE and unit is None:
            words = f"positions are {far:.4g} m from the origin at the median"
            raise FileError(f"{words}, over {MAX_DISTANCE:g} m: millimetres? unit='mm'")
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
            heads[file] = stream.read(64).replace(b"\0", b"")  # Zeros of UTF-16
    for begin, (_, read) in FORMATS.items():
        if own := [file for file in files if re.match(begin, heads[file])]:
            return read(own, unit)
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
    """Return the rows (m, 4) of each name, in the order of names."""
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
    """Return the flight of rows (time [s], x, y, z [unit]) (m, 4) of every body, and of MARKER.

    ``setpoints`` are rows too; for others see ``RecordedFlight``. Rows without a position, or with
    their body's last time, are left out. Raises FileError for an unknown unit, or times that do not
    ascend.
    """
    word = unit.strip().casefold()
    scale, epoch = UNITS.get(NAMES.get(word, word), 0.0), 0.0
    if not scale:
        raise FileError(f"its unit of length, {unit!r}, is unknown; state unit='m', 'cm' or 'mm'")
    bodies = {name: own for name, own in rows.items() if name != MARKER and len(own)}
    begin = min((float(own[0, 0]) for own in bodies.values()), default=0.0)
    if one_clock and abs(begin) >= ABSOLUTE:
        epoch, words = begin, f"times count from the first position, at {begin:.3f} s"
        notes = [*notes, f"{words} of the recording's clock"]

    def track(own: Array) -> Track:
        if not np.isfinite(own[:, 0]).all():
            raise FileError("a time is not finite; leave out rows without a time")
        own = own[np.isfinite(own).all(axis=1)]
        steps = np.diff(own[:, 0], prepend=-np.inf)
        if np.any(steps < 0.0):
            a, b = own[(i := int(np.argmax(steps < 0.0))) - 1 : i + 1, 0]
            words = f"times do not ascend: {a:.9g} s is followed by {b:.9g} s"
            raise FileError(f"{words}; give one flight, in the order in which it was recorded")
        return Track(own[steps > 0.0, 0] - epoch, scale * own[steps > 0.0, 1:])

    tracks = {name: track(own) for name, own in bodies.items()}
    count = sum(map(len, bodies.values()))
    if lost := count - sum(len(each.t) for each in tracks.values()):
        notes = [*notes, f"{lost} of {count} rows have no position, or the same time: left out"]
    cloud = rows.get(MARKER, np.zeros((0, 4)))
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    cloud = cloud[np.argsort(cloud[:, 0], kind="stable")]
    return RecordedFlight(
        source,
        {name: each for name, each in tracks.items() if len(each.t)},
        Track(cloud[:, 0] - epoch, scale * cloud[:, 1:]),
        {name: track(own) for name, own in (setpoints or {}).items()},
        epoch,
        one_clock,
        tuple(notes),
        simulated or {},
    )


def read_simulated(path: Path) -> RecordedFlight:
    """Return the flight in the results of ``hitchopt simulate``."""
    rows, end = dict[str, Array](), np.inf
    for file, (kind, prefix) in TABLES.items():
        table = labelled_table(partial(text_lines, path / file), ("t", kind, "x"), file)
        values = table.numbers(["t", "x", "y", "z"], blanks=True)
        values[values[:, 0] > end] = np.nan  # Drones alone are recorded longer
        end = float(np.max(values[:, 0]))
        for name, own in _by_name(table.words(kind), values).items():
            rows[prefix + name] = own[np.isfinite(own).all(axis=1)]
    try:
        content = parsed_json((path / SUMMARY).read_text(encoding="utf-8"))
        loops = [content["position_loops"][name] for name in ("feed_forward", "integral")]
        on = [np.array([np.any(drone) for drone in loop]) for loop in loops]
        density = float(content["density"]["simulated"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        words = f"not a summary of this flight; simulate again ({error})"
        raise FileError(f"{path / SUMMARY}: {words}") from error
    simulated = {"density": density, "feed_forward": on[0], "integral": on[1]}
    return flight_of("simulated flight", rows, simulated=simulated)


def table_of(
    lines: Iterable[str], separator: str, firsts: Sequence[int]
) -> tuple[Array, dict[int, Array]]:
    """Return the first two columns (rows, 2), and the points in three columns from ``firsts``.

    Points (m, 4), of every index into ``firsts``, are row and position; blank ones, most of a wide
    table, are left out. Lines end at one without a cell. Raises ValueError for other cells.
    """
    heads, points = list[list[float]](), {k: list[tuple[float, ...]]() for k in range(len(firsts))}
    for row, line in enumerate(takewhile(lambda line: line.strip(BLANK), lines)):
        text = (line if separator == "," else line.replace(",", ".")).replace('"', "")
        cells = text.replace(" ", "").split(separator)
        cells += [""] * (max(firsts, default=0) + 3 - len(cells))
        heads.append([float(cell or "nan") for cell in cells[:2]])
        for k, j in enumerate(firsts):
            if cells[j] and cells[j + 1] and cells[j + 2]:
                points[k].append((row, *map(float, cells[j : j + 3])))
    seen = {k: np.array(own).reshape(-1, 4) for k, own in points.items()}
    return np.array(heads).reshape(-1, 2), seen


def rows_of(
    t: Array, points: Mapping[int, Array], labels: Sequence[str], bodies: Collection[str] = ()
) -> dict[str, Array]:
    """Return rows (m, 4) of bodies and of MARKER, from points as of ``table_of`` and their labels.

    All but those of ``bodies`` are markers; a subject's are also a body, at their mean while all
    are visible.
    """
    rows, loose = dict[str, Array](), [np.zeros((0, 4))]
    subjects = defaultdict[str, list[Array]](list)
    for k, own in points.items():
        seen = np.column_stack([t[own[:, 0].astype(np.intp)], own[:, 1:]])
        label, subject = labels[k], labels[k].partition(":")[0]
        if label in bodies:
            rows[label] = seen
        else:
            loose.append(seen)
            if subject not in bodies and not label.casefold().startswith(UNLABELED):
                subjects[subject].append(seen)
    for subject, each in subjects.items():
        common = reduce(np.intersect1d, [own[:, 0] for own in each])
        rows[subject] = np.mean([own[np.isin(own[:, 0], common)] for own in each], axis=0)
    return rows | {MARKER: np.concatenate(loose)}


def read_motive(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Motive 1.21 to 1.25, by its row ``Frame`` and those above.

    Times are those of frames, since printed ones are cut to milliseconds. A body's markers are left
    out: the table holds them as expected and as measured.
    """
    lines = text_lines(paths[0])
    top = list(islice(lines, MAX_TITLES))
    separator = top[0].lstrip('"')[len(MOTIVE) :].lstrip('"')[:1] or ","
    rows = [list(map(str.strip, cells)) for cells in csv.reader(top, delimiter=separator)]
    k = next((i for i, cells in enumerate(rows) if cells[:1] == ["Frame"]), 0)
    titles = [cells for cells in rows[1:k] if any(cells)]
    if len(titles) < 3:
        raise FileError("has no titles above a row 'Frame'; export it with its header")
    facts = dict(zip(rows[0], rows[0][1:], strict=False))
    if facts.get("Coordinate Space", "Global").casefold() != "global":
        raise FileError("is in Local space, each body in its own; export it in Global space")
    kinds, names = titles[:2]
    firsts = [j for j, x in enumerate(titles[-1]) if (x, rows[k][j]) == ("Position", "X")]
    bodies = {names[j] for j in firsts if kinds[j] == "Rigid Body"}
    loose = {j for j in firsts if names[j].partition(":")[0] not in bodies and kinds[j] == "Marker"}
    firsts = [j for j in firsts if kinds[j] == "Rigid Body" or j in loose]
    head, points = table_of(chain(top[k + 1 :], lines), separator, firsts)
    hertz = float(facts.get("Export Frame Rate") or facts["Capture Frame Rate"])
    t, notes = (head[:, 0] - head[0, 0]) / hertz + head[0, 1], list[str]()
    if np.any(np.abs(t - head[:, 1]) > CUT):
        t, notes = head[:, 1], [f"times are as printed: frames at {hertz:g} Hz have others"]
    seen = rows_of(t, points, [names[j] for j in firsts], bodies)
    stated = unit or facts.get("Length Units", "")
    return flight_of(f"Motive CSV {facts[MOTIVE]}", seen, stated, notes=notes)


def read_vicon(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Vicon: sections of bodies and of markers, at one rate."""
    seen, lines, stated = dict[str, Array](), text_lines(paths[0]), "m"
    for title in (line.strip(BLANK) for line in lines):
        if title not in VICON:
            continue
        rate, *top = islice(lines, 4)
        hertz, separator = float(rate.strip(BLANK).replace(",", ".")), max(",;\t", key=top[1].count)
        if not hertz > 0.0:
            raise FileError(f"section {title}: a rate of {hertz:g} Hz; export it again")
        parsed = csv.reader(top, delimiter=separator)
        names, axes, units = (list(map(str.strip, cells)) for cells in parsed)
        firsts = [j for j, axis in enumerate(axes) if axis == ("X" if title == VICON[-1] else "TX")]
        head, points = table_of(lines, separator, firsts)
        points = {k: x[np.any(x[:, 1:] != 0.0, axis=1)] for k, x in points.items()}  # Gaps are zero
        labels = [next((name for name in names[j::-1] if name), "") for j in firsts]
        if title != VICON[-1]:
            labels = [label.partition(":")[0] for label in labels]
        bodies = seen if title == VICON[-1] else labels
        seen |= rows_of(head[:, 0] / hertz, points, labels, bodies)
        stated = units[firsts[0]] if firsts else stated
    return flight_of("Vicon CSV", seen, unit or stated)


def library(module: str) -> Any:
    """Return a module that only some formats need; FileError names the extra to install."""
    try:
        return import_module(module)
    except ImportError as fault:
        words = f"reading it needs {module.partition('.')[0]} ({fault})"
        raise FileError(f"{words}; pip install 'hitchopt[logs]'") from fault


def read_c3d(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a C3D file; every subject is a body."""
    with reading(paths[0], "C3D file", Exception):
        content = library("ezc3d").c3d(str(paths[0]))
        parameters = content["parameters"]["POINT"]
        point = {name: each["value"] for name, each in parameters.items() if "value" in each}
        labels = [label for i in ("", *range(2, 99)) for label in point.get(f"LABELS{i}", ())]
        positions = np.asarray(content["data"]["points"], np.float64)[:3].T  # (frames, points, 3)
        visible = np.isfinite(positions).all(axis=2) & np.any(positions != 0.0, axis=2)
        seen = [
            np.column_stack([np.flatnonzero(x), y[x]])
            for x, y in zip(visible.T, positions.swapaxes(0, 1), strict=True)
        ]
        first, last = struct.unpack_from("<2H", paths[0].read_bytes(), 6)  # ezc3d's are those read
        frames, every = len(positions), last - first + 1
        notes = [f"is cut off: read to frame {frames} of {every}"] if frames < every else []
        rows = rows_of(np.arange(frames) / float(point["RATE"][0]), dict(enumerate(seen)), labels)
        return flight_of("C3D", rows, unit or point["UNITS"][0], notes=notes)


def read_bag(paths: Sequence[Path], unit: str | None) -> RecordedFlight:
    """Return the flight in a bag of ROS 1 or 2, with definitions of its types or without."""
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for kind, text in MESSAGES.items():
        store.register(typesys.get_types_from_msg(text, kind))
    rows, path = defaultdict[str, list[Array]](list), paths[0]
    path = path.parent if (path.parent / "metadata.yaml").is_file() else path
    with (  # Its exceptions have no common root
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
    """Return the points (k, 3) of a cloud, which are of float32."""
    offsets = {field.name: field.offset for field in message.fields if field.datatype == FLOAT32}
    layout: Any = {"names": list("xyz"), "formats": ["<f4"] * 3}
    layout |= {"offsets": [offsets[axis] for axis in "xyz"], "itemsize": message.point_step}
    cloud: Any = np.frombuffer(bytes(message.data), layout, message.width * message.height)
    return np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)


def read_logs(
    source: str, read: Callable[[Path], Any], paths: Sequence[Path], unit: str | None
) -> RecordedFlight:
    """Return the flight in logs of drones, a file each, named as the drone, in metres.

    ``read`` returns rows of positions, of commands or None, and notes.
    """
    if unit is not None:
        raise FileError("has lengths whose units its format fixes; leave unit= out")
    rows, commands, notes = dict[str, Array](), dict[str, Array](), list[str]()
    for path in paths:
        with reading(path, source, Exception):
            rows[path.stem], command, own = read(path)
            commands |= {} if command is None else {path.stem: command}
            notes += [f"{path.stem}: {note}" for note in own]
    return flight_of(source, rows, notes=notes, setpoints=commands, one_clock=len(paths) == 1)


def read_usd(path: Path) -> tuple[Array, Array | None, list[str]]:
    """Return positions, commands and notes of a log of a Crazyflie's uSD card."""
    events, notes = usd_events(path.read_bytes())

    def first(groups: Mapping[str, float]) -> tuple[str, Array | None]:
        for group, event in product(groups, events):
            axes = [f"{group}.{axis}" for axis in "xyz"]
            if set(axes) <= set(event):
                positions = [groups[group] * event[axis] for axis in axes]
                return group, np.stack([event["t"], *positions], axis=1)
        return "", None

    group, rows = first(USD_POSITIONS)
    if rows is None:
        logged = ", ".join(sorted({name for event in events for name in event}))
        expected = ", ".join(f"{each}.x" for each in USD_POSITIONS)
        raise FileError(f"logs none of {expected}, but {logged[:200]}")
    return rows, first(USD_COMMANDS)[1], [*notes, f"positions are of {group}"]


def usd_events(data: bytes) -> tuple[list[dict[str, Array]], list[str]]:
    """Return the variables of every kind of event, ``t`` [s] among them, and notes on damage.

    The header numbers kinds of events, each with a time and variables ``group.name(type)``; their
    records follow, and a checksum.
    """
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in {1, 2}:
        raise FileError(f"is of version {version}; 1 and 2 are known")
    at, kinds = 5, dict[int, Any]()
    for _ in range(count):
        number, at = struct.unpack_from("<H", data, at)[0], data.index(0, at + 2) + 1
        many, at, fields = struct.unpack_from("<H", data, at)[0], at + 2, list[tuple[str, str]]()
        for _ in range(many):
            end = data.index(0, at)
            text, at = data[at:end].decode("ascii"), end + 1
            fields.append((text[:-3], f"<{text[-2]}"))
        kinds[number] = np.dtype([("", "<H"), ("t", "<I" if version == 1 else "<Q"), *fields])
    whole = len(data) >= at + 4 and zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]
    end, records = len(data) - 4 * whole, defaultdict[int, bytearray](bytearray)
    while at + 2 <= end:
        (number,) = struct.unpack_from("<H", data, at)
        if number not in kinds or at + (size := kinds[number].itemsize) > end:
            break
        records[number] += data[at : at + size]
        at += size
    events, tick = list[dict[str, Array]](), 1e-3 if version == 1 else 1e-6
    for number, own in records.items():
        values: Any = np.frombuffer(own, kinds[number])
        events.append({name: values[name].astype(np.float64) for name in values.dtype.names})
        events[-1]["t"] *= tick
    last = max((event["t"][-1] for event in events), default=0.0)
    return events, [] if whole else [f"is cut off or damaged: read to its record at {last:.3f} s"]


def read_ulog(path: Path) -> tuple[Array, None, list[str]]:
    """Return positions and notes of a PX4 ulog, its axes turned from north, east, down.

    They count from the drone's own origin unless they are those of motion capture.
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


# First bytes of formats, their names, and their readers of all files of a kind and a unit
TEXT = rb'^(\xef\xbb\xbf|\xff\xfe|\xfe\xff)?[\s"]*'
FORMATS: dict[bytes, tuple[str, Callable[[Sequence[Path], str | None], RecordedFlight]]] = {
    TEXT + MOTIVE.encode(): ("a table of Motive with its header", read_motive),
    TEXT + rb"(Segments|Objects|Trajectories)[\",;\s]": ("of Vicon", read_vicon),
    rb"^[\x01-\x1f]P": ("C3D", read_c3d),
    rb"^(SQLite format 3|\x89MCAP0\r\n|#ROSBAG V2\.0)": ("a ROS bag", read_bag),
    rb"^\xbc": ("Crazyflie uSD logs", partial(read_logs, "Crazyflie uSD log", read_usd)),
    rb"^ULog\x01\x12\x35": ("PX4 ulogs", partial(read_logs, "PX4 ulog", read_ulog)),
}
