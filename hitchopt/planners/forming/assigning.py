"""The assignment of robots to edges with the smallest sum of squared distances."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import GOLDEN, TIE
from hitchopt.hitch import Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.values import Array


def assigned(team: Team, drones: Array, outline: Outline, leg: float) -> Assignment:
    """Return the assignment of robots to edges, and of their drones to the edges' ends.

    A cable that leaves less than two legs on an edge does not take it while others do. The
    costs are squared distances to the edges' ends: straight lines of the least sum do not cross.
    Quadratic in n in memory, cubic at worst in time (seconds for a thousand robots).

    Parameters
    ----------
    team: as the robots are given.
    drones: (2n, 3) [m], their places.
    outline: its edges are assigned.
    leg: shortest leg [m].
    """
    from scipy.optimize import linear_sum_assignment

    layout, points = team.layout, outline.vertices
    first, last = points[layout.starts], points[layout.ends]
    q, r = drones[0::2, None, :2], drones[1::2, None, :2]
    straight = np.sum((q - first) ** 2, axis=-1) + np.sum((r - last) ** 2, axis=-1)
    crossed = np.sum((q - last) ** 2, axis=-1) + np.sum((r - first) ** 2, axis=-1)
    cost = np.minimum(straight, crossed)
    short = team.cable_length[:, None] - outline.edge_lengths < 2.0 * leg
    size = float(np.max(cost))
    k = np.arange(team.robots)
    cost = cost + TIE * size * _preference(team.robots)
    cost = cost + short * (1.0 + size) * len(cost)
    robots, roles = linear_sum_assignment(cost)
    order = robots[np.argsort(roles)]
    shorter = straight[order, k] - crossed[order, k]
    cables, edges = drones[1::2, :2][order] - drones[0::2, :2][order], last - first
    turns = cables[:, 0] * edges[:, 1] - cables[:, 1] * edges[:, 0]
    # Where both are as short, cables turn counter-clockwise.
    flipped = np.where(np.abs(shorter) > TIE * size, shorter > 0.0, turns < -TIE * size)
    return Assignment(tuple(order.tolist()), tuple(flipped.tolist()))


def _preference(robots: int) -> Array:
    """Return the costs (robots, edges), up to 2, that decide between assignments that tie.

    Robots prefer edges of their own number. Multiples of the golden ratio, modulo 1, tell apart
    assignments that would tie again.
    """
    k = np.arange(robots)
    away = np.abs(k[:, None] - k) / robots
    apart = np.mod(GOLDEN * np.arange(1.0, robots**2 + 1.0), 1.0).reshape(away.shape)
    preference: Array = away + 0.1 * apart
    return preference
