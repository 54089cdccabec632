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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Self

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

GRIP_LIMIT = 1.5
"""Smallest slip load over load."""

WRAP_GAP = 2e-5
"""[m] Largest gap or overlap of an edge and the section it is wrapped around."""

MIN_CHORD = 1e-9
"""[m] Arcs with shorter chords are their chords."""

PLACE_TOLERANCE = 1e-4
"""[m] Largest drift of clasps below a rim, and mean drift of contacts."""

SIGNS = np.array([[1.0], [-1.0]])
"""Signs of the straight parts of an edge: it leads to the object before it, away from it behind."""


def add_axis(value: Enclosed) -> Enclosed:
    """Return a value (…) with a new last leading axis (…, 1)."""
    return Enclosed(value.c[..., None, :, :], np.asarray(value.r)[..., None])


def select(value: Enclosed, items: int | list[int]) -> Enclosed:
    """Return items of the last leading axis."""
    radii = np.broadcast_to(value.r, value.c.shape[:-2])
    return Enclosed(value.c[..., items, :, :], radii[..., items])


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
    core = slab.section.core
    pose = add_axis(add_axis(pose))
    outline = Enclosed.of(np.tile(core, (2, 1)))
    heights = np.repeat([slab.lower, slab.upper], len(core))[:, None]
    world_heading = Enclosed(pose.c[..., 3:, :] * [[1.0], [-1.0]])  # in the object's frame
    offsets = vector(rotate_back(outline, world_heading), Enclosed.of(heights))
    return offsets + Enclosed(pose.c[..., :3, :], pose.r)


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
    poses = motion.poses.coefficients
    bodies = motion.requirements.objects.values()
    paths = [centre_path(poses[:, index], body) for index, body in enumerate(bodies)]
    return motion.poses.replaced(np.stack(paths, axis=1))


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
        items = np.arange(table.shape[1])
        return self.read(table, np.broadcast_to(items, (len(self), len(items))))

    @lazy
    def start_pieces(self) -> Indices:
        """(spans,) First pieces of the current holds; the spans' own if not carried."""
        carried = carried_objects(self.source)
        pieces = np.arange(len(carried))[:, None]
        continues = carried & np.roll(carried, 1, axis=0)
        starts = np.maximum.accumulate(np.where(continues, 0, pieces))
        return np.asarray(starts[self.piece, self.item])

    @lazy
    def pose(self) -> Enclosed:
        """x, y, z [m], cosine and sine of yaw."""
        return Enclosed(self.read(self.source.poses.coefficients), self.noise)

    @lazy
    def centre(self) -> Enclosed:
        """Centre of mass [m]."""
        return Enclosed(self.read(centres(self.source).coefficients), self.noise)

    @lazy
    def acceleration(self) -> Enclosed:
        """Acceleration of the centre of mass [m/s²]."""
        return self.derivative(centres(self.source), 2)

    @lazy
    def share(self) -> Enclosed:
        """Fraction of its weight that cables carry."""
        return Enclosed(self.read(self.source.load_share.coefficients)[:, None])


class GrippedObject(NamedTuple):
    """An object that edges are wrapped around."""

    object_index: int
    """Its index."""

    name: str
    """Its name."""

    pieces: Mask
    """(pieces,), on which it is gripped."""


def gripped_objects(motion: Motion) -> list[GrippedObject]:
    """Return all objects that are gripped on any piece."""
    gripped = []
    for index, name in enumerate(motion.requirements.objects):
        pieces = held_pieces(motion, name, HoldBy.GRIP)
        if np.any(pieces):
            gripped.append(GrippedObject(index, name, pieces))
    return gripped


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
        contacts = bends(self.source)[self.start_pieces, :, 1:3, :, 0]
        return in_frame(poses[:, None, None], contacts)

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
        team = self.source.team
        pull = self.tension
        if team.cable_density > 0.0:
            taut = Enclosed(self.of_items(tautness(self.source))[:, :, None])
            half_density = taut * (0.5 * GRAVITY * team.cable_density)
            edge = Enclosed(team.cable_length[:, None, None]) - self.legs.norm.sum()
            pull = chord_pull(pull, half_density, edge * edge)
        return self.chords.direction * add_axis(pull) * -SIGNS

    @lazy
    def slip_load(self) -> Array:
        """Lower bound of ``μ Σ T_k θ_k`` (spans,) [N].

        ``T_k`` is the smallest pull of cable k's legs, reduced by friction at its clasps.
        """
        turn_at_clasp = np.max(_angles(-self.legs, self.chords * SIGNS).high, axis=-1)
        leg_pulls = np.min(self.of_items(self.source.pulls.coefficients), axis=-1)
        smaller_pulls = np.min(leg_pulls.reshape(len(self), -1, 2), axis=-1)
        tensions = smaller_pulls * np.exp(-self.source.team.cable_friction * turn_at_clasp)
        before = select(self.chords, 0).xy
        behind = select(self.chords, 1).xy
        wraps = _angles(before, behind).low
        return np.asarray(self.body.friction * np.sum(tensions * wraps, axis=-1))

    @lazy
    def load(self) -> Array:
        """Upper bound (spans,) [N] of the carried ``m (g + a_z)`` plus the load of turning."""
        carried = ((self.acceleration[2] + GRAVITY) * self.share).upper.value
        pose_rate = self.derivative(self.source.poses, 2)
        angular_acceleration = Enclosed(pose_rate.c[:, 3:], pose_rate.r).norm_upper.value
        turning = angular_acceleration * turning_reach(self.body)
        return np.asarray(self.body.mass * (carried + turning))


def _cases_of_gripped(
    motion: Motion, formula: Callable[[Gripped], Bound], sense: str, limit: float = math.nan
) -> Iterator[WorstCase]:
    """Yield the worst value of a formula for every gripped object.

    Bounds are as tight as the comparison with a ``limit`` requires.
    """
    for index, name, pieces in gripped_objects(motion):
        spans = Gripped.of_object(motion, index, pieces)
        extremum = worst(spans, formula, sense, target=with_tolerance(limit, sense))
        yield WorstCase(extremum.worst, extremum.time, (name,))


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
    radii = np.linalg.norm(section.core - section.centroid, axis=-1)
    arm = section.rounding or float(np.min(radii))
    largest_radius = float(np.max(radii)) + section.rounding
    return largest_radius**2 / arm


def slip_ratio(spans: Gripped) -> Bound:
    """Return slip load over load, infinity without a load.

    It is minus infinity where edges are not wrapped around the object.
    """
    is_carried = np.any(spans.share.c > 0.0, axis=(1, 2))
    load = np.where(is_carried, spans.load * (1.0 + ROUNDING), 0.0)
    ratio = _ratio(spans.slip_load, load)
    return Bound(np.where(_misplaced(spans), -math.inf, ratio.value), ratio.x)


def _ratio(dividend: Array, divisor: Array) -> Bound:
    """Return a quotient (spans,); infinite where the divisor is not positive."""
    infinite = np.full_like(dividend, math.inf)
    ratio = np.divide(dividend, divisor, out=infinite, where=divisor > 0.0)
    return Bound(ratio, np.full(len(ratio), 0.5))


def spare_friction(motion: Motion, index: int) -> Array:
    """Return the spare load (pieces,) [N] of an object gripped on all pieces."""
    parts = Gripped.of_object(motion, index, np.ones(motion.drones.pieces, dtype=np.bool_))
    return np.concatenate([spans.slip_load / GRIP_LIMIT - spans.load for spans in parts])


def _slipping(motion: Motion, limit: float) -> WorstCase:
    """Return the smallest ratio of slip load to load.

    It is minus infinity if an edge bends without a gripped object, or off the object's section.
    """
    cases = [WorstCase(math.inf, 0.0), *_cases_of_gripped(motion, slip_ratio, "min", limit)]
    is_bent_freely = np.any(~_straight(Enclosed(bends(motion))), axis=1)
    for gripped in gripped_objects(motion):
        is_bent_freely &= ~gripped.pieces
    if np.any(is_bent_freely):
        first = int(np.argmax(is_bent_freely))
        cases.append(WorstCase(-math.inf, float(motion.drones.breaks[first])))
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
    start, first, last, end = (select(corners, corner) for corner in range(4))
    area = (first - start).cross(end - last).norm_upper.value
    length = (end - start).norm_upper.value
    is_point = (last - first).norm_upper.value <= WRAP_GAP
    is_on_edge = area <= WRAP_GAP * (length + WRAP_GAP)
    return np.asarray(is_point & is_on_edge)


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
    cases = [WorstCase(0.0, 0.0), *_cases_of_gripped(motion, missing_force, "max")]
    return max(cases, key=lambda case: case.worst)


def missing_force(spans: Gripped) -> Bound:
    """Return an object's missing force over the smallest tension; infinite without tension.

    It is ``Σ P_k (b̂_k - â_k) - m (a + ν g ẑ)``, ν the carried fraction of its weight, or the moment
    about its centre over its radius, both reduced by friction with its support.
    """
    body = spans.body
    needed = (spans.share.along_z() * GRAVITY + spans.acceleration) * body.mass
    force = spans.pulls.sum().sum() - needed
    arms = select(spans.corners, [1, 2]) - add_axis(add_axis(spans.centre))
    moment = arms.cross(spans.pulls).sum().sum().norm_upper.value
    friction = body.friction * body.mass * GRAVITY * (1.0 - spans.share.upper.value)
    push = np.maximum(force.xy.norm_upper.value, moment / body.section.circumradius)
    horizontal = np.maximum(push - friction, 0.0)
    missing = np.hypot(horizontal, force[2].norm_upper.value)
    return _ratio(missing, np.min(spans.tension.lower.value, axis=-1))


MIN_HINGE = 0.03
"""[m] Height of two clasps above the centre of mass, in addition to errors."""


def _hinge_limit(motion: Motion) -> float | None:
    """Return the smallest height of the clasps of two cables above a centre of mass [m]."""
    if not _has_two_cables(motion) or not gripped_objects(motion):
        return None
    tube = motion.requirements.limits.tube
    return MIN_HINGE + tube.level * tube.ratio


def _has_two_cables(motion: Motion) -> bool:
    """Return whether a closed hitch has only two cables."""
    return motion.team.layout.closed and motion.team.robots == 2


def hinge_height(spans: Gripped) -> Bound:
    """Return the height of the lowest clasp above the centre of mass [m]; infinite at no load."""
    clasps = Enclosed(spans.of_items(spans.source.vertices.coefficients), spans.noise)
    heights = (clasps - add_axis(spans.centre))[2].lower.value
    is_carried = np.any(spans.share.c > 0.0, axis=(1, 2))
    lowest = np.where(is_carried, np.min(heights, axis=-1), np.inf)
    return Bound(lowest, np.full(len(lowest), 0.5))


def _lowest_hinge(motion: Motion, limit: float) -> WorstCase:
    """Return the smallest height of clasps above the centre of mass of an object they carry."""
    cases = [WorstCase(math.inf, 0.0), *_cases_of_gripped(motion, hinge_height, "min", limit)]
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
    side_lengths = np.linalg.norm(np.roll(core, -1, axis=0) - core, axis=-1)
    along_outline = np.append(0.0, np.cumsum(side_lengths))
    distances = np.linalg.norm(contacts[..., None, :] - core, axis=-1)
    first, last = np.moveaxis(np.argmin(distances, axis=-1), -1, 0)
    sides: Array = (along_outline[last] - along_outline[first]) % along_outline[-1]
    chords = np.linalg.norm(contacts[..., 1, :] - contacts[..., 0, :], axis=-1)
    return np.where(chords < MIN_CHORD, 0.0, sides)


def arc_lengths(rows: Array) -> Enclosed:
    """Return the lengths of arcs (…) [m] from ``wrapped_arcs`` (…, 5, degree + 1).

    On a circle of radius R, the arc over a chord s is ``2 R asin(s / 2R)``, enclosed about its
    tangent at the middle of the range of s. Between corners of a polygon, it is a sum of sides.
    """
    diameter = 2.0 * rows[..., 3, 0]
    sides = rows[..., 4, 0]
    is_circle = diameter > 0.0
    chord = Enclosed(rows[..., :3, :]).norm * (1.0 / np.where(is_circle, diameter, 1.0))[..., None]
    lowest = np.clip(chord.range.low, 0.0, 1.0)
    highest = np.clip(chord.range.high, 0.0, 1.0)
    middle = 0.5 * (lowest + highest)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (1.0 - middle**2) ** -0.5
        # The second derivative of asin, x (1 - x²)^(-3/2), grows with x.
        error = 0.125 * (highest - lowest) ** 2 * highest * (1.0 - highest**2) ** -1.5
    is_bounded = is_circle & np.isfinite(error)
    tangent_slope = np.where(is_bounded, slope, 0.0)[..., None]
    mid_arc = np.where(is_bounded, np.arcsin(middle), 0.0)[..., None]
    arcs = ((chord - middle[..., None]) * tangent_slope + mid_arc) * diameter[..., None]
    lengths = arcs + sides[..., None]
    unbounded = np.where(is_circle, np.inf, 0.0)
    return lengths.widened(np.where(is_bounded, diameter * error, unbounded))


class Resting(Held):
    """Spans of an object with a rim that rests on all clasps."""

    @lazy
    def clasps(self) -> Enclosed:
        """Clasps (spans, n) [m] in the object's frame."""
        clasps = self.of_items(self.source.vertices.coefficients)
        return in_object_frame(self.pose, Enclosed(clasps, self.noise))

    @lazy
    def places(self) -> Array:
        """Horizontal positions of the clasps at the start of the hold (spans, n, 2) [m]."""
        poses = self.source.poses.coefficients[self.start_pieces, self.item, :, 0]
        clasps = self.source.vertices.coefficients[self.start_pieces, ..., 0]
        return in_frame(poses[:, None], clasps)[..., :2]


def force_line(spans: Resting) -> Bound:
    """Return the distance of the force line from the edges of the clasps' polygon [m]."""
    body = spans.body
    centre = body.centre_of_mass
    places = spans.places
    edges = unit(np.roll(places, -1, axis=1) - places)
    inward = -left_of(edges)  # of clockwise edges
    gaps = np.sum(inward * (centre[:2] - places), axis=-1)
    heading = Enclosed(spans.pose.c[:, 3:])
    horizontal = add_axis(rotate_back(spans.acceleration.xy, heading))
    height = centre[2] - known(body.rim).height
    tilt = horizontal.dot(inward) * height
    weight = add_axis(spans.acceleration[2] + GRAVITY).range
    shift = (tilt.range * weight.inverse).high
    distances = np.where(weight.low > 0.0, gaps - shift, -np.inf)
    nearest_edge = np.argmin(distances, axis=1)
    of_spans = np.arange(len(spans))
    error = (ROUNDING + heading_error(heading)) * (magnitude(spans.source) + body.circumradius)
    smallest = distances[of_spans, nearest_edge] - error - 2.0 * PLACE_TOLERANCE
    return Bound(smallest, tilt.upper.x[of_spans, nearest_edge])


def foot(spans: Gripped) -> Bound:
    """Return how far within its foot a standing object is pressed on its support [m].

    Edges pull with a moment about the point below the centre of mass. The support's force is that
    moment over the weight beside it.
    """
    body = spans.body
    height = np.array([0.0, 0.0, body.centre_of_mass[2] - body.lower])
    base = spans.centre - Enclosed.of(height)
    arms = select(spans.corners, [1, 2]) - add_axis(add_axis(base))
    moment = arms.cross(spans.pulls).sum().sum().xy.norm_upper
    inside = -float(body.section.clearance(body.section.centroid)[0])
    return Bound(inside - moment.value / (body.mass * GRAVITY), moment.x)


def _force_lines(motion: Motion, _: float) -> WorstCase:
    """Return the minimum distance of a force line from the edge of its supports [m].

    It is minus infinity if an object moves or is carried without a hold, if it floats, if its
    heading is not a unit vector, if holding clasps do not surround it or have left their positions,
    or if it would slide. Two cables must not push over an object as they are tied around it.
    """
    size = magnitude(motion)
    cases = [WorstCase(math.inf, 0.0, size=size)]
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        support = _ObjectSupport.of(motion, index, name, body)
        invalid = support.invalid_pieces()
        if _has_two_cables(motion) and not body.fixed:
            stands = support.gripped & ~support.carried & ~support.moves
            pressed = worst(Gripped.of_object(motion, index, stands), foot, "min")
            cases.append(WorstCase(pressed.worst, pressed.time, (name,), size))
        rests = support.resting & support.carried & support.fully_carried & ~invalid
        smallest = worst(Resting.of_object(motion, index, rests), force_line, "min")
        cases.append(WorstCase(smallest.worst, smallest.time, (name,), size))
        if np.any(invalid):
            start = float(motion.drones.breaks[int(np.argmax(invalid))])
            cases.append(WorstCase(-math.inf, start, (name,)))
    return min(cases, key=lambda case: case.worst)


@dataclass(frozen=True, eq=False)
class _ObjectSupport:
    """How an object is supported, on all pieces of a motion."""

    motion: Motion
    """The motion."""

    index: int
    """The object's index."""

    name: str
    """Its name."""

    body: SolidObject
    """The object."""

    moves: Mask
    """(pieces,), whether it moves."""

    carried: Mask
    """(pieces,), whether it moves or clasps carry some of its weight."""

    fully_carried: Mask
    """(pieces,), whether clasps carry all of its weight."""

    resting: Mask
    """(pieces,), whether phases state that it rests on clasps."""

    gripped: Mask
    """(pieces,), whether phases state that edges grip it."""

    @classmethod
    def of(cls, motion: Motion, index: int, name: str, body: SolidObject) -> _ObjectSupport:
        """Return the support of an object."""
        share = motion.load_share.coefficients[:, index]
        return cls(
            motion,
            index,
            name,
            body,
            moves=moving_objects(motion)[:, index],
            carried=carried_objects(motion)[:, index],
            fully_carried=np.all(share == 1.0, axis=-1),
            resting=held_pieces(motion, name, HoldBy.REST),
            gripped=held_pieces(motion, name, HoldBy.GRIP),
        )

    def invalid_pieces(self) -> Mask:
        """Return on which pieces the object is not supported as stated (pieces,)."""
        share = self.motion.load_share.coefficients[:, self.index]
        heading = Enclosed(self.motion.poses.coefficients[:, self.index, 3:])
        invalid = (self.moves & ~self.fully_carried) | (heading_error(heading) > CONTACT_GAP)
        if not self.body.fixed:
            stands = ~self.fully_carried & ~self.moves
            invalid |= _floating(self.motion, self.index, self.name, stands)
        invalid |= np.any((share < 0.0) | (share > 1.0), axis=-1)
        is_held = self.resting | self.gripped
        invalid |= self.carried & (~is_held | ~self.motion.formed | self.body.fixed)
        if self.body.rim is None or not self.motion.team.layout.closed:
            invalid |= self.resting
        for spans in Resting.of_object(self.motion, self.index, self.resting & ~invalid):
            invalid[spans.piece] = _misplaced_clasps(spans, self.carried[spans.piece])
        return np.asarray(invalid)


def _floating(motion: Motion, index: int, name: str, at_rest: Mask) -> Mask:
    """Return on which pieces ``at_rest`` an object has no support below (pieces,)."""
    objects = motion.requirements.objects
    poses = np.round(motion.poses.coefficients[..., 0] / REST_DRIFT) * REST_DRIFT
    distinct_poses, inverse = np.unique(poses, axis=0, return_inverse=True)
    case_of_piece = inverse.ravel()
    is_supported = np.zeros(len(distinct_poses), dtype=np.bool_)
    for case in np.unique(case_of_piece[at_rest]):
        places = distinct_poses[case]
        surface, _ = surface_below(objects, places, name, motion.requirements.floor)
        gap = float(places[index, 2]) + objects[name].lower - surface
        is_supported[case] = abs(gap) <= CONTACT_GAP
    return at_rest & ~is_supported[case_of_piece]


def _misplaced_clasps(spans: Resting, carried: Mask) -> Mask:
    """Return on which spans clasps are above a rim, or did not surround the body at the start.

    If the object is ``carried`` (spans,), clasps must also keep their places below the rim, and
    friction must prevent sliding.
    """
    body = spans.body
    rim = known(body.rim)
    places = spans.places
    edges = np.roll(places, -1, axis=1) - places
    is_outside = cross(body.section.centroid - places, edges) <= 0.0
    is_above_rim = Enclosed(spans.clasps.c)[2].upper.value > rim.height + PLACE_TOLERANCE
    loses_object = _left_places(spans) | _off_rim(body, places) | _slides(spans)
    invalid = is_outside | is_above_rim | (loses_object & carried[:, None])
    return np.asarray(np.any(invalid, axis=1))


def _left_places(spans: Resting) -> Mask:
    """Return which clasps (spans, n) may have left their places since the start of the hold.

    Under the full weight, they are ``rim_drop`` below the rim, before that no lower.
    """
    motion = spans.source
    body = spans.body
    rim_height = known(body.rim).height
    tensions = motion.tensions.coefficients[spans.piece, :, 0]
    drop = rim_drop(motion.team, body, spans.places, tensions)[:, None]
    is_fully_carried = np.all(spans.share.c == 1.0, axis=(1, 2))[:, None]
    heights = spans.clasps[2].range
    sideways = (spans.clasps.xy - spans.places).norm_upper.value
    too_low = rim_height - heights.low - drop
    too_high = heights.high - rim_height + np.where(is_fully_carried, drop, 0.0)
    deviation = np.maximum(np.maximum(sideways, too_low), too_high)
    return np.asarray(deviation > PLACE_TOLERANCE)


def _off_rim(body: SolidObject, places: Array) -> Mask:
    """Return which clasps at places (spans, n, 2) [m] are not below a rim, or cut its stem."""
    rim = known(body.rim)
    is_off_rim = rim.section.clearance(places)[0] >= -PLACE_TOLERANCE
    if body.stem is None:
        return np.asarray(is_off_rim)
    gaps = body.stem.segment_distance(places, np.roll(places, -1, axis=1))
    return np.asarray(is_off_rim | (gaps <= PLACE_TOLERANCE))


def _slides(spans: Resting) -> Mask:
    """Return which clasps (spans, n) accelerate more than friction with the rim can transfer."""
    accelerations = spans.source.vertices.differentiated(2).coefficients
    pushed = Enclosed(spans.of_items(accelerations))
    largest = spans.body.friction * (GRAVITY + pushed[2].lower.value)
    return np.asarray(pushed.xy.norm_upper.value > largest)


SUPPORT = CheckRule(
    "support",
    "m",
    "min",
    lambda motion: 0.0 if motion.requirements.objects else None,
    (Evaluator(_force_lines, TAUT_STATES | FREE_STATES, formulas=(force_line,)),),
    "carry it more gently, or hold it farther out or closer below its centre of mass",
    whole=True,
)
