"""Contacts: at the clasps, of drones, of objects; and the loads that hang where cables touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.forces import contact_forces
from hitchopt.simulation.task import Cargo, Task
from hitchopt.simulation.world import BODY_HALF_HEIGHT, BODY_RADIUS, Index, World
from hitchopt.values import Array

# Least contact force of a clasp over the plan's. Cables that merely cross press by their weight
# and by the drones' deviations, and Gauss's integral counts some of them as linked
BEARING_SHARE = 0.3

SMOOTHING = 0.05  # Time constant with which a load passes from nodes to others [s]
LEAST_FORCE = 1e-9  # Normal force below which cables do not touch [N]
OWN = 2.0  # Part of its own cable that a drone cannot touch, next to it, over the drone's radius
LANDED = 0.2  # Height above the ground [m] below which a drone may stand beside its own cable
NONE = np.zeros((0, 3))  # No places
GROUND, DRONE, CABLE, OBJECT = range(4)  # Kinds of things in contact


def least_bearing(task: Task) -> Array:
    """Return (samples, clasps) [N]: the contact force from which on a clasp bears.

    It is a share of the force with which a clasp presses without friction, which is
    ``|T (u_{k-1} + u_k)|`` where both its cables pull alike; 0 where one does not.
    """
    each = []
    for part in task.parts:
        team, least = part.team, np.zeros((len(task.t), len(part.team.layout.clasps)))
        pulled = np.all(part.tensions > 0.0, axis=-1)
        edges = unit(team.layout.edges(part.vertices[pulled]))
        least[pulled] = BEARING_SHARE * contact_forces(edges, part.tensions[pulled], team.topology)
        each.append(least)
    return np.concatenate(each, axis=1)


class ClaspContacts:
    """Contact forces between neighbouring cables and their centres, gathered over some steps."""

    def __init__(self, world: World, team: Team) -> None:
        self._world, layout = world, team.layout
        ranks = np.arange(len(layout.clasps))
        self._clasp = np.full((team.robots, team.robots), -1)
        self._clasp[layout.behind, layout.ahead] = ranks
        self._clasp[layout.ahead, layout.behind] = ranks
        self._force, self._moment, self._count = np.zeros(len(ranks)), np.zeros((len(ranks), 3)), 0

    def now(self) -> tuple[Index, Index, Array]:
        """Return contacts (c,) of the last step, their clasps (c,) and normal forces (c,) [N]."""
        data = self._world.data
        flexes, rows = data.contact.flex, data.contact.efc_address
        between = np.flatnonzero(np.all(flexes >= 0, axis=1) & (rows >= 0))
        clasp = self._clasp[flexes[between, 0], flexes[between, 1]]
        chosen = between[clasp >= 0]
        force = np.maximum(data.efc_force[rows[chosen]], 0.0)  # elliptic: the normal comes first
        return chosen, clasp[clasp >= 0], force

    def gather(self) -> None:
        """Add the contacts of the last step."""
        self._count += 1
        if self._world.data.ncon:
            chosen, clasp, force = self.now()
            np.add.at(self._force, clasp, force)
            moments = force[:, None] * self._world.data.contact.pos[chosen]
            np.add.at(self._moment, clasp, moments)

    def collect(self, least: Array | float = 0.0) -> tuple[Array, Array]:
        """Return vertices and forces since the last call, and start again.

        Vertices (clasps, 3) [m] are centres of the contact force; nan where cables press less than
        ``least`` (clasps,) [N]. Forces (clasps,) [N] are mean sums of normal forces.
        """
        forces = self._force / max(self._count, 1)
        bears = (forces > 0.0) & (forces >= least)
        vertices = np.full_like(self._moment, np.nan)
        vertices[bears] = self._moment[bears] / self._force[bears, None]
        self._force[:], self._moment[:], self._count = 0.0, 0.0, 0
        return vertices, forces


class HungLoads:
    """Loads that hang at the clasps, like rings: mass of the nodes that press on each other there.

    As cables slide through a clasp its load passes to the nodes that follow.
    """

    def __init__(self, world: World, team: Team) -> None:
        self._world, self._mass, self._contacts = world, team.load, ClaspContacts(world, team)
        self._cable = np.repeat(np.arange(team.robots), np.diff(world.cable_vertices))
        self._bodies = world.model.flex_vertbodyid
        self._empty = world.model.body_mass[self._bodies]
        self._on_nodes = np.zeros((len(team.load), len(self._bodies)))  # shares of a load

    def apply(self, shares: Array, seconds: float) -> None:
        """Put the loads on the nodes at their clasps for the next ``seconds``.

        ``shares`` (n,) are those of its halves of loads that a cable carries already; clasps whose
        cables do not touch lose theirs.
        """
        data = self._world.data
        chosen, clasp, force = self._contacts.now()
        force = np.maximum(force, LEAST_FORCE)
        force = force / np.bincount(clasp, force, len(self._mass))[clasp]
        node = self._world.cable_vertices[data.contact.flex[chosen]] + data.contact.elem[chosen]
        touching = np.zeros_like(self._on_nodes)
        for end in (0, 1):  # of both elements that touch
            np.add.at(touching, (clasp[:, None], node + end), 0.25 * force[:, None])
        remaining = np.exp(-seconds / SMOOTHING)
        self._on_nodes = remaining * self._on_nodes + (1.0 - remaining) * touching
        added = self._mass @ self._on_nodes * shares[self._cable]
        self._world.model.body_mass[self._bodies] = self._empty + added


def touching(
    world: World, names: Sequence[str] = (), passing: Array = NONE
) -> list[tuple[str, str]]:
    """Return all pairs in contact by name: ``q0`` and ``r2``, or ``q0`` and ``cable 2``.

    They do not collide, so that every flight is simulated to its end; nor do drones that are
    ``passing`` (m, 3) [m] under names. Drones are ellipsoids, cables their nodes: between two of
    them a cable is at most 2 mm closer. Cables of different groups do collide.
    """
    scale = 1.0 / np.array([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])
    count, names = len(world.drones), [*world.drone_names, *names]
    drones = np.concatenate([world.drones, passing]) * scale
    near: Any = cKDTree(world.nodes * scale).query_ball_point(drones, 1.0)  # a list per drone
    drone = np.repeat(np.arange(len(drones)), [len(entry) for entry in near])
    node = np.array([i for entry in near for i in entry], dtype=np.intp)
    cable = np.searchsorted(world.cable_vertices, node, side="right") - 1
    rank = node - world.cable_vertices[cable]
    from_end = np.where(drone % 2 == 0, rank, world.ropes.segments[cable] - rank)
    far = from_end * world.ropes.segment_lengths[cable] > OWN * BODY_RADIUS
    far &= drones[drone, 2] / scale[2] > world.ground + LANDED
    foreign = (drone // 2 != cable) | far  # on another cable, or far along the own one
    pairs = np.unique(np.column_stack([drone, cable])[foreign], axis=0)
    flexes = world.data.contact.flex
    between = flexes[np.all(flexes >= 0, axis=1)]
    across = between[world.groups[between[:, 0]] != world.groups[between[:, 1]]]
    near = sorted(cKDTree(drones).query_pairs(2.0))  # i < j; ellipsoids
    return [
        *((names[i], names[j]) for i, j in near if i < count),
        *((names[i], world.cable_names[k]) for i, k in pairs),
        *((world.cable_names[i], world.cable_names[j]) for i, j in np.unique(across, axis=0)),
    ]


class ObjectContacts:
    """Contacts of objects: with what may not touch them at the time, and with cables at all."""

    def __init__(self, world: World, cargo: Cargo) -> None:
        self._world, self._cargo, self._aloft = world, cargo, cargo.aloft
        bodies, objects = world.model.nbody, world.object_bodies
        counts = np.diff(world.cable_vertices)
        self._kind, self._rank = np.full(bodies, GROUND), np.full(bodies, -1)
        self._names = np.full(bodies, "the ground", dtype=object)
        for kind, chosen, names in (
            (CABLE, world.model.flex_vertbodyid, np.repeat(world.cable_names, counts)),
            (DRONE, world.drone_bodies, world.drone_names),  # the ends of cables
            (OBJECT, objects, cargo.names),
        ):
            self._kind[chosen], self._names[chosen] = kind, names
        self._rank[objects] = np.arange(len(objects))
        self._group = np.full(bodies, "", dtype=object)
        self._group[world.model.flex_vertbodyid] = np.repeat(world.groups, counts)
        self._holder = np.array([cargo.holders.get(name, "") for name in cargo.names], dtype=object)

    def wrong(self, index: int) -> list[tuple[str, str]]:
        """Return the forbidden contacts of objects at a sample of the plan, by name.

        Cables may touch what the plan holds; objects aloft touch nothing else, drones nothing.
        """
        thing, body = self._pairs()
        if not len(thing):
            return []
        held, aloft = self._cargo.held[index], np.append(self._aloft[index], False)
        kind, above = self._kind[body], aloft[thing] | aloft[self._rank[body]]
        held = held[thing] & (self._holder[thing] == self._group[body])
        chosen = np.where(kind == CABLE, ~held, (kind == DRONE) | above)
        named = zip(self._names[body[chosen]], thing[chosen], strict=True)
        return sorted({(str(other), self._cargo.names[i]) for other, i in named})

    @property
    def cables(self) -> NDArray[np.bool_]:
        """Whether cables touch an object (objects,)."""
        touched = np.zeros(len(self._cargo.objects), dtype=np.bool_)
        thing, body = self._pairs()
        touched[thing[self._kind[body] == CABLE]] = True
        return touched

    def _pairs(self) -> tuple[Index, Index]:
        """Return the ranks of objects (contacts,) in contact, and the bodies that touch them."""
        contact = self._world.data.contact
        geoms = contact.geom[np.all(contact.geom >= 0, axis=1) & (contact.efc_address >= 0)]
        bodies = self._world.model.geom_bodyid[geoms]
        chosen = bodies[np.any(self._rank[bodies] >= 0, axis=1)]
        rows, own = np.arange(len(chosen)), np.argmax(self._rank[chosen] >= 0, axis=1)
        return self._rank[chosen[rows, own]], chosen[rows, 1 - own]
