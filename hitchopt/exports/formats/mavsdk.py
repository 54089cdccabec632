"""Format mavsdk_drone_show: ``Drone N.csv``, setpoints for PX4 through MAVSDK, north-east-down.

``idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb`` at 20 Hz, mode 70 (manoeuvring), yaw in
degrees as MAVSDK takes it.

**Not all rows are flown.** By its own settings the show replaces rows by a climb and by a landing,
by altitude and by time, and sends positions alone. The manifest has the settings of its
``src/params.py`` with which all of a plan's rows are flown, with their velocities and
accelerations: every drone's rows are then counted from its own first one, in altitude too.

**The rise.** Drones are armed on the ground, so their first row is there, below the plan's first
place. They wait until all of them follow their rows, rise together, straight up, and rest before
the plan begins. Seen from above nothing moves; a hitch whose drones begin at one altitude rises as
it is. The cables' pull grows with the altitude.

**Feed-forward.** PX4 adds gravity to the acceleration setpoint and tilts by the sum, but knows no
cable. So ``ax, ay, az`` are ``a_ff = a - F / m``, with the cable's force F on the drone: thrust is
then ``m (a_ff + g)``, as planned. Use the show with velocity and acceleration feed-forward on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, floor
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.exporting import drone_check
from hitchopt.exports.format import (
    Candidate,
    DroneFacts,
    Format,
    Loaded,
    Task,
)
from hitchopt.exports.recording import Recording, read_columns, read_text, recording_of_samples
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

COLUMNS = "idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb"

READ = COLUMNS.split(",")[1:11]  # Columns that are read: time, position, velocity and acceleration

ROW = "%d," + "%#.9g," * 10 + "%#.6g,70,255,255,255"
"""A row of mode 70; all that are no counts have a decimal point."""

SMOOTH = 2  # Quintics run through positions, velocities and accelerations
SAME_TIME = 1e-6  # Largest difference of the drones' times in one row [s]
LATE = 5.0  # Longest time that arming takes after the common start [s]: rows run meanwhile
BLEND = 3.0  # Longest straight line from the climb to the rows [s]

WAIT = LATE + BLEND
"""Wait on the ground [s]: a drone that is late, or is drawn to its row, is there by then."""

SETTLE = 3.0  # Wait at the first places [s]
SPEED, ACCELERATION = 0.5, 0.5  # Largest speed and acceleration while rising [m/s], [m/s²]
LEAST = 1.0  # Shortest duration of the rise [s]
DIGITS = 5e-9  # Relative error of a number in the files, which has nine digits
BELOW = 1.0  # Distance of thresholds below all rows [m]: those are never under them


class MavsdkDroneShow(Format):
    """Setpoints of 20 Hz for PX4, ``Drone N.csv`` from 1 in the plan's order."""

    name = "mavsdk_drone_show"
    file = "Drone {number}.csv"
    endings = (".csv",)
    several = endings
    frames = ("ned",)
    rate = 20.0
    accuracy = 2e-3
    feed_forward = (
        "ax, ay, az = a - F/m, the cable's force F and the drone's mass m: PX4 adds gravity itself "
        "and knows no cable; fly it with acceleration feed-forward on"
    )
    carries_pull = True

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give the files.

        Raises
        ------
        InfeasibleError: drones that begin above one another cannot take off.
        """
        lead = lead_in(task)
        check = _rising_check(task, lead)
        settings = receiver_settings(task)
        rows = np.moveaxis(rows_of(task, lead), 1, 0)
        write = partial(np.savetxt, fmt=ROW, header=COLUMNS, comments="", encoding="ascii")
        each = zip(self.files(task), rows, strict=True)
        writers = {name: partial(write, X=table) for name, table in each}
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

    def recognises(self, labels: Sequence[str]) -> bool:
        """Return whether the first columns are index, time and north."""
        return labels[:3] == ["idx", "t", "px"]

    def load(self, files: Sequence[Path]) -> Loaded:
        """Return what CSV files hold, one drone each.

        Nobody knows the pull in their accelerations, so cubics run through positions and
        velocities.
        """
        tables = [read_table(path) for path in files]
        names = tuple(path.stem for path in files)
        facts = (DroneFacts(n, 0, 0, float(t[-1, 0])) for n, t in zip(names, tables, strict=True))
        recording = recording_of_tables(names, tables, None)
        return Loaded(self.name, recording, tuple(facts), streamed=True)

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the curves through the plan's setpoints as the receiver flies them.

        The cables' pull is taken out of accelerations.
        """
        lead, tables = lead_in(task), [read_table(folder / name) for name in self.files(task)]
        if len({len(table) for table in tables}) > 1 or len(tables[0]) <= lead.rows + 1:
            raise FileError(f"{folder}: its drones have not as many rows as the plan")
        # Altitudes are counted from the first row, and that is on the ground.
        ground = task.frame.points(lead.curves.at(0.0))[:, 2]
        for table, down in zip(tables, ground, strict=True):
            table[:, 0] -= lead.duration
            table[:, 3] += down - table[0, 3]
        return recording_of_tables(task.names, [table[lead.rows :] for table in tables], task)


@dataclass(frozen=True, eq=False)
class LeadIn:
    """The rows before a plan's own: ``rows`` steps, in which drones rise from the ground."""

    rows: int
    duration: float  # [s]
    share: PiecewisePolynomial  # of the rise, 0 to 1, with continuous acceleration
    curves: PiecewisePolynomial  # positions (D, 3) [m] while rising, in the plan's axes


def lead_in(task: Task) -> LeadIn:
    """Return the rows before the plan's own."""
    motion = task.motion
    limits = motion.requirements.limits
    first = motion.drones.coefficients[0, ..., 0]
    ground = np.column_stack([first[:, :2], np.full(len(first), motion.requirements.floor)])
    highest = float(np.max(np.abs(first - ground)))
    # The quintic at rest at both ends is fastest by 15/8, and accelerates most by 10/√3.
    rise = max(
        LEAST,
        1.875 * highest / min(SPEED, limits.speed),
        (10.0 / 3.0**0.5 * highest / min(ACCELERATION, limits.acceleration)) ** 0.5,
        (60.0 * highest / limits.jerk) ** (1.0 / 3.0),
    )
    rows = ceil((WAIT + rise + SETTLE) * task.rate)
    breaks = np.array([0.0, WAIT, WAIT + rise, rows / task.rate])

    def between(start: Array, end: Array) -> PiecewisePolynomial:
        ends = np.zeros((3, 4, *start.shape))
        ends[0, :2], ends[0, 2:] = start, end
        return PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])

    share = between(np.zeros(()), np.ones(()))
    return LeadIn(rows, rows / task.rate, share, between(ground, first))


def _rising_check(task: Task, lead: LeadIn) -> Check | None:
    """Return the separation for all t, the rounding in the files included; None of one drone.

    Raises
    ------
    InfeasibleError: drones that begin above one another cannot rise straight up to there.
    """
    motion, curves = task.motion, lead.curves
    c = drone_check("separation", curves, replace(motion.requirements, arena=None))
    if c is None:
        return None
    where = tuple(motion.team.drone_names[int(drone[1:])] for drone in c.where)
    reach = float(np.max(np.abs(task.frame.points(curves.coefficients[[0, -1], ..., 0]))))
    scale = float(np.max(motion.requirements.separation.scale))
    worst = c.bound - 2.0 * 3.0**0.5 * DIGITS * reach * scale
    c = Check.of(c.name, worst, c.limit, c.sense, c.unit, c.time, where)
    if not c.holds:
        when = "while the drones rise straight up from the ground to their first places"
        remedy = "begin with the drones side by side, or choose another format"
        raise InfeasibleError(
            (c.violation(when, remedy),),
            "mavsdk_drone_show is not written: its drones take off from below their first places",
        )
    return c


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


def rows_of(task: Task, lead: LeadIn) -> Array:
    """Return all drones' rows (S, D, 12): index, time, nine setpoints and yaw in degrees."""
    samples = ceil(task.motion.duration * task.rate - 1e-6) + 1
    index = np.arange(lead.rows + samples)
    t, frame = index / task.rate, task.frame
    before, plan = t[: lead.rows], task.setpoints(task.states(t[:samples]))
    pull = task.pulls(task.states(np.zeros(1))) * lead.share.at(before)[:, None, None]
    velocities, forward = (frame.vectors(lead.curves.at(before, order)) for order in (1, 2))
    rising = (frame.points(lead.curves.at(before)), velocities, forward - pull)
    values = [np.concatenate(parts, axis=-1) for parts in (rising, plan)]
    rows = np.empty((len(index), len(task.names), 12))
    rows[..., 0], rows[..., 1] = index[:, None], t[:, None]
    rows[..., 2:11] = np.concatenate(values) + 0.0  # no negative zeros
    rows[..., 11] = math.degrees(task.frame.heading)
    return rows


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
    table = read_columns(lines, header, told, COLUMNS, str(path), least=2)
    whole = np.zeros((len(table), len(READ)))
    whole[:, [READ.index(name) for name in told]] = table
    return whole


def recording_of_tables(
    names: tuple[str, ...], tables: list[Array], task: Task | None
) -> Recording:
    """Return the curves through all drones' rows, which share their times.

    With a task the cables' pull is taken out of the accelerations, and quintics run through all
    three; without one cubics run through positions and velocities.

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
        values[..., 6:] += task.pulls(task.states(t))
        values[t > task.motion.duration, :, 6:] = 0.0
    return recording_of_samples(names, t, values, "ned", 1 if task is None else SMOOTH)
