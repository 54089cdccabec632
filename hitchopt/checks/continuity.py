"""Check ``continuity``: nothing jumps where one piece follows another."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hitchopt.checks.bounds.bodies import LAYOUTS, PART_NAMES
from hitchopt.checks.bounds.rounding_margins import derivative_margin, position_margin
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.vectors import length
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE

LIMIT = 1e-6
"""[m], [m/s], [m/s²] Largest jump: no drone tells a smaller one from none."""


def _find(motion: Motion, _: float) -> Finding:
    """Return the largest jump at a joint of position [m], velocity [m/s] or acceleration [m/s²].

    Drones and objects are looked at, and vertices and legs while the hitch exists; the unit is
    given as m, whichever of the three it is. A jump of a vector is measured by its norm. ``where``
    names the drone, the object, the vertex or the leg.
    """
    parts = [(motion.drones, motion.team.drone_names)]
    if motion.poses is not None:
        parts.append((motion.poses, tuple(motion.requirements.objects)))
    legs = _leg_names(motion.team.robots)
    for span in motion.spans(HITCHED_STATE):
        parts += [(span.vertices, span.team.point_names), (span.legs.reshaped(-1, 1), legs)]
    worst, time = 0.0, float(motion.drones.breaks[0])
    where: tuple[str, ...] = ()
    for part, names in parts:
        if part.pieces == 1:
            continue
        ends = [part.ends(derivative) for derivative in range(3)]
        jump = length(np.array([left[1:] - right[:-1] for left, right in ends]))
        jump[0] += position_margin(motion)
        for derivative in (1, 2):
            margin = derivative_margin(part, derivative)
            jump[derivative] += margin[1:] + margin[:-1]
        place = np.unravel_index(int(np.argmax(jump)), jump.shape)
        if jump[place] > worst:
            worst, time = float(jump[place]), float(part.breaks[place[1] + 1])
            where = (names[place[2]],)
    return Finding(worst, time, where)


@lru_cache(maxsize=LAYOUTS)
def _leg_names(cables: int) -> tuple[str, ...]:
    return tuple(f"{name} {k}" for k in range(cables) for name in PART_NAMES[0::2])


RULE = CheckRule("continuity", "m", "max", LIMIT, (Finder(_find),), whole=True)
