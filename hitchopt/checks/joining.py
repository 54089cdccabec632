"""Robots that join a ring, or leave it: pairs across the seam of two chapters, replayed by robot.

At a seam every drone goes on where it was, and every pair of cables keeps its tie. The newcomer,
taut by itself, has come straight down on two cables that lie across each other at an open vertex,
from above both, or has come up from below both; these are its neighbours, and their pair opens for
good. Until one of their legs has rolled away they lie across each other beyond the newcomer's edge:
the one that was on top stays so. Leaving is the same backward.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hitchopt.checks.cables import end_thrusts
from hitchopt.checks.clasps import Corner, cut_corners
from hitchopt.checks.distances import (
    CROSSING,
    SIDEWAYS,
    TOUCHING,
    Flags,
    distance,
    upright_pieces,
)
from hitchopt.checks.linking import BEFORE, JUMP, LAID, Ties, jump_of, wrong_cables
from hitchopt.checks.rule import WorstCase
from hitchopt.checks.spans import clasped_pairs, leg_vectors, position_margin, same_degree
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.catenary import Catenary
from hitchopt.motion.motion import CableState, Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array, Indices

HALVINGS = 4
"""Number of halvings of a piece, on each part of which the side of a leg is enclosed."""


@dataclass(frozen=True, eq=False)
class Lowered:
    """Edges of a ring at rest over, or under, which a taut cable goes straight up or down.

    ``pieces`` are those on which it does. ``edges`` (k,) cross it, seen from above, at ``points``
    (k, 2) [m]; it is over them by ``gaps`` (k, pieces, degree + 1) [m], normal to both chords.
    """

    pieces: slice
    edges: Indices
    points: Array
    gaps: Array


def lowered_over(ring: Motion, alone: Motion) -> Iterator[Lowered]:
    """Yield how a robot's taut cable moves over or under the edges of a ring, on common pieces."""
    taut = alone.in_states(frozenset({CableState.LAYING}))
    resting = np.ones(len(taut), dtype=np.bool_)
    for curve in (ring.drones, ring.vertices):
        resting &= np.max(np.ptp(curve.coefficients, axis=-1), axis=(1, 2)) <= SIDEWAYS
    down = taut & resting & ring.formed & upright_pieces(alone)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], down, [False]])))
    for first, last in edges.reshape(-1, 2).tolist():
        yield _lowered(ring, alone, slice(first, last))


def _lowered(ring: Motion, alone: Motion, pieces: slice) -> Lowered:
    c, layout = alone.drones.coefficients[pieces], ring.team.layout
    q, r = c[0, :, :, 0]
    points = ring.vertices.coefficients[pieces.start, ..., 0]
    a, b = points[layout.starts], points[layout.ends]
    along, way = b - a, r - q
    turn = way[0] * along[:, 1] - way[1] * along[:, 0]
    apart = a - q
    with np.errstate(all="ignore"):
        here = (apart[:, 0] * along[:, 1] - apart[:, 1] * along[:, 0]) / turn  # share of the cable
        there = (apart[:, 0] * way[1] - apart[:, 1] * way[0]) / turn  # share of the edge
    crossed = np.flatnonzero((here > 0.0) & (here < 1.0) & (there > 0.0) & (there < 1.0))
    x, y = here[crossed], there[crossed]
    cable = Catenary.between(q[None], r[None], alone.team.cable_length)
    depth = np.array([float(cable.depth(2.0 * share - 1.0)[0]) for share in x])
    spans = np.linalg.norm(along[crossed], axis=1)
    half = 0.5 * GRAVITY * ring.team.cable_density / ring.team.tension[crossed]
    level = a[crossed, 2] + y * along[crossed, 2] - half * y * (1.0 - y) * spans**2
    heights = (1.0 - x)[:, None, None] * c[:, 0, 2] + x[:, None, None] * c[:, 1, 2]
    upright = np.abs(turn[crossed]) / np.linalg.norm(np.cross(way, along[crossed]), axis=1)
    gaps = (heights - (depth + level)[:, None, None]) * upright[:, None, None]
    return Lowered(pieces, crossed, q[:2] + x[:, None] * way[:2], gaps)


def corner_side(motion: Motion, corner: Corner) -> int:
    """Return 1 where the leg of the cable ahead stays above that of the one behind, -1 below; or 0.

    The legs' lines have a signed distance, whose numerator is ``d · (l × m)``, d between their
    clasps: it may change its sign by LAID at most, unless the legs are apart.
    """
    legs, vertices = leg_vectors(motion)[corner.pieces], motion.vertices.coefficients
    behind, ahead = corner.clasps
    apart = vertices[corner.pieces, ahead] - vertices[corner.pieces, behind]
    parts = [legs[:, 2 * corner.behind + 1], legs[:, 2 * corner.ahead], apart]
    for _ in range(HALVINGS):
        parts = [np.concatenate(bernstein.halve(part)) for part in parts]
    one, other, between = (Enclosed(part, position_margin(motion)) for part in parts)
    normal = one.cross(other)
    volume, within = between.dot(normal), LAID * normal.norm_below.value
    middle = volume.middle[:, 0]
    side = int(np.sign(middle[np.argmax(np.abs(middle))]))
    leg, its, start = same_degree(*parts)
    first, second = (np.stack(ends, axis=1) for ends in ((0.0 * leg, leg), (start, start + its)))
    clear = distance(first, second).value >= max(CROSSING.limit_of(motion) or 0.0, TOUCHING)
    low = volume.range.low if side > 0 else -volume.range.high
    return side if np.all(clear | (low >= -within)) else 0


def interlaced(chapters: Sequence[Motion]) -> WorstCase:
    """Return how many pairs of cables, or single ones, are not in the states of their phases."""
    wrong = sorted(dict.fromkeys(_wrong(chapters)))
    end = float(chapters[-1].drones.breaks[-1])
    places = tuple(dict.fromkeys(place for _, place in wrong))
    return WorstCase(float(len(places)), wrong[0][0] if wrong else end, places)


def _wrong(chapters: Sequence[Motion]) -> Iterator[tuple[float, str]]:
    """Yield times [s] and places at which something contradicts a phase, or a seam."""
    ties, last = None, len(chapters) - 1
    rings = [chapter.groups[0].motion for chapter in chapters]
    for i, ring in enumerate(rings):
        before = rings[i - 1].phases[-1].state if i else None
        after = rings[i + 1].phases[0].state if i < last else None
        if ties is None:
            ties = Ties.at_start(ring)
        for _, pair, time in wrong_cables(ring, ties, before, after):
            k, j = divmod(pair, ring.team.robots)
            yield time, f"cable {ring.team.labels[k]}, cable {ring.team.labels[j]}"
        passing, breaks = ring.in_states(frozenset({CableState.LYING})), ring.drones.breaks
        for corner in cut_corners(ring):
            passing[corner.pieces] &= not (i > 0 if corner.first else i < last)
        for piece in np.flatnonzero(passing).tolist():
            yield float(breaks[piece]), "ring"
        yield from _beside(chapters[i], (i > 0, i < last))
        if i < last:
            time = float(ring.drones.breaks[-1])
            ties, places = _over_seam(chapters[i], chapters[i + 1], ties)
            yield from ((time, place) for place in places)


def _beside(chapter: Motion, seams: tuple[bool, bool]) -> Iterator[tuple[float, str]]:
    """Yield robots that wait otherwise than said, or whose cable meets an edge.

    It may touch edges over, or under, which it goes straight up or down next to a seam.
    """
    ring = chapter.groups[0].motion
    least = max(CROSSING.limit_of(ring) or 0.0, TOUCHING)
    for alone in (each.motion for each in chapter.groups[1:]):
        name = f"cable {alone.team.labels[0]}"
        for _, _, time in wrong_cables(alone, Ties.at_start(alone)):
            yield time, name
        for each in lowered_over(ring, alone):
            away = np.where(_far_first(each), each.gaps[:, 0, 0], each.gaps[:, -1, -1])
            side, pieces = np.sign(away), each.pieces
            low = np.min(side[:, None, None] * each.gaps, axis=(1, 2), initial=np.inf)
            lies = (seams[0] and not pieces.start) or (
                seams[1] and pieces.stop == alone.drones.pieces
            )
            if np.any(np.abs(away) < least) or np.any(low < (-JUMP if lies else least)):
                yield float(alone.drones.breaks[pieces.start]), name


def _far_first(each: Lowered) -> Flags:
    """Return (k,) whether the cable is farther from an edge at first than at last."""
    first, last = np.abs(each.gaps[:, 0, 0]), np.abs(each.gaps[:, -1, -1])
    far: Flags = first > last
    return far


def _over_seam(here: Motion, there: Motion, ties: Ties) -> tuple[Ties, list[str]]:
    """Return the ties of the ring after a seam, and what is wrong there."""
    one, other = here.groups[0].motion, there.groups[0].motion
    after, wrong = Ties.at_start(other), list[str]()
    states = one.phases[-1].state, other.phases[0].state
    if {*states} <= BEFORE:
        laying = [
            f"cable {each.motion.team.labels[0]}"
            for each in (*here.groups[1:], *there.groups[1:])
            if each.motion.phases[0 if each in there.groups else -1].state is CableState.LAYING
        ]
        return after, laying
    joins = len(other.team.labels) > len(one.team.labels)
    less, more = (one, other) if joins else (other, one)
    new = {*more.team.labels} - {*less.team.labels}
    wanted = (CableState.ROLLING, CableState.LYING)
    if len(new) != 1 or states != (wanted if joins else wanted[::-1]):
        return after, [f"cable {k}" for k in {*one.team.labels} ^ {*other.team.labels}] or ["ring"]
    (robot,) = new
    at = more.team.labels.index(robot)
    rest = (*more.team.labels[at + 1 :], *more.team.labels[:at])
    start = less.team.labels.index(rest[0])
    if (*less.team.labels[start:], *less.team.labels[:start]) != rest:
        return after, [f"cable {k}" for k in rest]
    behind, ahead = rest[-1], rest[0]
    known = _by_pair(one, ties)
    chapter = here if joins else there
    alone = next(g.motion for g in chapter.groups[1:] if g.motion.team.labels == (robot,))
    side = _side(less, more, alone, (behind, robot, ahead), end=joins)
    corners = [c for c in cut_corners(more) if c.first is joins]
    corner = corner_side(more, corners[0]) if len(corners) == 1 else 0
    pairs = {(behind, robot): (0, 0, side), (robot, ahead): (0, 0, -side)}
    if joins:
        wrong += [] if side else [f"cable {robot}"]
        wrong += [] if corner and known[behind, ahead][2] == corner else [f"cable {ahead}"]
    else:
        wrong += [f"cable {a}" for (a, b), (*_, lies) in pairs.items() if known[a, b][2] != lies]
        wrong += [] if side and corner else [f"cable {robot}"]
        pairs = {(behind, ahead): (0, 0, corner)}
    for k, pair in enumerate(_pairs(other)):
        numbers = pairs.get(pair) or known.get(pair, (0, 0, 0))
        after.numbers[k], after.senses[k], after.lying[k] = numbers
    wrong += _moved(one, other)
    return after, wrong


def _pairs(ring: Motion) -> list[tuple[int, int]]:
    """Return the robots behind and ahead at every clasp, in the order of ties."""
    layout, labels = ring.team.layout, ring.team.labels
    order = np.argsort(clasped_pairs(layout))
    both = zip(layout.behind[order].tolist(), layout.ahead[order].tolist(), strict=True)
    return [(labels[a], labels[b]) for a, b in both]


def _by_pair(ring: Motion, ties: Ties) -> dict[tuple[int, int], tuple[int, int, int]]:
    """Return numbers, senses and what lies across, by the robots behind and ahead."""
    rows = zip(*(x.tolist() for x in (ties.numbers, ties.senses, ties.lying)), strict=True)
    return dict(zip(_pairs(ring), rows, strict=True))


def _side(
    less: Motion, more: Motion, alone: Motion, robots: tuple[int, int, int], *, end: bool
) -> int:
    """Return 1 where a robot lies on both of its neighbours at a seam, -1 under both; or 0.

    Its cable crosses no other edge, at the vertices that it has in the larger ring.
    """
    pieces = alone.drones.pieces
    runs = [
        x
        for x in lowered_over(less, alone)
        if (x.pieces.stop == pieces if end else not x.pieces.start)
    ]
    labels = less.team.labels
    wanted = {labels.index(robots[0]), labels.index(robots[2])}
    if len(runs) != 1 or {*runs[0].edges.tolist()} != wanted:
        return 0
    (run,) = runs
    gaps = run.gaps[:, -1, -1] if end else run.gaps[:, 0, 0]
    away = run.gaps[:, 0, 0] if end else run.gaps[:, -1, -1]
    side = int(np.sign(away[0]))
    at = more.team.labels.index(robots[1])
    places = more.vertices.coefficients[0 if end else -1, :, :2, 0 if end else -1]
    new = places[[at, (at + 1) % len(more.team.labels)]]
    order = [run.edges.tolist().index(labels.index(k)) for k in (robots[0], robots[2])]
    near = np.max(np.linalg.norm(run.points[order] - new, axis=1)) <= LAID
    close = np.max(np.abs(gaps)) <= LAID  # ``_beside`` follows who is above
    return side if near and close and np.all(np.sign(away) == side) else 0


def _moved(one: Motion, other: Motion) -> list[str]:
    """Return the vertices of pairs in both rings that are elsewhere after a seam."""
    places = dict[tuple[int, int], Array]()
    for ring, index in ((one, -1), (other, 0)):
        points = ring.vertices.coefficients[index, ..., index]
        labels, layout = ring.team.labels, ring.team.layout
        for k, a, b in zip(layout.clasps, layout.behind, layout.ahead, strict=True):
            pair = labels[a], labels[b]
            if pair in places and np.max(np.abs(places[pair] - points[k])) > JUMP:
                return [ring.team.point_names[k]]
            places[pair] = points[k]
    return []


def jumps(motion: Motion, _: Sequence[Motion]) -> WorstCase:
    """Return the largest jump of a drone at any joint, as the check ``continuity``."""
    return jump_of(motion, [(motion.drones, motion.team.drone_names)])


def jumps_of_thrust(motion: Motion, chapters: Sequence[Motion]) -> WorstCase:
    """Return the largest jump of a drone's thrust at a seam [N], beyond its cable's weight.

    Cables that lie across each other may leave that to one another: how much is not known.
    """
    team, largest = motion.team, WorstCase(0.0, float(motion.drones.breaks[0]))
    if team.cable_density == 0.0:
        return largest
    weight = GRAVITY * team.cable_density * team.cable_length
    for one, other in pairwise(chapters):
        sides = []
        for chapter, x in ((one, 1.0), (other, 0.0)):
            found = dict[str, tuple[Array, float, int]]()
            for own in (each.motion for each in chapter.groups):
                piece = slice(-1, None) if x else slice(0, 1)
                index = own.drones.pieces - 1 if x else 0
                cut = own.slice_pieces(slice(index, index + 1), own.phases[piece])
                thrusts, errors = end_thrusts(cut, x)
                names = own.team.drone_names
                for k, name in enumerate(names):
                    label = own.team.labels[k // 2]
                    found[name] = thrusts[0, k], float(errors[0, k]), label
            sides.append(found)
        for name, (before, slop, label) in sides[0].items():
            after, further, _ = sides[1][name]
            jump = float(np.linalg.norm(after - before)) + slop + further - weight[label]
            if jump > largest.worst:
                largest = WorstCase(jump, float(other.drones.breaks[0]), (name,))
    return largest
