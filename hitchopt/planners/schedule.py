"""When each of several groups begins to fly its path, so that their whole bodies keep apart.

Paths are given; what is sought are delays, on a grid of STEP seconds, and for whom no delay helps
another path of its own. Groups are placed by priority: the earliest start at which drones, cables
and objects keep off those of groups placed before, who wait at their starts and stay at their ends.
Delays are not monotone, as cables may pass where drones are far. Of two paths a table says at which
pairs of samples they are too close, so that every delay is a diagonal of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import check_time
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.motion import Group
from hitchopt.values import Array, Indices

STEP = 0.1  # [s]
ORDERS = 60  # maximum orders of priority that are tried
CHUNK = 200_000  # pairs of bodies compared at a time
REACH = 0.25  # [m] Excess of distances beyond their limits up to which it is computed


class Bodies(NamedTuple):
    """Segments (samples, bodies, 2, 3) [m] and what surrounds them.

    Their ``heights`` (samples, bodies, 2) from lowest to highest and ``radii`` (bodies,) [m]; those
    ``upright`` (samples,) are compared from above and by height.
    """

    segments: Array
    heights: Array
    radii: Array
    upright: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Track:
    """A group's path, sampled every STEP [s] from start to end, with the objects that it moves."""

    group: Group
    owned: frozenset[str] = frozenset()

    @cached_property
    def times(self) -> Array:
        """(samples,) [s]: the last one is the end."""
        first, last = self.group.motion.drones.breaks[[0, -1]]
        return np.append(np.arange(first, last - 1e-9, STEP), last)

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def drones(self) -> Bodies:
        """All drones."""
        places = self.group.motion.drones.at(self.times)
        segments, still = np.repeat(places[:, :, None], 2, axis=2), np.zeros(len(self), np.bool_)
        return Bodies(segments, segments[..., 2], np.zeros(places.shape[1]), still)

    @cached_property
    def cables(self) -> Bodies:
        """Parts of taut cables, and hanging cables with the sheets that they stay in."""
        motion, layout = self.group.motion, self.group.motion.team.layout
        n, m, drones = motion.team.robots, len(self), self.drones.segments[:, :, 0]
        if n == 0:
            none = np.zeros((m, 0, 2, 3))
            return Bodies(none, none[..., 2], np.zeros(0), np.zeros(m, np.bool_))
        segments = np.concatenate([motion.vertices.at(self.times), drones], axis=1)
        segments, breaks = segments[:, layout.part_nodes], motion.drones.breaks
        formed = motion.formed[np.searchsorted(breaks[1:-1], self.times, side="right")]
        cable = np.arange(segments.shape[1]) % n  # hanging ones, some of them twice
        chords = drones.reshape(m, n, 2, 3)[:, cable]
        lowest = np.mean(chords[..., 2], axis=-1) - 0.5 * motion.team.cable_length[cable]
        segments = np.where(formed[:, None, None, None], segments, chords)
        heights = np.sort(segments[..., 2], axis=-1)
        hung = np.minimum(heights[..., 0], lowest)
        heights[..., 0] = np.where(formed[:, None], heights[..., 0], hung)
        return Bodies(segments, heights, np.zeros(len(cable)), ~formed)

    @cached_property
    def objects(self) -> Bodies:
        """Circles around the objects that it moves, between their heights."""
        motion = self.group.motion
        objects = motion.requirements.objects
        own = [k for k, name in enumerate(objects) if name in self.owned]
        at = np.repeat(motion.object_poses.at(self.times)[:, own, None, :3], 2, axis=2)
        slabs = [list(objects.values())[k].slabs for k in own]
        ends = [[min(s.lower for s in each), max(s.upper for s in each)] for each in slabs]
        radii = [max(s.section.circumradius for s in each) for each in slabs]
        heights = at[..., 2] + np.array(ends).reshape(-1, 2)
        return Bodies(at, heights, np.array(radii), np.ones(len(self), np.bool_))

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Corners (samples, 3) [m] of a box around all of its bodies."""
        lower, upper = np.full((len(self), 3), np.inf), np.full((len(self), 3), -np.inf)
        for each in (self.drones, self.cables, self.objects):
            if each.segments.shape[1]:
                ends, radii = each.segments[..., :2], each.radii[:, None]
                low = np.min(np.min(ends, axis=2) - radii, axis=1), np.min(each.heights, (1, 2))
                high = np.max(np.max(ends, axis=2) + radii, axis=1), np.max(each.heights, (1, 2))
                lower = np.minimum(lower, np.column_stack(low))
                upper = np.maximum(upper, np.column_stack(high))
        return lower, upper


def _pairs(
    a: Track, b: Track, separation: Separation
) -> Iterator[tuple[str, Bodies, Bodies, float]]:
    """Yield the bodies of both tracks that keep off each other: by which check, how far [m]."""
    yield "separation", a.drones, b.drones, 1.0
    for check, one, other, limit in (
        ("cable_clearance", "drones", "cables", separation.cable),
        ("crossing", "cables", "cables", separation.crossing),
        ("keep_out", "drones", "objects", separation.radius),
        ("object_clearance", "cables", "objects", separation.object),
        ("object_clearance", "objects", "objects", separation.object),
    ):
        for first, second in dict.fromkeys(((one, other), (other, one))):
            yield check, getattr(a, first), getattr(b, second), limit


def slacks(a: Track, b: Track, separation: Separation) -> Array:
    """Return (samples of a, samples of b) by how much bodies are farther apart than required [m].

    It is the least of all pairs of bodies; infinite beyond REACH.
    """
    wide = 2.0 * max(separation.radius, separation.height)
    reach = max(wide, separation.cable, separation.crossing, separation.object) + REACH
    gaps = np.maximum(a.box[0][:, None] - b.box[1], b.box[0] - a.box[1][:, None])
    i, j = np.nonzero(np.sum(np.maximum(gaps, 0.0) ** 2, axis=-1) < reach**2)
    found = np.full((len(a), len(b)), np.inf)
    for _, _, thin, excess in _each_excess(a, b, separation, i, j):
        found[i, j] = np.minimum(found[i, j], thin * excess)
    return found


def _each_excess(
    a: Track, b: Track, separation: Separation, i: Indices, j: Indices
) -> Iterator[tuple[str, float, float, Array]]:
    """Yield by how much each kind of bodies exceed their distances at samples i and j (m,).

    Check, limit, the unit of the excess [m], and the excess (m,), infinite beyond REACH.
    """
    for check, first, second, limit in _pairs(a, b, separation):
        axes = 1.0 / separation.scale if check == "separation" else np.ones(3)
        thin, excess = float(np.min(axes)), np.full(len(i), np.inf)
        size = max(1, CHUNK // max(1, first.segments.shape[1] * second.segments.shape[1]))
        for k in range(0, len(i), size):
            check_time()
            rows = slice(k, k + size)
            excess[rows] = _excess(first, second, i[rows], j[rows], limit, axes)
        yield check, limit, thin, excess


def _excess(
    first: Bodies, second: Bodies, i: Indices, j: Indices, limit: float, axes: Array
) -> Array:
    """Return the least distance beyond a limit at samples i and j (m,), infinite beyond REACH.

    Distances are measured in units of ``axes`` (3,) [m].
    """
    least = np.full(len(i), np.inf)
    touching = limit + first.radii[:, None] + second.radii
    wide = touching[..., None] * axes + REACH
    a, b = (np.sort(each.segments[k], axis=2) for each, k in ((first, i), (second, j)))
    over = _gaps(first.heights[i], second.heights[j])
    near = over < wide[..., 2]
    for axis in range(2):
        near &= _gaps(a[..., axis], b[..., axis]) < wide[..., axis]
    pair, one, other = np.nonzero(near)
    upright = (first.upright[i] | second.upright[j])[pair]
    scale = np.where(upright[:, None], [1.0, 1.0, 0.0], 1.0)[:, None] / axes
    ends = first.segments[i[pair], one] * scale, second.segments[j[pair], other] * scale
    apart = length(shortest_offset(differences(*ends))) - touching[one, other]
    apart = np.where(upright, np.maximum(apart, over[near] - limit), apart)
    apart[apart * np.min(axes) > REACH] = np.inf
    np.minimum.at(least, pair, apart)
    return least


def _gaps(a: Array, b: Array) -> Array:
    """Return (m, bodies, bodies) the gaps between intervals (m, bodies, 2), negative if none."""
    a, b = a[:, :, None], b[:, None]
    return np.maximum(a[..., 0] - b[..., 1], b[..., 0] - a[..., 1])


@dataclass(eq=False)
class Placed:
    """A track and the sample of the common clock at which it begins."""

    track: Track
    start: int


@dataclass(frozen=True)
class Blocked:
    """Why a group finds no start beside another one.

    Attributes
    ----------
    names: of both groups.
    check, value, limit: the distance that is too small, at about ``time`` [s] since the item's
        start and ``place`` (3,) [m].
    at: ``goals`` or ``starts`` if both are too close while they rest there.
    """

    names: tuple[str, str]
    check: str
    value: float
    limit: float
    time: float
    place: tuple[float, ...]
    at: str


@dataclass(eq=False)
class Schedule:
    """Search for the starts of groups in one item of a mission.

    Attributes
    ----------
    tracks: of the groups, in the order of the file; at rest those of one sample.
    separation: distances that are kept.
    further: another path of a group by index and layer (1 up, 2 down), or None.
    """

    tracks: Sequence[Track]
    separation: Separation
    further: Callable[[int, int], Track | None] = lambda *_: None
    tables: dict[tuple[Track, Track], Array] = field(default_factory=dict)
    layered: dict[tuple[int, int], Track | None] = field(default_factory=dict)

    def solve(self, fixed: Sequence[Placed], pad: float) -> list[Placed] | Blocked:
        """Return the starts, in the order of the file, or what none is found for in that order.

        Where a group finds no start beside another one, it is tried before that one; else all
        orders follow one another.

        Parameters
        ----------
        fixed: what flies anyway.
        pad: by how much distances are wider [m].
        """
        first: Blocked | None = None
        names = [track.group.name for track in self.tracks]
        for layers in (1, 3):
            orders, tried = permutations(range(len(names))), set[tuple[int, ...]]()
            promoted: tuple[int, ...] | None = None
            for _ in range(ORDERS):
                order = promoted or next((each for each in orders if each not in tried), None)
                if order is None:
                    break
                tried.add(order)
                placed = self._placed(fixed, order, layers, pad)
                if not isinstance(placed, Blocked):
                    return [placed[k] for k in range(len(self.tracks))]
                first, promoted = first or placed, None
                if placed.names[1] in names:  # not somebody else's
                    late, early = map(names.index, placed.names)
                    rest = [k for k in order if k != late]
                    place = rest.index(early)
                    moved = (*rest[:place], late, *rest[place:])
                    promoted = None if moved in tried else moved
        assert first is not None
        return first

    def _placed(
        self, fixed: Sequence[Placed], order: Sequence[int], layers: int, pad: float
    ) -> dict[int, Placed] | Blocked:
        done = dict[int, Placed]()
        for k in order:
            blocked = None
            besides = [*fixed, *done.values()]
            for track, earlier in self._options(k, layers, earlier=layers > 1 and not fixed):
                start = self._earliest(track, besides, pad, earlier=earlier)
                if isinstance(start, int):
                    done[k] = Placed(track, start)
                    break
                blocked = blocked or start
            if k not in done:
                assert blocked is not None
                return blocked
        begin = min([0, *(each.start for each in done.values())])
        return {k: Placed(each.track, each.start - begin) for k, each in done.items()}

    def _options(self, k: int, layers: int, *, earlier: bool) -> Iterator[tuple[Track, bool]]:
        """Yield the paths of a group, and whether it is to begin before those placed already."""
        for before in (False, True)[: 1 + earlier]:
            for track in filter(None, (self._path(k, layer) for layer in range(layers))):
                yield track, before

    def _path(self, k: int, layer: int) -> Track | None:
        if layer == 0:
            return self.tracks[k]
        if (k, layer) not in self.layered:
            self.layered[k, layer] = self.further(k, layer)
        return self.layered[k, layer]

    def _earliest(
        self, track: Track, placed: Sequence[Placed], pad: float, *, earlier: bool
    ) -> int | Blocked:
        """Return the earliest start of a track that keeps off all that are placed.

        ``earlier``: the latest one below 0; the item then begins with it, and the others wait.
        """
        last = max([0, *(each.start + len(each.track) for each in placed)])
        starts = -np.arange(1, len(track) + 1) if earlier else np.arange(last + 1)
        starts = starts if len(track) > 1 else np.zeros(1, np.intp)
        free = np.ones(len(starts), np.bool_)
        begin = min([0, int(np.min(starts)), *(each.start for each in placed)])
        clock = np.arange(begin, last + len(track) + 1)
        own = np.clip(clock - starts[:, None], 0, len(track) - 1)
        for each in placed:
            where = np.clip(clock - each.start, 0, len(each.track) - 1)
            table = self._table(track, each.track)
            resting = table[np.ix_([0, -1], [0, -1])]  # distances at rest need no sample between
            close = table[own, where] < np.clip(np.min(resting), 0.0, pad)
            left = free & ~np.any(close, axis=1)
            if not np.any(left):
                row = int(np.flatnonzero(free)[-1])
                sample = int(clock[np.argmax(close[row])])
                return self._blocked(track, each, sample, int(starts[row]))
            free = left
        return int(starts[np.argmax(free)])

    def _table(self, a: Track, b: Track) -> Array:
        if (a, b) not in self.tables:
            if (b, a) in self.tables:
                return self.tables[b, a].T
            self.tables[a, b] = slacks(a, b, self.separation)
        return self.tables[a, b]

    def _blocked(self, track: Track, other: Placed, sample: int, start: int) -> Blocked:
        """Return what is closest at a sample, or at rest if they are too close there."""
        a, b = track, other.track
        i = int(np.clip(sample - start, 0, len(a) - 1))
        j = int(np.clip(sample - other.start, 0, len(b) - 1))
        table, at = self._table(a, b), ""
        for name, k in (("goals", -1), ("starts", 0)):
            if table[k, k] <= table[i, j]:
                i, j, at = k % len(a), k % len(b), name
        rows = [
            (float(e[0]) * thin, check, float(e[0]) + limit, limit)
            for check, limit, thin, e in _each_excess(
                a, b, self.separation, np.array([i]), np.array([j])
            )
        ]
        _, check, value, limit = min(rows)
        centres = [np.mean(each.drones.segments[k], axis=(0, 1)) for each, k in ((a, i), (b, j))]
        place = tuple(np.round(0.5 * (centres[0] + centres[1]), 3).tolist())
        names = a.group.name, b.group.name
        return Blocked(names, check, value, limit, STEP * sample, place, at)
