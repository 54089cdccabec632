"""What files say: text, tables and manifests, and the curves of time that their drones fly.

Every fault of a file is a FileError. A recording is read off exported numbers, ours or anybody
else's, after rounding. Windows follow one another without a gap, so that the curves and bounds of
long flights are not held in memory.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.exports.placing import AXES
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import SAME_BREAK, merged_breaks, on_breaks
from hitchopt.values import Array

WINDOW = 20_000
"""Pieces times drones that are read together: about 40 MB of coefficients and bounds."""

MAX_SPANS = 20_000_000
"""Largest number of pieces times drones with all drones' breaks merged; no show has more."""

SAME_TIME = 1e-9  # Largest difference of samples that are of one time [s]


@dataclass(frozen=True, eq=False)
class Recording:
    """The curves that exported numbers stand for.

    ``smooth`` is the highest derivative by time that does not jump: 0 positions, 1 velocities, 2
    accelerations. ``windows`` gives the curves (D, 3) [m] over one span of time after the other.
    ``untold`` says which derivatives the format has and the files do not hold.
    """

    names: tuple[str, ...]  # (D,) of the drones, in the file's order
    frame: str  # enu, nwu or ned; empty where the file does not say
    smooth: int
    windows: Callable[[], Iterator[PiecewisePolynomial]]
    untold: str = ""


def recording_of_curves(
    names: Sequence[str], curves: Sequence[PiecewisePolynomial], frame: str, smooth: int
) -> Recording:
    """Return the recording of one curve (3,) per drone, each with breaks of its own from 0.

    Drones that end before the others stay where they ended. Curves are put on common breaks window
    by window, so that drones with breaks of their own take no more memory than their files.

    Raises
    ------
    FileError: common breaks times drones beyond MAX_SPANS.
    """
    end = max(float(curve.breaks[-1]) for curve in curves)
    degree = max(curve.degree for curve in curves)
    each = [lasted(curve.elevated(degree), end) for curve in curves]
    times, pieces = [curve.breaks for curve in each], each[0].pieces
    if same := all(np.array_equal(t, times[0]) for t in times):
        breaks = times[0]
    else:
        pieces = len(np.unique(np.rint(np.concatenate(times) / SAME_BREAK))) - 1
    if pieces * len(each) > MAX_SPANS:
        raise FileError(
            f"{len(each)} drones with {pieces} spans of time between their points are more than "
            f"{MAX_SPANS} together; give all drones the same times, or fewer points"
        )
    if not same:
        breaks = merged_breaks(times)
    size = max(1, WINDOW // len(each))

    def windows() -> Iterator[PiecewisePolynomial]:
        for start in range(0, len(breaks) - 1, size):
            here = breaks[start : start + size + 1]
            if same:
                parts = [curve.coefficients[start : start + size] for curve in each]
            else:
                parts = [on_breaks(curve, here).coefficients for curve in each]
            yield PiecewisePolynomial(here, np.stack(parts, axis=1))

    return Recording(tuple(names), frame, smooth, windows)


def recording_of_samples(
    names: Sequence[str], t: Array, values: Array, frame: str, smooth: int
) -> Recording:
    """Return the recording of samples: between two of them the curve that meets both.

    The curves are straight lines through positions, cubics through velocities as well, and quintics
    through accelerations too.

    Parameters
    ----------
    names: (D,)
    t: (S,) [s]
    values: (S, D, 3 m), positions, then velocities and accelerations as far as there are any.
    frame: an unknown one becomes none.
    smooth: the highest derivative that the format has.

    Raises
    ------
    FileError: times that do not increase, or fewer than two samples.
    """
    check_times(t)
    if len(t) < 2:
        raise FileError("has fewer than two samples; nothing moves between them")
    given = np.moveaxis(values.reshape(len(t), len(names), -1, 3), 2, 0)
    untold = ("velocities", "accelerations")[len(given) - 1] if len(given) <= smooth else ""
    size = max(1, WINDOW // len(names))

    def windows() -> Iterator[PiecewisePolynomial]:
        for start in range(0, len(t) - 1, size):
            ends = given[:, start : start + size + 1]
            here = t[start : start + size + 1]
            yield PiecewisePolynomial.hermite(here, ends[:, :-1], ends[:, 1:])

    known = frame if frame in AXES else ""
    return Recording(tuple(names), known, len(given) - 1, windows, untold)


def told_columns(header: Collection[str], vectors: Sequence[Sequence[str]]) -> list[str]:
    """Return the columns that a table tells: places, then whole vectors of rates in a row."""
    told = takewhile(lambda vector: set(vector) <= set(header), vectors[1:])
    return [name for vector in (vectors[0], *told) for name in vector]


def check_times(t: Array, source: str = "") -> None:
    """Raise FileError unless the times (S,) [s] increase, naming what they do instead."""
    place = f"{source}: " if source else ""
    if not np.all(np.isfinite(t)):
        raise FileError(f"{place}a time is nan or infinite; every row needs one in seconds")
    wrong = np.flatnonzero(np.diff(t) <= SAME_TIME)
    if wrong.size:
        before, after = t[wrong[0]], t[wrong[0] + 1]
        if after - before >= -SAME_TIME:
            raise FileError(f"{place}repeats the time t = {after:g} s; keep one row of every time")
        raise FileError(
            f"{place}its times go back from t = {before:g} s to {after:g} s; sort its rows"
        )


def lasted(curve: PiecewisePolynomial, end: float) -> PiecewisePolynomial:
    """Return the curve, staying where it ended until ``end`` [s], if that is later."""
    if end <= curve.breaks[-1]:
        return curve
    rest = np.broadcast_to(curve.coefficients[-1:, ..., -1:], curve.coefficients[-1:].shape)
    return PiecewisePolynomial(
        np.append(curve.breaks, end), np.concatenate([curve.coefficients, rest])
    )


MANIFEST, MANIFEST_FORMAT = "export.json", "hitchopt-export/1"
"""Name of the file with what an export holds, in which frame, and what was checked; its format."""

MAX_MANIFEST = 50_000_000  # Size limit of a manifest that is read [B]


def read_text(path: Path) -> str:
    """Return a file's text in UTF-8, with or without a byte order mark.

    Raises
    ------
    FileError: it cannot be read, or is no such text.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read: {error}") from error


def read_columns(
    lines: Iterable[str],
    header: str,
    wanted: Sequence[str],
    usual: str,
    source: str,
    least: int = 0,
    kind: type[np.float64 | np.str_] = np.float64,
) -> NDArray[Any]:
    """Return the wanted columns of a table's lines as numbers or text; blank ones are left out.

    Parameters
    ----------
    lines: of the table, without the first one.
    header: the first line.
    wanted: names of columns.
    usual: the first line that hitchopt writes.
    source: name of the file.
    least: fewest rows.
    kind: of the cells.

    Raises
    ------
    FileError: a column is missing, fewer rows, rows that are too short, or text that is no number.
    """
    labels = header.split(",")
    if missing := [name for name in wanted if name not in labels]:
        words = f"its first line has no column {missing[0]!r}; it must be {usual}"
        raise FileError(f"{source}: {words}")
    columns = [labels.index(name) for name in wanted]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of no rows
            table = np.loadtxt(lines, kind, delimiter=",", usecols=columns, ndmin=2, comments=None)
    except (ValueError, IndexError) as error:
        raise FileError(f"{source}: {error}; it is truncated or damaged") from error
    if len(table) < least:
        raise FileError(f"{source}: has {len(table)} rows; {least} are the least")
    return table


def needed(module: str) -> Any:
    """Return a module of a library that only some formats need.

    Raises
    ------
    UnsupportedError: it is not installed; the message says what to install.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise UnsupportedError(
            f"this format needs the package {package} ({error}); pip install 'hitchopt[export]'"
        ) from error


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return what the manifest in a folder says; None where there is none, or not one of ours.

    Raises
    ------
    FileError: there is one that cannot be read.
    """
    path = folder / MANIFEST
    try:
        if not path.is_file():
            return None
        if path.stat().st_size > MAX_MANIFEST:
            raise FileError(f"{path}: is too large for a manifest")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{path}: cannot be read: {error}; remove it, or export anew") from error
    ours = isinstance(content, dict) and content.get("format") == MANIFEST_FORMAT
    return content if ours else None
