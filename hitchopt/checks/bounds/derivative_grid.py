"""A plan's derivatives on a grid of times, with bounds between its nodes."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.geometry.vectors import column_lengths
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

STORED = 500_000
"""Pairs of a node and a drone up to which vectors of all are stored, not only used ones."""

BLOCK = 60_000
"""Pairs of a node and a drone that are looked at in one go, so that they stay within the caches."""


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
    fourth, fifth: (pieces, drones), bounds of the norms of these derivatives.
    slope, bend: (pieces, drones), bounds of the norms of the static thrusts' derivatives.
    sizes: (3, drones, cells), bounds of the norms of the derivatives of orders 1 to 3 by plan time.
    largest: (3, cells), the largest of all drones.
    """

    def __init__(self, limits: ClockLimits, width: float = WIDTH) -> None:
        drones = limits.motion.drones
        self.fourth, self.fifth = (
            np.max(column_lengths(drones.differentiated(order).coefficients), axis=-1)
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
        self._pieces = np.repeat(np.arange(drones.pieces), parts + 1)
        self._places = np.zeros(len(self._pieces))
        self._places[self.left] = x
        self._places[np.cumsum(parts + 1) - 1] = 1.0
        force = limits.static.thrust.coefficients
        self._functions = (*limits.derivatives, force)
        slope = _slope(force, drones.durations)
        self.slope, self.bend = (
            np.max(column_lengths(c), axis=-1) for c in (slope, _slope(slope, drones.durations))
        )
        self.sizes = self._bounded(limits.margins)
        self.largest = np.max(self.sizes, axis=1)

    @cached_property
    def leading(self) -> Indices:
        """The drones (k,) that have the largest of ``sizes`` somewhere."""
        count = max(1, BLOCK // len(self.fourth[0]))
        some = [self.sizes[..., cell : cell + count] for cell in range(0, len(self.piece), count)]
        return np.unique(np.concatenate([np.argmax(each, axis=1) for each in some], axis=1))

    @property
    def _stored(self) -> bool:
        return len(self._places) * len(self.fourth[0]) <= STORED

    @cached_property
    def values(self) -> list[Array]:
        """(nodes, drones, 3) each: derivatives of orders 1 to 3 by plan time, static thrusts."""
        return [_at(c, self._pieces, self._places).transpose(2, 1, 0) for c in self._functions]

    def _bounded(self, margins: list[Array]) -> Array:
        """Return the bounds on all cells, for each drone."""
        fourth, fifth, first, second, third = (
            each.T for each in (self.fourth, self.fifth, *margins)
        )
        bend, piece = self.width**2 / 8.0, self.piece
        sizes = np.empty((3, len(fourth), len(piece)))
        count = max(1, BLOCK // len(self._places))
        for begin in range(0, len(fourth), count):
            part = slice(begin, begin + count)
            for order, most in enumerate(sizes[:, part]):
                size = axis_lengths(self._at_nodes(order, part))
                here, there = (size.take(ends, axis=1) for ends in (self.left, self.left + 1))
                np.maximum(here, there, out=most)
            V, A, J = sizes[:, part]
            J += bend * fifth[part].take(piece, axis=1) + third[part].take(piece, axis=1)
            A += bend * fourth[part].take(piece, axis=1) + second[part].take(piece, axis=1)
            V += bend * J + first[part].take(piece, axis=1)
        return sizes

    def _at_nodes(
        self, order: int, drones: Indices | slice, nodes: Indices | slice = slice(None)
    ) -> Array:
        """Return one of ``values`` at some nodes, in order, of some drones, (3, drones, nodes)."""
        if self._stored:
            return self.values[order].transpose(2, 1, 0)[:, drones, nodes]
        pieces, places = self._pieces[nodes], self._places[nodes]
        return _at(self._functions[order], pieces, places, drones)

    def node_before(self, times: Array) -> Indices:
        """Return the last node (…) up to each time [s]; the first or last one beyond the plan."""
        cell = np.searchsorted(self.begin, times, side="right") - 1
        found: Indices = self.left[np.maximum(cell, 0)]
        return found

    @cached_property
    def _everywhere(self) -> Array:
        return self._table(slice(None), slice(None), slice(None))

    def _table(self, orders: slice, drones: Indices | slice, nodes: Indices | slice) -> Array:
        """Return some of ``values`` (orders, 3, drones · nodes): sums over many nodes are quick."""
        found = [
            self._at_nodes(order, drones, nodes)
            for order in range(*orders.indices(len(self._functions)))
        ]
        return np.stack(found).reshape(len(found), 3, -1)

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
        left, count = self.left[cell], len(self._places)
        if self._stored:
            table = self._everywhere[orders]
        else:
            drones, nodes = np.unique(drone), np.unique([left, left + 1])
            table, count = self._table(orders, drones, nodes), len(nodes)
            drone, left = np.searchsorted(drones, drone), np.searchsorted(nodes, left)
        left = drone * count + left
        start = table.take(left, axis=2)
        chord = table.take(left + 1, axis=2)
        chord -= start
        found: Array = start[:, :, None] + tau * chord[:, :, None]
        return found


def _at(
    coefficients: Array, pieces: Indices, x: Array, drones: Indices | slice = slice(None)
) -> Array:
    """Return (3, drones, nodes): polynomials (pieces, drones, 3, m) at x (nodes,) of pieces.

    Pieces are in order; of some drones only, if these are given.
    """
    weights = bernstein.basis(x, bernstein.degree(coefficients))
    found = np.empty((coefficients.shape[2], len(coefficients[0, drones]), len(x)))
    starts = np.flatnonzero(np.diff(pieces, prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(x)], strict=True):  # one product a piece
        c = coefficients[pieces[first], drones]
        found[..., first:last] = bernstein.combined(c, weights[first:last]).transpose(1, 0, 2)
    return found


def _slope(coefficients: Array, durations: Array) -> Array:
    """Return the derivative by time of polynomials (pieces, drones, 3, m)."""
    slope: Array = bernstein.differentiate(coefficients) / durations[:, None, None, None]
    return slope


def axis_lengths(vectors: Array) -> Array:
    """Return the norms of vectors by axis (3, …)."""
    x, y, z = vectors
    length: Array = np.sqrt(x * x + y * y + z * z)
    return length
