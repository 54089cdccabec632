"""The smallest or largest value of a quantity over continuous time, by branch and bound.

The caller gives *cells* (polynomials on a span of time) and a *bound*: on every cell a number
that the quantity does not pass, and a value that it takes. Cells whose bound may still change the
answer are halved until none does. The answer holds for all t; it is not read off samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.time_limit import check_time
from hitchopt.trajectory import bernstein
from hitchopt.values import Array, Indices

RELATIVE = 1e-4
"""Largest gap between the answer and an attained value, relative to that value."""

ABSOLUTE = 2e-7
"""The same in the quantity's own unit; the larger of the two counts."""

MAX_HALVINGS = 40
"""Maximum number of halvings: the bound of a cell of 1e-12 of its piece is taken as it is."""

MAX_CELLS = 100_000
"""Maximum number of halves (or ten per given cell): beyond it bounds are taken as they are, valid
but less tight."""

BATCH = 4096
"""Cells bounded in one go, so that what a bound allocates stays within the caches."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Polynomials on spans of time, one span a cell.

    Attributes
    ----------
    blocks: (cells, rows, degree + 1) each; rows that share a degree share a block.
    item: (cells,), whose quantity it is.
    start, end: (cells,) [s]
    margin: (cells,), taken off every bound to cover rounding, in the quantity's unit.
    """

    blocks: tuple[Array, ...]
    item: Indices
    start: Array
    end: Array
    margin: Array

    def __len__(self) -> int:
        return len(self.item)

    @classmethod
    def over(
        cls,
        breaks: Array,
        blocks: Sequence[Array],
        margin: ArrayLike = 0.0,
        pieces: Indices | None = None,
    ) -> Cells:
        """Return one cell per piece and item.

        Parameters
        ----------
        breaks: (pieces + 1,) [s]
        blocks: (pieces, items, rows, degree + 1) each.
        margin: broadcasts to (pieces, items).
        pieces: of the breaks, that the blocks are of; None for all of them.
        """
        count, items = blocks[0].shape[:2]
        begin, end = breaks[:-1], breaks[1:]
        if pieces is not None:
            begin, end = begin[pieces], end[pieces]
        margins = np.empty((count, items))
        margins[...] = margin
        return cls(
            tuple([block.reshape(count * items, *block.shape[2:]) for block in blocks]),
            _items(count, items),
            begin.repeat(items),
            end.repeat(items),
            margins.ravel(),
        )

    def take(self, index: Indices | NDArray[np.bool_] | slice) -> Cells:
        """Return the chosen cells."""
        blocks = tuple(block[index] for block in self.blocks)
        start, end = self.start[index], self.end[index]
        return Cells(blocks, self.item[index], start, end, self.margin[index])

    def halves(self) -> Cells:
        """Return all first halves, then all second halves."""
        blocks = []
        for block in self.blocks:
            flat = block.reshape(-1, block.shape[-1])  # one product of matrices, not one a cell
            parts = bernstein.halve(flat) if block.shape[-1] > 1 else (flat, flat)
            halves = np.concatenate(parts)
            blocks.append(halves.reshape(2 * len(block), *block.shape[1:]))
        middle = 0.5 * (self.start + self.end)
        return Cells(
            tuple(blocks),
            np.concatenate([self.item, self.item]),
            np.concatenate([self.start, middle]),
            np.concatenate([middle, self.end]),
            np.concatenate([self.margin, self.margin]),
        )


@lru_cache(maxsize=64)
def _items(count: int, items: int) -> Indices:
    """Return the items (count · items,) of cells in a row, which nobody may change."""
    return np.arange(count * items) % max(1, items)


def joined_cells(parts: Sequence[Cells]) -> Cells:
    """Return the cells of all parts, in a row."""
    columns = zip(*((*p.blocks, p.item, p.start, p.end, p.margin) for p in parts), strict=True)
    *blocks, item, start, end, margin = map(np.concatenate, columns)
    return Cells(tuple(blocks), item, start, end, margin)


@dataclass(frozen=True, eq=False)
class Estimate:
    """A bound and an attained value of every cell.

    Attributes
    ----------
    bound: (cells,), not passed anywhere on the cell.
    value: (cells,), taken at ``x``.
    x: (cells,) in [0, 1], the place on the cell.
    """

    bound: Array
    value: Array
    x: Array

    def negated(self) -> Estimate:
        """Return the estimate of the quantity with its sign changed."""
        return Estimate(-self.bound, -self.value, self.x)


Bound = Callable[[tuple[Array, ...]], Estimate]
"""Function from the blocks of cells to their estimate."""

First = Callable[[slice], Estimate]
"""Function from a part of the given cells to their estimate, of which more is known than of others.
"""


@dataclass(frozen=True)
class Extremum:
    """The smallest or largest value of a quantity.

    Attributes
    ----------
    worst: not passed by the quantity at any time, rounding included.
    value: an attained value, about as far out as ``worst``.
    item: whose value it is; -1 where there was no cell at all.
    time: [s], when it is attained.
    """

    worst: float
    value: float
    item: int
    time: float


class Search:
    """Branch and bound for the smallest value; cells may be added bit by bit.

    Parameters
    ----------
    bound: gives lower bounds.
    relative, absolute: how tight ``worst`` has to be.
    target: where all values reach this, cells are halved until ``worst`` does too.
    known: only smaller values matter; the item is -1 where there are none.
    """

    def __init__(
        self,
        bound: Bound,
        *,
        relative: float = RELATIVE,
        absolute: float = ABSOLUTE,
        target: float = -np.inf,
        known: float = np.inf,
    ) -> None:
        self.bound = bound
        self.relative = relative
        self.absolute = absolute
        self.target = target
        self.value = known
        self.item = -1
        self.time = 0.0
        self.floor = np.inf  # smallest bound of the cells that are done with
        self.looked_at = 0
        self._open: list[tuple[Cells, Array]] = []

    @property
    def threshold(self) -> float:
        """Cells bounded by this or more need no closer look."""
        if not math.isfinite(self.value):
            return self.value
        tight = self.value - max(self.absolute, self.relative * abs(self.value))
        return max(tight, self.target) if self.value >= self.target else tight

    def add(self, cells: Cells, first: First | None = None) -> None:
        """Bound the cells once, by ``first`` where given; keep those that may hold the smallest."""
        for i, batch in enumerate(_batches(cells)):
            known = None if first is None else partial(first, slice(i * BATCH, (i + 1) * BATCH))
            self._keep(batch, self._bounds(batch, known))

    def finish(self) -> Extremum:
        """Halve what is open until nothing is, and return the answer."""
        pending = [(cells, bounds, 0) for cells, bounds in self._open]
        self._open = []
        # Deepest first: few cells are alive at a time, and the best values come early.
        pending.sort(key=lambda entry: -float(entry[1].min()))
        enough = max(MAX_CELLS, 10 * self.looked_at) + self.looked_at
        while pending:
            cells, bounds, depth = pending.pop()
            self._keep(cells, bounds)
            if not self._open:
                continue
            cells, bounds = self._open.pop()
            if depth == MAX_HALVINGS or self.looked_at > enough:
                self._settle(bounds - cells.margin)
                continue
            inherited = np.concatenate([bounds, bounds])
            for first, batch in enumerate(_batches(cells.halves())):
                given = inherited[first * BATCH :][: len(batch)]
                pending.append((batch, np.maximum(given, self._bounds(batch)), depth + 1))
        return Extremum(min(self.floor, self.value), self.value, self.item, self.time)

    def _bounds(self, batch: Cells, known: Callable[[], Estimate] | None = None) -> Array:
        """Return the lower bounds (cells,), having noted the smallest value."""
        check_time()
        self.looked_at += len(batch)
        with np.errstate(all="ignore"):  # coefficients may be anything; see nan below
            estimate = self.bound(batch.blocks) if known is None else known()
            values, bounds = estimate.value, estimate.bound
            # What is no number is as bad as can be: the search ends there, and the check fails.
            if math.isnan(values.sum() + bounds.sum()):  # or infinities of both signs
                lost = np.isnan(values) | np.isnan(bounds)
                values, bounds = (np.where(lost, -np.inf, each) for each in (values, bounds))
        best = int(values.argmin())
        if values[best] < self.value or (self.item < 0 and math.isinf(self.value)):
            self.value = float(values[best])
            self.item = int(batch.item[best])
            x = float(estimate.x[best])
            self.time = float(batch.start[best] + x * (batch.end[best] - batch.start[best]))
        return bounds

    def _keep(self, cells: Cells, bounds: Array) -> None:
        """Put aside the cells whose bounds need a closer look, and settle all others."""
        done = bounds >= self.threshold
        if done.all():
            self._settle(bounds - cells.margin)
        elif not done.any():
            self._open.append((cells, bounds))
        else:
            self._settle((bounds - cells.margin)[done])
            left = (~done).nonzero()[0]
            self._open.append((cells.take(left), bounds[left]))

    def _settle(self, bounds: Array) -> None:
        """Take bounds, rounding included, as they are."""
        self.floor = min(self.floor, float(bounds.min()))


def _batches(cells: Cells) -> Iterator[Cells]:
    if 0 < len(cells) <= BATCH:
        yield cells
        return
    for first in range(0, len(cells), BATCH):
        yield cells.take(slice(first, first + BATCH))


def smallest(
    cells: Cells, bound: Bound, target: float = -np.inf, first: First | None = None
) -> Extremum:
    """Return the smallest value over all cells; ``bound`` and ``first`` give lower bounds."""
    search = Search(bound, target=target)
    search.add(cells, first)
    return search.finish()


def largest(
    cells: Cells,
    bound: Bound,
    target: float = np.inf,
    first: First | None = None,
    absolute: float = ABSOLUTE,
) -> Extremum:
    """Return the largest value over all cells; ``bound`` and ``first`` give upper bounds."""
    search = Search(lambda blocks: bound(blocks).negated(), target=-target, absolute=absolute)
    search.add(cells, None if first is None else lambda part: first(part).negated())
    least = search.finish()
    return Extremum(-least.worst, -least.value, least.item, least.time)
