"""Motions of several groups, and beside others, for tests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from plans import planned

import hitchopt as ho
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import Group, Motion
from hitchopt.motion.plan_file import saved_others, write_plan
from hitchopt.motion.retiming import shifted


def moved(motion: Motion, *by: float) -> Motion:
    """Return a motion without objects elsewhere."""
    parts = {name: getattr(motion, name) for name in ("drones", "vertices")}
    offset = np.array(by)[:, None]
    shifted = {name: part.replaced(part.coefficients + offset) for name, part in parts.items()}
    return motion.replaced(**shifted)


def alone(motion: Motion, name: str) -> Motion:
    """Return the motion of one group, flown by itself."""
    return next(each.motion for each in motion.groups if each.name == name)


def flown_by(motion: Motion, **kinds: ho.Quadrotor) -> Motion:
    """Return the motion with other drones in some groups."""

    def changed(group: Group) -> Group:
        team, kind = group.motion.team, kinds[group.name]
        if team.has_cables:
            team = replace(team, quadrotor=(kind,) * team.robots)
        else:
            team = ho.Swarm(team.drones, quadrotor=kind)
        return replace(group, motion=group.motion.replaced(team=team))

    return combined([changed(each) if each.name in kinds else each for each in motion.groups])


def part(motion: Motion, first: str, last: str) -> Motion:
    """Return phases from one name to the first of another one after it."""
    names = [phase.name for phase in motion.phases]
    start = names.index(first)
    stop = names.index(last, start) + 1
    on = np.flatnonzero(np.isin(motion.phase_of_piece, range(start, stop)))
    cut = motion.slice_pieces(slice(on[0], on[-1] + 1), motion.phases[start:stop])
    return shifted(cut, -float(cut.drones.breaks[0]))


@cache
def two_hitches() -> Motion:
    """Return hitches a and b that cross, b after a; soft drones of unlike masses."""
    kinds = (ho.Quadrotor(mass=0.14, stiffness=4.75), ho.Quadrotor(mass=0.12, stiffness=4.0))
    return flown_by(planned("two_teams").motion, a=kinds[0], b=kinds[1])


@cache
def hitch_and_swarm() -> Motion:
    """Return a triangle of soft drones in a ring of single ones."""
    soft = ho.Quadrotor(mass=0.14, stiffness=4.75)
    return flown_by(planned("hitch_and_swarm").motion, triangle=soft)


@cache
def with_swarm() -> Motion:
    """Return a square that is tied below single drones, which wait for the end."""
    swarm = moved(planned("swarms/circle_6").motion, 0.0, 0.0, 2.0)
    return combined([Group("tied", planned("form_square").motion), Group("swarm", swarm)])


def beside(motion: Motion, other: Motion, at: float) -> Motion:
    """Return a motion beside a plan of somebody else from a time [s] on."""
    return motion.replaced(others=(Group("show", shifted(other, at), "0" * 64),))


def beside_saved(folder: Path) -> Motion:
    """Return a triangle beside a swarm, and beside a plan of two teams; save their plans."""
    show, pair = folder / "show" / "plan.npz", folder / "pair" / "plan.npz"
    for path in (show, pair):
        path.parent.mkdir(parents=True)
    write_plan(show, moved(planned("swarms/circle_6").motion, 0.0, 0.0, 1.5))
    ring = planned("triangle").motion
    two = [Group(name, moved(ring, 4.0, y, 0.0)) for name, y in (("a", 0.0), ("b", 4.0))]
    write_plan(pair, combined(two))
    others = saved_others("show", show, "show", 1.7), saved_others("pair", pair, "pair", -2.1)
    return ring.replaced(others=others[0] + others[1])
