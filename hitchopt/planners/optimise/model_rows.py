"""A path's program as it is put together: drones tied to the flat outputs, bodies kept apart."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.parts import SEPARATION
from hitchopt.model.loaded_clasp import loaded_planar_function
from hitchopt.model.robot import planar_function
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.search_task import Search, SolverStep
from hitchopt.planners.optimise.separating_rows import near_pairs, rows_at_knots, rows_between
from hitchopt.values import Array

FLATTEST = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""

BETWEEN = 0.35
"""Share of a step's reach within which pairs get rows between the knots: the knots keep them apart
as well."""

PENALTY_WEIGHT = 100.0
"""[1/m] Penalty weight of bodies that stay too near: more than any path gains by leaving them."""


class Draft:
    """Variables, rows and costs as they are collected.

    Attributes
    ----------
    f: sum of the costs so far.
    """

    def __init__(self) -> None:
        self.f = ca.MX(0.0)
        self._variables: list[tuple[ca.MX, Array, Array, Array]] = []
        self._rows: list[tuple[ca.MX, Array, Array]] = []

    def variables(self, name: str, start: Array, lower: Array, upper: Array) -> ca.MX:
        """Return new variables that start at ``start`` and stay within their bounds."""
        x = ca.MX.sym(name, len(start))
        self._variables.append((x, start, lower, upper))
        return x

    def bound(self, value: ca.MX, least: Array | float, most: Array | float) -> None:
        """Add rows that keep values (a column) between their bounds."""
        lower, upper = (np.zeros(value.numel()) + end for end in (least, most))
        self._rows.append((value, lower, upper))

    def soft_bound(self, value: ca.MX, least: Array, now: Array, weight: float) -> None:
        """Add rows that keep values (a column) above their bounds, softly where they are not now.

        Parameters
        ----------
        value, least, now: (rows,), now where the variables start.
        weight: penalty weight of a unit by which a value stays below.
        """
        short = np.flatnonzero(now < least)
        if len(short):
            lack = (least - now)[short]
            count = len(short)
            slack = self.variables("slack", lack, np.zeros(count), np.full(count, np.inf))
            ones = (short.tolist(), list(range(count)), ca.DM.ones(count))
            value = value + ca.DM.triplet(*ones, len(least), count) @ slack
            self.f += weight * ca.sum1(slack)
        self.bound(value, least, np.inf)

    def program(self) -> tuple[dict[str, ca.MX], dict[str, Array]]:
        """Return casadi's expressions x, f, g, and its numbers x0, lbx, ubx, lbg, ubg."""
        x, *box = zip(*self._variables, strict=True)
        g, *ranges = zip(*self._rows, strict=True)
        numbers = [np.concatenate(column) for column in (*box, *ranges)]
        expressions = {"x": ca.vertcat(*x), "f": self.f, "g": ca.vertcat(*g)}
        names = ("x0", "lbx", "ubx", "lbg", "ubg")
        return expressions, dict(zip(names, numbers, strict=True))


def tie_drones(draft: Draft, knots: ca.MX, path: KnotPath) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner.

    Parameters
    ----------
    knots: (size, J - 1), the variables of the inner knots.
    """
    layout, n = path.columns, path.team.robots
    columns = n * knots.size2()

    def gathered(places: NDArray[np.intp]) -> ca.MX:
        """Return (width, n · inner) of places (n, width)."""
        return ca.reshape(knots[places.ravel().tolist(), :], places.shape[1], columns)

    around = [np.roll(layout.vertices, shift, axis=0) for shift in (1, 0, -1, -2)]
    pulls = [np.roll(layout.tensions, shift) for shift in (1, 0, -1)]
    team, inner = path.team, knots.size2()
    vertices, tensions = gathered(np.concatenate(around, axis=1)), gathered(np.stack(pulls, axis=1))
    if team.loaded or path.roll is not None:
        neighbours = team.layout.neighbours
        ends = np.column_stack([team.layout.starts, team.layout.ends])
        roll = np.zeros((inner, n)) if path.roll is None else path.roll[1:-1]
        loads = np.zeros((n, 2, 3))
        loads[..., 2] = -GRAVITY * team.load[ends]
        place, turn = loaded_planar_function(team.cable_density > 0.0).map(columns)(
            vertices,
            gathered(layout.q_legs[neighbours]),
            tensions,
            np.tile(team.cable_length[neighbours[:, :2]].T, inner),
            roll[:, ends].reshape(columns, 2).T,
            np.tile(loads.reshape(n, 6).T, inner),
            np.full((1, columns), GRAVITY * team.cable_density),
        )
    else:
        free = not bool(np.all(team.tension == team.tension[0]))
        place, turn = planar_function(not free).map(columns)(
            vertices,
            gathered(layout.q_legs[:, None]),
            tensions,
            np.tile(team.cable_length, inner)[None],
        )
    lifted = gathered(np.column_stack([layout.drones.reshape(n, 4), layout.r_legs]))
    draft.bound(ca.vec(place - lifted), 0.0, 0.0)
    sharpest = min(np.min(ConvexPolygon(path.polygons[end]).exterior_angles) for end in (0, -1))
    draft.bound(ca.vec(turn), math.sin(min(FLATTEST, 0.5 * float(sharpest))), np.inf)


def keep_apart(draft: Draft, x: ca.MX, path: KnotPath, search: Search, step: SolverStep) -> None:
    """Keep all near pairs apart, at the knots and between them.

    Those that are too near now, as in a first guess, are parted as far as a step can.
    """
    columns, inner = path.columns, path.table[1:-1]
    now = inner.ravel()
    margins = search.margins(path.steps, np.arange(1.0, path.steps))
    separation = search.requirements.separation
    pairs = near_pairs(inner[:, columns.nodes], separation, margins, step.reach)
    drones = pairs.chosen(pairs.kind == SEPARATION)
    if len(drones.frame):
        first, second = (
            columns.size * drones.frame[:, None] + columns.nodes[node[:, 0]]
            for node in (drones.first, drones.second)
        )
        across, along = (x[first[:, i].tolist()] - x[second[:, i].tolist()] for i in range(2))
        squared = np.sum((now[first] - now[second]) ** 2, axis=1)
        apart = drones.enforced
        scale = 1.0 / (2.0 * apart)  # of squares to about metres
        value = (across**2 + along**2) * scale
        draft.soft_bound(value, scale * apart**2, scale * squared, PENALTY_WEIGHT)
    linear = [rows_at_knots(path, pairs.chosen(pairs.kind != SEPARATION))]
    if step.parts > 1:
        linear.append(rows_between(path, search, step.parts, BETWEEN * step.reach))
    for found in linear:
        if len(found.least):
            value = casadi_matrix(found.rows) @ x
            draft.soft_bound(value, found.least, found.rows @ now, PENALTY_WEIGHT)


def casadi_matrix(matrix: sparse.csc_matrix) -> ca.DM:
    """Return a matrix for casadi, in a tenth of the time of its own conversion."""
    columns, rows = matrix.indptr.tolist(), matrix.indices.tolist()
    return ca.DM(ca.Sparsity(*matrix.shape, columns, rows), matrix.data.tolist())
