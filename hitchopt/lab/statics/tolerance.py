"""Ranges of tensions and vertices for unknown errors, over a plan.

Sensitivities are those of ``hitchopt.hitch.rest_errors``. Every output depends on every error, so
that time and memory grow with n².

To first order, tensions and coordinates are linear in the errors: bounds add, standard deviations
add in squares and count three times. The remainder is estimated: the hitch settles with the errors
that change some tension or vertex most, in both directions, and twice the largest difference to
first order is added to every range. It is infinite if there is no rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, InputError, OneLine
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.energy import energy_of
from hitchopt.hitch.rest_errors import REMAINDER_FACTOR, enclosing_ellipsoids, responses
from hitchopt.lab.statics.equilibrium import (
    SAMPLED,
    Equilibrium,
    conditions_of,
    equilibrium,
    motion_of,
    samples_of,
)
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.values import SCALAR, WORD, Array, as_array, nonnegative
from hitchopt.values.fields import Key, Kind

DEVIATIONS = 3.0  # Standard deviations that a range covers: 99.7 % of normal errors
PREFIX = "sd:"  # Prefix of a standard deviation on the command line: sd:0.01

SAMPLES = 25  # Default number of times at which ranges are computed
CANDIDATES = 20  # Number of candidate times for each of these

CORNERS = 4  # Tensions and coordinates of widest range whose worst-case errors are evaluated


@dataclass(frozen=True)
class ErrorSize(OneLine):
    """Size of one kind of error, equal and independent for all cables or drones.

    Parameters
    ----------
    bound: largest error, for vectors the largest length.
    deviation: standard deviation, for vectors per axis, in addition to the bound.

    Raises
    ------
    InputError: a negative number.
    """

    bound: float = 0.0
    deviation: float = 0.0

    def __post_init__(self) -> None:
        for name in ("bound", "deviation"):
            object.__setattr__(self, name, nonnegative(name, getattr(self, name)))

    @classmethod
    def of(cls, key: str, given: ErrorSize | float | str) -> ErrorSize:
        """Return the size; 0.01 and ``"0.01"`` are bounds, ``"sd:0.01"`` is a deviation.

        InputError for a negative number or an invalid text.
        """
        if isinstance(given, ErrorSize):
            return given
        try:
            size = float(given.removeprefix(PREFIX)) if isinstance(given, str) else given
        except ValueError:
            raise InputError(key, given, ERROR_SIZE.bound, f"write {PREFIX}0.01") from None
        name = "deviation" if isinstance(given, str) and given.startswith(PREFIX) else "bound"
        return cls(**{name: nonnegative(key, size)})


Sizes = dict[str, ErrorSize]  # By "cable", "position" and "force"

ERROR_SIZE = Kind((SCALAR, WORD), ErrorSize.of, {}, accepted=(SCALAR, f"{PREFIX}number"))

ERROR_KEYS = {
    "cable": Key(ERROR_SIZE, "Error of cable lengths [m]", default=0.01),
    "position": Key(ERROR_SIZE, "Error of drones' positions [m]", default=0.02),
    "force": Key(ERROR_SIZE, "Error of the force feed-forward [N]", default=0.0),
}
"""Kinds of errors; defaults are bounds for cables cut to a centimetre, and motion capture."""


@dataclass(frozen=True, eq=False)
class Tolerance(OneLine):
    """Ranges at times (S,) of a plan.

    Attributes
    ----------
    errors: sizes of errors, of ``cable``, ``position`` and ``force``.
    equilibrium: rest of the hitch without errors, in samples (S,).
    tension_halves: (S, n) [N], half widths of the tensions' ranges, to first order.
    tension_remainders: (S,) [N], additional half widths beyond first order.
    vertex_halves: (S, points, 3) [m], half widths of the vertices' ranges, to first order.
    vertex_remainders: (S,) [m], additional half widths beyond first order.
    ellipsoids: (S, points, 3, 3) [m²], E: vertices stay within ``vᵀ E⁻¹ v ≤ 1``, to first order.
    """

    errors: Sizes
    equilibrium: Equilibrium
    tension_halves: Array
    tension_remainders: Array
    vertex_halves: Array
    vertex_remainders: Array
    ellipsoids: Array

    @property
    def tensions(self) -> Array:
        """Smallest and largest tension of every cable, nonnegative (S, n, 2) [N]."""
        half = self.tension_halves + self.tension_remainders[:, None]
        middle = self.equilibrium.tensions
        return np.maximum(np.stack([middle - half, middle + half], axis=-1), 0.0)

    @property
    def radii(self) -> Array:
        """Largest distance of every vertex from its rest without errors (S, points) [m]."""
        longest = np.sqrt(np.linalg.eigvalsh(self.ellipsoids)[..., -1])
        return np.asarray(longest + self.vertex_remainders[:, None])

    @property
    def band(self) -> Array:
        """Range of outward displacements of vertices, ``Equilibrium.band`` (S, points, 2) [m]."""
        return self.equilibrium.band

    @property
    def slack_cables(self) -> tuple[str, ...]:
        """Names of the cables that may be slack at some time."""
        slack = self.equilibrium.slack | (self.tensions[..., 0] <= 0.0)
        robots = np.array(self.equilibrium.team.labels)[slack.any(axis=0)]
        return tuple(f"c{k}" for k in sorted(robots.tolist()))


def tolerance(
    plan: Plan | Motion,
    t: ArrayLike | None = None,
    *,
    cable_error: ErrorSize | float | str = 0.0,
    position_error: ErrorSize | float | str = 0.0,
    force_error: ErrorSize | float | str = 0.0,
    **conditions: Any,
) -> Tolerance:
    """Return the range of every tension and vertex of a plan's hitch for errors of given sizes.

    Parameters
    ----------
    plan: with a hitch; or its motion.
    t: (S,) [s]; by default 25 times at which its cables are taut.
    cable_error: of every cable's length [m]. A number is a bound; ``ErrorSize(deviation=0.01)`` is
        a standard deviation, which counts three times.
    position_error: of every drone's setpoint, a vector [m].
    force_error: of every drone's force feed-forward, a vector [N].
    conditions: those of ``equilibrium``, without samples of their own.

    Raises
    ------
    InputError: a time without a hitch, a negative size, or a wrong condition.
    UnsupportedError: a plan without a taut hitch, or of several teams.
    InfeasibleError: there is no rest.
    """
    motion = motion_of(plan)
    sizes = {"cable": cable_error, "position": position_error, "force": force_error}
    errors = {name: ErrorSize.of(f"{name}_error", size) for name, size in sizes.items()}
    times = taut_times(motion) if t is None else np.atleast_1d(as_array("t", t))
    if times.ndim != 1 or times.size == 0:
        raise InputError(
            "t", t, "one time, or a list of them", "pass a one-dimensional array of times [s]"
        )
    rest = equilibrium(motion, times, **conditions)
    ranges = [_ranges(motion, rest, i, errors, conditions) for i in range(len(times))]
    return Tolerance(errors, rest, *(np.stack(values) for values in zip(*ranges, strict=True)))


def taut_times(motion: Motion, count: int = SAMPLES) -> Array:
    """Return at most ``count`` times [s] of taut cables, including the first and the last.

    Times at which tensions rise from zero or fall to zero are excluded. UnsupportedError: there are
    no other times.
    """
    if not motion.team.has_cables:
        raise unsupported(Feature.STATICS, Neighbour.SINGLE_DRONES)
    times: Array = np.linspace(0.0, motion.duration, CANDIDATES * count)
    states = states_at(motion, times)
    taut = states.taut(motion.team.tension)
    unloaded = ~np.any(states.load_share > 0.0, axis=-1)  # statics do not model objects
    times = times[taut & unloaded]
    if not len(times):
        raise unsupported(Feature.STATICS, Neighbour.FREE_CABLES)
    return times[np.unique(np.linspace(0, len(times) - 1, count).round().astype(np.intp))]


class Ranges(NamedTuple):
    """Ranges at one time, as in ``Tolerance``, in the same order."""

    tension_halves: Array
    tension_remainder: float
    vertex_halves: Array
    vertex_remainder: float
    ellipsoids: Array


def _ranges(
    motion: Motion, rest: Equilibrium, i: int, errors: Sizes, conditions: dict[str, Any]
) -> Ranges:
    """Return the ranges at the i-th time of a hitch at rest.

    Outputs are n tensions and the coordinates of vertices; errors are those of n cables and of 2n
    positions and 2n forces of drones.
    """
    n = motion.team.robots
    resolved = conditions_of(motion.team, **conditions)
    energy = energy_of(motion.team, resolved, samples_of(motion, rest.t[i], resolved)[1])
    clasps = rest.vertices[i, motion.team.layout.clasps]
    nodes = np.concatenate([rest.drones[i], clasps])
    slopes = responses(energy, nodes[None])[:, : 5 * n]  # (outputs, 5n, 3)
    sizes = np.array([[size.bound, DEVIATIONS * size.deviation] for size in errors.values()])
    bounds, deviations = np.repeat(sizes, [n, 2 * n, 2 * n], axis=0).T
    spreads = np.linalg.norm(slopes * deviations[:, None], axis=(1, 2))
    halves = length(slopes) @ bounds + spreads

    widest_tensions = np.argsort(-halves[:n])[:CORNERS]
    widest_coordinates = n + np.argsort(-halves[n:])[:CORNERS]
    widest = np.append(widest_tensions, widest_coordinates)
    worst_errors = _worst_errors(slopes[widest], bounds, deviations, spreads[widest])
    tension_remainder = vertex_remainder = np.inf
    settled = _settled(motion, rest.t[i], worst_errors, conditions, resolved)
    if settled is not None:
        changes = np.einsum("oji,sji->so", slopes, worst_errors)
        tensions = np.maximum(rest.tensions[i] + changes[:, :n], energy.slack_tension[0])
        vertices = rest.vertices[i] + changes[:, n:].reshape(len(changes), -1, 3)
        tension_remainder = REMAINDER_FACTOR * float(np.max(np.abs(settled.tensions - tensions)))
        vertex_remainder = REMAINDER_FACTOR * float(np.max(length(settled.vertices - vertices)))
    return Ranges(
        halves[:n],
        tension_remainder,
        halves[n:].reshape(-1, 3),
        vertex_remainder,
        _ellipsoids(slopes[n:], bounds, deviations),
    )


def _ellipsoids(slopes: Array, bounds: Array, deviations: Array) -> Array:
    """Return the ellipsoids (points, 3, 3) [m²] of vertices.

    Every bounded error moves a vertex within one ellipsoid, all deviations within another one.
    ``slopes`` (3 points, 5n, 3) are those of coordinates in the errors.
    """
    jacobians = slopes.reshape(-1, 3, *slopes.shape[1:])
    squares = np.einsum("pijc,pkjc->jpik", jacobians, jacobians)
    of_bounds = bounds[:, None, None, None] ** 2 * squares
    of_deviations = np.tensordot(deviations**2, squares, 1)[None]
    return enclosing_ellipsoids(np.concatenate([of_bounds, of_deviations]))


def _worst_errors(slopes: Array, bounds: Array, deviations: Array, spreads: Array) -> Array:
    """Return the errors (2k, 5n, 3) at which each of k outputs is largest, then smallest.

    ``slopes`` (k, 5n, 3) are those of the outputs, ``spreads`` (k,) their parts of deviations.
    """
    divisors = np.where(spreads > 0.0, spreads, 1.0)[:, None, None]
    of_bounds = bounds[:, None] * unit(slopes)
    largest = of_bounds + deviations[:, None] ** 2 * slopes / divisors
    return np.concatenate([largest, -largest])


def _settled(
    motion: Motion,
    t: float,
    errors: Array,
    conditions: dict[str, Any],
    resolved: dict[str, Any],
) -> Equilibrium | None:
    """Return the hitch at rest with errors (s, 5n, 3), without friction; None without a rest."""
    n = motion.team.robots
    cable_length, offsets, forces = np.split(errors, [n, 3 * n], axis=1)
    parts = (cable_length[..., 0], offsets, forces)
    with_errors = {name: resolved[name] + part for name, part in zip(SAMPLED, parts, strict=True)}
    try:
        return equilibrium(motion, t, **(conditions | with_errors | {"friction": 0.0}))
    except InfeasibleError:  # errors are too large for first order
        return None
