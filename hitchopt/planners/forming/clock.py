"""One clock for all drones: from rest to rest in the least time, jerk-limited, by ruckig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

SHORTEST = 1e-9
"""[s] Phases of a profile that are shorter are none."""


class ClockError(HitchoptError):
    """No profile was found; a bug, since every distance can be gone."""


def fastest_clock(
    goal: float, speed: float, acceleration: float, jerk: float
) -> PiecewisePolynomial:
    """Return the fastest way from 0 to ``goal``, at rest at both ends, as a cubic a phase.

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
    x = np.zeros((3, len(seconds) + 1))  # position, velocity, acceleration
    for i, (h, j) in enumerate(zip(seconds, jerks, strict=True)):
        p, v, a = x[:, i]
        x[:, i + 1] = (
            p + h * (v + h * (a / 2.0 + h * j / 6.0)),
            v + h * (a + h * j / 2.0),
            a + h * j,
        )
    x[:, -1] = goal, 0.0, 0.0  # rounding goes into the last phase, where it is all but nothing
    breaks = np.concatenate([[0.0], np.cumsum(seconds)])
    return PiecewisePolynomial.hermite(breaks, x[:, :-1], x[:, 1:])


def timed(clock: PiecewisePolynomial, most: float) -> Array:
    """Return times (pieces + 1,) [s]: the clock's breaks, and others in between.

    Between two of them the clock advances by at most about ``most``.
    """
    times = [clock.breaks[:1]]
    ways = np.diff(clock.at(clock.breaks))
    for first, last, way in zip(clock.breaks[:-1], clock.breaks[1:], ways, strict=True):
        count = max(1, int(np.ceil(way / most)))
        times.append(np.linspace(first, last, count + 1)[1:])
    return np.concatenate(times)
