"""The tasks of flights: setpoints of a plan at 100 Hz, its teams and its objects.

A ``TeamTask`` is that of one team. A ``Task`` is that of a flight: the tasks of all teams with
cables, and what flies with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.directory import refuse_mixture
from hitchopt.drones.controllers import EstimatorParameters, FlightController
from hitchopt.hitch import Team
from hitchopt.hitch.team import Layout
from hitchopt.motion.flight import CombinedSwarm, Flight, TeamMotion, team_label
from hitchopt.motion.loads import tautness
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import DRONE_FIELDS, States, sample_times, states_at
from hitchopt.objects import SolidObject
from hitchopt.storage.archive import PLAN
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, lazy

Flags = NDArray[np.bool_]

RATE = 100.0  # Setpoints per second [Hz]
MIN_LIFT = 0.03  # Smallest height of a lifted object above its supports [m]
PLACE_TOLERANCE = 1e-6  # Tolerance of an object's position [m] above its next place
FULL_SHARE = 1.0 - 1e-6  # Smallest fraction of its weight at which an object is fully carried
POINT_TABLES = ("starts", "ends", "clasps", "anchors", "pulled_to")  # Tables of a layout
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
    floor: float | None = 0.0  # height of the ground on which they stand [m], if there is one
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
    def joined(cls, flight: Flight, teams: Sequence[TeamTask]) -> Cargo:
        """Return the objects of several teams, and the teams that hold them."""
        requirements, holders, t = flight.requirements, dict[str, str](), teams[0].states.t
        shape = len(t), len(requirements.objects)
        held, load_share = np.zeros(shape, dtype=np.bool_), np.zeros(shape)
        poses = flight.poses.at(t)
        whole = cls(requirements.objects, poses, held, load_share, requirements.floor)
        for task in teams:
            for j, name in enumerate(task.cargo.names):
                label = team_label(task.name, name)
                key = label if label in whole.objects else name
                i, held = whole.names.index(key), task.cargo.held[:, j]
                whole.held[:, i] |= held
                share = whole.load_share[:, i]
                np.maximum(share, task.cargo.load_share[:, j], out=share)
                if held.any() or key not in holders:
                    holders[key] = task.name
        return replace(whole, holders=holders)

    @property
    def names(self) -> list[str]:
        """Names of all objects."""
        return list(self.objects)

    @property
    def movable(self) -> Flags:
        """Return whether objects can move (objects,)."""
        return np.array([not each.fixed for each in self.objects.values()], dtype=np.bool_)

    @property
    def carried(self) -> Flags:
        """Return whether the hitch carries the full weight of objects (samples, objects)."""
        return self.load_share >= FULL_SHARE

    @property
    def places_below(self) -> Array:
        """Return the heights (samples, objects) [m] at which objects are set down straight below.

        They are -inf where an object is not above its next place at rest, on its way down.
        """
        t = np.arange(len(self.poses))[:, None]
        rests = np.where(self.load_share <= 0.0, t, len(t))
        following = np.minimum.accumulate(rests[::-1], axis=0)[::-1]
        ends = np.take_along_axis(self.poses, np.minimum(following, len(t) - 1)[..., None], axis=0)
        offsets = np.delete(self.poses - ends, 2, axis=-1)
        is_below = (following < len(t)) & np.all(np.abs(offsets) <= PLACE_TOLERANCE, axis=-1)
        return np.where(is_below, ends[..., 2], -np.inf)

    @property
    def lifted(self) -> Flags:
        """Return whether objects are clear of the supports before and after (samples, objects)."""
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

    def until(self, index: int, accelerations: Array) -> Commands:
        """Return the samples up to one, which is held, without the plan's accelerations (2n, 3)."""
        last = min(index, len(self.positions) - 1)
        arrays = {name: values[: last + 1].copy() for name, values in self.arrays.items()}
        stays = Commands(**arrays, files=self.files)
        stays.velocities[-1] = stays.rates[-1] = 0.0
        stays.accelerations[-1] -= accelerations
        return stays

    def __getitem__(self, index: int) -> Commands:
        """Return the setpoints of one sample, of the last one beyond it."""
        i = min(index, len(self.positions) - 1)
        return Commands(self.positions[i], self.velocities[i], self.accelerations[i], self.rates[i])


@dataclass(frozen=True, eq=False)
class Received:
    """The setpoints and parameters of drones that fly exported files."""

    commands: Commands  # (samples, 2n, 3)
    loops: tuple[FlightController, ...]  # (2n,); empty if the files contain no gains
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

    def __init__(self, teams: Sequence[tuple[str, Team]]) -> None:
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
            team_label(name, point) for name, team in teams for point in team.point_names
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
class TeamTask:
    """Setpoints of one team with cables, and the plan's hitch at their times."""

    team: Team  # the team that flies
    states: States  # (samples, …), objects aside; without a hitch, vertices and tensions are zero
    # fraction of its clasps' loads that each cable carries (samples, n); None: all of cables under
    # tension
    taut: Array | None = None
    cargo: Cargo = field(default_factory=Cargo)  # objects
    # the team's plan, which gripped cables need; None for other setpoints
    motion: Motion | None = None
    others: tuple[TeamMotion, ...] = ()  # teams of external plans, on the plan's clock
    name: str = ""  # in a flight of several teams; empty for a single team

    def __post_init__(self) -> None:
        states, formed = self.states, self.states.formed[:, None]
        vertices = np.where(formed[..., None], states.vertices, 0.0)
        tensions = np.where(formed, states.tensions, 0.0)
        object.__setattr__(self, "states", replace(states, vertices=vertices, tensions=tensions))

    @classmethod
    def of(cls, motion: Motion) -> TeamTask:
        """Return the task of one team's plan."""
        return cls.in_flight(TeamMotion("", motion), sample_times(motion.duration, RATE))

    @classmethod
    def in_flight(
        cls, flown: TeamMotion, t: Array, others: tuple[TeamMotion, ...] = ()
    ) -> TeamTask:
        """Return the task of a flight's team at times (samples,) [s], among external plans."""
        motion = flown.motion
        taut = PiecewisePolynomial(motion.drones.breaks, tautness(motion)).at(t)
        states, cargo = states_at(motion, t), Cargo.of(motion, t)
        return cls(motion.team, states, taut, cargo, motion, others, flown.name)

    @property
    def flight(self) -> Flight | None:
        """The flight of the team and the external plans; None for other setpoints."""
        if self.motion is None:
            return None
        return Flight((TeamMotion("", self.motion),), self.others)

    @property
    def duration(self) -> float:
        """Time from the first setpoint to the last [s]."""
        return float(self.states.t[-1] - self.states.t[0])

    def until(self, index: int) -> TeamTask:
        """Return the task whose last sample is one of its own."""
        samples, cargo = slice(index + 1), self.cargo
        cargo = replace(
            cargo,
            poses=cargo.poses[samples],
            held=cargo.held[samples],
            load_share=cargo.load_share[samples],
        )
        taut = None if self.taut is None else self.taut[samples]
        return replace(self, states=self.states[samples], taut=taut, cargo=cargo)

    @property
    def pieces(self) -> NDArray[np.intp]:
        """Pieces of the plan's polynomials at the samples (samples,); zeros without a plan."""
        if self.motion is None:
            return np.zeros(len(self.states.t), dtype=np.intp)
        breaks = self.motion.drones.breaks[1:-1]
        return np.searchsorted(breaks, self.states.t, side="right")

    def clasps_at(self, index: int) -> Flags:
        """Return whether clasps exist at a sample (clasps,): they do if a hitch is formed."""
        return np.full(len(self.team.layout.clasps), self.states.formed[index])

    def load_shares(self, index: int) -> Array:
        """Return the shares (n,) of loads that cables carry at a sample."""
        shares = self.states.tensions > 0.0 if self.taut is None else self.taut
        return np.asarray(shares[index])

    def index(self, elapsed: float) -> int:
        """Return the setpoint that applies ``elapsed`` [s] after the first one."""
        t = self.states.t
        index = int(np.searchsorted(t, t[0] + elapsed + TIME_TOLERANCE, side="right")) - 1
        return min(max(index, 0), len(t) - 1)


class Span(NamedTuple):
    """Samples of a plan in which a hitch is closed, from the first to the last one."""

    first: int
    last: int


def closed_spans(part: TeamTask) -> Iterator[Span]:
    """Yield the spans of samples in which the hitch of a team is formed."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], part.states.formed, [False]])))
    for first, end in edges.reshape(-1, 2).tolist():
        if end - first > 1:
            yield Span(first, end - 1)


@dataclass(frozen=True, eq=False)
class Task:
    """Setpoints of a flight: the tasks of its teams with cables, and what flies with them.

    Drones, vertices and cables of several teams are concatenated.
    """

    teams: tuple[TeamTask, ...]  # at least one, at the same times
    flight: Flight | None = None  # the plan; None for other setpoints
    passing: Passing = field(default_factory=Passing)  # drones that are not simulated
    received: Received | None = None  # from exported files; None if the plan itself is flown

    @classmethod
    def of(cls, flight: Flight) -> Task:
        """Return the task of a plan; UnsupportedError for drones without cables."""
        if not flight.has_cables:
            raise unsupported(Feature.SIMULATION, Neighbour.SINGLE_DRONES)
        starts = [each.motion.phases[0].state for each in flight.teams]
        if any(state.tied and not state.hitched for state in starts):
            raise unsupported(Feature.SIMULATION, Neighbour.LOOSE_CLASPS)
        t = sample_times(flight.duration, RATE)
        tied = [each for each in flight.teams if each.motion.team.has_cables]
        single = [each for each in flight.teams if not each.motion.team.has_cables]
        passing = Passing.of([*single, *flight.others], float(flight.breaks[0]), t)
        teams = tuple(TeamTask.in_flight(each, t, flight.others) for each in tied)
        return cls(teams, flight, passing)

    def of_one_team(self, feature: Feature) -> TeamTask:
        """Return the task of the only team, for a ``feature`` that supports a single one.

        Raises UnsupportedError for several teams.
        """
        if self.flight is not None:
            self.flight.of_one_team(feature)
        return self.teams[0]

    @property
    def _is_single(self) -> bool:
        """Return whether no other team is part of the flight."""
        return len(self.teams) == 1 and not self.teams[0].name

    @lazy
    def team(self) -> Team:
        """The only team, or those with cables as one."""
        if self._is_single:
            return self.teams[0].team
        return Crew([(each.name, each.team) for each in self.teams])

    @lazy
    def states(self) -> States:
        """States of all teams; without any hitch, vertices and tensions are zero."""
        each = [task.states for task in self.teams]
        if len(each) == 1:
            return each[0]
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(states, name) for states in each], axis=1)
            for name in JOINED_FIELDS
        }
        formed = np.any([states.formed for states in each], axis=0)
        return replace(each[0], formed=formed, **joined)

    @lazy
    def cargo(self) -> Cargo:
        """The objects of all teams."""
        if self._is_single or self.flight is None:
            return self.teams[0].cargo
        return Cargo.joined(self.flight, self.teams)

    @property
    def duration(self) -> float:
        """Time from the first setpoint to the last [s]."""
        return self.teams[0].duration

    def until(self, index: int) -> Task:
        """Return the task whose last sample is one of its own."""
        return replace(self, teams=tuple(each.until(index) for each in self.teams))

    def with_positions(self, positions: Array) -> Task:
        """Return the task with other positions of the drones (samples, 2n, 3) [m]."""
        counts = np.cumsum([each.team.drones for each in self.teams])[:-1]
        parts = np.split(positions, counts, axis=1)
        teams = [
            replace(each, states=replace(each.states, positions=part))
            for each, part in zip(self.teams, parts, strict=True)
        ]
        return replace(self, teams=tuple(teams))

    @property
    def last_clasps(self) -> Flags:
        """Return whether clasps exist at the last sample (clasps,)."""
        return np.concatenate([each.clasps_at(-1) for each in self.teams])

    def clasped(self, flags: Sequence[Flags]) -> Flags:
        """Return flags (…) of every team, repeated for its clasps (…, clasps)."""
        counts = [len(each.team.layout.clasps) for each in self.teams]
        each = zip(flags, counts, strict=True)
        return np.concatenate([np.repeat(x[..., None], count, axis=-1) for x, count in each], -1)

    def load_shares(self, index: int) -> Array:
        """Return the shares (n,) of loads that cables carry at a sample."""
        return np.concatenate([each.load_shares(index) for each in self.teams])

    def index(self, elapsed: float) -> int:
        """Return the setpoint that applies ``elapsed`` [s] after the first one."""
        return self.teams[0].index(elapsed)


def read_task(directory: Path) -> Task:
    """Return the task of the plan in a directory; FileError if it is missing or damaged."""
    flight = read_plan(directory / PLAN)
    refuse_mixture(directory)
    return Task.of(flight)
