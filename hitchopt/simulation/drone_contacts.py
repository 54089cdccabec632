"""What drones touch that they should not: each other, and cables.

MuJoCo lets them pass, so that a flight can be watched to its end; every touch is a failure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY

Index = NDArray[np.intp]

OWN = 2.0
"""Radii of its own cable next to a drone that it cannot touch."""

LANDED = 0.2
"""[m] Lower than this above the ground, a drone may stand beside its own cable on the ground."""


@dataclass(frozen=True)
class Touch:
    """Two things that touch.

    Attributes
    ----------
    first, second: names, such as ``q0`` and ``r2``, or ``q0`` and ``cable 2``.
    """

    first: str
    second: str


def touches(world: World) -> list[Touch]:
    """Return what touches now: drones as ellipsoids, cables as the chains of their nodes.

    Nodes stand closer than half of a drone's radius; a cable between two of them is at most 2 mm
    nearer to it than they are.
    """
    scale = 1.0 / np.array([BODY.radius, BODY.radius, BODY.half_height])
    drones = world.drones * scale
    found = [
        Touch(_name(i), _name(j))
        for i, j in sorted(cKDTree(drones).query_pairs(2.0))  # both are ellipsoids
    ]
    nodes = world.nodes
    cable = np.repeat(np.arange(len(world.ropes.lengths)), world.ropes.segments + 1)
    near: Any = cKDTree(nodes * scale).query_ball_point(drones, 1.0)  # a list for each drone
    counts = np.array([len(entry) for entry in near])
    if not counts.sum():
        return found
    drone = np.repeat(np.arange(len(drones)), counts)
    node = np.concatenate([np.asarray(entry, dtype=np.intp) for entry in near])
    others = _foreign(world, drone, node, cable[node])
    pairs = np.unique(np.column_stack([drone, cable[node]])[others], axis=0)
    return found + [Touch(_name(i), f"cable {k}") for i, k in pairs]


def _foreign(world: World, drone: Index, node: Index, cable: Index) -> NDArray[np.bool_]:
    """Return which nodes are of other cables, or of the own one but far along it."""
    rank = node - world.cable_vertices[cable]
    from_end = np.where(drone % 2 == 0, rank, world.ropes.segments[cable] - rank)
    far = from_end * world.ropes.segment_lengths[cable] > OWN * BODY.radius
    far &= world.drones[drone, 2] > world.ground + LANDED
    foreign: NDArray[np.bool_] = (drone // 2 != cable) | far
    return foreign


def _name(drone: int) -> str:
    return f"{'qr'[drone % 2]}{drone // 2}"
