"""The loss of one cable: what remains is an open chain in balance.

Where cable k is gone, its clasps vanish. A neighbouring cable c = k ± 1 bent there; now it is
straight from its other clasp to its drone beyond. That clasp f needs the same force from it as
before, so the cable leaves f in the edge's direction there, with the length of edge and leg. All
other vertices and drones stay where they are, at the same tensions: exact for weights, unequal
tensions and roll.

Between the loss and the new balance a drone of mass m, with gains kp and kd and the planned pull T
fed forward, deviates by at most ``(T/kp) coth(π ζ / 2 √(1 - ζ²))``, ζ = kd / 2 √(kp m) (T/kp from ζ
= 1 on), if its cable pulls with anything from 0 to 2 T along the planned direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hitchopt.hitch.forces import cable_of, leg_vectors, starting_directions, weight_ratios
from hitchopt.hitch.team import Layout, Team
from hitchopt.values import Array, Indices

CABLE = "cable"  # The loss that plans can survive: of a cable with both its drones


@dataclass(frozen=True, eq=False)
class Losses:
    """The drones that move after the losses that a team survives, one row each."""

    drone: Indices  # (m,), the drone that moves
    lost: Indices  # (m,), the cable that is lost then
    clasp: Indices  # (m,), the clasp that vanishes, from which the drone's leg leads
    far: Indices  # (m,), the other vertex of the drone's cable, which stays

    @property
    def robots(self) -> Indices:
        """The cables that may be lost, in order."""
        return np.unique(self.lost)

    @classmethod
    def of(cls, layout: Layout) -> Losses:
        """Return the losses of any cable of a ring, or of a chain's ends.

        Two pieces remain without an inner cable of a chain, and nothing is tied by one cable.
        """
        return _losses(layout.robots, layout)


@lru_cache(maxsize=64)
def _losses(robots: int, layout: Layout) -> Losses:
    """Return the losses of a layout with a number of robots."""
    q_ahead, r_behind = 2 * layout.ahead, 2 * layout.behind + 1
    drone = np.concatenate([q_ahead, r_behind])
    lost = np.concatenate([layout.behind, layout.ahead])
    clasp = np.concatenate([layout.clasps, layout.clasps])
    far = np.concatenate([layout.ends[layout.ahead], layout.starts[layout.behind]])
    survives = np.full(len(drone), robots > 2)
    if not layout.closed:
        survives &= np.isin(lost, [0, robots - 1])
    order = np.lexsort([drone, lost])
    order = order[survives[order]]
    return Losses(drone[order], lost[order], clasp[order], far[order])


def places_after_loss(
    team: Team, drones: Array, vertices: Array, tensions: Array
) -> tuple[Array, Array]:
    """Return where drones move after losses (…, m, 3) [m], and cable lengths to them (…, m) [m].

    Rows are those of ``Losses``; lengths are those from the far vertex.

    Parameters
    ----------
    drones: (…, 2n, 3) [m].
    vertices: (…, points, 3) [m].
    tensions: (…, n) [N].
    """
    losses = Losses.of(team.layout)
    cable = losses.drone // 2
    pulls = tensions[..., cable]
    ratios = weight_ratios(team, pulls)
    clasps = vertices[..., losses.clasp, :]
    far = vertices[..., losses.far, :]
    edges = clasps - far
    cables = cable_of(edges, ratios) + cable_of(drones[..., losses.drone, :] - clasps, ratios)
    return far + leg_vectors(cables, starting_directions(edges, ratios), ratios), cables


def displacements(team: Team) -> Array:
    """Return by how much every drone may deviate after a loss (2n,) [m], at the team's tensions.

    It is infinite for rigid drones.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = team.damping / (2.0 * np.sqrt(team.stiffness * team.mass[:, None]))
        below = np.minimum(ratios, 1.0)
        swing = math.pi * below / (2.0 * np.sqrt(1.0 - below**2))
        gains = 1.0 / (team.stiffness * np.tanh(swing))
    pulls = np.repeat(team.tension, 2)
    rigid = ~np.isfinite(team.stiffness)
    return np.asarray(pulls * np.max(np.where(rigid, np.inf, gains), axis=1))
