"""Setpoints with offsets that hold the cables' tension without feed-forward of forces.

A controller with stiffness k and damping c tracks position, velocity and acceleration of its
setpoint s, and moves a drone of mass m under the cable force F by

    m ẍ = m s̈ + c (ṡ - ẋ) + k (s - x) + F.

The drone follows the plan if ``δ = s - x`` solves ``δ + (c/k) δ' + (m/k) δ'' = -F/k``. At rest the
setpoint is offset outward by T/k. F is that of ``States.held_forces``. The equation is solved
forward from rest by collocation at Lobatto points, ends included, so that the second derivative is
as continuous as F. The residual between these points moves the drone by at most the gain of the
response times the residual, which is computed and reported. The plan is extended so that the
setpoints end at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np

from hitchopt.checks.drones import largest_rate
from hitchopt.drones.controllers import DAMPING_RATIO
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import Team
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import prolonged
from hitchopt.motion.states import states_at
from hitchopt.support import Feature, Neighbour, refused_value, unsupported
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, positive

DEGREE = 8  # Degree of the offsets' pieces
MAX_STEP = 1.5  # Maximum duration of a piece over √(m/k), one radian of a drone's oscillation
HALVINGS = 3  # Maximum number of refinements
MAX_ERROR = 1e-4  # Maximum error of drones due to residuals [m]
PROBES = 3  # Number of points between Lobatto points at which residuals are evaluated
REST_TIME = 2.0  # Extension of the plan, in which offsets come to rest [s]
LIMIT_MARGIN = 0.2  # Margin of speed and acceleration limits over setpoints, for rounding


@dataclass(frozen=True, eq=False)
class HeldTension:
    """Setpoints of a plan that hold its tension, for controllers with given gains."""

    flight: Flight  # the extended plan with setpoints as drones
    stiffness: Array  # (2n, 3) [N/m]
    damping: Array  # (2n, 3) [N s/m]
    offset: float  # largest offset of a setpoint from its drone [m]
    error: float  # largest error of a drone with these controllers [m]

    @property
    def note(self) -> str:
        """Note for users."""
        stiffness, damping = _range_text(self.stiffness), _range_text(self.damping)
        return (
            f"setpoints lie up to {100.0 * self.offset:.3g} cm outside the plan to hold the "
            f"tension (gains {stiffness} N/m, {damping} N s/m); files last "
            f"{REST_TIME:g} s longer than the plan"
        )


def is_overridden(team: Team) -> bool:
    """Return whether integral gains would pull drones to moved setpoints, at any tension.

    PX4's permanent vertical integral is ignored: it only compensates vertical forces.
    """
    level = np.array([True, True, False])
    return bool(np.any((team.integral > 0.0) & (level | np.isfinite(team.integral))))


def held_tension(
    flight: Flight, stiffness: float | None = None, damping: float | None = None
) -> HeldTension:
    """Return setpoints with which controllers fly a plan without feed-forward of cable forces.

    Gains [N/m], [N s/m] are the team's by default. Raises InputError if the team has none, or an
    integral, which would move drones toward their setpoints, and InfeasibleError if forces change
    too fast.
    """
    if not flight.has_cables:
        raise unsupported(Feature.HOLD_TENSION, Neighbour.SINGLE_DRONES)
    held = {
        each.name: _team_setpoints(each.motion, stiffness, damping)
        for each in flight.teams
        if each.motion.team.has_cables
    }
    teams = [
        replace(each, motion=held[each.name].motion if each.name in held else each.motion.untimed)
        for each in flight.teams
    ]
    k, c = (
        np.concatenate([getattr(h, x) for h in held.values()]) for x in ("stiffness", "damping")
    )
    offset, error = (max(getattr(each, x) for each in held.values()) for x in ("offset", "error"))
    return HeldTension(replace(flight, teams=tuple(teams)), k, c, offset, error)


def loop_gains(
    team: Team, stiffness: float | None, damping: float | None, option: str
) -> tuple[Array, Array]:
    """Return stiffness [N/m] and damping [N s/m] (drones, 3) of position loops.

    They are the team's unless given. Raises InputError if an ``option`` needs them, and the team
    has none.
    """
    k, c = team.stiffness, team.damping
    if stiffness is not None:
        k = np.full_like(k, positive("stiffness", stiffness))
        c = 2.0 * DAMPING_RATIO * np.sqrt(k * team.mass[:, None])
    if not np.all(np.isfinite(k)):
        bound = f"the position loop's [N/m], with {option}"
        remedy = "pass stiffness=, or team.quadrotor.stiffness in the problem"
        raise InputError("stiffness", None, bound, remedy)
    if damping is not None:
        c = np.full_like(k, positive("damping", damping))
    return k, c


def trailing_times(stiffness: Array, damping: Array, mass: Array) -> Array:
    """Return the largest errors (…) [s], over the speed, of drones that follow positions alone.

    Their errors obey ``m ë + c ė + k e = m s̈ + c ṡ``. At a steady speed e = c/k ṡ. In any motion
    it is at most the largest ``|ṡ|`` times the integral of ``|g|``, where g is the decay of an
    error of 1 from rest. Beyond c/k this integral has twice the negative parts of g, which loops
    with a damping ratio ζ below 1 have: with ω² = k/m, its roots decay by ``a = ζ ω`` and turn by
    ``w = √(ω² - a²)``, and ``∫ g`` from its n-th root on is ``± exp(-a t) / ω``.
    """
    omega = np.sqrt(stiffness / mass)
    decay = 0.5 * damping / mass
    overshoots = decay < omega
    turn = np.sqrt(np.where(overshoots, omega**2 - decay**2, 1.0))
    first = (0.5 * np.pi + np.arctan2(decay, turn)) / turn
    parts = np.exp(-decay * first) / (omega * -np.expm1(-decay * np.pi / turn))
    times: Array = damping / stiffness + np.where(overshoots, 2.0 * parts, 0.0)
    return times


class _TeamSetpoints(NamedTuple):
    """Setpoints of one team that hold its tension; fields are those of ``HeldTension``."""

    motion: Motion
    stiffness: Array
    damping: Array
    offset: float
    error: float


def _team_setpoints(
    motion: Motion, stiffness: float | None, damping: float | None
) -> _TeamSetpoints:
    """Return the setpoints of one team with cables."""
    team = motion.team
    if is_overridden(team):
        gain = float(np.max(team.integral_gain))
        raise refused_value(Feature.HOLD_TENSION, Neighbour.INTEGRAL_GAINS, gain)
    k, c = loop_gains(team, stiffness, damping, "hold_tension=True")
    masses = team.mass[:, None]
    critical = 2.0 * np.sqrt(k * masses)
    # The largest error over the largest residual: the integral of the absolute impulse response.
    ratio = min(float(np.min(c / critical)), 1.0 - 1e-9)
    gain = float(1.0 / np.tanh(0.5 * np.pi * ratio / np.sqrt(1.0 - ratio * ratio)))
    whole = prolonged(motion.untimed, REST_TIME)
    step = MAX_STEP * float(np.min(np.sqrt(masses / k)))
    for halving in range(HALVINGS + 1):
        spans = [
            (a, b, ceil((b - a) / step * 2**halving)) for a, b in pairwise(whole.drones.breaks)
        ]
        inner = [np.linspace(a, b, count, endpoint=False) for a, b, count in spans]
        breaks = np.concatenate([*inner, whole.drones.breaks[-1:]])
        offsets, residual = _solve_offsets(whole, k, c, breaks)
        if (error := gain * residual) <= MAX_ERROR:
            break
    else:
        remedy = "fly it more slowly with stretch="
        violation = Violation("held_tension", error, MAX_ERROR, "max", "m", (), "", remedy)
        raise InfeasibleError([violation], "no setpoints that hold the tension were found")
    split = whole.map_curves(lambda part: on_breaks(part, breaks), whole.phases)
    degree = max(split.drones.degree, DEGREE)
    positions = bernstein.elevate(split.drones.coefficients, degree)
    drones = PiecewisePolynomial(
        breaks, positions + bernstein.elevate(offsets.coefficients, degree)
    )
    limits = split.requirements.limits.with_reserve
    factor = 1.0 + LIMIT_MARGIN
    widened = replace(  # limits that shows declare must hold for setpoints
        limits,
        speed=max(limits.speed, factor * largest_rate(drones, 1).worst),
        acceleration=max(limits.acceleration, factor * largest_rate(drones, 2).worst),
    )
    held = replace(split, drones=drones, requirements=replace(split.requirements, limits=widened))
    largest = float(np.max(np.linalg.norm(offsets.coefficients, axis=-2)))
    return _TeamSetpoints(held, k, c, largest, error)


def _solve_offsets(
    motion: Motion, stiffness: Array, damping: Array, breaks: Array
) -> tuple[PiecewisePolynomial, float]:
    """Return offsets (2n, 3) [m] that solve the equation at Lobatto points, and the residual [m].

    The residual is the largest one at points between them.
    """
    zeros = np.polynomial.legendre.Legendre.basis(DEGREE - 2).deriv().roots().real
    x = np.concatenate([[0.0], 0.5 + 0.5 * np.sort(zeros), [1.0]])
    inner = np.arange(1, PROBES + 1) / (PROBES + 1)
    probes = (x[:-1, None] + np.diff(x)[:, None] * inner).ravel()
    basis = [bernstein.derivative_basis(np.append(x, probes), DEGREE, i) for i in range(3)]
    durations = np.diff(breaks)
    times = breaks[:-1, None] + durations[:, None] * np.append(x, probes)
    times[:, len(x) - 1] = breaks[1:]  # exactly the start of the next piece
    forces = states_at(motion, times - breaks[0]).held_forces(motion.team.false_pull)
    right_sides = np.moveaxis(-forces / stiffness, 1, -1)  # (pieces, 2n, 3, points)
    first = damping / stiffness
    second = motion.team.mass[:, None] / stiffness
    coefficients = np.zeros((len(durations), motion.team.drones, 3, DEGREE + 1))
    value = right_sides[0, ..., 0]
    slope = np.zeros_like(right_sides[0, ..., 0])
    residual = 0.0
    for c, h, right in zip(coefficients, durations.tolist(), right_sides, strict=True):
        a = (first / h)[..., None, None]
        b = (second / h**2)[..., None, None]
        rows = basis[0] + a * basis[1] + b * basis[2]  # the equation's left side, by coefficients
        c[..., :2] = np.stack([value, value + h * slope / DEGREE], axis=-1)
        rest = right - (rows[..., :2] @ c[..., :2, None])[..., 0]
        solution = np.linalg.solve(rows[..., : len(x), 2:], rest[..., : len(x), None])
        c[..., 2:] = solution[..., 0]
        residuals = ((rows @ c[..., None])[..., 0] - right)[..., len(x) :]
        residual = max(residual, float(np.max(np.linalg.norm(residuals, axis=1))))
        value = c[..., -1]
        slope = DEGREE / h * (c[..., -1] - c[..., -2])
    return PiecewisePolynomial(breaks, coefficients), residual


def _range_text(values: Array) -> str:
    low, high = (f"{value:.4g}" for value in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"
