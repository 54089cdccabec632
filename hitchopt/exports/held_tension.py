"""Set points that hold the cables' tension where receivers do not feed it forward.

A controller of stiffness k and damping c that knows of its set point s no more than position,
velocity and acceleration moves a drone of mass m under the cable force F by

    m ẍ = m s̈ + c (ṡ - ẋ) + k (s - x) + F.

The drone is where the plan says if ``δ = s - x`` solves ``δ + (c/k) δ' + (m/k) δ'' = -F/k``; at
rest the set point is moved outward by T/k. F is scaled by ``Team.pull_gain``. The equation is
solved forward from rest by collocation: piece by piece a polynomial that fulfils it at Lobatto's
points, ends included, so that the second derivative is as continuous as F. What it misses between
these points moves the drone by at most the response's gain times the miss, which is measured and
reported. The plan lasts a little longer so that set points end at rest, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil

import numpy as np

from hitchopt.checks.drones import largest_rate
from hitchopt.errors import InfeasibleError, InputError, UnsupportedError, Violation
from hitchopt.hitch.flight_controller import DAMPING_RATIO
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import append_motion, resting
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, positive

DEGREE = 8  # Degree of the offset's pieces
LONGEST = 1.5  # Longest piece over √(m/k), the time in which a drone swings by one radian
HALVINGS = 3  # Number of times that the pieces are halved while the miss is too large
LARGEST_MISS = 1e-4  # [m] Largest distance of drones from the plan that a solution may leave
PROBES = 3  # Points between two of Lobatto's at which the equation is checked
REST = 2.0  # [s] Time by which the plan is prolonged, for offsets to come to rest
SPARE = 0.2  # Share by which limits of speed and acceleration exceed set points, for rounding


@dataclass(frozen=True, eq=False)
class HeldTension:
    """A plan's set points that hold its tension, for controllers of some gains."""

    motion: Motion  # the plan, prolonged, with the set points in place of the drones
    stiffness: Array  # (2n, 3) [N/m]
    damping: Array  # (2n, 3) [N s/m]
    offset: float  # largest distance of a set point from its drone [m]
    miss: float  # largest distance of a drone from the plan, with these controllers [m]

    @property
    def note(self) -> str:
        """Note for users."""
        return (
            f"set points are up to {100.0 * self.offset:.3g} cm off the drones' places, for "
            f"position loops of {_span(self.stiffness)} N/m and {_span(self.damping)} N s/m that "
            "feed forward velocity, acceleration and gravity alone; with these the drones are "
            f"within {max(1e3 * self.miss, 1e-3):.2g} mm of the plan; files last {REST:g} s longer"
        )


def held_tension(
    motion: Motion, stiffness: float | None = None, damping: float | None = None
) -> HeldTension:
    """Return the set points with which controllers fly a plan without feed-forward of the pull.

    Without gains [N/m], [N s/m] they are the team's. InputError tells that it has none, or a
    bounded integral, which would move drones after their set points; InfeasibleError of forces that
    change too fast.
    """
    if motion.changes:
        motion.refuse_several("hold_tension=True")
    if not motion.has_cables:
        raise UnsupportedError("hold_tension=True: single drones carry no cables that could pull")
    if len(motion.groups) == 1:
        return _held_tension(motion, stiffness, damping)
    held = {
        each.name: _held_tension(each.motion, stiffness, damping)
        for each in motion.groups
        if each.motion.has_cables
    }
    groups = [
        replace(each, motion=held[each.name].motion if each.name in held else each.motion.untimed)
        for each in motion.groups
    ]
    k, c = (
        np.concatenate([getattr(h, x) for h in held.values()]) for x in ("stiffness", "damping")
    )
    offset, miss = (max(getattr(each, x) for each in held.values()) for x in ("offset", "miss"))
    return HeldTension(combined(groups, motion.others), k, c, offset, miss)


def _held_tension(motion: Motion, stiffness: float | None, damping: float | None) -> HeldTension:
    """Return the set points of one group with cables."""
    team = motion.team
    k, c, most = team.stiffness, team.damping, team.integral
    if np.any((most > 0.0) & np.isfinite(most)):
        bound = "0 with hold_tension=True: integrals move drones after their set points"
        remedy = "set team.quadrotor.gains.ki to 0, there and on board"
        raise InputError("gains.ki", float(np.max(team.integral_gain)), bound, remedy)
    masses = team.mass[:, None]
    if stiffness is not None:
        k = np.full_like(k, positive("stiffness", stiffness))
        c = 2.0 * DAMPING_RATIO * np.sqrt(k * masses)
    if not np.all(np.isfinite(k)):
        bound = "the position loop's [N/m], with hold_tension=True"
        remedy = "give stiffness=, or team.quadrotor.stiffness in the problem"
        raise InputError("stiffness", None, bound, remedy)
    critical = 2.0 * np.sqrt(k * masses)
    if damping is not None:
        c = np.full_like(k, positive("damping", damping))
    # The largest offset over the largest miss: the integral of the absolute impulse response.
    ratio = min(float(np.min(c / critical)), 1.0 - 1e-9)
    gain = float(1.0 / np.tanh(0.5 * np.pi * ratio / np.sqrt(1.0 - ratio * ratio)))
    whole = append_motion(motion.untimed, resting(motion.untimed, REST))
    step = LONGEST * float(np.min(np.sqrt(masses / k)))
    for halving in range(HALVINGS + 1):
        spans = [
            (a, b, ceil((b - a) / step * 2**halving)) for a, b in pairwise(whole.drones.breaks)
        ]
        inner = [np.linspace(a, b, count, endpoint=False) for a, b, count in spans]
        breaks = np.concatenate([*inner, whole.drones.breaks[-1:]])
        offsets, error = _solved(whole, k, c, breaks)
        if (miss := gain * error) <= LARGEST_MISS:
            break
    else:
        remedy = "fly it slower with stretch="
        broken = Violation("held_tension", miss, LARGEST_MISS, "max", "m", (), "", remedy)
        raise InfeasibleError([broken], "set points that hold the tension are not found")
    split = whole.map_curves(lambda part: on_breaks(part, breaks), whole.phases)
    degree = max(split.drones.degree, DEGREE)
    places = bernstein.elevate(split.drones.coefficients, degree)
    drones = PiecewisePolynomial(breaks, places + bernstein.elevate(offsets.coefficients, degree))
    limits, share = split.requirements.limits.with_reserve, 1.0 + SPARE
    eased = replace(  # shows state limits, which set points keep
        limits,
        speed=max(limits.speed, share * largest_rate(drones, 1).worst),
        acceleration=max(limits.acceleration, share * largest_rate(drones, 2).worst),
    )
    held = replace(split, drones=drones, requirements=replace(split.requirements, limits=eased))
    largest = float(np.max(np.linalg.norm(offsets.coefficients, axis=-2)))
    return HeldTension(held, k, c, largest, miss)


def _solved(
    motion: Motion, stiffness: Array, damping: Array, breaks: Array
) -> tuple[PiecewisePolynomial, float]:
    """Return the offsets (2n, 3) [m] that solve the equation at Lobatto's points, and its error.

    The error [m] is the largest one at points between them.
    """
    zeros = np.polynomial.legendre.Legendre.basis(DEGREE - 2).deriv().roots().real
    x = np.concatenate([[0.0], 0.5 + 0.5 * np.sort(zeros), [1.0]])
    inner = np.arange(1, PROBES + 1) / (PROBES + 1)
    probes = (x[:-1, None] + np.diff(x)[:, None] * inner).ravel()
    order = [bernstein.derivative_basis(np.append(x, probes), DEGREE, i) for i in range(3)]
    durations = np.diff(breaks)
    times = breaks[:-1, None] + durations[:, None] * np.append(x, probes)
    times[:, len(x) - 1] = breaks[1:]  # the very time at which the next piece begins
    forces = motion.team.pull_gain * states_at(motion, times - breaks[0]).cable_forces
    wanted = np.moveaxis(-forces / stiffness, 1, -1)  # (pieces, 2n, 3, points)
    rate, bend = damping / stiffness, motion.team.mass[:, None] / stiffness
    coefficients = np.zeros((len(durations), motion.team.drones, 3, DEGREE + 1))
    value, slope, miss = wanted[0, ..., 0], np.zeros_like(wanted[0, ..., 0]), 0.0
    for c, h, right in zip(coefficients, durations.tolist(), wanted, strict=True):
        a, b = (rate / h)[..., None, None], (bend / h**2)[..., None, None]
        rows = order[0] + a * order[1] + b * order[2]  # the equation's left side, by coefficients
        c[..., :2] = np.stack([value, value + h * slope / DEGREE], axis=-1)
        rest = right - (rows[..., :2] @ c[..., :2, None])[..., 0]
        others = np.linalg.solve(rows[..., : len(x), 2:], rest[..., : len(x), None])
        c[..., 2:] = others[..., 0]
        missing = ((rows @ c[..., None])[..., 0] - right)[..., len(x) :]
        miss = max(miss, float(np.max(np.linalg.norm(missing, axis=1))))
        value, slope = c[..., -1], DEGREE / h * (c[..., -1] - c[..., -2])
    return PiecewisePolynomial(breaks, coefficients), miss


def _span(values: Array) -> str:
    low, high = (f"{value:.4g}" for value in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"
