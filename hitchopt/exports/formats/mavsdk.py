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
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.errors import FileError, InfeasibleError, Violation
from hitchopt.exports.format import DroneFacts, Format, Loaded, Task, Written
from hitchopt.exports.recording import (
    Recording,
    read_columns,
    read_text,
    recording_of_samples,
    told_columns,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

COLUMNS = "idx,t,px,py,pz,vx,vy,vz,ax,ay,az,yaw,mode,ledr,ledg,ledb"

FLOWN = [COLUMNS.split(",")[i : i + 3] for i in (2, 5, 8)]  # Position, velocity and acceleration

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

    def write(self, folder: Path, task: Task, bound: float) -> Written:  # noqa: ARG002
        """Write every drone's rows.

        Raises
        ------
        InfeasibleError: drones that begin above one another cannot take off.
        """
        rise, first = Rise.of(task), task.motion.drones.coefficients[0, ..., 0]
        separation = _separation(task, first)
        settings = receiver_settings(task)
        files = self.files(task)
        for name, table in zip(files, np.moveaxis(rows_of(task, rise), 1, 0), strict=True):
            np.savetxt(folder / name, table, ROW, header=COLUMNS, comments="", encoding="ascii")
        notes = (
            f"the plan begins {rise.duration:g} s after the show (row {rise.rows}): until then the "
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
        receiver: dict[str, Any] = {"settings": settings, "plan_begins_s": rise.duration}
        if separation is not None:
            receiver["separation_before"] = separation
        return Written(files, notes, receiver)

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
        rise, tables = Rise.of(task), [read_table(folder / name) for name in self.files(task)]
        if len({len(table) for table in tables}) > 1 or len(tables[0]) <= rise.rows + 1:
            raise FileError(f"{folder}: its drones have not as many rows as the plan")
        # Altitudes are counted from the first row, and that is on the ground.
        ground = task.frame.points(np.array([0.0, 0.0, task.motion.requirements.floor]))[2]
        for table in tables:
            table[:, 0] -= rise.duration
            table[:, 3] += ground - table[0, 3]
        return recording_of_tables(task.names, [table[rise.rows :] for table in tables], task)


@dataclass(frozen=True, eq=False)
class Rise:
    """The rows before a plan's own: ``rows`` steps, in which drones rise from the ground."""

    rows: int
    duration: float  # [s]
    share: PiecewisePolynomial  # of the rise, 0 to 1, with continuous acceleration

    @classmethod
    def of(cls, task: Task) -> Rise:
        """Return the rise to a plan's first places."""
        motion, limits = task.motion, task.motion.requirements.limits
        heights = motion.drones.coefficients[0, :, 2, 0] - motion.requirements.floor
        highest = float(np.max(np.abs(heights)))
        # The quintic at rest at both ends is fastest by 15/8, and accelerates most by 10/√3.
        lasts = max(
            LEAST,
            1.875 * highest / min(SPEED, limits.speed),
            (10.0 / 3.0**0.5 * highest / min(ACCELERATION, limits.acceleration)) ** 0.5,
            (60.0 * highest / limits.jerk) ** (1.0 / 3.0),
        )
        rows = ceil((WAIT + lasts + SETTLE) * task.rate)
        ends = np.zeros((3, 4))
        ends[0, 2:] = 1.0
        breaks = np.array([0.0, WAIT, WAIT + lasts, rows / task.rate])
        share = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
        return cls(rows, rows / task.rate, share)


def _separation(task: Task, first: Array) -> float | None:
    """Return the least separation of drones that rise to ``first`` (D, 3) [m]; None of one drone.

    It is that on the ground: heights grow apart, and seen from above nothing moves.

    Raises
    ------
    InfeasibleError: drones that begin above one another cannot rise straight up to there.
    """
    if len(first) < 2:
        return None
    found = cKDTree(first[:, :2]).query(first[:, :2], 2)
    distances, nearest = np.asarray(found[0]), np.asarray(found[1])
    drone = int(np.argmin(distances[:, 1]))
    # Numbers in files have nine digits.
    reach = 5e-9 * float(np.max(np.abs(task.frame.points(first))))
    radius = task.motion.requirements.separation.radius
    ratio: float = (float(distances[drone, 1]) - 2.0 * 2.0**0.5 * reach) / (2.0 * radius)
    if ratio < 1.0:
        names = task.motion.team.drone_names
        where = tuple(names[i] for i in sorted((drone, int(nearest[drone, 1]))))
        when = "while the drones rise straight up from the ground to their first places"
        remedy = "begin with the drones side by side, or choose another format"
        raise InfeasibleError(
            [Violation("separation", ratio, 1.0, "min", "ratio", where, when, remedy)],
            "mavsdk_drone_show is not written: its drones take off from below their first places",
        )
    return ratio


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


def rows_of(task: Task, rise: Rise) -> Array:
    """Return all drones' rows (S, D, 12): index, time, nine setpoints and yaw in degrees."""
    samples = ceil(task.motion.duration * task.rate - 1e-6) + 1
    index = np.arange(rise.rows + samples)
    t, frame, first = index / task.rate, task.frame, task.states(np.zeros(1))
    before, plan = t[: rise.rows], task.setpoints(task.states(t[:samples]))
    places, up = first.positions[0], np.zeros_like(first.positions[0])
    up[:, 2] = places[:, 2] - task.motion.requirements.floor
    share, rate, bend = (rise.share.at(before, k)[:, None, None] for k in range(3))
    pull = task.pulls(first) * share
    rising = (
        frame.points(places - up + share * up),
        frame.vectors(rate * up),
        frame.vectors(bend * up) - pull,
    )
    values = [np.concatenate(parts, axis=-1) for parts in (rising, plan)]
    rows = np.empty((len(index), len(task.names), 12))
    rows[..., 0], rows[..., 1] = index[:, None], t[:, None]
    rows[..., 2:11] = np.concatenate(values) + 0.0  # no negative zeros
    rows[..., 11] = math.degrees(task.frame.heading)
    return rows


def read_table(path: Path) -> Array:
    """Return the rows (S, 4, 7 or 10) of one drone: t, places and rates as they stand.

    Raises
    ------
    FileError: another header, rows of other lengths, fewer than two rows.
    """
    header, *lines = [line for line in read_text(path).splitlines() if line.strip()] or [""]
    told = told_columns(header.split(","), FLOWN)
    return read_columns(lines, header, ("t", *told), COLUMNS, str(path), least=2)


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
        alike = table.shape == tables[0].shape and np.max(np.abs(table[:, 0] - t)) <= SAME_TIME
        if not alike:
            raise FileError(f"{name}: its times are not those of {names[0]}, or its columns")
    values = np.stack([table[:, 1:] for table in tables], axis=1)
    if task is None:
        return recording_of_samples(names, t, values[..., :6], "ned", 1)
    values[..., 6:] += task.pulls(task.states(t))
    values[t > task.motion.duration, :, 6:] = 0.0
    return recording_of_samples(names, t, values, "ned", SMOOTH)
