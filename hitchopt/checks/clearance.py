"""What drones and cables keep off: checks ``cable_clearance``, ``keep_out``, ``object_clearance``.

Taut cables are straight. A cable that hangs between its drones is a catenary. Taking off and
landing, cables lie on the ground at least in part, in between their drones.

On a span of time a hanging cable is stood in for by the points of the catenary at fixed μ, its
steepness taken from mid time and its height difference from the polynomials themselves. The
catenary is never farther from that chain than a bound on how it bends between the points, plus
¼ (L + |h|) of how far its steepness is from that of mid time (see ``hitchopt.hitch.catenary``).

Objects are slabs, convex sections between two heights. Their support functions, and the direction
out of one to the nearest point of what moves, are all that ``hitchopt.checks.distances`` needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hitchopt.checks.certificate import within
from hitchopt.checks.distances import (
    GROUND,
    TALL,
    Flags,
    Ground,
    Moving,
    Names,
    Nearest,
    PairSpans,
    Shape,
    cable_ends,
    gap,
    plan_points,
    smallest,
)
from hitchopt.checks.drones import steepness_of
from hitchopt.checks.objects import heading_error, seen_from
from hitchopt.checks.rule import CheckRule, Finder
from hitchopt.checks.spans import (
    ROUNDING,
    cable_names,
    cable_parts,
    magnitude,
    phase_parts,
    position_margin,
)
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import SERIES, Catenary, depth_terms, level_length, steepness
from hitchopt.motion.loads import held_pieces
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, HoldBy, Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import STILL, TOUCH, sections_apart, surface_below
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, Indices

HALVINGS = 25
"""Halvings of a segment in search of its nearest point: it is found within 3e-8 of it."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A slab that points, segments and other upright slabs keep off.

    Of another slab, whose ``rounding`` is given, the corners of the core are known, those of its
    floor first; what is round about that core is added to the slab that stands still.
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
        """Return the directions (…, 3) out of it to what has corners (…, 1, 2 or 2 m, 3)."""
        if self.rounding is not None:
            return self._beside(corners, self.rounding)
        first, along = corners[..., 0, :], corners[..., -1, :] - corners[..., 0, :]
        if corners.shape[-2] == 1:
            return self.slab.clearance(first).normals

        def out(share: Array) -> Array:
            return self.slab.clearance(first + share[..., None] * along).normals

        lower, upper = np.zeros(first.shape[:-1]), np.ones(first.shape[:-1])
        for _ in range(HALVINGS):  # the distance to a convex body is convex along a segment
            middle = 0.5 * (lower + upper)
            rising = np.einsum("...d,...d->...", out(middle), along) > 0.0
            lower, upper = np.where(rising, lower, middle), np.where(rising, middle, upper)
        return out(np.where(lower == 0.0, 0.0, upper))

    def _beside(self, corners: Array, rounding: float) -> Array:
        """Return the same of upright slabs; level ones are those in which a side is nearest."""
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
    """Return a body as seen from above, where heights do not count."""
    return Solid(Slab(slab.section, -TALL, TALL))


def carried(motion: Motion) -> Iterator[Moving]:
    """Yield objects that move past the ground, and past all others.

    While one goes straight up from something on which it stands before or after that, or down onto
    it, and stays above it, they may touch; likewise what is below it where the motion begins so.
    """
    if motion.poses is None:
        return
    objects, poses = motion.requirements.objects, motion.poses.coefficients
    moving, floor = np.ptp(poses, axis=-1), motion.requirements.floor  # (pieces, objects, 5)
    going = np.any(moving > STILL, axis=-1)
    upright = np.max(moving[..., [0, 1, 3, 4]], axis=-1) <= TOUCH
    for index, (name, each) in enumerate(objects.items()):
        if not np.any(going[:, index]):
            continue
        bottom = poses[:, index, 2] + each.lower
        below = surface_below(objects, poses[0, :, :, 0], name, floor)[1] or GROUND
        error = float(np.max(heading_error(Enclosed(poses[:, index, 3:]))))
        for other, label in enumerate([*objects, GROUND]):
            if other == index:
                continue
            bodies = () if label == GROUND else objects[label].slabs
            high = poses[:, other, 2] + objects[label].upper if bodies else floor
            gap = bottom - high
            stands = np.any(np.abs(gap[:, [0, -1]]) <= TOUCH, axis=1)
            for piece in np.flatnonzero(stands) if bodies else ():
                here, there = poses[piece, [index, other], :, 0]
                met = (
                    sections_apart(a.section, here, b.section, there) < 0.0
                    for a in each.slabs
                    for b in bodies
                    if a.lower == each.lower and b.upper == objects[label].upper
                )
                stands[piece] = any(met)
            touching = _leaving(upright[:, index], stands, label == below)
            touching &= np.min(gap, axis=1) >= -TOUCH
            counted = (going[:, index] & ~touching)[:, None]
            for slab in each.slabs:
                seen = Enclosed(placed_core(poses[:, index], slab)[:, None])
                shapes: list[Shape] = [Ground(floor)]
                if bodies:
                    seen = seen_from(Enclosed(poses[:, other]), seen)
                    shapes = [Solid(body, slab.section.rounding) for body in bodies]
                size = magnitude(motion) + slab.size + sum(body.size for body in bodies)
                margin = ROUNDING * size + error * slab.section.circumradius
                names = ((name,), (label,))
                for shape in shapes:
                    yield _seen(motion, seen, shape, names, margin, counted=counted)


def _leaving(upright: Flags, stands: Flags, lifted: bool) -> Flags:
    """Return (pieces,) in which an object rises from something, or goes down onto it.

    It moves straight up or down in a run of pieces one of which begins or ends with it standing
    there; or in the first run, if it has been lifted from there.
    """
    runs = np.cumsum(~upright)
    from_there = np.isin(runs, runs[stands & upright]) | ((runs == 0) & lifted)
    return np.asarray(upright & from_there)


def placed_core(poses: Array, slab: Slab) -> Array:
    """Return the corners of a slab's core (pieces, 2 m, 3, degree + 1) [m], floor and ceiling.

    Given poses of its object (pieces, 5, degree + 1).
    """
    core = slab.section.core[:, :, None]
    x, y, z, c, s = (row[:, None] for row in np.moveaxis(poses, 1, 0))
    across, along = core[:, 0] * c - core[:, 1] * s + x, core[:, 0] * s + core[:, 1] * c + y
    heights = [z + height + 0.0 * across for height in (slab.lower, slab.upper)]
    return np.concatenate([np.stack([across, along, up], axis=2) for up in heights], axis=1)


TOLERANCE = 1e-3
"""[m] How far ``worst`` may lie below a distance that is attained, besides what a cable's links are
off it: catenaries are no polynomials, and are closed in on only with the length of a span."""

BY_LENGTH, BY_PLACE = 20, 16
"""A chain's points: so many links of equal length, which follow a cable down its steep ends, and
so many more points evenly across, which follow it around where it is lowest. It is off them by
about 0.2 % of its length at most, where it bends the most, and much less elsewhere."""

FARTHEST = 0.25
"""[m] Pieces on which a drone may go farther are cut before anything else."""

SHIFT = 1.12
"""How far a point of a cable moves with its ends, over how far they move: at most √(1 + ¼), since
its shares in their level and upward parts differ by up to a half."""


def chains(q: Array, r: Array, length: Array) -> tuple[Array, Array]:
    """Return points of chains that stand in for hanging cables, and how far these are off them.

    Of cables between ends (spans, 3, degree + 1), ``length`` (spans,) [m]: (spans, links + 1, 3,
    degree + 1) and (spans, links) [m], from each link at all times of the span.
    """
    offset = Enclosed(r - q)
    cable = Catenary.between(Enclosed(q).middle, Enclosed(r).middle, length)
    by_length = cable.place(np.linspace(0.0, 1.0, BY_LENGTH + 1)[:, None])
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
    return points, _bends(cable, mu) + (0.25 * (length + height) * drift)[:, None]


def _bends(cable: Catenary, mu: Array) -> Array:
    """Return (spans, links) [m] how far each cable sags below its links, between points μ, midway.

    Measured in Λ / 2 sinh σ the cable is a hyperbolic cosine, farthest below its chord where it is
    parallel to it.
    """
    sigma = np.maximum(cable.sigma, SERIES)
    y = mu * sigma + np.arcsinh(cable.tilt)
    first, last = y[:-1], y[1:]
    width = np.maximum(last - first, 1e-12)
    slope = (np.cosh(last) - np.cosh(first)) / width
    touching = np.clip(np.arcsinh(slope), first, last)
    gap = np.cosh(first) + slope * (touching - first) - np.cosh(touching)
    unit = 0.5 * level_length(cable.rise, cable.length) / np.sinh(sigma)
    rounding = 2.0**-40 * cable.length
    bends: Array = (unit * np.maximum(gap, 0.0) + rounding).T
    return bends


def cut(drones: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the same curves on pieces so short that no drone goes FARTHEST on any of them."""
    reach = np.max(np.linalg.norm(np.ptp(drones.coefficients, axis=-1), axis=-1), axis=1)
    counts = np.maximum(1, np.ceil(reach / FARTHEST)).astype(np.intp)
    if np.all(counts == 1):
        return drones
    piece = np.repeat(np.arange(drones.pieces), counts)
    first = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts = drones.breaks[piece] + first / counts[piece] * drones.durations[piece]
    return on_breaks(drones, np.append(starts, drones.breaks[-1]))


def foreign(cables: Indices, drones: Indices) -> Flags:
    """Return which drones do not carry a cable."""
    apart: Flags = drones // 2 != cables
    return apart


def cables_and_drones(motion: Motion) -> Moving:
    """Return cables as they hang and the drones that do not carry them."""
    points = cut(motion.drones).coefficients[:, :, None]
    return _hung(motion, points, motion.team.drone_names, allowed=foreign)


def cables_and_ground(motion: Motion) -> Moving:
    """Return cables as they hang above the ground."""
    nowhere = np.zeros((cut(motion.drones).pieces, 1, 1, 3, 1))
    return _hung(motion, nowhere, (GROUND,), shape=Ground(motion.requirements.floor))


def _hung(motion: Motion, second: Array, names: Sequence[str], **further: Any) -> Moving:
    """Return hanging cables and what they keep off; ``further`` as in Moving."""
    return Moving(
        (drones := cut(motion.drones)).breaks,
        cable_ends(drones.coefficients),
        second,
        position_margin(motion),
        lengths=motion.team.cable_length,
        names=(cable_names(motion), names),
        swapped=True,
        formula=hung_gap,
        tolerance=TOLERANCE,
        **further,
    )


def hung_gap(spans: PairSpans, shape: Shape | None = None) -> Bound:
    """Return the distances of hanging cables to points, or to what is below a height [m]."""
    (ends, point), shape = spans.ends, shape or spans.source.shape
    points, off = chains(ends[:, 0], ends[:, 1], spans.lengths)
    apart = points - point  # (spans, links + 1, 3, degree + 1)
    here = Enclosed(apart).middle
    along = shape.towards(np.stack([here[:, :-1], here[:, 1:]], axis=2))
    first, last = (np.einsum("sld,sldi->sli", along, c) for c in (apart[:, :-1], apart[:, 1:]))
    least = np.minimum(first, last) - (off + shape.support(along))[..., None]
    found = Enclosed(np.min(least, axis=1, keepdims=True), spans.source.margin).below
    return Bound(np.maximum(found.value, 0.0), found.x)


def above_ground(motion: Motion) -> bool:
    """Return whether cables, if all hung free, would keep ``separation.cable`` off the ground."""
    limit = motion.requirements.separation.cable
    least = smallest(cables_and_ground(motion), relative=TOLERANCE, absolute=TOLERANCE)
    return least.worst >= within(limit, "min", magnitude(motion))


def moved_by(motion: Motion) -> Callable[[float], float]:
    """Return how much nearer [m] drones and hanging cables come if every drone is off by r [m].

    A point of a cable (at μ, see ``hitchopt.hitch.catenary``) moves with its two ends, across by
    shares ``(1 ± μ)/2`` of them, upward by ``(1 ± sinh μσ / sinh σ)/2``, and by ¼ (L + |h|) per
    change of σ at most. That follows from ``(coth σ - 1/σ) dσ = d ln(Λ/s)``, where s and h change
    by 2r at most.
    """
    ends, L = cable_ends(cut(motion.drones).coefficients), motion.team.cable_length
    offset = Enclosed(ends[:, :, 1] - ends[:, :, 0])
    across, height = offset.level.norm_range, offset[2].norm_above.value

    def moved(radius: float) -> float:
        closer, higher = across.low - 2.0 * radius, height + 2.0 * radius
        if np.any(closer <= 0.0) or np.any(higher >= L):
            return np.inf
        flattest = steepness(level_length(higher, L) / (across.high + 2.0 * radius))
        if np.any(flattest < SERIES):  # nearly taut: how deep it hangs changes without a bound
            return np.inf
        ratio = np.log(across.low / closer)
        ratio = ratio + np.log(level_length(height, L) / level_length(higher, L))
        steeper = ratio / (1.0 / np.tanh(flattest) - 1.0 / flattest)
        return radius + SHIFT * radius + float(np.max(0.25 * (L + higher) * steeper))

    return moved


CONTACT = 2e-5
"""[m] Cables that hold an object and are no closer to its body enter it."""


def _past_taut(motion: Motion) -> Iterator[Moving]:
    """Yield drones past all parts of foreign cables, and past their own edge.

    A drone at a chain's end stands on its own edge.
    """
    (corners, part), on_leg = cable_parts(motion), motion.team.layout.has_leg.ravel()

    def strange(drones: Indices, bodies: Indices) -> Flags:
        k, kind = np.divmod(part[bodies], 3)
        counted: Flags = (drones // 2 != k) | ((kind == 1) & on_leg[drones])
        return counted

    drones = motion.drones.elevated(bernstein.degree(corners)).coefficients
    names = motion.team.drone_names, [f"cable {k}" for k in part // 3]
    yield Moving.of(motion, drones[:, :, None], corners, names, allowed=strange)


def _past_chords(motion: Motion) -> Iterator[Moving]:
    """Yield drones past the chords of cables not their own, as seen from above."""
    flat = plan_points(motion)
    names, swapped = (cable_names(motion), motion.team.drone_names), {"swapped": True}
    yield Moving.of(motion, cable_ends(flat), flat, names, allowed=foreign, **swapped)


def _past_hanging(motion: Motion) -> Iterator[Moving]:
    """Yield drones, and the ground, past hanging cables not their own.

    Each phase by itself: a search stops within millimetres, so that what it finds depends on the
    span of time.
    """
    for part in phase_parts(motion):
        yield cables_and_drones(part.motion)
        yield cables_and_ground(part.motion)


CABLE_CLEARANCE = CheckRule(
    "cable_clearance",
    "m",
    "min",
    lambda motion: motion.requirements.separation.cable,
    (
        Finder(Nearest(_past_taut), HITCHED_STATE, exported=True, shown=(gap,)),
        Finder(Nearest(_past_chords), frozenset({CableState.GROUND}), exported=True),
        Finder(
            Nearest(_past_hanging),
            FREE_STATES - {CableState.GROUND},
            exported=True,
            shown=(hung_gap,),
        ),
    ),
    "give the drones other leg lengths (of a longer cable or a smaller polygon), "
    "or a smaller separation.cable",
    "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    "length",
)
"""Drones, and the ground, stay off cables; drones as seen from above while these lie there."""


def _drones_past(motion: Motion) -> Iterator[Moving]:
    """Yield drones past prisms and objects, which have names."""
    points, names = Enclosed(motion.drones.coefficients[:, :, None]), motion.team.drone_names
    for prism in motion.requirements.keep_out:
        yield _past(motion, points, prism.slab, names, "")
    for name, each, pose in _placed(motion):
        seen = seen_from(pose, points)
        yield from (_past(motion, seen, slab, names, name) for slab in each.slabs)


def _placed(motion: Motion) -> Iterator[tuple[str, SolidObject, Enclosed]]:
    """Yield the names of objects, these, and their poses (pieces,)."""
    poses = motion.object_poses.coefficients
    for index, (name, each) in enumerate(motion.requirements.objects.items()):
        yield name, each, Enclosed(poses[:, index])


def _past(
    motion: Motion, seen: Enclosed, slab: Slab, names: Sequence[str], name: str, **further: Any
) -> Moving:
    """Return what moves past a slab that has a name; ``further`` as in Moving."""
    margin = ROUNDING * (magnitude(motion) + slab.size)
    return _seen(motion, seen, Solid(slab), (names, (name,)), margin, **further)


def _seen(
    motion: Motion, seen: Enclosed, shape: Shape, names: Names, margin: float, **further: Any
) -> Moving:
    """Return what moves past a shape, as seen from that."""
    margin += float(np.max(seen.r))
    nowhere = np.zeros((len(seen.c), 1, 1, 3, 1))
    return Moving.of(motion, seen.c, nowhere, names, shape=shape, margin=margin, **further)


KEEP_OUT = CheckRule(
    "keep_out",
    "m",
    "min",
    lambda motion: (
        motion.requirements.separation.radius
        if motion.requirements.keep_out or motion.requirements.objects
        else None
    ),
    (Finder(Nearest(_drones_past), exported=True, shown=(gap, Solid.towards)),),
    "move the keep-out volumes or objects, fly farther from them, or lower separation.radius",
)
"""Drones stay off prisms and objects, by the radius of their ellipsoids."""


def _cables_past(motion: Motion) -> Iterator[Moving]:
    """Yield taut cables past objects that they do not hold, and what is carried past others.

    The distance is zero where a cable enters what it holds, or the ground.
    """
    (corners, part), contact = cable_parts(motion), {"contact": CONTACT}
    cables, points = part // 3, Enclosed(corners)
    names = [f"cable {k}" for k in cables]
    # No part is lower than all of its ends, and bends of what is wrapped around an object.
    holding = np.array([phase.hold is not None for phase in motion.phases] + [False])
    on = np.repeat(holding[motion.phase_of_piece][:, None], len(part), axis=1)
    ground, margin = Ground(motion.requirements.floor - 2.0 * CONTACT), position_margin(motion)
    yield _seen(motion, points, ground, (names, (GROUND,)), margin, counted=on, **contact)
    for name, each, pose in _placed(motion):
        held = [p.hold.cables if p.hold and p.hold.object == name else () for p in motion.phases]
        touching = np.array([np.isin(cables, each) for each in [*held, ()]])
        counted, seen = ~touching[motion.phase_of_piece], seen_from(pose, points)
        if each.stem is not None:  # what is below a flat tray is off it
            gripped = held_pieces(motion, name, HoldBy.GRIP)[:, None]  # else edges stay out of it
            entering = (~gripped | (part % 3 != 1)) & ~counted
            yield _past(motion, seen, each.slabs[0], names, name, counted=entering, **contact)
        for slab in each.slabs:
            yield _past(motion, seen, slab, names, name, counted=counted)
    yield from carried(motion)


def _hanging_past(motion: Motion) -> Iterator[Moving]:
    """Yield cables that hang, or lie on the ground, past objects.

    From above, a cable is on its chord; a hanging one is above or below an object besides.
    """
    for part in phase_parts(motion):
        drones, here = cut(part.motion.drones), part.motion
        ends, names = Enclosed(cable_ends(drones.coefficients)), cable_names(motion)
        for name, each, pose in _placed(here):  # nothing moves them: check support
            seen = seen_from(Enclosed(pose.c[:1, :, :1]), ends)
            for slab in each.slabs:
                lies = part.phase.state is CableState.GROUND
                formula = gap if lies else partial(over, top=slab.upper)
                past = _past(here, seen, slab, names, name, formula=formula, tolerance=TOLERANCE)
                flat, lengths = from_above(slab), motion.team.cable_length
                yield replace(past, breaks=drones.breaks, shape=flat, lengths=lengths)


def over(spans: PairSpans, top: float) -> Bound:
    """Return how far hanging cables are off a body, aside of it or above [m]."""
    aside, higher = gap(spans), hung_gap(spans, Ground(top))
    up = higher.value > aside.value
    return Bound(np.where(up, higher.value, aside.value), np.where(up, higher.x, aside.x))


OBJECT_CLEARANCE = CheckRule(
    "object_clearance",
    "m",
    "min",
    lambda motion: motion.requirements.separation.object if motion.requirements.objects else None,
    (
        Finder(Nearest(_cables_past), HITCHED_STATE, exported=True, shown=(gap,)),
        Finder(Nearest(_hanging_past), FREE_STATES, exported=True, shown=(over,)),
    ),
    "fly higher over objects or farther from them, lift the held one higher, use shorter cables "
    "or stand it higher where the ground is near, or allow a smaller separation.object",
    "form and release farther from objects or higher above them, or allow a smaller "
    "separation.object",
)
"""Cables and held objects keep off objects.

Cables that hold an object come as close as they like, but not into it; where edges that grip are
wrapped, check ``grip`` says.
"""
