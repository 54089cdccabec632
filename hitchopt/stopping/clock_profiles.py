"""Fastest changes of a clock's rate, or of its place, as phases of constant jerk: by ruckig."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from hitchopt.trajectory.clock_phases import ClockPhases
from hitchopt.values import Array

SHORTEST = 1e-9
"""[s] Phases of a profile that are shorter are dropped."""

NEAR = 1e-6
"""[s] Rates that change sign so close to the end of a phase do so by rounding: polynomials cannot
follow a phase as short as what would be cut off."""

SAME = 1e-9
"""Rates closer than this to the fastest one are that: ruckig brakes for a rate that is faster by
rounding, and leaves a slope that adds up along the way."""


def to_rate(jet: Array, rate: float, acceleration: float, jerk: float) -> ClockPhases | None:
    """Return the fastest change to a constant rate; None if there is none.

    Parameters
    ----------
    jet: (3,) plan time [s], rate and its derivative [1/s] at the start.
    rate: at the end.
    acceleration, jerk: bounds of the rate's derivatives [1/s], [1/s²].
    """
    from ruckig import ControlInterface, InputParameter

    task = InputParameter(1)
    task.control_interface = ControlInterface.Velocity
    task.target_velocity, task.target_acceleration = [rate], [0.0]
    return _profile(task, jet, acceleration, jerk)


def to_time(
    jet: Array, time: float, fastest: float, acceleration: float, jerk: float
) -> ClockPhases | None:
    """Return the fastest course to rest at a plan time [s], at rates of at most ``fastest``."""
    from ruckig import InputParameter

    task = InputParameter(1)
    task.max_velocity, task.target_position = [fastest], [time]
    begin = np.array(jet[:3])
    if abs(abs(begin[1]) - fastest) <= SAME:
        begin[1] = math.copysign(fastest, begin[1])
    return _profile(task, begin, acceleration, jerk)


def _profile(task: object, jet: Array, acceleration: float, jerk: float) -> ClockPhases | None:
    from ruckig import Result, Ruckig, RuckigError, Trajectory

    place, rate, slope = (float(value) for value in jet[:3])
    task.current_position, task.current_velocity = [place], [rate]  # type: ignore[attr-defined]
    task.current_acceleration = [slope]  # type: ignore[attr-defined]
    task.max_acceleration, task.max_jerk = [acceleration], [jerk]  # type: ignore[attr-defined]
    trajectory = Trajectory(1)
    try:
        result = Ruckig(1).calculate(task, trajectory)
    except RuckigError:  # bounds far below what the clock does now
        return None
    if result not in {Result.Working, Result.Finished}:
        return None
    profile = trajectory.profiles[0][0]
    seconds = np.array([*profile.brake.t, *profile.t], dtype=np.float64)
    jerks = np.array([*profile.brake.j, *profile.j], dtype=np.float64)
    kept = seconds > SHORTEST
    return one_sign(phases_of(np.array([place, rate, slope]), seconds[kept], jerks[kept]))


def phases_of(jet: Array, seconds: Array, jerks: Array) -> ClockPhases:
    """Return phases of constant jerk one after the other, from a jet (3,) on."""
    jets = []
    p, v, a = (float(value) for value in jet[:3])  # plain numbers are faster than arrays of four
    for dt, j in zip(np.asarray(seconds).tolist(), np.asarray(jerks).tolist(), strict=True):
        jets.append((p, v, a, j))
        p, v, a = (
            p + dt * (v + dt * (a / 2.0 + dt * j / 6.0)),
            v + dt * (a + dt * j / 2.0),
            a + dt * j,
        )
    owner = np.zeros(len(jets), dtype=np.intp)
    return ClockPhases(owner, np.reshape(jets, (-1, 4)), np.array(seconds, dtype=np.float64))


def one_sign(phases: ClockPhases) -> ClockPhases:
    """Return the phases, split where their rates change sign."""
    seconds: list[float] = []
    jerks: list[float] = []
    for (_, rate, slope, jerk), duration in zip(
        phases.jets.tolist(), phases.duration.tolist(), strict=True
    ):
        cuts = [t for t in _zeros(rate, slope, 0.5 * jerk) if NEAR < t < duration - NEAR]
        edges = [0.0, *sorted(cuts), duration]
        seconds += [last - first for first, last in pairwise(edges)]
        jerks += [jerk] * (len(edges) - 1)
    if len(seconds) == len(phases):
        return phases
    return phases_of(phases.jets[0], np.array(seconds), np.array(jerks))


def _zeros(c: float, b: float, a: float) -> tuple[float, ...]:
    """Return the real zeros of ``a t² + b t + c``."""
    inside = b * b - 4.0 * a * c
    if inside < 0.0 or a == b == 0.0:
        return ()
    larger = -0.5 * (b + math.copysign(math.sqrt(inside), b))  # adds numbers of one sign
    return tuple(top / below for top, below in ((larger, a), (c, larger)) if below != 0.0)


NOTHING = phases_of(np.zeros(3), np.zeros(0), np.zeros(0))
"""No phase."""
