"""The simulated world as a model in MuJoCo's XML.

A rope is a one-dimensional flex: its nodes are bodies that slide in x, y and z, its first and
last node are the drones themselves (the cable is attached at the centre of mass), and an equality
constraint keeps the lengths of its edges. It has no bending stiffness and no self-collision.
"""

from __future__ import annotations

from collections.abc import Mapping

from hitchopt.objects import SolidObject
from hitchopt.simulation.object_xml import (
    CONTACT_SOLVER,
    GROUND,
    OBJECTS,
    describe_objects,
    number_text,
)
from hitchopt.simulation.ropes import Ropes
from hitchopt.values import Array

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


def describe(
    ropes: Ropes,
    masses: Array,
    inertia: Array,
    rigid: bool,
    ground: float,
    gravity: float,
    objects: Mapping[str, SolidObject],
) -> str:
    """Return the model, its ropes straight.

    Parameters
    ----------
    ropes: n of them.
    masses, inertia: (2n,) [kg], (2n, 3) [kg m²], of the drones q0, r0, q1, r1, ….
    rigid: whether drones have an attitude.
    ground: height of the ground [m].
    gravity: downward acceleration [m/s²].
    objects: by name.
    """
    bodies, flexes, equalities = "", "", ""
    edge = min(EDGE_TIME, EDGE_STEPS * ropes.preset.time_step) if objects else EDGE_TIME
    radius = number_text(0.5 * ropes.preset.diameter)
    # Nodes meet objects, not edges: distances of capsules from convex bodies are found by an
    # iteration whose normals are too rough for light ropes at the corners of a rim.
    ball = f'<geom size="{radius}" contype="0" conaffinity="{OBJECTS}"/>' if objects else ""
    for k, (count, length) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        names = [f"q{k}", *(f"c{k}_{i}" for i in range(1, count)), f"r{k}"]
        for i, name in enumerate(names):
            drone = 2 * k + (i == count)
            mass, turning, moves, shape = ropes.density * length, TINY_INERTIA, SLIDES, ball
            if i in (0, count):
                mass, shape = masses[drone], DRONE_SHAPE
                if rigid:
                    turning, moves = number_text(inertia[drone]), "<freejoint/>"
            bodies += (
                f'<body name="{name}" pos="{number_text([i * length, k, ground + 1.0])}">'
                f'<inertial pos="0 0 0" mass="{number_text(mass)}" diaginertia="{turning}"/>'
                f"{moves}{shape}</body>"
            )
        elements = " ".join(f"{i} {i + 1}" for i in range(count))
        flexes += (
            f'<flex name="cable{k}" dim="1" radius="{radius}" '
            f'body="{" ".join(names)}" element="{elements}"><contact contype="{ROPES}" '
            f'conaffinity="{ROPES | GROUND}" condim="3" '
            f'friction="{number_text(ropes.friction)} 0 0" {CONTACT_SOLVER} '
            f'selfcollide="none" margin="0"/></flex>'
        )
        equalities += f'<flex flex="cable{k}" solref="{edge} 1" {EDGE_IMPEDANCE}/>'
    ground_friction = number_text(max(ropes.friction, LEAST_GROUND_FRICTION))
    meshes, things = describe_objects(objects)
    step, ratio = number_text(ropes.preset.time_step), FIRM if objects else 1
    return f"""<mujoco>
        <option timestep="{step}" gravity="0 0 {number_text(-gravity)}" integrator="Euler"
            solver="Newton" iterations="30" tolerance="1e-8" cone="elliptic" impratio="{ratio}"/>
        <size memory="{64 + 16 * len(ropes.lengths)}M"/>
        <asset>{meshes}</asset>
        <worldbody>
            <geom type="plane" size="0 0 1" pos="0 0 {number_text(ground)}" contype="{GROUND}"
                conaffinity="0" friction="{ground_friction} 0 0"/>
            {bodies}{things}
        </worldbody>
        <deformable>{flexes}</deformable>
        <equality>{equalities}</equality>
    </mujoco>"""


DRONE_SHAPE = (
    f'<geom type="ellipsoid" size="{number_text([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])}" '
    f'contype="0" conaffinity="{GROUND | OBJECTS}"/>'
)
"""Ellipsoid with which a drone meets the ground and objects."""
