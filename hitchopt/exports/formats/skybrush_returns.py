"""Returns in a Skybrush show: ``settings.rthPlan`` of every drone, written, read back, certified.

``{"version": 1, "landingSpeed", "entries": [{"time", "action", "target", "duration", "preDelay",
"postDelay"}]}``: all times are whole seconds, those of the entries are the same for all drones. A
command at t takes the first entry from t on: the show goes on until its time, then the drone waits,
flies level to its target (``goToKeepAlt``) or nowhere (``land``), waits and goes down. After the
last entry drones land where they are. Skybrush's server without its extension drops all of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.formats.format import Task
from hitchopt.exports.formats.skybrush_show import MILLI, Show, stored
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.exports.returns import Return, return_checks
from hitchopt.motion.motion import Motion

LAND, LEVEL = "land", "goToKeepAlt"
"""Actions: down where the drone is, or after a level flight."""


def return_plans(
    returns: Sequence[Return], landing: float, frame: ReferenceFrame, motion: Motion
) -> list[dict[str, Any]]:
    """Return ``rthPlan`` of each drone.

    Parameters
    ----------
    returns: in the plan's axes, by time.
    landing: speed of the descents [m/s].
    frame: of the show.
    motion: the plan.
    """
    plans: list[list[dict[str, Any]]] = [[] for _ in motion.team.drone_names]
    for each in returns:
        heights = motion.drones.at(min(each.time, motion.duration))[:, 2:]
        places = frame.points(np.hstack([each.targets, heights]))
        points = np.round(np.rint(places / MILLI) * MILLI, 3) + 0.0
        for entries, point, before, after in zip(
            plans, points.tolist(), each.before.tolist(), each.after.tolist(), strict=True
        ):
            entries.append(
                {
                    "time": int(each.time),
                    "action": LEVEL if each.duration > 0.0 else LAND,
                    "target": point,
                    "duration": int(each.duration),
                    "preDelay": int(before),
                    "postDelay": int(after),
                }
            )
    return [{"version": 1, "landingSpeed": landing, "entries": entries} for entries in plans]


def read_returns(
    source: str, plans: Sequence[Mapping[str, Any] | None], frame: ReferenceFrame
) -> tuple[tuple[Return, ...], float]:
    """Return the returns, in the plan's axes, and the speed of their descents [m/s].

    Parameters
    ----------
    source: names the file.
    plans: ``rthPlan`` of each drone, as it stands in the show.
    frame: of the show.

    Raises
    ------
    FileError: drones without a plan, entries that differ in times, or that are no returns.
    """
    try:
        speeds = {float(plan["landingSpeed"]) for plan in plans if plan is not None}
        rows = [plan["entries"] for plan in plans if plan is not None]
        if len(rows) < len(plans) or len(speeds) != 1 or len({len(row) for row in rows}) != 1:
            raise ValueError("its drones have different ones")
        found = tuple(_return(entries, frame) for entries in zip(*rows, strict=True))
        times = [each.time for each in found]
        if times != sorted(set(times)):
            raise ValueError("its times do not increase")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise FileError(f"{source}: rthPlan is damaged: {error}; export anew") from error
    return found, speeds.pop()


def _return(entries: Sequence[Mapping[str, Any]], frame: ReferenceFrame) -> Return:
    """Return the return that the drones' entries of one time describe."""
    times = {entry["time"] for entry in entries}
    durations = {entry["duration"] if entry["action"] == LEVEL else 0 for entry in entries}
    if len(times) != 1 or len(durations) != 1 or any(float(t) % 1.0 for t in times):
        raise ValueError("entries of one time differ")
    if any(entry["action"] not in (LAND, LEVEL) for entry in entries):
        raise ValueError("an action is not known")
    targets = np.array([entry["target"] for entry in entries], dtype=np.float64)
    places = frame.planned(targets)
    waits = np.array([[entry["preDelay"], entry["postDelay"]] for entry in entries], np.float64)
    before, after = waits.T
    return Return(float(times.pop()), places[:, :2], float(durations.pop()), before, after)


def certify_returns(source: str, show: Show, task: Task) -> None:
    """Certify what a show says of returns, each flown from its time on, as the server stores it.

    Parameters
    ----------
    source: names the file.
    show: as it was read.
    task: what was exported.

    Raises
    ------
    FileError: the show's returns are damaged.
    InfeasibleError: a return breaks a limit.
    """
    motion, frame, names = task.motion, task.frame, task.names
    returns, landing = read_returns(source, [show.returns.get(name) for name in names], frame)
    curves = [stored(show.curves[name]) for name in names]
    for each in returns:
        start = np.array([curve.at(min(each.time, curve.breaks[-1])) for curve in curves])
        places = frame.planned(start)
        flown = each
        if each.duration <= 0.0:  # drones go down where they are
            flown = Return(each.time, places[:, :2], 0.0, each.before, each.after)
        broken = [c for c in return_checks(motion, flown, places, landing) if not c.holds]
        if broken:
            words = "a coordinated return of the show breaks a limit when it is read back"
            when, remedy = f"in the return from t = {each.time:g} s", "plan with a wider margin"
            raise InfeasibleError([check.violation(when, remedy) for check in broken], words)
