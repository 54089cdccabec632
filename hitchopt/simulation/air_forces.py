"""What air does: it slows cables, and drones blow on those below them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY

Array = NDArray[np.float64]

AIR_DENSITY = 1.2
"""[kg/m³]"""

DRAG_COEFFICIENT = 1.2
"""Of a cylinder across the wind, at the Reynolds numbers of a cord."""

SPREADING = 0.094
"""Half-width of a turbulent round jet per distance (Pope, Turbulent Flows, 2000, table 5.1)."""

BLOCKED = 0.5
"""Share of the downward momentum through a drone's disk that becomes force on it."""


def drag(world: World, slowing: float = 0.0) -> Array:
    """Return (nodes, 3) [N]: the air's drag on the cables' inner nodes, as on cylinders across.

    Parameters
    ----------
    world: whose cables move.
    slowing: [1/s], how fast they lose speed besides.
    """
    velocities = world.data.qvel[world.node_dofs]
    ropes = world.ropes
    area = np.repeat(ropes.preset.diameter * ropes.segment_lengths, ropes.segments - 1)
    speed = np.linalg.norm(velocities, axis=-1)
    mass = np.repeat(ropes.density * ropes.segment_lengths, ropes.segments - 1)
    rate = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * area * speed + slowing * mass
    forces: Array = -rate[:, None] * velocities
    return forces


def downwash(drones: Array, thrusts: Array) -> Array:
    """Return (2n, 3) [N]: how drones push down those below them.

    Below its disk a rotor's wake is taken for a turbulent round jet: it carries the momentum of
    the thrust, in a Gaussian profile whose half-width grows by ``SPREADING`` per distance (Pope
    2000, section 5.1) from half of the drone's radius on. A drone in it receives ``BLOCKED`` times
    the momentum that meets its disk. Real wakes of four rotors differ near the drone. All pairs:
    for teams of some hundred drones.

    Parameters
    ----------
    drones: (2n, 3) [m]
    thrusts: (2n,) [N]
    """
    offset = drones[:, None] - drones[None]  # [below, above]
    depth = -offset[..., 2]
    below = depth > BODY.half_height
    half_width = 0.5 * BODY.radius + SPREADING * np.where(below, depth, 0.0)
    spread = half_width**2 / (4.0 * np.log(2.0))  # of the momentum, whose profile is the square
    across = offset[..., 0] ** 2 + offset[..., 1] ** 2
    share = np.pi * BODY.radius**2 / (2.0 * np.pi * spread) * np.exp(-0.5 * across / spread)
    push = np.where(below, BLOCKED * np.minimum(share, 1.0) * thrusts[None], 0.0)
    forces = np.zeros_like(drones)
    forces[:, 2] = -np.sum(push, axis=1)
    return forces
