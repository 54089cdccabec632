"""How far a pair of drones may move toward each other before their ellipsoids touch.

They touch where their offset is on the ellipsoid of twice the semi-axes. Its distance to a point δ
is the largest of ``n·δ - h(n)`` over vectors n no longer than one, h the ellipsoid's support
function ``√(a² (n_x² + n_y²) + b² n_z²)``, which is convex: between the normals at both ends of a
cell the bound closes in on the distance, as ``trajectory.distance`` does for points.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.moving_bodies import Metric
from hitchopt.requirements import Separation
from hitchopt.trajectory.extremum import Estimate
from hitchopt.values import Array

NEWTON = 12
"""Number of Newton iterations for the nearest point; a normal that is off costs tightness only."""


def ellipsoid_metric(separation: Separation) -> Metric:
    """Return the distance [m] of offsets times ``Separation.scale`` to the touching ellipsoid."""
    axes = 1.0 / separation.scale
    thinnest = float(np.min(axes))

    def bound(blocks: tuple[Array, ...]) -> Estimate:
        offsets = blocks[0] * axes[:, None]
        degree = offsets.shape[-1] - 1
        normals = [nearest_normals(offsets[..., end], axes) for end in (0, -1)]
        gaps = [
            np.einsum("ck,ckn->cn", normal, offsets) - _support(normal, axes)[:, None]
            for normal in normals
        ]
        weight = np.arange(degree + 2) / (degree + 1)
        coefficients = np.zeros((len(offsets), degree + 2))
        coefficients[:, :-1] = (1.0 - weight[:-1]) * gaps[0]
        coefficients[:, 1:] += weight[1:] * gaps[1]
        ends = np.maximum(np.stack([gaps[0][:, 0], gaps[1][:, -1]]), 0.0)
        x = np.argmin(ends, axis=0).astype(np.float64)
        lowest = np.maximum(np.min(coefficients, axis=-1), 0.0)
        return Estimate(lowest, np.min(ends, axis=0), x)

    def measured(scaled: Array) -> Array:
        return ellipsoid_distance(scaled * axes, axes)

    # A ratio s leaves at least the thinnest semi-axis times s - 1.
    return Metric(bound, measured, lambda measure: 1.0 + measure / thinnest)


def ellipsoid_distance(offsets: Array, axes: Array) -> Array:
    """Return the distance (…) [m] of points (…, 3) [m] to an ellipsoid, zero within.

    Parameters
    ----------
    axes: (3,) [m], its semi-axes, the first two alike.
    """
    normals = nearest_normals(offsets, axes)
    gaps = np.sum(normals * offsets, axis=-1) - _support(normals, axes)
    distances: Array = np.maximum(gaps, 0.0)
    return distances


def nearest_normals(offsets: Array, axes: Array) -> Array:
    """Return the outward normals (…, 3) where the ellipsoid is nearest; zero for points within.

    The nearest point is ``(a² x, b² z) / (t + (a², b²))`` with t > 0 where that is on the
    ellipsoid. Newton's method on a convex function that falls, from the left.
    """
    a, b = float(axes[0]), float(axes[2])
    across, upward = np.hypot(offsets[..., 0], offsets[..., 1]), np.abs(offsets[..., 2])
    outside = (across / a) ** 2 + (upward / b) ** 2 > 1.0
    t = np.maximum(np.maximum(a * across - a * a, b * upward - b * b), 0.0)
    for _ in range(NEWTON):
        x, z = a * across / (t + a * a), b * upward / (t + b * b)
        excess = x * x + z * z - 1.0
        slope = 2.0 * (x * x / (t + a * a) + z * z / (t + b * b))
        t = t + np.where(outside, excess / np.where(slope > 0.0, slope, 1.0), 0.0)
    scale = t[..., None] + axes**2
    normals = offsets / scale
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    found: Array = np.where(
        outside[..., None] & (size > 0.0), normals / np.where(size > 0.0, size, 1.0), 0.0
    )
    return found


def _support(normals: Array, axes: Array) -> Array:
    """Return the support function (…) [m] of the ellipsoid."""
    support: Array = np.linalg.norm(normals * axes, axis=-1)
    return support
