"""Air forces: drag of the cables, and downwash of drones on those below them."""

from __future__ import annotations

import numpy as np

from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY_HALF_HEIGHT, BODY_RADIUS
from hitchopt.values import Array

AIR_DENSITY = 1.2
"""Density of air [kg/m³]."""

DRAG_COEFFICIENT = 1.2
"""Drag coefficient of a cylinder in cross-flow at the Reynolds numbers of a cord."""

SPREADING = 0.094
"""Half-width of a turbulent round jet per distance (Pope, Turbulent Flows, 2000, table 5.1)."""

BLOCKED = 0.5
"""Share of the downward momentum through a drone's disk that becomes force on it."""


def drag(world: World, damping: float = 0.0) -> Array:
    """Return (nodes, 3) [N]: the air's drag on the cables' inner nodes, as on cylinders.

    Parameters
    ----------
    world: simulated world.
    damping: additional rate at which the nodes lose speed [1/s].
    """
    velocities = world.data.qvel[world.node_dofs]
    ropes = world.ropes
    area = np.repeat(ropes.preset.diameter * ropes.segment_lengths, ropes.segments - 1)
    speed = np.linalg.norm(velocities, axis=-1)
    mass = np.repeat(ropes.density * ropes.segment_lengths, ropes.segments - 1)
    rate = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * area * speed + damping * mass
    forces: Array = -rate[:, None] * velocities
    return forces


def downwash(drones: Array, thrusts: Array) -> Array:
    """Return (2n, 3) [N]: the forces with which drones push down those below them.

    Below its disk a rotor's wake is modelled as a turbulent round jet: it carries the momentum of
    the thrust, in a Gaussian profile whose half-width grows by ``SPREADING`` per distance (Pope
    2000, section 5.1), starting from half of the drone's radius. A drone in it receives ``BLOCKED``
    times the momentum that meets its disk. Real wakes of four rotors differ near the drone. All
    pairs are evaluated, which suits teams of some hundred drones.

    Parameters
    ----------
    drones: positions (2n, 3) [m].
    thrusts: (2n,) [N]
    """
    offset = drones[:, None] - drones[None]  # [below, above]
    depth = -offset[..., 2]
    below = depth > BODY_HALF_HEIGHT
    half_width = 0.5 * BODY_RADIUS + SPREADING * np.where(below, depth, 0.0)
    spread = half_width**2 / (4.0 * np.log(2.0))  # of the momentum, whose profile is the square
    across = offset[..., 0] ** 2 + offset[..., 1] ** 2
    share = np.pi * BODY_RADIUS**2 / (2.0 * np.pi * spread) * np.exp(-0.5 * across / spread)
    push = np.where(below, BLOCKED * np.minimum(share, 1.0) * thrusts[None], 0.0)
    forces = np.zeros_like(drones)
    forces[:, 2] = -np.sum(push, axis=1)
    return forces
