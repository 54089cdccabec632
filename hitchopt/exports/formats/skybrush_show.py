"""Reading a Skybrush show (.skyc), ours or anybody else's."""

from __future__ import annotations

import posixpath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import opened_zip, read_members
from hitchopt.exports.recording import check_times
from hitchopt.storage.strict_json import parsed_json
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

MILLI = 1e-3
"""Unit of what Skybrush's server stores, [m] and [s]."""

REACH = 32768
"""Numbers on either side of zero that 16 bits with a sign hold."""

MAX_DRONES = 20_000
"""Size limit of a show that is read."""

DEGREE = 3
"""Degree of the pieces."""


@dataclass(frozen=True, eq=False)
class Show:
    """What a show holds, as far as it is read.

    Attributes
    ----------
    curves: positions (3,) [m] over the show's time, by drone.
    homes: what stands as the home of a drone, unchecked; None where nothing does.
    validation: the limits that the show sets itself, unchecked.
    returns: what stands as the returns of a drone, unchecked; None where nothing does.
    """

    curves: dict[str, PiecewisePolynomial]
    homes: dict[str, Any]
    validation: Mapping[str, Any]
    returns: dict[str, Any]


def read_show(path: Path) -> Show:
    """Return the show; each file in the zip is read once, however many drones refer to it.

    Raises
    ------
    FileError: no zip, no show, a trajectory that is damaged, or more than anyone flies.
    """
    with opened_zip(path, "Skybrush show") as archive:
        (content,) = read_members(path, archive, [archive.getinfo("show.json")])
        show = parsed_json(content)
        settings = _settings(path, show["swarm"]["drones"])
        given = {name: each["trajectory"] for name, each in settings.items()}
        files = {name: _file(trajectory) for name, trajectory in given.items()}
        members = {file: archive.getinfo(file) for file in files.values() if file}
        first = {file: name for name, file in reversed(files.items())}
        contents = read_members(path, archive, list(members.values()))
        shared = {
            file: _curve(f"{path}: {first[file]}", parsed_json(content))
            for file, content in zip(members, contents, strict=True)
        }
        curves = {
            name: shared[file] if file else _curve(f"{path}: {name}", given[name])
            for name, file in files.items()
        }
        homes = {name: each.get("home") for name, each in settings.items()}
        returns = {name: each.get("rthPlan") for name, each in settings.items()}
        own = show.get("settings")
    validation = own.get("validation") if isinstance(own, dict) else None
    return Show(curves, homes, validation if isinstance(validation, dict) else {}, returns)


def storage_scale(curves: PiecewisePolynomial, beyond: float = 0.0) -> int:
    """Return the least multiple of millimetres that all drones (…, 3) can be stored in.

    Every drone's curve is stored in multiples of its own, by how far its points reach; rounding may
    move them farther by ``beyond`` [m].
    """
    reach = np.max(np.abs(curves.coefficients), axis=(0, -2, -1)) + beyond
    scales = (np.ceil(reach / MILLI).astype(np.int64) + REACH) // REACH
    return int(np.lcm.reduce(np.atleast_1d(scales)))


def stored(curve: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the curve (3,) of one drone as the server stores it: digits beyond are cut off."""
    scale = storage_scale(curve)
    points = np.trunc(curve.coefficients * (1000.0 / scale)) * (scale * MILLI)
    lasting = np.floor(np.round(curve.durations, 3) * 1000.0) * MILLI
    first = float(np.round(curve.breaks[0], 3))
    return PiecewisePolynomial(first + np.concatenate([[0.0], np.cumsum(lasting)]), points)


def _settings(path: Path, drones: Any) -> dict[str, Any]:
    """Return the settings of a show's drones, by their names."""
    if not isinstance(drones, list) or not 0 < len(drones) <= MAX_DRONES:
        raise FileError(f"{path}: show.json names no drones, or more than {MAX_DRONES}")
    found: dict[str, Any] = {}
    for number, drone in enumerate(drones):
        settings = drone["settings"]
        name = str(settings.get("name", number + 1))
        if name in found:
            raise FileError(f"{path}: two drones are called {name!r}")
        found[name] = settings
    return found


def _file(trajectory: Any) -> str | None:
    """Return the zip's file that a trajectory is in; None where it stands in the show itself."""
    reference = trajectory.get("$ref") if isinstance(trajectory, dict) else None
    if not isinstance(reference, str):
        return None
    return posixpath.normpath(reference.partition("#")[0])


def _curve(source: str, trajectory: Any) -> PiecewisePolynomial:
    points = trajectory["points"]
    start = float(trajectory.get("takeoffTime", 0.0))
    if not isinstance(points, list) or len(points) < 2:
        count = len(points) if isinstance(points, list) else 0
        raise FileError(f"{source}: its trajectory has {count} points; two are the least")
    times = start + np.array([point[0] for point in points], dtype=np.float64)
    places = np.array([point[1] for point in points], dtype=np.float64)
    if times.shape != (len(points),) or places.shape != (len(points), 3):
        raise FileError(f"{source}: its points are not [t, [x, y, z], …]")
    check_times(times, source)
    coefficients = _cubics(source, places, [point[2] if point[2:] else [] for point in points[1:]])
    if times[0] > 0.0:  # it waits for its turn to take off
        waiting = np.broadcast_to(places[0][None, :, None], (1, 3, DEGREE + 1))
        times = np.concatenate([[0.0], times])
        coefficients = np.concatenate([waiting, coefficients])
    return PiecewisePolynomial(times, coefficients)


def _cubics(source: str, places: Array, controls: Sequence[Any]) -> Array:
    """Return the pieces (P, 3, 4) between places (P + 1, 3), by their numbers of controls."""
    counts = np.array([len(inner or ()) for inner in controls])
    if np.any(counts >= DEGREE):
        raise FileError(f"{source}: {np.max(counts)} control points; cubic is the most there is")
    coefficients = np.empty((len(counts), 3, DEGREE + 1))
    for count in range(DEGREE):
        which = np.flatnonzero(counts == count)
        if len(which) == 0:
            continue
        inner = np.empty((len(which), 0, 3))
        if count:
            inner = np.array([controls[i] for i in which.tolist()], dtype=np.float64)
        if inner.shape != (len(which), count, 3):
            raise FileError(f"{source}: its control points are not [x, y, z]")
        ends = places[which, None], places[which + 1, None]
        points = np.concatenate([ends[0], inner, ends[1]], axis=1)
        coefficients[which] = bernstein.elevate(np.moveaxis(points, 1, 2), DEGREE)
    return coefficients
