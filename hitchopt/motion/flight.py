"""Flights: what flies in one airspace, teams with a motion each, and external plans.

The motions of a flight's teams are on one clock and begin and end together, at rest before and
after their own time. Every team keeps its own breaks: derivatives on the short pieces between the
breaks of several motions would suffer from rounding.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.drones.controllers import Tube
from hitchopt.errors import InputError, OneLine
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.requirements import Arena, Requirements, Separation
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import JOINT, Motion, Phase
from hitchopt.motion.retiming import (
    append_motion,
    on_breaks_of,
    padded,
    prolonged,
    shifted,
    slice_time,
    stretched,
)
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.storage.archive import folded
from hitchopt.support import REFUSALS, Feature, Neighbour, unsupported
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks, spaced
from hitchopt.values import Array, Indices, check_instance, counted, lazy, sequence
from hitchopt.values.fields import keys_of

NAME = re.compile(r"[^\W\d][\w-]*")
"""Valid names of teams; teams of external plans are named plan.team."""

REST_RATE = 1e-6  # Largest speed [m/s] and acceleration [m/s²] at rest


def team_label(team: str, name: str) -> str:
    """Return the full name of a team's drone, point, cable or object, such as ``a.q0``."""
    return f"{team}.{name}" if team else name


@dataclass(frozen=True, eq=False)
class TeamMotion(OneLine):
    """The motion of one team in a flight, with the team's name, which is empty for a single team.

    For a team of an external plan, ``digest`` is the digest of its file and ``plan`` the path as
    written.
    """

    name: str
    motion: Motion
    digest: str = ""
    plan: str = ""

    def _parts(self) -> Iterator[str]:
        yield from [self.name] if self.name else []
        yield counted(len(self.motion.team.drone_names), "drone")
        yield f"{self.motion.duration:.4g} s"

    def label(self, name: str) -> str:
        """Return the full name of one of its drones, cables or vertices, such as ``a.q0``."""
        return team_label(self.name, name)


@dataclass(frozen=True, eq=False)
class CombinedSwarm(Swarm):
    """The drones of several teams as one swarm, with names such as ``a.q0``."""

    def __init__(self, teams: Sequence[tuple[str, Team]]) -> None:
        kinds = [kind for _, team in teams for kind in team.kinds]
        names = tuple(team_label(name, drone) for name, team in teams for drone in team.drone_names)
        super().__init__(len(kinds), quadrotor=kinds)
        object.__setattr__(self, "_names", names)
        firsts = np.cumsum([0, *(len(team.drone_names) for _, team in teams)]).tolist()
        places = [first + team.listed for first, (_, team) in zip(firsts, teams, strict=False)]
        object.__setattr__(self, "_listed", np.concatenate(places))

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(N,): a.q0, a.r0, …, b.d0, …."""
        names: tuple[str, ...] = vars(self)["_names"]
        return names

    @property
    def listed(self) -> Indices:
        """(N,): indices of the drones a.q0, a.r0, … in the order of the problem."""
        places: Indices = vars(self)["_listed"]
        return places


@dataclass(frozen=True, eq=False)
class Flight(OneLine):
    """The contents of one airspace: teams, each with its motion, and external plans.

    Parameters
    ----------
    teams: the teams with their motions, on one clock. They are extended by rests to a common start
        and end. The name of a single team is dropped.
    others: the teams of external plans on this clock, at rest before and after their own time. All
        distances to them are kept.

    Raises
    ------
    InputError: no team, or an invalid or duplicate name.
    """

    teams: tuple[TeamMotion, ...]
    others: tuple[TeamMotion, ...] = ()

    def __post_init__(self) -> None:
        for name in ("teams", "others"):
            entries = sequence(name, getattr(self, name))
            for index, flown in enumerate(entries):
                check_instance(f"{name}[{index}]", flown, TeamMotion)
            object.__setattr__(self, name, entries)
        if not self.teams:
            raise InputError("teams", [], "at least one", "name the teams that fly")
        self._check_names()
        if len(self.teams) == 1:
            object.__setattr__(self, "teams", (replace(self.teams[0], name=""),))
            return
        ends = np.array([flown.motion.drones.breaks[[0, -1]] for flown in self.teams])
        begin = float(np.min(ends[:, 0]))
        end = float(np.max(ends[:, 1]))
        padded_teams = [
            replace(flown, motion=padded(flown.motion, begin, end)) for flown in self.teams
        ]
        object.__setattr__(self, "teams", tuple(padded_teams))

    def _check_names(self) -> None:
        """Raise InputError for an invalid name of a team, or one that is taken."""
        names = [flown.name for flown in self.all_teams]
        count = len(self.teams)
        for index, name in enumerate(names):
            words = name.split(".", 1) if index >= count else [name]
            may_be_empty = count == 1 and index == 0
            is_valid = (name == "" and may_be_empty) or all(map(NAME.fullmatch, words))
            taken = map(folded, ("others", *names[:index]))
            if not is_valid or folded(name) in taken:
                bound = "a unique name, regardless of case, of letters, digits, - and _"
                raise InputError("teams", name, bound, "rename it")

    @classmethod
    def of(cls, flown: Motion | Flight) -> Flight:
        """Return the flight of one team alone, or a flight itself."""
        return cls((TeamMotion("", flown),)) if isinstance(flown, Motion) else flown

    def _parts(self) -> Iterator[str]:
        names = [flown.name for flown in self.teams if flown.name]
        yield counted(len(self.team.drone_names), "drone")
        yield from [f"teams: {', '.join(names)}"] if names else []
        yield f"{self.duration:.4g} s, phases: {len(self.phases)}"

    @property
    def all_teams(self) -> tuple[TeamMotion, ...]:
        """Its teams, and those of external plans."""
        return self.teams + self.others

    @property
    def alone(self) -> Motion | None:
        """The motion of a team that flies alone; None with other teams or external plans."""
        return self.teams[0].motion if len(self.all_teams) == 1 else None

    def of_one_team(self, feature: Feature) -> Motion:
        """Return the motion of the only team, for a feature that supports a single one.

        Raises UnsupportedError for several teams, and for external plans that it does not support.
        """
        names = ", ".join(flown.name or "the team" for flown in self.all_teams)
        if len(self.teams) > 1:
            raise unsupported(feature, Neighbour.SEVERAL_TEAMS, teams=names)
        if self.others and (feature, Neighbour.OTHERS) in REFUSALS:
            raise unsupported(feature, Neighbour.OTHERS, teams=names)
        return self.teams[0].motion

    @property
    def has_cables(self) -> bool:
        """Return whether any of its teams has cables."""
        return any(flown.motion.team.has_cables for flown in self.teams)

    @property
    def breaks(self) -> Array:
        """(pieces + 1,) [s]: breaks of all teams."""
        return self.drones.breaks

    @property
    def duration(self) -> float:
        """Duration of all phases [s]."""
        return self.drones.duration

    @lazy
    def team(self) -> Team:
        """The only team, or the drones of all teams as one swarm."""
        if len(self.teams) == 1:
            return self.teams[0].motion.team
        return CombinedSwarm([(flown.name, flown.motion.team) for flown in self.teams])

    @lazy
    def drones(self) -> PiecewisePolynomial:
        """Drones of all teams, of shape (N, 3) [m], in the order of ``team.drone_names``."""
        if len(self.teams) == 1:
            return self.teams[0].motion.drones
        motions = self._on_common_breaks
        degree = max(motion.drones.degree for motion in motions)
        parts = [motion.drones.elevated(degree).coefficients for motion in motions]
        return PiecewisePolynomial(motions[0].drones.breaks, np.concatenate(parts, axis=1))

    @lazy
    def phases(self) -> tuple[Phase, ...]:
        """Phases of the only team; of several, split where one ends, with the names of all."""
        return self.teams[0].motion.phases if len(self.teams) == 1 else _joint_phases(self.teams)

    @property
    def requirements(self) -> Requirements:
        """Requirements of the only team; of several, those between them, with all objects.

        Distances between teams are the larger of the two teams' requirements.
        """
        if len(self.teams) == 1:
            return self.teams[0].motion.requirements
        return self._joint.requirements

    @property
    def poses(self) -> PiecewisePolynomial:
        """Poses of the objects in the requirements, as in ``Motion``."""
        return self.teams[0].motion.poses if len(self.teams) == 1 else self._joint.poses

    @lazy
    def _on_common_breaks(self) -> list[Motion]:
        """Motions of the teams, on the breaks of all of them."""
        breaks = merged_breaks([flown.motion.drones.breaks for flown in self.teams])
        return [on_breaks_of(flown.motion, breaks) for flown in self.teams]

    @lazy
    def _joint(self) -> JointRequirements:
        """Requirements between several teams."""
        objects, poses = _joint_objects(self.teams, self._on_common_breaks)
        return JointRequirements(_joint_requirements(self.teams, objects), poses)

    def each_team(self, change: Callable[[Motion], Motion]) -> Flight:
        """Return the flight with ``change`` applied to the motion of every team."""
        teams = [replace(flown, motion=change(flown.motion)) for flown in self.teams]
        return Flight(tuple(teams), self.others)

    @property
    def without_others(self) -> Flight:
        """The flight without external plans."""
        return replace(self, others=()) if self.others else self

    @property
    def untimed(self) -> Flight:
        """The flight without limits on its duration."""
        return self.each_team(lambda motion: motion.untimed)

    def stretched(self, factor: float) -> Flight:
        """Return the same curves, slowed down by ``factor``, without a limit on their duration."""
        return self if factor == 1.0 else self.each_team(lambda motion: stretched(motion, factor))

    def between(self, start: float, end: float) -> Flight:
        """Return the flight between two times [s], starting at t = 0."""

        def part(motion: Motion) -> Motion:
            return shifted(slice_time(motion, start, end), -start)

        others = [replace(flown, motion=shifted(flown.motion, -start)) for flown in self.others]
        return replace(self.each_team(part), others=tuple(others))

    def spaced(self, times: ArrayLike) -> Array:
        """Return the first times [s], not before ``times``, up to which all motions can be cut.

        No motion then has a piece so short that its derivatives suffer from rounding.
        """
        spaced_times = np.asarray(times, dtype=np.float64)
        while True:
            last = spaced_times
            for flown in self.teams:
                spaced_times = spaced(spaced_times, flown.motion.drones.breaks)
            if np.array_equal(spaced_times, last):
                return spaced_times

    def prolonged(self, seconds: float) -> Flight:
        """Return a flight that stays at rest at its end for some time, in its last phases."""
        return self.each_team(lambda motion: prolonged(motion, seconds))

    def followed_by(self, flight: Flight) -> Flight:
        """Return two flights of the same teams in sequence; a continued phase stays one phase."""
        teams = [
            replace(flown, motion=append_motion(flown.motion, following.motion))
            for flown, following in zip(self.teams, flight.teams, strict=True)
        ]
        return replace(self, teams=tuple(teams))

    @property
    def rest_breaks(self) -> NDArray[np.intp]:
        """Indices of breaks, first and last included, at which all drones are at rest."""
        breaks = self.breaks
        at_rest = np.ones(len(breaks) - 2, dtype=np.bool_)
        for flown, order in product(self.teams, (1, 2)):
            rates = flown.motion.drones.differentiated(order)  # on the team's own breaks
            left, right = on_breaks(rates, breaks).ends()
            for values in (right[:-1], left[1:]):
                at_rest &= np.max(np.linalg.norm(values, axis=-1), axis=-1) <= REST_RATE
        return np.concatenate([[0], 1 + np.flatnonzero(at_rest), [len(breaks) - 1]])


class JointRequirements(NamedTuple):
    """Requirements between several teams."""

    requirements: Requirements  # Distances, with the objects of all teams
    poses: PiecewisePolynomial  # (objects, 5), poses of these objects, as in ``Motion``


def _joint_requirements(
    teams: Sequence[TeamMotion], objects: dict[str, SolidObject]
) -> Requirements:
    """Return the requirements between teams: the larger of all distances and tracking errors."""
    of_teams = [flown.motion.requirements for flown in teams]
    distances = [requirements.separation for requirements in of_teams]
    largest = {key: max(getattr(each, key) for each in distances) for key in keys_of(Separation)}
    tube = Tube.enclosing(requirements.limits.tube for requirements in of_teams)
    tracking = tube.tracking if tube and tube.level else None
    limits = replace(of_teams[0].limits, tracking=tracking)
    prisms = {
        prism.corners.tobytes(): prism
        for requirements in of_teams
        for prism in requirements.keep_out
    }
    arenas = [requirements.arena for requirements in of_teams if requirements.arena is not None]
    arena = None
    if len(arenas) == len(of_teams):  # each team stays in its own arena
        lower = np.min([each.lower for each in arenas], axis=0)
        upper = np.max([each.upper for each in arenas], axis=0)
        arena = Arena(lower, upper)
    return Requirements(limits, Separation(**largest), arena, tuple(prisms.values()), objects)


def _joint_objects(
    teams: Sequence[TeamMotion], motions: Sequence[Motion]
) -> tuple[dict[str, SolidObject], PiecewisePolynomial]:
    """Return the objects of several teams by name, and their poses on common breaks.

    Teams may share obstacles at rest. Other objects with the same name are labelled by team.
    """
    objects = dict[str, SolidObject]()
    poses = list[Array]()
    breaks = motions[0].drones.breaks
    degree = max(motion.poses.degree for motion in motions)
    for flown, motion in zip(teams, motions, strict=True):
        for index, (name, body) in enumerate(motion.requirements.objects.items()):
            pose = motion.poses.elevated(degree).coefficients[:, index]
            key = flown.label(name) if name in objects else name
            at_rest = np.max(np.abs(pose - body.pose[:, None])) <= REST_DRIFT
            if not (at_rest and name in objects and same_object(objects[name], body)):
                objects[key] = body
                poses.append(pose)
    if not poses:
        return objects, PiecewisePolynomial.constant(breaks, np.zeros((0, 5)))
    return objects, PiecewisePolynomial(breaks, np.stack(poses, axis=1))


def _joint_phases(teams: Sequence[TeamMotion]) -> tuple[Phase, ...]:
    """Return common phases, split where a phase of any team ends, with the names of all.

    The remark of a team's phase stands where that phase begins.
    """
    begin, end = teams[0].motion.drones.breaks[[0, -1]].tolist()
    ends = [phase.end for flown in teams for phase in flown.motion.phases[:-1]]
    times = np.unique([begin, *ends, end])
    times = times[np.append(True, np.diff(times) > JOINT)]
    times[-1] = end
    phases = list[Phase]()
    for start, stop in pairwise(times.tolist()):
        middle = 0.5 * (start + stop)
        active = [_phase_at(flown.motion, middle) for flown in teams]
        name = ", ".join(
            f"{flown.name} {phase.name}" for flown, phase in zip(teams, active, strict=True)
        )
        step = max(phase.step for phase in active)
        remarks = [
            f"{flown.name}: {phase.remark}"
            for flown, phase in zip(teams, active, strict=True)
            if phase.remark and abs(phase.start - start) <= JOINT
        ]
        phases.append(Phase(name, step, start, stop, "; ".join(remarks), CableState.NONE))
    return tuple(phases)


def _phase_at(motion: Motion, time: float) -> Phase:
    """Return the phase of a motion at a time [s]."""
    return next(phase for phase in motion.phases if phase.end >= time)


def moved_objects(motion: Motion) -> frozenset[str]:
    """Return the names of objects that a motion moves."""
    extents = np.ptp(motion.poses.coefficients, axis=(0, -1)).max(axis=-1, initial=0.0)
    moves = dict(zip(motion.requirements.objects, extents, strict=True))
    return frozenset(name for name, extent in moves.items() if extent > REST_DRIFT)


def own_objects(motion: Motion, others: Iterable[Motion]) -> frozenset[str]:
    """Return the names of objects that a motion moves, or that one of the others does not know."""
    known = [each.requirements.objects for each in others]
    unknown = [
        name
        for name, body in motion.requirements.objects.items()
        if any(name not in each or not same_object(body, each[name]) for each in known)
    ]
    return moved_objects(motion).union(unknown)


def same_object(one: SolidObject, other: SolidObject) -> bool:
    """Return whether two objects are equal bodies at the same pose."""
    if len(one.slabs) != len(other.slabs) or not np.array_equal(one.pose, other.pose):
        return False
    return all(
        (a.lower, a.upper, a.section.rounding) == (b.lower, b.upper, b.section.rounding)
        and np.array_equal(a.section.core, b.section.core)
        for a, b in zip(one.slabs, other.slabs, strict=True)
    )


def drone_places(flight: Flight) -> list[dict[str, str]]:
    """Return a row per drone on a cable, in the problem's order: end of an edge, and mass."""
    rows = list[dict[str, str]]()
    for each in flight.teams:
        team = each.motion.team
        if not team.has_cables:
            continue
        ends = team.layout.anchors.tolist()
        for name, place in zip(team.listed_names, team.listed.tolist(), strict=True):
            edge, end = divmod(place, 2)
            rows.append(
                {
                    "drone": each.label(name),
                    "place": f"edge {edge}, {('start', 'end')[end]}",
                    "vertex": team.point_names[ends[place]],
                    "leg": f"{'de'[end]}_{edge}",
                    "mass": f"{1e3 * team.mass[place]:.4g} g",
                }
            )
    return rows
