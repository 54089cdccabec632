"""Held objects: checks ``grip`` and ``support``, and points in the frames of objects.

Edge k is straight from ``p_k`` to the object, along ``â_k``, turns there by ``θ_k``, seen from
above, and is straight to ``p_{k+1}``, along ``b̂_k``. It pulls with ``T_k (b̂_k - â_k)``, and
friction carries up to ``μ Σ T_k θ_k``: check ``grip``.

For an object with its rim on clasps, the force line of weight and inertia through the centre of
mass c must meet the clasps' plane, h below it, within their polygon. Its distance from edge k with
the inward normal n is ``n·(c - p_k) - h n·a / (g + a_z)``, a the acceleration of c: check
``support``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    cached,
    joined_arrays,
    leg_vectors,
    magnitude,
)
from hitchopt.geometry.vectors import cross, left_of, unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import chord_pull
from hitchopt.motion.loads import centre_path, held_pieces, reduce_constants, rim_drop, tautness
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, TAUT_STATES, HoldBy, Motion
from hitchopt.objects import Section, Slab, SolidObject
from hitchopt.objects.placing import CONTACT_GAP, REST_DRIFT, in_frame, surface_below
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval, vector
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, Indices, known, lazy

Mask = NDArray[np.bool_]

GRIP_LIMIT = 1.5  # Slip load over load
WRAP_GAP = 2e-5  # [m] Largest gap or overlap of an edge and the section it is wrapped around
MIN_CHORD = 1e-9  # [m] Arcs with shorter chords are their chords
# An edge leads to the object before it, and away from it behind it
SIGNS = np.array([[1.0], [-1.0]])


def add_axis(value: Enclosed) -> Enclosed:
    """Return a value (…) with a new last leading axis (…, 1)."""
    return Enclosed(value.c[..., None, :, :], np.asarray(value.r)[..., None])


def select(value: Enclosed, items: int | list[int]) -> Enclosed:
    """Return items of the last leading axis."""
    r = np.broadcast_to(value.r, value.c.shape[:-2])
    return Enclosed(value.c[..., items, :, :], r[..., items])


def in_object_frame(pose: Enclosed, points: Enclosed) -> Enclosed:
    """Return points (…, 3 components) [m] in the frames of objects.

    Poses are x, y, z [m], cosine and sine of yaw; they broadcast along missing axes.
    """
    while pose.c.ndim < points.c.ndim:
        pose = add_axis(pose)
    offsets = points - Enclosed(pose.c[..., :3, :], pose.r)
    return vector(rotate_back(offsets.xy, Enclosed(pose.c[..., 3:, :])), offsets[2])


def placed_corners(pose: Enclosed, slab: Slab) -> Enclosed:
    """Return corners (…, 1, 2 m) [m] of the core of an object's slab, those of its floor first."""
    core, pose = slab.section.core, add_axis(add_axis(pose))
    heights = np.repeat([slab.lower, slab.upper], len(core))[:, None]
    heading = Enclosed(pose.c[..., 3:, :] * [[1.0], [-1.0]])  # of the world, in the object's frame
    horizontal = rotate_back(Enclosed.of(np.tile(core, (2, 1))), heading)
    return vector(horizontal, Enclosed.of(heights)) + Enclosed(pose.c[..., :3, :], pose.r)


def rotate_back(vectors: Enclosed, heading: Enclosed) -> Enclosed:
    """Return horizontal vectors (…, 2 components) in frames with headings (…, 2 components).

    Polynomial headings are not exact unit vectors: the error is added to the ball.
    """
    heading = Enclosed(reduce_constants(heading.c), heading.r)
    local = vector(vectors.dot(heading), heading.cross(vectors))
    return local.widened(heading_error(heading) * (vectors.size + vectors.r))


def heading_error(heading: Enclosed) -> Array:
    """Return a bound (…) of ``|h| - 1`` for headings h, which is less than ``|h|² - 1``."""
    return (heading.dot(heading) - 1.0).norm_upper.value


@cached
def centres(motion: Motion) -> PiecewisePolynomial:
    """Return the paths of all objects' centres of mass (objects, 3) [m]."""
    poses, bodies = motion.poses, motion.requirements.objects.values()
    paths = [centre_path(poses.coefficients[:, i], body) for i, body in enumerate(bodies)]
    return poses.replaced(np.stack(paths, axis=1))


@cached
def moving_objects(motion: Motion) -> Mask:
    """Return on which pieces objects move (pieces, objects)."""
    mask: Mask = np.any(np.ptp(motion.poses.coefficients, axis=-1) > REST_DRIFT, axis=-1)
    return mask


def carried_objects(motion: Motion) -> Mask:
    """Return on which pieces objects move or clasps carry them (pieces, objects)."""
    mask: Mask = moving_objects(motion) | np.any(motion.load_share.coefficients != 0.0, axis=-1)
    return mask


class Held(MotionSpans):
    """Spans of one object."""

    @classmethod
    def of_object(cls, motion: Motion, index: int, pieces: Mask) -> Iterator[Self]:
        """Yield the spans of an object on whole pieces, by their mask (pieces,)."""
        is_object = np.arange(len(motion.requirements.objects)) == index
        return cls.all_of(motion, motion.drones.breaks, len(is_object), pieces[:, None] & is_object)

    @lazy
    def body(self) -> SolidObject:
        """The object."""
        return tuple(self.source.requirements.objects.values())[int(self.item[0])]

    def of_items(self, table: Array) -> Array:
        """Return the polynomials (spans, items, …, degree + 1) of all items of a table."""
        every = np.arange(table.shape[1])
        return self.read(table, np.broadcast_to(every, (len(self), len(every))))

    @lazy
    def start_pieces(self) -> Indices:
        """(spans,) First pieces of the current holds; the spans' own if not carried."""
        carried = carried_objects(self.source)
        pieces = np.arange(len(carried))[:, None]
        starts = np.where(carried & np.roll(carried, 1, axis=0), 0, pieces)
        return np.asarray(np.maximum.accumulate(starts)[self.piece, self.item])

    @lazy
    def pose(self) -> Enclosed:
        """x, y, z [m], cosine and sine of yaw."""
        return Enclosed(self.read(self.source.poses.coefficients), self.noise)

    @lazy
    def acceleration(self) -> Enclosed:
        """Acceleration of the centre of mass [m/s²]."""
        return self.derivative(centres(self.source), 2)

    @lazy
    def share(self) -> Enclosed:
        """Fraction of its weight that cables carry."""
        return Enclosed(self.read(self.source.load_share.coefficients)[:, None])


def gripped_objects(motion: Motion) -> list[tuple[int, str, Mask]]:
    """Return index and name of every gripped object, and the mask of its pieces (pieces,)."""
    names = enumerate(motion.requirements.objects)
    held = [(index, name, held_pieces(motion, name, HoldBy.GRIP)) for index, name in names]
    return [(index, name, pieces) for index, name, pieces in held if np.any(pieces)]


@cached
def bends(motion: Motion) -> Array:
    """Return start, both contacts and end of edges (pieces, n, 4, 3, …) [m]."""
    ends = motion.inner_ends.coefficients
    return joined_arrays([ends[:, :, :1], motion.contacts.coefficients, ends[:, :, 1:]], axis=2)


class Gripped(Held):
    """Spans of an object that edges are wrapped around."""

    @lazy
    def corners(self) -> Enclosed:
        """Corners of edges, as ``bends`` (spans, n, 4) [m]."""
        return Enclosed(self.of_items(bends(self.source)), self.noise)

    @lazy
    def places(self) -> Array:
        """Contacts at the start of the hold, in the object's frame (spans, n, 2, 3) [m]."""
        poses = self.source.poses.coefficients[self.start_pieces, self.item, :, 0]
        return in_frame(poses[:, None, None], bends(self.source)[self.start_pieces, :, 1:3, :, 0])

    @lazy
    def chords(self) -> Enclosed:
        """Straight parts of edges, before and behind the object (spans, n, 2) [m]."""
        return _straight_parts(self.corners)

    @lazy
    def legs(self) -> Enclosed:
        """Legs of cables (spans, n, 2) [m]."""
        legs = self.of_items(leg_vectors(self.source))
        return Enclosed(legs.reshape(len(self), -1, 2, *legs.shape[2:]), self.noise)

    @lazy
    def tension(self) -> Enclosed:
        """Tensions of edges (spans, n) [N]."""
        return Enclosed(self.of_items(self.source.tensions.coefficients)[:, :, None])

    @lazy
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
        return self.chords.direction * add_axis(pull) * -SIGNS

    @lazy
    def slip_load(self) -> Array:
        """Lower bound of ``μ Σ T_k θ_k`` (spans,) [N].

        ``T_k`` is the smallest pull of cable k's legs, reduced by friction at its clasps.
        """
        clasped = np.max(_angles(-self.legs, self.chords * SIGNS).high, axis=-1)
        pulls = np.min(self.of_items(self.source.pulls.coefficients), axis=-1)
        pulls = np.min(pulls.reshape(len(self), -1, 2), axis=-1)
        pulls = pulls * np.exp(-self.source.team.cable_friction * clasped)
        before = select(self.chords, 0).xy
        behind = select(self.chords, 1).xy
        return np.asarray(self.body.friction * np.sum(pulls * _angles(before, behind).low, axis=-1))

    @lazy
    def load(self) -> Array:
        """Upper bound (spans,) [N] of the carried ``m (g + a_z)`` plus the load of turning."""
        carried = ((self.acceleration[2] + GRAVITY) * self.share).upper.value
        angular = self.derivative(self.source.poses, 2)
        angular_size = Enclosed(angular.c[:, 3:], angular.r).norm_upper.value
        return np.asarray(self.body.mass * (carried + angular_size * turning_reach(self.body)))


def _straight_parts(corners: Enclosed) -> Enclosed:
    """Return the straight parts (…, 2) [m] of edges that bend at corners (…, 4)."""
    return select(corners, [1, 3]) - select(corners, [0, 2])


def _angles(a: Enclosed, b: Enclosed) -> Interval:
    """Return intervals of the angles [rad] between two vectors."""
    cosine = a.direction.dot(b.direction).range
    return Interval(
        low=np.arccos(np.clip(cosine.high, -1.0, 1.0)),
        high=np.arccos(np.clip(cosine.low, -1.0, 1.0)),
    )


def turning_reach(body: SolidObject) -> float:
    """Return the load of a turning object over its mass and angular acceleration [m]."""
    section = body.section
    distances = np.linalg.norm(section.core - section.centroid, axis=-1)
    arm = section.rounding or float(np.min(distances))
    return (float(np.max(distances)) + section.rounding) ** 2 / arm


def slip_ratio(spans: Gripped) -> Bound:
    """Return slip load over load, infinity without a load.

    It is minus infinity where edges are not wrapped around the object.
    """
    carried = np.any(spans.share.c > 0.0, axis=(1, 2))
    ratio = _ratio(spans.slip_load, np.where(carried, spans.load * (1.0 + ROUNDING), 0.0))
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
    unsupported = np.any(~_straight(Enclosed(bends(motion))), axis=1)
    cases = [WorstCase(math.inf, 0.0)]
    for index, name, pieces in gripped_objects(motion):
        unsupported &= ~pieces
        parts = Gripped.of_object(motion, index, pieces)
        smallest = worst(parts, slip_ratio, "min", target=with_tolerance(limit, "min"))
        cases.append(WorstCase(smallest.worst, smallest.time, (name,)))
    if np.any(unsupported):
        cases.append(WorstCase(-math.inf, float(motion.drones.breaks[int(np.argmax(unsupported))])))
    return min(cases, key=lambda case: case.worst)


FORMULAS = (slip_ratio, Gripped.slip_load, Gripped.load)

GRIP = CheckRule(
    "grip",
    "1",
    "min",
    lambda motion: GRIP_LIMIT if gripped_objects(motion) or motion.has_wraps else None,
    (Evaluator(_slipping, TAUT_STATES | FREE_STATES, formulas=FORMULAS),),
    "lower the object's mass, raise the tension, or use rougher cables",
    whole=True,  # relative to the start of holds
)


def _straight(corners: Enclosed) -> Mask:
    """Return whether both contacts are one point on the straight edge (pieces, edges)."""
    start, first, last, end = (select(corners, i) for i in range(4))
    offset = (first - start).cross(end - last).norm_upper.value
    is_point = (last - first).norm_upper.value <= WRAP_GAP
    return np.asarray(is_point & (offset <= WRAP_GAP * ((end - start).norm_upper.value + WRAP_GAP)))


def _misplaced(spans: Gripped) -> Mask:
    """Return on which spans edges are not properly wrapped around the object (spans,).

    Every edge must be straight or touch the section at both contacts, keep all of the section on
    its right, and turn right by less than half a turn. Contacts must stay at the height on the
    object at which the hold began, and must not turn about the object on average.
    """
    local = in_object_frame(spans.pose, spans.corners)
    tolerance = WRAP_GAP + np.max(local.r, axis=-1)
    corners = Enclosed(local.c)
    on_object = _straight(corners) | _touching(spans.body.section, corners, tolerance)
    crosses_section = np.any(_section_is_left(spans.body.section, corners, tolerance), axis=-1)
    off_height = np.any(~_on_height(spans, corners, tolerance), axis=-1)
    invalid = ~on_object | crosses_section | off_height | _turns_left(corners, tolerance)
    carried = carried_objects(spans.source)[spans.piece, spans.item]
    return np.asarray((_rotated(spans, corners) & carried) | np.any(invalid, axis=1))


def _touching(section: Section, corners: Enclosed, tolerance: Array) -> Mask:
    """Return which edges (spans, edges) touch a section at both contacts."""
    # Contacts are at corners of a polygon, or on a circle.
    offsets = add_axis(select(corners, [1, 2]).xy) - section.core
    if section.outline is None:
        squared = offsets.dot(offsets) - section.rounding**2
        deviation = squared.norm_upper.value / section.rounding
    else:
        deviation = offsets.norm_upper.value
    nearest_corner = np.min(deviation, axis=-1)
    return np.asarray(np.all(nearest_corner <= tolerance[..., None], axis=-1))


def _section_is_left(section: Section, corners: Enclosed, tolerance: Array) -> Mask:
    """Return which straight parts with a length may have some of a section on their left."""
    parts = _straight_parts(corners).xy
    starts = add_axis(select(corners, [0, 2]).xy)
    left = add_axis(parts).cross(section.core - starts)
    reach = left + add_axis(parts.norm) * section.rounding
    farthest = np.max(reach.upper.value, axis=-1)
    lengths = parts.norm_range
    has_length = lengths.high > WRAP_GAP
    return np.asarray((farthest > tolerance[..., None] * lengths.low) & has_length)


def _turns_left(corners: Enclosed, tolerance: Array) -> Mask:
    """Return which edges (spans, edges) may turn left, or right by more than half a turn."""
    parts = _straight_parts(corners).xy
    before = select(parts, 0)
    behind = select(parts, 1)
    right = behind.cross(before).range
    along = before.dot(behind).range
    left_turn = right.low < -tolerance * np.maximum(along.high, -along.low)
    half_turn = (along.low <= 0.0) & (right.low <= 0.0)
    return np.asarray(left_turn | half_turn)


def _on_height(spans: Gripped, corners: Enclosed, tolerance: Array) -> Mask:
    """Return which contacts (spans, edges, 2) stay at the height at which the hold began."""
    contact_heights = select(corners, [1, 2])[2]
    drift = (contact_heights - spans.places[:, :, :1, 2:]).norm_upper.value
    heights = contact_heights.range
    on_object = (heights.low >= spans.body.lower) & (heights.high <= spans.body.upper)
    return np.asarray((drift <= tolerance[..., None]) & on_object)


def _rotated(spans: Gripped, corners: Enclosed) -> Mask:
    """Return on which spans (spans,) contacts may have turned about the object, on average."""
    section = spans.body.section
    initial = unit(spans.places[..., :2] - section.centroid)
    current = (select(corners, [1, 2]).xy - section.centroid).direction
    shift = Enclosed.of(initial).cross(current).sum().sum() * section.circumradius
    contacts = 2 * initial.shape[1]
    return np.asarray(shift.norm_upper.value > PLACE_TOLERANCE * contacts)


def unbalanced(motion: Motion) -> WorstCase:
    """Return the largest ``missing_force`` of all gripped objects."""
    cases = [WorstCase(0.0, 0.0)]
    for index, name, pieces in gripped_objects(motion):
        largest = worst(Gripped.of_object(motion, index, pieces), missing_force, "max")
        cases.append(WorstCase(largest.worst, largest.time, (name,)))
    return max(cases, key=lambda case: case.worst)


def missing_force(spans: Gripped) -> Bound:
    """Return an object's missing force over the smallest tension; infinite without tension.

    It is ``Σ P_k (b̂_k - â_k) - m (a + ν g ẑ)``, ν the carried fraction of its weight, or the moment
    about its centre over its radius, both reduced by friction with its support.
    """
    body = spans.body
    pulls = spans.pulls
    force = pulls.sum().sum() - (spans.share.along_z() * GRAVITY + spans.acceleration) * body.mass
    centre = Enclosed(spans.read(centres(spans.source).coefficients), spans.noise)
    arms = select(spans.corners, [1, 2]) - add_axis(add_axis(centre))
    moment = arms.cross(pulls).sum().sum().norm_upper.value / body.section.circumradius
    friction = body.friction * body.mass * GRAVITY * (1.0 - spans.share.upper.value)
    horizontal = np.maximum(force.xy.norm_upper.value, moment) - friction
    missing = np.hypot(np.maximum(horizontal, 0.0), force[2].norm_upper.value)
    return _ratio(missing, np.min(spans.tension.lower.value, axis=-1))


MIN_HINGE = 0.03  # [m] Height of two clasps above the centre of mass, in addition to errors


def _hinge_limit(motion: Motion) -> float | None:
    """Return the smallest height of the clasps of two cables above a centre of mass [m]."""
    is_hinge = motion.team.layout.closed and motion.team.robots == 2 and gripped_objects(motion)
    tube = motion.requirements.limits.tube
    return MIN_HINGE + tube.level * tube.ratio if is_hinge else None


def hinge_height(spans: Gripped) -> Bound:
    """Return the height of the lowest clasp above the centre of mass [m]; infinite at no load."""
    clasps = Enclosed(spans.of_items(spans.source.vertices.coefficients), spans.noise)
    centre = Enclosed(spans.read(centres(spans.source).coefficients), spans.noise)
    heights = (clasps - add_axis(centre))[2].lower.value
    carried = np.any(spans.share.c > 0.0, axis=(1, 2))
    lowest = np.where(carried, np.min(heights, axis=-1), np.inf)
    return Bound(lowest, np.full(len(lowest), 0.5))


def _lowest_hinge(motion: Motion, limit: float) -> WorstCase:
    """Return the smallest height of clasps above the centre of mass of an object they carry."""
    cases = [WorstCase(math.inf, 0.0)]
    for index, name, pieces in gripped_objects(motion):
        parts = Gripped.of_object(motion, index, pieces)
        smallest = worst(parts, hinge_height, "min", target=with_tolerance(limit, "min"))
        cases.append(WorstCase(smallest.worst, smallest.time, (name,)))
    return min(cases, key=lambda case: case.worst)


HINGE = CheckRule(
    "hinge",
    "m",
    "min",
    _hinge_limit,
    (Evaluator(_lowest_hinge, HITCHED_STATE, formulas=(hinge_height,)),),
    "tie higher above the centre of mass",
)
"""Two clasps are a hinge: an object hangs upright from them, but falls over above them."""


@cached
def wrapped_arcs(motion: Motion) -> Array:
    """Return chords of arcs, the radius of their circle, and the length of a polygon's sides.

    Returns
    -------
    (pieces, n, 5, degree + 1) [m]: coordinates of the chord, and two constants.
    """
    contacts = motion.contacts.coefficients
    rows = np.zeros((*contacts.shape[:2], 5, contacts.shape[-1]))
    rows[:, :, :3] = contacts[:, :, 1] - contacts[:, :, 0]
    for index, name, pieces in gripped_objects(motion):
        section = motion.requirements.objects[name].section
        rows[pieces, :, 3] = section.rounding
        if section.outline is not None:
            poses = motion.poses.coefficients[pieces, index, :, 0]
            local = in_frame(poses[:, None, None], contacts[pieces, ..., 0])
            rows[pieces, :, 4] = _sides(section, local[..., :2])[..., None]
    return rows


def _sides(section: Section, contacts: Array) -> Array:
    """Return the clockwise length (…) [m] of the outline between contacts (…, 2, 2) [m]."""
    core = section.core
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.roll(core, -1, axis=0) - core, axis=-1)))
    distances = np.linalg.norm(contacts[..., None, :] - core, axis=-1)
    first, last = np.moveaxis(np.argmin(distances, axis=-1), -1, 0)
    sides: Array = (lengths[last] - lengths[first]) % lengths[-1]
    straight = np.linalg.norm(contacts[..., 1, :] - contacts[..., 0, :], axis=-1) < MIN_CHORD
    return np.where(straight, 0.0, sides)


def arc_lengths(rows: Array) -> Enclosed:
    """Return the lengths of arcs (…) [m] from ``wrapped_arcs`` (…, 5, degree + 1).

    On a circle of radius R, the arc over a chord s is ``2 R asin(s / 2R)``, enclosed about its
    tangent at the middle of the range of s. Between corners of a polygon, it is a sum of sides.
    """
    width, sides = 2.0 * rows[..., 3, 0], rows[..., 4, 0]
    size = np.where(width > 0.0, width, 1.0)
    chord = Enclosed(rows[..., :3, :]).norm * (1.0 / size)[..., None]
    low, high = (np.clip(end, 0.0, 1.0) for end in (chord.range.low, chord.range.high))
    middle = 0.5 * (low + high)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (1.0 - middle**2) ** -0.5
        error = 0.125 * (high - low) ** 2 * high * (1.0 - high**2) ** -1.5  # asin'' grows
    valid = (width > 0.0) & np.isfinite(error)
    slope, arc = (np.where(valid, x, 0.0)[..., None] for x in (slope, np.arcsin(middle)))
    lengths = ((chord - middle[..., None]) * slope + arc) * width[..., None] + sides[..., None]
    return lengths.widened(np.where(valid, width * error, np.where(width > 0.0, np.inf, 0.0)))


PLACE_TOLERANCE = 1e-4  # [m] Largest drift of clasps below a rim, and mean drift of contacts


class Resting(Held):
    """Spans of an object with a rim that rests on all clasps."""

    @lazy
    def clasps(self) -> Enclosed:
        """Clasps (spans, n) [m] in the object's frame."""
        c = self.of_items(self.source.vertices.coefficients)
        return in_object_frame(self.pose, Enclosed(c, self.noise))

    @lazy
    def places(self) -> Array:
        """Horizontal positions of the clasps at the start of the hold (spans, n, 2) [m]."""
        poses = self.source.poses.coefficients[self.start_pieces, self.item, :, 0]
        clasps = self.source.vertices.coefficients[self.start_pieces, ..., 0]
        return in_frame(poses[:, None], clasps)[..., :2]


def force_line(spans: Resting) -> Bound:
    """Return the distance of the force line from the edges of the clasps' polygon [m]."""
    places, body = spans.places, spans.body
    centre = body.centre_of_mass
    edges = unit(np.roll(places, -1, axis=1) - places)
    inward = -left_of(edges)  # of clockwise edges
    gaps = np.sum(inward * (centre[:2] - places), axis=-1)
    heading = Enclosed(spans.pose.c[:, 3:])
    horizontal = add_axis(rotate_back(spans.acceleration.xy, heading))
    shift = horizontal.dot(inward) * (centre[2] - known(body.rim).height)
    weight = add_axis(spans.acceleration[2] + GRAVITY).range
    margin = (ROUNDING + heading_error(heading)) * (magnitude(spans.source) + body.circumradius)
    lowest = np.where(weight.low > 0.0, gaps - (shift.range * weight.inverse).high, -np.inf)
    k = np.arange(len(spans)), np.argmin(lowest, axis=1)
    return Bound(lowest[k] - margin - 2.0 * PLACE_TOLERANCE, shift.upper.x[k])


def foot(spans: Gripped) -> Bound:
    """Return how far within its foot a standing object is pressed on its support [m].

    Edges pull with a moment about the point below the centre of mass. The support's force is that
    moment over the weight beside it.
    """
    body = spans.body
    centre = Enclosed(spans.read(centres(spans.source).coefficients), spans.noise)
    down = np.array([0.0, 0.0, body.centre_of_mass[2] - body.lower])
    arms = select(spans.corners, [1, 2]) - add_axis(add_axis(centre - Enclosed.of(down)))
    moment = arms.cross(spans.pulls).sum().sum().xy.norm_upper
    inside = -float(body.section.clearance(body.section.centroid)[0])
    return Bound(inside - moment.value / (body.mass * GRAVITY), moment.x)


def _force_lines(motion: Motion, _: float) -> WorstCase:
    """Return the minimum distance of a force line from the edge of its supports [m].

    It is minus infinity if an object moves or is carried without a hold, if it floats, if its
    heading is not a unit vector, if holding clasps do not surround it or have left their positions,
    or if it would slide. Two cables must not push over an object as they are tied around it.
    """
    size, begins = magnitude(motion), motion.drones.breaks
    each = [WorstCase(math.inf, 0.0, size=size)]
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        share = motion.load_share.coefficients[:, index]
        moves, carried = moving_objects(motion)[:, index], carried_objects(motion)[:, index]
        fully = np.all(share == 1.0, axis=-1)
        resting, gripped = (held_pieces(motion, name, by) for by in (HoldBy.REST, HoldBy.GRIP))
        heading = Enclosed(motion.poses.coefficients[:, index, 3:])
        invalid = (moves & ~fully) | (heading_error(heading) > CONTACT_GAP)
        if not body.fixed:
            invalid |= _floating(motion, index, name, ~fully & ~moves)
        invalid |= np.any((share < 0.0) | (share > 1.0), axis=-1)
        invalid |= carried & (~(resting | gripped) | ~motion.formed | body.fixed)
        if body.rim is None or not motion.team.layout.closed:
            invalid |= resting
        for spans in Resting.of_object(motion, index, resting & ~invalid):
            invalid[spans.piece] = _misplaced_clasps(spans, carried[spans.piece])
        if motion.team.layout.closed and motion.team.robots == 2 and not body.fixed:
            standing = Gripped.of_object(motion, index, gripped & ~carried & ~moves)
            pressed = worst(standing, foot, "min")
            each.append(WorstCase(pressed.worst, pressed.time, (name,), size))
        parts = Resting.of_object(motion, index, resting & carried & fully & ~invalid)
        smallest = worst(parts, force_line, "min")
        each.append(WorstCase(smallest.worst, smallest.time, (name,), size))
        if np.any(invalid):
            each.append(WorstCase(-math.inf, float(begins[int(np.argmax(invalid))]), (name,)))
    return min(each, key=lambda case: case.worst)


def _floating(motion: Motion, index: int, name: str, at_rest: Mask) -> Mask:
    """Return on which pieces ``at_rest`` an object has no support below (pieces,)."""
    objects = motion.requirements.objects
    poses = np.round(motion.poses.coefficients[..., 0] / REST_DRIFT) * REST_DRIFT
    places, inverse = np.unique(poses, axis=0, return_inverse=True)
    supported = np.zeros(len(places), dtype=np.bool_)
    for i in np.unique(inverse.ravel()[at_rest]):
        surface, _ = surface_below(objects, places[i], name, motion.requirements.floor)
        gap = float(places[i, index, 2]) + objects[name].lower - surface
        supported[i] = abs(gap) <= CONTACT_GAP
    return at_rest & ~supported[inverse.ravel()]


def _misplaced_clasps(spans: Resting, carried: Mask) -> Mask:
    """Return on which spans clasps are above a rim, or did not surround the body at the start.

    If the object is ``carried`` (spans,), clasps must also keep their positions since the start of
    the hold, ``rim_drop`` below the rim, and friction must prevent sliding.
    """
    motion, body, rim, places = spans.source, spans.body, known(spans.body.rim), spans.places
    next_places, to_centre = np.roll(places, -1, axis=1), body.section.centroid - places
    edges = next_places - places
    invalid = cross(to_centre, edges) <= 0.0
    invalid |= Enclosed(spans.clasps.c)[2].upper.value > rim.height + PLACE_TOLERANCE
    pulls = motion.tensions.coefficients[spans.piece, :, 0]
    drop = rim_drop(motion.team, body, places, pulls)[:, None]
    fully = np.all(spans.share.c == 1.0, axis=(1, 2))[:, None]
    heights = spans.clasps[2].range
    deviation = (spans.clasps.xy - places).norm_upper.value
    deviation = np.maximum(deviation, rim.height - heights.low - drop)
    deviation = np.maximum(deviation, heights.high - rim.height + np.where(fully, drop, 0.0))
    unsupported = deviation > PLACE_TOLERANCE
    unsupported |= rim.section.clearance(places)[0] >= -PLACE_TOLERANCE
    if body.stem is not None:
        unsupported |= body.stem.segment_distance(places, next_places) <= PLACE_TOLERANCE
    pushed = Enclosed(spans.of_items(motion.vertices.differentiated(2).coefficients))
    unsupported |= pushed.xy.norm_upper.value > body.friction * (GRAVITY + pushed[2].lower.value)
    return np.asarray(np.any(invalid | (unsupported & carried[:, None]), axis=1))


SUPPORT = CheckRule(
    "support",
    "m",
    "min",
    lambda motion: 0.0 if motion.requirements.objects else None,
    (Evaluator(_force_lines, TAUT_STATES | FREE_STATES, formulas=(force_line,)),),
    "carry it more gently, or hold it farther out or closer below its centre of mass",
    whole=True,
)
