"""Smallest and largest values by compiled code, where that is on and knows the bound."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hitchopt.compiled.kernel_switch import kernels_on
from hitchopt.trajectory import bernstein, extremum
from hitchopt.trajectory.enclosure import DIRECTION_ORDER, NORM_ORDER
from hitchopt.trajectory.extremum import Bound, Cells, Extremum, First
from hitchopt.values import Array

MOST = 24
"""Largest degree of a block that is compiled."""

HUGE = 1e60
"""Numbers below this have products that do not overflow."""

BLOCKS = 4
"""Number of blocks that compiled code takes."""

LENGTHS = "lengths"
"""Kind of the bound that encloses lengths rather than directions."""


@dataclass(frozen=True)
class KnownBound:
    """A bound that compiled code has as well.

    Attributes
    ----------
    kind: its name in ``hitchopt.compiled.search_kernel``.
    blocks: number of blocks that it takes; cells with others are left to numpy.
    noise: of positions [m].
    short: vectors this short have no direction [m].
    rounding: relative.
    """

    kind: str
    blocks: int = 1
    noise: float = 0.0
    short: float = 0.0
    rounding: float = 0.0


def smallest(cells: Cells, bound: Bound, known: KnownBound, target: float = -np.inf) -> Extremum:
    """Return what ``extremum.smallest`` does."""
    found = _compiled(cells, known, 1.0, target)
    return extremum.smallest(cells, bound, target) if found is None else found


def largest(
    cells: Cells,
    bound: Bound,
    known: KnownBound,
    target: float = np.inf,
    first: First | None = None,
) -> Extremum:
    """Return what ``extremum.largest`` does."""
    found = _compiled(cells, known, -1.0, -target)
    return extremum.largest(cells, bound, target, first) if found is None else found


def _compiled(cells: Cells, known: KnownBound, sign: float, target: float) -> Extremum | None:
    """Return the extremum, the sign and the target being those of a smallest value."""
    if not kernels_on() or not 0 < len(cells) <= extremum.BATCH:
        return None
    if len(cells.blocks) != known.blocks:
        return None
    from hitchopt.compiled import search_kernel

    blocks = compiled_blocks(cells)
    if blocks is None:
        return None
    blocks += [np.empty((len(cells), 0, 1))] * (BLOCKS - len(blocks))
    order = NORM_ORDER if known.kind == LENGTHS else DIRECTION_ORDER
    row = 1 if known.kind in ("thrust", "tilt") else 0
    worst, value, item, time = search_kernel.search(
        search_kernel.KINDS[known.kind],
        sign,
        (blocks[0], blocks[1], blocks[2], blocks[3]),
        interpolation_weights(bernstein.degree(blocks[row]), order),
        np.array([known.noise, known.short, known.rounding]),
        cells.item,
        np.array([cells.start, cells.end, cells.margin]),
        np.array([extremum.RELATIVE, extremum.ABSOLUTE, target, HUGE]),
        (extremum.MAX_HALVINGS, extremum.MAX_CELLS),
    )
    return None if item < 0 else Extremum(sign * worst, sign * value, int(item), time)


def compiled_blocks(cells: Cells) -> list[Array] | None:
    """Return blocks as compiled code takes them, or None of high degrees."""
    if max(block.shape[-1] for block in cells.blocks) > MOST + 1:
        return None
    return [np.array(block, order="C") for block in cells.blocks]


@lru_cache
def interpolation_weights(degree: int, order: int) -> Array:
    """Return the weights of a polynomial's values at nodes, then of those through the nodes.

    Parameters
    ----------
    degree: of the polynomial.
    order: of the one through the nodes, as of ``bernstein.interpolate``.

    Returns
    -------
    (degree + 1 + order + 1, order + 1)
    """
    at = bernstein.basis(bernstein.nodes(order), degree)
    through = bernstein.interpolate(np.eye(order + 1))
    return np.concatenate([at.T, through])
