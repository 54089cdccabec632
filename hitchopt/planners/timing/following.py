"""Motions that follow their path: the distance from it is bounded for all t."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import column_lengths, length
from hitchopt.hitch.model import drone_jets
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import Path
from hitchopt.planners.timing.timed_motion import (
    fastest_motion,
    motion_by,
    stated_motion,
    within_limits,
)
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import divided, locate
from hitchopt.values import Array

MAX_DISTANCE = 1e-4
"""[m] Largest distance of a motion from its path, as of ``Path.of`` from its function."""

MAX_PIECES = 10_000  # Number of pieces beyond which a path is refused
SPANS = 64  # Number of spans of a piece on which path and motion are compared with their chords
DRONE_STRIDE = 8  # Number of these spans between two times at which drones are compared


def following_motion(
    path: Path, requirements: Requirements, duration: float | None = None
) -> Motion:
    """Return the motion of ``motion_along``, its pieces halved until it is near the path.

    A path with a duration keeps its timing, whatever its limits.

    Raises
    ------
    InputError: the path turns too often for MAX_PIECES.
    InfeasibleError, TimingError: as ``motion_along``.
    """
    if path.duration is None:
        motion, clock = fastest_motion(path, requirements)
    else:
        motion, clock = stated_motion(path, path.duration, requirements)
    while True:
        progress = PiecewisePolynomial.through_jets(clock.breaks, clock.jets())
        distances = distances_from(path, motion, progress)
        is_far = distances > MAX_DISTANCE
        if not np.any(is_far):
            return within_limits(motion, duration) if path.duration is None else motion
        if motion.drones.pieces + np.count_nonzero(is_far) > MAX_PIECES:
            worst = int(np.argmax(distances))
            found = f"left by {distances[worst]:.2g} m near s = {clock.jets()[worst, 0]:.3g}"
            bound = f"within {MAX_DISTANCE:g} m of its motion of {MAX_PIECES} polynomials"
            raise InputError("path", found, bound, "make it smoother or split it")
        clock = replace(clock, knots=divided(clock.knots, 1 + is_far))
        motion = motion_by(path, requirements, clock)


def distances_from(path: Path, motion: Motion, progress: PiecewisePolynomial) -> Array:
    """Return the largest distance [m] of each piece (pieces,) of a motion from its path.

    It is that of any vertex, an upper bound for all t, and of drones at samples. On a short span of
    time a vertex and its path are near their chords, by at most ``h² / 8`` times the largest second
    derivative (h is the length of the span, in t or s); two chords are never farther apart than at
    their ends.

    Parameters
    ----------
    progress: the path parameter over time, on the motion's breaks.
    """
    x = np.linspace(0.0, 1.0, SPANS + 1)
    s = _at(progress, x).clip(0.0, 1.0)
    on_path = path.vertices.at(s.ravel()).reshape(*s.shape, *path.vertices.shape)
    apart = np.max(length(_at(motion.vertices, x) - on_path), axis=-1)
    ends = np.maximum(apart[:, 1:], apart[:, :-1])
    spans_of_time = motion.vertices.durations / SPANS
    bulges = spans_of_time**2 / 8.0 * _largest_second_rates(motion.vertices)
    # Largest second derivatives of the path on the range of each row of s
    path_rates = np.append(_largest_second_rates(path.vertices), 0.0)
    first, _ = locate(path.vertices.breaks, np.min(s, axis=1))
    last, _ = locate(path.vertices.breaks, np.max(s, axis=1))
    ranges = np.stack([first, last + 1], axis=1)
    of_ranges = np.maximum.reduceat(path_rates, ranges.ravel())[::2]
    path_bulges = np.diff(s) ** 2 / 8.0 * of_ranges[:, None]
    bounds: Array = np.max(ends + path_bulges, axis=1) + bulges
    drone_x = x[::DRONE_STRIDE]
    drone_s = s[:, ::DRONE_STRIDE]
    drones = drone_jets(path.team, path.flat(drone_s.ravel(), 1)).positions[..., 0]
    drones = drones.reshape(*drone_s.shape, *motion.drones.shape)
    drones_apart = np.max(length(_at(motion.drones, drone_x) - drones), axis=(1, 2))
    return np.asarray(np.maximum(bounds, drones_apart))


def _at(part: PiecewisePolynomial, x: Array) -> Array:
    """Return the values (pieces, m, *shape) at local parameters (m,)."""
    basis = bernstein.basis(x, part.degree)
    values: Array = np.moveaxis(bernstein.transform(part.coefficients, basis), -1, 1)
    return values


def _largest_second_rates(part: PiecewisePolynomial) -> Array:
    """Return the largest norm of second derivatives (pieces,) of points (k, 3) on each piece."""
    second = bernstein.differentiate(bernstein.differentiate(part.coefficients))
    rates: Array = np.max(column_lengths(second), axis=(1, 2)) / part.durations**2
    return rates
