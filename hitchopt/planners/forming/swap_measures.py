"""Spans and distances of turning pairs, measured from angle to angle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.planners.forming.turns import Turns
from hitchopt.requirements import Separation
from hitchopt.values import Array

ANGLES = 73
"""Number of angles that are measured; the certificate bounds all of them."""

PLACES = np.linspace(0.0, 1.0, 41)
"""Shares of a hanging cable's length at which it is measured."""


@dataclass(frozen=True, eq=False)
class Measures:
    """Extremes over two swaps.

    Attributes
    ----------
    span: largest share of a cable between its drones.
    opening: smallest distance, along the edge, from q to r before the swaps [m]: at a smaller one
        pairs would be on the wrong side of each other's cables.
    clearances: (clasps,) smallest distance of a drone to its partner's cable [m].
    apart: smallest ratio of drones of pairs next to each other.
    lowest: largest depth of a cable below the drones' plane [m].
    """

    span: float
    opening: float
    clearances: Array
    apart: float
    lowest: float


def measured(turns: Turns, separation: Separation) -> Measures:
    """Return the extremes over two swaps on these ellipses; linear in the number of pairs."""
    drones = turns.drones(np.linspace(0.0, 2.0 * math.pi, ANGLES))
    q, r = drones[:, 0::2], drones[:, 1::2]
    layout, length = turns.team.layout, turns.team.cable_length
    cables = Catenary.between(q, r, length)
    mu = cables.place(PLACES[:, None, None])
    points = q + (0.5 * (1.0 + mu))[..., None] * (r - q)  # (places, angles, n, 3)
    points[..., 2] -= cables.depth(mu)
    clear = np.full(len(turns.half), np.inf)
    for drone, cable in (
        (q[:, layout.ahead], layout.behind),
        (r[:, layout.behind], layout.ahead),
    ):
        distance = np.linalg.norm(points[:, :, cable] - drone, axis=-1)
        clear = np.minimum(clear, np.min(distance, axis=(0, 1)))
    along = unit(layout.edges(turns.vertices))
    return Measures(
        float(np.max(np.linalg.norm(r - q, axis=-1) / length)),
        float(np.min(np.sum((r[0] - q[0]) * along, axis=-1))),
        clear,
        _apart(turns, drones, separation),
        float(turns.centres[0, 2]) - float(np.min(points[..., 2])),
    )


def _apart(turns: Turns, drones: Array, separation: Separation) -> float:
    """Return the smallest ratio of drones at neighbouring clasps, and at the next but one."""
    layout = turns.team.layout
    pairs = np.stack([drones[:, 2 * layout.ahead], drones[:, 2 * layout.behind + 1]], axis=2)
    closest = np.inf
    count = pairs.shape[1]
    for step in range(1, 1 + min(2, count // 2 if layout.closed else count - 1)):
        others = np.roll(pairs, -step, axis=1)
        offset = pairs[:, :, :, None] - others[:, :, None]
        if not layout.closed:
            offset = offset[:, : count - step]
        ratios = np.linalg.norm(offset * separation.scale, axis=-1)
        closest = min(closest, float(np.min(ratios, initial=np.inf)))
    return closest
