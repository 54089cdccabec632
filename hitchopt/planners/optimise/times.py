"""Limits of a path whose steps take variable times, linearised: speeds and accelerations.

Between two knots a drone or vertex, a *node*, has the mean velocity of its segment. Its
acceleration at a knot is the change of this velocity over half of both steps' times; at the ends,
from rest, over half of one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.optimise.knots import KnotPath
from hitchopt.planners.timing.profile import (
    GRID,
    TimingError,
    demands_along,
    fastest_profile,
    path_grid,
    spare_accelerations,
)
from hitchopt.values import Array, Indices

MIN_SHARE = 0.5
"""Fraction of a limit of speed or acceleration below which a node has no row."""


class TimedRows(NamedTuple):
    """Linear rows of m nodes, by their places at k knots and by the times of l steps."""

    node: Indices  # (m,), of 3n
    knots: Indices  # (m, k), of which ends and those beyond have no variables
    by_place: Array  # (m, k, 2), derivatives by the node's places there
    steps: Indices  # (m, l), of which those before the first or after the last one do not exist
    by_time: Array  # (m, l), derivatives by the times of these steps
    spare: Array  # (m,), largest change of the value

    def by_table(self, path: KnotPath) -> sp.csr_array[np.float64]:
        """Return the derivatives by the table's inner rows."""
        columns, inner = path.columns, path.steps - 1
        by = columns.size * (self.knots - 1)[..., None] + columns.nodes[self.node][:, None]
        used = (self.knots >= 1) & (self.knots <= inner)
        row = np.broadcast_to(np.arange(len(self.node))[:, None, None], by.shape)
        entries = self.by_place[used].ravel(), (row[used].ravel(), by[used].ravel())
        return sp.csr_array(entries, (len(self.node), columns.size * inner))

    def by_times(self, steps: int) -> tuple[Indices, Indices, Array]:
        """Return rows, steps and entries of the derivatives by the times of all steps."""
        used = (self.steps >= 0) & (self.steps < steps)
        row = np.broadcast_to(np.arange(len(self.node))[:, None], self.steps.shape)
        return row[used], self.steps[used], self.by_time[used]


def node_speeds(path: KnotPath, limits: Limits) -> Array:
    """Return the limits of the nodes' speeds (3n,) [m/s], vertices first."""
    return np.repeat([limits.vertex_speed, limits.speed], np.array([1, 2]) * path.team.robots)


def segment_times(path: KnotPath, limits: Limits) -> Array:
    """Return the times (J, 3n) [s] of the nodes' segments at their limits of speed."""
    moves = np.diff(path.table[:, path.columns.nodes], axis=0)
    times: Array = length(moves) / node_speeds(path, limits)
    return times


def step_times(path: KnotPath, limits: Limits) -> Array:
    """Return the times (J,) [s] of all steps on the fastest flight; at speed limits without one."""
    longest: Array = np.max(segment_times(path, limits), axis=1)
    grid = path_grid(GRID)
    try:
        profile = fastest_profile(grid, demands_along(path.path, limits))
    except TimingError:
        return longest
    knots = np.linspace(0.0, 1.0, path.steps + 1)
    return np.maximum(longest, np.diff(np.interp(knots, grid, profile.times)))


def speed_rows(path: KnotPath, limits: Limits, times: Array) -> TimedRows:
    """Return the rows of segments' times at the limits of speed: at most those of their steps."""
    own = segment_times(path, limits)
    step, node = np.nonzero(own > MIN_SHARE * times[:, None])
    moves = np.diff(path.table[:, path.columns.nodes], axis=0)[step, node]
    slope = unit(moves) / node_speeds(path, limits)[node, None]
    return TimedRows(
        node,
        np.stack([step, step + 1], axis=1),
        np.stack([-slope, slope], axis=1),
        step[:, None],
        np.full((len(step), 1), -1.0),
        (times[:, None] - own)[step, node],
    )


def accelerations(places: Array, times: Array) -> tuple[Array, Array, Array]:
    """Return accelerations (J + 1, k, 2) [m/s²] at knots, from rest to rest.

    Also return the mean velocities before and after (2, J + 1, k, 2) [m/s], and the times of the
    steps before and after (2, J + 1) [s], zero beyond the ends.

    Parameters
    ----------
    places: (J + 1, k, 2) [m].
    times: (J,) [s].
    """
    velocities = np.diff(places, axis=0) / times[:, None, None]
    at_rest = np.zeros_like(velocities[:1])
    around = np.stack([np.append(0.0, times), np.append(times, 0.0)])
    both = np.stack([np.concatenate([at_rest, velocities]), np.concatenate([velocities, at_rest])])
    changes = 2.0 * (both[1] - both[0]) / np.sum(around, axis=0)[:, None, None]
    return changes, both, around


def acceleration_rows(path: KnotPath, limits: Limits, times: Array) -> TimedRows:
    """Return the rows of drones' accelerations along their current directions.

    The bound of each is the acceleration that its thrust and tilt spare in any direction, within
    that of the limits, or its current one if it is larger.
    """
    drones = path.team.robots + np.arange(path.team.drones)
    places = path.table[:, path.columns.nodes[drones]]
    values, velocities, around = accelerations(places, times)
    at_knots = np.searchsorted(path_grid(GRID), np.linspace(0.0, 1.0, path.steps + 1))
    loads = demands_along(path.path, limits).loads[np.minimum(at_knots, GRID)]
    spare = np.minimum(spare_accelerations(path.team, limits, loads), limits.acceleration)
    sizes = length(values)
    knot, drone = np.nonzero(sizes > MIN_SHARE * spare)
    size, direction = sizes[knot, drone], unit(values[knot, drone])
    before, after = around[:, knot]
    shares = 2.0 / (before + after)
    of_before, of_after = (
        np.divide(shares, each, out=np.zeros_like(each), where=each > 0.0)
        for each in (before, after)
    )
    weights = np.stack([of_before, -of_before - of_after, of_after], axis=1)
    slow, fast = np.sum(velocities[:, knot, drone] * direction, axis=-1)
    mean = 0.5 * size * shares
    return TimedRows(
        drones[drone],
        knot[:, None] + np.array([-1, 0, 1]),
        weights[..., None] * direction[:, None],
        knot[:, None] + np.array([-1, 0]),
        np.stack([of_before * slow - mean, -of_after * fast - mean], axis=1),
        np.maximum(spare[knot, drone], size) - size,
    )
