"""What compiled code holds stops against."""

from __future__ import annotations

from typing import NamedTuple

from hitchopt.values import Array, Indices


class StopTables(NamedTuple):
    """What stops of one motion are held against.

    Attributes
    ----------
    begin, until, width: (cells,) [s], of the grid.
    piece, left: (cells,), in which each lies, and the node at which it begins.
    values: (nodes, drones, 3) each, derivatives of orders 1 to 3 and static thrusts.
    sizes: (cells, drones) each, bounds of the derivatives.
    largest: (cells, 3), the largest of these.
    spare: (pieces,), acceleration up to which all drones keep thrust and tilt.
    margins: (10, pieces, drones), bounds of the fourth and fifth derivative, rounding of the first
        three, static thrust, how far beyond the cone of tilt, radius of the static thrust, and
        bounds of its first two derivatives.
    team: (2, drones), masses and largest thrusts.
    limits: acceleration, jerk, and tilt [rad].
    """

    begin: Array
    until: Array
    width: Array
    piece: Indices
    left: Indices
    values: tuple[Array, Array, Array, Array]
    sizes: tuple[Array, Array, Array]
    largest: Array
    spare: Array
    margins: Array
    team: Array
    limits: Array
