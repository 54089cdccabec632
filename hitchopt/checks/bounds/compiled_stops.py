"""Tables of a motion's stops for compiled code, and the stops that it finds."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.bounds.stop_bounds import StopBounds
from hitchopt.compiled.stop_tables import StopTables
from hitchopt.values import Array


def stop_tables(bounds: StopBounds) -> StopTables:
    """Return what stops are held against."""
    grid, limits, team = bounds.grid, bounds.limits, bounds.limits.motion.team
    radius = limits.static.thrust.radius + ROUNDING * limits.hover
    margins = [grid.fourth, grid.fifth, *limits.margins, limits.hover, limits.beyond, radius]
    spare = np.minimum(team.max_thrust - limits.hover, -limits.beyond) / team.mass
    most = limits.motion.requirements.limits
    sizes = np.ascontiguousarray(grid.sizes.transpose(0, 2, 1))
    return StopTables(
        grid.begin,
        grid.until,
        grid.width,
        grid.piece,
        grid.left,
        (grid.values[0], grid.values[1], grid.values[2], grid.values[3]),
        (sizes[0], sizes[1], sizes[2]),
        np.ascontiguousarray(grid.largest.T),
        np.min(spare, axis=1),
        np.stack([*margins, grid.slope, grid.bend]),
        np.stack([team.mass, team.max_thrust]),
        np.array([most.acceleration, most.jerk, limits.tilt]),
    )


def compiled_stops(
    bounds: StopBounds, starts: Array, samples: Array, span: Array, rounds: int, longer: Array
) -> Array:
    """Return durations (m,) [s] of stops; see ``hitchopt.compiled.stop_kernel.quick_stops``."""
    from hitchopt.compiled.stop_kernel import quick_stops

    return quick_stops(stop_tables(bounds), starts, samples, span, rounds, longer)
