"""A timed path as piecewise polynomials of time, within its limits and of the wanted duration."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import length
from hitchopt.model.evaluation import drone_jets
from hitchopt.planners.path.jets import chained
from hitchopt.planners.path.shape_path import Path
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.mesh import time_mesh
from hitchopt.planners.timing.speed_profile import SpeedProfile, fastest_profile, path_grid
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.time_warp import Clock, first_clock, jerk_limited
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

GRID = 160
"""Steps of toppra's grid along the path."""

MODEL_ERROR = 1e-6
"""Largest error of a cable's length, relative: ten times better than a plan promises."""

SHORTEST_RAMP = 1e-5
"""Of the duration: polynomials do not resolve ramps of microseconds in flights of a month."""

FINEST = 400
"""Pieces at which refining for the model's sake ends."""


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

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Of shape (2n,) [N]: every leg pulls with its cable's tension."""
        both = np.repeat(self.tensions.coefficients, 2, axis=1)
        return PiecewisePolynomial(self.tensions.breaks, both)

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
    ramp = max(_ramp(profile, demands), SHORTEST_RAMP * profile.duration)
    finer = 1
    while True:
        clock = jerk_limited(
            first_clock(profile, ramp, time_mesh(profile, ramp, finer)), demands_at
        )
        flight = _polynomials(path, clock, profile)
        if flight.drones.pieces >= FINEST or _cable_error(path, flight) <= MODEL_ERROR:
            break
        finer *= 2
    flight = flight.stretched(needed_stretch(path.team, limits, flight))
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


def _probes(breaks: Array, count: int) -> Array:
    """Return ``count`` times inside every piece, and all breaks."""
    inner = (np.arange(count) + 0.5) / count
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * inner
    return np.sort(np.append(times.reshape(-1), breaks))
