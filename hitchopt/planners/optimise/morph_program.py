"""The nonlinear program of a path: casadi and IPOPT with exact sparse derivatives.

Variables are the inner knots of a path; what is minimised is either the energy of all vertices' and
drones' travel, whose solution comes in a few steps from any guess, or, from there, the time that
the speed limits allow. Cost is linear in knots · n: one small function of the model is mapped over
all robots and knots, and every other row has a handful of entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.model_rows import (
    Draft,
    Expression,
    Program,
    Symbols,
    keep_apart,
)
from hitchopt.planners.optimise.search_task import Search, SolverStep, variable_bounds
from hitchopt.planners.optimise.tied_drones import tie_drones
from hitchopt.values import Array

BEND = 0.1
"""Weight of the knots' second differences in the energy: keeps the spline near its knots."""

TIME_BEND = 0.01
"""Weight of the second differences beside the time; less leaves corners that cost more time than
they save."""

TIME_ENERGY = 1e-3
"""Weight of the energy beside the time, where the time leaves something open."""

TENSION_WEIGHT = 0.02
"""Weight of the tensions' squares where they are free, which gives thrust back to motion."""

TENSION_CHANGE = 0.01
"""Weight of the tensions' differences beside their squares."""

LAGGING = 0.5
"""Share of the longest segment of a step below which others do not tell how long it takes."""

ITERATIONS = 100
"""Largest number of IPOPT's iterations for the energy."""

FASTEST_ITERATIONS = 40
"""Largest number for the time: it converges in about 20 or, where all drones bind at once, not at
all."""


@dataclass(frozen=True, eq=False)
class MorphProgram:
    """A program around a path.

    Attributes
    ----------
    program: its variables start with those of the inner knots.
    path: around which it is, to read the solution.
    iterations: after which it is given up.
    multipliers: whether they are estimated first.
    """

    program: Program
    path: KnotPath
    iterations: int
    multipliers: bool


def build_program(path: KnotPath, search: Search, step: SolverStep) -> MorphProgram:
    """Return the program around a path: its near pairs and their normals are the path's."""
    columns, table, n = path.columns, path.table, path.team.robots
    draft = Draft()
    x = draft.variables(table[1:-1].ravel(), *variable_bounds(path, search, step.stride))
    tie_drones(draft, x, path)
    keep_apart(draft, x, path, search, step)

    limits = search.requirements.limits
    slowness = 1.0 / np.repeat([limits.vertex_speed, limits.speed], [2 * n, 4 * n])
    ends = draft.parameters(table[[0, -1]].ravel())
    draft.structure(slowness, path.steps, step.fastest)

    def whole(at: Symbols) -> ca.MX:
        """Return all knots (size, J + 1)."""
        first, last = ca.vertsplit(at.parameters[ends], columns.size)
        knots = ca.reshape(at.variables[x], columns.size, path.steps - 1)
        return ca.horzcat(first, knots, last)

    def scaled(at: Symbols) -> ca.MX:
        """Return the places of vertices and drones at all knots, in units of time."""
        places = whole(at)[columns.nodes.ravel().tolist(), :]
        return places * ca.repmat(ca.DM(slowness), 1, path.steps + 1)

    if search.tension is not None:
        draft.structure("tensions", path.team.tension)
        draft.cost(lambda at: _tension_cost(path, whole(at)))
    if step.fastest:
        moved = np.diff(table[:, columns.nodes] * slowness.reshape(-1, 2), axis=0)
        times = _times(draft, scaled, np.linalg.norm(moved, axis=-1))

        def time_cost(at: Symbols) -> ca.MX:
            _, energy, curvature = _roughness(scaled(at), n)
            total = ca.sum1(at.variables[times])
            return total + TIME_ENERGY * energy + TIME_BEND * curvature

        draft.cost(time_cost)
    else:

        def energy_cost(at: Symbols) -> ca.MX:
            _, energy, curvature = _roughness(scaled(at), n)
            return energy + BEND * curvature

        draft.cost(energy_cost)
    iterations = FASTEST_ITERATIONS if step.fastest else ITERATIONS
    return MorphProgram(draft.program(), path, iterations, step.multipliers)


def _roughness(values: ca.MX, n: int) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Return first differences of values (size, J + 1), and squares of first and second, by n."""
    steps = values.size2() - 1
    change = values[:, 1:] - values[:, :-1]
    bend = change[:, 1:] - change[:, :-1]
    return change, steps * ca.sumsqr(change) / n, steps**3 * ca.sumsqr(bend) / n


def _times(draft: Draft, scaled: Expression, lengths: Array) -> int:
    """Return variables that tell how long every step takes, by its longest segment.

    Parameters
    ----------
    draft: takes the rows.
    scaled: (6n, steps + 1), both coordinates of every node, in units of time.
    lengths: (steps, 3n), of the segments now.
    """
    steps, nodes = lengths.shape
    longest = np.max(lengths, axis=1)
    times = draft.variables(1.01 * longest, np.zeros(steps), np.full(steps, np.inf))
    at_step, node = np.nonzero(lengths > LAGGING * longest[:, None])
    place = 2 * (nodes * at_step + node)
    draft.structure("times", place)

    def lags(at: Symbols) -> ca.MX:
        values = scaled(at)
        flat = ca.vec(values[:, 1:] - values[:, :-1])
        squared = flat[place.tolist()] ** 2 + flat[(place + 1).tolist()] ** 2
        return squared - at.variables[times][at_step.tolist()] ** 2

    draft.bound(lags, np.full(len(place), -np.inf), np.zeros(len(place)))
    return times


def _tension_cost(path: KnotPath, whole: ca.MX) -> ca.MX:
    """Return the cost of free tensions: their squares and, to a lesser degree, their changes."""
    usual = ca.repmat(ca.DM(path.team.tension), 1, path.steps + 1)
    ratio = whole[path.columns.tensions.tolist(), :] / usual
    _, change, bend = _roughness(ratio, 1)
    cost = ca.sumsqr(ratio) / path.steps + TENSION_CHANGE * (change + BEND * bend)
    return TENSION_WEIGHT * cost / path.team.robots
