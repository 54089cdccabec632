"""Legs that lead and lag, so that drones start and stop more gently than their vertices.

Vertices have a limit of speed, drones one of acceleration besides. Where a vertex moves along the
legs of its drones, cables that slide through the clasps while it speeds up leave its drones behind
for a while, and let them overtake it: the vertex is at full speed earlier and stays so
for longer. The slide is a cubic of the path's parameter that is zero at both ends; its slopes there
are, for every cable by itself, those that leave its two drones the least to do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hitchopt.geometry.vectors import length, unit
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, drones_along
from hitchopt.planners.timing.time_estimates import flight_estimate, grid_demands
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

DEGREE = 3

HELPS = 0.9
"""Largest share of the fastest drone's start and stop that may be left for a slide to be tried."""

SHARES = (1.0, 0.75, 0.5)
"""Shares of the slide that leaves drones the least to do: it costs speed in between."""

SMALLER = 0.4
"""Factor on the best share: where that breaks a distance, one that slides less may not."""

GAIN = 0.995
"""Largest share of the path's own estimate that another one may take to be worth flying."""


def leading(path: ShapePath, limits: Limits) -> Iterator[ShapePath]:
    """Yield paths of the same vertices with a shorter estimate, the best first; mostly none.

    Neither their distances nor their durations are verified here.
    """
    if path.legs.length.pieces > 1:
        return
    slopes, left = _slopes(path, limits)
    if left > HELPS:
        return
    paths = {share: _slid(path, share * slopes) for share in SHARES}
    times = {share: flight_estimate(p, limits) for share, p in paths.items()}
    best = min(SHARES, key=lambda share: times[share])
    if times[best] < GAIN * flight_estimate(path, limits):
        yield paths[best]
        yield _slid(path, SMALLER * best * slopes)


def _slopes(path: ShapePath, limits: Limits) -> tuple[Array, float]:
    """Return the slides' slopes (2, n) [m] at s = 0 and 1 that slow the drones most there.

    Also the fastest drone's share of its speed that they leave. A drone's derivative by s is linear
    in its leg's, which moves it along the leg.
    """
    ends, n = np.array([0.0, 1.0]), path.team.robots
    jets = grid_demands(path, limits).drones[[0, -1]]
    usual = jets[..., 1].reshape(2, n, 2, -1)
    if path.team.cable_density == 0.0 and path.team.layout.closed:
        legs = jets[..., 0] - path.vertices.at(ends)[:, path.team.layout.anchors]
        along = unit(legs).reshape(2, n, 2, -1) * [[1.0], [-1.0]]  # r-legs grow shorter
    else:
        slid = drones_along(_slid(path, np.ones((2, n))), ends)
        along = slid.positions[..., 1].reshape(2, n, 2, -1) - usual
    size = np.sum(along**2, axis=(2, 3))
    slopes: Array = -np.sum(usual * along, axis=(2, 3)) / np.where(size > 0.0, size, np.inf)
    fastest = np.max(length(usual))
    led = np.max(length(usual + slopes[..., None, None] * along))
    return slopes, float(led / fastest) if fastest > 0.0 else math.inf


def _slid(path: ShapePath, slopes: Array) -> ShapePath:
    """Return the path with its legs slid, with slopes (2, n) at its ends."""
    law = path.legs.length.coefficients[0]
    slide = np.zeros((path.team.robots, DEGREE + 1))
    slide[:, 1], slide[:, -2] = slopes[0] / DEGREE, -slopes[1] / DEGREE
    order = max(DEGREE, bernstein.degree(law))
    length = bernstein.elevate(law, order) + bernstein.elevate(slide, order)
    legs = LegLaw(PiecewisePolynomial(np.array([0.0, 1.0]), length[None]), path.legs.share)
    return replace(path, legs=legs)
