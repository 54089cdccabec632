"""Distances at a goal, looked at before a path to it is planned."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.segments import shortest_offset
from hitchopt.geometry.vectors import dot
from hitchopt.hitch import Hitch
from hitchopt.requirements import Separation

CLEARLY = 1e-4
"""Share of a limit by which a distance is too small without a doubt: a plan ends within 1e-6 m of
its goal."""

MOST = 64
"""Largest number of robots: all pairs are looked at."""


def clearly_too_close(goal: Hitch, separation: Separation) -> bool:
    """Return whether a certificate of any path to a goal finds a drone too close to something.

    Other drones, foreign cables and its own edge are looked at, where the path ends. No says
    nothing: crossing cables, and teams of many robots, are not looked at.
    """
    team = goal.team
    if team.robots > MOST:
        return False
    drones, ends = goal.drones, goal.vertices[team.layout.pulled_to]
    cable = np.arange(team.drones) // 2
    ratios = (drones[:, None] - drones) * separation.scale
    squared = dot(ratios, ratios)
    np.fill_diagonal(squared, np.inf)
    if np.min(squared) < (1.0 - CLEARLY) ** 2:
        return True
    first, last = np.concatenate([drones, ends[::2]]), np.concatenate([ends, ends[1::2]])
    offsets = shortest_offset(np.stack([drones[:, None] - first, drones[:, None] - last], axis=-2))
    counted = cable[:, None] != np.append(cable, np.arange(team.robots))
    counted[:, team.drones :] |= team.layout.has_leg.reshape(-1, 1)  # its own edge as well
    near = np.min(dot(offsets, offsets), initial=np.inf, where=counted)
    return bool(near < ((1.0 - CLEARLY) * separation.cable) ** 2)
