"""Objects as rigid bodies in MuJoCo's XML: prisms and cylinders, rims as slabs, tables static."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.objects import Section, SolidObject
from hitchopt.simulation.object_wires import outline_points

Array = NDArray[np.float64]

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


def number_text(values: ArrayLike) -> str:
    """Return numbers as text, to the last bit."""
    return " ".join(f"{x:.17g}" for x in np.atleast_1d(np.asarray(values, dtype=np.float64)))


def describe_objects(objects: Mapping[str, SolidObject]) -> tuple[str, str]:
    """Return the meshes and the bodies of objects where they stand, in MuJoCo's XML.

    An object's priority makes its friction that of its contacts, whatever it touches. Moments of
    inertia are those of an even prism with the widest of its outlines: a tray's mass is in its rim.
    """
    meshes, bodies = "", ""
    for name, each in objects.items():
        shapes = [(each.section, each.lower, each.upper)]
        if each.rim is not None:
            shapes.append((each.rim.section, each.rim.height, each.rim.height + RIM))
        geoms = ""
        for i, (section, lower, upper) in enumerate(shapes):
            label = f"{PREFIX}{name} {i}"
            if section.outline is None:
                size = [section.rounding, 0.5 * (upper - lower)]
                centre = [0.0, 0.0, 0.5 * (lower + upper)]
                shape = f'type="cylinder" size="{number_text(size)}" pos="{number_text(centre)}"'
            elif (box := _box(section, lower, upper)) is not None:
                shape = box
            else:
                corners = [
                    np.column_stack([section.outline, np.full(len(section.outline), z)])
                    for z in (lower, upper)
                ]
                points = number_text(np.concatenate(corners).ravel())
                meshes += f'<mesh name="{label}" vertex="{points}"/>'
                shape = f'type="mesh" mesh="{label}"'
            geoms += (
                f'<geom {shape} contype="{OBJECTS}" conaffinity="0" condim="3" '
                f'priority="1" friction="{number_text(each.friction)} 0 0" {CONTACT_SOLVER}/>'
            )
        geoms += "".join(
            f'<geom size="{FOOT}" pos="{number_text(foot)}" contype="0" '
            f'conaffinity="{GROUND | OBJECTS}" condim="3" priority="{1 if each.fixed else 2}" '
            f'friction="{number_text(each.friction)} 0 0" {CONTACT_SOLVER}/>'
            for foot in _feet(each)
        )
        turn = [math.cos(0.5 * each.yaw), 0.0, 0.0, math.sin(0.5 * each.yaw)]
        moves = "" if each.fixed else f"<freejoint/>{_inertial(each)}"
        bodies += (
            f'<body name="{PREFIX}{name}" pos="{number_text(each.at)}" '
            f'quat="{number_text(turn)}">{moves}{geoms}</body>'
        )
    return meshes, bodies


def _feet(each: SolidObject) -> Array:
    """Return the centres (feet, 3) [m] of balls that end at floor and ceiling of object and rim."""
    slabs: list[tuple[Section, float, float, tuple[float, ...]]] = [
        (each.section, each.lower, each.upper, RINGS)
    ]
    if each.rim is not None:
        height = each.rim.height
        slabs.append((each.rim.section, height, height + RIM, RINGS[:1]))
    feet = []
    for section, lower, upper, rings in slabs:
        corners = 1 if section.outline is None else len(section.outline)
        count = corners * math.ceil(FEET / corners)
        ring = outline_points(section, count)[:-1] - section.centroid
        for size in rings:
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
        f'type="box" size="{number_text(size)}" pos="{number_text(centre)}" '
        f'quat="{number_text([math.cos(turn), 0.0, 0.0, math.sin(turn)])}"'
    )


def _inertial(each: SolidObject) -> str:
    """Return a body's mass, its centre, and its moments of inertia."""
    widest = max((slab.section for slab in each.slabs), key=lambda section: section.area)
    xx, yy, xy = _second_moments(widest)
    high = (each.upper - each.lower) ** 2 / 12.0
    moments = each.mass * np.array([yy + high, xx + high, xx + yy, -xy, 0.0, 0.0])
    return (
        f'<inertial pos="{number_text(each.centre_of_mass)}" mass="{number_text(each.mass)}" '
        f'fullinertia="{number_text(moments)}"/>'
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
