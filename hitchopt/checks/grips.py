"""Gripped objects: checks ``grip`` and ``yaw``, forces of edges, and lengths of arcs.

Edge k is straight from ``p_k`` to the object, along ``â_k``, turns there by ``θ_k``, seen from
above, and is straight to ``p_{k+1}``, along ``b̂_k``. It pulls with ``T_k (b̂_k - â_k)``, and
friction carries up to ``μ Σ T_k θ_k``: check ``grip``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.objects import (
    PLACE_TOLERANCE,
    Held,
    Mask,
    add_axis,
    carried_objects,
    in_object_frame,
    select,
)
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import ROUNDING, cached, joined_arrays, leg_vectors
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import level_pull
from hitchopt.hitch.twists import bend
from hitchopt.hitch.yaw import YawTerms, least_stiffness_of_turn
from hitchopt.motion.loads import held_pieces, tautness
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import Section, SolidObject
from hitchopt.objects.placing import in_frame
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, lazy

GRIP_LIMIT = 1.5  # Smallest slip load over load
WRAP_GAP = 2e-5  # [m] Largest gap or overlap of an edge and the section it is wrapped around
MIN_FORCE = 1e-12  # [N] Smallest divisor of forces
MIN_CHORD = 1e-9  # [m] Arcs with shorter chords are their chords

SIGNS = np.array([[1.0], [-1.0]])
"""Signs of the straight parts of an edge: it leads to the object before it, away from it behind."""


class GrippedObject(NamedTuple):
    """An object that edges are wrapped around."""

    object_index: int  # Its index
    name: str  # Its name
    pieces: Mask  # (pieces,), on which it is gripped


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
            pull = level_pull(pull, half_density * edge)
        return self.chords.direction * add_axis(pull) * -SIGNS

    @lazy
    def slip_load(self) -> Array:
        """Lower bound of ``μ Σ T_k θ_k`` (spans,) [N].

        ``T_k`` is the smallest pull of cable k's legs, reduced by friction at its clasps.
        """
        turn_at_clasp = np.max(_angles(-self.legs, self.chords * SIGNS).high, axis=-1)
        leg_pulls = np.min(self.of_items(self.source.pulls.coefficients), axis=-1)
        smaller_pulls = np.min(leg_pulls.reshape(len(self), -1, 2), axis=-1)
        tensions = smaller_pulls * np.exp(-self.source.team.friction * bend(np.cos(turn_at_clasp)))
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


def _smallest(formula: Callable[[Gripped], Bound]) -> Callable[[Motion, float], WorstCase]:
    """Return a function of the smallest value of a formula for all gripped objects."""

    def smallest(motion: Motion, limit: float) -> WorstCase:
        cases = [WorstCase(math.inf, 0.0), *_cases_of_gripped(motion, formula, "min", limit)]
        return min(cases, key=lambda case: case.worst)

    return smallest


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


def bent_freely(motion: Motion) -> WorstCase:
    """Return an infinite residual where an edge bends without an object that is gripped, or 0."""
    is_bent = ~_straight(Enclosed(bends(motion)))
    for gripped in gripped_objects(motion):
        is_bent[gripped.pieces] = False
    if not np.any(is_bent):
        return WorstCase(0.0, float(motion.drones.breaks[0]))
    piece, edge = np.argwhere(is_bent)[0].tolist()
    where = f"edge {edge} bends without an object"
    return WorstCase(math.inf, float(motion.drones.breaks[piece]), (where,))


FORMULAS = (slip_ratio, Gripped.slip_load, Gripped.load)

GRIP = CheckRule(
    "grip",
    "ratio",
    "min",
    lambda motion: GRIP_LIMIT if gripped_objects(motion) else None,
    (Evaluator(_smallest(slip_ratio), lambda state: state.has_cables, formulas=FORMULAS),),
    "lower the object's mass, raise the tension, or use rougher cables",
    whole=True,  # relative to the start of holds
    group="forces",
    bodies=(("held",),),
    proves="slip load over load, μ Σ T θ over m (g + a_z), with the worst friction at the clasps",
    unproven="the stated friction; that cables lie at one height",
)


def _straight(corners: Enclosed) -> Mask:
    """Return whether both contacts are one point on the straight edge (pieces, edges)."""
    start, first, last, end = (select(corners, corner) for corner in range(4))
    area = (first - start).cross(end - last).norm_upper.value
    length = (end - start).norm_upper.value
    is_point = (last - first).norm_upper.value <= WRAP_GAP
    # The area over the length is the distance of the point from the line through the ends
    is_on_line = area <= WRAP_GAP * (length + WRAP_GAP)
    return np.asarray(is_point & is_on_line)


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
    about its centre over its radius, both reduced by friction with its support, which resists a
    sliding turn with ``Section.friction_radius``.
    """
    body = spans.body
    needed = (spans.share.along_z() * GRAVITY + spans.acceleration) * body.mass
    force = spans.pulls.sum().sum() - needed
    arms = select(spans.corners, [1, 2]) - add_axis(add_axis(spans.centre))
    moment = arms.cross(spans.pulls).sum().sum()
    level_force = force.xy.norm_upper.value
    friction = body.friction * body.mass * GRAVITY * (1.0 - spans.share.upper.value)
    turning = moment[2].norm_upper.value / body.section.friction_radius
    on_support = np.hypot(level_force, turning)
    unheld = np.maximum(on_support - friction, 0.0) / np.maximum(on_support, MIN_FORCE)
    push = np.maximum(level_force, moment.norm_upper.value / body.section.circumradius)
    horizontal = unheld * push
    missing = np.hypot(horizontal, force[2].norm_upper.value)
    return _ratio(missing, np.min(spans.tension.lower.value, axis=-1))


def _yaw_limit(motion: Motion) -> float | None:
    """Return the smallest stiffness of the yaw of gripped polygons [N m]; discs have none."""
    objects = motion.requirements.objects
    has_polygon = any(
        objects[held.name].section.outline is not None for held in gripped_objects(motion)
    )
    return 0.0 if has_polygon else None


def yaw_stiffness(spans: Gripped) -> Bound:
    """Return the stiffness of the object's yaw [N m], as in ``YawTerms``; infinite at no load."""
    section = spans.body.section
    x = np.full(len(spans), 0.5)
    if section.outline is None:
        return Bound(np.full(len(spans), np.inf), x)
    tables = spans.source.drones.coefficients
    drones = spans.of_items(tables.reshape(len(tables), -1, 2, *tables.shape[2:]))
    corners = in_object_frame(spans.pose, spans.corners).xy
    clasps = select(corners, [0, 3])
    contacts = select(corners, [1, 2])
    parts = clasps - contacts
    legs = in_object_frame(spans.pose, Enclosed(drones, spans.noise)).xy - clasps
    tension = add_axis(spans.tension)
    across = _left_of(parts)
    across_legs = _left_of(legs)
    per_length = tension * parts.norm.inverse
    per_leg = tension * legs.norm.inverse
    levers = parts.direction.dot(contacts - section.centroid)
    by_levers = levers * per_length
    turns = _with_error(levers * (tension + by_levers))
    both = _with_error(-across * by_levers)
    of_parts = _with_error(across * across[0] * per_length, across * across[1] * per_length)
    of_legs = _with_error(
        across_legs * across_legs[0] * per_leg, across_legs * across_legs[1] * per_leg
    )
    terms, errors = (
        YawTerms(turn[..., 0, 0], move[..., 0, :], part, leg)
        for turn, move, part, leg in zip(turns, both, of_parts, of_legs, strict=True)
    )
    is_carried = np.any(spans.share.c > 0.0, axis=(1, 2))
    return Bound(np.where(is_carried, least_stiffness_of_turn(terms, errors), np.inf), x)


def _left_of(vectors: Enclosed) -> Enclosed:
    """Return unit vectors to the left of horizontal vectors."""
    directions = vectors.direction
    return Enclosed(directions.c[..., [1, 0], :] * [[-1.0], [1.0]], directions.r)


def _with_error(*rows: Enclosed) -> tuple[Array, Array]:
    """Return the middles of rows of components (…, rows, components), and their errors."""
    low = np.stack([np.min(row.c, axis=-1) - np.asarray(row.r)[..., None] for row in rows], -2)
    high = np.stack([np.max(row.c, axis=-1) + np.asarray(row.r)[..., None] for row in rows], -2)
    return 0.5 * (low + high), 0.5 * (high - low)


YAW = CheckRule(
    "yaw",
    "N·m",
    "min",
    _yaw_limit,
    (Evaluator(_smallest(yaw_stiffness), lambda state: state.hitched, formulas=(yaw_stiffness,)),),
    "use longer cables, or give the object rounder corners",
    group="forces",
    bodies=(("held",),),
    proves="moment per angle [N m] with which edges hold the yaw of a carried polygon",
    unproven="how far the object turns before it is lifted",
)
"""Edges whose clasps are next to an object's sides turn it about its corners."""


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
