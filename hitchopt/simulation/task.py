"""The task of a simulated flight: a plan's tables, read back, its team and its objects."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.exports.directory import HEADER as SETPOINTS_HEADER
from hitchopt.exports.directory import SETPOINTS, VERTICES, VERTICES_HEADER, refuse_mixture
from hitchopt.hitch import Team
from hitchopt.motion.loads import tautness
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import states_at
from hitchopt.objects import SolidObject
from hitchopt.storage.archive import PLAN
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

Flags = NDArray[np.bool_]

ALOFT = 0.03
"""Height over the places where it stood and will stand from which on an object is aloft [m]."""

CARRIED = 1.0 - 1e-6
"""Share of its weight from which on a hitch carries all of an object."""

SAME_TIME = 1e-6
"""Tolerance of a time that falls on a sample [s]: rounding of sums of periods."""

SETPOINT_ROW = np.dtype([("t", "f8"), ("name", "U32"), ("numbers", "f8", 16)])
VERTEX_ROW = np.dtype([("t", "f8"), ("name", "U32"), ("numbers", "f8", 3), ("tension", "f8")])
"""Columns of the two tables."""

EMPTY_COLUMN = 5
"""Column of the tension, which is empty in the last row of a chain; read as nan."""


@dataclass(frozen=True, eq=False)
class Cargo:
    """Objects, and where the plan has them at the samples of a task.

    Attributes
    ----------
    objects: by name.
    poses: (samples, objects, 5): x, y, z of their bases [m], cosine and sine of their yaws.
    held: whether the hitch holds them, such that its cables may touch them (samples, objects).
    borne: share of its weight that the hitch carries (samples, objects).
    floor: height of the ground on which they stand [m].
    """

    objects: Mapping[str, SolidObject] = field(default_factory=dict)
    poses: Array = field(default_factory=lambda: np.zeros((1, 0, 5)))
    held: Flags = field(default_factory=lambda: np.zeros((1, 0), dtype=np.bool_))
    borne: Array = field(default_factory=lambda: np.zeros((1, 0)))
    floor: float = 0.0

    @classmethod
    def of(cls, motion: Motion, t: Array) -> Cargo:
        """Return the objects of a plan at times ``t`` (samples,) [s] from its start."""
        objects = motion.requirements.objects
        times = np.clip(t, *motion.drones.breaks[[0, -1]])
        held = np.zeros((len(times), len(objects)), dtype=np.bool_)
        names = list(objects)
        for phase in motion.phases:
            if phase.hold is not None:
                during = (times >= phase.start) & (times <= phase.end)
                held[during, names.index(phase.hold.object)] = True
        poses, borne = motion.object_poses.at(times), motion.object_shares.at(times)
        return cls(objects, poses, held, borne, motion.requirements.floor)

    @property
    def names(self) -> list[str]:
        """Names of all objects."""
        return list(self.objects)

    @property
    def movable(self) -> Flags:
        """Whether an object can move (objects,)."""
        return np.array([not each.fixed for each in self.objects.values()], dtype=np.bool_)

    @property
    def carried(self) -> Flags:
        """Whether the hitch carries all of an object's weight (samples, objects)."""
        return self.borne >= CARRIED

    @property
    def aloft(self) -> Flags:
        """Whether an object is clear of what it stood on and will stand on (samples, objects)."""
        heights, rests = self.poses[..., 2], self.borne <= 0.0
        supports = []
        for order in (1, -1):  # the last place where it stood, and the next one
            rows = np.where(rests[::order], np.arange(len(rests))[:, None], -1)
            rows = np.maximum.accumulate(rows, axis=0)
            found = np.take_along_axis(heights[::order], np.maximum(rows, 0), axis=0)
            supports.append(np.where(rows >= 0, found, -np.inf)[::order])
        return ~rests & (heights > np.maximum(*supports) + ALOFT)


@dataclass(frozen=True, eq=False)
class Setpoints:
    """Commands to the drones q0, r0, q1, … at some times (…).

    Attributes
    ----------
    positions, velocities, accelerations, jerks: (…, 2n, 3) [m], [m/s], [m/s²], [m/s³]
    yaw: (…, 2n) [rad]
    cable_forces: (…, 2n, 3) [N], expected from the cables.
    """

    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    yaw: Array
    cable_forces: Array

    def __getitem__(self, index: int) -> Setpoints:
        """Return the setpoints of one sample."""
        return Setpoints(*(values[index] for values in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Task:
    """Setpoints of a team, and the hitch that the plan has at those times.

    Attributes
    ----------
    team: the drones and cables.
    t: times of the samples (samples,) [s], ascending.
    setpoints: commands (samples, …).
    formed: whether the hitch exists (samples,).
    vertices: planned vertices (samples, points, 3) [m]; zero where there is no hitch.
    tensions: planned tensions (samples, n) [N]; zero where there is no hitch.
    digest: SHA-256 of setpoints.csv, which identifies the plan in the results; or empty.
    taut: share of its part of the clasps' loads that each cable carries (samples, n); None: all of
        it where the cable has tension.
    cargo: objects.
    motion: the plan, for the corrections of ``Feedback``; None of tables alone.
    """

    team: Team
    t: Array
    setpoints: Setpoints
    formed: NDArray[np.bool_]
    vertices: Array
    tensions: Array
    digest: str = ""
    taut: Array | None = None
    cargo: Cargo = field(default_factory=Cargo)
    motion: Motion | None = None

    @classmethod
    def of(cls, motion: Motion, t: Array) -> Task:
        """Return the task of a plan at times (samples,) [s], as its tables would hold it."""
        states = states_at(motion, t)
        commands = states.positions, states.velocities, states.accelerations, states.jerks
        yaw, formed = np.zeros(commands[0].shape[:2]), np.asarray(states.formed, np.bool_)
        setpoints = Setpoints(*commands, yaw, states.cable_forces)
        vertices = np.where(formed[:, None, None], states.vertices, 0.0)
        tensions = np.where(formed[:, None], states.tensions, 0.0)
        task = cls(motion.team, t, setpoints, formed, vertices, tensions)
        return task.with_plan(motion)

    def with_plan(self, motion: Motion) -> Task:
        """Return the task with what only the plan says: how clasps are loaded, and its objects."""
        taut = PiecewisePolynomial(motion.drones.breaks, tautness(motion))
        times = np.clip(self.t, *taut.breaks[[0, -1]])
        cargo = Cargo.of(motion, times)
        return replace(self, taut=taut.at(times), cargo=cargo, motion=motion)

    @property
    def duration(self) -> float:
        """Time from the first setpoint to the last [s]."""
        return float(self.t[-1] - self.t[0])

    def load_shares(self, index: int) -> Array:
        """Return the shares (n,) of their parts of the loads that cables carry at a sample."""
        shares: Array = self.tensions[index] > 0.0 if self.taut is None else self.taut[index]
        return shares

    def index(self, elapsed: float) -> int:
        """Return the setpoint that applies ``elapsed`` [s] after the first one."""
        found = int(np.searchsorted(self.t, self.t[0] + elapsed + SAME_TIME, side="right")) - 1
        return min(max(found, 0), len(self.t) - 1)


def read_task(directory: Path) -> Task:
    """Return the task of a plan's directory.

    Raises
    ------
    FileError: a file is missing or broken, or the files are not of one solve.
    UnsupportedError: a plan of drones without cables.
    """
    motion = read_plan(directory / PLAN)
    if not motion.team.has_cables:
        raise UnsupportedError(
            f"{directory}: a plan of single drones has no cables; simulate a hitch's plan"
        )
    task = read_tables(directory / SETPOINTS, directory / VERTICES, motion.team)
    refuse_mixture(directory)
    return task.with_plan(motion)


def read_tables(setpoints: Path, vertices: Path, team: Team) -> Task:
    """Return the task of a ``setpoints.csv`` and a ``vertices.csv``, which may have no rows.

    Raises
    ------
    FileError: a table cannot be read, is not of this team, or not of the other one's plan.
    """
    points, n = team.layout.points, team.robots
    commands = _read(setpoints, SETPOINTS_HEADER, SETPOINT_ROW, "drones", team.drone_names)
    names = tuple(str(point) for point in range(points))
    hitch = _read(vertices, VERTICES_HEADER, VERTEX_ROW, "vertices", names)
    if not len(commands):
        raise FileError(f"{setpoints}: 0 rows for {len(team.drone_names)} drones; solve again")
    t = commands["t"][:, 0]
    formed = np.isin(t, hitch["t"][:, 0])
    if np.sum(formed) != len(hitch):
        raise FileError(f"{vertices}: holds times that {setpoints.name} has not; solve again")
    places, tensions = np.zeros((len(t), points, 3)), np.zeros((len(t), n))
    places[formed], tensions[formed] = hitch["numbers"], hitch["tension"][:, :n]
    x = commands["numbers"]
    vectors = (x[..., 0:3], x[..., 3:6], x[..., 6:9], x[..., 9:12])
    digest = hashlib.sha256(setpoints.read_bytes()).hexdigest()
    return Task(
        team, t, Setpoints(*vectors, x[..., 12], x[..., 13:]), formed, places, tensions, digest
    )


def _read(
    path: Path, header: str, row: np.dtype[np.void], kind: str, names: tuple[str, ...]
) -> NDArray[Any]:
    """Return the rows (samples, names) of a table, by time, then name.

    Raises
    ------
    FileError: the table cannot be read, or its rows are not those of the names.
    """
    try:
        with path.open(encoding="utf-8") as file:
            found = file.readline().rstrip("\r\n")
            lines = file.readlines()
        if found != header:
            raise FileError(f"{path}: begins with {found[:60]!r}, not {header!r}; solve again")
        rows: NDArray[Any] = np.empty(0, row)
        if lines:
            converters: dict[int | str, Callable[[str], float]] = {EMPTY_COLUMN: _number}
            rows = np.loadtxt(lines, row, delimiter=",", ndmin=1, converters=converters)
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file; solve the problem first") from None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: not a table of numbers: {error}; solve again") from error
    if not (np.all(np.isfinite(rows["t"])) and np.all(np.isfinite(rows["numbers"]))):
        raise FileError(f"{path}: holds numbers that are not finite; solve again")
    wanted = np.resize(np.array(names), rows.shape)
    for i in np.flatnonzero(rows["name"] != wanted)[:1]:
        raise FileError(
            f"{path}: row {i + 1} is of '{rows['name'][i]}' where '{wanted[i]}' is due; plan and "
            "tables are not of one solve: solve again"
        )
    if len(rows) % len(names):
        raise FileError(f"{path}: {len(rows)} rows for {len(names)} {kind}; solve again")
    table = rows.reshape(-1, len(names))
    if np.any(table["t"] != table["t"][:, :1]) or np.any(np.diff(table["t"][:, 0]) <= 0.0):
        raise FileError(f"{path}: its rows are not by time, then {kind}; solve again")
    return table


def _number(text: str) -> float:
    """Return a field's number; nan for an empty one."""
    return float(text or "nan")
