"""The nonlinear program of a way: casadi and IPOPT with exact sparse derivatives.

Variables are the inner knots of a way; what is minimised is either the energy of all vertices' and
drones' travel, whose solution comes in a few steps from any guess, or, from there, the time that
the speed limits allow. Cost is linear in knots · n: one small function of the model is mapped over
all robots and knots, and every other row has a handful of entries.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY, Arena, Limits, Separation, Team
from hitchopt.model.planar import planar_function
from hitchopt.planners.optimise.layout import Layout
from hitchopt.planners.optimise.pairs import pair_rows
from hitchopt.planners.optimise.way import Way

Array = NDArray[np.float64]

BEND = 0.1
"""Weight of the knots' second differences in the energy: keeps the spline near its knots."""

TIME_BEND = 0.01
"""The same beside the time; less of it leaves corners that cost more time than they save."""

TIME_ENERGY = 1e-3
"""Weight of the energy beside the time, where the time leaves something open."""

FLATTEST = math.radians(3.0)
"""[rad] Vertices stay this sharp on the way, or half as sharp as at its ends if that is less."""

INSET = 5e-3
"""[m] From walls and shortest legs, for what the spline does between knots."""

TENSION_INSET = 0.02
"""Of a range of tensions, kept free at both its ends for what the spline does between knots."""

STATIC_SHARE = 0.97
"""Of thrust and tilt that holding the hitch at rest may take, so that it can still be moved."""

LOOSE = 0.02
"""Weight of the tensions' squares where they are free, which gives thrust back to motion."""

STEP = 0.17
"""[m] How far a coordinate of a vertex or drone may go from the way that the program is built
around: two bodies then come nearer by less than REACH in ``pairs``."""

RAMP = 4.0
"""Knots in which the margin rises from what an end has: a step there would bend the way."""

ITERATIONS = 100
FASTEST_ITERATIONS = 40
"""For the time: it converges in about 20 or, where all drones bind at once, not at all."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """What a way has to keep.

    Attributes
    ----------
    limits, separation, arena: as of the problem.
    tension: smallest and largest [N] where tensions are free, or None.
    margin: how many times their limits distances are kept at the knots.
    end_margins: how many times their limits they are kept by the first and the last hitch.
    """

    limits: Limits
    separation: Separation
    arena: Arena | None
    tension: tuple[float, float] | None
    margin: float
    end_margins: tuple[float, float]

    def margins(self, inner: int) -> Array:
        """Return (inner,): the margin at every knot, near an end at most what that end has."""
        rise = np.minimum((np.arange(inner) + 1.0) / RAMP, 1.0)
        first, last = (min(m, self.margin) for m in self.end_margins)
        margins: Array = np.minimum(
            first + rise * (self.margin - first), last + rise[::-1] * (self.margin - last)
        )
        return margins


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


def build_program(way: Way, bounds: Bounds, *, fastest: bool = False) -> WayProgram:
    """Return the program around a way: its near pairs and their normals are the way's."""
    team, limits = way.team, bounds.limits
    layout = Layout(team.robots)
    table = layout.table(way)
    inner = len(table) - 2
    x = ca.MX.sym("x", layout.size * inner)
    knots = ca.reshape(x, layout.size, inner)
    rows = _Rows()
    _tie_drones(rows, layout, knots, way)
    margins = bounds.margins(inner)
    pairs = pair_rows(layout, table, bounds.separation, margins)
    if len(pairs.first):
        across = x[pairs.first[:, 0].tolist()] - x[pairs.second[:, 0].tolist()]
        along = x[pairs.first[:, 1].tolist()] - x[pairs.second[:, 1].tolist()]
        rows.add(across**2 + along**2, pairs.apart**2, np.inf)
    if len(pairs.least):
        rows.add(ca.DM(pairs.rows) @ x, pairs.least, np.inf)
    lower, upper = _box(layout, team, bounds, table[1:-1])

    whole = ca.horzcat(table[0], knots, table[-1])
    steps = len(table) - 1
    speed = np.repeat(
        [1.0 / limits.vertex_speed, 1.0 / limits.speed], [2 * team.robots, 4 * team.robots]
    )
    scaled = whole[layout.nodes.ravel().tolist(), :] * ca.repmat(ca.DM(speed), 1, steps + 1)
    travel = scaled[:, 1:] - scaled[:, :-1]
    bend = travel[:, 1:] - travel[:, :-1]
    energy = steps * ca.sumsqr(travel) / team.robots
    curvature = steps**3 * ca.sumsqr(bend) / team.robots
    loose = _loose(layout, whole, team, bounds)
    start = table[1:-1].ravel()
    if not fastest:
        f = energy + BEND * curvature + loose
    else:
        times = ca.MX.sym("time", steps)
        squared = travel[0::2, :] ** 2 + travel[1::2, :] ** 2
        rows.add(ca.vec(squared - ca.repmat((times**2).T, 3 * team.robots, 1)), -np.inf, 0.0)
        f = ca.sum1(times) + TIME_ENERGY * energy + TIME_BEND * curvature + loose
        x = ca.vertcat(x, times)
        moved = np.diff(table[:, layout.nodes] * speed.reshape(-1, 2), axis=0)
        longest = np.max(np.linalg.norm(moved, axis=-1), axis=1)
        start = np.append(start, 1.01 * longest)
        lower, upper = np.append(lower, np.zeros(steps)), np.append(upper, np.full(steps, np.inf))
    least, most = rows.bounds()
    g = ca.vertcat(*rows.values)
    iterations = FASTEST_ITERATIONS if fastest else ITERATIONS
    return WayProgram(x, f, g, start, lower, upper, least, most, layout, way, iterations)


def solve_program(program: WayProgram) -> Way | None:
    """Return the way that IPOPT finds, or None where it does not converge.

    Its word is not taken for more than that: what the way keeps is measured on its path.
    """
    solver = ca.nlpsol(
        "way",
        "ipopt",
        {"x": program.x, "f": program.f, "g": program.g},
        {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": program.iterations,
                "tol": 1e-5,
                "acceptable_tol": 1e-4,
            },
        },
    )
    solution = solver(
        x0=program.start,
        lbx=program.lower,
        ubx=program.upper,
        lbg=program.least,
        ubg=program.most,
    )
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    if not solver.stats()["success"] or not np.all(np.isfinite(x)):
        return None
    table = program.layout.table(program.way)
    inner = table[1:-1]
    solved = x[: inner.size].reshape(inner.shape)
    return program.layout.way(np.concatenate([table[:1], solved, table[-1:]]), program.way)


class _Rows:
    """Constraints as they are collected."""

    def __init__(self) -> None:
        self.values: list[ca.MX] = []
        self._least: list[Array] = []
        self._most: list[Array] = []

    def add(self, value: ca.MX, least: Array | float, most: Array | float) -> None:
        count = value.numel()
        self.values.append(value)
        self._least.append(np.broadcast_to(np.asarray(least, dtype=np.float64), (count,)))
        self._most.append(np.broadcast_to(np.asarray(most, dtype=np.float64), (count,)))

    def bounds(self) -> tuple[Array, Array]:
        return np.concatenate(self._least), np.concatenate(self._most)


def _tie_drones(rows: _Rows, layout: Layout, knots: ca.MX, way: Way) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner."""
    n, inner = layout.robots, knots.size2()
    columns = n * inner

    def gathered(places: NDArray[np.intp]) -> ca.MX:
        """Return (width, n · inner) of places (n, width)."""
        return ca.reshape(knots[places.ravel().tolist(), :], places.shape[1], columns)

    around = [np.roll(layout.vertices, shift, axis=0) for shift in (1, 0, -1, -2)]
    pulls = [np.roll(layout.tensions, shift) for shift in (1, 0, -1)]
    free = not bool(np.all(way.team.tension == way.team.tension[0]))
    place, turn = planar_function(not free).map(columns)(
        gathered(np.concatenate(around, axis=1)),
        gathered(layout.q_legs[:, None]),
        gathered(np.stack(pulls, axis=1)),
        np.tile(way.team.cable_length, inner)[None],
    )
    drones = layout.drones.reshape(n, 4)
    lifted = gathered(np.column_stack([drones, layout.r_legs]))
    rows.add(ca.vec(place - lifted), 0.0, 0.0)
    sharpest = [np.min(ConvexPolygon(way.polygons[end]).exterior_angles) for end in (0, -1)]
    rows.add(ca.vec(turn), math.sin(min(FLATTEST, 0.5 * float(min(sharpest)))), np.inf)


def _box(layout: Layout, team: Team, bounds: Bounds, table: Array) -> tuple[Array, Array]:
    """Return bounds of the variables: legs, walls, a step, tensions that can be held at rest."""
    inner = len(table)
    lower = np.full(layout.size, -np.inf)
    upper = np.full(layout.size, np.inf)
    if bounds.arena is not None:
        lower[layout.drones] = bounds.arena.lower[:2] + INSET
        upper[layout.drones] = bounds.arena.upper[:2] - INSET
    if bounds.tension is None:
        lower[layout.tensions] = upper[layout.tensions] = team.tension
    else:
        least, most = bounds.tension
        inset = TENSION_INSET * (most - least)
        lower[layout.tensions] = least + inset
        upper[layout.tensions] = np.minimum(most - inset, _static_tension(team, bounds))
        upper = np.maximum(lower, upper)
    lower, upper = np.tile(lower, (inner, 1)), np.tile(upper, (inner, 1))
    rise = (bounds.margins(inner) - 1.0) / max(bounds.margin - 1.0, 1e-9)
    legs = bounds.limits.leg + INSET * np.clip(rise, 0.0, 1.0)
    lower[:, layout.q_legs] = lower[:, layout.r_legs] = legs[:, None]
    places = layout.nodes.ravel()
    lower[:, places] = np.maximum(lower[:, places], table[:, places] - STEP)
    upper[:, places] = np.minimum(upper[:, places], table[:, places] + STEP)
    # A guess may stand outside the arena: then the walls are what it is pulled towards.
    return np.minimum(lower, upper).ravel(), np.maximum(lower, upper).ravel()


def _static_tension(team: Team, bounds: Bounds) -> Array:
    """Return (n,) [N]: the largest pull against which both drones of each robot can hover."""
    lift = team.mass * GRAVITY + team.cable_weight
    by_thrust = np.sqrt(np.maximum((STATIC_SHARE * team.max_thrust) ** 2 - lift**2, 0.0))
    by_tilt = lift * math.tan(STATIC_SHARE * bounds.limits.tilt)
    largest: Array = np.min(np.minimum(by_thrust, by_tilt).reshape(-1, 2), axis=1)
    return largest


def _loose(layout: Layout, whole: ca.MX, team: Team, bounds: Bounds) -> ca.MX:
    if bounds.tension is None:
        return ca.MX(0.0)
    ratio = whole[layout.tensions.tolist(), :] / ca.repmat(ca.DM(team.tension), 1, whole.size2())
    steps = whole.size2() - 1
    change = ratio[:, 1:] - ratio[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    rough = steps * ca.sumsqr(change) + BEND * steps**3 * ca.sumsqr(bend)
    return LOOSE * (ca.sumsqr(ratio) / steps + 0.01 * rough) / team.robots
