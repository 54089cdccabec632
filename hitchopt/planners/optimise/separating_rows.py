"""Pairs of bodies that come near on a path, and linear rows that keep them apart and legs long."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import differences, shortest_offset
from hitchopt.hitch.parts import Parts, end_combinations
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.search_task import Search
from hitchopt.requirements import Separation
from hitchopt.values import Array, Indices

FINER = 4
"""Factor on the instants in the first and the last step, where a hitch starts or ends that barely
satisfies its limits."""

LEG_INSET = 1e-3
"""[m] Distance of legs from their limit, unless they are shorter at the ends."""

LEG_REACH = 0.05
"""[m] Legs longer than their limit and this get no row."""


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


def near_pairs(nodes: Array, separation: Separation, margins: Array, reach: float) -> NearPairs:
    """Return all pairs that come within ``reach`` [m] of the distance to enforce.

    Parameters
    ----------
    nodes: (K, 3n, 2) [m]
    separation: distances to enforce.
    margins: (K,), how many times those.
    reach: [m]
    """
    parts = Parts.of(nodes.shape[1] // 3)
    limits = np.array([2.0 * separation.radius, separation.cable, separation.crossing])
    corners = nodes[:, parts.nodes]
    cutoff = float(np.max(limits * np.max(margins))) + reach
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
    return found.chosen(distance < enforced + reach)


@dataclass(frozen=True, eq=False)
class LinearRows:
    """``rows @ x ≥ least`` over the inner knots' variables in a row.

    Attributes
    ----------
    rows: (r, variables)
    least: (r,) [m]
    """

    rows: sparse.csc_matrix
    least: Array


def instants(steps: int, parts: int) -> Array:
    """Return (K,): the instants between the knots that get rows, in steps from the start."""
    base = FINER * parts
    k = np.arange(steps * base)
    at_ends = (k < base) | (k > (steps - 1) * base)
    places: Array = k[(k % base > 0) & (at_ends | (k % FINER == 0))] / base
    return places


def rows_at_knots(path: KnotPath, pairs: NearPairs) -> LinearRows:
    """Return rows that keep pairs at the inner knots on their sides of their normals."""
    table = path.table
    return _pairs_apart(path, table[1:-1], np.arange(1.0, path.steps), pairs)


def rows_between(path: KnotPath, search: Search, parts: int, reach: float) -> LinearRows:
    """Return rows that keep pairs apart and legs long between the knots, to first order.

    There the path is its chord from knot to knot and a bow, of which the bow is taken to stay.

    Parameters
    ----------
    path, search: around which the rows are, and what they enforce.
    parts: of each step; rows are at the instants in between.
    reach: pairs farther apart than their limit and this [m] get no row.
    """
    columns, limits = path.columns, search.requirements.limits
    places = instants(path.steps, parts)
    at_knots, there = path.table, path.at(places / path.steps).table
    margins = search.margins(path.steps, places)
    separation = search.requirements.separation
    pairs = near_pairs(there[:, columns.nodes], separation, margins, reach)
    apart = _pairs_apart(path, there, places, pairs)

    legs = np.concatenate([columns.q_legs, columns.r_legs])
    frame, leg = np.nonzero(there[:, legs] < limits.leg + LEG_REACH)
    if not len(frame):
        return apart
    single = (frame, legs[leg][:, None], np.ones((len(frame), 1)))
    rows, bow = _chords(at_knots, there, places, single)
    ends = np.min(at_knots[[0, -1]][:, legs], axis=0)
    shortest = np.minimum(limits.leg + LEG_INSET, ends)[leg]
    both = sparse.csc_matrix(sparse.vstack([apart.rows, rows]))
    return LinearRows(both, np.concatenate([apart.least, shortest - bow]))


def _pairs_apart(path: KnotPath, there: Array, places: Array, pairs: NearPairs) -> LinearRows:
    """Return the rows of pairs at places (K,) of a path, its table (K, size) ``there``."""
    nodes = path.columns.nodes
    pair, a, b = pairs.sides()
    slopes = np.concatenate([pairs.normal[pair], -pairs.normal[pair]], axis=1)
    sums = (pairs.frame[pair], np.concatenate([nodes[a], nodes[b]], axis=1), slopes)
    rows, bow = _chords(path.table, there, places, sums)
    return LinearRows(rows, pairs.enforced[pair] - bow)


def _chords(
    at_knots: Array, there: Array, places: Array, sums: tuple[Indices, Indices, Array]
) -> tuple[sparse.csc_matrix, Array]:
    """Return sums of variables at places, by those at the knots around: ``rows @ x + bow``.

    Parameters
    ----------
    at_knots, there: (J + 1, size) and (K, size), tables of the path.
    places: (K,), in steps from the path's start.
    sums: the place (r,), the variables and their weights (r, w) of each.
    """
    frame, variables, weights = sums
    steps, size = len(at_knots) - 1, at_knots.shape[1]
    shape = (len(frame), size * (steps - 1))
    if not len(frame):
        return sparse.csc_matrix(shape), np.zeros(0)
    knot = places[frame].astype(np.intp)
    share = places[frame] - knot
    bow = np.sum(weights * there[frame[:, None], variables], axis=1)
    entries: list[tuple[Array, Indices, Indices]] = []
    for at, part in ((knot, 1.0 - share), (knot + 1, share)):
        inner = np.flatnonzero((at > 0) & (at < steps) & (part > 0.0))
        slope, own = part[inner, None] * weights[inner], variables[inner]
        bow[inner] -= np.sum(slope * at_knots[at[inner, None], own], axis=1)
        column = size * (at[inner, None] - 1) + own
        entries.append((slope.ravel(), np.repeat(inner, own.shape[1]), column.ravel()))
    values, row, column = (np.concatenate(part) for part in zip(*entries, strict=True))
    return sparse.csc_matrix((values, (row, column)), shape=shape), bow
