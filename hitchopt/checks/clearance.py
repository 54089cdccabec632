"""Clearances of drones and cables from walls, other cables, prisms and objects.

Checks ``arena``, ``cable_clearance``, ``keep_out`` and ``object_clearance``.

Taut cables are straight. A cable that hangs between its drones is a catenary. During take-off and
landing, cables lie at least partly on the ground, between their drones.

On a time span, a hanging cable is replaced by a chain through points of the catenary at fixed μ,
with the steepness at mid time and the height difference of the polynomials. The distance of the
catenary from that chain is at most a bound on its bend between the points, plus ¼ (L + |h|) times
the deviation of its steepness from that at mid time (see ``hitchopt.hitch.catenary``).

Objects consist of slabs, convex sections between two heights. ``hitchopt.checks.distances`` only
needs their support functions, and their outward normals nearest to a moving body.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from hitchopt.checks.bodies import cable_sheets, clasped_cables, drones_of, taut_cables
from hitchopt.checks.certificate import Check, with_tolerance
from hitchopt.checks.distances import (
    GROUND,
    OTHER_LEGS,
    UNBOUNDED,
    Flags,
    Ground,
    Moving,
    PairSpans,
    Shape,
    cable_ends,
    gap,
    leg_remedy,
    nearest,
    plan_points,
    upright_distance,
)
from hitchopt.checks.drones import Drones, edge_sags, leg_sags, steepness_of
from hitchopt.checks.objects import in_object_frame, placed_corners
from hitchopt.checks.rule import (
    Approach,
    CheckRule,
    Evaluator,
    WorstCase,
    WorstOverSpans,
    largest_error,
)
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    cable_names,
    cable_parts,
    cached,
    joined_arrays,
    magnitude,
    part_names,
    phase_parts,
    position_margin,
)
from hitchopt.errors import EXCHANGED
from hitchopt.geometry.vectors import dot, unit
from hitchopt.hitch.catenary import (
    SERIES_LIMIT,
    Catenary,
    depth_terms,
    displacement_bound,
    level_length,
)
from hitchopt.hitch.pairs import CABLE, DISTANCES, TautBodies
from hitchopt.motion.loads import RIM_CUT, RIM_REMEDY, held_pieces
from hitchopt.motion.motion import (
    CLASPED_STATES,
    FREE_STATES,
    TAUT_STATES,
    CableState,
    HoldBy,
    Motion,
)
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import CONTACT_GAP, REST_DRIFT, section_gap, surface_below
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval, largest_of
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, Indices, known

# [m] Exported curves may pass a wall by this distance, as for a drone at rest on the floor
EXPORTED_LIMIT = -1e-4
FRACTIONS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])[:, None, None]
"""Points along a span: the polygon through them with the full sag is below the cable."""

MANY_SEGMENTS = 256  # Number of segments from which on each is divided into few parts per round
# Rounds and parts per round in which few segments are divided, to find nearest points to 3e-8 of
# their length
FEW_ROUNDS = (5, 32)
# Rounds and parts per round in which many segments are divided, to the same accuracy
MANY_ROUNDS = (25, 2)


@dataclass(frozen=True, eq=False)
class Solid(Shape):
    """A slab, as an obstacle for points, segments and other upright slabs.

    Another slab is represented by the corners of its core, those of its floor first; its
    ``rounding`` is added to this slab.
    """

    slab: Slab
    rounding: float | None = None

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m] along directions (…, 3)."""
        reach: Array = self.slab.support(directions)
        if self.rounding is not None:
            reach = reach + self.rounding * np.linalg.norm(directions[..., :2], axis=-1)
        return reach

    def flattened(self, ratio: float) -> Solid:
        """Return the slab with heights divided by a ratio."""
        lower, upper = self.slab.lower / ratio, self.slab.upper / ratio
        return replace(self, slab=replace(self.slab, lower=lower, upper=upper))

    def normals(self, corners: Array) -> Array:
        """Return outward normals (…, 3) nearest to bodies with corners (…, 1, 2 or 2 m, 3)."""
        if self.rounding is not None:
            return self._slab_normals(corners, self.rounding)
        first, last = corners[..., 0, :], corners[..., -1, :]
        along = last - first
        fraction = np.zeros(first.shape[:-1])
        if corners.shape[-2] > 1:
            # The distance to a convex body is convex along a segment: most are nearest at an end.
            rises_at_first = dot(self.slab.clearance(first).normals, along) > 0.0
            rises_at_last = dot(self.slab.clearance(last).normals, along) > 0.0
            inner = ~rises_at_first & rises_at_last
            fraction[~rises_at_last] = 1.0
            fraction[inner] = self._nearest_fractions(first[inner], along[inner])
        return self.slab.clearance(first + fraction[..., None] * along).normals

    def _nearest_fractions(self, starts: Array, along: Array) -> Array:
        """Return fractions of segments (segments, 3) nearest to the slab, if not their ends."""
        rounds, parts = FEW_ROUNDS if len(starts) < MANY_SEGMENTS else MANY_ROUNDS
        lower, width = np.zeros(len(starts)), 1.0
        for _ in range(rounds if len(starts) else 0):
            width /= parts
            fractions = lower + width * np.arange(1, parts)[:, None]
            normals = self.slab.clearance(starts + fractions[..., None] * along).normals
            lower += width * np.count_nonzero(dot(normals, along) <= 0.0, axis=0)
        return lower + width

    def _slab_normals(self, corners: Array, rounding: float) -> Array:
        """Return outward normals nearest to upright slabs, horizontal if a side is nearest."""
        floor = corners[..., : corners.shape[-2] // 2, :2]
        sides = np.stack([floor, np.roll(floor, -1, axis=-2)], axis=-2)
        flat = np.concatenate([sides, np.zeros_like(sides[..., :1])], axis=-1)
        normals = from_above(self.slab).normals(flat)[..., :2]  # (…, sides, 2)
        gaps = np.min(np.einsum("...sd,...kd->...sk", normals, floor), axis=-1)
        gaps = gaps - self.slab.section.support(normals) - rounding
        best = np.argmax(gaps, axis=-1)[..., None]
        gap = np.maximum(np.take_along_axis(gaps, best, axis=-1), 0.0)
        horizontal = gap * np.take_along_axis(normals, best[..., None], axis=-2)[..., 0, :]
        gap_above = np.maximum(corners[..., :1, 2] - self.slab.upper, 0.0)
        gap_below = np.maximum(self.slab.lower - corners[..., -1:, 2], 0.0)
        return unit(np.concatenate([horizontal, gap_above - gap_below], axis=-1))


def from_above(slab: Slab) -> Solid:
    """Return a body without vertical bounds, for horizontal distances."""
    return Solid(Slab(slab.section, -UNBOUNDED, UNBOUNDED))


def pairs_with_shape(
    motion: Motion,
    points: Enclosed,
    names: Sequence[str],
    label: str,
    shape: Shape,
    pose: Enclosed | None = None,
    *,
    margin: float | None = None,
    **further: Any,
) -> Moving:
    """Return the pairs of moving points and a named shape; ``further`` as in ``Moving``.

    With a ``pose``, the shape is in its frame. The default rounding error ``margin`` is that of the
    motion.
    """
    local = points if pose is None else in_object_frame(pose, points)
    if margin is None:
        margin = ROUNDING * (magnitude(motion) + sum(slab.size for slab in _obstacles(motion)))
    margin += float(np.max(local.r))
    breaks, nowhere = motion.drones.breaks, np.zeros((len(local.c), 1, 1, 3, 1))
    options: dict[str, Any] = {"breaks": breaks, "names": (names, (label,))} | further
    return Moving(first=local.c, second=nowhere, margin=margin, shape=shape, **options)


def _obstacles(motion: Motion) -> list[Slab]:
    """Return the slabs of all prisms and objects."""
    slabs = [prism.slab for prism in motion.requirements.keep_out]
    for body in motion.requirements.objects.values():
        slabs.extend(body.slabs)
    return slabs


def _objects(motion: Motion) -> Iterator[tuple[str, SolidObject, Enclosed]]:
    """Yield the names of objects, the objects, and their poses (pieces,)."""
    poses = motion.poses.coefficients
    for index, (name, each) in enumerate(motion.requirements.objects.items()):
        yield name, each, Enclosed(poses[:, index])


def moving_object_pairs(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of moving objects and the ground, and of moving objects and all others.

    An object may touch the support that it leaves or approaches vertically: in a run of such pieces
    one of which begins or ends in contact, and in the first run the support below it at the start.
    """
    objects, floor = motion.requirements.objects, motion.requirements.floor
    places = motion.poses.coefficients[0, :, :, 0]
    bodies = [*_objects(motion)]
    ground = GROUND, None, Enclosed(np.zeros((1, 5, 1)))
    for (name, body, pose), (label, other, other_pose) in product(bodies, [*bodies, ground]):
        travel = np.ptp(pose.c, axis=-1)
        moving = np.any(travel > REST_DRIFT, axis=-1)
        if name == label or not np.any(moving):
            continue
        vertical = np.max(travel[:, [0, 1, 3, 4]], axis=-1) <= CONTACT_GAP
        height = pose.c[:, 2] + body.lower - other_pose.c[:, 2] - (other.upper if other else floor)
        touches = vertical & np.any(np.abs(height[:, [0, -1]]) <= CONTACT_GAP, axis=1)
        if other and np.any(touches):
            poses = pose.c[touches, :, 0], other_pose.c[touches, :, 0]
            touches[touches] = _stand_on(body, other, *poses)
        support = surface_below(objects, places, name, floor)[1] or GROUND
        runs = np.cumsum(~vertical)
        touching = np.isin(runs, runs[touches]) | ((runs == 0) & (label == support))
        touching &= vertical & (np.min(height, axis=1) >= -CONTACT_GAP)
        active = (moving & ~touching)[:, None]
        frame = other_pose if other else None
        for slab in body.slabs:
            corners = placed_corners(pose, slab)
            shapes: list[Shape] = [Ground(floor)]
            if other:
                shapes = [Solid(each, slab.section.rounding) for each in other.slabs]
            for shape in shapes:
                yield pairs_with_shape(motion, corners, (name,), label, shape, frame, active=active)


def _stand_on(body: SolidObject, other: SolidObject, poses: Array, other_poses: Array) -> Flags:
    """Return for which poses (k, 5) the base of a body is, in plan, on the top of another one."""
    base = [slab.section for slab in body.slabs if slab.lower == body.lower]
    top = [slab.section for slab in other.slabs if slab.upper == other.upper]
    both = np.stack([poses, other_poses], axis=1)
    both[:, :, 2] = 0.0  # heights do not matter
    cases, index = np.unique(both, axis=0, return_inverse=True)
    gaps = [
        min(section_gap(lower, pose, upper, other_pose) for lower, upper in product(base, top))
        for pose, other_pose in cases
    ]
    return np.asarray(np.array(gaps)[index.ravel()] < 0.0)


# [m] Largest gap of ``worst`` below an attained distance, in addition to the distance of a cable
# from its links: bounds of catenaries, which are not polynomials, tighten slowly
CHAIN_TOLERANCE = 1e-3
# Number of a chain's points between links of equal length, which resolve steep ends. The cable
# deviates from the links by at most about 0.2 % of its length, where it bends the most, and much
# less elsewhere
BY_LENGTH = 20
# Number of a chain's points at equal horizontal distances, which resolve the lowest part
BY_PLACE = 16
# Where the last link ends that does not count for the cable's own drone, over the distance from
# which on the cable counts
OWN_SHARE = 0.75
ROUNDING_SHARE = 1e-9  # Rounding of that place, over the same distance
MAX_REACH = 0.25  # [m] Pieces on which a drone may move farther are split


def chains(q: Array, r: Array, length: Array) -> tuple[Array, Array]:
    """Return points of chains that replace hanging cables, and bounds of their distance.

    For cables between ends (spans, 3, degree + 1) of ``length`` (spans,) [m], these are (spans,
    links + 1, 3, degree + 1) and (spans, links) [m], for each link at all times of the span.
    """
    hanging = Hanging.between(q, r, length)
    return hanging.chain(hanging.places())


@dataclass(frozen=True, eq=False)
class Hanging:
    """Cables that hang between ends on spans of time."""

    start: Array  # (spans, 3, degree + 1) [m]
    offset: Enclosed  # of the ends (spans, 3) [m]
    length: Array  # (spans,) [m]
    cable: Catenary  # at mid time
    sigma: Interval  # of the steepness (spans,)

    @classmethod
    def between(cls, q: Array, r: Array, length: Array) -> Hanging:
        """Return the cables between ends (spans, 3, degree + 1) of ``length`` (spans,) [m]."""
        offset = Enclosed(r - q)
        cable = Catenary.between(Enclosed(q).middle, Enclosed(r).middle, length)
        return cls(q, offset, length, cable, steepness_of(offset, length))

    def places(self, *distances: float) -> Array:
        """Return parameters μ (links + 1, spans) of a chain's points.

        ``distances`` [m] from the start, along the cable, are among them.
        """
        spans = len(self.length)
        by_length = np.linspace(0.0, 1.0, BY_LENGTH + 1)[:, None]
        further = [np.minimum(x / self.length, 1.0)[None] for x in distances]
        by_length = np.concatenate([np.broadcast_to(by_length, (len(by_length), spans)), *further])
        by_place = (np.arange(BY_PLACE) + 0.5)[:, None] * (2.0 / BY_PLACE) - 1.0
        evenly = np.broadcast_to(by_place, (BY_PLACE, spans))
        return np.sort(np.concatenate([self.cable.parameter(by_length), evenly]), axis=0)

    def chain(self, mu: Array) -> tuple[Array, Array]:
        """Return points and bounds as ``chains``, at parameters μ (links + 1, spans)."""
        cable, offset, length = self.cable, self.offset, self.length
        level, skew = depth_terms(cable.sigma, mu)
        fraction = (0.5 * (1.0 + mu)).T[..., None, None]
        points = self.start[:, None] + fraction * offset.c[:, None]
        points[:, :, 2] -= (length * level).T[..., None] + skew.T[..., None] * offset.c[:, None, 2]
        drift = np.maximum(self.sigma.high - cable.sigma, cable.sigma - self.sigma.low)
        height = np.max(np.abs(offset.c[:, 2]), axis=-1)
        # In units of Λ / 2 sinh σ, it is a hyperbolic cosine, farthest from a parallel link.
        x = np.maximum(cable.sigma, SERIES_LIMIT)
        y = mu * x + np.arcsinh(cable.tilt)
        slope = np.diff(np.cosh(y), axis=0) / np.maximum(np.diff(y, axis=0), 1e-12)
        parallel = np.clip(np.arcsinh(slope), y[:-1], y[1:])
        bend = np.cosh(y[:-1]) + slope * (parallel - y[:-1]) - np.cosh(parallel)
        bend *= 0.5 * level_length(cable.rise, length) / np.sinh(x)
        errors = np.maximum(bend, 0.0) + ROUNDING * length + 0.25 * (length + height) * drift
        return points, errors.T

    def leads_away(self, mu: Array, distance: float) -> Flags:
        """Return which links (spans, links) lead down from the start, or begin near it, throughout.

        Near is up to a ``distance`` [m] along the cable.

        With σ the steepness and h the rise, the slope at μ is ``sinh(μ σ + artanh(h / L))``, and
        the length from the start is ``½ L (1 + sinh μσ / sinh σ) - ½ h (cosh σ - cosh μσ) / sinh
        σ``. Both fractions are monotone in σ.
        """
        rise, low, high = self.offset[2].range, self.sigma.low, self.sigma.high

        def steepness(sigma: Array) -> Array:
            """Return ``μσ``."""
            return np.asarray(mu * np.maximum(sigma, SERIES_LIMIT))

        def odd(sigma: Array) -> Array:
            """Return ``sinh μσ / sinh σ``."""
            x = np.maximum(sigma, SERIES_LIMIT)
            return np.asarray(np.sinh(mu * x) / np.sinh(x))

        def even(sigma: Array) -> Array:
            """Return ``(cosh σ - cosh μσ) / sinh σ``."""
            x = np.maximum(sigma, SERIES_LIMIT)
            return np.asarray((np.cosh(x) - np.cosh(mu * x)) / np.sinh(x))

        steepest = np.maximum(steepness(low), steepness(high))
        descending = steepest + np.arctanh(rise.high / self.length) <= 0.0
        largest_odd = np.maximum(odd(low), odd(high))
        ends = product((low, high), (rise.low, rise.high))
        by_largest_fall = np.maximum.reduce([-height * even(sigma) for sigma, height in ends])
        longest = 0.5 * (self.length * (1.0 + largest_odd) + by_largest_fall)
        x = np.maximum(self.cable.sigma, SERIES_LIMIT)  # at mid time
        by_rise = self.cable.rise * (np.cosh(x) - np.cosh(mu * x)) / np.sinh(x)
        place = 0.5 * (self.length * (1.0 + odd(self.cable.sigma)) - by_rise)
        near = longest <= distance
        near &= place <= OWN_SHARE * distance * (1.0 + ROUNDING_SHARE)
        return np.asarray((descending | near)[1:].T)


def split_long_pieces(drones: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the curves on pieces on which no drone moves farther than MAX_REACH."""
    reach = np.max(np.linalg.norm(np.ptp(drones.coefficients, axis=-1), axis=-1), axis=1)
    counts = np.maximum(1, np.ceil(reach / MAX_REACH)).astype(np.intp)
    if np.all(counts == 1):
        return drones
    runs = zip(drones.breaks[:-1], drones.breaks[1:], counts, strict=True)
    starts = np.concatenate([np.linspace(a, b, k, endpoint=False) for a, b, k in runs])
    return on_breaks(drones, np.append(starts, drones.breaks[-1]))


def cables_and_drones(motion: Motion) -> Moving:
    """Return the pairs of hanging cables and drones of other cables."""
    drones = split_long_pieces(motion.drones)
    return Moving(
        drones.breaks,
        cable_ends(drones.coefficients),
        drones.coefficients[:, :, None],
        position_margin(motion),
        lambda cables, drones: drones // 2 != cables,
        lengths=motion.team.cable_length,
        names=(cable_names(motion), motion.team.drone_names),
        formula=chain_distance,
        tolerance=CHAIN_TOLERANCE,
    )


OWN_DISTANCES = 2.0
"""Distance along a cable from its drone, over ``separation.cable``, from which on it counts there
where it rises again. Errors of drones add to that limit."""


def own_cable_distance(motion: Motion) -> float:
    """Return the distance along cables from which on they count for their own drones [m]."""
    requirements = motion.requirements
    limit = DISTANCES["cable_clearance"].limit(requirements.separation)
    return OWN_DISTANCES * (limit + 2.0 * requirements.limits.tube.level)


def drones_and_own_cables(motion: Motion) -> Moving:
    """Return the pairs of drones and their own hanging cables, where these rise again.

    The part that leads down from a drone never comes back to it.
    """
    drones = split_long_pieces(motion.drones)
    others = np.arange(motion.team.drones) ^ 1
    c, names = drones.coefficients, cable_names(motion)
    return Moving(
        drones.breaks,
        np.stack([c, c[:, others]], axis=2),
        c[:, :, None],
        position_margin(motion),
        matched=True,
        lengths=np.repeat(motion.team.cable_length, 2),
        names=([names[k // 2] for k in range(motion.team.drones)], motion.team.drone_names),
        formula=partial(chain_distance, own=own_cable_distance(motion)),
        tolerance=CHAIN_TOLERANCE,
    )


def cables_and_ground(motion: Motion) -> Moving:
    """Return the pairs of hanging cables and the ground.

    The ground is lowered so that cables at ``Requirements.ground_clearance`` keep the limit where
    heights are divided by ``height_ratio``: that division lengthens their distances only.
    """
    need = motion.requirements
    lowered = need.height_ratio * need.separation.cable - need.ground_clearance
    cables, ground = cables_and_drones(motion), Ground(need.floor - lowered)
    nowhere, names = np.zeros((len(cables.first), 1, 1, 3, 1)), (cables.names[0], (GROUND,))
    return replace(cables, second=nowhere, names=names, allowed=None, shape=ground)


def chain_distance(spans: PairSpans, shape: Shape | None = None, own: float = 0.0) -> Bound:
    """Return the distances of hanging cables from points, or from a half-space [m].

    With ``own``, points are the cables' starts, and only links count that rise beyond that distance
    along them [m].
    """
    (ends, point), shape = spans.ends, shape or spans.source.shape
    hanging = Hanging.between(ends[:, 0], ends[:, 1], spans.lengths)
    mu = hanging.places(*([OWN_SHARE * own] if own else []))
    points, errors = hanging.chain(mu)
    offsets = points - point  # (spans, links + 1, 3, degree + 1)
    if (ratio := spans.source.height_ratio) != 1.0:
        offsets[:, :, 2] /= ratio
        shape = shape.flattened(ratio)
    middle = Enclosed(offsets).middle
    along = shape.normals(np.stack([middle[:, :-1], middle[:, 1:]], axis=2))
    first, last = (np.einsum("sld,sldi->sli", along, c) for c in (offsets[:, :-1], offsets[:, 1:]))
    distances = np.minimum(first, last) - (errors + shape.support(along))[..., None]
    if own:
        distances[hanging.leads_away(mu, own)] = np.inf
    lower = Enclosed(np.min(distances, axis=1, keepdims=True), spans.source.margin).lower
    return Bound(np.maximum(lower.value, 0.0), lower.x)


def above_ground(motion: Motion) -> bool:
    """Return whether hanging cables would keep ``separation.cable`` from the ground."""
    limit = motion.requirements.separation.cable
    closest = nearest(lambda motion: [cables_and_ground(motion)])(motion, limit)
    return closest.worst >= with_tolerance(limit, "min", closest.size)


def cable_displacement(motion: Motion) -> Callable[[float], float]:
    """Return the largest displacement [m] of hanging cables as a function of tracking errors [m].

    Heights are divided by ``Requirements.height_ratio``.
    """
    ends = cable_ends(split_long_pieces(motion.drones).coefficients)
    cable_length = motion.team.cable_length
    offset = Enclosed(ends[:, :, 1] - ends[:, :, 0])
    across = offset.xy.norm_range
    rise = offset[2].norm_upper.value
    ratio = motion.requirements.height_ratio

    def displacement(radius: float) -> float:
        spans = (across.low, across.high)
        return float(np.max(displacement_bound(spans, rise, cable_length, radius, ratio)))

    return displacement


ENTRY_DISTANCE = 2e-5  # [m] Holding cables that come closer to an object's body enter it


def entry(spans: PairSpans) -> Bound:
    """Return zero where bodies come closer than ENTRY_DISTANCE, else infinity."""
    distances = gap(spans)
    return Bound(np.where(distances.value < ENTRY_DISTANCE, 0.0, np.inf), distances.x)


def _drones_and_taut(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and all parts of taut cables except the one that ends at the drone."""
    cables, table = taut_cables(motion), TautBodies.of(motion.team.layout)
    body = table.of_parts(cables.part)

    def foreign(i: Indices, j: Indices) -> Flags:
        flags: Flags = table.kind(i, body[j]) == CABLE
        return flags

    yield Moving.between(motion, drones_of(motion), cables, allowed=foreign)


def _drones_and_chords(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and the chords of other cables, projected from above."""
    flat, names = plan_points(motion), (motion.team.drone_names, cable_names(motion))
    yield Moving.of(motion, flat, cable_ends(flat), allowed=lambda i, k: i // 2 != k, names=names)


def _drones_and_drawn(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and the chords of other cables, and of drawn cables and the ground."""
    yield from _drones_and_chords(motion)
    yield cables_and_ground(motion)


def _drones_and_hanging(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of hanging cables and drones, those of other cables and their own, or the ground.

    Phases are searched separately: a search stops within millimetres, so its result depends on the
    time span.
    """
    for part in phase_parts(motion):
        yield cables_and_drones(part.motion)
        yield drones_and_own_cables(part.motion)
        yield cables_and_ground(part.motion)


def _drones_and_clasped(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and other cables that are being clasped or tightened.

    A pair of drones that turns about a clasp passes through the regions of both its cables. These
    drones keep their distance to the cables as they hang between their drones.
    """
    layout = motion.team.layout
    turning = np.zeros((layout.robots, 2 * layout.robots), dtype=np.bool_)
    turning[layout.ahead, 2 * layout.behind + 1] = turning[layout.behind, 2 * layout.ahead] = True
    for state in sorted(CLASPED_STATES & motion.cable_states):
        excepted = turning if state is CableState.CLASPING else np.zeros_like(turning)

        def counts(k: Indices, i: Indices, excepted: Flags = excepted) -> Flags:
            return np.asarray((i // 2 != k) & ~excepted[k, i])

        regions = replace(clasped_cables(motion), pieces=motion.in_states(frozenset({state})))
        yield Moving.between(motion, regions, drones_of(motion), allowed=counts)


ON_GROUND = frozenset({CableState.GROUND})
DRAWN = frozenset({CableState.DRAWN})

CABLE_CLEARANCE = CheckRule(
    "cable_clearance",
    "m",
    "min",
    lambda motion: DISTANCES["cable_clearance"].limit(motion.requirements.separation),
    (
        Evaluator(nearest(_drones_and_taut), TAUT_STATES, exported=True, formulas=(gap,)),
        Evaluator(nearest(_drones_and_chords), ON_GROUND, exported=True),
        Evaluator(nearest(_drones_and_drawn), DRAWN, exported=True),
        Evaluator(
            nearest(_drones_and_hanging),
            FREE_STATES - ON_GROUND - DRAWN,
            exported=True,
            formulas=(chain_distance,),
        ),
        Evaluator(
            nearest(_drones_and_clasped),
            FREE_STATES | TAUT_STATES,
            formulas=(upright_distance,),
        ),
    ),
    f"{OTHER_LEGS}, or allow a smaller separation.cable",
    "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    "length",
    remedy_at=partial(leg_remedy, distance="separation.cable"),
    approach=Approach(lambda gamma: 1.0 + largest_error(gamma), lambda _: 2.0),
)
"""Distance of cables from other drones and the ground; horizontal while they lie on it.

Cables that are drawn taut rise: their distances from drones are horizontal, too.
"""


def _drones_and_bodies(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and prisms, and of drones and objects."""
    drones = drones_of(motion)
    points, names = Enclosed(drones.corners), drones.names
    for prism in motion.requirements.keep_out:
        yield pairs_with_shape(motion, points, names, "", Solid(prism.slab))
    for name, each, pose in _objects(motion):
        for slab in each.slabs:
            yield pairs_with_shape(motion, points, names, name, Solid(slab), pose)


KEEP_OUT = CheckRule(
    "keep_out",
    "m",
    "min",
    lambda motion: motion.requirements.separation.radius if _obstacles(motion) else None,
    (Evaluator(nearest(_drones_and_bodies), exported=True, formulas=(gap, Solid.normals)),),
    "move the keep-out volumes or objects, fly farther from them, or lower separation.radius",
    approach=Approach(lambda _: 1.0, lambda _: 1.0),
)
"""Distance of drones from prisms and objects: at least the radius of their ellipsoids."""


def _taut_and_objects(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of taut cables and objects that they do not hold.

    The distance is zero where a cable enters an object that it holds, or the ground, and where it
    cuts a rim that rests on it higher than RIM_CUT. A rim above edges that grip a body bears on no
    cable.
    """
    taut = taut_cables(motion)
    part, names, points = taut.part, taut.names, Enclosed(taut.corners)
    cables = part // 3
    # No part is lower than its ends and the bends of edges wrapped around an object.
    holding = np.array([phase.hold is not None for phase in motion.phases] + [False])
    active = np.repeat(holding[motion.phase_of_piece][:, None], len(part), axis=1)
    ground = Ground(motion.requirements.floor - 2.0 * ENTRY_DISTANCE)
    yield pairs_with_shape(motion, points, names, GROUND, ground, active=active, formula=entry)
    for name, each, pose in _objects(motion):
        held = [p.hold.cables if p.hold and p.hold.object == name else () for p in motion.phases]
        touching = np.array([np.isin(cables, each) for each in [*held, ()]])
        active = ~touching[motion.phase_of_piece]
        gripped = held_pieces(motion, name, HoldBy.GRIP)[:, None] & ~active
        # Edges may touch a body that they grip; what rests on cables is above them there.
        inner = (gripped & (part % 3 != 1)) if each.stem is None else ~active
        inner &= ~gripped | (part % 3 != 1)
        for slab, holding in zip(each.slabs, (inner, gripped), strict=False):
            shape = Solid(slab)
            yield pairs_with_shape(
                motion, points, names, name, shape, pose, active=holding, formula=entry
            )
        if each.rim is not None:
            height = each.rim.height + RIM_CUT
            bent = held_pieces(motion, name, HoldBy.REST)[:, None] & ~active
            cut = Solid(Slab(each.rim.section, height, height))
            yield pairs_with_shape(
                motion, points, names, name, cut, pose, active=bent, formula=entry
            )
        for slab in each.slabs:
            yield pairs_with_shape(motion, points, names, name, Solid(slab), pose, active=active)


def _hanging_and_objects(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables that hang, or lie on the ground, and objects at rest.

    Horizontally, a cable is on its chord; a hanging one may also pass above an object.
    """
    for part in phase_parts(motion):
        span, cables = part.motion, cables_and_drones(part.motion)
        ends, names = Enclosed(cables.first), cables.names[0]
        options: dict[str, Any] = {
            "breaks": cables.breaks,
            "lengths": cables.lengths,
            "tolerance": CHAIN_TOLERANCE,
        }
        for name, each, pose in _objects(span):
            rest = Enclosed(pose.c[:1, :, :1])
            for slab in each.slabs:
                on_chord = part.phase.state in ON_GROUND | DRAWN
                options["formula"] = gap if on_chord else partial(beside_or_above, top=slab.upper)
                yield pairs_with_shape(span, ends, names, name, from_above(slab), rest, **options)


def _clasped_and_objects(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of objects and cables that are being clasped or tightened."""
    if not motion.cable_states & CLASPED_STATES:
        return
    sheets, names = cable_sheets(motion), cable_names(motion)
    prisms, active = Enclosed(sheets.prisms), np.repeat(sheets.clasped[:, None], len(names), axis=1)
    for name, each, pose in _objects(motion):
        for slab in each.slabs:
            shape = Solid(slab, 0.0)
            yield pairs_with_shape(motion, prisms, names, name, shape, pose, active=active)


def beside_or_above(spans: PairSpans, top: float) -> Bound:
    """Return the distance of hanging cables from a body, horizontal or above it [m]."""
    return largest_of([gap(spans), chain_distance(spans, Ground(top))])


def _rim_remedy(motion: Motion, check: Check) -> str:
    """Return what to do about legs that cut a rim which rests on them; empty for others."""
    piece = int(np.searchsorted(motion.drones.breaks, check.time, side="right")) - 1
    piece = min(max(piece, 0), motion.drones.pieces - 1)
    hold = motion.phases[motion.phase_of_piece[piece]].hold
    is_rest = hold is not None and hold.by is HoldBy.REST and hold.object in check.where
    is_holding = any(name in check.where for name in cable_names(motion))
    return RIM_REMEDY if check.worst == 0.0 and is_rest and is_holding else ""


OBJECT_CLEARANCE = CheckRule(
    "object_clearance",
    "m",
    "min",
    lambda motion: (
        DISTANCES["object_clearance"].limit(motion.requirements.separation)
        if motion.requirements.objects
        else None
    ),
    (
        Evaluator(nearest(_taut_and_objects), TAUT_STATES, exported=True, formulas=(gap,)),
        Evaluator(nearest(moving_object_pairs), TAUT_STATES),
        Evaluator(
            nearest(_hanging_and_objects),
            FREE_STATES - DRAWN,
            exported=True,
            formulas=(beside_or_above,),
        ),
        Evaluator(nearest(_hanging_and_objects), DRAWN, exported=True),
        Evaluator(nearest(_clasped_and_objects), FREE_STATES | TAUT_STATES),
    ),
    "fly higher over objects or farther away, lift the held one higher, use shorter cables, place "
    "it higher, or allow a smaller separation.object",
    "form and release farther from objects or higher above them, or allow a smaller "
    "separation.object",
    remedy_at=_rim_remedy,
    approach=Approach(largest_error, largest_error),
)
"""Distance of cables and held objects from other objects.

Cables may touch an object that they hold, but not enter it; the check ``grip`` verifies wrapped
edges.
"""


@cached
def on_floor_pieces(motion: Motion) -> Flags:
    """Return on which pieces drones rest on the floor, take off or land (pieces, 2n)."""
    c, floor = motion.drones.coefficients, motion.requirements.floor
    upright = np.all(np.ptp(c[:, :, :2], axis=-1) <= CONTACT_GAP, axis=-1)
    at_floor = upright & np.any(np.abs(c[:, :, 2, [0, -1]] - floor) <= CONTACT_GAP, axis=-1)
    runs = np.cumsum(~upright, axis=0) * len(c[0]) + np.arange(len(c[0]))
    return np.asarray(upright & np.isin(runs, runs[at_floor]))


def _wall_gap(spans: MotionSpans, x: Array, lowered: Array | float, reach: float = 0.0) -> Bound:
    """Return the minimum distance to a wall of points x (spans, points, 3, degree + 1) [m].

    Points have a horizontal radius ``reach``, and are lowered by ``lowered`` (spans, points) [m].
    """
    arena = known(spans.source.requirements.arena)
    above, below = x - arena.lower[:, None], arena.upper[:, None] - x
    above[..., 2, :] -= np.asarray(lowered)[..., None]
    for wall in (above, below):
        wall[..., :2, :] -= reach
        wall[..., 2, :] /= spans.source.requirements.height_ratio
    inside = np.concatenate([above, below], axis=2).reshape(len(x), -1, x.shape[-1])
    size = magnitude(spans.source) + float(np.max(np.abs([arena.lower, arena.upper])))
    return Enclosed(np.min(inside, axis=1, keepdims=True), ROUNDING * size).lower


def drone_wall_gap(spans: Drones, *, on_floor: bool = True) -> Bound:
    """Return the minimum distance of drones to a wall [m].

    With ``on_floor``, the floor also counts for drones that rest there, take off or land.
    """
    x = spans.read(spans.source.drones.coefficients)[:, None]
    free: Any = 0.0
    if not on_floor:
        free = UNBOUNDED * on_floor_pieces(spans.source)[spans.piece, spans.item, None]
    return _wall_gap(spans, x, -free)


class Parts(MotionSpans):
    """Spans of the straight parts of taut cables."""

    @classmethod
    def names(cls, motion: Motion) -> Sequence[str]:
        """Return the parts' names."""
        return part_names(motion, cable_parts(motion)[1])


@cached
def _part_sags(motion: Motion) -> list[Array]:
    """Return half of the weight per length of parts [N/m] and their tension [N], (pieces, …)."""
    cable, kind = np.divmod(cable_parts(motion)[1], 3)
    of_legs, of_edges = leg_sags(motion), edge_sags(motion)
    index = np.where(kind == 1, motion.team.drones + cable, 2 * cable + kind // 2)
    pairs = zip(of_legs, of_edges, strict=True)
    return [joined_arrays(pair, axis=1)[:, index] for pair in pairs]


def _part_wall_gap(spans: Parts) -> Bound:
    """Return the minimum distance of taut cables to a wall [m].

    A straight part of length s sags by ``ρ g s² / 8 T`` at its middle.
    """
    ends = spans.read(cable_parts(spans.source)[0])
    first, along = ends[:, :1], ends[:, 1:] - ends[:, :1]
    sag: Array = np.zeros(len(spans))
    if spans.source.team.cable_density > 0.0:
        half, tension = spans.scalars(_part_sags(spans.source))
        chord = Enclosed(along[:, 0]).norm_upper.value
        sag = half.upper.value / tension.lower.value * chord**2 / 4.0
    bent = (FRACTIONS[:, 0, 0] > 0.0) & (FRACTIONS[:, 0, 0] < 1.0)
    return _wall_gap(spans, first + FRACTIONS * along, sag[:, None] * bent)


def _object_wall_gap(motion: Motion, _: float) -> WorstCase:
    """Return the minimum distance of a held object to a wall or the ceiling [m]."""
    cases = [WorstCase(math.inf, 0.0)]
    for name, body, pose in _objects(motion):
        held = held_pieces(motion, name, HoldBy.REST) | held_pieces(motion, name, HoldBy.GRIP)
        for slab in body.slabs:
            corners = placed_corners(pose, slab)
            reach = slab.section.rounding + float(np.max(corners.r))

            def room(spans: MotionSpans, c: Array = corners.c, reach: float = reach) -> Bound:
                return _wall_gap(spans, spans.read(c), -UNBOUNDED, reach)

            spans = MotionSpans.all_of(motion, motion.drones.breaks, 1, held)
            smallest = worst(spans, room, "min")
            cases.append(WorstCase(smallest.worst, smallest.time, (name,)))
    return min(cases, key=lambda each: each.worst)


ARENA_REMEDY = "enlarge the arena, or keep the hitch farther from its walls"


def _arena_remedy(motion: Motion, _check: Check) -> str:
    """Return the suggested change, and whether drones were inside with x and y exchanged."""
    if (arena := motion.requirements.arena) is None:
        return ""
    places = motion.drones.at(motion.drones.breaks)[..., :2]

    def are_inside(level: Array) -> bool:
        return bool(np.all((level >= arena.lower[:2]) & (level <= arena.upper[:2])))

    exchanged = not are_inside(places) and are_inside(places[..., ::-1])
    return ARENA_REMEDY + EXCHANGED * exchanged


ARENA = CheckRule(
    "arena",
    "m",
    "min",
    lambda motion: None if motion.requirements.arena is None else 0.0,
    (
        Evaluator(WorstOverSpans(Drones, drone_wall_gap, "min", magnitude), exported=True),
        Evaluator(WorstOverSpans(Parts, _part_wall_gap, "min", magnitude), TAUT_STATES),
        Evaluator(_object_wall_gap, TAUT_STATES),
    ),
    ARENA_REMEDY,
    remedy_at=_arena_remedy,
    exported_limit=EXPORTED_LIMIT,
    approach=Approach(largest_error, lambda _: 1.0),
)
"""Drones, taut cables and held objects stay in the arena; ``cable_clearance`` and
``object_clearance`` keep hanging cables and objects above its floor."""
