"""Samples of a plan: their times, and the states of drones and vertices at them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Swarm, Team
from hitchopt.hitch.statics import cable_force_rates, cable_forces
from hitchopt.motion.motion import Motion
from hitchopt.motion.tensions import tautness
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, not_negative, positive

END_TOLERANCE = 1e-6
"""Distance of a plan's end from the last regular sample [s] below which it is no sample."""

MAX_SAMPLES = 50_000_000
"""Largest number of samples; more are refused before any memory is spent on them."""

TIME_TOLERANCE = 1e-9
"""Distance by which a time may lie outside the plan [s]: the rounding of sums of durations."""


AT_REST = (
    "velocities",
    "accelerations",
    "jerks",
    "cable_force_rates",
    "body_rates",
    "vertex_velocities",
)
"""Fields of states that are zero after a plan's end."""


@dataclass(frozen=True, eq=False)
class States:
    """States of drones and vertices at some times (…).

    Attributes
    ----------
    t: (…) [s], from the plan's start.
    formed: (…) whether the hitch exists; of a swarm without cables it never does.
    positions: of the drones q0, r0, q1, r1, … (…, 2n, 3) [m], or of a swarm's d0, d1, ….
    velocities, accelerations, jerks: their derivatives (…, 2n, 3) [m/s], [m/s²], [m/s³]. Where
        pieces join, those of the later piece.
    cable_forces: (…, 2n, 3) [N], the force of the cable on each drone: the pull of its leg (its
        edge, at a chain's end), ``T_k`` but for friction, and half of the cable's weight; while
        there is no hitch, the pull of a hanging cable. As tensions rise from zero or fall
        to it, the one passes continuously into the other (``hitchopt.motion.tensions``).
    cable_force_rates: (…, 2n, 3) [N/s], their derivatives by time.
    quaternions: (…, 2n, 4), w, x, y, z: attitude of each drone with yaw 0, from its axes to the
        world's; its z axis points along the thrust (``hitchopt.model.attitude``).
    body_rates: (…, 2n, 3) [rad/s], angular velocity of that attitude about the drone's own axes.
    vertices, vertex_velocities: (…, points, 3) [m], [m/s]; n points of a closed hitch, n + 1 of a
        chain. These, legs and tensions mean something only where the hitch is formed.
    legs: (…, n, 2) [m], ``d_k`` and ``e_k``.
    tensions: (…, n) [N].
    """

    t: Array
    formed: NDArray[np.bool_]
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    cable_forces: Array
    cable_force_rates: Array
    quaternions: Array
    body_rates: Array
    vertices: Array
    vertex_velocities: Array
    legs: Array
    tensions: Array

    def thrusts(self, team: Team | Swarm) -> Array:
        """Return (…, 2n, 3) [N] the thrust vectors ``m (a + g ẑ) - cable force``."""
        return thrusts_of(team, self.accelerations, self.cable_forces)

    def thrust_rates(self, team: Team | Swarm) -> Array:
        """Return (…, 2n, 3) [N/s] the derivatives of the thrust vectors by time."""
        rates: Array = team.mass[:, None] * self.jerks - self.cable_force_rates
        return rates


def thrusts_of(team: Team | Swarm, accelerations: Array, cable_forces: Array) -> Array:
    """Return the thrust vectors ``m (a + g ẑ) - cable force``, (…, 2n, 3) [N]."""
    upward = np.array([0.0, 0.0, GRAVITY])
    thrusts: Array = team.mass[:, None] * (accelerations + upward) - cable_forces
    return thrusts


def sample_times(duration: float, rate: float) -> Array:
    """Return (samples,) [s]: every multiple of 1/rate from 0, and the end.

    The end is left out where it is within 1e-6 s of the last multiple.

    Parameters
    ----------
    duration: duration of the plan [s], not negative.
    rate: [Hz], positive.

    Raises
    ------
    InputError: a number out of its range, or more than MAX_SAMPLES samples.
    """
    duration = not_negative("duration", duration)
    rate = positive("rate", rate)
    if duration * rate > MAX_SAMPLES:
        raise InputError(
            "rate", rate, f"at most {MAX_SAMPLES / duration:g} Hz", "ask for fewer samples"
        )
    times: Array = np.arange(int(duration * rate) + 2) / rate
    times = times[times <= duration]
    if duration - times[-1] > END_TOLERANCE:
        times = np.append(times, duration)
    return times


def states_at(motion: Motion, t: ArrayLike) -> States:
    """Return the states at times t (…) [s], at least one, counted from the plan's start.

    After its end a plan stays at rest where it ended.

    Raises
    ------
    InputError: no time, a time before the start, or one that is not finite.
    """
    asked = np.asarray(t, dtype=np.float64)
    if asked.size == 0 or not np.all((asked >= -TIME_TOLERANCE) & np.isfinite(asked)):
        raise InputError("t", t, "finite times from 0 s on", "count from the plan's start")
    times = np.minimum(asked, motion.duration)
    order = np.argsort(times, axis=None, kind="stable")
    blocks = list(iterate_states(motion, times.ravel()[order], times.size))
    back = np.argsort(order)
    states: dict[str, Any] = {}
    for field in fields(States):
        values = np.concatenate([getattr(block, field.name) for block in blocks])[back]
        states[field.name] = values.reshape((*times.shape, *values.shape[1:]))
    over = asked > motion.duration + TIME_TOLERANCE
    for name in AT_REST:
        states[name][over] = 0.0
    return States(**{**states, "t": asked})


def iterate_states(motion: Motion, times: Array, size: int) -> Iterator[States]:
    """Yield the states at ``times`` (samples,) [s], ascending, in blocks of at most ``size``.

    A block lies within one piece, so that its values are one matrix product per quantity.
    """
    from hitchopt.model.evaluation import attitudes  # casadi takes a while to import

    starts = motion.drones.breaks - motion.drones.breaks[0]
    formed, taut, p = motion.formed, tautness(motion), motion.vertices.coefficients
    pulls = np.where(formed[:, None, None], motion.pulls.coefficients, 0.0)
    firsts = np.searchsorted(times, starts[1:-1], side="left")
    bounds = np.concatenate([[0], firsts, [len(times)]])
    for piece in np.flatnonzero(np.diff(bounds)):
        h = motion.drones.durations[piece]
        drones = [motion.drones.coefficients[piece]]
        for _ in range(3):
            drones.append(bernstein.differentiate(drones[-1]) / h)
        for first in range(bounds[piece], bounds[piece + 1], size):
            t = times[first : min(first + size, bounds[piece + 1])]
            x = np.clip((t - starts[piece]) / h, 0.0, 1.0)
            positions, velocities, accelerations, jerks = (_values(c, x) for c in drones)
            values = (positions, *(_values(part[piece], x) for part in (p, pulls, taut)))
            rates = (
                velocities,
                *(
                    _values(bernstein.differentiate(part[piece]) / h, x)
                    for part in (p, pulls, taut)
                ),
            )
            forces = cable_forces(motion.team, *values)
            force_rates = cable_force_rates(motion.team, values, rates)
            attitude = attitudes(
                thrusts_of(motion.team, accelerations, forces),
                motion.team.mass[:, None] * jerks - force_rates,
            )
            yield States(
                t,
                np.full(len(t), formed[piece]),
                positions,
                velocities,
                accelerations,
                jerks,
                forces,
                force_rates,
                attitude.quaternions,
                attitude.body_rates,
                values[1],
                rates[1],
                _values(motion.legs.coefficients[piece], x),
                _values(motion.tensions.coefficients[piece], x),
            )


def _values(coefficients: Array, x: Array) -> Array:
    """Return the polynomials (*shape, degree + 1) at x (times,), as (times, *shape)."""
    order = bernstein.degree(coefficients)
    flat = bernstein.basis(x, order) @ coefficients.reshape(-1, order + 1).T
    return flat.reshape(len(x), *coefficients.shape[:-1])
