"""Check ``tilt``: no drone leans farther than allowed."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hitchopt.checks.bounds.leg_directions import largest_along
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.thrust_enclosure import (
    known_directions,
    thrust_at,
    thrust_cells,
    thrust_enclosure,
)
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.geometry.vectors import column_lengths, length, unit
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosure import Enclosure
from hitchopt.trajectory.extremum import Estimate
from hitchopt.values import Array

UPSIDE_DOWN = 180.0
"""[deg] The largest angle there is; also that of a thrust of no direction."""


def _find(motion: Motion, limit: float) -> Finding:
    """Return the largest angle of any drone's thrust from vertical, in degrees."""
    cells = thrust_cells(motion)
    aim = within(limit, "max", share=0.5)
    noise = position_margin(motion)
    bound = partial(tilt_bound, noise=noise)
    found = largest_along(cells, bound, known_directions(motion), aim)
    where = (motion.team.drone_names[found.item],)
    return Finding(min(found.worst, UPSIDE_DOWN), found.time, where)


def tilt_bound(blocks: tuple[Array, ...], noise: float, along: Enclosure | None = None) -> Estimate:
    """Bound the tilts of cells from above [deg]."""
    thrust = thrust_enclosure(blocks, noise, along)
    f, radius = thrust.coefficients, thrust.radius[:, None]
    angles = _angle(column_lengths(f[:, :2]), f[:, 2])
    # A cone about the vertical is convex below 90°: it holds the thrust if it holds a ball
    # of the radius about every coefficient.
    reach = angles + _spread(radius, column_lengths(f))
    bound = np.max(reach, axis=-1)
    low = ~(bound < 90.0)
    if np.any(low):
        bound[low] = _sideways(f[low], radius[low])
    index, order = np.argmax(angles, axis=-1), bernstein.degree(f)
    there = thrust_at(blocks, index, order)
    size = length(there.vectors)
    value = _angle(length(there.vectors[:, :2]), there.vectors[:, 2])
    value = np.minimum(value + _spread(there.pull, size), UPSIDE_DOWN)
    value = np.where(there.pull >= size, UPSIDE_DOWN, value)
    return Estimate(bound, value, index / max(1, order))


def _sideways(f: Array, radius: Array) -> Array:
    """Bound tilts from above (cells,) [deg], in the plane of ẑ and the azimuth at mid time.

    Where a thrust points below the horizon, leaving out the third coordinate turns it farther down.

    Parameters
    ----------
    f: (cells, 3, degree + 1), coefficients of thrusts.
    radius: (cells, 1), of their errors.
    """
    azimuth = unit(bernstein.evaluate(f[:, :2], 0.5))
    across = np.einsum("ci,cin->cn", azimuth, f[:, :2])
    level = _angle(across, f[:, 2]) + _spread(radius, np.hypot(across, f[:, 2]))
    downward = np.maximum(np.max(level, axis=-1), 90.0)
    return np.where(np.min(across - radius, axis=-1) > 0.0, downward, UPSIDE_DOWN)


def _angle(across: Array, upward: Array) -> Array:
    """Return the angle from +z in the half plane of (across, upward) [deg]."""
    return np.degrees(np.arctan2(across, upward))


def _spread(radius: Array, size: Array) -> Array:
    """Return by how much a ball of ``radius`` at ``size`` can turn a direction [deg]."""
    ratio = np.divide(radius, size, out=np.ones_like(size), where=size > radius)
    return np.where(ratio < 1.0, np.degrees(np.arcsin(ratio)), UPSIDE_DOWN)


RULE = CheckRule(
    "tilt",
    "deg",
    "max",
    lambda motion: math.degrees(motion.requirements.limits.tilt),
    (Finder(_find, exported=True),),
    "raise limits.tilt_deg, or lower team.tension",
    "raise limits.tilt_deg, or lower team.cable_density",
    Ease.TENSION,
    derivative=2,
)
