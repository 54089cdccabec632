"""Reading recorded flights: formats are told by their content, and what they say is doubted."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights import mocap, onboard
from hitchopt.flights.flight import Markers, RecordedFlight, SimulatedTeam, Track, no_markers
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array, choice

# Columns of a plain table, in any order and among others: time [s], a body (q0, r0, …, a vertex
# p0, …, or any name) or MARKER, a point without a name, and its position [m]
HEADER, MARKER = "t,name,x,y,z", "marker"

MAX_BYTES = 2_000_000_000  # Larger files are refused before they are read

# Files of a simulated flight; for "name" its tables have "drone" and "vertex"
DRONES, VERTICES, SUMMARY = "drones.csv", "vertices.csv", "simulation.json"

FORMATS = (
    "a table of Motive, Vicon or QTM, C3D, a ROS bag, Crazyflie uSD logs, PX4 ulogs, "
    f"the directory of a simulated flight, or a table with the columns {HEADER}"
)
BAGS = (b"SQLite format 3\0", b"\x89MCAP0\r\n", b"#ROSBAG V2.0")  # First bytes of bags
ULOG, C3D = b"ULog\x01\x12\x35", bytes([mocap.C3D_KEY])

Change = Callable[[Array, Array], tuple[Array, Array]]  # Of times and positions

LARGEST = 50.0  # Median distance from the origin beyond which lengths are no metres [m]
SLOWEST = 1.0  # Median step of times from which on they are no seconds [s]
CLOCKS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
RATES = (4.0, 3000.0)  # Rates at which flights are recorded [Hz]
ABSOLUTE = 1e7  # Times from which on they are a date, or that of a computer [s]


def read_flight(path: Path | str, unit: str | None = None) -> RecordedFlight:
    """Return what a recording holds, in any of the formats that are known.

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
        choice("unit", unit, tuple(mocap.UNITS))
    with reading(path, "recording"):
        flight = _read(path, unit)
        if not flight.tracks:
            raise FileError("holds no position of a body; record the drones")
        return _doubted(flight, unit)


def _read(path: Path, unit: str | None) -> RecordedFlight:
    if not path.exists():
        raise FileError(f"{path}: there is no such file; give a recording")
    if path.is_dir():
        return _read_directory(path, unit)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise FileError(f"is larger than {MAX_BYTES:.0e} bytes; record at a lower rate")
    with path.open("rb") as file:
        key = file.read(16)
    if key.startswith(BAGS):
        bag = path.parent if (path.parent / "metadata.yaml").is_file() else path
        return _scaled(onboard.read_bag(bag), unit)
    if key.startswith(bytes([onboard.USD_KEY])):
        return _of_logs(onboard.read_usd, [path], unit)
    if key.startswith(ULOG):
        return _of_logs(onboard.read_ulog, [path], unit)
    if key[1:2] == C3D and key[0] < 32:
        return mocap.read_c3d(path.read_bytes(), unit)
    return _read_text(path, unit)


def _read_directory(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight of a bag, of a simulation, or of all logs in a directory."""
    if (path / DRONES).is_file():
        return read_simulated(path)
    files, found = sorted(each for each in path.iterdir() if each.is_file()), defaultdict(list)
    for each in files:
        with each.open("rb") as file:
            key = file.read(16)
        found[next((k for k in (*BAGS, ULOG) if key.startswith(k)), key[:1])].append(each)
    if any(found[key] for key in BAGS):
        return _scaled(onboard.read_bag(path), unit)
    for key, read in ((bytes([onboard.USD_KEY]), onboard.read_usd), (ULOG, onboard.read_ulog)):
        if found[key]:
            return _of_logs(read, found[key], unit)
    names = ", ".join(each.name for each in files[:5]) or "no file"
    raise FileError(f"holds {names}: no recording; give {FORMATS}")


def _of_logs(
    read: Callable[[Sequence[Path]], RecordedFlight], paths: Sequence[Path], unit: str | None
) -> RecordedFlight:
    if unit is not None:
        raise FileError("has lengths whose units its format fixes; leave --unit out")
    return read(paths)


def _read_text(path: Path, unit: str | None) -> RecordedFlight:
    begin = next(islice(text_lines(path), 1), "").strip(' \t"')
    if begin.startswith(mocap.MOTIVE):
        return mocap.read_motive(list(text_lines(path)), unit)
    if begin.strip(' ",;\t') in mocap.VICON:
        return mocap.read_vicon(list(text_lines(path)), unit)
    if begin.startswith((mocap.QTM, "FILE_VERSION")):
        return mocap.read_qtm(list(text_lines(path)), unit)
    cells = next(csv.reader([begin]), [])
    if len(cells) > 4 and all(_is_number(cell) or not cell for cell in cells):
        words = "begins with numbers and has no titles; with Motive, export it with its header"
        raise FileError(f"{words}; or give the columns the names {HEADER}")
    try:
        table = labelled_table(partial(text_lines, path), HEADER.split(","), str(path))
    except FileError as error:
        raise FileError(f"{error}; give {FORMATS}") from None
    rows, names = table.numbers(["t", "x", "y", "z"], blanks=True), table.words("name")
    return _scaled(_of_rows("table", rows.tolist(), names), unit)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _of_rows(source: str, rows: Sequence[Sequence[float]], names: Sequence[str]) -> RecordedFlight:
    """Return the flight of rows (time, x, y, z) of names; of each name, times ascend."""
    own: dict[str, list[Sequence[float]]] = defaultdict(list)
    for name, row in zip(names, rows, strict=True):
        own[name].append(row)
    tracks, blank = dict[str, Track](), 0
    cloud = _cloud_of(own.pop(MARKER, []))
    for name, each in own.items():
        values = np.array(each, np.float64)
        if not np.all(np.isfinite(values[:, 0])):
            raise FileError("a time is not finite; leave out rows without a time")
        seen = np.all(np.isfinite(values), axis=1)
        track, repeated = onboard.sorted_track(values[seen].tolist())
        if repeated:
            raise FileError(f"holds {name} twice at the same time; record it once")
        blank += int(np.sum(~seen))
        if track is not None:
            tracks[name] = track
    notes = (f"{blank} of {len(rows)} rows have no position: left out",) if blank else ()
    return RecordedFlight(source, tracks, cloud, notes=notes)


def _cloud_of(rows: Sequence[Sequence[float]]) -> Markers:
    """Return the cloud of rows (time, x, y, z), frames being their times."""
    values = np.array(rows, np.float64).reshape(-1, 4)
    values = values[np.all(np.isfinite(values), axis=1)]
    values = values[np.argsort(values[:, 0], kind="stable")]
    t, frame = np.unique(values[:, 0], return_inverse=True)
    return Markers(t, frame, values[:, 1:]) if len(t) else no_markers()


def read_simulated(path: Path) -> RecordedFlight:
    """Return the flight in the results of ``hitchopt simulate``."""
    rows: list[list[float]] = []
    names: list[str] = []
    last = np.inf
    for file, kind, prefix in ((VERTICES, "vertex", "p"), (DRONES, "drone", "")):
        where = path / file
        table = labelled_table(partial(text_lines, where), ("t", kind, "x"), str(where))
        values = table.numbers(["t", "x", "y", "z"], blanks=True)
        keep = values[:, 0] <= last  # drones alone are recorded longer
        last = float(np.max(values[:, 0], initial=-np.inf)) if prefix else last
        rows += values[keep].tolist()
        names += [f"{prefix}{n}" for n, k in zip(table.words(kind), keep, strict=True) if k]
    try:
        content = parsed_json((path / SUMMARY).read_text(encoding="utf-8"))
        loops = (content["position_loops"][name] for name in ("feed_forward", "integral"))
        on = [np.asarray(np.any(np.reshape(each, (len(each), -1)), axis=1)) for each in loops]
        known = SimulatedTeam(float(content["density"]["simulated"]), on[0], on[1])
    except (OSError, ValueError, KeyError, TypeError) as error:
        words = f"not a summary of this flight; simulate again ({error})"
        raise FileError(f"{path / SUMMARY}: {words}") from error
    flight = _of_rows("simulated flight", rows, names)
    return replace(flight, up="z", notes=(), simulated=known)


def _scaled(flight: RecordedFlight, unit: str | None) -> RecordedFlight:
    """Return a flight in metres, of which lengths are in a unit."""
    if unit is None:
        return flight
    scale = mocap.UNITS[unit]
    return _mapped(flight, lambda t, x: (t, scale * x))


def _mapped(flight: RecordedFlight, change: Change) -> RecordedFlight:
    """Return a flight with times and positions of all its parts changed."""
    tracks, setpoints = (
        {name: Track(*change(each.t, each.positions)) for name, each in part.items()}
        for part in (flight.tracks, flight.setpoints)
    )
    t, places = change(flight.markers.t, flight.markers.positions)
    markers = Markers(t, flight.markers.frame, places)
    return replace(flight, tracks=tracks, setpoints=setpoints, markers=markers)


def _doubted(flight: RecordedFlight, unit: str | None) -> RecordedFlight:
    """Return a flight whose times count from its start if they are a date; refuse what is none."""
    tracks = list(flight.tracks.values())
    for name, track in flight.tracks.items():
        step = float(np.median(np.diff(track.t))) if len(track.t) > 1 else 0.0
        if step >= SLOWEST:
            units = [
                f"{each}, divide by {many:.0e}"
                for each, many in CLOCKS.items()
                if step / many * RATES[0] <= 1.0 <= step / many * RATES[1]
            ]
            words = f"times of {name} step by {step:.4g} s: not in seconds"
            raise FileError(f"{words}; if they are {' or if '.join(units) or 'other units'}")
    far = float(np.median(np.concatenate([np.linalg.norm(x.positions, axis=1) for x in tracks])))
    if far > LARGEST and unit is None:
        words = f"positions are {far:.4g} m from the origin at the median, over {LARGEST:g} m"
        raise FileError(f"{words}: millimetres? --unit mm")
    begin = min(float(track.t[0]) for track in tracks)
    if abs(begin) < ABSOLUTE or not flight.one_clock:
        return flight
    shifted = _mapped(flight, lambda t, x: (t - begin, x))
    note = f"times count from the first position, at {begin:.3f} s of the recording's clock"
    return replace(shifted, notes=(*flight.notes, note), epoch=begin)
