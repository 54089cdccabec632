"""Recordings of motion capture: tables of Motive, Vicon Nexus and QTM, and C3D files.

Times are those of frames: what tables print is cut to milliseconds. A body is what a table says is
one, else the mean of a subject's markers while all are seen. Measured markers are one cloud,
whatever their labels, which swap and break off; drones' own may be in it.
"""

from __future__ import annotations

import csv
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.flight import Markers, RecordedFlight, Track
from hitchopt.values import Array, Indices

# Units of length [m], by the names that files and users give them
UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
UNITS |= {"meters": 1.0, "centimeters": 0.01, "millimeters": 1e-3, "inches": 0.0254, "feet": 0.3048}

MOTIVE, QTM = "Format Version", "NO_OF_FRAMES"
VICON_BODIES, VICON = ("Segments", "Objects"), ("Segments", "Objects", "Trajectories")

UNLABELED = re.compile(r"\*|unlabel|unidentified|u_?\d+$|marker$", re.IGNORECASE)
TITLES = 50  # Lines among which a table's titles are looked for
CUT = 2e-3  # Largest difference between a frame's time and the printed one [s], by rounding

C3D_KEY, INTEL, BLOCK = 0x50, 84, 512


class Seen(NamedTuple):
    """Points of a table: the row and the label (k,) of each, and its place (k, 3)."""

    row: Indices
    label: Indices
    place: Array


class Cells(NamedTuple):
    """Numbers of a table in some of its columns, row by row; none where cells are blank."""

    rows: int
    row: Indices
    column: Indices
    value: Array

    @classmethod
    def of(cls, lines: Sequence[str], separator: str, columns: Collection[int]) -> Cells:
        """Return the numbers in columns of rows of text; ValueError for a cell that is none.

        Of thousands of columns, most cells are blank: bytes are searched for the others.
        """
        text = "\n".join(lines).replace(" ", "")
        text = text if separator == "," else text.replace(",", ".")
        data = np.frombuffer(f"{text}\n".encode(), np.uint8).copy()
        newlines = np.flatnonzero(data == ord("\n"))
        between = (data == ord("\n")) | (data == ord(separator))
        changes = np.flatnonzero(between[1:] != between[:-1]) + 1
        starts, ends = (changes if between[0] else np.append(0, changes)).reshape(-1, 2).T
        fields = np.flatnonzero(between)  # ends of all cells, blank ones too
        row = np.searchsorted(newlines, starts)
        first = np.append(0, np.searchsorted(fields, newlines) + 1)
        column = np.searchsorted(fields, ends) - first[row]
        wanted = np.isin(column, list(columns))
        for start, end in zip(starts[~wanted].tolist(), ends[~wanted].tolist(), strict=True):
            data[start:end] = ord(" ")
        data[between] = ord(" ")
        values = np.array(data.tobytes().decode().split(), np.float64)
        return cls(len(lines), row[wanted], column[wanted], values)

    def of_column(self, column: int) -> Array:
        """Return a column (rows,), nan where blank."""
        values, here = np.full(self.rows, np.nan), self.column == column
        values[self.row[here]] = self.value[here]
        return values

    def points(self, firsts: Sequence[int]) -> Seen:
        """Return what stands whole in three columns from each of ``firsts`` on."""
        place = np.full(max(firsts, default=0) + 3, -1)
        for i, j in enumerate(firsts):
            place[j : j + 3] = 3 * i + np.arange(3)
        chosen = self.column < len(place)
        key = place[self.column[chosen]]
        row, value, key = self.row[chosen][key >= 0], self.value[chosen][key >= 0], key[key >= 0]
        at = np.flatnonzero(key[:-2] % 3 == 0) if len(key) > 2 else np.zeros(0, np.intp)
        at = at[(key[at + 2] == key[at] + 2) & (row[at + 2] == row[at])]
        places = value[at[:, None] + np.arange(3)]
        whole = np.all(np.isfinite(places), axis=1)
        return Seen(row[at][whole], key[at][whole] // 3, places[whole])


def flight_of(
    source: str, t: Array, seen: Seen, labels: Sequence[str], bodies: Collection[str], **rest: Any
) -> RecordedFlight:
    """Return the flight of labelled points at times (rows,), which ascend.

    Points of ``bodies`` are tracks; others are markers, and those of a subject its track too.
    """
    if not np.all(np.diff(t) > 0.0):  # nan too
        i = int(np.argmin(np.diff(t) > 0.0))
        words = f"times do not ascend: {t[i]:.6g} s is followed by {t[i + 1]:.6g} s"
        raise FileError(f"{words}; export one take, from its first frame on")
    subjects = [label if label in bodies else label.partition(":")[0] for label in labels]
    body = np.array([label in bodies for label in labels], np.bool_)
    named = {
        subject: [i for i, each in enumerate(subjects) if each == subject and body[i] == is_body]
        for i, subject in enumerate(subjects)
        if not UNLABELED.match(labels[i])
        for is_body in (subject in bodies,)
    }
    tracks, ever = {}, np.bincount(seen.label, minlength=len(labels)) > 0
    for subject, all_own in named.items():
        own = [i for i in all_own if ever[i]]
        mine = np.isin(seen.label, own)
        count = np.bincount(seen.row[mine], minlength=len(t))
        whole = (count == len(own)) & (count > 0)
        sums = [np.bincount(seen.row[mine], x, len(t)) for x in seen.place[mine].T]
        if np.any(whole):
            tracks[subject] = Track(t[whole], (np.stack(sums, axis=1)[whole].T / count[whole]).T)
    loose = ~body[seen.label]
    order = np.argsort(seen.row[loose], kind="stable")
    cloud = Markers(t, seen.row[loose][order], seen.place[loose][order])
    return RecordedFlight(source, tracks, cloud, **rest)


def read_motive(lines: Sequence[str], unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Motive 1.21 to 1.25, from its row ``Frame`` and those above.

    A body's markers are left out: the table holds them as expected and as measured.
    """
    separator = lines[0].lstrip('"')[len(MOTIVE) :].lstrip('"')[:1] or ","
    top = [list(map(str.strip, x)) for x in csv.reader(lines[:TITLES], delimiter=separator)]
    k = next((i for i, cells in enumerate(top) if cells[:1] == ["Frame"]), 0)
    titles = [cells for cells in top[1:k] if any(cells)]
    if len(titles) < 3:
        raise FileError("has no titles above a row 'Frame'; export it with its header")
    facts = dict(zip(top[0], top[0][1:], strict=False))
    if facts.get("Coordinate Space", "Global").casefold() != "global":
        raise FileError("is in Local space, each body in its own; export it in Global space")
    width = len(top[k])
    kinds, names, quantities = (
        cells + [""] * (width - len(cells)) for cells in (*titles[:2], titles[-1])
    )
    firsts = [
        j
        for j in range(2, width - 2)
        if top[k][j : j + 3] == ["X", "Y", "Z"] and quantities[j : j + 3] == ["Position"] * 3
    ]
    bodies = {names[j] for j in firsts if kinds[j] == "Rigid Body"}
    firsts = [
        j
        for j in firsts
        if kinds[j] == "Rigid Body"
        or (kinds[j] == "Marker" and names[j].partition(":")[0] not in bodies)
    ]
    used = {0, 1}.union(*(range(j, j + 3) for j in firsts))
    cells = Cells.of(_until_blank(lines[k + 1 :]), separator, used)
    t, notes = _frame_times(
        cells, facts.get("Export Frame Rate") or facts.get("Capture Frame Rate")
    )
    seen, scale = cells.points(firsts), _scale(unit or facts.get("Length Units", ""))
    seen = seen._replace(place=scale * seen.place)
    rest: dict[str, Any] = {"up": "y", "notes": notes}
    source = f"Motive CSV {facts.get(MOTIVE, '')}"
    return flight_of(source, t, seen, [names[j] for j in firsts], bodies, **rest)


def _frame_times(cells: Cells, rate: str | None) -> tuple[Array, tuple[str, ...]]:
    """Return times of rows from their frames, else those printed, and notes on what was taken."""
    frames, printed = cells.of_column(0), cells.of_column(1)
    hertz = float(rate or 0.0)
    if hertz > 0.0:
        t = (frames - frames[:1]) / hertz + printed[:1]
        if np.all(np.abs(t - printed) <= CUT):
            return t, ()
    return printed, (f"times are as printed: frames at {hertz:g} Hz have others",)


def read_vicon(lines: Sequence[str], unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Vicon: sections of bodies and of markers, at one rate."""
    parts: list[tuple[str, Array, Seen, list[str]]] = []
    for k in range(len(lines)):
        title = lines[k].strip(' ",;\t')
        if title not in VICON or k + 4 > len(lines):
            continue
        rate, separator = lines[k + 1].strip(' ",;\t'), max(",;\t", key=lines[k + 3].count)
        rows = csv.reader(lines[k + 2 : k + 5], delimiter=separator)
        names, axes, units = (list(map(str.strip, cells)) for cells in rows)
        wanted = ["TX", "TY", "TZ"] if title in VICON_BODIES else ["X", "Y", "Z"]
        firsts = [j for j in range(2, len(axes)) if axes[j : j + 3] == wanted]
        used = {0}.union(*(range(j, j + 3) for j in firsts))
        cells = Cells.of(_until_blank(lines[k + 5 :]), separator, used)
        labels = [next((n for n in names[j::-1] if n), "") for j in firsts]
        seen = cells.points(firsts)
        scales = np.array([_scale(unit or units[j]) for j in firsts])
        seen = seen._replace(place=(seen.place.T * scales[seen.label]).T)
        hertz = float(rate.replace(",", "."))
        if not hertz > 0.0:
            raise FileError(f"section {title}: a rate of {rate!r} Hz; export it again")
        parts.append((title, cells.of_column(0) / hertz, seen, labels))
    if not parts:
        raise FileError(f"has none of the sections {', '.join(VICON)}; export one of them")
    t = np.unique(np.concatenate([each for _, each, _, _ in parts]))
    total, bodies, all_labels, merged = 0, set(), [], []
    for title, own, seen, given in parts:
        if not np.all(np.diff(own) > 0.0):
            raise FileError(f"section {title}: frames do not ascend; export one take")
        labels, plain = given, [label.partition(":")[0] for label in given]
        if title in VICON_BODIES:
            labels = plain if len(set(plain)) == len(plain) else given
            bodies |= set(labels)
        row = np.searchsorted(t, own)[seen.row]
        present = np.any(seen.place != 0.0, axis=1)  # zeros stand for gaps
        merged.append(Seen(row[present], seen.label[present] + total, seen.place[present]))
        all_labels += labels
        total += len(labels)
    whole = Seen(*(np.concatenate(each) for each in zip(*merged, strict=True)))
    return flight_of("Vicon CSV", t, whole, all_labels, bodies, up="z")


def read_qtm(lines: Sequence[str], unit: str | None) -> RecordedFlight:
    """Return the flight in a table of QTM: its head ends with the names of markers."""
    head: dict[str, list[str]] = {}
    k = 0
    for k, line in enumerate(lines):  # noqa: B007
        key, *values = map(str.strip, line.split("\t"))
        if re.match(r"frame$|-?[\d.,]+$", key, re.IGNORECASE):
            break
        head[key] = values
    labels, rate = head.get("MARKER_NAMES"), head.get("FREQUENCY", ["0"])[0]
    if not labels:
        raise FileError("names no MARKER_NAMES; export 3D data with its header")
    counted = lines[k].casefold().startswith("frame")
    offset, hertz = 2 * counted, float(rate.replace(",", "."))
    if not hertz > 0.0:
        raise FileError(f"states a FREQUENCY of {rate}; export it with an internal timebase")
    firsts = [offset + 3 * i for i in range(len(labels))]
    rows = _until_blank(lines[k + counted :])
    cells = Cells.of(rows, "\t", range(offset, offset + 3 * len(labels)))
    seen = cells.points(firsts)
    present = np.any(seen.place != 0.0, axis=1)
    seen = Seen(seen.row[present], seen.label[present], _scale(unit or "mm") * seen.place[present])
    return flight_of("QTM TSV", np.arange(len(rows)) / hertz, seen, labels, (), up="z")


def _until_blank(lines: Sequence[str]) -> Sequence[str]:
    """Return the lines before the first one without a cell."""
    return lines[: next((i for i, x in enumerate(lines) if not x.strip(' ",;\t')), len(lines))]


def _scale(unit: str) -> float:
    """Return a unit of length [m]; FileError for one that is not known."""
    scale = UNITS.get(unit.strip().casefold().replace("metre", "meter"))
    if scale is None:
        raise FileError(f"its unit of length, {unit!r}, is unknown; state --unit m, cm or mm")
    return scale


def read_c3d(data: bytes, unit: str | None) -> RecordedFlight:
    """Return the flight in the bytes of a C3D file, of processors with Intel's order of bytes."""
    (_, points, analog, first, last), (scale, start) = (
        struct.unpack_from("<HHHHH", data),
        struct.unpack_from("<fH", data, 12),
    )
    facts = _c3d_parameters(data, BLOCK * (data[0] - 1))
    rate, unit = float(facts.get("RATE", 0.0)), unit or facts.get("UNITS", "")
    labels = [label for i in ("", *range(2, 99)) for label in facts.get(f"LABELS{i}", ())]
    if not (points and rate > 0.0 and len(labels) >= points):
        raise FileError(f"has {points} points, {len(labels)} labels, {rate:g} Hz; export it again")
    real = facts.get("SCALE", scale) < 0.0
    kind, begin = np.dtype("<f4" if real else "<i2"), BLOCK * (start - 1)
    size = (4 * points + analog) * kind.itemsize
    frames = int(facts.get("FRAMES", 0)) % 2**16  # beyond that the header's count is cut too
    frames = max(frames, last - first + 1)
    whole = min(frames, max(0, len(data) - begin) // size)
    values = np.frombuffer(data, kind, whole * (size // kind.itemsize), max(begin, 0))
    with np.errstate(invalid="ignore"):  # of what is nan
        places = values.reshape(whole, -1)[:, : 4 * points].astype(np.float64)
    places = places.reshape(whole, points, 4)
    lost = (places[..., 3] < 0.0) | ~np.all(np.isfinite(places[..., :3]), axis=-1)
    lost |= np.all(places[..., :3] == 0.0, axis=-1)
    row, label = np.nonzero(~lost)
    factor = _scale(unit) * (1.0 if real else float(facts.get("SCALE", scale)))
    seen = Seen(row, label, factor * places[row, label, :3])
    notes = (f"is cut off: read to frame {whole} of {frames}",) if whole < frames else ()
    t = np.arange(whole) / rate
    return flight_of("C3D", t, seen, labels[:points], (), notes=notes)


def _c3d_parameters(data: bytes, at: int) -> Mapping[str, Any]:
    """Return the parameters of the group POINT: numbers, and lists of labels."""
    if data[at + 3] != INTEL:
        raise FileError("is of a processor other than Intel's; convert it")
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Any] = {}
    at += 4
    while True:
        length, group = struct.unpack_from("<bb", data, at)
        end = at + 2 + abs(length)
        name = data[at + 2 : end].decode("ascii").upper()
        (step,) = struct.unpack_from("<H", data, end)
        if not length:
            break
        if group < 0:
            groups[-group] = name
        else:
            found[group, name] = _c3d_value(data, end + 2)
        if not step:
            break
        at = end + step
    point = next((number for number, name in groups.items() if name == "POINT"), 0)
    return {name: value for (group, name), value in found.items() if group == point}


def _c3d_value(data: bytes, at: int) -> Any:
    """Return a parameter: a number, an array, a text, or the texts of a matrix of characters."""
    size, count = struct.unpack_from("<bB", data, at)
    shape = list(data[at + 2 : at + 2 + count])
    begin = at + 2 + count
    if size == -1:
        width, rows = (shape + [1])[0], int(np.prod(shape[1:]))
        text = data[begin : begin + width * rows].decode("latin-1")
        texts = [text[i * width : (i + 1) * width].strip(" \0") for i in range(rows)]
        return texts if count > 1 else texts[0]
    kind = {1: "u1", 2: "<i2", 4: "<f4"}[size]
    values = np.frombuffer(data, kind, int(np.prod(shape)), begin)
    return values[0] if values.size == 1 else values
