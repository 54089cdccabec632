"""Which drones fly inside a hanging cable: through the sheet between it and its drones' chord.

A cable that a drone pulls through such a sheet is caught when both come taut, although their chords
need never have met. So a drone has to keep off the sheets of all cables but its own. A sheet is
convex: whatever is on one side of all of its corners is off it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.hanging_links import chains, cut, drone_cable_cells
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.broadphase import Indices
from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, joined_cells
from hitchopt.values import Array

OFF = 1e-6
"""[m] Drones certainly this far from a sheet are not in it."""

MAX_HALVINGS = 24
"""A cell halved so often is where a drone enters a sheet."""

MOST = 2000
"""Cells in all, above which only one of each pair is followed up."""

BATCH = 2048
"""Cells looked at in one go."""


@dataclass(frozen=True, eq=False)
class Entered:
    """Where drones are, or may be, within a sheet.

    Attributes
    ----------
    drone, cable: (k,)
    time: (k,) [s]
    """

    drone: Indices
    cable: Indices
    time: Array


def entered(motion: Motion) -> Entered:
    """Return which drones fly inside foreign cables, each pair once.

    Parameters
    ----------
    motion: a phase without a hitch, no cable lying on the ground.
    """
    lost = _within(_candidates(motion))
    pairs, first = np.unique(lost.item, return_index=True)
    return Entered(*np.divmod(pairs, motion.team.robots), lost.start[first])


def _candidates(motion: Motion) -> Cells:
    """Return one cell per piece and pair of a drone and a foreign cable whose boxes meet."""
    drones, length = cut(motion.drones), motion.team.cable_length
    near = [drone_cable_cells(drones, piece, length, 2.0 * OFF) for piece in range(drones.pieces)]
    return joined_cells(near)


def _within(cells: Cells) -> Cells:
    """Return the cells on which a drone cannot be told to be off the sheet, to the last halving."""
    for _ in range(MAX_HALVINGS):
        if len(cells) == 0:
            break
        off = [
            _off(cells.take(slice(first, first + BATCH)).blocks)
            for first in range(0, len(cells), BATCH)
        ]
        cells = cells.take(~np.concatenate(off))
        _, first = (
            np.unique(cells.item, return_index=True) if len(cells) > MOST else (0, slice(None))
        )
        cells = cells.take(first).halves()  # of many, one a pair will do to tell that there is one
    return cells


def _off(blocks: tuple[Array, ...]) -> NDArray[np.bool_]:
    """Return on which cells one direction tells the drone from the whole sheet."""
    rows, length = blocks
    drone, q, r = rows[:, 0:3], rows[:, 3:6], rows[:, 6:9]
    hung = chains(q, r, length[:, 0, 0])
    apart = drone[:, None] - hung.points
    here = apart @ bernstein.basis(np.array(0.5), bernstein.degree(rows))
    # Towards the nearest side of the sheet: one of its links, or the chord.
    ring = np.concatenate([here, here[:, :1]], axis=1)
    offsets = shortest_offset(np.stack([ring[:, :-1], ring[:, 1:]], axis=2))
    nearest = np.argmin(np.linalg.norm(offsets, axis=-1), axis=1)
    edgewise = np.take_along_axis(offsets, nearest[:, None, None], axis=1)[:, 0]
    chord = here[:, 0] - here[:, -1]
    sideways = np.column_stack([-chord[:, 1], chord[:, 0], np.zeros(len(chord))])
    sideways *= np.sign(np.sum(sideways * here[:, 0], axis=1))[:, None]
    sure = np.zeros(len(rows), dtype=np.bool_)
    for towards in (edgewise, sideways):
        along = unit(towards)
        least = np.min(np.einsum("ci,clin->cln", along, apart), axis=(1, 2))
        # The cable is off its links upward or downward only.
        sure |= least > OFF + np.abs(along[:, 2]) * np.max(hung.off, axis=1)
    return sure
