"""The nonlinear program of a way: casadi and IPOPT with exact sparse derivatives.

Variables are the inner knots of a way; what is minimised is either the energy of all vertices' and
drones' travel, whose solution comes in a few steps from any guess, or, from there, the time that
the speed limits allow. Cost is linear in knots · n: one small function of the model is mapped over
all robots and knots, and every other row has a handful of entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.planners.optimise.draft import Draft
from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.model_rows import keep_apart, tie_drones
from hitchopt.planners.optimise.variable_bounds import Bounds, Step, variable_box
from hitchopt.planners.optimise.variables import Layout

Array = NDArray[np.float64]

BEND = 0.1
"""Weight of the knots' second differences in the energy: keeps the spline near its knots."""

TIME_BEND = 0.01
"""The same beside the time; less of it leaves corners that cost more time than they save."""

TIME_ENERGY = 1e-3
"""Weight of the energy beside the time, where the time leaves something open."""

LOOSE = 0.02
"""Weight of the tensions' squares where they are free, which gives thrust back to motion."""

LAGGING = 0.5
"""Of the longest stretch of a step; shorter ones do not tell how long it takes."""

ITERATIONS = 100
FASTEST_ITERATIONS = 40
"""For the time: it converges in about 20 or, where all drones bind at once, not at all."""


@dataclass(frozen=True, eq=False)
class WayProgram:
    """``min f(x)`` over ``lower ≤ x ≤ upper`` and ``least ≤ g(x) ≤ most``, and where to start.

    Attributes
    ----------
    x, f, g: casadi expressions.
    start, lower, upper: (variables,)
    least, most: (rows,)
    layout, way: to read the solution.
    iterations: after which it is given up.
    """

    x: ca.MX
    f: ca.MX
    g: ca.MX
    start: Array
    lower: Array
    upper: Array
    least: Array
    most: Array
    layout: Layout
    way: Way
    iterations: int


def build_program(way: Way, bounds: Bounds, step: Step) -> WayProgram:
    """Return the program around a way: its near pairs and their normals are the way's."""
    team = way.team
    layout = Layout(team.robots)
    table = layout.table(way)
    draft = Draft()
    box = variable_box(layout, team, bounds, table, step.stride)
    x = draft.variables("x", table[1:-1].ravel(), *box)
    knots = ca.reshape(x, layout.size, len(table) - 2)
    tie_drones(draft, layout, knots, way)
    keep_apart(draft, x, way, bounds, step)

    steps = len(table) - 1
    whole = ca.horzcat(table[0], knots, table[-1])
    limits = bounds.requirements.limits
    speed = [limits.vertex_speed, limits.speed]
    slowness = 1.0 / np.repeat(speed, [2 * team.robots, 4 * team.robots])
    scaled = whole[layout.nodes.ravel().tolist(), :] * ca.repmat(ca.DM(slowness), 1, steps + 1)
    travel = scaled[:, 1:] - scaled[:, :-1]
    bend = travel[:, 1:] - travel[:, :-1]
    energy = steps * ca.sumsqr(travel) / team.robots
    curvature = steps**3 * ca.sumsqr(bend) / team.robots
    draft.f += _loose(layout, whole, team, bounds)
    if step.fastest:
        moved = np.diff(table[:, layout.nodes] * slowness.reshape(-1, 2), axis=0)
        times = _times(draft, travel, np.linalg.norm(moved, axis=-1))
        draft.f += ca.sum1(times) + TIME_ENERGY * energy + TIME_BEND * curvature
    else:
        draft.f += energy + BEND * curvature
    iterations = FASTEST_ITERATIONS if step.fastest else ITERATIONS
    return WayProgram(
        draft.x, draft.f, draft.g, *draft.box(), *draft.ranges(), layout, way, iterations
    )


def _times(draft: Draft, travel: ca.MX, lengths: Array) -> ca.MX:
    """Return how long every step takes, by its longest stretch.

    Parameters
    ----------
    draft: takes the rows.
    travel: (6n, steps), both coordinates of every stretch, in units of time.
    lengths: (steps, 3n), of those now.
    """
    steps, nodes = lengths.shape
    longest = np.max(lengths, axis=1)
    times = draft.variables("time", 1.01 * longest, np.zeros(steps), np.full(steps, np.inf))
    at, node = np.nonzero(lengths > LAGGING * longest[:, None])
    flat, place = ca.vec(travel), 2 * (nodes * at + node)
    squared = flat[place.tolist()] ** 2 + flat[(place + 1).tolist()] ** 2
    draft.keep(squared - times[at.tolist()] ** 2, -np.inf, 0.0)
    return times


def _loose(layout: Layout, whole: ca.MX, team: Team, bounds: Bounds) -> ca.MX:
    if bounds.tension is None:
        return ca.MX(0.0)
    ratio = whole[layout.tensions.tolist(), :] / ca.repmat(ca.DM(team.tension), 1, whole.size2())
    steps = whole.size2() - 1
    change = ratio[:, 1:] - ratio[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    rough = steps * ca.sumsqr(change) + BEND * steps**3 * ca.sumsqr(bend)
    return LOOSE * (ca.sumsqr(ratio) / steps + 0.01 * rough) / team.robots
