"""Checks ``arena`` and ``floor``: drones, taut cables and objects within walls, above the floor.

Hanging cables are kept above the ground by ``cable_clearance``, held objects by
``object_clearance``, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.checks.distances import UNBOUNDED, Flags
from hitchopt.checks.drone_forces import SagTerms, edge_sags, leg_sags
from hitchopt.checks.drones import Drones
from hitchopt.checks.objects import placed_corners
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, WorstOverSpans
from hitchopt.checks.solids import placed_objects
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    cable_parts,
    cached,
    joined_arrays,
    magnitude,
    part_names,
)
from hitchopt.errors import EXCHANGED
from hitchopt.motion.loads import held_pieces
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import CONTACT_GAP
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, known

S = TypeVar("S", bound=MotionSpans)

EXPORTED_SLACK = 1e-4
"""[m] Distance by which exported curves may pass a wall, as of a drone at rest on the floor."""

LOWER_FACE = "arena.lower[2]"  # Key of the arena's floor
CEILING = "arena.upper[2]"  # Key of the ceiling

LARGEST_SHARE = 0.6
"""Half of a part's weight over its tension up to which its sag is computed; beyond, the whole chord
bounds it."""

STEEPNESS_ITERATIONS = 40  # Of ``σ = w s / 2 T · cosh σ``, each of which divides the error by 2.3

MIN_CHORD = 1e-9  # [m] Smallest chord in quotients

FRACTIONS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Points along a span: the polygon through them, with the full sag at all inner ones, is below the
cable."""


@cached
def on_floor_pieces(motion: Motion) -> Flags:
    """Return on which pieces drones rest on the floor, take off or land (pieces, 2n)."""
    places = motion.drones.coefficients
    heights = places[:, :, 2, [0, -1]]
    is_upright = np.all(np.ptp(places[:, :, :2], axis=-1) <= CONTACT_GAP, axis=-1)
    touches = np.abs(heights - motion.requirements.ground_or(-math.inf)) <= CONTACT_GAP
    at_floor = is_upright & np.any(touches, axis=-1)
    drones = len(places[0])
    runs_of_drone = np.cumsum(~is_upright, axis=0)
    runs = runs_of_drone * drones + np.arange(drones)  # a number for each run of each drone
    return np.asarray(is_upright & np.isin(runs, runs[at_floor]))


def _wall_gap(
    spans: MotionSpans, points: Array, lowered: Array | float, reach: float = 0.0
) -> Bound:
    """Return the minimum distance to a wall of points (spans, points, 3, degree + 1) [m].

    Points have a horizontal radius ``reach``, and are lowered by ``lowered`` (spans, points) [m].
    """
    arena = known(spans.source.requirements.arena)
    above_lower = points - arena.lower[:, None]
    below_upper = arena.upper[:, None] - points
    above_lower[..., 2, :] -= np.asarray(lowered)[..., None]
    for gaps in (above_lower, below_upper):
        gaps[..., :2, :] -= reach
        gaps[..., 2, :] /= spans.source.requirements.height_ratio
    inside = np.concatenate([above_lower, below_upper], axis=2)
    inside = inside.reshape(len(points), -1, points.shape[-1])
    size = magnitude(spans.source) + float(np.max(np.abs([arena.lower, arena.upper])))
    return Enclosed(np.min(inside, axis=1, keepdims=True), ROUNDING * size).lower


def drone_wall_gap(spans: Drones, *, on_floor: bool = True) -> Bound:
    """Return the minimum distance of drones to a wall [m].

    With ``on_floor``, the floor also applies to drones that rest there, take off or land.
    """
    points = spans.read(spans.source.drones.coefficients)[:, None]
    raised: Any = 0.0
    if not on_floor:
        raised = UNBOUNDED * on_floor_pieces(spans.source)[spans.piece, spans.item, None]
    return _wall_gap(spans, points, -raised)


class Parts(MotionSpans):
    """Spans of the straight parts of taut cables."""

    @classmethod
    def names(cls, motion: Motion) -> list[str]:
        """Return the parts' names."""
        return part_names(motion, cable_parts(motion)[1])


@cached
def _part_sags(motion: Motion) -> SagTerms:
    """Return the terms of all parts (pieces, parts, degree + 1)."""
    cable, kind = np.divmod(cable_parts(motion)[1], 3)
    is_edge = kind == 1
    leg_or_edge = np.where(is_edge, motion.team.drones + cable, 2 * cable + kind // 2)
    legs_and_edges = zip(leg_sags(motion), edge_sags(motion), strict=True)
    return SagTerms(*(joined_arrays(terms, axis=1)[:, leg_or_edge] for terms in legs_and_edges))


def _part_wall_gap(spans: Parts) -> Bound:
    """Return the minimum distance of taut cables to a wall [m].

    A straight part of length s sags by some ``ρ g s² / 8 T`` at its middle.
    """
    points, sag = _sagging_points(spans)
    return _wall_gap(spans, points, sag)


def _sagging_points(spans: Parts) -> tuple[Array, Array]:
    """Return points (spans, k, 3, degree + 1) on straight parts, and how far cables sag there [m].

    The polygon through the points, lowered by the sags (spans, k), is below the cable. A level part
    of chord s is below its chord by at most ``4 S u (1 - u)``, u from 0 to 1, with ``4 S = s sinh
    σ`` its slope at the ends, ``σ / cosh σ = w s / 2 T``. The polygon is lowered by S from u = 1/4
    to 3/4. Up to u = 1/4 it is lowered by ``4 S u``, along the tangent at its end, and so from 3/4
    on. Sloping parts sag less, by their mean tension; toward their lower end, they are below that
    curve by less than 0.3 w h / 2 T of it, h their rise. Without weight, its ends suffice.
    """
    ends = spans.read(cable_parts(spans.source)[0])
    if spans.source.team.cable_density == 0.0:
        return ends, np.zeros(ends.shape[:2])
    start = ends[:, :1]
    along = ends[:, 1:] - start
    half_density, tension = spans.scalars(_part_sags(spans.source))
    chord = Enclosed(along[:, 0]).norm_upper.value
    shortest = Enclosed(along[:, 0]).norm_lower.value
    descent = np.maximum(Enclosed(-along[:, 0, 2:]).upper.value, 0.0)
    mean = tension.lower.value - half_density.upper.value * descent
    share = half_density.upper.value * chord / np.where(mean > 0.0, mean, np.inf)
    is_taut = (mean > 0.0) & (share < LARGEST_SHARE)
    sigma = np.where(is_taut, share, 0.0)
    for _ in range(STEEPNESS_ITERATIONS):
        sigma = np.where(is_taut, share, 0.0) * np.cosh(sigma)
    slope = Enclosed(along[:, 0, 2:]).norm_upper.value / np.maximum(shortest, MIN_CHORD)
    sag = 0.25 * chord * np.sinh(sigma) * (1.0 + 0.3 * share * np.minimum(slope, 1.0))
    sag = np.where(is_taut, sag, chord)
    is_inner = (FRACTIONS > 0.0) & (FRACTIONS < 1.0)
    points = start + FRACTIONS[:, None, None] * along
    return points, sag[:, None] * is_inner


def lowest_height(motion: Motion) -> float:
    """Return the smallest height [m] of drones and taut cables at any time."""
    heights = [motion.drones.coefficients[:, :, 2]]
    if np.all(motion.formed):
        for spans in Parts.of(motion):
            points, sag = _sagging_points(spans)
            heights.append(points[:, :, 2] - sag[..., None])
    return min(float(np.min(each)) for each in heights)


def _object_wall_gap(motion: Motion, _: float) -> WorstCase:
    """Return the minimum distance of a held object to a wall or the ceiling [m].

    Objects that are fixed, such as columns, may touch both.
    """
    cases = [WorstCase(math.inf, 0.0)]
    for name, body, pose in placed_objects(motion):
        if body.fixed:
            continue
        held = held_pieces(motion, name, HoldBy.REST) | held_pieces(motion, name, HoldBy.GRIP)
        for slab in body.slabs:
            corners = placed_corners(pose, slab)
            reach = slab.section.rounding + float(np.max(corners.r))

            def gap(spans: MotionSpans, table: Array = corners.c, reach: float = reach) -> Bound:
                # Raised without bound, since the floor does not count
                return _wall_gap(spans, spans.read(table), lowered=-UNBOUNDED, reach=reach)

            spans = MotionSpans.all_of(motion, motion.drones.breaks, 1, held)
            smallest = worst(spans, gap, "min")
            cases.append(WorstCase(smallest.worst, smallest.time, (name,)))
    return min(cases, key=lambda case: case.worst)


ARENA_REMEDY = "enlarge the arena, or keep the hitch farther from its walls"


def nearest_wall(motion: Motion, check: Check) -> str:
    """Return the key of the wall nearest to what is at it in a check, such as ``arena.upper[2]``.

    It is empty if the motion has no arena.
    """
    arena = motion.requirements.arena
    if arena is None:
        return ""
    time = float(np.clip(check.time, *motion.drones.breaks[[0, -1]]))
    names = motion.team.drone_names
    named = [names.index(name) for name in check.where if name in names]
    drones = motion.drones.at(time)
    points = drones[named] if named else np.concatenate([drones, motion.vertices.at(time)])
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        if name in check.where:
            points = _corners(body, motion.poses.at(time)[index])
    gaps = np.stack([np.min(points, axis=0) - arena.lower, arena.upper - np.max(points, axis=0)])
    side, axis = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    return f"arena.{('lower', 'upper')[side]}[{axis}]"


def _corners(body: SolidObject, pose: Array) -> Array:
    """Return points (m, 3) [m] as far out as an object with a pose x, y, z, cosine, sine (5,)."""
    x, y, z, cosine, sine = pose
    corners = list[Array]()
    for slab in body.slabs:
        level = slab.section.core @ [[cosine, sine], [-sine, cosine]] + [x, y]
        for reach in (-slab.section.rounding, slab.section.rounding):
            for height in (slab.lower, slab.upper):
                corners.append(np.insert(level + reach, 2, z + height, axis=1))
    return np.concatenate(corners)


def _arena_remedy(motion: Motion, check: Check) -> str:
    """Return the suggested change, and whether drones were inside with x and y exchanged."""
    arena = motion.requirements.arena
    if arena is None:
        return ""
    wall = nearest_wall(motion, check)
    change = f"move the wall outward ({wall}), or keep the hitch farther from it"
    if wall == LOWER_FACE:
        is_start = check.time <= motion.drones.breaks[0]
        change = f"{'start or ' if is_start else ''}fly higher above the floor"
    elif wall == CEILING:
        change = f"raise the ceiling ({wall}), or fly lower"
    places = motion.drones.at(motion.drones.breaks)[..., :2]

    def are_inside(level: Array) -> bool:
        return bool(np.all((level >= arena.lower[:2]) & (level <= arena.upper[:2])))

    exchanged = not are_inside(places) and are_inside(places[..., ::-1])
    return change + EXCHANGED * exchanged


ARENA = CheckRule(
    "arena",
    "m",
    "min",
    lambda motion: None if motion.requirements.arena is None else 0.0,
    (
        Evaluator(WorstOverSpans(Drones, drone_wall_gap, "min", magnitude), exported=True),
        Evaluator(
            WorstOverSpans(Parts, _part_wall_gap, "min", magnitude), lambda state: state.hitched
        ),
        Evaluator(_object_wall_gap, lambda state: state.hitched),
    ),
    ARENA_REMEDY,
    remedy_at=_arena_remedy,
    exported_slack=EXPORTED_SLACK,
    group="distances",
    key="arena",
    bodies=(("drones", "walls"), ("cables", "walls"), ("held", "walls")),
    proves="the minimum distance [m] of a drone, taut cable or held object to a wall",
    unproven="where propellers reach: drones are points",
)
"""Drones, taut cables and held objects stay in the arena."""


def _floor_gap(spans: MotionSpans, heights: Array) -> Bound:
    """Return the smallest height over the floor of points [m].

    Their heights are polynomials (spans, points, degree + 1) [m].
    """
    requirements = spans.source.requirements
    floor = known(requirements.limits.floor)
    lowest = np.min(heights - floor, axis=1, keepdims=True) / requirements.height_ratio
    return Enclosed(lowest, ROUNDING * (magnitude(spans.source) + abs(floor))).lower


def drone_floor_gap(spans: Drones, *, on_floor: bool = True) -> Bound:
    """Return the height of drones over the floor [m].

    With ``on_floor``, it also counts for drones that rest there, take off or land.
    """
    heights = spans.read(spans.source.drones.coefficients[:, :, 2])[:, None]
    if not on_floor:
        rests = on_floor_pieces(spans.source)[spans.piece, spans.item, None, None]
        heights = heights + UNBOUNDED * rests
    return _floor_gap(spans, heights)


def _part_floor_gap(spans: Parts) -> Bound:
    """Return the height of taut cables, which sag, over the floor [m]."""
    points, sag = _sagging_points(spans)
    return _floor_gap(spans, points[:, :, 2] - sag[..., None])


def _object_floor_gap(motion: Motion, limit: float) -> WorstCase:
    """Return the smallest height [m] of an object that is not fixed; it may stand on the floor."""
    cases = [WorstCase(math.inf, 0.0)]
    for name, body, pose in placed_objects(motion):
        if body.fixed:
            continue
        bottom = pose.c[:, None, 2] + min(slab.lower for slab in body.slabs)

        def gap(spans: MotionSpans, bottom: Array = bottom) -> Bound:
            height = _floor_gap(spans, spans.read(bottom)[:, None])
            stands = np.abs(height.value) <= CONTACT_GAP
            return Bound(np.where(stands, 0.0, height.value), height.x)

        lowest = worst(MotionSpans.all_of(motion, motion.drones.breaks, 1), gap, "min")
        cases.append(WorstCase(limit + lowest.worst, lowest.time, (name,)))
    return min(cases, key=lambda case: case.worst)


def _height(gap: Callable[[S], Bound], spans: S) -> Bound:
    """Return the height [m] from one over the floor."""
    over_floor = gap(spans)
    floor = known(spans.source.requirements.limits.floor)
    return Bound(over_floor.value + floor, over_floor.x)


FLOOR_REMEDY = "fly higher above the floor, or lower limits.floor"


def _floor_remedy(motion: Motion, check: Check) -> str:
    """Return the suggested change of a hitch that starts below the floor, or goes there."""
    is_start = check.time <= motion.drones.breaks[0]
    return f"{'start or ' if is_start else ''}{FLOOR_REMEDY}"


FLOOR = CheckRule(
    "floor",
    "m",
    "min",
    attrgetter("requirements.limits.floor"),
    (
        Evaluator(
            WorstOverSpans(Drones, partial(_height, drone_floor_gap), "min", magnitude),
            exported=True,
        ),
        Evaluator(
            WorstOverSpans(Parts, partial(_height, _part_floor_gap), "min", magnitude),
            lambda state: state.hitched,
        ),
        Evaluator(_object_floor_gap),
    ),
    FLOOR_REMEDY,
    start_remedy=f"start or {FLOOR_REMEDY}",
    remedy_at=_floor_remedy,
    exported_slack=EXPORTED_SLACK,
    group="distances",
    key="limits.floor",
    bodies=(("drones", "ground"), ("cables", "ground"), ("held", "ground")),
    proves="the smallest height [m] of a drone, load, taut cable or object; hanging cables keep "
    "separation.cable from the ground",
    unproven="the height of real ground",
)
"""Drones, taut cables and objects stay above the floor, on which drones and objects may stand.

With tracking errors heights over it are divided by their ratio, as all heights in distances are.
"""
