"""One clock for all drones, the fastest jerk-limited profile, and curves flown on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.planners.forming.reserve import SHARE
from hitchopt.planners.path.jets import chained
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SHORTEST = 1e-9
"""[s] Phases of a profile that are shorter are dropped."""

Curve = Callable[[Array, int], Array]
"""Function of parameters (J,) and the order of a derivative by them; gives (J, drones, 3) [m]."""


class ClockError(HitchoptError):
    """No profile was found: a defect, as every distance has one."""


def fastest_clock(
    goal: float, speed: float, acceleration: float, jerk: float
) -> PiecewisePolynomial:
    """Return the fastest profile from 0 to ``goal``, from rest to rest, a cubic per phase.

    The phases are exact: ruckig's jerks and durations, integrated. No waypoints are used.

    Parameters
    ----------
    goal: positive, in any unit.
    speed, acceleration, jerk: limits, in that unit and seconds.

    Raises
    ------
    ClockError: ruckig failed.
    """
    from ruckig import InputParameter, Result, Ruckig, Trajectory

    task = InputParameter(1)
    task.current_position, task.target_position = [0.0], [goal]
    task.max_velocity, task.max_acceleration, task.max_jerk = [speed], [acceleration], [jerk]
    trajectory = Trajectory(1)
    result = Ruckig(1).calculate(task, trajectory)
    if result not in {Result.Working, Result.Finished}:
        raise ClockError(f"ruckig: {result} from 0 to {goal:g}; please report it")
    profile = trajectory.profiles[0][0]
    phases = np.array([profile.t, profile.j], dtype=np.float64)
    seconds, jerks = phases[:, phases[0] > SHORTEST]
    return _integrated(goal, seconds, jerks)


def _integrated(goal: float, seconds: Array, jerks: Array) -> PiecewisePolynomial:
    """Return the cubics of phases of constant jerk; the end is met exactly."""
    jets = [np.zeros(4)]
    for duration, jerk in zip(seconds, jerks, strict=True):
        jets[-1][3] = jerk
        jets.append(advanced(jets[-1], duration))
    x = np.stack(jets, axis=1)[:3]
    x[:, -1] = goal, 0.0, 0.0  # rounding goes into the last phase, where it is all but nothing
    breaks = np.concatenate([[0.0], np.cumsum(seconds)])
    return PiecewisePolynomial.hermite(breaks, x[:, :-1], x[:, 1:])


def advanced(jets: Array, dt: Array | float) -> Array:
    """Return the jets (…, 4) of cubics at ``dt`` (…) after they have the given ``jets`` (…, 4)."""
    p, v, a, j = np.moveaxis(jets, -1, 0)
    moved = p + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0), a + dt * j
    return np.stack([*moved, j], axis=-1)


def flown(
    curve: Curve, clock: PiecewisePolynomial, most: float, limits: Limits, reserve: float
) -> PiecewisePolynomial:
    """Return drones on a curve, on a clock that is slowed until they keep their limits.

    Parameters
    ----------
    curve: in the clock's unit.
    clock: cubics from rest to rest.
    most: largest advance of the clock on one piece.
    reserve: largest acceleration of any of them [m/s²].
    """
    drones = _fitted(curve, clock, most)
    factors = []
    for order, limit in ((1, limits.speed), (2, reserve), (3, limits.jerk)):
        largest = np.max(np.linalg.norm(drones.differentiated(order).coefficients, axis=-2))
        factors.append((float(largest) / (SHARE * limit)) ** (1.0 / order))
    return drones.stretched(max(factors))


def _fitted(curve: Curve, clock: PiecewisePolynomial, most: float) -> PiecewisePolynomial:
    """Return polynomials that meet position, velocity, acceleration and jerk at every break."""
    breaks = _times(clock, most)
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    rates = np.stack([clock.differentiated(k).at(middles) for k in range(4)], axis=-1)
    ends = []
    for times in (breaks[:-1], breaks[1:]):
        # Rates of the phase that the piece lies in: jerk jumps between phases.
        inner = advanced(rates, times - middles)
        outer = np.stack([curve(inner[:, 0], k) for k in range(4)], axis=-1)
        ends.append(np.moveaxis(chained(outer, inner[:, None, None, :]), -1, 0))
    left, right = ends
    first, last = clock.at(clock.breaks[[0, -1]])
    left[:3, 0] = _at_rest(curve, first)
    right[:3, -1] = _at_rest(curve, last)
    left[:3, 1:] = right[:3, :-1]
    return PiecewisePolynomial.hermite(breaks, left, right)


def _times(clock: PiecewisePolynomial, most: float) -> Array:
    """Return the clock's breaks and times in between (…,) [s], about ``most`` apart or less."""
    times = [clock.breaks[:1]]
    advances = np.diff(clock.at(clock.breaks))
    for first, last, advance in zip(clock.breaks[:-1], clock.breaks[1:], advances, strict=True):
        count = max(1, int(np.ceil(advance / most)))
        times.append(np.linspace(first, last, count + 1)[1:])
    return np.concatenate(times)


def _at_rest(curve: Curve, parameter: float) -> Array:
    """Return the jets (3, drones, 3) of drones at rest on the curve."""
    places = curve(np.array([parameter]), 0)[0]
    return np.stack([places, *np.zeros((2, *places.shape))])
