"""Directions of legs and edges on whole pieces, enclosed once for all checks that need them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hitchopt.checks.bounds.bodies import LAYOUTS, edge_vectors, pull_vectors
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.shared_values import once
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import enclosure, extremum
from hitchopt.trajectory.enclosure import DIRECTION_ORDER, Enclosure
from hitchopt.trajectory.extremum import ABSOLUTE, Cells, Estimate, Extremum, First
from hitchopt.values import Array, Indices

ENCLOSED = 4096
"""Directions enclosed in one go, so that what that allocates stays within the caches."""


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

    def taken(self, part: slice = slice(None)) -> Enclosure:
        """Return those of some cells."""
        place = self.place[part]
        return Enclosure(self.coefficients[place], self.radius[place])


def largest_along(
    cells: Cells,
    bound: Callable[..., Estimate],
    directions: Directions | None,
    target: float = np.inf,
    absolute: float = ABSOLUTE,
) -> Extremum:
    """Return the largest value over all cells, the directions of the given ones being known.

    Parameters
    ----------
    cells, target, absolute: as of ``extremum.largest``.
    bound: takes the blocks of cells, and directions that are known as ``along``.
    directions: those of the cells; None where they are not known.
    """
    first: First | None = None
    if directions is not None:

        def first(part: slice) -> Estimate:
            return bound(tuple(block[part] for block in cells.blocks), along=directions.taken(part))

    return extremum.largest(cells, bound, target, first, absolute)


def drone_directions(motion: Motion) -> Directions:
    """Enclose the directions of ``pull_vectors``, of every piece and drone in a row."""
    place = _drone_places(motion.drones.pieces, motion.team.layout)
    return replace(once(motion, _directions), place=place)


def clasp_directions(motion: Motion) -> Directions:
    """Enclose the four directions that meet at a clasp, of every piece and clasp in a row.

    They are those of its own leg and edge, and of the leg and the edge before.
    """
    place = _clasp_places(motion.drones.pieces, motion.team.layout)
    return replace(once(motion, _directions), place=place)


@lru_cache(maxsize=LAYOUTS)
def _drone_places(pieces: int, layout: Layout) -> Indices:
    """Return the places (pieces · drones,) of drones in what ``_directions`` returns."""
    return _places(pieces, layout, np.arange(2 * layout.robots)).ravel()


@lru_cache(maxsize=LAYOUTS)
def _clasp_places(pieces: int, layout: Layout) -> Indices:
    """Return the same (pieces · clasps, 4) of what meets at clasps."""
    ahead, behind, edges = layout.ahead, layout.behind, 2 * layout.robots
    items = np.stack([2 * ahead, edges + ahead, 2 * behind + 1, edges + behind], axis=1)
    return _places(pieces, layout, items).reshape(-1, 4)


def _places(pieces: int, layout: Layout, items: Indices) -> Indices:
    """Return the places (pieces, …) of items of every piece."""
    first = 3 * layout.robots * np.arange(pieces).reshape(-1, *(1,) * items.ndim)
    found: Indices = first + items
    return found


def _directions(motion: Motion) -> Directions:
    """Return the directions of all legs, then all edges, piece by piece in a row."""
    vectors = np.concatenate([pull_vectors(motion), edge_vectors(motion)], axis=1)
    vectors = vectors.reshape(-1, *vectors.shape[2:])
    noise, place = position_margin(motion), np.arange(len(vectors))
    order = vectors.shape[-1] - 1 + DIRECTION_ORDER
    coefficients, radius = np.empty((len(place), 3, order + 1)), np.empty(len(place))
    with np.errstate(all="ignore"):  # coefficients may be anything
        for begin in range(0, len(place), ENCLOSED):
            part = slice(begin, begin + ENCLOSED)
            found = enclosure.direction(vectors[part], noise)
            coefficients[part], radius[part] = found.coefficients, found.radius
    return Directions(coefficients, radius, place)
