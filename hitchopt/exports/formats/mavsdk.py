"""Format mavsdk_drone_show: ``Drone N.csv``, setpoints for PX4 through MAVSDK, north-east-down.

``idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb`` at 20 Hz, mode 70 (manoeuvring), yaw in
degrees as MAVSDK takes it. Before the plan's rows the drones wait on the ground and rise to their
first places; `mavsdk_receiver` has the rules by which rows are flown, and the manifest the settings
with which all of them are.

Feed-forward: PX4 adds gravity to the acceleration setpoint and tilts by the sum, but knows no
cable. So ``ax, ay, az`` are ``a_ff = a - F / m``, with the cable's force F on the drone: thrust is
then ``m (a_ff + g)``, as planned. Use the show with velocity and acceleration feed-forward on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.exports.formats.format import Candidate, Task, Whole, pull_of
from hitchopt.exports.formats.mavsdk_lead_in import LeadIn, lead_in, receiver_for
from hitchopt.exports.formats.mavsdk_receiver import LATE
from hitchopt.exports.recording import Recording, Samples, recording_of_samples
from hitchopt.motion.states import states_at
from hitchopt.storage.atomic import Writer

Array = NDArray[np.float64]

COLUMNS = "idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb"

MODE = 70

SMOOTH = 2

SAME_TIME = 1e-6
"""[s] Within which the drones' rows are of one time."""

BLOCK = 50_000
"""Rows that are formatted at once."""

OPEN = 200
"""Files that are open at once."""


class MavsdkDroneShow(Whole):
    """Setpoints of 20 Hz for PX4."""

    name = "mavsdk_drone_show"
    summary = "one CSV per drone for mavsdk_drone_show (PX4)"
    frames = ("ned",)
    rate = 20.0
    accuracy = 2e-3
    feed_forward = (
        "ax, ay, az = a - F/m, the cable's force F and the drone's mass m: PX4 adds gravity itself "
        "and knows no cable; fly it with acceleration feed-forward on"
    )

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the files, numbered from 1 in the plan's order.

        Raises
        ------
        InfeasibleError: drones that begin above one another cannot take off.
        """
        lead = lead_in(task)
        settings = receiver_for(task).settings()
        names = file_names(len(task.names))
        writers: dict[str, Writer] = dict.fromkeys(names, _written_already)
        writers[names[0]] = lambda path: write_files(path.parent, task, lead)
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
        if lead.check is not None:
            receiver["separation_before"] = lead.check.worst
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
        ground = task.room.points(lead.ground)[:, 2]
        for table, lower, down in zip(tables, receiver.lowered(places), ground, strict=True):
            table[:, 0] -= lead.duration
            table[:, 3] += lower + down
        return recording_of_tables(task.names, [table[lead.rows :] for table in tables], task)


def file_names(drones: int) -> tuple[str, ...]:
    """Return the files' names."""
    return tuple(f"Drone {i + 1}.csv" for i in range(drones))


def write_files(folder: Path, task: Task, lead: LeadIn) -> None:
    """Write all drones' files, block by block of the samples.

    Parameters
    ----------
    folder: where to.
    task: the plan.
    lead: what the drones do before it.

    Raises
    ------
    OSError: a file cannot be written.
    """
    samples = ceil(task.motion.duration * task.rate - 1e-6) + 1
    names = file_names(len(task.names))
    size = max(1, BLOCK // len(names))
    for name in names:
        (folder / name).write_text(COLUMNS + "\n", encoding="ascii", newline="\n")
    parts: tuple[tuple[int, int, Callable[[Task, Array], Array]], ...] = (
        (0, lead.rows, lead.values),
        (lead.rows, samples, _plan_values),
    )
    for before, count, values_at in parts:
        for first in range(0, count, size):
            index = np.arange(first, min(first + size, count))
            values = values_at(task, index / task.rate) + 0.0
            _append(folder, names, before + index, values, task)


def _plan_values(task: Task, t: Array) -> Array:
    """Return positions, velocities and accelerations to feed forward, (S, D, 9)."""
    states, room = states_at(task.motion, t), task.room
    parts = (
        room.points(states.positions),
        room.vectors(states.velocities),
        room.vectors(states.accelerations) - pull_of(task, states),
    )
    return np.concatenate(parts, axis=-1)


def _append(
    folder: Path, names: tuple[str, ...], index: NDArray[np.int64], values: Array, task: Task
) -> None:
    for start in range(0, len(names), OPEN):
        with ExitStack() as stack:
            for i, name in enumerate(names[start : start + OPEN], start):
                file = stack.enter_context((folder / name).open("a", newline="\n"))
                file.write(_rows(index, index / task.rate, values[:, i], task.room.heading))


def _rows(index: NDArray[np.int64], t: Array, values: Array, heading: float) -> str:
    yaw = f"{math.degrees(heading):#.6g}"  # with a decimal point, as all that are no counts
    lines = [
        f"{i},{at:#.9g},"
        + ",".join(f"{value:#.9g}" for value in row)
        + f",{yaw},{MODE},255,255,255\n"
        for i, at, row in zip(index.tolist(), t.tolist(), values.tolist(), strict=True)
    ]
    return "".join(lines)


def _written_already(path: Path) -> None:
    if not path.exists():
        raise FileNotFoundError(2, "was not written with the first drone's", str(path))


def read_table(path: Path) -> Array:
    """Return the rows (S, 10) of one drone: t, positions, velocities, accelerations as they stand.

    Columns of velocities and accelerations that are not there are zero.

    Raises
    ------
    FileError: another header, rows of other lengths, fewer than two rows.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read: {error}") from error
    lines = [line for line in text.splitlines() if line.strip()]
    header = lines[0].split(",") if lines else []
    wanted = COLUMNS.split(",")[1:11]
    vectors = [wanted[:4], wanted[4:7], wanted[7:]]
    needed = vectors[:1] + [v for v in vectors[1:] if any(name in header for name in v)]
    missing = [name for vector in needed for name in vector if name not in header]
    if missing:
        raise FileError(f"{path}: its first line has no column {missing[0]!r}, not {COLUMNS}")
    told = [i for i, name in enumerate(wanted) if name in header]
    columns = [header.index(wanted[i]) for i in told]
    if len(lines) < 2:
        raise FileError(f"{path}: has no rows; two are the least")
    try:
        table = np.loadtxt(lines[1:], delimiter=",", ndmin=2, usecols=columns, comments=None)
    except (ValueError, IndexError) as error:
        raise FileError(f"{path}: {error}; it is truncated or damaged") from error
    if len(table) < 2:
        raise FileError(f"{path}: has {len(table)} rows; two are the least")
    whole = np.zeros((len(table), len(wanted)))
    whole[:, told] = table
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
    values = np.stack(tables, axis=1)[..., 1:]  # (S, D, 9)
    derivatives = np.moveaxis(values.reshape(*values.shape[:2], 3, 3), 2, 0).copy()
    if task is None:
        return recording_of_samples(names, lambda: [Samples(t, derivatives[:2])], "ned", 1)
    derivatives[2] += task.pulls(t)
    derivatives[2][t > task.motion.duration] = 0.0
    return recording_of_samples(names, lambda: [Samples(t, derivatives)], "ned", SMOOTH)
