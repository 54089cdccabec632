"""Objects and keep-out prisms as obstacles: shapes from which moving points keep a distance.

Objects consist of slabs, convex sections between two heights. ``hitchopt.checks.distances`` only
needs their support functions, and their outward normals nearest to a moving body.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from hitchopt.checks.distances import UNBOUNDED, Moving, Shape
from hitchopt.checks.objects import in_object_frame
from hitchopt.checks.spans import ROUNDING, cached, magnitude
from hitchopt.geometry.vectors import dot, unit
from hitchopt.motion.motion import Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array


class Subdivision(NamedTuple):
    """Division of segments into parts, of which the one that contains the nearest point is kept."""

    rounds: int  # Number of divisions
    parts: int  # Number of parts in each division


MANY_SEGMENTS = 256  # Number of segments above which each is divided into few parts per round

FEW_LARGE_DIVISIONS = Subdivision(rounds=5, parts=32)
"""Division of few segments, to find nearest points to 3e-8 of their length."""

MANY_SMALL_DIVISIONS = Subdivision(rounds=25, parts=2)
"""Division of many segments, to the same accuracy."""


@dataclass(frozen=True, eq=False)
class Solid(Shape):
    """A slab, as an obstacle for points, segments and other slabs.

    Another slab is represented by the corners of its core, those of its floor first; its
    ``rounding`` is added to this slab.
    """

    slab: Slab
    rounding: float | None = None

    def support(self, directions: Array) -> Array:
        """Return the support function (…) [m] along directions (…, 3)."""
        reach: Array = self.slab.support(directions)
        if self.rounding is not None:
            reach = reach + self.rounding * np.linalg.norm(directions[..., :2], axis=-1)
        return reach

    def flattened(self, ratio: float) -> Solid:
        """Return the slab with heights divided by a ratio."""
        slab = replace(self.slab, lower=self.slab.lower / ratio, upper=self.slab.upper / ratio)
        return replace(self, slab=slab)

    def normals(self, corners: Array) -> Array:
        """Return outward normals (…, 3) nearest to bodies with corners (…, 1, 2 or 2 m, 3)."""
        if self.rounding is not None:
            return self._slab_normals(corners, self.rounding)
        first = corners[..., 0, :]
        along = corners[..., -1, :] - first
        fraction = np.zeros(first.shape[:-1])
        if corners.shape[-2] > 1:
            # The distance to a convex body is convex along a segment: most are nearest at an end.
            rises_at_first = dot(self.slab.clearance(first).normals, along) > 0.0
            rises_at_last = dot(self.slab.clearance(corners[..., -1, :]).normals, along) > 0.0
            inner = ~rises_at_first & rises_at_last
            fraction[~rises_at_last] = 1.0
            fraction[inner] = self._nearest_fractions(first[inner], along[inner])
        return self.slab.clearance(first + fraction[..., None] * along).normals

    def _nearest_fractions(self, starts: Array, along: Array) -> Array:
        """Return fractions of segments (segments, 3) nearest to the slab, if not their ends."""
        lower = np.zeros(len(starts))
        if not len(starts):
            return lower
        many = len(starts) >= MANY_SEGMENTS
        division = MANY_SMALL_DIVISIONS if many else FEW_LARGE_DIVISIONS
        width = 1.0
        for _ in range(division.rounds):
            width /= division.parts
            fractions = lower + width * np.arange(1, division.parts)[:, None]
            normals = self.slab.clearance(starts + fractions[..., None] * along).normals
            approaching = dot(normals, along) <= 0.0
            lower += width * np.count_nonzero(approaching, axis=0)
        return lower + width

    def _slab_normals(self, corners: Array, rounding: float) -> Array:
        """Return outward normals nearest to upright slabs, horizontal if a side is nearest."""
        floor = corners[..., : corners.shape[-2] // 2, :2]
        sides = np.stack([floor, np.roll(floor, -1, axis=-2)], axis=-2)
        level_sides = np.concatenate([sides, np.zeros_like(sides[..., :1])], axis=-1)
        normals = from_above(self.slab).normals(level_sides)[..., :2]  # (…, sides, 2)
        nearest_corners = np.min(np.einsum("...sd,...kd->...sk", normals, floor), axis=-1)
        gaps = nearest_corners - self.slab.section.support(normals) - rounding
        widest = np.argmax(gaps, axis=-1)[..., None]
        level_gap = np.maximum(np.take_along_axis(gaps, widest, axis=-1), 0.0)
        level_normal = np.take_along_axis(normals, widest[..., None], axis=-2)[..., 0, :]
        gap_above = np.maximum(corners[..., :1, 2] - self.slab.upper, 0.0)
        gap_below = np.maximum(self.slab.lower - corners[..., -1:, 2], 0.0)
        offset = np.concatenate([level_gap * level_normal, gap_above - gap_below], axis=-1)
        return unit(offset)


def from_above(slab: Slab) -> Solid:
    """Return a body without vertical bounds, for horizontal distances."""
    return Solid(Slab(slab.section, -UNBOUNDED, UNBOUNDED))


def obstacles(motion: Motion) -> list[Slab]:
    """Return the slabs of all prisms and objects."""
    slabs = [prism.slab for prism in motion.requirements.keep_out]
    for body in motion.requirements.objects.values():
        slabs.extend(body.slabs)
    return slabs


@cached
def _rounding(motion: Motion) -> float:
    """Return the rounding error of distances from obstacles [m]."""
    return ROUNDING * (magnitude(motion) + sum(slab.size for slab in obstacles(motion)))


class PlacedObject(NamedTuple):
    """An object of a motion."""

    name: str  # Its name
    body: SolidObject  # The object
    pose: Enclosed  # (pieces,) x, y, z [m], cosine and sine of yaw


def placed_objects(motion: Motion) -> Iterator[PlacedObject]:
    """Yield the objects of a motion with their poses."""
    poses = motion.poses.coefficients
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        yield PlacedObject(name, body, Enclosed(poses[:, index]))


def pairs_with_shape(
    motion: Motion,
    points: Enclosed,
    names: Sequence[str],
    label: str,
    shape: Shape,
    pose: Enclosed | None = None,
    *,
    margin: float | None = None,
    **further: Any,
) -> Moving:
    """Return the pairs of moving points and a named shape; ``further`` as in ``Moving``.

    With a ``pose``, the shape is in its frame. The default rounding error ``margin`` is that of the
    motion.
    """
    local = points if pose is None else in_object_frame(pose, points)
    if margin is None:
        margin = _rounding(motion)
    margin += float(np.max(local.r))
    options: dict[str, Any] = {"breaks": motion.drones.breaks, "names": (names, (label,))}
    options |= further
    at_origin = np.zeros((len(local.c), 1, 1, 3, 1))
    return Moving(first=local.c, second=at_origin, margin=margin, shape=shape, **options)
