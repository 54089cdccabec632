"""A path's program as it is put together: drones tied to the flat outputs, bodies kept apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

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
from hitchopt.planners.optimise.separating_rows import (
    NearPairs,
    near_pairs,
    rows_at_knots,
    rows_between,
)
from hitchopt.values import Array

FLATTEST = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""

BETWEEN = 0.35
"""Share of a step's reach within which pairs get rows between the knots: the knots keep them apart
as well."""

PENALTY_WEIGHT = 100.0
"""[1/m] Penalty weight of bodies that stay too near: more than any path gains by leaving them."""


@dataclass(frozen=True, eq=False)
class Symbols:
    """What a program's expressions are of.

    Attributes
    ----------
    variables: in groups, as they were added to the draft.
    parameters: vectors of numbers that programs of one structure differ in.
    """

    variables: list[ca.MX]
    parameters: list[ca.MX]


Expression = Callable[[Symbols], ca.MX]
"""Builds a column of rows, or a cost."""


class Draft:
    """Variables, rows and costs as they are collected: numbers at once, expressions when built.

    Programs of one structure have the same expressions, which are built for the first of them only.
    """

    def __init__(self) -> None:
        self._structure: list[Hashable] = []
        self._variables: list[tuple[Array, Array, Array]] = []
        self._parameters: list[Array] = []
        self._ranges: list[tuple[Array, Array]] = []
        self._rows: list[Expression] = []
        self._costs: list[Expression] = []

    def structure(self, *parts: Hashable | NDArray[Any]) -> None:
        """Note what expressions depend on besides variables and parameters."""
        self._structure += [
            (part.shape, part.tobytes()) if isinstance(part, np.ndarray) else part for part in parts
        ]

    def variables(self, start: Array, lower: Array, upper: Array) -> int:
        """Add a group of variables that start at ``start``; return its index."""
        self._variables.append((start, lower, upper))
        return len(self._variables) - 1

    def parameters(self, values: Array) -> int:
        """Add a vector of parameters; return its index."""
        self._parameters.append(values)
        return len(self._parameters) - 1

    def cost(self, expression: Expression) -> None:
        """Add a cost."""
        self._costs.append(expression)

    def bound(self, value: Expression, least: Array, most: Array) -> None:
        """Add rows (a column) that keep values between their bounds (rows,)."""
        self._rows.append(value)
        self._ranges.append((least, most))

    def soft_bound(self, value: Expression, least: Array, now: Array, weight: float) -> None:
        """Add rows that keep values (a column) above their bounds, softly where they are not now.

        Parameters
        ----------
        value, least, now: (rows,), now where the variables start.
        weight: penalty weight of a unit by which a value stays below.
        """
        short, most = np.flatnonzero(now < least), np.full(len(least), np.inf)
        self.structure("soft", len(least), short, weight)
        count = len(short)
        if not count:
            self.bound(value, least, most)
            return
        lack = (least - now)[short]
        slack = self.variables(lack, np.zeros(count), np.full(count, np.inf))
        ones = (short.tolist(), list(range(count)), ca.DM.ones(count))

        def eased(at: Symbols) -> ca.MX:
            return value(at) + ca.DM.triplet(*ones, len(least), count) @ at.variables[slack]

        self.cost(lambda at: weight * ca.sum1(at.variables[slack]))
        self.bound(eased, least, most)

    def program(self) -> Program:
        """Return what was collected."""
        box, ranges = zip(*self._variables, strict=True), zip(*self._ranges, strict=True)
        columns = [np.concatenate(column) for column in (*box, *ranges)]
        numbers = dict(zip(("x0", "lbx", "ubx", "lbg", "ubg"), columns, strict=True))
        numbers["p"] = np.concatenate([np.zeros(0), *self._parameters])
        groups = [len(start) for start, *_ in self._variables]
        vectors = [len(values) for values in self._parameters]
        structure = (*self._structure, tuple(groups), tuple(vectors), len(columns[-1]))
        return Program(structure, numbers, groups, vectors, self._rows, self._costs)


@dataclass(frozen=True, eq=False)
class Program:
    """``min f(x, p)`` over ``lbx ≤ x ≤ ubx`` and ``lbg ≤ g(x, p) ≤ ubg``, from x0.

    Attributes
    ----------
    structure: programs with equal ones differ in their numbers alone.
    numbers: ``x0``, ``lbx``, ``ubx`` (variables,), ``lbg``, ``ubg`` (rows,), ``p`` (parameters,).
    groups, vectors: sizes of the groups of variables and of the vectors of parameters.
    rows, costs: builders of the expressions.
    """

    structure: tuple[Hashable, ...]
    numbers: dict[str, Array]
    groups: list[int]
    vectors: list[int]
    rows: list[Expression]
    costs: list[Expression]

    def expressions(self) -> dict[str, ca.MX]:
        """Build casadi's expressions x, p, f, g."""
        x, p = (
            [ca.MX.sym(f"{name}{i}", size) for i, size in enumerate(sizes)]
            for name, sizes in (("x", self.groups), ("p", self.vectors))
        )
        at = Symbols(x, p)
        f = sum((cost(at) for cost in self.costs), ca.MX(0.0))
        g = ca.vertcat(*(rows(at) for rows in self.rows))
        return {"x": ca.vertcat(*x), "p": ca.vertcat(*p), "f": f, "g": g}


def tie_drones(draft: Draft, x: int, path: KnotPath) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner.

    Parameters
    ----------
    x: the variables of the inner knots.
    """
    layout, n, team, inner = path.columns, path.team.robots, path.team, path.steps - 1
    columns = n * inner
    lifted = np.column_stack([layout.drones.reshape(n, 4), layout.r_legs])
    around = np.concatenate([np.roll(layout.vertices, -k, axis=0) for k in (-1, 0, 1, 2)], axis=1)
    pulls = np.stack([np.roll(layout.tensions, -k) for k in (-1, 0, 1)], axis=1)
    rolled, equal = team.loaded or path.roll is not None, bool(np.ptp(team.tension) == 0.0)
    own: tuple[Array, ...]
    if rolled:
        legs, own = layout.q_legs[team.layout.neighbours], _clasp_numbers(path)
        planar = loaded_planar_function(team.cable_density > 0.0)
    else:
        legs, own = layout.q_legs[:, None], (np.tile(team.cable_length, inner)[None],)
        planar = planar_function(equal)
    draft.structure("tied", n, inner, rolled, equal, *own)

    def tied(at: Symbols) -> ca.MX:
        knots = ca.reshape(at.variables[x], layout.size, inner)

        def gathered(places: NDArray[np.intp]) -> ca.MX:
            """Return (width, n · inner) of places (n, width)."""
            return ca.reshape(knots[places.ravel().tolist(), :], places.shape[1], columns)

        moved = (gathered(around), gathered(legs), gathered(pulls))
        place, turn = planar.map(columns)(*moved, *own)
        return ca.vertcat(ca.vec(place - gathered(lifted)), ca.vec(turn))

    sharpest = min(np.min(ConvexPolygon(path.polygons[end]).exterior_angles) for end in (0, -1))
    flattest = math.sin(min(FLATTEST, 0.5 * float(sharpest)))
    zeros, corners = np.zeros(lifted.size * inner), np.full(columns, flattest)
    least, most = (np.append(zeros, end) for end in (corners, np.full(columns, np.inf)))
    draft.bound(tied, least, most)


def _clasp_numbers(path: KnotPath) -> tuple[Array, ...]:
    """Return cables' lengths, rolls, loads and weights of all robots at the inner knots."""
    team, n, inner = path.team, path.team.robots, path.steps - 1
    columns, ends = n * inner, np.column_stack([team.layout.starts, team.layout.ends])
    roll = np.zeros((inner, n)) if path.roll is None else path.roll[1:-1]
    loads = np.zeros((n, 2, 3))
    loads[..., 2] = -GRAVITY * team.load[ends]
    return (
        np.tile(team.cable_length[team.layout.neighbours[:, :2]].T, inner),
        roll[:, ends].reshape(columns, 2).T,
        np.tile(loads.reshape(n, 6).T, inner),
        np.full((1, columns), GRAVITY * team.cable_density),
    )


def keep_apart(draft: Draft, x: int, path: KnotPath, search: Search, step: SolverStep) -> None:
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
        _keep_drones_apart(draft, x, path, drones)
    linear = [rows_at_knots(path, pairs.chosen(pairs.kind != SEPARATION))]
    if step.parts > 1:
        linear.append(rows_between(path, search, step.parts, BETWEEN * step.reach))
    for found in linear:
        if len(found.least):
            value = linear_value(draft, x, found.rows)
            draft.soft_bound(value, found.least, found.rows @ now, PENALTY_WEIGHT)


def _keep_drones_apart(draft: Draft, x: int, path: KnotPath, drones: NearPairs) -> None:
    """Keep pairs of drones apart, by squares."""
    columns, now = path.columns, path.table[1:-1].ravel()
    first, second = (
        columns.size * drones.frame[:, None] + columns.nodes[node[:, 0]]
        for node in (drones.first, drones.second)
    )
    squared = np.sum((now[first] - now[second]) ** 2, axis=1)
    apart = drones.enforced
    scale = 1.0 / (2.0 * apart)  # of squares to about metres
    scales = draft.parameters(scale)
    draft.structure("drones", first, second)

    def value(at: Symbols) -> ca.MX:
        moved = at.variables[x]
        across, along = (moved[first[:, i].tolist()] - moved[second[:, i].tolist()] for i in (0, 1))
        return (across**2 + along**2) * at.parameters[scales]

    draft.soft_bound(value, scale * apart**2, scale * squared, PENALTY_WEIGHT)


def linear_value(draft: Draft, x: int, rows: sparse.csc_matrix) -> Expression:
    """Return rows times variables, the rows' entries being parameters."""
    entries = draft.parameters(rows.data)
    draft.structure("linear", rows.shape, rows.indptr, rows.indices)

    def value(at: Symbols) -> ca.MX:
        pattern = ca.Sparsity(*rows.shape, rows.indptr.tolist(), rows.indices.tolist())
        return ca.MX(pattern, at.parameters[entries]) @ at.variables[x]

    return value
