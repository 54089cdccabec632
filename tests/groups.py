"""Plans of several groups, and beside others, for tests."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from plans import planned

import hitchopt as ho
from hitchopt.mission.problem import HitchStart, Problem
from hitchopt.mission.teams import solve_teams
from hitchopt.mission.teams_problem import TeamsProblem
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import Group, Motion
from hitchopt.motion.plan_file import saved_others, write_plan
from hitchopt.steps import Transport


def moved(motion: Motion, *by: float) -> Motion:
    """Return a motion without objects elsewhere."""
    parts = {name: getattr(motion, name) for name in ("drones", "vertices")}
    offset = np.array(by)[:, None]
    shifted = {name: part.alike(part.coefficients + offset) for name, part in parts.items()}
    return motion.replaced(**shifted)


def team(robots: int, length: float, edge: float, at: list[float], to: list[float]) -> Problem:
    """Return the problem of a regular polygon that is flown from one place to another."""
    angle = 0.5 * np.pi - 2.0 * np.pi * np.arange(robots) / robots
    radius = edge / (2.0 * np.sin(np.pi / robots))
    polygon = np.array(at[:2]) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    start, own = HitchStart(polygon, at[2]), ho.Team(robots=robots, cable_length=length)
    return Problem(own, start, (Transport(to=np.array(to)),))


@cache
def crossing(height: float = 1.5) -> Motion:
    """Return a triangle and a square that cross, the square at a height [m]."""
    a = team(3, 2.3, 1.3, [-2.5, 0.0, 1.5], [2.5, 0.0, 1.5])
    b = team(4, 2.0, 1.1, [0.0, -2.5, height], [0.0, 2.5, height])
    teams, start = {"a": a.team, "b": b.team}, {"a": a.start, "b": b.start}
    item = {"a": a.mission[0], "b": b.mission[0]}
    return solve_teams(TeamsProblem(teams, start, [item])).motion


@cache
def with_swarm() -> Motion:
    """Return a square that is tied below single drones, which wait for the end."""
    swarm = moved(planned("swarms/circle_6").motion, 0.0, 0.0, 2.0)
    return combined([Group("tied", planned("form_square").motion), Group("swarm", swarm)])


def beside(folder: Path) -> Motion:
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
