"""Format skybrush: ``show.skyc``, cubic Bézier curves of every drone for Skybrush.

A zip with ``show.json`` and one ``trajectory.json`` per drone: points ``[t, [x, y, z], control
points]``, t in seconds from takeoff, north-west-up, the control points leading into their point.
Skybrush's server stores whole milliseconds and whole millimetres (multiples of s millimetres from
32.768 (s - 1) m on), and cuts off what is beyond them. So points are rounded here, and what is read
back and certified are the curves that the server stores.

Drones without cables have coordinated returns as well (``skybrush_returns``).

Feed-forward: the autopilots behind Skybrush track positions (and velocities) with controllers of
their own; the format has no place for accelerations, so the cable's pull is not in it.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.exports.formats.compressed import keeping_of
from hitchopt.exports.formats.format import Candidate, Format, Task
from hitchopt.exports.formats.skybrush_returns import certify_returns, return_plans
from hitchopt.exports.formats.skybrush_show import MILLI, read_show, storage_scale, stored
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.exports.refit.piece_fitting import Kind, Scale, breaks_within, fitted
from hitchopt.exports.refit.point_rounding import rounded, settled
from hitchopt.exports.returns import Return, landing_speed, planned_returns, stated
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

FILE = "show.skyc"

KIND = Kind(degree=3, match=2, quantum=MILLI, longest=1.0, shortest=0.1)
"""Cubic pieces: from 1.001 s on the server's arithmetic loses a millisecond of some durations; a
millimetre of a control point is 30 mm/s of velocity at 0.1 s, and 150 mm/s at 0.02 s."""

SMOOTH = 1
"""Acceleration jumps after rounding; so does velocity, by as much as the note says."""

SCALE = Scale(position=1e-3, velocity=3e-2, acceleration=0.5)
"""Errors of the refit that weigh alike."""

BOUNDS = (1.0, 1.4, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2)
"""Errors of the refit over SCALE, the best first: long segments fit worse and suffer less from
rounding; below the last one rounding costs more than the refit gains."""

ROUNDING = Scale(position=5e-4, velocity=1e-2, acceleration=0.2)
"""Errors of rounding that weigh alike."""

NUDGE = 1e-6
"""Distance of points in the file beyond their whole millimetres [m]: the server cuts digits off,
and in binary most of them lie just below."""


class SkybrushShow(Format):
    """Cubic curves in one show."""

    name = "skybrush"
    frames = ("nwu",)
    rate = 0.0
    accuracy = 2e-3
    feed_forward = (
        "not in this file: the autopilots track positions with controllers of their own, and the "
        "format has no accelerations"
    )
    carries_pull = False
    receiver_integral = False

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give refits, each with more points than the one before."""
        returns = None if task.motion.team.has_cables else planned_returns(task.motion)
        for bound in BOUNDS:
            breaks = breaks_within(task.motion.drones, KIND, bound, scale=SCALE)
            if breaks is None:
                continue
            fit = task.frame.placed(fitted(task.motion.drones, breaks, KIND))
            quantum = MILLI * storage_scale(fit, 2.0 * MILLI)
            keeping = keeping_of(task, breaks, self.accuracy)
            for rounding in _roundings(fit, quantum):
                whole = settled(rounding, fit, quantum, keeping)
                notes = (
                    f"{len(breaks)} points per drone; LEDs, takeoff and landing are left to "
                    "Skybrush",
                    f"points are multiples of {1e3 * quantum:g} mm, as Skybrush's server stores "
                    f"them; velocity jumps by up to {1e3 * _jump(whole):.3g} mm/s where segments "
                    "join",
                    *(() if returns is None else (stated(returns),)),
                )
                shown = partial(write_show, task=task, breaks=breaks)
                write = partial(shown, points=whole.coefficients, returns=returns)
                yield Candidate({FILE: write}, notes)

    def read(self, folder: Path, task: Task) -> Recording:  # noqa: ARG002
        """Return the curves of the show as Skybrush's server stores them."""
        drones = read_show(folder / FILE).curves
        curves = [stored(curve) for curve in drones.values()]
        return recording_of_curves(tuple(drones), curves, "nwu", SMOOTH)

    def certify(self, folder: Path, task: Task) -> None:
        """Certify the coordinated returns of drones without cables."""
        if not task.motion.team.has_cables:
            path = folder / FILE
            certify_returns(str(path), read_show(path), task)


def _roundings(curves: PiecewisePolynomial, quantum: float) -> list[PiecewisePolynomial]:
    """Return the curves rounded together and one point at a time, the smoother ones first.

    The former costs less velocity in short pieces, the latter less place where drones rest.
    """
    nearest = np.rint(curves.coefficients / quantum) * quantum
    each = PiecewisePolynomial(curves.breaks, nearest)
    return sorted([rounded(curves, quantum, ROUNDING), each], key=_jump)


def _jump(curves: PiecewisePolynomial) -> float:
    """Return the largest jump of velocity where pieces join [m/s]."""
    left, right = curves.ends(1)
    return float(np.max(np.linalg.norm(left[1:] - right[:-1], axis=-1), initial=0.0))


def write_show(
    path: Path, task: Task, breaks: Array, points: Array, returns: Sequence[Return] | None = None
) -> None:
    """Write the show.

    Parameters
    ----------
    path: name of the zip.
    task: the plan, for title, names and limits.
    breaks: (pieces + 1,) [s]
    points: (pieces, D, 3, 4) Bézier control points [m], north-west-up, of whole millimetres.
    returns: coordinated returns of drones without cables; None for no plan of returns at all.

    Raises
    ------
    OSError: the file cannot be written.
    """
    times = [round(t, 3) for t in breaks.tolist()]
    points = np.round(points + np.copysign(NUDGE, points) * (points != 0.0), 6) + 0.0
    drones = []
    landing, count = landing_speed(task.motion), len(task.names)
    plans: list[Any] = [None] * count
    if returns is not None:
        plans = return_plans(returns, landing, task.frame, task.motion)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, here, plan in zip(task.names, np.moveaxis(points, 1, 0), plans, strict=True):
            first, last = here[0, :, 0].tolist(), here[-1, :, 3].tolist()
            rows: list[Any] = [[times[0], first, []]]
            rows += [
                [t, piece[:, 3].tolist(), [piece[:, 1].tolist(), piece[:, 2].tolist()]]
                for t, piece in zip(times[1:], here, strict=True)
            ]
            head = {"version": 1, "takeoffTime": 0, "landingTime": times[-1]}
            file = f"drones/{name}/trajectory.json"
            archive.writestr(file, json.dumps({**head, "points": rows}, allow_nan=False))
            settings = {"name": name, "home": first, "landAt": last}
            settings |= {} if plan is None else {"rthPlan": plan}
            trajectory = {"trajectory": {"$ref": f"./{file}#"}}
            drones.append({"type": "generic", "settings": {**settings, **trajectory}})
        archive.writestr("show.json", json.dumps(_show(task, drones), allow_nan=False))


def _show(task: Task, drones: list[Any]) -> dict[str, Any]:
    """Return the description of the show, with the plan's limits for Skybrush's own checks."""
    requirements = task.motion.requirements
    speed = requirements.limits.speed
    validation = {
        "minDistance": 2.0 * requirements.separation.radius,
        "maxVelocityXY": speed,
        "maxVelocityZ": speed,
    }
    return {
        "version": 1,
        "environment": {"type": "indoor"},
        "settings": {"validation": validation},
        "meta": {"title": task.title, **task.frame.to_dict()},
        "swarm": {"drones": drones},
    }
