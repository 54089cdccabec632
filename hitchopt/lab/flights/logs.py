"""Readers of drones' logs: Crazyflies' uSD cards, and PX4.

Drones log one file each, on a clock that starts at boot. A load that all of them log aligns the
clocks; without one, each track has its own clock.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError
from hitchopt.geometry.vectors import length
from hitchopt.lab.flights.recordings import (
    QUANTITIES,
    Logged,
    RecordedFlight,
    fitted_shift,
    flight_of,
    library,
)
from hitchopt.lab.flights.topics import (
    COMMANDED,
    FLIPPED,
    LOAD,
    LOG_TOPICS,
    ULOG_POSITIONS,
    ULOG_QUANTITIES,
    USD_POSITIONS,
    USD_QUANTITIES,
    Topic,
    UlogVariables,
    quantity_name,
    taken_topics,
)
from hitchopt.storage.archive import reading
from hitchopt.storage.files import file_bytes, opened
from hitchopt.storage.tables import labelled_table, text_lines
from hitchopt.values import Array

CFCLIENT_TIME = "Timestamp"  # Column of times [ms] in logs of cfclient
HELD = "locSrv"  # Topic of a uSD log that repeats the last position, or zeros, until the next
USD_DRONES = ("stateEstimate", "stateEstimateZ", "kalman", HELD)  # Topics of drones' positions
TIE_SPAN = 5.0  # Largest difference between the starts of two logs of a flight [s]

# North, east, down to x east, y north, z up; forward, right, down to forward, left, up
WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
BODY = np.diag([1.0, -1.0, -1.0])


class Log(NamedTuple):
    """Content of one drone's log: rows of positions by topic, other quantities, and notes."""

    positions: dict[str, Array]
    quantities: dict[str, Logged]
    notes: list[str]


def read_logs(
    source: str,
    read: Callable[[Path], Log],
    paths: Sequence[Path],
    unit: str | None,
    topic: str | None,
) -> RecordedFlight:
    """Return the flight in drones' logs, whose file names are the drones' names."""
    if unit is not None:
        raise FileError("has a format with fixed units; omit unit=")
    drones, carried = dict[str, dict[str, Logged]](), dict[str, dict[str, Logged]]()
    by_note = defaultdict[str, list[str]](list)
    for path in paths:
        with reading(path, source, Exception):
            drones[path.stem], load, notes = _contents(read(path), topic)
        if load:
            carried[path.stem] = load
        for note in notes:
            by_note[note].append(path.stem)
    notes = [f"{', '.join(names)}: {note}" for note, names in by_note.items()]
    loads = {name: own["position"].rows for name, own in carried.items()}
    shifts, tie_notes = _tied(list(drones), loads)
    for name, shift in shifts.items():
        for quantity, (rows, kind) in drones[name].items():
            drones[name][quantity] = Logged(rows + np.eye(1, rows.shape[1]) * shift, kind)
    carriers = list(loads) if len(loads) > 1 and not shifts else list(loads)[:1]
    return flight_of(
        source,
        drones,
        loads={f"{LOAD} of {x}" if carriers[1:] else LOAD: carried[x] for x in carriers},
        notes=[*notes, *tie_notes],
        clock_shifts=shifts,
        one_clock=len(paths) == 1 or bool(shifts),
    )


def _contents(
    log: Log, request: str | None
) -> tuple[dict[str, Logged], dict[str, Logged], list[str]]:
    """Return the quantities of a log's drone and of its load, and notes.

    The drone's positions are of the requested topic, if any. Commands are those of the body that
    the commanded positions are nearest to, at the median.
    """
    order = list(LOG_TOPICS)
    topics = [Topic(x, x, "", LOG_TOPICS[x], order.index(x)) for x in log.positions]
    topics.sort(key=lambda topic: topic.preference)
    taken, notes = taken_topics(topics, request)
    if len(taken) > 1:
        both = " and ".join(each.name for each in taken)
        raise FileError(f"has positions in {both}: choose one with topic=")
    own = taken[0]
    positions = {name: Logged(x, name) for name, x in log.positions.items()}
    drone = {"position": positions[own.name], **log.quantities}
    of_kind = dict[str, str]()
    for each in topics[::-1]:
        of_kind[each.kind] = each.name  # Of each kind the first topic
    for kind, name in of_kind.items():
        quantity = quantity_name(kind, "position")
        # Measured positions are no quantity, if others are requested
        if quantity in QUANTITIES and (kind != own.kind or kind == COMMANDED):
            drone[quantity] = positions[name]
    command, load = of_kind.get(COMMANDED), of_kind.get(LOAD)
    carried = {"position": positions[load]} if load and own.kind != LOAD else {}
    if command and load:

        def distance(topic: str) -> float:
            t, *at = log.positions[topic].T
            times, *commands = log.positions[command].T
            offsets = [np.interp(times, t, x) for x in at] - np.stack(commands)
            return float(np.nanmedian(np.linalg.norm(offsets, axis=0)))

        here = distance(own.name)
        there = distance(load)
        if here > there:
            words = f"{there:.2f} m from {load} at the median, and {here:.2f} m from {own.name}"
            notes = [*notes, f"{command} is the target of the load, not of the drone: {words}"]
            commands = [quantity for quantity in drone if quantity.startswith("commanded_")]
            carried |= {quantity: drone.pop(quantity) for quantity in commands}
    return drone, carried, [*log.notes, *notes]


def _tied(names: Sequence[str], loads: Mapping[str, Array]) -> tuple[dict[str, float], list[str]]:
    """Return the shifts of all drones' clocks to the first one's [s], and a note.

    The load that all drones log ties them; no shift is returned if it is not one load, or moves too
    little.
    """
    if len(names) < 2 or set(names) != set(loads):
        return {}, []
    first, *others = names
    shifts = {first: 0.0}
    worst = 0.0
    for name in others:
        start = float(loads[first][0, 0] - loads[name][0, 0])
        fitted = fitted_shift(loads[name], loads[first], (start - TIE_SPAN, start + TIE_SPAN))
        if fitted is None:
            return {}, []
        shifts[name] = fitted[0]
        worst = max(worst, fitted[1])
    words = "the load, logged by all, aligns their clocks; its positions then agree to"
    return shifts, [f"{', '.join(names)}: {words} {1e3 * worst:.1f} mm"]


def read_usd(path: Path) -> Log:
    """Return the content of a log of a Crazyflie's uSD card."""
    return _crazyflie_log(*usd_events(file_bytes(path)))


def read_cfclient(path: Path) -> Log:
    """Return the content of a log of cfclient: a table of variables over ``Timestamp`` [ms]."""
    table = labelled_table(partial(text_lines, path), (CFCLIENT_TIME,), str(path))
    variables = table.numbers(table.labels, blanks=True)
    event = dict(zip(table.labels, variables.T, strict=True))
    return _crazyflie_log([{"t": 1e-3 * event[CFCLIENT_TIME], **event}], [])


def _crazyflie_log(events: Sequence[Mapping[str, Array]], notes: list[str]) -> Log:
    """Return the content of a log with variables of the Crazyflie's firmware, by event type."""
    positions, quantities = dict[str, Array](), dict[str, Logged]()
    for topic, (variables, unit) in USD_POSITIONS.items():
        if (samples := _usd_samples(events, variables)) is None:
            continue
        samples[:, 1:] *= unit
        if topic == HELD:
            samples = samples[np.any(np.diff(samples[:, 1:], axis=0, prepend=0.0) != 0.0, axis=1)]
        if len(samples):
            positions[topic] = samples
    if not positions.keys() & set(USD_DRONES):
        available = ", ".join(sorted({name for event in events for name in event}))
        expected = ", ".join(_usd_names(USD_POSITIONS[topic][0])[0] for topic in USD_DRONES)
        raise FileError(f"logs none of {expected}, but {available[:200]}")
    for quantity, options in USD_QUANTITIES.items():
        for variables, unit in options:
            if (samples := _usd_samples(events, variables)) is not None:
                names = _usd_names(variables)
                signs = [-1.0 if name == FLIPPED else 1.0 for name in names]
                values = _usd_values(quantity, samples[:, 1:] * unit * signs)
                rows = np.column_stack([samples[:, 0], values])
                quantities[quantity] = Logged(rows, names[0])
                break
    return Log(positions, quantities, notes)


def _usd_names(variables: str) -> list[str]:
    """Return the names of variables such as ``group.x y z``."""
    group, _, parts = variables.partition(".")
    return [f"{group}.{part}" for part in parts.split()]


def _usd_samples(events: Sequence[Mapping[str, Array]], variables: str) -> Array | None:
    """Return rows of time [s] and variables of the first event that has all; None if none has."""
    names = _usd_names(variables)
    event = next((each for each in events if set(names) <= set(each)), None)
    return None if event is None else np.stack([event[x] for x in ("t", *names)], axis=1)


def _usd_values(quantity: str, values: Array) -> Array:
    """Return compressed quaternions, or roll, pitch and yaw [rad], as quaternions.

    A vector of thrust becomes its norm.
    """
    if quantity.endswith("attitude") and values.shape[1] == 1:
        return decompressed(values[:, 0])
    if quantity.endswith("attitude") and values.shape[1] == 3:
        finite = np.isfinite(values).all(axis=1)
        turned: Array = np.full((len(values), 4), np.nan)
        turned[finite] = Rotation.from_euler("xyz", values[finite]).as_quat()
        return turned
    if quantity == "thrust" and values.shape[1] == 3:
        return length(values)[:, None]
    return values


def decompressed(words: Array) -> Array:
    """Return quaternions (m, 4) from 32 bits each, in the compression of the Crazyflie's firmware.

    The first two bits are the index of the largest component, which is positive; each other one has
    a sign and nine bits of its size over the square root of one half.
    """
    bits = words.astype(np.int64)
    largest = bits >> 30
    quaternions = np.zeros((len(bits), 4))
    for i in (3, 2, 1, 0):
        stored = largest != i
        sizes = math.sqrt(0.5) / 511.0 * (bits & 511) * np.where(bits & 512, -1.0, 1.0)
        quaternions[stored, i] = sizes[stored]
        bits = np.where(stored, bits >> 10, bits)
    rest = np.sqrt(np.maximum(1.0 - np.sum(quaternions**2, axis=1), 0.0))
    quaternions[np.arange(len(bits)), largest] = rest
    return quaternions


def usd_events(data: bytes) -> tuple[list[dict[str, Array]], list[str]]:
    """Return the variables of every event type, including ``t`` [s], and notes on damage.

    The header lists event types, each with a number and variables ``group.name(type)``. Records of
    events and a checksum follow.
    """
    version, event_types = struct.unpack_from("<HH", data, 1)
    if version not in {1, 2}:
        raise FileError(f"has version {version}; 1 and 2 are supported")
    offset = 5
    kinds = dict[int, Any]()
    for _ in range(event_types):
        number = struct.unpack_from("<H", data, offset)[0]
        offset = data.index(0, offset + 2) + 1
        (count,) = struct.unpack_from("<H", data, offset)
        offset = offset + 2
        fields = list[tuple[str, str]]()
        for _ in range(count):
            end = data.index(0, offset)
            text = data[offset:end].decode("ascii")
            offset = end + 1
            fields.append((text[:-3], f"<{text[-2]}"))
        kinds[number] = np.dtype([("", "<H"), ("t", "<I" if version == 1 else "<Q"), *fields])
    intact = len(data) >= offset + 4 and zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]
    end = len(data) - 4 * intact
    records = defaultdict[int, bytearray](bytearray)
    while offset + 2 <= end:
        (number,) = struct.unpack_from("<H", data, offset)
        if number not in kinds or offset + (size := kinds[number].itemsize) > end:
            break
        records[number] += data[offset : offset + size]
        offset += size
    events = list[dict[str, Array]]()
    tick = 1e-3 if version == 1 else 1e-6
    for number, record in records.items():
        values: Any = np.frombuffer(record, kinds[number])
        events.append({name: values[name].astype(np.float64) for name in values.dtype.names})
        events[-1]["t"] *= tick
    last = max((event["t"][-1] for event in events), default=0.0)
    return events, [] if intact else [f"truncated or damaged: read to the record at {last:.3f} s"]


def read_ulog(path: Path) -> Log:
    """Return the content of a PX4 ulog, converted from north, east, down."""
    options = [*ULOG_POSITIONS.values(), *ULOG_QUANTITIES.values()]
    names = list(dict.fromkeys(each.topic for variables in options for each in variables))
    with opened(path) as file:
        log = library("pyulog").ULog(file, names)
    topics = {topic.name: topic.data for topic in log.data_list[::-1]}  # Of each the first instance
    logged, quantities = dict[str, Array](), dict[str, Logged]()
    for topic, variables in ULOG_POSITIONS.items():
        if (own := _logged_variables(topics, variables)) is not None:
            logged[topic] = _ulog_rows(topics[topic], own)
    if not logged:
        raise FileError(f"logs none of {', '.join(ULOG_POSITIONS)}")
    positions = {topic: rows for topic, rows in logged.items() if len(rows)}
    if not positions:
        raise FileError(f"never has a valid position in {', '.join(logged)}")
    for quantity, variables in ULOG_QUANTITIES.items():
        own = _logged_variables(topics, variables)
        if own is not None and len(rows := _ulog_rows(topics[own.topic], own)):
            quantities[quantity] = Logged(rows, own.topic)
    if "commanded_position" in quantities:
        positions["trajectory_setpoint"] = quantities.pop("commanded_position").rows
    notes = [
        f"{topic} is skipped while it is not valid"
        for topic, rows in logged.items()
        if len(rows) < len(topics[topic]["timestamp"])
    ]
    if lost := sum(gap.duration for gap in log.dropouts):
        notes.append(f"{1e-3 * lost:.1f} s were not logged")
    return Log(positions, quantities, notes)


def _logged_variables(
    topics: Mapping[str, Mapping[str, Any]], options: Sequence[UlogVariables]
) -> UlogVariables | None:
    """Return the first variables that are logged."""
    logged = (
        each for each in options if set(each.names.split()) <= set(topics.get(each.topic, ()))
    )
    return next(logged, None)


def _ulog_rows(topic: Mapping[str, Any], variables: UlogVariables) -> Array:
    """Return rows of time [s] and values, in the axes of this package, while they are valid."""
    names = variables.names.split()
    values = np.stack([topic[name].astype(np.float64) for name in names], axis=1)
    values = px4_values(variables.axes, values)
    t = 1e-6 * topic.get("timestamp_sample", topic["timestamp"]).astype(np.float64)
    flags = [topic[name] != 0 for name in variables.valid.split() if name in topic]
    is_valid = np.all([np.ones(len(t), np.bool_), *flags], axis=0)
    return np.column_stack([t, values])[is_valid]


def px4_values(axes: str, values: ArrayLike) -> Array:
    """Return values (…, k) in PX4's axes, as of ``UlogVariables``, in those of this package.

    Quaternions w, x, y, z become x, y, z, w; nan if they are none.
    """
    numbers: Array = np.asarray(values, np.float64)
    if axes == "world":
        numbers = numbers @ WORLD.T
    elif axes == "body":
        numbers = numbers @ BODY.T
    elif axes == "attitude":
        numbers = _px4_attitudes(numbers.reshape(-1, 4)).reshape(numbers.shape)
    return numbers


def _px4_attitudes(values: Array) -> Array:
    is_known = np.isfinite(values).all(axis=1) & np.any(values != 0.0, axis=1)
    attitudes = Rotation.from_quat(values[is_known][:, [1, 2, 3, 0]]).as_matrix()
    quaternions = np.full_like(values, np.nan)
    quaternions[is_known] = Rotation.from_matrix(WORLD @ attitudes @ BODY).as_quat()
    return quaternions
