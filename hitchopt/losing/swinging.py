"""How a lost drone swings down about its clasp while its cable runs, for pulls and frictions.

The clasp stays where it is; the lost drone's partner is a mass on the spring of its position loop,
drawn along its leg. What it pulls with, and what friction at the clasps takes of that, is not known
when a drone is lost: the swing is computed for some of both. It is no bound for all of time.
"""

from __future__ import annotations

import numpy as np

from hitchopt.hitch import GRAVITY, Team
from hitchopt.losing.falling import GAIN
from hitchopt.motion.states import States
from hitchopt.values import Array

DAMPING = 10.0
"""[1/s] Damping over mass of usual position loops."""

FRICTION, TURN = 0.2, np.pi
"""Largest coefficient at the clasps where the team's own is not larger, and the angle [rad] by
which a cable turns about both of them while one end of it hangs: its tensions differ by
exp(FRICTION TURN)."""

FRICTIONS = 3
"""Number of frictions, from none to the largest."""

LEAST_LEG = 0.05
"""[m] Length of a partner's leg that remains when it gives way."""

STEP, EVERY = 2e-3, 5
"""[s] Time of a step, and number of steps from one place to the next."""

LASTS = 1.2
"""[s] Time that is looked at; swings have turned back by then."""


def swings(team: Team, states: States, lost: int, longest: float, floor: float) -> Array:
    """Return places (samples, 3) [m] of a lost drone that swings until it turns back, or falls.

    Parameters
    ----------
    states: of one time, of a hitch.
    lost: the drone.
    longest: distance from its clasp to which it falls freely besides [m].
    floor: height of the ground [m].
    """
    legs = states.positions - states.vertices[team.layout.pulled_to]
    leg, size = legs[lost], float(np.linalg.norm(legs[lost]))
    level = np.array([leg[0], leg[1], 0.0])
    out = level / max(float(np.linalg.norm(level)), 1e-9)
    partner = lost ^ 1
    first = float(np.arctan2(-leg[2], np.linalg.norm(level)))
    reach, angle = swung(
        (size, first),
        max(float(np.linalg.norm(legs[partner])) - LEAST_LEG, 0.0),
        (float(team.mass[lost]), float(team.mass[partner])),
        float(states.tensions[lost // 2]),
        max(team.cable_friction, FRICTION),
    )
    down = np.array([0.0, 0.0, -1.0])
    arcs = reach[..., None] * (np.cos(angle)[..., None] * out + np.sin(angle)[..., None] * down)
    depth = np.sqrt(max(longest**2 - size**2, 0.0))
    fallen = leg + np.linspace(0.0, depth, len(reach))[:, None] * down
    clasp = states.positions[lost] - leg
    places: Array = clasp + np.concatenate([arcs.reshape(-1, 3), fallen])
    places[:, 2] = np.maximum(places[:, 2], floor)
    return places


def swung(
    leg: tuple[float, float],
    gives: float,
    masses: tuple[float, float],
    tension: float,
    friction: float,
) -> tuple[Array, Array]:
    """Return distances from the clasp [m] and angles below the level [rad], (times, cases).

    A case that has turned back stays where it did. Cases have the partner's tension or none, and
    frictions from none to the largest.

    Parameters
    ----------
    leg: of the lost drone, its length [m] and angle below the level [rad].
    gives: by how much the partner can be drawn to its clasp [m].
    masses: of the lost drone and of its partner [kg].
    tension: of the cable [N].
    friction: coefficient at the clasps.
    """
    mass, other = masses
    ratio, pull = (
        each.ravel()
        for each in np.meshgrid(
            np.exp(friction * TURN * np.linspace(0.0, 1.0, FRICTIONS)), [0.0, tension]
        )
    )
    run, speed = np.zeros(len(pull)), np.zeros(len(pull))
    angle, turning = np.full(len(pull), leg[1]), np.zeros(len(pull))
    back = np.zeros(len(pull), bool)
    reaches, angles = [leg[0] + run], [angle]
    for step in range(1, round(LASTS / STEP) + 1):
        reach = leg[0] + run
        outward = mass * (reach * turning**2 + GRAVITY * np.sin(angle))
        held = pull + other * (GAIN * run + DAMPING * speed)
        runs = (outward - ratio * held) / (mass + ratio * other)
        returns = (outward - held / ratio) / (mass + other / ratio)
        starts = np.where(runs > 0.0, runs, np.minimum(returns, 0.0))
        rate = np.where(speed > 0.0, runs, np.where(speed < 0.0, returns, starts))
        faster = speed + STEP * rate
        faster = np.where(faster * speed < 0.0, 0.0, faster)  # friction holds before it runs back
        ended = (run >= gives) & (faster > 0.0) | (run <= 0.0) & (faster < 0.0)
        speed = np.where(ended | back, 0.0, faster)
        swing = (GRAVITY * np.cos(angle) - 2.0 * speed * turning) / reach
        turning = np.where(back, 0.0, turning + STEP * swing)
        back |= turning < 0.0
        run = np.clip(run + STEP * np.where(back, 0.0, speed), 0.0, gives)
        angle = angle + STEP * np.where(back, 0.0, turning)
        if step % EVERY == 0:
            reaches.append(leg[0] + run)
            angles.append(angle)
            if np.all(back):
                break
    return np.array(reaches), np.array(angles)
