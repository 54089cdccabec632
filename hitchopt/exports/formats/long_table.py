"""The table that scripts read: one row per sample and drone, written and read in blocks.

``ff_*`` is the acceleration to feed forward to a controller that adds gravity itself:
``a_ff = a - F / m`` with the cable's force F on the drone, so that the thrust is
``m (a_ff + g ẑ)``. ``q*`` is the attitude that points the thrust so, from the body's axes to the
file's, and ``rate_*`` its angular velocity about the body's axes
(``hitchopt.exports.formats.attitude_in_frame``).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.attitude_in_frame import attitudes_of
from hitchopt.exports.formats.format import Candidate, Format, Task
from hitchopt.exports.recording import Recording, Samples, check_times, recording_of_samples
from hitchopt.exports.reference_frame import AXES
from hitchopt.motion.states import iterate_states, sample_times
from hitchopt.values import Array

GROUPS = {
    "positions": ("x", "y", "z"),
    "velocities": ("vx", "vy", "vz"),
    "accelerations": ("ax", "ay", "az"),
    "jerks": ("jx", "jy", "jz"),
    "yaw": ("yaw",),
    "cable_forces": ("cable_x", "cable_y", "cable_z"),
    "feed_forward": ("ff_x", "ff_y", "ff_z"),
    "quaternions": ("qw", "qx", "qy", "qz"),
    "body_rates": ("rate_x", "rate_y", "rate_z"),
}
"""Quantities of a row and their columns: [m], [m/s], [m/s²], [m/s³], [rad], [N], [m/s²], 1,
[rad/s]."""

COLUMNS = tuple(name for group in GROUPS.values() for name in group)
"""Names of the numbers of a row, after ``t`` and ``drone``."""

FLOWN = COLUMNS[:9]
"""Columns that say where the drones go; readers need no others."""

PLACED = ("t", "drone", *FLOWN[:3])
"""Columns that every table needs; without the others it tells positions alone."""

SMOOTH = 2
"""Positions, velocities and accelerations are in the table: quintics run through them."""

ROWS = 50_000
"""Rows that are held at a time: 12 MB of numbers."""


class Table(Format):
    """A format that samples a plan for scripts.

    Attributes
    ----------
    file: name of its one file, in which ``{frame}`` stands for the frame's.
    """

    frames = tuple(AXES)
    rate = 100.0
    accuracy = 1e-3
    feed_forward = (
        "ff_* = a - F/m, the cable's force F and the drone's mass m: for controllers that add "
        "gravity themselves; cable_* = F for those that take forces; a alone for those that know "
        "the cable"
    )
    carries_pull = True
    receiver_integral = False
    file: str

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the one file there is."""
        name = self.file.format(frame=task.frame.name)
        yield Candidate({name: partial(self.write_file, task=task)})

    def read(self, folder: Path, task: Task) -> Recording:
        """Return what the file says."""
        return self.read_file(folder / self.file.format(frame=task.frame.name))

    @staticmethod
    @abstractmethod
    def write_file(path: Path, task: Task) -> None:
        """Write the file block by block."""

    @staticmethod
    @abstractmethod
    def read_file(path: Path) -> Recording:
        """Return what the file says, block by block."""


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of consecutive samples.

    Attributes
    ----------
    t: (S,) [s]
    values: (S, D, C), the numbers of COLUMNS.
    """

    t: Array
    values: Array


def blocks_of(task: Task, rows: int = ROWS) -> Iterator[Block]:
    """Yield the table in the file's axes, in blocks of at most ``rows`` rows (one sample at least).

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    """
    times = sample_times(task.motion.duration, task.rate)
    drones = len(task.names)
    for states in iterate_states(task.motion, times, max(1, rows // drones)):
        frame = task.frame
        positions, velocities, forward = task.setpoints(states)
        attitudes = attitudes_of(task, states)
        parts = (
            positions,
            velocities,
            frame.vectors(states.accelerations),
            frame.vectors(states.jerks),
            np.full((len(states.t), drones, 1), frame.heading),
            task.cable_forces(states),
            forward,
            attitudes.quaternions,
            attitudes.body_rates,
        )
        yield Block(states.t, np.concatenate(parts, axis=-1) + 0.0)  # no negative zeros


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows as they stand in a file.

    Attributes
    ----------
    t: (rows,) [s]
    drones: (rows,) names.
    values: (rows, 9), those of FLOWN.
    """

    t: Array
    drones: Sequence[str]
    values: Array

    @classmethod
    def telling(cls, t: Array, drones: Sequence[str], values: Array, told: Sequence[str]) -> Rows:
        """Return rows of the told columns (rows, …), zero where a table tells nothing."""
        whole = np.zeros((len(values), len(FLOWN)))
        whole[:, [FLOWN.index(name) for name in told]] = values
        return cls(t, drones, whole)


def told_in(header: Collection[str]) -> list[str]:
    """Return which of FLOWN a table with these columns tells.

    Positions are always among them; velocities and accelerations are, where they are whole.
    """
    vectors = [FLOWN[:3], *(v for v in (FLOWN[3:6], FLOWN[6:]) if set(v) <= set(header))]
    return [name for vector in vectors for name in vector]


def read_rows(path: Path, rows: Callable[[Path], Iterator[Rows]], frame: str) -> Recording:
    """Return the recording of a file of rows, which ``rows`` reads anew every time.

    Raises
    ------
    FileError: no rows, a first time that is no number, or a drone that comes twice in the first
        sample.
    """
    first = next(rows(path), None)
    if first is None:
        raise FileError(f"{path}: holds no rows; it is truncated")
    check_times(first.t[:1], str(path))
    later = np.flatnonzero(first.t != first.t[0])
    names = tuple(first.drones[: int(later[0]) if len(later) else len(first.drones)])
    if len(set(names)) != len(names):
        raise FileError(f"drone {names[-1]!r} comes twice at t = {first.t[0]:g} s")
    return recording_of_samples(names, lambda: _grouped(rows(path), names), frame, SMOOTH)


def _grouped(parts: Iterable[Rows], names: Sequence[str]) -> Iterator[Samples]:
    """Yield the rows sample by sample.

    Raises
    ------
    FileError: rows that are not by time and then drone, or an unfinished sample.
    """
    count = len(names)
    expected = np.array(names)
    rest = Rows(np.empty(0), (), np.empty((0, len(FLOWN))))
    for part in parts:
        rows = Rows(
            np.concatenate([rest.t, part.t]),
            [*rest.drones, *part.drones],
            np.concatenate([rest.values, part.values]),
        )
        whole = len(rows.t) // count * count
        rest = Rows(rows.t[whole:], rows.drones[whole:], rows.values[whole:])
        if whole == 0:
            continue
        t = rows.t[:whole].reshape(-1, count)
        found = np.array(rows.drones[:whole]).reshape(-1, count)
        if np.any(wrong := np.any((t != t[:, :1]) | (found != expected), axis=1)):
            raise FileError(
                f"its rows at t = {t[np.argmax(wrong), 0]:g} s are not one per drone, in one "
                "order; sort them by time, then drone"
            )
        yield Samples.of_rows(t[:, 0], rows.values[:whole].reshape(-1, count, len(FLOWN)))
    if len(rest.t):
        raise FileError(f"ends within the sample at t = {rest.t[0]:g} s; it is truncated")
