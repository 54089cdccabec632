"""Recordings of motion capture: tables of Motive and of Vicon Nexus, and C3D files.

Times are those of frames, since tables print them to milliseconds only. A body is one that a table
names, else the mean of a subject's markers while all are visible. Measured markers are one cloud,
whatever their labels, which swap and break off; markers of the drones may be in it.
"""

from __future__ import annotations

import csv
import re
import struct
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights.flight import Markers, RecordedFlight, Track, library, metres
from hitchopt.storage.archive import reading
from hitchopt.storage.tables import text_lines
from hitchopt.values import Array, Indices

MOTIVE, VICON = "Format Version", ("Segments", "Objects", "Trajectories")
UNLABELED = re.compile(r"\*|unlabel|unidentified|u_?\d+$|marker$", re.IGNORECASE)
MAX_TITLES = 50  # Lines among which the titles of a table of Motive are searched
CUT = 2e-3  # Largest difference between a frame's time and the printed one [s], by rounding
BLANK = ' ",;\t'  # Characters of a line without a cell


class Points(NamedTuple):
    """Points of a table: the row and the label (k,) of each, and its position (k, 3)."""

    row: Indices
    label: Indices
    positions: Array


def points_in(
    lines: Iterable[str], separator: str, head: Sequence[int], firsts: Sequence[int]
) -> tuple[Array, Points]:
    """Return columns ``head`` (rows, …), and the points in three columns from each of ``firsts``.

    Blank cells are nan, and points with a blank cell are left out. Lines end at one without a cell.
    Raises ValueError for cells that are no numbers.
    """
    columns = np.array([*head, *(j + i for j in firsts for i in range(3))])
    place = np.full(
        np.max(columns) + 2, -1
    )  # Of a column among those; of all beyond them, the last
    place[columns] = np.arange(len(columns))
    filled = re.compile(f"({separator}*)([^{separator}]+)")  # Few cells of wide tables are
    heads, labels, positions = [], [], []
    for line in lines:
        text = line.replace(" ", "").replace('"', "")
        text = (text if separator == "," else text.replace(",", ".")).rstrip(separator)
        cells = filled.findall(text)
        if not cells:
            break
        column = np.cumsum([len(separators) for separators, _ in cells])
        here = place[np.minimum(column, len(place) - 1)]
        numbers = np.array(
            [float(cell) for (_, cell), i in zip(cells, here, strict=True) if i >= 0]
        )
        here = here[here >= 0]
        top = np.full(len(head), np.nan)
        top[here[here < len(head)]] = numbers[here < len(head)]
        label, many = np.unique((here[here >= len(head)] - len(head)) // 3, return_counts=True)
        whole = np.repeat(many == 3, many)
        xyz = numbers[here >= len(head)][whole].reshape(-1, 3)
        finite = np.isfinite(xyz).all(axis=1)
        heads.append(top)
        labels.append(label[many == 3][finite])
        positions.append(xyz[finite])
    rows = np.repeat(np.arange(len(labels)), [len(each) for each in labels])
    all_labels = np.concatenate([np.zeros(0, np.intp), *labels])
    points = Points(rows, all_labels, np.concatenate([np.zeros((0, 3)), *positions]))
    return np.array(heads).reshape(-1, len(head)), points


def flight_of(
    source: str,
    t: Array,
    points: Points,
    labels: Sequence[str],
    bodies: Collection[str] = (),
    notes: tuple[str, ...] = (),
) -> RecordedFlight:
    """Return the flight of labelled points at times (rows,) [s]; FileError if these do not ascend.

    Points of ``bodies`` are tracks; others are markers, and those of a subject its track too.
    """
    if not np.all(np.diff(t) > 0.0):  # nan too
        i = int(np.argmin(np.diff(t) > 0.0))
        words = f"times do not ascend: {t[i]:.6g} s is followed by {t[i + 1]:.6g} s"
        raise FileError(f"{words}; export one take, from its first frame on")
    subjects, tracks = defaultdict[str, list[int]](list), {}
    for i, label in enumerate(labels):
        subject = label.partition(":")[0]
        if label in bodies:
            subjects[label].append(i)
        elif subject not in bodies and not UNLABELED.match(label):
            subjects[subject].append(i)
    for subject, indices in subjects.items():
        own = np.isin(points.label, indices)
        row, many = points.row[own], len(np.unique(points.label[own]))
        whole = np.flatnonzero(np.bincount(row, minlength=len(t)) == many)
        if many and len(whole):
            sums = [np.bincount(row, x, len(t))[whole] for x in points.positions[own].T]
            tracks[subject] = Track(t[whole], np.stack(sums, axis=1) / many)
    loose = np.array([label not in bodies for label in labels], np.bool_)[points.label]
    order = np.argsort(points.row[loose], kind="stable")
    cloud = Markers(t, points.row[loose][order], points.positions[loose][order])
    return RecordedFlight(source, tracks, cloud, notes=notes)


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
    width = len(rows[k])
    kinds, names, quantities = (
        cells + [""] * (width - len(cells)) for cells in (*titles[:2], titles[-1])
    )
    firsts = [
        j
        for j in range(2, width - 2)
        if rows[k][j : j + 3] == ["X", "Y", "Z"] and quantities[j : j + 3] == ["Position"] * 3
    ]
    bodies = {names[j] for j in firsts if kinds[j] == "Rigid Body"}
    firsts = [
        j
        for j in firsts
        if kinds[j] == "Rigid Body"
        or (kinds[j] == "Marker" and names[j].partition(":")[0] not in bodies)
    ]
    head, points = points_in(chain(top[k + 1 :], lines), separator, (0, 1), firsts)
    frames, t = head.T
    hertz = float(facts.get("Export Frame Rate") or facts["Capture Frame Rate"])
    exact = (frames - frames[:1]) / hertz + t[:1]
    close = np.all(np.abs(exact - t) <= CUT)
    notes = () if close else (f"times are as printed: frames at {hertz:g} Hz have others",)
    scaled = metres(unit or facts.get("Length Units", "")) * points.positions
    points, labels = points._replace(positions=scaled), [names[j] for j in firsts]
    source = f"Motive CSV {facts[MOTIVE]}"
    return flight_of(source, exact if close else t, points, labels, bodies, notes)


def read_vicon(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a table of Vicon: sections of bodies and of markers, at one rate."""
    parts, all_labels, bodies = list[tuple[Array, Points]](), list[str](), set[str]()
    lines = text_lines(path)
    for line in lines:
        title = line.strip(BLANK)
        if title not in VICON:
            continue
        rate, *top = islice(lines, 4)
        hertz, separator = float(rate.strip(BLANK).replace(",", ".")), max(",;\t", key=top[1].count)
        if not hertz > 0.0:
            raise FileError(f"section {title}: a rate of {hertz:g} Hz; export it again")
        rows = csv.reader(top, delimiter=separator)
        names, axes, units = (list(map(str.strip, cells)) for cells in rows)
        rigid = title != VICON[-1]
        wanted = ["TX", "TY", "TZ"] if rigid else ["X", "Y", "Z"]
        firsts = [j for j in range(2, len(axes)) if axes[j : j + 3] == wanted]
        head, points = points_in(lines, separator, (0,), firsts)
        labels = [next((name for name in names[j::-1] if name), "") for j in firsts]
        if not np.all(np.diff(head[:, 0]) > 0.0):
            raise FileError(f"section {title}: frames do not ascend; export one take")
        if rigid:
            plain = [label.partition(":")[0] for label in labels]
            labels = plain if len(set(plain)) == len(plain) else labels
            bodies |= set(labels)
        visible = np.any(points.positions != 0.0, axis=1)  # Zeros stand for gaps
        scales = np.array([metres(unit or units[j]) for j in firsts])[points.label]
        positions = scales[:, None] * points.positions
        label = points.label + len(all_labels)
        own = Points(points.row[visible], label[visible], positions[visible])
        parts.append((head[:, 0] / hertz, own))
        all_labels += labels
    if not parts:
        raise FileError(f"has none of the sections {', '.join(VICON)}; export one of them")
    t = np.unique(np.concatenate([own for own, _ in parts]))
    shifted = [points._replace(row=np.searchsorted(t, own)[points.row]) for own, points in parts]
    merged: Any = (np.concatenate(each) for each in zip(*shifted, strict=True))
    return flight_of("Vicon CSV", t, Points(*merged), all_labels, bodies)


def read_c3d(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a C3D file; every subject is a body."""
    with reading(path, "C3D file", Exception):
        content = library("ezc3d").c3d(str(path))
        parameters = content["parameters"]["POINT"]
        point = {name: each["value"] for name, each in parameters.items() if "value" in each}
        labels = [label for i in ("", *range(2, 99)) for label in point.get(f"LABELS{i}", ())]
        positions = np.asarray(content["data"]["points"], np.float64)[:3].transpose(2, 1, 0)
        _, many, _ = positions.shape
        rate = float(point["RATE"][0])
        if not (many and rate > 0.0 and len(labels) >= many):
            words = f"has {many} points, {len(labels)} labels, {rate:g} Hz; export it again"
            raise FileError(words)
        visible = np.all(np.isfinite(positions), axis=-1) & np.any(positions != 0.0, axis=-1)
        scale = metres(unit or next(iter(point.get("UNITS", ())), ""))
        row, label = np.nonzero(visible)
        first, last = struct.unpack_from("<2H", path.read_bytes(), 6)  # ezc3d states what it read
        seen = Points(row, label, scale * positions[visible])
        frames, all_frames = len(positions), last - first + 1
        notes = (
            (f"is cut off: read to frame {frames} of {all_frames}",) if frames < all_frames else ()
        )
        return flight_of("C3D", np.arange(frames) / rate, seen, labels[:many], notes=notes)
