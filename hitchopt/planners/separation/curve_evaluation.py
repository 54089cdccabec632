"""Evaluation of curves: the requirements they break, and the shortest time within limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks import Check, arena, keep_out, separation
from hitchopt.checks.bounds.rates import largest_rate, norm_bound
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.certificate import within
from hitchopt.errors import Violation
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.planners.separation.setting import Setting
from hitchopt.planners.timing.demands import LIMIT_SHARE
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.extremum import Cells, largest
from hitchopt.values import Array

STRETCH = 1.0 / LIMIT_SHARE
"""Stretch of the shortest duration: a reserve for the rounding and refitting of exports."""

IDLE = 0.01
"""[s] Duration where no drone moves."""

REMEDY = "give more time or room, or move the drones concerned apart"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Bounds on curves that hold at every time.

    Attributes
    ----------
    coefficients: (N, count, 3) [m].
    duration: the shortest in which they keep speed, acceleration and jerk [s].
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
    """Return the evaluation of curves, by the certificate's bounds that hold at every time."""
    task = setting.task
    duration = needed_duration(setting, setting.grid.curves(coefficients, 1.0))
    curves = setting.grid.curves(coefficients, duration)
    swarm = Swarm(task.drones)
    motion = Motion.single(swarm, task.requirements, curves, ())
    apart, *others = (rule.check(motion) for rule in (separation.RULE, arena.RULE, keep_out.RULE))
    names = dict(zip(swarm.drone_names, task.names, strict=True))
    broken = [
        replace(check, where=tuple(names.get(name, name) for name in check.where)).violation(
            f"at t = {check.time:.4g} s of {duration:.4g} s", REMEDY
        )
        for check in (apart, *others, _span(setting, curves, swarm))
        if check is not None and not check.holds
    ]
    return Evaluation(
        coefficients, duration, np.inf if apart is None else apart.bound, tuple(broken)
    )


def needed_duration(setting: Setting, unit: PiecewisePolynomial) -> float:
    """Return the shortest duration in which curves, given over 1 s, keep all limits [s]."""
    factors = []
    for order, cap in enumerate(setting.caps, start=1):
        shares = PiecewisePolynomial(unit.breaks, unit.coefficients / cap[:, None, None])
        factors.append(float(np.power(max(largest_rate(shares, order).worst, 0.0), 1.0 / order)))
    return max(*factors, IDLE) * STRETCH


def _span(setting: Setting, curves: PiecewisePolynomial, swarm: Swarm) -> Check | None:
    """Return the check of the tethers' lengths; None without tethers."""
    if not setting.task.tethers:
        return None
    first, second, longest = setting.task.tether_arrays
    x = curves.coefficients
    offsets = (x[:, first] - x[:, second]) / longest[:, None, None]
    size = float(np.max(np.abs(x))) / float(np.min(longest))
    cells = Cells.over(curves.breaks, [offsets], ROUNDING * size)
    found = largest(cells, norm_bound, within(1.0, "max", size, 0.5))
    pair = tuple(swarm.drone_names[ends[found.item]] for ends in (first, second))
    return Check.of("span", found.worst, 1.0, "max", "ratio", found.time, pair, size)
