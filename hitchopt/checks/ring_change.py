"""Robots that join or leave a ring: ties of cables across the seam of two chapters.

At a seam, positions of drones are continuous and pairs of cables keep their ties. The new robot's
cable, taut on its own, has come straight down onto two cables that cross at an open vertex, from
above both, or straight up from below both. These are its neighbours, and their pair is dissolved.
Until one of their legs has rolled away, these legs cross beyond the new robot's edge, and the upper
one stays on top. Leaving is the reverse.
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
    MAX_SIDEWAYS,
    Flags,
    distance,
    upright_pieces,
)
from hitchopt.checks.linking import MAX_JUMP, MAX_LAID_GAP, UNLINKED, Ties, jump_of, wrong_cables
from hitchopt.checks.rule import WorstCase
from hitchopt.checks.spans import clasped_pairs, leg_vectors, position_margin
from hitchopt.geometry.vectors import cross
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.pairs import MIN_GAP
from hitchopt.motion.motion import CableState, Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array, Indices, true_runs

HALVINGS = 4
"""Number of halvings of a piece before the side of a leg is enclosed on each part."""


@dataclass(frozen=True, eq=False)
class VerticalPass:
    """A taut cable that moves vertically above or below edges of a ring at rest."""

    pieces: slice  # pieces on which it moves vertically
    edges: Indices  # (k,), edges that cross it, seen from above
    points: Array  # (k, 2) [m], crossing points
    gaps: Array  # (k, pieces, degree + 1) [m], distances above the edges, normal to both chords


def vertical_passes(ring: Motion, alone: Motion) -> Iterator[VerticalPass]:
    """Yield the vertical passes of a robot's taut cable over or under a ring, on common pieces."""
    taut = alone.in_states(frozenset({CableState.LAYING}))
    resting = np.ones(len(taut), dtype=np.bool_)
    for curve in (ring.drones, ring.vertices):
        resting &= np.max(np.ptp(curve.coefficients, axis=-1), axis=(1, 2)) <= MAX_SIDEWAYS
    vertical = taut & resting & ring.formed & upright_pieces(alone)
    for run in true_runs(vertical):
        yield _vertical_pass(ring, alone, slice(*run))


def _vertical_pass(ring: Motion, alone: Motion, pieces: slice) -> VerticalPass:
    c, layout = alone.drones.coefficients[pieces], ring.team.layout
    q, r = c[0, :, :, 0]
    points = ring.vertices.coefficients[pieces.start, ..., 0]
    a, b = points[layout.starts], points[layout.ends]
    along, direction = b - a, r - q
    turn = cross(direction, along)
    offset = a - q
    with np.errstate(all="ignore"):
        x, y = cross(offset, along) / turn, cross(offset, direction) / turn  # of cable and edge
    crossed = np.flatnonzero((x > 0.0) & (x < 1.0) & (y > 0.0) & (y < 1.0))
    x, y = x[crossed], y[crossed]
    cable = Catenary.between(q[None], r[None], alone.team.cable_length)
    depth = np.array([float(cable.depth(2.0 * share - 1.0)[0]) for share in x])
    spans = np.linalg.norm(along[crossed], axis=1)
    half = 0.5 * GRAVITY * ring.team.cable_density / ring.team.tension[crossed]
    level = a[crossed, 2] + y * along[crossed, 2] - half * y * (1.0 - y) * spans**2
    heights = (1.0 - x)[:, None, None] * c[:, 0, 2] + x[:, None, None] * c[:, 1, 2]
    upright = np.abs(turn[crossed]) / np.linalg.norm(np.cross(direction, along[crossed]), axis=1)
    gaps = (heights - (depth + level)[:, None, None]) * upright[:, None, None]
    return VerticalPass(pieces, crossed, q[:2] + x[:, None] * direction[:2], gaps)


def corner_side(motion: Motion, corner: Corner) -> int:
    """Return 1 if the leg of the cable ahead stays above that of the cable behind, -1 if below.

    The signed distance of the legs' lines has the numerator ``d · (l × m)``, d between their
    clasps. It may change its sign by up to MAX_LAID_GAP, or if the legs are apart; else return 0.
    """
    legs, vertices = leg_vectors(motion)[corner.pieces], motion.vertices.coefficients
    behind, ahead = corner.clasps
    offset = vertices[corner.pieces, ahead] - vertices[corner.pieces, behind]
    parts = [legs[:, 2 * corner.behind + 1], legs[:, 2 * corner.ahead], offset]
    for _ in range(HALVINGS):
        parts = [np.concatenate(bernstein.halve(part)) for part in parts]
    one, other, between = (Enclosed(part, position_margin(motion)) for part in parts)
    normal = one.cross(other)
    volume, tolerance = between.dot(normal), MAX_LAID_GAP * normal.norm_lower.value
    middle = volume.middle[:, 0]
    side = int(np.sign(middle[np.argmax(np.abs(middle))]))
    leg, other_leg, start = same_degree(*parts)
    ends = (0.0 * leg, leg), (start, start + other_leg)
    first, second = (np.stack(each, axis=1) for each in ends)
    clear = distance(first, second).value >= max(CROSSING.limit_of(motion) or 0.0, MIN_GAP)
    low = volume.range.low if side > 0 else -volume.range.high
    return side if np.all(clear | (low >= -tolerance)) else 0


def interlacing(chapters: Sequence[Motion]) -> WorstCase:
    """Return the number of pairs of cables, or cables, that contradict the states of phases."""
    errors = sorted(dict.fromkeys(_errors(chapters)))
    end = float(chapters[-1].drones.breaks[-1])
    places = tuple(dict.fromkeys(place for _, place in errors))
    return WorstCase(float(len(places)), errors[0][0] if errors else end, places)


def _errors(chapters: Sequence[Motion]) -> Iterator[tuple[float, str]]:
    """Yield times [s] and names of cables that contradict a phase or a seam."""
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
        lying, breaks = ring.in_states(frozenset({CableState.LYING})), ring.drones.breaks
        for corner in cut_corners(ring):
            lying[corner.pieces] &= not (i > 0 if corner.first else i < last)
        for piece in np.flatnonzero(lying).tolist():
            yield float(breaks[piece]), "ring"
        yield from _waiting_errors(chapters[i], (i > 0, i < last))
        if i < last:
            time = float(ring.drones.breaks[-1])
            ties, places = _cross_seam(chapters[i], chapters[i + 1], ties)
            yield from ((time, place) for place in places)


def _waiting_errors(chapter: Motion, seams: tuple[bool, bool]) -> Iterator[tuple[float, str]]:
    """Yield waiting robots that contradict their phases, or whose cables touch an edge.

    Next to a seam, a cable may touch edges that it passes vertically.
    """
    ring = chapter.groups[0].motion
    min_gap = max(CROSSING.limit_of(ring) or 0.0, MIN_GAP)
    for alone in (each.motion for each in chapter.groups[1:]):
        name = f"cable {alone.team.labels[0]}"
        for _, _, time in wrong_cables(alone, Ties.at_start(alone)):
            yield time, name
        for each in vertical_passes(ring, alone):
            far = np.where(_approaches(each), each.gaps[:, 0, 0], each.gaps[:, -1, -1])
            side, pieces = np.sign(far), each.pieces
            low = np.min(side[:, None, None] * each.gaps, axis=(1, 2), initial=np.inf)
            touches = (seams[0] and not pieces.start) or (
                seams[1] and pieces.stop == alone.drones.pieces
            )
            if np.any(np.abs(far) < min_gap) or np.any(low < (-MAX_JUMP if touches else min_gap)):
                yield float(alone.drones.breaks[pieces.start]), name


def _approaches(each: VerticalPass) -> Flags:
    """Return whether the cable is farther from its edges at first than at last (k,)."""
    first, last = np.abs(each.gaps[:, 0, 0]), np.abs(each.gaps[:, -1, -1])
    return np.asarray(first > last)


def _cross_seam(before: Motion, after: Motion, ties: Ties) -> tuple[Ties, list[str]]:
    """Return the ties of the ring after a seam, and the names of contradictions."""
    ring, other = before.groups[0].motion, after.groups[0].motion
    result, errors = Ties.at_start(other), list[str]()
    states = ring.phases[-1].state, other.phases[0].state
    if {*states} <= UNLINKED:
        laying = [
            f"cable {each.motion.team.labels[0]}"
            for each in (*before.groups[1:], *after.groups[1:])
            if each.motion.phases[0 if each in after.groups else -1].state is CableState.LAYING
        ]
        return result, laying
    joins = len(other.team.labels) > len(ring.team.labels)
    smaller, larger = (ring, other) if joins else (other, ring)
    new = {*larger.team.labels} - {*smaller.team.labels}
    required = (CableState.ROLLING, CableState.LYING)
    if len(new) != 1 or states != (required if joins else required[::-1]):
        changed = {*ring.team.labels} ^ {*other.team.labels}
        return result, [f"cable {k}" for k in changed] or ["ring"]
    (robot,) = new
    index = larger.team.labels.index(robot)
    rest = (*larger.team.labels[index + 1 :], *larger.team.labels[:index])
    start = smaller.team.labels.index(rest[0])
    if (*smaller.team.labels[start:], *smaller.team.labels[:start]) != rest:
        return result, [f"cable {k}" for k in rest]
    behind, ahead = rest[-1], rest[0]
    ties_of = _by_pair(ring, ties)
    chapter = before if joins else after
    alone = next(g.motion for g in chapter.groups[1:] if g.motion.team.labels == (robot,))
    side = _joining_side(smaller, larger, alone, (behind, robot, ahead), end=joins)
    corners = [c for c in cut_corners(larger) if c.first is joins]
    corner = corner_side(larger, corners[0]) if len(corners) == 1 else 0
    pairs = {(behind, robot): (0, 0, side), (robot, ahead): (0, 0, -side)}
    if joins:
        errors += [] if side else [f"cable {robot}"]
        errors += [] if corner and ties_of[behind, ahead][2] == corner else [f"cable {ahead}"]
    else:
        errors += [f"cable {a}" for (a, b), (*_, lies) in pairs.items() if ties_of[a, b][2] != lies]
        errors += [] if side and corner else [f"cable {robot}"]
        pairs = {(behind, ahead): (0, 0, corner)}
    for k, pair in enumerate(_pairs(other)):
        numbers = pairs.get(pair) or ties_of.get(pair, (0, 0, 0))
        result.numbers[k], result.senses[k], result.lying[k] = numbers
    errors += _displaced(ring, other)
    return result, errors


def _pairs(ring: Motion) -> list[tuple[int, int]]:
    """Return the robots behind and ahead of every clasp, in the order of ties."""
    layout, labels = ring.team.layout, ring.team.labels
    order = np.argsort(clasped_pairs(layout))
    both = zip(layout.behind[order].tolist(), layout.ahead[order].tolist(), strict=True)
    return [(labels[a], labels[b]) for a, b in both]


def _by_pair(ring: Motion, ties: Ties) -> dict[tuple[int, int], tuple[int, int, int]]:
    """Return number, sense and ``lying`` of every tie, by the robots behind and ahead."""
    rows = zip(*(x.tolist() for x in (ties.numbers, ties.senses, ties.lying)), strict=True)
    return dict(zip(_pairs(ring), rows, strict=True))


def _joining_side(
    smaller: Motion, larger: Motion, alone: Motion, robots: tuple[int, int, int], *, end: bool
) -> int:
    """Return 1 if a robot lies on both of its neighbours at a seam, -1 if under both, else 0.

    Its cable must cross no other edge, and cross these at its vertices in the larger ring.
    """
    pieces = alone.drones.pieces
    runs = [
        x
        for x in vertical_passes(smaller, alone)
        if (x.pieces.stop == pieces if end else not x.pieces.start)
    ]
    labels = smaller.team.labels
    neighbours = {labels.index(robots[0]), labels.index(robots[2])}
    if len(runs) != 1 or {*runs[0].edges.tolist()} != neighbours:
        return 0
    (run,) = runs
    gaps = run.gaps[:, -1, -1] if end else run.gaps[:, 0, 0]
    far = run.gaps[:, 0, 0] if end else run.gaps[:, -1, -1]
    side = int(np.sign(far[0]))
    index = larger.team.labels.index(robots[1])
    points = larger.vertices.coefficients[0 if end else -1, :, :2, 0 if end else -1]
    corners = points[[index, (index + 1) % len(larger.team.labels)]]
    order = [run.edges.tolist().index(labels.index(k)) for k in (robots[0], robots[2])]
    aligned = np.max(np.linalg.norm(run.points[order] - corners, axis=1)) <= MAX_LAID_GAP
    touching = np.max(np.abs(gaps)) <= MAX_LAID_GAP  # ``_waiting_errors`` follows the sides
    return side if aligned and touching and np.all(np.sign(far) == side) else 0


def _displaced(ring: Motion, other: Motion) -> list[str]:
    """Return the first vertex of a pair in both rings that jumps at a seam."""
    points_of = dict[tuple[int, int], Array]()
    for each, index in ((ring, -1), (other, 0)):
        points = each.vertices.coefficients[index, ..., index]
        labels, layout = each.team.labels, each.team.layout
        for k, a, b in zip(layout.clasps, layout.behind, layout.ahead, strict=True):
            pair = labels[a], labels[b]
            if pair in points_of and np.max(np.abs(points_of[pair] - points[k])) > MAX_JUMP:
                return [each.team.point_names[k]]
            points_of[pair] = points[k]
    return []


def jumps(motion: Motion, _: Sequence[Motion]) -> WorstCase:
    """Return the largest jump of a drone at any joint, as the check ``continuity``."""
    return jump_of(motion, [(motion.drones, motion.team.drone_names)])


def jumps_of_thrust(motion: Motion, chapters: Sequence[Motion]) -> WorstCase:
    """Return the largest jump of a drone's thrust at a seam [N], beyond its cable's weight.

    Crossing cables may transfer their weight to each other in unknown parts.
    """
    team, largest = motion.team, WorstCase(0.0, float(motion.drones.breaks[0]))
    if team.cable_density == 0.0:
        return largest
    weight = GRAVITY * team.cable_density * team.cable_length
    for one, other in pairwise(chapters):
        sides = []
        for chapter, x in ((one, 1.0), (other, 0.0)):
            thrusts_of = dict[str, tuple[Array, float, int]]()
            for own in (each.motion for each in chapter.groups):
                piece = slice(-1, None) if x else slice(0, 1)
                index = own.drones.pieces - 1 if x else 0
                cut = own.slice_pieces(slice(index, index + 1), own.phases[piece])
                thrusts, errors = (each[int(x)] for each in end_thrusts(cut))
                names = own.team.drone_names
                for k, name in enumerate(names):
                    label = own.team.labels[k // 2]
                    thrusts_of[name] = thrusts[0, k], float(errors[0, k]), label
            sides.append(thrusts_of)
        for name, (before, error, label) in sides[0].items():
            after, next_error, _ = sides[1][name]
            jump = float(np.linalg.norm(after - before)) + error + next_error - weight[label]
            if jump > largest.worst:
                largest = WorstCase(jump, float(other.drones.breaks[0]), (name,))
    return largest
