"""A settled hitch: where drones and vertices rest, with what tensions, and how well they balance.

The residuals are recomputed from positions and tensions alone, without the energy whose minimum
the solver looks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Team
from hitchopt.one_line import OneLine
from hitchopt.settling.hitch_energy import HitchEnergy
from hitchopt.settling.rigging import Rigging, add_at_nodes
from hitchopt.values import Array

SLACK_SHARE = 1e-6
"""Tension over the planned one up to which the length of a cable is not compared: it is slack."""


@dataclass(frozen=True, eq=False)
class Settled(OneLine):
    """Positions at rest of samples (…) at times of a plan.

    Attributes
    ----------
    team: the plan's.
    t: (…) [s]
    drones: (…, 2n, 3) [m]
    vertices: (…, points, 3) [m]
    tensions: (…, n) [N], at the heights of the edges' middles.
    slack: (…, n) whether a cable is slack: it does not pull, or hangs by more than a quarter of one
        of its spans.
    bears: (…, clasps) whether the two cables of a clasp press on each other.
    planned_drones, planned_vertices, planned_tensions: what the plan says at those times.
    force_residual: (…) [N], the largest force without balance at a drone or a clasp.
    length_residual: (…) [m], the largest length that a taut cable has too much or too little.
    """

    team: Team
    t: Array
    drones: Array
    vertices: Array
    tensions: Array
    slack: NDArray[np.bool_]
    bears: NDArray[np.bool_]
    planned_drones: Array
    planned_vertices: Array
    planned_tensions: Array
    force_residual: Array
    length_residual: Array

    @property
    def displacements(self) -> Array:
        """(…, points) [m]: distance of every vertex from the planned one."""
        found: Array = np.linalg.norm(self.vertices - self.planned_vertices, axis=-1)
        return found

    @property
    def slack_cables(self) -> tuple[str, ...]:
        """Names of the cables that are slack in any sample: c0, c1, …."""
        return named("c", self.slack)

    @property
    def loose_clasps(self) -> tuple[str, ...]:
        """Names of the points whose cables do not press on each other in some sample."""
        loose = ~self.bears.reshape(-1, self.bears.shape[-1]).all(axis=0)
        return tuple(f"p{k}" for k in self.team.layout.clasps[loose])


def named(letter: str, flags: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of the columns of flags (…, n) in which any is set."""
    columns: Sequence[int] = np.flatnonzero(flags.reshape(-1, flags.shape[-1]).any(axis=0)).tolist()
    return tuple(f"{letter}{k}" for k in columns)


def residuals(energy: HitchEnergy, x: Array, tensions: Array) -> tuple[Array, Array]:
    """Return the largest force without balance (S,) [N] and error of a taut cable's length [m].

    A span of length s and level length h, with the tension m at the height of its chord's middle,
    pulls its two ends along its chord with ``m - w² h²/(24 m)``, less ``w² s/(12 m)`` times its
    level part; it puts half of its arc's weight on each. Where m is less than the least tension at
    which a cable is taut, arcs are those at that tension, and the force is linear in m.

    Parameters
    ----------
    energy: what is known of drones, cables and loads.
    x: (S, nodes, 3) [m]
    tensions: (S, n) [N], at the heights of the edges' middles.
    """
    rigging, law = energy.rigging, energy.law
    forces = energy.forces.copy()
    soft = np.flatnonzero(rigging.free[: rigging.drones])
    away = (energy.places - x[:, : rigging.drones])[:, soft]
    forces[:, soft] += energy.stiffness[soft, None] * away
    lengths = np.zeros(tensions.shape)
    edges = 0.5 * (x[:, rigging.nodes[:, 1], 2] + x[:, rigging.nodes[:, 2], 2])
    for part in range(3):
        cables = np.flatnonzero(rigging.spans[:, part])
        first, second = rigging.nodes[cables, part], rigging.nodes[cables, part + 1]
        chord = x[:, second] - x[:, first]
        s, h = (np.sqrt(np.sum(chord[..., :axes] ** 2, axis=-1)) for axes in (3, 2))
        middle = 0.5 * (x[:, first, 2] + x[:, second, 2])
        m = tensions[:, cables] + law.weight * (middle - edges[:, cables])
        held = np.maximum(m, law.least[:, cables])
        held = np.where(held > 0.0, held, np.inf)
        sag = law.weight**2 / (24.0 * held**2)
        bent = sag * (2.0 * held - m) if law.weight > 0.0 else np.zeros_like(m)
        force = ((m - bent * h**2) / s)[..., None] * chord
        force[..., :2] -= (2.0 * bent * s)[..., None] * chord[..., :2]
        add_at_nodes(forces, first, force)
        add_at_nodes(forces, second, -force)
        arc = s + sag * s * h**2
        for end in (first, second):
            add_at_nodes(forces[..., 2], end, -0.5 * law.weight * arc)
        lengths[:, cables] += arc
    free = np.sqrt(np.sum(forces**2, axis=-1))[:, rigging.free]
    lower = tensions - law.weight * (edges - law.heights)  # at the reference height
    stretched = law.lengths + law.compliance * (lower - law.reference)
    taut = (lower > law.least) & (lower > SLACK_SHARE * law.reference)
    wrong = np.where(taut, np.abs(lengths - stretched), 0.0)
    return np.max(free, axis=-1, initial=0.0), np.max(wrong, axis=-1)


def bearing(
    team: Team, rigging: Rigging, x: Array, tensions: Array, weight: float
) -> NDArray[np.bool_]:
    """Return (S, clasps) whether the two cables of each clasp press on each other.

    The force C with which the other cable acts on a cable is what that cable's two spans pull with,
    and half of their weight, turned round; it has to point into the cable's bend.

    Parameters
    ----------
    x: (S, nodes, 3) [m]
    tensions: (S, n) [N]
    weight: of the cables per length [N/m].
    """
    layout = team.layout
    found = np.ones((len(x), len(layout.clasps)), dtype=np.bool_)
    for cables, node in ((layout.ahead, 1), (layout.behind, 2)):
        here = rigging.nodes[cables]
        to_drone = x[:, here[:, node - 1 if node == 1 else 3]] - x[:, here[:, node]]
        to_edge = x[:, here[:, 3 - node]] - x[:, here[:, node]]
        sizes = [np.linalg.norm(part, axis=-1, keepdims=True) for part in (to_drone, to_edge)]
        leg, edge = to_drone / sizes[0], to_edge / sizes[1]
        contact = -tensions[:, cables, None] * (leg + edge)
        contact[..., 2] += 0.5 * weight * (sizes[0] + sizes[1])[..., 0]
        for direction in (leg, edge):
            found &= np.sum(contact * direction, axis=-1) < 0.0
    return found
