"""Several motions on one clock, combined into the motion of all their drones.

A combined motion is a swarm of all drones on the breaks of all motions. Its ``groups`` keep cables
and their own breaks: derivatives on the short pieces between the breaks of several motions would
suffer from rounding.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.flight_controller import Tube
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.motion import JOINT, PLAIN, CableState, Group, Motion, Phase
from hitchopt.motion.retiming import on_breaks_of, padded
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.storage.archive import folded
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks
from hitchopt.values import Indices

NAME = re.compile(r"[^\W\d][\w-]*")
"""Valid names of groups; groups of external plans are named plan.group."""


@dataclass(frozen=True, eq=False)
class CombinedSwarm(Swarm):
    """The drones of several teams as one swarm, with names such as ``a.q0``."""

    def __init__(self, teams: Sequence[tuple[str, Team]]) -> None:
        kinds = [kind for _, team in teams for kind in team.kinds]
        names = tuple(
            f"{name}.{drone}" if name else drone
            for name, team in teams
            for drone in team.drone_names
        )
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
        """(N,): places of the drones a.q0, a.r0, … in the order of the problem."""
        places: Indices = vars(self)["_listed"]
        return places


@dataclass(frozen=True, eq=False)
class CombinedMotion(Motion):
    """The motion of all drones of several teams; see ``combined``."""

    parts: tuple[Group, ...] = ()

    @property
    def groups(self) -> tuple[Group, ...]:
        """The combined motions."""
        return self.parts

    def each_group(self, change: Callable[[Motion], Motion]) -> Motion:
        """Return the motion with ``change`` applied to every group."""
        groups = [replace(each, motion=change(each.motion)) for each in self.parts]
        return combined(groups, self.others)

    @property
    def untimed(self) -> Motion:
        """The motion without limits on the groups' durations."""
        return self.each_group(lambda own: own.untimed)

    def map_curves(
        self, change: Callable[[PiecewisePolynomial], PiecewisePolynomial], phases: Sequence[Phase]
    ) -> Motion:
        """Raise NotImplementedError: groups have their own breaks."""
        raise NotImplementedError("apply it to each group")


def combined(groups: Sequence[Group], others: Sequence[Group] = ()) -> Motion:
    """Return the motions of several groups on one clock, at rest before and after their own time.

    Distances between groups are the larger ones of both groups' requirements. A single group is
    returned unchanged, except for ``others``.

    Raises InputError for invalid or duplicate names; UnsupportedError for several groups, one with
    cables that are tied around an object.
    """
    names = [each.name for each in (*groups, *others)]
    for index, name in enumerate(names):
        words = name.split(".", 1) if index >= len(groups) else [name]
        unnamed = name == "" and len(groups) == 1 and index == 0
        taken = map(folded, ("others", *names[:index]))
        if not (unnamed or all(map(NAME.fullmatch, words))) or folded(name) in taken:
            bound = "a name of its own, also without regard to case, of letters, digits, - and _"
            raise InputError("teams", name, bound, "rename it")
    flying = (*groups, *others)
    if len(flying) > 1 and any(each.motion.has_bent_cables for each in flying):
        message = "cables that bend around an object on their own keep no distances to other teams"
        raise UnsupportedError(f"{message}; plan the team that ties them in a file without others")
    begin = min(float(each.motion.drones.breaks[0]) for each in groups)
    end = max(float(each.motion.drones.breaks[-1]) for each in groups)
    groups = tuple(replace(each, motion=padded(each.motion, begin, end)) for each in groups)
    if len(groups) == 1:
        return groups[0].motion.replaced(others=tuple(others))
    begin, end = groups[0].motion.drones.breaks[[0, -1]].tolist()
    breaks = merged_breaks([each.motion.drones.breaks for each in groups])
    motions = [on_breaks_of(each.motion, breaks) for each in groups]
    degree = max(each.drones.degree for each in motions)
    drones = np.concatenate([each.drones.elevated(degree).coefficients for each in motions], axis=1)
    team = CombinedSwarm([(each.name, each.motion.team) for each in groups])
    requirements, poses = _shared(groups, motions)
    swarm = Motion.single(
        team, requirements, PiecewisePolynomial(breaks, drones), _phases(groups, begin, end)
    )
    values = {field.name: getattr(swarm, field.name) for field in fields(Motion)}
    values |= {"others": tuple(others), "poses": poses}
    return CombinedMotion(**values, parts=tuple(groups))


def _shared(groups: Sequence[Group], motions: Sequence[Motion]) -> tuple[Requirements, Any]:
    """Return the requirements between groups, with all objects, and the objects' poses.

    Groups may share obstacles at rest. Other objects with the same name are labelled by group.
    """
    requirements = [group.motion.requirements for group in groups]
    distances = [vars(own.separation) for own in requirements]
    separation = Separation(**{key: max(each[key] for each in distances) for key in distances[0]})
    tube = Tube.enclosing(own.limits.tube for own in requirements)
    tracking = tube.tracking if tube and tube.level else None
    limits: Limits = replace(requirements[0].limits, tracking=tracking)
    prisms = {prism.corners.tobytes(): prism for own in requirements for prism in own.keep_out}
    objects, poses = dict[str, SolidObject](), list[Any]()
    degree = max(motion.poses.degree for motion in motions)
    for group, motion, own in zip(groups, motions, requirements, strict=True):
        for index, (name, body) in enumerate(own.objects.items()):
            pose = motion.poses.elevated(degree).coefficients[:, index]
            key = group.label(name) if name in objects else name
            at_rest = np.max(np.abs(pose - body.pose[:, None])) <= REST_DRIFT
            if not (at_rest and name in objects and same_object(objects[name], body)):
                objects[key] = body
                poses.append(pose)
    arenas = [own.arena for own in requirements if own.arena is not None]
    arena = None
    if len(arenas) == len(requirements):  # each group stays in its own arena
        lower, upper = (np.array([getattr(own, k) for own in arenas]) for k in ("lower", "upper"))
        arena = Arena(np.min(lower, axis=0), np.max(upper, axis=0))
    merged = Requirements(limits, separation, arena, tuple(prisms.values()), objects)
    if not poses:
        return merged, PLAIN
    return merged, PiecewisePolynomial(motions[0].drones.breaks, np.stack(poses, axis=1))


def moved_objects(motion: Motion) -> frozenset[str]:
    """Return the names of objects that a motion moves."""
    moves = np.ptp(motion.poses.coefficients, axis=(0, -1)).max(axis=-1, initial=0.0)
    names = motion.requirements.objects
    return frozenset(name for name, by in zip(names, moves, strict=True) if by > REST_DRIFT)


def same_object(one: SolidObject, other: SolidObject) -> bool:
    """Return whether two objects are equal bodies at the same place."""
    if len(one.slabs) != len(other.slabs) or not np.array_equal(one.pose, other.pose):
        return False
    return all(
        (a.lower, a.upper, a.section.rounding) == (b.lower, b.upper, b.section.rounding)
        and np.array_equal(a.section.core, b.section.core)
        for a, b in zip(one.slabs, other.slabs, strict=True)
    )


def _phases(groups: Sequence[Group], begin: float, end: float) -> list[Phase]:
    """Return common phases, split where a phase of any group ends, with the names of all."""
    ends = [
        np.array([begin, *(phase.end for phase in each.motion.phases[:-1]), end]) for each in groups
    ]
    times = np.unique(np.concatenate(ends))
    times = times[np.append(True, np.diff(times) > JOINT)]
    times[-1] = end
    phases = list[Phase]()
    for start, stop in pairwise(times.tolist()):
        middle = 0.5 * (start + stop)
        active = [next(p for p in each.motion.phases if p.end >= middle) for each in groups]
        name = ", ".join(
            f"{group.name} {phase.name}" for group, phase in zip(groups, active, strict=True)
        )
        step = max(phase.step for phase in active)
        phases.append(Phase(name, step, start, stop, state=CableState.NONE))
    return phases
