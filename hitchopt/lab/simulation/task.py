"""The task of a simulated flight: setpoints of a plan at 100 Hz, its team and its objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import UnsupportedError
from hitchopt.exports.directory import refuse_mixture
from hitchopt.hitch import Team
from hitchopt.hitch.flight_controller import EstimatorParameters, FlightController
from hitchopt.hitch.team import Layout
from hitchopt.motion.flight import CombinedSwarm, Flight, TeamMotion
from hitchopt.motion.loads import tautness
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import DRONE_FIELDS, States, sample_times, states_at
from hitchopt.objects import SolidObject
from hitchopt.storage.archive import PLAN
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

Flags = NDArray[np.bool_]

RATE = 100.0  # Setpoints per second [Hz]
MIN_LIFT = 0.03  # Smallest height of a lifted object above its supports [m]
FULL_SHARE = 1.0 - 1e-6  # Smallest fraction of its weight at which an object is fully carried
POINT_TABLES = ("starts", "ends", "clasps", "anchors", "pulled_to")  # Of a layout
CABLE_TABLES = ("ahead", "behind", "neighbours")
JOINED_FIELDS = (*DRONE_FIELDS, "vertices", "vertex_velocities", "legs", "tensions")
TIME_TOLERANCE = 1e-6  # Tolerance of sample times [s], for rounding of sums of periods


@dataclass(frozen=True, eq=False)
class Cargo:
    """Objects, and their planned poses at the samples of a task."""

    objects: Mapping[str, SolidObject] = field(default_factory=dict)  # by name
    # (samples, objects, 5): x, y, z of their bases [m], cosine and sine of their yaws
    poses: Array = field(default_factory=lambda: np.zeros((1, 0, 5)))
    # whether the hitch holds them and its cables may touch them (samples, objects)
    held: Flags = field(default_factory=lambda: np.zeros((1, 0), dtype=np.bool_))
    # fraction of its weight that the hitch carries (samples, objects)
    load_share: Array = field(default_factory=lambda: np.zeros((1, 0)))
    floor: float = 0.0  # height of the ground on which they stand [m]
    # for several teams, the team whose hitch may hold each object
    holders: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, motion: Motion, t: Array) -> Cargo:
        """Return the objects of a plan at times (samples,) [s]."""
        objects = motion.requirements.objects
        held = np.zeros((len(t), len(objects)), dtype=np.bool_)
        for phase in motion.phases:
            if phase.hold is not None:
                during = (t >= phase.start) & (t <= phase.end)
                held[during, list(objects).index(phase.hold.object)] = True
        poses, load_share = motion.poses.at(t), motion.load_share.at(t)
        return cls(objects, poses, held, load_share, motion.requirements.floor)

    @classmethod
    def joined(cls, flight: Flight, teams: Sequence[TeamMotion], t: Array) -> Cargo:
        """Return the objects of several teams, and the teams that hold them."""
        requirements, holders = flight.requirements, dict[str, str]()
        shape = len(t), len(requirements.objects)
        held, load_share = np.zeros(shape, dtype=np.bool_), np.zeros(shape)
        poses = flight.poses.at(t)
        whole = cls(requirements.objects, poses, held, load_share, requirements.floor)
        for flown in teams:
            part = cls.of(flown.motion, t)
            for j, name in enumerate(part.names):
                key = flown.label(name) if flown.label(name) in whole.objects else name
                i, held = whole.names.index(key), part.held[:, j]
                whole.held[:, i] |= held
                share = whole.load_share[:, i]
                np.maximum(share, part.load_share[:, j], out=share)
                if held.any() or key not in holders:
                    holders[key] = flown.name
        return replace(whole, holders=holders)

    @property
    def names(self) -> list[str]:
        """Names of all objects."""
        return list(self.objects)

    @property
    def movable(self) -> Flags:
        """Whether objects can move (objects,)."""
        return np.array([not each.fixed for each in self.objects.values()], dtype=np.bool_)

    @property
    def carried(self) -> Flags:
        """Whether the hitch carries the full weight of objects (samples, objects)."""
        return self.load_share >= FULL_SHARE

    @property
    def lifted(self) -> Flags:
        """Whether objects are clear of their previous and next supports (samples, objects)."""
        heights, rests = self.poses[..., 2], self.load_share <= 0.0
        supports = []
        for order in (1, -1):  # the previous support, and the next one
            rows = np.where(rests[::order], np.arange(len(rests))[:, None], -1)
            rows = np.maximum.accumulate(rows, axis=0)
            last = np.take_along_axis(heights[::order], np.maximum(rows, 0), axis=0)
            supports.append(np.where(rows >= 0, last, -np.inf)[::order])
        return ~rests & (heights > np.maximum(*supports) + MIN_LIFT)


@dataclass(frozen=True, eq=False)
class Commands:
    """Setpoints at some times (…); yaw is 0."""

    positions: Array  # (…, 2n, 3) [m]
    velocities: Array  # (…, 2n, 3) [m/s]
    accelerations: Array  # (…, 2n, 3) [m/s²]; less F / m if the force F of cables is fed forward
    rates: Array  # (…, 2n, 3) [rad/s], about the bodies' axes
    files: str = ""  # exported files that they are read from, in words; empty if streamed

    @classmethod
    def joined(cls, each: Sequence[Commands]) -> Commands:
        """Return the samples of several teams; those that end early hold their last one."""
        samples = np.arange(max(len(commands.positions) for commands in each))

        def joined(name: str) -> Array:
            columns = (getattr(commands, name).take(samples, 0, mode="clip") for commands in each)
            return np.concatenate([*columns], axis=1)

        arrays = {name: joined(name) for name in each[0].arrays}
        return cls(**arrays, files=each[0].files)

    @property
    def arrays(self) -> dict[str, Array]:
        """Arrays of the setpoints by name."""
        return {name: values for name, values in vars(self).items() if name != "files"}

    def __getitem__(self, index: int) -> Commands:
        """Return the setpoints of one sample, of the last one beyond it."""
        i = min(index, len(self.positions) - 1)
        return Commands(self.positions[i], self.velocities[i], self.accelerations[i], self.rates[i])


@dataclass(frozen=True, eq=False)
class Received:
    """What the drones of exported files receive and are set to."""

    commands: Commands  # (samples, 2n, 3)
    loops: tuple[FlightController, ...]  # (2n,); empty if the files hold no gains
    estimator: EstimatorParameters | None  # of the drones' filters; None if not in the files
    flown_by: str  # upload or stream


def team_of(name: str) -> str:
    """Return the team in the name of a drone, point or cable; empty for a single team."""
    return name.rpartition(".")[0]


class Passing(NamedTuple):
    """Drones at planned positions that are not simulated.

    Names are (m,), positions (samples, m, 3) [m], masses (m,) [kg].
    """

    names: tuple[str, ...] = ()
    positions: Array = np.zeros((1, 0, 3))
    masses: Array = np.zeros(0)

    @classmethod
    def of(cls, teams: Sequence[TeamMotion], start: float, t: Array) -> Passing:
        """Return the drones of teams at times (samples,) [s] after a ``start`` of their clock."""
        names, positions, masses = list[str](), [np.zeros((len(t), 0, 3))], [np.zeros(0)]
        for flown in teams:
            drones, team = flown.motion.drones, flown.motion.team
            names += map(flown.label, team.drone_names)
            positions.append(drones.at(np.clip(start + t, *drones.breaks[[0, -1]])))
            masses.append(team.mass)
        return cls(tuple(names), np.concatenate(positions, axis=1), np.concatenate(masses))

    def at(self, index: Any) -> Array:
        """Return positions (…, m, 3) [m] at samples (…)."""
        positions: Array = np.take(self.positions, index, axis=0, mode="clip")
        return positions


class Crew(CombinedSwarm):
    """Several teams with cables as one, with concatenated arrays and prefixed names."""

    def __init__(self, flown: Sequence[TeamMotion]) -> None:
        teams = [(each.name, each.motion.team) for each in flown]
        super().__init__(teams)
        layouts = [team.layout for _, team in teams]
        cables = np.cumsum([0, *(each.robots for each in layouts)]).tolist()
        points = np.cumsum([0, *(each.points for each in layouts)]).tolist()
        offsets: dict[str, list[int]] = dict.fromkeys(POINT_TABLES, points) | dict.fromkeys(
            CABLE_TABLES, cables
        )
        tables: dict[str, Any] = {
            name: np.concatenate(
                [getattr(each, name) + first for each, first in zip(layouts, firsts, strict=False)]
            )
            for name, firsts in offsets.items()
        }
        tables["has_leg"] = np.concatenate([each.has_leg for each in layouts])
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(team, name) for _, team in teams])
            for name in ("cable_length", "tension", "load")
        }
        arrays |= {"robots": cables[-1], "_layout": Layout(cables[-1], points[-1], **tables)}
        arrays["_points"] = tuple(
            each.label(name) for each in flown for name in each.motion.team.point_names
        )
        vars(self).update(arrays)

    @property
    def layout(self) -> Layout:
        """Indices that relate points, cables and drones."""
        layout: Layout = vars(self)["_layout"]
        return layout

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of points (points,): a.p0, a.p1, …, b.p0, …."""
        names: tuple[str, ...] = vars(self)["_points"]
        return names


@dataclass(frozen=True, eq=False)
class Task:
    """Setpoints of a flight, and the plan's hitch at their times.

    For several teams it holds drones, vertices and cables of all teams with cables.
    """

    team: Team  # the team that flies
    states: States  # (samples, …), objects aside; without a hitch, vertices and tensions are zero
    # fraction of its clasps' loads that each cable carries (samples, n); None: all of cables under
    # tension
    taut: Array | None = None
    cargo: Cargo = field(default_factory=Cargo)  # objects
    # the plan, which feedback and gripped cables need; None for other setpoints
    flight: Flight | None = None
    teams: tuple[Task, ...] = ()  # the tasks of several teams
    passing: Passing = field(default_factory=Passing)  # drones that are not simulated
    received: Received | None = None  # from exported files; None if the plan itself is flown

    def __post_init__(self) -> None:
        states, formed = self.states, self.states.formed[:, None]
        vertices = np.where(formed[..., None], states.vertices, 0.0)
        tensions = np.where(formed, states.tensions, 0.0)
        object.__setattr__(self, "states", replace(states, vertices=vertices, tensions=tensions))

    @classmethod
    def of(cls, flight: Flight) -> Task:
        """Return the task of a plan; UnsupportedError for drones without cables."""
        if not flight.has_cables:
            raise UnsupportedError("single drones have no cables; simulate a hitch's plan")
        t = sample_times(flight.duration, RATE)
        tied = [each for each in flight.teams if each.motion.team.has_cables]
        single = [each for each in flight.teams if not each.motion.team.has_cables]
        passing = Passing.of([*single, *flight.others], float(flight.breaks[0]), t)
        parts = tuple(cls._of_team(each.motion, t) for each in tied)
        if len(flight.teams) == 1:
            return replace(parts[0], flight=flight, passing=passing)

        def joined(records: list[Any], names: Iterable[str]) -> dict[str, Any]:
            rows = {name: [getattr(record, name) for record in records] for name in names}
            return {name: np.concatenate(values, axis=1) for name, values in rows.items()}

        each = [part.states for part in parts]
        formed = np.any([states.formed for states in each], axis=0)
        states = replace(each[0], formed=formed, **joined(each, JOINED_FIELDS))
        task = cls(Crew(tied), states, flight=flight, teams=parts, passing=passing)
        cargo = Cargo.joined(flight, tied, t)
        return replace(task, cargo=cargo, **joined(list(parts), ["taut"]))

    @classmethod
    def _of_team(cls, motion: Motion, t: Array) -> Task:
        """Return the task of one team at times (samples,) [s]."""
        taut = PiecewisePolynomial(motion.drones.breaks, tautness(motion)).at(t)
        states, cargo = states_at(motion, t), Cargo.of(motion, t)
        return cls(motion.team, states, taut, cargo, Flight.of(motion))

    @property
    def parts(self) -> tuple[Task, ...]:
        """Tasks of all teams; the task itself for one team."""
        return self.teams or (self,)

    @property
    def motion(self) -> Motion | None:
        """The motion of the plan's only team; None for other setpoints.

        Raises UnsupportedError for several teams: each part has its motion.
        """
        if self.flight is None:
            return None
        return self.flight.of_one_team("the motion of a task", others=True)

    def require_one_team(self, what: str) -> None:
        """Raise UnsupportedError for several teams, which ``what`` does not support."""
        if self.flight is not None:
            self.flight.of_one_team(what, others=True)

    def clasped(self, flags: Sequence[Flags]) -> Flags:
        """Return flags (…) of every team, repeated for its clasps (…, clasps)."""
        counts = [len(part.team.layout.clasps) for part in self.parts]
        each = zip(flags, counts, strict=True)
        return np.concatenate([np.repeat(x[..., None], count, axis=-1) for x, count in each], -1)

    @property
    def duration(self) -> float:
        """Time from the first setpoint to the last [s]."""
        return float(self.states.t[-1] - self.states.t[0])

    def released(self, motion: Motion, start: float, duration: float) -> Task:
        """Return the task of a motion whose cable forces vanish smoothly in a ``duration`` [s]."""
        new = Task.of(Flight.of(motion)).states
        share = np.clip((new.t - start) / duration, 0.0, 1.0)[:, None, None]
        forces = new.cable_forces * (1.0 - share**2 * (3.0 - 2.0 * share))
        return Task(self.team, replace(new, t=self.states.t[0] + new.t, cable_forces=forces))

    def load_shares(self, index: int) -> Array:
        """Return the shares (n,) of loads that cables carry at a sample."""
        shares = self.states.tensions > 0.0 if self.taut is None else self.taut
        return np.asarray(shares[index])

    def index(self, elapsed: float) -> int:
        """Return the setpoint that applies ``elapsed`` [s] after the first one."""
        t = self.states.t
        index = int(np.searchsorted(t, t[0] + elapsed + TIME_TOLERANCE, side="right")) - 1
        return min(max(index, 0), len(t) - 1)


def read_task(directory: Path) -> Task:
    """Return the task of the plan in a directory; FileError if it is missing or damaged."""
    flight = read_plan(directory / PLAN)
    refuse_mixture(directory)
    return Task.of(flight)
