"""Coordinated returns of single drones: lines that all fly at once, then straight down.

A return begins at one time of the plan, from where the drones are then. All of them wait, fly to
their targets on straight lines in the same time, wait again and go down; how long each waits is its
own. Their velocity jumps where lines meet, so what is certified are distances, places and speeds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from scipy.optimize import linear_sum_assignment

from hitchopt.checks.certificate import Check
from hitchopt.checks.registry import RULES
from hitchopt.motion.motion import Motion, Phase
from hitchopt.one_line import OneLine
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splitting import merged_breaks
from hitchopt.values import Array, Indices

CARRIED = tuple(
    rule for rule in RULES if rule.derivative <= 1 and any(each.exported for each in rule.finders)
)
"""Rules of the checks of lines that are flown: velocities jump where they meet."""

SHARE = 0.9
"""Share of the speed limit that returns use: their durations are whole seconds."""

LANDING = 0.5
"""[m/s] Usual speed of a descent."""

SPARE = 1.01
"""Separation of a return that is planned: rounding to millimetres takes some of it."""

MOST = 60
"""Number of returns of a plan: with fewer, a command waits longer for the next one."""


@dataclass(frozen=True, eq=False)
class Return(OneLine):
    """A return of D drones.

    Attributes
    ----------
    time: of the plan, at which it begins [s].
    targets: (D, 2) [m], level, where the drones go down.
    duration: of the lines [s]; 0 where all go down at once.
    before, after: (D,) [s], times for which drones wait before and after their lines.
    """

    time: float
    targets: Array
    duration: float
    before: Array
    after: Array

    def curves(self, start: Array, floor: float, landing: float) -> PiecewisePolynomial:
        """Return what drones at ``start`` fly, from t = 0 to rest on the ground, of shape (D, 3).

        Parameters
        ----------
        start: (D, 3) [m]
        floor: height of the ground [m].
        landing: speed of the descent [m/s].
        """
        there = np.column_stack([self.targets, start[:, 2]])
        down = np.column_stack([self.targets, np.full(len(start), floor)])
        falling = np.maximum(start[:, 2] - floor, 0.0) / landing
        begins, ends = self.before, self.before + self.duration
        lowers = ends + self.after
        lands = lowers + falling
        breaks = merged_breaks([np.array([0.0, 1e-2, float(np.max(lands)) + 1e-2])])
        inner = np.unique(np.round(np.concatenate([begins, ends, lowers, lands]), 9))
        breaks = merged_breaks([breaks, inner[(inner > 0.0) & (inner < breaks[-1])]])

        def share(first: Array, last: Array) -> Array:
            spans = np.maximum(last - first, 1e-12)
            found: Array = np.clip((breaks[:, None] - first) / spans, 0.0, 1.0)
            return found[..., None]

        level, low = share(begins, ends), share(lowers, lands)
        places = start + level * (there - start) + low * (down - there)
        return PiecewisePolynomial(breaks, np.stack([places[:-1], places[1:]], axis=-1))


def return_checks(motion: Motion, flown: Return, start: Array, landing: float) -> tuple[Check, ...]:
    """Return the checks of a return whose drones begin at ``start`` (D, 3) [m]."""
    requirements = motion.requirements.untimed
    curves = flown.curves(start, requirements.floor, landing)
    phase = Phase("return", 0, 0.0, curves.duration)
    whole = Motion.single(motion.team, requirements, curves, [phase])
    found = (rule.check(whole, exported=True) for rule in CARRIED)
    return tuple(check for check in found if check is not None)


def landing_speed(motion: Motion) -> float:
    """Return the speed of descents [m/s]."""
    return min(LANDING, SHARE * motion.requirements.limits.speed)


def planned_returns(motion: Motion) -> tuple[Return, ...]:
    """Return the returns of a plan, at times of whole seconds, the last one after its end.

    Times from which none was found are left out: a command then waits for the next one.
    """
    every = max(1, ceil(motion.duration / MOST))
    times = range(0, ceil(motion.duration) + every, every)
    found = (planned_return(motion, float(time)) for time in times)
    return tuple(each for each in found if each is not None)


def planned_return(motion: Motion, time: float) -> Return | None:
    """Return the first return from a time [s] that keeps all limits; None if none was found."""
    start = motion.drones.at(min(time, motion.duration))
    landing = landing_speed(motion)
    for tried in _tries(motion, time, start, landing):
        checks = return_checks(motion, tried, start, landing)
        spare = all(check.bound >= SPARE for check in checks if check.name == "separation")
        if spare and all(check.holds for check in checks):
            return tried
    return None


def _tries(motion: Motion, time: float, start: Array, landing: float) -> Iterator[Return]:
    """Yield returns: down at once, then to places of the plan, at once or the lower ones first."""
    level, zero = start[:, :2], np.zeros(len(start))
    yield Return(time, level, 0.0, zero, zero)
    ends = motion.drones.coefficients[-1, ..., -1]
    first = motion.drones.coefficients[0, ..., 0]
    speed = SHARE * motion.requirements.limits.speed
    fall = ceil((float(np.max(start[:, 2])) - motion.requirements.floor) / landing) + 1.0
    turn = _turns(start)
    places = (ends[:, :2], first[:, :2])
    for goal in (*(place[assigned(level, place)] for place in places), *places, level):
        far = float(np.max(np.linalg.norm(goal - level, axis=-1)))
        duration = float(max(1, ceil(far / speed)))
        yield Return(time, goal, duration, zero, zero)
        yield Return(time, goal, duration, zero, fall * turn)
        yield Return(time, goal, duration, (fall + duration) * turn, zero)


def _turns(start: Array) -> Array:
    """Return (D,) the turns in which drones of one height go down together, the lowest first."""
    ranks = np.unique(np.round(start[:, 2], 2), return_inverse=True)[1]
    turns: Array = ranks.reshape(-1).astype(np.float64)
    return turns


def assigned(level: Array, goal: Array) -> Indices:
    """Return (D,) which place each drone flies to such that the squares of distances are least.

    Lines of one clock then do not cross at one time.
    """
    apart = np.sum((level[:, None] - goal) ** 2, axis=-1)
    rows, columns = linear_sum_assignment(apart)
    order: Indices = columns[np.argsort(rows)]
    return order


def stated(returns: Sequence[Return]) -> str:
    """Return the times of returns in words."""
    if not returns:
        return "no coordinated return was found; drones would land where they are"
    times = ", ".join(f"{each.time:g}" for each in returns)
    return (
        f"rthPlan: coordinated returns from t = {times} s; drones are taken to stop at once there"
    )
