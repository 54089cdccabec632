"""The simulated world in MuJoCo: colliding ropes, drones at their ends, objects and ground.

A rope is a one-dimensional flex without bending stiffness and self-collision. Its nodes are bodies
with slide joints in x, y and z, its first and last nodes are the drones (cables are attached at the
centre of mass), and an equality constraint fixes the lengths of its edges. ``contacts`` detects
contacts of drones with cables and with each other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import HitchoptError, optional_module
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation.ropes import ROUNDING, Ropes
from hitchopt.lab.simulation.task import team_of
from hitchopt.objects import Section, SolidObject
from hitchopt.values import Array

Index = NDArray[np.intp]

ROPES = 1  # Collision group of ropes, which collide with ropes and ground
GROUND = 2  # Collision group of ground and objects, with which drones collide
# Collision group of objects, which collide with feet of other objects and nodes of ropes
OBJECTS = 4

# Contact stiffness; with MuJoCo's softer defaults ropes pass through each other
CONTACT_SOLVER = 'solref="0.002 1" solimp="0.99 0.999 0.001"'

# Ratio of frictional to normal stiffness with objects: at half of the grip's capacity, objects
# creep by 7 mm/s at 1 and by 0.1 mm/s at 100
FRICTION_STIFFNESS_RATIO = 100

MIN_GROUND_FRICTION = 0.3  # Smallest friction coefficient of the ground
BODY_RADIUS = 0.07  # Horizontal semi-axis of the ellipsoid that a drone occupies [m]
BODY_HALF_HEIGHT = 0.03  # Vertical semi-axis of that ellipsoid [m]

# Radii of gyration of a drone about its axes, over its radius: four motors on arms, and a central
# mass
RADII_OF_GYRATION = (0.5, 0.5, 0.65)

SLIDE_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}  # Directions of slide joints

SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in SLIDE_AXES.values())

# Rotational inertia [kg m²] that MuJoCo requires of nodes of ropes
TINY_INERTIA = (1e-9, 1e-9, 1e-9)

PREFIX = "object "  # Prefix of objects in names of bodies
RIM_THICKNESS = 0.01  # Smallest one above the height of a rim [m]: ropes pass through thin sheets
RIGHT_ANGLE = 1e-9  # Largest cosine of a right angle

# Radius of the balls within their bottom and top on which objects stand [m]. Without them, MuJoCo
# finds wrong contacts of cylinders and meshes that only touch, and tilted cylinders roll along
# the edge of their floor forever
FOOT = 0.002
FEET = 8  # Minimum number of these balls in a ring
RINGS = (0.98, 0.4)  # Sizes of the rings, over the object's

EDGE_TIME = 0.002  # Time constant of the length constraints [s]
EDGE_IMPEDANCE = 'solimp="0.999 0.9999 0.0005"'  # Impedances of the length constraints
# Smallest time constant in time steps, which is used with objects, since ropes that hold them would
# stretch by a per cent
EDGE_STEPS = 2.5

# Largest rotation of a link within the time constant t, since links that turn at a rate ω are
# strained by ``(ω t)²``
MAX_LINK_TURN = 0.07
MIN_EDGE_TIME_RATIO = 0.06  # Smallest time constant over the largest

# Smallest and largest ratio of time constants in successive steps of loose ropes, which would
# jerk
LOOSE_CHANGES = (0.8, 1.05)
TAUT_CHANGES = (0.95, 1.002)  # The same of taut ropes

CHANGING = 6  # Segments of a cable over those at each end that become shorter with it
MAX_STRAIN = 0.02  # Largest strain of a segment, beyond which ropes may pass through each other
# Largest penetration of ropes over the diameter, beyond which they may pass through each other
MAX_PENETRATION = 0.3

FINER = "preset accurate or a higher density"  # Remedies of coarse ropes


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """Drones as rigid bodies."""

    positions: Array  # (2n, 3) [m]
    velocities: Array  # (2n, 3) [m/s]
    attitudes: Array  # (2n, 3, 3), their columns are the bodies' axes
    rates: Array  # (2n, 3) [rad/s], about the bodies' axes


class Airframes(Protocol):
    """Masses (2n,) [kg] of drones, and inertia (2n, 3) [kg m²] about their own axes."""

    masses: Array
    inertia: Array


class World:
    """A compiled model with its state, and indices into MuJoCo's arrays.

    It has n ropes, drones q0, r0, q1, … of some masses (2n,) [kg], the ground at a height [m], and
    objects by name. Ropes are straight initially: place the nodes before the first step.
    """

    def __init__(
        self,
        ropes: Ropes,
        masses: Array,
        ground: float,
        objects: dict[str, SolidObject],
        names: Sequence[str] = (),
    ) -> None:
        mujoco = optional_module("mujoco", "simulating needs", "simulate")
        self._forward, self._advance = mujoco.mj_forward, mujoco.mj_step  # deep copies share these
        if mujoco.get_mju_user_warning() is None:  # Without its log file of warnings
            mujoco.set_mju_user_warning(lambda _text: None)
        self.ropes, self.ground, self.objects = ropes, ground, objects
        self.masses = np.array(masses, dtype=np.float64)
        self.inertia = inertia_of(self.masses)
        count = len(ropes.lengths)
        self.drone_names = list(names) or [f"{end}{k}" for k in range(count) for end in "qr"]
        self.teams = np.array([team_of(name) for name in self.drone_names[::2]])
        self.cable_names = cable_names(self.drone_names)
        description = describe(ropes, self.masses, ground, objects, self.drone_names)
        self.model = model = mujoco.MjModel.from_xml_string(description)
        self.data = mujoco.MjData(model)
        things = [f"{PREFIX}{name}" for name in self.objects]
        self.drone_bodies, self.object_bodies = (
            np.array([model.body(name).id for name in names], dtype=np.intp)
            for names in (self.drone_names, things)
        )
        nodes = np.setdiff1d(model.flex_vertbodyid, self.drone_bodies)

        def places(addresses: Index, bodies: Index) -> Index:
            return np.asarray(addresses[model.body_jntadr[bodies]][:, None] + np.arange(3))

        # Addresses (2n, 3) of the drones' velocities in qvel, which those of their rates follow,
        # and of the inner nodes of all cables (nodes, 3)
        self.drone_dofs = places(model.jnt_dofadr, self.drone_bodies)
        self.node_dofs = places(model.jnt_dofadr, nodes)
        self._vertex_dofs = places(model.jnt_dofadr, model.flex_vertbodyid)
        self._drone_qpos = places(model.jnt_qposadr, self.drone_bodies)
        self._node_qpos = places(model.jnt_qposadr, nodes)
        self._node_origins = model.body_pos[nodes]  # positions at which qpos is zero
        # Nodes of cable k with its drones are flex vertices from entry k of (n + 1,) to the next
        self.cable_vertices: Index = np.concatenate([[0], np.cumsum(ropes.segments + 1)])
        # Cables of nodes and drones (nodes,), and of edges (edges,)
        self.node_cables: Index = np.repeat(np.arange(len(ropes.lengths)), ropes.segments + 1)
        self.edge_cables: Index = np.repeat(np.arange(len(ropes.lengths)), ropes.segments)
        self._last_edges: Index = self.cable_vertices[1:-1] - 1  # between cables
        self._shortest_segment = float(np.min(ropes.segment_lengths))
        # Addresses (2n, 6) of velocities and rates
        self._moving_dofs: Index = np.concatenate([self.drone_dofs, self.drone_dofs + 3], axis=1)
        self._wrenches = np.zeros((2 * count, 6))
        self._edge_lengths = self.model.flexedge_length0.copy()
        self._end_shares = np.concatenate([_end_shares(count) for count in ropes.segments])
        self._held = np.ones(len(self.edge_cables), dtype=np.bool_)  # edges of constant length
        self._edge_time = self._longest_edge_time = float(model.eq_solref[0, 0])
        self._stepping = float(model.opt.timestep), self._edge_time

    def place(self, cables: list[Array]) -> None:
        """Place the nodes of cables with drones at the ends, n of (segments + 1, 3) [m]."""
        inner = np.concatenate([cable[1:-1] for cable in cables])
        ends = np.concatenate([cable[[0, -1]] for cable in cables])
        self.data.qpos[self._node_qpos] = inner - self._node_origins
        self.data.qpos[self._drone_qpos] = ends
        self._forward(self.model, self.data)

    def step(self, count: int = 1, *, loose: bool = False, substeps: int = 1) -> None:
        """Advance by ``count`` time steps of the preset, with substeps while ropes whip.

        ``loose`` ropes may whip when they leave the ground or become straight. ``substeps`` is the
        smallest number of substeps. Length constraints have a shorter time constant with substeps.
        """
        step, longest = self.ropes.preset.time_step, self._longest_edge_time
        time = longest if substeps == 1 else min(longest, EDGE_STEPS * step / substeps)
        if loose:
            velocities = self.data.qvel.take(self._vertex_dofs)
            across = velocities[1:] - velocities[:-1]
            across[self._last_edges] = 0.0
            rate = math.sqrt(np.maximum.reduce(dot(across, across))) / self._shortest_segment
            time = max(min(time, MAX_LINK_TURN / max(rate, 1.0)), MIN_EDGE_TIME_RATIO * longest)
        lower, upper = LOOSE_CHANGES if loose else TAUT_CHANGES
        time = self._edge_time = min(max(time, lower * self._edge_time), upper * self._edge_time)
        count_per_step = substeps
        if time < longest:
            count_per_step = max(count_per_step, math.ceil(EDGE_STEPS * step / time - ROUNDING))
        if (step / count_per_step, time) != self._stepping:
            self._stepping = step / count_per_step, time
            self.model.opt.timestep = step / count_per_step
            self.model.eq_solref[:, 0] = time
        self._advance(self.model, self.data, nstep=count * count_per_step)

    def let_go(self, cable: int) -> None:
        """Let both drones of a cable let go of its ends.

        Its first and last edges become free, and their elements those next to them, so that nothing
        touches what would be between a drone and the rope.
        """
        edges = np.flatnonzero(self.edge_cables == cable)[[0, -1]]
        self._held[edges] = False
        self.model.flexedge_rigid[edges] = True  # these have no constraints
        elements = self.model.flex_elem.reshape(-1, 2)
        elements[edges] = elements[edges + [1, -1]]

    def shorten(self, by: Array) -> None:
        """Let cables be shorter than at first, by lengths (n,) [m], near their drones alone."""
        shorter = self._end_shares * by[self.edge_cables]
        self.model.flexedge_length0[:] = self._edge_lengths - shorter

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether edges are held at their length (edges,): all but those that drones let go."""
        return self._held

    @property
    def is_finite(self) -> bool:
        """Return whether all positions and attitudes are finite, and so is their sum."""
        return math.isfinite(np.add.reduce(self.data.qpos))

    @property
    def nodes(self) -> Array:
        """Positions of all nodes (nodes, 3) [m] by cable, with drones at the ends.

        Ends that drones let go are those of the ropes.
        """
        nodes = np.asarray(self.data.flexvert_xpos)
        if self._held.all():
            return nodes
        first, last = self.cable_vertices[:-1], self.cable_vertices[1:] - 1
        free = first[~self._held[first - np.arange(len(first))]]
        ends = last[~self._held[last - np.arange(len(last)) - 1]]
        nodes = nodes.copy()
        nodes[free], nodes[ends] = nodes[free + 1], nodes[ends - 1]
        return nodes

    @property
    def tensions(self) -> Array:
        """Tension of every segment (edges,) [N], in the order of ``edge_cables``."""
        if self._held.all():
            return -np.asarray(self.data.efc_force[: len(self.edge_cables)])
        tensions = np.zeros(len(self.edge_cables))
        tensions[self._held] = -self.data.efc_force[: np.count_nonzero(self._held)]
        return tensions

    @property
    def cables(self) -> list[Array]:
        """Nodes of every cable: n of (segments + 1, 3) [m]."""
        return np.split(self.nodes, self.cable_vertices[1:-1])

    @property
    def drones(self) -> Array:
        """Positions of the drones (2n, 3) [m]."""
        return np.asarray(self.data.qpos.take(self._drone_qpos))

    @property
    def bodies(self) -> RigidBodies:
        """State of the drones."""
        moving = self.data.qvel.take(self._moving_dofs)
        return RigidBodies(self.drones, moving[:, :3], self._attitudes, moving[:, 3:])

    @property
    def _attitudes(self) -> Array:
        """Axes of the drones as columns (2n, 3, 3)."""
        return np.asarray(self.data.xmat.take(self.drone_bodies, 0).reshape(-1, 3, 3))

    def push(self, thrusts: Array, moments: Array, forces: Array) -> None:
        """Apply thrusts (2n,) and moments about the bodies' axes, and forces (2n, 3) [N]."""
        attitudes, wrenches = self._attitudes, self._wrenches
        wrenches[:, :3] = forces + thrusts[:, None] * attitudes[:, :, 2]
        wrenches[:, 3:] = np.einsum("iab,ib->ia", attitudes, moments)
        self.data.xfrc_applied[self.drone_bodies] = wrenches

    @property
    def poses(self) -> Array:
        """Poses of the objects (objects, 7): positions of their bases [m], and quaternions."""
        data, bodies = self.data, self.object_bodies
        return np.concatenate([data.xpos[bodies], data.xquat[bodies]], axis=-1)


def cable_names(drones: Sequence[str]) -> list[str]:
    """Return the names (n,) of the cables between drones such as a.q0, a.r0: a.cable 0, …."""
    return [re.sub(r"[qr](\d+)$", r"cable \1", name) for name in drones[::2]]


class InvalidRunError(HitchoptError):
    """A simulation left its valid range at a time [s].

    The quantity is ``strain``, ``penetration``, ``tension`` or ``state`` (MuJoCo's own warnings).
    """

    def __init__(self, quantity: str, broken: str, time: float, where: str, remedy: str) -> None:
        self.quantity, self.time, self.where = quantity, time, where
        super().__init__(f"simulation: {broken}, t = {time:.3f} s: {remedy}")


def _end_shares(segments: int) -> Array:
    """Return the share (segments,) of each segment in a shortening of its cable."""
    at_end = max(1, segments // CHANGING)
    changes = np.zeros(segments)
    changes[:at_end] = changes[-at_end:] = 1.0
    return np.asarray(changes / np.sum(changes))


def check_valid(world: World, time: float) -> None:
    """Raise InvalidRunError if the step up to a time [s] of the flight is invalid.

    MuJoCo counts its warnings, and starts again from a state that is not finite.
    """
    data, ropes = world.data, world.ropes
    remedy = "a higher density" if ropes.preset.exact else FINER
    remedy = f"ropes may have passed each other; use {remedy}"
    if not world.is_finite or data.warning.number.any():
        raise InvalidRunError("state", "its state is no longer finite", time, "all", remedy)
    substeps = ropes.preset.time_step / world.model.opt.timestep
    strains = np.abs(data.flexedge_length / world.model.flexedge_length0 - 1.0) * world.held
    between = np.all(data.contact.flex >= 0, axis=1)
    depths, pairs = -data.contact.dist[between], data.contact.flex[between]
    for quantity, values, limit, unit in (
        ("strain", strains, MAX_STRAIN, "m/m"),
        ("tension", world.tensions, substeps**2 * ropes.largest_tension, "N"),
        ("penetration", depths, MAX_PENETRATION * ropes.preset.diameter, "m"),
    ):
        if len(values) and values[worst := int(np.argmax(values))] > limit:
            cables = (
                pairs[worst] if quantity == "penetration" else world.edge_cables[worst : worst + 1]
            )
            where = " and ".join(world.cable_names[k] for k in cables)
            excess = f"{quantity} of {values[worst]:.4g} {unit} is beyond {limit:.4g} {unit}"
            raise InvalidRunError(quantity, f"{excess} at {where}", time, where, remedy)


def inertia_of(masses: Array) -> Array:
    """Return the moments of inertia (2n, 3) [kg m²] of drones about their own axes."""
    return np.asarray(np.outer(masses, (BODY_RADIUS * np.array(RADII_OF_GYRATION)) ** 2))


def describe(
    ropes: Ropes,
    masses: Array,
    ground: float,
    objects: dict[str, SolidObject],
    names: Sequence[str],
    drone_joints: Callable[[str, Array], str] = lambda _name, _place: "<freejoint/>",
    node_joints: Callable[[str, Array], str] = lambda _name, _place: SLIDES,
    further: str = "",
) -> str:
    """Return the model in MuJoCo's XML, with straight ropes.

    Drones have masses (D,) [kg] and names (D,), those of cables first. Joints of drones, and of
    nodes between them, follow from their names and initial positions. ``further`` are more elements
    of the model.
    """
    bodies, flexes, equalities = "", "", ""
    edge = min(EDGE_TIME, EDGE_STEPS * ropes.preset.time_step) if objects else EDGE_TIME
    radius = text(0.5 * ropes.preset.diameter)
    # Objects collide with nodes, not edges: MuJoCo's iterative distances of capsules from convex
    # bodies have normals that are too inaccurate for light ropes at the corners of a rim
    ball = f'<geom size="{radius}" contype="0" conaffinity="{OBJECTS}"/>' if objects else ""
    axes = text([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])
    collision = f'contype="0" conaffinity="{GROUND | OBJECTS}"'
    ellipsoid = f'<geom type="ellipsoid" size="{axes}" {collision}/>'
    frictions = np.broadcast_to(ropes.friction, ropes.lengths.shape)
    node_masses = ropes.density * ropes.segment_lengths
    inertia = inertia_of(masses)
    cables = len(ropes.lengths)
    for k, (count, size) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        q, r = names[2 * k : 2 * k + 2]
        nodes = [q, *(f"c{k}_{i}" for i in range(1, count)), r]
        for i, name in enumerate(nodes):
            place = np.array([i * size, k, ground + 1.0])
            if i in (0, count):  # a drone, and half of the last segment
                drone = 2 * k + (i == count)
                inertial = masses[drone] + 0.5 * node_masses[k], inertia[drone]
                bodies += _body(name, place, *inertial, drone_joints(name, place) + ellipsoid)
            else:
                content = node_joints(name, place) + ball
                bodies += _body(name, place, node_masses[k], TINY_INERTIA, content)
        elements = " ".join(f"{i} {i + 1}" for i in range(count))
        flexes += (
            f'<flex name="cable{k}" dim="1" radius="{radius}" '
            f'body="{" ".join(nodes)}" element="{elements}"><contact contype="{ROPES}" '
            f'conaffinity="{ROPES | GROUND}" condim="3" '
            f'friction="{text(frictions[k])} 0 0" {CONTACT_SOLVER} '
            f'selfcollide="none" margin="0"/></flex>'
        )
        equalities += f'<flex flex="cable{k}" solref="{edge} 1" {EDGE_IMPEDANCE}/>'
    for drone in range(2 * cables, len(names)):
        place = np.array([0.0, cables + drone, ground + 1.0])
        content = drone_joints(names[drone], place) + ellipsoid
        bodies += _body(names[drone], place, masses[drone], inertia[drone], content)
    ground_friction = text(np.max(frictions, initial=MIN_GROUND_FRICTION))
    meshes, things = _describe_objects(objects, float(np.max(ropes.segment_lengths, initial=0.0)))
    step, ratio = text(ropes.preset.time_step), FRICTION_STIFFNESS_RATIO if objects else 1
    return f"""<mujoco>
        <option timestep="{step}" gravity="0 0 {text(-GRAVITY)}" integrator="Euler"
            solver="Newton" iterations="30" tolerance="1e-8" cone="elliptic" impratio="{ratio}"/>
        <size memory="{64 + 16 * len(ropes.lengths)}M"/>
        <asset>{meshes}</asset>
        <worldbody>
            <geom type="plane" size="0 0 1" pos="0 0 {text(ground)}" contype="{GROUND}"
                conaffinity="0" friction="{ground_friction} 0 0"/>
            {bodies}{things}
        </worldbody>
        <deformable>{flexes}</deformable>
        <equality>{equalities}</equality>
        {further}
    </mujoco>"""


def _body(name: str, place: Array, mass: float, inertia: ArrayLike, content: str) -> str:
    """Return a body with its joints and shapes."""
    return (
        f'<body name="{name}" pos="{text(place)}">'
        f'<inertial pos="0 0 0" mass="{text(mass)}" diaginertia="{text(inertia)}"/>'
        f"{content}</body>"
    )


def text(values: ArrayLike) -> str:
    """Return numbers as text with full precision."""
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(np.asarray(values, dtype=np.float64)))


def _describe_objects(objects: dict[str, SolidObject], link: float) -> tuple[str, str]:
    """Return meshes and bodies of objects in MuJoCo's XML, for ropes with a longest link [m].

    An object's friction is that of all its contacts. Its mass is that of a homogeneous prism with
    the widest of its outlines, without contacts: the mass of a tray is in its rim. Rims are as
    thick as links are long, up to the object's top: across a thinner one links of steep legs lie
    with one node on top, which holds the hitch as it opens.
    """
    meshes, bodies = "", ""
    for name, each in objects.items():
        slabs = [(each.section, each.lower, each.upper)]
        if each.rim is not None:
            thickness = max(RIM_THICKNESS, min(link, each.upper - each.rim.height))
            slabs.append((each.rim.section, each.rim.height, each.rim.height + thickness))
        contact = f'condim="3" friction="{text(each.friction)} 0 0" {CONTACT_SOLVER} mass="0"'
        parts = [
            (*slab, np.zeros(2), f'contype="{OBJECTS}" priority="1" {contact}') for slab in slabs
        ]
        widest = max((section for section, *_ in slabs), key=lambda section: section.area)
        shift = each.section.centroid - widest.centroid
        mass = f'contype="0" mass="{each.mass:.17g}"'
        parts.append((widest, each.lower, each.upper, shift, mass))
        geoms = ""
        for i, (section, lower, upper, offset, attributes) in enumerate(parts):
            label = f"{PREFIX}{name} {i}"
            mesh, shape = _shape(label, section, np.array([lower, upper]), offset)
            meshes += mesh
            geoms += f'<geom {shape} conaffinity="0" {attributes}/>'
        geoms += "".join(
            f'<geom size="{FOOT}" pos="{text(foot)}" contype="0" '
            f'conaffinity="{GROUND | OBJECTS}" priority="{1 if each.fixed else 2}" {contact}/>'
            for i, slab in enumerate(slabs)
            for foot in _feet(*slab, RINGS[: 2 - i])
        )
        turn = [math.cos(0.5 * each.yaw), 0.0, 0.0, math.sin(0.5 * each.yaw)]
        bodies += (
            f'<body name="{PREFIX}{name}" pos="{text(each.at)}" quat="{text(turn)}">'
            f"{'' if each.fixed else '<freejoint/>'}{geoms}</body>"
        )
    return meshes, bodies


def _shape(label: str, section: Section, heights: Array, shift: Array) -> tuple[str, str]:
    """Return the mesh, if any, and the geom of a section's prism between two heights [m]."""
    centre, half = [*(section.centroid + shift), np.mean(heights)], 0.5 * np.ptp(heights)
    if section.outline is None:
        return "", f'type="cylinder" size="{text([section.rounding, half])}" pos="{text(centre)}"'
    corners, sides = section.outline, np.diff(section.outline, axis=0)
    sizes = length(sides)
    skew = len(corners) != 4 or not np.allclose(corners[0] + corners[2], corners[1] + corners[3])
    if not skew and abs(sides[0] @ sides[1]) <= RIGHT_ANGLE * sizes[0] * sizes[1]:
        # MuJoCo has closed-form contacts of boxes
        turn = 0.5 * math.atan2(sides[0, 1], sides[0, 0])
        box = text([0.5 * sizes[0], 0.5 * sizes[1], half])
        quat = text([math.cos(turn), 0.0, 0.0, math.sin(turn)])
        return "", f'type="box" size="{box}" pos="{text(centre)}" quat="{quat}"'
    layers = [np.insert(corners + shift, 2, z, axis=1) for z in heights]
    points = text(np.concatenate(layers).ravel())
    return f'<mesh name="{label}" vertex="{points}"/>', f'type="mesh" mesh="{label}"'


def _feet(section: Section, lower: float, upper: float, sizes: tuple[float, ...]) -> Array:
    """Return centres (feet, 3) [m] of balls in rings at bottom and top, including corners."""
    if section.outline is None:
        angle = 2.0 * np.pi * np.arange(FEET) / FEET
        ring = section.rounding * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        corners = section.outline[:, None] - section.centroid
        count = math.ceil(FEET / len(corners))
        share = (np.arange(count) / count)[:, None]
        ring = (corners + share * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    rings = np.concatenate([section.centroid + size * ring for size in sizes])
    return np.concatenate([np.insert(rings, 2, z, axis=1) for z in (lower + FOOT, upper - FOOT)])
