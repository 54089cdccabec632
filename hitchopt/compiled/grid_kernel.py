"""Compiled values of a plan's derivatives on a grid, and bounds between, for ``DerivativeGrid``.

And all of the tables that ``quick_stops`` holds stops against.
"""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.kernel_switch import kernel
from hitchopt.compiled.polynomial_kernels import fill_basis, largest_column
from hitchopt.compiled.rounding_kernel import derivative_margins
from hitchopt.compiled.slope_kernel import slopes
from hitchopt.compiled.stop_tables import StopTables
from hitchopt.values import Array, Indices

ORDERS = 5
"""Number of orders of derivatives that bounds take."""


@kernel
def grid_values(c: Array, pieces: Indices, x: Array) -> Array:
    """Return (nodes, drones, 3): polynomials (pieces, drones, 3, m) at x (nodes,) of pieces.

    Pieces are in order.
    """
    columns, m, last = c.shape[1] * 3, c.shape[3], -1
    out, turned, weights = np.zeros((len(x), columns)), np.empty((m, columns)), np.empty(m)
    for i in range(len(x)):
        if pieces[i] != last:
            last = pieces[i]
            turned[:] = c[last].reshape(columns, m).T
        fill_basis(weights, x[i])
        row = out[i]
        for k in range(m):
            w, onward = weights[k], turned[k]
            for j in range(columns):
                row[j] += w * onward[j]
    return out.reshape(len(x), c.shape[1], 3)


@kernel
def _size(v: Array) -> float:
    return float(np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))


@kernel
def grid_sizes(
    values: tuple[Array, Array, Array],
    left: Indices,
    piece: Indices,
    width: Array,
    margins: Array,
) -> Array:
    """Return (3, cells, drones), bounds of the norms of three derivatives, as ``_bounded``.

    Parameters
    ----------
    values: (nodes, drones, 3) each, the derivatives.
    left: (cells,), the nodes at which cells begin.
    piece: (cells,) in which each lies.
    width: (cells,) [s]
    margins: (5, pieces, drones), of the three, and bounds of the fourth and fifth.
    """
    drones = values[0].shape[1]
    out = np.empty((3, len(left), drones))
    for cell in range(len(left)):
        node, p, bend = left[cell], piece[cell], width[cell] ** 2 / 8.0
        for drone in range(drones):
            V, A, J = (
                max(_size(values[0][node, drone]), _size(values[0][node + 1, drone])),
                max(_size(values[1][node, drone]), _size(values[1][node + 1, drone])),
                max(_size(values[2][node, drone]), _size(values[2][node + 1, drone])),
            )
            J += bend * margins[4, p, drone] + margins[2, p, drone]
            A += bend * margins[3, p, drone] + margins[1, p, drone]
            out[0, cell, drone] = V + bend * J + margins[0, p, drone]
            out[1, cell, drone], out[2, cell, drone] = A, J
    return out


@kernel
def _norms(c: Array) -> Array:
    """Return (pieces, drones), the largest norms of coefficients (pieces, drones, 3, m)."""
    out = np.zeros(c.shape[:2])
    for piece in range(len(c)):
        for drone in range(c.shape[1]):
            out[piece, drone] = largest_column(c[piece, drone])[0]
    return out


@kernel
def _beyond(force: Array, tilt: float) -> Array:
    """Return (pieces, drones), how far thrusts (pieces, drones, 3, m) are beyond a cone."""
    out, cos, sin = np.full(force.shape[:2], -np.inf), np.cos(tilt), np.sin(tilt)
    for piece in range(len(force)):
        for drone in range(force.shape[1]):
            f = force[piece, drone]
            for k in range(f.shape[1]):
                there = np.hypot(f[0, k], f[1, k]) * cos - f[2, k] * sin
                out[piece, drone] = max(out[piece, drone], there)
    return out


@kernel
def _parts(h: Array, fifth: Array, jerk: float, spacing: tuple[float, float, float]) -> Indices:
    """Return (pieces,) the numbers of cells, as ``DerivativeGrid``."""
    width, curved, denser = spacing
    out = np.empty(len(h), dtype=np.intp)
    for piece in range(len(h)):
        density = np.sqrt(np.max(fifth[piece]) / (8.0 * curved * jerk))
        density = 0.0 if np.isnan(density) else density
        out[piece] = np.ceil(h[piece] * min(max(density, 1.0 / width), denser / width))
    return out


@kernel
def stop_grid(
    c: Array,
    breaks: Array,
    static: tuple[Array, Array],
    team: Array,
    limits: Array,
    spacing: tuple[float, float, float],
    rounding: tuple[float, float],
) -> StopTables:
    """Return the tables of a plan's stops.

    Parameters
    ----------
    c: coefficients of drones (pieces, drones, 3, degree + 1).
    breaks: (pieces + 1,) [s]
    static: static thrusts (pieces, drones, 3, ·) and their radii (pieces, drones).
    team, limits: of the tables.
    spacing: largest width [s], and CURVED and DENSER, of a ``DerivativeGrid``.
    rounding: LAST_PLACE and ROUNDING of margins.
    """
    pieces, drones = c.shape[:2]
    h = breaks[1:] - breaks[:-1]
    flat = slopes(c.reshape(pieces, 3 * drones, c.shape[3]), h)
    first, second, third, fourth, fifth = (
        flat[0].reshape(pieces, drones, 3, -1),
        flat[1].reshape(pieces, drones, 3, -1),
        flat[2].reshape(pieces, drones, 3, -1),
        flat[3].reshape(pieces, drones, 3, -1),
        flat[4].reshape(pieces, drones, 3, -1),
    )
    noise = derivative_margins(c, h, ORDERS, rounding[0], rounding[1])
    margins = np.empty((10, pieces, drones))
    margins[0], margins[1] = _norms(fourth) + noise[3], _norms(fifth) + noise[4]
    margins[2:5] = noise[:3]
    force, radius = static
    margins[5], margins[6] = _norms(force) + radius, _beyond(force, limits[2]) + radius
    margins[7] = radius + rounding[1] * margins[5]
    bends = slopes(force.reshape(pieces, 3 * drones, force.shape[3]), h)
    margins[8] = _norms(bends[0].reshape(pieces, drones, 3, -1))
    margins[9] = _norms(bends[1].reshape(pieces, drones, 3, -1))
    spare = np.full(pieces, np.inf)
    for piece in range(pieces):
        for drone in range(drones):
            left = min(team[1, drone] - margins[5, piece, drone], -margins[6, piece, drone])
            spare[piece] = min(spare[piece], left / team[0, drone])
    parts = _parts(h, margins[1], limits[1], spacing)
    cells = np.sum(parts)
    begin, until, width = np.empty(cells), np.empty(cells), np.empty(cells)
    piece_of, left_of = np.empty(cells, dtype=np.intp), np.empty(cells, dtype=np.intp)
    nodes, places = np.empty(cells + pieces, dtype=np.intp), np.empty(cells + pieces)
    cell = node = 0
    for piece in range(pieces):
        for i in range(parts[piece]):
            x = i / parts[piece]
            width[cell], begin[cell] = h[piece] / parts[piece], breaks[piece] + x * h[piece]
            if cell > 0:
                until[cell - 1] = begin[cell]
            piece_of[cell], left_of[cell] = piece, node
            nodes[node], places[node] = piece, x
            cell, node = cell + 1, node + 1
        nodes[node], places[node] = piece, 1.0
        node += 1
    until[cells - 1] = breaks[-1]
    values = (
        grid_values(first, nodes, places),
        grid_values(second, nodes, places),
        grid_values(third, nodes, places),
        grid_values(force, nodes, places),
    )
    bounds = np.empty((5, pieces, drones))
    bounds[:3], bounds[3:] = noise[:3], margins[:2]
    sizes = grid_sizes((values[0], values[1], values[2]), left_of, piece_of, width, bounds)
    largest = np.zeros((cells, 3))
    for order in range(3):
        for cell in range(cells):
            largest[cell, order] = np.max(sizes[order, cell])
    return StopTables(
        begin,
        until,
        width,
        piece_of,
        left_of,
        values,
        (sizes[0], sizes[1], sizes[2]),
        largest,
        spare,
        margins,
        team,
        limits,
    )
