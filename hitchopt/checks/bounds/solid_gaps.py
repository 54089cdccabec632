"""Distances of carried objects to all others and to the ground, bounded for all t.

Upright bodies are as far apart as their level distance and the difference of their heights tell;
each of the two is bounded on its own.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.object_frames import heading_error, seen_from
from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.bounds.slab_distance import nearest
from hitchopt.checks.rule import Finding
from hitchopt.motion.motion import Motion
from hitchopt.objects import Section, Slab, SolidObject
from hitchopt.objects.placing import STILL, TOUCH, sections_apart, surface_below
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, smallest
from hitchopt.values import Array

Mask = NDArray[np.bool_]

GROUND = "ground"
"""Stands for the ground where two objects are named."""

TALL = 1e3
"""[m] Half of the height of what stands for an object as seen from above."""


def carried_gap(motion: Motion) -> Finding:
    """Return the smallest distance of an object that moves to another one, or to the ground [m].

    While it goes straight up or down it may touch what it stands on before or after that, or what
    is below it where the motion begins so: there it counts only that it does not go into that.
    ``where`` names the two.
    """
    best = Finding(math.inf, 0.0)
    if motion.poses is None:
        return best
    objects, poses = motion.requirements.objects, motion.poses.coefficients
    moving = np.ptp(poses, axis=-1)  # (pieces, objects, 5)
    going = np.any(moving > STILL, axis=-1)
    upright = np.max(moving[..., [0, 1, 3, 4]], axis=-1) <= TOUCH
    size = magnitude(motion)
    for index, (name, each) in enumerate(objects.items()):
        if not np.any(going[:, index]):
            continue
        _, below = surface_below(objects, poses[0, :, :, 0], name, motion.requirements.floor)
        found = _to_ground(motion, index, going[:, index], upright[:, index], below is None)
        if found.worst < best.worst:
            best = Finding(max(found.worst, 0.0), found.time, (name, GROUND), size)
        for slab in each.slabs:
            corners = placed_core(poses[:, index], slab)
            for other, (label, obstacle) in enumerate(objects.items()):
                if other == index:
                    continue
                seen = seen_from(poses[:, other], corners[:, None])
                leaving = _leaving(poses, index, each, other, obstacle, upright[:, index])
                if label == below:
                    leaving |= _first_run(upright[:, index])
                for body in obstacle.slabs:
                    margin = seen.error + ROUNDING * (size + slab.size + body.size)
                    margin += heading_error(poses[:, index, 3:]) * slab.section.circumradius
                    rows = seen.points.reshape(*seen.points.shape[:2], -1, seen.points.shape[-1])
                    cells = Cells.over(motion.drones.breaks, [rows], margin)
                    touching = leaving & _above(seen.points[:, 0], body)
                    cells = cells.take(going[:, index] & ~touching)
                    if len(cells) == 0:
                        continue
                    found = smallest(cells, partial(_bound, slab=slab, body=body))
                    if found.worst < best.worst:
                        best = Finding(max(found.worst, 0.0), found.time, (name, label), size)
    return best


def taut_gap_to_ground(motion: Motion) -> Finding:
    """Return the smallest height of cables that hold an object, or close, above the ground [m].

    They are straight, but where edges bend around an object: no part is lower than all of its ends
    and bends. ``where`` names the cable, and the ground.
    """
    team, floor = motion.team, motion.requirements.floor
    best = Finding(math.inf, 0.0)
    holding = np.array([phase.hold is not None for phase in motion.phases], dtype=np.bool_)
    if not np.any(holding):
        return best
    on = holding[motion.phase_of_piece]
    margin = ROUNDING * magnitude(motion)
    parts = [motion.drones, motion.vertices]
    owns = [np.arange(team.drones) // 2, np.arange(team.layout.points) % team.robots]
    if motion.contacts is not None:
        c = motion.contacts.coefficients
        parts.append(motion.drones.alike(c.reshape(len(c), -1, *c.shape[3:])))
        owns.append(np.arange(team.drones) // 2)
    for part, own in zip(parts, owns, strict=True):
        heights = part.coefficients[:, :, None, 2:] - floor
        cells = Cells.over(part.breaks, [heights], margin)
        found = smallest(cells.take(np.repeat(on, len(own))), _height)
        if found.worst < best.worst:
            best = Finding(found.worst, found.time, (f"cable {own[found.item]}", GROUND))
    return best


def _to_ground(motion: Motion, index: int, going: Mask, upright: Mask, over_it: bool) -> Extremum:
    """Return the smallest height [m] of an object's lowest point above the ground.

    Parameters
    ----------
    over_it: whether nothing else is below it when the motion begins.
    """
    body = list(motion.requirements.objects.values())[index]
    poses = motion.object_poses.coefficients
    heights = poses[:, index, 2] + (body.lower - motion.requirements.floor)
    meeting = np.any(np.abs(heights[:, [0, -1]]) <= TOUCH, axis=-1) & upright
    runs = np.cumsum(~upright)
    leaving = np.isin(runs, runs[meeting]) | (_first_run(upright) & over_it)
    touching = upright & leaving & (np.min(heights, axis=-1) >= -TOUCH)
    margin = ROUNDING * magnitude(motion)
    cells = Cells.over(motion.drones.breaks, [heights[:, None, None]], margin)
    return smallest(cells.take(going & ~touching), _height)


def _height(blocks: tuple[Array, ...]) -> Estimate:
    """Bound heights from below."""
    (rows,) = blocks
    half = bernstein.basis(np.array(0.5), bernstein.degree(rows))
    heights = rows.reshape(len(rows), -1)
    return Estimate(np.min(heights, axis=-1), heights @ half, np.full(len(rows), 0.5))


def _leaving(
    poses: Array, index: int, body: SolidObject, other: int, obstacle: SolidObject, upright: Mask
) -> Mask:
    """Return (pieces,) in which an object rises from another one, or goes down onto it.

    It moves straight up or down in them, between one at whose beginning or end it stands there and
    each of them too.
    """
    bottom, top = poses[:, index, 2] + body.lower, poses[:, other, 2] + obstacle.upper
    level = np.any(np.abs(bottom - top)[:, [0, -1]] <= TOUCH, axis=-1) & upright
    runs = np.cumsum(~upright)
    _, first = np.unique(runs[level], return_index=True)
    meeting = [
        piece
        for piece in np.flatnonzero(level)[first]
        for lowest in body.slabs
        for highest in obstacle.slabs
        if lowest.lower == body.lower and highest.upper == obstacle.upper
        if _meet(lowest.section, poses[piece, index], highest.section, poses[piece, other])
    ]
    found: Mask = upright & np.isin(runs, runs[meeting])
    return found


def _first_run(upright: Mask) -> Mask:
    """Return (pieces,) which are upright as all before them: continuations begin in mid air.

    What is below an object then is what it has been lifted from.
    """
    return np.asarray(np.cumsum(~upright) == 0)


def _meet(first: Section, here: Array, second: Section, there: Array) -> bool:
    """Return whether two sections meet, as seen from above, when a piece begins."""
    return sections_apart(first, here[:, 0], second, there[:, 0]) < 0.0


def placed_core(poses: Array, slab: Slab) -> Array:
    """Return where a slab's core and its floor are (pieces, corners, 3, degree + 1) [m].

    Parameters
    ----------
    poses: of its object, (pieces, 5, degree + 1).
    slab: in the object's frame.
    """
    core = slab.section.core[:, :, None]
    c, s = poses[:, None, 3], poses[:, None, 4]
    x = core[:, 0] * c - core[:, 1] * s + poses[:, None, 0]
    y = core[:, 0] * s + core[:, 1] * c + poses[:, None, 1]
    z = np.broadcast_to(poses[:, None, 2] + slab.lower, x.shape)
    return np.stack([x, y, z], axis=2)


def _above(corners: Array, body: Slab) -> NDArray[np.bool_]:
    """Return (pieces,) where corners (pieces, corners, 3, …) stay on or above a body."""
    lowest: Array = np.min(corners[:, :, 2], axis=(1, 2))
    return lowest >= body.upper - TOUCH


def _bound(blocks: tuple[Array, ...], slab: Slab, body: Slab) -> Estimate:
    """Bound the distance of a slab with given corners to a body from below."""
    (rows,) = blocks
    corners = rows.reshape(len(rows), -1, 3, rows.shape[-1])
    half = bernstein.basis(np.array(0.5), bernstein.degree(rows))
    heights, tallness = corners[:, 0, 2], slab.upper - slab.lower
    level, middle = _level(corners[:, :, :2], half, slab, body)
    over = np.maximum(heights - body.upper, body.lower - heights - tallness)
    above = np.min(heights, axis=-1) - body.upper
    below = body.lower - np.max(heights, axis=-1) - tallness
    upward = np.maximum(np.maximum(above, below), 0.0)
    there = np.maximum(over @ half, 0.0)
    return Estimate(np.hypot(level, upward), np.hypot(middle, there), np.full(len(rows), 0.5))


def _level(corners: Array, half: Array, slab: Slab, body: Slab) -> tuple[Array, Array]:
    """Return lower bounds (cells,) [m] of level distances, and those at mid time.

    Along directions in which one of the sides of the slab is nearest to the body at mid time.
    """
    here = corners @ half  # (cells, corners, 2)
    sides = np.stack([here, np.roll(here, -1, axis=1)], axis=2)
    flat = np.concatenate([sides, np.zeros_like(sides[..., :1])], axis=-1)
    _, normals = nearest(flat, Slab(body.section, -TALL, TALL))
    towards = normals[..., :2]  # (cells, sides, 2)
    products = np.einsum("csd,ckdi->cski", towards, corners)
    reach = body.section.support(towards) + slab.section.rounding
    least = np.min(products, axis=(2, 3)) - reach
    there = np.min(products @ half, axis=2) - reach
    best = np.argmax(there, axis=1)[:, None]
    found: tuple[Array, ...] = tuple(
        np.maximum(np.take_along_axis(each, best, axis=1)[:, 0], 0.0) for each in (least, there)
    )
    return found[0], found[1]
