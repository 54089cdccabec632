"""A plan's derivatives on a grid of times, with bounds between its nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.compiled.kernel_switch import kernels_on
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

WIDTH = 0.01
"""[s] Usual largest distance of nodes."""

NODES = 20_000
"""Largest number of nodes at that distance."""

CURVED = 0.02
"""Share of the largest jerk by which it may bend between two nodes."""

DENSER = 8.0
"""How many times closer nodes may be where the jerk bends more."""


@dataclass(frozen=True, eq=False)
class Sizes:
    """Bounds on cells of a grid, for each drone (cells, drones) or the largest of all (cells, 1).

    Attributes
    ----------
    first, second, third: norms of the derivatives by plan time.
    """

    first: Array
    second: Array
    third: Array

    @property
    def largest(self) -> Sizes:
        """The largest of all drones."""
        return Sizes(*(np.max(each, axis=1, keepdims=True) for each in vars(self).values()))


class DerivativeGrid:
    """Nodes at all breaks of a plan and between them; cells lie between nodes of one piece.

    Parameters
    ----------
    limits: of the motion.
    width: largest distance of nodes [s], for plans of up to ``width * NODES``.

    Attributes
    ----------
    piece: (cells,) in which each lies.
    begin, until, width: (cells,) [s].
    left: (cells,), the node at which each begins.
    values: (nodes, drones, 3), derivatives of orders 1 to 3 by plan time, and static thrusts.
    fourth, fifth: (pieces, drones), bounds of the norms of these derivatives.
    slope, bend: (pieces, drones), bounds of the norms of the static thrusts' derivatives.
    sizes, largest: bounds on all cells, for each drone and for all.
    """

    def __init__(self, limits: ClockLimits, width: float = WIDTH) -> None:
        drones = limits.motion.drones
        self.fourth, self.fifth = (
            np.max(np.linalg.norm(drones.differentiated(order).coefficients, axis=2), axis=-1)
            + derivative_margin(drones, order)
            for order in (4, 5)
        )
        width = max(width, drones.duration / NODES)
        bend = np.max(self.fifth, axis=-1) / (8.0 * CURVED * limits.motion.requirements.limits.jerk)
        density = np.clip(np.nan_to_num(np.sqrt(bend)), 1.0 / width, DENSER / width)
        parts = np.ceil(drones.durations * density).astype(np.intp)
        self.piece = np.repeat(np.arange(drones.pieces), parts)
        within = np.arange(len(self.piece)) - np.repeat(np.cumsum(parts) - parts, parts)
        x = within / parts[self.piece]
        self.width = (drones.durations / parts)[self.piece]
        self.begin = drones.breaks[self.piece] + x * drones.durations[self.piece]
        self.until = np.append(self.begin[1:], drones.breaks[-1])
        # Nodes are those where cells begin, and the end of each piece once more.
        self.left = np.arange(len(self.piece)) + self.piece
        nodes = np.repeat(np.arange(drones.pieces), parts + 1)
        place = np.zeros(len(nodes))
        place[self.left] = x
        place[np.cumsum(parts + 1) - 1] = 1.0
        force = limits.static.thrust.coefficients
        self.values = [_at(c, nodes, place) for c in (*limits.derivatives, force)]
        slope = _slope(force, drones.durations)
        self.slope, self.bend = (
            np.max(np.linalg.norm(c, axis=2), axis=-1)
            for c in (slope, _slope(slope, drones.durations))
        )
        self.sizes = self._bounded(limits.margins)
        self.largest = self.sizes.largest

    def _bounded(self, margins: list[Array]) -> Sizes:
        """Return bounds on all cells, for each drone."""
        bend = (self.width**2 / 8.0)[:, None]
        first, second, third = (margin[self.piece] for margin in margins)

        def ends(values: Array) -> Array:
            sizes = lengths(values)
            most: Array = np.maximum(sizes[self.left], sizes[self.left + 1])
            return most

        if kernels_on():
            from hitchopt.compiled.grid_kernel import grid_sizes

            values = (self.values[0], self.values[1], self.values[2])
            both = np.stack([*margins, self.fourth, self.fifth])
            return Sizes(*grid_sizes(values, self.left, self.piece, self.width, both))
        J = ends(self.values[2]) + bend * self.fifth[self.piece] + third
        A = ends(self.values[1]) + bend * self.fourth[self.piece] + second
        return Sizes(ends(self.values[0]) + bend * J + first, A, J)

    def node_before(self, times: Array) -> Indices:
        """Return the last node (…) up to each time [s]; the first or last one beyond the plan."""
        cell = np.searchsorted(self.begin, times, side="right") - 1
        found: Indices = self.left[np.maximum(cell, 0)]
        return found

    @cached_property
    def table(self) -> Array:
        """``values`` (orders, 3, drones · nodes), drone by drone: sums over many are quick."""
        nodes, drones, axes = self.values[0].shape
        table = np.empty((len(self.values), axes, drones, nodes))
        for order, values in zip(table, self.values, strict=True):
            order[...] = values.transpose(2, 1, 0)
        return table.reshape(len(table), axes, -1)

    def on_chord(self, orders: slice, drone: Indices, cell: Indices, tau: Array) -> Array:
        """Return some of ``values`` on the chords between nodes, by axis.

        Parameters
        ----------
        orders: indices in ``values``.
        drone, cell: broadcast to the places (…).
        tau: (k, …), shares of cells.

        Returns
        -------
        (orders, 3, k, …)
        """
        table = self.table[orders]
        left = drone * len(self.values[0]) + self.left[cell]
        start = table.take(left, axis=2)
        chord = table.take(left + 1, axis=2)
        chord -= start
        found: Array = start[:, :, None] + tau * chord[:, :, None]
        return found


def _at(coefficients: Array, pieces: Indices, x: Array) -> Array:
    """Return (nodes, drones, 3): polynomials (pieces, drones, 3, m) at x (nodes,) of pieces.

    Pieces are in order.
    """
    if kernels_on():
        from hitchopt.compiled.grid_kernel import grid_values

        return grid_values(coefficients.copy(), pieces, x)
    weights = bernstein.basis(x, bernstein.degree(coefficients))
    _, drones, axes, order = coefficients.shape
    found = np.empty((len(x), drones, axes))
    starts = np.flatnonzero(np.diff(pieces, prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(x)], strict=True):  # one product a piece
        c = coefficients[pieces[first]].reshape(-1, order)
        found[first:last] = (weights[first:last] @ c.T).reshape(-1, drones, axes)
    return found


def _slope(coefficients: Array, durations: Array) -> Array:
    """Return the derivative by time of polynomials (pieces, drones, 3, m)."""
    slope: Array = bernstein.differentiate(coefficients) / durations[:, None, None, None]
    return slope


def lengths(vectors: Array) -> Array:
    """Return the norms of vectors (…, 3)."""
    length: Array = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return length


def axis_lengths(vectors: Array) -> Array:
    """Return the norms of vectors by axis (3, …)."""
    x, y, z = vectors
    length: Array = np.sqrt(x * x + y * y + z * z)
    return length
