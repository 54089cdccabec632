"""Flights along paths: piecewise polynomials of time, within all limits of motion."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from hitchopt.hitch.cable_spans import cable_of, sag_factors
from hitchopt.planners.path.jets import chained, polynomials_through
from hitchopt.planners.path.shape_path import Path, path_jets
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.flight_curves import Flight, check_duration
from hitchopt.planners.timing.speed_profile import (
    SpeedProfile,
    acceleration_ramp,
    fastest_profile,
    path_grid,
)
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.time_warp import Clock, first_clock, jerk_limited
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

GRID = 160
"""Number of steps of toppra's grid along the path."""

MODEL_ERROR = 1e-6
"""Largest relative error of a cable's length: a tenth of what a plan guarantees."""

PAIRS = 32_000
"""Pairs of a time and a drone at which cables are looked at in one go: arrays fit in the caches."""

FINEST = 400
"""Number of pieces at which refining for the sake of MODEL_ERROR ends."""

SHORTEST_RAMP = 1e-5
"""Shortest ramp of the acceleration, as a share of the duration: polynomials do not resolve ramps
of microseconds in flights of a month."""

SHORTEST_FLIGHT = 0.05
"""[s] Shortest duration chosen: a move of micrometres would be over before its polynomials are
above their rounding."""

GENTLER = 1.005
"""Stretch for the sake of the body rate above which a flight with less jerk is tried as well."""


@lru_cache(maxsize=1)
def timing_demands(path: Path, limits: Limits) -> Demands:
    """Return the demands of a path on toppra's grid; those of the last path are stored."""
    return Demands.along(path, limits, path_grid(GRID))


def fly(path: Path, limits: Limits, duration: float | None = None) -> Flight:
    """Return the flight along a path, from rest to rest.

    Parameters
    ----------
    path: what is flown.
    limits: of which none is broken where the polynomials are sampled.
    duration: exact duration [s]; None for as fast as the limits allow, SHORTEST_FLIGHT at least.

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits allow.
    TimingError, WarpError: no timing was found.
    """
    flight, fastest = _timed(path, limits)
    slower = fastest / flight.duration
    if limits.body_rate is not None and GENTLER < slower < math.inf:
        # Thrusts turn with the jerk: with less of it, speed and acceleration need not suffer.
        gentle = replace(limits, jerk=limits.jerk / slower**3)
        flight, fastest = min(
            (flight, fastest), _timed(path, gentle, limits), key=lambda timed: timed[1]
        )
    if duration is None:
        return flight.lasting(max(fastest, SHORTEST_FLIGHT))
    check_duration(duration, fastest)
    return flight.lasting(duration)


def _timed(path: Path, aimed: Limits, limits: Limits | None = None) -> tuple[Flight, float]:
    """Return a flight timed for the limits ``aimed`` at, and in what time it keeps ``limits`` [s].

    Parameters
    ----------
    limits: those to be kept; None for the same ones.
    """
    grid = path_grid(GRID)
    demands = timing_demands(path, aimed)
    profile = fastest_profile(grid, demands)
    ramp = max(acceleration_ramp(profile, demands), SHORTEST_RAMP * profile.duration)
    finer = 1
    while True:
        clock = first_clock(profile, ramp, time_mesh(profile, ramp, finer))
        flight = _polynomials(path, jerk_limited(clock, lambda s: Demands.along(path, aimed, s)))
        if flight.drones.pieces >= FINEST or _cable_error(path, flight) <= MODEL_ERROR:
            break
        finer *= 2
    kept = limits or aimed
    slower = needed_stretch(path.team, kept, flight.drones, flight.vertices, flight.pulls)
    return flight, slower * flight.duration


def _polynomials(path: Path, clock: Clock) -> Flight:
    """Return polynomials that meet value, velocity, acceleration and jerk at every break."""
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
    return Flight(drones, vertices, legs, constant if steady else timed(tensions))


def _cable_error(path: Path, flight: Flight) -> float:
    """Return the largest relative error of a cable's length at samples between the breaks."""
    inner = (np.arange(5) + 0.5) / 5
    breaks = flight.drones.breaks
    t = np.append(breaks[:-1, None] + np.diff(breaks)[:, None] * inner, breaks)
    many = max(1, PAIRS // path.team.drones)
    return max(_error_at(path, flight, t[first : first + many]) for first in range(0, len(t), many))


def _error_at(path: Path, flight: Flight, t: Array) -> float:
    """Return the largest relative error of a cable's length at times t (m,)."""
    p, drones = flight.vertices.at(t), flight.drones.at(t)
    team, layout = path.team, path.team.layout
    legs = drones - p[:, layout.anchors]
    if team.cable_density == 0.0:
        lengths = np.linalg.norm(legs, axis=-1)
        cables = lengths[:, 0::2] + np.linalg.norm(layout.edges(p), axis=-1) + lengths[:, 1::2]
    else:
        factors = sag_factors(team, flight.tensions.at(t))
        cables = np.sum(
            [cable_of(x, factors) for x in (legs[:, 0::2], layout.edges(p), legs[:, 1::2])], axis=0
        )
    return float(np.max(np.abs(cables / team.cable_length - 1.0)))


WIDEST = 1.0 / 12.0
"""Longest piece, as a share of the whole time."""

PER_RAMP = 6.0
"""Number of pieces in a change of the acceleration from one limit to the other."""

SHORTEST = 5e-3
"""[s] Shortest piece: shorter ones lose more digits in third derivatives than they gain speed."""

MOST = 200
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
    widths = np.maximum(_graded(t, widths), SHORTEST)
    density = 0.5 * (1.0 / widths[1:] + 1.0 / widths[:-1]) * np.diff(t)
    pieces = np.append(0.0, np.cumsum(density))
    count = finer * max(int(np.ceil(min(pieces[-1], MOST))), 4)
    knots: Array = np.interp(np.linspace(0.0, pieces[-1], count + 1), pieces, t)
    knots[0], knots[-1] = 0.0, whole
    return knots


def _graded(t: Array, widths: Array) -> Array:
    """Return the widths lowered until none exceeds another by more than GRADING of its distance."""
    # min over u of w(u) + g |t - u|, from the left and from the right.
    left = np.minimum.accumulate(widths - GRADING * t) + GRADING * t
    right = np.minimum.accumulate((widths + GRADING * t)[::-1])[::-1] - GRADING * t
    return np.minimum(left, right)
