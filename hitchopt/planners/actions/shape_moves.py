"""The paper's actions ``move_vertex``, ``move_edge`` and ``adjust``, and ``follow_vertex``."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import make_interp_spline

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.planners.actions.action import Action, drone_names
from hitchopt.planners.timing.flight_curves import MOVES
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SAME_PLACE = 1e-6
"""[m] Largest distance of a point at t = 0 from the vertex."""

STILL = 1e-9
"""[m] Distance of consecutive points below which the vertex stands still."""


def move_vertex(start: Hitch, polygon: Outline, vertex: int) -> Action:
    """Return the paper's action 2: of the outline only ``vertex`` changes.

    ``e_k`` and ``d_{k-1}`` are kept, so ``q_k``, ``r_{k-1}`` go with the vertex and ``q_{k+1}``,
    ``r_{k-2}`` turn with its edges; where tensions differ, so may others at ``p_{k-1}, p_{k+1}``.
    """
    return Action(start, polygon, *vertex_law(start, vertex))


def vertex_law(start: Hitch, vertex: int) -> tuple[Array, Array, tuple[str, ...]]:
    """Return length and share of the law by which a vertex moves, and the drones that it names.

    ``e_k`` is kept, else ``d``. The paper names four drones, fewer near a chain's ends. At its very
    ends the edge's cable has one leg only, whose drone moves as the edge's length does.
    """
    closed, n = start.team.layout.closed, start.team.robots
    length, share = start.q_legs.copy(), np.zeros(n)
    if closed or vertex < n:
        length[vertex], share[vertex] = -start.r_legs[vertex], 1.0
    q, r = [vertex, vertex + 1], [vertex - 1, vertex - 2]
    if not closed:
        r += [0] if vertex == 0 else []
        q += [vertex - 1] if vertex == n else []
    return length, share, drone_names(start.team, q, r)


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
    return Action(start, polygon, length, share, drone_names(start.team, q, r))


def adjust(start: Hitch, q_legs: Array) -> Action:
    """Return the paper's action 4: cables slide through their clasps to ``q_legs`` (n,) [m].

    Drones move of those cables only whose legs change.
    """
    sliding = np.flatnonzero(np.abs(q_legs - start.q_legs) > MOVES).tolist()
    named = drone_names(start.team, sliding, sliding)
    return Action(start, start.polygon, start.q_legs, np.zeros(start.team.robots), named)


def _turned(start: Hitch, polygon: Outline, edge: int) -> bool:
    """Return whether an edge changes its direction; False for one beyond a chain's end."""
    count = start.team.robots
    if not start.team.layout.closed and not 0 <= edge < count:
        return False
    before, after = (p.edge_directions[edge % count] for p in (start.polygon, polygon))
    return bool(np.linalg.norm(after - before) * polygon.edge_lengths[edge % count] > MOVES)


def follow_vertex(start: Hitch, polygon: Outline, vertex: int, points: Array) -> Action:
    """Return the action that leads ``vertex`` along timed points, legs kept as by move_vertex.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    vertex: which.
    points: (J, 3), rows ``t, x, y`` [s, m, m]; t increases from 0 or later.

    Raises
    ------
    InfeasibleError: a point at t = 0 that is not where the vertex is.
    """
    here = start.vertices[vertex, :2]
    if points[0, 0] == 0.0:
        _check_begin(here, points[0, 1:], vertex)
        points = points[1:]
    times = np.append(0.0, points[:, 0])
    track = vertex_track(times, np.vstack([here, points[:, 1:]]))
    still = np.repeat(start.vertices[None, ..., None], track.pieces, axis=0)
    coefficients = np.repeat(still, track.degree + 1, axis=-1)
    coefficients[:, vertex, :2] = track.coefficients
    seconds = float(times[-1])
    path = PiecewisePolynomial(times / seconds, coefficients)
    return Action(start, polygon, *vertex_law(start, vertex), path, seconds)


def vertex_track(times: Array, places: Array) -> PiecewisePolynomial:
    """Return the path through ``places`` (J, d) [m] at ``times`` (J,) [s], one piece each.

    Each moving stretch is a quintic spline with four continuous derivatives, which is the smoothest
    one in the sense of least jerk; it is at rest at both ends.
    """
    gaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    resting = gaps < STILL
    # A stretch ends where the vertex stops or starts.
    changes = np.flatnonzero(resting[1:] | resting[:-1]) + 1
    bounds = [0, *changes.tolist(), len(gaps)]
    coefficients = np.empty((len(gaps), places.shape[1], 6))
    still = np.zeros(places.shape[1])
    rest = [(1, still), (2, still)]  # the stubs know of one condition an end, scipy of any
    for first, last in pairwise(bounds):
        span = slice(first, last)
        if resting[first]:
            coefficients[span] = places[span, :, None]
            continue
        knots = times[first : last + 1]
        met = places[first : last + 1]
        spline = make_interp_spline(knots - knots[0], met, k=5, bc_type=(rest, rest))  # type: ignore[arg-type]
        coefficients[span] = PiecewisePolynomial.from_spline(spline).coefficients
        coefficients[span, :, 0] = places[first:last]
        coefficients[span, :, -1] = places[first + 1 : last + 1]
    return PiecewisePolynomial(times, coefficients)


def _check_begin(here: Array, first: Array, vertex: int) -> None:
    away = float(np.linalg.norm(first - here))
    if away > SAME_PLACE:
        where = (f"p{vertex}",)
        remedy = (
            f"the path begins at t = 0 at {first.tolist()}, the vertex is at "
            f"{here.round(9).tolist()}: begin there, or later"
        )
        raise InfeasibleError(
            [Violation("continuity", away, SAME_PLACE, "max", "m", where, "at t = 0", remedy)]
        )
