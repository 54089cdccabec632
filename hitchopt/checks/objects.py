"""Objects of a motion: points in their frames, and spans of objects that a hitch holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.spans import MotionSpans, cached
from hitchopt.motion.loads import centre_path, reduce_constants
from hitchopt.motion.motion import Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Enclosed, vector
from hitchopt.values import Array, Indices, lazy

Mask = NDArray[np.bool_]

PLACE_TOLERANCE = 1e-4  # [m] Largest drift of clasps below a rim, and mean drift of contacts


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
