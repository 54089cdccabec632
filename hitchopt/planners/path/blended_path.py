"""One path through several hitches without a stop at those in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Hitch
from hitchopt.planners.path.path_feasibility import check_loads, check_shapes
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, drones_along
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.fly_path import GRID, fly
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

FINE = 2001
"""Number of points by which the lengths of path and flight are compared."""

SLOWEST = 1e-6
"""Share of a path's mean speed by its parameter below which it cannot be timed."""

SAME = 1e-9
"""[m] Hitches in a row that are closer than this are one."""


@dataclass(frozen=True, eq=False)
class BlendedPath:
    """A path and where on it each of its hitches is.

    Attributes
    ----------
    path: through all hitches, smooth up to the snap.
    s: (J,), from 0 to 1.
    """

    path: ShapePath
    s: Array


@dataclass(frozen=True, eq=False)
class BlendedMorph:
    """The planner of a morph through several hitches without a stop.

    Attributes
    ----------
    hitches: three or more, no two neighbours of them the same.
    requirements: limits of motion.
    """

    hitches: Sequence[Hitch]
    requirements: Requirements

    @cached_property
    def problem(self) -> BlendedPath:
        """The path through all hitches; raises InfeasibleError where it cannot be flown."""
        blend = blended(self.hitches)
        check_shapes(blend.path)
        check_turns(blend)
        check_loads(blend.path, self.requirements.limits)
        return blend

    def solve(self) -> Flight:
        """Return the flight along the path; errors as of StraightMorph."""
        return fly(self.problem.path, self.requirements.limits)


def blended(hitches: Sequence[Hitch]) -> BlendedPath:
    """Return the path through three hitches or more, no two neighbours of them the same.

    Vertices, fractions and roll are natural quintic splines: of all curves through the hitches
    those with the least third derivative. Their parameter is nearly the distance of the farthest
    drone.
    """
    places = np.stack([hitch.drones for hitch in hitches])
    steps = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=1)
    s = np.append(0.0, np.cumsum(np.maximum(steps, SAME)))
    s = s / s[-1]
    vertices = _spline(s, np.stack([hitch.vertices for hitch in hitches]))
    fractions = _spline(s, np.stack([hitch.fractions for hitch in hitches]))
    rolls = np.stack([hitch.roll for hitch in hitches])
    path = ShapePath(
        hitches[0].team,
        vertices,
        LegLaw.of_fractions(fractions),
        roll=_spline(s, rolls) if np.any(rolls) else None,
    )
    return BlendedPath(path, s)


def check_turns(blend: BlendedPath) -> None:
    """Raise InfeasibleError where the path turns back on itself at a point of the timing grid."""
    s = np.linspace(0.0, 1.0, GRID + 1)
    drones = drones_along(blend.path, s).positions[..., 1]
    speed = np.max(np.linalg.norm(drones, axis=-1), axis=1)
    slowest = int(np.argmin(speed))
    ratio = float(speed[slowest] / np.mean(speed))
    if ratio < SLOWEST:
        unit, when = "of the mean speed", f"at {s[slowest]:.0%} of the path"
        remedy = "the path turns back on itself there: go by another one"
        raise InfeasibleError([Violation("blend", ratio, SLOWEST, "min", unit, (), when, remedy)])


def passing_times(path: ShapePath, s: Array, flight: Flight) -> Array:
    """Return when (J,) [s] a flight along a path is at the inner points s (J,) of it.

    The distance that vertices and drones have covered together is the same on path and flight.
    From the time that it gives, the time is refined until the flight is abreast of the place.
    """
    t = np.linspace(0.0, flight.duration, FINE)
    fine = np.linspace(0.0, 1.0, FINE)
    gone_by_s = _gone(path.vertices.at(fine), path.legs.share.at(fine))
    gone_by_t = _gone(flight.vertices.at(t), _fractions(flight, t))
    share = np.interp(s, fine, gone_by_s / gone_by_s[-1])
    guesses = np.interp(share, gone_by_t / gone_by_t[-1], t)
    return np.array([_abreast(path, x, flight, g) for x, g in zip(s, guesses, strict=True)])


def _abreast(path: ShapePath, s: float, flight: Flight, guess: float) -> float:
    """Return the time near ``guess`` at which the flight is abreast of the path's point s."""
    at = np.array([s])
    place, ahead = (
        np.append(path.vertices.at(at, order), path.legs.share.at(at, order)) for order in (0, 1)
    )

    def off(t: float) -> float:
        now = np.append(flight.vertices.at([t]), _fractions(flight, np.array([t])))
        return float((now - place) @ ahead)

    reach = flight.duration / 100.0
    low, high = max(0.0, guess - reach), min(flight.duration, guess + reach)
    if off(low) >= 0.0 or off(high) <= 0.0:
        return guess
    return float(brentq(off, low, high, xtol=1e-12))


def _fractions(flight: Flight, t: Array) -> Array:
    legs = flight.legs.at(t)
    fractions: Array = legs[..., 0] / np.sum(legs, axis=-1)
    return fractions


def _gone(vertices: Array, fractions: Array) -> Array:
    """Return (J,): distance covered so far in all coordinates together."""
    rows = np.concatenate([vertices.reshape(len(vertices), -1), fractions], axis=1)
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1)))


def _spline(s: Array, values: Array) -> PiecewisePolynomial:
    """Return the natural quintic spline through ``values`` (J, *shape), J at least 3."""
    none = np.zeros(values.shape[1:])
    free = [(3, none), (4, none)]  # the stubs know of one condition an end, scipy of any
    spline = make_interp_spline(s, values, k=5, bc_type=(free, free))  # type: ignore[arg-type]
    return PiecewisePolynomial.from_spline(spline)
