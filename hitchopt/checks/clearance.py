"""Clearances of drones and cables from walls, other cables, prisms and objects.

Checks ``arena``, ``cable_clearance``, ``keep_out`` and ``object_clearance``.

Taut cables are straight. A cable that hangs between its drones is a catenary. During take-off and
landing, cables lie on the ground at least in part, in between their drones.

On a span of time a hanging cable is replaced by a chain through points of the catenary at fixed μ,
with the steepness of mid time and the height difference of the polynomials. The distance of the
catenary from that chain is at most a bound on its bend between the points, plus ¼ (L + |h|) times
the deviation of its steepness from that of mid time (see ``hitchopt.hitch.catenary``).

Objects are slabs, convex sections between two heights. Their support functions, and the direction
out of one to the nearest point of a moving body, are all that ``hitchopt.checks.distances`` needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Check, within, worst_of
from hitchopt.checks.distances import (
    GROUND,
    TALL,
    TOUCHING,
    Flags,
    Ground,
    Moving,
    PairSpans,
    Shape,
    cable_ends,
    gap,
    nearest,
    plan_points,
)
from hitchopt.checks.drones import Drones, edge_sags, leg_sags, steepness_of
from hitchopt.checks.objects import placed, seen_from
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, WorstOverSpans
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    cable_names,
    cable_parts,
    cached,
    concatenated,
    magnitude,
    part_names,
    phase_parts,
    position_margin,
)
from hitchopt.geometry.vectors import dot, unit
from hitchopt.hitch.catenary import (
    SERIES_LIMIT,
    Catenary,
    depth_terms,
    displacement_bound,
    level_length,
)
from hitchopt.hitch.pairs import CABLE, PAIRS, Bodies
from hitchopt.hitch.requirements import Arena
from hitchopt.motion.chapters import parts_of
from hitchopt.motion.loads import held_pieces
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, HoldBy, Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import STILL, TOUCH, sections_apart, surface_below
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, Indices

# [m] Exported curves may pass a wall by this much, as of a drone at rest on the floor
EXPORTED_LIMIT = -1e-4
SHARES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])[:, None, None]
"""Places along a span: the polygon through its sagged points there is below the parabola."""

HALVINGS = 25  # Halvings of a segment in search of its nearest point, to 3e-8 of its length


@dataclass(frozen=True, eq=False)
class Solid(Shape):
    """A slab, as an obstacle for points, segments and other upright slabs.

    Another slab is given by the corners of its core, those of its floor first; its ``rounding`` is
    added to this slab.
    """

    slab: Slab
    rounding: float | None = None

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3)."""
        reach: Array = self.slab.support(directions)
        if self.rounding is not None:
            reach = reach + self.rounding * np.linalg.norm(directions[..., :2], axis=-1)
        return reach

    def towards(self, corners: Array) -> Array:
        """Return the directions (…, 3) out of it to bodies with corners (…, 1, 2 or 2 m, 3)."""
        if self.rounding is not None:
            return self._towards_slab(corners, self.rounding)
        first, last = corners[..., 0, :], corners[..., -1, :]
        along, share = last - first, np.zeros(first.shape[:-1])
        if corners.shape[-2] > 1:
            # The distance to a convex body is convex along a segment: most are nearest at an end.
            rising = [dot(self.slab.clearance(end).normals, along) > 0.0 for end in (first, last)]
            inner = ~rising[0] & rising[1]
            begin, slope = first[inner], along[inner]
            lower, upper = np.zeros(len(begin)), np.ones(len(begin))
            for _ in range(HALVINGS if len(begin) else 0):
                middle = 0.5 * (lower + upper)
                normals = self.slab.clearance(begin + middle[:, None] * slope).normals
                passed = dot(normals, slope) > 0.0
                lower, upper = np.where(passed, lower, middle), np.where(passed, middle, upper)
            share[~rising[1]], share[inner] = 1.0, upper
        return self.slab.clearance(first + share[..., None] * along).normals

    def _towards_slab(self, corners: Array, rounding: float) -> Array:
        """Return the directions out of it to upright slabs, level if a side is nearest."""
        floor = corners[..., : corners.shape[-2] // 2, :2]
        sides = np.stack([floor, np.roll(floor, -1, axis=-2)], axis=-2)
        flat = np.concatenate([sides, np.zeros_like(sides[..., :1])], axis=-1)
        normals = from_above(self.slab).towards(flat)[..., :2]  # (…, sides, 2)
        apart = np.min(np.einsum("...sd,...kd->...sk", normals, floor), axis=-1)
        apart = apart - self.slab.section.support(normals) - rounding
        best = np.argmax(apart, axis=-1)[..., None]
        level = np.maximum(np.take_along_axis(apart, best, axis=-1), 0.0)
        level = level * np.take_along_axis(normals, best[..., None], axis=-2)[..., 0, :]
        upward = np.maximum(corners[..., :1, 2] - self.slab.upper, 0.0)
        upward = upward - np.maximum(self.slab.lower - corners[..., -1:, 2], 0.0)
        return unit(np.concatenate([level, upward], axis=-1))


def from_above(slab: Slab) -> Solid:
    """Return a body as seen from above, regardless of heights."""
    return Solid(Slab(slab.section, -TALL, TALL))


def pairs_with_shape(
    motion: Motion,
    points: Enclosed,
    names: Sequence[str],
    label: str,
    shape: Shape,
    pose: Enclosed | None = None,
    **further: Any,
) -> Moving:
    """Return the pairs of moving points and a named shape; ``further`` as in Moving.

    If a pose is given, the shape is in its frame.
    """
    seen = points if pose is None else seen_from(pose, points)
    size = magnitude(motion) + sum(slab.size for slab in _obstacles(motion))
    margin = ROUNDING * size + float(np.max(seen.r))
    breaks, nowhere = motion.drones.breaks, np.zeros((len(seen.c), 1, 1, 3, 1))
    options: dict[str, Any] = {"breaks": breaks, "names": (names, (label,))} | further
    return Moving(first=seen.c, second=nowhere, margin=margin, shape=shape, **options)


def _obstacles(motion: Motion) -> list[Slab]:
    """Return the slabs of all prisms and objects."""
    prisms, objects = motion.requirements.keep_out, motion.requirements.objects.values()
    return [prism.slab for prism in prisms] + [slab for each in objects for slab in each.slabs]


def _placed(motion: Motion) -> Iterator[tuple[str, SolidObject, Enclosed]]:
    """Yield the names of objects, the objects, and their poses (pieces,)."""
    poses = motion.object_poses.coefficients
    for index, (name, each) in enumerate(motion.requirements.objects.items()):
        yield name, each, Enclosed(poses[:, index])


def carried(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of moving objects and the ground, and of moving objects and all others.

    An object may touch the support that it rises from straight up, or descends to straight down: in
    a run of such pieces one of which begins or ends with it standing there, and in the first run
    the support below it at the motion's start.
    """
    objects, floor = motion.requirements.objects, motion.requirements.floor
    places, everything = motion.object_poses.coefficients[0, :, :, 0], [*_placed(motion)]
    for (name, body, pose), (label, other, there) in product(
        everything, [*everything, (GROUND, None, Enclosed(np.zeros((1, 5, 1))))]
    ):
        moved = np.ptp(pose.c, axis=-1)
        going = np.any(moved > STILL, axis=-1)
        if name == label or not np.any(going):
            continue
        upright = np.max(moved[:, [0, 1, 3, 4]], axis=-1) <= TOUCH
        height = pose.c[:, 2] + body.lower - there.c[:, 2] - (other.upper if other else floor)
        stands = upright & np.any(np.abs(height[:, [0, -1]]) <= TOUCH, axis=1)
        base = [slab.section for slab in body.slabs if slab.lower == body.lower]
        top = [slab.section for slab in other.slabs if slab.upper == other.upper] if other else []
        for piece in np.flatnonzero(stands) if top else ():
            ends = pose.c[piece, :, 0], there.c[piece, :, 0]
            apart = [sections_apart(a, ends[0], b, ends[1]) for a, b in product(base, top)]
            stands[piece] = min(apart) < 0.0
        below, runs = surface_below(objects, places, name, floor)[1] or GROUND, np.cumsum(~upright)
        touching = np.isin(runs, runs[stands]) | ((runs == 0) & (label == below))
        touching &= upright & (np.min(height, axis=1) >= -TOUCH)
        counted = (going & ~touching)[:, None]
        for slab in body.slabs:
            seen, shapes = placed(pose, slab), list[Shape]([Ground(floor)])
            if other:
                shapes = [Solid(each, slab.section.rounding) for each in other.slabs]
            for shape in shapes:
                frame = there if other else None
                yield pairs_with_shape(motion, seen, (name,), label, shape, frame, counted=counted)


# [m] Largest gap of ``worst`` below an attained distance, in addition to the distance of a cable
# from its links: bounds of catenaries, which are no polynomials, tighten slowly with spans' lengths
CHAIN_TOLERANCE = 1e-3
# A chain's points: so many links of equal length, which follow a cable down its steep ends, and
# so many more points evenly across, which follow it around where it is lowest. It is off them by
# about 0.2 % of its length at most, where it bends the most, and much less elsewhere
BY_LENGTH, BY_PLACE = 20, 16
MAX_REACH = 0.25  # [m] Pieces on which a drone may move farther are cut first


def chains(q: Array, r: Array, length: Array) -> tuple[Array, Array]:
    """Return points of chains that replace hanging cables, and bounds of their distance.

    For cables between ends (spans, 3, degree + 1), ``length`` (spans,) [m]: (spans, links + 1, 3,
    degree + 1) and (spans, links) [m], from each link at all times of the span.
    """
    offset = Enclosed(r - q)
    cable = Catenary.between(Enclosed(q).middle, Enclosed(r).middle, length)
    by_length = cable.parameter(np.linspace(0.0, 1.0, BY_LENGTH + 1)[:, None])
    by_place = (np.arange(BY_PLACE) + 0.5)[:, None] * (2.0 / BY_PLACE) - 1.0
    evenly = np.broadcast_to(by_place, (BY_PLACE, len(length)))
    mu = np.sort(np.concatenate([by_length, evenly]), axis=0)  # (links + 1, spans)
    level, skew = depth_terms(cable.sigma, mu)
    share = (0.5 * (1.0 + mu)).T[..., None, None]
    points = q[:, None] + share * offset.c[:, None]
    points[:, :, 2] -= (length * level).T[..., None] + skew.T[..., None] * offset.c[:, None, 2]
    sigma = steepness_of(offset, length)
    drift = np.maximum(sigma.high - cable.sigma, cable.sigma - sigma.low)
    height = np.max(np.abs(offset.c[:, 2]), axis=-1)
    # In units of Λ / 2 sinh σ it is a hyperbolic cosine, farthest off a link where parallel to it.
    x = np.maximum(cable.sigma, SERIES_LIMIT)
    y = mu * x + np.arcsinh(cable.tilt)
    slope = np.diff(np.cosh(y), axis=0) / np.maximum(np.diff(y, axis=0), 1e-12)
    parallel = np.clip(np.arcsinh(slope), y[:-1], y[1:])
    bend = np.cosh(y[:-1]) + slope * (parallel - y[:-1]) - np.cosh(parallel)
    bend *= 0.5 * level_length(cable.rise, length) / np.sinh(x)
    off = np.maximum(bend, 0.0) + ROUNDING * length + 0.25 * (length + height) * drift
    return points, off.T


def cut(drones: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the curves on pieces so short that no drone moves by MAX_REACH on any of them."""
    reach = np.max(np.linalg.norm(np.ptp(drones.coefficients, axis=-1), axis=-1), axis=1)
    counts = np.maximum(1, np.ceil(reach / MAX_REACH)).astype(np.intp)
    if np.all(counts == 1):
        return drones
    runs = zip(drones.breaks[:-1], drones.breaks[1:], counts, strict=True)
    starts = np.concatenate([np.linspace(a, b, k, endpoint=False) for a, b, k in runs])
    return on_breaks(drones, np.append(starts, drones.breaks[-1]))


def cables_and_drones(motion: Motion) -> Moving:
    """Return the pairs of hanging cables and drones of other cables."""
    drones = cut(motion.drones)
    return Moving(
        drones.breaks,
        cable_ends(drones.coefficients),
        drones.coefficients[:, :, None],
        position_margin(motion),
        lambda cables, drones: drones // 2 != cables,
        lengths=motion.team.cable_length,
        names=(cable_names(motion), motion.team.drone_names),
        formula=hung_gap,
        tolerance=CHAIN_TOLERANCE,
    )


def cables_and_ground(motion: Motion) -> Moving:
    """Return the pairs of hanging cables and the ground."""
    cables, ground = cables_and_drones(motion), Ground(motion.requirements.floor)
    nowhere, names = np.zeros((len(cables.first), 1, 1, 3, 1)), (cables.names[0], (GROUND,))
    return replace(cables, second=nowhere, names=names, allowed=None, shape=ground)


def hung_gap(spans: PairSpans, shape: Shape | None = None) -> Bound:
    """Return the distances of hanging cables to points, or to a half-space below a height [m]."""
    (ends, point), shape = spans.ends, shape or spans.source.shape
    points, off = chains(ends[:, 0], ends[:, 1], spans.lengths)
    apart = points - point  # (spans, links + 1, 3, degree + 1)
    here = Enclosed(apart).middle
    along = shape.towards(np.stack([here[:, :-1], here[:, 1:]], axis=2))
    first, last = (np.einsum("sld,sldi->sli", along, c) for c in (apart[:, :-1], apart[:, 1:]))
    least = np.minimum(first, last) - (off + shape.support(along))[..., None]
    lower = Enclosed(np.min(least, axis=1, keepdims=True), spans.source.margin).below
    return Bound(np.maximum(lower.value, 0.0), lower.x)


def above_ground(motion: Motion) -> bool:
    """Return whether cables, if all hung free, would keep ``separation.cable`` off the ground."""
    limit = motion.requirements.separation.cable
    closest = nearest(lambda motion: [cables_and_ground(motion)])(motion, limit)
    return closest.worst >= within(limit, "min", closest.size)


def moved_by(motion: Motion) -> Callable[[float], float]:
    """Return by how much drones and hanging cables approach [m] if drones are off by r [m]."""
    ends, L = cable_ends(cut(motion.drones).coefficients), motion.team.cable_length
    offset = Enclosed(ends[:, :, 1] - ends[:, :, 0])
    across, height = offset.level.norm_range, offset[2].norm_above.value

    def moved(radius: float) -> float:
        shift = displacement_bound((across.low, across.high), height, L, radius)
        return radius + float(np.max(shift))

    return moved


CONTACT = 2e-5  # [m] Cables that hold an object enter it if they come closer to its body


def entering(spans: PairSpans) -> Bound:
    """Return zero where bodies come closer than CONTACT, else infinity."""
    distances = gap(spans)
    return Bound(np.where(distances.value < CONTACT, 0.0, np.inf), distances.x)


def _past_taut(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and all parts of taut cables but the one that ends at the drone."""
    (corners, part), bodies = cable_parts(motion), Bodies.of(motion.team.layout)
    body = bodies.of_parts(part)

    def apart(i: Indices, j: Indices) -> Flags:
        flags: Flags = bodies.kind(i, body[j]) == CABLE
        return flags

    drones = motion.drones.elevated(bernstein.degree(corners)).coefficients
    cables = cable_names(motion)
    names = motion.team.drone_names, [cables[k] for k in part // 3]
    yield Moving.of(motion, drones[:, :, None], corners, allowed=apart, names=names)


def _past_chords(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and the chords of other cables, as seen from above."""
    flat, names = plan_points(motion), (motion.team.drone_names, cable_names(motion))
    yield Moving.of(motion, flat, cable_ends(flat), allowed=lambda i, k: i // 2 != k, names=names)


def _past_hanging(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones, or the ground, and hanging cables of others.

    Phases are searched separately: a search stops within millimetres, so its result depends on the
    span of time.
    """
    for part in phase_parts(motion):
        yield cables_and_drones(part.motion)
        yield cables_and_ground(part.motion)


LYING = frozenset({CableState.GROUND})

CABLE_CLEARANCE = CheckRule(
    "cable_clearance",
    "m",
    "min",
    lambda motion: max(PAIRS[CABLE].limit(motion.requirements.separation), TOUCHING),
    (
        Evaluator(nearest(_past_taut), HITCHED_STATE, exported=True, shown=(gap,)),
        Evaluator(nearest(_past_chords), LYING, exported=True),
        Evaluator(nearest(_past_hanging), FREE_STATES - LYING, exported=True, shown=(hung_gap,)),
    ),
    "give the drones other leg lengths (of a longer cable or a smaller polygon), "
    "or a smaller separation.cable",
    "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    "length",
)
"""Distance of cables from other drones and the ground; while they lie on it, seen from above."""


def _drones_past(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and prisms, and of drones and objects."""
    points, names = Enclosed(motion.drones.coefficients[:, :, None]), motion.team.drone_names
    for prism in motion.requirements.keep_out:
        yield pairs_with_shape(motion, points, names, "", Solid(prism.slab))
    for name, each, pose in _placed(motion):
        for slab in each.slabs:
            yield pairs_with_shape(motion, points, names, name, Solid(slab), pose)


KEEP_OUT = CheckRule(
    "keep_out",
    "m",
    "min",
    lambda motion: motion.requirements.separation.radius if _obstacles(motion) else None,
    (Evaluator(nearest(_drones_past), exported=True, shown=(gap, Solid.towards)),),
    "move the keep-out volumes or objects, fly farther from them, or lower separation.radius",
)
"""Distance of drones from prisms and objects: at least the radius of their ellipsoids."""


def _cables_past(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of taut cables and objects that they do not hold.

    The distance is zero where a cable enters an object that it holds, or the ground.
    """
    corners, part = cable_parts(motion)
    cables, points = part // 3, Enclosed(corners)
    whole = cable_names(motion)
    names = [whole[k] for k in cables]
    # No part is lower than its ends and the bends of edges wrapped around an object.
    holding = np.array([phase.hold is not None for phase in motion.phases] + [False])
    on = np.repeat(holding[motion.phase_of_piece][:, None], len(part), axis=1)
    ground = Ground(motion.requirements.floor - 2.0 * CONTACT)
    yield pairs_with_shape(motion, points, names, GROUND, ground, counted=on, formula=entering)
    for name, each, pose in _placed(motion):
        held = [p.hold.cables if p.hold and p.hold.object == name else () for p in motion.phases]
        touching = np.array([np.isin(cables, each) for each in [*held, ()]])
        counted = ~touching[motion.phase_of_piece]
        if each.stem is not None:  # below a flat tray a cable is off it
            gripped = held_pieces(motion, name, HoldBy.GRIP)[:, None]  # else edges stay out of it
            inner = (~gripped | (part % 3 != 1)) & ~counted
            body = Solid(each.slabs[0])
            yield pairs_with_shape(
                motion, points, names, name, body, pose, counted=inner, formula=entering
            )
        for slab in each.slabs:
            yield pairs_with_shape(motion, points, names, name, Solid(slab), pose, counted=counted)


def _hanging_past(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables that hang, or lie on the ground, and objects at rest.

    Seen from above, a cable is on its chord; a hanging one may also pass above an object.
    """
    for part in phase_parts(motion):
        here, hung = part.motion, cables_and_drones(part.motion)
        ends, names = Enclosed(hung.first), hung.names[0]
        options: dict[str, Any] = {
            "breaks": hung.breaks,
            "lengths": hung.lengths,
            "tolerance": CHAIN_TOLERANCE,
        }
        for name, each, pose in _placed(here):
            still = Enclosed(pose.c[:1, :, :1])
            for slab in each.slabs:
                lies = part.phase.state is CableState.GROUND
                options["formula"] = gap if lies else partial(over, top=slab.upper)
                yield pairs_with_shape(here, ends, names, name, from_above(slab), still, **options)


def over(spans: PairSpans, top: float) -> Bound:
    """Return the distance of hanging cables from a body, sideways or above [m]."""
    return largest_of([gap(spans), hung_gap(spans, Ground(top))])


OBJECT_CLEARANCE = CheckRule(
    "object_clearance",
    "m",
    "min",
    lambda motion: (
        max(motion.requirements.separation.object, TOUCHING)
        if motion.requirements.objects
        else None
    ),
    (
        Evaluator(nearest(_cables_past), HITCHED_STATE, exported=True, shown=(gap,)),
        Evaluator(nearest(carried), HITCHED_STATE),
        Evaluator(nearest(_hanging_past), FREE_STATES, exported=True, shown=(over,)),
    ),
    "fly higher over objects or farther from them, lift the held one higher, use shorter cables "
    "or stand it higher where the ground is near, or allow a smaller separation.object",
    "form and release farther from objects or higher above them, or allow a smaller "
    "separation.object",
)
"""Distance of cables and held objects from other objects.

Cables may touch an object that they hold, but not enter it; the check ``grip`` verifies how edges
are wrapped.
"""


@cached
def standing(motion: Motion) -> Flags:
    """Return (pieces, 2n) whether drones rest on the floor, rise from it or sink to it upright."""
    c, floor = motion.drones.coefficients, motion.requirements.floor
    upright = np.all(np.ptp(c[:, :, :2], axis=-1) <= TOUCH, axis=-1)
    down = upright & np.any(np.abs(c[:, :, 2, [0, -1]] - floor) <= TOUCH, axis=-1)
    run = np.cumsum(~upright, axis=0) * len(c[0]) + np.arange(len(c[0]))
    standing: Flags = upright & np.isin(run, run[down])
    return standing


def _room(spans: MotionSpans, x: Array, lowered: Array | float, reach: float = 0.0) -> Bound:
    """Return the smallest distance to a wall of points x (spans, points, 3, degree + 1) [m].

    Points have a radius ``reach`` seen from above, and are ``lowered`` (spans, points) further [m].
    """
    arena = spans.source.requirements.arena
    assert arena is not None
    over, under = x - arena.lower[:, None], arena.upper[:, None] - x
    over[..., 2, :] -= np.asarray(lowered)[..., None]
    for wall in (over, under):
        wall[..., :2, :] -= reach
    inside = np.concatenate([over, under], axis=2).reshape(len(x), -1, x.shape[-1])
    size = magnitude(spans.source) + float(np.max(np.abs([arena.lower, arena.upper])))
    return Enclosed(np.min(inside, axis=1, keepdims=True), ROUNDING * size).below


def drones_room(spans: Drones, *, landed: bool = True) -> Bound:
    """Return the smallest distance of drones to a wall [m].

    With ``landed``, the floor counts for drones that rest there, take off or land, too.
    """
    x = spans.read(spans.source.drones.coefficients)[:, None]
    free: Any = 0.0
    if not landed:
        free = TALL * standing(spans.source)[spans.piece, spans.item, None]
    return _room(spans, x, -free)


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
    return [concatenated(pair, axis=1)[:, index] for pair in pairs]


def _parts_room(spans: Parts) -> Bound:
    """Return the smallest distance of taut cables to a wall [m].

    A span of length s sags ``ρ g s² / 8 T`` below its chord, half way.
    """
    ends = spans.read(cable_parts(spans.source)[0])
    first, along = ends[:, :1], ends[:, 1:] - ends[:, :1]
    deep: Array = np.zeros(len(spans))
    if spans.source.team.cable_density > 0.0:
        half, tension = spans.scalars(_part_sags(spans.source))
        chord = Enclosed(along[:, 0]).norm_above.value
        deep = half.above.value / tension.below.value * chord**2 / 4.0
    bent = (SHARES[:, 0, 0] > 0.0) & (SHARES[:, 0, 0] < 1.0)
    return _room(spans, first + SHARES * along, deep[:, None] * bent)


def _held_room(motion: Motion, _: float) -> WorstCase:
    """Return the smallest distance of a held object to a wall or the ceiling [m]."""
    cases = [WorstCase(math.inf, 0.0)]
    for name, body, pose in _placed(motion):
        held = held_pieces(motion, name, HoldBy.REST) | held_pieces(motion, name, HoldBy.GRIP)
        for slab in body.slabs:
            corners = placed(pose, slab)
            reach = slab.section.rounding + float(np.max(corners.r))

            def room(spans: MotionSpans, c: Array = corners.c, reach: float = reach) -> Bound:
                return _room(spans, spans.read(c), -TALL, reach)

            spans = MotionSpans.all_of(motion, motion.drones.breaks, 1, held)
            least = worst(spans, room, "min")
            cases.append(WorstCase(least.worst, least.time, (name,)))
    return min(cases, key=lambda each: each.worst)


ARENA = CheckRule(
    "arena",
    "m",
    "min",
    lambda motion: None if motion.requirements.arena is None else 0.0,
    (
        Evaluator(WorstOverSpans(Drones, drones_room, "min", magnitude), exported=True),
        Evaluator(WorstOverSpans(Parts, _parts_room, "min", magnitude), HITCHED_STATE),
        Evaluator(_held_room, HITCHED_STATE),
    ),
    "enlarge the arena, or keep the hitch farther from its walls",
    exported_limit=EXPORTED_LIMIT,
)
"""Drones, taut cables and held objects stay in the arena; ``cable_clearance`` and
``object_clearance`` keep hanging cables and objects above its floor."""


def below_ground(motion: Motion) -> Check | None:
    """Return the height over z = 0 [m] as a check if it is negative and there is no arena."""
    if motion.requirements.arena is not None:
        return None
    open_ = Arena([-TALL, -TALL, 0.0], [TALL, TALL, TALL])
    needed = replace(motion.requirements, arena=open_)
    parts = [each.motion for each in parts_of(motion)] if motion.changes else [motion]
    check = worst_of(ARENA.check(part.replaced(requirements=needed)) for part in parts)
    return None if check is None or check.bound >= -TOUCH else check
