"""Drones on free cables in motion, and what samples say of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


def free_motion(
    team: Team,
    drones: PiecewisePolynomial,
    *states: CableState,
    **given: Any,
) -> Motion:
    """Phases in those states, one per piece (the last one for all that follow); else free."""
    last = states[-1] if states else CableState.FREE
    all_states = [*states, *[last] * (drones.pieces - len(states))]
    phases = tuple(
        Phase("approach", 0, float(a), float(b), state=state)
        for a, b, state in zip(drones.breaks[:-1], drones.breaks[1:], all_states, strict=True)
    )
    constant = PiecewisePolynomial.constant
    n = team.robots
    return Motion(
        team,
        Requirements(**given),
        drones,
        constant(drones.breaks, np.zeros((team.layout.points, 3))),
        constant(drones.breaks, np.zeros((n, 2))),
        constant(drones.breaks, np.zeros(n)),
        phases,
    )


def single(curves: PiecewisePolynomial, **given: Any) -> Motion:
    """Drones without cables on curves (N, 3)."""
    begin, end = curves.breaks[[0, -1]].tolist()
    phases = (Phase("fly", 0, begin, end),)
    return Motion.single(Swarm(curves.shape[0]), Requirements(**given), curves, phases)


def random_curves(
    n: int, seed: int, spread: float = 0.5, centre: ArrayLike = (5, -3, 4)
) -> PiecewisePolynomial:
    """Curves (n, 3) that jump at two joints, and meet now and then."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-2.0, 2.0, (n, 3)) + np.asarray(centre)
    c = middle[None, :, :, None] + rng.normal(scale=spread, size=(3, n, 3, 6))
    return PiecewisePolynomial(np.array([0.0, 0.5, 1.7, 2.4]), c)


def through(times: Array, places: Array) -> PiecewisePolynomial:
    """From rest to rest between places (J, 2n, 3) at times (J,)."""
    still = np.zeros_like(places[:-1])
    return PiecewisePolynomial.hermite(
        times, np.stack([places[:-1], still, still]), np.stack([places[1:], still, still])
    )


def random_flight(seed: int, n: int = 4, pieces: int = 3) -> tuple[Team, PiecewisePolynomial]:
    """Robots that wander, no cable ever taut; off the origin, cables unequal."""
    rng = np.random.default_rng(seed)
    topology = "closed" if n > 2 else "open"
    team = Team(n, 1.6 + 0.1 * np.arange(n), cable_density=0.01, topology=topology)
    middles = rng.uniform(-1.0, 1.0, (pieces + 1, n, 3)) * [1.2, 1.2, 0.3] + [3.0, -2.0, 2.5]
    arms = rng.uniform(-0.45, 0.45, (pieces + 1, n, 3)) * [1.0, 1.0, 0.4]
    places = np.stack([middles - arms, middles + arms], axis=2).reshape(pieces + 1, -1, 3)
    return team, through(np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, pieces))]), places)
