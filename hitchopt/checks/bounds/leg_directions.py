"""Directions of legs and edges on whole pieces, enclosed once for all checks that need them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hitchopt.checks.bounds.bodies import LAYOUTS, edge_vectors, pull_vectors
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.shared_values import once
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.compiled_search import Directions, enclosed_directions
from hitchopt.values import Indices


def drone_directions(motion: Motion) -> Directions:
    """Enclose the directions of ``pull_vectors``, of every piece and drone in a row."""
    return once(motion, _directions).placed(_drone_places(motion.drones.pieces, motion.team.layout))


def clasp_directions(motion: Motion) -> Directions:
    """Enclose the four directions that meet at a clasp, of every piece and clasp in a row.

    They are those of its own leg and edge, and of the leg and the edge before.
    """
    return once(motion, _directions).placed(_clasp_places(motion.drones.pieces, motion.team.layout))


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
    return enclosed_directions(vectors, position_margin(motion))
