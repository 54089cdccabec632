"""The convex program around current curves, with all requirements linearised.

Variables are the changes of the free coefficients, in trust radii, and slacks: one per drone for
its limits, one per tether and plane. Rows bound whole pieces by their Bernstein (or spline)
coefficients. Rows that the current curves violate are relaxed or have a slack, so that the program
is always feasible.

The solver is OSQP. Its status is not trusted: the curves are evaluated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.errors import check_time, time_left
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.geometry.vectors import EAST, first_smallest, left_of, length, unit
from hitchopt.hitch.quadratic_program import QuadraticProgram, Rows
from hitchopt.hitch.requirements import Arena, Prism, Separation
from hitchopt.swarms.task import END_COUNT, Setting, inside
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices, true_runs

PLANE_MARGIN = 0.01  # Margin of every plane, in separations; OSQP's residuals are a few thousandths


@dataclass(frozen=True)
class ProgramTuning:
    """Weights and ranges of the program; ``python -m benchmarks separation`` shows their effect."""

    roughness_weight: float = 3e-7
    """Weight of the squared third derivative over that of the squared distance to the nominal
    curves, for lengths relative to the longest route and a duration of one."""

    plane_penalty: float = 10.0  # Penalty weight of a squared slack of a plane or tether
    # Penalty weight of a squared slack of a drone's limits, divided by the number of drones
    limit_penalty: float = 100.0
    lateral_shares: tuple[float, float] = (0.3, 0.7)
    """Largest change normal to a derivative, as fractions of its limit: at the limit, and at zero.
    """

    # Absolute and relative tolerance of OSQP, for rows that are scaled to about one
    solver_tolerance: float = 1e-3
    near_range: float = 0.1
    """Distance to their bounds below which rows are enforced at first, where all changes are zero.
    """

    # Distance to their bounds below which rows are added together with violated rows
    added_range: float = 0.05
    initial_step: float = 0.1  # First step size ρ of OSQP
    normal_slope: float = 1e-2  # Upward slope of horizontal normals per separation
    slope_separation: float = 2.0  # Separation above which that slope is zero
    bounding_share: float = 0.5
    """Share of its squared distance above which a plane through a hull's nearest point bounds the
    hull. The share is 1 without rounding if the origin is outside, and at most 0 if it is inside.
    """


TUNING = ProgramTuning()


MIN_DIRECTION = 1e-9  # Smallest length of a scaled vector whose direction is used


def moved_curves(
    setting: Setting,
    coefficients: Array,
    duration: float,
    planes: Planes,
    moving: NDArray[np.bool_],
    damping: float,
    max_iterations: int,
) -> Array | None:
    """Return the curves (N, count, 3) [m] after one program around the current ones.

    None if the program has no finite solution.

    Parameters
    ----------
    duration: [s], to which the limits apply.
    planes: between pieces of curves, and to prisms.
    moving: (N,), mask of drones that may move.
    damping: weight of squared changes.
    max_iterations: of OSQP.
    """
    free = setting.grid.free
    program = build_program(setting, coefficients, duration, planes, damping)
    mask = np.ones(len(program.q), dtype=np.bool_)
    if not np.all(moving):
        program, mask = _reduced(program, np.repeat(moving, 3 * (free.stop - free.start)))
    changed = solve_program(program, max_iterations)
    if changed is None:
        return None
    solution = np.zeros(len(mask))
    solution[mask] = changed
    moved = coefficients.copy()
    inner = moved[:, free]
    changes = solution[: inner.size].reshape(inner.shape)
    inner += setting.trust * np.clip(changes, -1.0, 1.0)
    inner[...] = inside(setting.task.requirements.arena, inner)  # exactly
    return moved


def _reduced(
    program: QuadraticProgram, moving: NDArray[np.bool_]
) -> tuple[QuadraticProgram, NDArray[np.bool_]]:
    """Return the program of the moving variables and their slacks, and the mask of all of these."""
    pattern = abs(program.A)
    active = pattern[:, : len(moving)] @ moving.astype(np.float64) > 0.0
    slacks = pattern[:, len(moving) :].T @ active.astype(np.float64) > 0.0
    mask = np.append(moving, slacks)
    columns = sp.csr_array(program.A[:, mask])
    rows = np.diff(columns.indptr) > 0
    reduced = QuadraticProgram(
        sp.csc_array(program.P[:, mask][mask]),
        program.q[mask],
        sp.csc_array(columns[rows]),
        program.lower[rows],
        program.upper[rows],
    )
    return reduced, mask


def build_program(
    setting: Setting, coefficients: Array, duration: float, planes: Planes, damping: float
) -> QuadraticProgram:
    """Return the program around the current curves; parameters are those of ``moved_curves``."""
    n = setting.task.drones
    tethers = len(setting.task.tethers)
    trust = setting.trust
    inner = coefficients[:, setting.grid.free]
    arena = setting.task.requirements.arena
    slacks = n + tethers + len(planes.sides)
    rows = Rows(inner.size + slacks)
    upper = np.ones(inner.shape)
    lower = -upper
    if arena is not None:
        lower = np.maximum(lower, np.minimum((arena.lower - inner) / trust, 0.0))
        upper = np.minimum(upper, np.maximum((arena.upper - inner) / trust, 0.0))
    rows.add_bounds(np.arange(inner.size), lower.ravel(), upper.ravel())
    rows.add_bounds(inner.size + np.arange(slacks), 0.0, np.inf)
    for order, cap in enumerate(setting.caps, 1):  # slacks are fractions of the duration
        matrix = setting.grid.rates[order - 1] / duration**order
        _add_limit(rows, setting, matrix, matrix @ coefficients, cap, -float(order), inner.size)
    _add_tethers(rows, setting, inner, inner.size + n)
    _add_planes(rows, setting, planes, inner.size + n + tethers)
    hessian, gradient = _objective(setting, coefficients)
    hessian = hessian + damping * sp.eye_array(inner.size)
    of_limits = np.full(n, TUNING.limit_penalty / n)
    weights = np.append(of_limits, np.full(slacks - n, TUNING.plane_penalty))
    P = sp.csc_array(sp.block_diag([hessian, sp.diags_array(weights)]))
    return QuadraticProgram(P, np.append(gradient, np.zeros(slacks)), *rows.compressed())


def _objective(setting: Setting, coefficients: Array) -> tuple[sp.csc_array[np.float64], Array]:
    """Return the Hessian and gradient of deviation and roughness in the first variables."""
    free = setting.grid.free
    deviation, roughness_energy = setting.grid.energies
    roughness = TUNING.roughness_weight * roughness_energy
    scale = 2.0 * setting.trust / (setting.length_scale**2 * setting.task.drones)
    by_deviation = deviation[free] @ (coefficients - setting.nominal)
    gradient = by_deviation + roughness[free] @ coefficients
    of_axis = scale * setting.trust * (deviation + roughness)[free, free]
    block = sp.kron(sp.csc_array(of_axis), sp.eye_array(3))
    hessian = sp.csc_array(sp.kron(sp.eye_array(setting.task.drones), block))
    return hessian, scale * gradient.ravel()


def _add_tethers(rows: Rows, setting: Setting, inner: Array, slack: int) -> None:
    """Bound the distances of coefficients along their current directions, and so the curves'."""
    first, second, longest = setting.task.tether_arrays
    free = inner.shape[1]  # coefficients of a drone
    lengths = longest[:, None, None]
    offsets = (inner[first] - inner[second]) / lengths  # (tethers, free, 3)
    directions = unit(offsets, min_length=MIN_DIRECTION)
    unused = (1.0 - 0.5 * PLANE_MARGIN - np.linalg.norm(offsets, axis=-1)).ravel()
    # A row per tether and coefficient, with three entries for each of both drones
    by_first = (directions * setting.trust / lengths).ravel()
    entries = np.concatenate([by_first, -by_first])
    coefficients = np.stack([first, second])[..., None] * free + np.arange(free)
    columns = 3 * coefficients[..., None] + np.arange(3)  # (2, tethers, free, 3)
    row = np.arange(len(unused))
    row_of_entry = np.tile(np.repeat(row, 3), 2)
    no_bound = np.full(len(row), -np.inf)
    top = rows.add(row_of_entry, columns.ravel(), entries, no_bound, unused)
    rows.extend(top + row, slack + row // free, -1.0)


def _add_planes(rows: Rows, setting: Setting, planes: Planes, slack: int) -> None:
    """Keep Bernstein coefficients of pieces on their sides of planes, with a slack per plane."""
    m, k = planes.gaps.shape  # planes and coefficients of a piece
    free = setting.grid.count - 2 * END_COUNT
    piece, *drones = planes.sides.T
    entries = setting.grid.extraction[piece][..., None]
    entries = entries * (setting.trust * planes.normals)[:, None, None, :]
    index = piece[:, None] + np.arange(k) - END_COUNT
    index = index[:, None, :, None]  # (m, rows, coefficients, 3)
    is_free = np.broadcast_to((index >= 0) & (index < free), entries.shape)
    every = np.arange(m * k)
    local = np.broadcast_to(every.reshape(m, k, 1, 1), is_free.shape)
    row_parts = list[Indices]()
    column_parts = list[Indices]()
    entry_parts = list[Array]()
    for drone, sign in zip(drones, (1.0, -1.0), strict=True):
        mask = is_free & (drone >= 0)[:, None, None, None]
        columns = 3 * (drone[:, None, None, None] * free + index) + np.arange(3)
        row_parts.append(local[mask])
        column_parts.append(np.broadcast_to(columns, entries.shape)[mask])
        entry_parts.append(sign * entries[mask])
    # Rows of fixed coefficients have no bound
    bounds = 1.0 + PLANE_MARGIN - planes.gaps
    lower = np.where(np.any(is_free, axis=(2, 3)), bounds, -np.inf).ravel()
    top = rows.add(
        np.concatenate(row_parts),
        np.concatenate(column_parts),
        np.concatenate(entry_parts),
        lower,
        np.full(m * k, np.inf),
    )
    rows.extend(top + every, slack + every // k, 1.0)


def _add_limit(
    rows: Rows,
    setting: Setting,
    matrix: Array,
    derivatives: Array,
    cap: Array,
    slack_factor: float,
    slack: int,
) -> None:
    """Limit derivatives (N, k, 3), the ``matrix`` of coefficients, to ``cap`` (N,).

    Changes normal to them are limited to a share of the limit.

    The factor of the slack is the change of a derivative, over its limit, per fraction of duration.
    """
    count = len(derivatives)
    free = setting.grid.count - 2 * END_COUNT
    drones = np.arange(count)[:, None]
    relative = derivatives / cap[:, None, None]
    jacobian = matrix[:, setting.grid.free] * setting.trust
    row, coefficient = np.nonzero(jacobian)
    columns = ((drones * free + coefficient)[..., None] * 3 + np.arange(3)).ravel()
    values = np.broadcast_to(jacobian[row, coefficient] / cap[:, None], (count, len(row)))
    local = np.repeat(drones * len(matrix) + row, 3)

    def add(axis: Array, lower: Array, upper: Array) -> int:
        """Add rows for the component along an axis; return the first one."""
        entries = (values[..., None] * axis[:, row]).ravel()
        return rows.add(local, columns, entries, lower.ravel(), upper.ravel())

    along = unit(relative, EAST, MIN_DIRECTION)
    component = np.sum(relative * along, axis=-1)
    top = add(along, np.full(component.shape, -np.inf), 1.0 - component)
    every = np.arange(component.size)
    rows.extend(top + every, slack + every // len(matrix), slack_factor)

    unused = np.clip(1.0 - np.linalg.norm(relative, axis=-1), 0.0, 1.0)
    share = TUNING.lateral_shares[0] + np.ptp(TUNING.lateral_shares) * unused
    lateral = unit(np.cross(along, np.eye(3)[first_smallest(np.abs(along), 1.0)]))
    for axis in (lateral, np.cross(along, lateral)):
        component = np.sum(relative * axis, axis=-1)
        bound = np.maximum(share, np.abs(component))  # the current value is feasible
        add(axis, -bound - component, bound - component)


CHUNK = 100  # Iterations of OSQP before all rows are checked
MIN_TIME_LIMIT = 1e-3  # [s] Smallest time limit for OSQP, in which zero means no limit


def solve_program(program: QuadraticProgram, max_iterations: int) -> Array | None:
    """Return OSQP's solution (variables,) of a program, whose bounds on variables are rows.

    None if OSQP returns no finite point.

    Only rows near their bounds are enforced at first; others are added when they are violated, and
    the iteration continues. After ``max_iterations`` the last iterate is returned: later programs
    correct its residuals.
    """
    import osqp

    matrix = sp.csr_array(program.A)
    lower = program.lower
    upper = program.upper
    hessian = sp.csc_matrix(sp.triu(program.P))
    enforced = np.minimum(-lower, upper) < TUNING.near_range
    x = np.zeros(len(program.q))
    dual = np.zeros(len(lower))
    step = TUNING.initial_step
    solver = None
    for _ in range(max_iterations // CHUNK):
        if solver is None:
            rows = np.flatnonzero(enforced)
            solver = osqp.OSQP(algebra="builtin")
            solver.setup(
                hessian,
                program.q,
                sp.csc_matrix(matrix[rows]),
                lower[rows],
                upper[rows],
                rho=step,
                **_settings(),
            )
            solver.warm_start(x=x, y=dual[rows])
        result = solver.solve(raise_error=False)
        if result.info.status_val == osqp.SolverStatus.OSQP_SIGINT:
            raise KeyboardInterrupt  # OSQP catches the signal
        check_time()  # an interrupted solve has no solution
        x = np.asarray(result.x, dtype=np.float64)
        if x.shape != program.q.shape or not np.all(np.isfinite(x)):
            return None
        values = matrix @ x
        excess = np.maximum(lower - values, values - upper)
        added = ~enforced & (excess > -TUNING.added_range)
        if np.any(excess[added] > TUNING.solver_tolerance):
            dual[rows] = result.y
            step = result.info.rho_estimate
            solver = None
            enforced |= added
        elif result.info.status_val == osqp.SolverStatus.OSQP_SOLVED:
            break
    return x


def _settings() -> dict[str, float | bool]:
    """Return the settings of OSQP for the next iterations."""
    settings: dict[str, float | bool] = {
        "eps_abs": TUNING.solver_tolerance,
        "eps_rel": TUNING.solver_tolerance,
        "max_iter": CHUNK,
        "polishing": False,
        "verbose": False,
    }
    remaining = time_left()
    if math.isfinite(remaining):
        settings["time_limit"] = max(remaining, MIN_TIME_LIMIT)
    return settings


LEVEL_TOLERANCE = 1e-6  # Largest vertical component of horizontal normals

MIN_HULL_DISTANCE = 1e-6
"""Distance of a hull from the origin, in separations, below which it contains it."""


CURVE_SAMPLES = 17  # Number of samples of a piece that locate its nearest point

PARALLEL_TOLERANCE = 1e-10
"""Squared sine of the angle below which two edges of a triangle count as parallel; the nearest
point is then on an edge."""


class Planes(NamedTuple):
    """Separating planes of pieces of curves; lengths are in separations."""

    sides: Indices  # (m, 3): a piece, its drone, and the drone on the other side; -1 for a prism
    normals: Array
    """(m, 3) [1/m]: toward the first drone, the derivatives of gaps with respect to its
    position."""

    gaps: Array  # (m, degree + 1): gaps of the coefficients; at least 1 if they keep their distance

    def with_margin(self, margin: float) -> Planes:
        """Return the planes with gaps that are smaller by a margin."""
        return self._replace(gaps=self.gaps - margin)


def planes_between(
    curves: Array, separation: Separation, cutoff: float, required: Indices
) -> Planes:
    """Return the widest planes between pieces of two drones whose hulls are nearer than ``cutoff``.

    Lengths are scaled so that a pair's separation is a distance. The difference of two pieces is in
    the hull of its Bernstein coefficients; the point of that hull nearest to the origin is the
    normal of the plane with the widest gap along the whole piece.

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    cutoff: a separation.
    required: (k, 3), sides that have a plane at any distance.
    """
    scaled = curves * separation.scale[:, None]
    sides_by_time = [required]
    for index, piece in enumerate(scaled):
        pairs = close_pairs(Boxes(np.min(piece, axis=-1), np.max(piece, axis=-1)), None, cutoff)
        pieces = np.full(len(pairs), index)
        sides_by_time.append(np.column_stack([pieces, pairs.first, pairs.second]))
    sides, inverse = np.unique(np.concatenate(sides_by_time), axis=0, return_inverse=True)
    pieces, first, second = sides.T
    differences = scaled[pieces, first] - scaled[pieces, second]
    nearest = hull_points(differences)
    distances = length(nearest)
    has_plane = distances < cutoff
    has_plane[inverse.ravel()[: len(required)]] = True
    differences = differences[has_plane]
    normals = _normals(differences, nearest[has_plane], distances[has_plane])
    gaps = np.einsum("md,mdk->mk", normals, differences)
    return Planes(sides[has_plane], normals * separation.scale, gaps)


def _normals(differences: Array, nearest: Array, distances: Array) -> Array:
    """Return the normals (m, 3) of planes between two pieces, toward the first one.

    Drones at equal altitude could pass above or below each other, as rounding decides. A slope of
    horizontal normals lets the first one go up.

    Parameters
    ----------
    differences: (m, 3, degree + 1), of both pieces.
    nearest: (m, 3), the points nearest to the origin of the differences' hulls.
    distances: (m,), of these points.
    """
    # For hulls that contain the origin, the nearest point of the curve defines the plane
    inside = distances < MIN_HULL_DISTANCE
    points = _points_of(differences[inside])
    squared_distances = np.sum(points * points, axis=2)
    largest_squared = np.max(squared_distances, axis=1)  # by which rounding is judged
    closest = first_smallest(squared_distances, scale=largest_squared)
    toward_first = nearest.copy()
    toward_first[inside] = points[np.arange(len(points)), closest]
    normals = unit(toward_first, EAST, MIN_DIRECTION)
    slope = TUNING.normal_slope * np.maximum(TUNING.slope_separation - distances, 0.0)
    normals[:, 2] += np.where(np.abs(normals[:, 2]) < LEVEL_TOLERANCE, slope, 0.0)
    return unit(normals)


def _points_of(pieces: Array) -> Array:
    """Return samples (m, CURVE_SAMPLES, 3) of pieces (m, 3, degree + 1)."""
    weights = bernstein.basis(np.linspace(0.0, 1.0, CURVE_SAMPLES), pieces.shape[-1] - 1)
    return np.swapaxes(pieces @ weights.T, 1, 2)


def hull_points(differences: Array) -> Array:
    """Return the points (m, 3) nearest to the origin of the convex hulls of points (m, 3, k).

    They are computed in closed form over all points, edges and triangles, or are the origin. Since
    hulls are convex they are unique.
    """
    points = np.ascontiguousarray(differences.transpose(1, 2, 0))  # (3, k, m)
    nearest = points[:, 0]
    smallest = _dot(nearest, nearest)
    for size in (1, 2, 3):
        for corners in combinations(range(points.shape[1]), size):
            start, *others = (points[:, corner] for corner in corners)
            candidate, inside = _of_simplex(start, [other - start for other in others])
            squared = _dot(candidate, candidate)
            nearer = inside & (squared < smallest)
            nearest = np.where(nearer, candidate, nearest)
            smallest = np.where(nearer, squared, smallest)
    # A plane through the nearest point bounds the hull unless the origin is inside.
    lowest_product = np.min(np.einsum("dm,dkm->km", nearest, points), axis=0)
    is_bounding = lowest_product > TUNING.bounding_share * smallest
    return np.where(is_bounding, nearest, 0.0).T


def _of_simplex(start: Array, edges: list[Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the points (3, m) of simplices' affine hulls nearest to the origin, and if inside."""
    if not edges:
        return start, np.ones(start.shape[1], dtype=np.bool_)
    first = edges[0]
    last = edges[-1]
    first_square = _dot(first, first)
    last_square = _dot(last, last)
    toward_first = -_dot(first, start)
    toward_last = -_dot(last, start)
    if len(edges) == 1:
        size = first_square
        parts = [toward_first]
        regular = size > 0.0
    else:
        product = _dot(first, last)
        size = first_square * last_square - product * product
        parts = [
            toward_first * last_square - toward_last * product,
            toward_last * first_square - toward_first * product,
        ]
        regular = size > PARALLEL_TOLERANCE * first_square * last_square
    weights = [np.divide(part, size, out=np.zeros_like(size), where=regular) for part in parts]
    inside = regular & np.all([weight > 0.0 for weight in weights], axis=0)
    point = start + sum(weight * edge for weight, edge in zip(weights, edges, strict=True))
    return point, inside & (sum(weights) < 1.0)


def _dot(a: Array, b: Array) -> Array:
    """Return scalar products along the first axis."""
    product: Array = np.einsum("d...,d...->...", a, b)
    return product


def planes_to_prism(
    curves: Array, prism: Prism, radius: float, cutoff: float, arena: Arena | None
) -> Planes:
    """Return planes to a prism for all pieces that may be closer to it than ``cutoff`` [m].

    Consecutive pieces of a drone inside of the prism have the same normal, that of the shortest
    move of all of them out of the prism: nearest faces would pull the path apart.

    Parameters
    ----------
    curves: (pieces, N, 3, degree + 1) [m], Bernstein coefficients.
    radius: minimum distance to the prism [m]
    arena: the box that the drones stay in, or None.
    """
    corners = prism.corners
    low = np.min(corners, axis=0) - cutoff
    high = np.max(corners, axis=0) + cutoff
    near = np.all((np.min(curves, -1) <= high) & (np.max(curves, -1) >= low), axis=-1)
    drone, piece = np.nonzero(near.T)
    coefficients = curves[piece, drone]
    points = _points_of(coefficients)
    clearance = prism.clearance(points)
    nearest = first_smallest(clearance.distance, radius)
    normals = clearance.normals[np.arange(len(nearest)), nearest]
    is_inside = np.min(clearance.distance, axis=1, initial=np.inf) < 0.0
    for first, last in _runs(is_inside, drone, piece):
        normals[first:last] = _way_out(points[first:last].reshape(-1, 3), prism, radius, arena)
    normals = normals / radius
    supports = np.max(normals @ corners.T, axis=1)
    gaps = np.einsum("md,mdk->mk", normals, coefficients) - supports[:, None]
    close = np.min(gaps, axis=1) * radius < cutoff
    sides = np.column_stack([piece, drone, np.full(len(piece), -1)])
    return Planes(sides[close], normals[close], gaps[close])


def _runs(mask: NDArray[np.bool_], drone: Indices, piece: Indices) -> list[tuple[int, int]]:
    """Return first and last index, exclusive, of runs of consecutive pieces of one drone in a mask.

    Pieces (m,) are sorted by drone.
    """
    starts = np.flatnonzero((np.diff(drone) != 0) | (np.diff(piece) != 1)) + 1
    parts = np.split(np.arange(len(mask)), starts)
    return [
        (int(part[0]) + first, int(part[0]) + last)
        for part in parts
        if len(part)
        for first, last in true_runs(mask[part])
    ]


def _way_out(points: Array, prism: Prism, radius: float, arena: Arena | None) -> Array:
    """Return the unit normal (3,) of the shortest move of a path (m, 3) [m] out of a prism.

    The path moves to its right or left, up or down, within the arena if possible.
    """
    chord = points[-1] - points[0]
    right = unit(left_of(-chord), EAST, MIN_DIRECTION)
    directions = np.stack([right, -right, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    supports = np.max(directions @ prism.corners.T, axis=1) + radius
    distances = supports - np.min(directions @ points.T, axis=1)
    if arena is not None:
        moved = points + distances[:, None, None] * directions[:, None]
        outside = np.any((moved < arena.lower) | (moved > arena.upper), axis=(1, 2))
        if not np.all(outside):
            distances = np.where(outside, np.inf, distances)
    shortest: Array = directions[first_smallest(distances[None], radius)[0]]
    return shortest
