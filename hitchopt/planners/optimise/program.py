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
from hitchopt.hitch import Team
from hitchopt.model.planar import planar_function
from hitchopt.planners.optimise.between import between_rows
from hitchopt.planners.optimise.bounds import Bounds, variable_box
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

LOOSE = 0.02
"""Weight of the tensions' squares where they are free, which gives thrust back to motion."""

BETWEEN = 0.5
"""Of a step's reach, for pairs between the knots, which the knots keep apart as well."""

LAGGING = 0.5
"""Of the longest stretch of a step; shorter ones are not asked how long they take: they would have
to grow by more than a stride."""

ITERATIONS = 100
FASTEST_ITERATIONS = 40
"""For the time: it converges in about 20 or, where all drones bind at once, not at all."""


@dataclass(frozen=True)
class Step:
    """One step of the optimiser, from a way to a better one.

    Attributes
    ----------
    stride: [m], how far a coordinate of a vertex or drone may go.
    parts: into how many parts a step between knots is divided, at whose ends distances are kept as
        well; 1 for at the knots alone.
    fastest: minimise the time, not the energy.
    """

    stride: float
    parts: int = 1
    fastest: bool = False

    @property
    def reach(self) -> float:
        """[m] Pairs farther apart than their limit and this cannot come near in such a step."""
        return 2.0 * math.sqrt(2.0) * self.stride + 0.02


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
    team, limits = way.team, bounds.limits
    layout = Layout(team.robots)
    table = layout.table(way)
    inner, steps = len(table) - 2, len(table) - 1
    x = ca.MX.sym("x", layout.size * inner)
    knots = ca.reshape(x, layout.size, inner)
    rows = _Rows()
    _tie_drones(rows, layout, knots, way)
    start = table[1:-1].ravel()
    _keep_apart(rows, x, way, bounds, step)
    lower, upper = variable_box(layout, team, bounds, table, step.stride)

    whole = ca.horzcat(table[0], knots, table[-1])
    speed = np.repeat(
        [1.0 / limits.vertex_speed, 1.0 / limits.speed], [2 * team.robots, 4 * team.robots]
    )
    scaled = whole[layout.nodes.ravel().tolist(), :] * ca.repmat(ca.DM(speed), 1, steps + 1)
    travel = scaled[:, 1:] - scaled[:, :-1]
    bend = travel[:, 1:] - travel[:, :-1]
    energy = steps * ca.sumsqr(travel) / team.robots
    curvature = steps**3 * ca.sumsqr(bend) / team.robots
    loose = _loose(layout, whole, team, bounds)
    if not step.fastest:
        f = energy + BEND * curvature + loose
    else:
        times = ca.MX.sym("time", steps)
        moved = np.diff(table[:, layout.nodes] * speed.reshape(-1, 2), axis=0)
        lengths = np.linalg.norm(moved, axis=-1)
        longest = np.max(lengths, axis=1)
        at, node = np.nonzero(lengths > LAGGING * longest[:, None])
        flat = ca.vec(travel)
        place = 6 * team.robots * at + 2 * node
        squared = flat[place.tolist()] ** 2 + flat[(place + 1).tolist()] ** 2
        rows.add(squared - times[at.tolist()] ** 2, -np.inf, 0.0)
        f = ca.sum1(times) + TIME_ENERGY * energy + TIME_BEND * curvature + loose
        x = ca.vertcat(x, times)
        start = np.append(start, 1.01 * longest)
        lower, upper = np.append(lower, np.zeros(steps)), np.append(upper, np.full(steps, np.inf))
    least, most = rows.bounds()
    g = ca.vertcat(*rows.values)
    iterations = FASTEST_ITERATIONS if step.fastest else ITERATIONS
    return WayProgram(x, f, g, start, lower, upper, least, most, layout, way, iterations)


def _keep_apart(rows: _Rows, x: ca.MX, way: Way, bounds: Bounds, step: Step) -> None:
    """Keep all near pairs apart, at the knots and between them.

    Where they are too near by more than a stride, it is a stride that is asked for.
    """
    layout, count = Layout(way.team.robots), len(way.polygons) - 1
    table = layout.table(way)
    now = table[1:-1].ravel()
    margins = bounds.margins(count)[1:-1]
    pairs = pair_rows(layout, table, bounds.separation, margins, step.reach)
    if len(pairs.first):
        across = x[pairs.first[:, 0].tolist()] - x[pairs.second[:, 0].tolist()]
        along = x[pairs.first[:, 1].tolist()] - x[pairs.second[:, 1].tolist()]
        apart = np.linalg.norm(now[pairs.first] - now[pairs.second], axis=1)
        rows.add(across**2 + along**2, np.minimum(pairs.apart, apart + step.stride) ** 2, np.inf)
    linear = [(pairs.rows, pairs.least)]
    if step.parts > 1:
        finer = layout.table(way.resampled(step.parts * count + 1))
        between = between_rows(
            layout,
            (table, finer),
            bounds.separation,
            bounds.margins(count, step.parts),
            BETWEEN * step.reach,
        )
        linear.append((between.rows, between.least))
    for matrix, least in linear:
        if len(least):
            rows.add(ca.DM(matrix) @ x, np.minimum(least, matrix @ now + step.stride), np.inf)


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


def _loose(layout: Layout, whole: ca.MX, team: Team, bounds: Bounds) -> ca.MX:
    if bounds.tension is None:
        return ca.MX(0.0)
    ratio = whole[layout.tensions.tolist(), :] / ca.repmat(ca.DM(team.tension), 1, whole.size2())
    steps = whole.size2() - 1
    change = ratio[:, 1:] - ratio[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    rough = steps * ca.sumsqr(change) + BEND * steps**3 * ca.sumsqr(bend)
    return LOOSE * (ca.sumsqr(ratio) / steps + 0.01 * rough) / team.robots
