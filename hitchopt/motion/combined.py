"""Several motions side by side on one clock: the drones of all, and each with cables of its own.

A combined motion is a swarm of all drones on the breaks of all motions. What knows drones alone
takes it as it is; what knows cables takes its ``groups`` one by one: each has its own breaks, as
derivatives on the short pieces between the breaks of several would suffer from rounding.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.motion import JOINT, CableState, Group, Motion, Phase
from hitchopt.motion.retiming import on_breaks_of, padded
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks

NAME = re.compile(r"[^\W\d][\w-]*")
"""Names of groups; one of a plan that flies besides is plan.group."""


@dataclass(frozen=True, eq=False)
class Fleet(Swarm):
    """The drones of several teams, as ``a.q0``: a swarm to all that knows no cables."""

    def __init__(self, teams: Sequence[tuple[str, Team]]) -> None:
        kinds = [
            kind
            for _, team in teams
            for kind in team.quadrotor
            for _ in range(team.drones // len(team.quadrotor))
        ]
        names = tuple(
            f"{name}.{drone}" if name else drone
            for name, team in teams
            for drone in team.drone_names
        )
        super().__init__(len(kinds), quadrotor=kinds)
        object.__setattr__(self, "_names", names)

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(N,): a.q0, a.r0, …, b.d0, …."""
        names: tuple[str, ...] = vars(self)["_names"]
        return names


@dataclass(frozen=True, eq=False)
class CombinedMotion(Motion):
    """Motions of several teams side by side, as the motion of all drones; see ``combined``."""

    parts: tuple[Group, ...] = ()

    @property
    def groups(self) -> tuple[Group, ...]:
        """The motions side by side."""
        return self.parts

    def each_group(self, change: Callable[[Motion], Motion]) -> Motion:
        """Return the motion with a change of every group's clock applied."""
        groups = [replace(each, motion=change(each.motion)) for each in self.parts]
        return combined(groups, self.others)

    @property
    def untimed(self) -> Motion:
        """The motion without a limit on any group's duration."""
        return self.each_group(lambda own: own.untimed)

    def map_curves(
        self, change: Callable[[PiecewisePolynomial], PiecewisePolynomial], phases: Sequence[Phase]
    ) -> Motion:
        """Refuse: groups have breaks of their own."""
        raise NotImplementedError("apply it to each of groups")


def combined(groups: Sequence[Group], others: Sequence[Group] = ()) -> Motion:
    """Return the motions of several groups on one clock, all at rest before and after their own.

    Distances between groups are the larger ones of both groups' requirements. A group alone stays
    what it is.

    Raises
    ------
    InputError: names that are none, or given twice.
    UnsupportedError: among several, a hitch that changes its robots.
    """
    names = [each.name for each in (*groups, *others)]
    for index, name in enumerate(names):
        parts = name.split(".", 1) if index >= len(groups) else [name]
        alone = name == "" and len(groups) == 1 and index == 0
        if not (alone or all(map(NAME.fullmatch, parts))) or name in ("others", *names[:index]):
            bound = "a name of its own, of letters, digits, - and _"
            raise InputError("teams", name, bound, "rename it")
    for each in (*(groups if len(groups) > 1 else ()), *others):
        each.motion.refuse_several("a plan of several teams", others=False)
    begin = min(float(each.motion.drones.breaks[0]) for each in groups)
    end = max(float(each.motion.drones.breaks[-1]) for each in groups)
    groups = tuple(replace(each, motion=padded(each.motion, begin, end)) for each in groups)
    if len(groups) == 1:
        return groups[0].motion.replaced(others=tuple(others))
    return side_by_side(groups, others)


def side_by_side(groups: Sequence[Group], others: Sequence[Group]) -> Motion:
    """Return the motions of groups that cover the same time, as ``combined``, whatever names."""
    begin, end = groups[0].motion.drones.breaks[[0, -1]].tolist()
    breaks = merged_breaks([each.motion.drones.breaks for each in groups])
    whole = [on_breaks_of(each.motion, breaks) for each in groups]
    degree = max(each.drones.degree for each in whole)
    drones = np.concatenate([each.drones.elevated(degree).coefficients for each in whole], axis=1)
    team = Fleet([(each.name, each.motion.team) for each in groups])
    requirements, poses = _shared(groups, whole)
    swarm = Motion.single(
        team, requirements, PiecewisePolynomial(breaks, drones), _phases(groups, begin, end)
    )
    own = {field.name: getattr(swarm, field.name) for field in fields(Motion)}
    own |= {"others": tuple(others), "poses": poses}
    return CombinedMotion(**own, parts=tuple(groups))


def _shared(
    groups: Sequence[Group], whole: Sequence[Motion]
) -> tuple[Requirements, PiecewisePolynomial | None]:
    """Return the requirements that hold between groups, with all objects, and objects' poses.

    An obstacle that several groups have is one; other objects of one name are named by the group.
    """
    each = [group.motion.requirements for group in groups]
    separation = reduce(_wider, (one.separation for one in each))
    tracking = max((one.limits.tracking or 0.0 for one in each), default=0.0) or None
    limits: Limits = replace(each[0].limits, tracking=tracking)
    prisms = {prism.corners.tobytes(): prism for one in each for prism in one.keep_out}
    objects, poses = dict[str, SolidObject](), list[Any]()
    degree = max(motion.object_poses.degree for motion in whole)
    for group, motion, one in zip(groups, whole, each, strict=True):
        for index, (name, body) in enumerate(one.objects.items()):
            pose = motion.object_poses.elevated(degree).coefficients[:, index]
            key = group.label(name) if name in objects else name
            obstacle = np.max(np.abs(pose - body.pose[:, None])) <= STILL
            if not (obstacle and name in objects and same_object(objects[name], body)):
                objects[key] = body
                poses.append(pose)
    arenas = [one.arena for one in each if one.arena is not None]
    arena = None
    if len(arenas) == len(each):  # each stays in its own
        lower, upper = (np.array([getattr(one, k) for one in arenas]) for k in ("lower", "upper"))
        arena = Arena(np.min(lower, axis=0), np.max(upper, axis=0))
    needed = Requirements(limits, separation, arena, tuple(prisms.values()), objects)
    if not poses:
        return needed, None
    return needed, PiecewisePolynomial(whole[0].drones.breaks, np.stack(poses, axis=1))


def same_object(one: SolidObject, other: SolidObject) -> bool:
    """Return whether two objects are the same body at the same place."""
    if len(one.slabs) != len(other.slabs) or not np.array_equal(one.pose, other.pose):
        return False
    return all(
        (a.lower, a.upper, a.section.rounding) == (b.lower, b.upper, b.section.rounding)
        and np.array_equal(a.section.core, b.section.core)
        for a, b in zip(one.slabs, other.slabs, strict=True)
    )


def _wider(one: Separation, other: Separation) -> Separation:
    """Return the larger ones of all distances."""
    return Separation(**{name: max(x, getattr(other, name)) for name, x in vars(one).items()})


def _phases(groups: Sequence[Group], begin: float, end: float) -> list[Phase]:
    """Return the phases of all groups, ended where any of them ends, with the names of all."""
    ends = [
        np.array([begin, *(phase.end for phase in each.motion.phases[:-1]), end]) for each in groups
    ]
    times = np.unique(np.concatenate(ends))
    times = times[np.append(True, np.diff(times) > JOINT)]
    times[-1] = end
    phases = list[Phase]()
    for start, stop in pairwise(times.tolist()):
        middle = 0.5 * (start + stop)
        here = [next(p for p in each.motion.phases if p.end >= middle) for each in groups]
        name = ", ".join(
            f"{group.name} {phase.name}" for group, phase in zip(groups, here, strict=True)
        )
        step = max(phase.step for phase in here)
        phases.append(Phase(name, step, start, stop, state=CableState.NONE))
    return phases
