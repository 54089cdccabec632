"""What survivors fly: the plan's clock stops, and all of the team sinks to the ground together.

A team that sinks as a whole keeps all its distances. While it gathers speed, what falls is lighter
for it: at 2 m/s² a lost drone pulls at its cable with four fifths of its weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.bounds.clock_stops import StopTable
from hitchopt.errors import InfeasibleError
from hitchopt.motion.motion import JOINT, CableState, Motion, Phase
from hitchopt.motion.retiming import followed, resting
from hitchopt.planners.forming.straight import straight
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.requirements import Limits
from hitchopt.stopping.abort import until_stop
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splitting import merged_breaks, on_breaks
from hitchopt.values import Array

SHARE = 0.97
"""Share of the limits that sinking takes at most."""

SHARES = (SHARE, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.12)
"""Shares of the limits that sinking is tried with while the clock slows down."""

SAMPLE, LATER = 0.01, 0.05
"""[s] Distance of the samples of a stop, and of the times at which sinking is tried to begin."""

REST = 0.2
"""[s] Time at rest after everything."""

LEAST = 1e-3
"""[m] Drones that are so low are on the ground."""


@dataclass(frozen=True, eq=False)
class Stopping:
    """A plan whose clock stops, as soon as it can after a time.

    Attributes
    ----------
    motion: until rest.
    rest: plan time at rest [s].
    """

    motion: Motion
    rest: float


def stopped(motion: Motion, stops: StopTable, time: float, longer: float = 1.0) -> Stopping:
    """Return the plan that comes to rest as soon as the clock allows after a time [s].

    Parameters
    ----------
    longer: factor of the duration of its stop, as far as the plan reaches: a slow stop leaves
        more acceleration for sinking.
    """
    whole = motion.untimed
    if time >= motion.duration - JOINT:
        return Stopping(whole, motion.duration)
    start, duration = stops.after(time)
    duration = min(longer * duration, 2.0 * (motion.duration - start))
    return Stopping(*until_stop(whole, start, duration, REST))


def sunk(stopping: Stopping, begin: float, share: float) -> Motion:
    """Return a plan that stops and sinks from a time on until its lowest drone is on the ground.

    Parameters
    ----------
    begin: [s]
    share: of the limits of speed, acceleration and jerk that sinking takes.
    """
    motion, limits = stopping.motion, stopping.motion.requirements.limits
    heights = motion.drones.coefficients[-1, :, 2, -1]
    depth = float(np.min(heights)) - motion.requirements.floor
    if depth <= LEAST:
        return followed(motion, resting(motion, REST))
    clock = _descent(limits, depth, share)
    end = begin + clock.duration + REST
    if end > motion.duration + JOINT:
        motion = followed(motion, resting(motion, end - motion.duration))
    last = motion.duration
    times = [np.array([0.0, begin]) if begin > JOINT else np.array([0.0]), begin + clock.breaks]
    edges = np.concatenate([times[0][:1], times[0][1:], times[1][1:], [last]])
    c = clock.coefficients
    flat = np.ones(c.shape[-1])
    rows = [0.0 * flat[None]] * (begin > JOINT) + [c, depth * flat[None]]
    profile = PiecewisePolynomial(edges, np.concatenate(rows))
    breaks = merged_breaks([motion.drones.breaks, edges])
    lower = on_breaks(profile, breaks)
    finer = motion.changed(lambda part: on_breaks(part, breaks), motion.phases)

    def lowered(part: PiecewisePolynomial) -> PiecewisePolynomial:
        degree = max(part.degree, lower.degree)
        down = lower.elevated(degree).coefficients
        coefficients = part.elevated(degree).coefficients.copy()
        coefficients[:, :, 2] -= down[:, None]
        return PiecewisePolynomial(breaks, coefficients)

    return replace(finer, drones=lowered(finer.drones), vertices=lowered(finer.vertices))


def _descent(limits: Limits, depth: float, share: float) -> PiecewisePolynomial:
    """Return how far a team has sunk [m], to a depth [m], with a share of the limits."""
    kept = (share * limits.speed, share * limits.acceleration, share * limits.jerk)
    return fastest_clock(depth, *kept)


def deepest_first(
    stoppings: Sequence[Stopping], first: float, swung: float
) -> list[tuple[Stopping, float, float]]:
    """Return stops, times from which on to sink [s] and shares, the deepest sunk at a time first.

    Left out are those that break a limit at samples: what is left of the limits while a plan stops
    changes, and to begin later with more of them may sink the team sooner.

    Parameters
    ----------
    first: earliest time to sink [s].
    swung: time at which the depth counts [s].
    """
    found: list[tuple[float, Stopping, float, float]] = []
    for stopping in stoppings:
        motion, limits = stopping.motion, stopping.motion.requirements.limits
        depth = float(np.min(motion.drones.coefficients[-1, :, 2, -1])) - motion.requirements.floor
        if depth <= LEAST:
            continue
        bounds = limits.speed, limits.acceleration, limits.jerk
        t = np.append(np.arange(first, motion.duration, SAMPLE), motion.duration)
        flown = [motion.drones.at(t, order) for order in (1, 2, 3)]
        for share in SHARES:
            descent = _descent(limits, depth, share)
            for begin in np.append(np.arange(first, motion.duration, LATER), motion.duration):
                since = np.clip(t - begin, 0.0, descent.duration)
                moves = (t > begin) & (t < begin + descent.duration)
                kept = True
                for order, (values, bound) in enumerate(zip(flown, bounds, strict=True), 1):
                    down = np.where(moves, descent.at(since, order), 0.0)
                    sums = values - down[:, None, None] * [0.0, 0.0, 1.0]
                    kept &= bool(np.max(np.sum(sums**2, axis=-1)) <= bound**2)
                if kept:
                    at = np.clip([swung - begin], 0.0, descent.duration)
                    found.append((-float(descent.at(at)[0]), stopping, float(begin), share))
    return [each[1:] for each in sorted(found, key=lambda each: (each[0], each[2], -each[3]))]


def landed(motion: Motion) -> list[PiecewisePolynomial]:
    """Return the flights of all drones from where a motion ends to the ground.

    Those above another one go aside and down when the others are on the ground.

    Raises
    ------
    InfeasibleError: there are no places to land on.
    """
    team, requirements = motion.team, motion.requirements
    start = motion.drones.coefficients[-1, ..., -1]
    down = start.copy()
    down[:, 2] = requirements.floor
    if np.max(start[:, 2] - down[:, 2]) <= LEAST:
        return []
    level = _aside(start, 2.2 * requirements.separation.radius)
    moved = (np.linalg.norm(level - start[:, :2], axis=-1) > LEAST)[:, None]
    down[:, :2] = level
    first = np.where(moved, start, down)
    beside = np.where(moved, np.column_stack([level, start[:, 2]]), down)
    places = [start, first, beside, down] if np.any(moved) else [start, down]
    limits = requirements.limits.planned
    return [
        straight(team, limits, here, there)
        for here, there in pairwise(places)
        if np.max(np.abs(there - here)) > LEAST
    ]


def _aside(start: Array, apart: float) -> Array:
    """Return (D, 2) [m] places that are apart: the higher drones are moved outward, if need be.

    Raises
    ------
    InfeasibleError: some have none.
    """
    level = start[:, :2].copy()
    middle = np.mean(level, axis=0)
    order = np.argsort(start[:, 2], kind="stable")
    for rank, drone in enumerate(order.tolist()):
        below = level[order[:rank]]
        away = level[drone] - middle
        size = float(np.linalg.norm(away))
        out = away / size if size > LEAST else np.array([1.0, 0.0])
        for _ in range(20):
            if not len(below) or np.min(np.linalg.norm(below - level[drone], axis=1)) >= apart:
                break
            level[drone] += 0.25 * apart * out
        else:
            raise InfeasibleError([], "no place is free to land on")
    return level


def alone(motion: Motion, flights: list[PiecewisePolynomial]) -> list[Motion]:
    """Return the flights as motions of drones by themselves."""
    found = []
    for flight in flights:
        step, state = motion.phases[-1].step, CableState.GROUND
        phase = Phase("land", step, 0.0, flight.duration, state=state)
        found.append(Motion.single(motion.team, motion.requirements, flight, [phase]))
    return found
