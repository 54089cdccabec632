"""Flights along paths: piecewise polynomials of time, from rest to rest within all limits.

toppra's profile, smoothed, is sped up by the clock until limits bind at samples; polynomials that
meet the path's jets at every break are then slowed until their limits hold between samples too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import Team
from hitchopt.hitch.forces import cable_force_rates, cable_forces, cable_of, sag_factors
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.jets import chained, polynomials_through
from hitchopt.planners.morph.path import Path, path_jets
from hitchopt.planners.timing.clock import Clock, first_clock, jerk_limited
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
from hitchopt.values import Array, Indices


def in_duration(motion: Motion, duration: float) -> Motion:
    """Return the same curves from t = 0 in exactly ``duration`` [s], without phases."""
    breaks = duration / motion.duration * motion.drones.breaks
    breaks[-1] = duration
    return motion.map_curves(lambda part: part.alike(part.coefficients, breaks), ())


def check_duration(duration: float, fastest: float, when: str = "") -> None:
    """Raise InfeasibleError where a wanted duration is shorter than the fastest one [s]."""
    if duration < fastest:
        remedy = f"give it {fastest:.6g} s or more, or raise the limits of motion"
        raise InfeasibleError(
            [Violation("duration", duration, fastest, "min", "s", (), when, remedy)]
        )


GRID = 160
"""Number of steps of toppra's grid along the path."""

MODEL_ERROR = 1e-6
"""Largest relative error of a cable's length: a tenth of a plan's guarantee."""

FINEST = 400
"""Number of pieces at which refining for the sake of MODEL_ERROR ends."""

SHORTEST_RAMP = 1e-5
"""Shortest ramp of the acceleration, as a share of the duration: polynomials do not resolve ramps
of microseconds in flights of a month."""

SHORTEST_FLIGHT = 0.05
"""[s] Shortest duration chosen: a move of micrometres would be over before its polynomials are
above their rounding."""


def fly(path: Path, requirements: Requirements, duration: float | None = None) -> Motion:
    """Return the motion along a path, from rest to rest and without phases.

    Parameters
    ----------
    path: to be flown.
    requirements: of whose limits none is broken where the polynomials are sampled.
    duration: exact duration [s]; None for as fast as the limits allow, SHORTEST_FLIGHT at least.

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits allow.
    TimingError: no timing was found.
    """
    limits = aimed = requirements.limits
    demands = demands_along(path, limits, GRID)
    if limits.body_rate is not None:  # thrusts turn with the jerk, and are least at rest
        least = float(np.min(length(demands.loads) / path.team.mass))
        aimed = replace(limits, jerk=min(limits.jerk, limits.body_rate * least))
        demands = replace(demands, limits=aimed)
    profile = fastest_profile(path_grid(GRID), demands)
    ramp = max(acceleration_ramp(profile, demands), SHORTEST_RAMP * profile.duration)
    finer = 1
    while True:
        clock = first_clock(profile, ramp, time_mesh(profile, ramp, finer))
        warped = jerk_limited(clock, lambda s: Demands.along(path, aimed, s))
        motion = _motion(path, requirements, warped)
        if motion.drones.pieces >= FINEST or cable_error(motion) <= MODEL_ERROR:
            break
        finer *= 2
    fastest = needed_stretch(motion) * motion.duration
    if duration is None:
        return in_duration(motion, max(fastest, SHORTEST_FLIGHT))
    check_duration(duration, fastest)
    return in_duration(motion, duration)


def _motion(path: Path, requirements: Requirements, clock: Clock) -> Motion:
    """Return the motion that meets value, velocity, acceleration and jerk at every break."""
    breaks, progress = clock.breaks, clock.jets()
    s = np.clip(progress[:, 0], 0.0, 1.0)
    s[0], s[-1] = 0.0, 1.0
    *parts, tensions = path_jets(path, s)

    def timed(jets: Array) -> PiecewisePolynomial:
        """Return the polynomials for jets by s (J, *shape, 4)."""
        inner = progress.reshape(len(s), *(1,) * (jets.ndim - 2), 4)
        return polynomials_through(breaks, chained(jets, inner))

    steady = not np.any(tensions[..., 1:]) and np.all(tensions == tensions[0])
    constant = PiecewisePolynomial.constant(breaks, tensions[0, :, 0])
    drones, vertices, legs = map(timed, parts)
    pulled = constant if steady else timed(tensions)
    return Motion(path.team, requirements, drones, vertices, legs, pulled, phases=())


def cable_error(motion: Motion) -> float:
    """Return the largest relative error of a cable's length at samples between the breaks."""
    team, inner, breaks = motion.team, (np.arange(5) + 0.5) / 5, motion.drones.breaks
    times = np.append(breaks[:-1, None] + np.diff(breaks)[:, None] * inner, breaks)
    p, sag = motion.vertices.at(times), sag_factors(team, motion.tensions.at(times))
    legs = motion.drones.at(times) - p[:, team.layout.anchors]
    spans = (legs[:, 0::2], team.layout.edges(p), legs[:, 1::2])
    cables = np.sum([cable_of(span, sag) for span in spans], axis=0)
    return float(np.max(np.abs(cables / team.cable_length - 1.0)))


WIDEST = 1.0 / 12.0
"""Longest piece, as a share of the whole time."""

PER_RAMP = 6.0
"""Number of pieces in a change of the acceleration from one limit to the other."""

SHORTEST = 5e-3
"""[s] Shortest piece: shorter ones lose more digits in third derivatives than they gain speed."""

MAX_FIRST_PIECES = 200
"""Approximate number of pieces of the first mesh; where more would be needed, all are wider."""

GRADING = 0.4
"""Largest growth of pieces' lengths with their distance from one another."""

SAME = 1e-9
"""Share of the whole time: places closer than this are one, which rounding alone tells apart."""

ACTIVE = 0.1
"""Share of the largest change of acceleration below which a time counts as quiet."""


def time_mesh(profile: SpeedProfile, ramp: float, finer: int = 1) -> Array:
    """Return the knots (K + 1,) [s] for a profile smoothed over ``ramp`` [s].

    Parameters
    ----------
    profile: toppra's optimum.
    ramp: width of the moving average; the knots run from 0 to the profile's duration and this.
    finer: every piece is divided by about as much.
    """
    whole = profile.duration + ramp
    # Wherever the smoothed profile's acceleration may begin or end to change, and in between.
    places = np.concatenate([profile.times, profile.times + 0.5 * ramp, profile.times + ramp])
    t = np.unique(np.clip(np.append(places, np.linspace(0.0, whole, 801)), 0.0, whole))
    t = t[np.append(True, np.diff(t) > SAME * whole)]
    # The acceleration jumps at t: it is evaluated in between, where no rounding changes it.
    middle = 0.5 * (t[1:] + t[:-1])
    change = np.abs(profile.acceleration(middle) - profile.acceleration(middle - ramp))
    busy = np.append(change > ACTIVE * np.max(change), False)
    busy[1:] |= busy[:-1]
    fine = max(ramp / PER_RAMP, SHORTEST)
    widths = np.where(busy, np.minimum(fine, WIDEST * whole), WIDEST * whole)
    # No width exceeds another by more than GRADING of its distance, on the left and on the right.
    left = np.minimum.accumulate(widths - GRADING * t) + GRADING * t
    right = np.minimum.accumulate((widths + GRADING * t)[::-1])[::-1] - GRADING * t
    widths = np.maximum(np.minimum(left, right), SHORTEST)
    density = 0.5 * (1.0 / widths[1:] + 1.0 / widths[:-1]) * np.diff(t)
    pieces = np.append(0.0, np.cumsum(density))
    count = finer * max(int(np.ceil(min(pieces[-1], MAX_FIRST_PIECES))), 4)
    knots: Array = np.interp(np.linspace(0.0, pieces[-1], count + 1), pieces, t)
    knots[0], knots[-1] = 0.0, whole
    return knots


SPANS, ENCLOSING = 8, 8
"""Spans of a piece whose coefficients enclose rates, within about 0.1 %, and how many each has:
those of the drones' septic pieces."""

SURELY = 0.9
"""Share of the stretch for rates below which a rough estimate of that for forces is ignored."""

CHUNK = 60_000
"""Number of coefficients of drones that are processed in one go."""

SLOWEST = 1e6
"""Largest stretch that is tried."""

PRECISION = 1e-4
"""Relative precision of a stretch."""


def needed_stretch(motion: Motion) -> float:
    """Return how many times slower a formed motion must be to satisfy its limits.

    Rates are not sampled but enclosed: a vector polynomial stays within the hull of its
    coefficients, which lie close to it on a short span of time.
    """
    team, limits = motion.team, motion.requirements.limits
    drones, vertices, pulls = motion.drones, motion.vertices, motion.pulls
    factor, still = 1e-12, np.zeros(0)
    rates = (limits.speed, limits.acceleration, limits.jerk)
    bounds = [(vertices, 1, limits.vertex_speed)]
    bounds += [(drones, order, limit) for order, limit in enumerate(rates, 1)]
    for some in _chunks(team, np.arange(drones.pieces)):
        for part, order, limit in bounds:
            rate = float(np.max(length(_on_spans(part, some, order)), initial=0.0))
            factor = max(factor, (rate / (FINAL_SHARE * limit)) ** (1.0 / order))
    for some in _chunks(team, np.flatnonzero(_force_stretches(motion) > SURELY * factor)):
        jets = np.stack([_on_spans(drones, some, order) for order in range(4)], axis=-1)
        pull = np.zeros(jets.shape[:-1])
        if team.has_cables:
            places, values = (_on_spans(part, some) for part in (vertices, pulls))
            pull = cable_forces(team, jets[..., 0], places, values, np.ones(team.robots))
        loads = loads_at_rest(team, pull)
        demands = Demands(jets, still, loads, team, limits, FINAL_SHARE)
        factor = max(factor, float(np.max(demands.stretches())))
    taut = PiecewisePolynomial.constant(drones.breaks, np.ones(team.robots))
    return turning_stretch(team, limits.body_rate, (drones, vertices, pulls, taut), factor)


def _force_stretches(motion: Motion) -> Array:
    """Return about how many times slower each piece (pieces,) must be for thrust and tilt at most.

    As if accelerations pointed to where forces at rest, taken at the breaks, leave the least.
    """
    team, limits, drones = motion.team, motion.requirements.limits, motion.drones
    pull = np.zeros((drones.pieces + 1, team.drones, 3))
    if team.has_cables:
        drones_at, vertices, pulls = (
            part.at(drones.breaks) for part in (drones, motion.vertices, motion.pulls)
        )
        pull = cable_forces(team, drones_at, vertices, pulls, np.ones((len(pull), team.robots)))
    spare = np.maximum(spare_accelerations(team, limits, loads_at_rest(team, pull)), 1e-9)
    c = bernstein.differentiate(bernstein.differentiate(drones.coefficients))
    rates = np.max(np.linalg.norm(c, axis=-2), axis=-1) / drones.durations[:, None] ** 2
    stretches: Array = np.sqrt(np.max(rates / np.minimum(spare[1:], spare[:-1]), axis=1))
    return stretches


def turning_stretch(
    team: Team, limit: float | None, curves: Sequence[PiecewisePolynomial], least: float = 1.0
) -> float:
    """Return how many times slower, at least ``least``, a flight must be to keep its body rates.

    Slowed by κ, a thrust ``m a + l`` (l holds weight and cable) becomes ``m a / κ² + l`` and its
    derivative ``m j / κ³ + l̇ / κ``: the rate at which it turns falls with κ³ at most. Infinite
    where no stretch was found.

    Parameters
    ----------
    limit: of the body rate [rad/s]; None for no limit.
    curves: drones (2n, 3) [m], vertices (points, 3) [m], pulls (2n,) [N] and tautness (n,), as
        ``cable_forces`` takes them, on common breaks; of single drones the first one.
    """
    if limit is None:
        return least
    factor, pieces = least, np.arange(curves[0].pieces)
    while math.isfinite(factor):
        fastest = max(_turning_rate(team, curves, some, factor) for some in _chunks(team, pieces))
        if fastest <= LIMIT_SHARE * limit:
            break
        slower = (1.0 + PRECISION) * (fastest / (LIMIT_SHARE * limit)) ** (1.0 / 3.0)
        factor = factor * slower if factor < SLOWEST else math.inf
    return factor


def _turning_rate(
    team: Team, curves: Sequence[PiecewisePolynomial], pieces: Indices, stretch: float
) -> float:
    """Return the largest turning rate [rad/s] of thrusts on pieces of a flight, slowed."""
    values, rates = ([_on_spans(part, pieces, order) for part in curves] for order in (0, 1))
    second, third = (_on_spans(curves[0], pieces, order) for order in (2, 3))
    pull = pulled = np.zeros_like(second)
    if team.has_cables:
        pull = cable_forces(team, *values)
        pulled = cable_force_rates(team, tuple(values), tuple(rates))
    mass = team.mass[:, None]
    thrust = mass * second / stretch**2 + loads_at_rest(team, pull)
    rate = mass * third / stretch**3 - pulled / stretch
    squared = dot(thrust, thrust)
    if not np.all(squared > 0.0):
        return math.inf
    return float(np.max(length(np.cross(thrust, rate)) / squared))


def _chunks(team: Team, pieces: Indices) -> Iterator[Indices]:
    """Yield pieces of a flight that are few enough to be processed in one go."""
    size = max(1, CHUNK // (SPANS * ENCLOSING * team.drones))
    return (pieces[first : first + size] for first in range(0, len(pieces), size))


def _on_spans(part: PiecewisePolynomial, pieces: Indices, order: int = 0) -> Array:
    """Return values that enclose a derivative by time: (pieces · SPANS · ENCLOSING, *shape).

    Its coefficients on the spans of pieces, or values at as many places where it has more.
    """
    c = part.coefficients[pieces]
    enclosing = np.moveaxis(c @ _span_rows(bernstein.degree(c), order).T, -1, 1)
    h = part.durations[pieces].reshape(-1, *(1,) * (enclosing.ndim - 1))
    values: Array = (enclosing / h**order).reshape(-1, *part.shape)
    return values


@lru_cache
def _span_rows(degree: int, order: int) -> Array:
    """(SPANS · ENCLOSING, degree + 1): maps coefficients on a piece to those on its spans."""
    c = np.eye(degree + 1)
    for _ in range(order):
        c = bernstein.differentiate(c)
    starts = np.arange(SPANS) / SPANS
    if order == 0 or bernstein.degree(c) >= ENCLOSING:
        places = starts[:, None] + np.linspace(0.0, 1.0 / SPANS, ENCLOSING)
        rows = (c @ bernstein.basis(places.ravel(), bernstein.degree(c)).T).T
    else:
        same = bernstein.elevate(c, ENCLOSING - 1)[:, None]
        rows = bernstein.restrict(same, starts, starts + 1.0 / SPANS).reshape(degree + 1, -1).T
    rows.setflags(write=False)
    return rows
