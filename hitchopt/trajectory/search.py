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

RELATIVE, ABSOLUTE = 1e-4, 2e-7
"""Largest gap between the answer and an attained value: relative to that value, and in the unit of
the quantity. The larger one applies."""

MAX_HALVINGS, MAX_SPANS = 40, 100_000
"""Maximum number of halvings of a piece, and of halves in all (or ten per initial span). Beyond
them, bounds are accepted: valid, but less tight."""

BATCH = 4096
"""Number of spans bounded in one call: the arrays of a formula fit into the caches."""

TIE_DIGITS, TIE = 9, 1e-9
"""Digits of bounds, and relative difference of values, at which the first one in time is chosen."""

MAX_CANDIDATES = 32
"""Number of spans of a batch, those with the worst bounds, in which a value is computed."""

_ROUGH: ContextVar[bool] = ContextVar("rough", default=False)


@contextmanager
def rough_bounds() -> Iterator[None]:
    """Within the context, accept bounds that satisfy the target without tightening them."""
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
    extent: (2, spans), local parameters of starts and ends, from 0 to 1; None for whole pieces.
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
        self.extent = np.repeat([[0.0], [1.0]], len(item), axis=1) if extent is None else extent

    def __len__(self) -> int:
        return len(self.item)

    @classmethod
    def all_of(
        cls, source: Any, breaks: Array, items: int, mask: NDArray[np.bool_] | None = None
    ) -> Iterator[Self]:
        """Yield the spans of whole pieces of every item, in batches.

        ``mask`` (pieces,) or (pieces, items) selects spans; None selects all.
        """
        selected = np.ones((len(breaks) - 1, items), dtype=np.bool_)
        if mask is not None:
            selected &= mask.reshape(len(selected), -1)
        piece, item = np.nonzero(selected)
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
        (lower, upper), twice = self.extent, np.tile(np.arange(len(self)), 2)
        middle = 0.5 * (lower + upper)
        return self._like(twice, np.concatenate([[lower, middle], [middle, upper]], axis=1))

    def at(self, x: Array) -> Self:
        """Return the points at local parameters x (spans,) of the spans, from 0 to 1."""
        positions = self.extent[0] + x * (self.extent[1] - self.extent[0])
        return self._like(slice(None), np.stack([positions, positions]), points=True)

    def times(self, x: Array) -> Array:
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
        if self.points:
            weights = bernstein.basis(self.extent[0], c.shape[-1] - 1)
            values: Array = np.einsum("s...i,si->s...", c, weights)
            return values[..., None]
        lower, upper = self.extent.reshape(2, -1, *(1,) * (c.ndim - 2))
        return bernstein.restrict(c, lower, upper)


S = TypeVar("S", bound=TimeSpans)

Formula = Callable[[S], Bound]
"""Bound of a quantity on spans, or its value at points."""


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
        if not math.isfinite(self.value):
            return self.value
        tight = self.value + max(self.absolute, self.relative * abs(self.value))
        return min(tight, self.target) if self.value <= self.target else tight

    def add(self, spans: S) -> None:
        """Bound the spans once, and keep those open that may contain the worst value."""
        for batch in batches(spans):
            if (remaining := self._prune(batch, self._bounds(batch))) is not None:
                self._open.append((*remaining, 0))

    def finish(self) -> Extremum:
        """Halve open spans until all are closed, and return the answer."""
        # Deepest first: few spans are alive at a time, and the worst values come early.
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
                parents = inherited[i * BATCH : i * BATCH + len(batch)]
                self._open.append((batch, np.minimum(parents, self._bounds(batch)), depth + 1))
        worst = max(self.ceiling, self.value)
        return Extremum(self.sign * worst, self.attained, self.item, self.time)

    def _bounds(self, batch: S) -> Array:
        """Return upper bounds (spans,) of sign · quantity, and record the largest value."""
        check_time()
        self.evaluated += len(batch)
        with np.errstate(all="ignore"):  # coefficients may have any value; nan is handled below
            bound = self.formula(batch)
            bounds = _without_nan(self.sign * bound.value)
            # Spans that tie are taken in order: the answer is the same on every machine.
            size = np.max(np.abs(bounds), initial=0.0, where=np.isfinite(bounds)) or 1.0
            rounded = np.round(bounds / size, TIE_DIGITS)
            candidates = np.sort(np.argsort(-rounded, kind="stable")[:MAX_CANDIDATES])
            if self.item >= 0:  # no value exceeds its span's bound
                candidates = candidates[bounds[candidates] >= self.value - TIE * abs(self.value)]
            if len(candidates):
                points = batch.take(candidates).at(bound.x[candidates])
                if self.rough and bounds.max() <= self.target:
                    values = bounds[candidates]
                else:
                    values = _without_nan(self.sign * self.formula(points).value)
                self._record(points, values)
        return bounds

    def _record(self, points: S, values: Array) -> None:
        """Record the largest value, or the first in time of values that tie."""
        largest = float(values.max())
        tie = TIE * abs(largest) if math.isfinite(largest) else 0.0
        best = int(np.argmax(values >= largest - tie))
        value, time = float(values[best]), float(points.times(np.zeros(len(points)))[best])
        earlier = self.item >= 0 and value >= self.value - tie and time < self.time
        if value > self.value + tie or earlier or (self.item < 0 and np.isinf(self.value)):
            self.value, self.item, self.time = max(value, self.value), int(points.item[best]), time

    def _prune(self, spans: S, bounds: Array) -> tuple[S, Array] | None:
        """Close spans at the threshold, and return the remaining ones, if any."""
        closed = bounds <= self.threshold
        self.ceiling = max(self.ceiling, float(np.max(bounds[closed], initial=-np.inf)))
        if closed.all():
            return None
        return (spans.take(~closed), bounds[~closed]) if closed.any() else (spans, bounds)


def _without_nan(values: Array) -> Array:
    """Return values with nan replaced by infinity, which fails a check."""
    return np.where(np.isnan(values), np.inf, values)


def batches(spans: S) -> Iterator[S]:
    """Yield the spans, BATCH at a time."""
    if 0 < len(spans) <= BATCH:
        yield spans
    else:
        yield from (spans.take(slice(i, i + BATCH)) for i in range(0, len(spans), BATCH))


def worst(spans: Iterable[S], formula: Formula[S], sense: str, **options: float) -> Extremum:
    """Return the largest (``max``) or smallest (``min``) value; options of ``BranchAndBound``."""
    search: BranchAndBound[S] = BranchAndBound(formula, sense, **options)
    for each in spans:
        search.add(each)
    return search.finish()
