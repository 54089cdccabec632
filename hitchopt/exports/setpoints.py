"""Table setpoints.csv: the setpoints of every drone, sample by sample."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, iterate_states, sample_times

HEADER = "t,drone,x,y,z,vx,vy,vz,ax,ay,az,jx,jy,jz,yaw,cable_x,cable_y,cable_z"

NUMBER = "%#.12g"
"""Format of numbers: twelve significant digits, below a nanometre over a kilometre. A decimal point
is always there, since readers such as polars take a column for whole numbers that begins with one.
"""

NOTHING = "%.1f"
"""Format of numbers that are zero throughout a block: ``0.0``."""

ROWS = 2000
"""Rows that are formatted at once: more are slower, since they leave the processor's cache."""

AHEAD = 4
"""Blocks of ROWS whose numbers are computed at once, which few rows would slow down."""

Progress = Callable[[float], None]
"""Function that is called now and then with the fraction done, 0 to 1."""


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
    times = sample_times(motion.duration, rate)
    names = motion.team.drone_names
    size = max(1, ROWS // len(names))
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(HEADER + "\n")
        for states in iterate_states(motion, times, AHEAD * size):
            values = setpoint_values(states)
            for first in range(0, len(values), size):
                rows = values[first : first + size]
                file.write(lines_of(names, rows))
                if progress is not None:
                    progress(min(float(rows[-1, 0, 0]) / float(times[-1] or 1.0), 1.0))


def setpoint_values(states: States) -> NDArray[np.float64]:
    """Return the numbers of HEADER's columns, all but the drone's name, (S, D, 17)."""
    times = np.broadcast_to(states.t[:, None, None], (*states.positions.shape[:2], 1))
    yaw = np.zeros(times.shape)
    motion = (states.positions, states.velocities, states.accelerations, states.jerks)
    parts = (times, *motion, yaw, states.cable_forces)
    values: NDArray[np.float64] = np.concatenate(parts, axis=-1) + 0.0  # no negative zeros
    return values


def lines_of(names: tuple[str, ...], values: NDArray[np.float64]) -> str:
    """Return one line per sample and drone: its first number, the drone's name, the others.

    Parameters
    ----------
    names: (D,) names of the drones.
    values: (S, D, C)
    """
    zero = np.all(values == 0.0, axis=0)
    lines = _layout(names, zero.tobytes()) * len(values)
    return lines % tuple(values.ravel().tolist())


@lru_cache(maxsize=4)
def _layout(names: tuple[str, ...], zero: bytes) -> str:
    """Return the lines of one sample, given which of their numbers are zero, (D, C) booleans."""
    count = len(zero) // len(names)
    formats = [NOTHING if nothing else NUMBER for nothing in zero]
    lines = []
    for i, name in enumerate(names):
        first, *others = formats[i * count : (i + 1) * count]
        lines.append(",".join([first, name.replace("%", "%%"), *others]) + "\n")
    return "".join(lines)
