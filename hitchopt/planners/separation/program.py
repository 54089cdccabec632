"""The convex program around given curves: all requirements, linearised.

Unknowns are the changes of the free coefficients, in trust radii, and slacks: one per drone for its
limits, one per cable and plane. All rows hold on whole pieces, by their Bernstein (or spline)
coefficients. A row that is already broken may stay so, or has a slack: there is always a solution.

It is solved by OSQP. Its status is not trusted: the curves are evaluated.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.errors import check_time, time_left
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.geometry.vectors import EAST, first_smallest, length, unit
from hitchopt.hitch.requirements import Prism, Separation
from hitchopt.hitch.slack_split import QuadraticProgram, Rows
from hitchopt.planners.separation.task import HELD, Setting, inside
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

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
    mask = np.ones(len(program.q), dtype=np.bool_)
    if not np.all(moving):
        program, mask = _among(program, np.repeat(moving, 3 * (setting.grid.count - 2 * HELD)))
    x = np.zeros(len(mask))
    x[mask] = solve_program(program, HASTY if len(moving) >= CROWD else ITERATIONS)
    moved = coefficients.copy()
    inner = moved[:, HELD:-HELD]
    inner += setting.trust * np.clip(x[: inner.size].reshape(inner.shape), -1.0, 1.0)
    inner[...] = inside(setting.task.requirements.arena, inner)  # exactly
    return moved


def _among(
    program: QuadraticProgram, moving: NDArray[np.bool_]
) -> tuple[QuadraticProgram, NDArray[np.bool_]]:
    """Return the program of some of its first unknowns, and which unknowns are left in it.

    Others stay; slacks are left where rows of a moving unknown have them.
    """
    there = abs(program.A)
    touched = there[:, : len(moving)] @ moving.astype(np.float64) > 0.0
    slacks = there[:, len(moving) :].T @ touched.astype(np.float64) > 0.0
    mask = np.append(moving, slacks)
    columns = sp.csr_array(program.A[:, mask])
    rows = np.diff(columns.indptr) > 0
    P, A = sp.csc_array(program.P[:, mask][mask]), sp.csc_array(columns[rows])
    return QuadraticProgram(P, program.q[mask], A, program.lower[rows], program.upper[rows]), mask


def build_program(
    setting: Setting, coefficients: Array, duration: float, planes: Planes
) -> QuadraticProgram:
    """Return the program around the given curves; parameters as of ``moved_curves``."""
    n, cables, trust = setting.task.drones, len(setting.task.tethers), setting.trust
    inner, arena = coefficients[:, HELD:-HELD], setting.task.requirements.arena
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
    scale = 2.0 * setting.trust / (setting.size**2 * setting.task.drones)
    gradient = deviation[free] @ (coefficients - setting.nominal) + roughness[free] @ coefficients
    one = scale * setting.trust * (deviation + roughness)[free, free]
    block = sp.kron(sp.csc_array(one), sp.eye_array(3))
    hessian = sp.csc_array(sp.kron(sp.eye_array(setting.task.drones), block))
    return hessian, scale * gradient.ravel()


def _add_tethers(rows: Rows, setting: Setting, inner: Array, slack: int) -> None:
    """Bound every coefficient's distance along its current direction: the hull's is no larger."""
    first, second, longest = setting.task.tether_arrays
    free = inner.shape[1]
    offset = (inner[first] - inner[second]) / longest[:, None, None]
    along = unit(offset, least=1e-9)
    entries = (along * setting.trust / longest[:, None, None]).ravel()
    f = np.arange(free)
    columns = 3 * (np.stack([first, second])[..., None] * free + f)[..., None] + np.arange(3)
    upper = (1.0 - 0.5 * MARGIN - np.linalg.norm(offset, axis=-1)).ravel()
    every = np.arange(len(upper))
    local, entries = np.tile(np.repeat(every, 3), 2), np.concatenate([entries, -entries])
    top = rows.add(local, columns.ravel(), entries, np.full(len(upper), -np.inf), upper)
    rows.extend(top + every, slack + every // free, -1.0)


def _add_planes(rows: Rows, setting: Setting, planes: Planes, slack: int) -> None:
    """Keep every Bernstein coefficient of a piece on its side of a plane, with a slack a plane."""
    m, k = planes.gaps.shape
    free = setting.grid.count - 2 * HELD
    piece, *drones = planes.sides.T
    entries = setting.grid.extraction[piece][..., None]
    entries = entries * (setting.trust * planes.normals)[:, None, None, :]
    index = (piece[:, None] + np.arange(k) - HELD)[:, None, :, None]  # (m, rows, coefficients, 3)
    live = np.broadcast_to((index >= 0) & (index < free), entries.shape)
    every = np.arange(m * k)
    local = np.broadcast_to(every.reshape(m, k, 1, 1), live.shape)
    parts: list[tuple[Indices, Indices, Array]] = []
    for drone, sign in zip(drones, (1.0, -1.0), strict=True):
        there = live & (drone >= 0)[:, None, None, None]
        columns = 3 * (drone[:, None, None, None] * free + index) + np.arange(3)
        columns = np.broadcast_to(columns, entries.shape)
        parts.append((local[there], columns[there], sign * entries[there]))
    # Held coefficients cannot move: their rows have no bound.
    lower = np.where(np.any(live, axis=(2, 3)), 1.0 + MARGIN - planes.gaps, -np.inf).ravel()
    local, columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
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
    for k, cap in enumerate(setting.caps):
        order, matrix = k + 1, setting.grid.rates[k] / duration ** (k + 1)
        current = matrix @ coefficients / cap[:, None, None]
        size = np.linalg.norm(current, axis=-1)
        changing = matrix[:, HELD:-HELD] * setting.trust
        r, f = np.nonzero(changing)
        columns = ((drones[:, None] * free + f)[..., None] * 3 + np.arange(3)).ravel()
        values = np.broadcast_to(changing[r, f] / cap[:, None], (n, len(r)))
        local = np.repeat(drones[:, None] * len(matrix) + r, 3)
        across = ACROSS[0] + (ACROSS[1] - ACROSS[0]) * np.clip(1.0 - size, 0.0, 1.0)
        along = unit(current, EAST, 1e-9)
        aside = unit(np.cross(along, np.eye(3)[first_smallest(np.abs(along), 1.0)]))
        for axis in (along, aside, np.cross(along, aside)):
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


LEVEL = 1e-6
"""Largest upward component of a normal that counts as level."""

LEAN, LEAN_UNTIL = 1e-2, 2.0
"""Upward slope of level normals, for every unit by which the separation falls short of this."""

CURVE_SAMPLES = 17
"""Number of samples of a piece that locate its nearest point."""

FLAT = 1e-10
"""Squared sine of the angle below which two edges of a triangle count as parallel: all of it is
then as near to its edges."""


class Planes(NamedTuple):
    """Planes that pieces of curves stay on one side of; lengths are in separations.

    Attributes
    ----------
    sides: (m, 3): a piece, its drone, and the drone on the other side; -1 for a prism.
    normals: (m, 3) [1/m], towards the first drone: how gaps grow as it moves.
    gaps: (m, degree + 1), of the coefficients; 1 where they keep their distance.
    """

    sides: Indices
    normals: Array
    gaps: Array


def planes_between(curves: Array, separation: Separation, cutoff: float, known: Indices) -> Planes:
    """Return the widest planes for pieces of two drones whose hulls are nearer than ``cutoff``.

    Lengths are scaled so that a pair's separation is a distance. The difference of two pieces lies
    in the hull of its Bernstein coefficients; the point of that hull nearest to the origin is the
    normal of the plane with the widest gap that holds on the whole piece.

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    cutoff: a separation.
    known: (k, 3), sides that get a plane however far apart they are.
    """
    pairs_by_time, scaled = [known], curves * separation.scale[:, None]
    for m, piece in enumerate(scaled):  # as many as the grid has, whatever the number of drones
        pairs = close_pairs(Boxes(np.min(piece, axis=-1), np.max(piece, axis=-1)), None, cutoff)
        pairs_by_time.append(np.column_stack([np.full(len(pairs), m), pairs.first, pairs.second]))
    sides, index = np.unique(np.concatenate(pairs_by_time), axis=0, return_inverse=True)
    piece, first, second = sides.T
    differences = scaled[piece, first] - scaled[piece, second]
    nearest = hull_points(differences)
    apart = length(nearest)
    mask = apart < cutoff
    mask[index.ravel()[: len(known)]] = True
    sides, differences = sides[mask], differences[mask]
    nearest, apart = nearest[mask], apart[mask]
    # Hulls that hold the origin have no plane yet: the curve's own nearest point gives a first one.
    inside = apart < 1e-6
    points = _points_of(differences[inside])
    squared = np.sum(points * points, axis=2)
    best = first_smallest(squared, np.max(squared, axis=1))
    nearest[inside] = points[np.arange(len(points)), best]
    normals = unit(nearest, EAST, 1e-9)
    # Level pairs could pass above each other as well as below. The first one goes up: else
    # rounding would choose, as the programs move out of a plane as soon as anything is out of it.
    lean = LEAN * np.maximum(LEAN_UNTIL - apart, 0.0)
    normals[:, 2] += np.where(np.abs(normals[:, 2]) < LEVEL, lean, 0.0)
    normals = unit(normals)
    gaps = np.einsum("md,mdk->mk", normals, differences)
    return Planes(sides, normals * separation.scale, gaps)


def _points_of(pieces: Array) -> Array:
    """Return samples (m, CURVE_SAMPLES, 3) of pieces (m, 3, degree + 1)."""
    weights = bernstein.basis(np.linspace(0.0, 1.0, CURVE_SAMPLES), pieces.shape[-1] - 1)
    return np.swapaxes(pieces @ weights.T, 1, 2)


def hull_points(differences: Array) -> Array:
    """Return the points nearest to the origin of the hulls of (m, 3, k) points, as (m, 3).

    It is a point, on an edge or on a triangle of them, each in closed form, or it is the origin.
    Where several are equally near they are the same point, as a hull is convex.
    """
    points = np.ascontiguousarray(differences.transpose(1, 2, 0))  # (3, k, m)
    nearest, least = points[:, 0], _dot(points[:, 0], points[:, 0])
    for size in (1, 2, 3):
        for corners in combinations(range(points.shape[1]), size):
            start, *others = (points[:, corner] for corner in corners)
            candidate, inside = _of_simplex(start, [other - start for other in others])
            squared = _dot(candidate, candidate)
            nearer = inside & (squared < least)
            nearest, least = np.where(nearer, candidate, nearest), np.where(nearer, squared, least)
    # A plane through the nearest point bounds the hull unless the origin is within.
    products = np.min(np.einsum("dm,dkm->km", nearest, points), axis=0)
    return np.where(products > 0.5 * least, nearest, 0.0).T


def _of_simplex(start: Array, edges: list[Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the points (3, m) nearest to the origin of lines or planes, and which are inside."""
    if not edges:
        return start, np.ones(start.shape[1], dtype=np.bool_)
    a, b, c = (_dot(edges[i], edges[j]) for i, j in ((0, 0), (0, -1), (-1, -1)))
    u, v = -_dot(edges[0], start), -_dot(edges[-1], start)
    size, parts = (a, [u]) if len(edges) == 1 else (a * c - b * b, [u * c - v * b, v * a - u * b])
    solid = size > (0.0 if len(edges) == 1 else FLAT * a * c)
    weights = [np.divide(part, size, out=np.zeros_like(size), where=solid) for part in parts]
    inside = solid & np.all([weight > 0.0 for weight in weights], axis=0)
    point = start + sum(weight * edge for weight, edge in zip(weights, edges, strict=True))
    return point, inside & (sum(weights) < 1.0)


def _dot(a: Array, b: Array) -> Array:
    """Return products of vectors along the first axis."""
    product: Array = np.einsum("d...,d...->...", a, b)
    return product


def walls_before(curves: Array, prism: Prism, radius: float, cutoff: float) -> Planes:
    """Return a plane for every piece that may come closer to a prism than ``cutoff`` [m].

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    radius: smallest distance to the prism [m]
    """
    corners = prism.corners
    low, high = np.min(corners, axis=0) - cutoff, np.max(corners, axis=0) + cutoff
    near = np.all((np.min(curves, -1) <= high) & (np.max(curves, -1) >= low), axis=-1)
    piece, drone = np.nonzero(near)
    coefficients = curves[piece, drone]
    clearance = prism.clearance(_points_of(coefficients))
    worst = first_smallest(clearance.distance, radius)
    normals = clearance.normals[np.arange(len(worst)), worst] / radius
    reach = np.max(normals @ corners.T, axis=1)
    gaps = np.einsum("md,mdk->mk", normals, coefficients) - reach[:, None]
    close = np.min(gaps, axis=1) * radius < cutoff
    sides = np.column_stack([piece, drone, np.full(len(piece), -1)])
    return Planes(sides[close], normals[close], gaps[close])
