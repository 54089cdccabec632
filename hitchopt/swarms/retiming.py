"""Curves of all drones along themselves: their common clock as fast as limits allow.

Programs give all pieces of a flight the same share of its duration, so that one tight turn slows
down everything. A faster clock leaves drones where the others pass them: distances do not change.
"""

from __future__ import annotations

import numpy as np

from hitchopt.hitch import GRAVITY, Swarm
from hitchopt.hitch.series import JET, chained
from hitchopt.planners.timing.clock import even_clock, jerk_limited
from hitchopt.planners.timing.profile import Demands
from hitchopt.swarms.task import Setting
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from hitchopt.values.fields import with_fields


def retimed(setting: Setting, curves: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return curves (N, 3) [m] along others, faster where limits allow.

    Limits hold at samples, and distances up to the error of septic pieces between the breaks.

    Raises
    ------
    TimingError: no timing was found.
    """
    team = Swarm(setting.task.drones)
    _, acceleration, jerk = np.min(setting.caps, axis=1)
    capped = with_fields(
        setting.task.requirements.limits, acceleration=float(acceleration), jerk=float(jerk)
    )
    limits = capped.of_clocks(GRAVITY)
    breaks = curves.breaks / curves.duration
    path = PiecewisePolynomial(breaks, curves.coefficients)

    def demands_at(s: Array) -> Demands:
        no_vertices = np.zeros(len(s))
        no_loads = np.zeros((len(s), 0, 3))
        return Demands(path.jet(s, JET), no_vertices, no_loads, team, limits)

    clock = jerk_limited(even_clock(curves.duration, breaks), demands_at)
    progress = clock.jets()
    jets = path.jet(progress[:, 0].clip(0.0, 1.0), JET)
    return PiecewisePolynomial.through_jets(clock.breaks, chained(jets, progress[:, None, None]))
