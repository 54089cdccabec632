"""The simulated world in MuJoCo: ropes that collide, drones at their ends, a ground.

Contacts of drones with cables and with one another are found in ``drone_contacts``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import UnsupportedError
from hitchopt.hitch import GRAVITY
from hitchopt.objects import SolidObject
from hitchopt.simulation.mujoco_xml import BODY_RADIUS, EDGE_STEPS, describe
from hitchopt.simulation.object_xml import PREFIX
from hitchopt.simulation.ropes import ROUNDING, Ropes
from hitchopt.values import Array

Index = NDArray[np.intp]

RADII_OF_GYRATION = (0.5, 0.5, 0.65)
"""Radii of gyration of a drone about its axes, over its radius: four motors on arms, and the
remaining mass in the middle."""

TURNED = 0.07
"""Angle by which a link may turn within the time constant of the constraint on its length: links
that turn at a rate ω are strained by ``(ω t)²``, t that constant."""

LEAST_EDGE_TIME = 0.06
"""Least time constant, over that of links which hardly turn."""

TIGHTER, LOOSER, LOOSER_TAUT = 0.8, 1.05, 1.002
"""Factors by which the time constant changes at most at once, the last one where ropes are taut:
they yield a little, and would jerk."""

FIRM_STEPS, FIRMER = 2.2, 0.95
"""Time constant of the ropes' lengths in refined steps, of which MuJoCo takes at least 2, and the
factor by which it falls at most at once: what ropes have yielded pulls by its square."""


class World:
    """A compiled model, its state, and the positions of things in MuJoCo's arrays.

    The ropes are straight at first: place the nodes before the first step.

    Parameters
    ----------
    ropes: n of them.
    masses: (2n,) [kg], of the drones q0, r0, q1, r1, ….
    rigid: whether drones have an attitude.
    ground: height of the ground [m].
    gravity: downward acceleration [m/s²].
    objects: by name, where they stand.

    Attributes
    ----------
    model, data: MuJoCo's.
    inertia: (2n, 3) [kg m²], about the drones' own axes.
    node_dofs: addresses (nodes, 3) of the inner nodes of all cables, in order, in qvel.
    drone_bodies: (2n,)
    drone_dofs: addresses (2n, 3) of the drones' positions in qvel.
    objects: by name.
    object_bodies: (objects,)
    cable_vertices: (n + 1,), cable k's nodes, drones among them, are flex vertices
        ``cable_vertices[k]:cable_vertices[k + 1]``.
    edge_cables: cable of each edge (edges,).

    Raises
    ------
    UnsupportedError: mujoco is not installed.
    """

    def __init__(
        self,
        ropes: Ropes,
        masses: Array,
        *,
        rigid: bool = True,
        ground: float = 0.0,
        gravity: float = GRAVITY,
        objects: Mapping[str, SolidObject] | None = None,
    ) -> None:
        mujoco = self._mujoco = _imported_mujoco()
        self.ropes, self.rigid, self.ground = ropes, rigid, ground
        self.masses = np.array(masses, dtype=np.float64)
        self.inertia: Array = np.outer(masses, (BODY_RADIUS * np.array(RADII_OF_GYRATION)) ** 2)
        ends = np.repeat(0.5 * ropes.density * ropes.segment_lengths, 2)  # half of the last segment
        self.objects = {} if objects is None else dict(objects)
        drones_of = (self.masses + ends, self.inertia, rigid)
        text = describe(ropes, *drones_of, ground, gravity, self.objects)
        self.model = model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(model)
        names = [f"{end}{k}" for k in range(len(ropes.lengths)) for end in "qr"]
        drones: Index = np.array([model.body(name).id for name in names])
        nodes = np.setdiff1d(model.flex_vertbodyid, drones)
        self.object_bodies: Index = np.array(
            [model.body(f"{PREFIX}{name}").id for name in self.objects], dtype=np.intp
        )
        drone_joint, node_joint = model.body_jntadr[drones], model.body_jntadr[nodes]
        axes = np.arange(3)
        self.drone_bodies = drones
        self.drone_dofs: Index = model.jnt_dofadr[drone_joint][:, None] + axes
        self.node_dofs: Index = model.jnt_dofadr[node_joint][:, None] + axes
        self._drone_qpos = model.jnt_qposadr[drone_joint][:, None] + axes
        self._node_qpos = model.jnt_qposadr[node_joint][:, None] + axes
        # Where the qpos of bodies that slide is zero; a free joint's is the position itself.
        self._node_origins = model.body_pos[nodes]
        self._drone_origins = np.zeros((len(names), 3)) if rigid else model.body_pos[drones]
        self.cable_vertices: Index = np.concatenate([[0], np.cumsum(ropes.segments + 1)])
        self.edge_cables: Index = np.repeat(np.arange(len(ropes.lengths)), ropes.segments)
        joints = model.body_jntadr[model.flex_vertbodyid]
        self._vertex_dofs = model.jnt_dofadr[joints][:, None] + axes
        self._last_edges: Index = self.cable_vertices[1:-1] - 1  # none, from a cable to the next
        self._edge_time = self._longest_edge_time = float(model.eq_solref[0, 0])
        self._firm = math.inf

    def place(self, cables: list[Array]) -> None:
        """Put every cable's nodes, its drones at the ends, at n of (segments + 1, 3) [m]."""
        inner = np.concatenate([cable[1:-1] for cable in cables])
        ends = np.concatenate([cable[[0, -1]] for cable in cables])
        self.data.qpos[self._node_qpos] = inner - self._node_origins
        self.data.qpos[self._drone_qpos] = ends - self._drone_origins
        self._mujoco.mj_forward(self.model, self.data)

    def step(self, count: int = 1, *, loose: bool = False, finer: int = 1) -> None:
        """Advance by ``count`` time steps of the preset, in smaller ones where loose ropes whip.

        Ropes that are picked up from the ground, or drawn straight, do so.

        Parameters
        ----------
        loose: whether the ropes are not drawn tight, such that none pulls much.
        finer: least number of smaller steps for one of the preset's; ropes are firmer then as well.
        """
        time = TURNED / max(self._turning if loose else 0.0, TURNED / self._longest_edge_time)
        looser = LOOSER if loose else LOOSER_TAUT
        time = min(max(time, TIGHTER * self._edge_time), looser * self._edge_time)
        self._edge_time = time = max(time, LEAST_EDGE_TIME * self._longest_edge_time)
        step = self.ropes.preset.time_step
        parts = max(1, math.ceil(EDGE_STEPS * step / time - ROUNDING))
        if time >= self._longest_edge_time:
            self._edge_time, parts = self._longest_edge_time, 1
        parts = max(parts, finer)
        self.model.opt.timestep = step / parts
        firm = math.inf
        if finer > 1:
            firm = max(FIRM_STEPS * step / parts, FIRMER * min(self._firm, self._edge_time))
        self._firm = firm
        self.model.eq_solref[:, 0] = min(self._edge_time, firm)
        self._mujoco.mj_step(self.model, self.data, nstep=count * parts)

    @property
    def strains(self) -> Array:
        """(edges,): relative changes of the segments' lengths."""
        found: Array = self.data.flexedge_length / self.model.flexedge_length0 - 1.0
        return found

    @property
    def _turning(self) -> float:
        """Largest rate at which a link turns [rad/s]."""
        velocities = self.data.qvel[self._vertex_dofs]
        across = np.linalg.norm(np.diff(velocities, axis=0), axis=-1)
        across[self._last_edges] = 0.0
        return float(np.max(across)) / float(np.min(self.ropes.segment_lengths))

    @property
    def nodes(self) -> Array:
        """Positions of all nodes (nodes, 3) [m], cable after cable, with drones at the ends."""
        found: Array = self.data.flexvert_xpos
        return found

    @property
    def cables(self) -> list[Array]:
        """Nodes of every cable: n of (segments + 1, 3) [m]."""
        return np.split(self.nodes, self.cable_vertices[1:-1])

    @property
    def drones(self) -> Array:
        """Positions of the drones (2n, 3) [m]."""
        found: Array = self.data.qpos[self._drone_qpos] + self._drone_origins
        return found

    @property
    def poses(self) -> Array:
        """Poses of the objects (objects, 7): positions of their bases [m], and quaternions."""
        data, bodies = self.data, self.object_bodies
        return np.concatenate([data.xpos[bodies], data.xquat[bodies]], axis=-1)


def _imported_mujoco() -> Any:
    """Return the module, prevented from writing its warnings to a file in the current directory.

    They are counted in the data nevertheless, and end a run (see ``validity``).

    Raises
    ------
    UnsupportedError: mujoco is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise UnsupportedError(
            "simulating needs MuJoCo, which is not installed; pip install 'hitchopt[simulate]'"
        ) from None
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda _text: None)
    return mujoco
