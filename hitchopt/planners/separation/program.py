"""The convex program around given curves: all requirements, linearised.

Unknowns are the changes of the free coefficients, in trust radii, and slacks: one per drone for its
limits, one per cable and plane. All rows hold on whole pieces, by their Bernstein (or spline)
coefficients. A row that is already broken may stay so, or has a slack: there is always a solution.

It is solved by OSQP. Its status is not trusted: the curves are evaluated.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.errors import check_time, time_left
from hitchopt.geometry.vectors import EAST, first_smallest, unit
from hitchopt.hitch.leg_program import QuadraticProgram, Rows
from hitchopt.planners.separation.planes import Planes
from hitchopt.planners.separation.setting import HELD, Setting, inside
from hitchopt.values import Array, Indices

TRUST = 2.5
"""Trust radius: largest move of a coefficient in one program, in drone radii."""

MARGIN = 0.01
"""Margin of every plane, in separations: OSQP errs by some thousandths."""

DEVIATION, ROUGHNESS = 1.0, 3e-7
"""Weights of the squared distance to the nominal curves and of the squared third derivative, both
scaled to the longest route and a duration of one."""

BROKEN = 10.0
"""Penalty weight of a squared slack of a plane or cable."""

EXCEEDED = 100.0
"""Penalty weight of a squared slack of a drone's limits, divided by the number of drones."""


def moved_curves(
    setting: Setting,
    coefficients: Array,
    duration: float,
    planes: Planes,
    moving: NDArray[np.bool_],
) -> Array:
    """Return the curves (N, count, 3) [m] that the program around given ones leads to.

    Parameters
    ----------
    duration: [s] for which the limits hold.
    moving: (N,), drones that may move.

    Raises
    ------
    ProgramError: no finite point was returned.
    """
    program = build_program(setting, coefficients, duration, planes)
    kept = np.ones(len(program.q), dtype=np.bool_)
    if not np.all(moving):
        program, kept = _among(program, np.repeat(moving, 3 * (setting.grid.count - 2 * HELD)))
    x = np.zeros(len(kept))
    x[kept] = solve_program(program, HASTY if len(moving) >= CROWD else ITERATIONS)
    moved = coefficients.copy()
    inner = moved[:, HELD:-HELD]
    inner += trust_radius(setting) * np.clip(x[: inner.size].reshape(inner.shape), -1.0, 1.0)
    inner[...] = inside(setting.task.requirements.arena, inner)  # exactly
    return moved


def trust_radius(setting: Setting) -> float:
    """Return how far any coefficient may move along any axis [m]."""
    return TRUST * setting.task.requirements.separation.radius


def _among(
    program: QuadraticProgram, moving: NDArray[np.bool_]
) -> tuple[QuadraticProgram, NDArray[np.bool_]]:
    """Return the program of some of its first unknowns, and which unknowns are left in it.

    Others stay; slacks are left where rows of a moving unknown have them.
    """
    there = abs(program.A)
    touched = there[:, : len(moving)] @ moving.astype(np.float64) > 0.0
    slacks = there[:, len(moving) :].T @ touched.astype(np.float64) > 0.0
    kept = np.append(moving, slacks)
    columns = sp.csr_array(program.A[:, kept])
    rows = np.diff(columns.indptr) > 0
    P, A = sp.csc_array(program.P[:, kept][kept]), sp.csc_array(columns[rows])
    return QuadraticProgram(P, program.q[kept], A, program.lower[rows], program.upper[rows]), kept


def build_program(
    setting: Setting, coefficients: Array, duration: float, planes: Planes
) -> QuadraticProgram:
    """Return the program around the given curves; parameters as of ``moved_curves``."""
    n, cables = setting.task.drones, len(setting.task.tethers)
    inner, arena, trust = (
        coefficients[:, HELD:-HELD],
        setting.task.requirements.arena,
        trust_radius(setting),
    )
    slacks = n + cables + len(planes.sides)
    rows = Rows(inner.size + slacks)
    upper = np.ones(inner.shape)
    lower = -upper
    if arena is not None:
        lower = np.maximum(lower, np.minimum((arena.lower - inner) / trust, 0.0))
        upper = np.minimum(upper, np.maximum((arena.upper - inner) / trust, 0.0))
    rows.add_bounds(np.arange(inner.size), lower.ravel(), upper.ravel())
    rows.add_bounds(inner.size + np.arange(slacks), 0.0, np.inf)
    _add_limits(rows, setting, coefficients, duration, inner.size)
    _add_tethers(rows, setting, inner, inner.size + n)
    _add_planes(rows, setting, planes, inner.size + n + cables)
    hessian, gradient = _objective(setting, coefficients)
    weights = np.append(np.full(n, EXCEEDED / n), np.full(slacks - n, BROKEN))
    P = sp.csc_array(sp.block_diag([hessian, sp.diags_array(weights)]))
    return QuadraticProgram(P, np.append(gradient, np.zeros(slacks)), *rows.compressed())


def _objective(setting: Setting, coefficients: Array) -> tuple[sp.csc_array[np.float64], Array]:
    """Return the Hessian and the gradient of deviation and roughness by the first unknowns."""
    (deviation, roughness), free = setting.grid.energies, setting.grid.free
    deviation, roughness = DEVIATION * deviation, ROUGHNESS * roughness
    scale = 2.0 * trust_radius(setting) / (setting.size**2 * setting.task.drones)
    gradient = deviation[free] @ (coefficients - setting.nominal) + roughness[free] @ coefficients
    one = scale * trust_radius(setting) * (deviation + roughness)[free, free]
    block = sp.kron(sp.csc_array(one), sp.eye_array(3))
    hessian = sp.csc_array(sp.kron(sp.eye_array(setting.task.drones), block))
    return hessian, scale * gradient.ravel()


def _add_tethers(rows: Rows, setting: Setting, inner: Array, slack: int) -> None:
    """Bound every coefficient's distance along its current direction: the hull's is no larger."""
    first, second, longest = setting.task.tether_arrays
    free = inner.shape[1]
    offset = (inner[first] - inner[second]) / longest[:, None, None]
    along = unit(offset, least=1e-9)
    entries = (along * trust_radius(setting) / longest[:, None, None]).ravel()
    f = np.arange(free)
    columns = [(3 * (end[:, None] * free + f)[..., None] + np.arange(3)).ravel()
               for end in (first, second)]  # fmt: skip
    upper = (1.0 - 0.5 * MARGIN - np.linalg.norm(offset, axis=-1)).ravel()
    every = np.arange(len(upper))
    top = rows.add(
        np.tile(np.repeat(every, 3), 2),
        np.concatenate(columns),
        np.concatenate([entries, -entries]),
        np.full(len(upper), -np.inf),
        upper,
    )
    rows.extend(top + every, slack + every // free, -1.0)


def _add_planes(rows: Rows, setting: Setting, planes: Planes, slack: int) -> None:
    """Keep every Bernstein coefficient of a piece on its side of a plane, with a slack a plane."""
    m, k = planes.gaps.shape
    free = setting.grid.count - 2 * HELD
    piece, *drones = planes.sides.T
    entries = setting.grid.extraction[piece][..., None]
    entries = entries * (trust_radius(setting) * planes.normals)[:, None, None, :]
    index = (piece[:, None] + np.arange(k) - HELD)[:, None, :, None]  # (m, rows, coefficients, 3)
    live = np.broadcast_to((index >= 0) & (index < free), entries.shape)
    every = np.arange(m * k)
    local = np.broadcast_to(every.reshape(m, k, 1, 1), live.shape)
    found: list[tuple[Indices, Indices, Array]] = []
    for drone, sign in zip(drones, (1.0, -1.0), strict=True):
        there = live & (drone >= 0)[:, None, None, None]
        columns = 3 * (drone[:, None, None, None] * free + index) + np.arange(3)
        columns = np.broadcast_to(columns, entries.shape)
        found.append((local[there], columns[there], sign * entries[there]))
    # Held coefficients cannot move: their rows have no bound.
    lower = np.where(np.any(live, axis=(2, 3)), 1.0 + MARGIN - planes.gaps, -np.inf).ravel()
    local, columns, values = (np.concatenate(part) for part in zip(*found, strict=True))
    top = rows.add(local, columns, values, lower, np.full(m * k, np.inf))
    rows.extend(top + every, slack + every // k, 1.0)


ACROSS = (0.3, 0.7)
"""Largest change across a derivative, as shares of its limit: at the limit, and at zero."""


def _add_limits(
    rows: Rows, setting: Setting, coefficients: Array, duration: float, slack: int
) -> None:
    """Limit the first three derivatives: along themselves to the limit, across to a share of it.

    Slacks are shares of the duration.
    """
    n, free = len(coefficients), setting.grid.count - 2 * HELD
    drones = np.arange(n)
    for order, (rate, cap) in enumerate(
        zip(setting.grid.rates, setting.caps, strict=True), start=1
    ):
        matrix = rate / duration**order
        current = matrix @ coefficients / cap[:, None, None]
        size = np.linalg.norm(current, axis=-1)
        changing = matrix[:, HELD:-HELD] * trust_radius(setting)
        r, f = np.nonzero(changing)
        columns = ((drones[:, None] * free + f)[..., None] * 3 + np.arange(3)).ravel()
        values = np.broadcast_to(changing[r, f] / cap[:, None], (n, len(r)))
        local = np.repeat(drones[:, None] * len(matrix) + r, 3)
        across = ACROSS[0] + (ACROSS[1] - ACROSS[0]) * np.clip(1.0 - size, 0.0, 1.0)
        along, *aside = _frames(current)
        for axis in (along, *aside):
            here = np.sum(current * axis, axis=-1)
            bound = np.maximum(across, np.abs(here))  # no worse than it is
            upper, lower = bound - here, -bound - here
            if axis is along:
                upper, lower = 1.0 - here, np.full(here.shape, -np.inf)
            entries = (values[..., None] * axis[:, r]).ravel()
            top = rows.add(local, columns, entries, lower.ravel(), upper.ravel())
            if axis is along:
                every = np.arange(here.size)
                rows.extend(top + every, slack + every // len(matrix), -float(order))


def _frames(vectors: Array) -> tuple[Array, Array, Array]:
    """Return three orthogonal unit vectors for each of (…, 3), the first one along it."""
    along = unit(vectors, EAST, 1e-9)
    across = unit(np.cross(along, np.eye(3)[first_smallest(np.abs(along), 1.0)]))
    return along, across, np.cross(along, across)


ACCURACY = 1e-4
"""Absolute and relative tolerance of OSQP, for rows that are scaled to about one."""

ITERATIONS, CROWD, HASTY = 700, 64, 150
"""Iterations after which the current point is used as it is, and those of so many drones or more:
rounds correct what they leave."""

LEAST_TIME = 1e-3
"""[s] Smallest time limit that is passed to OSQP, which takes zero for none."""


class ProgramError(Exception):
    """No finite point was returned by OSQP."""


def solve_program(program: QuadraticProgram, iterations: int = ITERATIONS) -> Array:
    """Return OSQP's solution (unknowns,) of a program, whose bounds on unknowns are rows.

    Raises
    ------
    ProgramError: no finite point was returned.
    """
    import osqp

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
        polishing=False,
        verbose=False,
        **({"time_limit": max(left, LEAST_TIME)} if math.isfinite(left) else {}),
    )
    result = solver.solve(raise_error=False)
    if result.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
        raise KeyboardInterrupt  # OSQP catches the signal
    check_time()  # what has been cut short is no solution
    x = np.asarray(result.x, dtype=np.float64)
    if x.shape != program.q.shape or not np.all(np.isfinite(x)):
        raise ProgramError(str(result.info.status))
    return x
