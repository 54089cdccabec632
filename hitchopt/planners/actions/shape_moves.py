"""Actions that move vertices straight, or none: ``move_vertex``, ``move_edge``, ``adjust``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.planners.actions.action import Action, drone_names, straight_vertices
from hitchopt.planners.timing.flight_curves import MOVES

Array = NDArray[np.float64]


def move_vertex(start: Hitch, polygon: Outline, vertex: int) -> Action:
    """Return the paper's action 2: of the outline only ``vertex`` changes.

    ``e_k`` and ``d_{k-1}`` are kept, so ``q_k``, ``r_{k-1}`` go with the vertex and ``q_{k+1}``,
    ``r_{k-2}`` turn with its edges; where tensions differ, so may others at ``p_{k-1}, p_{k+1}``.
    """
    length, share = legs_kept_by_vertex(start, vertex)
    return Action(
        start,
        polygon,
        straight_vertices(start, polygon),
        length,
        share,
        vertex_movers(start, vertex),
    )


def legs_kept_by_vertex(start: Hitch, vertex: int) -> tuple[Array, Array]:
    """Return length and share of the law under which a vertex moves: ``e_k`` kept, else ``d``."""
    length, share = start.q_legs.copy(), np.zeros(start.team.robots)
    if start.team.layout.closed or vertex < start.team.robots:
        length[vertex], share[vertex] = -start.r_legs[vertex], 1.0
    return length, share


def vertex_movers(start: Hitch, vertex: int) -> tuple[str, ...]:
    """Return the four drones that the paper names, fewer near a chain's ends.

    At its very ends the edge's cable has one leg only, whose drone moves as the edge's length does.
    """
    q, r = [vertex, vertex + 1], [vertex - 1, vertex - 2]
    if not start.team.layout.closed:
        r += [0] if vertex == 0 else []
        q += [vertex - 1] if vertex == start.team.robots else []
    return drone_names(start.team, q, r)


def move_edge(start: Hitch, polygon: Outline, edge: int) -> Action:
    """Return the paper's action 3: of the outline only the ends of ``edge`` change.

    ``d_{k-1}`` and ``e_{k+1}`` are kept, and the fractions of cable k. Where the ends slide along
    the lines of edges k-1 and k+1 only ``q_k, r_k, r_{k-1}, q_{k+1}`` move; else those edges turn,
    and ``r_{k-2}, q_{k+2}`` with them.
    """
    n = start.team.robots
    length, share = start.q_legs.copy(), np.zeros(n)
    length[edge], share[edge] = 0.0, start.fractions[edge]
    after = edge + 1
    if start.team.layout.closed or after < n:
        length[after % n], share[after % n] = -start.r_legs[after % n], 1.0
    q, r = [edge, edge + 1], [edge, edge - 1]
    if _turned(start, polygon, edge - 1):
        r.append(edge - 2)
    if _turned(start, polygon, edge + 1):
        q.append(edge + 2)
    named = drone_names(start.team, q, r)
    return Action(start, polygon, straight_vertices(start, polygon), length, share, named)


def adjust(start: Hitch, q_legs: Array) -> Action:
    """Return the paper's action 4: cables slide through their clasps to ``q_legs`` (n,) [m].

    Drones move of those cables only whose legs change.
    """
    sliding = np.flatnonzero(np.abs(q_legs - start.q_legs) > MOVES)
    return Action(
        start,
        start.polygon,
        straight_vertices(start, start.polygon),
        start.q_legs.copy(),
        np.zeros(start.team.robots),
        drone_names(start.team, sliding.tolist(), sliding.tolist()),
    )


def _turned(start: Hitch, polygon: Outline, edge: int) -> bool:
    """Return whether an edge changes its direction; False for one beyond a chain's end."""
    count = start.team.robots
    if not start.team.layout.closed and not 0 <= edge < count:
        return False
    before, after = (p.edge_directions[edge % count] for p in (start.polygon, polygon))
    return bool(np.linalg.norm(after - before) * polygon.edge_lengths[edge % count] > MOVES)
