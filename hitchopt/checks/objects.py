"""Held objects: checks ``grip`` and ``support``, and points in the frames of objects.

Edge k runs straight from ``p_k`` to where it meets the object, along ``â_k``, turns there by
``θ_k``, seen from above, and runs straight on to ``p_{k+1}``, along ``b̂_k``. It pulls with ``T_k
(b̂_k - â_k)``, and friction bears ``μ Σ T_k θ_k``: check ``grip``.

An object with its rim on clasps: the line of weight and inertia through the centre of mass c must
meet the clasps' plane, h below it, within their polygon. Towards edge k with the inward normal n
that is ``n·(c - p_k) - h n·a / (g + a_z)``, a the acceleration of c: check ``support``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    cached,
    concatenated,
    leg_vectors,
    magnitude,
)
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import chord_pull
from hitchopt.motion.loads import centre_path, held_pieces, lowered, rim_drop, tautness
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, HoldBy, Motion
from hitchopt.objects import Section, Slab, SolidObject
from hitchopt.objects.placing import STILL, TOUCH, in_frame, surface_below
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval, vector
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, Indices

Mask = NDArray[np.bool_]

GRIP_LIMIT = 1.5  # Slip load over load
CONTACT = 2e-5  # [m] Edges lie on sections, and sections behind edges, this closely
# [m] Arcs with shorter chords, far below a circle's radius, are their chords
MIN_CHORD = 1e-9
# An edge runs towards the object before it, and away behind it
SIGNS = np.array([[1.0], [-1.0]])


def for_each(value: Enclosed) -> Enclosed:
    """Return a value (…) with a new last leading axis (…, 1)."""
    return Enclosed(value.c[..., None, :, :], np.asarray(value.r)[..., None])


def chosen(value: Enclosed, items: int | list[int]) -> Enclosed:
    """Return items of the last leading axis."""
    r = np.broadcast_to(value.r, value.c.shape[:-2])
    return Enclosed(value.c[..., items, :, :], r[..., items])


def seen_from(pose: Enclosed, points: Enclosed) -> Enclosed:
    """Return points (…, 3 components) [m] in the frames of objects.

    Their poses are x, y, z [m], cosine and sine of yaw, and broadcast along missing axes.
    """
    while pose.c.ndim < points.c.ndim:
        pose = for_each(pose)
    away = points - Enclosed(pose.c[..., :3, :], pose.r)
    return vector(turned_back(away.level, Enclosed(pose.c[..., 3:, :])), away[2])


def placed(pose: Enclosed, slab: Slab) -> Enclosed:
    """Return corners (…, 1, 2 m) [m] of the core of an object's slab, those of its floor first."""
    core, pose = slab.section.core, for_each(for_each(pose))
    heights = np.repeat([slab.lower, slab.upper], len(core))[:, None]
    heading = Enclosed(pose.c[..., 3:, :] * [[1.0], [-1.0]])  # that of the world, from the object
    level = turned_back(Enclosed.of(np.tile(core, (2, 1))), heading)
    return vector(level, Enclosed.of(heights)) + Enclosed(pose.c[..., :3, :], pose.r)


def turned_back(level: Enclosed, heading: Enclosed) -> Enclosed:
    """Return level vectors (…, 2 components) as seen from bodies with headings (…, 2 components).

    A heading of polynomials is no unit vector: the error is added to the ball.
    """
    heading = Enclosed(lowered(heading.c), heading.r)
    seen = vector(level.dot(heading), heading.cross(level))
    return seen.widened(heading_error(heading) * (level.size + level.r))


def heading_error(heading: Enclosed) -> Array:
    """Return (…) a bound of ``|h| - 1`` of headings, which is less than ``|h|² - 1``."""
    return (heading.dot(heading) - 1.0).norm_above.value


@cached
def centres(motion: Motion) -> PiecewisePolynomial:
    """Return the paths of all objects' centres of mass (objects, 3) [m]."""
    poses, bodies = motion.object_poses, motion.requirements.objects.values()
    paths = [centre_path(poses.coefficients[:, i], body) for i, body in enumerate(bodies)]
    return poses.alike(np.stack(paths, axis=1))


@cached
def moving(motion: Motion) -> Mask:
    """Return (pieces, objects) whether objects move."""
    found: Mask = np.any(np.ptp(motion.object_poses.coefficients, axis=-1) > STILL, axis=-1)
    return found


def carried(motion: Motion) -> Mask:
    """Return (pieces, objects) whether objects move or are borne."""
    found: Mask = moving(motion) | np.any(motion.object_shares.coefficients != 0.0, axis=-1)
    return found


class Held(MotionSpans):
    """Spans of one object."""

    @classmethod
    def of_object(cls, motion: Motion, index: int, on: Mask) -> Iterator[Self]:
        """Yield the spans of whole pieces ``on`` (pieces,) of an object."""
        own = np.arange(len(motion.requirements.objects)) == index
        return cls.all_of(motion, motion.drones.breaks, len(own), on[:, None] & own)

    @cached_property
    def body(self) -> SolidObject:
        """The object."""
        return tuple(self.source.requirements.objects.values())[int(self.item[0])]

    def of_items(self, table: Array) -> Array:
        """Return the polynomials (spans, items, …, degree + 1) of all items of a table."""
        every = np.arange(table.shape[1])
        return self.read(table, np.broadcast_to(every, (len(self), len(every))))

    @cached_property
    def begun(self) -> Indices:
        """Pieces with which the objects began to be carried (spans,); the spans' own if not."""
        on = carried(self.source)
        since = np.where(on & np.roll(on, 1, axis=0), 0, np.arange(len(on))[:, None])
        begun: Indices = np.maximum.accumulate(since)[self.piece, self.item]
        return begun

    @cached_property
    def pose(self) -> Enclosed:
        """x, y, z [m], cosine and sine of yaw."""
        return Enclosed(self.read(self.source.object_poses.coefficients), self.noise)

    @cached_property
    def pushed(self) -> Enclosed:
        """Acceleration of the centre of mass [m/s²]."""
        return self.derivative(centres(self.source), 2)

    @cached_property
    def share(self) -> Enclosed:
        """Share of its weight that cables carry."""
        return Enclosed(self.read(self.source.object_shares.coefficients)[:, None])


def gripping(motion: Motion) -> list[tuple[int, str, Mask]]:
    """Return index and name of every gripped object, and (pieces,) whether it is gripped."""
    names = enumerate(motion.requirements.objects)
    held = [(index, name, held_pieces(motion, name, HoldBy.GRIP)) for index, name in names]
    return [each for each in held if np.any(each[2])]


@cached
def bends(motion: Motion) -> Array:
    """Return start, both contacts and end of edges (pieces, n, 4, 3, …) [m]."""
    layout, vertices = motion.team.layout, motion.vertices.coefficients
    start, end = (vertices[:, points, None] for points in (layout.starts, layout.ends))
    return concatenated([start, motion.edge_contacts.coefficients, end], axis=2)


class Gripped(Held):
    """Spans of an object that edges are wrapped around."""

    @cached_property
    def corners(self) -> Enclosed:
        """Corners of edges, as ``bends`` (spans, n, 4) [m]."""
        return Enclosed(self.of_items(bends(self.source)), self.noise)

    @cached_property
    def places(self) -> Array:
        """Places of contacts where the hold began, seen from the object (spans, n, 2, 3) [m]."""
        poses = self.source.object_poses.coefficients[self.begun, self.item, :, 0]
        return in_frame(poses[:, None, None], bends(self.source)[self.begun, :, 1:3, :, 0])

    @cached_property
    def chords(self) -> Enclosed:
        """Straight parts of edges, before and behind the object (spans, n, 2) [m]."""
        return _straight_parts(self.corners)

    @cached_property
    def legs(self) -> Enclosed:
        """Legs of cables (spans, n, 2) [m]."""
        legs = self.of_items(leg_vectors(self.source))
        return Enclosed(legs.reshape(len(self), -1, 2, *legs.shape[2:]), self.noise)

    @cached_property
    def tension(self) -> Enclosed:
        """Tensions of edges (spans, n) [N]."""
        return Enclosed(self.of_items(self.source.tensions.coefficients)[:, :, None])

    @cached_property
    def pulls(self) -> Enclosed:
        """Pulls of edges on the object, before and behind it (spans, n, 2) [N].

        They act along the straight parts, with the sag of the whole length.
        """
        team, pull = self.source.team, self.tension
        if team.cable_density > 0.0:
            taut = Enclosed(self.of_items(tautness(self.source))[:, :, None])
            half = taut * (0.5 * GRAVITY * team.cable_density)
            edge = Enclosed(team.cable_length[:, None, None]) - self.legs.norm.sum()
            pull = chord_pull(pull, half, edge * edge)
        return self.chords.direction * for_each(pull) * -SIGNS

    @cached_property
    def slip_load(self) -> Array:
        """``μ Σ T_k θ_k`` (spans,) [N], at least.

        ``T_k`` is the least pull of cable k's legs, reduced by friction at its clasps.
        """
        clasped = np.max(_angles(-self.legs, self.chords * SIGNS).high, axis=-1)
        pulls = np.min(self.of_items(self.source.pulls.coefficients), axis=-1)
        pulls = np.min(pulls.reshape(len(self), -1, 2), axis=-1)
        pulls = pulls * np.exp(-self.source.team.cable_friction * clasped)
        before, behind = (chosen(self.chords, i).level for i in (0, 1))
        slip: Array = self.body.friction * np.sum(pulls * _angles(before, behind).low, axis=-1)
        return slip

    @cached_property
    def load(self) -> Array:
        """Upper bound (spans,) [N] of the carried ``m (g + a_z)`` plus the load of turning."""
        borne = ((self.pushed[2] + GRAVITY) * self.share).above.value
        turning = self.derivative(self.source.object_poses, 2)
        turned = Enclosed(turning.c[:, 3:], turning.r).norm_above.value
        load: Array = self.body.mass * (borne + turned * turning_reach(self.body))
        return load


def _straight_parts(corners: Enclosed) -> Enclosed:
    """Return the straight parts (…, 2) [m] of edges that bend at corners (…, 4)."""
    return chosen(corners, [1, 3]) - chosen(corners, [0, 2])


def _angles(a: Enclosed, b: Enclosed) -> Interval:
    """Return intervals of the angles [rad] between two vectors."""
    cosine = a.direction.dot(b.direction).range
    low, high = (np.arccos(np.clip(x, -1.0, 1.0)) for x in (cosine.high, cosine.low))
    return Interval(low, high)


def turning_reach(body: SolidObject) -> float:
    """Return the load of a turning object over its mass and angular acceleration [m]."""
    section = body.section
    away = np.linalg.norm(section.core - section.centroid, axis=-1)
    arm = section.rounding or float(np.min(away))
    return (float(np.max(away)) + section.rounding) ** 2 / arm


def slip_ratio(spans: Gripped) -> Bound:
    """Return slip load over load while there is a load, else infinity.

    It is minus infinity where edges are not wrapped around the object.
    """
    borne = np.any(spans.share.c > 0.0, axis=(1, 2))
    ratio = _ratio(spans.slip_load, np.where(borne, spans.load * (1.0 + ROUNDING), 0.0))
    return Bound(np.where(_misplaced(spans), -math.inf, ratio.value), ratio.x)


def _ratio(a: Array, b: Array) -> Bound:
    """Return a quotient (spans,); infinite where the divisor is not positive."""
    ratio = np.divide(a, b, out=np.full_like(a, math.inf), where=b > 0.0)
    return Bound(ratio, np.full(len(a), 0.5))


def spare_friction(motion: Motion, index: int) -> Array:
    """Return the spare load (pieces,) [N] of an object gripped on all pieces."""
    parts = Gripped.of_object(motion, index, np.ones(motion.drones.pieces, dtype=np.bool_))
    return np.concatenate([spans.slip_load / GRIP_LIMIT - spans.load for spans in parts])


def _slipping(motion: Motion, limit: float) -> WorstCase:
    """Return the smallest ratio of slip load to load.

    It is minus infinity if an edge bends without a gripped object, or off the object's section.
    """
    lost = np.any(~_straight(Enclosed(bends(motion))), axis=1)
    cases = [WorstCase(math.inf, 0.0)]
    for index, name, on in gripping(motion):
        parts, lost = Gripped.of_object(motion, index, on), lost & ~on
        least = worst(parts, slip_ratio, "min", target=within(limit, "min"))
        cases.append(WorstCase(least.worst, least.time, (name,)))
    if np.any(lost):
        cases.append(WorstCase(-math.inf, float(motion.drones.breaks[int(np.argmax(lost))])))
    return min(cases, key=lambda each: each.worst)


SHOWN = (slip_ratio, Gripped.slip_load, Gripped.load)

GRIP = CheckRule(
    "grip",
    "1",
    "min",
    lambda motion: GRIP_LIMIT if gripping(motion) or motion.contacts is not None else None,
    (Evaluator(_slipping, HITCHED_STATE | FREE_STATES, shown=SHOWN),),
    "lower the object's mass, raise the tension, or use rougher cables",
    whole=True,  # from where holds begin
)


def _straight(corners: Enclosed) -> Mask:
    """Return (pieces, edges) whether contacts are one point on the line between both ends."""
    start, first, last, end = (chosen(corners, i) for i in range(4))
    aside = (first - start).cross(end - last).norm_above.value
    one_point = (last - first).norm_above.value <= CONTACT
    straight: Mask = one_point & (aside <= CONTACT * ((end - start).norm_above.value + CONTACT))
    return straight


def _misplaced(spans: Gripped) -> Mask:
    """Return (spans,) whether edges are not wrapped around the object.

    Every edge is straight or touches the section at both contacts, which stay at the height on the
    object at which the hold began, all of the section is on its right, and it turns to the right by
    less than half a turn. From then on contacts do not turn about the object in the mean.
    """
    body, section = spans.body, spans.body.section
    seen = seen_from(spans.pose, spans.corners)
    slack = CONTACT + np.max(seen.r, axis=-1)
    exact = Enclosed(seen.c)
    straight, contacts = _straight_parts(exact).level, chosen(exact, [1, 2])
    # Contacts are at corners of a polygon, or on a circle.
    away = for_each(contacts.level) - section.core
    off = away.norm_above.value
    if section.outline is None:
        off = (away.dot(away) - section.rounding**2).norm_above.value / section.rounding
    touching = np.all(np.min(off, axis=-1) <= slack[..., None], axis=-1)
    # No part of the section is on the left; parts without length are not compared.
    left = for_each(straight).cross(section.core - for_each(chosen(exact, [0, 2]).level))
    reach = np.max((left + for_each(straight.norm) * section.rounding).above.value, axis=-1)
    size = straight.norm_range
    before = (reach > slack[..., None] * size.low) & (size.high > CONTACT)
    right = chosen(straight, 1).cross(chosen(straight, 0)).range
    along = chosen(straight, 0).dot(chosen(straight, 1)).range
    turned = right.low < -slack * np.maximum(along.high, -along.low)
    turned |= (along.low <= 0.0) & (right.low <= 0.0)
    heights = contacts[2].range
    drift = (contacts[2] - spans.places[:, :, :1, 2:]).norm_above.value
    level = drift <= slack[..., None]
    level &= (heights.low >= body.lower) & (heights.high <= body.upper)
    wrong = turned | np.any(before | ~level, axis=-1) | ~(_straight(exact) | touching)
    begun, now = unit(spans.places[..., :2] - section.centroid), contacts.level - section.centroid
    spun = Enclosed.of(begun).cross(now.direction).sum().sum() * section.circumradius
    far = spun.norm_above.value > PLACE_TOLERANCE * 2 * begun.shape[1]
    busy = carried(spans.source)[spans.piece, spans.item]
    misplaced: Mask = (far & busy) | np.any(wrong, axis=1)
    return misplaced


def unbalanced(motion: Motion) -> WorstCase:
    """Return the largest force, or moment over its size, that an object lacks, over the tension."""
    cases = [WorstCase(0.0, 0.0)]
    for index, name, on in gripping(motion):
        most = worst(Gripped.of_object(motion, index, on), lacking, "max")
        cases.append(WorstCase(most.worst, most.time, (name,)))
    return max(cases, key=lambda each: each.worst)


def lacking(spans: Gripped) -> Bound:
    """Return an object's missing force over the least tension; infinite if nothing holds it.

    That is ``Σ P_k (b̂_k - â_k) - m (a + ν g ẑ)``, ν the carried share of its weight, and moments
    about its centre, both reduced by friction with its support.
    """
    body, pulls = spans.body, spans.pulls
    force = pulls.sum().sum() - (spans.share.upward() * GRAVITY + spans.pushed) * body.mass
    centre = Enclosed(spans.read(centres(spans.source).coefficients), spans.noise)
    arms = chosen(spans.corners, [1, 2]) - for_each(for_each(centre))
    moment = arms.cross(pulls).sum().sum().norm_above.value / body.section.circumradius
    friction = body.friction * body.mass * GRAVITY * (1.0 - spans.share.above.value)
    level = np.maximum(force.level.norm_above.value, moment) - friction
    missing = np.hypot(np.maximum(level, 0.0), force[2].norm_above.value)
    return _ratio(missing, np.min(spans.tension.below.value, axis=-1))


@cached
def wrapped_arcs(motion: Motion) -> Array:
    """Return chords of arcs, the radius of their circle, and the length of polygons' sides.

    Returns
    -------
    (pieces, n, 5, degree + 1) [m]: a chord's coordinates, and two constants.
    """
    contacts = motion.edge_contacts.coefficients
    rows = np.zeros((*contacts.shape[:2], 5, contacts.shape[-1]))
    rows[:, :, :3] = contacts[:, :, 1] - contacts[:, :, 0]
    for index, name, on in gripping(motion):
        section = motion.requirements.objects[name].section
        rows[on, :, 3] = section.rounding
        if section.outline is not None:
            poses = motion.object_poses.coefficients[on, index, :, 0]
            seen = in_frame(poses[:, None, None], contacts[on, ..., 0])
            rows[on, :, 4] = _sides(section, seen[..., :2])[..., None]
    return rows


def _sides(section: Section, contacts: Array) -> Array:
    """Return the length (…) [m] of the outline, clockwise, between contacts (…, 2, 2) [m]."""
    core = section.core
    ring = np.append(0.0, np.cumsum(np.linalg.norm(np.roll(core, -1, axis=0) - core, axis=-1)))
    away = np.linalg.norm(contacts[..., None, :] - core, axis=-1)
    first, last = np.moveaxis(np.argmin(away, axis=-1), -1, 0)
    sides: Array = (ring[last] - ring[first]) % ring[-1]
    straight = np.linalg.norm(contacts[..., 1, :] - contacts[..., 0, :], axis=-1) < MIN_CHORD
    return np.where(straight, 0.0, sides)


def arc_lengths(rows: Array) -> Enclosed:
    """Return the lengths of arcs (…) [m], given ``wrapped_arcs`` of them (…, 5, degree + 1).

    On a circle of radius R the arc over a chord s is ``2 R asin(s / 2R)``: its tangent at the
    middle of the range of s. Between corners of a polygon arcs are sums of its sides.
    """
    width, sides = 2.0 * rows[..., 3, 0], rows[..., 4, 0]
    size = np.where(width > 0.0, width, 1.0)
    chord = Enclosed(rows[..., :3, :]).norm * (1.0 / size)[..., None]
    low, high = (np.clip(end, 0.0, 1.0) for end in (chord.range.low, chord.range.high))
    middle = 0.5 * (low + high)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (1.0 - middle**2) ** -0.5
        error = 0.125 * (high - low) ** 2 * high * (1.0 - high**2) ** -1.5  # asin'' grows
    known = (width > 0.0) & np.isfinite(error)
    slope, arc = (np.where(known, x, 0.0)[..., None] for x in (slope, np.arcsin(middle)))
    lengths = ((chord - middle[..., None]) * slope + arc) * width[..., None] + sides[..., None]
    return lengths.widened(np.where(known, width * error, np.where(width > 0.0, np.inf, 0.0)))


PLACE_TOLERANCE = 1e-4  # [m] of clasps that carry a rim, from their places below it


class Resting(Held):
    """Spans of an object with a rim that rests on all clasps."""

    @cached_property
    def clasps(self) -> Enclosed:
        """Clasps (spans, n) [m] as seen from the object."""
        c = self.of_items(self.source.vertices.coefficients)
        return seen_from(self.pose, Enclosed(c, self.noise))

    @cached_property
    def places(self) -> Array:
        """Places of the clasps where the hold began, seen from above (spans, n, 2) [m]."""
        poses = self.source.object_poses.coefficients[self.begun, self.item, :, 0]
        clasps = self.source.vertices.coefficients[self.begun, ..., 0]
        return in_frame(poses[:, None], clasps)[..., :2]


def force_line(spans: Resting) -> Bound:
    """Return the distance of the force line from the edges of the clasps' polygon [m]."""
    places, body = spans.places, spans.body
    assert body.rim is not None
    centre = body.centre_of_mass
    edges = unit(np.roll(places, -1, axis=1) - places)
    inward = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)  # of clockwise edges
    apart = np.sum(inward * (centre[:2] - places), axis=-1)
    heading = Enclosed(spans.pose.c[:, 3:])
    level = for_each(turned_back(spans.pushed.level, heading))
    lean = level.dot(inward) * (centre[2] - body.rim.height)
    pressing = for_each(spans.pushed[2] + GRAVITY).range
    margin = (ROUNDING + heading_error(heading)) * (magnitude(spans.source) + body.circumradius)
    least = np.where(pressing.low > 0.0, apart - (lean.range * pressing.inverse).high, -np.inf)
    k = np.arange(len(spans)), np.argmin(least, axis=1)
    return Bound(least[k] - margin - 2.0 * PLACE_TOLERANCE, lean.above.x[k])


def _force_lines(motion: Motion, _: float) -> WorstCase:
    """Return the smallest distance of a force line to the edge of its supports [m].

    It is minus infinity if an object moves, or is carried, and nothing holds it; if it floats, or
    its heading is no unit vector; and if clasps of a hold are not around it, or not where they
    support it, or it would slide off.
    """
    size, begins = magnitude(motion), motion.drones.breaks
    each = [WorstCase(math.inf, 0.0, size=size)]
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        share = motion.object_shares.coefficients[:, index]
        moves, busy = moving(motion)[:, index], carried(motion)[:, index]
        whole = np.all(share == 1.0, axis=-1)
        resting, gripped = (held_pieces(motion, name, by) for by in (HoldBy.REST, HoldBy.GRIP))
        heading = Enclosed(motion.object_poses.coefficients[:, index, 3:])
        lost = (moves & ~whole) | (heading_error(heading) > TOUCH)
        if not body.fixed:
            lost |= _floating(motion, index, name, ~whole & ~moves)
        lost |= np.any((share < 0.0) | (share > 1.0), axis=-1)
        lost |= busy & (~(resting | gripped) | ~motion.formed | body.fixed)
        if body.rim is None or not motion.team.layout.closed:
            lost |= resting
        for spans in Resting.of_object(motion, index, resting & ~lost):
            lost[spans.piece] = _misplaced_clasps(spans, busy[spans.piece])
        parts = Resting.of_object(motion, index, resting & busy & whole & ~lost)
        least = worst(parts, force_line, "min")
        each.append(WorstCase(least.worst, least.time, (name,), size))
        if np.any(lost):
            each.append(WorstCase(-math.inf, float(begins[int(np.argmax(lost))]), (name,)))
    return min(each, key=lambda case: case.worst)


def _floating(motion: Motion, index: int, name: str, still: Mask) -> Mask:
    """Return (pieces,) whether an object at rest, not fully carried, has no support below."""
    objects = motion.requirements.objects
    poses = np.round(motion.object_poses.coefficients[..., 0] / STILL) * STILL
    places, which = np.unique(poses, axis=0, return_inverse=True)
    stands = np.zeros(len(places), dtype=np.bool_)
    for i in np.unique(which.ravel()[still]):
        surface, _ = surface_below(objects, places[i], name, motion.requirements.floor)
        gap = float(places[i, index, 2]) + objects[name].lower - surface
        stands[i] = abs(gap) <= TOUCH
    return still & ~stands[which.ravel()]


def _misplaced_clasps(spans: Resting, busy: Mask) -> Mask:
    """Return (spans,) whether clasps are above a rim, or not around the body as the hold began.

    If it is ``busy``, also whether they have left their places of the hold's beginning, are not
    ``rim_drop`` below the rim, or it slides off.
    """
    motion, body, rim, places = spans.source, spans.body, spans.body.rim, spans.places
    assert rim is not None
    following, to = np.roll(places, -1, axis=1), body.section.centroid - places
    edges = following - places
    wrong = edges[..., 1] * to[..., 0] - edges[..., 0] * to[..., 1] <= 0.0
    wrong |= Enclosed(spans.clasps.c)[2].above.value > rim.height + PLACE_TOLERANCE
    pulls = motion.tensions.coefficients[spans.piece, :, 0]
    drop = rim_drop(motion.team, body, places, pulls)[:, None]
    whole = np.all(spans.share.c == 1.0, axis=(1, 2))[:, None]
    heights = spans.clasps[2].range
    off = (spans.clasps.level - places).norm_above.value
    off = np.maximum(off, rim.height - heights.low - drop)
    off = np.maximum(off, heights.high - rim.height + np.where(whole, drop, 0.0))
    unsupported = (off > PLACE_TOLERANCE) | (rim.section.clearance(places)[0] >= -PLACE_TOLERANCE)
    if body.stem is not None:
        unsupported |= body.stem.segment_distance(places, following) <= PLACE_TOLERANCE
    pushed = Enclosed(spans.of_items(motion.vertices.differentiated(2).coefficients))
    unsupported |= pushed.level.norm_above.value > body.friction * (GRAVITY + pushed[2].below.value)
    lost: Mask = np.any(wrong | (unsupported & busy[:, None]), axis=1)
    return lost


SUPPORT = CheckRule(
    "support",
    "m",
    "min",
    lambda motion: 0.0 if motion.requirements.objects else None,
    (Evaluator(_force_lines, HITCHED_STATE | FREE_STATES, shown=(force_line,)),),
    "carry it more gently, or hold it farther out or closer below its centre of mass",
    whole=True,
)
