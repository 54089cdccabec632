"""Limits of a path whose steps take variable times, linearised: speeds and accelerations.

Between two knots a drone or vertex, a *node*, has the mean velocity of its segment. Its
acceleration at a knot is the change of this velocity over half of both steps' times; at the ends,
from rest, over half of one.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.optimise.knots import KnotPath
from hitchopt.planners.timing.profile import (
    ESTIMATE_GRID,
    demands_along,
    fastest_profile,
    if_timed,
    path_grid,
    spare_accelerations,
)
from hitchopt.values import Array, Indices

MIN_SHARE = 0.5  # Fraction of a limit of speed or acceleration below which a node has no row


class TimeEntries(NamedTuple):
    """Entries of a sparse matrix: derivatives of rows by the times of steps."""

    row: Indices  # (entries,)
    step: Indices  # (entries,)
    entry: Array  # (entries,)


class TimedRows(NamedTuple):
    """Linear rows of m nodes, by their positions at k knots and by the times of l steps."""

    node: Indices  # (m,), of 3n
    knots: Indices  # (m, k), of which ends and those beyond have no variables
    by_place: Array  # (m, k, 2): derivatives with respect to the node's positions there
    steps: Indices  # (m, l), of which those before the first or after the last one do not exist
    by_time: Array  # (m, l): derivatives with respect to the times of these steps
    spare: Array  # (m,): largest change of the value

    def by_table(self, path: KnotPath) -> sp.csr_array[np.float64]:
        """Return the derivatives with respect to the table's inner rows."""
        columns = path.columns
        inner_knots = path.steps - 1
        nodes = columns.nodes[self.node]
        column = columns.flat_index(self.knots[..., None] - 1, nodes[:, None])  # (m, k, 2)
        row = np.broadcast_to(np.arange(len(self.node))[:, None, None], column.shape)
        is_inner = (self.knots >= 1) & (self.knots <= inner_knots)
        entries = self.by_place[is_inner].ravel()
        indices = (row[is_inner].ravel(), column[is_inner].ravel())
        return sp.csr_array((entries, indices), (len(self.node), columns.size * inner_knots))

    def by_times(self, steps: int) -> TimeEntries:
        """Return the derivatives with respect to the times of all ``steps`` steps."""
        exists = (self.steps >= 0) & (self.steps < steps)
        row = np.broadcast_to(np.arange(len(self.node))[:, None], self.steps.shape)
        return TimeEntries(row[exists], self.steps[exists], self.by_time[exists])


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
    grid = path_grid(ESTIMATE_GRID)
    demands = demands_along(path.path, limits)
    profile = if_timed(partial(fastest_profile, grid, demands))
    if profile is None:
        return longest
    knots = np.linspace(0.0, 1.0, path.steps + 1)
    return np.maximum(longest, np.diff(np.interp(knots, grid, profile.times)))


def speed_rows(path: KnotPath, limits: Limits, times: Array) -> TimedRows:
    """Return the rows of segments' times at the limits of speed: at most those of their steps."""
    of_segments = segment_times(path, limits)
    step, node = np.nonzero(of_segments > MIN_SHARE * times[:, None])
    moves = np.diff(path.table[:, path.columns.nodes], axis=0)[step, node]
    slope = unit(moves) / node_speeds(path, limits)[node, None]
    return TimedRows(
        node=node,
        knots=np.stack([step, step + 1], axis=1),
        by_place=np.stack([-slope, slope], axis=1),
        steps=step[:, None],
        by_time=np.full((len(step), 1), -1.0),
        spare=(times[:, None] - of_segments)[step, node],
    )


class KnotAccelerations(NamedTuple):
    """Accelerations of k nodes at J + 1 knots, from rest to rest, and what determines them."""

    values: Array  # (J + 1, k, 2) [m/s²]
    # (2, J + 1, k, 2) [m/s]: mean velocities in the steps before and after; zero at rest
    velocities: Array
    times: Array  # (2, J + 1) [s]: times of the steps before and after, zero beyond the ends


def accelerations(places: Array, times: Array) -> KnotAccelerations:
    """Return the accelerations of nodes at the knots.

    Parameters
    ----------
    places: (J + 1, k, 2) [m].
    times: (J,) [s].
    """
    velocities = np.diff(places, axis=0) / times[:, None, None]
    at_rest = np.zeros_like(velocities[:1])
    before = np.concatenate([at_rest, velocities])
    after = np.concatenate([velocities, at_rest])
    times_around = np.stack([np.append(0.0, times), np.append(times, 0.0)])
    values = 2.0 * (after - before) / np.sum(times_around, axis=0)[:, None, None]
    return KnotAccelerations(values, np.stack([before, after]), times_around)


def acceleration_rows(path: KnotPath, limits: Limits, times: Array) -> TimedRows:
    """Return the rows of drones' accelerations along their current directions.

    The bound of each is the acceleration that its thrust and tilt spare in any direction, within
    that of the limits, or its current one if it is larger.
    """
    drones = path.team.robots + np.arange(path.team.drones)
    at_knots = accelerations(path.table[:, path.columns.nodes[drones]], times)
    magnitudes = length(at_knots.values)
    reachable = _reachable_accelerations(path, limits)
    knot, drone = np.nonzero(magnitudes > MIN_SHARE * reachable)
    acceleration = magnitudes[knot, drone]
    direction = unit(at_knots.values[knot, drone])
    before, after = at_knots.times[:, knot]
    # The acceleration is 2 (v_after - v_before) / (before + after), of velocities in both steps
    per_velocity = 2.0 / (before + after)
    per_move_before = _divided(per_velocity, before)
    per_move_after = _divided(per_velocity, after)
    weights = np.stack([per_move_before, -per_move_before - per_move_after, per_move_after], axis=1)
    speed_before, speed_after = np.sum(at_knots.velocities[:, knot, drone] * direction, axis=-1)
    per_time = 0.5 * acceleration * per_velocity
    by_time_before = per_move_before * speed_before - per_time
    by_time_after = -per_move_after * speed_after - per_time
    return TimedRows(
        node=drones[drone],
        knots=knot[:, None] + np.array([-1, 0, 1]),
        by_place=weights[..., None] * direction[:, None],
        steps=knot[:, None] + np.array([-1, 0]),
        by_time=np.stack([by_time_before, by_time_after], axis=1),
        spare=np.maximum(reachable[knot, drone], acceleration) - acceleration,
    )


def _reachable_accelerations(path: KnotPath, limits: Limits) -> Array:
    """Return the accelerations (J + 1, 2n) [m/s²] that drones can reach in all directions."""
    index = np.searchsorted(path_grid(ESTIMATE_GRID), np.linspace(0.0, 1.0, path.steps + 1))
    loads = demands_along(path.path, limits).loads[np.minimum(index, ESTIMATE_GRID)]
    return np.minimum(spare_accelerations(path.team, limits, loads), limits.acceleration)


def _divided(values: Array, times: Array) -> Array:
    """Return values over times, zero where there is no time."""
    return np.divide(values, times, out=np.zeros_like(times), where=times > 0.0)
