"""Errors of a hitch's vertices at rest that errors of cables, drones and friction cause.

At rest the gradient of the energy is zero for any error p, so ``H dx = -∂gradient/∂p dp``.
The derivatives ``A_k`` of a tension by the nodes are minus those of the gradient by the length of
cable k: ``dx = H⁻¹ A_k dL_k``. Sensitivities of outputs follow from the adjoint, ``Y = H⁻¹ B`` for
derivatives B of the outputs by the nodes. To first order an error within a ball moves a vertex
within an ellipsoid, and independent errors within the sum of theirs, which one ellipsoid contains.

The remainder beyond first order is estimated: the hitch settles with the errors that move its worst
vertex farthest, in both directions, and twice the largest difference to first order is added.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hitchopt.drones.controllers import STOCK, Tube
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.energy import (
    AXIAL_STIFFNESS,
    CABLE_COORDINATES,
    CableSlopes,
    HitchEnergy,
    energy_of,
)
from hitchopt.hitch.team import Errors, Team
from hitchopt.values import Array

REMAINDER_FACTOR = 2.0
"""Factor of the largest difference to first order, since errors are worst cases to first order."""

UNSTATED_ERROR = 0.02
"""[m] Error of drones at rest without controllers, measurements and ``limits.tracking``."""

MAX_RESIDUAL = 1e-6  # [N] Largest force residual of a hitch at rest


def responses(energy: HitchEnergy, x: Array) -> Array:
    """Return derivatives (o, 7n, 3) of tensions and points in the errors, o = n + 3 points.

    Errors are n lengths, as first components, 2n setpoints, 2n forces on drones, and 2n logarithms
    of a leg's tension over its edge's, as first components. Nodes x (1, nodes, 3) [m] are those of
    one sample at rest.
    """
    slopes = energy.linear(x)
    by_nodes = _derivatives_by_nodes(energy, slopes)  # B
    outputs = by_nodes.shape[-1]

    # The adjoint Y = H⁻¹ B, and what of B rigid drones cause directly
    matrix = energy.matrix(x, slopes.forces)
    solution = energy.solved(matrix, by_nodes[None])
    residual = by_nodes.reshape(-1, outputs) - matrix[0] @ solution.reshape(-1, outputs)
    adjoint = solution[0].T.swapaxes(1, 2)  # (o, nodes, 3)
    direct = residual.T.reshape(outputs, -1, 3)

    by_forces = adjoint[:, : energy.drones]
    curvatures = energy.springs(x).curvatures[0]
    by_setpoints = np.where(curvatures > 0.0, curvatures * by_forces, direct[:, : energy.drones])
    by_lengths = _derivatives_by_lengths(energy, slopes, adjoint)
    by_ratios = _derivatives_by_ratios(energy, x, adjoint)
    return np.concatenate(
        [_as_vectors(by_lengths), by_setpoints, by_forces, _as_vectors(by_ratios)], axis=1
    )


def _derivatives_by_nodes(energy: HitchEnergy, slopes: CableSlopes) -> Array:
    """Return derivatives (nodes, 3, o) of the tensions at the edges' midpoints, then of points."""
    cables = np.arange(len(energy.nodes))
    outputs = len(cables) + 3 * len(energy.points)
    by_nodes = np.zeros((len(energy.free), 3, outputs))
    tensions = slopes.tensions[0].reshape(-1, 4, 3).copy()
    tensions[:, 1:3, 2] += 0.5 * energy.weight  # the midpoint of an edge rises with both its ends
    for node in range(4):  # one by one, since the end of a chain occurs twice
        by_nodes[energy.nodes[:, node], :, cables] += tensions[:, node]
    for axis in range(3):
        coordinates = np.arange(len(cables) + axis, outputs, 3)
        by_nodes[energy.points, axis, coordinates] = 1.0
    return by_nodes


def _derivatives_by_lengths(energy: HitchEnergy, slopes: CableSlopes, adjoint: Array) -> Array:
    """Return derivatives (o, n) by the lengths of cables, from the adjoint (o, nodes, 3)."""
    cables = np.arange(len(energy.nodes))
    forces_by_tension = slopes.forces[0, ..., CABLE_COORDINATES]
    forces_by_length = slopes.softness[0, :, None] * forces_by_tension
    at_nodes = forces_by_length.reshape(-1, 4, 3)
    by_lengths = np.einsum("onai,nai->on", adjoint[:, energy.nodes], at_nodes)
    by_lengths[cables, cables] -= slopes.softness[0]  # a longer cable has less tension itself
    return np.asarray(by_lengths)


def _derivatives_by_ratios(energy: HitchEnergy, x: Array, adjoint: Array) -> Array:
    """Return derivatives (o, 2n) by logarithms of tension ratios, from the adjoint (o, nodes, 3).

    A larger tension pulls the nodes at the start and end of a leg together.
    """
    at_starts = adjoint[:, energy.nodes[:, [0, 2]]]
    at_ends = adjoint[:, energy.nodes[:, [1, 3]]]
    by_ratios = -np.einsum("onli,nli->onl", at_ends - at_starts, energy.leg_pulls(x)[0])
    return np.asarray(by_ratios.reshape(len(adjoint), -1))


def _as_vectors(scalars: Array) -> Array:
    """Return scalars (o, k) as first components of vectors (o, k, 3)."""
    return np.pad(scalars[..., None], ((0, 0), (0, 0), (0, 2)))


def enclosing_ellipsoids(ellipsoids: Array) -> Array:
    """Return ellipsoids (points, 3, 3) [m²] that contain sums of others (errors, points, 3, 3).

    E stands for the points v with ``vᵀ E⁻¹ v ≤ 1``. The sum of E_j lies within ``(Σ √tr E_j) Σ
    E_j/√tr E_j``, which has the least sum of squared axes among such bounds.
    """
    roots = np.sqrt(np.trace(ellipsoids, axis1=-2, axis2=-1))[..., None, None]
    weights = np.sum(roots, axis=0) / np.where(roots > 0.0, roots, np.inf)
    return np.asarray(np.sum(weights * ellipsoids, axis=0))


@dataclass(frozen=True, eq=False)
class ErrorSizes:
    """Largest errors at rest, all independent of each other.

    Attributes
    ----------
    cable: of every cable's length [m].
    drone: of every drone's setpoint, within an ellipsoid.
    friction: coefficient of friction at the clasps.
    """

    cable: float
    drone: Tube
    friction: float

    @classmethod
    def of(cls, team: Team, tracking: float | Tube | None) -> ErrorSizes:
        """Return a team's errors; ``tracking`` are the errors of drones that a plan allows for."""
        errors = team.errors or Errors()
        drone = errors.drone
        if drone is None:
            drone = UNSTATED_ERROR if tracking is None else tracking
        return cls(errors.cable_length, Tube.of(drone), errors.friction)


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Bounds of how far vertices are off in S samples at rest.

    Attributes
    ----------
    radii: (S, points) [m], bounds of the distances from the planned positions.
    parts: (S, points, 3) [m], the contributions of cables, drones and friction along the direction
        in which a vertex may be off farthest, to first order.
    """

    radii: Array
    parts: Array


KINDS = ("cable lengths", "drone positions", "friction")
"""Kinds of errors in the order of ``VertexErrors.parts``."""


def vertex_errors(team: Team, samples: Mapping[str, Array], sizes: ErrorSizes) -> VertexErrors:
    """Return bounds of the errors of vertices in samples at rest (S, …), see ``planned_rest``.

    Position loops hold the planned pulls by their feed-forward. Their stiffness is that of the
    controllers, of rigid ones the largest that flies. Integrals are ignored.
    """
    loops = loops_of(team)
    energy = energy_of(team, loops, samples)
    nodes = energy.at_rest()
    vertices = nodes[:, energy.points]
    of_samples = list[FirstOrder]()
    for i in range(len(nodes)):
        one_sample = {name: values[i : i + 1] for name, values in samples.items()}
        of_sample = energy_of(team, loops, one_sample)
        of_samples.append(FirstOrder.of(of_sample, nodes[i : i + 1], sizes))
    predicted = np.array([sample.moves for sample in of_samples])
    worst_errors = np.array([sample.worst_errors for sample in of_samples])
    both_ways = {name: np.concatenate([values, values]) for name, values in samples.items()}
    with_errors = _settled_with(team, both_ways, np.concatenate([worst_errors, -worst_errors]))
    moves = with_errors.reshape(2, *vertices.shape) - vertices
    differences = np.max(length(moves - np.stack([predicted, -predicted])), axis=-1)
    beyond = REMAINDER_FACTOR * np.max(differences, axis=0)
    remainder = np.where(np.isfinite(beyond), beyond, np.inf)
    displaced = length(vertices - samples["vertices"])
    radii = np.array([sample.radii for sample in of_samples])
    parts = np.array([sample.parts for sample in of_samples])
    return VertexErrors(radii + displaced + remainder[:, None], parts)


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """Displacements by errors to first order, in one sample at rest."""

    radii: Array  # (points,) [m], bounds for all vertices
    parts: Array  # (points, 3) [m], contributions as in ``VertexErrors``
    moves: Array  # (points, 3) [m], moves by the errors that move the worst vertex farthest
    worst_errors: Array
    """(5n, 3), these errors: of n lengths, first components [m], of 2n setpoints [m], and 2n
    coefficients of friction, first components."""

    @classmethod
    def of(cls, energy: HitchEnergy, x: Array, sizes: ErrorSizes) -> FirstOrder:
        """Return the displacements by errors at nodes x (1, nodes, 3) [m]."""
        n = len(energy.nodes)
        drones = energy.drones
        largest = _largest_errors(n, drones, sizes)
        # Moves (points, 3, errors, 3) by the components of every largest error
        moves = (largest * _derivatives_of_points(energy, x)).reshape(-1, 3, len(largest), 3)
        ellipsoids = np.einsum("pijc,pkjc->jpik", moves, moves)
        squared_axes, directions = np.linalg.eigh(enclosing_ellipsoids(ellipsoids))
        radii = np.sqrt(np.maximum(squared_axes[:, -1], 0.0))
        along_longest = np.einsum("pi,pijc->pjc", directions[..., -1], moves)
        by_kind = np.split(length(along_longest), [n, n + drones], axis=-1)
        parts = np.stack([np.sum(values, axis=-1) for values in by_kind], axis=-1)
        worst = unit(along_longest[int(np.argmax(radii))])
        return cls(
            radii=radii,
            parts=parts,
            moves=np.einsum("pijc,jc->pi", moves, worst),
            worst_errors=largest * worst,
        )


def _derivatives_of_points(energy: HitchEnergy, x: Array) -> Array:
    """Return derivatives (3 points, 5n, 3) by errors in the order of ``FirstOrder``."""
    n = len(energy.nodes)
    drones = energy.drones
    by_errors = responses(energy, x)[n:]
    by_lengths, by_setpoints, _, by_ratios = np.split(
        by_errors, [n, n + drones, n + 2 * drones], axis=1
    )
    # By the capstan equation, a ratio's logarithm is friction times the bend at the vertex.
    by_friction = energy.bends(x)[0].reshape(-1, 1) * by_ratios
    return np.concatenate([by_lengths, by_setpoints, by_friction], axis=1)


def _largest_errors(cables: int, drones: int, sizes: ErrorSizes) -> Array:
    """Return the largest errors (5n, 3) in the order of ``FirstOrder``."""
    of_lengths = np.full((cables, 3), sizes.cable)
    of_setpoint = sizes.drone.level * np.array([1.0, 1.0, sizes.drone.ratio])
    of_setpoints = np.tile(of_setpoint, (drones, 1))
    of_friction = np.full((2 * cables, 3), sizes.friction)
    return np.concatenate([of_lengths, of_setpoints, of_friction])


def _settled_with(team: Team, samples: Mapping[str, Array], errors: Array) -> Array:
    """Return vertices (S, points, 3) [m] at rest with errors (S, 5n, 3) as in ``FirstOrder``."""
    n = team.robots
    lengths, offsets, friction = np.split(errors, [n, n + team.drones], axis=1)
    return settled(team, samples, lengths[..., 0], offsets, friction[..., 0].reshape(-1, n, 2))


def settled(
    team: Team, samples: Mapping[str, Array], lengths: Array, offsets: Array, friction: Array
) -> Array:
    """Return vertices (S, points, 3) [m] at rest with errors; nan where there is no rest.

    Errors are those of lengths (S, n) [m], of setpoints (S, 2n, 3) [m], and the coefficients of
    friction (S, n, 2) at both clasps of each cable, positive where the leg pulls more.
    """
    perturbed = {
        **samples,
        "cable_length": samples["cable_length"] + lengths,
        "offsets": samples["offsets"] + offsets,
    }
    energy = energy_of(team, loops_of(team), perturbed)
    nodes = energy.at_rest()
    residuals = np.max(np.abs(energy.slopes(nodes)), axis=(1, 2))
    nodes = np.where((residuals <= MAX_RESIDUAL)[:, None, None], nodes, np.nan)
    if np.any(friction):
        nodes = energy.rest_with_friction(nodes, friction)
    return np.asarray(nodes[:, energy.points])


def longest_period(team: Team, samples: Mapping[str, Array]) -> float:
    """Return the longest period [s] with which a hitch at rest (S = 1) swings without friction.

    Each node has its drone's mass or its load, and half of each span's mass.
    """
    energy = energy_of(team, loops_of(team), samples)
    nodes = energy.at_rest()
    (stiffness,) = energy.matrix(nodes, energy.linear(nodes).forces)
    masses = np.concatenate([team.mass, np.zeros(len(energy.free) - energy.drones)])
    masses[energy.points[team.layout.clasps]] += team.load
    halves = 0.5 * team.cable_density * energy.spans(nodes[:, energy.nodes]).lengths[0]
    for span in range(3):
        np.add.at(masses, energy.nodes[:, span], halves[:, span])
        np.add.at(masses, energy.nodes[:, span + 1], halves[:, span])
    # Eigenvalues of K⁻¹ M are squares of the periods over 2π; massless nodes have none
    squares = np.linalg.eigvals(np.linalg.solve(stiffness, np.diag(np.repeat(masses, 3))))
    return 2.0 * math.pi * math.sqrt(float(np.max(squares.real)))


def loops_of(team: Team) -> dict[str, Array]:
    """Return the conditions of ``energy_of`` for position loops that hold the planned pulls."""
    stiffest = STOCK["mellinger"].stiffest[0] * team.mass[:, None]
    return {
        "stiffness": np.where(np.isinf(team.stiffness), stiffest, team.stiffness),
        "integral": np.zeros((team.drones, 3)),
        "feed_forward": np.ones(team.drones),
        "load": team.load,
        "cable_density": np.array(team.cable_density),
        "axial_stiffness": np.array(AXIAL_STIFFNESS),
    }


def planned_rest(
    team: Team, positions: Array, vertices: Array, tensions: Array, cable_forces: Array
) -> dict[str, Array]:
    """Return samples of a hitch at rest as planned (S, …), for ``energy_of``.

    Positions (S, 2n, 3), vertices (S, points, 3) [m], tensions (S, n), cable forces (S, 2n, 3) [N].
    """
    samples = len(positions)
    return {
        "positions": positions,
        "vertices": vertices,
        "tensions": tensions,
        "cable_forces": cable_forces,
        "cable_length": np.tile(team.cable_length, (samples, 1)),
        "offsets": np.zeros(positions.shape),
        "forces": np.zeros(positions.shape),
    }
