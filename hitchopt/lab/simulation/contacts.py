"""Contacts at clasps, of drones and of objects, and loads that hang at clasps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.forces import contact_forces
from hitchopt.lab.simulation.task import Cargo, Task
from hitchopt.lab.simulation.world import BODY_HALF_HEIGHT, BODY_RADIUS, Index, World
from hitchopt.values import Array

# Smallest contact force of a clasp, over the plan's. Cables that only cross also press on each
# other, by weight and deviations of drones, and some of them have a linking number of one
MIN_BEARING_RATIO = 0.3

SMOOTHING = 0.05  # Time constant of the transfer of a load between nodes [s]
MIN_FORCE = 1e-9  # Smallest normal force of a contact [N]
EXCLUDED_LENGTH = 2.0  # Section of its own cable that a drone cannot touch, over its radius
LANDED_HEIGHT = 0.2  # Height below which a drone may touch its own cable [m]
NO_POSITIONS = np.zeros((0, 3))
GROUND, DRONE, CABLE, OBJECT = range(4)  # Kinds of bodies in contact


def least_bearing(task: Task) -> Array:
    """Return the smallest contact force of a bearing clasp (samples, clasps) [N].

    It is a fraction of the contact force without friction, which is ``|T (u_{k-1} + u_k)|`` for
    equal tensions; 0 if a cable has no tension.
    """
    by_part, t = [], task.states.t - task.states.t[0]
    for part in task.teams:
        team, motion, T = part.team, part.motion, part.states.tensions
        bearing = np.zeros((len(t), len(team.layout.clasps)))
        taut = np.all(T > 0.0, axis=-1)
        if motion is not None and motion.has_wraps:  # edges bend around an object
            layout, vertices = team.layout, part.states.vertices[taut]
            first, last = np.moveaxis(motion.contacts.at(t[taut]), -2, 0)
            ends = first - vertices[:, layout.starts], vertices[:, layout.ends] - last
        else:
            ends = (team.layout.edges(part.states.vertices[taut]),) * 2
        leaving, arriving = map(unit, ends)
        forces = contact_forces(leaving, T[taut], team.topology, arriving)
        bearing[taut] = MIN_BEARING_RATIO * forces
        by_part.append(bearing)
    return np.concatenate(by_part, axis=1)


class ClaspContacts:
    """Contact forces between neighbouring cables and their centres, averaged over steps."""

    def __init__(self, world: World, team: Team) -> None:
        self._world, layout = world, team.layout
        self._clasps = ranks = np.arange(len(layout.clasps))
        # Clasps by pairs of flexes: where the second cable begins, and where it ends. The last row
        # and column are those of contacts with other bodies, whose flex is -1
        begins = np.full((team.robots + 1,) * 2, -1)
        begins[layout.behind, layout.ahead] = ranks
        either = np.maximum(begins, begins.T)
        self._begins, self._ends = (np.where(x >= 0, x, either) for x in (begins, begins.T))
        self._clasps_twice = bool(np.any(self._begins != self._ends))
        self._segments = np.diff(world.cable_vertices) - 1
        # Of every step since the last call of ``collect``: flexes, elements of the second one,
        # rows of the constraints, normal forces and positions of all contacts
        self._steps: list[tuple[Index, Index, Index, Array, Array]] = []

    def now(self) -> tuple[Index, Index, Array]:
        """Return contacts (c,) of the last step, their clasps (c,) and normal forces (c,) [N]."""
        contact = self._world.data.contact
        contacts, clasp = self._at_clasps(contact.flex, contact.elem[:, 1], contact.efc_address)
        return contacts, clasp, self._normal_forces()[contacts]

    def _normal_forces(self) -> Array:
        """Return the normal forces (contacts,) [N]; meaningless for contacts without a row."""
        data = self._world.data  # cones are elliptic: the normal force comes first
        return np.asarray(np.maximum(data.efc_force[data.contact.efc_address], 0.0))

    def _at_clasps(self, flex: Index, element: Index, rows: Index) -> tuple[Index, Index]:
        """Return indices (c,) of the contacts at clasps that have forces, and their clasps (c,)."""
        one, other = flex.T
        clasp = self._begins[one, other]
        if self._clasps_twice:
            at_end = element >= 0.5 * self._segments[other]
            clasp = np.where(at_end, self._ends[one, other], clasp)
        (chosen,) = np.nonzero((clasp >= 0) & (rows >= 0))
        return chosen, clasp[chosen]

    def gather(self) -> None:
        """Add the contacts of the last step."""
        contact = self._world.data.contact
        columns = (contact.flex, contact.elem[:, 1], contact.efc_address)
        flex, element, rows = (column.copy() for column in columns)
        self._steps.append((flex, element, rows, self._normal_forces(), contact.pos.copy()))

    def collect(self, minimum: Array | float = 0.0) -> tuple[Array, Array]:
        """Return vertices and forces since the last call, and reset.

        Vertices (clasps, 3) [m] are centres of the contact force; nan for forces below ``minimum``
        (clasps,) [N]. Forces (clasps,) [N] are mean sums of normal forces.
        """
        total, moment = np.zeros(len(self._clasps)), np.zeros((len(self._clasps), 3))
        count = max(len(self._steps), 1)
        if self._steps:
            *columns, force, place = map(np.concatenate, zip(*self._steps, strict=True))
            chosen, clasp = self._at_clasps(*columns)
            pressing = force[chosen] * (clasp == self._clasps[:, None])
            total, moment = pressing.sum(axis=1), pressing @ place[chosen]
            self._steps.clear()
        forces = total / count
        bears = (forces > 0.0) & (forces >= minimum)
        vertices = np.full_like(moment, np.nan)
        vertices[bears] = moment[bears] / total[bears, None]
        return vertices, forces


class HungLoads:
    """Loads that hang at the clasps like rings, as additional mass of the nodes in contact.

    While cables slide through a clasp, its load passes from node to node.
    """

    def __init__(self, world: World, team: Team) -> None:
        self._world, self._mass, self._contacts = world, team.load, ClaspContacts(world, team)
        self._cable = np.repeat(np.arange(team.robots), np.diff(world.cable_vertices))
        self._bodies = world.model.flex_vertbodyid
        self._empty = world.model.body_mass[self._bodies]
        self._on_nodes = np.zeros((len(team.load), len(self._bodies)))  # fractions of a load

    def apply(self, shares: Array, seconds: float) -> None:
        """Distribute the loads over the nodes at their clasps for the next ``seconds``.

        ``shares`` (n,) are the fractions of its halves of loads that each cable carries. Clasps
        without contact lose their loads.
        """
        data = self._world.data
        chosen, clasp, force = self._contacts.now()
        force = np.maximum(force, MIN_FORCE)
        force = force / np.bincount(clasp, force, len(self._mass))[clasp]
        node = self._world.cable_vertices[data.contact.flex[chosen]] + data.contact.elem[chosen]
        target = np.zeros_like(self._on_nodes)
        for end in (0, 1):  # of both elements that touch
            np.add.at(target, (clasp[:, None], node + end), 0.25 * force[:, None])
        decay = np.exp(-seconds / SMOOTHING)
        self._on_nodes = decay * self._on_nodes + (1.0 - decay) * target
        added = self._mass @ self._on_nodes * shares[self._cable]
        self._world.model.body_mass[self._bodies] = self._empty + added


def touching(
    world: World, names: Sequence[str] = (), passing: Array = NO_POSITIONS
) -> list[tuple[str, str]]:
    """Return all pairs in contact by name: ``q0`` and ``r2``, or ``q0`` and ``cable 2``.

    These contacts have no forces, so that every flight is simulated to its end. ``passing`` (m, 3)
    [m] are drones with ``names`` that are not simulated. Drones are ellipsoids, cables points:
    between two nodes a cable is at most 2 mm closer. Cables of different teams do collide.
    """
    scale = 1.0 / np.array([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])
    count, names = len(world.drones), [*world.drone_names, *names]
    drones = np.concatenate([world.drones, passing]) * scale
    drone, node = np.nonzero(cdist(drones, world.nodes * scale) <= 1.0)
    cable = world.node_cables[node]
    index = node - world.cable_vertices[cable]
    from_end = np.where(drone % 2 == 0, index, world.ropes.segments[cable] - index)
    distant = from_end * world.ropes.segment_lengths[cable] > EXCLUDED_LENGTH * BODY_RADIUS
    distant &= drones[drone, 2] / scale[2] > world.ground + LANDED_HEIGHT
    foreign = (drone // 2 != cable) | distant  # on another cable, or far along the own one
    pairs = sorted({*zip(drone[foreign].tolist(), cable[foreign].tolist(), strict=True)})
    flexes = world.data.contact.flex
    between = flexes[np.all(flexes >= 0, axis=1)]
    across = between[world.teams[between[:, 0]] != world.teams[between[:, 1]]]
    crossings = sorted({(i, k) for i, k in across.tolist()})
    close = np.argwhere(cdist(drones[:count], drones) <= 2.0).tolist()  # two ellipsoids
    return [
        *((names[i], names[j]) for i, j in close if i < j),
        *((names[i], world.cable_names[k]) for i, k in pairs),
        *((world.cable_names[i], world.cable_names[k]) for i, k in crossings),
    ]


class ObjectContacts:
    """Contacts of objects: forbidden ones, and all contacts with cables."""

    def __init__(self, world: World, cargo: Cargo) -> None:
        self._world, self._cargo, self._lifted = world, cargo, cargo.lifted
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
        self._team = np.full(bodies, "", dtype=object)
        self._team[world.model.flex_vertbodyid] = np.repeat(world.teams, counts)
        self._untouched = np.zeros(len(objects), dtype=np.bool_)
        self._holder = np.array([cargo.holders.get(name, "") for name in cargo.names], dtype=object)

    def wrong(self, index: int) -> list[tuple[str, str]]:
        """Return the forbidden contacts of objects at a sample of the plan, by name.

        Cables may touch held objects. Lifted objects may touch nothing else, drones nothing at all.
        """
        if not self._cargo.objects:
            return []
        item, body = self._pairs()
        held, is_lifted = self._cargo.held[index], np.append(self._lifted[index], False)
        kind, lifted = self._kind[body], is_lifted[item] | is_lifted[self._rank[body]]
        held = held[item] & (self._holder[item] == self._team[body])
        forbidden = np.where(kind == CABLE, ~held, (kind == DRONE) | lifted)
        named = zip(self._names[body[forbidden]], item[forbidden], strict=True)
        return sorted({(str(other), self._cargo.names[i]) for other, i in named})

    @property
    def cables(self) -> NDArray[np.bool_]:
        """Return whether cables touch each object (objects,)."""
        touched = self._untouched.copy()
        if not len(touched):
            return touched
        thing, body = self._pairs()
        touched[thing[self._kind[body] == CABLE]] = True
        return touched

    def _pairs(self) -> tuple[Index, Index]:
        """Return indices of objects in contact (contacts,), and the bodies that touch them."""
        contact = self._world.data.contact
        geoms = contact.geom[np.all(contact.geom >= 0, axis=1) & (contact.efc_address >= 0)]
        bodies = self._world.model.geom_bodyid[geoms]
        chosen = bodies[np.any(self._rank[bodies] >= 0, axis=1)]
        rows, own = np.arange(len(chosen)), np.argmax(self._rank[chosen] >= 0, axis=1)
        return self._rank[chosen[rows, own]], chosen[rows, 1 - own]
