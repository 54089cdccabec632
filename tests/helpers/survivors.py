"""Hitches at rest that a loss leaves just within a bound, or just beyond it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import hitchopt as ho
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch.losses import Losses, places_after_loss
from hitchopt.hitch.requirements import Arena, Requirements
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.rests import rest_motion
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

RISE = 2.1  # Height of the rise of a lost robot's drones, over the semi-axis of ellipsoids
BOUNDS = "ceiling", "wall", "thrust", "tilt", "ground"


def held(
    *, robots: int = 3, length: float = 2.4, altitude: float = 1.6, max_thrust: float = 2.6
) -> Motion:
    """Return a hitch of heavy cables that survives losses, at rest."""
    quadrotor = ho.Quadrotor(stiffness=4.75, max_thrust=max_thrust)
    team = ho.Team(
        *(robots, length), tension=0.3, cable_density=0.005, release=True, quadrotor=quadrotor
    )
    roll = np.full(robots, 0.1)  # drones are at two heights
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(robots, 1.1), altitude, roll)
    need = Requirements(limits=ho.Limits(survive="cable")).flown_by(team)
    return rest_motion(hitch, need, 0.5, Phase("hold", 0, 0.0, 0.5))


def at_bound(bound: str, margin: float) -> Motion:
    """Return a hitch that a loss leaves within a bound by a margin, relative or in meters."""
    motion = held()
    need = motion.requirements
    places, drones = places_of(motion), motion.drones.at(0.0)
    level, upright = need.limits.tube.level, need.limits.tube.level * need.limits.tube.ratio
    upper = np.full(3, 20.0)
    if bound == "ceiling":
        heights = np.append(places[:, 2], drones[:, 2])
        rise = RISE * need.with_reserve.separation.height + np.ptp(heights)
        spare = margin if margin < 0.0 else 0.2  # proofs add how far low drones are raised
        upper[2] = np.max(drones[:, 2]) + rise + upright + spare
    elif bound == "wall":
        upper[0] = np.max(places[:, 0]) + level + margin
    team, limits = motion.team, need.limits
    weight, own = 0.005 * GRAVITY * 2.4, GRAVITY * 0.132
    if bound == "thrust":
        spare = (3.0 if margin > 0.0 else 0.8) * weight  # proofs add the pull of the raised cable
        return held(max_thrust=float(np.hypot(own + spare, 0.3)))
    if bound == "tilt":
        share = 1.0 + margin if margin > 0.0 else 0.93  # the pull of the raised cable is steeper
        limits = with_fields(limits, tilt=share * float(np.arctan2(0.3, own)))
    if bound == "ground":
        losses = Losses.of(team.layout)
        starts, others = drones[losses.drone], drones[losses.drone ^ 1]
        shares = np.linspace(0.0, 1.0, 2001)[:, None, None]
        offsets = (starts + shares * (places - starts) - others)[..., :2]
        nearest = np.min(np.linalg.norm(offsets, axis=-1))
        depth = 0.5 * np.sqrt(2.4**2 - nearest**2)
        lowest = min(np.min(drones[:, 2]), np.min(motion.vertices.at(0.0)[:, 2])) - depth
        height = need.with_reserve.ground_clearance
        return held(altitude=1.6 + height - lowest + margin)
    return motion.replaced(
        requirements=replace(need, limits=limits, arena=Arena([-20.0, -20.0, 0.0], upper))
    )


def places_of(motion: Motion) -> Array:
    """Return the places of the drones that move after losses (m, 3) [m]."""
    arrays = (motion.drones.at(0.0), motion.vertices.at(0.0), motion.tensions.at(0.0))
    return places_after_loss(motion.team, *arrays)[0]


def below_a_whole_cable() -> Motion:
    """Return a square whose drone q0 is 1.5 m below cable 2, which the loss of 0 leaves whole."""
    motion = held(robots=4, length=2.2, altitude=1.9)
    layout = motion.team.layout
    drones = motion.drones.coefficients.copy()
    ends = motion.vertices.at(0.0)[[layout.starts[2], layout.ends[2]]]
    drones[:, 0] = (np.mean(ends, axis=0) - [0.0, 0.0, 1.5])[:, None]
    return motion.replaced(drones=motion.drones.replaced(drones))
