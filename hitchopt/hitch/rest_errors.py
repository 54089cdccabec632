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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.energy import AXIAL_STIFFNESS, HitchEnergy, energy_of
from hitchopt.hitch.flight_controller import STOCK, Tube
from hitchopt.hitch.team import Errors, Team
from hitchopt.values import Array

REMAINDER_FACTOR = 2.0
"""Factor of the largest difference to first order, as errors are worst cases to first order."""

UNSTATED_ERROR = 0.02
"""[m] Error of drones at rest without controllers, measurements and ``limits.tracking``."""

MAX_RESIDUAL = 1e-6  # Largest force residual of a hitch at rest [N]


def responses(energy: HitchEnergy, x: Array) -> Array:
    """Return derivatives (o, 7n, 3) of tensions and points, o = n + 3 points, by the errors.

    Errors are n lengths, as first components, 2n setpoints, 2n forces on drones, and 2n logarithms
    of a leg's tension over its edge's, as first components. Nodes x (1, nodes, 3) [m] are those of
    one sample at rest.
    """
    nodes, cables = energy.nodes, np.arange(len(energy.nodes))
    blocks, tensions, softness = energy.linear(x)
    count = len(cables) + 3 * len(energy.points)
    seeds = np.zeros((*x.shape, count))  # outputs by nodes
    slopes = tensions[0].reshape(-1, 4, 3)
    slopes[:, 1:3, 2] += 0.5 * energy.weight  # tensions are those at the edges' midpoints
    for k in range(4):  # one by one, as the end of a chain occurs twice
        seeds[0, nodes[:, k], :, cables] += slopes[:, k]
    for axis in range(3):
        seeds[0, energy.points, axis, np.arange(len(cables) + axis, count, 3)] = 1.0
    matrix = energy.matrix(x, blocks)
    y = energy.solved(matrix, seeds)
    direct = seeds.reshape(-1, count) - matrix @ y.reshape(-1, count)
    y, direct = y[0].T.swapaxes(1, 2), direct.T.reshape(count, -1, 3)
    pulls = softness[0, :, None] * blocks[0, ..., 12]
    cable = np.einsum("onai,nai->on", y[:, nodes], pulls.reshape(-1, 4, 3))
    cable[cables, cables] -= softness[0]
    force, curvature = y[:, : energy.drones], energy.springs(x)[2][0]
    position = np.where(curvature > 0.0, curvature * force, direct[:, : energy.drones])
    leg_pulls = energy.leg_pulls(x)[0]
    inner_over_outer = y[:, nodes[:, [1, 3]]] - y[:, nodes[:, [0, 2]]]
    friction = -np.einsum("onli,nli->onl", inner_over_outer, leg_pulls).reshape(count, -1)
    lengths, ratios = (
        np.pad(row[..., None], ((0, 0), (0, 0), (0, 2))) for row in (cable, friction)
    )
    return np.concatenate([lengths, position, force, ratios], axis=1)


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
    radii: (S, points) [m], bounds of the distances from the planned places.
    parts: (S, points, 3) [m], the contributions of cables, drones and friction along the direction
        in which a vertex may be off farthest, to first order.
    """

    radii: Array
    parts: Array


KINDS = ("cables", "drones", "friction")
"""Kinds of errors in the order of ``VertexErrors.parts``."""


def vertex_errors(team: Team, samples: Mapping[str, Array], sizes: ErrorSizes) -> VertexErrors:
    """Return bounds of the errors of vertices in samples at rest (S, …), see ``planned_rest``.

    Position loops hold the planned pulls by their feed-forward. Their stiffness is that of the
    controllers, of rigid ones the largest that flies. Integrals are not counted.
    """
    n, loops = team.robots, loops_of(team)
    energy = energy_of(team, loops, samples)
    nodes = energy.at_rest()
    vertices = nodes[:, energy.points]
    of_samples = [
        _first_order(
            energy_of(team, loops, {name: x[i : i + 1] for name, x in samples.items()}),
            nodes[i : i + 1],
            sizes,
        )
        for i in range(len(nodes))
    ]
    radii, parts, predicted, corners = (
        np.array(values) for values in zip(*of_samples, strict=True)
    )
    lengths, offsets, friction = np.split(corners, [n, n + team.drones], axis=1)
    differences = list[Array]()
    for sign in (1.0, -1.0):
        errors = sign * lengths[..., 0], sign * offsets, sign * friction[..., 0].reshape(-1, n, 2)
        moved = settled(team, samples, *errors) - vertices
        differences.append(np.max(length(moved - sign * predicted), axis=1))
    beyond = REMAINDER_FACTOR * np.max(differences, axis=0)
    remainder = np.where(np.isfinite(beyond), beyond, np.inf)
    displaced = length(vertices - samples["vertices"])
    return VertexErrors(radii + displaced + remainder[:, None], parts)


def _first_order(
    energy: HitchEnergy, x: Array, sizes: ErrorSizes
) -> tuple[Array, Array, Array, Array]:
    """Return what errors move to first order, of one sample at rest with nodes x (1, nodes, 3) [m].

    These are bounds for all vertices (points,) [m], and their ``parts`` (points, 3) [m]; the moves
    (points, 3) [m] by the errors that move the worst vertex farthest; and these errors, vectors
    (5n, 3): n of lengths and 2n coefficients of friction as first components, 2n of setpoints.
    """
    n, drones = len(energy.nodes), energy.drones
    rows = responses(energy, x)[n:]
    by_lengths, by_setpoints, _, by_ratios = np.split(rows, [n, n + drones, n + 2 * drones], axis=1)
    scale = sizes.drone.level * np.array([1.0, 1.0, sizes.drone.ratio])
    by_friction = energy.bends(x)[0].reshape(-1, 1) * by_ratios
    size = np.concatenate(
        [
            np.full((n, 3), sizes.cable),
            np.tile(scale, (drones, 1)),
            np.full((2 * n, 3), sizes.friction),
        ]
    )
    moves = size * np.concatenate([by_lengths, by_setpoints, by_friction], axis=1)
    moves = moves.reshape(-1, 3, len(size), 3)
    squares = np.einsum("pijc,pkjc->jpik", moves, moves)
    axes, directions = np.linalg.eigh(enclosing_ellipsoids(squares))
    radii = np.sqrt(np.maximum(axes[:, -1], 0.0))
    pushes = np.einsum("pi,pijc->pjc", directions[..., -1], moves)
    by_kind = np.split(length(pushes), [n, n + drones], axis=-1)
    parts = np.stack([np.sum(values, axis=-1) for values in by_kind], axis=-1)
    worst = unit(pushes[int(np.argmax(radii))])
    return radii, parts, np.einsum("pijc,jc->pi", moves, worst), size * worst


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
    x = energy.at_rest()
    residual = np.max(np.abs(energy.slopes(x)), axis=(1, 2))
    x = np.where((residual <= MAX_RESIDUAL)[:, None, None], x, np.nan)
    if np.any(friction):
        x = energy.rest_with_friction(x, friction)
    return np.asarray(x[:, energy.points])


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
