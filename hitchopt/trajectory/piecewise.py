"""Piecewise polynomials of time, many at once, in Bernstein form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb, factorial, isfinite, prod
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError, OneLine
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices, as_array, counted

if TYPE_CHECKING:
    from scipy.interpolate import BPoly

MAX_STORED_TIMES = 500  # Maximum number of times for which the weights of jets are stored: 0.1 MB
MAX_STORED_SIZE = 2**16  # Maximum number of coefficients of a stored derivative: 0.5 MB


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial(OneLine):
    """Functions of time with values of any shape, polynomial between common breaks.

    Parameters
    ----------
    breaks: (pieces + 1,) [s], strictly increasing.
    coefficients: ``(pieces, *shape, degree + 1)``; Bernstein coefficients of each piece.

    Raises
    ------
    InputError: mismatched shapes, breaks that do not increase, values that are not finite.
    """

    breaks: Array
    coefficients: Array

    def __post_init__(self) -> None:
        breaks = as_array("breaks", self.breaks)
        coefficients = as_array("coefficients", self.coefficients)
        if breaks.ndim != 1 or len(breaks) < 2 or coefficients.ndim < 2:
            raise InputError("breaks", breaks.shape, "(pieces + 1,)", "specify at least one piece")
        if len(coefficients) != len(breaks) - 1 or coefficients.shape[-1] == 0:
            bound = f"({len(breaks) - 1}, …, degree + 1)"
            remedy = "specify one row of coefficients per piece"
            raise InputError("coefficients", coefficients.shape, bound, remedy)
        if not ((breaks[1:] > breaks[:-1]).all() and isfinite(breaks[0]) and isfinite(breaks[-1])):
            raise InputError("breaks", breaks, "finite and strictly increasing", "sort the times")
        if not np.isfinite(coefficients).all():
            raise InputError("coefficients", "nan or inf", "finite", "check how they are computed")
        for name, array in (("breaks", breaks), ("coefficients", coefficients)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def replaced(self, coefficients: Array, breaks: Array | None = None) -> PiecewisePolynomial:
        """Return the functions with other coefficients and breaks, without checks or copies."""
        function = object.__new__(PiecewisePolynomial)
        breaks = self.breaks if breaks is None else breaks
        for array in (coefficients, breaks):
            array.setflags(write=False)
        object.__setattr__(function, "breaks", breaks)
        object.__setattr__(function, "coefficients", coefficients)
        return function

    def _parts(self) -> Iterator[str]:
        yield f"{counted(self.pieces, 'piece')} of degree {self.degree}"
        yield f"shape {self.shape}"
        yield f"{self.breaks[0]:.4g} to {self.breaks[-1]:.4g} s"

    @classmethod
    def constant(cls, breaks: ArrayLike, value: ArrayLike, order: int = 0) -> PiecewisePolynomial:
        """Return the constant ``value`` over ``breaks``, in degree ``order``."""
        times = np.asarray(breaks, dtype=np.float64)
        array = np.asarray(value, dtype=np.float64)
        shape = (len(times) - 1, *array.shape, order + 1)
        return cls(times, np.broadcast_to(array[..., None], shape))

    @classmethod
    def hermite(cls, breaks: ArrayLike, left: Array, right: Array) -> PiecewisePolynomial:
        """Return the polynomials with prescribed derivatives at both ends of every piece.

        Parameters
        ----------
        breaks: (pieces + 1,) [s]
        left, right: ``(m, pieces, *shape)``; time derivatives 0 … m-1 at the pieces' ends.

        Returns
        -------
        Piecewise polynomials of degree 2m - 1.
        """
        times = np.asarray(breaks, dtype=np.float64)
        m, shape = len(left), left.shape[1:]
        h = (times[1:] - times[:-1]).reshape(-1, *(1,) * (left.ndim - 2))
        scaled = np.empty((*shape, 2 * m))
        for j in range(m):
            scaled[..., j], scaled[..., m + j] = left[j] * h**j, right[j] * h**j
        return cls(times, bernstein.transform(scaled, _hermite_map(m)))

    @classmethod
    def through_jets(cls, breaks: Array, jets: Array) -> PiecewisePolynomial:
        """Return the polynomials with jets ``(J, *shape, m)`` at breaks (J,), of degree 2m - 1."""
        orders = jets.transpose(-1, *range(jets.ndim - 1))
        return cls.hermite(breaks, orders[:, :-1], orders[:, 1:])

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return len(self.breaks) - 1

    @property
    def degree(self) -> int:
        """Degree of every piece."""
        return bernstein.degree(self.coefficients)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a value."""
        return self.coefficients.shape[1:-1]

    @cached_property
    def durations(self) -> Array:
        """(pieces,) [s], read-only."""
        durations = np.diff(self.breaks)
        durations.setflags(write=False)
        return durations

    @property
    def duration(self) -> float:
        """Time from the first break to the last [s]."""
        return float(self.breaks[-1] - self.breaks[0])

    def at(self, t: ArrayLike, derivative: int = 0) -> Array:
        """Return values, or a time derivative, at times t (…) as ``(…, *shape)``.

        Raises
        ------
        InputError: a time outside the breaks by more than 1e-9 s, or not finite.
        """
        function = self.differentiated(derivative)
        times = as_array("t", t)
        piece, x = locate(self.breaks, times)
        x = x.reshape(*times.shape, *(1,) * len(self.shape))
        return bernstein.evaluate(function.coefficients[piece], x)

    def jet(self, t: ArrayLike, count: int) -> Array:
        """Return values and time derivatives at times t (…) as ``(…, *shape, count)``.

        Raises
        ------
        InputError: as at.
        """
        times = as_array("t", t)
        piece, basis, weights = jet_weights(self.breaks, times, self.degree, count)
        c = self.coefficients[piece]
        jets: Array = c.reshape(*piece.shape, -1, c.shape[-1]) @ weights
        jets = jets.reshape(*piece.shape, *self.shape, count)
        basis = basis.reshape(*piece.shape, *(1,) * len(self.shape), -1)
        jets[..., 0] = np.einsum("...i,...i->...", c, basis)  # to the last bit what ``at`` returns
        return jets

    def to_scipy(self) -> BPoly:
        """Return the functions as a ``scipy.interpolate.BPoly``, with the same coefficients."""
        from scipy.interpolate import BPoly

        return BPoly(np.moveaxis(self.coefficients, -1, 0), self.breaks)

    def differentiated(self, order: int = 1) -> PiecewisePolynomial:
        """Return the time derivative of the given order."""
        if order == 0:
            return self
        stored = _DERIVATIVES.setdefault(self, {})
        if order in stored:
            return stored[order]
        lower = self.differentiated(order - 1).coefficients
        h = self.durations.reshape(-1, *(1,) * (lower.ndim - 1))
        slope = bernstein.differentiate(lower)
        slope /= h
        derivative = self.replaced(slope)
        if lower.size <= MAX_STORED_SIZE:
            stored[order] = derivative
        return derivative

    def reshaped(self, *shape: int) -> PiecewisePolynomial:
        """Return the functions with values of another shape."""
        return self.replaced(self.coefficients.reshape(self.pieces, *shape, self.degree + 1))

    def split(self, shapes: Sequence[tuple[int, ...]]) -> list[PiecewisePolynomial]:
        """Split functions with values (m,) into functions with values of these shapes."""
        parts, first, count = [], 0, self.degree + 1
        for shape in shapes:
            part = self.coefficients[:, first : first + prod(shape)]
            parts.append(self.replaced(part.reshape(self.pieces, *shape, count).copy()))
            first += prod(shape)
        return parts

    def elevated(self, order: int) -> PiecewisePolynomial:
        """Return the functions in degree ``order``."""
        if order == self.degree:
            return self
        return self.replaced(bernstein.elevate(self.coefficients, order))

    def ends(self, derivative: int = 0) -> tuple[Array, Array]:
        """Return a time derivative at both ends of every piece, ``(pieces, *shape)`` each."""
        c = self.differentiated(derivative).coefficients
        return c[..., 0], c[..., -1]

    def end_jet(self, count: int) -> Array:
        """Return the value and time derivatives at the last break, ``(*shape, count)``."""
        differences, scale = self.coefficients[-1][..., -count:], 1.0
        jet = np.zeros((*self.shape, count))
        for order in range(differences.shape[-1]):
            jet[..., order] = scale * differences[..., -1]
            differences = differences[..., 1:] - differences[..., :-1]
            scale *= (self.degree - order) / (self.breaks[-1] - self.breaks[-2])
        return jet

    def stretched(self, factor: float) -> PiecewisePolynomial:
        """Return the curves slowed down by ``factor``, from the same start."""
        first = self.breaks[0]
        return PiecewisePolynomial(first + factor * (self.breaks - first), self.coefficients)

    def slice_pieces(self, pieces: slice) -> PiecewisePolynomial:
        """Return a run of pieces (at least one), at the same times."""
        first, last, _ = pieces.indices(self.pieces)
        if last <= first:
            raise InputError("pieces", pieces, "at least one", "take a run of pieces")
        return self.replaced(self.coefficients[first:last], self.breaks[first : last + 1])

    def reversed(self) -> PiecewisePolynomial:
        """Return the curves in reverse over the same span of time."""
        breaks = self.breaks[0] + (self.breaks[-1] - self.breaks[::-1])
        return PiecewisePolynomial(breaks, self.coefficients[::-1, ..., ::-1])


_DERIVATIVES: WeakKeyDictionary[PiecewisePolynomial, dict[int, PiecewisePolynomial]] = (
    WeakKeyDictionary()
)
"""Derivatives of small polynomials in use, by order, shared by several checks."""


def joined(
    parts: Sequence[PiecewisePolynomial], template: PiecewisePolynomial | None = None
) -> PiecewisePolynomial:
    """Return the parts in sequence, from the start of the first, in their largest degree.

    ``template`` is the result for other parts with the same breaks.
    """
    if len(parts) == 1:
        return parts[0]
    each = [part.coefficients for part in parts]
    counts = {c.shape[-1] for c in each}
    if len(counts) > 1:
        each = [bernstein.elevate(c, max(counts) - 1) for c in each]
    coefficients = np.concatenate(each)
    if template is not None:
        return template.replaced(coefficients)
    spans = [parts[0].breaks[:1]]
    for part in parts:
        spans.append(spans[-1][-1] + (part.breaks[1:] - part.breaks[0]))
    breaks = np.concatenate(spans)
    if (breaks[1:] > breaks[:-1]).all():
        return parts[0].replaced(coefficients, breaks)
    return PiecewisePolynomial(breaks, coefficients)  # refused: rounding swallows a piece


@lru_cache
def _hermite_map(m: int) -> Array:
    """(2m, 2m): map from derivatives 0 … m - 1 at 0 and at 1 to Bernstein coefficients."""
    order, rows = 2 * m - 1, np.zeros((2 * m, 2 * m))
    for i in range(m):
        for j in range(i + 1):
            # The j-th forward difference at an end is the j-th derivative times (N-j)!/N!.
            weight = comb(i, j) * factorial(order - j) / factorial(order)
            rows[i, j], rows[order - i, m + j] = weight, (-1.0) ** j * weight
    rows.setflags(write=False)
    return rows


BREAK_TOLERANCE = 1e-7
"""[s] Closer breaks count as one: this far beyond its break, a smoothly joined piece is off by its
jump in jerk times 1e-21 s³, far below rounding."""


TIME_ROUNDING = 1e-9  # [s] Rounding of times, by which they may be outside the breaks

MIN_SPACING = 4e-3
"""[s] Shortest piece that is cut, stopped or timed: derivatives on shorter ones suffer from
rounding, by its square or cube."""


def spaced(times: ArrayLike, breaks: Array) -> Array:
    """Return the first times (…) [s], not before ``times``, up to which a curve can be cut.

    These are breaks (pieces + 1,) [s], or MIN_SPACING or more after the last one before them.
    """
    wanted = np.asarray(times, dtype=np.float64)
    index = np.searchsorted(breaks, wanted + TIME_ROUNDING, side="right") - 1
    before = breaks[np.maximum(index, 0)]
    after = breaks[np.minimum(index + 1, len(breaks) - 1)]
    inside = np.minimum(np.maximum(wanted, before + MIN_SPACING), after)
    return np.where(wanted <= before + TIME_ROUNDING, before, inside)


def merged_breaks(arrays: Sequence[Array]) -> Array:
    """Return the sorted union of arrays of breaks (pieces + 1,) [s].

    Breaks within BREAK_TOLERANCE of those of an earlier array are dropped.
    """
    merged = np.asarray(arrays[0], dtype=np.float64)
    for breaks in arrays[1:]:
        index = np.searchsorted(merged, breaks)
        before = np.abs(breaks - merged[np.maximum(index - 1, 0)])
        after = np.abs(breaks - merged[np.minimum(index, len(merged) - 1)])
        merged = np.union1d(merged, breaks[np.minimum(before, after) > BREAK_TOLERANCE])
    return merged


def divided(breaks: Array, counts: Indices) -> Array:
    """Return breakpoints (J,) with pieces divided into ``counts`` (J - 1,) equal parts each."""
    each = zip(breaks[:-1], breaks[1:], counts, strict=True)
    inner = [np.linspace(first, last, count, endpoint=False) for first, last, count in each]
    return np.append(np.concatenate(inner), breaks[-1])


def on_breaks(part: PiecewisePolynomial, breaks: Array) -> PiecewisePolynomial:
    """Return the functions on ``breaks`` within the part's, each piece inside one of the part's.

    The result is exact up to rounding, except within BREAK_TOLERANCE of the part's own breaks.
    """
    piece, partial, lower, upper = _cells(part.breaks.tobytes(), breaks.tobytes())
    coefficients = part.coefficients[piece]
    if partial.size and part.degree:
        axes = (-1, *(1,) * len(part.shape))
        coefficients[partial] = bernstein.restrict(
            coefficients[partial], lower.reshape(axes), upper.reshape(axes)
        )
    return part.replaced(coefficients, breaks)


def on_spaced_breaks(part: PiecewisePolynomial, breaks: Array) -> PiecewisePolynomial:
    """Return functions of degree 7 on ``breaks``, and on their own ones MIN_SPACING from these.

    Pieces that contain another break of theirs keep values and two derivatives at their ends.
    """
    distances = np.min(np.abs(part.breaks[:, None] - breaks), axis=1)
    merged = np.union1d(breaks, part.breaks[distances >= MIN_SPACING])
    piece, _ = locate(part.breaks, 0.5 * (merged[1:] + merged[:-1]))
    third = part.differentiated(3).coefficients[piece]
    rates = np.moveaxis(part.jet(merged, 3), -1, 0)
    ends = list[Array]()
    for orders, times in ((rates[:, :-1], merged[:-1]), (rates[:, 1:], merged[1:])):
        place = np.clip((times - part.breaks[piece]) / part.durations[piece], 0.0, 1.0)
        place = place.reshape(-1, *(1,) * len(part.shape))
        ends.append(np.concatenate([orders, bernstein.evaluate(third, place)[None]]))
    return PiecewisePolynomial.hermite(merged, *ends)


def summed(first: PiecewisePolynomial, second: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the sum of two functions on one span, whose shapes broadcast."""
    breaks = merged_breaks([first.breaks, second.breaks])
    degree = max(first.degree, second.degree)
    terms = [on_breaks(part, breaks).elevated(degree) for part in (first, second)]
    return PiecewisePolynomial(breaks, terms[0].coefficients + terms[1].coefficients)


@lru_cache(maxsize=32)
def _cells(own: bytes, breaks: bytes) -> tuple[Indices, Indices, Array, Array]:
    """Return the pieces of ``on_breaks``, and those that are partial, with their ends in [0, 1].

    Arguments are bytes of arrays, which are hashable: all curves of a motion have the same breaks.
    """
    outer, inner = np.frombuffer(own), np.frombuffer(breaks)
    if not (inner[1:] > inner[:-1]).all():
        raise InputError("breaks", inner, "finite and strictly increasing", "sort the times")
    middles = 0.5 * (inner[1:] + inner[:-1])
    piece = outer[1:-1].searchsorted(middles, side="right")
    start, end = outer[piece], outer[piece + 1]
    lower = ((inner[:-1] - start) / (end - start)).clip(0.0, 1.0)
    upper = ((inner[1:] - start) / (end - start)).clip(0.0, 1.0)
    lower[np.abs(inner[:-1] - start) <= BREAK_TOLERANCE] = 0.0
    upper[np.abs(inner[1:] - end) <= BREAK_TOLERANCE] = 1.0
    (partial,) = ((lower > 0.0) | (upper < 1.0)).nonzero()
    return piece, partial, lower[partial], upper[partial]


def locate(breaks: Array, times: Array) -> tuple[Indices, Array]:
    """Return the pieces (…) of times (…), and the local parameters (…) in them, from 0 to 1."""
    first, last = breaks[0], breaks[-1]
    if not np.all((times >= first - TIME_ROUNDING) & (times <= last + TIME_ROUNDING)):
        raise InputError(
            "t", times, f"within [{first:g}, {last:g}] s", "pass times within the plan"
        )
    piece = np.clip(np.searchsorted(breaks, times, side="right") - 1, 0, len(breaks) - 2)
    return piece, np.clip((times - breaks[piece]) / np.diff(breaks)[piece], 0.0, 1.0)


def _weights(
    breaks: bytes, times: bytes, shape: tuple[int, ...], order: int, count: int
) -> tuple[Indices, Array, Array]:
    """Return the weights of ``PiecewisePolynomial.jet``, which only depend on breaks and times.

    Parameters
    ----------
    breaks, times: bytes of the arrays, which are hashable.
    shape: shape of the times, (…).
    order: degree of the pieces.
    count: number of derivatives, the zeroth included.

    Returns
    -------
    Pieces (…), the basis (…, order + 1), and the basis with its derivatives (…, order + 1, count).
    """
    spans = np.frombuffer(breaks)
    piece, x = locate(spans, np.frombuffer(times).reshape(shape))
    weights = bernstein.jet_basis(x, order, count)
    weights /= np.diff(spans)[piece][..., None, None] ** np.arange(count)
    return piece, bernstein.basis(x, order), weights


_stored_weights = lru_cache(maxsize=64)(_weights)
"""``_weights`` with a cache: a search evaluates all of its paths on a few grids."""


def jet_weights(
    breaks: Array, times: Array, order: int, count: int
) -> tuple[Indices, Array, Array]:
    """Return ``_weights`` for breaks (pieces + 1,) and times (…) [s], cached for few times."""
    weights = _stored_weights if times.size <= MAX_STORED_TIMES else _weights
    return weights(breaks.tobytes(), times.tobytes(), times.shape, order, count)
