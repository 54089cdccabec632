"""Check ``support``: carried objects rest on the clasps below their rims.

The line of weight and inertia through the centre of mass c meets the clasps' plane, h below it,
within their polygon. Towards edge k with the inward normal n that is ``n·(c - p_k) - h n·a / (g +
a_z)``, a the acceleration of c.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from hitchopt.checks.gripping import Held, Mask, for_each, heading_error, seen_from, turned_back
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.checks.spans import ROUNDING, magnitude
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.motion.loads import held_pieces, rim_drop
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, HoldBy, Motion
from hitchopt.objects import Rim, SolidObject
from hitchopt.objects.placing import STILL, TOUCH, in_frame, surface_below
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import worst
from hitchopt.values import Array

CONTACT = 1e-4
"""[m] Clasps that carry a rim keep their places below it this closely."""


class Resting(Held):
    """Spans of an object with a rim that rests on all clasps."""

    @property
    def rim(self) -> Rim:
        """The rim."""
        assert self.body.rim is not None
        return self.body.rim

    @cached_property
    def clasps(self) -> Enclosed:
        """Clasps (spans, n) [m] as seen from the object."""
        c = self.of_items(self.source.vertices.coefficients)
        return seen_from(self.pose, Enclosed(c, self.noise))

    @cached_property
    def places(self) -> Array:
        """(spans, n, 2) [m] Where they are when the piece begins, seen from above."""
        poses = self.source.object_poses.coefficients[self.piece, self.item, :, 0]
        clasps = self.source.vertices.coefficients[self.piece, ..., 0]
        return in_frame(poses[:, None], clasps)[..., :2]


def force_line(spans: Resting) -> Bound:
    """Return how far from the edges of the clasps' polygon the force line meets its plane [m]."""
    places, body, rim = spans.places, spans.body, spans.rim
    centre = body.centre_of_mass
    edges = unit(np.roll(places, -1, axis=1) - places)
    inward = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)  # of clockwise edges
    apart = np.sum(inward * (centre[:2] - places), axis=-1)
    heading = Enclosed(spans.pose.c[:, 3:])
    level = for_each(turned_back(spans.pushed.level, heading))
    lean = level.dot(inward) * (centre[2] - rim.height)
    pressing = for_each(spans.pushed[2] + GRAVITY).range
    margin = (ROUNDING + heading_error(heading)) * (magnitude(spans.source) + body.circumradius)
    least = np.where(pressing.low > 0.0, apart - (lean.range * pressing.inverse).high, -np.inf)
    k = np.arange(len(spans)), np.argmin(least, axis=1)
    return Bound(least[k] - margin - 2.0 * CONTACT, lean.above.x[k])


def _find(motion: Motion, _: float) -> Finding:
    """Return the smallest distance of a force line to the edge of its supports [m].

    What contradicts the phases' holds counts as minus infinity: an object that moves, or is borne
    in part, where nothing holds it; one off the ground that is not borne as a whole; clasps of a
    hold that are above the rim, or not around the body; clasps that bear it and are not at the rim,
    beside the body and at one place; an acceleration at which it would slide off them. ``where``
    names the object.
    """
    objects = motion.requirements.objects.items()
    found = [_of_object(motion, i, name, body) for i, (name, body) in enumerate(objects)]
    return min(found, key=lambda each: each.worst)


def _of_object(motion: Motion, index: int, name: str, body: SolidObject) -> Finding:
    """Return what is found of one object."""
    pose = motion.object_poses.coefficients[:, index]
    share = motion.object_shares.coefficients[:, index]
    moving = np.any(np.ptp(pose, axis=-1) > STILL, axis=-1)
    whole = np.all(share == 1.0, axis=-1)
    carried = moving | np.any(share != 0.0, axis=-1)
    resting, gripped = (held_pieces(motion, name, by) for by in (HoldBy.REST, HoldBy.GRIP))
    lost = _floating(motion, index, name, ~whole & ~moving) | (moving & ~whole)
    lost |= np.any((share < 0.0) | (share > 1.0), axis=-1)
    lost |= carried & (~(resting | gripped) | ~motion.formed | body.fixed)
    if body.rim is None or not motion.team.layout.closed:
        lost |= resting
    else:
        for spans in Resting.of_object(motion, index, resting):
            lost[spans.piece] |= _apart(spans)
        for spans in Resting.of_object(motion, index, resting & carried):
            lost[spans.piece] |= _out_of_place(spans)
    if np.any(lost):
        return Finding(-math.inf, float(motion.drones.breaks[int(np.argmax(lost))]), (name,))
    found = worst(Resting.of_object(motion, index, resting & carried & whole), force_line, "min")
    return Finding(found.worst, found.time, (name,), magnitude(motion))


def _floating(motion: Motion, index: int, name: str, still: Mask) -> Mask:
    """Return (pieces,) where an object that is not borne as a whole stands on nothing."""
    objects = motion.requirements.objects
    if objects[name].fixed:
        return np.zeros_like(still)
    poses = np.round(motion.object_poses.coefficients[..., 0] / STILL) * STILL
    places, which = np.unique(poses, axis=0, return_inverse=True)
    stands = np.zeros(len(places), dtype=np.bool_)
    for i in np.unique(which.ravel()[still]):
        surface, _ = surface_below(objects, places[i], name, motion.requirements.floor)
        gap = float(places[i, index, 2]) + objects[name].lower - surface
        stands[i] = abs(gap) <= TOUCH
    return still & ~stands[which.ravel()]


def _apart(spans: Resting) -> Mask:
    """Return (spans,) where clasps are above a rim, or not around the body.

    They are around it all of a piece if they are when it begins: edges do not enter the body (check
    ``object_clearance``).
    """
    above = Enclosed(spans.clasps.c)[2].above.value > spans.rim.height + CONTACT
    edges = np.roll(spans.places, -1, axis=1) - spans.places
    to = spans.body.section.centroid - spans.places
    right = edges[..., 1] * to[..., 0] - edges[..., 0] * to[..., 1]
    found: Mask = np.any(above | (right <= 0.0), axis=1)
    return found


def _out_of_place(spans: Resting) -> Mask:
    """Return (spans,) where clasps are not below the rim, beside the body and at one place.

    Those that bear all of it are as far below as ``rim_drop`` says, while weight passes to them or
    back at most so far; a clasp accelerates no more than friction carries the rim along.
    """
    motion, body, rim, places = spans.source, spans.body, spans.rim, spans.places
    pulls = motion.tensions.coefficients[spans.piece, :, 0]
    drop = rim_drop(motion.team, body, places, pulls)[:, None]
    whole = np.all(spans.share.c == 1.0, axis=(1, 2))[:, None]
    heights = spans.clasps[2].range
    off = (spans.clasps.level - places).norm_above.value
    off = np.maximum(off, rim.height - heights.low - drop)
    off = np.maximum(off, heights.high - rim.height + np.where(whole, drop, 0.0))
    found = (off > CONTACT) | (rim.section.clearance(places)[0] >= -CONTACT)
    if body.stem is not None:
        found |= body.stem.segment_distance(places, np.roll(places, -1, axis=1)) <= CONTACT
    pushed = Enclosed(spans.of_items(motion.vertices.differentiated(2).coefficients))
    found |= pushed.level.norm_above.value > body.friction * (GRAVITY + pushed[2].below.value)
    lost: Mask = np.any(found, axis=1)
    return lost


SUPPORT = CheckRule(
    "support",
    "m",
    "min",
    lambda motion: 0.0 if motion.requirements.objects else None,
    (Finder(_find, HITCHED_STATE | FREE_STATES, shown=(force_line,)),),
    "carry it more gently, or hold it farther out or closer below its centre of mass",
)
