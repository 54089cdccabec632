"""What survivors fly: the plan's clock stops, and all of the team sinks to the ground together.

A team that sinks as a whole keeps all its distances. While it gathers speed, what falls is lighter
for it: at 2 m/s² a lost drone pulls at its cable with four fifths of its weight. Where a plan
brakes at its limit nothing is left to sink with straight down, but there is along a slope: a team
that is carried on while it sinks brakes less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from hitchopt.checks.stops import StopTable
from hitchopt.errors import InfeasibleError
from hitchopt.geometry.vectors import dot
from hitchopt.motion.motion import JOINT, CableState, Motion, Phase
from hitchopt.motion.retiming import followed, resting
from hitchopt.planners.forming.straight import straight
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.stopping.stopped_motion import until_stop
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.splitting import merged_breaks, on_breaks
from hitchopt.values import Array

SHARE = 0.97
"""Share of the limits that sinking takes at most."""

SHARES = (SHARE, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.12)
"""Shares of the limits that sinking is tried with while the clock slows down."""

SLOPES, CARRIED = (0.0, 0.3, 0.6), 0.25
"""Level acceleration over that of sinking with which a team that brakes is carried on, and how far
that takes it [m]."""

WORTH = 0.05
"""[m] Depth that being carried on has to gain: it leaves the plan's path."""

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


@dataclass(frozen=True)
class Sinking:
    """How a team sinks while a plan stops.

    Attributes
    ----------
    stopping: the plan.
    begin: from when on [s].
    share: of the limits of speed, acceleration and jerk that sinking takes.
    onward: level x and y of the acceleration by which the team is carried on, over its own.
    """

    stopping: Stopping
    begin: float
    share: float
    onward: tuple[float, float] = (0.0, 0.0)

    @property
    def depth(self) -> float:
        """How far the lowest drone is above the ground [m]."""
        motion = self.stopping.motion
        heights = motion.drones.coefficients[-1, :, 2, -1]
        return float(np.min(heights)) - motion.requirements.floor

    @cached_property
    def shift(self) -> PiecewisePolynomial:
        """Offset of all of the team from its plan, (3,) [m], from ``begin`` on."""
        limits, slope = self.stopping.motion.requirements.limits, math.hypot(*self.onward)
        share = self.share / math.hypot(slope, 1.0)
        bounds = limits.speed, limits.acceleration, limits.jerk
        down = fastest_clock(self.depth, *(share * bound for bound in bounds))
        if slope == 0.0:
            return _along(down, np.array([0.0, 0.0, -1.0]))
        level = fastest_clock(CARRIED, *(share * slope * bound for bound in bounds))
        level, down = _as_long(level, down), _as_long(down, level)
        breaks = merged_breaks([level.breaks, down.breaks])
        level, down = (
            _along(on_breaks(part, breaks), direction)
            for part, direction in (
                (level, np.array([*self.onward, 0.0]) / slope),
                (down, np.array([0.0, 0.0, -1.0])),
            )
        )
        return PiecewisePolynomial(breaks, level.coefficients + down.coefficients)


def _along(distance: PiecewisePolynomial, direction: Array) -> PiecewisePolynomial:
    """Return the points (3,) at a distance in a direction."""
    return PiecewisePolynomial(distance.breaks, direction[:, None] * distance.coefficients[:, None])


def _as_long(distance: PiecewisePolynomial, other: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return a distance that rests at its end until another one has ended."""
    if distance.duration >= other.duration - JOINT:
        return distance
    rest = PiecewisePolynomial.constant(
        [0.0, other.duration - distance.duration], distance.coefficients[-1, ..., -1]
    )
    return joined([distance, rest])


def sunk(sinking: Sinking) -> Motion:
    """Return a plan that stops and sinks until its lowest drone is on the ground."""
    motion, begin = sinking.stopping.motion, sinking.begin
    if sinking.depth <= LEAST:
        return followed(motion, resting(motion, REST))
    shift = sinking.shift
    end = begin + shift.duration + REST
    if end > motion.duration + JOINT:
        motion = followed(motion, resting(motion, end - motion.duration))
    parts = [PiecewisePolynomial.constant([0.0, begin], np.zeros(3))] if begin > JOINT else []
    rest = [0.0, motion.duration - begin - shift.duration]
    parts += [shift, PiecewisePolynomial.constant(rest, shift.coefficients[-1, ..., -1])]
    whole = joined(parts)
    whole = PiecewisePolynomial(np.append(whole.breaks[:-1], motion.duration), whole.coefficients)
    breaks = merged_breaks([motion.drones.breaks, whole.breaks])
    moved = on_breaks(whole, breaks)
    finer = motion.changed(lambda part: on_breaks(part, breaks), motion.phases)

    def shifted(part: PiecewisePolynomial) -> PiecewisePolynomial:
        degree = max(part.degree, moved.degree)
        by = moved.elevated(degree).coefficients[:, None]
        return PiecewisePolynomial(breaks, part.elevated(degree).coefficients + by)

    return replace(finer, drones=shifted(finer.drones), vertices=shifted(finer.vertices))


def deepest_first(stoppings: Sequence[Stopping], first: float, swung: float) -> list[Sinking]:
    """Return how a team may sink, the deepest sunk at a time first.

    Left out is what breaks a limit at samples: what is left of the limits while a plan stops
    changes, and to begin later with more of them may sink the team sooner.

    Parameters
    ----------
    first: earliest time to sink [s].
    swung: time at which the depth counts [s].
    """
    found: list[tuple[float, Sinking]] = []
    for stopping in stoppings:
        motion, limits = stopping.motion, stopping.motion.requirements.limits
        if Sinking(stopping, first, SHARE).depth <= LEAST:
            continue
        bounds = limits.speed, limits.acceleration, limits.jerk
        t = np.append(np.arange(first, motion.duration, SAMPLE), motion.duration)
        flown = [motion.drones.at(t, order) for order in (1, 2, 3)]
        begins = np.append(np.arange(first, motion.duration, LATER), motion.duration)
        for onward, share in product(_onward(flown[1]), SHARES):
            shift = Sinking(stopping, first, share, onward).shift
            since = t - begins[:, None]
            moves = (since > 0.0) & (since < shift.duration)
            since = np.clip(since, 0.0, shift.duration)
            kept = np.ones(len(begins), dtype=np.bool_)
            for order in (2, 3, 1):  # accelerations leave out most
                by = np.where(moves[..., None], shift.at(since, order), 0.0)
                for i in np.flatnonzero(kept):
                    sums = flown[order - 1] + by[i, :, None]
                    kept[i] = np.max(dot(sums, sums)) <= bounds[order - 1] ** 2
                if not np.any(kept):
                    break
            heights = shift.at(np.clip(swung - begins, 0.0, shift.duration))[:, 2]
            heights += WORTH if any(onward) else 0.0
            for begin, height in zip(begins[kept].tolist(), heights[kept].tolist(), strict=True):
                found.append((height, Sinking(stopping, begin, share, onward)))
    found.sort(key=lambda each: (each[0], each[1].begin, -each[1].share))
    return [sinking for _, sinking in found]


def _onward(accelerations: Array) -> list[tuple[float, float]]:
    """Return where a team may be carried on that stops with accelerations (times, drones, 3)."""
    against = -np.mean(accelerations[..., :2], axis=(0, 1))
    size = float(np.linalg.norm(against))
    if size <= LEAST:
        return [(0.0, 0.0)]
    x, y = (against / size).tolist()
    return [(slope * x, slope * y) for slope in SLOPES]


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
