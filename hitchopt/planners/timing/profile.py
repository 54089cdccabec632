"""Demands on drones along a path, and its time-optimal speed profile by reachability analysis.

The method is toppra's (Pham and Pham, "A new approach to time-optimal path parameterization based
on reachability analysis", IEEE T-RO 34, 2018). toppra solves it under limits that are given to it
as a polygon of (s̈, ṡ²) at every grid point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError, InfeasibleError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import hanging_forces
from hitchopt.hitch.model import FlatJets, drone_jets
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.morph.path import FlatPath
from hitchopt.values import Array, Indices

LIMIT_SHARE = 0.999
"""Fraction of the limits at samples, with a reserve for the times between."""

FINAL_SHARE = 1.0 - 0.5 * (1.0 - LIMIT_SHARE)
"""Share of the limits for the polynomials' enclosures; the rest is for the certificate's bounds."""

CHUNK = 64_000
"""Number of rays of drones per chunk, whose temporary arrays fit into a core's cache."""


@dataclass(frozen=True, eq=False)
class Demands:
    """Jets along a path and the loads at rest, at J points."""

    drones: Array
    """(J, 2n, 3, 4) [m]: positions and derivatives by the path's parameter."""

    vertex_speed: Array
    """(J,) [m]: largest first derivative of a vertex."""

    loads: Array
    """(J, 2n, 3) [N]: thrusts at rest, which balance weight and cable force."""

    team: Team
    """The team, with masses and largest thrusts."""

    limits: Limits
    """Limits of motion."""

    share: float = LIMIT_SHARE
    """Enforced fraction of the limits."""

    @classmethod
    def along(cls, path: FlatPath, limits: Limits, s: Array) -> Demands:
        """Return the demands of a path at its points s (J,)."""
        return cls.of(path.team, path.flat(s), limits)

    @classmethod
    def of(cls, team: Team, flat: FlatJets, limits: Limits) -> Demands:
        """Return the demands of flat outputs at J points."""
        drones = drone_jets(team, flat)
        vertex_speed = length(flat.vertices[..., 1]).max(axis=1)
        loads = loads_at_rest(team, drones.cable_forces)
        return cls(drones.positions, vertex_speed, loads, team, limits)

    def at(self, points: slice) -> Demands:
        """Return the demands at some of the points."""
        parts = self.drones[points], self.vertex_speed[points], self.loads[points]
        return Demands(*parts, self.team, self.limits, self.share)

    @property
    def speed_bound(self) -> Array:
        """(J,): largest ṡ² within the speed limits of drones and vertices."""
        fastest = np.max(length(self.drones[..., 1]), axis=1)
        own = np.maximum(fastest / self.limits.speed, self.vertex_speed / self.limits.vertex_speed)
        bound: Array = (self.share / np.maximum(own, 1e-12)) ** 2
        return bound

    def ray_factors(self, u: Array, x: Array) -> Array:
        """Return the factors (J, m) of rays (u, x) of s̈ and ṡ², (J, m) each, within all limits.

        They are 0 if rest violates a limit.
        """
        linear, quadratic = np.stack([u, x], axis=1), np.stack([u * u, 2.0 * u * x, x * x], axis=1)
        factors, size = np.empty(u.shape), max(1, CHUNK // (self.drones.shape[1] * u.shape[1]))
        for first in range(0, len(u), size):
            at = slice(first, first + size)
            forms, slopes, infeasible_at_rest = self._slowness(at)
            slowest = np.sqrt(np.max(forms[0] @ quadratic[at], axis=1))
            with np.errstate(invalid="ignore"):  # nan: the limit does not bound that ray
                for form, slope in zip(forms[1:], slopes, strict=True):
                    root = np.sqrt(form @ quadratic[at]) + slope @ linear[at]
                    slowest = np.fmax(slowest, np.fmax.reduce(root, axis=1))
            factors[at] = 1.0 / np.maximum(slowest, 1e-150)
            factors[at][np.any(infeasible_at_rest, axis=1)] = 0.0
        return factors

    def _slowness(self, at: slice) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return coefficients of rays' inverse factors ``1 / ρ`` for each limit, at some points.

        A limit binds where ``a ρ² + 2 b ρ + c = 0``, and c < 0 if rest satisfies it. Without
        cancellation, ``1 / ρ = -b / c + √((b / c)² - a / c)``.

        Returns
        -------
        forms: (3, J, 2n, 3), coefficients of (u², 2 u x, x²), for the squared inverse factor of the
            acceleration limit, and for the radicands of thrust and tilt.
        slopes: (2, J, 2n, 2), coefficients of (u, x) for -b / c of thrust and tilt.
        infeasible_at_rest: (J, 2n), whether rest violates a limit.
        """
        first, second, loads = self.drones[at, ..., 1], self.drones[at, ..., 2], self.loads[at]
        squares = np.stack([dot(first, first), dot(first, second), dot(second, second)], axis=-1)
        along_load = np.stack([dot(first, loads), dot(second, loads)], axis=-1)
        upward = np.stack([first[..., 2], second[..., 2]], axis=-1)
        upward_load, upward_squares = loads[..., 2, None], _products(upward)
        square_at_rest = dot(loads, loads)
        # Weight of the squared upward force against the square of the whole one: of the cone of
        # tilt, and none for thrust
        cone = 1.0 + math.tan(self.share * self.limits.tilt) ** 2
        thrust_at_rest = square_at_rest - (self.share * self.team.max_thrust) ** 2
        tilt_at_rest = square_at_rest - cone * loads[..., 2] ** 2
        forms = [squares / (self.share * self.limits.acceleration) ** 2]
        slopes = list[Array]()
        infeasible_at_rest = np.zeros(loads.shape[:-1], dtype=np.bool_)
        for at_rest, weight in ((thrust_at_rest, 0.0), (tilt_at_rest, cone)):
            infeasible_at_rest |= at_rest >= 0.0
            inverse = (self.team.mass / np.where(at_rest < 0.0, -at_rest, 1.0))[..., None]
            slopes.append(inverse * (along_load - weight * upward_load * upward))
            form = self.team.mass[:, None] * inverse * (squares - weight * upward_squares)
            forms.append(form + _products(slopes[-1]))
        return np.stack(forms), np.stack(slopes), infeasible_at_rest

    def stretches(self) -> Array:
        """Return the stretch in time (2n,) with which each drone keeps its limits, if s is time.

        It may be below 1, and is infinite if forces at rest violate a limit. With a stretch κ
        velocities decrease with κ, accelerations with κ² and jerks with κ³.
        """
        forms, slopes, infeasible_at_rest = self._slowness(slice(None))
        squares, slope = forms[..., 2], slopes[..., 1]  # along the ray of ṡ²
        forces = np.where(squares[1:] >= 0.0, slope + np.sqrt(np.maximum(squares[1:], 0.0)), 0.0)
        speeds, jerks = length(self.drones[..., 1]), length(self.drones[..., 3])
        stretches = np.maximum.reduce(
            [
                speeds / self.limits.speed / self.share,
                np.sqrt(np.maximum(np.sqrt(squares[0]), np.max(forces, axis=0))),
                np.cbrt(jerks / self.limits.jerk / self.share),
            ]
        )
        largest: Array = np.max(np.where(infeasible_at_rest, math.inf, stretches), axis=0)
        return largest


def loads_at_rest(team: Team, cable_forces: Array) -> Array:
    """Return the thrust (…, 2n, 3) [N] of drones at rest: ``m g ẑ - cable force``."""
    loads: Array = team.mass[:, None] * np.array([0.0, 0.0, GRAVITY]) - cable_forces
    return loads


def rest_ratios(team: Team, limits: Limits, loads: Array) -> Array:
    """Return (2, J, 2n): thrust and tilt of drones at rest over their limits."""
    tilt = np.arctan2(np.hypot(loads[..., 0], loads[..., 1]), loads[..., 2])
    return np.stack([length(loads) / team.max_thrust, tilt / limits.tilt])


def check_hover(
    team: Team, limits: Limits, loads: Array, when: Sequence[str], remedies: tuple[str, str]
) -> None:
    """Raise InfeasibleError if hovering uses up a limit of thrust or tilt.

    Parameters
    ----------
    loads: (J, 2n, 3) [N], thrusts at rest.
    when: J descriptions of positions on the flight.
    remedies: for thrust and tilt.
    """
    kinds = ("thrust", "N", team.max_thrust), ("tilt", "deg", np.degrees([limits.tilt]))
    both = rest_ratios(team, limits, loads)
    for (name, unit, each), ratios, remedy in zip(kinds, both, remedies, strict=True):
        j, i = divmod(int(np.argmax(ratios)), team.drones)
        if ratios[j, i] >= LIMIT_SHARE:
            limit, where = float(np.broadcast_to(each, team.drones)[i]), (team.drone_names[i],)
            value, limit = float(ratios[j, i]) * limit, LIMIT_SHARE * limit
            words = f"{when[j]}, {1.0 - LIMIT_SHARE:.1%} of it being reserved to move by"
            violation = Violation(name, value, limit, "max", unit, where, words, remedy)
            raise InfeasibleError([violation])


def spare_accelerations(team: Team, limits: Limits, loads: Array) -> Array:
    """Return the accelerations (J, 2n) [m/s²] in any direction within thrust and tilt limits."""
    thrust, tilt = LIMIT_SHARE - rest_ratios(team, limits, loads)
    lateral = length(loads) * np.sin(limits.tilt * tilt)
    spare: Array = np.minimum(team.max_thrust * thrust, lateral) / team.mass
    return spare


def usable_accelerations(team: Team, limits: Limits, drones: Array) -> Array:
    """Return the usable acceleration of every drone (2n,) [m/s²] in any direction.

    Parameters
    ----------
    drones: (J, 2n, 3) [m], positions along the flight.

    Raises
    ------
    InfeasibleError: hovering exceeds the limits of thrust or tilt, or a heavy cable is too short
        for its drones' positions.
    """
    if team.cable_density > 0.0:  # the pull of a cable that is too short is unbounded
        spans = length(drones[:, 1::2] - drones[:, 0::2]) / team.cable_length
        cable, worst = int(np.argmax(np.max(spans, axis=0))), float(np.max(spans))
        if worst >= 1.0:
            where, when = (team.cable_names[cable],), "between its drones' places"
            remedy = "use a longer cable, a smaller polygon, or place the drones closer together"
            raise InfeasibleError([Violation("span", worst, 1.0, "max", "1", where, when, remedy)])
    loads = loads_at_rest(team, hanging_forces(team, drones))
    remedy = "use lighter cables, or stronger drones that may tilt more"
    check_hover(team, limits, loads, ["hovering with a hanging cable"] * len(drones), (remedy,) * 2)
    spare = spare_accelerations(team, limits, loads)
    usable: Array = np.minimum(np.min(spare, axis=0), LIMIT_SHARE * limits.acceleration)
    return usable


def _products(pair: Array) -> Array:
    """Return the products (…, 3) of pairs (…, 2): first², first · second, second²."""
    return pair[..., [0, 0, 1]] * pair[..., [0, 1, 1]]


RAYS = 64
"""Number of directions in the half plane of (s̈, ṡ² ≥ 0); chords cut off 0.03 % of a circle."""


class TimingError(HitchoptError):
    """No timing of the path from rest to rest satisfies the limits."""


def path_grid(steps: int) -> Array:
    """Return a grid (steps + 1,) from 0 to 1, finer at the ends, where speeds are low."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(steps + 1) / steps)


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """The fastest motion along a path without a jerk limit."""

    s: Array
    """(J,): the grid from 0 to 1."""

    speed: Array
    """(J,) [1/s]: ṡ on the grid; s̈ is constant between."""

    @cached_property
    def times(self) -> Array:
        """(J,) [s]: times of the grid points."""
        steps = 2.0 * (self.s[1:] - self.s[:-1]) / (self.speed[1:] + self.speed[:-1])
        return np.concatenate([[0.0], steps.cumsum()])

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return float(self.times[-1])

    @cached_property
    def _rates(self) -> Array:
        """(J - 1,) [1/s²]: s̈ on each step."""
        rates: Array = (self.speed[1:] - self.speed[:-1]) / (self.times[1:] - self.times[:-1])
        return rates

    def _steps(self, t: Array) -> Indices:
        """Return the steps at t (…) [s], the first or the last one outside."""
        return self.times[1:-1].searchsorted(t, side="right")

    def acceleration(self, t: Array) -> Array:
        """Return s̈ at t (…) [s], zero before and after [1/s²]."""
        inside = (t >= 0.0) & (t <= self.duration)
        return np.where(inside, self._rates[self._steps(t)], 0.0)

    def mean(self, t: Array, width: float) -> Array:
        """Return the mean of s over the ``width`` [s] before t (…); s is 0 before and 1 after."""
        x = np.stack([t, t - width])
        inner = x.clip(0.0, self.duration)
        # The integrals of s up to the grid points, and from these to x.
        steps, rates = self.times[1:] - self.times[:-1], self._rates
        parts = self.s[:-1], self.speed[:-1] / 2.0, rates / 6.0
        whole = steps * (parts[0] + steps * (parts[1] + steps * parts[2]))
        k = self._steps(inner)
        dt, (s, half, sixth) = inner - self.times[k], (part[k] for part in parts)
        before = (whole.cumsum() - whole)[k]
        upper, lower = before + dt * (s + dt * (half + dt * sixth)) + (x - inner).clip(0.0)
        mean: Array = (upper - lower) / width
        return mean


def fastest_profile(
    s: Array, demands: Demands, polygons: tuple[Array, Array, Array] | None = None
) -> SpeedProfile:
    """Return the time-optimal profile from rest to rest on the grid s (J,), from 0 to 1.

    ``polygons`` are the ``feasible_polygons``, if they are known.

    Raises
    ------
    TimingError: none exists, for instance because rest violates a limit.
    """
    from hitchopt.planners.timing.reachability import fastest_speeds

    corners, acceleration, squared_speed = polygons or feasible_polygons(demands)
    # toppra's tolerances are absolute. A length of the path and a unit of time scale both s̈ and ṡ²
    # to order 1, whether limited by acceleration or by speed.
    length = float(np.clip(np.median(acceleration / squared_speed), 1e-2, 1e9))
    unit = float(np.median(squared_speed)) * length
    if not math.isfinite(length * unit):
        raise TimingError("clasps have no balance on this path")
    scaled = np.stack([corners[0] / unit, corners[1] * length / unit])
    speeds = fastest_speeds(s * length, scaled)
    if speeds is None:
        raise TimingError("toppra found no speed profile from rest to rest on this path")
    return SpeedProfile(s, speeds * np.sqrt(unit / length))


def acceleration_ramp(profile: SpeedProfile, demands: Demands) -> float:
    """Return the time [s] in which the acceleration changes from one limit to the other.

    It is less if the jerk limit keeps the acceleration from its limits: at the largest speed of the
    profile, or on the longest path of a drone.
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


def feasible_polygons(demands: Demands) -> tuple[Array, Array, Array]:
    """Return an inner approximation of the feasible (s̈, ṡ²).

    The feasible set of all drones is convex. Its polygon has corners on rays from rest; their
    number does not depend on n.

    Returns
    -------
    corners: (2, J, RAYS + 1), from the largest s̈ at ṡ = 0 to the smallest.
    acceleration, squared_speed: (J,) [1/s²], magnitudes of s̈ and of ṡ².
    """
    squared_speed = demands.speed_bound
    rates = np.maximum(length(demands.drones[..., 1]), 1e-12)
    acceleration = np.min(demands.limits.acceleration / rates, axis=1)
    angles = np.pi * np.arange(RAYS + 1) / RAYS
    u, x = acceleration[:, None] * np.cos(angles), squared_speed[:, None] * np.sin(angles)
    x[:, [0, -1]] = 0.0
    factors, positive = demands.ray_factors(u, x), np.where(x > 0.0, x, 1.0)
    factors = np.minimum(factors, np.where(x > 0.0, squared_speed[:, None] / positive, np.inf))
    return np.stack([factors * u, factors * x]), acceleration, squared_speed


GRID = 80
"""Number of steps of the grid along the path, below which comparisons of paths are unreliable."""

RAMP_SHARE = 0.5
"""Smallest increase of the duration by a jerk limit, over the acceleration's ramp, as in a change
from rest to full speed."""


@lru_cache(maxsize=3)
def demands_along(path: FlatPath, limits: Limits, steps: int = GRID) -> Demands:
    """Return the demands of a path on a grid, cached for the last paths."""
    return Demands.along(path, limits, path_grid(steps))


@lru_cache(maxsize=16)
def flight_estimate(path: FlatPath, limits: Limits) -> float:
    """Return an estimate of the duration [s] of a flight along a path; infinite if there is none.

    Most flights are longer, by up to a tenth of the ramp.
    """
    return _estimates(demands_along(path, limits))[0]


def flight_estimates(paths: Sequence[FlatPath], limits: Limits) -> list[float]:
    """Return the ``flight_estimate`` of each of several paths of one team, evaluated together."""
    flat = FlatJets.concatenated([path.flat(path_grid(GRID)) for path in paths])
    return _estimates(Demands.of(paths[0].team, flat, limits))


def _estimates(demands: Demands) -> list[float]:
    """Return the estimates of paths whose demands on the grid follow each other."""
    s, estimates = path_grid(GRID), list[float]()
    corners, *sizes = feasible_polygons(demands)
    for first in range(0, len(demands.loads), len(s)):
        points = slice(first, first + len(s))
        own = demands.at(points)
        try:
            polygons = corners[:, points], sizes[0][points], sizes[1][points]
            profile = fastest_profile(s, own, polygons)
        except TimingError:
            estimates.append(math.inf)
            continue
        estimates.append(profile.duration + RAMP_SHARE * acceleration_ramp(profile, own))
    return estimates
