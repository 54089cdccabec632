"""Ranges of tensions and vertices for errors that nobody knows, over a plan.

Derivatives take one linear solve with the Hessian each. At rest the energy's slope is zero for any
error p, so ``H dx = -∂slope/∂p dp``. A tension's row ``A_k`` of derivatives by the nodes is at the
same time, turned round, what a longer cable k does to the slope: ``dx = H⁻¹ A_k dL_k``. Rows of
outputs are found by the adjoint, ``Y = H⁻¹ B`` for the outputs' derivatives B by the nodes. Every
output depends on every error, so that work and memory grow with n².

To first order every tension and coordinate is linear in the errors: bounds add, standard deviations
add in squares and count three times. What is left out is measured: the hitch settles at the errors
that move some tension or vertex most, both ways, and twice the largest difference to first order
widens every range. It is infinite where no rest is found there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError
from hitchopt.geometry.vectors import length, unit
from hitchopt.motion.loads import stated_tensions
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan
from hitchopt.statics.energy import HitchEnergy
from hitchopt.statics.settle import (
    Conditions,
    Settled,
    energy_of,
    named,
    samples_of,
    settle_motion,
)
from hitchopt.values import Array, as_array, instance, not_negative

DEVIATIONS = 3.0
"""Standard deviations that a range covers: 99.7 % of normal errors."""

MARK = "sd:"
"""What a standard deviation begins with on the command line: ``sd:0.01``."""


@dataclass(frozen=True)
class ErrorSize(OneLine):
    """Size of one kind of error, alike and independent for all that it befalls.

    Parameters
    ----------
    bound: largest error; of vectors their largest length.
    deviation: standard deviation, of vectors per axis; it adds to the bound.

    Raises
    ------
    InputError: a negative number.
    """

    bound: float = 0.0
    deviation: float = 0.0

    def __post_init__(self) -> None:
        for name in ("bound", "deviation"):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))

    @classmethod
    def of(cls, key: str, given: ErrorSize | float) -> ErrorSize:
        """Return the size; a number is a bound.

        Raises
        ------
        InputError: a negative number.
        """
        return given if isinstance(given, ErrorSize) else cls(not_negative(key, given))

    @classmethod
    def parsed(cls, key: str, text: str) -> ErrorSize:
        """Return the size that a text says: ``0.01`` is a bound, ``sd:0.01`` a deviation.

        Raises
        ------
        InputError: no such text.
        """
        try:
            number = float(text.removeprefix(MARK))
        except ValueError:
            raise InputError(key, text, "a number, or sd:number", f"write {MARK}0.01") from None
        size = not_negative(key, number)
        return cls(deviation=size) if text.startswith(MARK) else cls(size)

    @property
    def words(self) -> str:
        """What it says, without a unit: ``±0.01`` or ``sd 0.01``."""
        parts = [f"±{self.bound:g}"] if self.bound or not self.deviation else []
        return " and ".join([*parts, *([f"sd {self.deviation:g}"] if self.deviation else [])])


@dataclass(frozen=True)
class Errors:
    """Errors of a hitch.

    Parameters
    ----------
    cable: of every cable's length [m].
    position: of every drone's set point, a vector [m].
    force: of every drone's force feed-forward, a vector [N].
    """

    cable: ErrorSize = ErrorSize()
    position: ErrorSize = ErrorSize()
    force: ErrorSize = ErrorSize()


@dataclass(frozen=True, eq=False)
class Gradients:
    """Derivatives of the tensions and points of a hitch at rest, o = n + 3 points of them.

    Attributes
    ----------
    cable: (o, n, 1) by the cables' lengths.
    position: (o, 2n, 3) by the drones' set points.
    force: (o, 2n, 3) by the forces on drones.
    """

    cable: Array
    position: Array
    force: Array

    @classmethod
    def of(cls, energy: HitchEnergy, x: Array) -> Gradients:
        """Return the derivatives of one sample that has settled at nodes x (1, nodes, 3) [m]."""
        law, nodes, cables = energy.law, energy.nodes, np.arange(len(energy.nodes))
        found, count = energy.linear(x), len(cables) + 3 * len(energy.points)
        seeds = np.zeros((*x.shape, count))  # outputs by nodes
        slopes = found.tensions[0].reshape(-1, 4, 3).copy()
        slopes[:, 1:3, 2] += 0.5 * law.weight  # tensions are those in the edges' middles
        for k in range(4):
            seeds[0, nodes[:, k], :, cables] += slopes[:, k]
        for k, node in enumerate(energy.points):
            seeds[0, node, :, len(cables) + 3 * k : len(cables) + 3 * k + 3] = np.eye(3)
        matrix = energy.matrix(found.forces)
        y = energy.solved(matrix, seeds)
        direct = (seeds.reshape(-1, count) - matrix @ y.reshape(-1, count)).reshape(y.shape)
        y, direct = np.moveaxis(y[0], -1, 0), np.moveaxis(direct[0], -1, 0)
        cable = np.einsum("onai,nai->on", y[:, nodes], found.pulls[0].reshape(-1, 4, 3))
        cable[cables, cables] -= found.softness[0]
        force, soft = y[:, : energy.drones], energy.stiffness[:, None]
        position = np.where(soft > 0.0, soft * force, direct[:, : energy.drones])
        return cls(cable[..., None], position, force)


SAMPLES = 25
"""Times of a plan at which ranges are computed unless others are given."""

CANDIDATES = 20
"""Times that are looked at for each of them, to leave out those without a taut hitch."""

TAUT = 0.999
"""Share of the least tension that is stated from which on a cable is taut."""

CORNERS = 4
"""Tensions, and coordinates, of widest range whose worst errors are settled at, for each time."""

REMAINDER = 2.0
"""Factor of the largest difference to first order: the corners are worst for the first order, not
for what is beyond it."""


Corner = tuple[Array, Array, Array]
"""Errors of cables (n, 1), positions and forces (2n, 3) that reach the end of a range."""


@dataclass(frozen=True, eq=False)
class Tolerance(OneLine):
    """Ranges at times (S,) of a plan.

    Attributes
    ----------
    errors: what they are for.
    settled: where the hitch rests without them, in samples (S,).
    tension_halves: (S, n) [N], half widths of the tensions' ranges, at first order.
    tension_remainders: (S,) [N], what is added to them for what is beyond first order.
    vertex_halves: (S, points, 3) [m], half widths of the vertices' ranges, at first order.
    vertex_remainders: (S,) [m]
    ellipsoids: (S, points, 3, 3) [m²], E: vertices stay within ``vᵀ E⁻¹ v ≤ 1``, at first order.
    """

    errors: Errors
    settled: Settled
    tension_halves: Array
    tension_remainders: Array
    vertex_halves: Array
    vertex_remainders: Array
    ellipsoids: Array

    @property
    def tensions(self) -> Array:
        """(S, n, 2) [N]: smallest and largest tension of every cable, not below zero."""
        half = self.tension_halves + self.tension_remainders[:, None]
        middle = self.settled.tensions
        return np.maximum(np.stack([middle - half, middle + half], axis=-1), 0.0)

    @property
    def radii(self) -> Array:
        """(S, points) [m]: how far every vertex may be from where it rests without errors."""
        longest = np.sqrt(np.linalg.eigvalsh(self.ellipsoids)[..., -1])
        return np.asarray(longest + self.vertex_remainders[:, None])

    @property
    def band(self) -> Array:
        """(S, points, 2) [m]: how far outside of its plan friction lets every vertex rest."""
        return self.settled.band

    @property
    def slack(self) -> NDArray[np.bool_]:
        """(S, n): whether a cable may be slack."""
        found: NDArray[np.bool_] = self.settled.slack | (self.tensions[..., 0] <= 0.0)
        return found

    @property
    def slack_cables(self) -> tuple[str, ...]:
        """Names of the cables that may be slack at some time."""
        return named("c", self.slack)


def tolerance(
    plan: Plan,
    t: ArrayLike | None = None,
    *,
    cable_error: ErrorSize | float = 0.0,
    position_error: ErrorSize | float = 0.0,
    force_error: ErrorSize | float = 0.0,
    **conditions: Any,
) -> Tolerance:
    """Return the range of every tension and vertex of a plan's hitch for errors of given sizes.

    Parameters
    ----------
    plan: with a hitch.
    t: (S,) [s]; by default 25 times at which its cables are drawn taut.
    cable_error: of every cable's length [m]. A number is a bound; ``ErrorSize(deviation=0.01)`` is
        a standard deviation, which counts three times.
    position_error: of every drone's set point, a vector [m].
    force_error: of every drone's force feed-forward, a vector [N].
    conditions: the keywords of ``Conditions``, without samples of their own, as for ``settle``.

    Raises
    ------
    InputError: a time without hitch, a negative size, or a wrong condition.
    UnsupportedError: a plan without a taut hitch.
    InfeasibleError: no rest is found.
    """
    instance("plan", plan, Plan)
    errors = Errors(
        ErrorSize.of("cable_error", cable_error),
        ErrorSize.of("position_error", position_error),
        ErrorSize.of("force_error", force_error),
    )
    return tolerance_of_motion(plan.motion, t, errors, Conditions(**conditions))


def tolerance_of_motion(
    motion: Motion, t: ArrayLike | None, errors: Errors, conditions: Conditions
) -> Tolerance:
    """Return the ranges of a motion's hitch; see ``tolerance``."""
    times = taut_times(motion) if t is None else np.atleast_1d(as_array(t))
    if times.ndim != 1:
        raise InputError("t", t, "one time, or a list of them", "give times [s] in one row")
    settled = settle_motion(motion, times, conditions)
    parts = [_range(motion, settled, i, errors, conditions) for i in range(len(times))]
    return Tolerance(errors, settled, *(np.stack(values) for values in zip(*parts, strict=True)))


def taut_times(motion: Motion, count: int = SAMPLES) -> Array:
    """Return at most ``count`` times [s], the first and last ones among them, of taut cables.

    While tensions rise from zero or fall to it a hitch holds little; such times are left out.

    Raises
    ------
    UnsupportedError: there are none.
    """
    times = np.linspace(0.0, motion.duration, CANDIDATES * count)
    found = np.zeros(len(times), dtype=np.bool_)
    if motion.team.has_cables:
        states = states_at(motion, times)
        starts = motion.drones.breaks - motion.drones.breaks[0]
        piece = np.clip(np.searchsorted(starts, times, "right") - 1, 0, motion.drones.pieces - 1)
        least = np.minimum(stated_tensions(motion)[..., 0], motion.team.tension)
        found = states.formed & np.all(states.tensions >= TAUT * least[piece], axis=-1)
        found &= ~np.any(states.borne > 0.0, axis=-1)  # statics do not know of objects
    taut = times[found]
    if not len(taut):
        raise UnsupportedError("a plan without a taut hitch has no tensions that could differ")
    return taut[np.unique(np.linspace(0, len(taut) - 1, count).round().astype(np.intp))]


def _range(
    motion: Motion, settled: Settled, i: int, errors: Errors, conditions: Conditions
) -> tuple[Any, ...]:
    """Return the arrays of a Tolerance at one time, in order."""
    energy, _ = energy_of(motion, conditions, samples_of(motion, settled.t[i], conditions)[1])
    clasps = settled.vertices[i, motion.team.layout.clasps]
    rows = Gradients.of(energy, np.concatenate([settled.drones[i], clasps])[None])
    halves, n = _halves(rows, errors), motion.team.robots
    widest = [*np.argsort(-halves[:n])[:CORNERS], *n + np.argsort(-halves[n:])[:CORNERS]]
    corners = [_corner(rows, int(o), errors) for o in widest]
    pulled, moved = _remainders(motion, settled, i, conditions, energy.law.least[0], rows, corners)
    return halves[:n], pulled, halves[n:].reshape(-1, 3), moved, _ellipsoids(rows, n, errors)


def _kinds(rows: Gradients, errors: Errors) -> tuple[tuple[Array, ErrorSize], ...]:
    """Return the gradients (o, items, 1 or 3) for every kind of error, and its size."""
    return (rows.cable, errors.cable), (rows.position, errors.position), (rows.force, errors.force)


def _spread(rows: Gradients, errors: Errors) -> Array:
    """Return the standard deviations (o,) of outputs."""
    kinds = _kinds(rows, errors)
    squares = sum(np.sum((size.deviation * row) ** 2, axis=(1, 2)) for row, size in kinds)
    return np.asarray(np.sqrt(squares))


def _halves(rows: Gradients, errors: Errors) -> Array:
    """Return the half widths (o,) of the ranges of outputs."""
    kinds = _kinds(rows, errors)
    bounds = sum(size.bound * np.sum(length(row), axis=-1) for row, size in kinds)
    return np.asarray(bounds + DEVIATIONS * _spread(rows, errors))


def _corner(rows: Gradients, o: int, errors: Errors) -> Corner:
    """Return the errors that reach the end of an output's range."""
    one = Gradients(rows.cable[o : o + 1], rows.position[o : o + 1], rows.force[o : o + 1])
    spread = float(_spread(one, errors)[0]) or 1.0
    cable, position, force = (
        size.bound * unit(row[0]) + DEVIATIONS * size.deviation**2 * row[0] / spread
        for row, size in _kinds(one, errors)
    )
    return cable, position, force


def _ellipsoids(rows: Gradients, n: int, errors: Errors) -> Array:
    """Return (points, 3, 3) [m²] ellipsoids that hold all displacements of points.

    The sum of ellipsoids ``E_j`` lies within ``(Σ √tr E_j) Σ E_j/√tr E_j``, of all such the one
    with the least sum of squared axes. Every bound is one of them, all deviations are another.
    """
    shapes, spread = [], np.zeros((1, 1, 1, 1))
    for row, size in _kinds(rows, errors):
        J = row[n:].reshape(-1, 3, *row.shape[1:])  # (points, 3, items, 1 or 3)
        squares = np.einsum("pijc,pkjc->pjik", J, J)
        shapes.append(size.bound**2 * squares)
        spread = spread + (DEVIATIONS * size.deviation) ** 2 * np.sum(squares, 1, keepdims=True)
    each = np.concatenate([*shapes, spread], axis=1)
    roots = np.sqrt(np.trace(each, axis1=-2, axis2=-1))
    shares = np.sum(roots, axis=1, keepdims=True) / np.where(roots > 0.0, roots, np.inf)
    return np.asarray(np.sum(shares[..., None, None] * each, axis=1))


def _remainders(
    motion: Motion,
    settled: Settled,
    i: int,
    conditions: Conditions,
    least: Array,
    rows: Gradients,
    corners: list[Corner],
) -> tuple[float, float]:
    """Return what tensions [N] and vertices [m] differ by from first order, times REMAINDER."""
    both = [(sign * c, sign * p, sign * f) for c, p, f in corners for sign in (1.0, -1.0)]
    cable, position, force = (np.stack(part) for part in zip(*both, strict=True))
    team = motion.team
    added = {
        "cable_length": conditions.lengths(team) + cable[..., 0],
        "offsets": conditions.errors("offsets", team) + position,
        "forces": conditions.errors("forces", team) + force,
    }
    try:
        found = settle_motion(motion, settled.t[i], replace(conditions, friction=0.0, **added))
    except InfeasibleError:  # so far from where it was that first order says nothing
        return np.inf, np.inf
    sides = zip((rows.cable, rows.position, rows.force), (cable, position, force), strict=True)
    change = sum(np.einsum("ojc,sjc->so", row, error) for row, error in sides)
    pulled, moved = np.split(np.asarray(change), [team.robots], axis=1)
    expected = np.maximum(settled.tensions[i] + pulled, least)
    vertices = settled.vertices[i] + moved.reshape(len(both), -1, 3)
    tension = float(np.max(np.abs(found.tensions - expected)))
    return REMAINDER * tension, REMAINDER * float(np.max(length(found.vertices - vertices)))
