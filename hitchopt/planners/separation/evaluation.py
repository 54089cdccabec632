"""How curves stand: what their certificate will say, and in what time they keep the limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.proximity import Bodies, every_pair, smallest_distance
from hitchopt.checks.bounds.rates import largest_rate, norm_bound
from hitchopt.checks.bounds.rounding_margins import LAST_PLACE, ROUNDING
from hitchopt.checks.certificate import within
from hitchopt.checks.keep_out import smallest_clearance
from hitchopt.errors import Violation
from hitchopt.planners.separation.setting import Course
from hitchopt.planners.timing.demands import LIMIT_SHARE
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.extremum import Cells, largest

Array = NDArray[np.float64]

STRETCH = 1.0 / LIMIT_SHARE
"""So much more time than limits need leaves room for what exports round and refit."""

IDLE = 0.01
"""[s] What it takes where nobody moves."""

REMEDY = "give more time or room, or move the drones concerned apart"


@dataclass(frozen=True, eq=False)
class Standing:
    """What is known of curves for all of the time.

    Attributes
    ----------
    coefficients: (N, count, 3) [m], of the curves.
    duration: the shortest in which they keep speed, acceleration and jerk [s].
    closest: bounds the smallest separation of any pair.
    broken: what they break, whatever the duration; times are for ``duration``.
    """

    coefficients: Array
    duration: float
    closest: float
    broken: tuple[Violation, ...]

    @property
    def clear(self) -> bool:
        """Whether the curves, in their duration or a longer one, break nothing."""
        return not self.broken


def standing_of(course: Course, coefficients: Array) -> Standing:
    """Return how curves stand, by bounds for all of the time."""
    unit = course.grid.curves(coefficients, 1.0)
    duration = needed_duration(course, unit)
    closest, broken = _separation(course, unit, duration)
    found = [broken, *_surroundings(course, unit, duration), *_cables(course, unit, duration)]
    return Standing(coefficients, duration, closest, tuple(v for v in found if v is not None))


def needed_duration(course: Course, unit: PiecewisePolynomial) -> float:
    """Return the shortest duration in which curves, given over 1 s, keep all limits [s]."""
    factors = []
    for order, cap in enumerate(course.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    return max(*factors, IDLE) * STRETCH


def _separation(
    course: Course, unit: PiecewisePolynomial, duration: float
) -> tuple[float, Violation | None]:
    n = course.task.drones
    if n < 2:
        return math.inf, None
    scaled = unit.coefficients * course.scale[:, None]
    bodies = Bodies(scaled[:, :, None])
    size = float(np.max(np.abs(scaled)))
    found = smallest_distance(
        unit.breaks,
        bodies,
        None,
        every_pair,
        ROUNDING * size,
        within(1.0, "min", size, 0.5),
    )
    if found.worst >= within(1.0, "min", size):
        return found.worst, None
    i, j = sorted(divmod(found.item, n))
    names = (course.task.names[i], course.task.names[j])
    when = _when(found.time, duration)
    return found.worst, Violation(
        "separation", found.worst, 1.0, "min", "ratio", names, when, REMEDY
    )


def _surroundings(
    course: Course, unit: PiecewisePolynomial, duration: float
) -> list[Violation | None]:
    task = course.task
    found: list[Violation | None] = []
    if task.requirements.arena is not None:
        x = unit.coefficients  # an arena is convex: what holds the coefficients holds the curves
        room = np.minimum(
            x - task.requirements.arena.lower[:, None], task.requirements.arena.upper[:, None] - x
        )
        corners = np.abs([task.requirements.arena.lower, task.requirements.arena.upper])
        size = float(np.max(np.abs(x)))
        worst = float(np.min(room)) - ROUNDING * (size + float(np.max(corners)))
        if float(np.min(room)) >= -LAST_PLACE * float(np.max(corners)):
            worst = 0.0  # who rests on the floor is not below it, as the certificate has it
        if worst < within(0.0, "min", size):
            piece, drone = np.unravel_index(int(np.argmin(room)), room.shape)[:2]
            when = _when(float(unit.breaks[piece]), duration)
            name = (task.names[int(drone)],)
            found.append(Violation("arena", worst, 0.0, "min", "m", name, when, REMEDY))
    if task.requirements.keep_out:
        limit = task.requirements.separation.radius
        nearest = smallest_clearance(unit, task.requirements.keep_out, limit)
        if nearest.worst < within(limit, "min", float(np.max(np.abs(unit.coefficients)))):
            name = (task.names[nearest.item],)
            when = _when(nearest.time, duration)
            found.append(
                Violation("keep_out", nearest.worst, limit, "min", "m", name, when, REMEDY)
            )
    return found


def _cables(course: Course, unit: PiecewisePolynomial, duration: float) -> list[Violation | None]:
    tethers = course.task.tethers
    if not tethers:
        return []
    first = [tether.first for tether in tethers]
    second = [tether.second for tether in tethers]
    longest = np.array([tether.longest for tether in tethers])
    x = unit.coefficients
    offsets = (x[:, first] - x[:, second]) / longest[:, None, None]
    size = float(np.max(np.abs(x))) / float(np.min(longest))
    cells = Cells.over(unit.breaks, [offsets], ROUNDING * size)
    found = largest(cells, norm_bound, within(1.0, "max", size, 0.5))
    if found.worst <= within(1.0, "max", size):
        return []
    tether = tethers[found.item]
    names = (course.task.names[tether.first], course.task.names[tether.second])
    when = _when(found.time, duration)
    return [Violation("span", found.worst, 1.0, "max", "ratio", names, when, REMEDY)]


def _when(share: float, duration: float) -> str:
    return f"at t = {share * duration:.4g} s of {duration:.4g} s"
