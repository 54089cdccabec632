"""Stops that compiled code finds."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.derivative_grid import CURVED, DENSER, NODES
from hitchopt.checks.bounds.rounding_margins import LAST_PLACE, ROUNDING
from hitchopt.checks.bounds.static_thrust import StaticThrust
from hitchopt.compiled.kernel_switch import writable
from hitchopt.motion.motion import Motion
from hitchopt.values import Array


def compiled_stops(
    motion: Motion,
    width: float,
    starts: Array,
    samples: Array,
    span: Array,
    rounds: int,
    longer: Array,
) -> Array:
    """Return durations (m,) [s] of stops; see ``hitchopt.compiled.stop_kernel.quick_stops``.

    Those of a motion whose thrusts may turn as fast as they like, with nothing that is carried.
    ``width`` is that of a ``DerivativeGrid``.
    """
    from hitchopt.compiled.stop_kernel import quick_stops

    limits, team, drones = motion.requirements.limits, motion.team, motion.drones
    static = StaticThrust.of(motion).thrust
    return quick_stops(
        (writable(drones.coefficients), writable(drones.breaks)),
        (writable(static.coefficients), writable(static.radius)),
        np.stack([team.mass, team.max_thrust]),
        np.array([limits.acceleration, limits.jerk, limits.tilt]),
        (max(width, drones.duration / NODES), CURVED, DENSER),
        (LAST_PLACE, ROUNDING),
        starts,
        samples,
        span,
        rounds,
        longer,
    )
