"""vertices.csv: where the hitch's vertices are, and how hard its cables pull."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hitchopt.export.sampling import iterate_states, sample_times
from hitchopt.export.setpoints import NUMBER, ROWS
from hitchopt.model.motion import Motion

HEADER = "t,vertex,x,y,z,tension"


def write_vertices(path: Path, motion: Motion, rate: float) -> None:
    """Write one row per sample and vertex; row k carries the tension of cable k.

    Parameters
    ----------
    path: of the file, replaced if there is one.
    motion: the plan.
    rate: samples a second [Hz], that of the setpoints.

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    OSError: the file cannot be written.
    """
    n = motion.team.robots
    rows = "".join(f"{NUMBER},{k},{NUMBER},{NUMBER},{NUMBER},{NUMBER}\n" for k in range(n))
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(HEADER + "\n")
        times = sample_times(motion.duration, rate)
        for states in iterate_states(motion, times, max(1, ROWS // n)):
            parts = (
                np.broadcast_to(states.t[:, None, None], (len(states.t), n, 1)),
                states.vertices,
                states.tensions[..., None],
            )
            values = np.concatenate(parts, axis=-1) + 0.0  # no negative zeros
            file.write(rows * len(values) % tuple(values.ravel().tolist()))
