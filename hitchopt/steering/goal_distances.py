"""Distances at a goal, looked at before a path to it is planned."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import dot
from hitchopt.hitch import Hitch
from hitchopt.hitch.layout import Layout
from hitchopt.requirements import Separation
from hitchopt.values import Array

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
    itself, counted = _pairs(team.layout)
    ratios = (drones[:, None] - drones) * separation.scale
    if (dot(ratios, ratios) + itself).min() < (1.0 - CLEARLY) ** 2:
        return True
    starts = np.concatenate([drones, ends[::2]])
    along = np.concatenate([ends, ends[1::2]]) - starts
    offsets = drones[:, None] - starts
    share = np.einsum("ijd,jd->ij", offsets, along) / dot(along, along)
    offsets -= np.minimum(np.maximum(share, 0.0), 1.0)[..., None] * along
    near = dot(offsets, offsets).min(initial=np.inf, where=counted)
    return bool(near < ((1.0 - CLEARLY) * separation.cable) ** 2)


@lru_cache(maxsize=16)
def _pairs(layout: Layout) -> tuple[Array, NDArray[np.bool_]]:
    """Return infinity for a drone and itself, and which segments count for each drone.

    Those are legs, (2n, 2n), and edges, (2n, n): all foreign ones, and its own edge.
    """
    cable = np.arange(2 * layout.robots) // 2
    counted = cable[:, None] != np.append(cable, np.arange(layout.robots))
    counted[:, len(cable) :] |= layout.has_leg.reshape(-1, 1)
    return np.diag(np.full(len(cable), np.inf)), counted
