"""Demands of motion along a path on drones, and its time-optimal speed by toppra's analysis.

The passes are toppra's (Pham and Pham, "A new approach to time-optimal path parameterization based
on reachability analysis", IEEE T-RO 34, 2018), and so is the solver of the small linear programs;
its classes take three times as long to set these up as to solve them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly
from toppra.solverwrapper.cy_seidel_solverwrapper import solve_lp2d

from hitchopt.errors import HitchoptError, InfeasibleError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import hanging_forces
from hitchopt.hitch.model import drone_jets
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.morph.path import Path
from hitchopt.values import Array

LIMIT_SHARE = 0.999
"""Share of the limits in use at samples; the rest is for the time between them."""

FINAL_SHARE = 1.0 - 0.5 * (1.0 - LIMIT_SHARE)
"""Share of the limits that the polynomials' enclosures may use: half of the rest remains to the
certificate, which bounds them by other means."""

CHUNK = 64_000
"""Number of rays of drones that are cast at a time: temporary arrays fit in a core's cache, and are
small enough for memory that is used again."""


@dataclass(frozen=True, eq=False)
class Demands:
    """Jets along a path and the loads at rest, at J points.

    Attributes
    ----------
    drones: (J, 2n, 3, 4) [m], positions and derivatives by the path's parameter.
    vertex_speed: (J,) [m], largest first derivative of a vertex.
    loads: (J, 2n, 3) [N], thrust at rest: weight and the cable's pull held against.
    team: whose masses and thrusts.
    limits: of which ``share`` is used.
    """

    drones: Array
    vertex_speed: Array
    loads: Array
    team: Team
    limits: Limits
    share: float = LIMIT_SHARE

    @classmethod
    def along(cls, path: Path, limits: Limits, s: Array) -> Demands:
        """Return the demands of a path at its points s (J,)."""
        flat = path.flat(s)
        drones = drone_jets(path.team, flat)
        vertex_speed = np.max(length(flat.vertices[..., 1]), axis=1)
        loads = loads_at_rest(path.team, drones.cable_forces)
        return cls(drones.positions, vertex_speed, loads, path.team, limits)

    @property
    def speed_bound(self) -> Array:
        """(J,): largest ṡ² within the speed limits of drones and vertices."""
        fastest = np.max(length(self.drones[..., 1]), axis=1)
        own = np.maximum(fastest / self.limits.speed, self.vertex_speed / self.limits.vertex_speed)
        bound: Array = (self.share / np.maximum(own, 1e-12)) ** 2
        return bound

    def reach(self, u: Array, x: Array) -> Array:
        """Return how far (J, m) along rays (u, x) of s̈ and ṡ², (J, m) each, all limits hold.

        0 where rest itself breaks a limit.
        """
        linear, quadratic = np.stack([u, x], axis=1), np.stack([u * u, 2.0 * u * x, x * x], axis=1)
        factors, many = np.empty(u.shape), max(1, CHUNK // (self.drones.shape[1] * u.shape[1]))
        for first in range(0, len(u), many):
            at = slice(first, first + many)
            forms, slopes, infeasible_at_rest = self._slowness(at)
            slowest = np.sqrt(np.max(forms[0] @ quadratic[at], axis=1))
            with np.errstate(invalid="ignore"):  # a negative discriminant: that limit ends no ray
                for form, slope in zip(forms[1:], slopes, strict=True):
                    root = np.sqrt(form @ quadratic[at]) + slope @ linear[at]
                    slowest = np.fmax(slowest, np.fmax.reduce(root, axis=1))
            factors[at] = 1.0 / np.maximum(slowest, 1e-150)
            factors[at][np.any(infeasible_at_rest, axis=1)] = 0.0
        return factors

    def _slowness(self, at: slice) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return by what the inverse of a ray's factor is computed, limit by limit, at some points.

        With ``a ρ² + 2 b ρ + c = 0`` where a limit is reached, and c < 0 as at rest it is kept,
        ``1 / ρ = -b / c + √((b / c)² - a / c)``, in which nothing cancels.

        Forms (3, J, 2n, 3) of (u², 2 u x, x²) are the inverse's square for the acceleration, and
        what is under the root for thrust and tilt; (2, J, 2n, 2) of (u, x) are -b / c for these
        two; (J, 2n) tells whether rest itself breaks a limit.
        """
        q1, q2, loads = self.drones[at, ..., 1], self.drones[at, ..., 2], self.loads[at]
        squares = np.stack([dot(q1, q1), dot(q1, q2), dot(q2, q2)], axis=-1)
        along = np.stack([dot(q1, loads), dot(q2, loads)], axis=-1)
        upward = np.stack([q1[..., 2], q2[..., 2]], axis=-1)
        lift, upwards = loads[..., 2, None], _products(upward)
        forms = [squares / (self.share * self.limits.acceleration) ** 2]
        slopes, infeasible_at_rest = [], np.zeros(loads.shape[:-1], dtype=np.bool_)
        rest, cone = dot(loads, loads), 1.0 + math.tan(self.share * self.limits.tilt) ** 2
        thrust = rest - (self.share * self.team.max_thrust) ** 2
        for c, slope2 in ((thrust, 0.0), (rest - cone * loads[..., 2] ** 2, cone)):
            infeasible_at_rest |= c >= 0.0
            inverse = (self.team.mass / np.where(c < 0.0, -c, 1.0))[..., None]
            slopes.append(inverse * (along - slope2 * lift * upward))
            form = self.team.mass[:, None] * inverse * (squares - slope2 * upwards)
            forms.append(form + _products(slopes[-1]))
        return np.stack(forms), np.stack(slopes), infeasible_at_rest

    def stretches(self) -> Array:
        """Return how many times slower each drone (2n,) must fly to keep its limits.

        The parameter is the flight's time. Below 1 where it could be faster, infinite where not
        even the forces at rest are within the limits. Slowed by κ, velocities fall with κ,
        accelerations with κ² and jerks with κ³.
        """
        forms, slopes, infeasible_at_rest = self._slowness(slice(None))
        squares, slope = forms[..., 2], slopes[..., 1]  # along the ray of ṡ²
        forces = np.where(squares[1:] >= 0.0, slope + np.sqrt(np.maximum(squares[1:], 0.0)), 0.0)
        speeds, jerks = length(self.drones[..., 1]), length(self.drones[..., 3])
        slower = np.maximum.reduce(
            [
                speeds / self.limits.speed / self.share,
                np.sqrt(np.maximum(np.sqrt(squares[0]), np.max(forces, axis=0))),
                np.cbrt(jerks / self.limits.jerk / self.share),
            ]
        )
        slowest: Array = np.max(np.where(infeasible_at_rest, math.inf, slower), axis=0)
        return slowest


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
    """Raise InfeasibleError where hovering alone leaves nothing of a limit to move by.

    Parameters
    ----------
    loads: (J, 2n, 3) [N], thrusts at rest.
    when: J words for where on the flight that is.
    remedies: for too much thrust and too much tilt.
    """
    kinds = ("thrust", "N", team.max_thrust), ("tilt", "deg", np.degrees([limits.tilt]))
    at_rest = rest_ratios(team, limits, loads)
    for (name, unit, limit), ratios, remedy in zip(kinds, at_rest, remedies, strict=True):
        j, i = divmod(int(np.argmax(ratios)), team.drones)
        if ratios[j, i] >= LIMIT_SHARE:
            most = float(np.broadcast_to(limit, team.drones)[i])
            limit_values = name, float(ratios[j, i]) * most, LIMIT_SHARE * most, "max", unit
            words = f"{when[j]}, {1.0 - LIMIT_SHARE:.1%} of it being reserved to move by"
            raise InfeasibleError([Violation(*limit_values, (team.drone_names[i],), words, remedy)])


def spare_accelerations(team: Team, limits: Limits, loads: Array) -> Array:
    """Return (J, 2n) [m/s²]: what thrust and tilt leave for accelerations in any direction."""
    thrust, tilt = LIMIT_SHARE - rest_ratios(team, limits, loads)
    sideways = length(loads) * np.sin(limits.tilt * tilt)
    spare: Array = np.minimum(team.max_thrust * thrust, sideways) / team.mass
    return spare


def usable_accelerations(team: Team, limits: Limits, drones: Array) -> Array:
    """Return how much every drone may accelerate in any direction (2n,) [m/s²].

    Parameters
    ----------
    drones: (J, 2n, 3) [m], places along the flight.

    Raises
    ------
    InfeasibleError: hovering alone takes more thrust or tilt than there is, or a cable with weight
        is too short for its drones' places.
    """
    if team.cable_density > 0.0:  # the pull of a cable that is too short has no bound
        spans = length(drones[:, 1::2] - drones[:, 0::2]) / team.cable_length
        cable, worst = int(np.argmax(np.max(spans, axis=0))), float(np.max(spans))
        if worst >= 1.0:
            where, when = (f"cable {cable}",), "between its drones' places"
            remedy = "use a longer cable, a smaller polygon, or place the drones closer together"
            raise InfeasibleError([Violation("span", worst, 1.0, "max", "1", where, when, remedy)])
    loads = loads_at_rest(team, hanging_forces(team, drones))
    remedy = "use lighter cables, or stronger drones that may tilt more"
    check_hover(team, limits, loads, ["hovering with a hanging cable"] * len(drones), (remedy,) * 2)
    free = spare_accelerations(team, limits, loads)
    reserve: Array = np.minimum(np.min(free, axis=0), LIMIT_SHARE * limits.acceleration)
    return reserve


def _products(pair: Array) -> Array:
    """Return the products (…, 3) of both numbers (…, 2): first², first · second, second²."""
    return pair[..., [0, 0, 1]] * pair[..., [0, 1, 1]]


RAYS = 64
"""Directions in the half plane of (s̈, ṡ² ≥ 0): chords cut off 0.03 % of a circle."""

TINY = 1e-8
"""Margin of ṡ² below toppra's solution, so that rounding leaves programs feasible."""

HUGE = 1e8
"""Bound of s̈ and ṡ² in toppra's programs."""

ACCELERATION_WEIGHT = 1e-9
"""Weight of s̈ relative to ṡ², which chooses among corners of equal speed."""


class TimingError(HitchoptError):
    """The path cannot be timed: no profile from rest to rest, or no rate, keeps the limits."""


def path_grid(steps: int) -> Array:
    """Return (steps + 1,) from 0 to 1, closer at the ends, where the path is left from rest."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(steps + 1) / steps)


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """The fastest motion along a path without a jerk limit.

    Attributes
    ----------
    s: (J,), the grid from 0 to 1.
    speed: (J,) [1/s], ṡ there; s̈ is constant in between.
    """

    s: Array
    speed: Array

    @property
    def times(self) -> Array:
        """(J,) [s]: when s is reached."""
        steps = 2.0 * np.diff(self.s) / (self.speed[1:] + self.speed[:-1])
        return np.append(0.0, np.cumsum(steps))

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return float(self.times[-1])

    @cached_property
    def progress(self) -> PPoly:
        """Function of time [s]: s, a quadratic on each step."""
        steps = np.diff(self.times)
        quadratics = np.stack([0.5 * np.diff(self.speed) / steps, self.speed[:-1], self.s[:-1]])
        return PPoly(quadratics, self.times)

    def acceleration(self, t: Array) -> Array:
        """Return s̈ at t (…) [s], zero before and after [1/s²]."""
        inside = (t >= 0.0) & (t <= self.duration)
        return np.where(inside, self.progress(np.clip(t, 0.0, self.duration), 2), 0.0)

    def mean(self, t: Array, width: float) -> Array:
        """Return the mean of s over the ``width`` [s] before t (…); at rest before and after."""
        integral, end = self.progress.antiderivative(), self.duration
        until, before = (
            integral(np.clip(x, 0.0, end)) + np.maximum(x - end, 0.0) for x in (t, t - width)
        )
        mean: Array = (until - before) / width
        return mean


def fastest_profile(s: Array, demands: Demands) -> SpeedProfile:
    """Return the time-optimal profile from rest to rest on the grid s (J,), from 0 to 1.

    Raises
    ------
    TimingError: none exists, as where rest itself breaks a limit on the path.
    """
    corners, steepest, fastest = allowed(demands)
    # toppra's bounds and tolerances are absolute: its path gets a length, and its time a unit, in
    # which both s̈ and ṡ² are of order 1, be they bound by acceleration or by speed.
    length = float(np.clip(np.median(steepest / fastest), 1e-2, 1e9))
    unit = float(np.median(fastest)) * length
    squares = _fastest_squares(_step_programs(corners, s, length, unit))
    if not np.all(squares[1:-1] > 0.0):
        raise TimingError("toppra found no speed profile from rest to rest on this path")
    return SpeedProfile(s, np.sqrt(squares) * np.sqrt(unit / length))


def _step_programs(corners: Array, s: Array, length: float, unit: float) -> Array:
    """Return (J, 3, 2m + 2): rows ``a s̈ + b ṡ² + c ≤ 0`` of the steps between points s (J + 1,).

    The first two keep ṡ² at the next point within bounds, the others are the half planes within
    allowed corners at both ends of the step, for a length of the path and a unit of ṡ² times that.
    """
    along = np.diff(corners, axis=1)  # counter-clockwise
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    size = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(size > 0.0, normals / np.where(size > 0.0, size, 1.0), [0.0, 1.0])
    bounds = np.sum(normals * corners[:, :-1], axis=-1)
    normals = normals * [1.0, 1.0 / length]
    size = np.linalg.norm(normals, axis=-1)
    normals, bounds = normals / size[..., None], bounds / unit / size
    twice, m = 2.0 * np.diff(s * length)[:, None], normals.shape[1]
    programs = np.zeros((len(twice), 3, 2 * m + 2))
    programs[:, :2, 0] = np.append(twice, np.ones_like(twice), axis=1)
    programs[:, :2, 1] = -programs[:, :2, 0]
    here, there = programs[..., 2 : m + 2], programs[..., m + 2 :]
    here[:, 0], here[:, 1], here[:, 2] = normals[:-1, :, 0], normals[:-1, :, 1], -bounds[:-1]
    there[:, 0] = normals[1:, :, 0] + twice * normals[1:, :, 1]
    there[:, 1], there[:, 2] = normals[1:, :, 1], -bounds[1:]
    return programs


def _fastest_squares(programs: Array) -> Array:
    """Return (J + 1,): the largest ṡ² from rest to rest, nan where there is none.

    From the last point to the first, the largest ones from which rest can be reached; then as fast
    as these allow. The next point's bounds are written into the programs.
    """
    steps = len(programs)
    lowest, highest = np.array([-HUGE, 0.0]), np.array([HUGE, HUGE])
    aim, active = np.array([-ACCELERATION_WEIGHT, 1.0, 0.0]), np.arange(2)
    most = [0.0] * (steps + 1)
    for i in reversed(range(steps)):
        a, b, c = programs[i]
        c[0] = -most[i + 1]
        solved, _, best, binding = solve_lp2d(aim, a, b, c, lowest, highest, active)
        if not solved:
            return np.full(steps + 1, np.nan)
        most[i], active = float(best[1]), np.array(binding, dtype=active.dtype)
    a, b, c = programs[:, 0], programs[:, 1], programs[:, 2]
    above = np.where(a > 0.0, a, 1.0)
    limits, slopes = np.where(a > 0.0, -c / above, np.inf), np.where(a > 0.0, b / above, 0.0)
    twice, squares = a[:, 0].tolist(), [0.0] * (steps + 1)
    for i, (limit, slope) in enumerate(zip(limits, slopes, strict=True)):
        after = squares[i] + twice[i] * float((limit - slope * squares[i]).min())
        squares[i + 1] = min(most[i + 1], max(after - TINY, 0.9999 * after, 0.0))
    return np.array(squares)


def acceleration_ramp(profile: SpeedProfile, demands: Demands) -> float:
    """Return how long the acceleration takes from one limit to the other [s].

    Where the jerk never lets it reach its limits: as long as the largest speed that is reached
    takes, or the longest path of a drone.
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


def allowed(demands: Demands) -> tuple[Array, Array, Array]:
    """Return an inner approximation of the (s̈, ṡ²) that all drones' limits allow.

    Vector norms are no boxes: rays from rest find the boundary of the convex set that all drones
    allow together, and the polygon through their ends lies inside of it. Its size is fixed in n.

    Returns
    -------
    Corners (J, RAYS + 1, 2) from the largest s̈ at ṡ = 0 to the smallest; (J,) [1/s²] each, sizes
    of s̈ and of ṡ².
    """
    fastest = demands.speed_bound
    rates = np.maximum(length(demands.drones[..., 1]), 1e-12)
    steepest = np.min(demands.limits.acceleration / rates, axis=1)
    angles = np.pi * np.arange(RAYS + 1) / RAYS
    u, x = steepest[:, None] * np.cos(angles), fastest[:, None] * np.sin(angles)
    x[:, [0, -1]] = 0.0
    ends, moving = demands.reach(u, x), np.where(x > 0.0, x, 1.0)
    ends = np.minimum(ends, np.where(x > 0.0, fastest[:, None] / moving, np.inf))
    return np.stack([ends * u, ends * x], axis=-1), steepest, fastest


GRID = 80
"""Number of steps of the grid along the path: coarser ones mistake which of two paths is faster."""

RAMP_SHARE = 0.5
"""Share of the acceleration's ramp by which a limit of jerk makes flights longer at least: that of
a change from rest to full speed."""


@lru_cache(maxsize=3)
def demands_along(path: Path, limits: Limits, steps: int = GRID) -> Demands:
    """Return the demands of a path on a grid of ``steps``; those of the last paths are stored."""
    return Demands.along(path, limits, path_grid(steps))


@lru_cache(maxsize=16)
def flight_estimate(path: Path, limits: Limits) -> float:
    """Return an estimate of the duration [s] of a flight along a path; infinite if there is none.

    Flights are mostly longer, by up to a tenth of the ramp.
    """
    demands = demands_along(path, limits)
    try:
        profile = fastest_profile(path_grid(GRID), demands)
    except TimingError:
        return math.inf
    return profile.duration + RAMP_SHARE * acceleration_ramp(profile, demands)
