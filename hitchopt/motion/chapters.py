"""Chapters of a motion: time spans in which the same robots form the ring.

A motion has rows of polynomials for all robots of its team. If phases name the robots of a ring,
the first rows of vertices are those of the ring, in order. A chapter combines the ring, with its
robots in the order of its edges, and every waiting robot, as separate groups.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import PartTeam
from hitchopt.motion.combined import side_by_side
from hitchopt.motion.motion import JOINT, RING_CURVES, CableState, Group, Motion
from hitchopt.motion.retiming import on_breaks_of, slice_time
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array, Indices

WAITING_STATES = frozenset({CableState.GROUND, CableState.FREE, CableState.LAYING})
"""States of the cables of waiting robots."""

REMEDY = "give ring and waiting for every phase, or for none"

_CHAPTERS: WeakKeyDictionary[Motion, tuple[Motion, ...]] = WeakKeyDictionary()


def chapters(motion: Motion) -> tuple[Motion, ...]:
    """Return the chapters of a motion, at its times; the first group of each is the ring.

    A motion whose ring does not change is its only chapter.

    Raises InputError for invalid rings, robots twice or missing, or objects that move.
    """
    if not motion.has_ring_changes:
        return (motion,)
    if motion not in _CHAPTERS:
        check_rings(motion)
        rings = [motion.phases[i].ring for i in motion.phase_of_piece.tolist()]
        changes = [i for i, (a, b) in enumerate(pairwise(rings), 1) if a != b]
        spans = pairwise([0, *changes, len(rings)])
        _CHAPTERS[motion] = tuple(_chapter(motion.on_pieces(*span)) for span in spans)
    return _CHAPTERS[motion]


def parts_of(motion: Motion) -> tuple[Group, ...]:
    """Return the groups of all chapters of a motion, at their times."""
    return tuple(group for chapter in chapters(motion) for group in chapter.groups)


def parts_at(motion: Motion, t: Array) -> Iterator[tuple[Motion, Indices, Indices]]:
    """Yield the parts of one group at times (times,) [s] from its start.

    Each is the motion of a ring or of a waiting robot, the indices of the times in its chapter, and
    its robots, in its order. A time at a seam belongs to the later chapter.
    """
    if not motion.has_ring_changes:
        yield motion, np.arange(len(t)), np.arange(motion.team.robots)
        return
    seams = [chapter.drones.breaks[0] for chapter in chapters(motion)[1:]]
    index = np.searchsorted(seams, motion.drones.breaks[0] + t, side="right")
    for i, chapter in enumerate(chapters(motion)):
        if len(samples := np.flatnonzero(index == i)):
            for part in chapter.groups:
                yield part.motion, samples, np.array(part.motion.team.labels)


def check_rings(motion: Motion) -> None:
    """Raise InputError unless ring and waiting robots of every phase are all robots, each once.

    Waiting robots have no legs and tensions, and a ring has as many vertices as robots.
    """
    team, breaks = motion.team, motion.drones.breaks
    for i, phase in enumerate(motion.phases):
        ring, waiting = phase.ring or (), [robot for robot, _ in phase.waiting]
        if len(ring) < 3 or sorted((*ring, *waiting)) != list(range(team.robots)):
            bound = f"at least 3 in the ring, and all of 0 to {team.robots - 1} once"
            raise InputError(f"phases[{i}].ring", [*ring, *waiting], bound, REMEDY)
        if any(state not in WAITING_STATES for _, state in phase.waiting):
            bound = f"one of {', '.join(sorted(WAITING_STATES))}"
            raise InputError(f"phases[{i}].waiting", phase.waiting, bound, REMEDY)
        if phase.hold is not None:
            bound = "null where robots join or leave"
            raise InputError(f"phases[{i}].hold", vars(phase.hold), bound, "hold with all robots")
        pieces = motion.phase_of_piece == i
        parts = [motion.vertices.coefficients[pieces, len(ring) :]]
        parts += [
            c[pieces][:, waiting] for c in (motion.legs.coefficients, motion.tensions.coefficients)
        ]
        if any(np.any(part) for part in parts):
            bound = "zero legs, tensions and vertices of waiting robots"
            raise InputError(f"phases[{i}].waiting", phase.waiting, bound, REMEDY)
    for previous, phase in pairwise(motion.phases):
        differs = (previous.ring, previous.waiting) != (phase.ring, phase.waiting)
        if differs and np.min(np.abs(phase.start - breaks)) > JOINT:
            bound = "breaks where rings and waiting robots change"
            raise InputError("phases", phase.start, bound, "split the pieces there")
    if not team.layout.closed or np.any(team.load):
        raise InputError("phases.ring", team.topology, "of closed hitches without loads", REMEDY)
    if motion.has_wraps or not motion.has_objects_at_rest:
        bound = "at rest where robots join or leave"
        raise InputError("poses", "objects that move", bound, "carry with a ring of all robots")


def _chapter(motion: Motion) -> Motion:
    """Return the ring and the waiting robots of one chapter as separate groups."""
    first, (begin, end) = motion.phases[0], motion.drones.breaks[[0, -1]].tolist()
    groups = [Group("", _ring(motion, first.ring or ()))]
    for robot, _ in first.waiting:
        own = [
            replace(phase, state=dict(phase.waiting)[robot], ring=None, waiting=(), tension=None)
            for phase in motion.phases
        ]
        rows = motion.drones.replaced(motion.drones.coefficients[:, _rows("drones", [robot])])
        team = PartTeam.of(motion.team, [robot])
        groups.append(Group("", Motion.single(team, motion.requirements, rows, own)))
    others = [replace(each, motion=slice_time(each.motion, begin, end)) for each in motion.others]
    if len(groups) == 1:
        return groups[0].motion.replaced(others=tuple(others))
    return side_by_side(groups, others)


def _rows(curve: str, robots: Sequence[int]) -> Indices:
    """Return the indices of the rows of a ring's robots in a curve of all robots."""
    if curve == "vertices":  # numbered along the ring
        return np.arange(len(robots))
    width = 2 if curve == "drones" else 1
    return np.asarray(np.add.outer(width * np.array(robots), np.arange(width)).ravel())


def _ring(motion: Motion, members: tuple[int, ...]) -> Motion:
    """Return the motion of the ring alone."""
    whole: dict[str, PiecewisePolynomial] = {name: getattr(motion, name) for name in RING_CURVES}
    curves: dict[str, Any] = {
        name: each.replaced(each.coefficients[:, _rows(name, members)])
        for name, each in whole.items()
    }
    phases = tuple(replace(phase, ring=None, waiting=()) for phase in motion.phases)
    team = PartTeam.of(motion.team, members)
    return motion.replaced(team=team, phases=phases, assignment=None, others=(), **curves)


@dataclass(frozen=True, eq=False)
class WaitingRobot:
    """A robot outside the ring: its drones (2, 3) [m], moving or at rest, and its cable's state."""

    drones: PiecewisePolynomial | Array
    state: CableState = CableState.FREE


def with_waiting(
    motion: Motion, whole: Team, waiting: Mapping[int, WaitingRobot], requirements: Requirements
) -> Motion:
    """Return the motion of the whole team from that of the ring and of the waiting robots.

    Breaks are those of all of them.
    """
    moving = (x.drones for x in waiting.values() if isinstance(x.drones, PiecewisePolynomial))
    breaks = merged_breaks([motion.drones.breaks, *(each.breaks for each in moving)])
    ring, labels, curves = on_breaks_of(motion, breaks), motion.team.labels, dict[str, Any]()
    for name in RING_CURVES:
        own: PiecewisePolynomial = getattr(ring, name)
        c, count = own.coefficients, (2 if name == "drones" else 1) * whole.robots
        rows = np.zeros((len(c), count, *c.shape[2:]))
        rows[:, _rows(name, labels)] = c
        curves[name] = own.replaced(rows)
    paths = {
        robot: on_breaks(x.drones, breaks)
        if isinstance(x.drones, PiecewisePolynomial)
        else PiecewisePolynomial.constant(breaks, x.drones)
        for robot, x in waiting.items()
    }
    degree = max(curve.degree for curve in (curves["drones"], *paths.values()))
    c = curves["drones"].elevated(degree).coefficients.copy()
    for robot, path in paths.items():
        c[:, 2 * robot : 2 * robot + 2] = path.elevated(degree).coefficients
    curves["drones"] = ring.drones.replaced(c)
    states = tuple((robot, each.state) for robot, each in sorted(waiting.items()))
    phases = tuple(replace(phase, ring=labels, waiting=states) for phase in motion.phases)
    return Motion(whole, requirements, **curves, phases=phases)
