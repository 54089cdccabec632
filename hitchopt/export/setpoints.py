"""setpoints.csv: what every drone is to do, sample by sample."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hitchopt.export.sampling import iterate_states, sample_times
from hitchopt.model.motion import Motion

HEADER = "t,drone,x,y,z,vx,vy,vz,ax,ay,az,jx,jy,jz,yaw,cable_x,cable_y,cable_z"

NUMBER = "%.12g"
"""Twelve significant digits: below a nanometre over a kilometre."""

ROWS = 2000
"""Rows that are formatted at once: more are slower, since they leave the processor's cache."""

Progress = Callable[[float], None]
"""Called now and then with the fraction done, 0 to 1."""


def write_setpoints(
    path: Path, motion: Motion, rate: float, progress: Progress | None = None
) -> None:
    """Write one row per sample and drone, by time, then drone; yaw is 0.

    Parameters
    ----------
    path: of the file, replaced if there is one.
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
    numbers = ",".join([NUMBER] * 12)
    forces = ",".join([NUMBER] * 3)
    rows = "".join(f"{NUMBER},{name},{numbers},0,{forces}\n" for name in names)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(HEADER + "\n")
        for states in iterate_states(motion, times, max(1, ROWS // len(names))):
            parts = (
                np.broadcast_to(states.t[:, None, None], (*states.positions.shape[:2], 1)),
                states.positions,
                states.velocities,
                states.accelerations,
                states.jerks,
                states.cable_forces,
            )
            values = np.concatenate(parts, axis=-1) + 0.0  # no negative zeros
            file.write(rows * len(values) % tuple(values.ravel().tolist()))
            if progress is not None:
                progress(min(float(states.t[-1]) / float(times[-1] or 1.0), 1.0))
