"""Smallest and largest values by compiled code, where that is on and knows the bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hitchopt.compiled.kernel_switch import kernels_on, writable
from hitchopt.trajectory import bernstein, enclosure, extremum
from hitchopt.trajectory.enclosure import DIRECTION_ORDER, NORM_ORDER, Enclosure
from hitchopt.trajectory.extremum import Bound, Cells, Estimate, Extremum, First
from hitchopt.values import Array, Indices

MOST = 24
"""Largest degree of a block that is compiled."""

HUGE = 1e60
"""Numbers below this have products that do not overflow."""

BLOCKS = 4
"""Number of blocks that compiled code takes."""

DIRECTIONS = 4096
"""Directions enclosed in one go, so that what that allocates stays within the caches."""

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
    absolute: largest gap of a largest value to an attained one, as of a Search.
    """

    kind: str
    blocks: int = 1
    noise: float = 0.0
    short: float = 0.0
    rounding: float = 0.0
    absolute: float = extremum.ABSOLUTE


@dataclass(frozen=True, eq=False)
class Directions:
    """Enclosed directions, of which given cells take one or some.

    Attributes
    ----------
    coefficients: (m, 3, degree + 1)
    radius: (m,)
    place: (cells,) or (cells, k), the indices of each cell's.
    """

    coefficients: Array
    radius: Array
    place: Indices

    def placed(self, place: Indices) -> Directions:
        """Return the same directions for other cells."""
        return replace(self, place=place)

    def taken(self, part: slice = slice(None)) -> Enclosure:
        """Return those of some cells."""
        place = self.place[part]
        return Enclosure(self.coefficients[place], self.radius[place])


def enclosed_directions(vectors: Array, noise: float) -> Directions:
    """Enclose the directions of vectors (m, 3, degree + 1), as ``enclosure.direction`` does."""
    place = np.arange(len(vectors))
    if kernels_on() and vectors.shape[-1] <= MOST + 1 and np.max(np.abs(vectors)) < HUGE:
        from hitchopt.compiled.enclosure_kernels import directions

        weights = interpolation_weights(bernstein.degree(vectors), DIRECTION_ORDER)
        return Directions(*directions(writable(vectors), weights, noise), place)
    order = bernstein.degree(vectors) + DIRECTION_ORDER
    coefficients, radius = np.empty((len(place), 3, order + 1)), np.empty(len(place))
    with np.errstate(all="ignore"):  # coefficients may be anything
        for first in range(0, len(place), DIRECTIONS):
            part = slice(first, first + DIRECTIONS)
            found = enclosure.direction(vectors[part], noise)
            coefficients[part], radius[part] = found.coefficients, found.radius
    return Directions(coefficients, radius, place)


NOTHING = Directions(np.empty((0, 3, 1)), np.empty(0), np.empty((0, 1), dtype=np.intp))
"""No directions."""


def smallest(cells: Cells, bound: Bound, known: KnownBound, target: float = -np.inf) -> Extremum:
    """Return what ``extremum.smallest`` does."""
    found = _compiled(cells, known, 1.0, target)
    return extremum.smallest(cells, bound, target) if found is None else found


def largest(
    cells: Cells,
    bound: Callable[..., Estimate],
    known: KnownBound,
    target: float = np.inf,
    directions: Callable[[], Directions] | None = None,
) -> Extremum:
    """Return what ``extremum.largest`` does.

    Parameters
    ----------
    cells, target: as there.
    bound: takes the blocks of cells, and where directions are known, these as ``along``.
    known: the same for compiled code.
    directions: returns those that the given cells need, where other checks need them as well.
    """
    found = _compiled(cells, known, -1.0, -target, directions)
    if found is not None:
        return found
    first: First | None = None
    if directions is not None:
        along = directions()

        def first(part: slice) -> Estimate:
            return bound(tuple(block[part] for block in cells.blocks), along=along.taken(part))

    return extremum.largest(cells, bound, target, first, known.absolute)


def _compiled(
    cells: Cells,
    known: KnownBound,
    sign: float,
    target: float,
    directions: Callable[[], Directions] | None = None,
) -> Extremum | None:
    """Return the extremum, the sign and the target being those of a smallest value."""
    if not kernels_on() or not 0 < len(cells) <= extremum.BATCH:
        return None
    if len(cells.blocks) != known.blocks:
        return None
    from hitchopt.compiled import search_kernel

    blocks = compiled_blocks(cells)
    if blocks is None:
        return None
    if len(blocks) < BLOCKS:
        blocks += [np.empty((len(cells), 0, 1))] * (BLOCKS - len(blocks))
    order = NORM_ORDER if known.kind == LENGTHS else DIRECTION_ORDER
    row = 1 if known.kind in ("thrust", "tilt") else 0
    along = NOTHING if directions is None else directions()
    each = 1 if along.place.ndim == 1 else along.place.shape[1]
    worst, value, item, time = search_kernel.search(
        search_kernel.KINDS[known.kind],
        sign,
        (blocks[0], blocks[1], blocks[2], blocks[3]),
        interpolation_weights(bernstein.degree(blocks[row]), order),
        (along.coefficients, along.radius, along.place.reshape(len(along.place), each)),
        (float(known.noise), known.short, known.rounding),
        cells.item,
        (cells.start, cells.end, cells.margin),
        (extremum.RELATIVE, known.absolute, float(target), HUGE),
        (extremum.MAX_HALVINGS, extremum.MAX_CELLS),
    )
    return None if item < 0 else Extremum(sign * worst, sign * value, int(item), time)


def compiled_blocks(cells: Cells) -> list[Array] | None:
    """Return blocks as compiled code takes them, or None of high degrees."""
    if max(block.shape[-1] for block in cells.blocks) > MOST + 1:
        return None
    return [writable(block) for block in cells.blocks]


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
