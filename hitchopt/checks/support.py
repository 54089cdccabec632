"""Check ``support``: objects rest on clasps, on other objects or on the ground.

For an object with its rim on clasps, the force line of weight and inertia through the centre of
mass c must meet the clasps' plane, h below it, within their polygon. Its distance from edge k with
the inward normal n is ``n·(c - p_k) - h n·a / (g + a_z)``, a the acceleration of c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.grips import Gripped
from hitchopt.checks.objects import (
    PLACE_TOLERANCE,
    Held,
    Mask,
    add_axis,
    carried_objects,
    heading_error,
    in_object_frame,
    moving_objects,
    rotate_back,
    select,
)
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import ROUNDING, magnitude
from hitchopt.geometry.vectors import cross, left_of, unit
from hitchopt.hitch import GRAVITY
from hitchopt.motion.loads import held_pieces, rim_drop
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import CONTACT_GAP, REST_DRIFT, in_frame, surface_below
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, known, lazy


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
    distances_at_rest = np.sum(inward * (centre[:2] - places), axis=-1)
    heading = Enclosed(spans.pose.c[:, 3:])
    horizontal_acceleration = add_axis(rotate_back(spans.acceleration.xy, heading))
    height = centre[2] - known(body.rim).height
    moment = horizontal_acceleration.dot(inward) * height  # of inertia, per mass
    weight = add_axis(spans.acceleration[2] + GRAVITY).range  # per mass
    shift = (moment.range * weight.inverse).high
    distances = np.where(weight.low > 0.0, distances_at_rest - shift, -np.inf)
    nearest_edge = np.argmin(distances, axis=1)
    of_spans = np.arange(len(spans))
    error = (ROUNDING + heading_error(heading)) * (magnitude(spans.source) + body.circumradius)
    smallest = distances[of_spans, nearest_edge] - error - 2.0 * PLACE_TOLERANCE
    return Bound(smallest, moment.upper.x[of_spans, nearest_edge])


def foot(spans: Gripped) -> Bound:
    """Return how far within its foot a standing object is pressed on its support [m].

    Edges pull with a moment about the point below the centre of mass. The support's force acts at a
    distance of that moment over the weight.
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
    or if it would slide.
    """
    size = magnitude(motion)
    cases = [WorstCase(math.inf, 0.0, size=size)]
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        support = _ObjectSupport.of(motion, index, name, body)
        invalid = support.invalid_pieces()
        rests = support.resting & support.carried & support.fully_carried & ~invalid
        smallest = worst(Resting.of_object(motion, index, rests), force_line, "min")
        cases.append(WorstCase(smallest.worst, smallest.time, (name,), size))
        if np.any(invalid):
            start = float(motion.drones.breaks[int(np.argmax(invalid))])
            cases.append(WorstCase(-math.inf, start, (name,)))
    return min(cases, key=lambda case: case.worst)


@dataclass(frozen=True, eq=False)
class _ObjectSupport:
    """The supports of an object, on all pieces of a motion."""

    motion: Motion  # The motion
    index: int  # The object's index
    name: str  # Its name
    body: SolidObject  # The object
    moves: Mask  # (pieces,), whether it moves
    carried: Mask  # (pieces,), whether it moves or clasps carry some of its weight
    fully_carried: Mask  # (pieces,), whether clasps carry all of its weight
    resting: Mask  # (pieces,), whether phases state that it rests on clasps
    gripped: Mask  # (pieces,), whether phases state that edges grip it

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
    floor = motion.requirements.ground_or(-math.inf)
    for case in np.unique(case_of_piece[at_rest]):
        places = distinct_poses[case]
        surface, _ = surface_below(objects, places, name, floor)
        gap = float(places[index, 2]) + objects[name].lower - surface
        is_supported[case] = abs(gap) <= CONTACT_GAP
    return at_rest & ~is_supported[case_of_piece]


def _misplaced_clasps(spans: Resting, carried: Mask) -> Mask:
    """Return on which spans clasps are above a rim, or did not surround the body at the start.

    If the object is ``carried`` (spans,), clasps must also keep their positions below the rim, and
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
    """Return which clasps (spans, n) may have left their positions since the start of the hold.

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
    """Return which clasps at positions (spans, n, 2) [m] are not below a rim, or cut its stem."""
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
    (Evaluator(_force_lines, lambda state: state.has_cables, formulas=(force_line,)),),
    "carry it more slowly, or hold it farther out or closer to its centre of mass",
    whole=True,
    group="forces",
    bodies=(("held",),),
    proves="the minimum distance [m] by which the line of weight and inertia passes inside the "
    "clasps; minus infinity if an object floats, leaves its clasps or exceeds friction",
    unproven="swing or slip in gusts",
)
