"""Readers of recorded flights. Formats are recognised by their first bytes, and units are checked.

Readers return rows of time and position by label, which ``flight_of`` converts to bodies and
markers. Motion capture yields one cloud of markers: labels are ignored, since they swap and end.
The cloud may contain the drones' own markers. Drones log one file each, on a clock that starts at
boot.
"""

from __future__ import annotations

import csv
import math
import re
import struct
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from itertools import chain, islice, takewhile
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.geometry.vectors import length
from hitchopt.lab.flights.bag_files import single_file
from hitchopt.lab.flights.bags import read_bag
from hitchopt.lab.flights.logs import read_cfclient, read_logs, read_ulog, read_usd
from hitchopt.lab.flights.recordings import (
    MARKER,
    UNITS,
    RecordedFlight,
    flight_of,
    library,
    positions_of,
    scale_of,
)
from hitchopt.storage.archive import reading
from hitchopt.storage.files import file_text, opened, parsed_json
from hitchopt.storage.tables import Table, labelled_table, numeric_table, text_lines
from hitchopt.values import Array, check_choice
from hitchopt.values import path as checked_path
from hitchopt.values.fields import suggest_keywords

MAX_DISTANCE = 50.0  # Largest median distance from the origin of lengths in metres [m]
MAX_STEP = 1.0  # Largest median step of times in seconds [s]
JUMP = 0.1  # Smallest jump back and forth between samples [m]
JUMP_SPEED = 10.0  # Smallest speed of such a jump [m/s]
MAX_JUMPS = 0.1  # Largest fraction of samples with such jumps
CLOCKS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
RATES = (4.0, 3000.0)  # Plausible sampling rates [Hz]

# Required columns of a plain table, in any order: time [s], the name of a body (q0, r0, …, a vertex
# p0, …, or any name) or MARKER for an unlabeled point, and its position [m]
HEADER = "t,name,x,y,z"
OWN_HEADER = "t,drone,x,y,z"  # Those of setpoints.csv and of exports, in the plan's axes

# Columns of names in the tables of a simulated flight, and prefixes of the names
TABLES = {"vertices.csv": ("vertex", "p"), "drones.csv": ("drone", "")}
SUMMARY = "simulation.json"  # Summary of a simulated flight

MOTIVE = "Format Version"  # Key in the header of files of Motive
VICON = ("Segments", "Objects", "Trajectories")  # Titles of sections in files of Vicon
UNLABELED = ("*", "unlabel", "unidentified", "u_", MARKER)  # Prefixes of labels without a subject
MAX_HEADER_LINES = 50  # Lines in which the titles of a table are searched
# Lines of a Qualisys header that name markers or bodies, and numbers of each of them in a row
QUALISYS_COLUMNS = {"MARKER_NAMES": 3, "BODY_NAMES": 16}
EXTERNAL = "ext"  # Their FREQUENCY if another clock triggers frames
TIME_TOLERANCE = 2e-3  # Largest rounding error of the printed time of a frame [s]
BODY_RADIUS = 0.3  # Largest distance of markers from the middle of their body [m]
NUMBERED = re.compile(r"(.+?)(?:_| - )(\d{1,3})")  # Names of markers with numbers
MIN_MARKERS = 3  # Smallest number of markers of a body
RIGID = 5e-3  # Largest standard deviation of a distance between two markers of a body [m]
BLANK = ' ",;\t'  # Characters of a line without content


@suggest_keywords
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
            raise FileError("contains no positions of bodies; record the drones")
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
            problem = f"the median distance of positions from the origin is {distance:.4g} m"
            raise FileError(f"{problem}, over {MAX_DISTANCE:g} m: millimetres? unit='mm'")
        return _without_jumping_bodies(flight)


def _without_jumping_bodies(flight: RecordedFlight) -> RecordedFlight:
    """Return a flight without bodies that jump back and forth; FileError if none is left."""
    tracks = dict(flight.tracks)
    notes = list[str]()
    for name, track in flight.tracks.items():
        steps, across = (length(track.positions[k:] - track.positions[:-k]) for k in (1, 2))
        there = (steps > JUMP) & (steps > JUMP_SPEED * np.diff(track.t))
        jumps = there[:-1] & there[1:] & (across < 0.5 * np.minimum(steps[:-1], steps[1:]))
        if np.sum(jumps) > MAX_JUMPS * len(track.t):
            size = f"back and forth by {np.median(steps[:-1][jumps]):.2g} m"
            share = f"{np.sum(jumps) / len(jumps):.0%} of its samples jump {size}"
            notes.append(f"{name} omitted: {share}, as if from two sources")
            del tracks[name]
    if not tracks:
        raise FileError("; ".join(notes))
    return replace(flight, tracks=tracks, notes=(*flight.notes, *notes))


def _read(path: Path, unit: str | None, topic: str | None) -> RecordedFlight:
    if not path.exists():
        raise FileError(f"{path}: there is no such file; name a recording")
    if all((path / name).is_file() for name in TABLES):
        _refuse_topic(topic)
        return read_simulated(path)
    files = sorted(x for x in path.iterdir() if x.is_file()) if path.is_dir() else [path]
    heads = dict[Path, bytes]()
    for file in files:
        with opened(file) as stream:
            heads[file] = stream.read(64).replace(b"\0", b"")  # Zero bytes of UTF-16
    for pattern, (_, read) in {**TABLE_FORMATS, **TOPIC_FORMATS}.items():
        if matching := [file for file in files if re.match(pattern, heads[file])]:
            if pattern in TOPIC_FORMATS:
                return read(matching, unit, topic)
            _refuse_topic(topic)
            return read(single_file(matching), unit)
    known = ", ".join(name for name, _ in (*TABLE_FORMATS.values(), *TOPIC_FORMATS.values()))
    known += f", the directory of a simulated flight, or a table with the columns {HEADER}"
    known += f" or {OWN_HEADER}"
    if path.is_dir():
        listed = ", ".join(each.name for each in files[:5]) or "no file"
        raise FileError(f"contains {listed}: no recording; name {known}")
    table, owner = _plain_table(path, known)
    _refuse_topic(topic)
    rows = table.numbers(["t", "x", "y", "z"], blanks=True)
    names = table.words(owner)
    return flight_of("table", positions_of(_by_name(names, rows)), unit or "m")


def _plain_table(path: Path, known: str) -> tuple[Table, str]:
    """Return a table with the columns of HEADER or OWN_HEADER, and its column of names."""
    refusal: FileError | None = None
    for header in (HEADER, OWN_HEADER):
        try:
            table = labelled_table(partial(text_lines, path), header.split(","), str(path))
        except FileError as error:
            refusal = refusal or error
        else:
            return table, header.split(",")[1]
    raise FileError(f"{refusal}; name {known}") from None


def _refuse_topic(topic: str | None) -> None:
    if topic is not None:
        raise FileError("has a format without topics; omit topic=")


def _by_name(names: Sequence[str], rows: Array) -> dict[str, Array]:
    """Return the rows (m, 4) of each name, in order of first occurrence."""
    return {name: rows[np.array(names) == name] for name in dict.fromkeys(names)}


def read_simulated(path: Path) -> RecordedFlight:
    """Return the flight in a results directory of ``hitchopt simulate``."""
    rows = dict[str, Array]()
    end = np.inf
    for file, (kind, prefix) in TABLES.items():
        table = labelled_table(partial(text_lines, path / file), ("t", kind, "x"), file)
        values = table.numbers(["t", "x", "y", "z"], blanks=True)
        values[values[:, 0] > end] = np.nan  # Drones are recorded for longer
        end = float(np.max(values[:, 0]))
        for name, samples in _by_name(table.words(kind), values).items():
            rows[prefix + name] = samples[np.isfinite(samples).all(axis=1)]
    try:
        content = parsed_json(file_text(path / SUMMARY))
        loops = [content["position_loops"][name] for name in ("feed_forward", "integral")]
        enabled = [np.array([np.any(drone) for drone in loop]) for loop in loops]
        density = float(content["density"]["simulated"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        problem = f"not a summary of this flight; simulate again ({error})"
        raise FileError(f"{path / SUMMARY}: {problem}") from error
    simulated = {"density": density, "feed_forward": enabled[0], "integral": enabled[1]}
    return flight_of("simulated flight", positions_of(rows), simulated=simulated)


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
    rows = dict[str, Array]()
    markers = [np.zeros((0, 4))]
    notes = list[str]()
    subjects = _subjects([label for label in labels if label not in bodies])
    by_subject = defaultdict[str, dict[str, Array]](dict)
    for k, point in points.items():
        label = labels[k]
        samples = np.column_stack([t[point[:, 0].astype(np.intp)], point[:, 1:]])
        if label in bodies:
            rows[label] = samples
            continue
        markers.append(samples)
        subject = subjects[label]
        if subject not in bodies and not label.casefold().startswith(UNLABELED):
            by_subject[subject][label] = samples
    for subject, samples_by_label in by_subject.items():
        common = reduce(np.intersect1d, [samples[:, 0] for samples in samples_by_label.values()])
        group = np.stack(
            [samples[np.isin(samples[:, 0], common)] for samples in samples_by_label.values()]
        )
        middle = np.mean(group, axis=0)
        radius = scale_of(unit) * _median_radius(group[..., 1:])
        is_numbered = ":" not in next(iter(samples_by_label))
        is_rigid = scale_of(unit) * _largest_strain(group[..., 1:]) <= RIGID
        if radius <= BODY_RADIUS and (is_rigid or not is_numbered):
            rows[subject] = middle
        elif is_numbered:  # Drones with numbers
            rows |= samples_by_label
        else:
            own_names = {label: label.partition(":")[2] for label in samples_by_label}
            rows |= {
                name if name not in rows else label: samples_by_label[label]
                for label, name in own_names.items()
            }
            far = f"up to {radius:.2g} m from their centre"
            notes.append(f"markers of {subject} are separate bodies: they are {far}")
    return rows | {MARKER: np.concatenate(markers)}, notes


def _subjects(labels: Sequence[str]) -> dict[str, str]:
    """Return the subjects of markers: ``NAME:…``, or ``NAME_1``, ``NAME_2``, … of at least three.

    Other markers are subjects of their own.
    """
    numbers = defaultdict[str, set[int]](set)
    for label in labels:
        if match := NUMBERED.fullmatch(label):
            numbers[match[1]].add(int(match[2]))
    numbered = {
        name
        for name, own in numbers.items()
        if own == set(range(1, max(MIN_MARKERS, len(own)) + 1))
    }
    subjects = dict[str, str]()
    for label in labels:
        match = NUMBERED.fullmatch(label)
        subjects[label] = match[1] if match and match[1] in numbered else label.partition(":")[0]
    return subjects


def _median_radius(group: Array) -> float:
    """Return the median over time of the largest distance from the middle of (markers, times, 3).

    Zero without times.
    """
    if not group.shape[1]:
        return 0.0
    from_middle = length(group - np.mean(group, axis=0))
    return float(np.median(np.max(from_middle, axis=0)))


def _largest_strain(group: Array) -> float:
    """Return the largest standard deviation over time of a distance within (markers, times, 3)."""
    if not group.shape[1]:
        return 0.0
    distances = length(group[:, None] - group[None])
    return float(np.max(np.std(distances, axis=2)))


def read_motive(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Motive 1.21 to 1.25, by its row ``Frame`` and those above.

    Times follow from frame numbers, since printed times are truncated to milliseconds. Markers of
    rigid bodies are ignored: the table lists them twice, as expected and as measured.
    """
    lines = text_lines(path)
    top = list(islice(lines, MAX_HEADER_LINES))
    separator = top[0].lstrip('"')[len(MOTIVE) :].lstrip('"')[:1] or ","
    rows = [list(map(str.strip, cells)) for cells in csv.reader(top, delimiter=separator)]
    header = next((i for i, cells in enumerate(rows) if cells[:1] == ["Frame"]), 0)
    titles = [cells for cells in rows[1:header] if any(cells)]
    if len(titles) < 3:
        raise FileError("has no column titles above the row 'Frame'; export it with its header")
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
    t = (head[:, 0] - head[0, 0]) / hertz + head[0, 1]
    notes = list[str]()
    if np.any(np.abs(t - head[:, 1]) > TIME_TOLERANCE):
        t = head[:, 1]
        notes = [f"times are as printed: they differ from frames at {hertz:g} Hz"]
    length_unit = unit or metadata.get("Length Units", "")
    labels = [names[j] for j in columns]
    samples, row_notes = rows_of(t, points, labels, length_unit, bodies)
    source = f"Motive CSV {metadata[MOTIVE]}"
    notes = notes + row_notes
    return flight_of(source, positions_of(samples), length_unit, notes=notes)


def read_vicon(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a Vicon table with sections of bodies and of markers."""
    samples = dict[str, Array]()
    lines = text_lines(path)
    length_unit = "m"
    notes = list[str]()
    for title in (line.strip(BLANK) for line in lines):
        if title not in VICON:
            continue
        rate, *top = islice(lines, 4)
        hertz = float(rate.strip(BLANK).replace(",", "."))
        separator = max(",;\t", key=top[1].count)
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
        samples = samples | rows
        notes = notes + row_notes
    return flight_of("Vicon CSV", positions_of(samples), unit or length_unit, notes=notes)


def read_qualisys(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a TSV table of Qualisys Track Manager, of markers or of rigid bodies.

    Times follow from the frequency: the header's time stamp is not that of the first frame. Those
    of an external clock are in the column Time. Gaps are blank, NULL or zeros.
    """
    lines = text_lines(path)
    header = dict[str, list[str]]()
    for line in islice(lines, MAX_HEADER_LINES):
        key, *values = line.strip(BLANK).split("\t")
        header[key] = values
        if key in QUALISYS_COLUMNS:
            break
    else:
        raise FileError(f"has no line {' or '.join(QUALISYS_COLUMNS)}; export it with its header")
    frequency = header.get("FREQUENCY", ["nan"])[0].strip()
    is_external = frequency.casefold() == EXTERNAL
    hertz = math.nan if is_external else float(frequency.replace(",", "."))
    if not (hertz > 0.0 or is_external):
        raise FileError(f"has a FREQUENCY of {hertz:g} Hz; export it again")
    names, width = header[key], QUALISYS_COLUMNS[key]
    titles = list[str]()
    first = ""
    for line in lines:
        if re.match(r"\s*[-+.\d]", line):
            first = line
            break
        if line.startswith(("Frame", "Time")) or line.rstrip("\t").endswith(("Z", "]")):
            titles = [title.strip() for title in line.split("\t")]
    columns = [j for j, title in enumerate(titles) if title.split(" ")[-1] == "X"]
    if len(columns) != len(names):  # No titles: at most the frame and its time come first
        before = len(first.strip("\t\n").split("\t")) - width * len(names)
        columns = [max(before, 0) + width * k for k in range(len(names))]
    gaps_blank = (re.sub(r"\bNULL\b", "", line) for line in chain([first], lines))
    rows, points = table_of(gaps_blank, "\t", columns)
    points = {k: x[np.any(x[:, 1:] != 0.0, axis=1)] for k, x in points.items()}  # Gaps are 0
    if is_external:  # Frames are triggered by another clock, which only this column has
        if "Time" not in titles[:2]:
            raise FileError("has a FREQUENCY of EXT, and no column Time; export it with times")
        t = rows[:, titles.index("Time")]
    else:
        t = np.arange(len(rows)) / hertz
    length_unit = unit or "mm"
    bodies = names if key == "BODY_NAMES" else ()
    samples, notes = rows_of(t, points, names, length_unit, bodies)
    return flight_of("Qualisys TSV", positions_of(samples), length_unit, notes=notes)


def read_c3d(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a C3D file, with a body per subject."""
    with reading(path, "C3D file", Exception):
        content = library("ezc3d").c3d(str(path))
        parameters = content["parameters"].get("POINT", {})
        point = {name: each["value"] for name, each in parameters.items() if "value" in each}
        positions = np.asarray(content["data"]["points"], np.float64)[:3].T  # (frames, points, 3)
        frames, count, _ = positions.shape
        if not count or not frames:
            raise FileError("contains no points; export the markers' or the bodies' positions")
        if not (hertz := float(next(iter(point.get("RATE", ())), 0.0))) > 0.0:
            raise FileError(f"states a rate of {hertz:g} Hz; export it again")
        length_unit = unit or next(iter(point.get("UNITS", ())), "").strip()
        if not length_unit:
            raise FileError("states no unit of length; state it: unit='mm', 'cm' or 'm'")
        labels = [label for i in ("", *range(2, 99)) for label in point.get(f"LABELS{i}", ())]
        labels += [f"*{k}" for k in range(len(labels), count)]
        visible = np.isfinite(positions).all(axis=2) & np.any(positions != 0.0, axis=2)
        samples = [
            np.column_stack([np.flatnonzero(is_seen), places[is_seen]])
            for is_seen, places in zip(visible.T, positions.swapaxes(0, 1), strict=True)
        ]
        with opened(path) as file:
            first, last = struct.unpack_from("<2H", file.read(10), 6)  # As stated in the file
        total = last - first + 1
        notes = [f"truncated: read to frame {frames} of {total}"] if frames < total else []
        t = np.arange(frames) / hertz
        rows, row_notes = rows_of(t, dict(enumerate(samples)), labels, length_unit)
        return flight_of("C3D", positions_of(rows), length_unit, notes=[*notes, *row_notes])


def read_tum(paths: Sequence[Path], unit: str | None, topic: str | None) -> RecordedFlight:
    """Return the flight in trajectories of TUM's benchmark, one file per body, on one clock.

    Rows are ``timestamp tx ty tz qx qy qz qw`` [s], [m]; attitudes are not read.
    """
    _refuse_topic(topic)
    rows = dict[str, Array]()
    for path in paths:
        with reading(path, "TUM trajectory"):
            rows[path.stem] = numeric_table(partial(text_lines, path), str(path)).numbers(range(4))
    return flight_of("TUM trajectory", positions_of(rows), unit or "m")


TEXT = rb'^(\xef\xbb\xbf|\xff\xfe|\xfe\xff)?[\s"]*'
Formats = dict[bytes, tuple[str, Callable[..., RecordedFlight]]]
"""Names and readers of formats by their first bytes."""

# Formats with one file per flight, read in a unit
TABLE_FORMATS: Formats = {
    TEXT + MOTIVE.encode(): ("a table of Motive with its header", read_motive),
    TEXT + rb"(Segments|Objects|Trajectories)[\",;\s]": ("of Vicon", read_vicon),
    TEXT + rb"(FILE_VERSION|NO_OF_FRAMES)\t": ("of Qualisys", read_qualisys),
    rb"^[\x01-\x1f]P": ("C3D", read_c3d),
}
# Formats with topics, of which all files of a directory are read
TOPIC_FORMATS: Formats = {
    rb"^(SQLite format 3|\x89MCAP0\r\n|#ROSBAG V2\.0|\x28\xb5\x2f\xfd)": ("a ROS bag", read_bag),
    rb"^\xbc": ("Crazyflie uSD logs", partial(read_logs, "Crazyflie uSD log", read_usd)),
    TEXT + rb"Timestamp,": ("cfclient logs", partial(read_logs, "cfclient log", read_cfclient)),
    rb"^ULog\x01\x12\x35": ("PX4 ulogs", partial(read_logs, "PX4 ulog", read_ulog)),
    rb"^(#\s*timestamp|([-+\d.eE]+ ){4})": ("TUM trajectories", read_tum),
}
