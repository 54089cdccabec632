"""A timed path as piecewise polynomials of time, within its limits and of the wanted duration."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Limits
from hitchopt.model.evaluation import drone_jets
from hitchopt.planners.demands import Demands, loads_at_rest
from hitchopt.planners.jets import chained
from hitchopt.planners.mesh import time_mesh
from hitchopt.planners.path import Path
from hitchopt.planners.timing import SpeedProfile, fastest_profile, path_grid
from hitchopt.planners.warp import Clock, first_clock, jerk_limited
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]

GRID = 160
"""Steps of toppra's grid along the path."""

MODEL_ERROR = 1e-6
"""Largest error of a cable's length, relative: ten times better than a plan promises."""

FINEST = 400
"""Pieces at which refining for the model's sake ends."""

FINAL_SHARE = 0.9995
"""Share of the limits that the polynomials' enclosures may use; the certificate, which bounds
them by other means, has the rest to itself."""

SPANS = 8
"""Of a piece, on which its rates are enclosed: within about 0.1 %."""

ENCLOSING = 8
"""Coefficients on a span: those of the drones' septic pieces."""

CHUNK = 60_000
"""Coefficients of drones that are looked at in one go."""


@dataclass(frozen=True, eq=False)
class Flight:
    """What flies along a path.

    Attributes
    ----------
    drones, vertices, legs, tensions: as in a Motion, from t = 0.
    profile: toppra's optimum for the same path, without a jerk limit.
    """

    drones: PiecewisePolynomial
    vertices: PiecewisePolynomial
    legs: PiecewisePolynomial
    tensions: PiecewisePolynomial
    profile: SpeedProfile

    @property
    def duration(self) -> float:
        """From rest to rest [s]."""
        return self.drones.duration

    def stretched(self, factor: float) -> Flight:
        """Return the same flight ``factor`` times as slow."""
        return self._each(lambda part: part.stretched(factor))

    def lasting(self, duration: float) -> Flight:
        """Return the same flight slowed to last exactly ``duration`` [s]."""
        factor = duration / self.duration

        def slowed(part: PiecewisePolynomial) -> PiecewisePolynomial:
            breaks = factor * part.breaks
            breaks[-1] = duration
            return PiecewisePolynomial(breaks, part.coefficients)

        return self._each(slowed)

    def _each(self, change: Callable[[PiecewisePolynomial], PiecewisePolynomial]) -> Flight:
        return Flight(
            change(self.drones),
            change(self.vertices),
            change(self.legs),
            change(self.tensions),
            self.profile,
        )


def fly(path: Path, limits: Limits, duration: float | None = None) -> Flight:
    """Return the flight along a path, from rest to rest.

    Parameters
    ----------
    path: what is flown.
    limits: of which none is broken where the polynomials are sampled.
    duration: exactly that long [s]; None for as fast as the limits allow.

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits allow.
    TimingError, WarpError: no timing was found.
    """

    def demands_at(s: Array) -> Demands:
        flat = path.flat(s)
        return Demands.of(path.team, limits, flat, drone_jets(path.team, flat))

    grid = path_grid(GRID)
    demands = demands_at(grid)
    profile = fastest_profile(grid, demands)
    ramp = _ramp(profile, demands)
    finer = 1
    while True:
        clock = jerk_limited(
            first_clock(profile, ramp, time_mesh(profile, ramp, finer)), demands_at
        )
        flight = _polynomials(path, clock, profile)
        if flight.drones.pieces >= FINEST or _cable_error(path, flight) <= MODEL_ERROR:
            break
        finer *= 2
    flight = flight.stretched(_needed_stretch(path, limits, flight))
    if duration is None:
        return flight
    if duration < flight.duration:
        raise InfeasibleError(
            [
                Violation(
                    "duration",
                    duration,
                    flight.duration,
                    "min",
                    "s",
                    (),
                    "",
                    f"give it {flight.duration:.6g} s or more, or raise the limits of motion",
                )
            ]
        )
    return flight.lasting(duration)


def _ramp(profile: SpeedProfile, demands: Demands) -> float:
    """Return how long the acceleration takes from one limit to the other [s].

    Or as long as matters, where the jerk never lets it come to its limits: for the largest speed
    that is reached, and for the longest way of a drone.
    """
    rates = length(demands.drones[..., 1])
    speed = float(np.max(rates * profile.speed[:, None]))
    steps = np.diff(profile.s)[:, None]
    longest = float(np.max(np.sum(0.5 * (rates[1:] + rates[:-1]) * steps, axis=0)))
    limits = demands.limits
    return min(
        2.0 * limits.acceleration / limits.jerk,
        2.0 * math.sqrt(speed / limits.jerk),
        math.pow(32.0 * longest / limits.jerk, 1.0 / 3.0),
    )


def _polynomials(path: Path, clock: Clock, profile: SpeedProfile) -> Flight:
    """Return polynomials that meet value, velocity, acceleration and jerk at every break."""
    breaks, progress = clock.breaks, clock.jets()
    s = np.clip(progress[:, 0], 0.0, 1.0)
    s[0], s[-1] = 0.0, 1.0
    flat = path.flat(s)
    drones = drone_jets(path.team, flat)
    legs = np.stack([flat.q_legs, drones.r_legs], axis=2)
    legs *= path.team.layout.has_leg[..., None]  # exactly zero, not nearly

    def timed(jets: Array) -> PiecewisePolynomial:
        """Return the polynomials for jets by s (J, *shape, 4)."""
        inner = progress.reshape(len(s), *(1,) * (jets.ndim - 2), 4)
        data = np.moveaxis(chained(jets, inner), -1, 0)
        return PiecewisePolynomial.hermite(breaks, data[:, :-1], data[:, 1:])

    steady = not np.any(flat.tensions[..., 1:]) and np.all(flat.tensions == flat.tensions[0])
    tensions = (
        PiecewisePolynomial.constant(breaks, flat.tensions[0, :, 0])
        if steady
        else timed(flat.tensions)
    )
    return Flight(timed(drones.positions), timed(flat.vertices), timed(legs), tensions, profile)


def _cable_error(path: Path, flight: Flight) -> float:
    """Return the largest relative error of a cable's length at samples between the breaks."""
    t = _probes(flight.drones.breaks, 5)
    p, drones = flight.vertices.at(t), flight.drones.at(t)
    layout = path.team.layout
    legs = np.linalg.norm(drones - p[:, layout.anchors], axis=-1)
    length = legs[:, 0::2] + np.linalg.norm(layout.edges(p), axis=-1) + legs[:, 1::2]
    return float(np.max(np.abs(length / path.team.cable_length - 1.0)))


def _needed_stretch(path: Path, limits: Limits, flight: Flight) -> float:
    """Return how many times slower the flight must be to keep its limits.

    Rates are not sampled but enclosed: a vector polynomial stays within the hull of its
    coefficients, which lie close to it on a short span of time.
    """
    breaks, h = flight.drones.breaks, flight.drones.durations
    inner = np.linspace(0.0, 1.0, SPANS * ENCLOSING)
    size = max(1, CHUNK // (len(inner) * len(path.team.mass)))
    factors = []
    for first in range(0, len(h), size):  # a thousand robots fill the memory
        span = slice(first, first + size)
        at = breaks[:-1][span, None] + h[span, None] * inner
        demands = Demands(
            np.stack([_rates(flight.drones, span, order) for order in range(4)], axis=-1),
            np.max(length(_rates(flight.vertices, span, 1)), axis=1),
            _loads(path, flight, at.ravel()),
            path.team.mass,
            path.team.max_thrust,
            limits,
            FINAL_SHARE,
        )
        factors.append(demands.stretch())
    return max(factors)


def _rates(part: PiecewisePolynomial, pieces: slice, order: int) -> Array:
    """Return the coefficients (pieces · SPANS · ENCLOSING, items, 3) of a derivative by time.

    Of each of the pieces, on each of its SPANS spans in turn.
    """
    c, h = part.coefficients[pieces], part.durations[pieces]
    for _ in range(order):
        c = bernstein.differentiate(c)
    c = c / h[:, None, None, None] ** order
    rates = c @ _spans(bernstein.degree(c)).T
    return np.moveaxis(rates, -1, 1).reshape(-1, *rates.shape[1:-1])


@lru_cache
def _spans(order: int) -> Array:
    """(SPANS · ENCLOSING, order + 1): from coefficients on a piece to those on its spans."""
    same = bernstein.elevate(np.eye(order + 1), ENCLOSING - 1)[:, None]
    starts = np.arange(SPANS) / SPANS
    spans: Array = bernstein.restrict(same, starts, starts + 1.0 / SPANS)
    spans = spans.reshape(order + 1, -1).T
    spans.setflags(write=False)
    return spans


def _loads(path: Path, flight: Flight, t: Array) -> Array:
    """Return the thrust at rest (times, 2n, 3) [N] of what the polynomials say at t."""
    p, drones = flight.vertices.at(t), flight.drones.at(t)
    outward = drones - p[:, path.team.layout.pulled_to]
    directions = outward / length(outward)[..., None]
    forces = -np.repeat(flight.tensions.at(t), 2, axis=1)[..., None] * directions
    forces[..., 2] -= path.team.cable_weight
    return loads_at_rest(path.team, forces)


def _probes(breaks: Array, count: int) -> Array:
    """Return ``count`` times inside every piece, and all breaks."""
    inner = (np.arange(count) + 0.5) / count
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * inner
    return np.sort(np.append(times.reshape(-1), breaks))
