"""Moves of an object that is carried straight on, as fast as the hitch that holds it allows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchopt.checks import equilibrium
from hitchopt.checks.grip import RULE as GRIP
from hitchopt.errors import InfeasibleError
from hitchopt.planners.carrying.moves import Move, crossing_ratios, held_flight, separation_ratios
from hitchopt.planners.carrying.smooth_law import SmoothLaw
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.steps.carrying import STRETCHES, changed_move, held_motion
from hitchopt.steps.situation import StepTask
from hitchopt.values import Array

CARRY_ACCELERATION = 1.0
"""[m/s²] Largest acceleration of what is carried."""

LIFT_ACCELERATION = 0.3
"""[m/s²] The same where it is lifted or set down."""

SLOWER = 1.5
"""How much longer a move takes that is tried where a grip slips, cables do not balance, or edges do
not bear weight and inertia."""

NEAREST, APART = 1.001, 1.002
"""Distances over those asked: the least one in curves, whose polynomials are nearer by up
to 4e-4, and the least one at rest that inertia may lessen."""


def carried_move(task: StepTask, start: Array, to: Array, speed: float) -> Move:
    """Return the fastest move of a carried object within all limits.

    Parameters
    ----------
    start, to: (4,) x, y, z [m] and yaw [rad], in a straight line.
    speed: largest one of the object and of drones about it [m/s]

    Raises
    ------
    InfeasibleError: the weight cannot be carried.
    """
    holding, limits = task.holding, task.requirements.limits
    held = holding.held
    assert held is not None
    turned = abs(float(to[3] - start[3])) * held.reach
    length = float(np.linalg.norm((to - start)[:3])) + turned
    upright = bool(np.all(start[[0, 1, 3]] == to[[0, 1, 3]]))
    acceleration = min(
        LIFT_ACCELERATION if upright else CARRY_ACCELERATION,
        limits.acceleration,
        held.largest_acceleration,
    )
    if length == 0.0 or acceleration == 0.0:
        law = SmoothLaw(0.5)
    else:
        top = min(speed, limits.speed, limits.vertex_speed)
        law = SmoothLaw.fastest(top / length, acceleration / length, limits.jerk / length)
    lifted = replace(task, before=replace(task.before, holding=replace(holding, borne=True)))
    for left in reversed(range(STRETCHES)):
        move = replace(changed_move(lifted, law, to=to), start=start)
        try:
            factor = needed_stretch(held.team, limits, *held_flight(held, move).parts)
            if factor == math.inf:  # at rest all but a limit itself is reached
                factor = SLOWER
            elif factor <= 1.0:
                separation = task.requirements.separation
                apart = separation_ratios(held, move, separation)
                factor = max(_slower(apart), _slower(crossing_ratios(held, move, separation)))
                if factor <= 1.0 and _fails(lifted, move):
                    factor = SLOWER
        except InfeasibleError:
            if left == 0:
                raise
            factor = SLOWER
        if not 1.0 < factor < math.inf:
            break
        law = law.slowed(1.01 * factor)
    return move


def _fails(task: StepTask, move: Move) -> bool:
    """Return whether a move breaks the limit of a grip or of the cables' balance."""
    held = task.holding.held
    if held is None:
        return False
    motion = held_motion(task, [held_flight(held, move)], "carry")
    found = (rule.check(motion) for rule in (GRIP, equilibrium.QUICK))
    return any(check is not None and not check.holds for check in found)


def _slower(ratios: Array) -> float:
    """Return how much longer a move has to take for inertia not to bring anything too close.

    That lessens their distances in proportion to the acceleration, nearly.

    Parameters
    ----------
    ratios: (samples,) distances over those asked, at rest first.
    """
    rest, least = float(ratios[0]), float(np.min(ratios))
    if least >= NEAREST or rest < APART:
        return 1.0
    return math.sqrt((rest - least) / (rest - NEAREST))
