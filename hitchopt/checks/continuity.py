"""Check ``continuity``: nothing jumps where one piece follows another."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.bodies import PART_NAMES
from hitchopt.checks.bounds.rounding_margins import derivative_margin, position_margin
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.vectors import length
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.trajectory import PiecewisePolynomial

LIMIT = 1e-6
"""[m], [m/s], [m/s²] Largest jump: no drone tells a smaller one from none."""


def _find(motion: Motion, _: float) -> Finding:
    """Return the largest jump at a joint of position [m], velocity [m/s] or acceleration [m/s²].

    Drones are looked at, and vertices and legs while the hitch exists; the unit is given as m,
    whichever of the three it is. A jump of a vector is measured by its norm. ``where`` names the
    drone, the vertex or the leg.
    """
    parts = [(motion.drones, motion.team.drone_names)]
    for span in motion.spans(HITCHED_STATE):
        legs = span.legs
        each = legs.coefficients.reshape(legs.pieces, -1, 1, legs.degree + 1)
        cables = range(span.team.robots)
        parts += [
            (span.vertices, span.team.point_names),
            (
                PiecewisePolynomial(legs.breaks, each),
                tuple(f"{name} {k}" for k in cables for name in PART_NAMES[0::2]),
            ),
        ]
    worst, time = 0.0, float(motion.drones.breaks[0])
    where: tuple[str, ...] = ()
    for part, names in parts:
        if part.pieces == 1:
            continue
        for derivative in range(3):
            left, right = part.ends(derivative)
            jump = length(left[1:] - right[:-1])
            if derivative == 0:
                jump += position_margin(motion)
            else:
                margin = derivative_margin(part, derivative)
                jump += margin[1:] + margin[:-1]
            joint, item = np.unravel_index(int(np.argmax(jump)), jump.shape)
            if jump[joint, item] > worst:
                worst, time = float(jump[joint, item]), float(part.breaks[joint + 1])
                where = (names[item],)
    return Finding(worst, time, where)


RULE = CheckRule("continuity", "m", "max", LIMIT, (Finder(_find),), whole=True)
