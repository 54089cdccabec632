"""Format skybrush: ``show.skyc``, cubic Bézier curves of every drone for Skybrush.

A zip with ``show.json`` and one ``trajectory.json`` per drone: points ``[t, [x, y, z], control
points]``, t in seconds from takeoff, north-west-up, the control points leading into their point.
Durations are whole milliseconds. What Skybrush sends to the drones is rounded to millimetres once
more, which is not in these numbers.

Feed-forward: the autopilots behind Skybrush track positions (and velocities) with controllers of
their own; the format has no place for accelerations, so the cable's pull is not in it.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.export.formats.format import Candidate, Task, Whole
from hitchopt.export.formats.skybrush_show import drones_of_show
from hitchopt.export.recording import Recording, lasted, recording_of_curves
from hitchopt.export.refit.breaks import greedy_breaks, span_error
from hitchopt.export.refit.pieces import Kind, Scale, fitted

Array = NDArray[np.float64]

FILE = "show.skyc"

KIND = Kind(degree=3, match=2, quantum=1e-3, longest=60.0)
"""Positions and velocities are continuous."""

SMOOTH = 1

SCALE = Scale(position=1e-3, velocity=3e-2, acceleration=0.5)

BOUNDS = (1.0, 0.3, 0.1, 0.03)
"""Of the refit over SCALE: as few points as will do."""

DECIMALS = 6
"""Of metres in the file."""


class SkybrushShow(Whole):
    """Cubic curves in one show."""

    name = "skybrush"
    summary = "a show of cubic curves for Skybrush (.skyc)"
    frames = ("nwu",)
    rate = 0.0
    accuracy = 2e-3
    feed_forward = (
        "not in this file: the autopilots track positions with controllers of their own, and the "
        "format has no accelerations"
    )

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give refits, each with more points than the one before."""
        curves = task.motion.drones
        error = span_error(curves, KIND, SCALE)
        most = ceil(curves.duration / KIND.quantum) + 1
        for bound in BOUNDS:
            breaks = greedy_breaks(error, float(curves.breaks[-1]), KIND, bound, most)
            if breaks is None:
                continue
            fit = task.room.placed(fitted(lasted(curves, float(breaks[-1])), breaks, KIND))
            points = np.round(fit.coefficients, DECIMALS) + 0.0
            note = f"{len(breaks)} points per drone; LEDs, takeoff and landing are left to Skybrush"
            yield Candidate(
                {FILE: partial(write_show, task=task, breaks=breaks, points=points)}, (note,)
            )

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return the curves of the show."""
        drones = drones_of_show(folder / FILE)
        return recording_of_curves(tuple(drones), tuple(drones.values()), "nwu", SMOOTH)


def write_show(path: Path, task: Task, breaks: Array, points: Array) -> None:
    """Write the show.

    Parameters
    ----------
    path: of the zip.
    task: with title, names and limits.
    breaks: (pieces + 1,) [s]
    points: (pieces, D, 3, 4) Bézier control points [m], north-west-up.

    Raises
    ------
    OSError: the file cannot be written.
    """
    times = [round(t, 3) for t in breaks.tolist()]
    drones = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for i, name in enumerate(task.names):
            here = points[:, i]  # (pieces, 3, 4)
            rows: list[Any] = [[times[0], here[0, :, 0].tolist(), []]]
            rows += [
                [t, piece[:, 3].tolist(), [piece[:, 1].tolist(), piece[:, 2].tolist()]]
                for t, piece in zip(times[1:], here, strict=True)
            ]
            trajectory = {
                "version": 1,
                "takeoffTime": 0,
                "landingTime": times[-1],
                "points": rows,
            }
            file = f"drones/{name}/trajectory.json"
            archive.writestr(file, json.dumps(trajectory, allow_nan=False))
            settings = {
                "name": name,
                "home": here[0, :, 0].tolist(),
                "landAt": here[-1, :, 3].tolist(),
                "trajectory": {"$ref": f"./{file}#"},
            }
            drones.append({"type": "generic", "settings": settings})
        archive.writestr("show.json", json.dumps(_show(task, drones), allow_nan=False))


def _show(task: Task, drones: list[Any]) -> dict[str, Any]:
    motion = task.motion
    return {
        "version": 1,
        "environment": {"type": "indoor"},
        "settings": {
            "validation": {
                "minDistance": 2.0 * motion.requirements.separation.radius,
                "maxVelocityXY": motion.requirements.limits.speed,
                "maxVelocityZ": motion.requirements.limits.speed,
            }
        },
        "meta": {
            "title": task.title,
            "frame": "nwu",
            "origin_enu": task.room.origin.tolist(),
            "yaw_deg": math.degrees(task.room.yaw),
        },
        "swarm": {"drones": drones},
    }
