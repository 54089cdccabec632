"""A program as it is put together: variables, costs, rows that keep near bodies apart."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import differences, shortest_offset
from hitchopt.hitch.parts import SEPARATION, Parts, end_combinations
from hitchopt.hitch.requirements import Separation
from hitchopt.planners.optimise.knots import KnotPath, Search, SolverStep
from hitchopt.values import Array, Indices

PENALTY_WEIGHT = 100.0
"""[1/m] Penalty weight of bodies that stay too near: more than any path gains by leaving them."""

BETWEEN = 0.4
"""Share of a step's reach within which pairs get rows between the knots: the knots keep them apart
otherwise."""


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
        groups = (("x", self.groups), ("p", self.vectors))
        variables, parameters = (
            [ca.MX.sym(f"{name}{i}", size) for i, size in enumerate(sizes)]
            for name, sizes in groups
        )
        at = Symbols(variables, parameters)
        g = ca.vertcat(*(build(at) for build in self.rows))
        f = sum((cost(at) for cost in self.costs), ca.MX(0.0))
        return {"x": ca.vertcat(*variables), "p": ca.vertcat(*parameters), "f": f, "g": g}


def keep_apart(draft: Draft, x: int, path: KnotPath, search: Search, step: SolverStep) -> None:
    """Keep all near pairs apart: drones at the knots by squares, all others by their normals.

    Between the knots the path is its chord from knot to knot and a bow, which is taken to stay.
    Those that are too near now, as in a first guess, are parted as far as a step can.
    """
    columns, inner, parts = path.columns, path.table[1:-1], step.parts
    places = np.arange(1, parts * path.steps) / parts
    there = path.table[1:-1] if parts == 1 else path.at(places / path.steps).table
    at_knot = places % 1.0 == 0.0
    margins = search.margins(path.steps, places)
    reach = np.where(at_knot, 1.0, BETWEEN) * step.reach
    separation = search.requirements.separation
    pairs = near_pairs(there[:, columns.nodes], separation, margins, reach)
    by_squares = (pairs.kind == SEPARATION) & at_knot[pairs.frame]
    if np.any(by_squares):
        _keep_drones_apart(draft, x, path, pairs.chosen(by_squares), parts)
    others = pairs.chosen(~by_squares)
    if not len(others.frame):
        return
    pair, *ends = others.sides()
    nodes = np.concatenate([columns.nodes[end] for end in ends], axis=1)
    slopes = np.concatenate([others.normal[pair], -others.normal[pair]], axis=1)
    entries = (slopes.ravel(), (columns.size * others.frame[pair, None] + nodes).ravel())
    sums = sparse.csr_matrix((*entries, 4 * np.arange(len(pair) + 1)), (len(pair), there.size))
    share = np.maximum(1.0 - np.abs(places[:, None] - np.arange(1.0, path.steps)), 0.0)
    rows = sparse.csc_matrix(sums @ sparse.kron(share, sparse.eye(columns.size), "csr"))
    now = rows @ inner.ravel()
    bow = sums @ there.ravel() - now
    least = others.enforced[pair] - bow
    draft.soft_bound(linear_value(draft, x, rows), least, now, PENALTY_WEIGHT)


def _keep_drones_apart(draft: Draft, x: int, path: KnotPath, drones: NearPairs, parts: int) -> None:
    """Keep pairs of drones apart at knots, by squares."""
    columns, now = path.columns, path.table[1:-1].ravel()
    knot = drones.frame[:, None] // parts
    first, second = (
        columns.size * knot + columns.nodes[node[:, 0]] for node in (drones.first, drones.second)
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


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Pairs of bodies that come near one another, each at one of K instants.

    Attributes
    ----------
    frame: (m,), the instant.
    first, second: (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same.
    kind: (m,), as in ``hitch.parts``.
    normal: (m, 2), unit vector from the second body to the first where they are closest.
    enforced: (m,) [m], the distance to enforce.
    """

    frame: Indices
    first: Indices
    second: Indices
    kind: Indices
    normal: Array
    enforced: Array

    def chosen(self, which: NDArray[np.bool_]) -> NearPairs:
        """Return the pairs where ``which`` (m,) holds."""
        return NearPairs(*(getattr(self, field.name)[which] for field in fields(self)))

    def sides(self) -> tuple[Indices, Indices, Indices]:
        """Return (pair, node of the first, node of the second) of all their ends against all.

        Bodies whose ends all lie on their sides of a normal are apart by as much.
        """
        return end_combinations(self.kind, self.first, self.second)


def near_pairs(nodes: Array, separation: Separation, margins: Array, reach: Array) -> NearPairs:
    """Return all pairs that come within ``reach`` of the distance to enforce.

    Parameters
    ----------
    nodes: (K, 3n, 2) [m]
    separation: distances to enforce.
    margins: (K,), how many times those.
    reach: (K,) [m]
    """
    parts = Parts.of(nodes.shape[1] // 3)
    limits = np.array([2.0 * separation.radius, separation.cable, separation.crossing])
    corners = nodes[:, parts.nodes]
    cutoff = float(np.max(limits * np.max(margins)) + np.max(reach))
    boxes = corners.min(axis=2), corners.max(axis=2)
    frame, i, j, kind = parts.near(*boxes, limits, cutoff)
    ends = [nodes[frame[:, None], parts.nodes[body]] for body in (i, j)]
    offset = shortest_offset(differences(*ends))
    distance = np.linalg.norm(offset, axis=1)
    middle = (ends[0] - ends[1]).mean(axis=1)
    normal = np.where(distance[:, None] > 1e-6, offset, middle)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    enforced = limits[kind] * margins[frame]
    found = NearPairs(frame, parts.nodes[i], parts.nodes[j], kind, normal, enforced)
    return found.chosen(distance < enforced + reach[frame])
