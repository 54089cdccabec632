"""The response of vertices to setpoints, against the statics that minimise the energy."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.feedback.vertex_response import VertexResponse, vertex_response
from hitchopt.values import Array

OUTLINES: dict[str, list[list[float]]] = {
    "closed": [[1.0, 1.0], [0.4, 2.3], [1.7, 2.4]],
    "open": [[-1.5, 0.0], [-0.8, 0.9], [0.4, 1.0], [1.3, 0.1]],
}
PUSH = 1e-4
STIFFNESS = 4.75


def response(team: ho.Team, drones: Array, vertices: Array, tensions: Array) -> VertexResponse:
    """The response of one shape."""
    stiffness = np.full(team.drones, STIFFNESS)
    return vertex_response(team, drones[None], vertices[None], tensions[None], stiffness)


@pytest.mark.parametrize("topology", sorted(OUTLINES))
def test_vertices_move_as_in_the_statics(topology: str) -> None:
    team = ho.Team(3, [2.4, 2.5, 2.3], topology=topology, tension=[0.4, 0.4, 0.4])
    plan = ho.hold(ho.Hitch.spread(team, OUTLINES[topology], 1.2), 1.0)
    states = plan.at(0.5)
    found = response(team, states.positions, states.vertices, states.tensions).forward[0]
    pushes = PUSH * np.eye(3 * team.drones).reshape(-1, team.drones, 3)
    sides = [
        ho.settle(
            plan, 0.5, offsets=sign * pushes, stiffness=STIFFNESS, axial_stiffness=1e7
        ).vertices[:, team.layout.clasps]
        for sign in (1.0, -1.0)
    ]
    expected = (sides[0] - sides[1]).reshape(len(pushes), -1).T / (2.0 * PUSH)
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_a_shift_of_all_setpoints_shifts_all_vertices() -> None:
    team = ho.Team(4, 2.4)
    hitch = ho.Hitch.balanced(team, [[1.0, 1.0], [1.0, 2.0], [2.0, 2.2], [2.0, 1.0]], 1.0)
    found = response(team, hitch.drones, hitch.vertices, team.tension)
    shift = np.array([0.3, -0.2, 0.5])
    moved = found.forward[0] @ np.tile(shift, 8)
    np.testing.assert_allclose(moved.reshape(-1, 3), np.tile(shift, (4, 1)), atol=1e-9)


def test_the_inverse_moves_vertices_by_less_than_asked_and_never_the_other_way() -> None:
    team = ho.Team(3, 2.4)
    hitch = ho.Hitch.spread(team, OUTLINES["closed"], 1.0)
    found = response(team, hitch.drones, hitch.vertices, team.tension)
    both = found.forward[0] @ found.inverse[0]
    values = np.linalg.eigvalsh(0.5 * (both + both.T))
    np.testing.assert_allclose(both, both.T, atol=1e-9)
    assert values[0] > 0.0
    assert values[-1] < 1.0
