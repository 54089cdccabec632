"""Ranges of tensions and vertices for errors that nobody knows, over a plan.

Derivatives take one linear solve with the Hessian each. At rest the energy's slope is zero for any
error p, so ``H dx = -∂slope/∂p dp``. A tension's row ``A_k`` of derivatives by the nodes is at the
same time, turned round, what a longer cable k does to the slope: ``dx = H⁻¹ A_k dL_k``. Rows of
outputs are found by the adjoint, ``Y = H⁻¹ B`` for the outputs' derivatives B by the nodes, block
by block: every output depends on every error, so that the work grows with n², the memory with n.

To first order every tension and coordinate is linear in the errors: bounds add, standard deviations
add in squares and count three times. What is left out is measured: the hitch settles at the errors
that move some tension or vertex most, both ways, and twice the largest difference to first order
widens every range. It is infinite where no rest is found there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_array

from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError
from hitchopt.motion.loads import stated_tensions
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan
from hitchopt.statics.energy import (
    LEAST_STIFFNESS,
    MIDDLES,
    Factor,
    HitchEnergy,
    Index,
    add_at_nodes,
)
from hitchopt.statics.settle import (
    Conditions,
    Settled,
    energy_of,
    hitched_states,
    named,
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


BLOCK = 48
"""Outputs that are solved for at once."""


@dataclass(frozen=True, eq=False)
class Gradients:
    """Derivatives of some outputs, o of them, in S samples.

    Attributes
    ----------
    cable: (S, o, n) by the cables' lengths.
    position: (S, o, 2n, 3) by the drones' set points.
    force: (S, o, 2n, 3) by the forces on drones.
    """

    cable: Array
    position: Array
    force: Array


@dataclass(frozen=True, eq=False)
class Response:
    """First-order response of a hitch that has settled at nodes x (S, nodes, 3)."""

    energy: HitchEnergy
    x: Array

    @cached_property
    def _cables(self) -> tuple[Array, Array]:
        """Slopes of T by its cable's nodes (S, n, 4, 3), and by its length turned round (S, n)."""
        spans, law = self.energy.spans(self.x), self.energy.law
        T = law.tensions(spans)
        shorter = law.length_slopes(spans, T)
        along = shorter[..., None, None] * self.energy.length_slopes(spans, T)
        return along, shorter

    @cached_property
    def _tensions(self) -> Array:
        """Slopes (S, n, 4, 3) of the tensions in the edges' middles, by their cables' nodes."""
        slopes = self._cables[0].copy()
        slopes[..., 2] += self.energy.law.weight * MIDDLES[1]
        return slopes

    @cached_property
    def _hessian(self) -> tuple[csc_array, Factor]:
        blocks = self.energy.blocks(self.x)
        shape = (len(self.x), 3 * self.energy.rigging.count)
        diagonal = np.broadcast_to(self.energy.diagonal + LEAST_STIFFNESS, shape)
        rigging = self.energy.rigging
        return rigging.matrix(blocks, diagonal), rigging.factor(blocks, diagonal)

    def _times_hessian(self, nodes: Array) -> Array:
        """Return H times displacements (S, nodes, 3, o)."""
        flat = nodes.reshape(-1, nodes.shape[-1])
        return np.asarray(self._hessian[0] @ flat).reshape(nodes.shape)

    def gradients_of_tensions(self, cables: Index) -> Gradients:
        """Return the gradients of the tensions of some cables (o,) [N/m], [N/N]."""
        along, shorter = self._tensions, self._cables[1]
        seeds = np.zeros((*self.x.shape, len(cables)))
        nodes = self.energy.rigging.nodes[cables]
        for i, row in enumerate(nodes.T):  # the four nodes of a cable
            seeds[:, row, :, np.arange(len(cables))] += np.moveaxis(along[:, cables, i], 1, 0)
        found = self._adjoint(seeds)
        found.cable[:, np.arange(len(cables)), cables] -= shorter[:, cables]
        return found

    def gradients_of_points(self, points: Index) -> Gradients:
        """Return the gradients of points' coordinates, o = 3 for each of them, in order."""
        seeds = np.zeros((*self.x.shape, 3 * len(points)))
        nodes = np.repeat(self.energy.rigging.points[points], 3)
        axes = np.tile(np.arange(3), len(points))
        seeds[:, nodes, axes, np.arange(3 * len(points))] = 1.0
        return self._adjoint(seeds)

    def blocks(self, count: int, each: int) -> Iterator[Index]:
        """Give the indices of ``count`` items, each of them ``each`` outputs, in blocks."""
        size = max(1, BLOCK // each)
        for first in range(0, count, size):
            yield np.arange(first, min(first + size, count))

    def _adjoint(self, seeds: Array) -> Gradients:
        rigging, drones = self.energy.rigging, self.energy.rigging.drones
        found = self._hessian[1].solve(seeds)
        along, _ = self._cables
        cable = np.einsum("snaio,snai->son", found[:, rigging.nodes], along)
        soft = rigging.free[:drones]
        force = np.moveaxis(found[:, :drones], 3, 1)
        position = np.where(soft, self.energy.stiffness, 0.0)[:, None] * force
        if not np.all(soft):  # a drone that is held moves its node itself
            direct = (seeds - self._times_hessian(found))[:, :drones]
            position = np.where(soft[:, None], position, np.moveaxis(direct, 3, 1))
        return Gradients(cable, position, force)

    def to(self, cable: Array, position: Array, force: Array) -> tuple[Array, Array]:
        """Return the changes of nodes (o, nodes, 3) [m] and tensions (o, n) [N] of one sample.

        Parameters
        ----------
        cable: (o, n) [m], changes of the lengths.
        position, force: (o, 2n, 3) [m], [N], changes of set points and forces on drones.
        """
        rigging, drones = self.energy.rigging, self.energy.rigging.drones
        along, shorter = self._cables
        soft = rigging.free[:drones, None]
        held = np.zeros((len(cable), *self.x.shape[1:]))
        held[:, :drones] = np.where(soft, 0.0, position)
        stiffness = np.where(soft, self.energy.stiffness[:, None], 0.0)
        pushed = np.zeros(held.shape)
        pushed[:, :drones] = np.where(soft, stiffness * position + force, 0.0)
        add_at_nodes(pushed, rigging.nodes, cable[..., None, None] * along)
        columns = np.moveaxis(held, 0, 2)[None]
        right = np.moveaxis(pushed, 0, 2)[None] - self._times_hessian(columns)
        moved = np.moveaxis((columns + self._hessian[1].solve(right))[0], 2, 0)
        tensions = np.einsum("snai,nai->sn", moved[:, rigging.nodes], self._tensions[0])
        return moved, tensions - shorter * cable


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


Corner = tuple[float, Array, Array, Array]
"""Half width of a range, and the errors of cables, positions and forces that reach its end."""


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
    response = _response(motion, settled, i, conditions)
    layout = motion.team.layout
    worst: list[Corner] = []
    tensions, halves, ellipsoids = [], [], []
    for cables in response.blocks(layout.robots, 1):
        rows = response.gradients_of_tensions(cables)
        half = _halves(rows, errors)
        tensions.append(half)
        worst += _corners(rows, half, errors)
    corners, worst = _widest(worst), []
    for points in response.blocks(layout.points, 3):
        rows = response.gradients_of_points(points)
        half = _halves(rows, errors)
        halves.append(half.reshape(-1, 3))
        ellipsoids.append(_ellipsoids(rows, errors))
        worst += _corners(rows, half, errors)
    corners += _widest(worst)
    pulled, moved = _remainders(motion, settled, i, conditions, response, corners)
    found = (np.concatenate(parts) for parts in (tensions, halves, ellipsoids))
    tension, vertex, ellipsoid = found
    return tension, pulled, vertex, moved, ellipsoid


def _widest(corners: list[Corner]) -> list[Corner]:
    return sorted(corners, key=lambda corner: -corner[0])[:CORNERS]


def _response(motion: Motion, settled: Settled, i: int, conditions: Conditions) -> Response:
    states = hitched_states(motion, settled.t[i : i + 1])
    given = states.positions, states.vertices, states.tensions, states.cable_forces
    energy, _ = energy_of(motion, conditions, *given, *_errors_of(motion, conditions))
    clasps = settled.vertices[i : i + 1, motion.team.layout.clasps]
    return Response(energy, np.concatenate([settled.drones[i : i + 1], clasps], axis=1))


def _errors_of(motion: Motion, conditions: Conditions) -> tuple[Array, Array, Array]:
    """Return the lengths, offsets and forces of conditions that are the same at all times."""
    team = motion.team
    return (
        conditions.lengths(team)[None],
        conditions.errors("offsets", team)[None],
        conditions.errors("forces", team)[None],
    )


def _kinds(rows: Gradients, errors: Errors) -> tuple[tuple[Array, ErrorSize], ...]:
    """Return the gradients (o, items, 1 or 3) for every kind of error, and its size."""
    sizes = errors.cable, errors.position, errors.force
    parts = rows.cable[0, ..., None], rows.position[0], rows.force[0]
    return tuple(zip(parts, sizes, strict=True))


def _halves(rows: Gradients, errors: Errors) -> Array:
    """Return the half widths (o,) of the ranges of outputs."""
    bound: Array = np.zeros(rows.cable.shape[1])
    square: Array = np.zeros(rows.cable.shape[1])
    for row, size in _kinds(rows, errors):
        lengths = np.linalg.norm(row, axis=-1)
        bound += size.bound * np.sum(lengths, axis=-1)
        square += (size.deviation * lengths**2 * size.deviation).sum(axis=-1)
    return bound + DEVIATIONS * np.sqrt(square)


def _corners(rows: Gradients, halves: Array, errors: Errors) -> list[Corner]:
    """Return, of the widest ranges, the half width and the errors that reach its end."""
    kinds = _kinds(rows, errors)
    spread = np.sqrt(sum(np.sum((size.deviation * row) ** 2, axis=(1, 2)) for row, size in kinds))
    corners = []
    for o in np.argsort(-halves)[:CORNERS]:
        parts = []
        for row, size in kinds:
            lengths = np.linalg.norm(row[o], axis=-1, keepdims=True)
            at_bound = size.bound * row[o] / np.where(lengths > 0.0, lengths, 1.0)
            normal = DEVIATIONS * size.deviation**2 * row[o] / (spread[o] or 1.0)
            parts.append(at_bound + normal)
        corners.append((float(halves[o]), parts[0][..., 0], parts[1], parts[2]))
    return corners


def _ellipsoids(rows: Gradients, errors: Errors) -> Array:
    """Return (points, 3, 3) [m²] ellipsoids that hold all displacements of points.

    The sum of ellipsoids ``E_j`` lies within ``(Σ √tr E_j) Σ E_j/√tr E_j``, of all such the one
    with the least sum of squared axes. Every bound is one of them, all deviations are another.
    """
    count = rows.cable.shape[1] // 3
    total, weighted = np.zeros(count), np.zeros((count, 3, 3))
    spread = np.zeros((count, 3, 3))
    for row, size in _kinds(rows, errors):
        J = row.reshape(count, 3, *row.shape[1:])  # (points, 3, items, 1 or 3)
        squares = np.einsum("pijc,pkjc->pjik", J, J)
        roots = np.sqrt(np.trace(squares, axis1=-2, axis2=-1))
        total += size.bound * np.sum(roots, axis=-1)
        share = size.bound * np.where(roots > 0.0, 1.0 / np.where(roots > 0.0, roots, 1.0), 0.0)
        weighted += np.einsum("pj,pjik->pik", share, squares)
        spread += (DEVIATIONS * size.deviation) ** 2 * np.sum(squares, axis=1)
    root = np.sqrt(np.trace(spread, axis1=-2, axis2=-1))
    weighted += spread / np.where(root > 0.0, root, 1.0)[:, None, None]
    return np.asarray((total + root)[:, None, None] * weighted)


def _remainders(
    motion: Motion,
    settled: Settled,
    i: int,
    conditions: Conditions,
    response: Response,
    corners: list[Corner],
) -> tuple[float, float]:
    """Return what tensions [N] and vertices [m] differ by from first order, times REMAINDER."""
    both = [(sign * c, sign * p, sign * f) for _, c, p, f in corners for sign in (1.0, -1.0)]
    cable, position, force = (np.stack(part) for part in zip(*both, strict=True))
    lengths, offsets, forces = _errors_of(motion, conditions)
    added = {"cable_length": lengths + cable, "offsets": offsets + position}
    wrong = replace(conditions, **added, forces=forces + force, friction=0.0)
    try:
        found = settle_motion(motion, settled.t[i], wrong)
    except InfeasibleError:  # so far from where it was that first order says nothing
        return np.inf, np.inf
    moved, pulled = response.to(cable, position, force)
    expected = np.maximum(settled.tensions[i] + pulled, response.energy.law.least)
    vertices = settled.vertices[i] + moved[:, response.energy.rigging.points]
    apart = np.linalg.norm(found.vertices - vertices, axis=-1)
    tension = float(np.max(np.abs(found.tensions - expected)))
    return REMAINDER * tension, REMAINDER * float(np.max(apart))
