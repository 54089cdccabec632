"""The convex program around given curves: all requirements, linearised.

Unknowns are the changes of the free coefficients, in trust radii, and slacks: one per drone for its
limits, one per cable, plane and wall. All rows hold on whole pieces, by their Bernstein (or spline)
coefficients. A row that is already broken may stay so, or has a slack: there is always a solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.geometry.vectors import unit
from hitchopt.hitch.convex_qp import QuadraticProgram, Rows
from hitchopt.planners.separation.limit_rows import add_limits
from hitchopt.planners.separation.planes import Planes
from hitchopt.planners.separation.setting import DEGREE, HELD, Setting, inside
from hitchopt.planners.separation.walls import Walls
from hitchopt.values import Array, Indices

MARGIN = 0.01
"""Margin of every plane, in separations: OSQP errs by some thousandths."""

DEVIATION, ROUGHNESS = 1.0, 3e-7
"""Weights of the squared distance to the nominal curves and of the squared third derivative, both
scaled to the longest route and a duration of one."""

BROKEN = 10.0
"""Penalty weight of a squared slack of a plane, wall or cable."""

EXCEEDED = 100.0
"""Penalty weight of a squared slack of a drone's limits, divided by the number of drones."""


@dataclass(frozen=True, eq=False)
class Around:
    """The curves that a program is linearised about, with planes and walls.

    Attributes
    ----------
    coefficients: (N, count, 3) [m], the current curves.
    duration: [s] for which the limits hold.
    trust: how far any coefficient may move along any axis [m].
    planes, walls: what pieces must stay on their side of.
    moves: (N,), largest move of each drone's coefficients along any axis, in ``trust``.
    """

    coefficients: Array
    duration: float
    trust: float
    planes: Planes
    walls: Walls
    moves: Array


@dataclass(frozen=True, eq=False)
class Built:
    """A program and what its unknowns stand for.

    Attributes
    ----------
    program: for the solver.
    common_rows: rows at the front that are the same in every program of this setting.
    setting, around: what it was built from.
    """

    program: QuadraticProgram
    common_rows: int
    setting: Setting
    around: Around

    def among(self, moving: NDArray[np.bool_]) -> Part:
        """Return the program of the drones that are ``moving`` (N,) while the others stay.

        For tasks without tethers and prisms.
        """
        between = self.around.planes.between
        free = self.setting.grid.count - 2 * HELD
        touched = moving[between.first] | moving[between.second]
        which = np.concatenate([np.repeat(moving, 3 * free), moving, touched])
        kept = np.flatnonzero(which)
        whole = self.program
        A = sp.csr_array(whole.A[:, kept])
        rows = np.flatnonzero(np.diff(A.indptr))
        P = sp.csc_array(whole.P[:, kept][kept])
        part = QuadraticProgram(
            P, whole.q[kept], sp.csc_array(A[rows]), whole.lower[rows], whole.upper[rows]
        )
        return Part(part, kept, len(which))

    def moved(self, x: Array) -> Array:
        """Return the coefficients (N, count, 3) [m] that a solution stands for."""
        coefficients = self.around.coefficients.copy()
        inner, moves = coefficients[:, HELD:-HELD], self.around.moves[:, None, None]
        inner += self.around.trust * np.clip(x[: inner.size].reshape(inner.shape), -moves, moves)
        arena = self.setting.task.requirements.arena
        if arena is not None:  # exactly, where OSQP has a tolerance
            inner[...] = inside(arena, inner)
        return coefficients


@dataclass(frozen=True, eq=False)
class Part:
    """A program in some of the unknowns of another, in which the rest is zero.

    Attributes
    ----------
    program: for the solver.
    kept: (m,), which unknowns these are.
    unknowns: number of unknowns of the whole.
    """

    program: QuadraticProgram
    kept: Indices
    unknowns: int

    def whole(self, x: Array) -> Array:
        """Return what a solution (m,) is in all unknowns."""
        found = np.zeros(self.unknowns)
        found[self.kept] = x
        return found


def build_program(setting: Setting, around: Around) -> Built:
    """Return the program around the given curves."""
    n = setting.task.drones
    free = setting.grid.count - 2 * HELD
    unknowns = 3 * n * free
    cables = len(setting.task.tethers)
    planes, walls = len(around.planes.between), len(around.walls)
    rows = Rows(unknowns + n + cables + planes + walls)
    _add_boxes(rows, setting, around)
    add_limits(rows, setting, around.coefficients, around.duration, around.trust, unknowns)
    _add_tethers(rows, setting, around, unknowns + n)
    rows.add_bounds(unknowns + np.arange(n + cables), 0.0, np.inf)
    common = rows.count
    slacks = unknowns + n + cables
    _add_planes(rows, setting, around, slacks)
    _add_walls(rows, setting, around, slacks + planes)
    rows.add_bounds(slacks + np.arange(planes + walls), 0.0, np.inf)
    hessian, gradient = _objective(setting, around)
    weights = np.concatenate([np.full(n, EXCEEDED / n), np.full(cables + planes + walls, BROKEN)])
    P = sp.csc_array(sp.block_diag([hessian, sp.diags_array(weights)]))
    q = np.concatenate([gradient, np.zeros(len(weights))])
    program = QuadraticProgram(P, q, *rows.compressed())
    return Built(program, common, setting, around)


def _objective(setting: Setting, around: Around) -> tuple[sp.csc_array[np.float64], Array]:
    grid = setting.grid
    s, weights = grid.quadrature
    basis, bends = grid.sampled(s), grid.sampled(s, 3)
    unit = 2.0 / (setting.size**2 * setting.task.drones)
    free = basis[:, grid.free] * weights[:, None], bends[:, grid.free] * weights[:, None]
    deviation = np.einsum("sc,ncd->nsd", basis, around.coefficients - setting.nominal)
    bending = np.einsum("sc,ncd->nsd", bends, around.coefficients)
    gradient = DEVIATION * np.einsum("sf,nsd->nfd", free[0], deviation)
    gradient += ROUGHNESS * np.einsum("sf,nsd->nfd", free[1], bending)
    one = DEVIATION * free[0].T @ basis[:, grid.free] + ROUGHNESS * free[1].T @ bends[:, grid.free]
    trust = around.trust
    block = sp.kron(sp.csc_array(unit * trust**2 * one), sp.eye_array(3))
    hessian = sp.csc_array(sp.kron(sp.eye_array(setting.task.drones), block))
    return hessian, unit * trust * gradient.ravel()


def _add_boxes(rows: Rows, setting: Setting, around: Around) -> None:
    """Keep changes within the trust radius, and coefficients (so curves) within the arena."""
    current = around.coefficients[:, HELD:-HELD]
    upper = np.broadcast_to(around.moves[:, None, None], current.shape)
    lower = -upper
    arena = setting.task.requirements.arena
    if arena is not None:
        lower = np.maximum(lower, np.minimum((arena.lower - current) / around.trust, 0.0))
        upper = np.minimum(upper, np.maximum((arena.upper - current) / around.trust, 0.0))
    rows.add_bounds(np.arange(current.size), lower.ravel(), upper.ravel())


def _add_tethers(rows: Rows, setting: Setting, around: Around, slack: int) -> None:
    """Bound every coefficient's distance along its current direction: the hull's is no larger."""
    first, second, longest = setting.task.tether_arrays
    inner = around.coefficients[:, HELD:-HELD]
    free = inner.shape[1]
    offset = (inner[first] - inner[second]) / longest[:, None, None]
    size = np.linalg.norm(offset, axis=-1)
    along = unit(offset, least=1e-9)
    f = np.arange(free)
    local = (np.arange(len(longest))[:, None] * free + f).ravel()
    entries = (along * around.trust / longest[:, None, None]).ravel()
    columns = [
        ((end[:, None] * free + f)[..., None] * 3 + np.arange(3)).ravel() for end in (first, second)
    ]
    upper = (1.0 - 0.5 * MARGIN - size).ravel()
    top = rows.add(
        np.tile(np.repeat(local, 3), 2),
        np.concatenate(columns),
        np.concatenate([entries, -entries]),
        np.full(len(upper), -np.inf),
        upper,
    )
    rows.extend(top + local, slack + local // free, -1.0)


def _add_planes(rows: Rows, setting: Setting, around: Around, slack: int) -> None:
    between = around.planes.between
    steepest = around.planes.normals * setting.scale * around.trust
    lower = (1.0 + MARGIN) - around.planes.gaps
    first, there, live = _piece_entries(setting, between.piece, between.first, steepest)
    second, back, _ = _piece_entries(setting, between.piece, between.second, -steepest)
    _add_sided(rows, [first, second], [there, back], live, lower, slack)


def _add_walls(rows: Rows, setting: Setting, around: Around, slack: int) -> None:
    walls = around.walls
    lower = (1.0 + MARGIN) - walls.gaps
    steepest = walls.normals * around.trust / setting.task.requirements.separation.radius
    column, entry, live = _piece_entries(setting, walls.piece, walls.drone, steepest)
    _add_sided(rows, [column], [entry], live, lower, slack)


def _piece_entries(
    setting: Setting, piece: Indices, drone: Indices, steepest: Array
) -> tuple[Indices, Array, NDArray[np.bool_]]:
    """Return columns, entries and which are free, (m, rows, coefficients, 3), of pieces' rows."""
    k = DEGREE + 1
    free = setting.grid.count - 2 * HELD
    entries = setting.grid.extraction[piece][..., None] * steepest[:, None, None, :]
    index = piece[:, None] + np.arange(k) - HELD
    live = np.broadcast_to(((index >= 0) & (index < free))[:, None, :, None], entries.shape)
    columns = ((drone[:, None] * free + index)[..., None] * 3 + np.arange(3))[:, None]
    return np.broadcast_to(columns, entries.shape), entries, live


def _add_sided(
    rows: Rows,
    columns: list[Indices],
    entries: list[Array],
    live: NDArray[np.bool_],
    lower: Array,
    slack: int,
) -> None:
    """Add rows, one per Bernstein coefficient, that share a slack per plane."""
    m, k = lower.shape
    if m == 0:
        return
    local = np.broadcast_to(np.arange(m * k).reshape(m, k, 1, 1), live.shape)[live]
    # Held coefficients cannot move: their rows have no bound.
    movable = np.any(live, axis=(2, 3))
    lower = np.where(movable, lower, -np.inf)
    top = rows.add(
        np.tile(local, len(columns)),
        np.concatenate([column[live] for column in columns]),
        np.concatenate([entry[live] for entry in entries]),
        lower.ravel(),
        np.full(m * k, np.inf),
    )
    every = np.arange(m * k)
    rows.extend(top + every, slack + every // k, 1.0)
