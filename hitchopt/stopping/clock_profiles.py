"""Fastest changes of a clock's rate, or of its place, as phases of constant jerk: by ruckig."""

from __future__ import annotations

import numpy as np

from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array

SHORTEST = 1e-9
"""[s] Phases of a profile that are shorter are dropped."""


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
    return _profile(task, jet, acceleration, jerk)


def _profile(task: object, jet: Array, acceleration: float, jerk: float) -> ClockPhases | None:
    from ruckig import Result, Ruckig, Trajectory

    place, rate, slope = (float(value) for value in jet[:3])
    task.current_position, task.current_velocity = [place], [rate]  # type: ignore[attr-defined]
    task.current_acceleration = [slope]  # type: ignore[attr-defined]
    task.max_acceleration, task.max_jerk = [acceleration], [jerk]  # type: ignore[attr-defined]
    trajectory = Trajectory(1)
    if Ruckig(1).calculate(task, trajectory) not in {Result.Working, Result.Finished}:
        return None
    profile = trajectory.profiles[0][0]
    seconds = np.array([*profile.brake.t, *profile.t], dtype=np.float64)
    jerks = np.array([*profile.brake.j, *profile.j], dtype=np.float64)
    kept = seconds > SHORTEST
    return one_sign(phases_of(np.array([place, rate, slope]), seconds[kept], jerks[kept]))


def phases_of(jet: Array, seconds: Array, jerks: Array) -> ClockPhases:
    """Return phases of constant jerk one after the other, from a jet (3,) on."""
    jets = []
    here = np.append(jet[:3], 0.0)
    for duration, jerk in zip(seconds, jerks, strict=True):
        here[3] = jerk
        jets.append(here)
        here = advanced(here, duration)
    owner = np.zeros(len(seconds), dtype=np.intp)
    return ClockPhases(owner, np.reshape(jets, (-1, 4)), np.asarray(seconds, dtype=np.float64))


def one_sign(phases: ClockPhases) -> ClockPhases:
    """Return the phases, split where their rates change sign."""
    jet = phases.jets[0, :3] if len(phases) else np.zeros(3)
    seconds: list[float] = []
    jerks: list[float] = []
    for (_, rate, slope, jerk), duration in zip(phases.jets, phases.duration, strict=True):
        roots = np.roots(np.trim_zeros(np.array([0.5 * jerk, slope, rate]), "f"))
        cuts = [
            float(root.real)
            for root in roots
            if abs(root.imag) < SHORTEST < root.real < duration - SHORTEST
        ]
        edges = [0.0, *sorted(cuts), duration]
        seconds += np.diff(edges).tolist()
        jerks += [jerk] * (len(edges) - 1)
    return phases_of(jet, np.array(seconds), np.array(jerks))


NOTHING = phases_of(np.zeros(3), np.zeros(0), np.zeros(0))
"""No phase."""
