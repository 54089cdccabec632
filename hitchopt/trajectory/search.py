"""The smallest or largest value of a formula over continuous time, by branch and bound.

A formula bounds a quantity on each of many spans of time at once; on spans of no length the bound
is its value. Spans that may still change the answer are halved until none is left. The answer holds
for all t and does not rely on samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import check_time
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Bound
from hitchopt.values import Array, Indices

RELATIVE = 1e-4
"""Largest gap between the answer and an attained value, relative to that value, if ABSOLUTE is
smaller."""

ABSOLUTE = 2e-7
"""Largest gap between the answer and an attained value in the unit of the quantity, if the relative
one is smaller."""

MAX_HALVINGS = 40
"""Maximum number of halvings of a piece. Beyond it, bounds are accepted: valid, but less tight."""

MAX_SPANS = 100_000  # Maximum number of halves in total, or ten per initial span, likewise

BATCH = 4096  # Number of spans bounded in one call: the arrays of a formula fit into the caches

TIE_STEPS = 1e9
"""Number of steps of bounds up to the largest one: within a step, the first in time is chosen."""

TIE = 1e-9  # Relative difference of values within which the first one in time is chosen

WHOLE = np.array([[0.0], [1.0]])  # Start and end of whole pieces

MAX_MATRICES = 64
"""Number of spans up to which matrices, the same for all curves, restrict curves to them."""

MAX_CANDIDATES = 32
"""Number of spans of a batch, those with the worst bounds, in which a value is computed."""

_ROUGH: ContextVar[bool] = ContextVar("rough", default=False)


@contextmanager
def rough_bounds() -> Iterator[None]:
    """Accept bounds in the context that satisfy the target, without tightening them."""
    token = _ROUGH.set(True)
    try:
        yield
    finally:
        _ROUGH.reset(token)


class TimeSpans:
    """Spans of time, each within one piece and of one item.

    Parameters
    ----------
    source: object with the polynomials.
    breaks: (pieces + 1,) [s]
    piece, item: (spans,)
    extent: (2, spans), local parameters of starts and ends, from 0 to 1; None for whole pieces,
        whose attribute is (2, 1).
    points: whether the spans have no length.
    """

    def __init__(
        self,
        source: Any,
        breaks: Array,
        piece: Indices,
        item: Indices,
        extent: Array | None = None,
        *,
        points: bool = False,
    ) -> None:
        self.source, self.breaks, self.piece, self.item = source, breaks, piece, item
        self.whole, self.points = extent is None, points
        self.extent = WHOLE if extent is None else extent
        self._weights: dict[int, Array] = {}  # by degree

    def __len__(self) -> int:
        return len(self.item)

    @classmethod
    def all_of(
        cls, source: Any, breaks: Array, items: int, mask: NDArray[np.bool_] | None = None
    ) -> Iterator[Self]:
        """Yield the spans of whole pieces of every item, in batches.

        ``mask`` (pieces,) or (pieces, items) selects spans; None selects all.
        """
        piece, item = divmod(np.arange((len(breaks) - 1) * items), items)
        if mask is not None:
            shape = len(breaks) - 1, items
            selected = np.broadcast_to(mask.reshape(shape[0], -1), shape).ravel()
            piece, item = piece[selected], item[selected]
        yield from batches(cls(source, breaks, piece, item))

    def _like(self, index: Any, extent: Array | None, *, points: bool = False) -> Self:
        chosen = self.piece[index], self.item[index]
        return type(self)(self.source, self.breaks, *chosen, extent, points=points)

    def take(self, index: Indices | NDArray[np.bool_] | slice) -> Self:
        """Return the chosen spans."""
        extent = None if self.whole else self.extent[:, index]
        return self._like(index, extent, points=self.points)

    def halves(self) -> Self:
        """Return all first halves, then all second halves."""
        (lower, upper), count = self.extent, self.item.size
        extent = np.empty((2, 2, count))  # (start and end, half, span)
        extent[0, 0], extent[1, 1] = lower, upper
        extent[0, 1] = extent[1, 0] = 0.5 * (lower + upper)
        return self._like(np.arange(2 * count) % count, extent.reshape(2, -1))

    def at(self, x: Array | float, index: Any = slice(None)) -> Self:
        """Return the points at local parameters x (spans,), from 0 to 1, of the chosen spans."""
        lower, upper = self.extent if self.whole else self.extent[:, index]
        extent = np.empty((2, self.piece[index].size))
        extent[:] = lower + x * (upper - lower)
        return self._like(index, extent, points=True)

    def times(self, x: Array | float) -> Array:
        """Return the times [s] at local parameters x (spans,)."""
        (lower, upper), starts = self.extent, self.breaks[self.piece]
        durations = self.breaks[self.piece + 1] - starts
        times: Array = starts + (lower + x * (upper - lower)) * durations
        return times

    def read(self, table: Array, item: Indices | None = None) -> Array:
        """Return polynomials (spans, …, degree + 1) on the spans.

        Parameters
        ----------
        table: (pieces, items, …, degree + 1), coefficients on whole pieces.
        item: (spans,) or (spans, k), items to read; the spans' own by default.
        """
        item = self.item if item is None else item
        c = table[self.piece if item.ndim == 1 else self.piece[:, None], item]
        if self.whole or c.shape[-1] == 1:
            return c
        if not self.points and len(self) > MAX_MATRICES:
            lower, upper = self.extent.reshape(2, -1, *(1,) * (c.ndim - 2))
            return bernstein.restrict(c, lower, upper)
        order = c.shape[-1] - 1
        if order not in self._weights:
            self._weights[order] = self._weights_of(order)
        weights = self._weights[order]
        rows = math.prod(c.shape[1:-1])  # -1 is refused where there are no spans
        values = c.reshape(len(self), rows, order + 1) @ weights
        return values.reshape(*c.shape[:-1], weights.shape[-1])

    def _weights_of(self, order: int) -> Array:
        """Return matrices (spans, order + 1, k) from coefficients on whole pieces to the spans."""
        lower, upper = self.extent
        if self.points:
            return bernstein.basis(lower, order)[..., None]
        return bernstein.restrictions(lower, upper, order)


S = TypeVar("S", bound=TimeSpans)

Formula = Callable[[S], Bound]  # Bound of a quantity on spans, or its value at points


@dataclass(frozen=True)
class Extremum:
    """The smallest or largest value of a quantity.

    ``worst`` bounds it at all times, rounding included; ``value`` is attained by an ``item`` at a
    ``time`` [s] and close to it (within ``rough_bounds`` a bound that satisfies the target). The
    item is -1 if there was no span.
    """

    worst: float
    value: float
    item: int
    time: float


class BranchAndBound(Generic[S]):
    """Branch and bound for the largest or smallest value; spans are added in any order.

    Parameters
    ----------
    formula: computes the bounds.
    sense: ``max`` for the largest value, ``min`` for the smallest.
    target: if all values satisfy it, spans are halved until ``worst`` does too.
    incumbent: only worse values are searched for; the item is -1 if there are none.
    relative, absolute: largest gap between ``worst`` and an attained value.
    """

    def __init__(
        self,
        formula: Formula[S],
        sense: str,
        *,
        target: float = math.nan,
        incumbent: float = math.nan,
        relative: float = RELATIVE,
        absolute: float = ABSOLUTE,
    ) -> None:
        self.formula = formula
        self.sign = 1.0 if sense == "max" else -1.0  # the search maximises sign · value
        self.relative, self.absolute = relative, absolute
        self.target = np.inf if math.isnan(target) else self.sign * target
        self.value = -np.inf if math.isnan(incumbent) else self.sign * incumbent
        self.rough = _ROUGH.get() and not math.isnan(target)
        self.item, self.time = -1, 0.0
        self.ceiling = -np.inf  # largest bound of closed spans
        self.evaluated = 0
        self._open: list[tuple[S, Array, int]] = []

    @property
    def attained(self) -> float:
        """The worst value so far."""
        return self.sign * self.value

    @property
    def threshold(self) -> float:
        """Bound at or below which spans are closed."""
        if not -np.inf < self.value < np.inf:
            return self.value
        tight = self.value + max(self.absolute, self.relative * abs(self.value))
        return self.target if self.value <= self.target < tight else tight

    def add(self, spans: S) -> None:
        """Bound the spans once, and keep those open that may contain the worst value."""
        for batch in batches(spans):
            if (remaining := self._prune(batch, self._bounds(batch))) is not None:
                self._open.append((*remaining, 0))

    def finish(self) -> Extremum:
        """Halve open spans until all are closed, and return the answer."""
        # Deepest first: few spans are alive at a time, and the worst values come early.
        if len(self._open) > 1:
            self._open.sort(key=lambda entry: float(entry[1].max()))
        budget = max(MAX_SPANS, 10 * self.evaluated) + self.evaluated
        while self._open:
            spans, bounds, depth = self._open.pop()
            if (remaining := self._prune(spans, bounds)) is None:
                continue
            spans, bounds = remaining
            if depth == MAX_HALVINGS or self.evaluated > budget:
                self.ceiling = max(self.ceiling, float(bounds.max()))
                continue
            inherited = np.concatenate([bounds, bounds])
            for i, batch in enumerate(batches(spans.halves())):
                parents = inherited[i * BATCH : (i + 1) * BATCH]
                self._open.append((batch, np.minimum(parents, self._bounds(batch)), depth + 1))
        worst = max(self.ceiling, self.value)
        return Extremum(self.sign * worst, self.attained, self.item, self.time)

    def _bounds(self, batch: S) -> Array:
        """Return upper bounds (spans,) of sign · quantity, and record the largest value."""
        check_time()
        self.evaluated += batch.item.size
        bound = self.formula(batch)
        bounds = self._signed(bound)
        if self.rough and bounds.max() <= self.target:
            best = bounds.argmax(axis=0, keepdims=True)
            self.record(batch.item[best], batch.times(bound.x)[best], bounds[best])
            return bounds
        # Spans that tie are taken in order: the answer is the same on every machine.
        size = np.maximum.reduce(sizes := np.abs(bounds)) or 1.0
        if size == np.inf:
            size = np.max(sizes, initial=0.0, where=np.isfinite(sizes)) or 1.0
        candidates = (-np.rint(bounds / size * TIE_STEPS)).argsort(kind="stable")[:MAX_CANDIDATES]
        candidates.sort()
        if self.item >= 0:  # no value exceeds its span's bound
            candidates = candidates[bounds[candidates] >= self.value - TIE * abs(self.value)]
        if candidates.size:
            points = batch.at(bound.x[candidates], candidates)
            values = bounds[candidates] if batch.points else self._signed(self.formula(points))
            self.record(points.item, points.times(0.0), values)
        return bounds

    def _signed(self, bound: Bound) -> Array:
        """Return sign · quantity, with nan replaced by infinity, which fails a check."""
        values: Array = self.sign * bound.value
        values[np.isnan(values)] = np.inf
        return values

    def record(self, items: Indices, times: Array, values: Array) -> None:
        """Record the largest of sign · values, or the first in time of values that tie."""
        largest = float(np.maximum.reduce(values))
        tie = TIE * abs(largest) if largest - largest == 0.0 else 0.0  # not if infinite
        best = int((values >= largest - tie).argmax())
        value, time = float(values[best]), float(times[best])
        earlier = self.item >= 0 and value >= self.value - tie and time < self.time
        if value > self.value + tie or earlier or (self.item < 0 and np.isinf(self.value)):
            self.value, self.item, self.time = max(value, self.value), int(items[best]), time

    def _prune(self, spans: S, bounds: Array) -> tuple[S, Array] | None:
        """Close spans at the threshold, and return the remaining ones, if any."""
        is_open = bounds > self.threshold
        index, decided = is_open.nonzero()[0], bounds[~is_open]
        if decided.size:
            self.ceiling = max(self.ceiling, float(np.maximum.reduce(decided)))
        if not index.size:
            return None
        return (spans.take(index), bounds[index]) if decided.size else (spans, bounds)


def batches(spans: S) -> Iterator[S]:
    """Yield the spans, BATCH at a time."""
    if 0 < spans.item.size <= BATCH:
        yield spans
    else:
        yield from (spans.take(slice(i, i + BATCH)) for i in range(0, len(spans), BATCH))


def worst(spans: Iterable[S], formula: Formula[S], sense: str, **options: float) -> Extremum:
    """Return the largest (``max``) or smallest (``min``) value; options of ``BranchAndBound``."""
    search: BranchAndBound[S] = BranchAndBound(formula, sense, **options)
    for each in spans:
        search.add(each)
    return search.finish()
