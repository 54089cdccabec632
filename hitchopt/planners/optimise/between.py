"""Between the knots: rows on pairs that come near one another, and on legs that get short there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.pairs import near_pairs
from hitchopt.planners.optimise.variable_bounds import Bounds
from hitchopt.planners.optimise.variables import Layout

Array = NDArray[np.float64]
Index = NDArray[np.intp]

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


LEG_INSET = 1e-3
"""[m] By which legs are longer than their limit, or as long as at the ends."""

LEG_REACH = 0.05
"""[m] Legs longer than their limit and this are let go."""


def instants(steps: int, parts: int) -> Array:
    """Return (K,) where between its knots a way is looked at, in steps from its start."""
    base = FINER * parts
    k = np.arange(steps * base)
    at_ends = (k < base) | (k > (steps - 1) * base)
    places: Array = k[(k % base > 0) & (at_ends | (k % FINER == 0))] / base
    return places


def between_rows(way: Way, bounds: Bounds, places: Array, reach: float) -> BetweenRows:
    """Return rows that keep pairs apart and legs long between the knots, to first order.

    There the way is its chord from knot to knot and a bow, of which the bow is taken to stay.

    Parameters
    ----------
    way, bounds: around which the rows are, and what they keep.
    places: (K,), where, in steps from the way's start; none of them at a knot.
    reach: pairs farther apart than their limit and this [m] are let go.
    """
    layout, steps = Layout(way.team.robots), len(way.polygons) - 1
    at_knots, there = layout.table(way), layout.table(way.at(places / steps))
    margins = bounds.margins(steps, places)
    pairs = near_pairs(there[:, layout.nodes], bounds.requirements.separation, margins, reach)
    pair, a, b = pairs.sides()
    slopes = np.concatenate([pairs.normal[pair], -pairs.normal[pair]], axis=1)
    variables = np.concatenate([layout.nodes[a], layout.nodes[b]], axis=1)
    apart = _between(at_knots, there, places, (pairs.frame[pair], variables, slopes))

    legs = np.concatenate([layout.q_legs, layout.r_legs])
    short = there[:, legs] < bounds.requirements.limits.leg + LEG_REACH
    frame, leg = np.nonzero(short)
    single = (frame, legs[leg][:, None], np.ones((len(frame), 1)))
    long = _between(at_knots, there, places, single)
    ends = np.min(at_knots[[0, -1]][:, legs], axis=0)
    shortest = np.minimum(bounds.requirements.limits.leg + LEG_INSET, ends)[leg]
    least = np.concatenate([pairs.kept[pair] - apart.bow, shortest - long.bow])
    return BetweenRows(sparse.csc_matrix(sparse.vstack([apart.rows, long.rows])), least)


@dataclass(frozen=True, eq=False)
class _Chords:
    """Sums of variables between the knots: ``rows @ x + bow``."""

    rows: sparse.csc_matrix
    bow: Array


def _between(
    at_knots: Array, there: Array, places: Array, sums: tuple[Index, Index, Array]
) -> _Chords:
    """Return sums of variables at places, by those at the knots around.

    Parameters
    ----------
    at_knots, there: (J + 1, size) and (K, size), tables of the way.
    places: (K,), in steps from the way's start.
    sums: the place (r,), the variables and their weights (r, w) of each.
    """
    frame, variables, weights = sums
    steps, size = len(at_knots) - 1, at_knots.shape[1]
    knot = places[frame].astype(np.intp)
    share = places[frame] - knot
    bow = np.sum(weights * there[frame[:, None], variables], axis=1)
    entries: list[Array] = []
    rows: list[Index] = []
    columns: list[Index] = []
    for at, part in ((knot, 1.0 - share), (knot + 1, share)):
        slope = part[:, None] * weights
        inner = np.flatnonzero((at > 0) & (at < steps))
        own = variables[inner]
        bow[inner] -= np.sum(slope[inner] * at_knots[at[inner, None], own], axis=1)
        entries.append(slope[inner].ravel())
        rows.append(np.repeat(inner, variables.shape[1]))
        columns.append((size * (at[inner, None] - 1) + own).ravel())
    matrix = sparse.csc_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
        shape=(len(frame), size * (steps - 1)),
    )
    return _Chords(matrix, bow)
