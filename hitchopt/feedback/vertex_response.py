"""Linear response of a hitch's vertices to its drones' setpoints, at rest and without friction.

Drones are springs to their setpoints, cables are straight and of constant length, and slide freely
through their clasps. A small shift δ of the setpoints moves the nodes y (drones, then clasps) and
changes the tensions T by

    K y + Aᵀ T = k δ,    A y = 0,

K being the drones' stiffness and that of straight cables across their direction, ``T/s`` per span
of length s, and A the slopes of the cables' lengths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import Team
from hitchopt.hitch.layout import Index
from hitchopt.values import Array

DAMPING = 0.3
"""Singular value of the response below which a mode is corrected by less than half: to move the
vertices there takes setpoints more than three times as far."""

LEAST_LENGTH = 1e-6
"""[m] Length of a span below which it counts as that long."""


@dataclass(frozen=True, eq=False)
class VertexResponse:
    """What setpoints do to vertices at S places of a plan.

    Attributes
    ----------
    forward: (S, 3 clasps, 6n), how far vertices move by the setpoints' shifts.
    inverse: (S, 6n, 3 clasps), the damped least shifts of setpoints that move vertices as wanted.
    """

    forward: Array
    inverse: Array


def vertex_response(
    team: Team, drones: Array, vertices: Array, tensions: Array, stiffness: Array
) -> VertexResponse:
    """Return the response at S shapes of the hitch.

    Parameters
    ----------
    drones, vertices: (S, 2n, 3), (S, points, 3) [m]
    tensions: (S, n) [N]
    stiffness: (2n,) of the drones' position loops [N/m].
    """
    nodes = np.concatenate([drones, vertices[:, team.layout.clasps]], axis=1)
    first, last, cable = _spans(team)
    found = [
        _forward(each, first, last, cable, pulls, stiffness)
        for each, pulls in zip(nodes, tensions, strict=True)
    ]
    forward = np.reshape(found, (len(nodes), -1, 3 * team.drones))
    turned = np.swapaxes(forward, 1, 2)
    gram = forward @ turned + DAMPING**2 * np.eye(forward.shape[1])
    return VertexResponse(forward, np.swapaxes(np.linalg.solve(gram, forward), 1, 2))


def _spans(team: Team) -> tuple[Index, Index, Index]:
    """Return the first and last nodes of all spans of cable, and their cables."""
    layout, n = team.layout, team.robots
    node = np.full(layout.points, -1)
    node[layout.clasps] = team.drones + np.arange(len(layout.clasps))
    chains = np.column_stack(
        [2 * np.arange(n), node[layout.starts], node[layout.ends], 2 * np.arange(n) + 1]
    )
    cable, place = np.nonzero(chains >= 0)
    flat = chains[cable, place]
    same = cable[1:] == cable[:-1]
    return flat[:-1][same], flat[1:][same], cable[1:][same]


def _forward(
    nodes: Array, first: Index, last: Index, cable: Index, tensions: Array, stiffness: Array
) -> Array:
    """Return (3 clasps, 6n), by how much clasps move with the drones' setpoints."""
    count, drones = len(nodes), len(stiffness)
    along = nodes[last] - nodes[first]
    lengths = np.maximum(np.linalg.norm(along, axis=-1), LEAST_LENGTH)
    unit = along / lengths[:, None]
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    across *= (tensions[cable] / lengths)[:, None, None]
    size = 3 * count
    matrix = np.zeros((size + len(tensions), size + len(tensions)))
    stiff = np.zeros((count, count, 3, 3))
    for a, b, sign in ((first, first, 1), (last, last, 1), (first, last, -1), (last, first, -1)):
        np.add.at(stiff, (a, b), sign * across)
    matrix[:size, :size] = stiff.transpose(0, 2, 1, 3).reshape(size, size)
    held = np.arange(3 * drones)
    matrix[held, held] += np.repeat(stiffness, 3)
    slopes = np.zeros((len(tensions), count, 3))
    np.add.at(slopes, (cable, first), -unit)
    np.add.at(slopes, (cable, last), unit)
    matrix[size:, :size] = slopes.reshape(len(tensions), size)
    matrix[:size, size:] = matrix[size:, :size].T
    pushed = np.zeros((len(matrix), 3 * drones))
    pushed[held, held] = np.repeat(stiffness, 3)
    return np.linalg.solve(matrix, pushed)[3 * drones : size].astype(np.float64)
