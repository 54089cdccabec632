"""The search for a way: guesses are optimised, one by one, until their paths are clear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch
from hitchopt.planners.optimise.evaluation import Candidate, Judge, Search, clear, judged, promise
from hitchopt.planners.optimise.guesses import guesses, widened
from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.screening import end_margin, loose, same, sound
from hitchopt.planners.optimise.settling import iterates
from hitchopt.planners.optimise.variable_bounds import Step
from hitchopt.requirements import Requirements

__all__ = ["ROUNDS", "Candidate", "Judge", "Search", "candidates", "searched"]


@dataclass(frozen=True)
class Round:
    """How closely a way is looked at.

    Attributes
    ----------
    finer: how many times the first knots' steps.
    parts: of every step, at whose ends distances are kept.
    margin: how many times their limits.
    """

    finer: int
    parts: int
    margin: float


ROUNDS = (Round(1, 4, 1.02), Round(1, 8, 1.03), Round(2, 4, 1.02), Round(2, 8, 1.05))
"""Until a way's path is clear and the judge lets it pass."""

FIRST_MARGIN = 1.02
"""How many times their limits distances are kept at the knots of a guess."""

FIRST_STEP, LATER_STEP = Step(0.17), 0.12
"""Of the optimiser, from a guess; and the stride [m] from a way that it has found."""

FIRST_STEPS, LATER_STEPS, FASTEST_STEPS = 12, 5, 4
"""How many steps at most."""

STILL = 0.15
"""Of its stride: a step that moves no vertex by more will not clear a way either."""

LENGTH = 0.9
"""[m] No vertex is to go farther from one of the first knots to the next, about."""

FEWEST_KNOTS, MOST_KNOTS = 8, 16
"""Steps between the first knots."""

WIDER = 0.25
"""By how much guesses are widened half way where none has led to a way as it is."""

HOPELESS = 1.3
"""A guess that takes longer than the fastest way found by this factor is not optimised."""

WORSE = 1.1
"""A way that promises to take longer than the fastest one found by this factor is not refined."""


def candidates(
    start: Hitch,
    end: Hitch,
    requirements: Requirements,
    judge: Judge,
    tension: tuple[float, float] | None = None,
) -> list[Candidate]:
    """Return the ways found from all guesses, the fastest first; none for chains.

    Parameters
    ----------
    start, end: hitches at one altitude that keep all limits.
    kept: limits, separation and arena.
    judge: has the last word on every path; those that it turns down are refined.
    tension: smallest and largest [N] where tensions may change on the way.
    """
    if not isinstance(start.polygon, ConvexPolygon) or not isinstance(end.polygon, ConvexPolygon):
        return []  # chains are not optimised
    search = Search(
        requirements,
        judge,
        tension,
        (end_margin(start, requirements), end_margin(end, requirements)),
    )
    found = guesses(start.polygon, end.polygon, FEWEST_KNOTS + 1)
    ways = [Way.through(guess.name, start, end, guess.polygons) for guess in found]
    whole = [way for way in ways if sound(way)]
    found_ways = searched([way for way in whole if loose(way, requirements)] or whole, search)
    if found_ways:
        return found_ways
    # Wider on the way, legs have more room to pass one another.
    wide = [
        Way.through(guess.name, start, end, widened(guess.polygons, WIDER)) for guess in found[1:]
    ]
    return searched([way for way in wide if sound(way)], search)


def searched(ways: Sequence[Way], search: Search) -> list[Candidate]:
    """Return the ways found from the given first ones, the fastest first.

    Those that take the least time as they are come first; the others have to be near them. A guess
    that is one with another, from which a way was found, would come to the same.
    """
    found: list[Candidate] = []
    seen: list[Way] = []
    tried: list[Way] = []
    fastest = np.inf
    outlooks = [promise(way, search.requirements) for way in ways]
    for k in np.argsort(outlooks, kind="stable"):
        if outlooks[k] > HOPELESS * fastest:
            break
        knots = ways[k].resampled(_steps(ways[k]) + 1)
        if any(same(knots, other) for other in tried):
            continue
        settled = _settled(knots, search, seen)
        if settled is None:
            continue
        tried.append(knots)
        if found and promise(settled, search.requirements) > WORSE * fastest:
            continue
        refined = _refined(settled, search)
        if refined is not None:
            found.append(refined)
            fastest = min(fastest, refined.flight.duration)
    return sorted(found, key=lambda candidate: candidate.flight.duration)


def _settled(knots: Way, search: Search, seen: list[Way]) -> Way | None:
    """Return the way of least energy near a guess; None where it is one that was seen before."""
    found: Way | None = None
    before = tuple(seen)
    for moved in iterates(knots, search.bounds(FIRST_MARGIN), FIRST_STEP, FIRST_STEPS):
        if any(same(moved, other) for other in before):
            return None
        found = moved
        seen.append(moved)
    return found


def _refined(way: Way, search: Search) -> Candidate | None:
    """Return what comes of a way of least energy, or of a faster one beside it.

    Where limits are broken between the knots, it is looked at there, then more of them are set.
    """
    steps = len(way.polygons) - 1
    for how in ROUNDS:
        if len(way.polygons) != how.finer * steps + 1:
            way = way.resampled(how.finer * steps + 1)
        bounds = search.bounds(how.margin)
        for moved in iterates(way, bounds, Step(LATER_STEP, how.parts), LATER_STEPS, STILL):
            way = moved
            if clear(way, search):
                break
        else:
            continue
        quick = Step(LATER_STEP, how.parts, fastest=True)
        steps_on = iterates(way, bounds, quick, FASTEST_STEPS, STILL)
        faster = [moved for moved in steps_on if clear(moved, search)]
        choices = [*faster, way]
        if faster:
            choices.sort(key=lambda choice: promise(choice, search.requirements))
        for choice in dict.fromkeys([choices[0], way]):
            found = judged(choice, search)
            if found is not None:
                return found
    return None


def _steps(way: Way) -> int:
    """Return how many steps between knots a way needs, its longest one's being LENGTH."""
    travel = np.linalg.norm(np.diff(way.polygons, axis=0), axis=-1)
    longest = float(np.max(np.sum(travel, axis=0)))
    return int(np.clip(np.ceil(longest / LENGTH), FEWEST_KNOTS, MOST_KNOTS))
