"""Open chains in motion."""

from __future__ import annotations

import math

import numpy as np
from certificate_cases import fitted, smooth_step
from numpy.typing import ArrayLike, NDArray

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.motion import Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


def bent(headings: ArrayLike, lengths: ArrayLike, origin: ArrayLike = (1.5, -0.7)) -> Array:
    """(n + 1, 2): edges of these headings [deg] and lengths [m], one after the other."""
    angle = np.radians(np.asarray(headings, dtype=np.float64))
    steps = np.asarray(lengths)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points: Array = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) + np.asarray(origin)
    return points


def chain_motion(
    team: Team,
    start: Array,
    end: Array,
    q_legs: ArrayLike,
    *,
    seconds: float = 3.0,
    pieces: int = 6,
    order: int = 7,
    separation: Separation | None = None,
    arena: Arena | None = None,
) -> Motion:
    """Return points that go straight from start to end, inner q-legs constant."""
    breaks = np.linspace(0.0, seconds, pieces + 1)

    def hitches(t: Array) -> list[Hitch]:
        found = []
        for s in smooth_step(t / seconds):
            points = start + s * (end - start)
            d = np.array(q_legs, dtype=np.float64)
            d[0] = 0.0
            d[-1] = team.cable_length[-1] - math.dist(points[-2], points[-1])
            found.append(Hitch(team, points, 1.3, d))
        return found

    def through(name: str) -> PiecewisePolynomial:
        return fitted(breaks, lambda t: np.array([getattr(h, name) for h in hitches(t)]), order)

    return Motion(
        team,
        Requirements(Limits(), separation or Separation(), arena),
        through("drones"),
        through("vertices"),
        through("legs"),
        PiecewisePolynomial.constant(breaks, team.tension),
        (Phase("morph", 0, 0.0, seconds),),
    )


def random_chain(n: int, seed: int) -> Motion:
    """Return a chain of unequal cables and tensions, off the origin, that bends and stretches."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.6, 1.0, n - 1)
    headings = rng.uniform(0.0, 360.0) - np.append(0.0, np.cumsum(turn)) * min(60.0, 200.0 / n)
    lengths = rng.uniform(1.1, 1.4, n)
    start = bent(headings, lengths, rng.uniform(-3.0, 3.0, 2))
    end = bent(
        0.9 * headings + rng.uniform(-20.0, 20.0),
        lengths * rng.uniform(0.92, 1.08, n),
        start[0] + rng.uniform(-0.4, 0.4, 2),
    )
    team = Team(
        n,
        1.1 * lengths + rng.uniform(0.7, 0.9, n),
        topology="open",
        tension=rng.uniform(0.4, 0.44, n),
        cable_density=0.004,
    )
    arena = Arena(np.append(start[0] - 30.0, 0.1), np.append(start[0] + 31.0, 2.9))
    return chain_motion(team, start, end, rng.uniform(0.3, 0.5, n), arena=arena)
