"""Table vertices.csv: positions of the hitch's vertices and tensions of its cables."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hitchopt.exports.setpoints import NUMBER, ROWS
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import hitch_at, sample_times

HEADER = "t,vertex,x,y,z,tension"


def write_vertices(path: Path, motion: Motion, rate: float) -> None:
    """Write one row per sample and vertex, while the hitch exists; row k has cable k's tension.

    The last row of an open chain, which has one point more than cables, leaves it empty.

    Parameters
    ----------
    path: name of the file, replaced if there is one.
    motion: the plan.
    rate: samples a second [Hz], that of the setpoints.

    Raises
    ------
    InputError: a rate that is not positive, or more samples than anyone can use.
    OSError: the file cannot be written.
    """
    n, points = motion.team.robots, motion.team.layout.points
    place = f"{NUMBER},{NUMBER},{NUMBER}"
    rows = "".join(f"{NUMBER},{k},{place},{NUMBER if k < n else ''}\n" for k in range(points))
    # Of each row all but the vertex's number: time, place, tension.
    filled = np.arange(5 * points)[: 5 * points - (points - n)]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(HEADER + "\n")
        times, size = sample_times(motion.duration, rate), max(1, ROWS // points)
        for first in range(0, len(times), size):
            t = times[first : first + size]
            formed, vertices, tensions = hitch_at(motion, t)
            values = np.zeros((len(t), points, 5))
            values[..., 0] = t[:, None]
            values[..., 1:4] = vertices
            values[:, :n, 4] = tensions
            given = values[formed].reshape(-1, 5 * points)[:, filled]
            given = given + 0.0  # no negative zeros
            file.write(rows * len(given) % tuple(given.ravel().tolist()))
