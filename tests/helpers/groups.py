"""Flights of several teams, and beside others, for tests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import hitchopt as ho
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import saved_others, write_plan
from hitchopt.motion.retiming import shifted
from tests.helpers.plans import planned


def moved(motion: Motion, *by: float) -> Motion:
    """Return a motion without objects elsewhere."""
    parts = {name: getattr(motion, name) for name in ("drones", "vertices")}
    offset = np.array(by)[:, None]
    shifted = {name: part.replaced(part.coefficients + offset) for name, part in parts.items()}
    return motion.replaced(**shifted)


def alone(flight: Flight, name: str) -> Motion:
    """Return the motion of one team, flown by itself."""
    return next(each.motion for each in flight.teams if each.name == name)


def flown_by(flight: Flight, **kinds: ho.Quadrotor) -> Flight:
    """Return the flight with other drones in some teams."""

    def changed(flown: TeamMotion) -> TeamMotion:
        team, kind = flown.motion.team, kinds[flown.name]
        if team.has_cables:
            team = replace(team, quadrotor=(kind,) * team.robots)
        else:
            team = ho.Swarm(team.drones, quadrotor=kind)
        return replace(flown, motion=flown.motion.replaced(team=team))

    return Flight(tuple(changed(each) if each.name in kinds else each for each in flight.teams))


def part(motion: Motion, first: str, last: str) -> Motion:
    """Return phases from one name to the first of another one after it."""
    names = [phase.name for phase in motion.phases]
    start = names.index(first)
    stop = names.index(last, start) + 1
    on = np.flatnonzero(np.isin(motion.phase_of_piece, range(start, stop)))
    cut = motion.slice_pieces(slice(on[0], on[-1] + 1), motion.phases[start:stop])
    return shifted(cut, -float(cut.drones.breaks[0]))


@cache
def two_hitches() -> Flight:
    """Return hitches a and b that cross, b after a; soft drones of unlike masses."""
    kinds = (ho.Quadrotor(mass=0.14, stiffness=4.75), ho.Quadrotor(mass=0.12, stiffness=4.0))
    return flown_by(planned("two_teams").flight, a=kinds[0], b=kinds[1])


@cache
def hitch_and_swarm() -> Flight:
    """Return a triangle of soft drones in a ring of single ones."""
    soft = ho.Quadrotor(mass=0.14, stiffness=4.75)
    return flown_by(planned("hitch_and_swarm").flight, triangle=soft)


@cache
def with_swarm() -> Flight:
    """Return a square that is tied below single drones, which wait for the end."""
    swarm = moved(planned("swarms/circle_6").motion, 0.0, 0.0, 2.0)
    return Flight((TeamMotion("tied", planned("form_square").motion), TeamMotion("swarm", swarm)))


def beside(flown: Motion | Flight, other: Motion, at: float) -> Flight:
    """Return a flight beside a plan of somebody else from a time [s] on."""
    show = TeamMotion("show", shifted(other, at), "0" * 64)
    return replace(Flight.of(flown), others=(show,))


def beside_saved(folder: Path) -> Flight:
    """Return a triangle beside a swarm, and beside a plan of two teams; save their plans."""
    show, pair = folder / "show" / "plan.npz", folder / "pair" / "plan.npz"
    for path in (show, pair):
        path.parent.mkdir(parents=True)
    write_plan(show, Flight.of(moved(planned("swarms/circle_6").motion, 0.0, 0.0, 1.5)))
    ring = planned("triangle").motion
    two = [TeamMotion(name, moved(ring, 4.0, y, 0.0)) for name, y in (("a", 0.0), ("b", 4.0))]
    write_plan(pair, Flight(tuple(two)))
    others = saved_others("show", show, "show", 1.7), saved_others("pair", pair, "pair", -2.1)
    return replace(Flight.of(ring), others=others[0] + others[1])
