"""A motion made by hand: off the origin, unequal cables, odd weights, one piece that moves."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Quadrotor, Swarm, Team
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.motion import Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

OUTLINE = [[1.2, 0.7], [0.9, 1.9], [2.0, 2.3], [2.6, 1.1]]
BREAKS = [0.0, 0.7, 1.9, 2.53]
ORDER = 9


def smooth(x: Array) -> Array:
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


@lru_cache
def made_motion() -> Motion:
    team = Team(
        4,
        [2.4, 2.6, 2.9, 2.7],
        cable_density=0.004,
        cable_friction=0.1,
        tension=[0.4, 0.55, 0.47, 0.5],
        quadrotor=[Quadrotor(0.13 + 0.01 * k, 2.5 + 0.1 * k) for k in range(4)],
    )
    shift = np.array([[0.1, -0.2], [0.0, 0.05], [0.3, 0.1], [-0.05, 0.15]])
    # Times of all interpolation points, piece by piece; nothing moves in the last piece.
    x = np.clip(
        np.add.outer(BREAKS[:-1], np.zeros(ORDER + 1))
        + np.multiply.outer(np.diff(BREAKS), bernstein.nodes(ORDER)),
        0.0,
        BREAKS[2],
    )
    hitches = [
        Hitch.balanced(team, ConvexPolygon(np.array(OUTLINE) + s * shift), 1.1 + 0.3 * s)
        for s in smooth(x / BREAKS[2]).ravel()
    ]

    def through(values: list[Array]) -> PiecewisePolynomial:
        table = np.array(values).reshape(*x.shape, *values[0].shape)
        return PiecewisePolynomial(
            np.array(BREAKS), bernstein.interpolate(np.moveaxis(table, 1, -1))
        )

    return Motion(
        team,
        Requirements(
            Limits(speed=0.9, tilt=0.7, duration=7.3),
            Separation(radius=0.11, crossing=0.04),
            Arena([-4.0, -3.0, 0.1], [5.0, 6.0, 3.5]),
        ),
        through([h.drones for h in hitches]),
        through([h.vertices for h in hitches]),
        through([h.legs for h in hitches]),
        PiecewisePolynomial.constant(BREAKS, team.tension, 2),
        (Phase("morph", 0, 0.0, 1.9), Phase("hold", 1, 1.9, 2.53)),
    )


def made_swarm() -> Motion:
    """Return the drones of made_motion without their cables."""
    motion = made_motion()
    swarm = Swarm(8, quadrotor=[Quadrotor(0.13 + 0.01 * i, 2.5 + 0.1 * i) for i in range(8)])
    return Motion.single(
        swarm,
        Requirements(
            motion.requirements.limits, motion.requirements.separation, motion.requirements.arena
        ),
        motion.drones,
        motion.phases,
    )


def made_certificate() -> Certificate:
    return Certificate(
        2.53,
        (
            Check.of("separation", 1.3, 1.0, "min", "ratio", 1.2, ("q0", "r3")),
            Check("crossing", True, float("inf"), 0.04, "min", "m", 0.0, ()),
            Check.of("speed", 0.5, 0.9, "max", "m/s", 0.9, ("q1",)),
        ),
    )
