"""Reading recorded flights: formats are recognized by their first bytes, and units are doubted."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.flights import mocap, onboard
from hitchopt.flights.recordings import UNITS, RecordedFlight, flight_of
from hitchopt.storage.archive import reading
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import is_number, labelled_table, text_lines
from hitchopt.values import Array, choice

# First bytes of formats, their names, and their readers: of one file and the unit of its lengths,
# or of the logs of all drones, whose units are fixed. Zeros of UTF-16 are left out
TEXT = rb'^(\xef\xbb\xbf|\xff\xfe|\xfe\xff)?[\s"]*'
FILES: dict[bytes, tuple[str, Callable[[Path, str | None], RecordedFlight]]] = {
    TEXT + mocap.MOTIVE.encode(): ("a table of Motive", mocap.read_motive),
    TEXT + rb"(Segments|Objects|Trajectories)[\",;\s]": ("of Vicon", mocap.read_vicon),
    rb"^[\x01-\x1f]P": ("C3D", mocap.read_c3d),
    rb"^(SQLite format 3|\x89MCAP0\r\n|#ROSBAG V2\.0)": ("a ROS bag", onboard.read_bag),
}
LOGS: dict[bytes, tuple[str, Callable[[Sequence[Path]], RecordedFlight]]] = {
    rb"^\xbc": ("Crazyflie uSD logs", onboard.read_usd),
    rb"^ULog\x01\x12\x35": ("PX4 ulogs", onboard.read_ulog),
}

# Columns of a plain table, in any order and among others: time [s], a body (q0, r0, …, a vertex
# p0, …, or any name) or MARKER, a point without a name, and its position [m]
HEADER = "t,name,x,y,z"
NAMES = ", ".join(name for name, _ in (*FILES.values(), *LOGS.values()))
KNOWN = f"{NAMES}, the directory of a simulated flight, or a table with the columns {HEADER}"

# Files of a simulated flight, whose tables have "vertex" and "drone" in place of "name"
TABLES, SUMMARY = {"vertices.csv": ("vertex", "p"), "drones.csv": ("drone", "")}, "simulation.json"

MAX_BYTES = 2_000_000_000  # Size limit of a file [B]
MAX_DISTANCE = 50.0  # Median distance from the origin beyond which lengths are no metres [m]
MAX_STEP = 1.0  # Median step of times from which on they are no seconds [s]
CLOCKS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
RATES = (4.0, 3000.0)  # Rates at which flights are recorded [Hz]


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
        choice("unit", unit, tuple(UNITS))
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
        if file.stat().st_size > MAX_BYTES:
            raise FileError(f"is larger than {MAX_BYTES:.0e} bytes; record at a lower rate")
        with file.open("rb") as stream:
            heads[file] = stream.read(64).replace(b"\0", b"")
    for key, (_, read_logs) in LOGS.items():
        if logs := [file for file in files if re.match(key, heads[file])]:
            if unit is not None:
                raise FileError("has lengths whose units its format fixes; leave unit= out")
            return read_logs(logs)
    for key, (_, read) in FILES.items():
        for file in files:
            if re.match(key, heads[file]):
                return read(file, unit)
    if path.is_dir():
        names = ", ".join(each.name for each in files[:5]) or "no file"
        raise FileError(f"holds {names}: no recording; give {KNOWN}")
    return read_table(path, unit)


def read_table(path: Path, unit: str | None) -> RecordedFlight:
    """Return the flight in a plain table with the columns HEADER."""
    cells = next(csv.reader(islice(text_lines(path), 1)), [])
    if len(cells) > 4 and all(is_number(cell) or not cell for cell in cells):
        words = "begins with numbers and has no titles; with Motive, export it with its header"
        raise FileError(f"{words}; or give the columns the names {HEADER}")
    try:
        table = labelled_table(partial(text_lines, path), HEADER.split(","), str(path))
    except FileError as error:
        raise FileError(f"{error}; give {KNOWN}") from None
    rows = table.numbers(["t", "x", "y", "z"], blanks=True)
    return flight_of("table", table.words("name"), rows, unit or "m")


def read_simulated(path: Path) -> RecordedFlight:
    """Return the flight in the results of ``hitchopt simulate``."""
    parts, names, end = list[Array](), list[str](), np.inf
    for file, (kind, prefix) in TABLES.items():
        table = labelled_table(partial(text_lines, path / file), ("t", kind, "x"), file)
        rows = table.numbers(["t", "x", "y", "z"], blanks=True)
        common = (rows[:, 0] <= end) & np.isfinite(rows).all(axis=1)  # Drones are recorded longer
        end = float(np.max(rows[:, 0], initial=-np.inf))
        parts.append(rows[common])
        names += [prefix + label for label in np.array(table.words(kind))[common].tolist()]
    try:
        content = parsed_json((path / SUMMARY).read_text(encoding="utf-8"))
        simulated = {
            name: np.array([np.any(drone) for drone in content["position_loops"][name]])
            for name in ("feed_forward", "integral")
        } | {"density": float(content["density"]["simulated"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        words = f"not a summary of this flight; simulate again ({error})"
        raise FileError(f"{path / SUMMARY}: {words}") from error
    return flight_of("simulated flight", names, np.concatenate(parts), simulated=simulated)
