"""The simulated world as a model in MuJoCo's XML.

A rope is a one-dimensional flex: its nodes are bodies that slide in x, y and z, its first and
last node are the drones themselves (the cable is attached at the centre of mass), and an equality
constraint keeps the lengths of its edges. It has no bending stiffness and no self-collision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.simulation.ropes import Ropes

Array = NDArray[np.float64]

BODY_RADIUS, BODY_HALF_HEIGHT = 0.07, 0.03
"""Half-axes of the ellipsoid that a drone occupies [m]."""

EDGE_SOLVER = 'solref="0.002 1" solimp="0.999 0.9999 0.0005"'
CONTACT_SOLVER = 'solref="0.002 1" solimp="0.99 0.999 0.001"'
"""Stiffness of constraints; MuJoCo's defaults are softer and let ropes pass through each other."""

ROPES, GROUND = 1, 2
"""Collision groups: ropes meet ropes and the ground, drones only the ground."""

LEAST_GROUND_FRICTION = 0.3
"""Friction coefficient of the ground where the cables' is less."""

TINY_INERTIA = "1e-9 1e-9 1e-9"
"""Inertia of bodies that only slide [kg m²]: MuJoCo requires one, nothing turns."""

SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
"""Joints of a body that slides in x, y and z."""


def describe(
    ropes: Ropes, masses: Array, inertia: Array, rigid: bool, ground: float, gravity: float
) -> str:
    """Return the model, its ropes straight.

    Parameters
    ----------
    ropes: n of them.
    masses, inertia: (2n,) [kg], (2n, 3) [kg m²], of the drones q0, r0, q1, r1, ….
    rigid: whether drones have an attitude.
    ground: height of the ground [m].
    gravity: downward acceleration [m/s²].
    """
    bodies, flexes, equalities = "", "", ""
    for k, (count, length) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        names = [f"q{k}", *(f"c{k}_{i}" for i in range(1, count)), f"r{k}"]
        for i, name in enumerate(names):
            drone = 2 * k + (i == count)
            mass, turning, moves, shape = ropes.density * length, TINY_INERTIA, SLIDES, ""
            if i in (0, count):
                mass, shape = masses[drone], DRONE_SHAPE
                if rigid:
                    turning, moves = _text(inertia[drone]), "<freejoint/>"
            bodies += (
                f'<body name="{name}" pos="{_text([i * length, k, ground + 1.0])}">'
                f'<inertial pos="0 0 0" mass="{_text(mass)}" diaginertia="{turning}"/>'
                f"{moves}{shape}</body>"
            )
        elements = " ".join(f"{i} {i + 1}" for i in range(count))
        flexes += (
            f'<flex name="cable{k}" dim="1" radius="{_text(0.5 * ropes.preset.diameter)}" '
            f'body="{" ".join(names)}" element="{elements}"><contact contype="{ROPES}" '
            f'conaffinity="{ROPES | GROUND}" condim="3" friction="{_text(ropes.friction)} 0 0" '
            f'{CONTACT_SOLVER} selfcollide="none" margin="0"/></flex>'
        )
        equalities += f'<flex flex="cable{k}" {EDGE_SOLVER}/>'
    ground_friction = _text(max(ropes.friction, LEAST_GROUND_FRICTION))
    return f"""<mujoco>
        <option timestep="{_text(ropes.preset.time_step)}" gravity="0 0 {_text(-gravity)}"
            integrator="Euler" solver="Newton" iterations="30" tolerance="1e-8" cone="elliptic"/>
        <size memory="{64 + 16 * len(ropes.lengths)}M"/>
        <worldbody>
            <geom type="plane" size="0 0 1" pos="0 0 {_text(ground)}" contype="{GROUND}"
                conaffinity="0" friction="{ground_friction} 0 0"/>
            {bodies}
        </worldbody>
        <deformable>{flexes}</deformable>
        <equality>{equalities}</equality>
    </mujoco>"""


def _text(values: ArrayLike) -> str:
    """Return numbers as text, to the last bit."""
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(np.asarray(values, dtype=np.float64)))


DRONE_SHAPE = (
    f'<geom type="ellipsoid" size="{_text([BODY_RADIUS, BODY_RADIUS, BODY_HALF_HEIGHT])}" '
    f'contype="0" conaffinity="{GROUND}"/>'
)
"""Ellipsoid with which a drone meets the ground."""
