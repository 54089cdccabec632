"""Evaluation of curves: the requirements they break, and the shortest time within limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.proximity import Bodies, every_pair, smallest_distance
from hitchopt.checks.bounds.rates import largest_rate, norm_bound
from hitchopt.checks.bounds.rounding_margins import LAST_PLACE, ROUNDING
from hitchopt.checks.certificate import within
from hitchopt.checks.keep_out import smallest_clearance
from hitchopt.errors import Violation
from hitchopt.hitch import Swarm
from hitchopt.planners.separation.setting import Setting
from hitchopt.planners.timing.demands import LIMIT_SHARE
from hitchopt.planners.timing.turning_stretch import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.extremum import Cells, largest

Array = NDArray[np.float64]

STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration: a reserve for the rounding and refitting of exports."""

IDLE = 0.01
"""[s] Duration where no drone moves."""

UNITS = {"separation": "ratio", "arena": "m", "keep_out": "m", "span": "ratio"}
"""Units of the checked quantities."""

REMEDY = "give more time or room, or move the drones concerned apart"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Bounds on curves that hold at every time.

    Attributes
    ----------
    coefficients: (N, count, 3) [m].
    duration: the shortest in which they keep speed, acceleration, jerk and body rate [s].
    closest: lower bound of the smallest separation of any pair.
    broken: violations that no duration removes; times are for ``duration``.
    """

    coefficients: Array
    duration: float
    closest: float
    broken: tuple[Violation, ...]

    @property
    def clear(self) -> bool:
        """Whether the curves, in their duration or a longer one, break nothing."""
        return not self.broken


def evaluate(setting: Setting, coefficients: Array) -> Evaluation:
    """Return the evaluation of curves, by bounds that hold at every time."""
    unit = setting.grid.curves(coefficients, 1.0)
    duration = needed_duration(setting, unit)
    closest, broken = _separation(setting, unit, duration)
    broken += _surroundings(setting, unit, duration) + _tethers(setting, unit, duration)
    return Evaluation(coefficients, duration, closest, tuple(broken))


def needed_duration(setting: Setting, unit: PiecewisePolynomial) -> float:
    """Return the shortest duration in which curves, given over 1 s, keep all limits [s]."""
    factors = []
    for order, cap in enumerate(setting.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    duration = max(*factors, IDLE) * STRETCH
    limits = setting.task.requirements.limits
    return turning_stretch(Swarm(setting.task.drones), limits.body_rate, (unit,), duration)


def _separation(
    setting: Setting, unit: PiecewisePolynomial, duration: float
) -> tuple[float, list[Violation]]:
    n = setting.task.drones
    if n < 2:
        return math.inf, []
    scaled = unit.coefficients * setting.scale[:, None]
    size = float(np.max(np.abs(scaled)))
    found = smallest_distance(
        unit.breaks,
        Bodies(scaled[:, :, None]),
        None,
        every_pair,
        ROUNDING * size,
        within(1.0, "min", size, 0.5),
    )
    if found.worst >= within(1.0, "min", size):
        return found.worst, []
    pair = sorted(divmod(found.item, n))
    when = found.time * duration, duration
    return found.worst, [_violation(setting, "separation", found.worst, 1.0, "min", pair, when)]


def _surroundings(setting: Setting, unit: PiecewisePolynomial, duration: float) -> list[Violation]:
    requirements, x = setting.task.requirements, unit.coefficients
    size = float(np.max(np.abs(x)))
    broken = []
    if requirements.arena is not None:
        # An arena is convex: if it holds the coefficients, it holds the curves.
        lower, upper = requirements.arena.lower, requirements.arena.upper
        room = np.minimum(x - lower[:, None], upper[:, None] - x)
        corner = float(np.max(np.abs([lower, upper])))
        worst = float(np.min(room)) - ROUNDING * (size + corner)
        if float(np.min(room)) >= -LAST_PLACE * corner:
            worst = 0.0  # a drone that rests on the floor is not below it, as in the certificate
        if worst < within(0.0, "min", size):
            piece, drone = np.unravel_index(int(np.argmin(room)), room.shape)[:2]
            when = float(unit.breaks[piece]) * duration, duration
            broken.append(_violation(setting, "arena", worst, 0.0, "min", [int(drone)], when))
    if requirements.keep_out:
        limit = requirements.separation.radius
        found = smallest_clearance(unit, requirements.keep_out, limit)
        if found.worst < within(limit, "min", size):
            when = found.time * duration, duration
            broken.append(
                _violation(setting, "keep_out", found.worst, limit, "min", [found.item], when)
            )
    return broken


def _tethers(setting: Setting, unit: PiecewisePolynomial, duration: float) -> list[Violation]:
    if not setting.task.tethers:
        return []
    first, second, longest = setting.task.tether_arrays
    x = unit.coefficients
    offsets = (x[:, first] - x[:, second]) / longest[:, None, None]
    size = float(np.max(np.abs(x))) / float(np.min(longest))
    cells = Cells.over(unit.breaks, [offsets], ROUNDING * size)
    found = largest(cells, norm_bound, within(1.0, "max", size, 0.5))
    if found.worst <= within(1.0, "max", size):
        return []
    pair = [int(first[found.item]), int(second[found.item])]
    when = found.time * duration, duration
    return [_violation(setting, "span", found.worst, 1.0, "max", pair, when)]


def _violation(
    setting: Setting,
    name: str,
    value: float,
    limit: float,
    sense: str,
    drones: Sequence[int],
    when: tuple[float, float],
) -> Violation:
    """Return the violation of drones at a time of the whole duration, ``when`` [s]."""
    names = tuple(setting.task.names[i] for i in drones)
    words = f"at t = {when[0]:.4g} s of {when[1]:.4g} s"
    return Violation(name, value, limit, sense, UNITS[name], names, words, REMEDY)
