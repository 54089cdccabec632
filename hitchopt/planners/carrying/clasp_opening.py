"""Whether legs can open clasps whose cables rub on each other."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Hitch
from hitchopt.requirements import Requirements
from hitchopt.values import Array

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
