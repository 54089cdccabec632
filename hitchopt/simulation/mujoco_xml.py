"""The world in MuJoCo's own words.

A rope is a one-dimensional flex: its nodes are bodies that slide in x, y and z, its first and
last node are the drones themselves (the cable is attached at the centre of mass), and an equality
constraint keeps its edges' lengths. It has no bending stiffness and does not collide with itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.ropes import Ropes

Array = NDArray[np.float64]

EDGE_SOLREF, EDGE_SOLIMP = "0.002 1", "0.999 0.9999 0.0005"
CONTACT_SOLREF, CONTACT_SOLIMP = "0.002 1", "0.99 0.999 0.001"
"""MuJoCo's own are softer, and let ropes pass through each other."""

ROPES, GROUND = 1, 2
"""Collision groups: ropes meet ropes and the ground, drones only the ground."""

TINY_INERTIA = "1e-9 1e-9 1e-9"
"""[kg m²] Of bodies that only slide: MuJoCo asks for one, nothing turns."""


@dataclass(frozen=True)
class Body:
    """What a drone fills: an ellipsoid about its centre.

    Parameters
    ----------
    radius: across [m]
    half_height: [m]
    """

    radius: float = 0.07
    half_height: float = 0.03


BODY = Body()


def describe(
    ropes: Ropes,
    masses: Array,
    inertia: Array,
    rigid: bool,
    ground: float,
    gravity: float,
    body: Body,
) -> str:
    """Return the model in MuJoCo's XML, ropes laid out straight.

    Parameters
    ----------
    ropes: n of them.
    masses, inertia: (2n,) [kg], (2n, 3) [kg m²], of the drones q0, r0, q1, r1, ….
    rigid: whether drones have an attitude.
    ground: its height [m].
    gravity: downward [m/s²].
    body: what a drone fills.
    """
    root = ElementTree.Element("mujoco")
    _add(
        root,
        "option",
        timestep=ropes.preset.time_step,
        gravity=[0.0, 0.0, -gravity],
        integrator="Euler",
        solver="Newton",
        iterations=30,
        tolerance=1e-8,
        cone="elliptic",
    )
    _add(root, "size", memory=f"{64 + 16 * len(ropes.lengths)}M")
    tree = _add(root, "worldbody")
    _add(
        tree,
        "geom",
        type="plane",
        size=[0, 0, 1],
        pos=[0, 0, ground],
        contype=GROUND,
        conaffinity=0,
        friction=[max(ropes.friction, 0.3), 0, 0],
    )
    flexes = _add(root, "deformable")
    equalities = _add(root, "equality")
    for k, (count, length) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        names = [f"q{k}", *(f"c{k}_{i}" for i in range(1, count)), f"r{k}"]
        for i, name in enumerate(names):
            spot = [i * length, float(k), ground + 1.0]
            if i in (0, count):
                drone = 2 * k + (i == count)
                _drone(tree, name, spot, masses[drone], inertia[drone], rigid, body)
            else:
                _node(tree, name, spot, ropes.density * length)
        flex = _add(
            flexes,
            "flex",
            name=f"cable{k}",
            dim=1,
            radius=0.5 * ropes.preset.diameter,
            body=" ".join(names),
            element=" ".join(f"{i} {i + 1}" for i in range(count)),
        )
        _add(
            flex,
            "contact",
            contype=ROPES,
            conaffinity=ROPES | GROUND,
            condim=3,
            friction=[ropes.friction, 0, 0],
            solref=CONTACT_SOLREF,
            solimp=CONTACT_SOLIMP,
            selfcollide="none",
            margin=0,
        )
        _add(equalities, "flex", flex=f"cable{k}", solref=EDGE_SOLREF, solimp=EDGE_SOLIMP)
    return ElementTree.tostring(root, encoding="unicode")


def _node(parent: Any, name: str, spot: list[float], mass: float) -> Any:
    node = _add(parent, "body", name=name, pos=spot)
    _add(node, "inertial", pos=[0, 0, 0], mass=mass, diaginertia=TINY_INERTIA)
    for axis in np.eye(3):
        _add(node, "joint", type="slide", axis=axis)
    return node


def _drone(
    parent: Any, name: str, spot: list[float], mass: float, inertia: Array, rigid: bool, body: Body
) -> None:
    if rigid:
        drone = _add(parent, "body", name=name, pos=spot)
        _add(drone, "inertial", pos=[0, 0, 0], mass=mass, diaginertia=inertia)
        _add(drone, "freejoint")
    else:
        drone = _node(parent, name, spot, mass)
    _add(
        drone,
        "geom",
        type="ellipsoid",
        size=[body.radius, body.radius, body.half_height],
        contype=0,
        conaffinity=GROUND,
    )


def _add(parent: Any, tag: str, **attributes: object) -> Any:
    texts = {name: _text(value) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def _text(value: object) -> str:
    if isinstance(value, str):
        return value
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(np.asarray(value, dtype=np.float64)))
