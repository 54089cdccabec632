"""Start times of several teams on given paths that keep all their bodies separated.

Start times are on a grid of STEP seconds; where teams would wait, or no delay helps, one may take
another path. Teams are placed in an order of priority, each at the earliest start at which its
drones, cables and objects keep their distances to those of teams placed before, which rest at both
ends of their paths. Feasible delays need not form an interval. A table of two paths holds the slack
of every pair of samples, so that every delay is one of its diagonals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bodies import cable_sheets, drones_of, taut_parts
from hitchopt.errors import check_time
from hitchopt.geometry import differences, hull_distance, shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.hitch.pairs import DISTANCES, Kind
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.flight import TeamMotion, same_object
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

STEP = 0.1  # [s] Spacing of samples
MAX_ORDERS = 60  # Maximum number of orders of priority
LAYER_SAVING = 0.1  # Smallest share of a duration that a climb to another layer saves
CHUNK = 200_000  # Number of pairs of bodies per chunk
FAR = 1e6  # [m] Distance of bodies that are ignored
REACH = 0.25  # [m] Distance beyond a limit up to which it is computed


class SampledBodies(NamedTuple):
    """Segments, or upright hulls of corners in plan view, at sampled times."""

    corners: Array  # (samples, bodies, k, 3) [m]: segments end at the first and the last one
    heights: Array  # (samples, bodies, 2) [m]: lowest and highest points
    radii: Array  # (bodies,) [m]: radii about the corners
    upright: NDArray[np.bool_]
    """(samples,): whether bodies are upright hulls, whose distances are those in plan view, or of
    heights if larger."""


class Boxes(NamedTuple):
    """Boxes around all bodies of a team at sampled times."""

    lower: Array  # (samples, 3) [m]
    upper: Array  # (samples, 3) [m]


@dataclass(frozen=True, eq=False)
class SampledPath:
    """A team's path, sampled every STEP [s] from start to end, and its own objects."""

    flown: TeamMotion  # The team's motion
    # Names of the objects that the team moves, or that some other team does not know
    owned: frozenset[str] = frozenset()

    @cached_property
    def times(self) -> Array:
        """(samples,) [s], including the end."""
        first, last = self.flown.motion.drones.breaks[[0, -1]]
        return np.append(np.arange(first, last - 1e-9, STEP), last)

    def __len__(self) -> int:
        return len(self.times)

    def samples(self, since_start: Indices) -> Indices:
        """Return samples by their number since the start; the team rests before and after."""
        return np.clip(since_start, 0, len(self) - 1)

    @cached_property
    def _pieces(self) -> Indices:
        """Pieces of the motion at all times (samples,)."""
        inner = self.flown.motion.drones.breaks[1:-1]
        return np.searchsorted(inner, self.times, side="right")

    @cached_property
    def drones(self) -> SampledBodies:
        """All drones."""
        motion = self.flown.motion
        corners = drones_of(motion).corners
        points = PiecewisePolynomial(motion.drones.breaks, corners).at(self.times)
        ends = np.repeat(points, 2, axis=2)
        return SampledBodies(
            corners=ends,
            heights=ends[..., 2],
            radii=np.zeros(points.shape[1]),
            upright=np.zeros(len(self), np.bool_),
        )

    @cached_property
    def cables(self) -> SampledBodies:
        """Parts of taut cables, and the vertical regions that contain other cables."""
        motion = self.flown.motion
        robots = motion.team.robots
        if robots == 0:
            empty = np.zeros((len(self), 0, 2, 3))
            never = np.zeros(len(self), np.bool_)
            return SampledBodies(
                corners=empty, heights=empty[..., 2], radii=np.zeros(0), upright=never
            )
        breaks = motion.drones.breaks
        ends = PiecewisePolynomial(breaks, taut_parts(motion).corners).at(self.times)
        sheets = PiecewisePolynomial(breaks, cable_sheets(motion).corners).at(self.times)
        cable = np.arange(ends.shape[1]) % robots  # regions fill the array repeatedly
        regions = sheets[:, cable]
        outlines = regions[:, :, :-2]
        parts = np.repeat(ends, [outlines.shape[2] - 1, 1], axis=2)
        lowest = np.min(regions[..., 2], axis=-1)
        highest = np.max(regions[..., 2], axis=-1)
        taut = motion.formed[self._pieces]
        is_taut = taut[:, None, None]
        heights_of_parts = np.sort(ends[..., 2], axis=-1)
        heights = np.where(is_taut, heights_of_parts, np.stack([lowest, highest], axis=-1))
        corners = np.where(is_taut[..., None], parts, outlines)
        return SampledBodies(
            corners=corners, heights=heights, radii=np.zeros(len(cable)), upright=~taut
        )

    @cached_property
    def taut(self) -> SampledBodies:
        """Parts of taut cables; far away at other times."""
        cables = self.cables
        offset = np.where(cables.upright, FAR, 0.0)[:, None, None]
        corners = cables.corners + offset[..., None]
        return cables._replace(corners=corners, heights=cables.heights + offset)

    @cached_property
    def objects(self) -> SampledBodies:
        """Cylinders around its own objects."""
        motion = self.flown.motion
        objects = motion.requirements.objects
        indices = [k for k, name in enumerate(objects) if name in self.owned]
        slabs_of_bodies = [body.slabs for name, body in objects.items() if name in self.owned]
        places = motion.poses.at(self.times)[:, indices, :3]
        axes = np.repeat(places[:, :, None], 2, axis=2)  # both ends are at the base
        lowest = [min(slab.lower for slab in slabs) for slabs in slabs_of_bodies]
        highest = [max(slab.upper for slab in slabs) for slabs in slabs_of_bodies]
        radii = [max(slab.section.circumradius for slab in slabs) for slabs in slabs_of_bodies]
        heights = axes[..., 2] + np.column_stack([lowest, highest])
        return SampledBodies(
            corners=axes,
            heights=heights,
            radii=np.array(radii),
            upright=np.ones(len(self), np.bool_),
        )

    def bodies(self, kind: Kind, other: SampledPath) -> SampledBodies:
        """Return the bodies of a kind that keep distances to another team."""
        if kind not in ("objects", "movable"):
            of_team: SampledBodies = getattr(self, kind)
            return of_team
        motion = self.flown.motion
        obstacles = other.flown.motion.requirements.objects
        compared = list[bool]()
        for index, (name, body) in enumerate(motion.requirements.objects.items()):
            if name in self.owned:
                offsets = motion.poses.coefficients[:, index] - body.pose[:, None]
                is_moved = np.max(np.abs(offsets)) > REST_DRIFT
                is_obstacle = name in obstacles and same_object(body, obstacles[name])
                is_kind = kind == "objects" or not body.fixed
                compared.append(is_kind and (is_moved or not is_obstacle))
        objects = self.objects
        return objects._replace(
            corners=objects.corners[:, compared],
            heights=objects.heights[:, compared],
            radii=objects.radii[compared],
        )

    @cached_property
    def boxes(self) -> Boxes:
        """Boxes around all bodies."""
        lower = np.full((len(self), 3), np.inf)
        upper = np.full((len(self), 3), -np.inf)
        for bodies in (self.drones, self.cables, self.objects):
            if not bodies.corners.shape[1]:
                continue
            level = bodies.corners[..., :2]
            radii = bodies.radii[:, None]
            level_low = np.min(np.min(level, axis=2) - radii, axis=1)
            level_high = np.max(np.max(level, axis=2) + radii, axis=1)
            low = np.column_stack([level_low, np.min(bodies.heights, (1, 2))])
            high = np.column_stack([level_high, np.max(bodies.heights, (1, 2))])
            lower = np.minimum(lower, low)
            upper = np.maximum(upper, high)
        return Boxes(lower, upper)


def slacks(a: SampledPath, b: SampledPath, separation: Separation) -> Array:
    """Return the smallest slack (samples of a, samples of b) [m], infinite beyond REACH."""
    separated = 2.0 * max(separation.radius, separation.height)
    reach = max(separated, separation.cable, separation.crossing, separation.object) + REACH
    gaps_below = a.boxes.lower[:, None] - b.boxes.upper
    gaps_above = b.boxes.lower - a.boxes.upper[:, None]
    gaps = np.maximum(gaps_below, gaps_above)
    i, j = np.nonzero(np.sum(np.maximum(gaps, 0.0) ** 2, axis=-1) < reach**2)
    table = np.full((len(a), len(b)), np.inf)
    for slacks_of_check in _slacks_by_check(a, b, separation, i, j):
        table[i, j] = np.minimum(table[i, j], slacks_of_check.unit * slacks_of_check.values)
    return table


class CheckSlacks(NamedTuple):
    """Slacks of a check at m pairs of samples."""

    check: str  # Name of the check
    limit: float  # Its limit [m or ratio]
    unit: float  # [m] Unit of the slacks
    values: Array  # (m,), infinite beyond REACH


def _slacks_by_check(
    a: SampledPath, b: SampledPath, separation: Separation, i: Indices, j: Indices
) -> Iterator[CheckSlacks]:
    """Yield the slacks of all checks at samples i of a and j of b (m,)."""
    half_axes = 0.5 / separation.scale
    axes_of = {"separation": 2.0 * half_axes, "downwash": half_axes}
    both = (a, i), (b, j)
    pairs = (
        (rule, kinds, tracks)
        for rule in DISTANCES.values()
        for kinds in rule.kinds
        for tracks in (both, both[::-1])[: 1 + (kinds[0] != kinds[1])]
    )
    for rule, (kind, other_kind), ((first, of_first), (second, of_second)) in pairs:
        limit = rule.limit(separation)
        bodies, others = first.bodies(kind, second), second.bodies(other_kind, first)
        axes = axes_of.get(rule.check, np.ones(3))
        slack_of = _downwash_slack if rule.check == "downwash" else _slack
        slack = np.full(len(i), np.inf)
        size = max(1, CHUNK // max(1, bodies.corners.shape[1] * others.corners.shape[1]))
        for start in range(0, len(i), size):
            check_time()
            rows = slice(start, start + size)
            slack[rows] = slack_of(bodies, others, of_first[rows], of_second[rows], limit, axes)
        yield CheckSlacks(rule.check, limit, float(np.min(axes)), slack)


def _slack(
    first: SampledBodies, second: SampledBodies, i: Indices, j: Indices, limit: float, axes: Array
) -> Array:
    """Return the minimum distance minus the limit at samples i and j (m,), infinite beyond REACH.

    Distances are scaled by ``axes`` (3,) [m].
    """
    smallest = np.full(len(i), np.inf)
    required = limit + first.radii[:, None] + second.radii
    reach = required[..., None] * axes + REACH
    first_boxes = _boxes(first.corners)[i]
    second_boxes = _boxes(second.corners)[j]
    vertical = _gaps(first.heights[i], second.heights[j])
    near = vertical < reach[..., 2]
    for axis in range(2):
        near &= _gaps(first_boxes[:, :, axis], second_boxes[:, :, axis]) < reach[..., axis]
    pair, first_body, second_body = np.nonzero(near)
    first_corners = first.corners[i[pair], first_body]
    second_corners = second.corners[j[pair], second_body]
    first_ends = first_corners[:, [0, -1]] / axes
    second_ends = second_corners[:, [0, -1]] / axes
    slack = length(shortest_offset(differences(first_ends, second_ends)))
    upright = (first.upright[i] | second.upright[j])[pair]
    slack[upright] = hull_distance(first_corners[upright, :, :2], second_corners[upright, :, :2])
    slack -= required[first_body, second_body]
    slack = np.where(upright, np.maximum(slack, vertical[near] - limit), slack)
    slack[slack * np.min(axes) > REACH] = np.inf
    np.minimum.at(smallest, pair, slack)
    return smallest


def _downwash_slack(
    drones: SampledBodies, others: SampledBodies, i: Indices, j: Indices, limit: float, axes: Array
) -> Array:
    """Return the slack of the ratio of drones above other bodies, as ``_slack``.

    Bodies above a drone do not count; those below reach up to their highest points everywhere.
    """
    across, _, upward = axes
    smallest = np.full(len(i), np.inf)
    points = drones.corners[i][:, :, :1]
    hulls = others.corners[j]
    boxes = _boxes(others.corners)[j]
    lowest, highest = np.moveaxis(others.heights[j], -1, 0)
    rise = points[..., 2] - highest[:, None]
    near = (rise < limit * upward + REACH) & (points[..., 2] > lowest[:, None])
    reach = limit * across + REACH + others.radii
    for axis in range(2):
        place = points[..., axis]
        low, high = np.moveaxis(boxes[:, None, :, axis], -1, 0)
        near &= np.maximum(low - place, place - high) < reach
    pair, drone, other = np.nonzero(near)
    distance = hull_distance(points[pair, drone, :, :2], hulls[pair, other, :, :2])
    level = np.maximum(distance - others.radii[other], 0.0)
    ratio = np.hypot(level / across, np.maximum(rise[near], 0.0) / upward)
    np.minimum.at(smallest, pair, ratio - limit)
    return smallest


def _boxes(corners: Array) -> Array:
    """Return the intervals (samples, bodies, 3, 2) [m] of corners (samples, bodies, k, 3) [m]."""
    return np.stack([np.min(corners, axis=2), np.max(corners, axis=2)], axis=-1)


def _gaps(first: Array, second: Array) -> Array:
    """Return gaps (m, bodies, bodies) between intervals (m, bodies, 2), negative on overlap."""
    first_low, first_high = np.moveaxis(first[:, :, None], -1, 0)
    second_low, second_high = np.moveaxis(second[:, None], -1, 0)
    gaps: Array = np.maximum(first_low - second_high, second_low - first_high)
    return gaps


@dataclass(eq=False)
class Placed:
    """A track and its start, as a sample of the common clock."""

    track: SampledPath  # The track
    start: int  # Sample of the common clock at which it starts
    behind: str = ""  # Name of the team for which it waits; empty if it starts at once


def _end(schedule: Sequence[Placed]) -> int:
    """Return the sample at which all tracks have ended."""
    return max(placed.start + len(placed.track) for placed in schedule)


@dataclass(frozen=True)
class Blocked:
    """The conflict of two teams without a feasible start."""

    # Names of the team without a start, and of the one placed before that it meets
    names: tuple[str, str]
    check: str  # Name of the check of the violated distance
    value: float  # The violated distance
    limit: float  # Its limit
    time: float  # [s] Approximate time of the violation since the item's start
    place: tuple[float, ...]  # (3,) [m]: a point between both teams
    at: str  # ``goals`` or ``starts`` if the teams are too close while they rest there, else empty


@dataclass(eq=False)
class Schedule:
    """Search for the starts of teams in one item of a mission."""

    # Paths of the teams, in the order of the file; teams at rest have one sample
    tracks: Sequence[SampledPath]
    separation: Separation  # Limits of distances
    # Returns another path of a team by index and layer from 1 on, or None
    alternative: Callable[[int, int], SampledPath | None]
    numbers_of_layers: Sequence[int]  # Numbers of layers of every team, tried in turn
    # Cache of slacks
    tables: dict[tuple[SampledPath, SampledPath], Array] = field(default_factory=dict)
    # Cache of other paths
    alternatives: dict[tuple[int, int], SampledPath | None] = field(default_factory=dict)

    def solve(self, fixed: Sequence[Placed], pad: float) -> list[Placed] | Blocked:
        """Return the starts, in the order of the file, or the first conflict.

        More layers are tried while teams wait for each other, or have no start; they are taken if
        they save LAYER_SAVING of the duration, and tried if one of their paths is so short. For
        other plans teams only wait, if that helps.

        Parameters
        ----------
        fixed: tracks with a fixed start.
        pad: increase of all distances [m].
        """
        conflicts = list[Blocked]()
        best: list[Placed] | None = None
        without_waiting = max(map(len, self.tracks))
        for fewer, layers in pairwise((0, *self.numbers_of_layers)):
            if best is not None:
                longest = (1.0 - LAYER_SAVING) * _end(best)
                every = product(range(len(self.tracks)), range(fewer, layers))
                paths = filter(None, (self._path(*each) for each in every))
                if min(map(len, paths), default=math.inf) > longest:
                    continue
            schedule = self._in_layers(fixed, layers, pad)
            if isinstance(schedule, Blocked):
                conflicts.append(schedule)
                continue
            if best is None or _end(schedule) <= (1.0 - LAYER_SAVING) * _end(best):
                best = schedule
            if fixed or _end(best) * (1.0 - LAYER_SAVING) < without_waiting:
                break
        return conflicts[0] if best is None else best

    def _path(self, team: int, layer: int) -> SampledPath | None:
        """Return the path of a team in a layer, of which 0 is its own; None if there is none."""
        if layer == 0:
            return self.tracks[team]
        if (team, layer) not in self.alternatives:
            self.alternatives[team, layer] = self.alternative(team, layer)
        return self.alternatives[team, layer]

    def _in_layers(
        self, fixed: Sequence[Placed], layers: int, pad: float
    ) -> list[Placed] | Blocked:
        """Return the starts of the first feasible order of priority, or the first conflict.

        After a conflict the next order of priority promotes the later team before the other one;
        if that order was evaluated before, the next permutation follows.
        """
        conflicts = list[Blocked]()
        evaluated = set[tuple[int, ...]]()
        all_orders = permutations(range(len(self.tracks)))
        order: tuple[int, ...] | None = next(all_orders)
        while order is not None and len(evaluated) < MAX_ORDERS:
            placed = self._placed(fixed, order, layers, pad)
            if not isinstance(placed, Blocked):
                return [placed[team] for team in range(len(self.tracks))]
            conflicts.append(placed)
            evaluated.add(order)
            order = self._promoted(order, placed)
            if order is None or order in evaluated:
                order = next((new for new in all_orders if new not in evaluated), None)
        return conflicts[0]

    def _promoted(self, order: tuple[int, ...], conflict: Blocked) -> tuple[int, ...] | None:
        """Return the order with the later team of a conflict before the other one.

        None if the other track is fixed.
        """
        names = [track.flown.name for track in self.tracks]
        late_name, early_name = conflict.names
        if early_name not in names:
            return None
        late = names.index(late_name)
        others = [team for team in order if team != late]
        position = others.index(names.index(early_name))
        return (*others[:position], late, *others[position:])

    def _placed(
        self, fixed: Sequence[Placed], order: Sequence[int], layers: int, pad: float
    ) -> dict[int, Placed] | Blocked:
        """Return the placed tracks by team index for an order of priority, or a conflict."""
        placed = dict[int, Placed]()
        for team in order:
            others = [*fixed, *placed.values()]
            placement = self._placement(team, others, layers, pad, earlier=layers > 1 and not fixed)
            if isinstance(placement, Blocked):
                return placement
            placed[team] = placement
        first = min([0, *(placement.start for placement in placed.values())])
        return {
            team: replace(placement, start=placement.start - first)
            for team, placement in placed.items()
        }

    def _placement(
        self, team: int, placed: Sequence[Placed], layers: int, pad: float, *, earlier: bool
    ) -> Placed | Blocked:
        """Return a team on the path that ends first, or the conflict on its own path.

        With ``earlier`` it may also start before the teams placed already, if it cannot after.
        """
        conflicts = list[Blocked]()
        for starts_before in (False, True) if earlier else (False,):
            feasible = list[Placed]()
            for layer in range(layers):
                track = self._path(team, layer)
                if track is None:
                    continue
                placement = self._earliest(track, placed, pad, earlier=starts_before)
                if isinstance(placement, Blocked):
                    conflicts.append(placement)
                else:
                    feasible.append(placement)
            if feasible:
                return min(feasible, key=lambda path: path.start + len(path.track))
        return conflicts[0]

    def _earliest(
        self, track: SampledPath, placed: Sequence[Placed], pad: float, *, earlier: bool
    ) -> Placed | Blocked:
        """Return a track at its earliest feasible start with those placed, or a conflict.

        With ``earlier`` it is the latest feasible start below 0, for which all others wait.
        """
        last = max([0, *(other.start + len(other.track) for other in placed)])
        if len(track) == 1:  # at rest: all starts are alike
            starts = np.zeros(1, np.intp)
        elif earlier:
            starts = -np.arange(1, len(track) + 1)
        else:
            starts = np.arange(last + 1)
        first = min([0, int(np.min(starts)), *(other.start for other in placed)])
        clock = np.arange(first, last + len(track) + 1)
        samples = track.samples(clock - starts[:, None])  # (starts, clock)
        feasible = np.ones(len(starts), np.bool_)
        behind = ""
        for other in placed:
            table = self._table(track, other.track)
            # Starts or ends that are closer than the pad cannot be moved apart, and need no pad
            both_at_rest = table[[0, -1], [0, -1]]
            needed = np.clip(np.min(both_at_rest), 0.0, pad)
            samples_of_other = other.track.samples(clock - other.start)
            too_close = table[samples, samples_of_other] < needed
            remaining = feasible & ~np.any(too_close, axis=1)
            if not np.any(remaining):
                last_feasible = int(np.flatnonzero(feasible)[-1])
                sample = int(clock[np.argmax(too_close[last_feasible])])
                start = int(starts[last_feasible])
                return self._blocked(track, other, sample, start, float(needed))
            if np.argmax(remaining) > np.argmax(feasible):
                behind = other.track.flown.name
            feasible = remaining
        return Placed(track, int(starts[np.argmax(feasible)]), "" if earlier else behind)

    def _table(self, a: SampledPath, b: SampledPath) -> Array:
        """Return the slacks (samples of a, samples of b) [m] of two tracks."""
        if (a, b) not in self.tables:
            if (b, a) in self.tables:
                return self.tables[b, a].T
            self.tables[a, b] = slacks(a, b, self.separation)
        return self.tables[a, b]

    def _blocked(
        self, track: SampledPath, other: Placed, sample: int, start: int, needed: float
    ) -> Blocked:
        """Return the minimum distance at a sample, or at rest if it is smaller there.

        The limit includes the ``needed`` slack [m], such as errors of position.
        """
        table = self._table(track, other.track)
        i = int(np.clip(sample - start, 0, len(track) - 1))
        j = int(np.clip(sample - other.start, 0, len(other.track) - 1))
        at = ""
        if table[-1, -1] <= table[i, j]:
            i = len(track) - 1
            j = len(other.track) - 1
            at = "goals"
        if table[0, 0] <= table[i, j]:
            i = 0
            j = 0
            at = "starts"
        by_check = _slacks_by_check(
            track, other.track, self.separation, np.array([i]), np.array([j])
        )
        tightest = min(by_check, key=lambda slack: (slack.unit * slack.values[0], slack.check))
        centre = np.mean(track.drones.corners[i], axis=(0, 1))
        centre_of_other = np.mean(other.track.drones.corners[j], axis=(0, 1))
        return Blocked(
            names=(track.flown.name, other.track.flown.name),
            check=tightest.check,
            value=float(tightest.values[0]) + tightest.limit,
            limit=tightest.limit + needed / tightest.unit,
            time=STEP * sample,
            place=tuple(np.round(0.5 * (centre + centre_of_other), 3).tolist()),
            at=at,
        )
