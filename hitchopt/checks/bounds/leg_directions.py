"""Directions of legs and edges on whole pieces, enclosed once for all checks that need them."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.bodies import edge_vectors, pull_vectors
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.shared_values import once
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.compiled_search import Directions, enclosed_directions
from hitchopt.values import Indices


def drone_directions(motion: Motion) -> Directions:
    """Enclose the directions of ``pull_vectors``, of every piece and drone in a row."""
    items = np.arange(motion.team.drones)
    return once(motion, _directions).placed(_places(motion, items).ravel())


def clasp_directions(motion: Motion) -> Directions:
    """Enclose the four directions that meet at a clasp, of every piece and clasp in a row.

    They are those of its own leg and edge, and of the leg and the edge before.
    """
    layout = motion.team.layout
    ahead, behind, edges = layout.ahead, layout.behind, motion.team.drones
    items = np.stack([2 * ahead, edges + ahead, 2 * behind + 1, edges + behind], axis=1)
    return once(motion, _directions).placed(_places(motion, items).reshape(-1, 4))


def _places(motion: Motion, items: Indices) -> Indices:
    """Return the places (pieces, …) of items of every piece in what ``_directions`` returns."""
    team = motion.team
    count = team.drones + team.robots
    pieces = count * np.arange(motion.drones.pieces).reshape(-1, *(1,) * items.ndim)
    found: Indices = pieces + items
    return found


def _directions(motion: Motion) -> Directions:
    """Return the directions of all legs, then all edges, piece by piece in a row."""
    vectors = np.concatenate([pull_vectors(motion), edge_vectors(motion)], axis=1)
    vectors = vectors.reshape(-1, *vectors.shape[2:])
    return enclosed_directions(vectors, position_margin(motion))
