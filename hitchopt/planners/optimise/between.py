"""Distances between the knots: rows on pairs that come near one another while no knot looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.hitch import Separation
from hitchopt.planners.optimise.layout import Layout
from hitchopt.planners.optimise.pairs import near_pairs

Array = NDArray[np.float64]


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


def between_rows(
    layout: Layout,
    tables: tuple[Array, Array],
    separation: Separation,
    margins: Array,
    reach: float,
) -> BetweenRows:
    """Return rows that keep pairs apart between the knots, to first order in the way's change.

    There the way is its chord from knot to knot and a bow, of which the bow is taken to stay.

    Parameters
    ----------
    layout: of the variables.
    tables: the way at its knots (J + 1, size), and at ``P J + 1`` instants (P J + 1, size).
    separation: distances to keep.
    margins: (P J + 1,), how many times those, at every instant.
    reach: pairs farther apart than their limit and this [m] are let go.
    """
    table, finer = tables
    steps = len(table) - 1
    parts = (len(finer) - 1) // steps
    instants = np.flatnonzero(np.arange(len(finer)) % parts)
    nodes, at_knots = finer[:, layout.nodes], table[:, layout.nodes]
    pairs = near_pairs(nodes[instants], separation, margins[instants], reach)
    pair, a, b = pairs.sides()
    normal, instant = pairs.normal[pair], instants[pairs.frame[pair]]
    knot, share = instant // parts, (instant % parts) / parts

    least = pairs.kept[pair] - np.sum(normal * (nodes[instant, a] - nodes[instant, b]), axis=1)
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
            places = layout.size * (at[:, None] - 1) + layout.nodes[node]
            entries.append((sign * slope)[~fixed].ravel())
            rows.append(np.repeat(row[~fixed], 2))
            columns.append(places[~fixed].ravel())
    matrix = sparse.csc_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
        shape=(len(pair), layout.size * (steps - 1)),
    )
    return BetweenRows(matrix, least)
