"""Motions for pictures: a stretch and a shift of a hitch away from the origin, then a rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import hitchopt as ho
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Phase
from hitchopt.trajectory import PiecewisePolynomial, bernstein

ORDER = 9
MOVING, RESTING = 2.2, 0.9  # [s]
CORNERS = [[-0.3, -0.1], [0.2, -0.2], [0.3, 0.15], [-0.1, 0.25]]


def make_motion(n: int, shift: float = 0.3, thrusts: tuple[float, ...] = (2.6,)) -> ho.Motion:
    start = ho.regular_polygon(n, 1.3, 0.4).vertices + np.array([2.0, -1.0])
    kinds = [ho.Quadrotor(0.13 + 0.01 * (k % 2), thrusts[k % len(thrusts)]) for k in range(n)]
    team = ho.Team(n, [2.2 + 0.1 * (k % 3) for k in range(n)], quadrotor=kinds)
    nodes = bernstein.nodes(ORDER)
    share = nodes**3 * (10.0 - 15.0 * nodes + 6.0 * nodes**2)
    hitches = [
        ho.Hitch.balanced(
            team, ho.ConvexPolygon((start + s * shift) * [1.0, 1.0 - 0.2 * s * shift]), 1.0 + s
        )
        for s in share
    ]
    breaks = np.array([0.0, MOVING, MOVING + RESTING])

    def through(name: str) -> PiecewisePolynomial:
        moving = bernstein.interpolate(
            np.stack([getattr(hitch, name) for hitch in hitches], axis=-1)
        )
        resting = np.broadcast_to(moving[..., -1:], moving.shape)
        return PiecewisePolynomial(breaks, np.stack([moving, resting]))

    return ho.Motion(
        team,
        Requirements(ho.Limits(speed=0.8), ho.Separation(radius=0.11, height=0.25), None),
        through("drones"),
        through("vertices"),
        through("legs"),
        PiecewisePolynomial.constant(breaks, team.tension, 1),
        (Phase("morph", 0, 0.0, MOVING), Phase("hold", 1, MOVING, MOVING + RESTING)),
    )


def made_certificate() -> ho.Certificate:
    return ho.Certificate(
        MOVING + RESTING,
        (
            ho.Check.of("separation", 2.345, 1.0, "min", "ratio", 0.4, ("q0", "r1")),
            ho.Check.of("speed", 0.6789, 0.8, "max", "m/s", 1.1, ("q0",)),
            ho.Check.of("thrust", 1.456, 2.6, "max", "N", 1.7, ("r1",)),
        ),
    )


def with_box(yaw: float = 0.7) -> ho.Motion:
    """Return a motion beside which a box stands."""
    box = ho.SolidObject(ho.Section(CORNERS), 0.0, 0.3, at=(1.5, 2.0, 0.4), yaw=yaw)
    motion = make_motion(3)
    return motion.replaced(requirements=replace(motion.requirements, objects={"box": box}))
