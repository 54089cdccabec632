"""Format mavsdk_drone_show: ``Drone N.csv``, setpoints for PX4 through MAVSDK, north-east-down.

``idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb`` at 20 Hz, mode 70 (manoeuvring), yaw in
degrees as MAVSDK takes it.

**Not all rows are flown.** By its own settings the show replaces rows by a climb and by a landing,
by altitude and by time, and sends positions alone. The manifest has the settings of its
``src/params.py`` with which all of a plan's rows are flown, with their velocities and
accelerations: every drone's rows are then counted from its own first one, in altitude too.

**The rise.** Drones are armed on the ground, so their first row is there, below the plan's first
place. They wait until all of them follow their rows, rise together, straight up, and rest before
the plan begins. Seen from above nothing moves. The cables' pull grows with the altitude.

**Feed-forward.** PX4 adds gravity to the acceleration setpoint and tilts by the sum, but knows no
cable. So ``ax, ay, az`` are ``a_ff = a - F / m``, with the cable's force F on the drone: thrust is
then ``m (a_ff + g)``, with MPC_ACC_DECOUPLE = 0 and a hover thrust that was measured without cables
(MPC_THR_HOVER, MPC_USE_HTE = 0). Use the show with velocity and acceleration feed-forward on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from math import ceil, floor
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.firmware import px4_parameters
from hitchopt.exports.format import Format, Task, Written
from hitchopt.exports.options import ExportOptions
from hitchopt.exports.recording import Recording, present_columns, unusual
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion, Phase
from hitchopt.storage.archive import reading
from hitchopt.storage.tables import Table, labelled_table, text_lines
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

COLUMNS = "idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb"
FLOWN = [COLUMNS.split(",")[i : i + 3] for i in (2, 5, 8)]  # Position, velocity and acceleration
ROW = "%d," + "%#.9g," * 10 + "%#.6g,70,255,255,255"  # All that are no counts have a point
SMOOTH = 2  # Quintics run through positions, velocities and accelerations
SAME_TIME = 1e-6  # Largest difference of the drones' times in one row [s]
LATE = 5.0  # Longest time that arming takes after the common start [s]: rows run meanwhile
BLEND = 3.0  # Longest straight line from the climb to the rows [s]

WAIT = LATE + BLEND  # Wait on the ground [s], for drones that are late or drawn to their rows
SETTLE = 3.0  # Wait at the first places [s]
SPEED, ACCELERATION = 0.5, 0.5  # Largest speed and acceleration while rising [m/s], [m/s²]
LEAST = 1.0  # Shortest duration of the rise [s]
BELOW = 1.0  # Distance of thresholds below all rows [m]: those are never under them


class MavsdkDroneShow(Format):
    """Setpoints of 20 Hz for PX4, Drone N.csv from 1 in the plan's order."""

    name = "mavsdk_drone_show"
    file = "Drone {number}.csv"
    header = "idx,t,px"
    endings = (".csv",)
    several = endings
    frames = ("ned",)
    rate = 20.0
    accuracy = 2e-3
    feed_forward = (
        "ax, ay, az = a - F/m, the cable's force F and the drone's mass m: PX4 adds gravity itself "
        "and knows no cable; fly it with acceleration feed-forward on"
    )
    flown_by = "stream"
    controllers = ("px4",)
    streamed = 2.0

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:  # noqa: ARG002
        """Return PX4's parameters of every drone, by its name in the plan."""
        return {"parameters": px4_parameters(team)}

    def write(self, folder: Path, task: Task) -> Written:
        """Write every drone's rows, or raise InfeasibleError where they cannot take off."""
        rise = rise_of(task)
        refuse_stacks(task, rise)
        settings, files = receiver_settings(task), self.files(task)
        for name, table in zip(files, np.moveaxis(rows_of(task, rise), 1, 0), strict=True):
            np.savetxt(folder / name, table, ROW, header=COLUMNS, comments="", encoding="ascii")
        unseen = ", with cables not looked at" if task.motion.has_cables else ""
        order = ", ".join(f"{i + 1} {name}" for i, name in enumerate(task.names[:6]))
        notes = (
            f"the plan begins {rise.duration:g} s after the show: until then drones wait and "
            f"rise straight up{unseen}; at the end PX4 lands them",
            "with its own settings mavsdk_drone_show replaces rows by a climb and a landing: in "
            f"src/params.py set {', '.join(f'{key} = {x}' for key, x in settings.items())}",
            f"Drone N.csv in the plan's order: {order}{', …' if len(task.names) > 6 else ''}",
            "launch every drone at px, py of its first row: its rows are counted from there",
            "of PX4 set the parameters in export.json, and MPC_THR_HOVER, of free drones",
        )
        return Written(files, notes, {"settings": settings, "plan_begins_s": rise.duration})

    def load(self, files: Sequence[Path]) -> Recording:
        """Return cubics through positions and velocities: accelerations have an unknown pull."""
        names, tables = tuple(path.stem for path in files), read_tables(files)
        recording = Recording.of_samples(names, tables[:, 0, 0], tables[..., 1:7], "ned", 1)
        each = (unusual(_table(path), path.stem) for path in files)
        return replace(recording, findings=tuple(chain.from_iterable(each)))

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the receiver's motion, the cables' pull removed from accelerations."""
        tables, rise = read_tables([folder / name for name in self.files(task)]), rise_of(task)
        rows = round(rise.duration * task.rate)
        if len(tables) <= rows + 1:
            raise FileError(f"{folder}: its drones have not as many rows as the plan")
        # Altitudes are counted from the first row, and that is on the ground.
        ground = task.frame.points(np.array([0.0, 0.0, task.motion.requirements.floor]))[2]
        tables[..., 3] += ground - tables[0, :, 3]
        t, values = tables[rows:, 0, 0] - rise.duration, tables[rows:, :, 1:]
        values[..., 6:] += task.samples(t)["cable_forces"] / task.motion.team.mass[:, None]
        values[t > task.motion.duration, :, 6:] = 0.0
        return Recording.of_samples(task.names, t, values, "ned", SMOOTH)


def rise_of(task: Task) -> PiecewisePolynomial:
    """Return the share of the rise to a plan's first places, 0 to 1, over whole rows before it."""
    limits = [each.motion.requirements.limits for each in task.motion.groups]
    highest = float(np.max(np.abs(_climb(task))))
    # The quintic at rest at both ends is fastest by 15/8, and accelerates most by 10/√3.
    lasts = max(
        LEAST,
        1.875 * highest / min(SPEED, *(each.speed for each in limits)),
        (10.0 / 3.0**0.5 * highest / min(ACCELERATION, *(each.acceleration for each in limits)))
        ** 0.5,
        (60.0 * highest / min(each.jerk for each in limits)) ** (1.0 / 3.0),
    )
    ends = np.zeros((3, 4))
    ends[0, 2:] = 1.0
    last = ceil((WAIT + lasts + SETTLE) * task.rate) / task.rate
    return PiecewisePolynomial.hermite([0.0, WAIT, WAIT + lasts, last], ends[:, :-1], ends[:, 1:])


def refuse_stacks(task: Task, rise: PiecewisePolynomial) -> None:
    """Raise InfeasibleError where drones begin above one another: they cannot rise straight up."""
    motion, up = task.motion, _climb(task)[..., None]
    places = motion.drones.coefficients[0, ..., :1] + up * (rise.coefficients[:, None, None] - 1.0)
    rising, phase = PiecewisePolynomial(rise.breaks, places), Phase("rise", 0, 0.0, rise.duration)
    flown = Motion.single(motion.team, motion.requirements.untimed, rising, [phase])
    check = RULE_OF["separation"].check(flown)
    if check is not None and not check.holds:
        when = "while the drones rise straight up from the ground to their first places"
        remedy = "begin with the drones side by side, or choose another format"
        raise InfeasibleError([check.violation(when, remedy)])


def _climb(task: Task) -> Array:
    """Return the ascent from the ground to the plan's first places (D, 3) [m]."""
    heights = task.motion.drones.coefficients[0, :, 2, :1] - task.motion.requirements.floor
    return heights * [0.0, 0.0, 1.0]


def receiver_settings(task: Task) -> dict[str, float | bool]:
    """Return the settings with which every row is flown, with its velocity and acceleration."""
    altitudes = task.motion.drones.coefficients[:, :, 2] - task.motion.requirements.floor
    below = floor(min(0.0, float(np.min(altitudes)))) - BELOW
    return {
        "INITIAL_CLIMB_ALTITUDE_THRESHOLD": below,
        "INITIAL_CLIMB_TIME_THRESHOLD": 0.0,
        "GROUND_ALTITUDE_THRESHOLD": below,
        "AUTO_GLOBAL_ORIGIN_MODE": False,
        "USE_GLOBAL_SETPOINTS": False,
        "FEEDFORWARD_VELOCITY_ENABLED": True,
        "FEEDFORWARD_ACCELERATION_ENABLED": True,
    }


def rows_of(task: Task, rise: PiecewisePolynomial) -> Array:
    """Return all drones' rows (S, D, 12): index, time, nine setpoints and yaw in degrees."""
    before = round(rise.duration * task.rate)
    index = np.arange(before + ceil(task.motion.duration * task.rate - 1e-6) + 1)
    t, up = index / task.rate, task.frame.vectors(_climb(task))
    plan = task.samples(t[before:] - rise.duration)
    share, rate, bend = (rise.at(t[:before], k)[:, None, None] for k in range(3))
    pull = plan["cable_forces"][0] / task.motion.team.mass[:, None]
    rising = plan["positions"][0] + (share - 1.0) * up, rate * up, bend * up - share * pull
    flying = plan["positions"], plan["velocities"], plan["feed_forward"]
    rows = np.empty((len(index), len(task.names), 12))
    rows[..., 0], rows[..., 1] = index[:, None], t[:, None]
    rows[..., 2:11] = np.concatenate([np.concatenate(each, axis=-1) for each in (rising, flying)])
    rows[..., 11] = math.degrees(task.frame.heading)
    return rows + 0.0  # no negative zeros


def _table(path: Path) -> Table:
    with reading(path, "text"):
        return labelled_table(lambda: text_lines(path), ("idx", "t"), str(path))


def read_tables(paths: Sequence[Path]) -> Array:
    """Return drones' rows (S, D, 4, 7 or 10), times first, at one set of times for all."""
    tables: list[Array] = []
    for path in paths:
        text = _table(path)
        table = text.numbers(["t", *present_columns(text, FLOWN)], least=2)
        first = tables[0] if tables else table
        if table.shape != first.shape or np.max(np.abs(table[:, 0] - first[:, 0])) > SAME_TIME:
            name = paths[0].stem
            raise FileError(f"{path.stem}: its times are not those of {name}, or its columns")
        tables.append(table)
    return np.stack(tables, axis=1)
