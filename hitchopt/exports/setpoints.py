"""The table of a plan: setpoints by time, then drone, as text and as a data frame; vertices.csv.

The columns up to ``cable_z`` are those of ``setpoints.csv``. Exported tables have all: ``ff_*`` is
the acceleration to feed forward to a controller that adds gravity itself, ``a_ff = a - F / m`` with
the cable's force F on the drone, so that the thrust is ``m (a_ff + g ẑ)``; ``q*`` is the attitude
that points the thrust so, from the body's axes to the file's, and ``rate_*`` its angular velocity
about the body's axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import UnsupportedError
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, hitch_at, iterate_states, sample_times, states_at
from hitchopt.values import Array

if TYPE_CHECKING:
    from pandas import DataFrame

    from hitchopt.exports.format import Task

SAVED = {
    "positions": ("x", "y", "z"),
    "velocities": ("vx", "vy", "vz"),
    "accelerations": ("ax", "ay", "az"),
    "jerks": ("jx", "jy", "jz"),
    "yaw": ("yaw",),
    "cable_forces": ("cable_x", "cable_y", "cable_z"),
}
"""Quantities of a row and their columns: [m], [m/s], [m/s²], [m/s³], [rad], [N]."""

GROUPS = SAVED | {
    "feed_forward": ("ff_x", "ff_y", "ff_z"),
    "quaternions": ("qw", "qx", "qy", "qz"),
    "body_rates": ("rate_x", "rate_y", "rate_z"),
}
"""Those of exported tables: [m/s²], 1, [rad/s] as well."""

COLUMNS = tuple(name for group in GROUPS.values() for name in group)
"""Names of the numbers of an exported row, after ``t`` and ``drone``."""

HEADER = ",".join(("t", "drone", *(name for group in SAVED.values() for name in group)))

VERTICES_HEADER = "t,vertex,x,y,z,tension"

NUMBER = "%#.12g"
"""Format of numbers: twelve significant digits, below a nanometre over a kilometre. A decimal point
is always there, since readers such as polars take a column for whole numbers that begins with one.
"""

NOTHING = "%.1f"  # Format of numbers that are zero throughout a block: ``0.0``

ROWS = 2000
"""Rows that are formatted at once: more are slower, since they leave the processor's cache."""

Progress = Callable[[float], None]
"""Function that is called now and then with the fraction done, 0 to 1."""


def _values(states: States) -> Array:
    """Return the numbers of SAVED (S, D, 16)."""
    motion = (states.positions, states.velocities, states.accelerations, states.jerks)
    yaw = np.zeros((*states.positions.shape[:2], 1))
    values: Array = np.concatenate((*motion, yaw, states.cable_forces), axis=-1) + 0.0
    return values  # without negative zeros


def exported_blocks(task: Task, rows: int) -> Iterator[tuple[Array, Array]]:
    """Yield times (S,) [s] and the numbers of COLUMNS (S, D, 26) in blocks of so many rows.

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    """
    frame = task.frame
    for states in task.blocks(sample_times(task.motion.duration, task.rate), rows):
        positions, velocities, forward = task.setpoints(states)
        attitudes = task.attitudes(states)
        parts = (
            positions,
            velocities,
            frame.vectors(states.accelerations),
            frame.vectors(states.jerks),
            np.full((*positions.shape[:2], 1), frame.heading),
            frame.vectors(states.cable_forces),
            forward,
            attitudes.quaternions,
            attitudes.body_rates,
        )
        yield states.t, np.concatenate(parts, axis=-1) + 0.0  # no negative zeros


def write_setpoints(
    path: Path, motion: Motion, rate: float, progress: Progress | None = None
) -> None:
    """Write one row per sample and drone, by time, then drone; yaw is 0.

    Parameters
    ----------
    path: name of the file, replaced if there is one.
    motion: the plan.
    rate: samples a second [Hz].
    progress: called with the fraction done.

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    OSError: the file cannot be written.
    """
    times, names = sample_times(motion.duration, rate), motion.team.drone_names

    def blocks() -> Iterator[tuple[Array, Array]]:
        for states in iterate_states(motion, times, max(1, ROWS // len(names))):
            yield states.t, _values(states)
            if progress is not None:
                progress(min(float(states.t[-1]) / float(times[-1] or 1.0), 1.0))

    write_rows(path, HEADER, names, blocks())


def write_rows(
    path: Path, header: str, names: tuple[str, ...], blocks: Iterable[tuple[Array, Array]]
) -> None:
    """Write a header and one line per sample and drone: the time, the drone's name, the numbers.

    Parameters
    ----------
    path: name of the file, replaced if there is one.
    header: the first line.
    names: (D,) names of the drones.
    blocks: times (S,) [s] and numbers (S, D, C) of the samples, one block after the other.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(header + "\n")
        for t, values in blocks:
            zero = np.all(values == 0.0, axis=0)
            times = np.broadcast_to(t[:, None, None], (*values.shape[:2], 1))
            numbers = np.concatenate([times, values], -1)
            file.write(_layout(names, zero.tobytes()) * len(t) % tuple(numbers.ravel().tolist()))


@lru_cache(maxsize=4)
def _layout(names: tuple[str, ...], zero: bytes) -> str:
    """Return the lines of one sample, given which of their numbers are zero, (D, C) booleans."""
    count = len(zero) // len(names)
    formats = [NOTHING if nothing else NUMBER for nothing in zero]
    lines = [
        ",".join([NUMBER, name.replace("%", "%%"), *formats[i * count : (i + 1) * count]]) + "\n"
        for i, name in enumerate(names)
    ]
    return "".join(lines)


def write_vertices(path: Path, motion: Motion, rate: float) -> None:
    """Write one row per sample and vertex, while the hitch exists; row k has cable k's tension.

    The last row of an open chain, which has one point more than cables, leaves it empty. Parameters
    and errors are those of ``write_setpoints``.
    """
    n, points = motion.team.robots, motion.team.layout.points
    place = f"{NUMBER},{NUMBER},{NUMBER}"
    rows = "".join(f"{NUMBER},{k},{place},{NUMBER if k < n else ''}\n" for k in range(points))
    # Of each row all but the vertex's number: time, place, tension.
    filled = np.arange(5 * points)[: 5 * points - (points - n)]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(VERTICES_HEADER + "\n")
        times, size = sample_times(motion.duration, rate), max(1, ROWS // points)
        for first in range(0, len(times), size):
            t = times[first : first + size]
            formed, vertices, tensions = hitch_at(motion, t)
            values = np.zeros((len(t), points, 5))
            values[..., 0] = t[:, None]
            values[..., 1:4] = vertices
            values[:, :n, 4] = tensions
            given = values[formed].reshape(-1, 5 * points)[:, filled] + 0.0  # no negative zeros
            file.write(rows * len(given) % tuple(given.ravel().tolist()))


def data_frame(motion: Motion, rate: float) -> DataFrame:
    """Return the rows of ``setpoints.csv`` and the name of the phase, by time, then drone.

    Raises
    ------
    InputError: a rate that is not positive.
    UnsupportedError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        remedy = "pip install 'hitchopt[pandas]'"
        raise UnsupportedError(f"data frames need the package pandas ({error}); {remedy}") from None
    times, names = sample_times(motion.duration, rate), motion.team.drone_names
    values = _values(states_at(motion, times))
    first, _, *columns = HEADER.split(",")
    phases = [f"{phase.name} ({i})" for i, phase in enumerate(motion.phases)]
    ends = np.array([phase.end for phase in motion.phases[:-1]])
    here = np.repeat(np.searchsorted(ends, times, side="right"), len(names))
    flat = values.reshape(-1, values.shape[-1])

    def words(codes: NDArray[np.intp], each: Iterable[str]) -> pandas.Categorical[str]:
        return pandas.Categorical.from_codes(codes, categories=pandas.Index(list(each)))

    who = words(np.tile(np.arange(len(names)), len(times)), names)
    return pandas.DataFrame(
        {first: np.repeat(times, len(names)), "drone": who}
        | {name: flat[:, i] for i, name in enumerate(columns)}
        | {"phase": words(here, phases)}
    )
