"""The MuJoCo world: ropes that collide, drones at their ends, a ground.

Drones meet cables and one another in ``contacts``, not here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import UnsupportedError
from hitchopt.hitch import GRAVITY
from hitchopt.simulation.mujoco_xml import BODY, Body, describe
from hitchopt.simulation.ropes import Ropes

Array = NDArray[np.float64]
Index = NDArray[np.intp]

RADII_OF_GYRATION = (0.5, 0.5, 0.65)
"""Of a drone about its axes, over its radius: four motors on arms, the rest in the middle."""


@dataclass(frozen=True, eq=False)
class World:
    """A compiled model, its state, and where things are in its arrays.

    Attributes
    ----------
    model, data: of MuJoCo.
    ropes: what was built.
    rigid: whether drones have an attitude.
    ground: its height [m].
    masses: (2n,) [kg], of the drones q0, r0, q1, r1, ….
    inertia: (2n, 3) [kg m²], about the drones' own axes.
    node_qpos, node_dofs: (nodes, 3), addresses of the inner nodes of all cables, in order, in
        qpos and qvel.
    node_origins: (nodes, 3) [m], where a node's qpos is zero.
    drone_bodies: (2n,)
    drone_qpos, drone_dofs: (2n, 3), of the drones' positions.
    drone_origins: (2n, 3) [m]
    cable_vertices: (n + 1,), cable k's nodes, drones among them, are flex vertices
        ``cable_vertices[k]:cable_vertices[k + 1]``.
    edge_cables: (edges,), the cable that each edge belongs to.
    """

    model: Any
    data: Any
    ropes: Ropes
    rigid: bool
    ground: float
    masses: Array
    inertia: Array
    node_qpos: Index
    node_dofs: Index
    node_origins: Array
    drone_bodies: Index
    drone_qpos: Index
    drone_dofs: Index
    drone_origins: Array
    cable_vertices: Index
    edge_cables: Index

    def place(self, nodes: list[Array]) -> None:
        """Put every cable's nodes, drones at the ends among them: n of (segments + 1, 3) [m]."""
        import mujoco

        inner = np.concatenate([cable[1:-1] for cable in nodes])
        ends = np.concatenate([cable[[0, -1]] for cable in nodes])
        self.data.qpos[self.node_qpos] = inner - self.node_origins
        self.data.qpos[self.drone_qpos] = ends - self.drone_origins
        mujoco.mj_forward(self.model, self.data)

    @property
    def nodes(self) -> Array:
        """(all nodes, 3) [m], cable after cable, drones at the ends among them."""
        found: Array = self.data.flexvert_xpos
        return found

    def cable(self, k: int) -> Array:
        """Return (segments + 1, 3) [m]: the nodes of cable k."""
        return self.nodes[self.cable_vertices[k] : self.cable_vertices[k + 1]]

    @property
    def drones(self) -> Array:
        """(2n, 3) [m]: where the drones are."""
        found: Array = self.data.qpos[self.drone_qpos] + self.drone_origins
        return found


def build_world(
    ropes: Ropes,
    masses: Array,
    *,
    rigid: bool = True,
    ground: float = 0.0,
    gravity: float = GRAVITY,
    body: Body = BODY,
) -> World:
    """Return the world of some ropes, laid out straight: place the nodes before the first step.

    Parameters
    ----------
    ropes: n of them.
    masses: (2n,) [kg], of the drones q0, r0, q1, r1, ….
    rigid: whether drones have an attitude.
    ground: its height [m].
    gravity: downward [m/s²].
    body: what a drone fills.

    Raises
    ------
    UnsupportedError: mujoco is not installed.
    """
    mujoco = imported_mujoco()
    inertia = np.outer(masses, (body.radius * np.array(RADII_OF_GYRATION)) ** 2)
    text = describe(ropes, masses, inertia, rigid, ground, gravity, body)
    model = mujoco.MjModel.from_xml_string(text)
    names = [f"{end}{k}" for k in range(len(ropes.lengths)) for end in "qr"]
    drone_bodies = np.array([model.body(name).id for name in names])
    first_joint = model.body_jntadr[drone_bodies]
    inner = np.setdiff1d(np.arange(1, model.nbody), drone_bodies)  # 0 is the world itself
    node_joint = model.body_jntadr[inner]
    axes = np.arange(3)
    segments = ropes.segments
    return World(
        model,
        mujoco.MjData(model),
        ropes,
        rigid,
        ground,
        np.array(masses, dtype=np.float64),
        inertia,
        model.jnt_qposadr[node_joint][:, None] + axes,
        model.jnt_dofadr[node_joint][:, None] + axes,
        model.body_pos[inner],
        drone_bodies,
        model.jnt_qposadr[first_joint][:, None] + axes,
        model.jnt_dofadr[first_joint][:, None] + axes,
        np.zeros((len(names), 3)) if rigid else model.body_pos[drone_bodies],
        np.concatenate([[0], np.cumsum(segments + 1)]),
        np.repeat(np.arange(len(segments)), segments),
    )


def imported_mujoco() -> Any:
    """Return the module, kept from writing its warnings to a file where the user happens to be.

    They are counted in the data all the same, and end a run (see watch).

    Raises
    ------
    UnsupportedError: it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise UnsupportedError(
            "simulating needs MuJoCo, which is not installed; pip install 'hitchopt[simulate]'"
        ) from None
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_unheard)
    return mujoco


def _unheard(_text: str) -> None:
    """Take a warning that the data tells as well."""
