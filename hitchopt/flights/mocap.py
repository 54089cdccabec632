"""Recordings of motion capture: tables of Motive and of Vicon Nexus, and C3D files.

Times are those of frames, since tables print them to milliseconds only. A body is one that a table
names, else the mean of a subject's markers while all are visible. Measured markers are one cloud,
whatever their labels, which swap and break off; markers of the drones may be in it.
"""

from __future__ import annotations

import csv
import struct
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from functools import reduce
from itertools import chain, islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.recordings import MARKER, RecordedFlight, flight_of, library
from hitchopt.storage.archive import reading
from hitchopt.storage.tables import text_lines
from hitchopt.values import Array

MOTIVE, VICON = "Format Version", ("Segments", "Objects", "Trajectories")
UNLABELED = ("*", "unlabel", "unidentified", "u_", MARKER)  # How labels of no subject begin
MAX_TITLES = 50  # Lines among which the titles of a table of Motive are searched
CUT = 2e-3  # Largest difference between a frame's time and the printed one [s], by rounding
BLANK = ' ",;\t'  # Characters of a line without a cell


def points_in(lines: Iterable[str], separator: str, firsts: Sequence[int]) -> tuple[Array, Array]:
    """Return the first two columns (rows, 2), and the points in three columns from ``firsts``.

    Points (k, 5) are row, index into ``firsts`` and position; those with a blank cell are left out.
    Lines end at one without a cell. Raises ValueError for cells that are no numbers.
    """
    heads, points = list[list[float]](), [np.zeros((0, 5))]
    for row, line in enumerate(lines):
        text = line if separator == "," else line.replace(",", ".")
        cells = text.replace(" ", "").replace('"', "").split(separator)
        if not any(cells):
            break
        heads.append([float(cell or "nan") for cell in cells[:2]])
        cells += ["", ""]  # Of a last point that is cut off
        own = [
            (row, k, *map(float, xyz))
            for k, j in enumerate(firsts)
            if all(xyz := cells[j : j + 3] or [""])
        ]
        points.append(np.array(own).reshape(-1, 5))
    return np.array(heads).reshape(-1, 2), np.concatenate(points)


def flight_of_points(
    source: str,
    t: Array,
    points: Array,
    labels: Sequence[str],
    unit: str,
    bodies: Collection[str] = (),
    notes: Sequence[str] = (),
) -> RecordedFlight:
    """Return the flight of points (k, 5) as of ``points_in``, at times of rows, by their labels.

    All but those of ``bodies`` are markers; a subject's are also a body, at their mean.
    """
    row, label = points[:, :2].T.astype(np.intp)
    parts = [np.column_stack([t[row], points[:, 2:]])]
    names = [each if each in bodies else MARKER for each in labels]
    names, subjects = [names[i] for i in label], defaultdict[str, list[Array]](list)
    for i, each in enumerate(labels):
        subject, own = each.partition(":")[0], parts[0][label == i]
        loose = subject not in bodies and not each.casefold().startswith(UNLABELED)
        if loose and len(own):
            subjects[subject].append(own)
    for subject, seen in subjects.items():
        common = reduce(np.intersect1d, [own[:, 0] for own in seen])
        parts.append(np.mean([own[np.isin(own[:, 0], common)] for own in seen], axis=0))
        names += [subject] * len(parts[-1])
    return flight_of(source, names, np.concatenate(parts), unit, notes=notes)


def read_motive(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Motive 1.21 to 1.25, by its row ``Frame`` and those above.

    A body's markers are left out: the table holds them as expected and as measured.
    """
    lines = text_lines(path)
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
    (kinds, names), what = titles[:2], titles[-1]
    firsts = [j for j, x in enumerate(what) if (x, rows[k][j]) == ("Position", "X")]
    bodies = {names[j] for j in firsts if kinds[j] == "Rigid Body"}
    firsts = [
        j
        for j in firsts
        if kinds[j] == "Rigid Body"
        or (kinds[j] == "Marker" and names[j].partition(":")[0] not in bodies)
    ]
    head, points = points_in(chain(top[k + 1 :], lines), separator, firsts)
    frames, t = head.T
    hertz = float(facts.get("Export Frame Rate") or facts["Capture Frame Rate"])
    exact, notes = (frames - frames[:1]) / hertz + t[:1], list[str]()
    if np.any(np.abs(exact - t) > CUT):
        exact, notes = t, [f"times are as printed: frames at {hertz:g} Hz have others"]
    return flight_of_points(
        f"Motive CSV {facts[MOTIVE]}",
        exact,
        points,
        [names[j] for j in firsts],
        unit or facts.get("Length Units", ""),
        bodies,
        notes,
    )


def read_vicon(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Vicon: sections of bodies and of markers, at one rate."""
    t, points, labels, bodies = [np.zeros(0)], [np.zeros((0, 5))], list[str](), set[str]()
    lines, units = text_lines(path), [""]
    for title in (line.strip(BLANK) for line in lines):
        if title not in VICON:
            continue
        rate, *top = islice(lines, 4)
        hertz, separator = float(rate.strip(BLANK).replace(",", ".")), max(",;\t", key=top[1].count)
        if not hertz > 0.0:
            raise FileError(f"section {title}: a rate of {hertz:g} Hz; export it again")
        names, axes, units = (
            list(map(str.strip, cells)) for cells in csv.reader(top, delimiter=separator)
        )
        firsts = [j for j, axis in enumerate(axes) if axis == ("X" if title == VICON[-1] else "TX")]
        head, own = points_in(lines, separator, firsts)
        own = own[np.any(own[:, 2:] != 0.0, axis=1)]  # Zeros stand for gaps
        points.append(own + [sum(map(len, t)), len(labels), 0.0, 0.0, 0.0])
        t.append(head[:, 0] / hertz)
        labels += [next((name for name in names[j::-1] if name), "") for j in firsts]
        if title != VICON[-1]:
            plain = [label.partition(":")[0] for label in labels]
            labels = plain if len(set(plain)) == len(plain) else labels
            bodies |= set(labels)
    if len(t) < 2:
        raise FileError(f"has none of the sections {', '.join(VICON)}; export one of them")
    stated = unit or units[firsts[0]]
    return flight_of_points(
        "Vicon CSV", np.concatenate(t), np.concatenate(points), labels, stated, bodies
    )


def read_c3d(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a C3D file; every subject is a body."""
    with reading(path, "C3D file", Exception):
        content = library("ezc3d").c3d(str(path))
        parameters = content["parameters"]["POINT"]
        point = {name: each["value"] for name, each in parameters.items() if "value" in each}
        labels = [label for i in ("", *range(2, 99)) for label in point.get(f"LABELS{i}", ())]
        positions = np.asarray(content["data"]["points"], np.float64)[:3].T  # (frames, points, 3)
        (frames, many, _), rate = positions.shape, float(point["RATE"][0])
        if not (many and rate > 0.0 and len(labels) >= many):
            words = f"has {many} points, {len(labels)} labels, {rate:g} Hz; export it again"
            raise FileError(words)
        visible = np.isfinite(positions).all(axis=-1) & np.any(positions != 0.0, axis=-1)
        points = np.column_stack([*np.nonzero(visible), positions[visible]])
        first, last = struct.unpack_from("<2H", path.read_bytes(), 6)  # ezc3d states what it read
        cut = f"is cut off: read to frame {frames} of {last - first + 1}"
        notes = [cut] if frames < last - first + 1 else []
        stated = unit or next(iter(point.get("UNITS", ())), "")
        t = np.arange(frames) / rate
        return flight_of_points("C3D", t, points, labels, stated, notes=notes)
