"""Chapters of a motion: time spans in which the same robots form the ring.

A motion has rows of polynomials for all robots of its team. If phases name the robots of a ring,
the first rows of vertices are those of the ring, in order. A chapter combines the ring, with its
robots in the order of its edges, and every waiting robot, as separate groups.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from hitchopt.motion.motion import JOINT, CableState, Group, Motion, Phase
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

    Raises
    ------
    InputError: invalid rings, robots twice or missing, or objects that move.
    """
    if motion not in _CHAPTERS:
        check_rings(motion)
        index, breaks = motion.phase_of_piece, motion.drones.breaks
        rings = [motion.phases[i].ring for i in index.tolist()]
        changes = [i for i, (a, b) in enumerate(pairwise(rings), 1) if a != b]
        bounds = [0, *changes, len(rings)]
        _CHAPTERS[motion] = tuple(
            _chapter(
                motion.slice_pieces(
                    slice(first, last), motion.overlapping(breaks[first], breaks[last])
                )
            )
            for first, last in pairwise(bounds)
        )
    return _CHAPTERS[motion]


def parts_of(motion: Motion) -> tuple[Group, ...]:
    """Return the groups of a motion, or those of all its chapters, at their times."""
    if not motion.has_ring_changes:
        return motion.groups
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
    first = motion.phases[0]
    assert first.ring is not None
    begin, end = motion.drones.breaks[[0, -1]].tolist()
    groups = [Group("", _ring(motion, first.ring))]
    groups += [Group("", _waiting_motion(motion, robot)) for robot, _ in first.waiting]
    others = [replace(each, motion=slice_time(each.motion, begin, end)) for each in motion.others]
    if len(groups) == 1:
        return groups[0].motion.replaced(others=tuple(others))
    return side_by_side(groups, others)


def _take_rows(curve: PiecewisePolynomial, rows: list[int], width: int = 1) -> PiecewisePolynomial:
    """Return the rows of some robots, ``width`` of each."""
    index = (width * np.array(rows)[:, None] + np.arange(width)).ravel()
    return curve.replaced(curve.coefficients[:, index])


def _ring(motion: Motion, members: tuple[int, ...]) -> Motion:
    """Return the motion of the ring alone."""
    rows = list(members)
    return motion.replaced(
        team=PartTeam.of(motion.team, rows),
        drones=_take_rows(motion.drones, rows, 2),
        vertices=_take_rows(motion.vertices, list(range(len(rows)))),
        legs=_take_rows(motion.legs, rows),
        tensions=_take_rows(motion.tensions, rows),
        leg_tensions=_take_rows(motion.leg_tensions, rows),
        phases=tuple(replace(phase, ring=None, waiting=()) for phase in motion.phases),
        assignment=None,
        others=(),
    )


def _waiting_motion(motion: Motion, robot: int) -> Motion:
    """Return the motion of a waiting robot."""
    phases = list[Phase]()
    for phase in motion.phases:
        own = replace(phase, state=dict(phase.waiting)[robot], ring=None, waiting=(), tension=None)
        phases.append(own)
    team, drones = PartTeam.of(motion.team, [robot]), _take_rows(motion.drones, [robot], 2)
    return Motion.single(team, motion.requirements, drones, phases)


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
    breaks = motion.drones.breaks
    for each in waiting.values():
        if isinstance(each.drones, PiecewisePolynomial):
            breaks = merged_breaks([breaks, each.drones.breaks])
    ring = on_breaks_of(motion, breaks)
    rows, n = list(motion.team.labels), whole.robots
    states = tuple((robot, each.state) for robot, each in sorted(waiting.items()))
    curves: dict[str, Any] = {
        "drones": _scatter(ring.drones, rows, n, 2),
        "vertices": _scatter(ring.vertices, list(range(len(rows))), n),
        "legs": _scatter(ring.legs, rows, n),
        "tensions": _scatter(ring.tensions, rows, n),
        "leg_tensions": _scatter(ring.leg_tensions, rows, n),
    }
    waiting_curves = {
        robot: on_breaks(
            each.drones
            if isinstance(each.drones, PiecewisePolynomial)
            else PiecewisePolynomial.constant(breaks, each.drones),
            breaks,
        )
        for robot, each in waiting.items()
    }
    degree = max(curve.degree for curve in (curves["drones"], *waiting_curves.values()))
    c = curves["drones"].elevated(degree).coefficients.copy()
    for robot, curve in waiting_curves.items():
        c[:, 2 * robot : 2 * robot + 2] = curve.elevated(degree).coefficients
    curves["drones"] = ring.drones.replaced(c)
    phases = tuple(
        replace(phase, ring=motion.team.labels, waiting=states) for phase in motion.phases
    )
    return Motion(whole, requirements, **curves, phases=phases)


def _scatter(
    curve: PiecewisePolynomial, rows: list[int], robots: int, width: int = 1
) -> PiecewisePolynomial:
    """Return a curve with rows for all robots; those of other robots are zero."""
    c = curve.coefficients
    index = (width * np.array(rows)[:, None] + np.arange(width)).ravel()
    whole = np.zeros((len(c), width * robots, *c.shape[2:]))
    whole[:, index] = c
    return curve.replaced(whole)
