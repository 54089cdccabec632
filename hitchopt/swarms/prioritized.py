"""Schedules of drones that queue at a passage or wait aside, by prioritized planning.

Drones are planned one after the other on a lattice of points and times. Each takes a fastest path
that keeps clear of all drones before it, and waits where it has to (Erdmann and Lozano-Pérez, "On
multiple moving objects", 1987; Silver, "Cooperative pathfinding", 2005). Drones with long paths
come first; one that has no path left moves to the front, and planning starts again (Andreychuk and
Yakovlev, "Two techniques that enhance the performance of multi-robot prioritized path planning",
2018).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import TIE, length
from hitchopt.hitch.requirements import Prism, Separation
from hitchopt.swarms.task import SeparationTask
from hitchopt.values import Array, Indices

Mask = NDArray[np.bool_]
Node = tuple[int, int, int]


@dataclass(frozen=True)
class LatticeTuning:
    """Numbers of lattices; ``python -m benchmarks separation`` shows their effect."""

    spacing: float = 0.25  # Distance between neighbouring points of a lattice, in separations
    max_points: int = 40_000  # Maximum number of points; lattices of larger spaces are coarser
    # Spacing, in separations, above which a lattice resolves no two drones
    max_spacing: float = 1.0
    coarser: float = 1.1  # Ratio of spacings of a coarser and a finer lattice
    # Largest distance by which a point is moved away from prisms, over the spacing
    max_move: float = 0.6
    moves: int = 4  # Number of times that points are moved away from each prism
    prism_tolerance: float = 1e-3  # Tolerance of the distance to prisms, over the radius of drones
    margin: float = 3.0  # Lattice around starts and goals without an arena, in separations
    max_steps_ratio: int = 5  # Maximum number of steps over that of the longest path alone
    max_orders: int = 8  # Maximum number of orders of priority for each clearance
    straight_bonus: float = 0.5
    """Bonus of a step like the one after it, over squared distances in steps, which are integers.
    """


TUNING = LatticeTuning()


CLEARANCES = (1.1, 1.0, 0.9)
"""Separations of drones at the times of a lattice, in the order in which they are tried. Between
these times drones may come closer; the programs that follow correct it."""


STEPS = np.array(sorted(product((-1, 0, 1), repeat=3), key=lambda step: sum(map(abs, step))))
"""(27, 3): steps from a point to itself, which is waiting, and to its neighbours."""

WAITING: Indices = STEPS[0]  # (3,): the step of a drone that waits


@dataclass(frozen=True, eq=False)
class Schedule:
    """Positions of all drones at equally spaced times.

    Attributes
    ----------
    points: (N, times, 3) [m], close to the starts at first and close to the goals at last.
    duration_ratio: number of steps over that of the longest path alone.
    """

    points: Array
    duration_ratio: float


@dataclass(frozen=True, eq=False)
class Lattice:
    """Points of a box on which drones move, one step at a time.

    Points that are a little too close to prisms are moved away from them, so that also a narrow
    passage has points in its middle.

    Attributes
    ----------
    points: (x, y, z, 3) [m].
    spacing: (3,) distances between neighbouring points along x, y and z, in separations.
    clear: (x, y, z), mask of the points that keep the distance to all prisms.
    separation: distances of drones.
    """

    points: Array
    spacing: Array
    clear: Mask
    separation: Separation

    @classmethod
    def of(cls, task: SeparationTask) -> Lattice | None:
        """Return the lattice of a task; None if the space is too large for one."""
        separation, arena = task.requirements.separation, task.requirements.arena
        ends = np.vstack([task.start, task.goal])
        margin = TUNING.margin / separation.scale
        lower = np.min(ends, axis=0) - margin
        upper = np.max(ends, axis=0) + margin
        if arena is not None:
            lower, upper = np.maximum(lower, arena.lower), np.minimum(upper, arena.upper)
        size = (upper - lower) * separation.scale  # in separations
        spacing = TUNING.spacing
        while np.prod(np.ceil(size / spacing) + 1.0) > TUNING.max_points:
            spacing *= TUNING.coarser
        if spacing > TUNING.max_spacing:
            return None
        counts = np.ceil(size / spacing).astype(int) + 1
        axes = map(np.linspace, lower, upper, counts)
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        largest_move = TUNING.max_move * spacing / separation.scale[0]  # [m]
        points, clear = _moved_away(
            grid, task.requirements.keep_out, separation.radius, largest_move
        )
        return cls(points, size / np.maximum(counts - 1, 1), clear, separation)

    def nearest(self, point: Array) -> Node:
        """Return the clear point nearest to a point (3,) [m]."""
        squares = np.sum(((self.points - point) * self.separation.scale) ** 2, axis=-1)
        squares[~self.clear] = np.inf
        x, y, z = np.unravel_index(int(np.argmin(squares)), squares.shape)
        return int(x), int(y), int(z)

    def along(self, path: Indices) -> Array:
        """Return the points (times, 3) [m] of a path (times, 3) of indices."""
        points: Array = self.points[tuple(path.T)]
        return points

    def neighbourhood(self, clearance: float) -> Mask:
        """Return the mask of the offsets between points that are closer than a separation."""
        x, y, z = (_offsets(spacing, clearance) for spacing in self.spacing)
        squared = (x**2)[:, None, None] + (y**2)[:, None] + z**2
        close: Mask = squared < clearance**2 * (1.0 - TIE)
        return close


def _offsets(spacing: float, clearance: float) -> Array:
    """Return the offsets (2 reach + 1,) of points along an axis up to a clearance, or the next."""
    reach = math.ceil(clearance / spacing) if spacing > 0.0 else 0
    return np.asarray(np.arange(-reach, reach + 1) * spacing, dtype=np.float64)


def _moved_away(
    grid: Array, prisms: Sequence[Prism], radius: float, largest_move: float
) -> tuple[Array, Mask]:
    """Return points (…, 3) [m] moved away from prisms, and the mask (…) of those that are clear."""
    points = grid.copy()
    for _ in range(TUNING.moves):
        for prism in prisms:
            clearance = prism.clearance(points)
            deficit = np.clip(radius - clearance.distance, 0.0, largest_move)
            points += deficit[..., None] * clearance.normals
    clear = length(points - grid) <= largest_move
    for prism in prisms:
        clear &= prism.clearance(points).distance >= radius * (1.0 - TUNING.prism_tolerance)
    return points, clear


class Reservations:
    """Points of a lattice that drones occupy at every time, until the end of their paths and after.

    Attributes
    ----------
    lattice: the lattice.
    close: mask of the offsets of points that a drone occupies, see ``Lattice.neighbourhood``.
    taken: masks (x, y, z) by time; the last one holds for all later times.
    """

    def __init__(self, lattice: Lattice, clearance: float) -> None:
        self.lattice = lattice
        self.close = lattice.neighbourhood(clearance)
        self.taken: list[Mask] = [np.zeros(lattice.clear.shape, dtype=np.bool_)]

    def add(self, path: Indices) -> None:
        """Reserve the points around a path (times, 3) of indices."""
        reach = np.array(self.close.shape) // 2
        new_times = max(len(path) - len(self.taken), 0)
        self.taken += [self.taken[-1].copy() for _ in range(new_times)]
        for time, taken in enumerate(self.taken):
            point = path[min(time, len(path) - 1)]
            lower = np.maximum(point - reach, 0)
            upper = np.minimum(point + reach + 1, taken.shape)
            on_lattice = tuple(map(slice, lower, upper))
            in_neighbourhood = tuple(map(slice, lower - point + reach, upper - point + reach))
            taken[on_lattice] |= self.close[in_neighbourhood]

    def free(self, time: int) -> Mask:
        """Return the points (x, y, z) that are clear and not taken at a time."""
        mask: Mask = self.lattice.clear & ~self.taken[min(time, len(self.taken) - 1)]
        return mask

    def free_from(self, point: Node) -> int:
        """Return the time from which a point stays free; larger than all times if never."""
        blocked_times = [time for time, taken in enumerate(self.taken) if taken[point]]
        if not blocked_times:
            return 0
        last_blocked = blocked_times[-1]
        if last_blocked == len(self.taken) - 1:
            return np.iinfo(np.int64).max
        return last_blocked + 1


def prioritized(task: SeparationTask) -> Iterator[Schedule]:
    """Yield schedules of a task's drones, those with more clearance first."""
    lattice = Lattice.of(task)
    if lattice is None or not np.any(lattice.clear):
        return
    starts = [lattice.nearest(point) for point in task.start]
    goals = [lattice.nearest(point) for point in task.goal]
    ends = list(zip(starts, goals, strict=True))
    horizon = int(np.sum(lattice.clear))
    empty = Reservations(lattice, CLEARANCES[0])
    paths_alone = [fastest_path(empty, start, goal, horizon) for start, goal in ends]
    steps_alone = [len(path) for path in paths_alone if path is not None]
    if len(steps_alone) < task.drones:
        return
    order = sorted(range(task.drones), key=lambda drone: -steps_alone[drone])
    longest = max(steps_alone)
    if longest == 1:  # all drones stay at their points of the lattice
        return
    for clearance in CLEARANCES:
        paths = _paths(lattice, ends, order, clearance, TUNING.max_steps_ratio * longest)
        if paths is not None:
            times = max(map(len, paths))
            until_last = (
                np.pad(path, ((0, times - len(path)), (0, 0)), mode="edge") for path in paths
            )
            yield Schedule(np.stack([*map(lattice.along, until_last)]), times / longest)


def _paths(
    lattice: Lattice,
    ends: Sequence[tuple[Node, Node]],
    order: Sequence[int],
    clearance: float,
    horizon: int,
) -> list[Indices] | None:
    """Return the paths (times, 3) of all drones, with other orders if need be, or None."""
    for _ in range(TUNING.max_orders):
        reservations = Reservations(lattice, clearance)
        paths: dict[int, Indices] = {}
        for drone in order:
            check_time()
            path = fastest_path(reservations, *ends[drone], horizon)
            if path is None:
                break
            reservations.add(path)
            paths[drone] = path
        else:
            return [paths[drone] for drone in range(len(ends))]
        if drone == order[0]:
            return None
        order = [drone, *(other for other in order if other != drone)]
    return None


def fastest_path(
    reservations: Reservations, start: Node, goal: Node, horizon: int
) -> Indices | None:
    """Return a path (times, 3) of indices with the fewest steps, at most ``horizon``, or None.

    Points that can be reached spread from the start by one step at a time. The path is read
    backward: it waits where it can, and otherwise flies straight on.
    """
    reached = [np.zeros(reservations.lattice.clear.shape, dtype=np.bool_)]
    reached[0][start] = True
    earliest = reservations.free_from(goal)
    while not (reached[-1][goal] and len(reached) > earliest):
        time = len(reached)
        reached.append(_spread(reached[-1]) & reservations.free(time))
        unchanged = time > len(reservations.taken) and np.array_equal(reached[-1], reached[-2])
        if time >= horizon or unchanged or not np.any(reached[-1]):
            return None
    backward = [np.array(goal)]
    step = WAITING
    for reached_before in reached[-2::-1]:
        step = _step_back(reached_before, backward[-1], step, np.array(start))
        backward.append(backward[-1] + step)
    return np.array(backward[::-1])


def _spread(mask: Mask) -> Mask:
    """Return the mask (x, y, z) of points and all their neighbours."""
    for axis in range(mask.ndim):
        along_axis = np.moveaxis(mask, axis, 0)
        wider = along_axis.copy()
        wider[1:] |= along_axis[:-1]
        wider[:-1] |= along_axis[1:]
        mask = np.moveaxis(wider, 0, axis)
    return mask


def _step_back(reached: Mask, point: Indices, last: Indices, start: Indices) -> Indices:
    """Return the step (3,) from a point to one that was reached a time earlier.

    Waiting comes first, then the step that leaves the least distance to the start. Of several such
    steps, the one that equals ``last``, the step after it, comes first.
    """
    candidates = point + STEPS
    possible = np.all((candidates >= 0) & (candidates < reached.shape), axis=1)
    possible[possible] = reached[tuple(candidates[possible].T)]
    waits = possible[0]
    if waits:
        return WAITING
    squared_distances = np.sum((candidates - start) ** 2, axis=1)
    costs = squared_distances - TUNING.straight_bonus * np.all(last == STEPS, axis=1)
    best: Indices = STEPS[int(np.argmin(np.where(possible, costs, np.inf)))]
    return best
