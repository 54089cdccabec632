"""Check ``support``: carried objects rest on the clasps below their rims."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.object_frames import heading_error, seen_from
from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.motion.carried import centre_path, rim_drop, turned_back
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE, HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL, TOUCH, in_frame, surface_below
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, smallest
from hitchopt.values import Array

Mask = NDArray[np.bool_]

CONTACT = 1e-4
"""[m] Clasps that carry a rim keep their places below it this closely."""


def _find(motion: Motion, _: float) -> Finding:
    """Return the smallest distance of a force line to the edge of its supports [m].

    The line of weight and inertia through the centre of mass meets the clasps' plane within their
    polygon, at least that far from its edges. What contradicts the phases' holds counts as minus
    infinity: an object that moves, or is borne in part, where nothing holds it; one off the ground
    that is not borne as a whole; clasps of a hold that are above the rim, or not around the body;
    clasps that bear it and are not at the rim, beside the body and at one place; an acceleration at
    which it would slide off them. ``where`` names the object.
    """
    best = Finding(math.inf, 0.0)
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        found = _of_object(motion, index, name, body)
        if found.worst < best.worst:
            best = found
    return best


def _of_object(motion: Motion, index: int, name: str, body: SolidObject) -> Finding:
    """Return what is found of one object."""
    pose = motion.object_poses.coefficients[:, index]
    share = motion.object_shares.coefficients[:, index]
    moving = np.any(np.ptp(pose, axis=-1) > STILL, axis=-1)
    whole = np.all(share == 1.0, axis=-1)
    carried = moving | np.any(share != 0.0, axis=-1)
    by = _held_by(motion, name)
    lost = _floating(motion, index, name, ~whole & ~moving) | (moving & ~whole)
    lost |= np.any((share < 0.0) | (share > 1.0), axis=-1)
    lost |= carried & ((by == "") | ~motion.formed | body.fixed)
    lost |= (by == HoldBy.REST) & _apart(motion, index, body)
    bearing = carried & (by == HoldBy.REST)
    if np.any(bearing):
        lost |= bearing & _out_of_place(motion, index, body, bearing)
    if np.any(lost):
        time = float(motion.drones.breaks[int(np.argmax(lost))])
        return Finding(-math.inf, time, (name,))
    if not np.any(bearing & whole):
        return Finding(math.inf, 0.0)
    return _force_line(motion, index, name, body, bearing & whole)


def _held_by(motion: Motion, name: str) -> NDArray[np.str_]:
    """Return (pieces,) how each piece's phase holds an object; an empty word where it does not."""
    words = [
        phase.hold.by.value if phase.hold is not None and phase.hold.object == name else ""
        for phase in motion.phases
    ]
    return np.array(words)[motion.phase_of_piece]


def _floating(motion: Motion, index: int, name: str, still: Mask) -> Mask:
    """Return (pieces,) where an object that is not borne as a whole stands on nothing."""
    floating = np.zeros(len(still), dtype=np.bool_)
    objects = motion.requirements.objects
    if objects[name].fixed or not np.any(still):
        return floating
    poses = np.round(motion.object_poses.coefficients[..., 0] / STILL) * STILL
    places, which = np.unique(poses[still], axis=0, return_inverse=True)
    gaps = []
    for each in places:
        surface, _ = surface_below(objects, each, name, motion.requirements.floor)
        gaps.append(abs(float(each[index, 2]) + objects[name].lower - surface))
    floating[still] = np.array(gaps)[which.ravel()] > TOUCH
    return floating


def _apart(motion: Motion, index: int, body: SolidObject) -> Mask:
    """Return (pieces,) where clasps are above a rim, or not around the body.

    They are around it all of a piece if they are when it begins: edges do not enter the body (check
    ``object_clearance``).
    """
    if body.rim is None or not motion.team.layout.closed:
        return np.ones(motion.drones.pieces, dtype=np.bool_)
    poses = motion.object_poses.coefficients
    seen = seen_from(poses[:, index], motion.vertices.coefficients[:, :, None])
    points = seen.points[:, :, 0]
    above = np.max(points[:, :, 2], axis=(1, 2)) > body.rim.height + CONTACT
    level = points[..., :2, 0]
    edge, to = np.roll(level, -1, axis=1) - level, body.section.centroid - level
    right = edge[..., 1] * to[..., 0] - edge[..., 0] * to[..., 1]
    found: Mask = above | np.any(right <= 0.0, axis=1)
    return found


def _out_of_place(motion: Motion, index: int, body: SolidObject, on: Mask) -> Mask:
    """Return (pieces,) where clasps are not below the rim, beside the body and at one place.

    Those that bear all of it are as far below as ``rim_drop`` says, while weight passes to them or
    back at most so far.

    Parameters
    ----------
    on: (pieces,), where they bear it or a part of it.
    """
    if body.rim is None or not motion.team.layout.closed:
        return np.ones(motion.drones.pieces, dtype=np.bool_)
    poses = motion.object_poses.coefficients
    seen = seen_from(poses[:, index], motion.vertices.coefficients[:, :, None])
    points = seen.points[:, :, 0]  # (pieces, clasps, 3, degree + 1)
    places = points[..., 0]
    level = places[..., :2]
    pulls = motion.tensions.coefficients[..., 0]
    drop = np.zeros(len(places))
    drop[on] = rim_drop(motion.team, body, level[on], pulls[on])
    whole = np.all(motion.object_shares.coefficients[:, index] == 1.0, axis=-1)
    deep = body.rim.height - np.min(points[:, :, 2], axis=(1, 2)) - drop
    high = np.max(points[:, :, 2], axis=(1, 2)) - body.rim.height + np.where(whole, drop, 0.0)
    off = np.max(np.abs(points[:, :, :2] - level[..., None]), axis=(1, 2, 3))
    off = np.maximum(off, np.maximum(deep, high)) + seen.error
    inside = np.max(body.rim.section.clearance(places[..., :2])[0], axis=1) < -CONTACT
    found: Mask = (off > CONTACT) | ~inside | _slides(motion, body)
    if body.stem is not None:
        beside = body.stem.segment_distance(level, np.roll(level, -1, axis=1))
        found |= np.min(beside, axis=1) <= CONTACT
    return found


def _slides(motion: Motion, body: SolidObject) -> Mask:
    """Return (pieces,) where a clasp accelerates more than friction carries the rim along."""
    pushed = motion.vertices.differentiated(2).coefficients
    level = np.max(np.linalg.norm(pushed[:, :, :2], axis=2), axis=-1)
    pressing = GRAVITY + np.min(pushed[:, :, 2], axis=-1)
    found: Mask = np.any(level > body.friction * pressing, axis=1)
    return found


def _force_line(motion: Motion, index: int, name: str, body: SolidObject, on: Mask) -> Finding:
    """Return how far from the edges of the clasps' polygon the force line meets its plane.

    Towards edge k with the inward normal n that is ``n·(c - p_k) - h n·a / (g + a_z)``: c the
    centre of mass, h above the clasps, and a its acceleration.
    """
    pose = motion.object_poses.coefficients[:, index]
    durations = motion.drones.durations[:, None, None]
    pushed = bernstein.differentiate(bernstein.differentiate(centre_path(pose, body)))
    pushed = pushed / durations**2
    turned = turned_back(pushed[:, :2], pose[:, 3:])
    points = in_frame(pose[:, None, :, 0], motion.vertices.coefficients[..., 0])
    edges = unit((np.roll(points, -1, axis=1) - points)[..., :2])
    inward = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)  # of clockwise edges
    centre = body.centre_of_mass
    distance = np.sum(inward * (centre[:2] - points[..., :2]), axis=-1)
    assert body.rim is not None
    level = (centre[2] - body.rim.height) * np.einsum("pkd,pdi->pki", inward, turned)
    order = bernstein.degree(level)
    upward = bernstein.elevate(pushed[:, None, 2], order)
    start, upward = (np.broadcast_to(x, level.shape) for x in (distance[..., None], upward))
    turning = heading_error(pose[:, 3:])
    margin = (ROUNDING + turning) * (magnitude(motion) + body.circumradius) + 2.0 * CONTACT
    cells = Cells.over(motion.drones.breaks, [np.stack([start, level, upward], axis=2)], margin)
    found = smallest(cells.take(np.repeat(on, points.shape[1])), _bound)
    return Finding(found.worst, found.time, (name,), magnitude(motion))


def _bound(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the distance of the force line to edges from below: rows of distance, h n·a, a_z."""
    distance, level, upward = np.moveaxis(blocks[0], 1, 0)
    most = np.max(level, axis=-1)
    falling = GRAVITY + np.min(upward, axis=-1), GRAVITY + np.max(upward, axis=-1)
    pressing = np.where(most > 0.0, falling[0], falling[1])
    bound = np.where(falling[0] > 0.0, distance[:, 0] - most / pressing, -np.inf)
    x = np.argmax(level, axis=-1) / max(1, bernstein.degree(level))
    there = bernstein.evaluate(level, x) / (GRAVITY + bernstein.evaluate(upward, x))
    return Estimate(bound, distance[:, 0] - there, x)


def _limit(motion: Motion) -> float | None:
    return 0.0 if motion.requirements.objects else None


RULE = CheckRule(
    "support",
    "m",
    "min",
    _limit,
    (Finder(_find, HITCHED_STATE | FREE_STATES),),
    "carry it more gently, or hold it farther out or closer below its centre of mass",
)
