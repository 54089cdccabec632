"""Directions of legs and edges on whole pieces, enclosed once for all checks that need them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from weakref import WeakKeyDictionary

from hitchopt.checks.bounds.bodies import edge_vectors, pull_vectors
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import enclosure
from hitchopt.trajectory.enclosure import Enclosure
from hitchopt.values import Array

Shared = WeakKeyDictionary[Motion, dict[Callable[[Motion], Array], Enclosure]]

_SHARED: ContextVar[Shared | None] = ContextVar("shared", default=None)


@contextmanager
def shared_directions() -> Iterator[None]:
    """Keep directions within the context: they take more room than the motion itself."""
    token = _SHARED.set(WeakKeyDictionary())
    try:
        yield
    finally:
        _SHARED.reset(token)


def pull_directions(motion: Motion) -> Enclosure:
    """Enclose the directions of ``pull_vectors``, (pieces, 2n, 3)."""
    return _directions(motion, pull_vectors)


def edge_directions(motion: Motion) -> Enclosure:
    """Enclose the directions of ``edge_vectors``, (pieces, n, 3)."""
    return _directions(motion, edge_vectors)


def taken(directions: Enclosure, part: slice) -> Enclosure:
    """Return those of some cells, which are one per piece and item, in a row."""
    c, radius = directions.coefficients, directions.radius
    return Enclosure(c.reshape(-1, *c.shape[2:])[part], radius.ravel()[part])


def _directions(motion: Motion, vectors: Callable[[Motion], Array]) -> Enclosure:
    shared = _SHARED.get()
    kept = {} if shared is None else shared.setdefault(motion, {})
    if vectors not in kept:
        kept[vectors] = enclosure.direction(vectors(motion), position_margin(motion))
    return kept[vectors]
