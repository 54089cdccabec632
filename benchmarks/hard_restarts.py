"""Random restarts of the optimiser, each within a cap of processor time."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from benchmarks.hard_cases import Case
from hitchopt.geometry import ConvexPolygon
from hitchopt.planners.optimise.candidates import Candidate, searched
from hitchopt.planners.optimise.guesses import mean_turn
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.screening import end_margins
from hitchopt.planners.optimise.search_task import Search

CAP = 20.0
"""[s] of processor time for one restart; what has found nothing by then counts as not found."""


class CapReachedError(Exception):
    """The cap is reached."""


@dataclass(frozen=True)
class Restarts:
    """What random restarts of one morph came to.

    Attributes
    ----------
    count: how many there were.
    found: how many of them led to a certified path.
    capped: how many the cap of processor time stopped.
    best: shortest certified duration [s], infinity if there is none.
    """

    count: int
    found: int
    capped: int
    best: float


def restarts(case: Case, count: int) -> Restarts:
    """Return what that many random restarts of a morph come to."""
    rng = np.random.default_rng(0)
    durations: list[float] = []
    capped = 0
    for seed in rng.integers(0, 2**32, count):
        try:
            with _capped(CAP):
                found = restarted(case, np.random.default_rng(seed))
        except CapReachedError:
            capped += 1
            continue
        durations += [candidate.flight.duration for candidate in found]
    return Restarts(count, len(durations), capped, min(durations, default=np.inf))


def restarted(case: Case, rng: np.random.Generator) -> list[Candidate]:
    """Return what one random first guess comes to."""
    first, last = case.start.polygon, case.end.polygon
    s = np.linspace(0.0, 1.0, 9)
    if not isinstance(first, ConvexPolygon) or not isinstance(last, ConvexPolygon):
        return []
    angle = mean_turn(first, last) + 2.0 * np.pi * rng.choice([-1, 0, 0, 0, 1])
    bump = np.sin(np.pi * s)
    turn = angle * (s + 0.15 * rng.normal() * bump)
    size = 1.0 + 0.25 * rng.normal() * bump
    bow = np.outer(bump, rng.normal(scale=0.4, size=2))
    shape = first.vertices - first.centroid
    goal = last.translated(-last.centroid).rotated(-angle).vertices
    blend = shape + s[:, None, None] * (goal - shape)
    blend = blend + 0.05 * bump[:, None, None] * rng.normal(size=shape.shape)
    c, d = np.cos(turn), np.sin(turn)
    matrices = np.stack([np.stack([c, d], axis=-1), np.stack([-d, c], axis=-1)], axis=-2)
    centres = first.centroid + s[:, None] * (last.centroid - first.centroid) + bow
    polygons = centres[:, None] + size[:, None, None] * (blend @ matrices)
    polygons[0], polygons[-1] = first.vertices, last.vertices
    path = KnotPath.through("restart", case.start, case.end, polygons)
    if np.min(path.slack) <= 0.0:
        return []
    margins = end_margins(case.start, case.end, case.requirements)
    return searched([path], Search(case.requirements, case.judge, None, margins))


@contextmanager
def _capped(seconds: float) -> Iterator[None]:
    """Raise CapReachedError in or after the body once it has taken that much processor time.

    A solver that is stopped may swallow the error, so it is raised again every second.
    """
    reached = False

    def stop(*_: object) -> None:
        nonlocal reached
        reached = True
        raise CapReachedError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    if reached:
        raise CapReachedError
