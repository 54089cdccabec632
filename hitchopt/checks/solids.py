"""Upright bodies that stand still or are carried, and what keeps off them.

A slab is a convex section between two heights. Its support function and the direction out of it to
the nearest point of what moves are all that ``hitchopt.checks.distances`` needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.distances import GROUND, TALL, Flags, Ground, Moving
from hitchopt.checks.gripping import heading_error, seen_from
from hitchopt.checks.spans import ROUNDING, UPWARD, magnitude
from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import STILL, TOUCH, sections_apart, surface_below
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array

HALVINGS = 25
"""Halvings of a segment in search of its nearest point: it is found within 3e-8 of it."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A slab that points and segments keep off."""

    slab: Slab

    @property
    def box(self) -> Array:
        """Lower and upper corner (2, 3) [m] of a box around it."""
        reach = self.slab.section.circumradius
        return np.array([[-reach, -reach, self.slab.lower], [reach, reach, self.slab.upper]])

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3)."""
        return self.slab.support(directions)

    def towards(self, corners: Array) -> Array:
        """Return the directions (…, 3) out of it to points or segments (…, 1 or 2, 3)."""
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


@dataclass(frozen=True, eq=False)
class Beside:
    """A slab that another upright one keeps off, of which the core's corners are given.

    First those of its floor, then those of its ceiling. What is round about the core is added to
    the slab that stands still.
    """

    slab: Slab
    rounding: float

    @property
    def box(self) -> Array:
        """Lower and upper corner (2, 3) [m] of a box around it."""
        level = self.rounding * np.array([1.0, 1.0, 0.0])
        return np.stack([Solid(self.slab).box[0] - level, Solid(self.slab).box[1] + level])

    def support(self, directions: Array) -> Array:
        """Return how far it reaches (…) [m] along directions (…, 3)."""
        round_ = self.rounding * np.linalg.norm(directions[..., :2], axis=-1)
        reach: Array = self.slab.support(directions) + round_
        return reach

    def towards(self, corners: Array) -> Array:
        """Return the directions (…, 3) out of it to upright slabs with corners (…, 2 m, 3).

        Level ones are those in which a side is nearest to it.
        """
        floor = corners[..., : corners.shape[-2] // 2, :2]
        sides = np.stack([floor, np.roll(floor, -1, axis=-2)], axis=-2)
        flat = np.concatenate([sides, np.zeros_like(sides[..., :1])], axis=-1)
        normals = from_above(self.slab).towards(flat)[..., :2]  # (…, sides, 2)
        apart = np.min(np.einsum("...sd,...kd->...sk", normals, floor), axis=-1)
        apart = apart - self.slab.section.support(normals) - self.rounding
        best = np.argmax(apart, axis=-1)[..., None]
        level = np.maximum(np.take_along_axis(apart, best, axis=-1), 0.0)
        level = level * np.take_along_axis(normals, best[..., None], axis=-2)[..., 0, :]
        lowest, highest = corners[..., :1, 2], corners[..., -1:, 2]
        upward = np.maximum(lowest - self.slab.upper, 0.0)
        return unit(
            np.concatenate([level, upward - np.maximum(self.slab.lower - highest, 0.0)], -1)
        )


def from_above(slab: Slab) -> Solid:
    """Return a body as seen from above, where heights do not count."""
    return Solid(Slab(slab.section, -TALL, TALL))


def carried(motion: Motion) -> Iterator[Moving]:
    """Yield objects that move past the ground, and past all others.

    While one goes straight up or down it may touch what it stands on before or after that, or what
    is below it where the motion begins so: there it counts only that it does not go into that.
    """
    if motion.poses is None:
        return
    objects, poses = motion.requirements.objects, motion.poses.coefficients
    moving = np.ptp(poses, axis=-1)  # (pieces, objects, 5)
    going = np.any(moving > STILL, axis=-1)
    upright = np.max(moving[..., [0, 1, 3, 4]], axis=-1) <= TOUCH
    breaks, size, floor = motion.drones.breaks, magnitude(motion), motion.requirements.floor
    for index, (name, each) in enumerate(objects.items()):
        if not np.any(going[:, index]):
            continue
        _, below = surface_below(objects, poses[0, :, :, 0], name, floor)
        base = poses[:, index, :3] + each.lower * UPWARD[:, None]
        heights = base[:, 2] - floor
        stands = np.any(np.abs(heights[:, [0, -1]]) <= TOUCH, axis=-1)
        touching = _leaving(upright[:, index], stands, below is None)
        touching &= np.min(heights, axis=-1) >= -TOUCH
        yield Moving.past(
            breaks,
            base[:, None, None],
            Ground(floor),
            margin=ROUNDING * size,
            counted=(going[:, index] & ~touching)[:, None],
            names=((name,), (GROUND,)),
        )
        for slab in each.slabs:
            corners = Enclosed(placed_core(poses[:, index], slab)[:, None])
            turned = (
                float(np.max(heading_error(Enclosed(poses[:, index, 3:]))))
                * slab.section.circumradius
            )
            for other, (label, obstacle) in enumerate(objects.items()):
                if other == index:
                    continue
                seen = seen_from(Enclosed(poses[:, other]), corners)
                stands = _stands_on(poses, index, each, other, obstacle)
                leaving = _leaving(upright[:, index], stands, label == below)
                for body in obstacle.slabs:
                    above = np.min(seen.c[:, 0, :, 2], axis=(1, 2)) >= body.upper - TOUCH
                    reach = size + slab.size + body.size
                    yield Moving.past(
                        breaks,
                        seen.c,
                        Beside(body, slab.section.rounding),
                        margin=float(np.max(seen.r)) + ROUNDING * reach + float(np.max(turned)),
                        counted=(going[:, index] & ~(leaving & above))[:, None],
                        names=((name,), (label,)),
                    )


def _leaving(upright: Flags, stands: Flags, lifted: bool) -> Flags:
    """Return (pieces,) in which an object rises from something, or goes down onto it.

    It moves straight up or down in them, between one at whose beginning or end it stands there and
    each of them too; or from the beginning if it has been lifted from there.
    """
    runs = np.cumsum(~upright)
    from_there = np.isin(runs, runs[stands & upright]) | ((runs == 0) & lifted)
    found: Flags = upright & from_there
    return found


def _stands_on(
    poses: Array, index: int, body: SolidObject, other: int, obstacle: SolidObject
) -> Flags:
    """Return (pieces,) at whose beginning or end an object stands on another one."""
    bottom, top = poses[:, index, 2] + body.lower, poses[:, other, 2] + obstacle.upper
    found: Flags = np.any(np.abs(bottom - top)[:, [0, -1]] <= TOUCH, axis=-1)
    bases = [slab.section for slab in body.slabs if slab.lower == body.lower]
    tops = [slab.section for slab in obstacle.slabs if slab.upper == obstacle.upper]
    for piece in np.flatnonzero(found):
        here, there = poses[piece, index, :, 0], poses[piece, other, :, 0]
        found[piece] = any(sections_apart(a, here, b, there) < 0.0 for a in bases for b in tops)
    return found


def placed_core(poses: Array, slab: Slab) -> Array:
    """Return the corners of a slab's core (pieces, 2 m, 3, degree + 1) [m], floor and ceiling.

    Parameters
    ----------
    poses: of its object, (pieces, 5, degree + 1).
    slab: in the object's frame.
    """
    core = slab.section.core[:, :, None]
    c, s = poses[:, None, 3], poses[:, None, 4]
    x = core[:, 0] * c - core[:, 1] * s + poses[:, None, 0]
    y = core[:, 0] * s + core[:, 1] * c + poses[:, None, 1]
    z = [
        np.broadcast_to(poses[:, None, 2] + height, x.shape) for height in (slab.lower, slab.upper)
    ]
    return np.concatenate([np.stack([x, y, each], axis=2) for each in z], axis=1)
