"""Format mavsdk_drone_show: ``Drone N.csv``, setpoints for PX4 through MAVSDK, north-east-down.

``idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb`` at 20 Hz, mode 70 (manoeuvring), yaw in
degrees as in MAVSDK.

**Replaced rows.** By default the show replaces rows by a climb and by a landing, based on altitude
and time, and sends only positions. The manifest has settings of ``src/params.py`` with which all
rows of a plan are flown, with velocities and accelerations: the positions of every drone, altitude
included, are then relative to its first row.

**The rise.** Drones are armed on the ground, so the first row is there, below the first position of
the plan. The drones wait until all of them follow their rows, rise together vertically, and rest
before the plan begins. Cable forces increase with the altitude.

**Feed-forward.** PX4 adds gravity to the acceleration setpoint and tilts by the sum, but has no
cable model. So ``ax, ay, az`` are ``a_ff = a - F / m``, with the cable force F on the drone: the
thrust is ``m (a_ff + g)``, with MPC_ACC_DECOUPLE = 0 and a hover thrust that was measured without
cables (MPC_THR_HOVER, MPC_USE_HTE = 0). Use the show with velocity and acceleration feed-forward.
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
from hitchopt.exports.contents import FileContents, present_columns, separator_findings
from hitchopt.exports.firmware import px4_notes, px4_team_parameters
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.exports.options import ExportOptions
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion, Phase
from hitchopt.storage.archive import reading
from hitchopt.storage.tables import Table, labelled_table, text_lines
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

COLUMNS = "idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb"
STATE_COLUMNS = [COLUMNS.split(",")[i : i + 3] for i in (2, 5, 8)]
"""Columns of position, velocity and acceleration."""
ROW = "%d," + "%#.9g," * 10 + "%#.6g,70,255,255,255"  # Numbers that are no counts have a point
SMOOTH = 2  # The curves are quintics with continuous accelerations
SAME_TIME = 1e-6  # Maximum difference of the drones' times in one row [s]
ARMING_TIME = 5.0  # Maximum delay of arming after the common start [s]
BLEND_TIME = 3.0  # Maximum duration of the transition from the climb to the rows [s]
WAIT = ARMING_TIME + BLEND_TIME  # Time on the ground before the rise [s]
SETTLE = 3.0  # Rest at the first positions [s]
SPEED = 0.5  # Maximum speed of the rise [m/s]
ACCELERATION = 0.5  # Maximum acceleration of the rise [m/s²]
MIN_RISE = 1.0  # Minimum duration of the rise [s]
THRESHOLD_MARGIN = 1.0  # Distance of altitude thresholds below all rows [m]


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
    reach = math.inf
    feed_forward = (
        "ax, ay, az = a - F/m with the cable's force F and the mass m: PX4 adds gravity and has "
        "no model of the cable; enable acceleration feed-forward"
    )
    flown_by = "stream"
    needs_stiffness = True  # by its own settings the show sends positions only
    has_gains = True
    stiffest = 6.25  # gains are then within PX4_RANGES
    controllers = ("px4",)
    streamed = 2.0

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return the PX4 parameters of all drones, by name in the plan."""
        return {"parameters": px4_team_parameters(team, options.stiffness, options.damping)}

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the rows of all drones; raises InfeasibleError if they cannot take off."""
        rise = rise_of(task)
        refuse_stacks(task, rise)
        settings = receiver_settings(task)
        files = self.files(task)
        for name, table in zip(files, np.moveaxis(rows_of(task, rise), 1, 0), strict=True):
            np.savetxt(folder / name, table, ROW, header=COLUMNS, comments="", encoding="ascii")
        unseen = ", where cables are not checked" if task.flight.has_cables else ""
        order = ", ".join(f"{i + 1} {name}" for i, name in enumerate(task.names[:6]))
        notes = (
            f"the plan starts {rise.duration:g} s into the show: until then drones wait and "
            f"rise straight up{unseen}; at the end PX4 lands them",
            "by default, mavsdk_drone_show replaces rows with a climb and a landing: in "
            f"src/params.py set {', '.join(f'{key} = {x}' for key, x in settings.items())}",
            f"Drone N.csv in the plan's order: {order}{', …' if len(task.names) > 6 else ''}",
            "launch every drone at px, py of its first row, the origin of its rows",
            "set PX4's parameters as in export.json, and MPC_THR_HOVER as measured without cables",
            *px4_notes(task.flight.team, task.options.stiffness, task.options.damping),
        )
        return FormatOutput(files, notes, {"settings": settings, "plan_begins_s": rise.duration})

    def load(self, files: Sequence[Path]) -> FileContents:
        """Return cubics through positions and velocities, since cable forces are unknown."""
        names = tuple(path.stem for path in files)
        tables = read_tables(files)
        contents = FileContents.of_samples(names, tables[:, 0, 0], tables[..., 1:7], "ned", 1)
        each = (separator_findings(_table(path), path.stem) for path in files)
        return replace(contents, findings=tuple(chain.from_iterable(each)))

    def sent(self, files: Sequence[Path], manifest: Mapping[str, Any]) -> FileContents:
        """Return all setpoints after the rise, of drones numbered in the manifest's order."""
        names = tuple(map(str, manifest["drones"].values()))
        folder = files[0].parent
        tables = read_tables(
            [folder / self.file.format(number=i) for i in range(1, len(names) + 1)]
        )
        rise = float(manifest["receiver"]["plan_begins_s"])
        t = tables[:, 0, 0] - rise
        values = tables[..., 1:]
        flown = t > -SAME_TIME
        return FileContents.of_samples(names, t[flown], values[flown], "ned", SMOOTH)

    def read(self, folder: Path, task: ExportTask) -> FileContents:
        """Return the receiver's motion, without cable forces in accelerations."""
        tables = read_tables([folder / name for name in self.files(task)])
        rise = rise_of(task)
        rise_rows = round(rise.duration * task.rate)
        if len(tables) <= rise_rows + 1:
            raise FileError(f"{folder}: its drones do not have as many rows as the plan")
        # Altitudes are relative to the first row, which is on the ground.
        ground = task.frame.points(np.array([0.0, 0.0, ground_of(task)]))[2]
        tables[..., 3] += ground - tables[0, :, 3]
        t = tables[rise_rows:, 0, 0] - rise.duration
        values = tables[rise_rows:, :, 1:]  # positions, velocities, accelerations
        values[..., 6:] += task.samples(t)["cable_forces"] / task.masses[:, None]
        values[t > task.flight.duration, :, 6:] = 0.0
        return FileContents.of_samples(task.names, t, values, "ned", SMOOTH)


def ground_of(task: ExportTask) -> float:
    """Return the height of the ground [m], from which drones take off."""
    return task.flight.requirements.ground_for("a take-off")


def rise_of(task: ExportTask) -> PiecewisePolynomial:
    """Return the completed fraction of the rise, 0 to 1, over an integer number of rows."""
    limits = [each.motion.requirements.limits for each in task.flight.teams]
    height = float(np.max(np.abs(_ascent(task))))
    speed = min(SPEED, *(each.speed for each in limits))
    acceleration = min(ACCELERATION, *(each.acceleration for each in limits))
    jerk = min(each.jerk for each in limits)
    # Maximum derivatives of the quintic from rest to rest: 15/8, 10/√3 and 60.
    duration = max(
        MIN_RISE,
        1.875 * height / speed,
        (10.0 / 3.0**0.5 * height / acceleration) ** 0.5,
        (60.0 * height / jerk) ** (1.0 / 3.0),
    )
    ends = np.zeros((3, 4))
    ends[0, 2:] = 1.0
    last = ceil((WAIT + duration + SETTLE) * task.rate) / task.rate
    breaks = [0.0, WAIT, WAIT + duration, last]
    return PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])


def refuse_stacks(task: ExportTask, rise: PiecewisePolynomial) -> None:
    """Raise InfeasibleError if drones start above one another, and cannot rise vertically."""
    flight = task.flight
    up = _ascent(task)[..., None]
    points = task.curves.coefficients[0, ..., :1] + up * (rise.coefficients[:, None, None] - 1.0)
    curves = PiecewisePolynomial(rise.breaks, points)
    phase = Phase("rise", 0, 0.0, rise.duration)
    curves = curves.replaced(curves.coefficients[:, np.argsort(task.order)])
    ascent = Motion.single(flight.team, flight.requirements.untimed, curves, [phase])
    check = RULE_OF["separation"].check(ascent)
    if check is not None and not check.holds:
        when = "while the drones rise straight up from the ground to their first positions"
        remedy = "begin with the drones side by side, or choose another format"
        raise InfeasibleError([check.violation(when, remedy)])


def _ascent(task: ExportTask) -> Array:
    """Return the displacement from the ground to the plan's first positions (D, 3) [m]."""
    heights = task.curves.coefficients[0, :, 2, :1] - ground_of(task)
    return heights * [0.0, 0.0, 1.0]


def receiver_settings(task: ExportTask) -> dict[str, float | bool]:
    """Return the settings with which all rows are flown, with velocity and acceleration."""
    altitudes = task.flight.drones.coefficients[:, :, 2] - ground_of(task)
    below = floor(min(0.0, float(np.min(altitudes)))) - THRESHOLD_MARGIN
    return {
        "INITIAL_CLIMB_ALTITUDE_THRESHOLD": below,
        "INITIAL_CLIMB_TIME_THRESHOLD": 0.0,
        "GROUND_ALTITUDE_THRESHOLD": below,
        "AUTO_GLOBAL_ORIGIN_MODE": False,
        "USE_GLOBAL_SETPOINTS": False,
        "FEEDFORWARD_VELOCITY_ENABLED": True,
        "FEEDFORWARD_ACCELERATION_ENABLED": True,
    }


def rows_of(task: ExportTask, rise: PiecewisePolynomial) -> Array:
    """Return rows (S, D, 12) of all drones: index, time, nine setpoints and yaw in degrees."""
    count = round(rise.duration * task.rate)
    index = np.arange(count + ceil(task.flight.duration * task.rate - 1e-6) + 1)
    t = index / task.rate
    up = task.frame.vectors(_ascent(task))
    plan = task.samples(t[count:] - rise.duration)
    share, speed, acceleration = (rise.at(t[:count], k)[:, None, None] for k in range(3))
    force = plan["cable_forces"][0] / task.masses[:, None]
    positions = plan["positions"][0] + (share - 1.0) * up
    ascent = positions, speed * up, acceleration * up - share * force
    states = plan["positions"], plan["velocities"], plan["feed_forward"]
    rows = np.empty((len(index), len(task.names), 12))
    rows[..., 0], rows[..., 1] = index[:, None], t[:, None]
    rows[..., 2:11] = np.concatenate([np.concatenate(each, axis=-1) for each in (ascent, states)])
    rows[..., 11] = math.degrees(task.frame.heading)
    return rows + 0.0  # no negative zeros


def _table(path: Path) -> Table:
    with reading(path, "text file"):
        return labelled_table(lambda: text_lines(path), ("idx", "t"), str(path))


def read_tables(paths: Sequence[Path]) -> Array:
    """Return rows (S, D, 4, 7 or 10) of all drones at common times, times first."""
    tables: list[Array] = []
    for path in paths:
        text = _table(path)
        table = text.numbers(["t", *present_columns(text, STATE_COLUMNS)], min_rows=2)
        first = tables[0] if tables else table
        if table.shape != first.shape or np.max(np.abs(table[:, 0] - first[:, 0])) > SAME_TIME:
            name = paths[0].stem
            raise FileError(f"{path.stem}: its times or columns differ from those of {name}")
        tables.append(table)
    return np.stack(tables, axis=1)
