"""Demands on drones along a path, and its time-optimal speed profile by reachability analysis.

The method is toppra's (Pham and Pham, "A new approach to time-optimal path parameterization based
on reachability analysis", IEEE T-RO 34, 2018). toppra solves it under limits that are given to it
as a polygon of (s̈, ṡ²) at every grid point.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError, InfeasibleError, RequestError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import hanging_forces
from hitchopt.hitch.model import FlatJets, drone_jets
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.path import FlatPath
from hitchopt.values import Array, Indices

T = TypeVar("T")

LIMIT_SHARE = 0.999  # Fraction of the limits at samples, with a reserve for the times between

FINAL_SHARE = 1.0 - 0.5 * (1.0 - LIMIT_SHARE)
"""Share of the limits for the polynomials' enclosures; the rest is for the certificate's bounds."""

CHUNK = 64_000  # Number of rays of drones per chunk, whose temporary arrays fit into a core's cache


class RaySlowness(NamedTuple):
    """Coefficients of inverse factors ``1 / ρ`` of rays (u, x) of s̈ and ṡ², at J points.

    A limit binds where ``a ρ² + 2 b ρ + c = 0``, and c < 0 if rest satisfies it. Without
    cancellation, ``1 / ρ = -b / c + √((b / c)² - a / c)``.
    """

    acceleration: Array  # (J, 2n, 3): coefficients of (u², 2 u x, x²) in the squared inverse factor
    # (2, J, 2n, 3): coefficients of (u², 2 u x, x²) in the radicands of thrust and tilt
    radicands: Array
    slopes: Array  # (2, J, 2n, 2): coefficients of (u, x) in -b / c of thrust and tilt
    infeasible_at_rest: NDArray[np.bool_]  # (J, 2n): whether rest violates a limit

    def of_rays(self, u: Array, x: Array) -> Array:
        """Return the largest inverse factors (J, m) of rays (u, x), (J, m) each."""
        rays = np.stack([u, x], axis=1)
        products = np.stack([u * u, 2.0 * u * x, x * x], axis=1)
        slowest: Array = np.sqrt(np.max(self.acceleration @ products, axis=1))
        with np.errstate(invalid="ignore"):  # nan: the limit does not bound that ray
            for radicand, slope in zip(self.radicands, self.slopes, strict=True):
                inverse_factors = np.sqrt(radicand @ products) + slope @ rays
                slowest = np.fmax(slowest, np.fmax.reduce(inverse_factors, axis=1))
        return slowest


@dataclass(frozen=True, eq=False)
class Demands:
    """Jets along a path and the loads at rest, at J points."""

    # (J, 2n, 3, 4) [m]: positions and derivatives with respect to the path's parameter
    drones: Array
    vertex_speed: Array  # (J,) [m]: largest first derivative of a vertex
    loads: Array
    """(J, 2n, 3) [N]: thrusts at rest, which balance weight and cable force; (J, 0, 3) for drones
    whose limit of acceleration is within those of thrust and tilt."""

    team: Team  # The team, with masses and largest thrusts
    limits: Limits  # Limits of motion
    share: float = LIMIT_SHARE  # Enforced fraction of the limits
    slowness: Array | float = 0.0  # (J,) or a number [s]: smallest 1 / ṡ

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
        return Demands(
            self.drones[points],
            self.vertex_speed[points],
            self.loads[points],
            self.team,
            self.limits,
            self.share,
            np.broadcast_to(self.slowness, len(self.drones))[points],
        )

    @property
    def has_loads(self) -> bool:
        """Whether thrust and tilt are limited as well."""
        return bool(self.loads.shape[1] > 0)

    @property
    def speed_bound(self) -> Array:
        """(J,): largest ṡ² within the speed limits of drones and vertices, and the slowness."""
        fastest_drone = np.max(length(self.drones[..., 1]), axis=1)
        drone_ratio = fastest_drone / self.limits.speed
        vertex_ratio = self.vertex_speed / self.limits.vertex_speed
        largest_ratio = np.maximum(drone_ratio, vertex_ratio)
        within_limits = self.share / np.maximum(largest_ratio, MIN_RATE)
        bound: Array = np.minimum(within_limits, 1.0 / np.maximum(self.slowness, MIN_RATE)) ** 2
        return bound

    def ray_factors(self, u: Array, x: Array) -> Array:
        """Return the factors (J, m) of rays (u, x) of s̈ and ṡ², (J, m) each, within all limits.

        They are 0 if rest violates a limit.
        """
        factors = np.empty(u.shape)
        size = max(1, CHUNK // (self.drones.shape[1] * u.shape[1]))
        for first in range(0, len(u), size):
            chunk = slice(first, first + size)
            slowness = self.at(chunk).ray_slowness
            factors[chunk] = 1.0 / np.maximum(slowness.of_rays(u[chunk], x[chunk]), 1e-150)
            factors[chunk][np.any(slowness.infeasible_at_rest, axis=1)] = 0.0
        return factors

    @property
    def ray_slowness(self) -> RaySlowness:
        """The coefficients of rays' inverse factors ``1 / ρ`` for each limit."""
        velocity = self.drones[..., 1]
        acceleration = self.drones[..., 2]
        squares = np.stack(
            [
                dot(velocity, velocity),
                dot(velocity, acceleration),
                dot(acceleration, acceleration),
            ],
            axis=-1,
        )
        along_load = np.stack([dot(velocity, self.loads), dot(acceleration, self.loads)], axis=-1)
        upward = np.stack([velocity[..., 2], acceleration[..., 2]], axis=-1)
        upward_load = self.loads[..., 2, None]
        upward_squares = _products(upward)
        square_at_rest = dot(self.loads, self.loads)
        # Weight of the squared upward force against the square of the whole one: of the cone of
        # tilt, and none for thrust
        cone = 1.0 + math.tan(self.share * self.limits.tilt) ** 2
        thrust_at_rest = square_at_rest - (self.share * self.team.max_thrust) ** 2
        tilt_at_rest = square_at_rest - cone * self.loads[..., 2] ** 2
        radicands = list[Array]()
        slopes = list[Array]()
        infeasible_at_rest = np.zeros(self.loads.shape[:-1], dtype=np.bool_)
        for at_rest, weight in ((thrust_at_rest, 0.0), (tilt_at_rest, cone)):
            infeasible_at_rest |= at_rest >= 0.0
            inverse = (self.team.mass / np.where(at_rest < 0.0, -at_rest, 1.0))[..., None]
            slope = inverse * (along_load - weight * upward_load * upward)
            form = self.team.mass[:, None] * inverse * (squares - weight * upward_squares)
            slopes.append(slope)
            radicands.append(form + _products(slope))
        return RaySlowness(
            squares / (self.share * self.limits.acceleration) ** 2,
            np.stack(radicands),
            np.stack(slopes),
            infeasible_at_rest,
        )

    def stretches(self) -> Array:
        """Return the stretch in time (2n,) with which each drone keeps its limits, if s is time.

        It may be below 1, and is infinite if forces at rest violate a limit. With a stretch κ
        velocities decrease with κ, accelerations with κ² and jerks with κ³.
        """
        slowness = self.ray_slowness
        # Along the ray of ṡ²
        accelerations = slowness.acceleration[..., 2]
        slopes = slowness.slopes[..., 1]
        radicands = slowness.radicands[..., 2]
        forces = np.where(radicands >= 0.0, slopes + np.sqrt(np.maximum(radicands, 0.0)), 0.0)
        speeds = length(self.drones[..., 1])
        jerks = length(self.drones[..., 3])
        stretches = np.maximum.reduce(
            [
                speeds / self.limits.speed / self.share,
                np.sqrt(np.maximum(np.sqrt(accelerations), np.max(forces, axis=0))),
                np.cbrt(jerks / self.limits.jerk / self.share),
            ]
        )
        largest: Array = np.max(np.where(slowness.infeasible_at_rest, math.inf, stretches), axis=0)
        return largest


def loads_at_rest(team: Team, cable_forces: Array) -> Array:
    """Return the thrust (…, 2n, 3) [N] of drones at rest: ``m g ẑ - cable force``."""
    loads: Array = team.mass[:, None] * np.array([0.0, 0.0, GRAVITY]) - cable_forces
    return loads


def rest_ratios(team: Team, limits: Limits, loads: Array) -> Array:
    """Return (2, J, 2n): thrust and tilt of drones at rest over their limits."""
    tilt = np.arctan2(np.hypot(loads[..., 0], loads[..., 1]), loads[..., 2])
    return np.stack([length(loads) / team.max_thrust, tilt / limits.tilt])


def hover_violation(
    team: Team, limits: Limits, loads: Array, when: Sequence[str], remedies: tuple[str, str]
) -> Violation | None:
    """Return the violation of a limit of thrust or tilt that hovering uses up; None without one.

    Parameters
    ----------
    loads: (J, 2n, 3) [N], thrusts at rest.
    when: J descriptions of positions on the flight.
    remedies: for thrust and tilt.
    """
    thrust_ratios, tilt_ratios = rest_ratios(team, limits, loads)
    tilts = np.full(team.drones, np.degrees(limits.tilt))
    kinds = (
        ("thrust", "N", team.max_thrust, thrust_ratios, remedies[0]),
        ("tilt", "deg", tilts, tilt_ratios, remedies[1]),
    )
    for check, unit, limits_of_drones, ratios, remedy in kinds:
        sample, drone = divmod(int(np.argmax(ratios)), team.drones)
        ratio = float(ratios[sample, drone])
        if ratio >= LIMIT_SHARE:
            limit = float(limits_of_drones[drone])
            reserved = f"{when[sample]}, {1.0 - LIMIT_SHARE:.1%} of it reserved for motion"
            return Violation(
                check,
                ratio * limit,
                LIMIT_SHARE * limit,
                "max",
                unit,
                (team.drone_names[drone],),
                reserved,
                remedy,
            )
    return None


def spare_accelerations(team: Team, limits: Limits, loads: Array) -> Array:
    """Return the accelerations (J, 2n) [m/s²] in any direction within thrust and tilt limits."""
    spare_thrust, spare_tilt = LIMIT_SHARE - rest_ratios(team, limits, loads)
    lateral = length(loads) * np.sin(limits.tilt * spare_tilt)
    spare: Array = np.minimum(team.max_thrust * spare_thrust, lateral) / team.mass
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
        span_ratios = length(drones[:, 1::2] - drones[:, 0::2]) / team.cable_length
        worst = float(np.max(span_ratios))
        if worst >= 1.0:
            cable = int(np.argmax(np.max(span_ratios, axis=0)))
            where = (team.cable_names[cable],)
            when = "between its drones' positions"
            remedy = "use a longer cable"
            raise InfeasibleError([Violation("span", worst, 1.0, "max", "1", where, when, remedy)])
    loads = loads_at_rest(team, hanging_forces(team, drones))
    remedy = "use lighter cables, or stronger drones that may tilt more"
    hovering = ["hovering with a hanging cable"] * len(drones)
    violation = hover_violation(team, limits, loads, hovering, (remedy, remedy))
    if violation is not None:
        raise InfeasibleError([violation])
    spare = spare_accelerations(team, limits, loads)
    usable: Array = np.minimum(np.min(spare, axis=0), LIMIT_SHARE * limits.acceleration)
    return usable


def _products(pair: Array) -> Array:
    """Return the products (…, 3) of pairs (…, 2): first², first · second, second²."""
    return pair[..., [0, 0, 1]] * pair[..., [0, 1, 1]]


MIN_RATE = 1e-12  # Smallest rate by which limits of speed and acceleration are divided
MIN_PATH_LENGTH = 1e-2  # Smallest length of a path in toppra's units
MAX_PATH_LENGTH = 1e9  # Largest length of a path in toppra's units

RAYS = 64
"""Number of directions in the half plane of (s̈, ṡ² ≥ 0); chords cut off 0.03 % of a circle."""


class TimingError(HitchoptError):
    """No timing of the path from rest to rest satisfies the limits."""


def if_timed(query: Callable[[], T]) -> T | None:
    """Return what a query answers, or None if a path has no timing."""
    try:
        return query()
    except TimingError:
        return None


WHOLE = (0.0, 1.0)  # Ends of the only part of a path
MIN_PART_STEPS = 12  # Smallest number of steps of a grid on one of several parts


def path_grid(steps: int, ends: Sequence[float] = WHOLE) -> Array:
    """Return a grid (J,) from 0 to 1, of ``steps`` in all, finer at the ``ends`` of all parts.

    Speeds are low at the ends of the path, and change at those of its parts.
    """
    parts = list[Array]()
    for start, end in pairwise(ends):
        count = max(MIN_PART_STEPS, math.ceil(steps * (end - start)))
        finer_at_ends = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / count)
        parts.append(start + (end - start) * finer_at_ends)
    return np.append(np.concatenate(parts), ends[-1])


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """The fastest motion along a path without a jerk limit."""

    s: Array  # (J,): the grid from 0 to 1
    speed: Array  # (J,) [1/s]: ṡ on the grid; s̈ is constant between

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
        bounds = np.stack([t, t - width])
        inner = bounds.clip(0.0, self.duration)
        # The integrals of s up to the grid points, and from these to the bounds
        steps = self.times[1:] - self.times[:-1]
        start = self.s[:-1]
        half_speed = self.speed[:-1] / 2.0
        sixth_of_rate = self._rates / 6.0
        of_steps = steps * (start + steps * (half_speed + steps * sixth_of_rate))
        k = self._steps(inner)
        dt = inner - self.times[k]
        up_to_grid = (of_steps.cumsum() - of_steps)[k]
        from_grid = dt * (start[k] + dt * (half_speed[k] + dt * sixth_of_rate[k]))
        after_end = (bounds - inner).clip(0.0)
        upper, lower = up_to_grid + from_grid + after_end
        mean: Array = (upper - lower) / width
        return mean


class FeasiblePolygons(NamedTuple):
    """Inner approximations of the feasible (s̈, ṡ²) at J points of a path."""

    corners: Array  # (2, J, RAYS + 1): from the largest s̈ at ṡ = 0 to the smallest
    acceleration: Array  # (J,) [1/s²]: magnitude of s̈
    squared_speed: Array  # (J,) [1/s²]: magnitude of ṡ²

    def at(self, points: slice) -> FeasiblePolygons:
        """Return the polygons at some of the points."""
        return FeasiblePolygons(
            self.corners[:, points], self.acceleration[points], self.squared_speed[points]
        )


def fastest_profile(
    s: Array, demands: Demands, polygons: FeasiblePolygons | None = None
) -> SpeedProfile:
    """Return the time-optimal profile from rest to rest on the grid s (J,), from 0 to 1.

    ``polygons`` are the ``feasible_polygons``, if they are known.

    Raises
    ------
    TimingError: none exists, for instance because rest violates a limit.
    """
    try:
        from hitchopt.planners.timing.reachability import fastest_speeds
    except ValueError as error:
        if backend := os.environ.get("MPLBACKEND"):  # toppra imports matplotlib, which refuses it
            remedy = f"unset this environment variable, or set it to Agg ({str(error)[:200]})"
            raise RequestError("MPLBACKEND", backend, "installed here", remedy) from error
        raise

    if polygons is None:
        polygons = feasible_polygons(demands)
    corners, acceleration, squared_speed = polygons
    # toppra's tolerances are absolute. A length of the path and a unit of time scale both s̈ and ṡ²
    # to order 1, whether limited by acceleration or by speed.
    ratio = float(np.median(acceleration / squared_speed))
    path_length = float(np.clip(ratio, MIN_PATH_LENGTH, MAX_PATH_LENGTH))
    unit = float(np.median(squared_speed)) * path_length
    if not math.isfinite(path_length * unit):
        raise TimingError("clasps have no balance on this path")
    scaled = np.stack([corners[0] / unit, corners[1] * path_length / unit])
    speeds = fastest_speeds(s * path_length, scaled)
    if speeds is None:
        raise TimingError("toppra found no speed profile from rest to rest on this path")
    return SpeedProfile(s, speeds * np.sqrt(unit / path_length))


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


def feasible_polygons(demands: Demands) -> FeasiblePolygons:
    """Return an inner approximation of the feasible (s̈, ṡ²).

    The feasible set of all drones is convex. Its polygon has corners on rays from rest; their
    number does not depend on n.
    """
    squared_speed = demands.speed_bound
    rates = np.maximum(length(demands.drones[..., 1]), MIN_RATE)
    acceleration = np.min(demands.limits.acceleration / rates, axis=1)
    angles = np.pi * np.arange(RAYS + 1) / RAYS
    u = acceleration[:, None] * np.cos(angles)
    x = squared_speed[:, None] * np.sin(angles)
    x[:, [0, -1]] = 0.0
    moves = x > 0.0
    of_speed = np.where(moves, squared_speed[:, None] / np.where(moves, x, 1.0), np.inf)
    factors = np.minimum(demands.ray_factors(u, x), of_speed)
    corners = np.stack([factors * u, factors * x])
    return FeasiblePolygons(corners, acceleration, squared_speed)


ESTIMATE_GRID = 80
"""Number of steps of the grid along the path, below which comparisons of paths are unreliable."""

RAMP_SHARE = 0.5
"""Smallest increase of the duration by a jerk limit, over the acceleration's ramp, as in a change
from rest to full speed."""


@lru_cache(maxsize=3)
def demands_along(
    path: FlatPath, limits: Limits, steps: int = ESTIMATE_GRID, ends: tuple[float, ...] = WHOLE
) -> Demands:
    """Return the demands of a path on a grid, cached for the last paths."""
    return Demands.along(path, limits, path_grid(steps, ends))


@lru_cache(maxsize=16)
def flight_estimate(path: FlatPath, limits: Limits) -> float:
    """Return an estimate of the duration [s] of a flight along a path; infinite if there is none.

    Most flights are longer, by up to a tenth of the ramp.
    """
    return _estimates(demands_along(path, limits))[0]


def flight_estimates(paths: Sequence[FlatPath], limits: Limits) -> list[float]:
    """Return the ``flight_estimate`` of each of several paths of one team, evaluated together."""
    flat = FlatJets.concatenated([path.flat(path_grid(ESTIMATE_GRID)) for path in paths])
    return _estimates(Demands.of(paths[0].team, flat, limits))


def _estimates(demands: Demands) -> list[float]:
    """Return the estimates of paths whose demands on the grid follow each other."""
    s = path_grid(ESTIMATE_GRID)
    polygons = feasible_polygons(demands)
    estimates = list[float]()
    for first in range(0, len(demands.loads), len(s)):
        points = slice(first, first + len(s))
        of_path = demands.at(points)
        profile = if_timed(partial(fastest_profile, s, of_path, polygons.at(points)))
        if profile is None:
            estimates.append(math.inf)
        else:
            estimates.append(profile.duration + RAMP_SHARE * acceleration_ramp(profile, of_path))
    return estimates
