"""Motions of several groups: two hitches that cross, and a hitch beside single drones."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

import hitchopt as ho
from hitchopt.mission.problem import HitchStart, Problem
from hitchopt.mission.teams import solve_teams
from hitchopt.mission.teams_problem import Fly, TeamsProblem
from hitchopt.motion.motion import Group, Motion
from hitchopt.motion.retiming import shifted
from hitchopt.steps import Transport

KINDS = {
    "a": ho.Quadrotor(mass=0.14, stiffness=4.75),
    "b": ho.Quadrotor(mass=0.12, stiffness=4.0),
}


def crossing(name: str, n: int, edge: float, start: list[float], goal: list[float]) -> Problem:
    corners = ho.regular_polygon(n, edge).translated(start)
    team = ho.Team(robots=n, cable_length=2.3 if n == 3 else 2.0, quadrotor=KINDS[name])
    return Problem(team, HitchStart(corners, 1.5), (Transport(to=np.array([*goal, 1.5])),))


@lru_cache
def two_hitches() -> Motion:
    """The hitch b waits until a has passed."""
    a = crossing("a", 3, 1.3, [-2.5, 0.0], [2.5, 0.0])
    b = crossing("b", 4, 1.1, [0.0, -2.5], [0.0, 2.5])
    teams, start = {"a": a.team, "b": b.team}, {"a": a.start, "b": b.start}
    item = {"a": a.mission[0], "b": b.mission[0]}
    return solve_teams(TeamsProblem(teams, start, [item])).motion


@lru_cache
def hitch_and_swarm() -> Motion:
    hitch = crossing("a", 3, 1.3, [0.0, 0.0], [0.5, -0.5])
    start = np.array([[-1.5, 1.6, 1.2], [-1.5, 1.0, 1.2]])
    teams: dict[str, ho.Team] = {"hitch": hitch.team, "camera": ho.Swarm(2)}
    item = {"hitch": hitch.mission[0], "camera": Fly(start + [3.0, 0.0, 0.0])}
    starts = {"hitch": hitch.start, "camera": start}
    return solve_teams(TeamsProblem(teams, starts, [item])).motion


def beside(motion: Motion, other: Motion, at: float) -> Motion:
    """Return a motion beside a plan of somebody else from a time [s] on."""
    return motion.replaced(others=(Group("show", shifted(other, at), "0" * 64),))


def alone(motion: Motion, name: str) -> Motion:
    """Return the motion of one group, flown by itself."""
    return next(each.motion for each in motion.groups if each.name == name)


def far(motion: Motion) -> Motion:
    """Return a motion that is 50 m higher than another one."""
    drones, vertices = (
        part.alike(part.coefficients + np.array([0.0, 0.0, 50.0])[:, None])
        for part in (motion.drones, motion.vertices)
    )
    needs = replace(motion.requirements, arena=None)
    return motion.replaced(drones=drones, vertices=vertices, requirements=needs)
