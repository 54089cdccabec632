"""Fewer pieces for the same curves, and their control points rounded.

**Fewer pieces.** On every new piece the curves meet the plan's positions and first derivatives at
both ends, so that what is exported is as smooth across its pieces as the plan; the coefficients
that this leaves free are those nearest to the plan. Pieces end as far on as an error allows, one
after the other; errors are taken at points, the certificate verifies the result over all time.

**Rounded together.** A control point rounded on its own is off by half a quantum, its neighbour by
as much in the opposite direction: over a piece of degree N and h seconds that is up to ``N / h``
quanta a second of velocity. So each is rounded with the errors of those before it in mind: among
the remaining real coefficients the ones that make up best for them are found by least squares
(Babai's nearest plane), in a norm of the errors of position, velocity and acceleration.

**Settled.** A plan that flies at a limit has nothing left for rounding. Single inner control
points, and pairs of them, are moved by one quantum as long as that lowers what is beyond limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import ceil, exp, floor, inf, log
from typing import NamedTuple

import numpy as np

from hitchopt.exports.placing import ReferenceFrame
from hitchopt.exports.recording import lasted
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

NODES = 25  # Points of a piece at which the plan is met in the least squares, and errors are taken
CROWD = 200  # Drones that are evaluated when ends are placed: larger teams are thinned out evenly
BISECTIONS = 9  # Bisections of the logarithm of the error: enough to distinguish 31 pieces from 32
COARSEST, FINEST = 30.0, 1e-3  # Errors over their scale between which is searched
POINTS = 33  # Points of a piece at which limits are checked

MARGIN = 3e-4
"""Relative distance from the limits, for what lies between the points and for the bounds."""

MOST = 500
"""Pieces of single drones that are settled, at some 10 ms each; with more, limits are too tight."""

UNLIMITED = 1e6  # [m/s], [N] Speed and thrust beyond all that is flown
STEPS = 12  # Largest number of moves of one piece
NEAR = 0.85  # Share of the accuracy beyond which errors cost


@dataclass(frozen=True)
class Kind:
    """A format's kind of pieces."""

    degree: int
    match: int  # how many derivatives, from the position on, are the plan's at both ends
    quantum: float  # durations are whole multiples of it [s]
    longest: float  # duration of a piece [s]
    shortest: float = 0.0  # duration of a piece, whatever its error [s]; whole curves may be so

    @property
    def free(self) -> slice:
        """Coefficients that the ends leave free."""
        return slice(self.match, self.degree + 1 - self.match)


class Scale(NamedTuple):
    """Errors that weigh alike."""

    position: float = 1e-3  # [m]
    velocity: float = 1e-2  # [m/s]
    acceleration: float = 1e-1  # [m/s²]


def fitted(curves: PiecewisePolynomial, breaks: Array, kind: Kind) -> PiecewisePolynomial:
    """Return the curves (D, 3), from t = 0, on pieces of a kind; at rest after their own end."""
    curves = lasted(curves, float(breaks[-1]))
    ends = np.stack([curves.at(breaks, order) for order in range(kind.match)])
    hermite = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
    coefficients = np.array(bernstein.elevate(hermite.coefficients, kind.degree))
    x = bernstein.nodes(NODES - 1)
    basis = bernstein.basis(x, kind.degree)
    for c, start, h in zip(coefficients, breaks, np.diff(breaks), strict=False):
        # Hermite's own coefficients inside are a first guess; the rest is least squares.
        missing = np.moveaxis(curves.at(start + x * h), 0, -1) - c @ basis.T
        c[..., kind.free] += missing @ _solver(kind).T
    return PiecewisePolynomial(breaks, coefficients)


def span_errors(
    curves: PiecewisePolynomial, kind: Kind, scale: Scale
) -> Callable[[float, float], float]:
    """Return the function of a span's start and end [s] that gives the error of one piece there.

    It is the largest error over the scale, of any drone at NODES points.
    """
    x = bernstein.nodes(NODES - 1)
    basis = [bernstein.derivative_basis(x, kind.degree, i) for i in range(3)]
    match = kind.match

    def error(start: float, end: float) -> float:
        h = end - start
        # By the span's own parameter: values and two derivatives, (3, NODES, D * 3).
        jet = np.moveaxis(curves.jet(start + x * h, 3), -1, 0)
        wanted = jet.reshape(3, NODES, -1) * h ** np.arange(3.0)[:, None, None]
        c = _hermite(kind) @ np.concatenate([wanted[:match, 0], wanted[:match, -1]])
        c[kind.free] += _solver(kind) @ (wanted[0] - basis[0] @ c)
        worst = 0.0
        for order, each in enumerate(scale):
            missing = (basis[order] @ c - wanted[order]).reshape(-1, 3)
            size = float(np.max(np.einsum("ij,ij->i", missing, missing))) ** 0.5
            worst = max(worst, size / (each * h**order))
        return worst

    return error


@lru_cache
def _solver(kind: Kind) -> Array:
    """Return the matrix (free, NODES) from what is missing at the nodes to free coefficients."""
    matrix = bernstein.at_nodes(NODES - 1, kind.degree)[:, kind.free]
    return np.asarray(np.linalg.pinv(matrix), dtype=np.float64)


@lru_cache
def _hermite(kind: Kind) -> Array:
    """Return the matrix (degree + 1, 2 match) from the left and right end's derivatives."""
    unit = np.eye(2 * kind.match)[:, None]
    ends = PiecewisePolynomial.hermite([0.0, 1.0], unit[: kind.match], unit[kind.match :])
    return np.array(ends.elevated(kind.degree).coefficients[0].T)


def greedy_breaks(
    error: Callable[[float, float], float],
    duration: float,
    kind: Kind,
    bound: float,
    most: float = inf,
) -> Array | None:
    """Return breaks from 0 to ``duration`` [s], rounded up to a quantum; None if too many.

    Every piece lasts as long as its error stays within ``bound``, or as short as it may.
    """
    last = max(1, ceil(duration / kind.quantum - 1e-9))
    longest = max(1, floor(kind.longest / kind.quantum))
    shortest = max(1, ceil(kind.shortest / kind.quantum - 1e-9))
    ticks = [0]
    stride = max(1, last // 8)

    def fits(stride: int) -> bool:
        return error(ticks[-1] * kind.quantum, (ticks[-1] + stride) * kind.quantum) <= bound

    while ticks[-1] < last:
        if len(ticks) > most:
            return None
        remaining = last - ticks[-1]
        stride = max(shortest, _farthest(fits, min(remaining, longest), stride))
        if remaining - stride < shortest:  # the last piece would be too short
            stride = remaining - shortest if stride < remaining >= 2 * shortest else remaining
        ticks.append(ticks[-1] + stride)
    return np.array(ticks) * kind.quantum


def _farthest(fits: Callable[[int], bool], most: int, guess: int) -> int:
    """Return the longest stride that fits, by doubling from a guess and bisection."""
    good, bad = 1, most + 1
    stride = min(guess, most)
    while good < stride < bad:
        if not fits(stride):
            bad = stride
            break
        good = stride
        stride = min(2 * stride, most)
    while good < most and bad - good > max(1, good // 64):
        middle = (good + bad) // 2
        if fits(middle):
            good = middle
        else:
            bad = middle
    return good


def best_breaks(curves: PiecewisePolynomial, kind: Kind, most: int) -> Array | None:
    """Return the breaks of at most so many pieces with the smallest error, from FINEST on.

    There are none where the error is beyond COARSEST.
    """
    found = breaks_within(curves, kind, FINEST, most)
    best = breaks_within(curves, kind, COARSEST, most) if found is None else found
    if best is None or found is not None:
        return best
    low, high = log(FINEST), log(COARSEST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        found = breaks_within(curves, kind, exp(middle), most)
        if found is None:
            low = middle
        else:
            best, high = found, middle
    return best


def breaks_within(
    curves: PiecewisePolynomial,
    kind: Kind,
    bound: float,
    most: float = inf,
    scale: Scale | None = None,
) -> Array | None:
    """Return the breaks of pieces whose errors stay within ``bound``; None if they are too many."""
    end = ceil(float(curves.breaks[-1]) / kind.quantum) * kind.quantum
    step = max(1, curves.shape[0] // CROWD)
    some = PiecewisePolynomial(curves.breaks, curves.coefficients[:, ::step])
    error = span_errors(lasted(some, end), kind, scale or Scale())
    return greedy_breaks(error, float(curves.breaks[-1]), kind, bound, most)


def rounded(curves: PiecewisePolynomial, quantum: float, scale: Scale) -> PiecewisePolynomial:
    """Return the curves (D, 3) with coefficients multiples of ``quantum`` [m], joined exactly."""
    wanted = curves.coefficients / quantum
    found = np.empty_like(wanted)
    last = np.rint(wanted[0, ..., 0])
    for piece, h in enumerate(curves.durations):
        found[piece] = _nearest(wanted[piece], last, _gram(curves.degree, float(h), scale))
        last = found[piece, ..., -1]
    return PiecewisePolynomial(curves.breaks, found * quantum)


def _nearest(wanted: Array, first: Array, gram: Array) -> Array:
    """Return integers (…, N + 1) near to ``wanted`` in the norm, the first of them given."""
    # With G = L Lᵀ the error's norm is |Lᵀ e|: row i of Lᵀ holds e_i and those after it. The last
    # coefficient to be chosen is thus the first one of the basis, so the order is turned round.
    factor = np.linalg.cholesky(gram[::-1, ::-1]).T
    c = wanted[..., ::-1]
    size = c.shape[-1]
    errors = np.zeros_like(c)
    found = np.empty_like(c)
    for i in range(size - 1, -1, -1):
        aim = c[..., i] - errors[..., i + 1 :] @ factor[i, i + 1 :] / factor[i, i]
        found[..., i] = first if i == size - 1 else np.rint(aim)
        errors[..., i] = found[..., i] - c[..., i]
    return found[..., ::-1]


def _gram(degree: int, h: float, scale: Scale) -> Array:
    """Return the basis's Gram matrix (N + 1, N + 1) for errors over a piece of ``h`` seconds."""
    nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
    x = 0.5 * (nodes + 1.0)
    gram = np.zeros((degree + 1, degree + 1))
    for order, size in enumerate(scale):
        values = bernstein.derivative_basis(x, degree, order) / (size * h**order)
        gram += values.T @ (0.5 * weights[:, None] * values)
    return gram


@dataclass(frozen=True, eq=False)
class Keeping:
    """The limits that are enforced."""

    speed: float  # of every drone [m/s]
    mass: Array  # (D,) [kg]
    max_thrust: Array  # (D,) [N]
    load: Array  # (pieces, POINTS, D, 3) [N], what thrust carries besides acceleration: m g ẑ - F
    accuracy: float  # largest error of positions [m]

    @classmethod
    def of(
        cls, motion: Motion, frame: ReferenceFrame, breaks: Array, accuracy: float, offset: bool
    ) -> Keeping:
        """Return the limits of a plan that rounding may break, in the file's axes.

        Set points that are ``offset`` from the drones have neither speed nor thrust to keep.
        """
        times = breaks[:-1, None] + np.linspace(0.0, 1.0, POINTS) * np.diff(breaks)[:, None]
        forces = states_at(motion, np.minimum(times, float(motion.drones.breaks[-1]))).cable_forces
        mass, speed = motion.team.mass, motion.requirements.limits.speed
        load = frame.vectors(mass[:, None] * np.array([0.0, 0.0, GRAVITY]) - forces)
        if offset:
            return cls(UNLIMITED, mass, np.full(len(mass), UNLIMITED), load, accuracy)
        return cls(speed, mass, motion.team.max_thrust, load, accuracy)

    def beyond(self, each: Array, h: float, piece: int, drones: slice = slice(None)) -> Array:
        """Return by how much pieces (m, 3, N + 1) of ``h`` s are beyond limits, relative, (m,).

        The root of the mean of squares over the points: a move that helps one of several counts.
        """
        _, slopes, bends = _bases(bernstein.degree(each))
        speed = np.linalg.norm(np.einsum("tn,mdn->mtd", slopes, each) / h, axis=-1)
        pull = np.einsum("tn,mdn->mtd", bends, each) / h**2
        load = np.moveaxis(self.load[piece, :, drones], 1, 0)
        thrust = self.mass[drones, None, None] * pull + load
        pushed = np.linalg.norm(thrust, axis=-1) / self.max_thrust[drones, None]
        most = 1.0 - MARGIN
        squares = np.maximum(speed / self.speed - most, 0.0) ** 2
        squares += np.maximum(pushed - most, 0.0) ** 2
        return np.asarray(np.sqrt(np.mean(squares, axis=1)))


def settled(
    curves: PiecewisePolynomial, wanted: PiecewisePolynomial, quantum: float, keeping: Keeping
) -> PiecewisePolynomial:
    """Return curves (D, 3) of multiples of ``quantum``, moved within pieces; their ends stay.

    ``wanted`` is what they were rounded from, on the same pieces.
    """
    c, durations = np.array(curves.coefficients), curves.durations.tolist()
    beyond = np.stack([keeping.beyond(c[p], h, p) for p, h in enumerate(durations)])
    pieces, drones = np.nonzero(beyond > 0.0)
    if len(pieces) > MOST:
        return curves
    moves = quantum * _moves(curves.degree)
    basis, slopes, _ = _bases(curves.degree)
    for p, d in zip(pieces.tolist(), drones.tolist(), strict=True):
        h, to = durations[p], wanted.coefficients[p, d].T
        for _ in range(STEPS):
            each = c[p, d] + moves  # (moves, 3, N + 1)
            lost = keeping.beyond(each, h, p, slice(d, d + 1))
            if lost[0] == 0.0:  # the first one moves nothing
                break
            off = np.linalg.norm(np.einsum("tn,mdn->mtd", basis, each) - basis @ to, axis=-1)
            wild = np.einsum("tn,mdn->mtd", slopes, each) / h - slopes @ to / h
            cost = (
                1e5 * lost
                + 2e1 * np.maximum(np.max(off, axis=1) / keeping.accuracy - NEAR, 0.0)
                + np.max(np.linalg.norm(wild, axis=-1), axis=1) / keeping.speed
            )
            best = int(np.argmin(cost))
            if best == 0:
                break
            c[p, d] = each[best]
    return PiecewisePolynomial(curves.breaks, np.rint(c / quantum) * quantum)


@lru_cache
def _bases(degree: int) -> tuple[Array, Array, Array]:
    """Return basis, slopes and bends by the local parameter, (POINTS, degree + 1) each."""
    x = np.linspace(0.0, 1.0, POINTS)
    basis, slopes, bends = (bernstein.derivative_basis(x, degree, order) for order in range(3))
    return basis, slopes, bends


@lru_cache
def _moves(degree: int) -> Array:
    """Return moves (moves, 3, degree + 1): none, runs of inner control points, any two of them."""
    runs = []
    for first, last in combinations(range(1, degree + 1), 2):
        for axis in range(3):
            run = np.zeros((3, degree + 1))
            run[axis, first:last] = 1.0
            runs += [run, -run]
    single = [run for run in runs if np.abs(run).sum() == 1.0]
    pairs = [a + b for a, b in combinations(single, 2)]
    return np.array([np.zeros((3, degree + 1)), *runs, *pairs])
