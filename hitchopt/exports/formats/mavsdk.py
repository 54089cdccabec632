"""Format mavsdk_drone_show: ``Drone N.csv``, setpoints for PX4 through MAVSDK, north-east-down.

``idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb`` at 20 Hz, mode 70 (manoeuvring), yaw in
degrees as MAVSDK takes it. Before the plan's rows the drones wait on the ground and rise to their
first places; ``mavsdk_receiver`` has the rules by which rows are flown, and the manifest the
settings with which all of them are.

Feed-forward: PX4 adds gravity to the acceleration setpoint and tilts by the sum, but knows no
cable. So ``ax, ay, az`` are ``a_ff = a - F / m``, with the cable's force F on the drone: thrust is
then ``m (a_ff + g)``, as planned. Use the show with velocity and acceleration feed-forward on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.formats.file_reading import column_places, read_numbers, read_text
from hitchopt.exports.formats.format import Candidate, Format, Task
from hitchopt.exports.formats.mavsdk_lead_in import LeadIn, lead_in, receiver_for, rising_check
from hitchopt.exports.formats.mavsdk_receiver import LATE
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.motion.states import states_at
from hitchopt.values import Array

COLUMNS = "idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb"

READ = COLUMNS.split(",")[1:11]
"""Columns that are read: time, position, velocity and acceleration."""

ROW = "%d," + "%#.9g," * 10 + "%#.6g,70,255,255,255"
"""A row of mode 70; all that are no counts have a decimal point."""

SMOOTH = 2
"""Quintics run through positions, velocities and accelerations."""

SAME_TIME = 1e-6
"""Largest difference of the drones' times in one row [s]."""


class MavsdkDroneShow(Format):
    """Setpoints of 20 Hz for PX4."""

    name = "mavsdk_drone_show"
    frames = ("ned",)
    rate = 20.0
    accuracy = 2e-3
    feed_forward = (
        "ax, ay, az = a - F/m, the cable's force F and the drone's mass m: PX4 adds gravity itself "
        "and knows no cable; fly it with acceleration feed-forward on"
    )
    carries_pull = True
    receiver_integral = False

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the files, numbered from 1 in the plan's order.

        Raises
        ------
        InfeasibleError: drones that begin above one another cannot take off.
        """
        lead = lead_in(task)
        check = rising_check(task, lead)
        settings = receiver_for(task).settings()
        files = file_names(len(task.names))
        rows = rows_of(task, lead)
        writers = {name: partial(write_rows, rows=rows[:, i]) for i, name in enumerate(files)}
        notes = (
            f"the plan begins {lead.duration:g} s after the show (row {lead.rows}): until then the "
            "drones wait on the ground and rise straight up, with their cables not looked at",
            "with its own settings mavsdk_drone_show replaces rows by a climb and a landing: set "
            + ", ".join(f"{name} = {value}" for name, value in settings.items())
            + " in its src/params.py",
            "at the end PX4 lands every drone from its last row",
            "Drone N.csv in the plan's order: "
            + ", ".join(f"{i + 1} {name}" for i, name in enumerate(task.names[:6]))
            + (", …" if len(task.names) > 6 else ""),
            "launch every drone below its first place, px and py of its first row: its rows are "
            "counted from there",
        )
        receiver: dict[str, Any] = {"settings": settings, "plan_begins_s": lead.duration}
        if check is not None:
            receiver["separation_before"] = check.worst
        yield Candidate(writers, notes, receiver)

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves through the plan's setpoints as the receiver flies them.

        The cables' pull is taken out of accelerations.
        """
        files = file_names(len(task.names))
        lead, receiver = lead_in(task), receiver_for(task)
        tables = [read_table(folder / name) for name in files]
        if len({len(table) for table in tables}) > 1 or len(tables[0]) <= lead.rows + 1:
            raise FileError(f"{folder}: its drones have not as many rows as the plan")
        places = np.stack([table[:, 1:4] for table in tables], axis=1)
        lost = ~receiver.followed(tables[0][:, 0], places, LATE)[lead.rows :]
        if np.any(lost):
            row, drone = np.argwhere(lost)[0]
            t = tables[0][lead.rows + row, 0]
            raise FileError(
                f"{folder / files[drone]}: mavsdk_drone_show does not fly its row at t = {t:g} s"
            )
        # Altitudes are counted from the first row, and that is on the ground.
        ground = task.frame.points(lead.ground)[:, 2]
        for table, lower, down in zip(tables, receiver.lowered(places), ground, strict=True):
            table[:, 0] -= lead.duration
            table[:, 3] += lower + down
        return recording_of_tables(task.names, [table[lead.rows :] for table in tables], task)


def file_names(drones: int) -> tuple[str, ...]:
    """Return the files' names."""
    return tuple(f"Drone {i + 1}.csv" for i in range(drones))


def rows_of(task: Task, lead: LeadIn) -> Array:
    """Return all drones' rows (S, D, 12): index, time, nine setpoints and yaw in degrees."""
    samples = ceil(task.motion.duration * task.rate - 1e-6) + 1
    index = np.arange(lead.rows + samples)
    t = index / task.rate
    plan = task.setpoints(states_at(task.motion, t[:samples]))
    values = [lead.values(task, t[: lead.rows]), np.concatenate(plan, axis=-1)]
    rows = np.empty((len(index), len(task.names), 12))
    rows[..., 0], rows[..., 1] = index[:, None], t[:, None]
    rows[..., 2:11] = np.concatenate(values) + 0.0  # no negative zeros
    rows[..., 11] = math.degrees(task.frame.heading)
    return rows


def write_rows(path: Path, rows: Array) -> None:
    """Write one drone's rows (S, 12).

    Raises
    ------
    OSError: the file cannot be written.
    """
    np.savetxt(path, rows, ROW, header=COLUMNS, comments="", encoding="ascii")


def read_table(path: Path) -> Array:
    """Return the rows (S, 10) of one drone: t, positions, velocities, accelerations as they stand.

    Columns of velocities and accelerations that are not there are zero.

    Raises
    ------
    FileError: another header, rows of other lengths, fewer than two rows.
    """
    header, *lines = [line for line in read_text(path).splitlines() if line.strip()] or [""]
    found = set(header.split(","))
    vectors = [READ[:4], *(vector for vector in (READ[4:7], READ[7:]) if found & set(vector))]
    told = [name for vector in vectors for name in vector]
    columns = column_places(header, told, COLUMNS, str(path))
    table = read_numbers(lines, columns, str(path), least=2)
    whole = np.zeros((len(table), len(READ)))
    whole[:, [READ.index(name) for name in told]] = table
    return whole


def recording_of_tables(
    names: tuple[str, ...], tables: list[Array], task: Task | None
) -> Recording:
    """Return the curves through all drones' rows, which share their times.

    With a task the cables' pull is taken out of the accelerations, and quintics run through all
    three; without one nobody knows the pull, and cubics run through positions and velocities.

    Raises
    ------
    FileError: times that differ between the drones.
    """
    t = tables[0][:, 0]
    for name, table in zip(names, tables, strict=True):
        if len(table) != len(t) or np.max(np.abs(table[:, 0] - t)) > SAME_TIME:
            raise FileError(f"{name}: its times are not those of {names[0]}")
    values = np.stack([table[:, 1:] for table in tables], axis=1)
    if task is not None:
        values[..., 6:] += task.pulls(states_at(task.motion, t))
        values[t > task.motion.duration, :, 6:] = 0.0
    samples = Samples.of_rows(t, values)
    return recording_of_samples(names, lambda: [samples], "ned", 1 if task is None else SMOOTH)
