"""Rules for files of mavsdk_drone_show: which rows the receiver replaces or shifts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.mavsdk_receiver import LATE, NAMES, Receiver
from hitchopt.exports.lint.findings import Finding, and_more, error, note, warning
from hitchopt.exports.manifest import read_manifest
from hitchopt.values import Array

REMAINING = 0.1
"""[m] Rows that move a drone no farther, seen from above, may be replaced by a climb or a landing;
so far may a first row be from the ground."""


def receiver_findings(
    folder: Path, names: Sequence[str], tables: Sequence[Array]
) -> Iterator[Finding]:
    """Yield which rows are not flown as they stand, one finding a rule.

    The settings are those that the folder's manifest states, else those that the show comes with.

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
    yield from _never(receiver, names, places, followed)
    yield from _replaced(receiver, names, t, places, followed)
    # Without settings the mode is unknown; every mode but one counts from the first row.
    yield from _lowered(
        Receiver(shared_origin=False) if settings is None else receiver, names, places
    )
    if settings is not None and receiver != Receiver():
        stated = ", ".join(f"{name} = {value}" for name, value in receiver.settings().items())
        yield note("settings", "", f"flown as they stand only with {stated} in src/params.py")


def _settings(folder: Path) -> dict[str, object] | None:
    """Return the receiver's settings in the manifest; None where it has none."""
    receiver = (read_manifest(folder) or {}).get("receiver")
    settings = receiver.get("settings") if isinstance(receiver, dict) else None
    if settings is not None and not isinstance(settings, dict):
        raise FileError(f"{folder}: its manifest's settings of the receiver are no map")
    return settings


def _never(
    receiver: Receiver, names: Sequence[str], places: Array, followed: NDArray[np.bool_]
) -> Iterator[Finding]:
    never = np.flatnonzero(~followed.any(axis=0))
    if len(never) > 0:
        highest = float(np.max(-places[:, never, 2] - receiver.lowered(places)[never]))
        yield error(
            "climb",
            and_more(names[never[0]], len(never)),
            f"mavsdk_drone_show flies none of its rows: it climbs until a row is at "
            f"{receiver.climb_altitude:g} m and {receiver.climb_time:g} s have passed, and they go "
            f"up to {highest:.4g} m; set {NAMES['climb_altitude']} below them and "
            f"{NAMES['climb_time']} to 0",
        )


def _replaced(
    receiver: Receiver, names: Sequence[str], t: Array, places: Array, followed: NDArray[np.bool_]
) -> Iterator[Finding]:
    """Yield whose rows before the first and after the last one that is flown move it."""
    flown = followed.any(axis=0)
    first = np.argmax(followed, axis=0)
    last = len(t) - 1 - np.argmax(followed[::-1], axis=0)
    each = np.arange(places.shape[1])
    rows = np.arange(len(t))[:, None]
    lower = f"{NAMES['climb_altitude']} and {NAMES['climb_time']} lower"
    land = f"{NAMES['ground_altitude']} below {receiver.ground_altitude:g}"
    for rule, lost, met, end, remedy in (
        ("climb", rows < first, first, "before", f"let it wait until then, or set {lower}"),
        ("landing", rows > last, last, "after", f"end higher, or set {land}"),
    ):
        across = np.linalg.norm((places - places[met, each])[..., :2], axis=-1)
        moved = np.max(np.where(lost, across, 0.0), axis=0) * flown
        drone = int(np.argmax(moved))
        if moved[drone] > REMAINING:
            yield warning(
                rule,
                and_more(names[drone], np.count_nonzero(moved > REMAINING)),
                f"mavsdk_drone_show replaces its rows {end} t = {t[met[drone]]:.4g} s by a "
                f"{rule}, and they move it by {moved[drone]:.3g} m across; {remedy}",
            )


def _lowered(receiver: Receiver, names: Sequence[str], places: Array) -> Iterator[Finding]:
    """Yield who flies lower than its rows because its first one is not on the ground."""
    lower = receiver.lowered(places)
    drone = int(np.argmax(np.abs(lower)))
    if abs(lower[drone]) > REMAINING:
        yield warning(
            "launch",
            and_more(names[drone], np.count_nonzero(np.abs(lower) > REMAINING)),
            f"its first row is at {lower[drone]:.3g} m: unless {NAMES['shared_origin']} is on, "
            "altitudes are counted from there, and it flies so much lower; begin on the ground",
        )
