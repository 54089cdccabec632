"""The simulated world in MuJoCo: ropes that collide, drones at their ends, objects, a ground.

A rope is a one-dimensional flex: its nodes are bodies that slide in x, y and z, its first and
last node are the drones themselves (the cable is attached at the centre of mass), and an equality
constraint keeps the lengths of its edges. It has no bending stiffness and no self-collision.
Contacts of drones with cables and with one another are found in ``contacts``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import HitchoptError, UnsupportedError
from hitchopt.hitch import GRAVITY
from hitchopt.objects import Section, SolidObject
from hitchopt.simulation.ropes import ROUNDING, Ropes
from hitchopt.values import Array

Index = NDArray[np.intp]

GROUND, OBJECTS = 2, 4
"""Collision groups of the ground, and of objects, which meet ropes, drones and others' feet."""

FEET, RINGS = 8, (0.98, 0.4)
"""Least number of feet in a ring below and on top of an object, and the rings' sizes over that of
its outline. Objects stand on the ground and on each other by these small balls: between cylinders
and meshes that merely touch, MuJoCo at times finds contacts as deep as the bodies, and a cylinder
that has been tilted rolls along the edge of its floor for ever, a degree or more a second."""

FOOT = 0.002
"""Radius of a foot [m]; it does not protrude."""

PREFIX = "object "
"""What a body's name begins with, before that of its object."""

RIM = 0.01
"""Thickness of a rim, above its height [m]: ropes pass through a sheet."""

RIGHT = 1e-9
"""Cosine of an angle that counts as a right one."""

CONTACT_SOLVER = 'solref="0.002 1" solimp="0.99 0.999 0.001"'
"""Stiffness of contacts; MuJoCo's defaults are softer, and let ropes pass."""

BODY_RADIUS, BODY_HALF_HEIGHT = 0.07, 0.03
"""Half-axes of the ellipsoid that a drone occupies [m]."""

EDGE_TIME, EDGE_IMPEDANCE = 0.002, 'solimp="0.999 0.9999 0.0005"'
"""Time constant [s] and impedances of the constraints on the ropes' lengths."""

EDGE_STEPS = 2.5
"""Least time constant of the lengths in time steps; also what it is where there are objects: ropes
that hold them pull harder, and short segments would yield by a per cent."""

ROPES = 1
"""Collision group besides GROUND and OBJECTS: ropes meet ropes and the ground, drones the ground
and objects, the ropes' nodes objects."""

FIRM = 100
"""Ratio of frictional to normal stiffness where there are objects: held ones creep by 7 mm/s at 1,
by 0.1 mm/s at 100 (measured at half of the grip's capacity)."""

LEAST_GROUND_FRICTION = 0.3
"""Friction coefficient of the ground where the cables' is less."""

TINY_INERTIA = "1e-9 1e-9 1e-9"
"""Inertia of bodies that only slide [kg m²]: MuJoCo requires one, nothing turns."""

SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
"""Joints of a body that slides in x, y and z."""

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

MOST_STRAIN = 0.02
"""Largest relative change of a segment's length; beyond it the time step is too long."""

MOST_PENETRATION = 0.3
"""Largest penetration over the diameter; ropes that press deeper are about to pass each other."""


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
        text = _describe(self, self.masses + ends, gravity)
        self.model = model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(model)
        names = [f"{end}{k}" for k in range(len(ropes.lengths)) for end in "qr"]
        self.drone_names = names
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
        turning = 0.0  # largest rate at which a link turns [rad/s]
        if loose:
            across = np.diff(self.data.qvel[self._vertex_dofs], axis=0)
            across[self._last_edges] = 0.0
            across = np.linalg.norm(across, axis=-1)
            turning = float(np.max(across) / np.min(self.ropes.segment_lengths))
        time = TURNED / max(turning, TURNED / self._longest_edge_time)
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

    They are counted in the data nevertheless, and end a run (see ``check_valid``).
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


class InvalidRunError(HitchoptError):
    """A simulation that has left the range in which it is meaningful.

    Attributes
    ----------
    quantity: ``strain``, ``penetration``, ``tension`` or ``state`` (MuJoCo's own warnings).
    value: its value; nan for a state.
    time: [s], from the flight's start; negative while the cables settle.
    where: names of cables.
    """

    def __init__(
        self, quantity: str, value: float, limit: float, unit: str, time: float, where: str
    ) -> None:
        self.quantity, self.value, self.time, self.where = quantity, value, time, where
        broken = f"{quantity} of {value:.4g} {unit} is beyond {limit:.4g} {unit} at {where}"
        if quantity == "state":
            broken = "its state is no longer finite"
        super().__init__(
            f"simulation: {broken}, t = {time:.3f} s: ropes may have passed each other; take a "
            "finer preset or a shorter time step, or fly more gently"
        )


def tensions(world: World) -> Array:
    """Return (edges,) [N]: the tension of every segment, in the order of ``edge_cables``."""
    found: Array = -world.data.efc_force[: len(world.edge_cables)]
    return found


def check_valid(world: World, time: float) -> None:
    """Check that the last step, until a time [s] of the flight, is meaningful.

    Raises
    ------
    InvalidRunError: the state is not finite, or a limit is exceeded.
    """
    data, ropes = world.data, world.ropes
    if not np.all(np.isfinite(data.qpos)) or data.warning.number.any():
        raise InvalidRunError("state", float("nan"), 0.0, "", time, "all")
    finer = ropes.preset.time_step / world.model.opt.timestep
    strains = np.abs(data.flexedge_length / world.model.flexedge_length0 - 1.0)
    flexes, cables = data.contact.flex, world.edge_cables
    between = np.all(flexes >= 0, axis=1)
    depths, pairs = -data.contact.dist[between], flexes[between]
    for quantity, values, limit, unit in (
        ("strain", strains, MOST_STRAIN, "m/m"),
        ("tension", tensions(world), finer**2 * ropes.largest_tension, "N"),
        ("penetration", depths, MOST_PENETRATION * ropes.preset.diameter, "m"),
    ):
        worst = int(np.argmax(values)) if len(values) else 0
        if len(values) and values[worst] > limit:
            where = f"cable {cables[worst]}"
            if quantity == "penetration":
                where = f"cables {pairs[worst][0]} and {pairs[worst][1]}"
            raise InvalidRunError(quantity, float(values[worst]), limit, unit, time, where)


def _describe(world: World, masses: Array, gravity: float) -> str:
    """Return the model in MuJoCo's XML, ropes straight; ``masses`` (2n,) [kg] hold their ends."""
    ropes, ground, objects = world.ropes, world.ground, world.objects
    bodies, flexes, equalities = "", "", ""
    edge = min(EDGE_TIME, EDGE_STEPS * ropes.preset.time_step) if objects else EDGE_TIME
    radius = _text(0.5 * ropes.preset.diameter)
    # Nodes meet objects, not edges: distances of capsules from convex bodies are found by an
    # iteration whose normals are too rough for light ropes at the corners of a rim.
    ball = f'<geom size="{radius}" contype="0" conaffinity="{OBJECTS}"/>' if objects else ""
    size = _text([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])
    meets = f'contype="0" conaffinity="{GROUND | OBJECTS}"'
    ellipsoid = f'<geom type="ellipsoid" size="{size}" {meets}/>'
    for k, (count, length) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        names = [f"q{k}", *(f"c{k}_{i}" for i in range(1, count)), f"r{k}"]
        for i, name in enumerate(names):
            drone = 2 * k + (i == count)
            mass, turning, moves, shape = ropes.density * length, TINY_INERTIA, SLIDES, ball
            if i in (0, count):
                mass, shape = masses[drone], ellipsoid
                if world.rigid:
                    turning, moves = _text(world.inertia[drone]), "<freejoint/>"
            bodies += (
                f'<body name="{name}" pos="{_text([i * length, k, ground + 1.0])}">'
                f'<inertial pos="0 0 0" mass="{_text(mass)}" diaginertia="{turning}"/>'
                f"{moves}{shape}</body>"
            )
        elements = " ".join(f"{i} {i + 1}" for i in range(count))
        flexes += (
            f'<flex name="cable{k}" dim="1" radius="{radius}" '
            f'body="{" ".join(names)}" element="{elements}"><contact contype="{ROPES}" '
            f'conaffinity="{ROPES | GROUND}" condim="3" '
            f'friction="{_text(ropes.friction)} 0 0" {CONTACT_SOLVER} '
            f'selfcollide="none" margin="0"/></flex>'
        )
        equalities += f'<flex flex="cable{k}" solref="{edge} 1" {EDGE_IMPEDANCE}/>'
    ground_friction = _text(max(ropes.friction, LEAST_GROUND_FRICTION))
    meshes, things = _describe_objects(objects)
    step, ratio = _text(ropes.preset.time_step), FIRM if objects else 1
    return f"""<mujoco>
        <option timestep="{step}" gravity="0 0 {_text(-gravity)}" integrator="Euler"
            solver="Newton" iterations="30" tolerance="1e-8" cone="elliptic" impratio="{ratio}"/>
        <size memory="{64 + 16 * len(ropes.lengths)}M"/>
        <asset>{meshes}</asset>
        <worldbody>
            <geom type="plane" size="0 0 1" pos="0 0 {_text(ground)}" contype="{GROUND}"
                conaffinity="0" friction="{ground_friction} 0 0"/>
            {bodies}{things}
        </worldbody>
        <deformable>{flexes}</deformable>
        <equality>{equalities}</equality>
    </mujoco>"""


def _text(values: ArrayLike) -> str:
    """Return numbers as text, to the last bit."""
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(np.asarray(values, dtype=np.float64)))


def _describe_objects(objects: Mapping[str, SolidObject]) -> tuple[str, str]:
    """Return the meshes and the bodies of objects where they stand, in MuJoCo's XML.

    An object's priority makes its friction that of its contacts, whatever it touches. Moments of
    inertia are those of an even prism with the widest of its outlines: a tray's mass is in its rim.
    """
    meshes, bodies = "", ""
    for name, each in objects.items():
        geoms = ""
        for i, (section, lower, upper) in enumerate(_slabs(each)):
            label = f"{PREFIX}{name} {i}"
            if section.outline is None:
                size = [section.rounding, 0.5 * (upper - lower)]
                centre = [0.0, 0.0, 0.5 * (lower + upper)]
                shape = f'type="cylinder" size="{_text(size)}" pos="{_text(centre)}"'
            elif (box := _box(section, lower, upper)) is not None:
                shape = box
            else:
                corners = [
                    np.column_stack([section.outline, np.full(len(section.outline), z)])
                    for z in (lower, upper)
                ]
                points = _text(np.concatenate(corners).ravel())
                meshes += f'<mesh name="{label}" vertex="{points}"/>'
                shape = f'type="mesh" mesh="{label}"'
            geoms += (
                f'<geom {shape} contype="{OBJECTS}" conaffinity="0" condim="3" '
                f'priority="1" friction="{_text(each.friction)} 0 0" {CONTACT_SOLVER}/>'
            )
        geoms += "".join(
            f'<geom size="{FOOT}" pos="{_text(foot)}" contype="0" '
            f'conaffinity="{GROUND | OBJECTS}" condim="3" priority="{1 if each.fixed else 2}" '
            f'friction="{_text(each.friction)} 0 0" {CONTACT_SOLVER}/>'
            for foot in _feet(each)
        )
        turn = [math.cos(0.5 * each.yaw), 0.0, 0.0, math.sin(0.5 * each.yaw)]
        moves = "" if each.fixed else f"<freejoint/>{_inertial(each)}"
        bodies += (
            f'<body name="{PREFIX}{name}" pos="{_text(each.at)}" '
            f'quat="{_text(turn)}">{moves}{geoms}</body>'
        )
    return meshes, bodies


def _slabs(each: SolidObject) -> list[tuple[Section, float, float]]:
    """Return the sections of object and rim, with their lowest and highest heights [m]."""
    slabs = [(each.section, each.lower, each.upper)]
    if each.rim is not None:
        slabs.append((each.rim.section, each.rim.height, each.rim.height + RIM))
    return slabs


def _feet(each: SolidObject) -> Array:
    """Return the centres (feet, 3) [m] of balls that end at floor and ceiling of object and rim."""
    feet = []
    for i, (section, lower, upper) in enumerate(_slabs(each)):
        corners = 1 if section.outline is None else len(section.outline)
        count = corners * math.ceil(FEET / corners)
        ring = _outline_points(section, count)[:-1] - section.centroid
        for size in RINGS[: 2 - i]:
            for height in (lower + FOOT, upper - FOOT):
                level = section.centroid + size * ring
                feet.append(np.column_stack([level, np.full(len(level), height)]))
    return np.concatenate(feet)


def _box(section: Section, lower: float, upper: float) -> str | None:
    """Return the shape of a rectangle's prism, whose contacts MuJoCo finds in closed form."""
    corners = section.core
    sides = np.diff(corners, axis=0)
    square = len(corners) == 4 and np.allclose(corners[0] + corners[2], corners[1] + corners[3])
    if not square or abs(sides[0] @ sides[1]) > RIGHT * np.prod(np.linalg.norm(sides[:2], axis=1)):
        return None
    size = 0.5 * np.array([*np.linalg.norm(sides[:2], axis=1), upper - lower])
    centre = [*section.centroid, 0.5 * (lower + upper)]
    turn = 0.5 * math.atan2(sides[0, 1], sides[0, 0])
    return (
        f'type="box" size="{_text(size)}" pos="{_text(centre)}" '
        f'quat="{_text([math.cos(turn), 0.0, 0.0, math.sin(turn)])}"'
    )


def _inertial(each: SolidObject) -> str:
    """Return a body's mass, its centre, and its moments of inertia."""
    widest = max((slab.section for slab in each.slabs), key=lambda section: section.area)
    xx, yy, xy = _second_moments(widest)
    high = (each.upper - each.lower) ** 2 / 12.0
    moments = each.mass * np.array([yy + high, xx + high, xx + yy, -xy, 0.0, 0.0])
    return (
        f'<inertial pos="{_text(each.centre_of_mass)}" mass="{_text(each.mass)}" '
        f'fullinertia="{_text(moments)}"/>'
    )


def _second_moments(section: Section) -> tuple[float, float, float]:
    """Return the means of x², y² and x y [m²] over a section, about its centroid."""
    if section.outline is None:
        return 0.25 * section.rounding**2, 0.25 * section.rounding**2, 0.0
    a = section.outline - section.centroid
    b = np.roll(a, -1, axis=0)
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])  # of the triangles about the centroid
    corners = np.einsum("ki,kj->kij", a, a) + np.einsum("ki,kj->kij", b, b)
    both = np.einsum("ki,kj->kij", a + b, a + b)
    means = np.einsum("k,kij->ij", area, corners + both) / (12.0 * np.sum(area))
    return float(means[0, 0]), float(means[1, 1]), float(means[0, 1])


def _outline_points(section: Section, count: int) -> NDArray[np.float64]:
    """Return points (count + 1, 2) [m] on an outline, the first one twice.

    Corners are among them where ``count`` is a multiple of their number.
    """
    share = np.linspace(0.0, 1.0, count + 1)
    if section.outline is None:
        angle = 2.0 * np.pi * share
        return section.rounding * np.column_stack([np.cos(angle), np.sin(angle)])
    corners = np.vstack([section.outline, section.outline[:1]])
    place, ranks = share * len(section.outline), np.arange(len(corners))
    return np.column_stack([np.interp(place, ranks, corners[:, i]) for i in (0, 1)])
