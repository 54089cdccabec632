"""The search for a path: guesses are optimised, one by one, until their paths are clear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.planners.optimise.guesses import guesses, widened
from hitchopt.planners.optimise.ipopt_steps import iterates
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.screening import (
    clear,
    end_margin,
    estimate,
    judged,
    loose,
    same,
    sound,
)
from hitchopt.planners.optimise.search_task import Judge, Search, SolverStep
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.requirements import Requirements


@dataclass(frozen=True)
class Round:
    """One round of refinement: how closely a path is examined.

    Attributes
    ----------
    finer: how many times the first knots' steps.
    parts: of every step, at whose ends distances are enforced.
    margin: how many times their limits.
    """

    finer: int
    parts: int
    margin: float


ROUNDS = (Round(1, 4, 1.02), Round(1, 8, 1.03), Round(2, 4, 1.02), Round(2, 8, 1.05))
"""Rounds of refinement until a path is clear and the judge accepts it."""

FIRST_STEP = SolverStep(0.17)
"""Step of the optimiser from a guess."""

LATER_STRIDE = 0.12
"""[m] Stride from a path that the optimiser has found."""

FIRST_STEPS, LATER_STEPS, FASTEST_STEPS = 12, 5, 4
"""Largest numbers of steps from a guess, in a round, and towards a faster path."""

STILL = 0.15
"""Share of its stride: a step that moves no vertex by more will not clear a path either."""

LENGTH = 0.9
"""[m] Length that a vertex's path from one of the first knots to the next should not exceed."""

FEWEST_KNOTS, MOST_KNOTS = 8, 16
"""Bounds of the number of steps between the first knots."""

WIDER = 0.25
"""Share by which guesses are widened half way where none has led to a path as it is."""

HOPELESS = 1.3
"""Factor on the duration of the fastest path found: slower guesses are not optimised."""

WORSE = 1.1
"""Factor on the duration of the fastest path found: slower estimates are not refined."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A path that the judge has accepted.

    Attributes
    ----------
    name: of the guess that it came from.
    flight: along it.
    """

    name: str
    flight: Flight


def candidates(
    start: Hitch,
    end: Hitch,
    requirements: Requirements,
    judge: Judge,
    tension: tuple[float, float] | None = None,
) -> list[Candidate]:
    """Return the paths found from all guesses, the fastest first; none for chains.

    Parameters
    ----------
    start, end: hitches at one altitude that satisfy all limits.
    requirements: limits, separation and arena.
    judge: decides about every path; those that it rejects are refined.
    tension: smallest and largest [N] where tensions may change on the path.
    """
    if not isinstance(start.polygon, ConvexPolygon) or not isinstance(end.polygon, ConvexPolygon):
        return []  # chains are not optimised
    margins = (end_margin(start, requirements), end_margin(end, requirements))
    search = Search(requirements, judge, tension, margins)
    found = guesses(start.polygon, end.polygon, FEWEST_KNOTS + 1)
    paths = [KnotPath.through(guess.name, start, end, guess.polygons) for guess in found]
    whole = [path for path in paths if sound(path)]
    first = searched([path for path in whole if loose(path, requirements)] or whole, search)
    if first:
        return first
    # With wider polygons half way, legs have more room to pass one another.
    wide = [
        KnotPath.through(guess.name, start, end, widened(guess.polygons, WIDER))
        for guess in found[1:]
    ]
    return searched([path for path in wide if sound(path)], search)


def searched(paths: Sequence[KnotPath], search: Search) -> list[Candidate]:
    """Return the paths found from the given first ones, the fastest first.

    Those that take the least time as they are come first; the others have to be near them. A guess
    that is one with another, from which a path was found, would come to the same.
    """
    found: list[Candidate] = []
    seen: list[KnotPath] = []
    tried: list[KnotPath] = []
    fastest = np.inf
    estimates = [estimate(path, search.requirements) for path in paths]
    for k in np.argsort(estimates, kind="stable"):
        if estimates[k] > HOPELESS * fastest:
            break
        knots = paths[k].resampled(_steps(paths[k]) + 1)
        if any(same(knots, other) for other in tried):
            continue
        settled = _settled(knots, search, seen)
        if settled is None:
            continue
        tried.append(knots)
        if found and estimate(settled, search.requirements) > WORSE * fastest:
            continue
        flight = _refined(settled, search)
        if flight is not None:
            found.append(Candidate(settled.name, flight))
            fastest = min(fastest, flight.duration)
    return sorted(found, key=lambda candidate: candidate.flight.duration)


def _settled(knots: KnotPath, search: Search, seen: list[KnotPath]) -> KnotPath | None:
    """Return the path of least energy near a guess; None where it is one that was seen before."""
    found: KnotPath | None = None
    before = tuple(seen)
    for moved in iterates(knots, search, FIRST_STEP, FIRST_STEPS):
        if any(same(moved, other) for other in before):
            return None
        found = moved
        seen.append(moved)
    return found


def _refined(path: KnotPath, search: Search) -> Flight | None:
    """Return the flight along a path of least energy refined, or along a faster one near it.

    Where limits are broken between the knots, rows are added there, then more knots.
    """
    steps = path.steps
    for how in ROUNDS:
        if path.steps != how.finer * steps:
            path = path.resampled(how.finer * steps + 1)
        closer = replace(search, margin=how.margin)
        step = SolverStep(LATER_STRIDE, how.parts)
        for moved in iterates(path, closer, step, LATER_STEPS, STILL):
            path = moved
            if clear(path, search):
                break
        else:
            continue
        quicker = iterates(path, closer, replace(step, fastest=True), FASTEST_STEPS, STILL)
        faster = [moved for moved in quicker if clear(moved, search)]
        choices = [path]
        if faster:
            best = min([*faster, path], key=lambda choice: estimate(choice, search.requirements))
            choices = list(dict.fromkeys([best, path]))
        for choice in choices:
            flight = judged(choice, search)
            if flight is not None:
                return flight
    return None


def _steps(path: KnotPath) -> int:
    """Return how many steps between knots a path needs, its longest vertex path's being LENGTH."""
    longest = float(np.max(np.sum(length(np.diff(path.polygons, axis=0)), axis=0)))
    return int(np.clip(np.ceil(longest / LENGTH), FEWEST_KNOTS, MOST_KNOTS))
