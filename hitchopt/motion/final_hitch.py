"""The hitch that a motion ends in, recovered from its polynomials."""

from __future__ import annotations

import numpy as np

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

ITERATIONS = 30
"""Most corrections of legs and roll; without weight the first ones are exact."""

CLOSE, STEP, LEVEL = 1e-12, 1e-6, 1e-9
"""[m], [rad] Largest correction with which they end, difference of roll by which its effect is
found, and roll that is rounding."""

SAME = 1e-6
"""[m] Largest distance of a drone from the recovered hitch's, as for joints of a motion."""


def final_hitch(motion: Motion) -> Hitch:
    """Return the hitch whose vertices and drones are those of the motion's end.

    Raises
    ------
    InputError: there is no hitch at the end.
    UnsupportedError: none has its drones there: cables pull with other tensions than the team's.
    """
    if not (motion.team.has_cables and motion.formed[-1]):
        remedy = "form one, or go on with the drones at plan.at(plan.duration)"
        raise InputError("end", "free cables", "a hitch", remedy)
    team, layout = motion.team, motion.team.layout
    drones, vertices, legs = (
        part.coefficients[-1, ..., -1] for part in (motion.drones, motion.vertices, motion.legs)
    )
    outline, altitude = vertices[:, :2], float(np.mean(vertices[:, 2]))
    raised = 2 * layout.clasps  # q_k, whose leg is at clasp k

    def tied(q_legs: Array, roll: Array) -> Hitch:
        return Hitch(team, outline, altitude, q_legs, roll)

    q_legs = layout.q_legs_of(legs[:, 0], Hitch.balanced(team, outline, altitude).slack)
    hitch = tied(q_legs, np.zeros(len(layout.clasps)))
    for _ in range(ITERATIONS):
        longer = np.where(layout.has_leg[:, 0], legs[:, 0] - hitch.legs[:, 0], 0.0)
        there = hitch.drones[raised, 2]
        higher = tied(hitch.q_legs, hitch.roll + STEP).drones[raised, 2]
        turned = (drones[raised, 2] - there) * STEP / (higher - there)
        hitch = tied(hitch.q_legs + longer, hitch.roll + np.clip(turned, -0.5, 0.5))
        if max(np.max(np.abs(longer)), np.max(np.abs(turned))) < CLOSE:
            break
    hitch = tied(hitch.q_legs, np.where(np.abs(hitch.roll) < LEVEL, 0.0, hitch.roll))
    if np.max(np.abs(hitch.drones - drones)) > SAME:
        raise UnsupportedError("the plan's end is no hitch with the team's tensions to go on from")
    return hitch
