"""Reading a Skybrush show (.skyc), ours or anybody else's."""

from __future__ import annotations

import json
import posixpath
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

MAX_UNPACKED = 500_000_000
"""[bytes] Of one file in the zip."""

MILLI = 1e-3
"""[m], [s] Skybrush's server stores whole ones."""

REACH = 32768
"""Numbers that 16 bits with a sign tell from zero, on either side."""

MAX_DRONES = 20_000

DEGREE = 3


def drones_of_show(path: Path) -> dict[str, PiecewisePolynomial]:
    """Return the positions (3,) [m] of every drone over the show's time, by name.

    Raises
    ------
    FileError: no zip, no show, or a trajectory that is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            show = _json(archive, "show.json")
            drones = show["swarm"]["drones"]
            if not isinstance(drones, list) or not 0 < len(drones) <= MAX_DRONES:
                raise FileError(f"{path}: show.json names no drones")
            found = {}
            for number, drone in enumerate(drones):
                settings = drone["settings"]
                name = str(settings.get("name", number + 1))
                if name in found:
                    raise FileError(f"{path}: two drones are called {name!r}")
                trajectory = _resolved(archive, settings["trajectory"])
                found[name] = _curve(f"{path}: {name}", trajectory)
            return found
    except (OSError, ValueError, zipfile.BadZipFile, zlib.error, RuntimeError) as error:
        raise FileError(f"{path}: is no Skybrush show, or a damaged one: {error}") from error
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise FileError(f"{path}: is no Skybrush show: {error!r} where a drone is told") from error


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


def _json(archive: zipfile.ZipFile, name: str) -> Any:
    if archive.getinfo(name).file_size > MAX_UNPACKED:
        raise FileError(f"{name}: is too large")
    return json.loads(archive.read(name))


def _resolved(archive: zipfile.ZipFile, value: Any) -> Any:
    if isinstance(value, dict) and isinstance(value.get("$ref"), str):
        name = posixpath.normpath(value["$ref"].partition("#")[0])
        return _json(archive, name)
    return value


def _curve(source: str, trajectory: Any) -> PiecewisePolynomial:
    points = trajectory["points"]
    start = float(trajectory.get("takeoffTime", 0.0))
    if len(points) < 2:
        raise FileError(f"{source}: its trajectory has {len(points)} points; two are the least")
    times = start + np.array([float(point[0]) for point in points])
    places = np.array([point[1] for point in points], dtype=np.float64)
    if places.shape != (len(points), 3) or not np.all(np.diff(times) > 0.0):
        raise FileError(f"{source}: its points are not [t, [x, y, z], …] with t increasing")
    pieces = [
        _piece(source, places[i], points[i + 1][2:], places[i + 1]) for i in range(len(points) - 1)
    ]
    if times[0] > 0.0:  # it waits for its turn to take off
        waiting = np.repeat(places[:1, :, None], DEGREE + 1, axis=2)[0]
        times, pieces = np.concatenate([[0.0], times]), [waiting, *pieces]
    try:
        return PiecewisePolynomial(times, np.stack(pieces))
    except InputError as error:
        raise FileError(f"{source}: {error}") from error


def _piece(source: str, first: Array, rest: Sequence[Any], last: Array) -> Array:
    inner = np.array(rest[0] if rest and rest[0] else np.empty((0, 3)), dtype=np.float64)
    if inner.shape[1:] != (3,) or len(inner) > DEGREE - 1:
        raise FileError(f"{source}: control points {inner.shape}; cubic is the most there is")
    points = np.concatenate([first[None], inner, last[None]])
    return bernstein.elevate(points.T, DEGREE)
