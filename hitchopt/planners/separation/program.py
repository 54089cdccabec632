"""The convex program around given curves: all requirements, linearised.

Unknowns are the changes of the free coefficients, in trust radii, and slacks: one per drone for its
limits, one per cable, plane and wall. All rows hold on whole pieces, by their Bernstein (or spline)
coefficients. A row that is already broken may stay so, or has a slack: there is always a solution.

It is solved by OSQP. Its status is not trusted: the curves are evaluated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.errors import check_time, time_left
from hitchopt.geometry.vectors import EAST, first_smallest, unit
from hitchopt.hitch.leg_program import QuadraticProgram, Rows
from hitchopt.planners.separation.planes import Planes, Walls
from hitchopt.planners.separation.setting import DEGREE, HELD, Setting, inside
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
    setting, around: what it was built from.
    """

    program: QuadraticProgram
    setting: Setting
    around: Around

    def among(self, moving: NDArray[np.bool_]) -> tuple[QuadraticProgram, Indices]:
        """Return the program of the drones that are ``moving`` (N,) while the others stay.

        Also which of the unknowns are left in it. For tasks without tethers and prisms.
        """
        between, whole = self.around.planes.between, self.program
        free = self.setting.grid.count - 2 * HELD
        touched = moving[between.first] | moving[between.second]
        kept = np.flatnonzero(np.concatenate([np.repeat(moving, 3 * free), moving, touched]))
        columns = sp.csr_array(whole.A[:, kept])
        rows = np.flatnonzero(np.diff(columns.indptr))
        P, A = sp.csc_array(whole.P[:, kept][kept]), sp.csc_array(columns[rows])
        return QuadraticProgram(P, whole.q[kept], A, whole.lower[rows], whole.upper[rows]), kept

    def moved(self, x: Array) -> Array:
        """Return the coefficients (N, count, 3) [m] that a solution stands for."""
        coefficients = self.around.coefficients.copy()
        inner, moves = coefficients[:, HELD:-HELD], self.around.moves[:, None, None]
        inner += self.around.trust * np.clip(x[: inner.size].reshape(inner.shape), -moves, moves)
        arena = self.setting.task.requirements.arena
        if arena is not None:  # exactly, where OSQP has a tolerance
            inner[...] = inside(arena, inner)
        return coefficients


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
    slacks = unknowns + n + cables
    _add_planes(rows, setting, around, slacks)
    _add_walls(rows, setting, around, slacks + planes)
    rows.add_bounds(slacks + np.arange(planes + walls), 0.0, np.inf)
    hessian, gradient = _objective(setting, around)
    weights = np.concatenate([np.full(n, EXCEEDED / n), np.full(cables + planes + walls, BROKEN)])
    P = sp.csc_array(sp.block_diag([hessian, sp.diags_array(weights)]))
    q = np.concatenate([gradient, np.zeros(len(weights))])
    program = QuadraticProgram(P, q, *rows.compressed())
    return Built(program, setting, around)


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


ACROSS = (0.3, 0.7)
"""Largest change across a derivative, as shares of its limit: at the limit, and at zero."""


def add_limits(
    rows: Rows, setting: Setting, coefficients: Array, duration: float, trust: float, slack: int
) -> None:
    """Limit the first three derivatives: along themselves to the limit, across to a share of it.

    Parameters
    ----------
    rows: collects them.
    setting: grid and limits.
    coefficients: (N, count, 3) [m], the current curves.
    duration: [s] for which they hold.
    trust: change of a coefficient that an unknown of one stands for [m]
    slack: column of the first drone's slack, in shares of the duration.
    """
    n, free = len(coefficients), setting.grid.count - 2 * HELD
    drones = np.arange(n)
    for order, (rate, cap) in enumerate(
        zip(setting.grid.rates, setting.caps, strict=True), start=1
    ):
        matrix = rate / duration**order
        current = np.einsum("rc,ncd->nrd", matrix, coefficients) / cap[:, None, None]
        size = np.linalg.norm(current, axis=-1)
        changing = matrix[:, HELD:-HELD] * trust
        r, f = np.nonzero(changing)
        columns = ((drones[:, None] * free + f)[..., None] * 3 + np.arange(3)).ravel()
        values = np.broadcast_to(changing[r, f] / cap[:, None], (n, len(r)))
        across = ACROSS[0] + (ACROSS[1] - ACROSS[0]) * np.clip(1.0 - size, 0.0, 1.0)
        for k, axis in enumerate(_frames(current)):
            entries = (values[..., None] * axis[:, r]).ravel()
            here = np.sum(current * axis, axis=-1)
            local = np.repeat(drones[:, None] * len(matrix) + r, 3)
            if k == 0:
                upper, lower = 1.0 - here, np.full(here.shape, -np.inf)
            else:  # no worse than it is
                bound = np.maximum(across, np.abs(here))
                upper, lower = bound - here, -bound - here
            first = rows.add(local, columns, entries, lower.ravel(), upper.ravel())
            if k == 0:
                every = np.arange(here.size)
                rows.extend(first + every, slack + every // len(matrix), -float(order))


def _frames(vectors: Array) -> tuple[Array, Array, Array]:
    """Return three orthogonal unit vectors for each of (…, 3), the first one along it."""
    along = unit(vectors, EAST, 1e-9)
    across = unit(np.cross(along, np.eye(3)[first_smallest(np.abs(along), 1.0)]))
    return along, across, np.cross(along, across)


ACCURACY = 1e-4
"""Absolute and relative tolerance of OSQP, for rows that are scaled to about one."""

MOST_ITERATIONS = 700
"""Iterations after which the current point is used as it is: the curves are evaluated anyway."""

LEAST_TIME = 1e-3
"""[s] Smallest time limit that is passed to OSQP, which takes zero for none."""


class ProgramError(Exception):
    """No finite point was returned by OSQP."""


def solve_program(
    program: QuadraticProgram, first: Array, iterations: int = MOST_ITERATIONS
) -> Array:
    """Return OSQP's solution (unknowns,) of a program, whose bounds on unknowns are rows.

    Parameters
    ----------
    program: what is solved.
    first: (unknowns,) where to start.
    iterations: after which the current point is used as it is.

    Raises
    ------
    ProgramError: no finite point was returned.
    """
    import osqp

    if first.shape != program.q.shape:
        raise ValueError(f"a start of {first.shape} for {program.q.shape}")
    left = time_left()
    solver = osqp.OSQP(algebra="builtin")
    solver.setup(
        sp.csc_matrix(sp.triu(program.P)),
        program.q,
        sp.csc_matrix(program.A),
        program.lower,
        program.upper,
        eps_abs=ACCURACY,
        eps_rel=ACCURACY,
        max_iter=iterations,
        warm_starting=True,
        polishing=False,
        verbose=False,
        **({"time_limit": max(left, LEAST_TIME)} if math.isfinite(left) else {}),
    )
    solver.warm_start(x=first, y=np.zeros(len(program.lower)))
    result = solver.solve(raise_error=False)
    if result.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
        raise KeyboardInterrupt  # OSQP catches the signal
    check_time()  # what has been cut short is no solution
    x = np.asarray(result.x, dtype=np.float64)
    if x.shape != program.q.shape or not np.all(np.isfinite(x)):
        raise ProgramError(str(result.info.status))
    return x
