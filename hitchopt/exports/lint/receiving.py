"""Lint of what mavsdk_drone_show makes of its files: rows that it replaces or shifts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.mavsdk_receiver import LATE, NAMES, Receiver
from hitchopt.exports.lint.findings import ERROR, NOTE, WARNING, Finding
from hitchopt.exports.manifest import read_manifest

Array = NDArray[np.float64]

REMAINING = 0.1
"""[m] Rows that move a drone no farther, seen from above, may be replaced by a climb or a landing;
so far may a first row be from the ground."""


def receiver_findings(folder: Path, names: Sequence[str], tables: Sequence[Array]) -> list[Finding]:
    """Return which rows are not flown as they stand, one finding a rule.

    With the settings that the folder's manifest states, else with those that the show comes with.

    Parameters
    ----------
    folder: of the files.
    names: (D,) of the drones.
    tables: of each drone, (S, 10) as they stand in its file, with common times.

    Raises
    ------
    FileError: a manifest that cannot be read.
    """
    settings = _settings(folder)
    receiver = Receiver() if settings is None else Receiver.of(settings)
    t = tables[0][:, 0]
    places = np.stack([table[:, 1:4] for table in tables], axis=1)
    followed = receiver.followed(t, places, 0.0 if settings is None else LATE)
    findings = [
        *_never(receiver, names, places, followed),
        *_replaced(receiver, names, t, places, followed),
        *_lowered(receiver, names, places, foreign=settings is None),
    ]
    if settings is not None and receiver != Receiver():
        told = ", ".join(f"{name} = {value}" for name, value in receiver.settings().items())
        findings.append(
            Finding(NOTE, "settings", "", f"flown as they stand only with {told} in src/params.py")
        )
    return findings


def _settings(folder: Path) -> dict[str, object] | None:
    """Return what the manifest says of the receiver; None where it says nothing."""
    manifest = read_manifest(folder)
    receiver = manifest.get("receiver") if manifest else None
    settings = receiver.get("settings") if isinstance(receiver, dict) else None
    if settings is not None and not isinstance(settings, dict):
        raise FileError(f"{folder}: its manifest's settings of the receiver are no map")
    return settings


def _never(
    receiver: Receiver, names: Sequence[str], places: Array, followed: NDArray[np.bool_]
) -> list[Finding]:
    never = np.flatnonzero(~followed.any(axis=0))
    if len(never) == 0:
        return []
    highest = float(np.max(-places[:, never, 2] - receiver.lowered(places)[never]))
    return [
        Finding(
            ERROR,
            "climb",
            _whose(names, never),
            f"mavsdk_drone_show flies none of its rows: it climbs until a row is at "
            f"{receiver.climb_altitude:g} m and {receiver.climb_time:g} s have passed, and they go "
            f"up to {highest:.4g} m; set {NAMES['climb_altitude']} below them and "
            f"{NAMES['climb_time']} to 0",
        )
    ]


def _replaced(
    receiver: Receiver, names: Sequence[str], t: Array, places: Array, followed: NDArray[np.bool_]
) -> list[Finding]:
    """Return whose rows before the first and after the last one that is flown move it."""
    flown = followed.any(axis=0)
    first = np.argmax(followed, axis=0)
    last = len(t) - 1 - np.argmax(followed[::-1], axis=0)
    each = np.arange(places.shape[1])
    rows = np.arange(len(t))[:, None]
    found = []
    for rule, lost, met, end, remedy in (
        (
            "climb",
            rows < first,
            first,
            "before",
            f"let it wait until then, or set {NAMES['climb_altitude']} and {NAMES['climb_time']} "
            "lower",
        ),
        (
            "landing",
            rows > last,
            last,
            "after",
            f"end higher, or set {NAMES['ground_altitude']} below {receiver.ground_altitude:g}",
        ),
    ):
        across = np.linalg.norm((places - places[met, each])[..., :2], axis=-1)
        moved = np.max(np.where(lost, across, 0.0), axis=0) * flown
        if np.max(moved) <= REMAINING:
            continue
        drone = int(np.argmax(moved))
        found.append(
            Finding(
                WARNING,
                rule,
                _whose(names, np.flatnonzero(moved > REMAINING), drone),
                f"mavsdk_drone_show replaces its rows {end} t = {t[met[drone]]:.4g} s by a "
                f"{rule}, and they move it by {moved[drone]:.3g} m across; {remedy}",
            )
        )
    return found


def _lowered(
    receiver: Receiver, names: Sequence[str], places: Array, *, foreign: bool
) -> list[Finding]:
    """Return who flies lower than its rows because its first one is not on the ground."""
    if foreign:  # nobody knows; every mode but one counts from the first row
        receiver = Receiver(shared_origin=False)
    lower = receiver.lowered(places)
    drone = int(np.argmax(np.abs(lower)))
    if abs(lower[drone]) <= REMAINING:
        return []
    return [
        Finding(
            WARNING,
            "launch",
            _whose(names, np.flatnonzero(np.abs(lower) > REMAINING), drone),
            f"its first row is at {lower[drone]:.3g} m: unless {NAMES['shared_origin']} is on, "
            "altitudes are counted from there, and it flies so much lower; begin on the ground",
        )
    ]


def _whose(names: Sequence[str], drones: NDArray[np.intp], one: int | None = None) -> str:
    name = names[int(drones[0]) if one is None else one]
    return name if len(drones) == 1 else f"{name} and {len(drones) - 1} more"
