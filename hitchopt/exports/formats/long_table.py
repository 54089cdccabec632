"""The table that scripts read: one row per sample and drone, written and read in blocks.

``ff_*`` is the acceleration to feed forward to a controller that adds gravity itself:
``a_ff = a - F / m`` with the cable's force F on the drone, so that the thrust is
``m (a_ff + g ẑ)``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Task, Whole, pull_of
from hitchopt.exports.frame import AXES
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.motion.states import iterate_states, sample_times

Array = NDArray[np.float64]

VECTORS = (
    ("x", "y", "z"),
    ("vx", "vy", "vz"),
    ("ax", "ay", "az"),
    ("jx", "jy", "jz"),
    ("yaw",),
    ("cable_x", "cable_y", "cable_z"),
    ("ff_x", "ff_y", "ff_z"),
)

COLUMNS = tuple(name for group in VECTORS for name in group)
"""The numbers of a row, after ``t`` and ``drone``: [m], [m/s], [m/s²], [m/s³], [rad], [N], [m/s²]
by groups."""

FLOWN = COLUMNS[:9]
"""Those that say where the drones go; readers need no others."""

PLACED = ("t", "drone", *FLOWN[:3])
"""Columns that every table needs; without the others it tells positions alone."""

SMOOTH = 2
"""Positions, velocities and accelerations are in the table: quintics run through them."""

FEED_FORWARD = (
    "ff_* = a - F/m, the cable's force F and the drone's mass m: for controllers that add gravity "
    "themselves; cable_* = F for those that take forces; a alone for those that know the cable"
)


class Table(Whole):
    """What formats that sample a plan for scripts have in common."""

    frames = tuple(AXES)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = FEED_FORWARD


ROWS = 100_000
"""Rows that are held at a time: 16 MB of numbers."""


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of consecutive samples.

    Attributes
    ----------
    t: (S,) [s]
    values: (S, D, C), the numbers of COLUMNS, or of FLOWN where that is all that was read.
    """

    t: Array
    values: Array


def sample_count(task: Task) -> int:
    """Return how many samples the table has."""
    return len(sample_times(task.motion.duration, task.rate))


def blocks_of(task: Task, rows: int = ROWS) -> Iterator[Block]:
    """Yield the table in the file's axes, in blocks of at most ``rows`` rows (one sample at least).

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    """
    times = sample_times(task.motion.duration, task.rate)
    drones = len(task.names)
    for states in iterate_states(task.motion, times, max(1, rows // drones)):
        room = task.room
        parts = (
            room.points(states.positions),
            room.vectors(states.velocities),
            room.vectors(states.accelerations),
            room.vectors(states.jerks),
            np.full((len(states.t), drones, 1), room.heading),
            room.vectors(states.cable_forces),
            room.vectors(states.accelerations) - pull_of(task, states),
        )
        yield Block(states.t, np.concatenate(parts, axis=-1) + 0.0)  # no negative zeros


def samples_of(t: Array, values: Array) -> Samples:
    """Return the samples of a block (S, D, C), FLOWN first."""
    return Samples(t, np.moveaxis(values[..., :9].reshape(*values.shape[:2], 3, 3), 2, 0))


def recording_of_rows(
    names: Sequence[str], blocks: Callable[[], Iterator[Block]], frame: str
) -> Recording:
    """Return the recording of a table's blocks, which ``blocks`` gives anew every time."""
    return recording_of_samples(
        names, lambda: (samples_of(b.t, b.values) for b in blocks()), frame, SMOOTH
    )


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows as they stand in a file.

    Attributes
    ----------
    t: (rows,) [s]
    drones: (rows,) names.
    values: (rows, C)
    """

    t: Array
    drones: Sequence[str]
    values: Array


def columns_told(header: Collection[str]) -> list[int]:
    """Return which of FLOWN a table with these columns tells, as indices; vectors in whole only."""
    return [i for i in range(9) if set(FLOWN[i // 3 * 3 : i // 3 * 3 + 3]) <= set(header)]


def spread_out(values: Array, told: Sequence[int]) -> Array:
    """Return the told columns (rows, …) as (rows, 9), zero where a table tells nothing."""
    whole = np.zeros((len(values), len(FLOWN)))
    whole[:, told] = values
    return whole


def first_names(rows: Rows) -> tuple[str, ...]:
    """Return the drones of the first sample: the names until one comes again or time goes on."""
    later = np.flatnonzero(rows.t != rows.t[0])
    names = tuple(rows.drones[: int(later[0]) if len(later) else len(rows.drones)])
    if len(set(names)) != len(names):
        raise FileError(f"drone {names[-1]!r} comes twice at t = {rows.t[0]:g} s")
    return names


def grouped(parts: Iterable[Rows], names: Sequence[str]) -> Iterator[Block]:
    """Yield the rows sample by sample.

    Raises
    ------
    FileError: rows that are not by time and then drone, or an unfinished sample.
    """
    count = len(names)
    expected = np.array(names)
    rest: Rows | None = None
    for part in parts:
        rows = part if rest is None else _joined(rest, part)
        whole = len(rows.t) // count * count
        rest = Rows(rows.t[whole:], rows.drones[whole:], rows.values[whole:])
        if whole == 0:
            continue
        t = rows.t[:whole].reshape(-1, count)
        found = np.array(rows.drones[:whole]).reshape(-1, count)
        if np.any(t != t[:, :1]) or np.any(found != expected):
            wrong = int(np.flatnonzero(np.any((t != t[:, :1]) | (found != expected), axis=1))[0])
            raise FileError(
                f"its rows at t = {t[wrong, 0]:g} s are not one per drone, in one order; "
                "sort them by time, then drone"
            )
        yield Block(t[:, 0], rows.values[:whole].reshape(-1, count, rows.values.shape[-1]))
    if rest is not None and len(rest.t):
        raise FileError(f"ends within the sample at t = {rest.t[0]:g} s; it is truncated")


def _joined(a: Rows, b: Rows) -> Rows:
    return Rows(
        np.concatenate([a.t, b.t]),
        [*a.drones, *b.drones],
        np.concatenate([a.values, b.values]),
    )
