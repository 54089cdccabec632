"""Contacts at clasps, of drones and of objects, and loads that hang at clasps."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.forces import contact_forces
from hitchopt.lab.simulation.task import MIN_LIFT, Cargo, Task, TeamTask
from hitchopt.lab.simulation.world import BODY_HALF_HEIGHT, BODY_RADIUS, Index, World
from hitchopt.values import Array

Strings = NDArray[np.str_]

MIN_BEARING_RATIO = 0.3
"""Smallest contact force of a clasp, over the plan's. Cables that only cross also press on each
other, by weight and deviations of drones, and some of them have a linking number of one."""

SMOOTHING = 0.05  # [s] Time constant of the transfer of a load between nodes
MIN_FORCE = 1e-9  # [N] Smallest normal force of a contact
EXCLUDED_LENGTH = 2.0  # Section of its own cable that a drone cannot touch, over its radius
LANDED_HEIGHT = 0.2  # [m] Height below which a drone may touch its own cable
NO_POSITIONS = np.zeros((0, 3))  # [m] Positions of no drones


def least_bearing(task: Task) -> Array:
    """Return the smallest contact force of a bearing clasp (samples, clasps) [N].

    It is a fraction of the contact force without friction, which is ``|T (u_{k-1} + u_k)|`` for
    equal tensions; 0 if a cable has no tension.
    """
    times = task.states.t - task.states.t[0]
    return np.concatenate([_least_bearing(part, times) for part in task.teams], axis=1)


def _least_bearing(part: TeamTask, times: Array) -> Array:
    """Return the forces (samples, clasps) [N] of one team, at times from the task's start [s]."""
    layout = part.team.layout
    tensions = part.states.tensions
    bearing = np.zeros((len(times), len(layout.clasps)))
    taut = np.all(tensions > 0.0, axis=-1)
    vertices = part.states.vertices[taut]
    if part.motion is not None and part.motion.has_wraps:  # edges bend around an object
        first_contacts, last_contacts = np.moveaxis(part.motion.contacts.at(times[taut]), -2, 0)
        leaving = unit(first_contacts - vertices[:, layout.starts])
        arriving = unit(vertices[:, layout.ends] - last_contacts)
    else:
        leaving = arriving = unit(layout.edges(vertices))
    forces = contact_forces(leaving, tensions[taut], part.team.topology, arriving)
    bearing[taut] = MIN_BEARING_RATIO * forces
    return bearing


class ContactsAtClasps(NamedTuple):
    """Contacts that press at clasps."""

    contacts: Index  # (c,), their numbers among all contacts
    clasps: Index  # (c,), their clasps
    forces: Array  # (c,) [N], normal forces


class CableContacts(NamedTuple):
    """All contacts of one step, or of several, with their bodies by flexes; -1 for other bodies."""

    flexes: Index  # (contacts, 2)
    rows: Index  # (contacts,), rows of the constraints; -1 for contacts without a force
    forces: Array  # (contacts,) [N], normal forces
    positions: Array  # (contacts, 3) [m]

    @classmethod
    def of_step(cls, world: World) -> CableContacts:
        """Return the contacts of the last step; forces have no meaning for those without a row."""
        contact = world.data.contact
        # Friction cones are elliptic: the normal force comes first.
        normal_forces = np.maximum(world.data.efc_force[contact.efc_address], 0.0)
        return cls(
            flexes=contact.flex.copy(),
            rows=contact.efc_address.copy(),
            forces=np.asarray(normal_forces),
            positions=contact.pos.copy(),
        )

    @classmethod
    def of_steps(cls, steps: Sequence[CableContacts]) -> CableContacts:
        """Return the contacts of several steps, step after step."""
        return cls(*(np.concatenate(columns) for columns in zip(*steps, strict=True)))


class ClaspContacts:
    """Contact forces between neighbouring cables and their centres, averaged over steps."""

    def __init__(self, world: World, team: Team) -> None:
        self._world = world
        layout = team.layout
        self._clasps = np.arange(len(layout.clasps))
        # Clasp of a contact by both its flexes. The last row and column are those of contacts with
        # other bodies, whose flex is -1.
        self._clasp_of_flexes = np.full((team.robots + 1, team.robots + 1), -1)
        self._clasp_of_flexes[layout.behind, layout.ahead] = self._clasps
        self._clasp_of_flexes[layout.ahead, layout.behind] = self._clasps
        self._steps: list[CableContacts] = []  # since the last call of ``collect``

    def now(self) -> ContactsAtClasps:
        """Return the contacts at clasps of the last step."""
        return self._at_clasps(CableContacts.of_step(self._world))

    def _at_clasps(self, contacts: CableContacts) -> ContactsAtClasps:
        """Return the contacts at clasps that have forces."""
        first, second = contacts.flexes.T
        clasps = self._clasp_of_flexes[first, second]
        (pressing,) = np.nonzero((clasps >= 0) & (contacts.rows >= 0))
        return ContactsAtClasps(pressing, clasps[pressing], contacts.forces[pressing])

    def gather(self) -> None:
        """Add the contacts of the last step."""
        self._steps.append(CableContacts.of_step(self._world))

    def collect(self, minimum: Array | float = 0.0) -> tuple[Array, Array]:
        """Return vertices and forces since the last call, and reset.

        Vertices (clasps, 3) [m] are centres of the contact force; nan for forces below ``minimum``
        (clasps,) [N]. Forces (clasps,) [N] are mean sums of normal forces.
        """
        total = np.zeros(len(self._clasps))
        moment = np.zeros((len(self._clasps), 3))
        steps = max(len(self._steps), 1)
        if self._steps:
            contacts = CableContacts.of_steps(self._steps)
            pressing = self._at_clasps(contacts)
            forces_by_clasp = pressing.forces * (pressing.clasps == self._clasps[:, None])
            total = forces_by_clasp.sum(axis=1)
            moment = forces_by_clasp @ contacts.positions[pressing.contacts]
            self._steps.clear()
        forces = total / steps
        bears = (forces > 0.0) & (forces >= minimum)
        vertices = np.full_like(moment, np.nan)
        vertices[bears] = moment[bears] / total[bears, None]
        return vertices, forces


class HungLoads:
    """Loads that hang at the clasps like rings, as additional mass of the nodes in contact.

    While cables slide through a clasp, its load passes from node to node.
    """

    def __init__(self, world: World, team: Team) -> None:
        self._world = world
        self._mass = team.load
        self._contacts = ClaspContacts(world, team)
        self._cable_of_node = np.repeat(np.arange(team.robots), np.diff(world.cable_vertices))
        self._bodies = world.model.flex_vertbodyid
        self._own_mass = world.model.body_mass[self._bodies]
        self._on_nodes = np.zeros((len(team.load), len(self._bodies)))  # fractions of a load

    def apply(self, shares: Array, seconds: float) -> None:
        """Distribute the loads over the nodes at their clasps for the next ``seconds``.

        Each cable carries half of the loads at its clasps, times its share in ``shares`` (n,).
        Clasps without contact lose their loads.
        """
        target = self._nodes_in_contact()
        decay = np.exp(-seconds / SMOOTHING)
        self._on_nodes = decay * self._on_nodes + (1.0 - decay) * target
        hung_mass = self._mass @ self._on_nodes * shares[self._cable_of_node]
        self._world.model.body_mass[self._bodies] = self._own_mass + hung_mass

    def _nodes_in_contact(self) -> Array:
        """Return the fractions (clasps, nodes) of loads on the nodes that now touch at clasps."""
        contact = self._world.data.contact
        contacts, clasps, forces = self._contacts.now()
        forces = np.maximum(forces, MIN_FORCE)
        fractions = forces / np.bincount(clasps, forces, len(self._mass))[clasps]
        # First nodes (c, 2) of both elements that touch; each element carries half, at both ends
        nodes = self._world.cable_vertices[contact.flex[contacts]] + contact.elem[contacts]
        on_nodes = np.zeros_like(self._on_nodes)
        for end in (0, 1):
            np.add.at(on_nodes, (clasps[:, None], nodes + end), 0.25 * fractions[:, None])
        return on_nodes


def touching(
    world: World, names: Sequence[str] = (), passing: Array = NO_POSITIONS
) -> list[tuple[str, str]]:
    """Return all pairs in contact by name: ``q0`` and ``r2``, or ``q0`` and ``cable 2``.

    These contacts have no forces, so that every flight is simulated to its end. ``passing`` (m, 3)
    [m] are drones with ``names`` that are not simulated. Drones are ellipsoids, cables points:
    between two nodes a cable is at most 2 mm closer. Cables of different teams do collide.
    """
    drone_names = [*world.drone_names, *names]
    positions = np.concatenate([world.drones, passing])
    return [
        *((drone_names[i], drone_names[j]) for i, j in _touching_drones(world, positions)),
        *((drone_names[i], world.cable_names[k]) for i, k in _drones_at_cables(world, positions)),
        *((world.cable_names[i], world.cable_names[k]) for i, k in _cables_across_teams(world)),
    ]


ELLIPSOID_SCALE = 1.0 / np.array([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])
"""(3,) [1/m], scale of coordinates in which the body of a drone is a unit ball."""


def _touching_drones(world: World, positions: Array) -> list[tuple[int, int]]:
    """Return pairs i < j of touching drones, of which i is simulated; positions (d, 3) [m]."""
    centres = positions * ELLIPSOID_SCALE
    simulated = centres[: len(world.drone_bodies)]
    close = np.argwhere(cdist(simulated, centres) <= 2.0)  # two ellipsoids
    return [(i, j) for i, j in close.tolist() if i < j]


def _drones_at_cables(world: World, positions: Array) -> list[tuple[int, int]]:
    """Return sorted pairs of drones, at positions (d, 3) [m], and the cables that they touch.

    A drone may touch its own cable near their joint, and when it has landed.
    """
    distances = cdist(positions * ELLIPSOID_SCALE, world.nodes * ELLIPSOID_SCALE)
    drones, nodes = np.nonzero(distances <= 1.0)
    cables = world.node_cables[nodes]
    from_first_node = nodes - world.cable_vertices[cables]
    from_last_node = world.ropes.segments[cables] - from_first_node
    segments_from_drone = np.where(drones % 2 == 0, from_first_node, from_last_node)
    lengths_from_drone = segments_from_drone * world.ropes.segment_lengths[cables]
    is_far_along = lengths_from_drone > EXCLUDED_LENGTH * BODY_RADIUS
    is_flying = positions[drones, 2] > world.ground + LANDED_HEIGHT
    is_own = drones // 2 == cables
    forbidden = ~is_own | (is_far_along & is_flying)
    return sorted({*zip(drones[forbidden].tolist(), cables[forbidden].tolist(), strict=True)})


def _cables_across_teams(world: World) -> list[tuple[int, int]]:
    """Return sorted pairs of cables of different teams in contact."""
    flexes = world.data.contact.flex
    of_cables = flexes[np.all(flexes >= 0, axis=1)]
    across = of_cables[world.teams[of_cables[:, 0]] != world.teams[of_cables[:, 1]]]
    return sorted({(i, k) for i, k in across.tolist()})


class BodyKind(IntEnum):
    """Kinds of bodies that objects may touch."""

    GROUND = 0
    DRONE = 1
    CABLE = 2
    OBJECT = 3


class ObjectContacts:
    """Contacts of objects: forbidden ones, and all contacts with cables."""

    def __init__(self, world: World, cargo: Cargo) -> None:
        self._world = world
        self._cargo = cargo
        self._lifted = cargo.lifted
        self._places_below = cargo.places_below
        self._upper = np.array([each.upper for each in cargo.objects.values()])
        bodies = world.model.nbody
        cable_bodies = world.model.flex_vertbodyid
        nodes = np.diff(world.cable_vertices)
        self._kind = np.full(bodies, BodyKind.GROUND)
        self._names = np.full(bodies, "the ground", dtype=object)
        self._classify(cable_bodies, BodyKind.CABLE, np.repeat(world.cable_names, nodes))
        self._classify(world.drone_bodies, BodyKind.DRONE, world.drone_names)  # ends of cables
        self._classify(world.object_bodies, BodyKind.OBJECT, cargo.names)
        self._team = np.full(bodies, "", dtype=object)
        self._team[cable_bodies] = np.repeat(world.teams, nodes)
        # Index of the object of each body; -1 for other bodies
        self._object = np.full(bodies, -1)
        self._object[world.object_bodies] = np.arange(len(world.object_bodies))
        self._holder = np.array([cargo.holders.get(name, "") for name in cargo.names], dtype=object)

    def _classify(self, bodies: Index, kind: BodyKind, names: Sequence[str] | Strings) -> None:
        """Set the kind and the names of bodies."""
        self._kind[bodies] = kind
        self._names[bodies] = names

    def wrong(self, index: int) -> list[tuple[str, str]]:
        """Return the forbidden contacts of objects at a sample of the plan, by name.

        Cables may touch held objects. Lifted objects may touch nothing else, except, as they are
        set down, the ground and what is below their places. Drones may touch nothing at all.
        """
        if not self._cargo.objects:
            return []
        objects, bodies = self._pairs()
        kind = self._kind[bodies]
        held_by_team = self._holder[objects] == self._team[bodies]
        held = self._cargo.held[index][objects] & held_by_team
        others = self._object[bodies]
        lifted = self._touches_in_air(index, objects, others)
        lifted |= self._touches_in_air(index, others, objects)
        forbidden = np.where(kind == BodyKind.CABLE, ~held, (kind == BodyKind.DRONE) | lifted)
        named = zip(self._names[bodies[forbidden]], objects[forbidden], strict=True)
        return sorted({(str(other), self._cargo.names[i]) for other, i in named})

    def _touches_in_air(self, index: int, objects: Index, others: Index) -> NDArray[np.bool_]:
        """Return whether objects are lifted and may not touch others (contacts,).

        Other bodies than objects are -1.
        """
        tops = np.append(self._cargo.poses[index, :, 2] + self._upper, -np.inf)
        places = np.append(self._places_below[index], -np.inf)
        is_lifted = np.append(self._lifted[index], False)
        return np.asarray(is_lifted[objects] & (tops[others] >= places[objects] + MIN_LIFT))

    @property
    def cables(self) -> NDArray[np.bool_]:
        """Return whether cables touch each object (objects,)."""
        touched = np.zeros(len(self._world.object_bodies), dtype=np.bool_)
        if len(touched):
            objects, bodies = self._pairs()
            touched[objects[self._kind[bodies] == BodyKind.CABLE]] = True
        return touched

    def _pairs(self) -> tuple[Index, Index]:
        """Return indices of objects in contact (contacts,), and the bodies that touch them."""
        contact = self._world.data.contact
        has_force = np.all(contact.geom >= 0, axis=1) & (contact.efc_address >= 0)
        bodies = self._world.model.geom_bodyid[contact.geom[has_force]]
        is_object = self._object[bodies] >= 0
        of_objects = np.any(is_object, axis=1)
        bodies = bodies[of_objects]
        first_object = np.argmax(is_object[of_objects], axis=1)
        rows = np.arange(len(bodies))
        touched = bodies[rows, first_object]
        touching_bodies = bodies[rows, 1 - first_object]
        return self._object[touched], touching_bodies
