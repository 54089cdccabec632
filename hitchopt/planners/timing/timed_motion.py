"""Timed motions along paths: piecewise polynomials of time, from rest to rest within all limits.

The clock speeds up toppra's smoothed profile until limits bind at samples. Polynomials with the
path's jets at every breakpoint are then slowed down until limits also hold between samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError, Violation, rounded_up
from hitchopt.geometry.vectors import column_lengths, dot, length
from hitchopt.hitch import Team
from hitchopt.hitch.forces import cable_force_rates, cable_forces, cable_of, sag_factors
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.series import chained
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import FlatPath, Path, path_jets
from hitchopt.planners.timing.clock import Clock, even_clock, first_clock, jerk_limited
from hitchopt.planners.timing.profile import (
    FINAL_SHARE,
    LIMIT_SHARE,
    Demands,
    SpeedProfile,
    acceleration_ramp,
    demands_along,
    fastest_profile,
    loads_at_rest,
    path_grid,
    spare_accelerations,
)
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import divided
from hitchopt.values import Array, Indices
from hitchopt.values.fields import with_fields


def in_duration(motion: Motion, duration: float) -> Motion:
    """Return the curves rescaled to start at t = 0 with a duration [s], without phases."""
    breaks = duration / motion.duration * motion.drones.breaks
    breaks[-1] = duration
    return motion.map_curves(lambda part: part.replaced(part.coefficients, breaks), ())


def check_duration(duration: float, fastest: float, when: str = "") -> None:
    """Raise InfeasibleError if a prescribed duration is shorter than the fastest one [s]."""
    if duration < fastest:
        remedy = f"allow {rounded_up(fastest, 6):.6g} s or more, or raise the limits of motion"
        raise InfeasibleError(
            [Violation("duration", duration, fastest, "min", "s", (), when, remedy)]
        )


GRID = 160
"""Number of steps of toppra's grid along the path."""

MAX_CABLE_ERROR = 1e-6
"""Largest relative error of a cable's length, a hundredth of LENGTH_LIMIT."""

MAX_PIECES = 400
"""Number of pieces at which refinement for MAX_CABLE_ERROR ends."""

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
    demands = replace(demands_along(path, requirements.limits, GRID), limits=limits)
    profile = fastest_profile(path_grid(GRID), demands)
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

MAX_PEAK_ROUNDS = 2
"""Maximum number of clocks with smaller peaks that are tried."""


def _without_peaks(
    path: FlatPath,
    requirements: Requirements,
    limits: Limits,
    first: Clock,
    fastest: ClockedMotion,
) -> ClockedMotion:
    """Return a motion without peaks of jerk between samples, if it is faster once stretched."""
    best = fastest
    peaks = _jerk_peaks(best.motion, limits)
    best_duration = np.cbrt(np.max(peaks)) * best.motion.duration
    shares = np.ones(len(peaks))
    for _ in range(MAX_PEAK_ROUNDS):
        if np.max(peaks) <= MAX_PEAK:
            break
        shares = shares / np.maximum(peaks, 1.0)
        slower = _clocked(path, requirements, limits, first, shares)
        peaks = _jerk_peaks(slower.motion, limits)
        duration = np.cbrt(max(1.0, np.max(peaks))) * slower.motion.duration
        if duration < best_duration:
            best = slower
            best_duration = duration
    return best


def _jerk_peaks(motion: Motion, limits: Limits) -> Array:
    """Return the largest enclosed jerk on each piece (pieces,) over its limit."""
    peaks = [
        length(_on_spans(motion.drones, chunk, 3)).reshape(len(chunk), -1).max(axis=1)
        for chunk in _chunks(motion.team, np.arange(motion.drones.pieces))
    ]
    return np.concatenate(peaks) / (FINAL_SHARE * limits.jerk)


def stated_motion(path: Path, duration: float, requirements: Requirements) -> ClockedMotion:
    """Return the motion along a path whose s is time, in its duration [s], whatever its limits."""
    clock = even_clock(duration, path.vertices.breaks)
    while True:
        motion = motion_by(path, requirements, clock)
        if motion.drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
            return ClockedMotion(motion, clock)
        clock = replace(clock, knots=divided(clock.knots, np.full(len(clock.knots) - 1, 2)))


def clocked_limits(path: FlatPath, requirements: Requirements) -> Limits:
    """Return the limits of motion of the clock, which bounds body rates by the jerk.

    The body rate is about the jerk over the thrust per mass.
    """
    limits = requirements.limits
    if limits.body_rate is None:
        return limits
    demands = demands_along(path, limits, GRID)
    smallest = float(np.min(length(demands.loads) / path.team.mass))
    return with_fields(limits, jerk=min(limits.jerk, limits.body_rate * smallest))


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
    return _by_piece(values).reshape(-1, *part.shape)


def _by_piece(values: Array) -> Array:
    """Return values (pieces, *shape, samples) as (pieces, samples, *shape)."""
    return values.transpose(0, -1, *range(1, values.ndim - 1))


MAX_PIECE_SHARE = 1.0 / 12.0
"""Longest piece over the duration."""

PIECES_PER_RAMP = 6.0
"""Number of pieces in a change of the acceleration from one limit to the other."""

MIN_PIECE = 5e-3
"""[s] Shortest piece; shorter ones lose more digits of third derivatives than they gain speed."""

MAX_INITIAL_PIECES = 200
"""Approximate largest number of pieces of the first mesh."""

MIN_INITIAL_PIECES = 4
"""Smallest number of pieces of the first mesh."""

GRADING = 0.4
"""Largest slope of the length of pieces over time."""

TIME_TOLERANCE = 1e-9
"""Distance over the duration below which times are equal up to rounding."""

ACTIVE_SHARE = 0.1
"""Change of acceleration, over the largest one, above which pieces are short."""


def time_mesh(profile: SpeedProfile, ramp: float, refinement: int = 1) -> Array:
    """Return the knots (K + 1,) [s] for a profile smoothed over ``ramp`` [s].

    Parameters
    ----------
    profile: toppra's optimum.
    ramp: width of the moving average, which adds to the profile's duration.
    refinement: factor of the number of pieces.
    """
    duration = profile.duration + ramp
    changes = [profile.times, profile.times + 0.5 * ramp, profile.times + ramp]
    grid = np.linspace(0.0, duration, 801)
    t = np.unique(np.clip(np.concatenate([*changes, grid]), 0.0, duration))
    t = t[np.append(True, np.diff(t) > TIME_TOLERANCE * duration)]
    # The smoothed acceleration starts or ends to change at t, and is evaluated between
    middle = 0.5 * (t[1:] + t[:-1])
    change = np.abs(profile.acceleration(middle) - profile.acceleration(middle - ramp))
    active = np.append(change > ACTIVE_SHARE * np.max(change), False)
    active[1:] |= active[:-1]
    longest = MAX_PIECE_SHARE * duration
    fine = max(ramp / PIECES_PER_RAMP, MIN_PIECE)
    widths = np.where(active, np.minimum(fine, longest), longest)
    # Limit the slope of widths to the left and to the right
    left = np.minimum.accumulate(widths - GRADING * t) + GRADING * t
    right = np.minimum.accumulate((widths + GRADING * t)[::-1])[::-1] - GRADING * t
    widths = np.maximum(np.minimum(left, right), MIN_PIECE)
    pieces_per_step = 0.5 * (1.0 / widths[1:] + 1.0 / widths[:-1]) * np.diff(t)
    pieces = np.append(0.0, np.cumsum(pieces_per_step))
    initial = max(int(np.ceil(min(pieces[-1], MAX_INITIAL_PIECES))), MIN_INITIAL_PIECES)
    evenly = np.linspace(0.0, pieces[-1], refinement * initial + 1)
    knots: Array = np.interp(evenly, pieces, t)
    knots[0] = 0.0
    knots[-1] = duration
    return knots


SPANS = 8
"""Number of spans of a piece. They enclose rates to within about 0.1 %."""

SPAN_COEFFICIENTS = 8
"""Number of coefficients on each span, as of the drones' septic pieces."""

FORCE_STRETCH_SHARE = 0.9
"""Estimated stretch for forces, over that for rates, below which it is not computed."""

CHUNK = 60_000
"""Number of coefficients of drones per chunk."""

MAX_STRETCH = 1e6
"""Largest stretch of the search."""

STRETCH_TOLERANCE = 1e-4
"""Relative tolerance of a stretch."""

ROUNDING = 1e-9
"""Relative difference of rates within which they may be equal."""


def needed_stretch(motion: Motion) -> float:
    """Return the stretch in time with which a hitched motion satisfies its limits.

    Rates are enclosed, not sampled: a vector polynomial is in the convex hull of its coefficients,
    which are close to it on a short span of time.
    """
    team = motion.team
    limits = motion.requirements.limits
    drones = motion.drones
    factor = _rate_stretch(motion)
    critical = np.flatnonzero(_force_stretches(motion) > FORCE_STRETCH_SHARE * factor)
    no_vertices = np.zeros(0)
    for chunk in _chunks(team, critical):
        jets = np.stack([_on_spans(drones, chunk, order) for order in range(4)], axis=-1)
        forces = np.zeros(jets.shape[:-1])
        if team.has_cables:
            points = _on_spans(motion.pull_points, chunk)
            pulls = _on_spans(motion.pulls, chunk)
            forces = cable_forces(team, jets[..., 0], points, pulls, np.ones(team.robots))
        loads = loads_at_rest(team, forces)
        demands = Demands(jets, no_vertices, loads, team, limits, FINAL_SHARE)
        factor = max(factor, float(np.max(demands.stretches())))
    taut = PiecewisePolynomial.constant(drones.breaks, np.ones(team.robots))
    curves = (drones, motion.pull_points, motion.pulls, taut)
    return turning_stretch(team, limits.body_rate, curves, factor)


class RateBound(NamedTuple):
    """A limit of a time derivative of points."""

    points: PiecewisePolynomial
    """(k, 3) [m]"""

    order: int
    """Order of the derivative."""

    limit: float
    """Limit of its norm."""


def _rate_stretch(motion: Motion) -> float:
    """Return the stretch in time with which speeds, accelerations and jerks keep their limits.

    Spans are computed of the pieces whose own coefficients exceed a rate attained elsewhere.
    """
    limits = motion.requirements.limits
    bounds = (
        RateBound(motion.inner_ends.reshaped(-1, 3), 1, limits.vertex_speed),
        RateBound(motion.drones, 1, limits.speed),
        RateBound(motion.drones, 2, limits.acceleration),
        RateBound(motion.drones, 3, limits.jerk),
    )
    factor = 1e-12  # of motions at rest
    for points, order, limit in bounds:
        allowed = FINAL_SHARE * limit
        sizes = column_lengths(points.differentiated(order).coefficients).max(axis=1, initial=0.0)
        attained = max(float(np.max(sizes[:, [0, -1]])), allowed * factor**order)
        critical = np.flatnonzero(sizes.max(axis=1) >= (1.0 - ROUNDING) * attained)
        for chunk in _chunks(motion.team, critical):
            rate = float(np.max(length(_on_spans(points, chunk, order)), initial=0.0))
            factor = max(factor, (rate / allowed) ** (1.0 / order))
    return factor


def _force_stretches(motion: Motion) -> Array:
    """Return estimates of upper bounds of each piece's stretch (pieces,) for thrust and tilt.

    Accelerations have the worst direction, and forces at rest are those at the breakpoints.
    """
    team = motion.team
    drones = motion.drones
    forces = np.zeros((drones.pieces + 1, team.drones, 3))
    if team.has_cables:
        forces = cable_forces(
            team,
            _at_breaks(drones),
            _at_breaks(motion.pull_points),
            _at_breaks(motion.pulls),
            np.ones((len(forces), team.robots)),
        )
    limits = motion.requirements.limits
    spare = spare_accelerations(team, limits, loads_at_rest(team, forces))
    spare = np.maximum(spare, 1e-9)  # not zero: it divides
    second = bernstein.differentiate(bernstein.differentiate(drones.coefficients))
    accelerations = column_lengths(second).max(axis=-1) / drones.durations[:, None] ** 2
    ratios = accelerations / np.minimum(spare[1:], spare[:-1])
    return np.asarray(np.sqrt(ratios.max(axis=1)))


def _at_breaks(part: PiecewisePolynomial) -> Array:
    """Return the values (pieces + 1, *shape) at the breakpoints."""
    coefficients = part.coefficients
    return np.concatenate([coefficients[..., 0], coefficients[-1:, ..., -1]])


def turning_stretch(
    team: Team, limit: float | None, curves: Sequence[PiecewisePolynomial], smallest: float = 1.0
) -> float:
    """Return the stretch in time, at least ``smallest``, with which body rates keep their limit.

    With a stretch κ a thrust ``m a + l`` (l holds weight and cable force) becomes ``m a / κ² + l``
    and its derivative ``m j / κ³ + l̇ / κ``: the turning rate decreases with at most κ³. The stretch
    is infinite if the search fails.

    Parameters
    ----------
    limit: of the body rate [rad/s]; None for no limit.
    curves: drones (2n, 3) [m], their points (2n, 3) [m], pulls (2n,) [N] and tautness (n,), the
        arguments of ``cable_forces``, on common breaks; for single drones only the first.
    """
    if limit is None:
        return smallest
    factor = smallest
    pieces = np.arange(curves[0].pieces)
    while math.isfinite(factor):
        rate = max(_turning_rate(team, curves, chunk, factor) for chunk in _chunks(team, pieces))
        if rate <= LIMIT_SHARE * limit:
            break
        step = (1.0 + STRETCH_TOLERANCE) * (rate / (LIMIT_SHARE * limit)) ** (1.0 / 3.0)
        factor = factor * step if factor < MAX_STRETCH else math.inf
    return factor


def _turning_rate(
    team: Team, curves: Sequence[PiecewisePolynomial], pieces: Indices, stretch: float
) -> float:
    """Return the largest turning rate [rad/s] of thrusts on pieces of a stretched flight."""
    acceleration = _on_spans(curves[0], pieces, 2)
    jerk = _on_spans(curves[0], pieces, 3)
    forces = np.zeros_like(acceleration)
    force_rates = np.zeros_like(acceleration)
    if team.has_cables:
        values = tuple(_on_spans(curve, pieces) for curve in curves)
        rates = tuple(_on_spans(curve, pieces, 1) for curve in curves)
        forces = cable_forces(team, *values)
        force_rates = cable_force_rates(team, values, rates)
    mass = team.mass[:, None]
    thrust = mass * acceleration / stretch**2 + loads_at_rest(team, forces)
    thrust_rate = mass * jerk / stretch**3 - force_rates / stretch
    squared = dot(thrust, thrust)
    if not np.all(squared > 0.0):
        return math.inf
    return float(np.max(length(np.cross(thrust, thrust_rate)) / squared))


def _chunks(team: Team, pieces: Indices) -> Iterator[Indices]:
    """Yield the pieces of a flight in chunks of bounded size."""
    size = max(1, CHUNK // (SPANS * SPAN_COEFFICIENTS * team.drones))
    return (pieces[first : first + size] for first in range(0, len(pieces), size))


def _on_spans(part: PiecewisePolynomial, pieces: Indices, order: int = 0) -> Array:
    """Return enclosing values of a time derivative (pieces · SPANS · SPAN_COEFFICIENTS, *shape).

    They are coefficients on the spans of pieces; values and higher degrees are sampled instead.
    """
    of_pieces = part.coefficients[pieces]
    to_spans = _span_rows(bernstein.degree(of_pieces), order)
    of_spans = _by_piece(bernstein.transform(of_pieces, to_spans))
    durations = part.durations[pieces].reshape(-1, *(1,) * (of_spans.ndim - 1))
    values: Array = (of_spans / durations**order).reshape(-1, *part.shape)
    return values


@lru_cache
def _span_rows(degree: int, order: int) -> Array:
    """Return the map (SPANS · SPAN_COEFFICIENTS, degree + 1) from a piece to its spans."""
    derivatives = np.eye(degree + 1)
    for _ in range(order):
        derivatives = bernstein.differentiate(derivatives)
    starts = np.arange(SPANS) / SPANS
    if order == 0 or bernstein.degree(derivatives) >= SPAN_COEFFICIENTS:
        samples = starts[:, None] + np.linspace(0.0, 1.0 / SPANS, SPAN_COEFFICIENTS)
        basis = bernstein.basis(samples.ravel(), bernstein.degree(derivatives))
        rows = (derivatives @ basis.T).T
    else:
        elevated = bernstein.elevate(derivatives, SPAN_COEFFICIENTS - 1)[:, None]
        rows = bernstein.restrict(elevated, starts, starts + 1.0 / SPANS)
        rows = rows.reshape(degree + 1, -1).T
    rows.setflags(write=False)
    return rows
