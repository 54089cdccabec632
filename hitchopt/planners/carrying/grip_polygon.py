"""The polygon at which a hitch grips an object, and whether it opens and lets go."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.holding.grip import GripTask, best_grip, largest_tension
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.rest import STRETCHES, HoldPolygons
from hitchopt.values import Array

SEARCHED = 0.9
"""Share of the largest level pull with which polygons are looked for: they do not depend on it."""


def grip_task(
    body: SolidObject, team: Team, tension: float, requirements: Requirements
) -> GripTask:
    """Return the search for a grip by a team.

    Raises
    ------
    InputError: cables or drones that differ.
    """
    for name, values in (("cable_length", team.cable_length), ("quadrotor", team.quadrotor)):
        if len(set(values)) > 1:
            bound = "alike for all robots where they grip an object"
            raise InputError(f"team.{name}", list(values), bound, "use one kind")
    return GripTask(
        body.section,
        team.robots,
        float(team.cable_length[0]),
        tension,
        team.cable_friction,
        requirements,
        team.quadrotor[0],
    )


def grip_polygons(
    name: str, body: SolidObject, team: Team, requirements: Requirements, gap: float
) -> HoldPolygons:
    """Return the polygons of the grip whose slip load is largest.

    Parameters
    ----------
    name, body: the object.
    gap: how far edges around it keep from it [m].

    Raises
    ------
    InfeasibleError: no grip was found.
    """
    most, _ = largest_tension(requirements, team.quadrotor[0])
    task = grip_task(body, team, SEARCHED * most, requirements)
    try:
        closed = best_grip(task).vertices
    except InfeasibleError as error:
        words = f"around objects.{name}"
        raise InfeasibleError([replace(v, when=words) for v in error.violations]) from None
    return HoldPolygons.about(closed, body.centre_of_mass[:2], (body.section,), gap, STRETCHES)


def check_pull(tension: float, team: Team, requirements: Requirements) -> None:
    """Raise InfeasibleError for level pulls that no drone can hold."""
    most, binding = largest_tension(requirements, team.quadrotor[0])
    if tension <= most:
        return
    own = requirements.limits
    remedy = f"grasp with a tension of {most:.3g} N or less"
    if binding == "tilt":
        needed = np.degrees(np.arctan(tension / (9.81 * team.mass[0])))
        remedy = (
            f"level pulls of {tension:.3g} N need limits.tilt_deg of {np.ceil(needed) + 5:.0f}, "
            f"above {np.degrees(own.tilt):.3g}; or {remedy}"
        )
    raise InfeasibleError(
        [Violation(binding, tension, most, "max", "N", (), "to grip at rest", remedy)]
    )


PASSES = 60
"""Times that an angle and the friction over it are computed from each other."""

OUTWARD = 0.02
"""[m] Clasps are opened that go outward by more: they are nowhere to a centimetre."""


def check_opens(hitch: Hitch, around: Array, requirements: Requirements, remedy: str) -> None:
    """Raise InfeasibleError where friction keeps legs from opening a hitch.

    A clasp opens where its legs, which enclose β, pull outward by more than its edges do inward:
    ``cos(β/2) > e^{μ θ} cos(β_edges/2)``, μ the cables' friction and θ the mean of both angles, by
    which cables turn. Legs enclose the least angle where their drones are side by side.

    Parameters
    ----------
    hitch: closed, as it is now.
    around: (n, 2) [m], where its vertices are to go, as seen from a common centre or not.
    requirements: the distance of drones.
    remedy: what to change.
    """
    friction, layout = hitch.team.cable_friction, hitch.team.layout
    if friction == 0.0 or np.any(hitch.roll):
        return
    here = hitch.polygon.vertices
    inward = [np.roll(here, shift, axis=0) - here for shift in (-1, 1)]
    ahead, behind = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in inward)
    outward = -(ahead + behind) / np.linalg.norm(ahead + behind, axis=1, keepdims=True)
    moved = (around - np.mean(around, axis=0)) - (here - np.mean(here, axis=0))
    opened = np.sum(outward * moved, axis=1) > OUTWARD
    edges = np.arccos(np.clip(np.sum(ahead * behind, axis=1), -1.0, 1.0))
    d, e = hitch.legs[layout.ahead, 0], hitch.legs[layout.behind, 1]
    apart = 2.0 * requirements.separation.radius
    legs = np.arccos(np.clip((d**2 + e**2 - apart**2) / (2.0 * d * e), -1.0, 1.0))
    turned, room = 0.5 * (edges + legs), np.log(np.cos(0.5 * legs) / np.cos(0.5 * edges))
    excess = np.where(opened, np.exp(friction * turned - room), 0.0)
    worst = int(np.argmax(excess))
    if excess[worst] <= 1.0:
        return
    where, words = (hitch.team.point_names[layout.clasps[worst]],), "as the hitch opens"
    smoother = room[worst] / turned[worst]
    if smoother > 0.0:
        smoother = math.floor(1000.0 * smoother) / 1000.0
        remedy = f"{remedy}, or use smoother cables, team.cable_friction {smoother:.3g} or less"
    raise InfeasibleError(
        [Violation("equilibrium", float(excess[worst]), 1.0, "max", "ratio", where, words, remedy)]
    )


def grip_left(legs: Array, tension: Array, clasp_friction: float, friction: float) -> float:
    """Return the largest slip load [N] of a hitch that has been opened as far as friction lets it.

    Where legs enclose β, cables slide on each other until edges enclose ``β_edges``, ``cos(β_edges
    /2) = e^{-μ θ} cos(β/2)``, θ the mean of both angles and μ the cables' friction. What these
    angles add up to beyond those of a polygon is wrapped around the object.

    Parameters
    ----------
    legs: (n, 2, 2) [m], the two legs at every clasp as seen from above.
    tension: (n,) [N], of legs.
    clasp_friction: coefficient of cables on each other.
    friction: coefficient of cables on the object.
    """
    directions = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    between = np.arccos(np.clip(np.sum(directions[:, 0] * directions[:, 1], axis=-1), -1.0, 1.0))
    edges = between
    for _ in range(PASSES):
        rubbed = np.exp(-clasp_friction * 0.5 * (edges + between))
        edges = 2.0 * np.arccos(rubbed * np.cos(0.5 * between))
    wrapped = max(float(np.sum(edges)) - (len(legs) - 2) * math.pi, 0.0)
    return friction * float(np.max(tension) / np.min(rubbed)) * wrapped
