"""Distances between the knots: rows on pairs that come near one another while no knot looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.planners.optimise.bounds import Bounds
from hitchopt.planners.optimise.layout import Layout
from hitchopt.planners.optimise.pairs import near_pairs
from hitchopt.planners.optimise.way import Way

Array = NDArray[np.float64]

FINER = 4
"""Times as many instants in the first and the last step, where a hitch that keeps its limits by a
hair is left or reached."""


@dataclass(frozen=True, eq=False)
class BetweenRows:
    """``rows @ x ≥ least`` over the inner knots' variables in a row.

    Attributes
    ----------
    rows: (r, variables)
    least: (r,) [m]
    """

    rows: sparse.csc_matrix
    least: Array


def instants(steps: int, parts: int) -> Array:
    """Return (K,) where between its knots a way is looked at, in steps from its start."""
    base = FINER * parts
    k = np.arange(steps * base)
    at_ends = (k < base) | (k > (steps - 1) * base)
    places: Array = k[(k % base > 0) & (at_ends | (k % FINER == 0))] / base
    return places


def between_rows(way: Way, bounds: Bounds, places: Array, reach: float) -> BetweenRows:
    """Return rows that keep pairs apart between the knots, to first order in the way's change.

    There the way is its chord from knot to knot and a bow, of which the bow is taken to stay.

    Parameters
    ----------
    way, bounds: around which the rows are, and what they keep.
    places: (K,), where, in steps from the way's start; none of them at a knot.
    reach: pairs farther apart than their limit and this [m] are let go.
    """
    layout, steps = Layout(way.team.robots), len(way.polygons) - 1
    at_knots = layout.table(way)[:, layout.nodes]
    nodes = layout.table(way.at(places / steps))[:, layout.nodes]
    pairs = near_pairs(nodes, bounds.separation, bounds.margins(steps, places), reach)
    pair, a, b = pairs.sides()
    normal, frame = pairs.normal[pair], pairs.frame[pair]
    knot = places[frame].astype(np.intp)
    share = places[frame] - knot

    least = pairs.kept[pair] - np.sum(normal * (nodes[frame, a] - nodes[frame, b]), axis=1)
    row = np.arange(len(pair))
    entries: list[Array] = []
    rows: list[NDArray[np.intp]] = []
    columns: list[NDArray[np.intp]] = []
    for at, weight in ((knot, 1.0 - share), (knot + 1, share)):
        slope = weight[:, None] * normal
        least += np.sum(slope * (at_knots[at, a] - at_knots[at, b]), axis=1)
        fixed = (at == 0) | (at == steps)
        for node, sign in ((a, 1.0), (b, -1.0)):
            least[fixed] -= np.sum(sign * slope * at_knots[at, node], axis=1)[fixed]
            variables = layout.size * (at[:, None] - 1) + layout.nodes[node]
            entries.append((sign * slope)[~fixed].ravel())
            rows.append(np.repeat(row[~fixed], 2))
            columns.append(variables[~fixed].ravel())
    matrix = sparse.csc_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
        shape=(len(pair), layout.size * (steps - 1)),
    )
    return BetweenRows(matrix, least)
