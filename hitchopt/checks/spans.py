"""Time spans of a plan, and the polynomials that checks read on them.

A check is a formula over spans of drones, points, cables, clasps or pairs. Values that several
formulas use are cached: those of a motion within ``value_cache``, those of spans with the spans.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import wraps
from math import perm
from typing import Any, NamedTuple, Self, TypeVar, cast

import numpy as np

from hitchopt.hitch.team import Layout
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.flight import Flight
from hitchopt.motion.loads import reduce_constants
from hitchopt.motion.motion import Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.search import BATCH, TimeSpans
from hitchopt.values import Array, Indices, lazy

ROUNDING = 2.0**-40
"""Margin of every bound, relative to the largest numbers that enter the quantity.

Coefficients and breaks are exact: they define the plan. Values computed from them err by a few
units in the last place; the margin has a reserve of a factor of a thousand, also for sampling."""

DIFFERENCE_ROUNDING = 2.0**-50  # Largest relative error of a difference of two numbers
MAX_CACHED = 8 * BATCH  # Maximum number of spans of drones with cached values

UPWARD = np.array([0.0, 0.0, 1.0])

F = TypeVar("F", bound=Callable[..., Any])

_CACHE: ContextVar[dict[Any, Any] | None] = ContextVar("cache", default=None)


@contextmanager
def value_cache() -> Iterator[None]:
    """Cache values within the outermost context, since they take more memory than the motion."""
    cache = _CACHE.get()
    token = _CACHE.set({} if cache is None else cache)
    try:
        yield
    finally:
        _CACHE.reset(token)


def cached(value: F) -> F:
    """Return a function whose values are computed once within ``value_cache``.

    Callers must not modify them.
    """

    @wraps(value)
    def stored(*args: Any) -> Any:
        cache = _CACHE.get()
        if cache is None:
            return value(*args)
        key = value, args
        if key not in cache:
            cache[key] = value(*args)
        return cache[key]

    return cast("F", stored)


@cached
def runs_of(motion: Motion, states: Set[CableState]) -> tuple[Motion, ...]:
    """Return ``Motion.spans`` in some states, the same for all rules."""
    return motion.spans(lambda state: state in states)


@cached
def magnitude(motion: Motion) -> float:
    """Return the largest coordinate of drones, and of vertices while the hitch exists [m]."""
    vertices = motion.vertices.coefficients[motion.formed]
    of_drones = float(np.max(np.abs(motion.drones.coefficients), initial=0.0))
    of_vertices = float(np.max(np.abs(vertices), initial=0.0))
    return max(of_drones, of_vertices)


@cached
def flight_magnitude(flight: Flight) -> float:
    """Return ``magnitude`` of the only team, or the largest coordinate of all drones [m]."""
    if len(flight.teams) == 1:
        return magnitude(flight.teams[0].motion)
    return float(np.max(np.abs(flight.drones.coefficients), initial=0.0))


def position_margin(motion: Motion) -> float:
    """Return the rounding error of positions [m]."""
    return ROUNDING * magnitude(motion)


@cached
def derivative(part: PiecewisePolynomial, order: int) -> Array:
    """Return the coefficients (pieces, …, degree + 1) of a time derivative."""
    return by_time(derivative(part, order - 1), part.durations) if order else part.coefficients


def by_time(c: Array, durations: Array) -> Array:
    """Return the time derivative of polynomials (pieces, …, degree + 1)."""
    slope = bernstein.differentiate(c)
    slope /= durations.reshape(-1, *(1,) * (c.ndim - 1))
    return slope


@cached
def derivative_margin(part: PiecewisePolynomial, order: int) -> Array:
    """Return the rounding margin (pieces, items) of the norm of a time derivative.

    For the k-th derivative of degree N on a piece of h seconds, it is ``2**-50 · 2^k · N!/(N-k)! /
    h^k`` times the largest difference of adjacent coefficients, plus ``2**-40`` of the derivative.
    """
    gain = 2.0**order * perm(part.degree, order) / part.durations**order
    size = _largest(derivative(part, order))
    margin: Array = (DIFFERENCE_ROUNDING * gain)[:, None] * _jumps(part) + ROUNDING * size
    return margin


@cached
def _jumps(part: PiecewisePolynomial) -> Array:
    """Return the largest differences (pieces, items) of adjacent coefficients."""
    return _largest(np.diff(part.coefficients, axis=-1))


def _largest(coefficients: Array) -> Array:
    """Return the largest magnitudes (pieces, items) of coefficients (pieces, items, d, m)."""
    flat = np.abs(coefficients).reshape(*coefficients.shape[:2], -1)
    largest: Array = np.maximum.reduce(flat, axis=-1, initial=0.0)
    return largest


@cached
def rate(motion: Motion, table: Callable[[Motion], Array]) -> Array:
    """Return the time derivative of a table of a motion (pieces, …, degree + 1)."""
    return by_time(table(motion), motion.drones.durations)


class MotionSpans(TimeSpans):
    """Spans of one kind of item of a motion."""

    source: Motion

    names: Callable[[Motion], Sequence[str]]  # The items' names

    @classmethod
    def of(cls, motion: Motion) -> Iterable[Self]:
        """Return the spans of whole pieces of every item, in batches.

        Batches are cached, except for many items: their values would fill the memory.
        """
        pieces, drones = motion.drones.coefficients.shape[:2]
        if pieces * drones > MAX_CACHED:
            return cls.all_of(motion, motion.drones.breaks, len(cls.names(motion)))
        return _cached_batches(motion, cls)

    def scalars(self, tables: Sequence[Array]) -> list[Enclosed]:
        """Return exact scalars from tables (pieces, items, degree + 1)."""
        return [Enclosed(self.read(table)[:, None]) for table in tables]

    def derivative(self, part: PiecewisePolynomial, order: int) -> Enclosed:
        """Return the time derivative of points of a part, rounding included."""
        margin = derivative_margin(part, order)[self.piece, self.item]
        return Enclosed(self.read(derivative(part, order)), margin)

    @lazy
    def noise(self) -> float:
        """[m] Rounding error of differences of positions."""
        return position_margin(self.source)


@cached
def _cached_batches(motion: Motion, spans_type: type[MotionSpans]) -> tuple[Any, ...]:
    """Return the spans of whole pieces of every item."""
    return tuple(spans_type.all_of(motion, motion.drones.breaks, len(spans_type.names(motion))))


def cable_names(motion: Motion) -> Sequence[str]:
    """Return the cables' names."""
    return motion.team.cable_names


def positions(motion: Motion) -> tuple[Array, Array]:
    """Return drones (pieces, 2n, 3, N+1) and points (pieces, P, 3, N+1) in a common degree [m]."""
    drones, vertices = same_degree(motion.drones.coefficients, motion.vertices.coefficients)
    return drones, vertices


@cached
def leg_vectors(motion: Motion) -> Array:
    """Return vectors (pieces, 2n, 3, N+1) [m] of legs, to each drone q0, r0, q1, …."""
    drones, ends = same_degree(motion.drones.coefficients, motion.inner_ends.coefficients)
    return drones - ends.reshape(drones.shape)


@cached
def pull_vectors(motion: Motion) -> Array:
    """Return vectors (pieces, 2n, 3, N+1) [m] to each drone along its straight part of cable."""
    if motion.team.layout.closed:
        return leg_vectors(motion)
    drones, vertices = positions(motion)
    return drones - vertices[:, motion.team.layout.pulled_to]


@cached
def edge_vectors(motion: Motion) -> Array:
    """Return the edges ``p_{k+1} - p_k`` (pieces, n, 3, N+1) [m]."""
    return motion.team.layout.edges(positions(motion)[1], axis=1)


def joined_arrays(parts: Sequence[Array], axis: int) -> Array:
    """Return concatenated polynomials (…, degree + 1), in the largest of their degrees."""
    return np.concatenate(same_degree(*parts), axis=axis)


def bent_edges(motion: Motion) -> tuple[Array, Array]:
    """Return the straight parts of edges at ``p_k`` and at ``p_{k+1}`` (pieces, n, 3, N+1) [m].

    They end at the object that an edge is wrapped around; both are a whole edge if straight.
    """
    if not motion.has_wraps:
        edges = edge_vectors(motion)
        return edges, edges
    ends, contacts = same_degree(motion.inner_ends.coefficients, motion.contacts.coefficients)
    return contacts[:, :, 0] - ends[:, :, 0], ends[:, :, 1] - contacts[:, :, 1]


@cached
def cable_parts(motion: Motion) -> tuple[Array, Indices]:
    """Return the cable parts as segments (pieces, bodies, 2, 3, N+1) [m], and their indices.

    An edge that is wrapped around an object has three: two straight parts and the arc's chord.
    """
    layout = motion.team.layout
    if not motion.has_wraps:
        nodes = motion.vertices.coefficients, motion.drones.coefficients
        return joined_arrays(nodes, axis=1)[:, layout.part_nodes], layout.parts
    drones, ends, contacts = same_degree(
        motion.drones.coefficients, motion.inner_ends.coefficients, motion.contacts.coefficients
    )
    pairs = drones.reshape(ends.shape)
    corners = [pairs[:, :, 0], ends[:, :, 0], contacts[:, :, 0]]
    route = np.stack([*corners, contacts[:, :, 1], ends[:, :, 1], pairs[:, :, 1]], axis=2)
    parts = np.stack([route[:, :, :-1], route[:, :, 1:]], axis=3)
    part = (3 * np.arange(layout.robots)[:, None] + np.array([0, 1, 1, 1, 2])).ravel()
    exists = np.isin(part, layout.parts)  # the ends of a chain have no legs
    return parts.reshape(len(parts), -1, *parts.shape[3:])[:, exists], part[exists]


def clasped_pairs(layout: Layout) -> Indices:
    """Return the pairs of cables (clasps,) with a common clasp: ``i * n + j`` with i < j."""
    return pair_of(layout, layout.ahead, layout.behind)


def pair_of(layout: Layout, first: Indices, second: Indices) -> Indices:
    """Return pairs of cables as ``i * n + j`` with i <= j."""
    return np.minimum(first, second) * layout.robots + np.maximum(first, second)


def part_names(motion: Motion, parts: Indices) -> list[str]:
    """Return the names of cable parts: legs of their drones, edges of the polygon."""
    legs = motion.team.leg_names
    names = list[str]()
    for part in parts.tolist():
        cable, kind = divmod(part, 3)
        of_kind = (legs[2 * cable], f"edge {cable}", legs[2 * cable + 1])
        names.append(of_kind[kind])
    return names


def without_shared_zeros(rows: Sequence[Array]) -> list[Array]:
    """Return polynomials divided by the factor ``x^a (1 - x)^b`` that all those of an item share.

    They are (pieces, items, k, degree + 1) each, constants in degree 0.
    """
    rows = [reduce_constants(row) for row in rows]
    ends = np.concatenate([row[..., [0, -1]] for row in rows], axis=2)
    if not np.logical_or.reduce(np.logical_and.reduce(ends == 0.0, axis=2), axis=None):
        return rows
    divided_at_start = _divided(joined_arrays(rows, axis=2))
    divided = _divided(divided_at_start[..., ::-1])[..., ::-1]
    ends_of_rows = np.cumsum([row.shape[2] for row in rows])[:-1]
    return [reduce_constants(part) for part in np.split(divided, ends_of_rows, axis=2)]


def _divided(table: Array) -> Array:
    """Return polynomials (pieces, items, rows, degree + 1) divided by their common power of x."""
    order = bernstein.degree(table)
    while True:
        begin_at_zero = np.all(table[..., 0] == 0.0, axis=2)
        is_divisible = begin_at_zero & np.any(table != 0.0, axis=(2, 3))
        if order == 0 or not np.any(is_divisible):
            return table
        steps = np.arange(1, order + 1)
        quotient = bernstein.elevate(table[..., 1:] * (order / steps), order)
        table = np.where(is_divisible[..., None, None], quotient, table)


class PhasePart(NamedTuple):
    """A phase, its pieces in the motion, and the motion on them."""

    phase: Phase  # The phase
    pieces: slice  # Its pieces
    motion: Motion  # The motion on these


def phase_parts(motion: Motion) -> Iterator[PhasePart]:
    """Yield the parts of a motion by phase; each piece belongs to the phase at its middle.

    Phases of blended steps end within pieces.
    """
    breaks = motion.drones.breaks
    for index, phase in enumerate(motion.phases):
        pieces = np.flatnonzero(motion.phase_of_piece == index)
        if len(pieces):
            run = slice(int(pieces[0]), int(pieces[-1]) + 1)
            start = float(breaks[run.start])
            end = float(breaks[run.stop])
            whole = replace(phase, start=start, end=end)
            yield PhasePart(phase, run, motion.slice_pieces(run, (whole,)))
