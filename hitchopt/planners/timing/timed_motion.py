"""Timed motions along paths: piecewise polynomials of time, from rest to rest within all limits.

The clock speeds up toppra's smoothed profile until limits bind at samples. Polynomials with the
path's jets at every breakpoint are then slowed down until limits also hold between samples.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError, StepPlace, Violation, rounded_up
from hitchopt.geometry.vectors import length
from hitchopt.hitch.forces import cable_of, sag_factors
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.series import chained
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import FlatPath, Path, path_jets
from hitchopt.planners.timing.clock import Clock, even_clock, first_clock, jerk_limited
from hitchopt.planners.timing.mesh import time_mesh
from hitchopt.planners.timing.profile import (
    Demands,
    acceleration_ramp,
    demands_along,
    fastest_profile,
    path_grid,
)
from hitchopt.planners.timing.stretch import by_piece, jerk_peaks, needed_stretch
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import divided
from hitchopt.values import Array


def in_duration(motion: Motion, duration: float) -> Motion:
    """Return the curves rescaled to start at t = 0 with a duration [s], without phases."""
    breaks = duration / motion.duration * motion.drones.breaks
    breaks[-1] = duration
    return motion.map_curves(lambda part: part.replaced(part.coefficients, breaks), ())


def check_duration(duration: float, fastest: float, *steps: StepPlace) -> None:
    """Raise InfeasibleError if a prescribed duration of steps is shorter than the fastest one [s].

    The steps may be unknown.
    """
    if duration < fastest:
        remedy = f"allow {rounded_up(fastest, 6):.6g} s or more, or raise the limits of motion"
        raise InfeasibleError(
            [Violation("duration", duration, fastest, "min", "s", (), "", remedy, steps)]
        )


TIMING_GRID = 160  # Number of steps of toppra's grid along the path
MAX_CABLE_ERROR = 1e-6  # Largest relative error of a cable's length, a hundredth of LENGTH_LIMIT
MAX_PIECES = 400  # Number of pieces at which refinement for MAX_CABLE_ERROR ends

MIN_RAMP_SHARE = 1e-5
"""Shortest ramp of the acceleration over the duration; polynomials do not resolve shorter ones."""

MIN_DURATION = 0.05
"""[s] Shortest duration if none is prescribed; shorter moves would be dominated by rounding."""


def motion_along(
    path: FlatPath, requirements: Requirements, duration: float | None = None
) -> Motion:
    """Return the motion along a path, from rest to rest and without phases.

    Parameters
    ----------
    path: of the hitch.
    requirements: with the limits of motion, which the polynomials' enclosures satisfy.
    duration: prescribed duration [s]; None for the fastest one, but at least MIN_DURATION.

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits permit.
    TimingError: no timing was found.
    """
    return within_limits(fastest_motion(path, requirements).motion, duration)


class ClockedMotion(NamedTuple):
    """A motion along a path, and the clock that gives the path parameter over time."""

    motion: Motion
    clock: Clock


def fastest_motion(path: FlatPath, requirements: Requirements) -> ClockedMotion:
    """Return the fastest motion along a path; between samples it may exceed limits.

    Raises
    ------
    TimingError: no timing was found.
    """
    limits = clocked_limits(path, requirements)
    demands = replace(demands_along(path, requirements.limits, TIMING_GRID), limits=limits)
    profile = fastest_profile(path_grid(TIMING_GRID), demands)
    ramp = max(acceleration_ramp(profile, demands), MIN_RAMP_SHARE * profile.duration)
    refinement = 1
    while True:
        first = first_clock(profile, ramp, time_mesh(profile, ramp, refinement))
        fastest = _clocked(path, requirements, limits, first)
        motion = fastest.motion
        if motion.drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
            return _without_peaks(path, requirements, limits, first, fastest)
        refinement *= 2


def _clocked(
    path: FlatPath,
    requirements: Requirements,
    limits: Limits,
    first: Clock,
    jerk_shares: Array | None = None,
) -> ClockedMotion:
    """Return the fastest motion along a path by a first clock, as of ``jerk_limited``."""
    clock = jerk_limited(first, lambda s: Demands.along(path, limits, s), jerk_shares)
    return ClockedMotion(motion_by(path, requirements, clock), clock)


MAX_PEAK = 1.003
"""Largest jerk between samples over its limit; beyond, pieces with such peaks are slowed down.
A whole flight that is stretched for a peak takes longer by a third of its excess."""

MAX_PEAK_ROUNDS = 2  # Maximum number of clocks with smaller peaks that are tried


def _without_peaks(
    path: FlatPath,
    requirements: Requirements,
    limits: Limits,
    first: Clock,
    fastest: ClockedMotion,
) -> ClockedMotion:
    """Return a motion without peaks of jerk between samples, if it is faster once stretched."""
    best = fastest
    peaks = jerk_peaks(best.motion, limits)
    best_duration = np.cbrt(np.max(peaks)) * best.motion.duration
    shares = np.ones(len(peaks))
    for _ in range(MAX_PEAK_ROUNDS):
        if np.max(peaks) <= MAX_PEAK:
            break
        shares = shares / np.maximum(peaks, 1.0)
        slower = _clocked(path, requirements, limits, first, shares)
        peaks = jerk_peaks(slower.motion, limits)
        duration = np.cbrt(max(1.0, np.max(peaks))) * slower.motion.duration
        if duration < best_duration:
            best = slower
            best_duration = duration
    return best


def stated_motion(path: Path, duration: float, requirements: Requirements) -> ClockedMotion:
    """Return the motion along a path whose s is time, in its duration [s], whatever its limits."""
    clock = even_clock(duration, path.vertices.breaks)
    while True:
        motion = motion_by(path, requirements, clock)
        if motion.drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
            return ClockedMotion(motion, clock)
        clock = replace(clock, knots=divided(clock.knots, np.full(len(clock.knots) - 1, 2)))


def clocked_limits(path: FlatPath, requirements: Requirements) -> Limits:
    """Return the limits of motion of the clock, with the smallest thrust on the path at rest."""
    demands = demands_along(path, requirements.limits, TIMING_GRID)
    smallest = float(np.min(length(demands.loads) / path.team.mass))
    return requirements.limits.of_clocks(smallest)


def within_limits(motion: Motion, duration: float | None = None) -> Motion:
    """Return a motion slowed down until its limits hold, or in a prescribed duration [s].

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits permit.
    """
    fastest = needed_stretch(motion) * motion.duration
    if duration is None:
        return in_duration(motion, max(fastest, MIN_DURATION))
    check_duration(duration, fastest)
    return in_duration(motion, duration)


def motion_by(path: FlatPath, requirements: Requirements, clock: Clock) -> Motion:
    """Return the motion with the path's value and three derivatives at every breakpoint."""
    breaks = clock.breaks
    progress = clock.jets()
    s = np.clip(progress[:, 0], 0.0, 1.0)
    s[0] = 0.0
    s[-1] = 1.0
    jets = path_jets(path, s)
    rows = np.concatenate([jet.reshape(len(s), -1, 4) for jet in jets], axis=1)
    curves = PiecewisePolynomial.through_jets(breaks, chained(rows, progress[:, None]))
    drones, vertices, legs, tensions = curves.split([jet.shape[1:-1] for jet in jets])
    is_constant = not jets.tensions[..., 1:].any() and (jets.tensions == jets.tensions[0]).all()
    if is_constant:
        tensions = PiecewisePolynomial.constant(breaks, jets.tensions[0, :, 0])
    return Motion(path.team, requirements, drones, vertices, legs, tensions, phases=())


def cable_error(motion: Motion) -> float:
    """Return the largest relative error of a cable's length at samples."""
    team = motion.team
    vertices = _sampled(motion.vertices)
    legs = _sampled(motion.drones) - vertices[:, team.layout.anchors]
    sag = sag_factors(team, _sampled(motion.tensions))
    cables: Array = cable_of(legs[:, 0::2], sag) + cable_of(legs[:, 1::2], sag)
    cables += cable_of(team.layout.edges(vertices), sag)
    return float(np.abs(cables / team.cable_length - 1.0).max())


CABLE_SAMPLES = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
"""Local parameters in pieces at which lengths of cables are computed."""


def _sampled(part: PiecewisePolynomial) -> Array:
    """Return the values (pieces · samples, *shape) at CABLE_SAMPLES."""
    coefficients = part.coefficients
    basis = bernstein.basis(CABLE_SAMPLES, coefficients.shape[-1] - 1)
    values = bernstein.transform(coefficients, basis)
    return by_piece(values).reshape(-1, *part.shape)
