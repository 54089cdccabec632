"""Paths on which legs are rolled more half way than at either end.

Along nearly straight edges the two drones of a cable meet where the edge is half as long as the
cable. In the plane they cannot pass one another; with ``L - l`` of legs between them, a roll ψ sets
them ``(L - l) sin ψ`` apart in height, and each goes by above or below the other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.trajectory import PiecewisePolynomial, bernstein

RAISES = tuple(math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0))
"""[rad] Rolls that are added half way, tried in turn."""

STEEPEST = math.radians(60.0)
"""[rad] Largest roll tried, up to which clasps hold in simulated ropes."""

DEGREE = 2


def rolled_more(path: ShapePath) -> Iterator[ShapePath]:
    """Yield the path with its legs rolled more half way; none where they are not rolled at all."""
    roll = path.roll
    if roll is None:
        return
    c = roll.coefficients
    order = max(DEGREE, bernstein.degree(c))
    sense = np.sign(c[..., 0] + c[..., -1])[..., None]
    lower, upper = roll.breaks[:-1], roll.breaks[1:]
    rise = bernstein.restrict(np.array([0.0, 2.0, 0.0]), lower, upper)[:, None]  # 4 s (1 - s)
    own, more = bernstein.elevate(c, order), bernstein.elevate(rise, order)
    for angle in RAISES:
        if float(np.max(np.abs(own))) + angle > STEEPEST:
            return
        yield replace(path, roll=PiecewisePolynomial(roll.breaks, own + angle * sense * more))
