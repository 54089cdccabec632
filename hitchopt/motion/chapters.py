"""Chapters of a motion whose hitch changes its robots: spans in which the same ones form the ring.

A motion of a team has rows of polynomials for all of its robots. Where phases say which of them
form a ring, the rows of vertices, as many as the ring has, count along it. A chapter is the ring,
in the order of its edges, side by side with every robot that waits.
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
from hitchopt.motion.retiming import between
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array, Indices

WAITING_STATES = frozenset({CableState.GROUND, CableState.FREE, CableState.LAYING})
"""States of the cables of robots that are in no ring."""

REMEDY = "give ring and waiting of every phase, or of none"

_CHAPTERS: WeakKeyDictionary[Motion, tuple[Motion, ...]] = WeakKeyDictionary()


def chapters(motion: Motion) -> tuple[Motion, ...]:
    """Return the chapters of a motion at its times, each of the ring first and of who waits.

    Raises
    ------
    InputError: rings that are none, robots twice or missing, or objects that move.
    """
    if motion not in _CHAPTERS:
        check_rings(motion)
        index, breaks = motion.phase_of_piece, motion.drones.breaks
        rings = [motion.phases[i].ring for i in index.tolist()]
        ends = [i for i, (a, b) in enumerate(pairwise(rings), 1) if a != b]
        edges = [0, *ends, len(rings)]
        _CHAPTERS[motion] = tuple(
            _chapter(
                motion.slice_pieces(
                    slice(first, last), motion.overlapping(breaks[first], breaks[last])
                )
            )
            for first, last in pairwise(edges)
        )
    return _CHAPTERS[motion]


def parts_of(motion: Motion) -> tuple[Group, ...]:
    """Return its groups, of every chapter where the hitch changes its robots, at their times."""
    if not motion.changes:
        return motion.groups
    return tuple(group for chapter in chapters(motion) for group in chapter.groups)


def parts_at(motion: Motion, t: Array) -> Iterator[tuple[Motion, Indices, Indices]]:
    """Yield the parts of one group at times (times,) [s] from its start, which and whose they are.

    Those are every motion whose cables are known by itself, indices of the times within its own,
    and its robots, in its order. Where chapters join it is the later one, at their end the last.
    """
    if not motion.changes:
        yield motion, np.arange(len(t)), np.arange(motion.team.robots)
        return
    seams = [chapter.drones.breaks[0] for chapter in chapters(motion)[1:]]
    index = np.searchsorted(seams, motion.drones.breaks[0] + t, side="right")
    for i, chapter in enumerate(chapters(motion)):
        if len(here := np.flatnonzero(index == i)):
            for part in chapter.groups:
                yield part.motion, here, np.array(part.motion.team.labels)


def check_rings(motion: Motion) -> None:
    """Raise InputError for phases whose robots are not those of the team, each once.

    Robots that wait have no legs and tensions, and a ring has as many vertices as robots.
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
        on = motion.phase_of_piece == i
        parts = [motion.vertices.coefficients[on, len(ring) :]]
        parts += [
            c[on][:, waiting] for c in (motion.legs.coefficients, motion.tensions.coefficients)
        ]
        if any(np.any(part) for part in parts):
            bound = "0 of robots that are in no ring"
            raise InputError(f"phases[{i}].waiting", phase.waiting, bound, REMEDY)
    for one, other in pairwise(motion.phases):
        changed = (one.ring, one.waiting) != (other.ring, other.waiting)
        if changed and np.min(np.abs(other.start - breaks)) > JOINT:
            bound = "breaks where rings and waiting robots change"
            raise InputError("phases", other.start, bound, "split the pieces there")
    if not team.layout.closed or np.any(team.load):
        raise InputError("phases.ring", team.topology, "of closed hitches without loads", REMEDY)
    if any(curve is not None for curve in (motion.poses, motion.borne, motion.contacts)):
        bound = "left out where robots join or leave"
        raise InputError("poses", "objects that move", bound, "carry with a ring of all robots")


def _chapter(motion: Motion) -> Motion:
    """Return the ring and the waiting robots, side by side, of a motion of one chapter."""
    first = motion.phases[0]
    assert first.ring is not None
    begin, end = motion.drones.breaks[[0, -1]].tolist()
    groups = [Group("", _ring(motion, first.ring))]
    groups += [Group("", _alone(motion, robot)) for robot, _ in first.waiting]
    others = [replace(each, motion=between(each.motion, begin, end)) for each in motion.others]
    if len(groups) == 1:
        return groups[0].motion.replaced(others=tuple(others))
    return side_by_side(groups, others)


def _rows(curve: PiecewisePolynomial, rows: list[int], width: int = 1) -> PiecewisePolynomial:
    """Return the rows of robots, ``width`` of each."""
    index = (width * np.array(rows)[:, None] + np.arange(width)).ravel()
    return curve.alike(curve.coefficients[:, index])


def _ring(motion: Motion, members: tuple[int, ...]) -> Motion:
    """Return the motion of the ring alone."""
    rows = list(members)
    pulls = motion.leg_tensions
    return motion.replaced(
        team=PartTeam.of(motion.team, rows),
        drones=_rows(motion.drones, rows, 2),
        vertices=_rows(motion.vertices, list(range(len(rows)))),
        legs=_rows(motion.legs, rows),
        tensions=_rows(motion.tensions, rows),
        leg_tensions=None if pulls is None else _rows(pulls, rows),
        phases=tuple(replace(phase, ring=None, waiting=()) for phase in motion.phases),
        assignment=None,
        others=(),
    )


def _alone(motion: Motion, robot: int) -> Motion:
    """Return the motion of a robot that waits; phases of one state are one phase."""
    phases = list[Phase]()
    for phase in motion.phases:
        own = replace(phase, state=dict(phase.waiting)[robot], ring=None, waiting=(), tension=None)
        phases.append(own)
    team, drones = PartTeam.of(motion.team, [robot]), _rows(motion.drones, [robot], 2)
    return Motion.single(team, motion.requirements, drones, phases)


@dataclass(frozen=True, eq=False)
class Waiting:
    """A robot in no ring: its drones (2, 3) [m], over time or at rest, and its cable's state."""

    drones: PiecewisePolynomial | Array
    state: CableState = CableState.FREE


def with_waiting(
    motion: Motion, whole: Team, waiting: Mapping[int, Waiting], requirements: Requirements
) -> Motion:
    """Return the motion of the whole team from that of a ring, as robots wait besides.

    A ring at rest is on any breaks; one of it and of those who wait may move.
    """
    breaks = motion.drones.breaks
    for each in waiting.values():
        if isinstance(each.drones, PiecewisePolynomial):
            breaks = merged_breaks([breaks, each.drones.breaks])
    moving = motion.map_curves(lambda part: on_breaks(part, breaks), motion.phases)
    rows, n = list(motion.team.labels), whole.robots
    states = tuple((robot, each.state) for robot, each in sorted(waiting.items()))
    curves: dict[str, Any] = {
        "drones": _spread(moving.drones, rows, n, 2),
        "vertices": _spread(moving.vertices, list(range(len(rows))), n),
        "legs": _spread(moving.legs, rows, n),
        "tensions": _spread(moving.tensions, rows, n),
    }
    if moving.leg_tensions is not None:
        curves["leg_tensions"] = _spread(moving.leg_tensions, rows, n)
    own = {
        robot: on_breaks(
            each.drones
            if isinstance(each.drones, PiecewisePolynomial)
            else PiecewisePolynomial.constant(breaks, each.drones),
            breaks,
        )
        for robot, each in waiting.items()
    }
    degree = max(curve.degree for curve in (curves["drones"], *own.values()))
    c = curves["drones"].elevated(degree).coefficients.copy()
    for robot, curve in own.items():
        c[:, 2 * robot : 2 * robot + 2] = curve.elevated(degree).coefficients
    curves["drones"] = moving.drones.alike(c)
    phases = tuple(
        replace(phase, ring=motion.team.labels, waiting=states) for phase in motion.phases
    )
    return Motion(whole, requirements, **curves, phases=phases)


def _spread(
    curve: PiecewisePolynomial, rows: list[int], robots: int, width: int = 1
) -> PiecewisePolynomial:
    """Return a curve with rows for all robots, zero where it has none."""
    c = curve.coefficients
    index = (width * np.array(rows)[:, None] + np.arange(width)).ravel()
    whole = np.zeros((len(c), width * robots, *c.shape[2:]))
    whole[:, index] = c
    return curve.alike(whole)
