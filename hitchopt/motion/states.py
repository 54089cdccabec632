"""A plan at given times: when to sample, and all that drones and vertices do there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Swarm, Team
from hitchopt.hitch.statics import cable_forces
from hitchopt.motion.motion import Motion
from hitchopt.motion.tensions import tautness
from hitchopt.trajectory import bernstein
from hitchopt.values import not_negative, positive

Array = NDArray[np.float64]

END_TOLERANCE = 1e-6
"""[s] A plan's end this close to the last regular sample is no sample of its own."""

MAX_SAMPLES = 50_000_000
"""More are refused before any memory is spent on them."""

TIME_TOLERANCE = 1e-9
"""[s] Largest distance of a time from the plan: the rounding of sums of durations."""


@dataclass(frozen=True, eq=False)
class States:
    """What drones and vertices do at some times (…).

    Attributes
    ----------
    t: (…) [s], from the plan's start.
    formed: (…) whether the hitch exists; of a swarm without cables it never does.
    positions: of the drones q0, r0, q1, r1, … (…, 2n, 3) [m], or of a swarm's d0, d1, ….
    velocities, accelerations, jerks: their derivatives (…, 2n, 3) [m/s], [m/s²], [m/s³]. Where
        pieces join, those of the later piece.
    cable_forces: (…, 2n, 3) [N], what the cable puts on each drone: what its leg (its edge, at a
        chain's end) pulls with, ``T_k`` but for friction, and down by half of the cable's weight;
        while there is no hitch, what a hanging cable pulls with. As tensions rise from zero or fall
        to it, the one passes continuously into the other (``hitchopt.motion.tensions``).
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
    vertices: Array
    vertex_velocities: Array
    legs: Array
    tensions: Array

    def thrusts(self, team: Team | Swarm) -> Array:
        """Return (…, 2n, 3) [N] the thrust vectors ``m (a + g ẑ) - cable force``."""
        upward = np.array([0.0, 0.0, GRAVITY])
        thrusts: Array = team.mass[:, None] * (self.accelerations + upward) - self.cable_forces
        return thrusts


def sample_times(duration: float, rate: float) -> Array:
    """Return (samples,) [s]: every multiple of 1/rate from 0, and the end.

    The end is left out where it is within 1e-6 s of the last multiple.

    Parameters
    ----------
    duration: of the plan [s], not negative.
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
    back = np.empty_like(order)
    back[order] = np.arange(len(order))

    def whole(name: str) -> NDArray[Any]:
        values: NDArray[Any] = np.concatenate([getattr(block, name) for block in blocks])[back]
        return values.reshape((*times.shape, *values.shape[1:]))

    states = {field.name: whole(field.name) for field in fields(States)}
    over = asked > motion.duration + TIME_TOLERANCE
    for name in ("velocities", "accelerations", "jerks", "vertex_velocities"):
        states[name][over] = 0.0
    return States(**{**states, "t": asked})


def iterate_states(motion: Motion, times: Array, size: int) -> Iterator[States]:
    """Yield the states at ``times`` (samples,) [s], ascending, in blocks of at most ``size``.

    A block lies within one piece, so that its values are one matrix product per quantity.
    """
    starts = motion.drones.breaks - motion.drones.breaks[0]
    formed, taut = motion.formed, tautness(motion)
    pulls = np.where(formed[:, None, None], motion.pulls.coefficients, 0.0)
    firsts = np.searchsorted(times, starts[1:-1], side="left")
    bounds = np.concatenate([[0], firsts, [len(times)]])
    for piece in np.flatnonzero(np.diff(bounds)):
        for first in range(bounds[piece], bounds[piece + 1], size):
            t = times[first : min(first + size, bounds[piece + 1])]
            elapsed = t - starts[piece]
            cables = bool(formed[piece]), pulls[piece], taut[piece]
            yield _states_within(motion, int(piece), t, elapsed, *cables)


def _states_within(
    motion: Motion, piece: int, t: Array, elapsed: Array, formed: bool, pulls: Array, taut: Array
) -> States:
    """Return the states at times t within a piece.

    Its cables' ``pulls`` (2n, degree + 1) and tautness ``taut`` (n, degree + 1) are given.
    """
    h = motion.drones.durations[piece]
    x = np.clip(elapsed / h, 0.0, 1.0)
    drones = motion.drones.coefficients[piece]
    velocities = bernstein.differentiate(drones) / h
    accelerations = bernstein.differentiate(velocities) / h
    jerks = bernstein.differentiate(accelerations) / h
    positions = _values(drones, x)
    p = _values(motion.vertices.coefficients[piece], x)
    forces = cable_forces(motion.team, positions, p, _values(pulls, x), _values(taut, x))
    return States(
        t,
        np.full(len(t), formed),
        positions,
        _values(velocities, x),
        _values(accelerations, x),
        _values(jerks, x),
        forces,
        p,
        _values(bernstein.differentiate(motion.vertices.coefficients[piece]) / h, x),
        _values(motion.legs.coefficients[piece], x),
        _values(motion.tensions.coefficients[piece], x),
    )


def _values(coefficients: Array, x: Array) -> Array:
    """Return (times, *shape): the polynomials (*shape, degree + 1) at x (times,)."""
    order = bernstein.degree(coefficients)
    flat = bernstein.basis(x, order) @ coefficients.reshape(-1, order + 1).T
    return flat.reshape(len(x), *coefficients.shape[:-1])
